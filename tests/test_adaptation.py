"""What is learned of tires and road, against axles that obey the similarity it assumes."""

import numpy as np
import pytest

from lpvmpc.control.stiffness.adaptation import CF, CR, FORCE, MOMENT, MU, TireAdaptation
from lpvmpc.plant.mjcf import packaged_car

TS = 0.033
PEAK_F, PEAK_R = 7000.0, 5500.0


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def axle(alpha, mu, scale, C, peak):
    """Force, slope and tangent offset of a saturating axle, Fy = mu F(scale alpha / mu)."""
    z = C * scale * alpha / (mu * peak)
    force, slope = mu * peak * np.tanh(z), C * scale / np.cosh(z) ** 2
    return force, slope, force - slope * alpha


def learn(car, alphas, *, mu=1.0, scales=(1.0, 1.0), push=(0.0, 0.0), noise=0.0):
    """What is learned while the car is driven at slip angles, one per period."""
    made, rng = TireAdaptation(car, TS), np.random.default_rng(0)
    lever_f, lever_r = car.lf - car.trail_f, car.lr + car.trail_r
    for alpha, now in zip(alphas, np.broadcast_to(mu, len(alphas)), strict=True):
        known = made.estimate
        slips = np.array([alpha, 0.5 * alpha])
        f = axle(slips[0], known[MU], known[CF], car.Cf, PEAK_F)
        r = axle(slips[1], known[MU], known[CR], car.Cr, PEAK_R)
        true_f = axle(slips[0], now, scales[0], car.Cf, PEAK_F)[0]
        true_r = axle(slips[1], now, scales[1], car.Cr, PEAK_R)[0]
        force = true_f + true_r - f[0] - r[0] + push[0]
        moment = lever_f * (true_f - f[0]) - lever_r * (true_r - r[0]) + push[1]
        unmodelled = np.array([force / car.m, moment / car.Iz]) + noise * rng.standard_normal(2)
        forces = np.array([f[1], f[2], r[1], r[2]])
        made.update(unmodelled, forces, slips, 0.0, (true_f + true_r) / car.m)
    return made.estimate


def swing(amplitude, seconds=30.0):
    """Slip angle on a winding road."""
    return amplitude * np.sin(0.6 * np.pi * np.arange(0.0, seconds, TS))


@pytest.mark.parametrize("mu", [0.5, 0.75])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_road_that_becomes_slippery_near_the_limit_is_noticed_within_a_second(car, mu, side):
    """After 20 s on a dry road, in which the tires have become known."""
    dry = swing(0.04, 20.0)
    alphas = np.concatenate([dry, np.full(30, side * 0.1)])
    friction = np.concatenate([np.ones(len(dry)), np.full(30, mu)])
    assert learn(car, alphas, mu=friction)[MU] == pytest.approx(mu, abs=0.15)


@pytest.mark.parametrize("scales", [(0.7, 1.0), (1.0, 0.7), (0.7, 0.7), (1.3, 1.2)])
def test_a_wrong_stiffness_is_not_taken_for_a_slippery_road(car, scales):
    found = learn(car, swing(0.02), scales=scales)
    assert found[MU] > 0.9
    np.testing.assert_allclose(found[[CF, CR]], scales, rtol=0.12)


@pytest.mark.parametrize("alpha", [0.0, 0.01])
def test_side_wind_is_not_taken_for_tires(car, alpha):
    found = learn(car, [alpha] * 300, push=(-2500.0, 400.0))
    assert found[MU] > 0.9
    np.testing.assert_allclose(found[[CF, CR]], 1.0, atol=0.25)
    if alpha == 0.0:
        np.testing.assert_allclose(found[[FORCE, MOMENT]], (-2500.0, 400.0), rtol=0.1)


def test_nothing_is_learned_of_friction_where_little_grip_is_used(car):
    assert learn(car, [0.004] * 120, mu=0.5)[MU] == pytest.approx(1.0, abs=0.02)


def test_noise_is_seen_and_met(car):
    """Differentiated GNSS speeds: 1 m/s2 and 1 rad/s2 of noise, twice a dry road's braking."""
    found = learn(car, swing(0.03, 60.0), noise=1.0)
    assert found[MU] > 0.85
    np.testing.assert_allclose(found[[CF, CR]], 1.0, atol=0.25)


def test_reset_forgets(car):
    made = TireAdaptation(car, TS)
    made.update(np.full(2, -5.0), np.full(4, 3000.0), np.full(2, 0.1), 0.0, 6.0)
    assert made.estimate[MU] != 1.0
    made.reset()
    np.testing.assert_array_equal(made.estimate, [1.0, 1.0, 1.0, 0.0, 0.0])
