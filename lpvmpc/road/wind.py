"""Side wind along the path, and the force it puts on the car.

The wind of a scenario is one number, its speed along the path's left-to-right normal: positive
wind blows from the left and pushes the car to the right, wherever the path turns. That is how the
paper's authors state theirs; it keeps the wind a pure side wind on every road.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import OptionError
from lpvmpc.units import Array


@dataclass(frozen=True, kw_only=True)
class Wind:
    """Side-wind speed as a function of time or of the distance along the path.

    Linear between knots. Before the first and after the last knot the value is held, or the whole
    signal repeats where a period is given (a closed track driven for more than a lap).
    """

    knots: npt.ArrayLike = (0.0,)
    """Times [s] or arc lengths [m] of the knots, increasing, shape (k,)."""
    speeds: npt.ArrayLike = (0.0,)
    """Wind speed from left to right at the knots [m/s], shape (k,)."""
    over: Literal["time", "distance"] = "time"
    """What the knots are."""
    period: float | None = None
    """Time [s] or distance [m] after which the signal repeats; None: the last value is held."""
    scale: float = 1.0
    """Factor on the wind speed (the force goes with its square)."""
    _signal: tuple[Array, Array] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the knots and keep them as read-only arrays, the scale applied.

        Raises:
            OptionError: Knots not increasing, numbers not finite, or a negative scale.
        """
        knots = np.array(self.knots, dtype=float)
        speeds = np.array(self.speeds, dtype=float)
        if not (math.isfinite(self.scale) and 0.0 <= self.scale <= 10.0):
            raise OptionError("wind_scale", self.scale, "a number from 0 to 10")
        if knots.ndim != 1 or not len(knots) or not np.all(np.diff(knots) > 0.0):
            raise OptionError("knots", self.knots, "increasing numbers")
        if speeds.shape != knots.shape or not np.all(np.isfinite(speeds)):
            raise OptionError("speeds", self.speeds, f"{len(knots)} finite numbers")
        if self.period is not None and not self.period >= knots[-1] - knots[0]:
            raise OptionError("period", self.period, "at least the span of the knots")
        speeds *= self.scale
        knots.flags.writeable = speeds.flags.writeable = False
        object.__setattr__(self, "_signal", (knots, speeds))

    @property
    def calm(self) -> bool:
        """Whether there is no wind at all."""
        return not self._signal[1].any()

    def speed(self, t: float | Array, s: float | Array) -> float | Array:
        """Wind speed from left to right.

        Args:
            t: Time since the start of the run [s], shape (...,).
            s: Arc length of the car's projection, not wrapped [m], shape (...,).

        Returns:
            Wind speed [m/s], shape (...,); a float for floats.
        """
        at = t if self.over == "time" else s
        knots, speeds = self._signal
        value = np.interp(at, knots, speeds, period=self.period)
        return float(value) if np.ndim(value) == 0 else value

    def velocity(self, t: float, s: float, psi_path: float) -> tuple[float, float]:
        """Air velocity over the ground, (wx, wy) = speed * (sin psi, -cos psi).

        Args:
            t: Time since the start of the run [s].
            s: Arc length of the car's projection, not wrapped [m].
            psi_path: Heading of the path there [rad].

        Returns:
            World components [m/s].
        """
        speed = float(self.speed(t, s))
        return speed * math.sin(psi_path), -speed * math.cos(psi_path)
