"""Every QP of the controllers has a solution and gets it, wherever the car is."""

import numpy as np
import pytest

from lpvmpc.car.bicycle import unpack
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.period import bounds
from lpvmpc.interface import Preview, State
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.sim.names import load_controller

N_SHORT, N_LONG = 2_000, 100_000


def counts(short, long):
    """A short form for every day, and the long one."""
    return [short, pytest.param(long, marks=pytest.mark.slow)]


def anywhere(rng, steps):
    """A state and a preview that a car may be in: at walking pace, sliding, spinning, far away."""
    vx = float(rng.choice([rng.uniform(0.0, 3.0), rng.uniform(0.0, 50.0)]))
    state = State(
        0.0, 0.0, rng.uniform(-np.pi, np.pi), vx, rng.normal(0.0, 0.3 * vx + 0.1),
        rng.normal(0.0, 0.8), rng.uniform(-0.55, 0.55), rng.uniform(-9.0, 4.0),
        rng.uniform(-9.0, 9.0), vx / 0.3 * rng.choice([0.0, 0.5, 1.0, 1.0, 1.5], 4),
    )
    n = steps + 1
    bend, pace = rng.normal(0.0, 0.05), rng.uniform(0.0, 45.0)
    kappa = np.clip(bend + 0.3 * bend * np.sin(rng.uniform(0.0, 1.0) * np.arange(n)), -0.2, 0.2)
    speed = np.abs(pace + rng.normal(0.0, 5.0) * np.linspace(0.0, 1.0, n))
    flat = np.zeros(n)
    preview = Preview(
        rng.normal(0.0, 1.0), rng.normal(0.0, 1.5), rng.normal(0.0, 0.5), kappa, speed, flat, flat,
        flat,
    )
    return state, preview


@pytest.mark.parametrize("count", counts(N_SHORT, N_LONG))
def test_the_bounds_can_be_kept_from_any_state(count):
    """By intervals: from where the input is, at the rate it has, it can be inside at every step."""
    controller = LPVMPC(packaged_car())
    h, car, rng = controller.horizon, unpack(controller.horizon.car), np.random.default_rng(0)
    step = h.du_max[0]
    for _ in range(count):
        vx = rng.uniform(0.0, 3.0) if rng.random() < 0.5 else rng.uniform(0.0, 50.0)
        h.schedule[:, 0] = vx + rng.normal(0.0, 1.0, len(h.schedule)).cumsum()
        h.schedule[:, 1:3] = rng.normal(0.0, 2.0, (len(h.schedule), 2))
        h.queue[-1] = rng.uniform(-h.delta_max, h.delta_max), rng.uniform(-9.0, 4.0)
        bounds(h.handle, car, rng.uniform(0.01, 0.3), rng.uniform(0.0, 9e3), rng.uniform(0.0, 9.0))
        lowest = highest = h.queue[-1, 0]
        for k in range(len(h.u_lo)):
            lowest, highest = lowest - step, highest + step
            lowest, highest = max(lowest, h.u_lo[k, 0]), min(highest, h.u_hi[k, 0])
            assert lowest <= highest + 1e-12
            assert h.u_lo[k, 1] <= h.u_hi[k, 1]


@pytest.mark.parametrize("name", ["lpv-mpc", "lmpc-pso-pid"])
@pytest.mark.parametrize("count", counts(N_SHORT // 4, N_LONG // 3))
def test_every_qp_is_solved(name, count):
    """The paper's plain form is left out: its Euler model explodes at walking pace, and answers
    of 1e4 are refused."""
    controller, rng = load_controller(name), np.random.default_rng(1)
    for k in range(count):
        if k % 10 == 0:
            controller.reset(np.random.default_rng(0))
        command = controller.command(*anywhere(rng, controller.preview_steps))
        assert controller.diagnostics.solved, (k, controller.diagnostics.status)
        assert np.isfinite(command).all()
