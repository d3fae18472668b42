"""The friction observer against a tire law that obeys the similarity it assumes."""

import numpy as np
import pytest

from lpvmpc.control.stiffness.friction import FRICTION_MAX, FRICTION_MIN, FrictionObserver
from lpvmpc.plant.mjcf import packaged_car

TS = 0.033


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def axle(alpha, mu, C, peak):
    """Force and tangent offset of a saturating axle, Fy = mu F(alpha / mu)."""
    z = C * alpha / (mu * peak)
    force = mu * peak * np.tanh(z)
    return force, force - C / np.cosh(z) ** 2 * alpha


def learn(car, true, alpha, *, side_force=0.0, periods=120):
    """Estimates of an observer that sees steady driving at a slip angle."""
    observer = FrictionObserver(car, TS)
    lever_f, lever_r = car.lf - car.trail_f, car.lr + car.trail_r
    peak_f, peak_r = 7000.0, 5500.0
    for _ in range(periods):
        mu = observer.friction
        (model_f, F0f), (model_r, F0r) = (
            axle(alpha, mu, car.Cf, peak_f),
            axle(0.5 * alpha, mu, car.Cr, peak_r),
        )
        real_f, real_r = (
            axle(alpha, true, car.Cf, peak_f)[0],
            axle(0.5 * alpha, true, car.Cr, peak_r)[0],
        )
        force = real_f + real_r - model_f - model_r + side_force
        moment = lever_f * (real_f - model_f) - lever_r * (real_r - model_r)
        moment += car.x_cy * side_force
        unmodelled = np.array([force / car.m, moment / car.Iz])
        observer.update(unmodelled, np.array([F0f, F0r]))
    return observer


@pytest.mark.parametrize("true", [0.5, 0.75, 1.1])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_friction_is_found_near_the_limit(car, true, side):
    observer = learn(car, true, side * 0.1)
    # the pull back to a dry road, Ts / 20 s per period, leaves a few per cent
    assert observer.friction == pytest.approx(true, abs=0.06)


def test_nothing_is_learned_from_tires_that_are_used_little(car):
    assert learn(car, 0.5, 0.004).friction > 0.9


@pytest.mark.parametrize("alpha", [0.0, 0.01])
def test_side_wind_is_not_taken_for_a_slippery_road(car, alpha):
    observer = learn(car, 1.0, alpha, side_force=-2500.0, periods=300)
    assert observer.friction > 0.85
    assert observer.side_force == pytest.approx(-2500.0, rel=0.1)


def test_the_estimate_stays_in_its_range(car):
    observer = FrictionObserver(car, TS)
    for sign in (-1.0, 1.0):
        for _ in range(200):
            observer.update(np.array([sign * 50.0, sign * 50.0]), np.array([5000.0, 3000.0]))
            assert FRICTION_MIN <= observer.friction <= FRICTION_MAX


def test_reset_forgets_the_road(car):
    observer = learn(car, 0.5, 0.1)
    observer.reset()
    assert observer.friction == 1.0
    assert observer.side_force == 0.0
