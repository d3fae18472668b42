"""Traction control: how much drive the front wheels take, told by their speeds.

The MPC plans an acceleration, the motor spins a wheel: an inner front wheel that is out of grip
takes the outer one's drive with it, and its side force. No model of the controller sees that.
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
