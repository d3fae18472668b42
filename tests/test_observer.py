"""The disturbance observer."""

import numpy as np
import pytest

from lpvmpc import observer
from lpvmpc.bicycle import EXACT, NU, NX, Bicycle, hold, lpv
from lpvmpc.vehicle import VehicleParams

TS = 0.033


@pytest.fixture(scope="module")
def model():
    """Discretised model at 15 m/s on a straight."""
    car = VehicleParams.load()
    x = np.array([15.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    A, B, c = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    lpv(x, 0.0, np.array([car.Cf, 0.0, car.Cr, 0.0]), Bicycle.of(car), 0, A, B, c)
    Ad, G = np.empty((NX, NX)), np.empty((NX, NX))
    hold(A, TS, EXACT, Ad, G)
    return Ad, G, B, c, x


@pytest.mark.parametrize("gain", [0.1, 0.3, 1.0])
def test_a_constant_disturbance_is_found_without_steady_state_error(model, gain):
    Ad, G, B, c, x = model
    truth, estimate = np.array([0.3, -1.2, 0.4]), np.zeros(3)
    u, predicted, measured = np.zeros(2), np.empty(NX), np.empty(NX)
    for _ in range(200):
        observer.predict(Ad, G, B, c, x, u, estimate, predicted)
        observer.predict(Ad, G, B, c, x, u, truth, measured)
        observer.update(estimate, predicted, measured, np.full(3, gain), observer.LIMIT, TS)
        x = measured.copy()
    # geometric convergence, factor at most 1 - 0.1/2 per period: 0.95^200 = 4e-5
    np.testing.assert_allclose(estimate, truth, atol=1e-3)


def test_a_disturbance_moves_position_within_the_period(model):
    """It enters before discretisation, so that ey feels half of d Ts^2."""
    Ad, G, B, c, x = model
    with_d, without = np.empty(NX), np.empty(NX)
    observer.predict(Ad, G, B, c, x, np.zeros(2), np.array([0.0, 1.0, 0.0]), with_d)
    observer.predict(Ad, G, B, c, x, np.zeros(2), np.zeros(3), without)
    moved = (with_d - without)[3]
    assert 0.5 * 0.5 * TS**2 < moved < 0.5 * TS**2  # less than free motion: the tires resist


def test_the_estimate_is_limited():
    estimate = np.zeros(3)
    measured = np.full(NX, 100.0)
    observer.update(estimate, np.zeros(NX), measured, np.ones(3), observer.LIMIT, TS)
    np.testing.assert_array_equal(estimate, observer.LIMIT)
