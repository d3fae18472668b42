"""The condensed QP and its solver against independent forms."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from lpvmpc.control.horizon import Horizon
from lpvmpc.control.qp import condense
from lpvmpc.control.solver.checked import QPSolver
from lpvmpc.control.solver.optimality import GOOD, factor, judge
from lpvmpc.errors import OptionError

N, NX, NU = 8, 3, 2
WRITTEN = ("H", "g", "C", "lo", "hi", "free", "forced")


def problem(
    seed=0, x0=None, *, u_max=5.0, du_max=1.0, soft_bound=0.5, r=0.1, n_rates=NU, soft_every=1
):
    """A random stable tracking problem: the fields that `condense` reads and those it wrote."""
    rng = np.random.default_rng(seed)
    Ad = np.repeat((np.eye(NX) + 0.1 * rng.standard_normal((NX, NX)))[None], N, axis=0)
    Bd = np.repeat(0.5 * rng.standard_normal((1, NX, NU)), N, axis=0)
    cd = 0.02 * rng.standard_normal((N, NX))
    h = Horizon.allocated(
        N, NX, NU, ns=NX + 1, soft_every=soft_every,
        Ts=1.0, car=np.zeros(0),
        q=np.tile([1.0, 0.0, 3.0], (N, 1)), r_du=np.full(NU, r),
        du_max=np.full(n_rates, du_max), soft=0, soft_bound=soft_bound,
        slack_weights=np.array([100.0, 1000.0]), scale=np.array([0.5, 2.0]),
    )
    x0 = rng.standard_normal(NX) if x0 is None else x0
    h.Ad[:], h.Bd[:], h.cd[:] = Ad, Bd, cd
    h.schedule[:] = np.nan  # but for its first row, and there for the model's states, not read
    h.schedule[0, 1:] = x0
    h.x_ref[:] = 0.3 * rng.standard_normal((N, NX))
    h.queue[-1] = 0.1 * rng.standard_normal(NU)
    h.u_lo[:], h.u_hi[:] = -u_max, u_max
    h.terminal[:] = 0.5 * np.eye(NX + NU) + 0.1
    h.z_ref[:] = 0.2 * rng.standard_normal(NX + NU)
    for name in WRITTEN:
        getattr(h, name)[:] = np.nan
    condense(h.handle)
    given = {name: value for name, value in vars(h).items() if name not in WRITTEN}
    given |= {"x0": h.schedule[0, 1:], "u_prev": h.queue[-1]}
    written = {name: getattr(h, name) for name in WRITTEN}
    return given, written


def rollout(given, u):
    """States x_1..x_N by stepping the system."""
    x, states = given["x0"], []
    for k in range(N):
        x = given["Ad"][k] @ x + given["Bd"][k] @ u[k] + given["cd"][k]
        states.append(x)
    return np.array(states)


def cost(given, u, slack):
    """The cost as the docstring of `condense` states it."""
    states = rollout(given, u)
    du = np.diff(np.vstack([given["u_prev"], u]), axis=0)
    w = given["slack_weights"]
    end = np.append(states[-1], u[-1]) - given["z_ref"]
    return (
        end @ given["terminal"] @ end
        + (given["q"] * (states - given["x_ref"]) ** 2).sum()
        + (given["r_du"] * du**2).sum()
        + w[0] * slack
        + w[1] * slack**2
    )


def solver(written, **options):
    return QPSolver(len(written["g"]), len(written["lo"]), **options)


def solve(written, **options):
    arrays = (written[k] for k in ("H", "g", "C", "lo", "hi"))
    return solver(written, **options).solve(*arrays)


def test_condensed_cost_is_the_stated_sum():
    given, written = problem()
    rng = np.random.default_rng(5)
    values = []
    for _ in range(4):
        u, slack = rng.standard_normal((N, NU)), rng.uniform()
        z = np.append((u / given["scale"]).ravel(), slack)
        values.append(0.5 * z @ written["H"] @ z + written["g"] @ z - cost(given, u, slack))
    # the QP drops a constant, so the difference is the same for every z
    np.testing.assert_allclose(values, values[0], rtol=1e-12)


def test_condensed_states_are_the_rollout():
    given, written = problem()
    u = np.random.default_rng(2).standard_normal((N, NU))
    states = written["free"] + written["forced"] @ (u / given["scale"]).ravel()
    np.testing.assert_allclose(states, rollout(given, u), atol=1e-12)


def test_bounds_and_rates_are_respected_and_the_soft_bound_gives_way():
    given, written = problem(x0=np.array([3.0, -1.0, 2.0]), u_max=0.6, du_max=0.2)
    result = solve(written)
    assert result.solved
    u = result.z[:-1].reshape(N, NU) * given["scale"]
    du = np.diff(np.vstack([given["u_prev"], u]), axis=0)
    # 1e-6: the accepted KKT residual, in units of the scaled inputs (at most 2)
    assert np.abs(u).max() <= 0.6 + 2e-6
    assert np.abs(du).max() <= 0.2 + 2e-6
    assert result.z[-1] > 0.1  # x0 is far outside the soft bound
    over = np.abs(rollout(given, u)[:, 0]).max() - given["soft_bound"]
    assert over <= result.z[-1] + 1e-5


def test_a_soft_bound_may_hold_at_every_second_step_only():
    _, every = problem(x0=np.array([3.0, -1.0, 2.0]), u_max=0.6)
    _, second = problem(x0=np.array([3.0, -1.0, 2.0]), u_max=0.6, soft_every=2)
    assert len(every["lo"]) - len(second["lo"]) == N
    slack = solve(every).z[-1], solve(second).z[-1]
    assert 0.0 < slack[1] <= slack[0] + 1e-5  # fewer rows ask for no more slack


def test_an_input_without_increment_bound_may_jump():
    x0 = np.array([3.0, -1.0, 2.0])
    given, written = problem(x0=x0, du_max=0.05, n_rates=1, soft_bound=100.0)
    result = solve(written)
    assert result.solved
    u = result.z[:-1].reshape(N, NU) * given["scale"]
    du = np.abs(np.diff(np.vstack([given["u_prev"], u]), axis=0)).max(axis=0)
    assert du[0] <= 0.05 + 1e-6 < 0.2 < du[1]


def test_returned_solutions_satisfy_the_optimality_conditions():
    for seed in range(20):
        _, written = problem(seed, u_max=0.8, du_max=0.2)
        result = solve(written)
        assert result.solved, result.status
        assert result.residual <= 1e-6
        # independent of our check: no feasible direction improves (random probing)
        z, H, g = result.z, written["H"], written["g"]
        best = 0.5 * z @ H @ z + g @ z
        rng = np.random.default_rng(seed)
        for _ in range(50):
            other = z + 0.05 * rng.standard_normal(len(z))
            values = written["C"] @ other
            if np.all(values >= written["lo"]) and np.all(values <= written["hi"]):
                assert 0.5 * other @ H @ other + g @ other >= best - 1e-6


def test_without_constraints_the_first_input_is_the_lqr_input():
    """With the Riccati solution as terminal weight, MPC equals LQR on (x, u_prev)."""
    rng = np.random.default_rng(3)
    A, B = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[0.0], [0.1]])
    # increments as input: augmented state (x, u_prev); diagonal weights need P, so use long N
    Aa = np.block([[A, B], [np.zeros((1, 2)), np.eye(1)]])
    Ba = np.vstack([B, np.eye(1)])
    Q, Rw = np.diag([2.0, 1.0, 0.0]), np.array([[0.5]])
    P = solve_discrete_are(Aa, Ba, Q + 1e-9 * np.eye(3), Rw)
    K = np.linalg.solve(Rw + Ba.T @ P @ Ba, Ba.T @ P @ Aa)
    x0, u_prev, horizon = rng.standard_normal(2), rng.standard_normal(1), 200
    h = Horizon.allocated(
        horizon, 2, 1, Ts=1.0, car=np.zeros(0), Ad=A, Bd=B, q=np.tile([2.0, 1.0], (horizon, 1)),
        r_du=np.array([0.5]), u_lo=-1e6, u_hi=1e6, du_max=np.array([1e6]), soft=0, soft_bound=1e6,
        slack_weights=np.array([1.0, 1.0]), scale=np.array([1.0]),
    )
    h.schedule[0], h.queue[-1, 0] = x0, u_prev[0]
    condense(h.handle)
    H, g = h.H, h.g
    z = np.linalg.solve(H[:-1, :-1], -g[:-1])
    # condense sums x_1..x_N and the LQR x_0..: the difference does not depend on u
    expected = u_prev - K @ np.append(x0, u_prev)
    assert z[0] == pytest.approx(expected[0], rel=1e-6)  # tail of 200 steps


def test_the_check_sees_a_wrong_answer():
    _, written = problem(u_max=0.8, du_max=0.2)
    result = solve(written)
    arrays = tuple(written[k] for k in ("H", "g", "C", "lo", "hi"))
    H, none = arrays[0], np.zeros(len(written["lo"]))
    U = np.zeros_like(H)
    assert factor(*arrays, U) == GOOD
    wrong = result.z.copy()
    wrong[0] += 1e-3
    assert min(judge(*arrays, wrong, none, U)) > 1e-5
    assert np.isnan(judge(*arrays, wrong * np.nan, none, U)).all()


@pytest.mark.parametrize(
    ("poison", "value"),
    [
        *((name, value) for name in ("H", "g", "C", "lo") for value in (np.nan, np.inf)),
        ("hi", np.nan),  # an infinite upper bound means no bound
    ],
)
def test_data_that_are_not_finite_are_refused_without_asking_the_solver(poison, value):
    _, written = problem()
    prox = solver(written)
    healthy = tuple(written[k].copy() for k in ("H", "g", "C", "lo", "hi"))
    good = prox.solve(*healthy)
    written[poison].flat[0] = value
    refused = prox.solve(*(written[k] for k in ("H", "g", "C", "lo", "hi")))
    assert not refused.solved
    assert refused.status == "NOT_FINITE"
    again = prox.solve(*healthy)
    np.testing.assert_allclose(again.z, good.z, atol=1e-9)  # not poisoned afterwards


def test_an_infeasible_problem_is_refused_within_the_iteration_limit():
    _, written = problem()
    written["lo"][0], written["hi"][0] = 3.0, 2.0
    result = solve(written, max_iter=20)
    assert not result.solved
    # outer times inner limit, and the outer ones; unlimited it runs for seconds
    assert result.iterations <= 20 * 20 + 20


def test_the_same_sequence_gives_the_same_bytes():
    arrays = [tuple(problem(s)[1][k] for k in ("H", "g", "C", "lo", "hi")) for s in range(6)]
    runs = []
    for _ in range(2):
        prox = QPSolver(len(arrays[0][1]), len(arrays[0][3]))
        runs.append(np.array([prox.solve(*a).z for a in arrays]))
    assert runs[0].tobytes() == runs[1].tobytes()


@pytest.mark.parametrize(("option", "value"), [("tolerance", 0.0), ("tolerance", np.nan),
                                               ("max_iter", 0)])
def test_impossible_solver_options_are_named(option, value):
    with pytest.raises(OptionError, match=option):
        QPSolver(2, 2, **{option: value})


@pytest.mark.parametrize("seed", [4787, 5253, 5722])
def test_an_answer_that_is_not_optimal_is_asked_for_again(seed):
    """Problems in which ProxQP stops too early, and says SOLVED."""
    _, written = problem(seed, soft_bound=0.2)
    result = solve(written, max_iter=50)
    assert result.second and result.solved and result.residual <= 1e-6


def test_asking_again_leaves_no_trace_in_the_next_solve():
    _, hard = problem(4787, soft_bound=0.2)
    _, plain = problem(1)
    alone, after = (QPSolver(len(plain["g"]), len(plain["lo"])) for _ in range(2))
    names = ("H", "g", "C", "lo", "hi")
    after.solve(*(hard[k] for k in names))
    expected = alone.solve(*(plain[k] for k in names))
    np.testing.assert_array_equal(after.solve(*(plain[k] for k in names)).z, expected.z)
