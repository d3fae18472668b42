"""Traction control by itself; test_mpc.py has it in the controller."""

import numpy as np
import pytest

from lpvmpc.control.traction import FRICTION_MIN, RELEASE, SLIP_RATIO, hold
from lpvmpc.plant.mjcf import packaged_car

TS, MOST = 0.033, 3.0


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def held(car, slip, *, allowed=float("inf"), a=2.0, friction=1.0, vx=10.0, r=0.0, wheel=0):
    """What is allowed when one front wheel is faster than its road by a slip ratio."""
    half_track = 0.5 * car.track_f
    spin = [(vx - half_track * r) / car.R_w, (vx + half_track * r) / car.R_w, 0.0, 0.0]
    spin[wheel] *= 1.0 + slip
    return hold(
        allowed, MOST, a, np.array(spin), vx, r, friction, car.R_w, half_track, car.vx_min, TS
    )


@pytest.mark.parametrize("wheel", [0, 1])
@pytest.mark.parametrize("r", [0.0, -0.6, 0.6])
def test_a_spinning_wheel_takes_the_drive_back(car, wheel, r):
    assert held(car, 0.9 * SLIP_RATIO, r=r, wheel=wheel) == MOST
    # half the drive at twice the slip
    assert held(car, 2.0 * SLIP_RATIO, r=r, wheel=wheel) == pytest.approx(1.0)


def test_a_rolling_wheel_gives_it_again_by_and_by(car):
    assert held(car, 0.0, allowed=1.0) == pytest.approx(1.0 + RELEASE * TS)
    assert held(car, 0.0, allowed=MOST) == MOST


def test_a_slippery_road_allows_less_slip(car):
    slip = 0.8 * SLIP_RATIO
    assert held(car, slip) == MOST
    assert held(car, slip, friction=0.6) < 2.0
    # what the estimate says of less friction is not believed
    assert held(car, slip, friction=0.2) == held(car, slip, friction=FRICTION_MIN)


def test_braking_is_not_held(car):
    assert held(car, -0.5, a=-4.0) == MOST
    assert held(car, 1.0, a=-4.0) == 0.0
