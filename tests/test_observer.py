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


def learn(estimate, predicted, measured, gain, walk=np.inf, noise=None, last=None):
    noise = np.zeros(3) if noise is None else noise
    last = np.zeros(3) if last is None else last
    disturbance.update(
        estimate, predicted, measured, gain, disturbance.LIMIT, np.full(3, walk), noise, last, TS
    )


def test_the_gain_follows_the_noise_that_it_sees():
    rng, spread = np.random.default_rng(0), {}
    for std in (1e-5, 0.03):  # of the measured speeds [m/s]: none to speak of, and a good GNSS's
        estimate, noise, last, seen = np.zeros(3), np.zeros(3), np.zeros(3), []
        for _ in range(600):
            truth = np.array([0.0, 1.0, 0.0])
            error = (truth - estimate) * TS + std * rng.standard_normal(3)
            measured = np.zeros(NX)
            measured[:3] = error
            learn(estimate, np.zeros(NX), measured, np.full(3, 0.6), 1.0, noise, last)
            seen.append(estimate.copy())
        assert np.mean(seen[300:], axis=0)[1] == pytest.approx(1.0, abs=0.15)
        spread[std] = np.std(seen[300:], axis=0)[1]
    # at the full gain the noise would be sqrt(0.6 / 1.4) * 0.03 / TS = 0.6 m/s2
    assert spread[1e-5] < 0.01 and 0.05 < spread[0.03] < 0.35


@pytest.mark.parametrize("gain", [0.1, 0.3, 1.0])
def test_a_constant_disturbance_is_found_without_steady_state_error(model, gain):
    Ad, Ed, cd, x = model
    truth, estimate = np.array([0.3, -1.2, 0.4]), np.zeros(3)
    for _ in range(200):
        predicted = Ad @ x + Ed @ estimate + cd
        x = Ad @ x + Ed @ truth + cd
        learn(estimate, predicted, x, np.full(3, gain))
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
    learn(estimate, np.zeros(NX), measured, np.ones(3))
    np.testing.assert_array_equal(estimate, disturbance.LIMIT)


@pytest.mark.parametrize(
    ("std", "share"),
    [((0.0, 0.0, 0.0, 0.0), 1.0), ((0.02, 0.002, 0.004, 0.001), 0.0), ((0.0, 0.0, 0.004, 0.0), 0.0),
     ((0.0, 0.0, 0.0, 0.001), 0.0)],
)
def test_quiet_measurements_are_told_from_noisy_ones(std, share):
    """Noise of vy [m/s], r [rad/s], ey [m], epsi [rad], all of it or of a single one."""
    rng = np.random.default_rng(1)
    estimate, noise, last = np.zeros(3), np.zeros(5), np.zeros(5)
    for k in range(400):
        measured = np.zeros(NX)
        measured[1:5] = std * rng.standard_normal(4)
        measured[1] += 1e-4 * np.sin(0.1 * k)  # what a model misses is alike from period to period
        learn(estimate, np.zeros(NX), measured, np.full(3, 0.1), 2.0, noise, last)
        quiet = disturbance.quiet(np.zeros(NX), measured, noise, last, TS)
    assert quiet == pytest.approx(share, abs=0.01)
