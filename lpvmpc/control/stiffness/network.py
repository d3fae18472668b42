"""The learned tires, evaluated without torch: compiled by numba.

`network` gives each axle's lateral force and its local slope. The slip angle enters as
s = C0 alpha / D, where D is the friction circle's remainder; the force leaves as D y:

    Fz = Fz0 -+ m ax h / L,   q = Fx / (f mu Fz),   D = f mu Fz sqrt(1 - q^2)
    y(s, z) = sum_j w_j (tanh(u_j s + e_j) - tanh(e_j - u_j s)) / 2,   e = V z + b
    z = ((M / (m h ay_limit))^2, q^2, Fz / Fz0 - 1),   Fy = D y,   dFy/dalpha = C0 dy/ds

M is the moment in roll springs and dampers, which shifts load between left and right wheels: it
follows the lateral acceleration by a lag that matters in quick manoeuvres.

So the force is odd in the slip angle by construction, and the friction scale f acts by similarity:
it scales the force at a slip scaled alike. The paper's network is in secant_network.py.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lpvmpc.car import bicycle
from lpvmpc.car.bicycle import AF, AR, DELTA, PHI, VX, VY, A, P, R
from lpvmpc.car.params import VehicleParams
from lpvmpc.control.stiffness.network_file import N_EVEN, Weights, load_weights
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.interface import State
from lpvmpc.units import GRAVITY, Array

SLOPE_MIN, SLOPE_MAX = 0.05, 1.3
"""Range of a slope or secant stiffness, as a share of the nominal stiffness: positive, so that the
controller's problem stays well posed."""
FRICTION_MARGIN = 1.08
"""Largest lateral force over f mu Fz: lighter wheels have more friction than the nominal load's."""
ELLIPSE_MIN = 0.05
"""Floor of 1 - q^2, where the drive or brake force takes all grip."""

# Columns of the numbers that describe an axle's normalisation.
C0, FZ0, TRANSFER, MU, ROLL0 = range(5)


def normalisation(car: VehicleParams, mass: float | None = None) -> Array:
    """Numbers that make the features of both axles dimensionless.

    Args:
        car: Vehicle parameters.
        mass: Mass where it differs from the car's [kg].

    Returns:
        Rows front, rear of (stiffness [N/rad], static load [N], load per longitudinal acceleration
        [kg], friction [-], roll moment at the limit [N m]), shape (2, 5).
    """
    m = car.m if mass is None else mass
    roll = car.m * car.h * car.ay_limit
    L, transfer = car.wheelbase, m * car.h / car.wheelbase
    return np.array(
        [
            [car.Cf, m * GRAVITY * car.lr / L, -transfer, car.mu, roll],
            [car.Cr, m * GRAVITY * car.lf / L, transfer, car.mu, roll],
        ]
    )


@njit(cache=True)
def features(alpha, Fx, ax, roll, friction, norm, z):
    """Dimensionless inputs of an axle; see the head of this file.

    Args:
        alpha: Slip angle after relaxation [rad].
        Fx: Drive or brake force of the axle [N].
        ax: Longitudinal acceleration of the car [m/s2].
        roll: Moment in the roll springs and dampers, K_phi phi + C_phi p [N m].
        friction: Scale of the road's peak friction [-].
        norm: Row of `normalisation`, shape (5,).
        z: Receives the even features, shape (3,).

    Returns:
        s [-], and D [N], by which the force is scaled.
    """
    Fz = max(norm[FZ0] + norm[TRANSFER] * ax, 0.2 * norm[FZ0])
    grip = friction * norm[MU] * Fz
    q = Fx / grip
    D = grip * math.sqrt(max(1.0 - q * q, ELLIPSE_MIN))
    z[0] = (roll / norm[ROLL0]) ** 2
    z[1] = q * q
    z[2] = Fz / norm[FZ0] - 1.0
    return norm[C0] * alpha / D, D


@njit(cache=True)
def _response(s, z, u, V, b, w):
    """Force y and slope dy/ds of an axle's network."""
    y, slope = 0.0, 0.0
    for j in range(u.shape[0]):
        e = b[j]
        for i in range(N_EVEN):
            e += V[j, i] * z[i]
        plus, minus = math.tanh(e + u[j] * s), math.tanh(e - u[j] * s)
        y += w[j] * (plus - minus)
        slope += w[j] * u[j] * (2.0 - (plus * plus + minus * minus))
    return 0.5 * y, 0.5 * slope


@njit(cache=True)
def axle_force(axle, alpha, Fx, ax, roll, friction, norm, net, z):
    """Lateral force of an axle [N], its slope [N/rad], and how many inputs were clamped.

    Inputs are clamped to the trained range; the force keeps within the friction circle, the slope
    between SLOPE_MIN and SLOPE_MAX of the nominal stiffness. All of it is continuous.

    Args:
        axle: 0 front, 1 rear.
        alpha: See `features`, also for Fx, ax, roll, friction.
        Fx: As above.
        ax: As above.
        roll: As above.
        friction: As above.
        norm: `normalisation`, shape (2, 5).
        net: The tuple of `NetworkTire.net`.
        z: Scratch, shape (3,).
    """
    u, V, b, w, low, high, slip_max = net
    s, D = features(alpha, Fx, ax, roll, friction, norm[axle], z)
    clamped = 0
    for i in range(N_EVEN):
        value = min(max(z[i], low[axle, i]), high[axle, i])
        clamped += value != z[i]
        z[i] = value
    limit = slip_max[axle]
    clamped += abs(s) > limit
    y, slope = _response(min(max(s, -limit), limit), z, u[axle], V[axle], b[axle], w[axle])
    bound = min(max(y, -FRICTION_MARGIN), FRICTION_MARGIN)
    C = norm[axle, C0] * min(max(slope, SLOPE_MIN), SLOPE_MAX)
    return D * bound, C, clamped


@njit(cache=True)
def longitudinal(a, vx, delta, ay, car, m_eff, drive_front, brake_front, inertia):
    """Acceleration of the car and drive or brake force of the axles, from the drive's.

    m_eff ax = m_eff a - c_roll m g - k_drag vx^2 - Fyf sin(delta),  Fyf as in steady cornering;
    Fx of an axle is its share of m_eff a, less what spins its wheels and rolls its tires.

    Args:
        a: Drive (`drive_front`) or brake (`brake_front`) acceleration [m/s2].
        vx: Speed [m/s].
        delta: Steering angle [rad].
        ay: Lateral acceleration [m/s2].
        car: `Bicycle` constants.
        m_eff: Mass with the wheels' spin [kg].
        drive_front: Share of the drive on the front axle [-].
        brake_front: Share of the brake force on the front axle [-].
        inertia: Spin inertia of an axle's wheels over the radius squared [kg].

    Returns:
        ax [m/s2], Fxf, Fxr [N].
    """
    L = car.lf + car.lr
    drag = car.c_roll * car.m * GRAVITY + car.k_drag * vx * vx
    cornering = car.m * ay * car.lr / L * math.sin(delta)
    ax = a - (drag + cornering) / m_eff
    share = drive_front if a > 0.0 else brake_front
    spin = inertia * ax
    roll_f = car.c_roll * car.m * (GRAVITY * car.lr - ax * car.h) / L
    roll_r = car.c_roll * car.m * (GRAVITY * car.lf + ax * car.h) / L
    return ax, share * m_eff * a - spin - roll_f, (1.0 - share) * m_eff * a - spin - roll_r


@njit(cache=True)
def along(
    x, Ts, friction, scale_f, scale_r, constants, m_eff, drive_front, brake_front, inertia, norm,
    net, z, tires,
):
    """Affine axle forces in the middle of each interval of a prediction, in place.

    Args:
        x: Prediction (vx, vy, r, ey, epsi, delta, a, alpha_f, alpha_r, phi, p), shape (N + 1, 11).
        Ts: Period [s].
        friction: Scale of the road's peak friction.
        scale_f: Scale of the front axle's stiffness: its force is that of so many times the slip.
        scale_r: The same of the rear axle.
        constants: `Bicycle` as an array, shape (17,).
        m_eff: See `longitudinal`, also for drive_front, brake_front, inertia.
        drive_front: As above.
        brake_front: As above.
        inertia: As above.
        norm: `normalisation`, shape (2, 5).
        net: The tuple of `NetworkTire.net`.
        z: Scratch, shape (3,).
        tires: Receives (Cf, F0f, Cr, F0r), Fy = C alpha + F0 the tangent, shape (N, 4).

    Returns:
        Number of clamped inputs.
    """
    clamped = 0
    car = bicycle.unpack(constants)
    for k in range(tires.shape[0]):
        vx = max(0.5 * (x[k, VX] + x[k + 1, VX]), car.vx_min)
        vy, r = 0.5 * (x[k, VY] + x[k + 1, VY]), 0.5 * (x[k, R] + x[k + 1, R])
        delta, a = 0.5 * (x[k, DELTA] + x[k + 1, DELTA]), 0.5 * (x[k, A] + x[k + 1, A])
        ay = vx * r + (x[k + 1, VY] - x[k, VY]) / Ts
        ax, Fxf, Fxr = longitudinal(
            a, vx, delta, ay, car, m_eff, drive_front, brake_front, inertia
        )
        roll = car.m * car.h * ay
        if car.K_phi > 0.0:
            roll = 0.5 * car.K_phi * (x[k, PHI] + x[k + 1, PHI])
            roll += 0.5 * car.C_phi * (x[k, P] + x[k + 1, P])
        if car.sigma_f > 0.0:
            alpha_f = 0.5 * (x[k, AF] + x[k + 1, AF])
            alpha_r = 0.5 * (x[k, AR] + x[k + 1, AR])
        else:
            sway = 0.5 * car.h * (x[k, P] + x[k + 1, P]) if car.K_phi > 0.0 else 0.0
            alpha_f = delta - math.atan2(vy + sway + car.lf * r, vx)
            alpha_r = -math.atan2(vy + sway - car.lr * r, vx)
        Fy, C, n = axle_force(0, scale_f * alpha_f, Fxf, ax, roll, friction, norm, net, z)
        tires[k, 0], tires[k, 1] = scale_f * C, Fy - scale_f * C * alpha_f
        clamped += n
        Fy, C, n = axle_force(1, scale_r * alpha_r, Fxr, ax, roll, friction, norm, net, z)
        tires[k, 2], tires[k, 3] = scale_r * C, Fy - scale_r * C * alpha_r
        clamped += n
    return clamped


@njit(cache=True)
def forces_of(alpha, Fx, ax, roll, friction, norms, net, Fy, slope, slope_zero):
    """Forces of many samples of both axles, in place; nothing is bounded but the inputs.

    Args:
        alpha: Slip angles [rad], shape (n, 2).
        Fx: Drive or brake forces [N], shape (n, 2).
        ax: Longitudinal acceleration [m/s2], shape (n,).
        roll: Roll moment [N m], shape (n,).
        friction: Scale of the road's peak friction, shape (n,).
        norms: `normalisation` of each sample, shape (n, 2, 5).
        net: The tuple of `NetworkTire.net`.
        Fy: Receives the forces [N], shape (n, 2).
        slope: Receives the local slopes [N/rad], shape (n, 2).
        slope_zero: Receives the slopes at slip angle zero, shape (n, 2).
    """
    u, V, b, w, low, high, slip_max = net
    z = np.zeros(N_EVEN)
    for k in range(alpha.shape[0]):
        for i in range(2):
            s, D = features(alpha[k, i], Fx[k, i], ax[k], roll[k], friction[k], norms[k, i], z)
            for j in range(N_EVEN):
                z[j] = min(max(z[j], low[i, j]), high[i, j])
            s = min(max(s, -slip_max[i]), slip_max[i])
            y, slope[k, i] = _response(s, z, u[i], V[i], b[i], w[i])
            Fy[k, i] = D * y
            slope[k, i] *= norms[k, i, C0]
            slope_zero[k, i] = norms[k, i, C0] * _response(0.0, z, u[i], V[i], b[i], w[i])[1]


class NetworkTire:
    """Stiffness model `network`: tangents of the learned axle forces along the prediction."""

    name = "network"

    def __init__(
        self,
        car: VehicleParams,
        weights: Weights | None = None,
        *,
        Ts: float = 0.033,
    ) -> None:
        """Build the model.

        Args:
            car: Vehicle parameters.
            weights: Trained weights (default: the packaged ones).
            Ts: Control period [s].
        """
        weights = load_weights("network") if weights is None else weights
        if weights.kind != "network":
            raise OptionError("weights", weights.kind, "weights of a 'network'")
        self.weights = weights
        w = {name: np.ascontiguousarray(v, np.float64) for name, v in weights.arrays.items()}
        names = ("u", "V", "b", "w", "z_low", "z_high", "slip_max")
        self.net: tuple[Array, ...] = tuple(w[name] for name in names)
        """Arrays u, V, b, w, z_low, z_high, slip_max; the first axis is the axle."""
        self.norm = normalisation(car)
        self.friction = 1.0
        """Scale of the road's peak friction that is assumed."""
        self.scales = (1.0, 1.0)
        """Scales of the axles' stiffness that are assumed, front and rear."""
        self._constants = np.array(bicycle.Bicycle.of(car))
        self.Ts = Ts
        self._spin = (
            car.m_eff, car.drive_front, car.brake_front, 2.0 * car.J_w / car.R_w**2
        )
        self._z = np.zeros(N_EVEN)
        self.reset()

    def reset(self) -> None:
        """Forget the run so far."""
        self.clamped = 0
        """Number of inputs that lay outside the trained range since the last reset."""
        self.friction, self.scales = 1.0, (1.0, 1.0)

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `stiffness.StiffnessModel.horizon`."""
        self.clamped += along(
            prediction, self.Ts, self.friction, *self.scales, self._constants, *self._spin,
            self.norm, self.net, self._z, tires,
        )

    def axle(
        self, axle: int, alpha: float, Fx: float, ax: float, roll: float, friction: float = 1.0
    ) -> tuple[float, float]:
        """Force [N] and slope [N/rad] of one axle; arguments as in `features`."""
        values = (axle, alpha, Fx, ax, roll, friction)
        if not all(map(math.isfinite, values)):
            raise LPVMPCError(f"An input of the network is not finite: {values}.")
        Fy, C, n = axle_force(*values, self.norm, self.net, self._z)
        self.clamped += n
        return Fy, C
