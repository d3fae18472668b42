"""The reference path: arc length, heading, curvature, projection and preview.

The curvature is piecewise linear on a uniform fine grid, so the path is a chain of short clothoids;
heading and position are its integrals, exact to rounding. Whatever a path was made of (curvature
knots, segments, points), the controller sees a continuous curvature that agrees with the position.

On a closed path the arc length counts up lap after lap and the heading keeps turning, so nothing
jumps at the start line. An open path goes on beyond both ends with the curvature it has there, so
a preview never runs out.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import PathError
from lpvmpc.interface import Preview
from lpvmpc.road import clothoid
from lpvmpc.units import Array

GRID = 0.2
"""Default spacing of the fine grid [m]; a whole number of cells always fits the length."""

MAX_POINTS = 2_000_000
"""More grid points than this are a mistake in units (400 km at the default spacing)."""

WIDTH = 3.5
"""Half width of a road that states none [m]."""


class Path:
    """A planar curve of piecewise-linear curvature.

    Attributes:
        s: Arc length of the grid points [m], shape (n + 1,), uniform from 0 to `length`.
        x: Position [m], shape (n + 1,).
        y: Position [m], shape (n + 1,).
        psi: Heading [rad], shape (n + 1,), unwrapped.
        kappa: Curvature [1/m], left positive, shape (n + 1,).
        length: Arc length of the path, or of one lap [m].
        closed: Whether the end is the start.
        spacing: Distance of the grid points along the path [m].
        turn: Change of heading over the whole path [rad]; a multiple of 2 pi on closed paths.
        width_right: Distance from the path to the right road edge [m], shape (n + 1,).
        width_left: The same to the left [m].
        has_widths: Whether the road states its widths; else they are `WIDTH`.
        largest_shift: How far smoothing moved a point it was made from [m]; 0 without smoothing.
    """

    def __init__(
        self,
        kappa: npt.ArrayLike,
        length: float,
        *,
        x0: float = 0.0,
        y0: float = 0.0,
        psi0: float = 0.0,
        closed: bool = False,
        width: float | tuple[npt.ArrayLike | None, npt.ArrayLike | None] | None = None,
        largest_shift: float = 0.0,
    ) -> None:
        """Integrate the curvature given on a uniform grid.

        On a closed path the curvature is first corrected by the smallest amount (in the mean
        square) that makes the ends meet exactly; `Path.closure_correction` tells how much.

        Args:
            kappa: Curvature at uniformly spaced points [1/m], shape (n + 1,).
            length: Arc length of the whole path [m].
            x0: Start [m].
            y0: Start [m].
            psi0: Start heading [rad].
            closed: Whether the path ends where and how it starts.
            width: Half width of the road [m], or the widths (right, left) on the grid; None
                where it states none.
            largest_shift: See the class.

        Raises:
            PathError: Not finite, no length, or closed with ends that do not meet.
        """
        kappa = np.array(kappa, dtype=float)
        if kappa.ndim != 1 or len(kappa) < 2 or not np.all(np.isfinite(kappa)):
            raise PathError("The curvature of a path must be at least two finite numbers.")
        if not (math.isfinite(length) and length > 0.0):
            raise PathError(f"The length of a path is {length!r} m, but must be positive.")
        n = len(kappa) - 1
        self.closed = bool(closed)
        self.length = float(length)
        self.spacing = self.length / n
        self.closure_correction = 0.0
        if closed:
            kappa = self._close(kappa, psi0)
        psi, x, y = clothoid.integrate(kappa, self.spacing, x0, y0, psi0)
        self.s = np.linspace(0.0, self.length, n + 1)
        # One contiguous table, so that a compiled call has one array to unpack.
        self._table = np.ascontiguousarray(np.column_stack([x, y, psi, kappa]))
        self._table.flags.writeable = False
        self.x, self.y, self.psi, self.kappa = self._table.T
        self.turn = float(psi[-1] - psi[0])
        sides = width if isinstance(width, tuple) else (width, width)
        self.has_widths = any(side is not None for side in sides)
        self.width_right, self.width_left = (
            np.broadcast_to(np.asarray(WIDTH if side is None else side, dtype=float), (n + 1,))
            for side in sides
        )
        self.largest_shift = float(largest_shift)

    def _close(self, kappa: Array, psi0: float) -> Array:
        """Correct the curvature so that position and heading close.

        To first order a change dk(s) moves the end by the integrals of dk (heading), -(y_end - y)
        dk and (x_end - x) dk (position), so the smallest change is a combination of 1, x(s) and
        y(s). Newton's method on the three factors.
        """
        n, h = len(kappa) - 1, self.spacing
        kappa = kappa.copy()
        jump = abs(kappa[-1] - kappa[0])
        kappa[0] = kappa[-1] = 0.5 * (kappa[0] + kappa[-1])
        before = kappa.copy()
        psi, x, y = clothoid.integrate(kappa, h, 0.0, 0.0, psi0)
        turn = 2.0 * math.pi * round((psi[-1] - psi[0]) / (2.0 * math.pi))
        gap = math.hypot(x[-1], y[-1])
        if gap > 0.05 * self.length or abs(psi[-1] - psi[0] - turn) > 0.5 or jump > 0.05:
            raise PathError(
                f"A closed path must end where and how it starts, but its ends are {gap:.3g} m "
                f"and {math.degrees(psi[-1] - psi[0] - turn):.3g} degrees apart."
            )
        basis = np.column_stack([np.ones(n + 1), x - x.mean(), y - y.mean()])
        scale = np.abs(basis).max(axis=0)
        basis /= np.where(scale > 0.0, scale, 1.0)
        basis[-1] = basis[0] = 0.5 * (basis[0] + basis[-1])
        for _ in range(12):
            psi, x, y = clothoid.integrate(kappa, h, 0.0, 0.0, psi0)
            miss = np.array([psi[-1] - psi[0] - turn, x[-1], y[-1]])
            weight = np.full(n + 1, h)
            weight[[0, -1]] *= 0.5
            effect = np.stack([np.ones(n + 1), -(y[-1] - y), x[-1] - x]) * weight  # (3, n + 1)
            kappa = kappa - basis @ np.linalg.solve(effect @ basis, miss)
            if np.abs(miss).max() < 1e-12 * max(1.0, self.length):
                break
        self.closure_correction = float(np.abs(kappa - before).max())
        return kappa

    @classmethod
    def from_curvature(
        cls,
        kappa_knots: npt.ArrayLike,
        ds_knots: float | npt.ArrayLike,
        *,
        x0: float = 0.0,
        y0: float = 0.0,
        psi0: float = 0.0,
        closed: bool = False,
        grid: float = GRID,
    ) -> Path:
        """Path whose curvature is linear between knots.

        Args:
            kappa_knots: Curvature at the knots [1/m], shape (k,).
            ds_knots: Distance of the knots [m], one number or shape (k - 1,). With one number the
                knots lie on the grid; otherwise they are met within half a cell.
            x0: Start [m].
            y0: Start [m].
            psi0: Start heading [rad].
            closed: Whether the path ends where and how it starts.
            grid: Largest spacing of the fine grid [m].

        Raises:
            PathError: Knots that are not finite, or distances that are not positive.
        """
        knots = np.asarray(kappa_knots, dtype=float)
        if knots.ndim != 1 or len(knots) < 2:
            raise PathError("A path needs at least two curvature knots.")
        steps = np.broadcast_to(np.asarray(ds_knots, dtype=float), (len(knots) - 1,))
        if not np.all(np.isfinite(steps)) or np.any(steps <= 0.0):
            raise PathError("The distances between curvature knots must be positive numbers.")
        s_knots = np.concatenate([[0.0], np.cumsum(steps)])
        length = float(s_knots[-1])
        if np.ndim(ds_knots) == 0:
            cells = math.ceil(float(steps[0]) / grid - 1e-9) * len(steps)
        else:
            cells = math.ceil(length / grid - 1e-9)
        if cells > MAX_POINTS:
            raise PathError(f"A path of {length:.6g} m is longer than this program handles.")
        kappa = np.interp(np.linspace(0.0, length, cells + 1), s_knots, knots)
        return cls(kappa, length, x0=x0, y0=y0, psi0=psi0, closed=closed)

    def at(self, s: npt.ArrayLike) -> tuple[Array, Array, Array, Array]:
        """Position, heading and curvature at arc lengths.

        Args:
            s: Arc length [m], shape (...,).

        Returns:
            x [m], y [m], psi [rad, unwrapped], kappa [1/m], each of shape (...,).
        """
        s = np.asarray(s, dtype=float)
        out = clothoid.poses(
            self._table, self.spacing, self.closed, np.ascontiguousarray(s).ravel()
        )
        return tuple(column.reshape(s.shape) for column in out)  # type: ignore[return-value]

    def width_at(self, s: float, ey: float) -> float:
        """Width of the road [m] at an arc length [m], on the side to which ey [m] points."""
        width = self.width_left if ey > 0.0 else self.width_right
        return float(np.interp(s, self.s, width, period=self.length if self.closed else None))

    def project(self, x: float, y: float, s_prev: float) -> tuple[float, float]:
        """Foot of the perpendicular from a point, searched from the previous one.

        Descends the distance from `s_prev`, at most 1 m per iteration, so it stays on the branch
        where it was: crossing branches and the start line do not exist for it.

        Args:
            x: Point [m].
            y: Point [m].
            s_prev: Arc length of the previous projection [m].

        Returns:
            s [m] (not wrapped on closed paths) and ey [m, left positive].
        """
        return clothoid.project(self._table, self.spacing, self.closed, x, y, s_prev)

    def preview(
        self,
        x: float,
        y: float,
        psi: float,
        s_prev: float,
        vx_ref: Array,
        spacing: float,
        Np: int,
        Ts: float,
    ) -> Preview:
        """Errors of the car and the reference along the horizon, in one compiled call.

        Args:
            x: Position of the car [m].
            y: Position of the car [m].
            psi: Heading of the car [rad], any multiple of 2 pi away.
            s_prev: Arc length of the previous projection [m].
            vx_ref: Reference speed at uniformly spaced points of this path [m/s], shape (n,).
            spacing: Their distance along the path [m].
            Np: Number of steps of the horizon.
            Ts: Step [s].
        """
        s, ey, epsi, rows = clothoid.preview(
            self._table,
            self.spacing,
            self.closed,
            vx_ref,
            spacing,
            x,
            y,
            psi,
            s_prev,
            Np,
            Ts,
        )
        return Preview(s, ey, epsi, rows[0], rows[1], rows[2], rows[3], rows[4])
