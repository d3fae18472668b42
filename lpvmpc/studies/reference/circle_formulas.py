"""The linear single track in a circle: understeer, rear slip, roll and yaw gain."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lpvmpc.car.params import VehicleParams


@dataclass(frozen=True)
class Linear:
    """What the linear single track with the tires' slopes says of a car."""

    understeer: float
    """Understeer gradient U [rad s2/m]."""
    rear_slip: float
    """Rear slip gradient [rad s2/m]."""
    roll: float
    """Roll gradient [rad s2/m]."""
    wheelbase: float
    """Wheelbase [m]."""

    @classmethod
    def of(cls, p: VehicleParams) -> Linear:
        """The linear formulas of a car."""
        front, rear = p.lf - p.trail_f, p.lr + p.trail_r
        share = p.m / (front + rear)
        return cls(
            understeer=share * (rear / p.Cf - front / p.Cr),
            rear_slip=-share * front / p.Cr,
            roll=p.m * p.h / p.K_phi,
            wheelbase=p.wheelbase,
        )

    def yaw_gain(self, vx: Any) -> Any:
        """Yaw rate over steer [1/s]: vx / (L + U vx^2)."""
        return vx / (self.wheelbase + self.understeer * vx**2)
