"""The terminal weight: the cost-to-go of the unconstrained problem."""

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from lpvmpc.car.bicycle import CORRECTED, EPSI, EY, NU, NX, VX, Bicycle, lpv
from lpvmpc.car.hold import discretise
from lpvmpc.control.cost import NZ, SPEEDS, cost_to_go, kept_cost_to_go, terminal_weight
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.plant.mjcf import packaged_car

TS = 0.033
Q = np.array([1.0, 0.0, 0.0, 30.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
R = np.array([5.0, 0.05])


@pytest.fixture(scope="module")
def params():
    return packaged_car()


@pytest.mark.parametrize("parts", [{}, {"lags": False, "relaxation": False, "roll": False}])
def test_no_steering_law_costs_less_than_the_weight_says(params, parts):
    """Against the definition: the greedy law of P reaches P's cost, and others cost more."""
    car = Bicycle.of(params).simplified(**parts)
    tires = np.array([params.Cf, 0.0, params.Cr, 0.0])
    table = cost_to_go(car, tires, Q, R, TS)
    n = 8
    x = np.zeros(NX)
    x[VX] = SPEEDS[n]
    A, B, c = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    lpv(x, 0.0, tires, car, CORRECTED, A, B, c)
    Ad, Bd, _ = discretise(A, B, c, TS)
    if not car.tau_delta:  # states that copy their input
        Ad[[5, 6]], Bd[[5, 6]] = 0.0, np.eye(2)
    step = np.block([[Ad, Bd], [np.zeros((NU, NX)), np.eye(NU)]])
    push = np.vstack([Bd, np.eye(NU)])
    later = table[n] + np.diag(np.append(Q, np.zeros(NU)))
    gain = np.linalg.solve(np.diag(R) + push.T @ later @ push, push.T @ later @ step)
    start = np.zeros(NZ)
    start[EY], start[EPSI], start[VX] = 0.3, 0.05, 1.0

    def cost(K):
        z, total = start.copy(), 0.0
        for _ in range(3000):
            du = -K @ z
            z = step @ z + push @ du
            total += Q @ z[:NX] ** 2 + R @ du**2
        return total

    promised = start @ table[n] @ start
    assert cost(gain) == pytest.approx(promised, rel=1e-6)  # the tail after 99 s is nothing
    assert cost(1.2 * gain) > promised
    assert cost(0.8 * gain) > promised


def test_the_weight_is_symmetric_positive_and_smooth_over_speed(params):
    table = cost_to_go(Bicycle.of(params), np.array([params.Cf, 0.0, params.Cr, 0.0]), Q, R, TS)
    np.testing.assert_array_equal(table, table.transpose(0, 2, 1))
    for P in table:
        values = np.linalg.eigvalsh(P)
        assert values.min() > -1e-9 * values.max()
    assert (np.abs(np.diff(table[:, EPSI, EPSI])) < 0.6 * table[:-1, EPSI, EPSI]).all()


def test_the_weight_has_the_same_bytes_for_any_number_of_threads(params):
    """Workers of a batch are given fewer than a process alone; else their runs would differ."""
    arguments = Bicycle.of(params), np.array([params.Cf, 0.0, params.Cr, 0.0]), Q, R, TS
    found = set()
    for threads in (1, 2, 4):
        with threadpool_limits(threads, user_api="blas"):
            found.add(cost_to_go(*arguments).tobytes())
    assert len(found) == 1


def test_what_is_looked_up_is_what_was_solved_and_cannot_be_written_to(params):
    arguments = Bicycle.of(params), (params.Cf, 0.0, params.Cr, 0.0), tuple(Q), tuple(R), TS
    kept = kept_cost_to_go(*arguments)
    assert kept is kept_cost_to_go(*arguments)
    car, *vectors, Ts = arguments
    assert kept.tobytes() == cost_to_go(car, *map(np.array, vectors), Ts).tobytes()
    with pytest.raises(ValueError, match="read-only"):
        kept[0, 0, 0] = 1.0
    others = kept_cost_to_go(car, vectors[0], tuple(2.0 * Q), tuple(R), Ts)
    assert others.tobytes() != kept.tobytes()


@pytest.mark.parametrize("quiet", [0.0, 1.0])
@pytest.mark.parametrize(("steering", "drive"), [(1.0, 1.0), (2.0, 1.0), (1.0, 4.0), (3.0, 2.0)])
def test_each_lag_has_its_own_terminal_weight(params, steering, drive, quiet):
    """On a straight road steering and drive have no common state: their lags can be mixed."""
    controller = LPVMPC(params)
    h, car = controller.horizon, controller.bicycle
    lags = steering * car.tau_delta, drive * car.tau_ax
    h.quiet[:] = quiet
    terminal_weight(h.handle, SPEEDS[7], lags)
    q = h.q_noisy[0].copy()
    q[[EY, EPSI]] *= controller.weights.calm if quiet else 1.0
    other = car._replace(tau_delta=lags[0], tau_ax=lags[1])
    tires = np.array([params.Cf, 0.0, params.Cr, 0.0])
    exact = cost_to_go(other, tires, q, h.r_du, h.Ts)[7]
    np.testing.assert_allclose(
        h.terminal, controller.weights.terminal * exact, rtol=1e-6, atol=1e-9 * abs(exact).max()
    )
