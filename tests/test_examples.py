"""Every example runs as it is, and says what its README says it shows."""

import re
import runpy
from pathlib import Path

import pytest

from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate

FOLDER = Path(__file__).parents[1] / "examples"
SAYS = {
    "change_a_weight": r"q_ey .*\n(.* mm .* rad/s\n){3}",
    "compare_two": r"double-lane-change, 186 m +lpv-mpc +stanley\n",
    "gym_random": r"^(random-[12]: +-?\d+\.\d m, reward +-?\d+\.\d, (not )?lost\n){3}$",
    "mine": r"^$",  # a class alone, to be named on a command line
    "own_controller": r"^lateral error: RMSE \d+ mm, largest \d+ mm\n$",
    "own_world": r"^seed .*error\n( +\d +0\.\d\d +\d+ kg +\d+ ms +\d+\.\d mm\n){3}$",
    "own_track": r"completed: True, largest lateral error 0\.\d mm",
    "read_trace": r"849 control periods, .* columns:\n",
    "record_and_replay": r"^the car itself .* 0\.00\d\d rad/s .*\nsofter in front .* 0\.0[1-9]",
    "wind_batch": r"\nlpv-mpc +0\.0( +\d+\.\d){3}\nstanley +0\.0( +\d+\.\d){3}\n",
}
"""What each must print."""
SHORT = ("mine", "own_controller")
"""Those whose scripts run here by default; the others' code does in their notebooks."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(file.stem, marks=() if file.stem in SHORT else pytest.mark.slow)
     for file in sorted(FOLDER.glob("*.py"))],
)
def test_an_example_runs(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(FOLDER / f"{name}.py"), run_name="__main__")
    out, err = capsys.readouterr()
    assert err == "" and re.search(SAYS[name], out), out


def test_mine_drives_the_lane_change(monkeypatch):
    monkeypatch.chdir(FOLDER)
    controller = load_controller("mine:Mine")
    result = metrics(simulate(Plant(), controller, load_scenario("double-lane-change")))
    assert result["completed"] and result["lateral_max_m"] < 0.5  # half the room beside the car


def test_the_readme_lists_them_all_and_each_is_short():
    listed = re.findall(r"^\| \[(\w+)\.py\]", (FOLDER / "README.md").read_text(), re.M)
    assert sorted(listed) == sorted(file.stem for file in FOLDER.glob("*.py"))
    for file in FOLDER.glob("*.py"):
        assert len(file.read_text().splitlines()) < 60, file.name
