"""Hard weights where measurements are quiet, soft ones where they are noisy."""

import numpy as np
import pytest

from lpvmpc import Plant, load_controller, load_scenario, simulate
from lpvmpc.car.bicycle import EPSI, EY
from lpvmpc.sim.metrics import metrics


def horizon(world="ideal", delay=0):
    """Where the controller stands after a lane change."""
    controller = load_controller("lpv-mpc", delay=delay)
    simulate(Plant(), controller, load_scenario("double-lane-change"), world=world, delay=delay)
    return controller.horizon, controller.weights


@pytest.mark.parametrize(("world", "share"), [("ideal", 1.0), ("rtk", 0.0)])
def test_the_weights_follow_the_noise_of_the_world(world, share):
    h, weights = horizon(world)
    assert h.quiet == pytest.approx([share, share], abs=0.03)
    factor = 1.0 + (weights.calm - 1.0) * h.quiet[1]
    np.testing.assert_allclose(h.q[:, [EY, EPSI]], factor * h.q_noisy[:, [EY, EPSI]])
    others = [i for i in range(h.q.shape[1]) if i not in (EY, EPSI)]
    np.testing.assert_array_equal(h.q[:, others], h.q_noisy[:, others])


def test_a_command_that_comes_late_is_no_hard_one():
    h, _ = horizon(delay=3)
    # at the end of the lane change the car runs nearly straight
    assert h.quiet[1] == pytest.approx(h.quiet[0] / 4.0, rel=0.01)


@pytest.mark.parametrize("delay", [0, 2])
def test_a_prediction_begins_at_the_car_however_far_the_controller_looks(delay):
    controller = load_controller("lpv-mpc", delay=delay)
    log = simulate(Plant(), controller, load_scenario("double-lane-change"), delay=delay)
    c = log.columns
    ahead = np.hypot(c["pred_x_m_0"] - c["x_m"], c["pred_y_m_0"] - c["y_m"])[5:]
    np.testing.assert_allclose(ahead, delay * 0.033 * c["vx_mps"][5:], atol=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("grip", [0.92, 0.96])
def test_a_told_delay_of_six_periods_holds_where_the_tires_bend(grip):
    scenario = load_scenario("circuit", grip=grip)
    log = simulate(Plant(), load_controller("lpv-mpc", delay=6), scenario, delay=6)
    result = metrics(log)
    assert result["completed"]
    assert result["lateral_rmse_m"] < 0.015 and result["lateral_max_m"] < 0.07
