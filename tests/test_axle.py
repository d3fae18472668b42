"""An axle's lateral force from its two tires."""

import dataclasses

import numpy as np
import pytest

from lpvmpc.car import axle, tire
from lpvmpc.plant.mjcf import compile_model, packaged_car, tires
from lpvmpc.units import GRAVITY


@pytest.fixture(scope="module")
def car():
    return packaged_car()


@pytest.fixture(scope="module")
def pair(car):
    return axle.axles(car, *tires(compile_model()))


def test_the_slope_at_rest_is_the_axles_cornering_stiffness(car, pair):
    for one, C in zip(pair, (car.Cf, car.Cr), strict=True):
        slope, offset = axle.tangent(one, 0.0, 0.0, 0.0, 1.0, 1.0)
        assert slope == pytest.approx(C, rel=1e-3)  # difference quotient over 1 mrad
        assert offset == pytest.approx(0.0, abs=1e-9)


def test_loads_balance_weight_braking_and_roll(car, pair):
    """Twice the static loads are the weight; pitch balances m a h, roll balances the moment."""
    front, rear = pair
    assert 2.0 * (front.load + rear.load) == pytest.approx(car.m * GRAVITY, rel=1e-12)
    assert 2.0 * rear.pitch * car.wheelbase == pytest.approx(car.m * car.h, rel=1e-12)
    assert front.pitch == -rear.pitch
    ay = 4.0
    phi = car.m * car.h * ay / car.K_phi
    carried = phi * (front.roll * car.track_f + rear.roll * car.track_r)
    # the springs carry m ay h and the weight that has moved sideways
    expected = car.m * ay * car.h + car.m * GRAVITY * car.h * phi
    assert carried == pytest.approx(expected, rel=1e-12)


def test_the_force_is_odd_in_slip_and_roll(pair):
    for one in pair:
        left = axle.lateral_force(one, 0.05, 0.03, -2.0, 0.8)
        right = axle.lateral_force(one, -0.05, -0.03, -2.0, 0.8)
        assert left == pytest.approx(-right, rel=1e-12)


def test_roll_braking_and_ice_reduce_the_grip(pair):
    for one in pair:
        free = axle.lateral_force(one, 0.1, 0.0, 0.0, 1.0)
        assert axle.lateral_force(one, 0.1, 0.05, 0.0, 1.0) < free
        assert axle.lateral_force(one, 0.1, 0.0, 0.0, 0.5) < 0.6 * free
    front, rear = pair
    # braking moves load forward, and takes grip from both
    assert axle.lateral_force(front, 0.1, 0.0, -5.0, 1.0) > axle.lateral_force(
        rear, 0.1, 0.0, -5.0, 1.0
    )
    assert axle.lateral_force(rear, 0.1, 0.0, -5.0, 1.0) < axle.lateral_force(
        rear, 0.1, 0.0, 0.0, 1.0
    )


def test_the_tangent_touches_the_force_and_its_offset_is_the_friction_sensitivity(pair):
    """By similarity dFy/dmu = (Fy - C alpha) / mu, where no longitudinal force takes part."""
    one, alpha, mu, h = pair[0], 0.07, 0.7, 1e-4
    C, F0 = axle.tangent(one, alpha, 0.02, 0.0, mu, 1.0)
    force = axle.lateral_force(one, alpha, 0.02, 0.0, mu)
    assert pytest.approx(force, rel=1e-12) == C * alpha + F0
    above = axle.lateral_force(one, alpha, 0.02, 0.0, mu + h)
    below = axle.lateral_force(one, alpha, 0.02, 0.0, mu - h)
    assert (above - below) / (2 * h) == pytest.approx(F0 / mu, rel=1e-3)  # two quotients


def test_past_the_peak_the_slope_stays_positive(pair):
    C, F0 = axle.tangent(pair[0], 0.4, 0.0, 0.0, 0.5, 5000.0)
    assert C == 5000.0
    assert np.isfinite(F0)


def test_both_tires_without_roll_are_twice_one_tire(car, pair):
    one = pair[1]
    Fy = tire.forces(one.tire, 0.0, 0.06, one.load, 0.9)[1]
    assert axle.lateral_force(one, 0.06, 0.0, 0.0, 0.9) == pytest.approx(2.0 * Fy, rel=1e-12)


def test_the_roll_share_moves_load_transfer_to_the_front(car):
    stiff = dataclasses.replace(car, roll_share_front=0.7)
    front, rear = axle.axles(stiff, *tires(compile_model()))
    assert front.roll > rear.roll
