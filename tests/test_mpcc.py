"""The rival `mpcc`: the point on the path, its Jacobian, and short drives."""

import numpy as np
import pytest

pytest.importorskip("casadi", reason="the extra `nmpc` is not installed")

from lpvmpc.car.axle import axles
from lpvmpc.car.bicycle import EPSI, EY, NX, Bicycle
from lpvmpc.control.rivals import mpcc, nmpc_model
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import _tires, load_controller, load_scenario

TS = 0.033
LEARNED, DISTURBANCE = np.array([0.9, 1.1, 0.95]), np.array([0.1, 0.2, 0.3])
PATH = np.array([[0.0, 1.0, 2.5], [0.1, 0.13, 0.25], [0.02, 0.04, 0.12], [20.0, 21.0, 20.0]])
CIRCLE = np.array([[0.0, 100.0], [0.0, 5.0], [0.05, 0.05], [15.0, 15.0]])


@pytest.fixture(scope="module")
def model():
    car = packaged_car()
    front, rear = axles(car, *_tires())
    return nmpc_model.Model(Bicycle.of(car), front, rear, 0, car.Cf, car.Cr, car.vx_min)


def test_a_car_that_stays_where_it_is_is_told_in_the_frame_of_the_moved_point():
    """On a circle of 20 m the point moves by a quarter; where the car is then is geometry."""
    out, G = np.empty(5), np.empty((5, 5))
    R, v = 20.0, 12.0
    mpcc.place(0.0, 0.4, 0.1, 3.0, v, CIRCLE, TS, out, G)
    turn = v * TS / R
    x, y = -R * np.sin(turn), 0.4 - R * (1.0 - np.cos(turn))
    assert out[2] == pytest.approx(x * np.cos(turn) + y * np.sin(turn), abs=1e-8)
    assert out[0] == pytest.approx(y * np.cos(turn) - x * np.sin(turn), abs=1e-8)
    assert out[[1, 3, 4]] == pytest.approx([0.1 - turn, v - 15.0, 3.0 + v * TS])


@pytest.mark.parametrize("s", [0.2, 0.9, 1.6])
def test_the_jacobian_is_that_of_the_step(model, s):
    z = np.array([20.0, 0.3, 0.2, 0.05, 0.02, 0.05, 1.0, 0.03, 0.02, 0.03, 0.01, 0.15, 0.4, s])
    v = np.array([0.06, -2.0, 19.0])
    rest = (PATH, model, LEARNED, DISTURBANCE, TS)
    out, J = np.empty(mpcc.NZ), np.empty((mpcc.NZ, mpcc.NZ + mpcc.NV))
    mpcc.jacobian(z, v, *rest, out, J)
    moved, G, after = np.empty(NX), np.empty((5, 5)), np.empty((2, mpcc.NZ))
    for i in range(mpcc.NZ + mpcc.NV):
        for k, sign in enumerate((-1.0, 1.0)):
            there = np.append(z, v)
            there[i] += sign * 1e-6
            mpcc.step(there[: mpcc.NZ], there[mpcc.NZ :], *rest, moved, after[k], G)
        difference = (after[1] - after[0]) / 2e-6
        # where the path's rows meet, place and heading are smooth and the curvature's slope is not
        np.testing.assert_allclose(J[:, i], difference, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("delay", [0, 2])
def test_it_follows_a_lane_change_also_with_a_told_delay(delay):
    log = simulate(
        Plant(), load_controller("mpcc", delay=delay), load_scenario("double-lane-change"),
        delay=delay,
    )
    result = metrics(log)
    assert result["completed"] and result["lateral_max_m"] < (0.0024, 0.008)[delay > 0]
    assert np.abs(log.columns["ey_m"]).max() == pytest.approx(result["lateral_max_m"])


def test_its_weights_lie_where_tuning_searches():
    weights = mpcc.MPCC.by_hand
    assert all(low <= getattr(weights, name) <= high
               for name, (low, high) in weights.RANGES.items())
    controller = load_controller("mpcc", weights={"q_lag": 300.0})
    np.testing.assert_allclose(controller._q[mpcc.LAG] / controller._q[EY], 300.0 / weights.q_ey)
    assert controller._q[EPSI] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "options", "world", "rmse", "largest"),
    [("paper", {}, "rtk", 0.006, 0.03), ("circuit", {"grip": 0.65}, "ideal", 0.0006, 0.002),
     ("circuit", {"grip": 0.87}, "ideal", 0.0008, 0.003)],
)
def test_it_drives(scenario, options, world, rmse, largest):
    log = simulate(
        Plant(), load_controller("mpcc"), load_scenario(scenario, **options), world=world, seed=3000
    )
    result = metrics(log)
    assert result["completed"]
    assert result["lateral_rmse_m"] < rmse and result["lateral_max_m"] < largest
