import csv
import dataclasses
import json

import numpy as np
import pytest
from matplotlib.figure import Figure

from lpvmpc.bench import cases as ablation
from lpvmpc.bench import report as ablation_report
from lpvmpc.bench.cases import Case
from lpvmpc.sim import batch

COMMAND = "ablation"
OUTPUT = ("ablation.csv", "ablation.json", "ablation.md", "ablation.png")


@pytest.fixture
def road(tmp_path):
    """A bend of 60 m."""
    x = np.arange(0.0, 61.0, 3.0)
    lines = [f"{a:g},{0.004 * a * a:g},4,4" for a in x]
    file = tmp_path / "bend.csv"
    file.write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *lines]) + "\n")
    return str(file)


@pytest.fixture
def short(road, monkeypatch):
    """Two cases on a short road in place of all."""
    cases = (
        Case(key="circuit-0.76", title="76 %", group="grip", scenario=road, options={"grip": 0.5}),
        Case(key="paper", title="paper", group="road", scenario=road, options={"grip": 0.6}),
    )
    monkeypatch.setattr(ablation, "CASES", cases)
    monkeypatch.setattr(ablation, "QUICK", ("circuit-0.76",))
    monkeypatch.setattr(ablation, "COARSE", (0.8, 0.9))
    monkeypatch.setattr(ablation, "FINE", (0.05,))
    roads = (dataclasses.replace(cases[0], options={"grip": 0.4}),)
    monkeypatch.setattr(ablation, "SEARCH", roads)
    monkeypatch.setattr(ablation, "roads", lambda names, grips: roads)


@pytest.fixture
def driven(road, monkeypatch):
    """Counts the runs; one is driven, the others pretend to give the same log."""
    runs, log = [], batch.drive(batch.Run(scenario=road))

    def drive(run):
        runs.append(run)
        return log

    monkeypatch.setattr(batch, "drive", drive)
    return runs


@pytest.fixture
def no_picture(monkeypatch):
    """Drawing takes two seconds, and is tested elsewhere."""
    monkeypatch.setattr(ablation_report, "draw", lambda rows: Figure(figsize=(1.0, 1.0)))


def test_the_report_is_what_was_driven(run, short, driven, tmp_path):
    code, out, err = run("--jobs", "1", "--json", tmp_path / "copy" / "b.json")
    assert (code, err) == (0, "")
    folder = tmp_path / "docs" / "results"
    assert sorted(file.name for file in folder.iterdir()) == sorted(OUTPUT)
    values = json.loads((folder / "ablation.json").read_text())
    assert values == json.loads((tmp_path / "copy" / "b.json").read_text())
    rows = list(csv.DictReader((folder / "ablation.csv").read_text().splitlines()))
    assert len(rows) == 2 * 13 == len(values["runs"])
    assert all(row["completed"] == "True" for row in rows)
    report = (folder / "ablation.md").read_text()
    assert "quick" not in report.splitlines()[0]
    best = values["constant"]["yes"]["best"]
    assert f"nominal one: x{best:g}" in " ".join(out.split())
    assert "| constant-best " in out and "Saved docs/results/" in out
    # sentences and tables fit a terminal, whose last line names the folder
    assert max(len(line) for line in out.splitlines()[:-1]) <= 80
    assert values["bars"]["circuit-0.76_rmse_mm"]["ok"] is True
    assert values["bars"]["circuit-0.87_rmse_mm"]["value"] is None


def test_a_quick_look_really_drives_says_so_and_leaves_the_report_alone(
    run, short, no_picture, tmp_path, monkeypatch
):
    few = [m for m in ablation.MODELS if m.key in ("constant", "constant-best", "network")]
    monkeypatch.setattr(ablation, "MODELS", tuple(few))
    code, out, err = run("--quick", "--jobs", "1")
    assert (code, err) == (0, "") and "Saved runs/ablation-quick/" in out
    folder = tmp_path / "runs" / "ablation-quick"
    report = (folder / "ablation.md").read_text()
    assert "quick look" in report.splitlines()[0] and "--quick" in report
    assert not (tmp_path / "docs").exists()
    rows = list(csv.DictReader((folder / "ablation.csv").read_text().splitlines()))
    # a gentle bend: whoever drives it, the errors are small, and all different
    errors = [float(row["lateral_max_m"]) for row in rows]
    assert 0.0 < min(errors) and max(errors) < 0.1
    assert len(errors) == len(set(errors)) == 7  # twice three models, and the paper's controller


def test_an_interrupted_ablation_goes_on_where_it_stopped(
    run, short, driven, no_picture, tmp_path, monkeypatch
):
    drive, limit = batch.drive, 10

    def interrupted(one):
        if len(driven) >= limit:
            raise KeyboardInterrupt
        return drive(one)

    monkeypatch.setattr(batch, "drive", interrupted)
    code, _, err = run("--jobs", "1")
    assert (code, err) == (130, "Interrupted; --resume goes on from here.\n")
    limit = 1000
    assert run("--jobs", "1", "--resume")[0] == 0
    # 2 * (2 + 1) factors, 26 rows; those of factor 1 on the same road are other grips
    assert len(driven) == 6 + 26
    assert len({one.key() for one in driven}) == len(driven)
    assert run("--jobs", "1", "--resume")[0] == 0
    assert len(driven) == 6 + 26
    (tmp_path / "runs" / "ablation" / "mine.json").write_text("{}")
    assert run("--jobs", "1")[0] == 0  # anew
    assert len(driven) == 2 * (6 + 26)
    assert (tmp_path / "runs" / "ablation" / "mine.json").exists()  # not ours, not removed


def test_there_must_be_something_to_resume(run, short, tmp_path):
    code, out, err = run("--resume", "--cache", tmp_path / "elsewhere")
    assert (code, out) == (2, "")
    assert err.startswith("Error: --resume needs the results of an earlier ablation, but ")
    assert err.count("\n") == 1 and "leave --resume out" in err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--jobs", "-1"], "--jobs is -1, but must be from 0 to 1024"),
        (["--jobs", "two"], "--jobs"),
        (["--fast"], "--fast"),
        (["--out", "file/below"], "Cannot write into 'file/below'"),
        (["--cache", "file/below"], "Cannot write into 'file/below'"),
        (["--json", "file/below/b.json"], "Cannot write into 'file/below'"),
    ],
)
def test_bad_options_are_one_sentence(run, short, tmp_path, arguments, sentence):
    (tmp_path / "file").write_text("")
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("Error: ") and err.count("\n") == 1 and sentence in err
