"""Load transfer of a car on its springs, in a circle and along the road, in closed form."""

from __future__ import annotations

from lpvmpc.car.params import VehicleParams
from lpvmpc.studies.parts.rollover import Springs
from lpvmpc.studies.reference.circle_formulas import roll_gradient
from lpvmpc.units import GRAVITY


def lateral_transfer(p: VehicleParams, ay: float) -> tuple[float, float, float]:
    """Steady transfer and roll in a left turn, linear in the lateral acceleration.

    Args:
        p: Parameters of the car.
        ay: Lateral acceleration [m/s2].

    Returns:
        Transfer of the front and of the rear axle [N], roll angle [rad].
    """
    phi = roll_gradient(p) * ay
    springs = (p.K_phi + p.m * GRAVITY * p.h) * phi
    share = p.roll_share_front
    return share * springs / p.track_f, (1.0 - share) * springs / p.track_r, phi


def longitudinal_transfer(
    p: VehicleParams, springs: Springs, force: float, spin_up: float
) -> float:
    """Load that the front axle gains [N].

    Args:
        p: Parameters of the car.
        springs: Its springs.
        force: Longitudinal force of all tires [N].
        spin_up: Sum of the wheels' angular accelerations [rad/s2].
    """
    L = p.wheelbase
    moment = -(force * p.h + p.J_w * spin_up)
    softness = 0.5 / springs.front + 0.5 / springs.rear
    carried = p.m * GRAVITY * (p.h - springs.wheel_height) * softness / L**2
    return moment / L / (1.0 - carried)
