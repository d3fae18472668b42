"""What nobody announces of the road: its friction on each side, its bank and its grade."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from lpvmpc.errors import OptionError


@dataclass(frozen=True, kw_only=True)
class Slope:
    """A slope along the road: knots at equal distances, between them half a cosine.

    y(s) = a + (b - a) (1 - cos(pi u)) / 2 with u from 0 to 1 between two knots a and b

    So it is smooth, never beyond its knots, and repeats after the last one.
    """

    values: tuple[float, ...] = (0.0,)
    """Slope at the knots [-]; a single one is constant."""
    spacing: float = 100.0
    """Distance of the knots [m]."""

    def __post_init__(self) -> None:
        """Raise OptionError for knots that are no slope."""
        if not self.values or not all(abs(value) <= 0.5 for value in self.values):
            raise OptionError("slope", self.values, "numbers from -0.5 to 0.5")
        if not (math.isfinite(self.spacing) and self.spacing > 0.0):
            raise OptionError("spacing of a slope", self.spacing, "a positive number of metres")

    def __call__(self, s: float) -> float:
        """Slope at an arc length [m]."""
        n = len(self.values)
        if n == 1:
            return self.values[0]
        at = s / self.spacing
        i = math.floor(at)
        a, b = self.values[i % n], self.values[(i + 1) % n]
        return a + (b - a) * 0.5 * (1.0 - math.cos(math.pi * (at - i)))

    def around(self, length: float) -> Slope:
        """The same slope, stretched a little to meet its start after a lap of this length [m]."""
        if len(self.values) == 1:
            return self
        n = min(max(round(length / self.spacing), 1), len(self.values))
        return Slope(values=self.values[:n], spacing=length / n)


@dataclass(frozen=True, kw_only=True)
class Surface:
    """The road under the car, beside what the scenario says of it."""

    friction: float = 1.0
    """Factor on the friction everywhere."""
    friction_left: float = 1.0
    """A further factor under the left wheels (split friction)."""
    friction_right: float = 1.0
    """A further factor under the right wheels."""
    patches: tuple[tuple[float, float, float], ...] = ()
    """Stretches of other friction: where each begins and ends [m], and the factor there."""
    grade: Slope = field(default_factory=Slope)
    """Rise per length along the road [-]."""
    bank: Slope = field(default_factory=Slope)
    """Fall per length to the left of the road [-]: positive pulls the car to the left."""

    @property
    def level(self) -> bool:
        """Whether there is neither bank nor grade anywhere."""
        return not any(self.grade.values) and not any(self.bank.values)

    def patch(self, s: float) -> float:
        """Factor of the patches at an arc length [m]; where they overlap they multiply."""
        factor = 1.0
        for start, end, friction in self.patches:
            if start <= s < end:
                factor *= friction
        return factor

    @property
    def left(self) -> float:
        """Friction scale under the left wheels [-]."""
        return self.friction * self.friction_left

    @property
    def right(self) -> float:
        """Friction scale under the right wheels [-]."""
        return self.friction * self.friction_right


PLAIN = Surface()
"""Dry, flat, and the same on both sides."""
