"""What a controller may know: the car's state, its command, and its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path as FilePath
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import ModelError, OptionError, UnknownNameError

Array = npt.NDArray[np.float64]

GRAVITY = 9.81
"""Gravitational acceleration of the paper's Table 2 [m/s2]."""


class State(NamedTuple):
    """True or estimated state of the car at one control instant.

    The frame is ISO 8855: x forward, y left, counter-clockwise angles positive. Position and
    velocity are those of the centre of mass of the whole car.
    """

    x: float
    """Position [m]."""
    y: float
    """Position [m]."""
    psi: float
    """Heading [rad], unwrapped."""
    vx: float
    """Longitudinal speed, body frame [m/s]."""
    vy: float
    """Lateral speed, body frame [m/s]."""
    r: float
    """Yaw rate [rad/s]."""
    delta: float
    """Real road-wheel angle of the equivalent single track [rad]."""
    ax: float
    """Longitudinal acceleration of the centre of mass [m/s2], gravity excluded."""
    ay: float
    """Lateral acceleration of the centre of mass [m/s2], gravity excluded."""
    wheel_speed: Array
    """Spin of the wheels fl, fr, rl, rr [rad/s], shape (4,)."""


class Command(NamedTuple):
    """What a controller asks of the car for one control period."""

    delta: float
    """Road-wheel steering angle [rad], left positive."""
    ax: float
    """Drive (positive) or brake (negative) acceleration before resistances [m/s2]."""


class AxleForces(NamedTuple):
    """True forces and slip angles of the axles; only the oracle stiffness model is told them."""

    Fyf: float
    """Lateral force of the front wheels across their heading [N]."""
    Fyr: float
    """Lateral force of the rear wheels [N]."""
    Fzf: float
    """Load of the front axle [N]."""
    Fzr: float
    """Load of the rear axle [N]."""
    alpha_f: float
    """Front slip angle of the single track [rad]."""
    alpha_r: float
    """Rear slip angle of the single track [rad]."""
    Fxf: float
    """Longitudinal force of the front wheels along their heading [N]."""
    Fxr: float
    """Longitudinal force of the rear wheels [N]."""
    mu: float
    """Peak friction of the four wheels, weighted by their loads [-]."""


@dataclass(frozen=True, kw_only=True)
class VehicleParams:
    """Physical parameters of the car, read from the MJCF (the only place they are typed)."""

    m: float
    """Total mass [kg]."""
    Iz: float
    """Yaw inertia of the whole car about its centre of mass [kg m2]."""
    lf: float
    """Centre of mass to front axle [m]."""
    lr: float
    """Centre of mass to rear axle [m]."""
    track_f: float
    """Front track width [m]."""
    track_r: float
    """Rear track width [m]."""
    h: float
    """Height of the centre of mass above the road in the settled pose [m]."""
    width: float
    """Body width without mirrors [m]."""
    length: float
    """Body length [m]."""
    R_w: float
    """Wheel radius [m]."""
    J_w: float
    """Spin inertia of one wheel [kg m2]."""
    mu: float
    """Peak tire-road friction at nominal load, friction scale 1 [-]."""
    Cf: float
    """Front axle cornering stiffness at static load [N/rad], from the tire coefficients."""
    Cr: float
    """Rear axle cornering stiffness at static load [N/rad], from the tire coefficients."""
    Ixx: float
    """Roll inertia about the centre of mass, without the wheels, which stay down [kg m2]."""
    K_phi: float
    """Roll stiffness: springs, anti-roll bars and tires in series, less gravity [N m/rad]."""
    C_phi: float
    """Roll damping of the dampers, as seen through the tires [N m s/rad]."""
    roll_share_front: float
    """Share of the roll stiffness, and so of the load transfer, at the front axle [-]."""
    trail_f: float
    """Pneumatic trail of the front tires at small slip [m]."""
    trail_r: float
    """Pneumatic trail of the rear tires at small slip [m]."""
    sigma_f: float
    """Lateral relaxation length of the front tires at static load [m]."""
    sigma_r: float
    """Lateral relaxation length of the rear tires at static load [m]."""
    c_roll: float
    """Rolling resistance coefficient [-]."""
    rho_air: float
    """Air density [kg/m3]."""
    CdA: float
    """Drag area [m2]."""
    CyA: float
    """Side-wind area [m2]."""
    x_cy: float
    """Lever of the side force ahead of the centre of mass [m]."""
    tau_delta: float
    """Time constant of the steering servo [s]."""
    delta_max: float
    """Largest road-wheel angle [rad]."""
    delta_rate_max: float
    """Largest rate of the road-wheel angle [rad/s]."""
    tau_ax: float
    """Time constant of drive and brake [s]."""
    F_drive_max: float
    """Largest drive force at the wheels, from the motor's torque [N]."""
    P_drive_max: float
    """Largest drive power [W]."""
    F_brake_max: float
    """Largest brake force of all four wheels [N]."""
    brake_front: float
    """Share of the brake force on the front axle [-]."""
    ay_limit: float
    """Largest steady lateral acceleration on a 100 m circle, friction scale 1 [m/s2]."""
    vx_min: float
    """Speed below which the single-track model is not used [m/s]."""

    @property
    def wheelbase(self) -> float:
        """Distance between the axles [m]."""
        return self.lf + self.lr

    @property
    def m_eff(self) -> float:
        """Mass including the wheels' spin, m + 4 J_w / R_w^2 [kg]."""
        return self.m + 4.0 * self.J_w / self.R_w**2

    def ax_max(self, vx: float) -> float:
        """Largest acceleration that motor torque and power allow, before resistances [m/s2]."""
        force = min(self.F_drive_max, self.P_drive_max / max(vx, 1.0))
        return force / self.m_eff

    @property
    def ax_min(self) -> float:
        """Strongest braking the brakes can give, before resistances [m/s2], negative."""
        return -self.F_brake_max / self.m_eff

    def __post_init__(self) -> None:
        """Raise OptionError for a parameter that no car can have."""
        signed = {"x_cy"}
        may_be_zero = {"trail_f", "trail_r", "c_roll", "CdA", "CyA", "rho_air"}
        for field in fields(self):
            value = getattr(self, field.name)
            if not math.isfinite(value):
                raise OptionError(field.name, value, "a finite number")
            if field.name in signed:
                continue
            if field.name in may_be_zero and value < 0.0:
                raise OptionError(field.name, value, "zero or positive")
            if field.name not in may_be_zero and value <= 0.0:
                raise OptionError(field.name, value, "positive")
        if self.brake_front >= 1.0:
            raise OptionError("brake_front", self.brake_front, "a share between 0 and 1")

    @classmethod
    def load(cls, path: str | FilePath | None = None) -> VehicleParams:
        """Read the parameters from an MJCF file (default: the packaged models/vehicle.xml).

        Raises:
            ModelError: the file is broken, or not a car of this package.
        """
        from lpvmpc import model  # MuJoCo and numba: not for those who only need the types

        return model.parameters(model.compile_model(path))


def models_dir() -> FilePath:
    """Folder of the MJCF files: lpvmpc/models in a wheel, models/ in a checkout.

    Raises:
        ModelError: neither exists.
    """
    package = FilePath(__file__).resolve().parent
    for folder in (package / "models", package.parent / "models"):
        if (folder / "vehicle.xml").is_file():
            return folder
    raise ModelError(f"No models/vehicle.xml beside {package}; the installation is damaged.")


def model_path(name: str) -> FilePath:
    """Path of a packaged MJCF file by its name, with or without .xml.

    Raises:
        UnknownNameError: there is no such file; the message lists those there are.
    """
    folder = models_dir()
    path = folder / (name if name.endswith(".xml") else f"{name}.xml")
    if not path.is_file():
        raise UnknownNameError("model", name, (file.stem for file in folder.glob("*.xml")))
    return path
