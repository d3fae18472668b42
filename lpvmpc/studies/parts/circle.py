"""A car that drives steadily in a circle: states, levels, gradients, the limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import OptionError
from lpvmpc.plant.plant import Plant
from lpvmpc.units import GRAVITY, Array

SPEED = 100.0 / 3.6
"""Speed of the constant-speed test [m/s]."""
STEP = 0.5
"""Largest step of lateral acceleration in ISO 4138 [m/s2]."""


@dataclass(frozen=True)
class Steady:
    """A car that drives steadily in a circle; left turns are positive."""

    vx: float
    """Longitudinal speed [m/s]."""
    vy: float
    """Lateral speed [m/s]."""
    r: float
    """Yaw rate [rad/s]."""
    delta: float
    """Steer [rad]."""
    roll: float
    """Roll angle [rad]."""
    loads: tuple[float, ...]
    """Wheel loads fl, fr, rl, rr [N]."""

    @property
    def ay(self) -> float:
        """Lateral acceleration [m/s2]."""
        return self.vx * self.r

    def understeer(self, wheelbase: float) -> float:
        """Steer less that of the geometry, delta - L r / vx [rad]."""
        return self.delta - wheelbase * self.r / self.vx

    def rear_slip(self, lr: float) -> float:
        """Sideslip angle of the rear axle, (vy - lr r) / vx [rad]."""
        return (self.vy - lr * self.r) / self.vx


def steady(plant: Plant, vx: float, ay: float) -> Steady:
    """Let a car settle in a circle.

    Args:
        plant: plant.
        vx: speed [m/s].
        ay: lateral acceleration [m/s2], positive to the left.

    Raises:
        OptionError: the car cannot hold that.
    """
    s = plant.reset(vx=vx, kappa=ay / vx**2)
    return Steady(s.vx, s.vy, s.r, s.delta, plant.roll, tuple(plant.wheels.Fz))


def levels(limit: float) -> Array:
    """Lateral accelerations up to a limit, in steps of ISO 4138 [m/s2]."""
    return np.append(np.arange(STEP, limit - 0.1, STEP), 0.995 * limit)


def drivable(plant: Plant, limit: float) -> list[float]:
    """Levels that the car can hold at the constant speed [m/s2]."""
    found = []
    for ay in levels(limit):
        try:
            steady(plant, SPEED, ay)
        except OptionError:
            break
        found.append(float(ay))
    return found


def both_ways(plant: Plant, points: Iterable[tuple[float, float]]) -> list[Steady]:
    """Steady states (vx, ay) to the right and to the left, by rising ay."""
    points = list(points)
    turns = [(vx, -ay) for vx, ay in reversed(points)] + points
    return [steady(plant, vx, ay) for vx, ay in turns]


def slope_at_zero(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope at zero of the odd cubic a x + b x^3 through points."""
    at = np.array(x)
    return float(np.linalg.lstsq(np.stack([at, at**3], axis=1), np.array(y), rcond=None)[0][0])


def deg_per_g(gradient: float) -> float:
    """A gradient of rad s2/m in deg/g."""
    return math.degrees(gradient) * GRAVITY


def fastest_turning_speed(plant: Plant, ay: float = 0.5) -> float:
    """Speed of the highest yaw gain [m/s]: vertex of the parabola through the best three."""
    speeds = np.arange(20.0, 33.0)
    gain = np.array([s.r / s.delta for s in (steady(plant, vx, ay) for vx in speeds)])
    best = int(np.clip(np.argmax(gain), 1, len(speeds) - 2))
    a, b, _ = np.polyfit(speeds[best - 1 : best + 2], gain[best - 1 : best + 2], 2)
    return float(-b / (2.0 * a))


def sideslip_free_speed(plant: Plant, ay: float = 1.0) -> float:
    """Speed at which the sideslip of the centre of mass changes its sign [m/s]."""
    speeds = np.arange(15.0, 32.0, 2.0)
    vy = [steady(plant, vx, ay).vy for vx in speeds]
    return float(np.interp(0.0, -np.array(vy), speeds))


def effective_stiffness(s: Steady, p: VehicleParams) -> tuple[float, float]:
    """Front and rear lateral force over slip angle of the single track [N/rad]."""
    share = p.m * s.ay / p.wheelbase
    front = s.delta - (s.vy + p.lf * s.r) / s.vx
    return share * p.lr / front, share * p.lf / -s.rear_slip(p.lr)
