"""The compiled numerics of `nmpc`: what a period begins with, its linearisation, its line search.

The plan is a row of inputs; the states follow from it by driving the model from where the plan
begins (single shooting), so that every plan that is looked at is one that the model can drive, and
its cost is the merit of the line search.

Arguments that recur: h, the handle of a `Horizon`; kappa [1/m], the curvature at the ends of the
periods along the plan, shape (N + 1,); xs and us, the states and inputs of the plan, shapes
(N + 1, 11) and (N, 2); model, learned as in `nmpc_model`; constants, `Limits`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import AF, AR, EPSI, EY, NU, NX, PHI, VX, VY, A, R
from lpvmpc.control.cost import terminal_weight
from lpvmpc.control.disturbance import LIMIT, update
from lpvmpc.control.period import BACK, NEAR, ahead, bounds
from lpvmpc.control.rivals.nmpc_model import (
    STEP,
    axle_force,
    linearised,
    period,
)
from lpvmpc.control.rivals.nmpc_steady import steady
from lpvmpc.control.traction import FRICTION_MIN, protect_pace, protect_wheels
from lpvmpc.units import GRAVITY

ELLIPSE = 0.95
"""Share of an axle's friction that drive or brakes and steering may use together [-]: the wheels'
slip, which the model does not have, needs the rest."""
ALWAYS = 0.15
"""Share of the friction that drive and brakes may always use [-]."""
SLOPE_MIN = 0.05
"""Smallest slope of a tangent that is told to the adaptation, as a share of that at rest."""
TRIES = 6
"""Step lengths that the line search tries: 1, 1/2, ..., 1/32."""
ENOUGH = 0.01
"""Share of the decrease that the quadratic program promises, per step length, that is enough."""
EXACT_ENOUGH = 0.02
"""The plan is done where cost and quadratic program differ by less than this share of the cost,"""
NOTHING = 1e-7
"""or by less than this: a lateral error of 50 um over one period."""


class Limits(NamedTuple):
    """Numbers of the car that bound the inputs."""

    mu: float
    """Friction of the tires on a dry road [-]."""
    m_eff: float
    """Mass with the wheels' spin [kg]."""
    brake_front: float
    """Share of the brakes on the front axle [-]."""
    protected: int
    """Whether slip cap, traction control and friction ellipse bound the inputs."""


@njit(cache=True)
def drive(h, kappa, model, learned, us, xs):
    """States of a plan, in place, and its cost [-]; infinite where they are not finite.

    sum_{k=1..N} |x_k - x_ref_k|^2_q + sum_{k=0..N-1} |u_k - u_{k-1}|^2_r_du
        + |(x_N, u_{N-1}) - z_ref|^2_terminal
    """
    N = len(us)
    xs[0] = h.schedule[0]
    for k in range(N):
        period(xs[k], us[k], kappa[k], kappa[k + 1], model, learned, h.disturbance, h.Ts, xs[k + 1])
    return cost(h, us, xs)


@njit(cache=True)
def cost(h, us, xs):
    """Cost of a plan and its states; see `drive`."""
    N = len(us)
    total = 0.0
    for k in range(N):
        for i in range(NX):
            error = xs[k + 1, i] - h.x_ref[k, i]
            total += h.q[k, i] * error * error
        for m in range(NU):
            step = us[k, m] - (us[k - 1, m] if k > 0 else h.queue[-1, m])
            total += h.r_du[m] * step * step
    e = np.empty(NX + NU)
    for i in range(NX):
        e[i] = xs[N, i] - h.z_ref[i]
    for m in range(NU):
        e[NX + m] = us[N - 1, m] - h.z_ref[NX + m]
    for i in range(NX + NU):
        for j in range(NX + NU):
            total += e[i] * h.terminal[i, j] * e[j]
    return total if np.isfinite(total) else np.inf


@njit(cache=True)
def _axle_room(mu, load, Fy):
    """Longitudinal force that an axle's friction leaves beside its lateral force [N]."""
    most = ELLIPSE * mu * max(load, 0.0)
    return math.sqrt(max(most * most - Fy * Fy, 0.0))


@njit(cache=True)
def _friction_ellipse(h, model, learned, limits, xs):
    """Tighten the bounds of the acceleration to what the friction of the axles leaves, in place."""
    car = model.car
    mu = limits.mu * max(learned[0], FRICTION_MIN)
    floor = ALWAYS * mu * GRAVITY
    L = car.lf + car.lr
    for k in range(len(h.u_lo)):
        x = xs[k + 1]
        Ff = axle_force(model, False, x[AF], x[PHI], x[A], learned)
        Fr = axle_force(model, True, x[AR], x[PHI], x[A], learned)
        brakes = mu * GRAVITY
        for _ in range(2):  # braking loads the front axle
            front = _axle_room(mu, car.m * (GRAVITY * car.lr + brakes * car.h) / L, Ff)
            rear = _axle_room(mu, car.m * (GRAVITY * car.lf - brakes * car.h) / L, Fr)
            brakes = min(front / limits.brake_front, rear / (1.0 - limits.brake_front))
            brakes /= limits.m_eff
        load = car.m * (GRAVITY * car.lr - max(x[A], 0.0) * car.h) / L
        h.u_lo[k, 1] = max(h.u_lo[k, 1], -max(brakes, floor))
        h.u_hi[k, 1] = min(h.u_hi[k, 1], max(_axle_room(mu, load, Ff) / limits.m_eff, floor))


@njit(cache=True)
def within(h, us):
    """Put inputs within their bounds and increments, in place."""
    for k in range(len(us)):
        for m in range(NU):
            value = min(max(us[k, m], h.u_lo[k, m]), h.u_hi[k, m])
            if m < len(h.du_max):
                last = us[k - 1, m] if k > 0 else h.queue[-1, m]
                value = min(max(value, last - h.du_max[m]), last + h.du_max[m])
            us[k, m] = value


@njit(cache=True)
def begin(h, kappa_seen, vx_ref, wheel_speed, model, learned, limits, slip_cap, kappa, us, xs):
    """Bounds, references and the plan that a period begins with, in place.

    Args:
        h: See the head of this file.
        kappa_seen: Curvature from where the plan begins, by the reference's speed [1/m].
        vx_ref: Reference speed, the same points [m/s].
        wheel_speed: Spin of the wheels [rad/s], shape (4,).
        model: See the head of this file, also for the next two.
        learned: As above.
        limits: As above.
        slip_cap: Largest front slip angle that a command may ask for, on a dry road [rad].
        kappa: Receives the curvature along the plan.
        us: Receives the plan, that of the period before.
        xs: Receives its states.

    Returns:
        Its cost; infinite where the model cannot drive it.
    """
    car, N, friction = model.car, len(us), min(learned[0], 1.0)
    kappa[:] = ahead(h, kappa_seen, vx_ref)
    goal, force, brakes = vx_ref, h.drive[1], -h.drive[0]
    if limits.protected:
        force, brakes = protect_wheels(h, h.schedule[0, A], wheel_speed, friction)
        goal = protect_pace(h, kappa_seen, vx_ref, learned[0], slip_cap)
    us[:] = h.plan
    for k in range(N):
        period(
            xs[k] if k > 0 else h.schedule[0], us[k], kappa[k], kappa[k + 1], model, learned,
            h.disturbance, h.Ts, xs[k + 1],
        )
    if not np.isfinite(np.sum(xs[1:])):
        return np.inf
    h.schedule[1:] = xs[1:]
    bounds(h, car, slip_cap * friction if limits.protected else np.pi, force, brakes)
    if limits.protected:
        _friction_ellipse(h, model, learned, limits, h.schedule)
    aside = h.schedule[0, EY]
    excess = max(abs(aside) - NEAR, 0.0)
    for k in range(N):
        x, ref = h.schedule[k + 1], h.x_ref[k]
        steady(x, kappa[k + 1], model, learned, h.disturbance, slip_cap * friction, ref)
        ref[VX] = goal[k + 1]
        if excess > 0.0:  # led back to the path, not pulled
            ref[EY] = np.sign(aside) * excess * np.exp(-(k + 1) * h.Ts / BACK)
            ref[EPSI] -= np.arctan(ref[EY] / BACK / max(x[VX], car.vx_min))
    terminal_weight(h, goal[N], (car.tau_delta, car.tau_ax))
    within(h, us)
    return drive(h, kappa, model, learned, us, xs)


@njit(cache=True)
def linearise(h, kappa, model, learned, us, xs):
    """Linearise every period along the plan into h.Ad, h.Bd, h.cd, in place."""
    S, x_next = np.empty((NX, NX + NU)), np.empty(NX)
    for k in range(len(us)):
        linearised(
            xs[k], us[k], kappa[k], kappa[k + 1], model, learned, h.disturbance, h.Ts, x_next, S
        )
        for i in range(NX):
            rest = x_next[i]
            for j in range(NX):
                h.Ad[k, i, j] = S[i, j]
                rest -= S[i, j] * xs[k, j]
            for m in range(NU):
                h.Bd[k, i, m] = S[i, NX + m]
                rest -= S[i, NX + m] * us[k, m]
            h.cd[k, i] = rest


@njit(cache=True)
def search(h, v, kappa, model, learned, before, us, xs):
    """Line search from the plan towards the solution of the quadratic program, in place.

    A step of length t is taken where the cost falls by at least `ENOUGH` t times what the quadratic
    program promises for a whole one.

    Args:
        h: See the head of this file.
        v: Variables of the program, as `staged_qp` orders them.
        kappa: See the head of this file, also for model, learned, us and xs.
        model: As above.
        learned: As above.
        before: Cost of the plan.
        us: As above; receives the new plan, which stays as it was where no step is good.
        xs: As above.

    Returns:
        Cost of the plan now, and whether it is done.

    Source: Nocedal and Wright, Numerical Optimization, sections 3.1 and 18.4.
    """
    N = len(us)
    goal, reached = np.empty((N, NU)), np.empty((N + 1, NX))
    first = NU
    for k in range(N):
        reached[k + 1] = v[first : first + NX]
        goal[k] = v[first + NX : first + NX + NU]
        first += NX + 2 * NU
    promised = cost(h, goal, reached)
    gain = before - promised
    if gain <= NOTHING:
        return before, True
    within(h, goal)
    plan, states = np.empty((N, NU)), np.empty((N + 1, NX))
    t = 1.0
    for _ in range(TRIES):
        for k in range(N):
            for m in range(NU):
                plan[k, m] = us[k, m] + t * (goal[k, m] - us[k, m])
        now = drive(h, kappa, model, learned, plan, states)
        if now <= before - ENOUGH * t * gain:
            us[:] = plan
            xs[:] = states
            done = t == 1.0 and abs(now - promised) <= EXACT_ENOUGH * now + NOTHING
            return now, done
        t *= 0.5
    return before, True


@njit(cache=True)
def compare(h, x, kappa, ax, model, learned):
    """Compare the measured state with what the model expected for it, in place.

    Fills in what is not measured, tells the tires' error and the tangents and slips that go with it
    (`unmodelled`, `acting`, `slips`) and what the drive gave (`driven`), and moves the disturbance.
    """
    predicted, disturbance = h.predicted, h.disturbance
    in_force = h.queue[len(h.queue) - 1 - h.delay - int(h.lateness[0])]
    last = h.x_last
    period(
        last, in_force, h.kappa_last[0], kappa, model, learned, disturbance, h.Ts, predicted
    )
    for i in range(2):
        h.unmodelled[i] = disturbance[1 + i] + (x[1 + i] - predicted[1 + i]) / h.Ts
        alpha = h.slips[i] = 0.5 * (last[AF + i] + predicted[AF + i])
        phi, a = 0.5 * (last[PHI] + predicted[PHI]), 0.5 * (last[A] + predicted[A])
        F = axle_force(model, i == 1, alpha, phi, a, learned)
        slope = (axle_force(model, i == 1, alpha + STEP, phi, a, learned) - F) / STEP
        C = max(slope, SLOPE_MIN * (model.Cr if i == 1 else model.Cf))
        h.acting[2 * i], h.acting[2 * i + 1] = C, F - C * alpha
    # what is measured of the speed's change, less what the model says of all but the drive
    others = (predicted[VX] - last[VX]) / h.Ts - 0.5 * (last[A] + predicted[A]) - disturbance[VX]
    h.driven[0] = ax + x[R] * x[VY] - others
    for i in range(A, NX):
        h.inner[i - A] = x[i] = predicted[i]
    if model.car.tau_ax == 0.0:
        h.inner[0] = x[A] = in_force[1]
    update(disturbance, predicted, x, h.gain, LIMIT, h.walk, h.noise, h.error, h.Ts)


@njit(cache=True)
def predict(h, x, kappa, compared, ax, model, learned):
    """Learn from the measured state, and predict from it to where the plan begins, in place.

    Args:
        h: See the head of this file.
        x: Measured state, shape (11,); if `compared`, what cannot be measured is filled in.
        kappa: Curvature from now on [1/m].
        compared: Whether there is a period before, to compare its prediction with x.
        ax: Measured longitudinal acceleration [m/s2].
        model: See the head of this file, also for learned.
        learned: As above.
    """
    if compared:
        compare(h, x, kappa[0], ax, model, learned)
    h.x_last[:] = x
    h.kappa_last[0] = kappa[0]
    start, later = h.schedule[0], np.empty(NX)
    start[:] = x
    delay = h.delay + int(h.lateness[0])
    first = len(h.queue) - delay
    for i in range(delay):
        period(
            start, h.queue[first + i], kappa[i], kappa[i + 1], model, learned, h.disturbance, h.Ts,
            later,
        )
        start[:] = later
