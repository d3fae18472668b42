"""The reference speed along a path: given by knots, or planned within the car's limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import PathError
from lpvmpc.road.path import Path
from lpvmpc.units import GRAVITY, Array

SMOOTHING_TIME = 0.3
"""Half the time over which a change of planned acceleration is spread [s]."""
DRIVE_MARGIN = 0.85
"""Share of the motor's and the brakes' force that a plan may use; the rest is for control."""
_STEP = 0.02
"""Time step of the smoothing [s]."""
_HALF = math.ceil(SMOOTHING_TIME / _STEP)
"""Steps on either side of its window."""


@dataclass(frozen=True)
class SpeedProfile:
    """Reference speed, linear between uniformly spaced points of a path.

    Beyond the ends of an open path the end values hold; on a closed path it repeats every lap.

    At either end of an open path it may be given as 0: the car starts from rest, or stops there.
    A reference point at 0 m/s would never get going, so in that end's cell it moves at half the
    speed of the cell's other side: the mean speed of a constant acceleration from rest.
    """

    vx: Array
    """Reference speed [m/s], shape (n + 1,)."""
    length: float
    """Arc length that the points span [m]."""
    closed: bool = False
    """Whether the path is closed."""
    rest: tuple[bool, bool] = (False, False)
    """Whether the car starts from rest, and whether it stops at the end; true where the speed is
    given as 0 there."""

    def __post_init__(self) -> None:
        """Check the speeds and make them read-only.

        Raises:
            PathError: Speeds that are not positive numbers, 0 at an end of an open path excepted.
        """
        vx = np.ascontiguousarray(self.vx, dtype=float)
        if vx is self.vx:
            vx = vx.copy()
        if vx.ndim == 1 and len(vx) > 2 and not self.closed:
            rest = self.rest[0] or vx[0] == 0.0, self.rest[1] or vx[-1] == 0.0
            object.__setattr__(self, "rest", (bool(rest[0]), bool(rest[1])))
            for end, inner in ((0, 1), (-1, -2)):
                if vx[end] == 0.0:
                    vx[end] = 0.5 * vx[inner]
        if vx.ndim != 1 or len(vx) < 2 or not np.all(np.isfinite(vx)) or vx.min() <= 0.0:
            raise PathError(
                "A reference speed must be positive and finite everywhere; only an open road may "
                "have 0 at its first and its last point."
            )
        vx.flags.writeable = False
        object.__setattr__(self, "vx", vx)

    @classmethod
    def from_knots(cls, s: npt.ArrayLike, vx: npt.ArrayLike, path: Path) -> SpeedProfile:
        """Speed given at knots, linear in between, put on the grid of a path.

        From or to a knot at rest the acceleration is constant instead: linear in vx^2.

        Args:
            s: Arc length of the knots, increasing [m], shape (k,).
            vx: Speed [m/s], shape (k,).
            path: The path it belongs to.
        """
        period = path.length if path.closed else None
        at, speeds = np.asarray(s, dtype=float), np.asarray(vx, dtype=float)
        values = np.interp(path.s, at, speeds, period=period)
        if not path.closed and len(at) > 2 and speeds[[0, -1]].min() == 0.0:
            at = at.copy()
            at[[0, -1]] = 0.0, path.length  # a foot may lie a little inside the path
            constant = np.sqrt(np.interp(path.s, at, speeds**2))
            for here, zone in ((0, path.s < at[1]), (-1, path.s > at[-2])):
                if speeds[here] == 0.0:
                    values[zone] = constant[zone]
        return cls(values, path.length, path.closed)

    def capped(self, v_max: float) -> SpeedProfile:
        """The same, but nowhere faster than v_max [m/s]."""
        return SpeedProfile(np.minimum(self.vx, v_max), self.length, self.closed, self.rest)

    @classmethod
    def constant(cls, vx: float, path: Path) -> SpeedProfile:
        """One speed [m/s] all along a path."""
        return cls(np.full(len(path.s), float(vx)), path.length, path.closed)

    @property
    def start(self) -> float:
        """Speed at which the car starts [m/s]: 0 from rest."""
        return 0.0 if self.rest[0] else float(self.vx[0])

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
        return np.interp(np.asarray(s, dtype=float), self.s, self.vx, period=period)

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


def plan(
    path: Path, params: VehicleParams, *, ay_max: float, v_max: float, margin: float = DRIVE_MARGIN
) -> SpeedProfile:
    """A fast reference speed along a path, which the car can follow.

    The limits, with ay = vx^2 kappa and a the acceleration along the path:
      vx <= v_max, |ay| <= ay_max                                 everywhere
      (a/a_circle)^2 + (ay/ay_max)^2 <= 1                         tires: ay_max for braking, and the
                                                                  load share lr/L of it for driving
      a <= margin F_drive(vx)/m - resistances,  -a <= margin F_brake/m

    A forward and a backward pass give the fastest such speed (a flying lap on closed paths). Its
    acceleration jumps, which no drive can follow; so the speed, as a function of time, is replaced
    by its minimum over +-`SMOOTHING_TIME` and then averaged over the same window. The average of
    values that are all below the limit is below the limit, and the speed at the tightest points is
    kept. The acceleration becomes a moving average: continuous, and never larger than before.

    Args:
        path: The road.
        params: The car.
        ay_max: Largest lateral acceleration [m/s2].
        v_max: Largest speed [m/s].
        margin: Share of drive and brake force in use [-].
    """
    top = _top_speed(params, margin)
    with np.errstate(divide="ignore"):
        ceiling = np.minimum(np.sqrt(ay_max / np.abs(path.kappa)), min(v_max, top))
    drive_share = params.lr / params.wheelbase
    limits = np.array(
        [
            ay_max,
            drive_share * ay_max,  # front drive: only the front axle's load carries drive force
            min(ay_max, margin * params.F_brake_max / params.m_eff),
            margin * params.F_drive_max / params.m_eff,
            margin * params.P_drive_max / params.m_eff,
            params.c_roll * GRAVITY,
            0.5 * params.rho_air * params.CdA / params.m_eff,
            drive_share**2 * params.m / params.Cf + (1.0 - drive_share) ** 2 * params.m / params.Cr,
        ]
    )
    tightest = np.abs(path.kappa)
    for _ in range(2):
        fastest = _fastest(tightest, path.spacing, path.closed, ceiling, limits)
        # Smoothing moves the acceleration along the road by up to its window, so it may use only
        # what the tightest curvature within that window leaves of the friction circle.
        tightest = _widest(np.abs(path.kappa), fastest, path)
    return SpeedProfile(_smooth(fastest, path, ceiling), path.length, path.closed)


def _top_speed(params: VehicleParams, margin: float) -> float:
    """Speed at which the drive only just balances the resistances on a straight [m/s]."""
    v = np.linspace(5.0, 100.0, 951)
    force = margin * np.minimum(params.F_drive_max, params.P_drive_max / v)
    resistance = params.c_roll * params.m * GRAVITY + 0.5 * params.rho_air * params.CdA * v**2
    return float(v[np.argmax(force < resistance)] if np.any(force < resistance) else v[-1])


@njit(cache=True)
def _acceleration(vx, kappa, limits, braking):
    """Largest change of speed [m/s2] at a speed and curvature: driving, or (positive) braking."""
    ay_max, drive_circle, brake, force, power, c_roll, drag, slip = limits
    ay = vx * vx * abs(kappa)
    left = math.sqrt(max(1.0 - (ay / ay_max) ** 2, 0.0))
    if braking:
        return brake * left
    # The last term is cornering drag: what the tires' lateral forces lose by their slip angles.
    resistance = c_roll + drag * vx * vx + slip * ay * ay
    return max(min(drive_circle * left, min(force, power / vx) - resistance), 0.0)


@njit(cache=True)
def _fastest(kappa, h, closed, ceiling, limits):
    """Fastest speed below the ceiling [m/s]: forward pass for driving, backward for braking."""
    n = kappa.size - 1
    v = ceiling.copy()
    start = 0
    if closed:  # the slowest point stays as it is, so one round from there is all
        start = int(np.argmin(ceiling[:n]))
    for direction in (1, -1):
        for j in range(n):
            if closed:
                i = (start + direction * j) % n
                k = (i + direction) % n
            else:
                i = j if direction == 1 else n - j
                k = i + direction
            a = _acceleration(v[i], kappa[i], limits, direction == -1)
            v[k] = min(v[k], math.sqrt(v[i] * v[i] + 2.0 * a * h))
        if closed:
            v[n] = v[0]
    return v


def _windows(values: Array, speed: Array, path: Path) -> tuple[Array, Array, Array]:
    """Values on a road seen in time, each with its neighbours within `SMOOTHING_TIME`.

    Returns:
        Times of the grid points (n + 1,), uniform times (m,), and windows (m + 2 half, 2 half + 1).
    """
    steps_s = path.spacing / (0.5 * (speed[1:] + speed[:-1]))
    time = np.concatenate([[0.0], np.cumsum(steps_s)])
    uniform = np.linspace(0.0, time[-1], max(round(time[-1] / _STEP), 1) + 1)
    sampled = np.interp(uniform, time, values)
    if path.closed:
        sampled = np.pad(sampled[:-1], (2 * _HALF, 2 * _HALF + 1), mode="wrap")
    else:
        sampled = np.pad(sampled, 2 * _HALF, mode="edge")
    return time, uniform, np.lib.stride_tricks.sliding_window_view(sampled, 2 * _HALF + 1)


def _widest(values: Array, speed: Array, path: Path) -> Array:
    """Largest value within the window of every grid point, shape (n + 1,)."""
    time, uniform, windows = _windows(values, speed, path)
    return np.maximum(np.interp(time, uniform, windows.max(axis=1)[_HALF:-_HALF]), values)


def _smooth(speed: Array, path: Path, ceiling: Array) -> Array:
    """Minimum, then Hann mean of the speed over its window; see `plan`. Shape (n + 1,)."""
    time, uniform, windows = _windows(speed, speed, path)
    weights = np.hanning(2 * _HALF + 3)[1:-1]
    smooth = np.convolve(windows.min(axis=1), weights / weights.sum(), mode="valid")
    # The grids of time and distance differ, so the result may miss the ceiling by rounding.
    return np.minimum(np.interp(time, uniform, smooth), ceiling)
