"""The compiled numerics of one control period: model, references, bounds, QP, and what follows.

One call from Python tells what the last period taught and where the plan begins (`estimate`), one
builds the whole QP (`write`), one makes its solution the plan (`accept`), one carries it into the
next period (`shift`): each call costs its own, and numbers that go through Python cost more than
those that stay here.

Arguments that recur: h, the handle of a `Horizon`, whose fields are told there; kappa [1/m] and
vx_ref [m/s], the reference at the ends of the periods, from now or, after the delay, from where the
plan begins; car, the `Bicycle` of `h.car`. States and inputs are those of `bicycle`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import (
    AF,
    DELTA,
    EPSI,
    EY,
    NU,
    NX,
    VX,
    VY,
    A,
    R,
    lpv,
    steady_state,
    unpack,
)
from lpvmpc.car.hold import EULER, hold
from lpvmpc.control.cost import terminal_weight
from lpvmpc.control.disturbance import LIMIT, quiet, update
from lpvmpc.control.formulation import EY_MAX
from lpvmpc.control.qp import condense
from lpvmpc.control.traction import left_now, protect_pace, protect_wheels

NEAR = 0.15
"""A car that is no further beside its path than this is pulled onto it [m]."""
BACK = 1.5
"""Time constant with which one that is further is led back [s]."""
BENT = 0.06
"""Slip angle from where on a late command is as soft as at the limit [rad]."""


@njit(cache=True)
def freeze(h, kappa, car):
    """Freeze the LPV model along the schedule and discretise it, in place.

    One row of axle forces and one model serve N / n periods; the exact hold is frozen in the middle
    of them, Euler at their start, as the paper's.
    """
    schedule, tires, disturbance = h.schedule, h.axle_forces, h.disturbance
    Ad, Bd, cd, form, method, Ts = h.Ad, h.Bd, h.cd, h.form, h.method, h.Ts
    span = Ad.shape[0] // tires.shape[0]
    A_, B_, c_ = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    inputs, held = np.empty((NX, NU + 1)), np.empty((NX, NU + 1))
    where = np.empty(NX)
    for n in range(tires.shape[0]):
        k = n * span
        end = k if method == EULER else k + span
        for i in range(NX):
            where[i] = 0.5 * (schedule[k, i] + schedule[end, i])
        lpv(where, 0.5 * (kappa[k] + kappa[end]), tires[n], car, form, A_, B_, c_)
        if h.decoupled:  # what steers does not brake: its effect on the speed is taken as planned
            for j in range(NX):
                if j != VX and j != A:
                    c_[VX] += A_[VX, j] * where[j]
                    A_[VX, j] = 0.0
            c_[VX] += B_[VX, 0] * where[DELTA]  # of a steering without lag
            B_[VX, 0] = 0.0
        for i in range(NX):
            for m in range(NU):
                inputs[i, m] = B_[i, m]
            inputs[i, NU] = c_[i] + (disturbance[i] if i < 3 else 0.0)
        hold(A_, inputs, Ts, method, Ad[k], held)
        if car.tau_delta == 0.0:  # the steering follows at once
            Ad[k, DELTA, DELTA], held[DELTA, 0] = 0.0, 1.0
        if car.tau_ax == 0.0:
            Ad[k, A, A], held[A, 1] = 0.0, 1.0
        for j in range(k, k + span):
            for i in range(NX):
                for m in range(NX):
                    Ad[j, i, m] = Ad[k, i, m]
                for m in range(NU):
                    Bd[j, i, m] = held[i, m]
                cd[j, i] = held[i, NU]


@njit(cache=True)
def references(h, kappa, vx_ref, car):
    """State reference at steps 1..N of the horizon, in place."""
    tires, disturbance, steady, x_ref = h.axle_forces, h.disturbance, h.steady, h.x_ref
    schedule = h.schedule
    N = x_ref.shape[0]
    aside = schedule[0, EY]
    excess = max(abs(aside) - NEAR, 0.0) if h.approach else 0.0
    span = N // tires.shape[0]
    for k in range(N):
        x_ref[k] = 0.0
        if steady:
            law = tires[k // span]
            vx = schedule[k + 1, VX] if h.decoupled else vx_ref[k + 1]
            steady_state(vx, kappa[k + 1], law, disturbance, car, x_ref[k])
        x_ref[k, VX] = vx_ref[k + 1]
        if excess > 0.0:  # led back to the path, not pulled
            ey = np.sign(aside) * excess * np.exp(-(k + 1) * h.Ts / BACK)
            x_ref[k, EY] = ey
            x_ref[k, EPSI] -= np.arctan(ey / BACK / max(schedule[k + 1, VX], car.vx_min))
    if h.approach:
        h.soft_bound[0] = EY_MAX + excess


@njit(cache=True)
def ahead(h, kappa, vx_ref):
    """Curvature where the car will be by its schedule, shape (N + 1,).

    The preview tells it where a point will be that moves at the reference speed; a car that is
    faster comes to it earlier. Linear between the preview's points, held beyond its last one.
    """
    schedule, Ts = h.schedule, h.Ts
    N = len(h.plan)
    out = np.empty(N + 1)
    out[0] = kappa[0]
    s, s_low, k = 0.0, 0.0, 0
    s_high = 0.5 * (vx_ref[0] + vx_ref[1]) * Ts
    for i in range(1, N + 1):
        s += 0.5 * (schedule[i - 1, VX] + schedule[i, VX]) * Ts
        while s > s_high and k + 2 < len(vx_ref):
            k += 1
            s_low, s_high = s_high, s_high + 0.5 * (vx_ref[k] + vx_ref[k + 1]) * Ts
        share = (s - s_low) / (s_high - s_low) if s_high > s_low else 1.0
        share = min(max(share, 0.0), 1.0)
        out[i] = kappa[k] + share * (kappa[k + 1] - kappa[k])
    return out


@njit(cache=True)
def bounds(h, car, slip_cap, force, brakes):
    """Input bounds along the horizon, in place; always reachable within the increment bounds.

    Steering: +-delta_max, and no front slip angle above `slip_cap` [rad] along the schedule, since
    past the tire's peak more steering turns the car less. Acceleration: what the drive's `force`
    [N] and power allow at the speed of the schedule, and the brakes.
    """
    schedule, u_lo, u_hi, du_max, delta_max = h.schedule, h.u_lo, h.u_hi, h.du_max, h.delta_max
    ax_min, _, power, m_eff = h.drive
    u_prev = h.queue[-1]
    for k in range(u_lo.shape[0]):
        vx = max(schedule[k, VX], car.vx_min)
        flow = np.arctan2(schedule[k, VY] + car.lf * schedule[k, R], vx)
        u_lo[k, 0] = max(-delta_max, min(flow - slip_cap, delta_max))
        u_hi[k, 0] = min(delta_max, max(flow + slip_cap, -delta_max))
        u_lo[k, 1] = max(ax_min, -brakes)
        u_hi[k, 1] = min(force, power / vx) / m_eff
        for m in range(len(du_max)):  # what the increment bounds can reach is allowed
            least = (u_lo[k - 1, m] if k > 0 else u_prev[m]) - du_max[m]
            most = (u_hi[k - 1, m] if k > 0 else u_prev[m]) + du_max[m]
            u_lo[k, m] = min(max(u_lo[k, m], least), most)
            u_hi[k, m] = max(min(u_hi[k, m], most), least)


@njit(cache=True)
def write(h, kappa, vx_ref, wheel_speed, friction):
    """Model, references, bounds and QP of one period, in place.

    Args:
        h: See the head of this file, also for kappa and vx_ref: from now on, N + delay + 1 points.
        kappa: As above.
        vx_ref: As above.
        wheel_speed: Spin of the wheels [rad/s], shape (4,).
        friction: Scale of the road's friction as estimated [-].
    """
    car = unpack(h.car)
    delay = h.delay + int(h.lateness[0])
    kappa, vx_ref = kappa[delay:], vx_ref[delay:]
    goal, force, brakes = vx_ref, h.drive[1], -h.drive[0]
    if h.traction:
        force, brakes = protect_wheels(h, h.schedule[0, A], wheel_speed, friction)
        if h.decoupled:
            goal = protect_pace(h, kappa, vx_ref, friction, h.slip_cap)
            brakes = min(brakes, left_now(h, friction))
    if h.decoupled:
        kappa = ahead(h, kappa, vx_ref)
    if h.calm != 1.0:
        for k in range(len(h.plan)):
            for i in (EY, EPSI):
                h.q[k, i] = h.q_noisy[k, i] * (1.0 + (h.calm - 1.0) * h.quiet[1])
    freeze(h, kappa, car)
    references(h, kappa, goal, car)
    terminal_weight(h, goal[len(h.plan)], (car.tau_delta, car.tau_ax))
    # the tires' peak moves to smaller slip as the road gets slippery
    bounds(h, car, h.slip_cap * min(friction, 1.0), force, brakes)
    condense(h)


@njit(cache=True)
def accept(h, z):
    """Turn a QP solution z into the input plan and the states predicted after now, in place.

    Columns of the plan that the QP does not decide, and states that its model takes as measured,
    are left as they are and as they were.
    """
    plan, prediction, free, forced, scale = h.plan, h.prediction, h.free, h.forced, h.scale
    N, nx = free.shape
    nu = len(scale)
    first = prediction.shape[1] - nx
    for k in range(N):
        for m in range(nu):
            plan[k, m] = z[k * nu + m] * scale[m]
    for k in range(N):
        for i in range(first):
            prediction[k + 1, i] = h.schedule[0, i]
        for i in range(nx):
            value = free[k, i]
            for a in range((k + 1) * nu):
                value += forced[k, i, a] * z[a]
            prediction[k + 1, first + i] = value


@njit(cache=True)
def advance(h, x, x_next, kappa, kappa_next, u, out):
    """One-period prediction from x, with the model frozen between x and x_next, in place."""
    car, Ts, tires, disturbance = unpack(h.car), h.Ts, h.axle_forces[0], h.disturbance
    A_, B_, c_ = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    Ad, rate, held = np.empty((NX, NX)), np.zeros((NX, NU + 1)), np.empty((NX, NU + 1))
    where = np.empty(NX)
    for i in range(NX):
        where[i] = 0.5 * (x[i] + x_next[i])
    lpv(where, 0.5 * (kappa + kappa_next), tires, car, h.form, A_, B_, c_)
    for i in range(NX):
        rate[i, 0] = B_[i, 0] * u[0] + B_[i, 1] * u[1] + c_[i]
        if i < 3:
            rate[i, 0] += disturbance[i]
    hold(A_, rate, Ts, h.method, Ad, held)
    for i in range(NX):
        out[i] = held[i, 0]
        for j in range(NX):
            out[i] += Ad[i, j] * x[j]
    if car.tau_delta == 0.0:
        out[DELTA] = u[0]
    if car.tau_ax == 0.0:
        out[A] = u[1]


@njit(cache=True)
def estimate(h, x, kappa, compared, ax):
    """Learn from the measured state, and predict from it to where the plan begins, in place.

    Args:
        h: See the head of this file.
        x: Measured state, shape (11,); if `compared`, what cannot be measured is filled in.
        kappa: Curvature from now on [1/m].
        compared: Whether there is a period before, to compare its prediction with x.
        ax: Measured longitudinal acceleration [m/s2].

    Returns:
        Acceleration of the drive [m/s2].
    """
    if compared:
        compare(h, x, kappa[0], ax)
    h.x_last[:] = x
    h.kappa_last[0] = kappa[0]
    start, ahead = h.schedule[0], np.empty(NX)
    start[:] = x
    delay = h.delay + int(h.lateness[0])
    first = len(h.queue) - delay
    for i in range(delay):
        advance(h, start, start, kappa[i], kappa[i + 1], h.queue[first + i], ahead)
        start[:] = ahead
    h.knots[0] = start
    return x[A]


@njit(cache=True)
def compare(h, x, kappa, ax):
    """Compare the measured state with what the model expected for it, in place.

    Fills in what is not measured, tells the tires' error and the forces and slips that go with it
    (`unmodelled`, `acting`, `slips`) and what the drive gave
    (`driven`), and moves the disturbance.
    """
    predicted, disturbance = h.predicted, h.disturbance
    in_force = h.queue[len(h.queue) - 1 - h.delay - int(h.lateness[0])]
    advance(h, h.x_last, x, h.kappa_last[0], kappa, in_force, predicted)
    h.acting[:] = h.axle_forces[0]
    for i in range(2):
        h.unmodelled[i] = disturbance[1 + i] + (x[1 + i] - predicted[1 + i]) / h.Ts
        h.slips[i] = 0.5 * (h.x_last[AF + i] + predicted[AF + i])
    # what is measured of the speed's change, less what the model says of all but the drive
    drive = 0.5 * (h.x_last[A] + predicted[A])
    others = (predicted[VX] - h.x_last[VX]) / h.Ts - drive - disturbance[VX]
    h.driven[0] = ax + x[R] * x[VY] - others
    for i in range(A, NX):
        h.inner[i - A] = x[i] = predicted[i]
    gain = h.gain
    if h.calm != 1.0:
        # a command that comes late must not be a hard one, least of all where the tires bend
        late = 1.0 + h.delay + h.lateness[0]
        bent = min((max(abs(h.slips[0]), abs(h.slips[1])) / BENT) ** 2, 1.0)
        softer = (1.0 + (late - 1.0) * bent) ** 2
        gain = gain + h.quiet[0] / softer * np.maximum(h.calm_gain - gain, 0.0)
    update(disturbance, predicted, x, gain, LIMIT, h.walk, h.noise, h.error, h.Ts)
    if h.calm != 1.0:
        h.quiet[0] = quiet(predicted, x, h.noise, h.error, h.Ts)
        h.quiet[1] = h.quiet[0] / late ** (1.0 + bent)


@njit(cache=True)
def shift(h):
    """Make this period's plan and prediction the next one's fallback and schedule, in place."""
    plan, prediction, schedule, queue = h.plan, h.prediction, h.schedule, h.queue
    for i in range(len(queue) - 1):
        queue[i] = queue[i + 1]
    queue[-1] = plan[0]
    prediction[0] = schedule[0]
    for k in range(len(plan)):
        newest = 0.5 if h.damped and k + 1 < len(plan) else 1.0
        for i in range(prediction.shape[1]):
            before = schedule[k + 1, i] if newest < 1.0 else 0.0
            schedule[k, i] = newest * prediction[k + 1, i] + (1.0 - newest) * before
        if k + 1 < len(plan):
            plan[k] = plan[k + 1]
    schedule[-1] = prediction[-1]
    thin(schedule, h.knots)


@njit(cache=True)
def thin(schedule, knots):
    """The schedule at the ends of the intervals that share one frozen model, in place."""
    span = (len(schedule) - 1) // (len(knots) - 1)
    for i in range(len(knots)):
        knots[i] = schedule[i * span]
