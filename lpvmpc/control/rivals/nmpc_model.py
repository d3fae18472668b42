"""The nonlinear single-track model of the rival `nmpc`, one control period of it, and its Jacobian.

States and inputs are those of `car.bicycle`: (vx, vy, r, ey, epsi, delta, a, alpha_f, alpha_r,
phi, p), and (delta, ax) as commanded. What differs from it: the axle forces follow the car's own
tires (`car.axle`) instead of a tangent, and the slip angles are written so that they exist at a
standstill.

Arguments that recur: model, a `Model`; learned, what was learned of the tires (friction scale,
stiffness scale of the front and of the rear axle), shape (3,); disturbance, accelerations of
(vx, vy, r) that the model lacks, shape (3,).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from lpvmpc.car.axle import Axle, lateral_force
from lpvmpc.car.bicycle import (
    AF,
    AR,
    DELTA,
    EPSI,
    EY,
    NU,
    NX,
    PHI,
    VX,
    VY,
    A,
    Bicycle,
    P,
    R,
)
from lpvmpc.units import GRAVITY

SUBSTEPS = 2
"""Steps of the integrator in a period: at 45 m/s the slip builds up within 10 ms, and one step of
33 ms would be unstable."""
STEP = 1e-5
"""Step of the difference quotients of the axle forces [rad; m/s2 are a thousand times larger]."""


class Model(NamedTuple):
    """Constants of the model, as plain numbers for compiled code."""

    car: Bicycle
    """The single track; without lags, relaxation and roll for the textbook's."""
    front: Axle
    """Front axle and its tires."""
    rear: Axle
    """Rear axle and its tires."""
    linear: int
    """Whether the tires are linear, Fy = C alpha."""
    Cf: float
    """Front axle cornering stiffness, for linear tires [N/rad]."""
    Cr: float
    """Rear axle cornering stiffness, for linear tires [N/rad]."""
    v_slip: float
    """Speed below which slip angles are those of a slip speed over this one [m/s]."""


@njit(cache=True)
def axle_force(model, rear, alpha, phi, a, learned):
    """Lateral force of an axle at a built-up slip angle [N].

    Fy(alpha; mu, c) = F(c alpha; mu), or Fy = C alpha for linear tires.

    Args:
        model: See the head of this file, also for learned.
        rear: Whether it is the rear axle.
        alpha: Slip angle [rad].
        phi: Roll angle [rad].
        a: Drive or brake acceleration [m/s2].
        learned: As above.
    """
    if rear:
        if model.linear:
            return model.Cr * alpha
        return lateral_force(model.rear, learned[2] * alpha, phi, a, learned[0])
    if model.linear:
        return model.Cf * alpha
    return lateral_force(model.front, learned[1] * alpha, phi, a, learned[0])


@njit(cache=True)
def slips(x, delta, model):
    """Slip angles that the axles roll with [rad], positive for a force to the left.

    alpha_f = atan2(vx sin(delta) - w cos(delta), max(vx cos(delta) + w sin(delta), v_slip)),
    alpha_r = -atan2(vy + h p - lr r, max(vx, v_slip)),   w = vy + h p + lf r

    Above `v_slip` these are the slip angles of `bicycle.slip_angles`; at rest they are zero.
    """
    car = model.car
    sway = car.h * x[P] if car.K_phi > 0.0 else 0.0
    w_f, w_r = x[VY] + sway + car.lf * x[R], x[VY] + sway - car.lr * x[R]
    sin_d, cos_d = math.sin(delta), math.cos(delta)
    along = max(x[VX] * cos_d + w_f * sin_d, model.v_slip)
    alpha_f = math.atan2(x[VX] * sin_d - w_f * cos_d, along)
    return alpha_f, -math.atan2(w_r, max(x[VX], model.v_slip))


@njit(cache=True)
def rates(x, u, kappa, model, learned, disturbance, dx):
    """Time derivative of the state, in place; the equations are those of `bicycle.derivative`.

    Args:
        x: State, shape (11,).
        u: Command (delta [rad], ax [m/s2]), shape (2,).
        kappa: Path curvature [1/m].
        model: See the head of this file, also for the rest.
        learned: As above.
        disturbance: As above.
        dx: Receives the derivative, shape (11,); zero for states without lag.
    """
    car = model.car
    vx, vy, r, ey, epsi = x[VX], x[VY], x[R], x[EY], x[EPSI]
    dx[:] = 0.0
    delta, a = u[0], u[1]
    if car.tau_delta > 0.0:
        delta = x[DELTA]
        dx[DELTA] = (u[0] - delta) / car.tau_delta
    if car.tau_ax > 0.0:
        a = x[A]
        dx[A] = (u[1] - a) / car.tau_ax
    alpha_f, alpha_r = slips(x, delta, model)
    if car.sigma_f > 0.0:
        rolling = max(vx, model.v_slip)
        dx[AF] = rolling / car.sigma_f * (alpha_f - x[AF])
        dx[AR] = rolling / car.sigma_r * (alpha_r - x[AR])
        alpha_f, alpha_r = x[AF], x[AR]
    phi = x[PHI] if car.K_phi > 0.0 else 0.0
    Ff = axle_force(model, False, alpha_f, phi, a, learned)
    Fr = axle_force(model, True, alpha_r, phi, a, learned)
    sin_d, cos_d, sin_e, cos_e = math.sin(delta), math.cos(delta), math.sin(epsi), math.cos(epsi)
    # a standing car does not roll backwards
    moving = min(max(vx / model.v_slip, -1.0), 1.0)
    drag = car.c_roll * car.m * GRAVITY * moving + car.k_drag * vx * abs(vx)
    Fy = Ff * cos_d + Fr
    dx[VX] = a + r * vy - (Ff * sin_d + drag) / car.m + disturbance[0]
    dx[VY] = Fy / car.m - r * vx + disturbance[1]
    dx[R] = (car.lever_f * Ff * cos_d - car.lever_r * Fr) / car.Iz + disturbance[2]
    dx[EY] = vx * sin_e + vy * cos_e
    dx[EPSI] = r - kappa * (vx * cos_e - vy * sin_e) / (1.0 - ey * kappa)
    if car.K_phi > 0.0:
        dx[P] = (car.h * Fy - car.C_phi * x[P] - car.K_phi * x[PHI]) / car.Ixx
        dx[PHI] = x[P]


@njit(cache=True)
def jacobian(x, u, kappa, model, learned, J):
    """Derivatives of `rates` by the state and the command, in place, shape (11, 13).

    Those of the axle forces are difference quotients, all others are written out.
    """
    car = model.car
    vx, vy, r, ey, epsi = x[VX], x[VY], x[R], x[EY], x[EPSI]
    J[:, :] = 0.0
    i_delta, i_a = NX, NX + 1  # where the angle and the acceleration in force stand
    delta, a = u[0], u[1]
    if car.tau_delta > 0.0:
        i_delta, delta = DELTA, x[DELTA]
        J[DELTA, DELTA], J[DELTA, NX] = -1.0 / car.tau_delta, 1.0 / car.tau_delta
    if car.tau_ax > 0.0:
        i_a, a = A, x[A]
        J[A, A], J[A, NX + 1] = -1.0 / car.tau_ax, 1.0 / car.tau_ax
    rolls = car.K_phi > 0.0
    sway = car.h * x[P] if rolls else 0.0
    phi = x[PHI] if rolls else 0.0
    sin_d, cos_d, sin_e, cos_e = math.sin(delta), math.cos(delta), math.sin(epsi), math.cos(epsi)

    # slip angles: alpha = atan(across / along)
    w_f, w_r = vy + sway + car.lf * r, vy + sway - car.lr * r
    across, along = vx * sin_d - w_f * cos_d, vx * cos_d + w_f * sin_d
    floor = max(along, model.v_slip)
    q = across / floor
    per = 1.0 / (floor * (1.0 + q * q))
    share = q if along > model.v_slip else 0.0
    by_w_f = per * (-cos_d - share * sin_d)
    by_vx_f = per * (sin_d - share * cos_d)
    by_delta = per * (along + share * across)
    floor = max(vx, model.v_slip)
    q = -w_r / floor
    per = 1.0 / (floor * (1.0 + q * q))
    by_w_r = -per
    by_vx_r = -per * q if vx > model.v_slip else 0.0
    alpha_f, alpha_r = math.atan2(across, max(along, model.v_slip)), math.atan(q)

    row_f, row_r = np.zeros(NX + NU), np.zeros(NX + NU)
    row_f[VX], row_f[VY], row_f[R], row_f[i_delta] = by_vx_f, by_w_f, car.lf * by_w_f, by_delta
    row_r[VX], row_r[VY], row_r[R] = by_vx_r, by_w_r, -car.lr * by_w_r
    if rolls:
        row_f[P], row_r[P] = car.h * by_w_f, car.h * by_w_r
    if car.sigma_f > 0.0:
        rolling = max(vx, model.v_slip)
        for i in range(NX + NU):
            J[AF, i] = rolling / car.sigma_f * row_f[i]
            J[AR, i] = rolling / car.sigma_r * row_r[i]
        J[AF, AF] -= rolling / car.sigma_f
        J[AR, AR] -= rolling / car.sigma_r
        if vx > model.v_slip:
            J[AF, VX] += (alpha_f - x[AF]) / car.sigma_f
            J[AR, VX] += (alpha_r - x[AR]) / car.sigma_r
        alpha_f, alpha_r = x[AF], x[AR]
        row_f[:] = 0.0
        row_r[:] = 0.0
        row_f[AF], row_r[AR] = 1.0, 1.0

    # axle forces
    Ff = axle_force(model, False, alpha_f, phi, a, learned)
    Fr = axle_force(model, True, alpha_r, phi, a, learned)
    slope_f = (axle_force(model, False, alpha_f + STEP, phi, a, learned) - Ff) / STEP
    slope_r = (axle_force(model, True, alpha_r + STEP, phi, a, learned) - Fr) / STEP
    for i in range(NX + NU):
        row_f[i] *= slope_f
        row_r[i] *= slope_r
    if not model.linear:
        if rolls:
            row_f[PHI] += (axle_force(model, False, alpha_f, phi + STEP, a, learned) - Ff) / STEP
            row_r[PHI] += (axle_force(model, True, alpha_r, phi + STEP, a, learned) - Fr) / STEP
        step = 1e3 * STEP if a >= 0.0 else -1e3 * STEP  # away from the change of axle at zero
        row_f[i_a] += (axle_force(model, False, alpha_f, phi, a + step, learned) - Ff) / step
        row_r[i_a] += (axle_force(model, True, alpha_r, phi, a + step, learned) - Fr) / step

    for i in range(NX + NU):
        front, rear = row_f[i], row_r[i]
        J[VX, i] = -front * sin_d / car.m
        J[VY, i] = (front * cos_d + rear) / car.m
        J[R, i] = (car.lever_f * front * cos_d - car.lever_r * rear) / car.Iz
        if rolls:
            J[P, i] = car.h * (front * cos_d + rear) / car.Ixx
    J[VX, i_delta] -= Ff * cos_d / car.m
    J[VY, i_delta] -= Ff * sin_d / car.m
    J[R, i_delta] -= car.lever_f * Ff * sin_d / car.Iz
    if rolls:
        J[P, i_delta] -= car.h * Ff * sin_d / car.Ixx
        J[P, P] -= car.C_phi / car.Ixx
        J[P, PHI] -= car.K_phi / car.Ixx
        J[PHI, P] = 1.0
    J[VX, i_a] += 1.0
    J[VX, R] += vy
    J[VX, VY] += r
    J[VX, VX] -= 2.0 * car.k_drag * abs(vx) / car.m
    if abs(vx) < model.v_slip:
        J[VX, VX] -= car.c_roll * GRAVITY / model.v_slip
    J[VY, R] -= vx
    J[VY, VX] -= r

    # the path
    J[EY, VX], J[EY, VY], J[EY, EPSI] = sin_e, cos_e, vx * cos_e - vy * sin_e
    narrow = 1.0 / (1.0 - ey * kappa)
    speed = vx * cos_e - vy * sin_e
    J[EPSI, R] = 1.0
    J[EPSI, VX], J[EPSI, VY] = -kappa * narrow * cos_e, kappa * narrow * sin_e
    J[EPSI, EPSI] = kappa * narrow * (vx * sin_e + vy * cos_e)
    J[EPSI, EY] = -kappa * kappa * narrow * narrow * speed


@njit(cache=True)
def period(x, u, kappa, kappa_next, model, learned, disturbance, Ts, out):
    """The state one control period later, in place: `SUBSTEPS` steps of Runge-Kutta's fourth order.

    Args:
        x: State, shape (11,).
        u: Command held over the period, shape (2,).
        kappa: Path curvature at its beginning [1/m]; between the two it is linear in time.
        kappa_next: The same at its end.
        model: See the head of this file, also for the next two.
        learned: As above.
        disturbance: As above.
        Ts: Control period [s].
        out: Receives the state, shape (11,).
    """
    h = Ts / SUBSTEPS
    k1, k2, k3, k4, at = np.empty(NX), np.empty(NX), np.empty(NX), np.empty(NX), np.empty(NX)
    out[:] = x
    for n in range(SUBSTEPS):
        first = kappa + (kappa_next - kappa) * n / SUBSTEPS
        last = kappa + (kappa_next - kappa) * (n + 1) / SUBSTEPS
        middle = 0.5 * (first + last)
        rates(out, u, first, model, learned, disturbance, k1)
        for i in range(NX):
            at[i] = out[i] + 0.5 * h * k1[i]
        rates(at, u, middle, model, learned, disturbance, k2)
        for i in range(NX):
            at[i] = out[i] + 0.5 * h * k2[i]
        rates(at, u, middle, model, learned, disturbance, k3)
        for i in range(NX):
            at[i] = out[i] + h * k3[i]
        rates(at, u, last, model, learned, disturbance, k4)
        for i in range(NX):
            out[i] += h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])
    if model.car.tau_delta == 0.0:
        out[DELTA] = u[0]
    if model.car.tau_ax == 0.0:
        out[A] = u[1]


@njit(cache=True)
def linearised(x, u, kappa, kappa_next, model, learned, disturbance, Ts, out, S):
    """As `period`, and the Jacobian of what it gives by (x, u), in place.

    Args:
        x: See `period`, also for the rest.
        u: As above.
        kappa: As above.
        kappa_next: As above.
        model: As above.
        learned: As above.
        disturbance: As above.
        Ts: As above.
        out: As above.
        S: Receives the Jacobian, shape (11, 13).
    """
    h = Ts / SUBSTEPS
    n_z = NX + NU
    k, total, at = np.empty(NX), np.empty(NX), np.empty(NX)
    J, T = np.empty((NX, n_z)), np.empty((NX, n_z))
    K, sums = np.zeros((NX, n_z)), np.empty((NX, n_z))
    out[:] = x
    S[:, :] = 0.0
    for i in range(NX):
        S[i, i] = 1.0
    for n in range(SUBSTEPS):
        first = kappa + (kappa_next - kappa) * n / SUBSTEPS
        last = kappa + (kappa_next - kappa) * (n + 1) / SUBSTEPS
        total[:] = 0.0
        sums[:, :] = 0.0
        for stage in range(4):
            c = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            here = first if stage == 0 else (last if stage == 3 else 0.5 * (first + last))
            weight = h / 6.0 if stage in (0, 3) else h / 3.0
            for i in range(NX):
                at[i] = out[i] + (c * k[i] if stage > 0 else 0.0)
                for j in range(n_z):
                    T[i, j] = S[i, j] + (c * K[i, j] if stage > 0 else 0.0)
            rates(at, u, here, model, learned, disturbance, k)
            jacobian(at, u, here, model, learned, J)
            for i in range(NX):
                for j in range(n_z):
                    K[i, j] = 0.0
                K[i, NX], K[i, NX + 1] = J[i, NX], J[i, NX + 1]
                for m in range(NX):
                    value = J[i, m]
                    if value != 0.0:
                        for j in range(n_z):
                            K[i, j] += value * T[m, j]
                total[i] += weight * k[i]
                for j in range(n_z):
                    sums[i, j] += weight * K[i, j]
        for i in range(NX):
            out[i] += total[i]
            for j in range(n_z):
                S[i, j] += sums[i, j]
    if model.car.tau_delta == 0.0:
        out[DELTA] = u[0]
        S[DELTA] = 0.0
        S[DELTA, NX] = 1.0
    if model.car.tau_ax == 0.0:
        out[A] = u[1]
        S[A] = 0.0
        S[A, NX + 1] = 1.0
