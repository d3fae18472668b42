"""What the two tires of an axle give together, seen from the single-track model.

Loads follow from the model's own states: roll shifts load from the inner to the outer wheel, drive
and braking shift it between the axles. The lateral force of an axle and its slope are then a
function of slip, roll, acceleration and road friction.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from lpvmpc.car import tire
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import Tire
from lpvmpc.units import GRAVITY

SLIP_STEP = 1e-3
"""Half width of the difference quotient for the slope [rad]; a thousandth of the force's scale."""


class Axle(NamedTuple):
    """Constants of one axle, as plain numbers for compiled code."""

    tire: Tire
    """Its tires: law and coefficients."""
    load: float
    """Static load of one wheel [N]."""
    pitch: float
    """Change of one wheel's load per longitudinal acceleration [N per m/s2]."""
    roll: float
    """Change of the outer wheel's load per roll angle [N/rad]."""
    drive: float
    """Longitudinal force of one wheel per driving acceleration [N per m/s2]."""
    brake: float
    """Longitudinal force of one wheel per braking acceleration [N per m/s2]."""


def axles(car: VehicleParams, tire_f: Tire, tire_r: Tire) -> tuple[Axle, Axle]:
    """Front and rear axle of a car with the given tires.

    Args:
        car: Vehicle parameters.
        tire_f: Front tire.
        tire_r: Rear tire.
    """
    weight, L = car.m * GRAVITY, car.wheelbase
    pitch = 0.5 * car.m * car.h / L
    # springs carry the moment of gravity too, which K_phi has lost
    moment = car.K_phi + weight * car.h
    share = car.roll_share_front
    front = Axle(
        tire_f,
        0.5 * weight * car.lr / L,
        -pitch,
        share * moment / car.track_f,
        0.5 * car.m_eff * car.drive_front,
        0.5 * car.m_eff * car.brake_front,
    )
    rear = Axle(
        tire_r,
        0.5 * weight * car.lf / L,
        pitch,
        (1.0 - share) * moment / car.track_r,
        0.5 * car.m_eff * (1.0 - car.drive_front),
        0.5 * car.m_eff * (1.0 - car.brake_front),
    )
    return front, rear


@njit(cache=True)
def lateral_force(axle, alpha, phi, a, friction):
    """Lateral force of an axle.

    Fy = sum over the wheels of Fy(alpha, slip of the longitudinal force, Fz),
    Fz = static + pitch a +- roll phi

    Args:
        axle: `Axle` constants.
        alpha: Slip angle that the tires have built up [rad].
        phi: Roll angle [rad], positive in a left turn: the right wheel is then the outer one.
        a: Drive (positive) or brake acceleration [m/s2].
        friction: Scale of the road's friction [-].

    Returns:
        Lateral force [N], left positive.

    Source: `tire.forces`; loads by balance of moments, docs/derivations.md D8.
    """
    base = axle.load + axle.pitch * a
    shift = axle.roll * phi
    Fx = (axle.drive if a > 0.0 else axle.brake) * a
    total = 0.0
    for side in (-1.0, 1.0):
        Fz = max(base + side * shift, 50.0)  # a lifted wheel keeps a load that can be divided by
        slip_ratio = Fx / tire.slip_stiffness(axle.tire, Fz)
        total += tire.forces(axle.tire, slip_ratio, alpha, Fz, friction)[1]
    return total


@njit(cache=True)
def tangent(axle, alpha, phi, a, friction, C_min):
    """Affine force C alpha + F0 that touches the axle's force at a slip angle.

    Past the peak the slope is kept at `C_min`: a model in which steering more turns the car less
    has no use for a controller that must not go there.

    Args:
        axle: `Axle` constants.
        alpha: Operating point [rad].
        phi: Roll angle [rad].
        a: Drive or brake acceleration [m/s2].
        friction: Scale of the road's friction [-].
        C_min: Smallest slope [N/rad].

    Returns:
        Slope C [N/rad] and offset F0 [N].
    """
    force = lateral_force(axle, alpha, phi, a, friction)
    above = lateral_force(axle, alpha + SLIP_STEP, phi, a, friction)
    below = lateral_force(axle, alpha - SLIP_STEP, phi, a, friction)
    C = max((above - below) / (2.0 * SLIP_STEP), C_min)
    return C, force - C * alpha
