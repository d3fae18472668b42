"""How much drive, brake and speed the road takes, told by wheel speeds and estimated friction.

The reference may ask for more than the car has: that of a road that is slippery and was thought
dry, or one that nobody checked. What no car of this friction can do is not tried: the car slows
down early, instead of leaving the road in the bend.

The MPC plans an acceleration, the motor spins a wheel: an inner front wheel that is out of grip
takes the outer one's drive with it, and its side force. Brakes that are asked for more than the
road holds lock the front wheels, which then steer no more. No model of the controller sees either.
"""

from __future__ import annotations

import math

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
LOCKING = 0.15
"""Slip of a braked wheel that is on its way to lock, on a dry road [-]: the tires' peak."""
UNLOCK = 0.5
"""What is braked with while a wheel is locked, as a share of what locked it [-]: little enough for
the road to spin it up again."""
BELOW = 0.95
"""What is braked with afterwards, as a share of what locked it [-]."""
FORGET = 1.0
"""Rate at which what locked a wheel is forgotten [m/s3]: roads change."""
BRAKE_MIN = 1.5
"""Least braking that stays allowed [m/s2]."""
DRY = 0.97
"""Friction from which on the road counts as dry: estimates are noisy."""
BRAKING = 6.0
"""What the brakes are believed to give where no bend takes its share, on a dry road [m/s2]; the
front wheels lock at a little above 7."""


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
def hold_brakes(allowed, holds, most, a, wheel_speed, vx, r, friction, R_w, half_track, vx_min, Ts):
    """Strongest braking to ask for, so that no wheel stays locked.

    A wheel that locks tells what the road holds: a little less is braked with from then on, after
    the wheel turns again.

    Args:
        allowed: What was allowed in the period before, positive [m/s2]; infinite at the start.
        holds: What the road is believed to hold, positive [m/s2]; infinite at the start.
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
        The braking, and what the road is believed to hold, positive [m/s2].
    """
    slip = 0.0
    for i in range(4):
        side = -half_track if i % 2 == 0 else half_track
        speed = max(vx + side * r, vx_min)
        slip = max(slip, 1.0 - wheel_speed[i] * R_w / speed)
    holds = min(holds + FORGET * Ts, most)
    bound = LOCKING * min(max(friction, FRICTION_MIN), 1.0)
    if slip > bound and vx > 2.0 * vx_min:
        if allowed > UNLOCK * holds + BRAKE_RELEASE * Ts:  # not the lock that is being released
            holds = min(holds, max(-BELOW * a, BRAKE_MIN))
        return UNLOCK * holds, holds
    return min(allowed + BRAKE_RELEASE * Ts, holds), holds


LOCKS = 6.5
"""Braking at which wheels lock, on a dry road, less what a lock is told by early [m/s2]."""


@njit(cache=True)
def left_for_brakes(vx, turn, friction, holds, ay_limit):
    """What a bend leaves of the brakes, by the ellipse of friction [m/s2].

    Args:
        vx: Speed [m/s].
        turn: Curvature, or yaw rate over speed [1/m].
        friction: Scale of the road's friction [-].
        holds: See `hold_brakes`.
        ay_limit: Largest lateral acceleration on a dry road [m/s2].
    """
    used = min(vx * vx * abs(turn) / (friction * ay_limit), 1.0)
    return min(BRAKING * friction, holds) * max(math.sqrt(1.0 - used * used), 0.35)


@njit(cache=True)
def pace(vx_ref, kappa, friction, holds, ay_limit, Ts):
    """Reference speed that a road of this friction takes: bends, and braking early enough for them.

    Args:
        vx_ref: Reference speed at the ends of the periods [m/s], shape (n,).
        kappa: Curvature there [1/m], shape (n,).
        friction: Scale of the road's friction [-].
        holds: Braking that the road is believed to hold, positive [m/s2].
        ay_limit: Largest lateral acceleration on a dry road [m/s2].
        Ts: Control period [s].

    Returns:
        Speeds, none above the reference's, shape (n,).
    """
    out = vx_ref.copy()
    friction = min(friction, holds / LOCKS)  # brakes that locked knew before the bend
    if friction >= DRY:
        friction = 1.0
    grip = friction * ay_limit
    for k in range(len(out)):
        if out[k] * out[k] * abs(kappa[k]) > grip:
            out[k] = math.sqrt(grip / abs(kappa[k]))
    for k in range(len(out) - 2, -1, -1):
        ds = 0.5 * (vx_ref[k] + vx_ref[k + 1]) * Ts
        brakes = left_for_brakes(out[k + 1], kappa[k + 1], friction, holds, ay_limit)
        out[k] = min(out[k], math.sqrt(out[k + 1] * out[k + 1] + 2.0 * brakes * ds))
    return out
