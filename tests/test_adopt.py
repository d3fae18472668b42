"""Adopting a car: options that are refused, stages that are not repeated."""

import json
import shutil
from pathlib import Path

import pytest

from lpvmpc.commands.recordings import adopt
from lpvmpc.kit import cli

BAD = [
    ([], "RECORDING"),
    (["a.csv"], "--out"),
    (["a.csv", "--out", "car", "--held-back", "0.9"], "--held-back"),
    (["a.csv", "--out", "car", "--fit", "wings"], "Unknown parameter 'wings'"),
    (["a.csv", "--out", "car"], "There is no recording a.csv"),
]


@pytest.mark.parametrize(("words", "message"), BAD)
def test_bad_options_are_one_line(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.run(adopt.Options, adopt.main, words) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


def test_stages_that_are_through_are_not_repeated(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    called = []
    fit = {"warnings": [], "parameters": {
        "Cf": {"value": 1.2e5, "low95": 1.1e5, "high95": 1.3e5, "unit": "N/rad"}}}
    results = {
        "fit": {"fit": fit, "ratio_linear": 2.0, "held_back": {"a.csv": {"r": 0.9, "vy": None}}},
        "drive": {"runs": {
            "ideal": [{"seed": 0, "completed": False, "reason": "left the road"}],
            "rtk": [{"seed": 4, "completed": True, "reason": "", "lateral_rmse_m": 0.007,
                     "lateral_max_m": 0.01, "duration_s": 90.0}]}},
    }

    def stage(name, fails=False):
        def run(options, out):
            called.append(name)
            if fails:
                raise KeyboardInterrupt
            return results.get(name, {})

        return run

    for name in adopt.STAGES:
        monkeypatch.setattr(adopt, f"_{name}", stage(name, fails=name == "train"))
    words = ["a.csv", "--out", "car"]
    assert cli.run(adopt.Options, adopt.main, words) == 130
    assert called == ["fit", "collect", "train"]
    monkeypatch.setattr(adopt, "_train", stage("train"))
    assert cli.run(adopt.Options, adopt.main, words) == 2  # what is there is not overwritten
    assert cli.run(adopt.Options, adopt.main, [*words, "--resume", "--samples", "3000"]) == 2
    assert cli.run(adopt.Options, adopt.main, [*words, "--resume"]) == 3
    assert called == ["fit", "collect", "train", "train", "tune", "drive"]
    told = (tmp_path / "car" / "adopt.md").read_text()
    assert "only 0.900 of r" in told and "draw 0, the car did not complete: left the road" in told
    assert "rtk the median RMSE is 7.00 mm, more than the 6 mm" in told
    assert "linear single track" in told
    assert set(json.loads((tmp_path / "car" / "adopt.json").read_text())["stages"]) == {
        "fit", "collect", "train", "tune", "drive"}


@pytest.mark.slow
def test_the_car_is_driven_in_each_world_and_each_draw_told(tmp_path, monkeypatch):
    cars = Path(__file__).parent.parent / "cars"
    out = Path(shutil.copytree(cars / "bmw-320i", tmp_path / "mine"))
    monkeypatch.setattr(adopt, "SEEDS", {"ideal": (0,)})
    with pytest.warns(UserWarning, match="No weights of lpv-mpc were tuned"):
        told = adopt._drive(adopt.Options(jobs=1), out)
    (run,) = told["runs"]["ideal"]
    assert run["completed"] and run["lateral_rmse_m"] < 0.002
    missed, rows = adopt._driven(told["runs"])
    assert missed == [] and rows[0][:2] == ["ideal", "1 of 1"]
    assert len(list((out / "runs").glob("*.json"))) == 1  # kept, for --resume
