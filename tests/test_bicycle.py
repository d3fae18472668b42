"""The single-track model: LPV form, discretisation and steady state against independent forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from lpvmpc.car import bicycle, hold
from lpvmpc.car.bicycle import AF, AR, CORRECTED, DELTA, EPSI, EY, NU, NX, PRINTED, VX, VY, A, R
from lpvmpc.car.hold import EULER, EXACT
from lpvmpc.plant.mjcf import packaged_car


@pytest.fixture(scope="module")
def params():
    return packaged_car()


@pytest.fixture(scope="module")
def car(params):
    return bicycle.Bicycle.of(params)


def random_points(n=20):
    """States in and beyond normal driving, curvatures, affine tires."""
    rng = np.random.default_rng(1)
    low = np.array([3.0, -1.0, -0.8, -0.4, -0.3, -0.4, -4.0, -0.1, -0.1, -0.1, -0.3])
    high = np.array([30.0, 1.0, 0.8, 0.4, 0.3, 0.4, 3.0, 0.1, 0.1, 0.1, 0.3])
    for _ in range(n):
        tires = np.array([1.2e5, 800.0, 2.0e5, -500.0]) * rng.uniform(0.3, 1.2, 4)
        yield rng.uniform(low, high), rng.uniform(-0.1, 0.1), tires


def without_lags(car):
    return car.simplified(lags=False, relaxation=False, roll=False)


def matrices(x, kappa, tires, car, *, form=CORRECTED):
    A, B, c = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    bicycle.lpv(x, kappa, tires, car, form, A, B, c)
    return A, B, c


def test_slip_angles_are_positive_for_steering_left(car):
    alpha_f, alpha_r = bicycle.slip_angles(15.0, 0.0, 0.0, 0.05, car)
    assert alpha_f == 0.05
    assert alpha_r == 0.0


@pytest.mark.parametrize("servos", [True, False])
@pytest.mark.parametrize("relaxation", [True, False])
@pytest.mark.parametrize("roll", [True, False])
def test_lpv_form_equals_the_nonlinear_model_at_the_scheduling_point(car, servos, relaxation, roll):
    car = car.simplified(lags=servos, relaxation=relaxation, roll=roll)
    for x, kappa, tires in random_points():
        A, B, c = matrices(x, kappa, tires, car)
        u = np.array([0.1, 1.0]) if servos else x[[DELTA, bicycle.A]]
        expected = bicycle.derivative(x, u, kappa, tires, car)
        # both are sums of the same few terms: rounding only
        np.testing.assert_allclose(A @ x + B @ u + c, expected, rtol=1e-11, atol=1e-11)


def test_printed_error_row_has_the_same_value_but_not_the_sensitivity(car):
    for x, kappa, tires in random_points(5):
        A, _, _ = matrices(x, kappa, tires, car)
        P, _, _ = matrices(x, kappa, tires, car, form=PRINTED)
        assert (A @ x)[EY] == pytest.approx((P @ x)[EY], rel=1e-12, abs=1e-14)
        assert P[EY, EPSI] == 0.0
        assert A[EY, EPSI] == pytest.approx(x[VX], rel=0.02)  # sinc of at most 0.3 rad


def test_error_rows_are_the_jacobian_of_the_nonlinear_model(car):
    """On the path, the rows of ey and epsi agree with finite differences."""
    x = np.array([15.0, 0.2, 0.15, 0.0, 0.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0])
    tires, kappa, h = np.array([1.2e5, 0.0, 2.0e5, 0.0]), 0.01, 1e-6
    A, _, _ = matrices(x, kappa, tires, car)
    for j in (VX, VY, R, EPSI):
        step = np.zeros(NX)
        step[j] = h
        forward = bicycle.derivative(x + step, np.zeros(2), kappa, tires, car)
        back = bicycle.derivative(x - step, np.zeros(2), kappa, tires, car)
        # 1e-6: second-order differences of numbers of order 15 in double precision
        assert A[EY, j] == pytest.approx((forward - back)[EY] / (2 * h), abs=1e-6)
        if j != EPSI:
            assert A[EPSI, j] == pytest.approx((forward - back)[EPSI] / (2 * h), abs=1e-6)


def test_steering_left_turns_left(car):
    x, tires = np.zeros(NX), np.array([1.2e5, 0.0, 2.0e5, 0.0])
    x[VX] = 15.0
    _, B, _ = matrices(x, 0.0, tires, without_lags(car))
    assert B[VY, 0] > 0.0
    assert B[R, 0] > 0.0
    A, _, _ = matrices(x, 0.0, tires, car.simplified(relaxation=False))
    assert A[R, DELTA] == B[R, 0]
    A, _, _ = matrices(x, 0.0, tires, car)
    assert A[R, AF] == B[R, 0]
    assert A[R, AR] < 0.0


@pytest.mark.parametrize("Ts", [0.001, 0.033, 0.2])
def test_exact_hold_is_the_matrix_exponential(car, Ts):
    for x, kappa, tires in random_points(8):
        A, B, c = matrices(x, kappa, tires, car)
        block = np.zeros((NX + NU + 1, NX + NU + 1))
        block[:NX, :NX], block[:NX, NX:-1], block[:NX, -1] = A, B, c
        reference = expm(block * Ts)
        Ad, Bd, cd = hold.discretise(A, B, c, Ts)
        # the series is truncated at 1e-6 of the result (docstring)
        for ours, theirs in (
            (Ad, reference[:NX, :NX]),
            (Bd, reference[:NX, NX:-1]),
            (cd, reference[:NX, -1]),
        ):
            assert np.abs(ours - theirs).max() < 1e-6 * np.abs(theirs).max()


def test_exact_hold_is_stable_at_walking_speed_where_euler_is_not(car):
    x = np.zeros(NX)
    x[VX] = 2.0
    A, _, _ = matrices(x, 0.0, np.array([1.31e5, 0.0, 2.15e5, 0.0]), without_lags(car))
    radius = {}
    for method in (EXACT, EULER):
        Ad = np.empty((NX, NX))
        hold.hold(A, np.zeros((NX, NU + 1)), 0.033, method, Ad, np.empty((NX, NU + 1)))
        lateral = Ad[1:3, 1:3]
        radius[method] = np.abs(np.linalg.eigvals(lateral)).max()
    assert radius[EXACT] < 1.0 < radius[EULER]


def test_hold_predicts_the_nonlinear_model_over_one_period(car):
    x = np.array([15.0, 0.1, 0.2, 0.05, 0.01, 0.04, 0.5, 0.02, 0.01, 0.02, 0.1])
    tires, u, kappa, Ts = np.array([1.2e5, 0.0, 2.0e5, 0.0]), np.array([0.05, 1.0]), 0.01, 0.033
    A, B, c = matrices(x, kappa, tires, car)
    Ad, Bd, cd = hold.discretise(A, B, c, Ts)
    exact = solve_ivp(
        lambda t, z: bicycle.derivative(z, u, kappa, tires, car), (0, Ts), x, rtol=1e-10
    ).y[:, -1]
    change = np.abs(exact - x).max()
    # frozen at the start of the period: 2 % of what changes over it
    assert np.abs(Ad @ x + Bd @ u + cd - exact).max() < 0.02 * change


def test_steady_state_is_an_equilibrium_of_the_nonlinear_model(car):
    for vx, kappa, d in [
        (5.0, 0.1, (0, 0, 0)),
        (20.0, 0.01, (0, 0, 0)),
        (15.0, -0.02, (0.1, 1.5, -0.2)),
        (25.0, 0.0, (0, -1.0, 0.3)),
    ]:
        tires = np.array([1.2e5, 300.0, 2.0e5, -100.0])
        x = np.empty(NX)
        bicycle.steady_state(vx, kappa, tires, np.array(d, float), car, x)
        dx = bicycle.derivative(x, x[[DELTA, A]], kappa, tires, car)
        dx[:3] += d
        # three fixed-point rounds: the remainder is third order in the steering angle
        np.testing.assert_allclose(dx, 0.0, atol=2e-3)


def test_steady_state_reproduces_the_understeer_gradient(car, params):
    """delta = L kappa + K ay with K = m/L (lr/Cf - lf/Cr), Rajamani eq. 3.11, without trail."""
    car = car.simplified(trail=False)
    tires = np.array([params.Cf, 0.0, params.Cr, 0.0])
    vx, kappa = 20.0, 1e-4  # ay 0.04 m/s2: linear
    x = np.empty(NX)
    bicycle.steady_state(vx, kappa, tires, np.zeros(3), car, x)
    K = car.m / params.wheelbase * (car.lr / params.Cf - car.lf / params.Cr)
    assert x[DELTA] == pytest.approx(params.wheelbase * kappa + K * vx**2 * kappa, rel=1e-4)


def test_a_curve_to_the_other_side_mirrors_the_steady_state(car):
    tires = np.array([1.2e5, 0.0, 2.0e5, 0.0])
    left, right = np.empty(NX), np.empty(NX)
    bicycle.steady_state(12.0, 0.03, tires, np.array([0, 0.5, 0.1]), car, left)
    bicycle.steady_state(12.0, -0.03, tires, np.array([0, -0.5, -0.1]), car, right)
    mirror = np.array([1, -1, -1, -1, -1, -1, 1, -1, -1, -1, -1])
    np.testing.assert_array_equal(left, mirror * right)
