"""What the product promises: the bars of the closed loop on the real plant, road by road.

The promises about the car alone (static loads, rest, slope, straight line, mirror, grip limit,
handling) are in test_plant.py and test_vehicle.py. Bounds on errors are at most twice what was
measured when they were set, after the results had been seen: they keep what was reached.
"""

import os
import subprocess
import sys
from functools import cache

import pytest
from references import ay_peak

from lpvmpc import LPVMPC, Plant, load_controller, load_scenario, simulate
from lpvmpc.paper import steering_at_rest
from lpvmpc.sim.metrics import metrics

DRIVE_AND_WRITE = """
import sys
from lpvmpc import Plant, load_controller, load_scenario, simulate
simulate(Plant(), load_controller("lpv-mpc"), load_scenario("paper"), seed=3).write(sys.argv[1])
"""


@cache
def drive(name, grip=None, controller="lpv-mpc", seed=0):
    """Log of one road, driven once per process whatever asks for it."""
    scenario = load_scenario(name, grip=grip)
    return simulate(Plant(), load_controller(controller), scenario, seed=seed)


def test_the_papers_road_is_driven_within_two_millimetres_under_full_wind():
    log = drive("paper")
    result = metrics(log)
    assert log.scenario.wind.speed(log.columns["t_s"], log.columns["s_m"]).max() > 50.0
    assert result["completed"]
    assert result["qp"]["fallback"] == 0
    # 0.02 % measured, less than a control period.
    assert result["duration_s"] == pytest.approx(result["reference_duration_s"], rel=0.0004)
    # 0.165 and 0.77 mm measured.
    assert result["lateral_rmse_m"] <= 0.00033
    assert result["lateral_max_m"] <= 0.0015
    # Course, not heading: the crab angle in the wind is physics. 0.094 mrad measured.
    assert result["course_rmse_rad"] <= 0.00018
    # 0.0086 m/s measured; what is left is the kinks of the reference every 40 m.
    assert result["speed_rmse_mps"] <= 0.017


def test_the_papers_formulation_drives_its_road_less_exactly():
    """The matrices corrected, but no observer, no lags, no feed-forward: what those buy."""
    plain = metrics(drive("paper", controller="lpv-mpc-paper"))
    assert plain["completed"]
    # 23 mm measured.
    assert plain["lateral_max_m"] < 0.046
    # The wind alone leaves a centimetre without an observer, and nothing with it: 75 times.
    assert plain["lateral_rmse_m"] > 38.0 * metrics(drive("paper"))["lateral_rmse_m"]


@pytest.mark.parametrize(
    ("name", "grip", "rmse_mm", "largest_mm"),
    [  # 0.42 and 1.7 mm measured, 0.53 / 2.4, 0.36 / 1.04, 0.50 / 0.79, 0.31 / 1.26, 0.25 / 1.17
        ("paper-loop", None, 0.83, 3.3),
        ("double-lane-change", None, 1.05, 4.8),
        ("slalom", None, 0.71, 2.0),
        ("skidpad", None, 0.99, 1.5),
        ("circuit", 0.65, 0.61, 2.5),
        # 3 s on its own and easier than 0.65; the slow run completes the list of promises
        pytest.param("circuit", 0.5, 0.49, 2.3, marks=pytest.mark.slow),
    ],
)
def test_every_road_is_driven_as_planned(name, grip, rmse_mm, largest_mm):
    log = drive(name, grip)
    result = metrics(log)
    assert result["completed"]
    assert result["qp"]["fallback"] == 0
    # Slower than this would make the lateral bars easy: 0.16 % at most measured.
    assert result["duration_s"] == pytest.approx(result["reference_duration_s"], rel=0.003)
    # So would cutting the tightest bend's curvature or speed; overshoot is not bounded here.
    assert result["lateral_acc_max_mps2"] >= 0.95 * ay_peak(log.scenario)
    # Stiffness is wrong where the tires bend; with feedback over 33 ms periods that leaves
    # millimetres where the curvature changes.
    assert 1e3 * result["lateral_rmse_m"] <= rmse_mm
    assert 1e3 * result["lateral_max_m"] <= largest_mm


@pytest.mark.parametrize("turning", [False, True], ids=["straight", "circle"])
@pytest.mark.parametrize("vx", steering_at_rest.SPEEDS)
def test_the_steering_comes_to_rest_at_every_speed(plant, vx, turning):
    """No limit cycle: a gust pushes the car off the line, then nothing is left to correct."""
    log = simulate(plant, LPVMPC(plant.params), steering_at_rest.scenario(vx, turning))
    result = steering_at_rest.of(log, vx, turning)
    assert result.ok, result


def test_the_same_seed_gives_the_same_bytes_in_another_process(tmp_path):
    """Nothing of this process (order of hashes, addresses, earlier runs) reaches the trace."""
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    drive("paper", seed=3).write(here)
    subprocess.run(
        [sys.executable, "-c", DRIVE_AND_WRITE, str(there)],
        check=True,
        env={**os.environ, "PYTHONHASHSEED": "7"},
        timeout=120,
    )
    assert (here / "trace.parquet").read_bytes() == (there / "trace.parquet").read_bytes()
