"""The outline of the car, and the flattest path between cones."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix

from lpvmpc.road import segments
from lpvmpc.road.cones import Course
from lpvmpc.road.path import Path
from lpvmpc.units import Array

LEAD, TAIL = 25.0, 35.0
"""Road before the first and behind the last lane [m]."""
CELL = 0.5
"""Spacing of the points at which the flattest path may change its curvature [m]."""
BUILD_UP = 4.0
"""Length over which the flattest path builds up its curvature, about [m]: at 20 m/s the lateral
acceleration needs 0.2 s."""


@dataclass(frozen=True)
class Outline:
    """The car from above: a rectangle around its centre of mass."""

    front: float
    """Centre of mass to front bumper [m]."""
    rear: float
    """Centre of mass to rear bumper [m]."""
    half_width: float
    """Half the width without mirrors [m]."""


def clearance(outline: Outline, points: Array, poses: Array) -> Array:
    """Smallest distance of each point from the outline along a drive; negative inside.

    Args:
        outline: Of the car.
        points: x, y in the first two columns [m], shape (k, ...).
        poses: x, y [m], psi [rad] of the centre of mass, shape (n, 3).

    Returns:
        Distances [m], shape (k,).
    """
    dx, dy = (points[:, i, None] - poses[:, i] for i in (0, 1))  # (k, n)
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
    over_x = np.maximum(ahead - outline.front, -outline.rear - ahead)
    over_y = np.abs(left) - outline.half_width
    outside = np.hypot(np.maximum(over_x, 0.0), np.maximum(over_y, 0.0))
    distance: Array = np.where(outside > 0.0, outside, np.maximum(over_x, over_y)).min(axis=1)
    return distance


@dataclass(frozen=True)
class FlatPath:
    """A path y(x) through the lanes with little curvature."""

    x: Array
    """Along the lanes [m], shape (n,)."""
    y: Array
    """Across [m]."""
    slope: Array
    """y'."""
    bending: Array
    """y'' [1/m]."""

    @property
    def curvature(self) -> float:
        """Largest curvature [1/m]."""
        return float(np.abs(self.bending / (1.0 + self.slope**2) ** 1.5).max())

    def path(self) -> Path:
        """As a road that starts at the origin; its x is this one's plus LEAD."""

        def derivatives(x: Array) -> tuple[Array, Array]:
            at = x - LEAD
            return np.interp(at, self.x, self.slope), np.interp(at, self.x, self.bending)

        return segments.from_graph(derivatives, float(self.x[-1]) + LEAD)


def flattest_path(
    course: Course, outline: Outline, margin: float, build_up: float = BUILD_UP
) -> FlatPath:
    """Path of the centre of mass with the least peak of curvature between the cones.

    A linear programme: minimise the peak of the curvature plus `build_up` times the peak of its
    rate, while the side of the car, which points along the path, keeps `margin` from the edges
    wherever it is beside them. Slopes reach 0.2, so that it is repeated with the slopes of the
    last solution in the geometry.

    Args:
        course: Lanes.
        outline: Of the car.
        margin: Distance of the car's sides from the edges of the lanes [m].
        build_up: Weight of the rate of curvature [m].
    """
    n = round((LEAD + course.length + TAIL) / CELL) + 1
    x = np.linspace(-LEAD, course.length + TAIL, n)
    to_slope, to_y = _integrals(n, x[1] - x[0])
    points = course.edge(1.0)
    slope = np.zeros(n)
    for _ in range(10):
        psi = np.arctan(slope)
        sides, room = _sides(points, x, psi, to_slope, to_y, outline, margin)
        stretch = (1.0 + slope**2) ** 1.5
        bending = _solve(to_slope, to_y, sides, room, stretch, x[1] - x[0], build_up)
        change = np.abs(to_slope @ bending - slope).max()
        slope = to_slope @ bending
        if change < 1e-3:  # 4 mm at a bumper
            break
    return FlatPath(x, to_y @ bending, slope, bending)


def _integrals(n: int, h: float) -> tuple[Array, Array]:
    """Matrices that give y' and y from y'', which is linear between its n points."""
    to_slope, to_y = np.zeros((n, n)), np.zeros((n, n))
    for i in range(1, n):
        to_slope[i] = to_slope[i - 1]
        to_slope[i, i - 1 : i + 1] += h / 2.0
        to_y[i] = to_y[i - 1] + h * to_slope[i - 1]
        to_y[i, i - 1 : i + 1] += h * h / 3.0, h * h / 6.0
    return to_slope, to_y


def _sides(
    points: Array, x: Array, psi: Array, to_slope: Array, to_y: Array, outline: Outline,
    margin: float,
) -> tuple[Array, Array]:
    """Rows A, b of A y'' <= b: where a side of the car is beside a point, it stays inside it."""
    rows, room = [], []
    for at, edge, side in points:
        ahead = (at - x) * np.cos(psi)
        for i in np.flatnonzero((ahead > -outline.rear - CELL) & (ahead < outline.front + CELL)):
            rows.append(side * (to_y[i] + (at - x[i]) * to_slope[i]))
            room.append(side * edge - outline.half_width / math.cos(psi[i]) - margin)
    return np.array(rows), np.array(room)


def _solve(
    to_slope: Array, to_y: Array, sides: Array, room: Array, stretch: Array, h: float,
    build_up: float,
) -> Array:
    """One linear programme over y'' and the peaks of curvature and of its rate."""
    n = len(stretch)
    curvature, rate = np.diag(1.0 / stretch), np.diff(np.eye(n), axis=0) / h
    blocks = [np.hstack([sides, np.zeros((len(sides), 2))])]
    for rows, peak in ((curvature, (-1.0, 0.0)), (rate, (0.0, -1.0))):
        for sign in (1.0, -1.0):
            blocks.append(np.hstack([sign * rows, np.tile(peak, (len(rows), 1))]))
    upper = np.concatenate([room, np.zeros(2 * n + 2 * (n - 1))])
    ends = np.zeros((4, n + 2))  # straight and on the axis again at the end, no step of curvature
    ends[0, :n], ends[1, :n], ends[2, 0], ends[3, n - 1] = to_slope[-1], to_y[-1], 1.0, 1.0
    cost = np.zeros(n + 2)
    cost[n:] = 1.0, build_up
    solution = linprog(
        cost, A_ub=csr_matrix(np.vstack(blocks)), b_ub=upper, A_eq=csr_matrix(ends),
        b_eq=np.zeros(4), bounds=[(None, None)] * n + [(0.0, None)] * 2, method="highs",
    )
    assert solution.status == 0, solution.message
    bending: Array = solution.x[:n]
    return bending
