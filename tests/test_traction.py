"""Traction control by itself; test_mpc.py has it in the controller."""

import numpy as np
import pytest

from lpvmpc.control.traction import (
    BELOW,
    BRAKE_RELEASE,
    BRAKING,
    CAUTION,
    FORGET,
    FRICTION_MIN,
    LET_GO,
    LOCKING,
    LOCKS,
    PROBE,
    REGAIN,
    RELEASE,
    SLIP_RATIO,
    SLOWER,
    UNLOCK,
    bend_holds,
    hold,
    hold_brakes,
    left_for_brakes,
    pace,
    road_holds,
)
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


def braked(car, slip, *, allowed=np.inf, holds=np.inf, a=-6.0, vx=15.0, friction=1.0, wheel=1):
    """Braking allowed, and held by the road, when one wheel is slower than its road."""
    spin = np.full(4, vx / car.R_w)
    spin[wheel] *= 1.0 - slip
    return hold_brakes(
        allowed, holds, 9.0, a, spin, vx, 0.0, friction, car.R_w, 0.5 * car.track_f, car.vx_min, TS
    )


@pytest.mark.parametrize("wheel", range(4))
def test_a_locking_wheel_is_let_go_and_braked_a_little_less_afterwards(car, wheel):
    assert braked(car, 0.9 * LOCKING, wheel=wheel) == (9.0, 9.0)
    allowed, holds = braked(car, 1.0, wheel=wheel)
    assert (allowed, holds) == pytest.approx((UNLOCK * BELOW * 6.0, BELOW * 6.0))
    # still locked while it is let go: nothing new is learned, though less is braked with
    again = braked(car, 0.5, allowed=allowed, holds=holds, a=-3.0, wheel=wheel)
    assert again == pytest.approx((LET_GO * allowed, holds + FORGET * TS))
    # it turns again: back to what the road holds, and no further
    for _ in range(20):
        allowed, holds = braked(car, 0.0, allowed=allowed, holds=holds, a=-3.0, wheel=wheel)
        assert allowed <= holds
    assert allowed == holds
    assert BRAKE_RELEASE > 0.0


def test_a_bend_takes_its_share_of_the_brakes(car):
    assert left_for_brakes(10.0, 0.0, 0.8, np.inf, 7.4) == pytest.approx(0.8 * BRAKING)
    full = left_for_brakes(10.0, 0.8 * 7.4 / 100.0, 0.8, np.inf, 7.4)
    assert 0.0 < full < 0.5 * 0.8 * BRAKING
    assert left_for_brakes(10.0, 0.0, 1.0, 2.0, 7.4) == 2.0


def test_a_reference_that_the_road_takes_is_driven_as_it_is(car):
    vx, kappa = np.linspace(20.0, 18.0, 80), np.full(80, 0.01)
    np.testing.assert_array_equal(pace(vx, kappa, 1.0, np.inf, np.inf, car.ay_limit, TS), vx)


@pytest.mark.parametrize(("friction", "holds"), [(0.6, np.inf), (1.0, 3.9), (1.0, np.inf)])
def test_a_bend_that_the_road_does_not_take_is_braked_for_in_time(car, friction, holds):
    """A straight, then a bend that asks for 1.4 times the limit of a dry road."""
    n, bend = 150, 100
    vx = np.full(n, 20.0)
    kappa = np.where(np.arange(n) < bend, 0.0, 1.4 * car.ay_limit / 400.0)
    out = pace(vx, kappa, friction, holds, np.inf, car.ay_limit, TS)
    believed = min(friction, holds / LOCKS)
    turning = out[bend:] ** 2 * kappa[bend:]
    assert turning == pytest.approx(np.full(n - bend, believed * car.ay_limit))
    assert out[0] == 20.0 and (np.diff(out[:bend]) <= 0.0).all()
    # what the car brakes with over the ground that the reference point covers
    decel = -0.5 * np.diff(out[:bend] ** 2) / (20.0 * TS)
    share = 1.0 if believed == 1.0 else CAUTION
    assert decel.max() <= share * min(BRAKING * believed, holds) + 1e-9
    assert decel[-1] > 0.5 * BRAKING * believed


def test_brakes_that_are_far_from_locking_are_tried_harder(car):
    _, slow = braked(car, 0.0, allowed=3.0, holds=3.0, a=-1.0)
    _, quick = braked(car, 0.0, allowed=3.0, holds=3.0, a=-3.0)
    assert (slow, quick) == pytest.approx((3.0 + FORGET * TS, 3.0 + PROBE * TS))


def test_a_wheel_that_locks_in_a_bend_says_little_of_the_road(car):
    limit = car.ay_limit
    straight = road_holds(np.inf, np.inf, 3.8, 9.0, -4.0, 0.0, limit, TS)
    assert straight == pytest.approx(BELOW * 4.0)
    in_a_bend = road_holds(np.inf, np.inf, 1.5, 9.0, -1.0, 0.9 * limit, limit, TS)
    assert in_a_bend == pytest.approx(np.hypot(BELOW, 0.9 * LOCKS))
    # no wheel locked: what was learned is forgotten slowly
    assert road_holds(4.0, 2.0, 2.0 + FORGET * TS, 9.0, -1.0, 0.0, limit, TS) == 4.0 + FORGET * TS


@pytest.mark.parametrize(
    ("slips", "friction", "slides"),
    [((0.16, 0.03), 0.8, True), ((0.16, 0.03), 1.0, False), ((0.05, -0.12), 1.0, True),
     ((0.05, 0.03), 0.8, False)],
)
def test_a_bend_in_which_an_axle_slid_is_driven_slower(car, slips, friction, slides):
    cap, asked = 0.17 * friction, 0.9 * friction * car.ay_limit
    grip = bend_holds(np.inf, np.array(slips), cap, asked, friction, car.ay_limit, TS)
    assert grip == (SLOWER * asked if slides else np.inf)
    # no bend: a slide there says nothing of the next one
    assert bend_holds(5.0, np.array(slips), cap, 0.1, friction, car.ay_limit, TS) == 5.0
    # the same bend without sliding: a little faster the next time
    calm = bend_holds(5.0, np.array([0.05, 0.02]), cap, 4.9, friction, car.ay_limit, TS)
    assert calm == pytest.approx(5.0 + REGAIN * TS)
    # and what is learned holds for what lies ahead
    kappa = np.full(60, 5.0 / 300.0)
    out = pace(np.full(60, 20.0), kappa, 1.0, np.inf, 5.0, car.ay_limit, TS)
    assert out**2 * kappa == pytest.approx(np.full(60, 5.0))
