import json
import sys

import numpy as np
import pytest

from lpvmpc.errors import LPVMPCError
from lpvmpc.paper import figures, measurements, records, retrain, runs, steering_at_rest
from lpvmpc.paper.runs import LMPC, OURS
from lpvmpc.tune import genetic, sphere

COMMAND = "reproduce"
LINES = {("tuned", OURS), ("tuned", LMPC), ("by hand", OURS), ("printed", "as printed"),
         ("corrected", "+ secant"), ("corrected", "+ network")}


@pytest.fixture
def short(tmp_path, monkeypatch):
    """One road of 40 m, a few lines, a small sphere: everything else is as it is."""
    angle = np.linspace(0.0, 0.8, 21)
    rows = "".join(f"{50 * np.sin(a):.4f},{50 * (1 - np.cos(a)):.4f},3,3,10\n" for a in angle)
    (tmp_path / "road.csv").write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n" + rows)
    case = runs.RoadCase(key="paper", title="bend", scenario="road.csv", ablated=True)
    every = runs.entries
    monkeypatch.setattr(runs, "CASES", (case,))
    monkeypatch.setattr(
        runs, "entries", lambda eq: [e for e in every(eq) if (e.group, e.key) in LINES]
    )
    monkeypatch.setattr(measurements, "STIFFNESS_CASE", "paper")
    monkeypatch.setattr(measurements, "QUICK_SPEEDS", (10.0,))
    monkeypatch.setattr(steering_at_rest, "SPEEDS", (10.0,))
    settings = genetic.GeneticSettings(generations=10, population=10)
    study = sphere.run(seeds=2, settings=settings)
    monkeypatch.setattr(sphere, "run", lambda **options: study)
    monkeypatch.setattr(figures, "DPI", 40)
    # Pictures of a kind are tested beside the report; two tell that they are saved and shown
    some = ("fig10-errors", "fig5-stiffness")
    monkeypatch.setattr(figures, "FIGURES", {k: figures.FIGURES[k] for k in some})


def test_the_report_is_written_and_the_second_time_nothing_is_driven_again(run, short, tmp_path):
    code, out, err = run("--jobs", 1, "--json", tmp_path / "copy" / "all.json")
    assert (code, err) == (0, "")
    assert max(map(len, out.splitlines())) <= 80
    folder = tmp_path / "docs" / "results"
    values = json.loads((folder / "paper.json").read_text())
    assert values == json.loads((tmp_path / "copy" / "all.json").read_text())
    text = (folder / "paper.md").read_text()
    for name in ("fig10-errors", "fig5-stiffness"):
        assert f"](paper/{name}.png)" in text
        assert (folder / "paper" / f"{name}.png").exists()
    assert text.startswith("# The paper's results beside ours\n\nMachine: ")
    rows = {(r["group"], r["line"]): r for r in values["runs"]}
    assert set(rows) == LINES
    assert rows["tuned", OURS]["completed"] and not rows["printed", "as printed"]["completed"]
    # The chain ends in the controller of the first table: driven once, told twice
    full = rows["corrected", "+ network"]
    assert full["lateral_rmse_m"] == rows["tuned", OURS]["lateral_rmse_m"]
    assert values["numbers"]["lateral_rmse_m"]["ours"] == full["lateral_rmse_m"]
    assert values["bars"]["rest_straight_10_mrad"]["ok"]
    assert values["record"]["kept"] == 0

    kept = len(list((tmp_path / "runs" / "reproduce").glob("*.json")))
    assert run("--jobs", 1)[0] == 0
    again = json.loads((folder / "paper.json").read_text())
    assert again["record"]["kept"] == kept > 0
    assert again["runs"] == values["runs"]  # step times too: they were kept


def test_a_quick_look_says_so_and_leaves_the_report_alone(run, short, tmp_path, monkeypatch):
    monkeypatch.setattr(runs, "QUICK", ("paper",))
    code, out, _ = run("--quick", "--jobs", 1)
    assert code == 0
    assert not (tmp_path / "docs").exists()
    text = (tmp_path / "runs" / "reproduce-quick" / "paper.md").read_text()
    assert "(quick look: a part of it, not the report)" in text.splitlines()[0]
    assert "Made by `python eval/reproduce.py --quick`" in text
    assert "Saved runs/reproduce-quick/" in out


def test_weights_tuned_anew_and_networks_trained_anew_drive(run, short, monkeypatch):
    by_hand = records.weights_by_hand()
    asked, seen = [], {}

    def read(folder):
        name = folder.name
        return records.Tuning(
            controller=name, task={"scenarios": ["tuning-b"]}, evaluations=4, budget=4, cost=0.1,
            weights={**by_hand[name], "kp": 7.0} if name == LMPC else by_hand[name],
            before=(), after=(), history=(("genetic", 4, 0.1),),
        )

    def gather(**options):
        seen.update(options)
        raise KeyboardInterrupt

    def tune(task, folder, *rest):
        asked.append(task)
        return folder

    monkeypatch.setattr(retrain, "tune", tune)
    monkeypatch.setattr(records, "read_tuning", read)
    monkeypatch.setattr(retrain, "train", lambda folder, *a, **k: {"network": folder / "n"})
    monkeypatch.setattr(measurements, "gather", gather)
    code, _, err = run("--retune", "--retrain", "--quick")
    assert (code, err) == (130, "Interrupted; the same command goes on from here.\n")
    assert {task.controller for task in asked} == set(by_hand)
    assert len({task.budget for task in asked}) == 1
    equipment = measurements.equip(seen["tunings"], seen["networks"])
    assert equipment.options(LMPC)["weights"]["kp"] == 7.0
    assert equipment.options(OURS)["stiffness_file"] == "runs/reproduce/training-quick/n"


def test_training_anew_without_torch_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(LPVMPCError, match="--retrain needs torch; pip install"):
        retrain.train(tmp_path, 1, lambda *what: None)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--jobs", "-1"], "--jobs is -1, but must be from 0 to 1024"),
        (["--out", "/proc/nowhere"], "Cannot write into '/proc/nowhere'"),
        (["--cache", "/proc/nowhere"], "Cannot write into '/proc/nowhere'"),
        (["--json", "/proc/nowhere/a.json"], "Cannot write into '/proc/nowhere'"),
        (["--resume"], "Unrecognized"),
    ],
)
def test_bad_options_are_one_sentence(run, arguments, sentence):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert sentence in err and err.count("\n") == 1
