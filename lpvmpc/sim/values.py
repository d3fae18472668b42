"""Values of a world: a number, or a range from which one is drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.errors import OptionError


@dataclass(frozen=True)
class Uniform:
    """A number anywhere between two."""

    low: float
    high: float

    def draw(self, rng: np.random.Generator) -> float:
        """One such number."""
        return float(rng.uniform(self.low, self.high))


@dataclass(frozen=True)
class Normal:
    """A normally distributed number, never further than three standard deviations off."""

    mean: float
    std: float

    @property
    def low(self) -> float:
        """The smallest it can be."""
        return self.mean - 3.0 * self.std

    @property
    def high(self) -> float:
        """The largest it can be."""
        return self.mean + 3.0 * self.std

    def draw(self, rng: np.random.Generator) -> float:
        """One such number."""
        while abs(z := rng.standard_normal()) > 3.0:
            pass
        return float(self.mean + self.std * z)


Value = float | Uniform | Normal
"""What a field of a world may be."""


def value_of(name: str, given: Any) -> Value:
    """A value or a range as a world's field has it."""
    if isinstance(given, Uniform | Normal):
        return given
    if is_number(given):
        return float(given)
    if isinstance(given, list | tuple) and len(given) == 2 and all(map(is_number, given)):
        if given[0] <= given[1]:
            return Uniform(float(given[0]), float(given[1]))
    if isinstance(given, Mapping) and set(given) == {"mean", "std"}:
        if all(map(is_number, given.values())) and given["std"] >= 0.0:
            return Normal(float(given["mean"]), float(given["std"]))
    raise OptionError(f"world {name}", given, "a number, [low, high] or {mean, std}")


def is_number(value: Any) -> bool:
    """Whether a value is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number of 309 digits or more
        return False


def ends_of(value: Value) -> tuple[float, float]:
    """The smallest and the largest that a value can be."""
    return (value, value) if isinstance(value, float) else (value.low, value.high)


def draw_of(value: Value, rng: np.random.Generator) -> float:
    """One number of a value."""
    return value if isinstance(value, float) else value.draw(rng)
