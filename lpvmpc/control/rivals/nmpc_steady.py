"""Steady cornering of the rival `nmpc`'s model: what its plan is drawn to."""

from __future__ import annotations

import math

from numba import njit

from lpvmpc.car.bicycle import AF, AR, DELTA, EPSI, EY, PHI, VX, VY, A, P, R
from lpvmpc.control.rivals.nmpc_model import STEP, axle_force
from lpvmpc.units import GRAVITY

SLOPE_MIN = 0.1
"""Smallest slope of an axle's force in `steady`, as a share of that at rest: past its peak a tire
has no slip for a larger force."""


@njit(cache=True)
def _slip_for(force, model, rear, start, phi, a, learned, most):
    """Slip angle of an axle for a force, two steps of Newton from a slip nearby [rad]."""
    C = model.Cr if rear else model.Cf
    alpha = start
    for _ in range(2):
        F = axle_force(model, rear, alpha, phi, a, learned)
        slope = (axle_force(model, rear, alpha + STEP, phi, a, learned) - F) / STEP
        alpha += (force - F) / max(slope, SLOPE_MIN * C)
        alpha = min(max(alpha, -most), most)
    return alpha


@njit(cache=True)
def steady(near, kappa, model, learned, disturbance, most, out):
    """State in which the car follows a curve without error at its speed, in place.

    As `bicycle.steady_state`, for these tires: forces from the balances of force and moment, slip
    angles from the forces.

    Args:
        near: A state nearby, shape (11,): its speed and drive acceleration are kept, its slip
            angles are where the search begins.
        kappa: Curvature [1/m].
        model: See `nmpc_model`, also for the next two.
        learned: As above.
        disturbance: As above.
        most: Largest slip angle [rad].
        out: Receives the state, shape (11,).
    """
    car = model.car
    vx = max(near[VX], model.v_slip)
    a = near[A]
    vy = near[VY] if abs(near[VY]) < 0.3 * vx else 0.0
    delta = near[DELTA]
    alpha_f, alpha_r, phi, r, Fyf, Fy = near[AF], near[AR], near[PHI], 0.0, 0.0, 0.0
    for _ in range(2):
        r = kappa * math.sqrt(vx * vx + vy * vy)
        Fy = car.m * (r * vx - disturbance[1])
        front = (car.lever_r * Fy - car.Iz * disturbance[2]) / (car.lever_f + car.lever_r)
        phi = car.h * Fy / car.K_phi if car.K_phi > 0.0 else 0.0
        alpha_r = _slip_for(Fy - front, model, True, alpha_r, phi, a, learned, most)
        vy = car.lr * r - vx * math.tan(alpha_r)
        Fyf = front / math.cos(delta)
        alpha_f = _slip_for(Fyf, model, False, alpha_f, phi, a, learned, most)
        delta = alpha_f + math.atan2(vy + car.lf * r, vx)
    drag = car.c_roll * car.m * GRAVITY + car.k_drag * vx * vx
    out[VX], out[VY], out[R], out[EY], out[EPSI] = near[VX], vy, r, 0.0, -math.atan2(vy, vx)
    out[DELTA], out[AF], out[AR], out[PHI], out[P] = delta, alpha_f, alpha_r, phi, 0.0
    out[A] = (Fyf * math.sin(delta) + drag) / car.m - r * vy - disturbance[0]
