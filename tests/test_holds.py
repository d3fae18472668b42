"""What the controller must hold outside the perfect world, on short roads; reports have the rest.

Bounds are at most twice what was measured when they were set, after the results had been seen, and
never above what was promised; where nothing but rounding was measured they are 1e-9.
"""

import numpy as np
import pytest

from lpvmpc.plant.deviations import Deviations
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import load_controller, load_scenario

RETURN = ("lpv-mpc", "lpv-mpc-protected", "lmpc-pso-pid", "stanley", "pure-pursuit")
"""Who comes back to the line; the paper's plain forms do not."""
OVERSHOOT = dict(zip(RETURN, (0.032, 0.38, 0.1, 0.49, 0.47), strict=True))
"""How far across it, as a share of the start beside it."""
LEFT = dict(zip(RETURN, (4e-6, 0.012, 3.4e-9, 6e-5, 1e-9), strict=True))
"""What is left of it at the end [m]."""


def straight(folder, speeds):
    """A straight road of 5 m between points, one per speed [m/s]."""
    rows = "".join(f"{5.0 * k:g},0,5,5,{speed:g}\n" for k, speed in enumerate(speeds))
    file = folder / "straight.csv"
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n" + rows)
    return load_scenario(file)


def drive(scenario, *, controller="lpv-mpc", options=None, **more):
    log = simulate(Plant(), load_controller(controller, **(options or {})), scenario, **more)
    return log, metrics(log)


@pytest.mark.filterwarnings("ignore:.*asks for")
@pytest.mark.parametrize(
    "speeds",
    [
        [8.0] * 20 + [36.0] * 40,  # more than the motor gives
        [25.0] * 30 + [1.2] * 8,  # more than the brakes give
        [0.0] + [10.0] * 30 + [0.0],  # from rest to a stop
    ],
)
def test_speed_errors_never_steer(tmp_path, speeds):
    log, result = drive(straight(tmp_path, speeds))
    assert result["completed"] and result["qp"]["fallback"] == 0
    assert result["lateral_max_m"] < 1e-9
    assert np.abs(log.columns["delta_cmd_rad"]).max() < 1e-9


@pytest.mark.parametrize(("vx", "aside", "length"), [(30.0, 1.0, 450), (10.0, 0.3, 150),
                                                     (5.0, -1.0, 100)])  # fmt: skip
@pytest.mark.parametrize("controller", RETURN)
def test_a_car_beside_its_line_comes_back_with_little_overshoot(
    tmp_path, controller, vx, aside, length
):
    scenario = straight(tmp_path, [vx] * (length // 5))
    log, result = drive(scenario, controller=controller, start_offset=(aside, 0.0))
    ey = log.columns["ey_m"] * np.sign(aside)
    assert result["completed"] and ey.min() > -OVERSHOOT[controller] * abs(aside)
    assert abs(ey[-1]) < LEFT[controller]


@pytest.mark.filterwarnings("ignore:.*asks for")
@pytest.mark.parametrize("controller", RETURN[1:])
@pytest.mark.parametrize("speeds", [[25.0] * 30 + [1.2] * 8, [0.0] + [10.0] * 20 + [0.0]])
def test_baselines_brake_to_a_walk_start_and_stop(tmp_path, controller, speeds):
    _, result = drive(straight(tmp_path, speeds), controller=controller)
    assert result["completed"] and result["lateral_max_m"] < 1e-9
    assert result["qp"] is None or result["qp"]["fallback"] == 0


def test_a_car_that_walks_is_led_back_too(tmp_path):
    """At 2 m/s Euler's rule is unstable: it lost the car from 1 m."""
    log, result = drive(straight(tmp_path, [2.0] * 12), controller="lmpc-pso-pid",
                        start_offset=(1.0, 0.0))
    assert result["completed"] and result["qp"]["fallback"] == 0
    assert log.columns["ey_m"].min() > 0.0 and abs(log.columns["ey_m"][-1]) < 2e-6


@pytest.mark.parametrize(("controller", "speed"), [
    *zip(RETURN[1:], (0.005, 0.147, 0.189, 0.047), strict=True)])
def test_a_known_delay_costs_the_baselines_little(controller, speed):
    """Six periods, 0.2 s: without compensation each of them leaves this road."""
    scenario = load_scenario("slalom")
    _, prompt = drive(scenario, controller=controller)
    _, late = drive(scenario, controller=controller, delay=6, options={"delay": 6})
    assert late["completed"]
    assert late["lateral_max_m"] < 2.0 * prompt["lateral_max_m"] + 0.05
    assert late["speed_rmse_mps"] < speed  # twice what was measured


@pytest.mark.parametrize(
    "deviations",
    [{"Cf": 0.7}, {"Cr": 0.7}, {"steer_lag": 3.0}, {"steer_offset": 0.0087}, {"steer_ratio": 0.95},
     {"drive_lag": 4.0}],
)  # fmt: skip
def test_each_deviation_alone_is_held(deviations):
    """The lane change, which is harder on the steering than the roads of the reports."""
    scenario = load_scenario("double-lane-change")
    _, result = drive(scenario, deviations=Deviations(**deviations))
    assert result["completed"] and result["lateral_max_m"] < 0.0048  # 2.4 to 2.8 mm


@pytest.mark.parametrize("latency", [0.020, 0.040])
def test_an_unknown_latency_is_found(latency):
    _, result = drive(load_scenario("slalom"), latency=latency)
    assert result["completed"] and result["lateral_max_m"] < 0.0012  # 0.6 and 1.03 mm


def test_a_known_delay_of_six_periods_is_compensated():
    _, result = drive(load_scenario("slalom"), delay=6, options={"delay": 6})
    assert result["completed"] and result["lateral_max_m"] < 0.0089


def test_a_good_gnss_is_enough():
    _, result = drive(load_scenario("slalom"), world="rtk", seed=3)
    assert result["completed"] and result["lateral_max_m"] < 0.022
    assert result["steer_rate_rms_radps"] < 0.29
