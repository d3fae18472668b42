"""The rival `mppi`: its model, its draws, and a closed loop."""

import numpy as np
import pytest

from lpvmpc.car.bicycle import AF, AR, DELTA, EPSI, EY, NX, VX, VY, R, unpack
from lpvmpc.control.cost import NZ
from lpvmpc.control.rivals.mppi import PERIODS, SAMPLES, cost_of, improve, step, within
from lpvmpc.interface import State
from lpvmpc.plant.plant import Plant
from lpvmpc.road.path import Path as Road
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import load_controller, load_scenario

LATERAL = [VY, R, EY, EPSI, DELTA, AF, AR]


@pytest.fixture(scope="module")
def controller():
    return load_controller("mppi", stiffness="constant")


def commands(controller, seed, periods=3):
    """What it asks for beside a bend, whatever comes of it; shape (periods, 2)."""
    road, vx, kappa = Road.from_curvature([0.012, 0.012], 400.0), 14.0, 0.012
    controller.reset(np.random.default_rng(seed))
    found = []
    for n in range(periods):
        s = 60.0 + vx * 0.033 * n
        x, y, psi, _ = (float(value) for value in road.at(s))
        spin = np.full(4, vx / controller.car.R_w)
        state = State(x, y, psi + 0.004, vx, 0.01, vx * kappa, 0.02, 0.1, vx * vx * kappa, spin)
        preview = road.preview(
            x, y, psi, s, np.full(800, vx), 0.5, controller.preview_steps, 0.033
        )
        found.append(controller.command(state, preview))
    return np.array(found)


def test_the_seed_decides_its_commands(controller):
    first, again = commands(controller, 3), commands(controller, 3)
    assert first.tobytes() == again.tobytes()
    assert commands(controller, 4).tobytes() != first.tobytes()


def run_step(h, car, x, u, kappa, dt, count, mirror=1.0):
    """States after some steps of the model, mirrored or not."""
    x = x.copy()
    x[LATERAL] *= mirror
    tires = np.array([car.Cf, 0.0, car.Cr, 0.0])
    shares = -np.expm1(-dt / car.tau_delta), -np.expm1(-dt / car.tau_ax)
    for _ in range(count):
        step(x, np.array([mirror * u[0], u[1]]), mirror * kappa, tires, np.array([6e3, 6e3]),
             np.zeros(3), unpack(h.car), *shares, dt)
    x[LATERAL] *= mirror
    return x


def test_its_model_is_mirrored_and_its_steps_are_fine_enough(controller):
    h, car = controller.horizon, controller.car
    x, u = np.zeros(NX), np.array([0.05, 0.5])
    x[VX], x[DELTA], x[EPSI] = 14.0, 0.02, 0.01
    left = run_step(h, car, x, u, 0.01, 0.011, 45)
    np.testing.assert_allclose(run_step(h, car, x, u, 0.01, 0.011, 45, -1.0), left, atol=1e-12)
    assert left[R] > 0.1 and left[EY] > 0.1  # it has turned
    fine, half = (run_step(h, car, x, u, 0.01, 0.011 / n, 45 * n) for n in (64, 2))
    error = abs(left[EY] - fine[EY])
    # three steps in a period are Euler's: 15 mm after half a second, half of it with half steps
    assert error < 0.015 and abs(half[EY] - fine[EY]) == pytest.approx(0.5 * error, rel=0.1)


def test_the_mean_of_the_drawn_plans_costs_less_and_keeps_the_bounds(controller):
    commands(controller, 0)
    h, car = controller.horizon, unpack(controller.horizon.car)
    kappa, most = np.full(PERIODS + 1, 0.012), np.array([6e3, 6e3])
    x, z, costs = np.empty(NX), np.empty(NZ), np.empty(SAMPLES)
    plan = np.zeros((PERIODS, 2))
    within(h.handle, plan)
    before = cost_of(h.handle, plan, kappa, most, car, x, z)
    noise = 0.004 * np.random.default_rng(0).standard_normal((SAMPLES, PERIODS, 2))
    improve(h.handle, plan, noise, kappa, most, 0.05, costs)
    assert cost_of(h.handle, plan, kappa, most, car, x, z) < 0.9 * before
    kept = plan.copy()
    within(h.handle, kept)
    np.testing.assert_allclose(kept, plan, atol=1e-12)


def test_it_drives_a_straight_road_in_a_side_wind(tmp_path):
    rows = "".join(f"{x},0,3,3,12,{4 if x > 10 else 0}\n" for x in range(0, 32, 2))
    file = tmp_path / "road.csv"
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps,wind_mps\n" + rows)
    result = metrics(simulate(Plant(), load_controller("mppi"), load_scenario(file)))
    assert result["completed"] and result["lateral_max_m"] < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("world", ["rtk", "fleet"])
def test_it_completes_the_papers_road_within_its_period(world):
    log = simulate(Plant(), load_controller("mppi"), load_scenario("paper"), world=world, seed=1)
    result = metrics(log)
    assert result["completed"] and result["step_time_us"]["p99"] < 33_000
