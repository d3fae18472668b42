"""The linear single track in steady state: understeer, rear slip, roll and yaw gain.

Beside the textbook's terms it has those of first order that a textbook leaves out, since they are a
few per cent of one axle's slip each: a car that understeers clearly hardly shows them, a car that
is close to neutral, whose understeer is the small difference of two such slips, does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpvmpc.car import tire
from lpvmpc.car.aero import aero_wrench
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import Tire
from lpvmpc.units import GRAVITY, Array


def roll_gradient(p: VehicleParams) -> float:
    """Roll angle over lateral acceleration, (m h + 4 J_w / R_w) / K_phi [rad s2/m].

    The second term is the gyroscopic moment of the wheels, whose spin axis turns with the car.
    """
    return (p.m * p.h + 4.0 * p.J_w / p.R_w) / p.K_phi


@dataclass(frozen=True)
class Linear:
    """What the textbook's linear single track with the tires' slopes says of a car."""

    front_slip: float
    """Front slip over lateral acceleration, m (lr + t_r) / (L' Cf) [rad s2/m]."""
    rear_slip: float
    """Rear slip gradient, -m (lf - t_f) / (L' Cr) [rad s2/m]."""
    roll: float
    """Roll gradient [rad s2/m]."""
    wheelbase: float
    """Wheelbase [m]."""

    @classmethod
    def of(cls, p: VehicleParams) -> Linear:
        """The linear formulas of a car."""
        front, rear = p.lf - p.trail_f, p.lr + p.trail_r
        share = p.m / (front + rear)
        return cls(share * rear / p.Cf, -share * front / p.Cr, roll_gradient(p), p.wheelbase)

    @property
    def understeer(self) -> float:
        """Understeer gradient U: front slip less rear slip [rad s2/m]."""
        return self.front_slip + self.rear_slip

    @property
    def slips(self) -> float:
        """Sum of both axles' slips, of which U is the difference [rad s2/m]."""
        return self.front_slip - self.rear_slip

    def yaw_gain(self, vx: Any) -> Any:
        """Yaw rate over steer [1/s]: vx / (L + U vx^2)."""
        return vx / (self.wheelbase + self.understeer * vx**2)

    def yaw_gain_per_slip(self, vx: float) -> float:
        """By how much the yaw gain changes, relatively, if both slips do, oppositely [-].

        (front + rear slip) vx^2 / (L + U vx^2): the yaw gain of a car that is close to neutral
        shows more of an error of its axles' stiffness.
        """
        return self.slips * vx**2 / (self.wheelbase + self.understeer * vx**2)


def front_load(p: VehicleParams, drag: float) -> float:
    """Load of the front axle, of which a drag at the height h takes drag h / L [N]."""
    return (p.m * GRAVITY * p.lr - drag * p.h) / p.wheelbase


def against(p: VehicleParams, tires: tuple[Tire, Tire], drag: float) -> VehicleParams:
    """The car with its axles at the loads that a drag [N] at the centre of mass leaves them."""
    Fz_f = front_load(p, drag)
    front, rear = zip(tires, (0.5 * Fz_f, 0.5 * (p.m * GRAVITY - Fz_f)), strict=True)
    return replace(
        p,
        Cf=2.0 * tire.cornering_stiffness(*front),
        Cr=2.0 * tire.cornering_stiffness(*rear),
        trail_f=tire.pneumatic_trail(front[0], 0.0, front[1]),
        trail_r=tire.pneumatic_trail(rear[0], 0.0, rear[1]),
        sigma_f=tire.relaxation_lengths(*front)[1],
        sigma_r=tire.relaxation_lengths(*rear)[1],
    )


def roll_resists(p: VehicleParams, drag: float) -> float:
    """Yaw moment over roll angle, -(c_roll (K_phi + m g h) + h drag) [N m/rad].

    The loaded side's rolling resistance is larger, by the load (K_phi + m g h) phi / t that roll
    moves there; and roll moves the centre of mass, where the drag acts, out by h phi.
    """
    return -(p.c_roll * (p.K_phi + p.m * GRAVITY * p.h) + p.h * drag)


@dataclass(frozen=True)
class SteadyTrack:
    """Linear steady state; left is positive."""

    delta: float
    """Steer [rad]."""
    sideslip: float
    """Sideslip angle of the centre of mass, vy / vx [rad]."""
    side_force: float
    """Side force of the air [N]."""


def steady_track(
    p: VehicleParams, tires: tuple[Tire, Tire], vx: float, ay: float, wind: float = 0.0
) -> SteadyTrack:
    """Steer and sideslip of the linear single track in a circle, or straight on in a side wind.

    With Yf, Yr the lateral forces of the axles in the wheels' axes, Xf the longitudinal one in
    front, Fw the side force of the air and r = ay / vx,

        Yf + Xf delta + Yr + Fw = m ay
        lf (Yf + Xf delta) - t_f Yf - (lr + t_r) Yr + x_cy Fw - (c_roll S + h D) phi = 0
        Yf = Cf (delta - vy / vx - lf r / vx),   Yr = Cr (-vy / vx + lr r / vx)
        phi = (h (m ay - Fw) + 4 J_w / R_w ay) / K_phi,   S = K_phi + m g h

    Beyond the textbook's: the axles at the loads that the drag D leaves (`against`); the front
    wheels' drive less rolling resistance, which points where they do; the yaw moments that come
    with roll (`roll_resists`); the air's side force on a car that drifts.

    Args:
        p: Parameters of the car.
        tires: Its front and rear tires.
        vx: Speed along the car's axis [m/s].
        ay: Lateral acceleration, vx r [m/s2].
        wind: Wind from the left [m/s], across the course; with ay = 0.

    Source: Pacejka, Tire and Vehicle Dynamics, section 1.3; the further terms are ours. Valid for
    small angles, as ay and the wind go to 0.
    """
    sideslip = delta = side_force = 0.0
    for _ in range(10):  # each pass gains two digits: the air hardly feels the sideslip
        air_x = vx - wind * math.sin(sideslip)
        air_y = vx * math.tan(sideslip) + wind * math.cos(sideslip)
        Fx, side_force, _ = aero_wrench(air_x, air_y, p.rho_air, p.CdA, p.CyA, p.x_cy)
        delta, sideslip = _balance(against(p, tires, -Fx), vx, ay, -Fx, side_force)
    return SteadyTrack(delta, sideslip, float(side_force))


def _balance(
    p: VehicleParams, vx: float, ay: float, drag: float, side_force: float
) -> tuple[float, float]:
    """Steer and sideslip [rad] at which forces and moments balance."""
    Xf = p.drive_front * (drag + p.c_roll * p.m * GRAVITY) - p.c_roll * front_load(p, drag)
    phi = (p.h * (p.m * ay - side_force) + 4.0 * p.J_w / p.R_w * ay) / p.K_phi
    turn = ay / vx**2  # r / vx
    a, b, Cf, Cr = p.lf - p.trail_f, p.lr + p.trail_r, p.Cf, p.Cr
    # rows: lateral force, yaw moment; columns: delta, vy / vx
    A = np.array([[Cf + Xf, -(Cf + Cr)], [a * Cf + p.lf * Xf, b * Cr - a * Cf]])
    right: Array = np.array([
        p.m * ay - side_force + (Cf * p.lf - Cr * p.lr) * turn,
        -roll_resists(p, drag) * phi - p.x_cy * side_force + (a * Cf * p.lf + b * Cr * p.lr) * turn,
    ])
    delta, sideslip = np.linalg.solve(A, right)
    return float(delta), float(sideslip)
