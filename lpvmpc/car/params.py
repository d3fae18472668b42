"""What a controller may know of the car: its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from lpvmpc.errors import OptionError


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
    drive_front: float = 1.0
    """Share of the drive on the front axle [-]: 1 front-driven, 0 rear-driven."""
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
        may_be_zero = {
            "trail_f", "trail_r", "c_roll", "CdA", "CyA", "rho_air", "drive_front",
        }
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
        if self.drive_front > 1.0:
            raise OptionError("drive_front", self.drive_front, "a share from 0 to 1")
