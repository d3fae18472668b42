"""The single-track ("bicycle") model: nonlinear, as an LPV system, and in steady state.

Equations 1-4 and 7-8 of Kebbati et al. in the corrected form of docs/derivations.md. Tire forces
are affine in the slip angle on each axle, Fy = C alpha + F0: the paper's linear tire is F0 = 0, and
a tangent at the operating point has both terms.

Orders: the MPC state is (vx, vy, r, ey, epsi, delta, a, alpha_f, alpha_r, phi, p): the paper's
five states, the actual steering angle and drive acceleration, the slip angles that the tires have
built up over their relaxation lengths, and roll angle and rate; the input is (delta, ax) as
commanded. A lag of zero means that the quantity follows at once, and its state is then unused; so
are the roll states without roll stiffness.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.units import GRAVITY

NX = 11
"""Number of model states: vx, vy, r, ey, epsi, delta, a, alpha_f, alpha_r, phi, p."""
NU = 2
"""Number of inputs: delta, ax."""
VX, VY, R, EY, EPSI, DELTA, A, AF, AR, PHI, P = range(NX)
CORRECTED, PRINTED = 0, 1


class Bicycle(NamedTuple):
    """Constants of the single-track model, as plain numbers for compiled code."""

    m: float
    """Mass [kg]."""
    Iz: float
    """Yaw inertia [kg m2]."""
    lf: float
    """Centre of mass to front axle [m]."""
    lr: float
    """Centre of mass to rear axle [m]."""
    lever_f: float
    """Lever of the front lateral force, lf - trail [m]."""
    lever_r: float
    """Lever of the rear lateral force, lr + trail [m]."""
    c_roll: float
    """Rolling resistance coefficient [-]."""
    k_drag: float
    """0.5 rho_air CdA [kg/m]."""
    tau_delta: float
    """Lag of the steering servo [s]; with 0 the wheels follow the command at once."""
    tau_ax: float
    """Lag of drive and brake [s]; 0 as above."""
    sigma_f: float
    """Relaxation length of the front tires [m]; with 0 the force follows the slip at once."""
    sigma_r: float
    """Relaxation length of the rear tires [m]; 0 as above."""
    h: float
    """Height of the centre of mass [m]."""
    Ixx: float
    """Roll inertia about the centre of mass [kg m2]."""
    K_phi: float
    """Roll stiffness [N m/rad]; with 0 the body does not roll."""
    C_phi: float
    """Roll damping [N m s/rad]."""
    vx_min: float
    """Speed below which the model is evaluated at vx_min [m/s]."""

    @classmethod
    def of(cls, car: VehicleParams) -> Bicycle:
        """The single-track constants of a car."""
        return cls(
            car.m,
            car.Iz,
            car.lf,
            car.lr,
            car.lf - car.trail_f,
            car.lr + car.trail_r,
            car.c_roll,
            0.5 * car.rho_air * car.CdA,
            car.tau_delta,
            car.tau_ax,
            car.sigma_f,
            car.sigma_r,
            car.h,
            car.Ixx,
            car.K_phi,
            car.C_phi,
            car.vx_min,
        )

    def simplified(
        self,
        *,
        lags: bool = True,
        relaxation: bool = True,
        roll: bool = True,
        trail: bool = True,
    ) -> Bicycle:
        """The same car with parts of the model left out (the paper's has none of them)."""
        changes: dict[str, float] = {}
        if not lags:
            changes |= {"tau_delta": 0.0, "tau_ax": 0.0}
        if not relaxation:
            changes |= {"sigma_f": 0.0, "sigma_r": 0.0}
        if not roll:
            changes |= {"K_phi": 0.0}
        if not trail:
            changes |= {"lever_f": self.lf, "lever_r": self.lr}
        return self._replace(**changes)


@njit(cache=True)
def unpack(v):
    """`Bicycle` from an array of its fields, shape (17,), inside compiled code.

    numba takes 10 us to look at a named tuple that comes from Python, and none at an array.
    """
    return Bicycle(
        v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11], v[12],
        v[13], v[14], v[15], v[16],
    )


def slip_angles(vx, vy, r, delta, car):
    """Front and rear slip angles of the single-track model.

    alpha_f = delta - atan2(vy + lf r, vx),   alpha_r = -atan2(vy - lr r, vx)

    The sign is opposite to ISO 8855: a positive angle gives a positive (left) force.

    Args:
        vx: Longitudinal speed [m/s], shape (...,). Meaningful above `car.vx_min`.
        vy: Lateral speed [m/s], shape (...,).
        r: Yaw rate [rad/s], shape (...,).
        delta: Road-wheel steering angle [rad], shape (...,).
        car: Anything with `lf` and `lr` [m].

    Returns:
        Pair of arrays [rad], shape (...,).

    Source: Rajamani, Vehicle Dynamics and Control, section 2.3; the paper's eq. 4, sign corrected.
    """
    alpha_f = delta - np.arctan2(vy + car.lf * r, vx)
    alpha_r = -np.arctan2(vy - car.lr * r, vx)
    return alpha_f, alpha_r


@njit(cache=True)
def derivative(x, u, kappa, axle_forces, car):
    """Time derivative of the nonlinear single-track model with servo lags, relaxation and roll.

    vx' = a + r vy - (Fyf sin(delta) + Fd) / m,   Fd = c_roll m g + k_drag vx^2
    vy' = (Fyf cos(delta) + Fyr) / m - r vx
    r'  = (lever_f Fyf cos(delta) - lever_r Fyr) / Iz
    ey' = vx sin(epsi) + vy cos(epsi)
    epsi' = r - kappa (vx cos(epsi) - vy sin(epsi)) / (1 - ey kappa)
    delta' = (delta_cmd - delta) / tau_delta,   a' = (ax_cmd - a) / tau_ax
    alpha' = (vx / sigma) (slip angle - alpha) on each axle,   Fy = C alpha + F0
    p' = (h (Fyf cos(delta) + Fyr) - C_phi p - K_phi phi) / Ixx,   phi' = p

    The body rolls about the road, so that the contact patches move with vy + h p.

    Args:
        x: State (vx, vy, r, ey, epsi, delta, a, alpha_f, alpha_r, phi, p), shape (11,).
        u: Command (delta [rad], ax [m/s2]), shape (2,).
        kappa: Path curvature [1/m].
        axle_forces: Affine axle forces (Cf [N/rad], F0f [N], Cr, F0r), shape (4,).
        car: `Bicycle` constants.

    Returns:
        Derivative of the state, shape (11,); zero for states without lag.

    Source: Kebbati et al., eqs. 1-4, corrected as in docs/derivations.md; relaxation as in
    Pacejka, Tire and Vehicle Dynamics, section 7.2.
    """
    dx = np.zeros(NX)
    vx = max(x[VX], car.vx_min)
    vy, r, ey, epsi = x[VY], x[R], x[EY], x[EPSI]
    delta, a = u[0], u[1]
    if car.tau_delta > 0.0:
        delta = x[DELTA]
        dx[DELTA] = (u[0] - delta) / car.tau_delta
    if car.tau_ax > 0.0:
        a = x[A]
        dx[A] = (u[1] - a) / car.tau_ax
    sway = car.h * x[P] if car.K_phi > 0.0 else 0.0
    alpha_f = delta - np.arctan2(vy + sway + car.lf * r, vx)
    alpha_r = -np.arctan2(vy + sway - car.lr * r, vx)
    if car.sigma_f > 0.0:
        dx[AF] = vx / car.sigma_f * (alpha_f - x[AF])
        dx[AR] = vx / car.sigma_r * (alpha_r - x[AR])
        alpha_f, alpha_r = x[AF], x[AR]
    Fyf = axle_forces[0] * alpha_f + axle_forces[1]
    Fyr = axle_forces[2] * alpha_r + axle_forces[3]
    drag = car.c_roll * car.m * GRAVITY + car.k_drag * vx * vx
    dx[VX] = a + r * vy - (Fyf * np.sin(delta) + drag) / car.m
    dx[VY] = (Fyf * np.cos(delta) + Fyr) / car.m - r * vx
    dx[R] = (car.lever_f * Fyf * np.cos(delta) - car.lever_r * Fyr) / car.Iz
    if car.K_phi > 0.0:
        moment = car.h * (Fyf * np.cos(delta) + Fyr)
        dx[P] = (moment - car.C_phi * x[P] - car.K_phi * x[PHI]) / car.Ixx
        dx[PHI] = x[P]
    dx[EY] = vx * np.sin(epsi) + vy * np.cos(epsi)
    dx[EPSI] = r - kappa * (vx * np.cos(epsi) - vy * np.sin(epsi)) / (1.0 - ey * kappa)
    return dx


@njit(cache=True)
def _sinc(angle):
    """sin(angle) / angle, continuous at zero."""
    if abs(angle) < 1e-4:
        return 1.0 - angle * angle / 6.0
    return np.sin(angle) / angle


@njit(cache=True)
def _atanc(z):
    """atan(z) / z, continuous at zero."""
    if abs(z) < 1e-4:
        return 1.0 - z * z / 3.0
    return np.arctan(z) / z


@njit(cache=True)
def lpv(x, kappa, axle_forces, car, form, A_out, B_out, c_out):
    """Matrices of the LPV form x' = A(rho) x + B(rho) u + c(rho), written in place.

    At the scheduling point rho = (x, kappa) the LPV form equals the nonlinear model exactly.
    A45 is vx sinc(epsi) instead of the printed A41 = sin(epsi): the same value at the scheduling
    point, but the predicted ey then reacts to the predicted epsi.

    Args:
        x: Scheduling state (vx, vy, r, ey, epsi, delta, a, alpha_f, alpha_r, phi, p),
            shape (11,).
        kappa: Path curvature [1/m].
        axle_forces: Affine axle forces (Cf, F0f, Cr, F0r) [N/rad, N], shape (4,).
        car: `Bicycle` constants.
        form: CORRECTED, or PRINTED for the error row as printed (A41 = sin, A45 = 0), which an
            ablation shows.
        A_out: Receives A, shape (11, 11).
        B_out: Receives B, shape (11, 2).
        c_out: Receives c, shape (11,).

    Source: Kebbati et al., eqs. 7-8; corrections in docs/derivations.md, D1 and D2.
    """
    vx = max(x[VX], car.vx_min)
    vy, r, ey, epsi, delta = x[VY], x[R], x[EY], x[EPSI], x[DELTA]
    Cf, F0f, Cr, F0r = axle_forces[0], axle_forces[1], axle_forces[2], axle_forces[3]
    sin_d, cos_d = np.sin(delta), np.cos(delta)
    rolls = car.K_phi > 0.0
    sway = car.h * x[P] if rolls else 0.0
    flow_f = _atanc((vy + sway + car.lf * r) / vx) / vx  # flow angle per lateral speed of the axle
    flow_r = _atanc((vy + sway - car.lr * r) / vx) / vx

    A_out[:, :] = 0.0
    B_out[:, :] = 0.0
    c_out[:] = 0.0
    A_out[VX, VX] = -car.c_roll * GRAVITY / vx - car.k_drag * vx / car.m
    A_out[VX, R] = vy
    A_out[VY, R] = -vx
    A_out[EY, VY] = np.cos(epsi)
    if form == PRINTED:
        A_out[EY, VX] = np.sin(epsi)
    else:
        A_out[EY, EPSI] = vx * _sinc(epsi)
    narrowing = 1.0 - ey * kappa
    A_out[EPSI, VX] = -kappa * np.cos(epsi) / narrowing
    A_out[EPSI, VY] = kappa * np.sin(epsi) / narrowing
    A_out[EPSI, R] = 1.0

    # accelerations of (vx, vy, r, p) per slip angle, and where the slip angles come from
    roll = car.h / car.Ixx if rolls else 0.0
    front = (-sin_d / car.m, cos_d / car.m, car.lever_f * cos_d / car.Iz, roll * cos_d)
    rear = (0.0, 1.0 / car.m, -car.lever_r / car.Iz, roll)
    rows = (VX, VY, R, P)
    for n in range(4):
        i, f, q = rows[n], front[n], rear[n]
        c_out[i] = f * F0f + q * F0r
        if car.sigma_f > 0.0:
            A_out[i, AF] = f * Cf
            A_out[i, AR] = q * Cr
            continue
        A_out[i, VY] -= f * Cf * flow_f + q * Cr * flow_r
        A_out[i, R] -= car.lf * f * Cf * flow_f - car.lr * q * Cr * flow_r
        if rolls:
            A_out[i, P] -= car.h * (f * Cf * flow_f + q * Cr * flow_r)
        if car.tau_delta > 0.0:
            A_out[i, DELTA] = f * Cf
        else:
            B_out[i, 0] = f * Cf
    if car.sigma_f > 0.0:
        rate_f, rate_r = vx / car.sigma_f, vx / car.sigma_r
        A_out[AF, VY], A_out[AF, R] = -rate_f * flow_f, -rate_f * flow_f * car.lf
        A_out[AR, VY], A_out[AR, R] = -rate_r * flow_r, rate_r * flow_r * car.lr
        if rolls:
            A_out[AF, P], A_out[AR, P] = -rate_f * flow_f * car.h, -rate_r * flow_r * car.h
        A_out[AF, AF], A_out[AR, AR] = -rate_f, -rate_r
        if car.tau_delta > 0.0:
            A_out[AF, DELTA] = rate_f
        else:
            B_out[AF, 0] = rate_f
    if rolls:
        A_out[P, P] -= car.C_phi / car.Ixx
        A_out[P, PHI] = -car.K_phi / car.Ixx
        A_out[PHI, P] = 1.0

    if car.tau_delta > 0.0:
        A_out[DELTA, DELTA] = -1.0 / car.tau_delta
        B_out[DELTA, 0] = 1.0 / car.tau_delta
    if car.tau_ax > 0.0:
        A_out[VX, A] = 1.0
        A_out[A, A] = -1.0 / car.tau_ax
        B_out[A, 1] = 1.0 / car.tau_ax
    else:
        B_out[VX, 1] = 1.0


@njit(cache=True)
def steady_state(vx, kappa, axle_forces, disturbance, car, x_out):
    """State in which the car follows a curve without error, in place.

    With r = kappa vx, ey = 0 and a velocity along the path (epsi = -atan(vy / vx)), solves
    vy' = 0 and r' = 0 for vy and delta; the two equations are linear for the affine tires once
    cos(delta) is taken as 1, and are corrected twice for cos(delta) and the arctangents.

    Args:
        vx: Speed [m/s].
        kappa: Curvature [1/m].
        axle_forces: Affine axle forces (Cf, F0f, Cr, F0r) [N/rad, N], shape (4,).
        disturbance: Unmodelled accelerations of (vx, vy, r) [m/s2, m/s2, rad/s2], shape (3,).
        car: `Bicycle` constants.
        x_out: Receives (vx, vy, r, ey, epsi, delta, a, alpha_f, alpha_r, phi, p), shape (11,).

    Source: Rajamani, section 3.2, with an added disturbance; docs/derivations.md.
    """
    vx = max(vx, car.vx_min)
    Cf, F0f, Cr, F0r = axle_forces[0], axle_forces[1], axle_forces[2], axle_forces[3]
    vy, delta, alpha_f, alpha_r = 0.0, 0.0, 0.0, 0.0
    for _ in range(3):
        # along the path: the course is psi + beta, and ds/dt = vx / cos(beta)
        r = kappa * np.sqrt(vx * vx + vy * vy)
        Fy = car.m * (r * vx - disturbance[1])  # cos(delta) Fyf + Fyr
        Mz = -car.Iz * disturbance[2]
        Fyf_cos = (car.lever_r * Fy + Mz) / (car.lever_f + car.lever_r)
        Fyr = Fy - Fyf_cos
        alpha_r = (Fyr - F0r) / Cr
        vy = car.lr * r - vx * np.tan(alpha_r)
        alpha_f = (Fyf_cos / np.cos(delta) - F0f) / Cf
        delta = alpha_f + np.arctan2(vy + car.lf * r, vx)
    Fyf = Fyf_cos / np.cos(delta)
    drag = car.c_roll * car.m * GRAVITY + car.k_drag * vx * vx
    x_out[VX] = vx
    x_out[VY] = vy
    x_out[R] = r
    x_out[EY] = 0.0
    x_out[EPSI] = -np.arctan2(vy, vx)
    x_out[DELTA] = delta
    x_out[A] = (Fyf * np.sin(delta) + drag) / car.m - r * vy - disturbance[0]
    x_out[AF] = alpha_f
    x_out[AR] = alpha_r
    x_out[PHI] = car.h * (Fyf_cos + Fyr) / car.K_phi if car.K_phi > 0.0 else 0.0
    x_out[P] = 0.0
