"""Traction and anti-lock control: how much drive and brake the wheels take, told by their speeds.

The MPC plans an acceleration, the motor spins a wheel: an inner front wheel that is out of grip
takes the outer one's drive with it, and its side force. Brakes that are asked for more than the
road holds lock the front wheels, which then steer no more. No model of the controller sees either.
"""

from __future__ import annotations

from numba import njit

SLIP_RATIO = 0.1
"""Slip of a driven wheel from which on the drive is held back, on a dry road [-]: two thirds of the
tires' peak, which moves to smaller slip with the friction."""
FRICTION_MIN = 0.5
"""Smallest friction that is believed here: where little grip is used the estimate drifts."""
RELEASE = 6.0
"""Rate at which the drive is released again [m/s3]."""
BRAKE_RELEASE = 15.0
"""The same of the brakes [m/s3]: a car that does not brake runs wide at the next bend."""


@njit(cache=True)
def hold(allowed, most, a, wheel_speed, vx, r, friction, R_w, half_track, vx_min, Ts):
    """Largest acceleration to ask for, so that no driven wheel spins.

    Where the wheel speeds tell more slip than `SLIP_RATIO` times the friction, less than what is
    driven with now, in proportion; from there on it rises by at most `RELEASE`.

    Args:
        allowed: What was allowed in the period before [m/s2]; infinite at the start.
        most: What motor torque allows [m/s2].
        a: What is driven with now [m/s2].
        wheel_speed: Spin of the wheels fl, fr, rl, rr [rad/s], shape (4,).
        vx: Speed [m/s].
        r: Yaw rate [rad/s].
        friction: Scale of the road's friction [-].
        R_w: Radius of a wheel [m].
        half_track: Half the front track [m].
        vx_min: Speed below which slip means nothing [m/s].
        Ts: Control period [s].

    Returns:
        The acceleration [m/s2].
    """
    turn = half_track * r
    left = wheel_speed[0] * R_w / max(vx - turn, vx_min)
    right = wheel_speed[1] * R_w / max(vx + turn, vx_min)
    slip = max(left, right) - 1.0
    allowed = min(allowed + RELEASE * Ts, most)
    bound = SLIP_RATIO * min(max(friction, FRICTION_MIN), 1.0)
    if slip > bound:
        allowed = min(allowed, max(a, 0.0) * bound / slip)
    return allowed


@njit(cache=True)
def hold_brakes(allowed, most, a, wheel_speed, vx, r, friction, R_w, half_track, vx_min, Ts):
    """Strongest braking to ask for, so that no wheel locks.

    Args:
        allowed: What was allowed in the period before, positive [m/s2]; infinite at the start.
        most: What the brakes can give, positive [m/s2].
        a: What is driven or braked with now [m/s2].
        wheel_speed: See `hold`, also for the rest.
        vx: As above.
        r: As above.
        friction: As above.
        R_w: As above.
        half_track: As above.
        vx_min: As above.
        Ts: As above.

    Returns:
        The braking, positive [m/s2].
    """
    slip = 0.0
    for i in range(4):
        side = -half_track if i % 2 == 0 else half_track
        speed = max(vx + side * r, vx_min)
        slip = max(slip, 1.0 - wheel_speed[i] * R_w / speed)
    allowed = min(allowed + BRAKE_RELEASE * Ts, most)
    bound = SLIP_RATIO * min(max(friction, FRICTION_MIN), 1.0)
    if slip > bound and vx > 2.0 * vx_min:
        allowed = min(allowed, max(-a, 0.0) * bound / slip)
    return allowed
