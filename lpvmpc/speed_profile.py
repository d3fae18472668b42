"""The reference speed along a path: given by knots, or planned within the car's limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import PathError
from lpvmpc.path import Path

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class SpeedProfile:
    """Reference speed, linear between uniformly spaced points of a path.

    Beyond the ends of an open path the end values hold; on a closed path it repeats every lap.
    """

    vx: Array
    """Reference speed [m/s], shape (n + 1,)."""
    length: float
    """Arc length that the points span [m]."""
    closed: bool = False
    """Whether the path is closed."""

    def __post_init__(self) -> None:
        """Check the speeds and make them read-only.

        Raises:
            PathError: Speeds that are not positive numbers.
        """
        vx = np.ascontiguousarray(self.vx, dtype=float)
        if vx is self.vx:
            vx = vx.copy()
        if vx.ndim != 1 or len(vx) < 2 or not np.all(np.isfinite(vx)) or vx.min() <= 0.0:
            raise PathError("A reference speed must be positive and finite everywhere.")
        vx.flags.writeable = False
        object.__setattr__(self, "vx", vx)

    @classmethod
    def from_knots(cls, s: npt.ArrayLike, vx: npt.ArrayLike, path: Path) -> SpeedProfile:
        """Speed given at knots, linear in between, put on the grid of a path.

        Args:
            s: Arc length of the knots, increasing [m], shape (k,).
            vx: Speed [m/s], shape (k,).
            path: The path it belongs to.
        """
        period = path.length if path.closed else None
        return cls(np.interp(path.s, s, vx, period=period), path.length, path.closed)

    @classmethod
    def constant(cls, vx: float, path: Path) -> SpeedProfile:
        """One speed [m/s] all along a path."""
        return cls(np.full(len(path.s), float(vx)), path.length, path.closed)

    @property
    def spacing(self) -> float:
        """Distance of the points [m]."""
        return self.length / (len(self.vx) - 1)

    @property
    def s(self) -> Array:
        """Arc length of the points [m], shape (n + 1,)."""
        return np.linspace(0.0, self.length, len(self.vx))

    def at(self, s: npt.ArrayLike) -> Array:
        """Reference speed [m/s] at arc lengths [m], shape (...,)."""
        period = self.length if self.closed else None
        return np.interp(s, self.s, self.vx, period=period)

    @property
    def ax(self) -> Array:
        """Acceleration vx dvx/ds within each cell, at its middle [m/s2], shape (n,)."""
        return np.diff(0.5 * self.vx**2) / self.spacing

    @property
    def duration(self) -> float:
        """Time that the path, or one lap, takes at this speed [s]."""
        v0, v1 = self.vx[:-1], self.vx[1:]
        ratio = (v1 - v0) / v0
        # log(1 + q)/q is the exact mean of v0/v over a cell in which v is linear.
        small = np.abs(ratio) < 1e-6
        safe = np.where(small, 1.0, ratio)
        mean = np.where(small, 1.0 - 0.5 * ratio, np.log1p(safe) / safe)
        return math.fsum(self.spacing * mean / v0)
