"""The largest steady lateral acceleration of a car, which its model file states as `ay_limit`."""

from __future__ import annotations

import math

from lpvmpc.errors import OptionError
from lpvmpc.plant.plant import Plant
from lpvmpc.units import GRAVITY

RADIUS = 100.0
"""Radius of the circle [m]; ISO 4138's standard one."""


def largest_lateral_acceleration(plant: Plant, precision: float = 0.01) -> float:
    """Largest lateral acceleration that the car can hold on the circle [m/s2], by bisection.

    Args:
        plant: The car; reset here.
        precision: Width of the last interval [m/s2].
    """
    low, high = 3.0, 2.5 * GRAVITY
    while high - low > precision:
        ay = 0.5 * (low + high)
        vx = math.sqrt(ay * RADIUS)
        try:
            plant.reset(vx=vx, kappa=ay / vx**2)
        except OptionError:
            high = ay
        else:
            low = ay
    return low
