"""The linear single track with relaxation and roll, in closed form: transfer functions, modes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import Tire
from lpvmpc.studies.reference.circle_formulas import against, roll_resists
from lpvmpc.units import Array

YAW_RATE, LATERAL_ACCELERATION, ROLL = 0, 1, 2
"""Rows of C."""


def lateral_model(
    p: VehicleParams, vx: float, tires: tuple[Tire, Tire] | None = None
) -> tuple[Array, Array, Array]:
    """Lateral motion at constant speed, small angles.

    m (vy' + vx r) = Fyf + Fyr,   Iz r' = (lf - t_f) Fyf - (lr + t_r) Fyr - G p
    Fy = C alpha,   alpha' = (vx / sigma) (slip - alpha) on each axle
    slip_f = delta - (vy + h p + lf r) / vx,   slip_r = -(vy + h p - lr r) / vx
    Ixx p' = h (Fyf + Fyr) - C_phi p - K_phi phi + G r,   phi' = p,   G = 4 J_w vx / R_w

    G is the spin of the wheels, whose axes turn with the car. With the tires, the axles are at
    the loads that drag leaves, and roll makes the yaw moments of `circle_formulas.roll_resists`.

    Args:
        p: parameters.
        vx: speed [m/s].
        tires: front and rear tires, if drag and rolling resistance count.

    Returns:
        A (6, 6), b (6,) and C (3, 6) of x' = A x + b delta, x = (vy, r, alpha_f, alpha_r, phi, p)
        and outputs yaw rate [rad/s], lateral acceleration [m/s2] and roll angle [rad].

    Source: Pacejka, Tire and Vehicle Dynamics, section 1.3 (single track) and 7.2 (relaxation).
    """
    A = np.zeros((6, 6))
    if tires is not None:
        drag = 0.5 * p.rho_air * p.CdA * vx**2
        A[1, 4] = roll_resists(p, drag) / p.Iz
        p = against(p, tires, drag)
    front, rear, spin = p.Cf / p.m, p.Cr / p.m, 4.0 * p.J_w * vx / p.R_w
    A[0, [1, 2, 3]] = -vx, front, rear
    A[1, [2, 3]] = (p.lf - p.trail_f) * p.Cf / p.Iz, -(p.lr + p.trail_r) * p.Cr / p.Iz
    A[1, 5], A[5, 1] = -spin / p.Iz, spin / p.Ixx
    A[2, [0, 1, 2, 5]] = np.array([-1.0, -p.lf, -vx, -p.h]) / p.sigma_f
    A[3, [0, 1, 3, 5]] = np.array([-1.0, p.lr, -vx, -p.h]) / p.sigma_r
    A[4, 5] = 1.0
    A[5, [2, 3, 4, 5]] = np.array([p.h * p.Cf, p.h * p.Cr, -p.K_phi, -p.C_phi]) / p.Ixx
    b = np.array([0.0, 0.0, vx / p.sigma_f, 0.0, 0.0, 0.0])
    C = np.zeros((3, 6))
    C[YAW_RATE, 1] = 1.0
    C[LATERAL_ACCELERATION, [2, 3]] = front, rear
    C[ROLL, 4] = 1.0
    return A, b, C


def frequency_response(
    model: tuple[Array, Array, Array], frequencies: npt.ArrayLike
) -> npt.NDArray[np.complex128]:
    """Outputs over steer at frequencies [Hz], shape (n, 3)."""
    A, b, C = model
    s = 2j * np.pi * np.atleast_1d(np.asarray(frequencies, dtype=float))
    return np.array([C @ np.linalg.solve(x * np.eye(len(b)) - A, b) for x in s])


def response(model: tuple[Array, Array, Array], steer: Array, dt: float) -> Array:
    """Outputs under a steer that is linear between samples, from straight driving, (n, 3)."""
    from scipy.signal import lsim

    A, b, C = model
    times = dt * np.arange(float(len(steer)))
    outputs: Array = lsim((A, b[:, None], C, np.zeros((3, 1))), steer, times)[1]
    return outputs
