"""What is given to the environments, checked: one sentence says what is wrong with it."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import LPVMPCError, OptionError, UnknownNameError
from lpvmpc.gym.one import FASTEST, SLOWEST
from lpvmpc.sim.world import World
from lpvmpc.units import Array

OWN = ("road", "world", "s", "ey", "epsi", "vx")
"""What `reset(options=...)` may fix for an episode instead of drawing it."""
FURTHEST = 20.0
"""Furthest from the path that a car may start [m], as far as is observed."""
RANGES = {
    "s": (0.0, math.inf), "ey": (-FURTHEST, FURTHEST), "epsi": (-math.pi, math.pi),
    "vx": (SLOWEST, FASTEST),
}
"""Where a car may start: SI units; s ends with the road."""
UNBEGUN = "An environment must be reset before its first step."
ENDED = "The episode has ended; reset the environment before its next step."
CLOSED = "The environment is closed; make another one."


def whole(name: str, value: object, low: int, high: int) -> None:
    """Refuse what is no whole number from low to high.

    Raises:
        OptionError: With the name, the value and the range.
    """
    if type(value) is not int or not low <= value <= high:
        raise OptionError(name, value, f"a whole number from {low:,} to {high:,}")


def size(width: object, height: object) -> None:
    """Refuse pictures that cannot be drawn.

    Raises:
        OptionError: A width or height that is no number of pixels from 16 to 4096.
    """
    whole("width", width, 16, 4096)
    whole("height", height, 16, 4096)


def start_of(options: object) -> dict[str, Any]:
    """What `reset` is told to fix, a copy.

    Raises:
        UnknownNameError: An option that there is not.
        OptionError: No mapping, or a value outside its domain.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise OptionError("options", options, f"a dictionary of some of {', '.join(OWN)}")
    own = dict(options)
    for name, value in own.items():
        if name not in OWN:
            raise UnknownNameError("option of reset", str(name), OWN)
        if name == "road" and not isinstance(value, str | os.PathLike):
            raise OptionError("road", value, "the name of a scenario or a CSV file")
        if name == "world" and not isinstance(value, str | os.PathLike | Mapping | World):
            raise OptionError("world", value, "a name, a TOML file, or its contents")
        if name in RANGES:
            own[name] = number(name, value, *RANGES[name])
    return own


def number(name: str, value: Any, low: float, high: float) -> float:
    """A number within a range, as a float.

    Raises:
        OptionError: It is none.
    """
    try:
        found = float(value)
    except (TypeError, ValueError):
        found = math.nan
    if isinstance(value, str | bytes | bool) or not (low <= found <= high and found < math.inf):
        most = "on" if high == math.inf else f"to {high:.6g}"
        raise OptionError(name, value, f"a number from {low:.6g} {most}")
    return found


def actions_of(given: npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    """Actions as finite numbers of a shape.

    Raises:
        LPVMPCError: They are none.
    """
    try:
        found = np.asarray(given)
        if found.dtype.kind in "fiub":
            found = found.astype(np.float64)
            if found.shape == shape and np.isfinite(found).all():
                return found
    except (TypeError, ValueError):  # ragged lists
        pass
    raise LPVMPCError(f"Actions must be finite numbers of shape {shape}, steering and acceleration "
                      f"from -1 to 1; given was {_short(given)}.")


def _short(given: object) -> str:
    """A value in one line that can be read."""
    text = " ".join(repr(given).split())
    return text if len(text) <= 80 else f"{text[:77]}..."
