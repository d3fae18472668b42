"""The rival `lqr`: its plan against the quadratic program's, and short closed loops."""

import math

import numpy as np
import pytest

from lpvmpc.control.cost import SHARED_RANGES
from lpvmpc.control.rivals.lqr import PREVIEW, LQRWeights, regulate
from lpvmpc.interface import State
from lpvmpc.plant.plant import Plant
from lpvmpc.road.path import Path as Road
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import load_controller, load_scenario


def driven(controller, kappa=0.012, vx=14.0, steps=6):
    """After some periods beside a bend that begins, with what they ask for ignored."""
    road = Road.from_curvature([0.0, 0.0, kappa, kappa, 0.3 * kappa], 400.0)
    controller.reset(np.random.default_rng(0))
    for n in range(steps):
        s = 60.0 + vx * 0.033 * n
        x, y, psi, now = (float(value) for value in road.at(s))
        x, y = x - 0.03 * math.sin(psi), y + 0.03 * math.cos(psi)
        spin = np.full(4, vx / controller.car.R_w)
        state = State(x, y, psi + 0.004, vx, 0.01, vx * now, 0.01, 0.1, vx * vx * now, spin)
        speed = np.linspace(vx + 0.2, vx + 0.6, 800)
        preview = road.preview(x, y, psi, s, speed, 0.5, controller.preview_steps, 0.033)
        controller.command(state, preview)
    controller.estimate(state, preview)
    controller.write_qp(state, preview)
    return controller.horizon


@pytest.mark.parametrize("weights", [{}, {"q_vx": 80.0, "r_delta": 0.05, "q_r": 1.0, "q_vy": 4.0}])
def test_within_its_bounds_the_plan_is_the_quadratic_programs_without_constraints(weights):
    h = driven(load_controller("lqr", stiffness="constant", weights=weights))
    z = np.zeros(len(h.g))
    regulate(h.handle, z)
    free = slice(0, 2 * PREVIEW)
    best = np.linalg.solve(h.H[free, free], -h.g[free])
    u = best.reshape(PREVIEW, 2) * h.scale
    assert (u > h.u_lo).all() and (u < h.u_hi).all()  # no bound is active
    assert np.abs(np.diff(u[:, 0])).max() < h.du_max[0]
    np.testing.assert_allclose(z[free], best, atol=1e-6)
    assert np.ptp(u[:, 0]) > 1e-3  # and it does something


def test_what_it_asks_for_stays_within_the_bounds():
    h = driven(load_controller("lqr", weights={"slip_cap": 0.02}), kappa=0.03)
    h.schedule[0, 3] = 2.0
    z = np.zeros(len(h.g))
    regulate(h.handle, z)
    u = z[: 2 * PREVIEW].reshape(PREVIEW, 2) * h.scale
    assert (u >= h.u_lo - 1e-12).all() and (u <= h.u_hi + 1e-12).all()
    assert (np.isclose(u[:, 0], h.u_lo[:, 0]) | np.isclose(u[:, 0], h.u_hi[:, 0])).any()
    steps = np.abs(np.diff(np.concatenate([h.queue[-1:, 0], u[:, 0]])))
    assert steps.max() <= h.du_max[0] + 1e-12


def test_it_has_the_weights_of_lpv_mpc_without_the_terminal_one():
    assert set(SHARED_RANGES) - set(LQRWeights.RANGES) == {"terminal"}
    assert load_controller("lqr", weights={"q_ey": 7.0}).weights == LQRWeights(q_ey=7.0)


@pytest.mark.parametrize(("delay", "most"), [(0, 0.008), (6, 0.04)])
def test_it_drives_a_lane_change(delay, most):
    log = simulate(Plant(), load_controller("lqr", delay=delay),
                   load_scenario("double-lane-change"), delay=delay)
    result = metrics(log)
    assert result["completed"] and result["lateral_max_m"] < most


def test_it_comes_back_to_its_line_starts_and_stops(tmp_path):
    file = tmp_path / "straight.csv"
    speeds = [0.0] + [10.0] * 18 + [0.0]
    rows = "".join(f"{5.0 * k:g},0,5,5,{speed:g}\n" for k, speed in enumerate(speeds))
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n" + rows)
    log = simulate(Plant(), load_controller("lqr"), load_scenario(file), start_offset=(1.0, 0.0))
    ey = log.columns["ey_m"]
    assert metrics(log)["completed"] and ey.min() > -0.1 and abs(ey[-1]) < 0.02
