"""How the real car differs from the one that its controller was told.

`deviated` changes a copy of the compiled model: masses, tires, servo, drive, air. What lies between
a command and the servo or the drive (ratio, offset, play, brake gain) is not in the model; it
is in `plant.actuation`. `Plant.deviations` sets both.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import mujoco
import numpy as np

from lpvmpc.car import tire
from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import OptionError, UnknownNameError
from lpvmpc.plant.mjcf import WHEELS, parameters, tire_law
from lpvmpc.units import GRAVITY, Array

FACTOR = (0.2, 5.0, "a factor from 0.2 to 5")
RANGES: dict[str, tuple[float, float, str]] = {
    "mass": (0.5, 2.0, "a factor from 0.5 to 2"),
    "load": (0.0, 1500.0, "a mass from 0 to 1500 kg"),
    "load_x": (-3.0, 3.0, "a place from -3 to 3 m ahead of the centre of mass"),
    "load_z": (0.0, 2.5, "a height from 0 to 2.5 m"),
    "com_height": (-0.4, 1.5, "a rise from -0.4 to 1.5 m"),
    "mu_f": (0.05, 2.0, "a factor from 0.05 to 2"),
    "mu_r": (0.05, 2.0, "a factor from 0.05 to 2"),
    "relaxation": (0.1, 10.0, "a factor from 0.1 to 10"),
    "steer_lag": (0.1, 20.0, "a factor from 0.1 to 20"),
    "steer_ratio": (0.5, 1.5, "a gain from 0.5 to 1.5"),
    "steer_offset": (-0.1, 0.1, "an angle from -0.1 to 0.1 rad"),
    "steer_play": (0.0, 0.1, "an angle from 0 to 0.1 rad"),
    "drive_lag": (0.1, 20.0, "a factor from 0.1 to 20"),
    "brake_gain": (0.1, 2.0, "a gain from 0.1 to 2"),
    "tire_radius": (0.9, 1.1, "a factor from 0.9 to 1.1"),
    "side_area": (0.0, 10.0, "a factor from 0 to 10"),
    "side_lever": (-2.0, 2.0, "a length from -2 to 2 m, or None"),
}
"""Allowed domain of each deviation; what is not named here is a `FACTOR`."""

CRITICAL_SPEED = 15.0
"""An oversteering car that is unstable from a lower speed than this is refused [m/s]."""
TRAVEL_LEFT = 0.01
"""Suspension travel that must be left at rest before the stop [m]."""


@dataclass(frozen=True, kw_only=True)
class Deviations:
    """What is different about one car; the defaults are the nominal car's.

    Raises:
        OptionError: A value outside its domain.
    """

    mass: float = 1.0
    """Factor on the whole car's mass and inertia, its centre of mass unmoved [-]."""
    load: float = 0.0
    """Mass of a load carried by the body, a point [kg]."""
    load_x: float = 0.0
    """Where it lies, ahead of the nominal car's centre of mass [m]."""
    load_z: float = 0.7
    """Its height above the road [m]."""
    com_height: float = 0.0
    """How much higher the body sits in its mass: rise of the whole car's centre of mass [m]."""
    Iz: float = 1.0
    """Factor on the whole car's yaw inertia; its pitch inertia grows by as much, as it does where
    mass is moved along the car [-]."""
    Cf: float = 1.0
    """Factor on the front axle's cornering stiffness, at unchanged peak friction [-]."""
    Cr: float = 1.0
    """Factor on the rear axle's cornering stiffness, at unchanged peak friction [-]."""
    mu_f: float = 1.0
    """Factor on the front tires' friction, at unchanged stiffness [-]."""
    mu_r: float = 1.0
    """Factor on the rear tires' friction, at unchanged stiffness [-]."""
    relaxation: float = 1.0
    """Factor on all relaxation lengths [-]."""
    steer_lag: float = 1.0
    """Factor on the steering servo's time constant [-]."""
    steer_rate: float = 1.0
    """Factor on its largest rate [-]."""
    steer_ratio: float = 1.0
    """Road-wheel angle that the servo is asked for, per commanded angle [-]."""
    steer_offset: float = 0.0
    """Road-wheel angle at a command of zero [rad], left positive."""
    steer_play: float = 0.0
    """Width of the steering's play (backlash) [rad]."""
    drive_lag: float = 1.0
    """Factor on the time constant of drive and brakes [-]."""
    brake_gain: float = 1.0
    """Brake acceleration that is asked of the brakes, per commanded one [-]."""
    tire_radius: float = 1.0
    """Factor on the wheels' radius, rolling and unloaded [-]."""
    side_area: float = 1.0
    """Factor on the side-wind area [-]."""
    side_lever: float | None = None
    """Lever of the side force ahead of the nominal centre of mass [m]; None: the nominal one. The
    body carries it: a load that moves the centre of mass back makes it longer."""

    air_density: float = 1.0
    """Factor on the density of the air [-]."""

    def __post_init__(self) -> None:
        """Check every value's domain."""
        for field in fields(self):
            value = getattr(self, field.name)
            if value is None and field.name == "side_lever":
                continue
            low, high, allowed = RANGES.get(field.name, FACTOR)
            number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
            if not (number and low <= value <= high):  # NaN fails the comparison too
                raise OptionError(f"deviation {field.name}", value, allowed)

    def record(self) -> dict[str, Any]:
        """What differs from the nominal car, by name; empty for the nominal car."""
        nominal = asdict(NOMINAL)
        return {
            name: None if value is None else float(value)
            for name, value in asdict(self).items()
            if value != nominal[name]
        }


NOMINAL = Deviations()
"""The car that the controllers know."""


def named(values: Mapping[str, float | None]) -> Deviations:
    """Deviations by their names.

    Raises:
        UnknownNameError: There is no such deviation.
        OptionError: A value outside its domain.
    """
    known = [field.name for field in fields(Deviations)]
    for name in values:
        if name not in known:
            raise UnknownNameError("deviation", name, known)
    return Deviations(**values)  # type: ignore[arg-type]


def deviated(model: mujoco.MjModel, deviations: Deviations) -> mujoco.MjModel:
    """A copy of a compiled car with deviations; the model itself stays as it is.

    A stiffer tire (Cf, Cr) has another slope B C D at the same D. Less friction (mu_f, mu_r) is
    road friction by similarity, F(slip) = mu F0(slip / mu), as `tire.forces` does for the road.

    Raises:
        OptionError: The car cannot be driven: it does not stand on its four wheels or its springs,
            its inertia belongs to no body, or it is unstable from below `CRITICAL_SPEED`.
    """
    out = copy.copy(model)
    if deviations == NOMINAL:
        return out
    nominal = parameters(model)
    _masses(out, deviations, nominal)
    _tires(out, deviations)
    out.numeric("steering").data[0] *= deviations.steer_lag
    out.numeric("steering").data[1] *= deviations.steer_rate
    out.numeric("powertrain").data[0] *= deviations.drive_lag
    out.numeric("wheel").data[0] *= deviations.tire_radius
    mujoco.mj_setConst(out, mujoco.MjData(out))
    moved = _centre_of_mass(out)[0] - _centre_of_mass(model)[0]
    air = out.numeric("aero").data
    air[0] *= deviations.air_density
    air[2] *= deviations.side_area
    lever = air[3] if deviations.side_lever is None else deviations.side_lever
    air[3] = lever - moved
    _check(out, deviations)
    return out


def _masses(out: mujoco.MjModel, deviations: Deviations, nominal: VehicleParams) -> None:
    """Put mass, load, height and yaw inertia into the chassis body's inertial frame."""
    chassis = out.body("chassis").id
    mass, centre = float(out.body_mass[chassis]), out.body_ipos[chassis].copy()
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, out.body_iquat[chassis])
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(out.body_inertia[chassis]) @ axes.T
    com, whole = _centre_of_mass(out), _whole_inertia(out)
    parts = [(mass, centre, inertia)]
    if deviations.mass != 1.0:
        more = deviations.mass - 1.0
        parts.append((more * nominal.m, com, more * whole))
    if deviations.load:
        place = com + (deviations.load_x, 0.0, deviations.load_z - nominal.h)
        parts.append((deviations.load, place, np.zeros((3, 3))))
    total = sum(m for m, _, _ in parts)
    if total <= 0.0:
        raise OptionError("deviation mass", deviations.mass, "one that leaves the body a mass")
    middle = sum((m * c for m, c, _ in parts), np.zeros(3)) / total
    inertia = sum((i + m * _steiner(c - middle) for m, c, i in parts), np.zeros((3, 3)))
    longer = (deviations.Iz - 1.0) * whole[2, 2]
    inertia[1, 1] += longer  # mass moved along the car turns pitch and yaw alike
    inertia[2, 2] += longer
    if deviations.com_height:
        unsprung = nominal.m - mass
        middle[2] += deviations.com_height * (total + unsprung) / total
    principal, axes = np.linalg.eigh(inertia)
    if principal[0] <= 0.0 or principal[2] > principal[0] + principal[1]:
        raise OptionError(
            "deviation Iz", deviations.Iz, "one that leaves the body's inertia that of a body"
        )
    if np.linalg.det(axes) < 0.0:
        axes[:, 0] *= -1.0
    out.body_mass[chassis], out.body_ipos[chassis] = total, middle
    out.body_inertia[chassis] = principal
    mujoco.mju_mat2Quat(out.body_iquat[chassis], axes.ravel())


def _tires(out: mujoco.MjModel, deviations: Deviations) -> None:
    """Change the coefficients of both axles' tires."""
    law = tire.LAWS[tire_law(out)]
    for name, stiffness, friction in (
        ("tire_f", deviations.Cf, deviations.mu_f),
        ("tire_r", deviations.Cr, deviations.mu_r),
    ):
        c = out.numeric(name).data
        law.scale(c, stiffness, friction, deviations.relaxation)
        c[tire.R0] *= deviations.tire_radius


def _check(out: mujoco.MjModel, deviations: Deviations) -> None:
    """Refuse a car that cannot be driven.

    A car at rest needs load on both axles, springs that carry it, and more roll stiffness than its
    height takes. An oversteering one, K < 0, is unstable above V = sqrt(-L / K) with the
    understeer gradient K = m / L (lr / Cf - lf / Cr).
    """
    given = ", ".join(f"{name} {value:.6g}" for name, value in deviations.record().items())
    com = _centre_of_mass(out)
    data = mujoco.MjData(out)
    mujoco.mj_kinematics(out, data)
    x = {w: float(data.xpos[out.body(f"wheel_{w}").id][0]) for w in WHEELS}
    chassis = out.body("chassis").id
    ahead = x["fl"] - (float(data.xpos[chassis][0]) + com[0])
    behind = float(data.xpos[chassis][0]) + com[0] - x["rl"]
    if min(ahead, behind) < 0.05 * (ahead + behind):
        raise OptionError("deviations", given, "a car whose mass lies between its axles")
    weight = float(out.body_subtreemass[chassis]) * GRAVITY
    for axle, arm in (("f", behind), ("r", ahead)):
        joint = out.joint(f"susp_{axle}l")
        unsprung = float(out.body_subtreemass[out.body(f"knuckle_{axle}l").id]) * GRAVITY
        load = 0.5 * weight * arm / (ahead + behind) - unsprung
        stiffness = float(np.ravel(out.jnt_stiffness[joint.id])[0])
        travel = load / stiffness + float(out.qpos_spring[joint.qposadr[0]])
        if travel > float(out.jnt_range[joint.id, 1]) - TRAVEL_LEFT:
            raise OptionError("deviations", given, "a car that its springs carry off their stops")
    try:
        car = parameters(out)
    except OptionError as error:
        why = f"a car that stands; its {str(error).rstrip('.')}"
        raise OptionError("deviations", given, why) from None
    K = car.m / car.wheelbase * (car.lr / car.Cf - car.lf / car.Cr)
    if K < 0.0 and (critical := math.sqrt(-car.wheelbase / K)) < CRITICAL_SPEED:
        raise OptionError(
            "deviations", given, f"a car that is stable up to {CRITICAL_SPEED:g} m/s (this one: "
            f"{critical:.1f} m/s)",
        )


def _centre_of_mass(model: mujoco.MjModel) -> Array:
    """Centre of mass of the whole car in the chassis frame, at zero travel [m], shape (3,)."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    chassis = model.body("chassis").id
    return data.subtree_com[chassis] - data.xpos[chassis]


def _whole_inertia(model: mujoco.MjModel) -> Array:
    """Inertia of the whole car about its centre of mass [kg m2], shape (3, 3)."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    mass = float(model.body_subtreemass[model.body("chassis").id])
    return inertia[3:6, 3:6] - mass * _steiner(_centre_of_mass(model))


def _steiner(d: Array) -> Array:
    """Inertia of a unit mass at d about the origin, |d|^2 1 - d d^T [m2], shape (3, 3)."""
    return float(d @ d) * np.eye(3) - np.outer(d, d)
