"""The command `lpvmpc worlds`, on a short road."""

import csv
import json

import numpy as np
import pytest
from matplotlib.figure import Figure

import lpvmpc.bench.worlds_report  # noqa: F401  it takes names of `worlds` that are changed below
from lpvmpc.bench import margins as margin_search
from lpvmpc.bench import worlds, worlds_pictures
from lpvmpc.bench.margins import KINDS
from lpvmpc.sim import batch

COMMAND = "worlds"


@pytest.fixture
def short(tmp_path, monkeypatch):
    """A bend of 60 m in place of the roads, few deviations, one world, one kind of margin."""
    x = np.arange(0.0, 61.0, 3.0)
    lines = [f"{a:g},{0.004 * a * a:g},4,4" for a in x]
    file = tmp_path / "bend.csv"
    file.write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *lines]) + "\n")
    road = worlds.PacedRoad(
        key="circuit-65", title="bend", scenario=str(file), options={"grip": 0.5}
    )
    monkeypatch.setitem(worlds.ROADS, "circuit-65", road)
    few = [one for one in worlds.DEVIATIONS if one.key in ("nominal", "Cr-10")]
    monkeypatch.setattr(worlds, "DEVIATIONS", tuple(few))
    world = worlds.Sampled(key="fleet", world="fleet", roads=("circuit-65",))
    monkeypatch.setattr(worlds, "SAMPLED", {"fleet": world})
    monkeypatch.setattr(worlds, "ADAPTED", ("fleet",))
    monkeypatch.setattr(worlds, "QUICK", {
        "seeds": 2, "roads": ("circuit-65",), "margin_steps": 2, "margin_halvings": 1,
        "quick": True,
    })
    monkeypatch.setattr(margin_search, "KINDS", KINDS[:1])


def test_a_tiny_grid_is_driven_part_by_part_into_one_report(run, short, tmp_path, monkeypatch):
    common = ("--quick", "--jobs", "1", "--controllers", "lpv-mpc", "stanley")
    code, out, err = run(*common, "--parts", "deviations,worlds")
    assert (code, err) == (0, "") and "Saved runs/worlds-quick/" in out
    folder = tmp_path / "runs" / "worlds-quick"
    text = (folder / "worlds.md").read_text()
    assert "quick look" in text.splitlines()[0] and "Not driven yet: margins, adaptation." in text
    assert not (tmp_path / "docs").exists()
    before = (folder / "worlds.csv").read_text()
    code, out, err = run(*common, "--parts", "margins", "--resume", "--json", tmp_path / "w.json")
    assert (code, err) == (0, "")
    after = (folder / "worlds.csv").read_text()
    assert after.startswith(before) and len(after) > len(before)
    lines = list(csv.DictReader(after.splitlines()))
    assert {line["part"] for line in lines} == {"deviations", "worlds", "margins"}
    fleet = [float(line["lateral_rmse_m"]) for line in lines if line["part"] == "worlds"]
    assert len(fleet) == len(set(fleet)) == 4 and 0.0 < min(fleet) and max(fleet) < 0.5
    values = json.loads((tmp_path / "w.json").read_text())
    assert values["record"]["parts"] == ["deviations", "worlds", "margins"]
    assert values["margins"][0]["held"] is not None
    assert {"worlds.png", "worlds-margins.png"} <= {file.name for file in folder.iterdir()}


def test_the_same_numbers_whatever_the_jobs(run, short, tmp_path, monkeypatch):
    monkeypatch.setattr(worlds_pictures, "shares", lambda *a: Figure(figsize=(1.0, 1.0)))
    tables = []
    for jobs in ("1", "2"):
        out = tmp_path / jobs
        arguments = ("--quick", "--controllers", "stanley", "--parts", "worlds", "--out", out)
        assert run(*arguments, "--jobs", jobs)[0] == 0
        tables.append((out / "worlds.csv").read_bytes())
    assert tables[0] == tables[1]


def test_an_interrupted_run_says_how_to_go_on(run, short, monkeypatch):
    def interrupted(one):
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "drive", interrupted)
    code, out, err = run("--quick", "--jobs", "1", "--parts", "worlds")
    assert (code, out, err) == (130, "", "Interrupted; --resume goes on from here.\n")


@pytest.mark.parametrize(
    "arguments, said",
    [
        (("--parts", "margin"), "--parts is 'margin', but must be one of deviations, worlds"),
        (("--seeds", "0"), "--seeds is 0, but must be from 1 to 10000"),
        (("--controllers", "lpv"), "Unknown controller 'lpv'"),
        (("--controllers", "stanley", "stanley"), "each name once"),
        (("--resume",), "--resume needs the results of an earlier worlds"),
    ],
)
def test_bad_input_is_refused_in_one_line(run, arguments, said):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "") and err.count("\n") == 1
    assert said in err
