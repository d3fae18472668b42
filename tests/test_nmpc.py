"""The rival `nmpc`: its model, its quadratic program, and short drives."""

import pickle
import sys

import numpy as np
import pytest

pytest.importorskip("casadi", reason="the extra `nmpc` is not installed")

from lpvmpc.car.axle import axles
from lpvmpc.car.bicycle import DELTA, EPSI, NU, NX, A, Bicycle
from lpvmpc.control.rivals import nmpc_model, nmpc_steady, staged_qp
from lpvmpc.control.rivals.nmpc import NMPC, V_SLIP_TEXTBOOK, NMPCWeights
from lpvmpc.errors import ControllerError, LPVMPCError
from lpvmpc.interface import Preview, State
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import _tires, load_controller, load_scenario

TS = 0.033
LEARNED, DISTURBANCE = np.array([0.9, 1.1, 0.95]), np.array([0.1, 0.2, 0.3])
COMMAND = np.array([0.06, -2.0])


def state(vx):
    return np.array([vx, 0.3, 0.2, 0.05, 0.02, 0.05, 1.0, 0.03, 0.02, 0.03, 0.01])


@pytest.fixture(scope="module")
def car():
    return packaged_car()


@pytest.fixture(scope="module")
def models(car):
    front, rear = axles(car, *_tires())
    whole = Bicycle.of(car)
    plain = whole.simplified(lags=False, relaxation=False, roll=False, trail=False)
    return {
        "nmpc": nmpc_model.Model(whole, front, rear, 0, car.Cf, car.Cr, car.vx_min),
        "nmpc-textbook": nmpc_model.Model(
            plain, front, rear, 1, car.Cf, car.Cr, V_SLIP_TEXTBOOK
        ),
    }


# The model --------------------------------------------------------------------------------------


@pytest.mark.parametrize("vx", [20.0, 0.5, 0.0])
@pytest.mark.parametrize("name", ["nmpc", "nmpc-textbook"])
def test_the_jacobian_is_that_of_the_period(models, name, vx):
    model, x = models[name], state(vx)
    out, S = np.empty(NX), np.empty((NX, NX + NU))
    rest = (0.01, 0.012, model, LEARNED, DISTURBANCE, TS)
    nmpc_model.linearised(x, COMMAND, *rest, out, S)
    z, after = np.append(x, COMMAND), np.empty((2, NX))
    nmpc_model.period(x, COMMAND, *rest, after[0])
    np.testing.assert_allclose(out, after[0], atol=1e-12)
    for j in range(NX + NU):
        for n, sign in enumerate((1.0, -1.0)):
            moved = z.copy()
            moved[j] += sign * 1e-6
            nmpc_model.period(moved[:NX], moved[NX:], *rest, after[n])
        # the axle forces are differentiated by one-sided quotients
        np.testing.assert_allclose((after[0] - after[1]) / 2e-6, S[:, j], atol=2e-3)


def test_a_steady_state_stays(models):
    model, x = models["nmpc"], state(20.0)
    for _ in range(8):
        nmpc_steady.steady(x.copy(), 0.01, model, LEARNED, DISTURBANCE, 0.2, x)
    dx = np.empty(NX)
    nmpc_model.rates(x, x[[DELTA, A]], 0.01, model, LEARNED, DISTURBANCE, dx)
    assert np.abs(dx).max() < 1e-3  # of accelerations of 4 m/s2


def test_a_car_at_rest_stays_at_rest_however_its_wheels_point(models):
    for model in models.values():
        x, dx = np.zeros(NX), np.empty(NX)
        x[[DELTA, EPSI]] = 0.3, 0.1
        nmpc_model.rates(x, np.array([0.3, 0.0]), 0.02, model, np.ones(3), np.zeros(3), dx)
        np.testing.assert_array_equal(dx, np.zeros(NX))


# The quadratic program --------------------------------------------------------------------------


def test_the_staged_program_has_the_solution_of_the_dense_one():
    N, nx, nu = 4, 3, 2
    rng = np.random.default_rng(0)
    Ad, Bd, cd = rng.normal(size=(N, nx, nx)), rng.normal(size=(N, nx, nu)), np.ones((N, nx))
    x0, u_prev, q, r = rng.normal(size=nx), np.array([0.1, -0.2]), np.ones((N, nx)), np.ones(nu)
    P = np.diag(np.arange(1.0, nx + nu + 1))
    x_ref, z_ref = rng.normal(size=(N, nx)), rng.normal(size=nx + nu)
    u_hi = np.full((N, nu), 0.4)
    qp = staged_qp.StagedQP(N, nx, nu, "test")

    def cost(u):
        x, total, last = x0, 0.0, u_prev
        for k in range(N):
            x = Ad[k] @ x + Bd[k] @ u[k] + cd[k]
            total += np.sum((x - x_ref[k]) ** 2) + np.sum((u[k] - last) ** 2)
            last = u[k]
        e = np.append(x, last) - z_ref
        return total + e @ P @ e

    for bound in (0.4, 0.2):  # twice: the second call must not answer the first question
        u_hi[:] = bound
        staged_qp.write(
            Ad, Bd, cd, x0, u_prev, x_ref, q, r, P, z_ref, -u_hi, u_hi, np.array([0.3, np.inf]),
            qp.data,
        )
        v, residual, status, _ = qp.solve()
        assert status == "SOLVED" and residual < 1e-6
        u = np.array([v[nu + k * (nx + 2 * nu) + nx :][:nu] for k in range(N)])
        assert np.abs(u).max() <= bound + 1e-6
        assert np.abs(np.diff(np.vstack([u_prev, u])[:, 0])).max() <= 0.3 + 1e-6
        best = cost(u)
        for _ in range(200):  # no feasible neighbour is better
            other = np.clip(u + rng.normal(size=u.shape) * 1e-2, -bound, bound)
            if np.abs(np.diff(np.vstack([u_prev, other])[:, 0])).max() <= 0.3:
                assert cost(other) >= best - 1e-6


def test_without_casadi_one_sentence_says_what_to_install(car, monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(LPVMPCError, match=r"'nmpc' .* not installed here: .*lpvmpc\[nmpc\]"):
        NMPC(car, _tires())
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setattr("lpvmpc.control.rivals.find_spec", lambda name: None)
    with pytest.raises(ControllerError, match=r"package casadi"):
        load_controller("nmpc")


# Drives -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def from_rest_to_rest(tmp_path_factory):
    """A left bend of 60 m that begins and ends at a standstill."""
    s = np.linspace(0.0, 60.0, 61)
    x, y = 80.0 * np.sin(s / 80.0), 80.0 * (1.0 - np.cos(s / 80.0))
    vx = np.minimum(np.minimum(np.sqrt(4.0 * s), np.sqrt(4.0 * (60.0 - s))), 9.0)
    vx[1:-1] = np.maximum(vx[1:-1], 0.5)
    file = tmp_path_factory.mktemp("road") / "stop.csv"
    rows = "\n".join(f"{a},{b},{v}" for a, b, v in zip(x, y, vx, strict=True))
    file.write_text("x_m,y_m,vx_mps\n" + rows + "\n")
    return load_scenario(str(file))


@pytest.mark.parametrize(("name", "bound"), [("nmpc", 0.01), ("nmpc-textbook", 0.05)])
def test_it_starts_from_rest_and_stops(from_rest_to_rest, name, bound):
    log = simulate(Plant(), load_controller(name), from_rest_to_rest)
    result = metrics(log)
    assert result["completed"], result["reason"]
    assert result["lateral_max_m"] < bound


@pytest.mark.parametrize("delay", [0, 3])
def test_it_follows_a_lane_change_also_with_a_told_delay(delay):
    controller = load_controller("nmpc", delay=delay)
    log = simulate(Plant(), controller, load_scenario("double-lane-change"), delay=delay)
    result = metrics(log)
    assert result["completed"] and result["lateral_max_m"] < 0.01  # the prototype: 1.4 mm


def test_a_measurement_that_is_no_number_is_survived_and_copies_drive_alike(car):
    controller = load_controller("nmpc")
    controller.reset(np.random.default_rng(0))
    n = controller.preview_steps + 1
    flat = np.zeros(n)
    preview = Preview(0.0, 0.1, 0.0, flat + 0.01, flat + 10.0, flat, flat, flat)
    seen = State(0.0, 0.0, 0.0, 10.0, 0.0, 0.1, 0.0, 0.0, 1.0, np.full(4, 33.0))
    for vx in (10.0, np.nan, 10.0):
        controller.command(seen._replace(vx=vx), preview)
    twin = pickle.loads(pickle.dumps(controller))
    assert twin.command(seen, preview) == controller.command(seen, preview)
    assert controller.diagnostics.solved and controller.diagnostics.prediction.shape == (21, 5)


def test_its_weights_lie_where_tuning_searches():
    weights = NMPCWeights()
    for name, (low, high) in NMPCWeights.RANGES.items():
        assert low < getattr(weights, name) < high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("grip", "rmse", "largest"),
    [(0.96, 0.74, 5.1),
     pytest.param(1.0, 1.5, 18.0, marks=pytest.mark.xfail(
         strict=True, reason="1.72 mm where 1.65 are asked; the largest error, 17.2, is met"))],
)
def test_it_drives_at_the_limit(grip, rmse, largest):
    log = simulate(Plant(), load_controller("nmpc"), load_scenario("circuit", grip=grip))
    result = metrics(log)
    assert result["completed"]
    assert 1e3 * result["lateral_rmse_m"] < 1.1 * rmse  # the prototype's, shared facts
    assert 1e3 * result["lateral_max_m"] < 1.1 * largest
