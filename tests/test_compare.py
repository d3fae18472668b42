"""The script that lays controllers side by side; its pictures are tested in test_comparison.py."""

import json
from pathlib import Path

import numpy as np
import pytest

COMMAND = "compare"


@pytest.fixture
def road(tmp_path):
    """A gentle bend of 60 m at 10 m/s."""
    s = np.linspace(0.0, 60.0, 31)
    rows = np.stack([s, 0.002 * s**2, np.full(31, 10.0)], axis=1)
    file = tmp_path / "bend.csv"
    np.savetxt(file, rows, delimiter=",", header="x_m,y_m,vx_mps")
    return file


def test_two_controllers_are_driven_and_laid_side_by_side(run, road, monkeypatch):
    from lpvmpc.picture import comparison

    monkeypatch.setattr(comparison, "DPI", 30)
    code, out, err = run("--controllers", "stanley", "pure-pursuit", "--scenario", road,
                         "--json", "all.json")
    assert code == 0 and err == ""
    assert "stanley" in out and "RMSE / largest" in out and "[mm]" in out
    result = json.loads(Path("all.json").read_text())
    assert list(result["runs"]) == ["stanley", "pure-pursuit"]
    assert all(each["completed"] for each in result["runs"].values())
    assert set(result["record"]["weights"]["stanley"]) >= {"k_e", "kp"}
    folder = Path("runs/bend-stanley-vs-pure-pursuit")
    names = {"comparison.md", "comparison.json", "errors.png", "signals.png", "path.png"}
    assert {file.name for file in folder.iterdir()} == names


def test_a_picture_that_fails_does_not_cost_the_runs(run, road, monkeypatch):
    from lpvmpc.picture import comparison

    monkeypatch.setattr(comparison, "save_all", lambda runs, folder: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("--controllers", "stanley", "pure-pursuit", "--scenario", road)
    stored = Path("runs/bend-stanley-vs-pure-pursuit/comparison.json")
    assert len(json.loads(stored.read_text())["runs"]) == 2


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--controllers", "stanley"], "--controllers needs 2 to 6 names, but got 1"),
        (["--render", "--controllers", *"abcde"], "2 to 4 names with --render, but got 5"),
        (["--controllers", "stanley", "stanley"], "--controllers is 'stanley', but must be given"),
        (["--controllers", "stanley", "mpc"], "Unknown controller 'mpc'; the choices are"),
        (["--controllers", "stanley", "lpv-mpc/soft"], "Unknown stiffness model 'soft'"),
        (["--controllers", "stanley/oracle", "pure-pursuit"], "left out for stanley"),
        (["--scenario", "papers"], "Unknown scenario 'papers'"),
        (["--delay", "31"], "--delay is 31, but must be from 0 to 30 periods"),
        (["--seed", "-1"], "--seed is -1"),
    ],
)
def test_bad_options_are_one_sentence(run, arguments, sentence, tmp_path):
    code, out, err = run(*arguments)
    assert code == 2 and out == ""
    assert sentence in err
    assert err.startswith("Error: ") and err.count("\n") == 1
    assert not list(tmp_path.iterdir())  # nothing was begun
