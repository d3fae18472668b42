"""The compiled numerics of one control period: model, references, bounds, QP, and what follows.

One call from Python builds the whole QP (`period`), one tells what the last period taught
(`compare`), one carries the solution into the next period (`accept`, `shift`): each call costs its
own, and numbers that go through Python cost more than those that stay here.

Arguments that recur, for a horizon of N periods of which N / n share one frozen model; states are
those of `bicycle`, inputs (delta [rad], ax [m/s2]):

- schedule, prediction: states at the ends of the periods, shape (N + 1, 11); knots: at the ends of
  the intervals that share a model, shape (n + 1, 11);
- kappa [1/m], vx_ref [m/s]: reference at the same instants, shape (N + 1,) or longer;
- tires: affine axle forces (Cf [N/rad], F0f [N], Cr, F0r) per interval, shape (n, 4);
- disturbance: unmodelled acceleration of (vx, vy, r) [m/s2, m/s2, rad/s2], shape (3,);
- car: `Bicycle`; constants: the same as an array; form: CORRECTED or PRINTED; method: EXACT or
  EULER; Ts: control period [s];
- drive: (largest braking [m/s2], drive force [N], power [W], mass with the wheels' spin [kg]);
- plan, u_lo, u_hi: inputs over the horizon, shape (N, 2); u_prev: the last one, shape (2,);
- q, r_du, H, g, C, lo, hi, free, forced: see `qp.condense`.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import (
    DELTA,
    EULER,
    EY,
    NU,
    NX,
    VX,
    VY,
    A,
    R,
    hold,
    lpv,
    steady_state,
    unpack,
)
from lpvmpc.control.disturbance import LIMIT, update
from lpvmpc.control.formulation import EY_MAX, SCALE, SLACK_WEIGHTS
from lpvmpc.control.qp import condense
from lpvmpc.control.terminal_cost import SPEEDS


@njit(cache=True)
def freeze(schedule, kappa, tires, disturbance, car, form, method, Ts, Ad, Bd, cd):
    """Freeze the LPV model along the schedule and discretise it, in place.

    One row of `tires` and one model serve N / len(tires) periods; the exact hold is frozen in the
    middle of them, Euler at their start, as the paper's.
    """
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
def references(vx_ref, kappa, tires, disturbance, car, steady, x_ref):
    """State reference at steps 1..N of the horizon, in place."""
    N = x_ref.shape[0]
    span = N // tires.shape[0]
    for k in range(N):
        x_ref[k] = 0.0
        if steady:
            law = tires[k // span]
            steady_state(vx_ref[k + 1], kappa[k + 1], law, disturbance, car, x_ref[k])
        x_ref[k, VX] = vx_ref[k + 1]


@njit(cache=True)
def terminal_cost(table, vx, x_ref, weight, z_ref):
    """Terminal weight at a speed, and the steady state that it pulls towards, in place."""
    n = len(SPEEDS)
    k = 0
    while k < n - 2 and SPEEDS[k + 1] < vx:
        k += 1
    share = min(max((vx - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k]), 0.0), 1.0)
    for i in range(NX + NU):
        for j in range(NX + NU):
            weight[i, j] = (1.0 - share) * table[k, i, j] + share * table[k + 1, i, j]
    for i in range(NX):
        z_ref[i] = x_ref[i]
    z_ref[NX], z_ref[NX + 1] = x_ref[DELTA], x_ref[A]


@njit(cache=True)
def bounds(schedule, u_prev, du_max, delta_max, slip_cap, car, drive, u_lo, u_hi):
    """Input bounds along the horizon, in place; always reachable within the increment bounds.

    Steering: +-delta_max, and no front slip angle above `slip_cap` along the prediction, since
    past the tire's peak more steering turns the car less. Acceleration: motor torque and power at
    the predicted speed, and the brakes.
    """
    ax_min, force, power, m_eff = drive
    for k in range(u_lo.shape[0]):
        vx = max(schedule[k, VX], car.vx_min)
        flow = np.arctan2(schedule[k, VY] + car.lf * schedule[k, R], vx)
        u_lo[k, 0] = max(-delta_max, min(flow - slip_cap, delta_max))
        u_hi[k, 0] = min(delta_max, max(flow + slip_cap, -delta_max))
        u_lo[k, 1] = ax_min
        u_hi[k, 1] = min(force, power / vx) / m_eff
        for m in range(len(du_max)):  # what the increment bounds can reach is allowed
            reach = (k + 1) * du_max[m]
            u_lo[k, m] = min(u_lo[k, m], u_prev[m] + reach)
            u_hi[k, m] = max(u_hi[k, m], u_prev[m] - reach)


@njit(cache=True)
def period(
    schedule, kappa, vx_ref, tires, disturbance, u_prev, constants, form, method, steady, Ts, table,
    du_max, delta_max, slip_cap, drive, q, r_du, work, H, g, C, lo, hi,
):  # fmt: skip
    """Model, references, bounds and QP of one period; one call, since each call costs its own."""
    car = unpack(constants)
    Ad, Bd, cd, x_ref, u_lo, u_hi, terminal, z_ref, free, forced = work
    freeze(schedule, kappa, tires, disturbance, car, form, method, Ts, Ad, Bd, cd)
    references(vx_ref, kappa, tires, disturbance, car, steady, x_ref)
    terminal_cost(table, vx_ref[len(x_ref)], x_ref[-1], terminal, z_ref)
    bounds(schedule, u_prev, du_max, delta_max, slip_cap, car, drive, u_lo, u_hi)
    condense(
        Ad, Bd, cd, schedule[0], x_ref, q, r_du, u_prev, u_lo, u_hi, du_max, EY,
        len(x_ref) // len(tires), EY_MAX, SLACK_WEIGHTS, SCALE, terminal, z_ref, H, g, C, lo,
        hi, free, forced,
    )  # fmt: skip


@njit(cache=True)
def accept(z, free, forced, plan, prediction):
    """Turn a QP solution z into the input plan and the states predicted after now, in place."""
    N, nx = free.shape
    for k in range(N):
        for m in range(NU):
            plan[k, m] = z[k * NU + m] * SCALE[m]
    for k in range(N):
        for i in range(nx):
            value = free[k, i]
            for a in range((k + 1) * NU):
                value += forced[k, i, a] * z[a]
            prediction[k + 1, i] = value


@njit(cache=True)
def advance(x, x_next, kappas, tires, disturbance, u, constants, form, method, Ts, out):
    """One-period prediction from x, with the model frozen between x and x_next, in place."""
    car = unpack(constants)
    A_, B_, c_ = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    Ad, rate, held = np.empty((NX, NX)), np.zeros((NX, NU + 1)), np.empty((NX, NU + 1))
    where = np.empty(NX)
    for i in range(NX):
        where[i] = 0.5 * (x[i] + x_next[i])
    lpv(where, 0.5 * (kappas[0] + kappas[1]), tires, car, form, A_, B_, c_)
    for i in range(NX):
        rate[i, 0] = B_[i, 0] * u[0] + B_[i, 1] * u[1] + c_[i]
        if i < 3:
            rate[i, 0] += disturbance[i]
    hold(A_, rate, Ts, method, Ad, held)
    for i in range(NX):
        out[i] = held[i, 0]
        for j in range(NX):
            out[i] += Ad[i, j] * x[j]
    if car.tau_delta == 0.0:
        out[DELTA] = u[0]
    if car.tau_ax == 0.0:
        out[A] = u[1]


@njit(cache=True)
def compare(
    x, x_last, kappa_last, kappa, tires, disturbance, applied, constants, form, method, Ts, gain,
    predicted, inner, unmodelled, offsets,
):  # fmt: skip
    """Compare the measured state with what the model expected for it, in place.

    Args:
        x: Measured state; what cannot be measured is filled in, shape (11,).
        x_last: State of the period before, shape (11,).
        kappa_last: Curvature of the period before [1/m].
        kappa: Curvature now [1/m].
        tires: Affine axle forces that the period before began with, shape (4,).
        disturbance: The observer's estimate, changed, shape (3,).
        applied: Command in effect since, shape (2,).
        constants: `Bicycle` as an array.
        form: CORRECTED or PRINTED.
        method: EXACT or EULER.
        Ts: Control period [s].
        gain: Gain of the observer, zeros for none, shape (3,).
        predicted: Receives the expected state, shape (11,).
        inner: Receives the expectation of what cannot be measured, shape (5,).
        unmodelled: Receives the acceleration of (vy, r) that the model without observer left
            unexplained, shape (2,).
        offsets: Receives the offsets of the axle forces' tangents, shape (2,).

    Returns:
        Expected acceleration of the drive [m/s2].
    """
    advance(
        x_last, x, (kappa_last, kappa), tires, disturbance, applied, constants, form, method, Ts,
        predicted,
    )  # fmt: skip
    for i in range(2):
        unmodelled[i] = disturbance[1 + i] + (x[1 + i] - predicted[1 + i]) / Ts
        offsets[i] = tires[1 + 2 * i]
    for i in range(A, NX):
        inner[i - A] = x[i] = predicted[i]
    update(disturbance, predicted, x, gain, LIMIT, Ts)
    return predicted[A]


@njit(cache=True)
def shift(plan, prediction, schedule, knots, queue, x0):
    """Make this period's plan and prediction the next one's fallback and schedule, in place."""
    for i in range(len(queue) - 1):
        queue[i] = queue[i + 1]
    queue[-1] = plan[0]
    prediction[0] = x0
    for k in range(len(plan)):
        schedule[k] = prediction[k + 1]
        if k + 1 < len(plan):
            plan[k] = plan[k + 1]
    schedule[-1] = prediction[-1]
    thin(schedule, knots)


@njit(cache=True)
def thin(schedule, knots):
    """The schedule at the ends of the intervals that share one frozen model, in place."""
    span = (len(schedule) - 1) // (len(knots) - 1)
    for i in range(len(knots)):
        knots[i] = schedule[i * span]
