"""What the product promises: the bars of the closed loop on the real plant, road by road.

The promises about the car alone (static loads, rest, slope, straight line, mirror, grip limit,
handling) are in test_plant.py and test_vehicle.py.
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


def test_the_papers_road_is_driven_within_millimetres_under_full_wind():
    log = drive("paper")
    result = metrics(log)
    assert log.scenario.wind.speed(log.columns["t_s"], log.columns["s_m"]).max() > 50.0
    assert result["completed"]
    assert result["qp"]["fallback"] == 0
    # A run that tracks the speed to 0.02 m/s at 15 m/s cannot be off by more than 0.2 %.
    assert result["duration_s"] == pytest.approx(result["reference_duration_s"], rel=0.01)
    # The paper's own figures are 21.7 and 80 mm: a twentieth of them is what observer, lag states
    # and steady-state reference bought in every prototype. 0.4 and 1.8 mm measured.
    assert result["lateral_rmse_m"] <= 0.001
    assert result["lateral_max_m"] <= 0.005
    # Course, not heading: the crab angle in the wind is physics. 1 mm of lateral error swings with
    # the wind within some metres, so 0.1 mrad is measured; the bar leaves room for other wind.
    assert result["course_rmse_rad"] <= 0.002
    # A fifth of the paper's 0.101 m/s; what is left is the kinks of the reference every 40 m.
    assert result["speed_rmse_mps"] <= 0.02


def test_the_papers_formulation_drives_its_road_less_exactly():
    """The matrices corrected, but no observer, no lags, no feed-forward: what those buy."""
    plain = metrics(drive("paper", controller="lpv-mpc-paper"))
    assert plain["completed"]
    # The paper's own bound on the lateral error; 26 mm measured.
    assert plain["lateral_max_m"] < 0.3
    # The wind alone leaves a centimetre without an observer, and nothing with it: 13 mm measured.
    assert plain["lateral_rmse_m"] > 5.0 * metrics(drive("paper"))["lateral_rmse_m"]


@pytest.mark.parametrize(
    ("name", "grip"),
    [
        ("paper-loop", None),
        ("double-lane-change", None),
        ("slalom", None),
        ("skidpad", None),
        ("circuit", 0.65),
        # 3 s on its own and easier than 0.65; the slow run completes the list of promises
        pytest.param("circuit", 0.5, marks=pytest.mark.slow),
    ],
)
def test_every_road_is_driven_as_planned(name, grip):
    log = drive(name, grip)
    result = metrics(log)
    assert result["completed"]
    assert result["qp"]["fallback"] == 0
    # Slower than this would make the lateral bars easy.
    assert result["duration_s"] == pytest.approx(result["reference_duration_s"], rel=0.02)
    # So would cutting the tightest bend's curvature or speed; overshoot is not bounded here.
    assert result["lateral_acc_max_mps2"] >= 0.95 * ay_peak(log.scenario)
    # Constant stiffness is 10 to 20 % wrong at 5 m/s2, where the tires bend; with feedback over
    # 33 ms periods that leaves millimetres where the curvature changes (1.9 and 7.1 mm, lane
    # change). The largest error allowed is a fifteenth of the 0.3 m that the paper allows.
    assert result["lateral_rmse_m"] <= 0.003
    assert result["lateral_max_m"] <= 0.020


@pytest.mark.parametrize("turning", [False, True], ids=["straight", "circle"])
@pytest.mark.parametrize("vx", steering_at_rest.SPEEDS)
def test_the_steering_comes_to_rest_at_every_speed(plant, vx, turning):
    """No limit cycle: a gust pushes the car off the line, then nothing is left to correct."""
    # What is left 4 s after the gust was 1e-5 rad: the slowest mode decays with half a second.
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
