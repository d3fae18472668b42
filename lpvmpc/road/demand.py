"""What a reference speed asks of the car, against what the car and the road have."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.road.path import Path
from lpvmpc.road.speed_profile import SpeedProfile
from lpvmpc.units import GRAVITY, Array

TOLERANCE = 0.02
"""Share by which a reference may ask for more without a word: rounding, and knots on a grid."""
FASTEST = 100.0
"""No car of this package is looked at beyond this speed [m/s]."""


@dataclass(frozen=True, kw_only=True)
class Shortfall:
    """Where a reference asks for more than there is, in one direction."""

    kind: str
    """`sideways`, `of drive` or `of braking`."""
    s: float
    """Arc length of the place where most is missing [m]."""
    asked: float
    """Acceleration that the reference asks for there, resistances included [m/s2]."""
    has: float
    """Acceleration that car and road have there [m/s2]."""
    length: float
    """Length of the road on which something is missing [m]."""

    def __str__(self) -> str:
        """The clause of a sentence."""
        return (
            f"{self.asked:.3g} m/s2 {self.kind} at {self.s:.0f} m, where there are {self.has:.3g} "
            f"({max(self.length, 1.0):.0f} m of the road)"
        )


def shortfalls(
    path: Path,
    speed: SpeedProfile,
    params: VehicleParams,
    friction: Callable[[float], float] | None = None,
) -> list[Shortfall]:
    """Where a reference asks for more than the car and the road have.

    With v the speed, a = v dv/ds and the friction scale f(s) of the road:
      sideways:  v^2 |kappa|                  against  f ay_limit
      drive:     a + c_roll g + drag(v)/m     against  min(F_drive(v)/m, f mu g lr/L)
      braking:   -a - c_roll g - drag(v)/m    against  min(F_brake/m, f mu g)
    each alone: a friction circle is not checked here.

    Args:
        path: The road.
        speed: Its reference speed.
        params: The car.
        friction: Friction scale at an arc length [m] that is announced; None: 1 everywhere.
    """
    s = path.s
    scale = np.ones_like(s) if friction is None else np.array([friction(float(at)) for at in s])
    middle, spacing = 0.5 * (s[1:] + s[:-1]), path.spacing
    vx, holds = 0.5 * (speed.vx[1:] + speed.vx[:-1]), 0.5 * (scale[1:] + scale[:-1])
    resistance = _resistance(params, vx)
    tires = holds * params.mu * GRAVITY
    drive = np.array([params.ax_max(v) for v in vx])
    along = (
        ("sideways", s, speed.vx**2 * np.abs(path.kappa), scale * params.ay_limit),
        ("of drive", middle, speed.ax + resistance,
         np.minimum(drive, params.lr / params.wheelbase * tires)),
        ("of braking", middle, -speed.ax - resistance, np.minimum(-params.ax_min, tires)),
    )
    found = []
    for kind, at, asked, has in along:
        missing = asked - (1.0 + TOLERANCE) * has
        if missing.max() > 0.0:
            i = int(np.argmax(missing))
            found.append(
                Shortfall(
                    kind=kind,
                    s=float(at[i]),
                    asked=float(asked[i]),
                    has=float(has[i]),
                    length=float(spacing * np.count_nonzero(missing > 0.0)),
                )
            )
    return found


def top_speed(params: VehicleParams) -> float:
    """Speed at which the whole drive only just balances the resistances on a straight [m/s]."""
    low, high = 1.0, FASTEST
    while high - low > 1e-3:
        vx = 0.5 * (low + high)
        short = params.ax_max(vx) < float(_resistance(params, np.array(vx)))
        low, high = (low, vx) if short else (vx, high)
    return low


def _resistance(params: VehicleParams, vx: Array) -> Array:
    """Deceleration by rolling and air resistance [m/s2] at speeds [m/s], shape (...,)."""
    drag = 0.5 * params.rho_air * params.CdA * vx**2
    return (params.c_roll * params.m * GRAVITY + drag) / params.m_eff


def start_speed_limit(kappa: float, params: VehicleParams, friction: float = 1.0) -> float:
    """Largest speed [m/s] at which the car can be trimmed on a curvature [1/m]."""
    bend = math.inf if kappa == 0.0 else math.sqrt(friction * params.ay_limit / abs(kappa))
    return min(top_speed(params), bend)
