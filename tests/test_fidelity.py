import csv
import json

import pytest

from lpvmpc.studies.names import STUDIES

COMMAND = "fidelity"


def test_one_study_end_to_end(run, tmp_path):
    code, out, err = run("tire", "--json", tmp_path / "copy" / "fidelity.json")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    folder = tmp_path / "runs" / "fidelity"  # a part of the studies does not replace the report
    figures = json.loads((tmp_path / "copy" / "fidelity.json").read_text())
    assert {"study", "figure", "value", "limit", "ok"} <= set(figures[0])
    assert all(figure["study"] == "tire" and figure["ok"] for figure in figures)
    rows = list(csv.DictReader((folder / "fidelity.csv").read_text().splitlines()))
    assert [row["figure"] for row in rows] == [figure["figure"] for figure in figures]
    text = (folder / "fidelity.md").read_text()
    assert "## Tire: slip characteristics" in text and "Machine: " in text
    assert "Made by `python eval/fidelity.py tire`" in " ".join(text.split())
    for figure in figures:
        assert figure["figure"] in text and figure["figure"] in out
    linked = [line.split("](")[1][:-1] for line in text.splitlines() if line.startswith("![")]
    assert linked and all((folder / name).stat().st_size > 10_000 for name in linked)
    assert out.endswith("figures are inside their limits.\nSaved runs/fidelity/ "
                        "(fidelity.md, fidelity.csv, fidelity/)\n")


def test_a_figure_outside_its_limit_is_exit_code_3(run, tmp_path):
    code, out, _ = run("tire", "--broken", "wrong-trail", "--out", tmp_path / "here")
    assert code == 3
    assert "FAIL" in out
    text = (tmp_path / "here" / "fidelity.md").read_text()
    assert "**FAILED**" in text
    assert "broken on purpose: wrong-trail" in text


def test_an_unknown_study_is_one_sentence_with_the_list(run):
    code, out, err = run("tyre")
    assert (code, out) == (2, "")
    assert err.startswith("Error: Unknown study 'tyre'; the choices are ")
    assert err.count("\n") == 1
    assert all(name in err for name in STUDIES)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("--broken", "x"), "Unknown broken car 'x'; the choices are"),
        (("--jobs", "-1"), "--jobs is -1, but must be from 0 to 1024."),
        (("--nonsense",), "nonsense"),
    ],
)
def test_bad_input_is_one_sentence(run, arguments, message):
    code, out, err = run(*arguments)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert message in err


def test_the_help_names_every_study_and_the_exit_code(run, capsys):
    with pytest.raises(SystemExit) as stop:
        run("--help")
    assert stop.value.code == 0
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert all(name in text for name in STUDIES)
    assert "3 when one is not" in text


def test_a_folder_that_cannot_be_written_is_one_sentence(run, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run("tire", "--out", tmp_path / "file" / "below")
    assert code == 2
    assert err.startswith("Error: Cannot write into") and err.count("\n") == 1


@pytest.mark.slow
def test_two_processes_find_the_same_figures(run, tmp_path):
    for jobs in (1, 2):
        run("static", "tire", "--jobs", jobs, "--out", tmp_path / str(jobs))
    one, two = ((tmp_path / str(jobs) / "fidelity.csv").read_bytes() for jobs in (1, 2))
    assert one == two and one.index(b"tire,") < one.index(b"static,")  # the order of the report
