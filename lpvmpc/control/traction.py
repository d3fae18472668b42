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

from lpvmpc.car.bicycle import VX, R

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
LET_GO = 0.95
"""What of that is left one period later, while the wheel stays locked [-]."""
BELOW = 0.95
"""What is braked with afterwards, as a share of what locked it [-]."""
FORGET = 1.0
"""Rate at which what locked a wheel is forgotten [m/s3]: roads change."""
PROBE = 4.0
"""The same while as much is braked with and no wheel is near to lock [m/s3]."""
BRAKE_MIN = 1.5
"""Least braking that stays allowed [m/s2]."""
DRY = 0.97
"""Friction from which on the road counts as dry: estimates are noisy."""
BRAKING = 6.0
"""What the brakes are believed to give where no bend takes its share, on a dry road [m/s2]; the
front wheels lock at a little above 7."""
CAUTION = 0.85
"""What of that is planned with where the road is slippery [-]: brakes that lock give less."""


@njit(cache=True)
def hold(
    allowed, most, a, wheel_speed, vx, r, friction, R_w, half_track, vx_min, Ts, drive_front=1.0
):
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
        drive_front: Share of the drive on the front axle [-]; without one, the rear wheels tell.

    Returns:
        The acceleration [m/s2].
    """
    turn = half_track * r
    first = 0 if drive_front > 0.0 else 2
    left = wheel_speed[first] * R_w / max(vx - turn, vx_min)
    right = wheel_speed[first + 1] * R_w / max(vx + turn, vx_min)
    if 0.0 < drive_front < 1.0:
        left = max(left, wheel_speed[2] * R_w / max(vx - turn, vx_min))
        right = max(right, wheel_speed[3] * R_w / max(vx + turn, vx_min))
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
    bound = LOCKING * min(max(friction, FRICTION_MIN), 1.0)
    probed = allowed >= holds and -a > 0.8 * holds and slip < 0.5 * bound
    holds = min(holds + (PROBE if probed else FORGET) * Ts, most)
    if slip > bound and vx > 2.0 * vx_min:
        if allowed > UNLOCK * holds + BRAKE_RELEASE * Ts:  # not the lock that is being released
            holds = min(holds, max(-BELOW * a, BRAKE_MIN))
            return UNLOCK * holds, holds
        return LET_GO * allowed, holds
    return min(allowed + BRAKE_RELEASE * Ts, holds), holds


LOCKS = 6.5
"""Braking at which wheels lock, on a dry road, less what a lock is told by early [m/s2]."""


@njit(cache=True)
def road_holds(road, before, holds, most, a, ay, ay_limit, Ts):
    """Braking that the road would hold on a straight: what locked a wheel and what the bend took.

    In a bend the inner wheel carries little and locks early. That says little of the road, and
    nothing of the speed that the next bend takes.

    Args:
        road: What this function gave in the period before [m/s2]; infinite at the start.
        before: What `hold_brakes` said the road holds in the period before [m/s2].
        holds: What it says now [m/s2].
        most: What the brakes can give, positive [m/s2].
        a: What is driven or braked with now [m/s2].
        ay: Lateral acceleration [m/s2].
        ay_limit: Largest lateral acceleration on a dry road [m/s2].
        Ts: Control period [s].
    """
    road = min(road + FORGET * Ts, most)
    if holds < min(before + FORGET * Ts, most):  # a wheel has just locked
        road = min(road, max(math.hypot(BELOW * a, LOCKS * ay / ay_limit), BRAKE_MIN))
    return road


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
    return min(BRAKING * friction, holds) * max(math.sqrt(1.0 - used * used), 0.2)


FULL = 0.9
"""Slip of an axle from which on it gives no more, as a share of the slip cap [-]."""
FULL_REAR = 0.6
"""The same of the rear axle, which slides without being steered there [-]."""
SLOWER = 0.95
"""Lateral acceleration that is asked for instead, as a share of what was asked [-]."""
REGAIN = 0.3
"""Rate at which that rises again in a bend that is driven so without sliding [m/s3]."""


@njit(cache=True)
def bend_holds(grip, slips, cap, asked, friction, ay_limit, Ts):
    """Lateral acceleration that bends are driven with, less once an axle has slid in one.

    Friction alone does not tell: an axle may hold less than the other, or carry more.

    Args:
        grip: What this function gave in the period before [m/s2]; infinite at the start.
        slips: Slip angles of the axles [rad], shape (2,).
        cap: Slip angle at the tires' peak on this road [rad].
        asked: Lateral acceleration of the reference at this speed, positive [m/s2].
        friction: Scale of the road's friction [-].
        ay_limit: Largest lateral acceleration on a dry road [m/s2].
        Ts: Control period [s].
    """
    front, rear = abs(slips[0]) > FULL * cap, abs(slips[1]) > FULL_REAR * cap
    # on a dry road the front axle of a car at its limit is where the reference wants it
    if (rear or (front and friction < DRY)) and asked > 0.5 * friction * ay_limit:
        return min(grip, SLOWER * asked)
    calm = abs(slips[0]) < 0.7 * FULL * cap and abs(slips[1]) < 0.7 * FULL_REAR * cap
    return grip + REGAIN * Ts if calm and asked > 0.8 * grip else grip


@njit(cache=True)
def pace(vx_ref, kappa, friction, holds, bend, ay_limit, Ts):
    """Reference speed that a road of this friction takes: bends, and braking early enough for them.

    Args:
        vx_ref: Reference speed at the ends of the periods [m/s], shape (n,).
        kappa: Curvature there [1/m], shape (n,).
        friction: Scale of the road's friction [-].
        holds: Braking that the road is believed to hold, positive [m/s2].
        bend: Lateral acceleration that bends are driven with at most [m/s2].
        ay_limit: Largest lateral acceleration on a dry road [m/s2].
        Ts: Control period [s].

    Returns:
        Speeds, none above the reference's, shape (n,).
    """
    out = vx_ref.copy()
    friction = min(friction, holds / LOCKS)  # brakes that locked knew before the bend
    share = CAUTION
    if friction >= DRY:
        friction = share = 1.0
    grip = min(friction * ay_limit, bend)
    for k in range(len(out)):
        if out[k] * out[k] * abs(kappa[k]) > grip:
            out[k] = math.sqrt(grip / abs(kappa[k]))
    for k in range(len(out) - 2, -1, -1):
        ds = 0.5 * (vx_ref[k] + vx_ref[k + 1]) * Ts
        brakes = share * left_for_brakes(out[k + 1], kappa[k + 1], friction, holds, ay_limit)
        out[k] = min(out[k], math.sqrt(out[k + 1] * out[k + 1] + 2.0 * brakes * ds))
    return out


@njit(cache=True)
def protect_wheels(h, a, wheel_speed, friction):
    """What to drive and brake with at most, so that no wheel spins or stays locked.

    Args:
        h: Handle of a `Horizon`, whose `allowed` remembers.
        a: What is driven or braked with now [m/s2].
        wheel_speed: Spin of the wheels [rad/s], shape (4,).
        friction: Scale of the road's friction [-].

    Returns:
        Force of the drive [N], and braking, positive [m/s2].
    """
    R_w, half_track, vx_min, ay_limit, drive_front = h.wheels
    ax_min, force, _, m_eff = h.drive
    allowed, vx, r = h.allowed, h.x_last[VX], h.x_last[R]
    allowed[0] = hold(
        allowed[0], force / m_eff, a, wheel_speed, vx, r, friction, R_w, half_track, vx_min, h.Ts,
        drive_front,
    )
    before = allowed[2]
    allowed[1], allowed[2] = hold_brakes(
        allowed[1], before, -ax_min, a, wheel_speed, vx, r, friction, R_w, half_track, vx_min, h.Ts
    )
    allowed[3] = road_holds(allowed[3], before, allowed[2], -ax_min, a, vx * r, ay_limit, h.Ts)
    return m_eff * allowed[0], allowed[1]


@njit(cache=True)
def protect_pace(h, kappa, vx_ref, friction, slip_cap):
    """Reference speed that the road takes, by all that is known of it; see `pace`.

    Args:
        h: Handle of a `Horizon`, whose `allowed` remembers and whose `slips` tell who slides.
        kappa: Curvature at the ends of the periods [1/m], shape (n,).
        vx_ref: Reference speed there [m/s], shape (n,).
        friction: Scale of the road's friction [-].
        slip_cap: Slip angle of the front tires' peak on a dry road [rad].
    """
    ay_limit, slippery = h.wheels[3], min(friction, 1.0)
    asked = h.x_last[VX] ** 2 * abs(kappa[0])
    h.allowed[4] = bend_holds(
        h.allowed[4], h.slips, slip_cap * slippery, asked, slippery, ay_limit, h.Ts
    )
    return pace(vx_ref, kappa, friction, h.allowed[3], h.allowed[4], ay_limit, h.Ts)


@njit(cache=True)
def left_now(h, friction):
    """What the bend in which the car is leaves of the brakes, positive [m/s2]; h as above."""
    vx, ay_limit = max(h.x_last[VX], h.wheels[2]), h.wheels[3]
    return left_for_brakes(vx, h.x_last[R] / vx, min(friction, 1.0), h.allowed[2], ay_limit)
