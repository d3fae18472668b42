"""The disturbance observer."""

import numpy as np
import pytest

from lpvmpc.car.bicycle import EY, NU, NX, Bicycle, lpv
from lpvmpc.car.hold import discretise
from lpvmpc.control import disturbance
from lpvmpc.plant.mjcf import packaged_car

TS = 0.033


@pytest.fixture(scope="module")
def model():
    """Discretised model at 15 m/s on a straight, the disturbance as three more inputs."""
    car = packaged_car()
    x = np.zeros(NX)
    x[0] = 15.0
    A, B, c = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    lpv(x, 0.0, np.array([car.Cf, 0.0, car.Cr, 0.0]), Bicycle.of(car), 0, A, B, c)
    Ad, Ed, cd = discretise(A, np.eye(NX, 3), c, TS)
    return Ad, Ed, cd, x


@pytest.mark.parametrize("gain", [0.1, 0.3, 1.0])
def test_a_constant_disturbance_is_found_without_steady_state_error(model, gain):
    Ad, Ed, cd, x = model
    truth, estimate = np.array([0.3, -1.2, 0.4]), np.zeros(3)
    for _ in range(200):
        predicted = Ad @ x + Ed @ estimate + cd
        x = Ad @ x + Ed @ truth + cd
        disturbance.update(estimate, predicted, x, np.full(3, gain), disturbance.LIMIT, TS)
    # geometric convergence, factor at most 1 - 0.1/2 per period: 0.95^200 = 4e-5
    np.testing.assert_allclose(estimate, truth, atol=1e-3)


def test_a_disturbance_moves_position_within_the_period(model):
    """It enters before discretisation, so that ey feels half of d Ts^2."""
    _, Ed, _, _ = model
    moved = Ed[EY, 1]
    assert 0.5 * 0.5 * TS**2 < moved <= 0.5 * TS**2  # at most free motion: the tires resist


def test_the_estimate_is_limited():
    estimate = np.zeros(3)
    measured = np.full(NX, 100.0)
    disturbance.update(estimate, np.zeros(NX), measured, np.ones(3), disturbance.LIMIT, TS)
    np.testing.assert_array_equal(estimate, disturbance.LIMIT)
