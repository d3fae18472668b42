"""Lanes of cones: the courses of ISO 3888, and where their cones stand.

The lanes of ISO 3888-1 (double lane change) and 3888-2 (obstacle avoidance): lengths and widths as
public implementations of the standards give them (Project Chrono, MathWorks); widths grow with the
vehicle's width without mirrors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lpvmpc.units import Array

CONE_SPACING = 3.0
"""Largest distance of the cones along a lane [m]; the car is longer, so none slips through."""


@dataclass(frozen=True)
class Lane:
    """A straight lane along x between two rows of cones."""

    start: float
    """Where it begins [m]."""
    end: float
    """Where it ends [m]."""
    middle: float
    """Its middle [m], left positive."""
    width: float
    """Between the cones [m]."""


@dataclass(frozen=True)
class Course:
    """Lanes to drive through."""

    name: str
    """What it is."""
    lanes: tuple[Lane, ...]
    """In the order of driving, the first one on the x axis."""
    coasting: bool
    """Whether it is driven without drive and brakes."""

    @property
    def length(self) -> float:
        """End of the last lane [m]."""
        return self.lanes[-1].end

    @cached_property
    def cones(self) -> Array:
        """Points where cones touch the lanes: x, y [m], side (1 left, -1 right), shape (n, 3)."""
        return self.edge(CONE_SPACING)

    def edge(self, spacing: float) -> Array:
        """Points on the edges of the lanes, at most so far apart [m]."""
        points = []
        for lane in self.lanes:
            count = math.ceil((lane.end - lane.start) / spacing)
            for x in np.linspace(lane.start, lane.end, count + 1):
                points += [(x, lane.middle + side * lane.width / 2.0, side) for side in (1.0, -1.0)]
        return np.array(points)


def double_lane_change(width: float) -> Course:
    """ISO 3888-1: lanes of 15, 25 and 30 m, gaps of 30 and 25 m, offset 3.5 m.

    The offset is read as that of the lanes' middles, as in the scenario `double-lane-change`.

    Args:
        width: Of the vehicle, without mirrors [m].
    """
    lanes = (
        Lane(0.0, 15.0, 0.0, 1.1 * width + 0.25),
        Lane(45.0, 70.0, 3.5, 1.2 * width + 0.25),
        Lane(95.0, 125.0, 0.0, 1.3 * width + 0.25),
    )
    return Course("ISO 3888-1, double lane change", lanes, coasting=False)


def obstacle_avoidance(width: float) -> Course:
    """ISO 3888-2: lanes of 12, 11 and 12 m, gaps of 13.5 and 12.5 m, 1 m between the lanes' edges.

    Args:
        width: Of the vehicle, without mirrors [m].
    """
    first, second, third = 1.1 * width + 0.25, width + 1.0, max(1.3 * width + 0.25, 3.0)
    lanes = (
        Lane(0.0, 12.0, 0.0, first),
        Lane(25.5, 36.5, first / 2.0 + 1.0 + second / 2.0, second),
        Lane(49.0, 61.0, 0.0, third),
    )
    return Course("ISO 3888-2, obstacle avoidance", lanes, coasting=True)
