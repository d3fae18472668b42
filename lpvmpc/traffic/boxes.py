"""Boxes on the ground, and how far apart they are."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.units import Array


class Box(NamedTuple):
    """A rectangle on the ground."""

    x: float
    """Its centre [m]."""
    y: float
    """The same [m]."""
    psi: float
    """Heading of its long side [rad]."""
    length: float
    """Its length [m]."""
    width: float
    """Its width [m]."""

    def corners(self) -> Array:
        """Its corners [m], shape (4, 2), one after the other round it."""
        c, s = math.cos(self.psi), math.sin(self.psi)
        ahead = 0.5 * self.length * np.array([1.0, 1.0, -1.0, -1.0])
        left = 0.5 * self.width * np.array([1.0, -1.0, -1.0, 1.0])
        return np.column_stack([self.x + c * ahead - s * left, self.y + s * ahead + c * left])


def footprint(car: VehicleParams, x: float, y: float, psi: float) -> Box:
    """The body of a car whose centre of mass is at (x, y) [m] with heading psi [rad].

    Its middle is taken to be midway between the axles.
    """
    ahead = 0.5 * (car.lf - car.lr)
    return Box(x + ahead * math.cos(psi), y + ahead * math.sin(psi), psi, car.length, car.width)


def gap(a: Box, b: Box) -> float:
    """Smallest distance between two boxes [m]; 0 where they touch or overlap.

    Convex bodies overlap unless a line along one of their sides parts them; if one does, the
    smallest distance is that of a corner of one from a side of the other.
    """
    corners = a.corners(), b.corners()
    if not any(_parts(corners, psi) for psi in (a.psi, b.psi)):
        return 0.0
    return min(_from_sides(*corners), _from_sides(*reversed(corners)))


def _parts(corners: tuple[Array, Array], psi: float) -> bool:
    """Whether the boxes lie apart, seen along or across a heading."""
    c, s = math.cos(psi), math.sin(psi)
    for axis in ((c, s), (-s, c)):
        one, other = (points @ np.array(axis) for points in corners)
        if one.max() < other.min() or other.max() < one.min():
            return True
    return False


def _from_sides(points: Array, box: Array) -> float:
    """Smallest distance of some points, shape (n, 2), from the sides of a box, shape (4, 2)."""
    side = np.roll(box, -1, axis=0) - box
    to = points[:, None, :] - box[None, :, :]  # (n, 4, 2)
    along = np.clip((to * side).sum(axis=2) / (side * side).sum(axis=1), 0.0, 1.0)
    return float(np.sqrt(((to - along[:, :, None] * side) ** 2).sum(axis=2)).min())
