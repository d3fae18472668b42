"""What a controller states of itself, so that it can be tuned: its weights, and where to search.

A controller of the package has a dataclass of weights with `RANGES`. A user's class states the same
by three things: its constructor takes `weights` (names with numbers, all of them or some, or None),
its attribute `weights` holds those in force (a dictionary or a dataclass), and `RANGES`, beside it
or on the dataclass, the lowest and highest value of each weight that is to be searched.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

from lpvmpc.control.registry import CONTROLLERS, TUNABLE
from lpvmpc.errors import ControllerError, UnknownNameError
from lpvmpc.sim.names import load_controller
from lpvmpc.sim.own import file_of, own_module


@dataclass(frozen=True, kw_only=True)
class Stated:
    """A controller's weights as set by hand, and where each is searched."""

    weights: dict[str, float]
    """All of them by name."""
    ranges: dict[str, tuple[float, float]]
    """Lowest and highest value by name, of those that are searched; logarithmic where the lowest
    is positive."""


def is_own(controller: str) -> bool:
    """Whether a name is that of a user's class."""
    return ":" in controller


def sources(controller: str) -> tuple[str, ...]:
    """Text of a user's module, on which the outcome depends; none for the package's controllers."""
    file = file_of(controller.partition(":")[0]) if is_own(controller) else None
    return () if file is None else (file.read_text(encoding="utf-8", errors="replace"),)


def stated(controller: str) -> Stated:
    """Weights and ranges of a controller, by its name or as `module:Class`.

    Raises:
        UnknownNameError: No such name.
        ControllerError: The user's class does not import, or does not state what is needed.
    """
    if not is_own(controller):
        if controller not in CONTROLLERS:
            raise UnknownNameError("controller", controller, [*TUNABLE, "module:Class"])
        if controller not in TUNABLE:
            raise _refused(controller, "it was trained (eval/learn.py) and has no weights")
        weights = load_controller(controller, weights={}).weights  # type: ignore[attr-defined]
        return Stated(weights=asdict(weights), ranges=dict(weights.RANGES))
    if not _takes_weights(controller):
        raise _refused(controller, "its constructor does not ask for 'weights'")
    made = load_controller(controller)
    values = _in_force(controller, made)
    ranges = _ranges(controller, made, values)
    middle = {**values, **{name: _middle(*ends) for name, ends in ranges.items()}}
    taken = _in_force(controller, load_controller(controller, weights=middle))
    for name in ranges:
        if not math.isclose(taken.get(name, math.nan), middle[name], rel_tol=1e-9, abs_tol=1e-12):
            raise _refused(
                controller, f"given weights with {name} = {middle[name]:g} it drives with "
                f"{taken.get(name, 'none')}"
            )
    return Stated(weights=values, ranges=ranges)


def _refused(controller: str, why: str) -> ControllerError:
    return ControllerError(f"Controller {controller!r} cannot be tuned: {why}.")


def _takes_weights(controller: str) -> bool:
    """Whether its constructor asks for weights; True where there is none to ask."""
    module, _, name = controller.partition(":")
    try:
        maker = getattr(own_module(module), name)
    except Exception:
        return True  # what is missing is told where it is loaded
    try:
        return "weights" in inspect.signature(maker).parameters
    except (TypeError, ValueError):  # a compiled class without signature
        return False


def _in_force(controller: str, made: Any) -> dict[str, float]:
    """The weights that a user's controller holds."""
    weights = getattr(made, "weights", None)
    if is_dataclass(weights) and not isinstance(weights, type):
        weights = asdict(weights)
    if not isinstance(weights, Mapping) or not weights:
        raise _refused(
            controller, "its attribute 'weights' must be a dataclass or a dictionary of numbers, "
            f"but is {_short(weights)}"
        )
    for name, value in weights.items():
        if not isinstance(name, str) or not _number(value):
            raise _refused(
                controller, f"its weight {_short(name)} must be a finite number, but is "
                f"{_short(value)}"
            )
    return {name: float(value) for name, value in weights.items()}


def _ranges(
    controller: str, made: Any, weights: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Where a user's weights are searched."""
    given = getattr(made, "RANGES", None)
    if given is None:
        given = getattr(made.weights, "RANGES", None)
    if not isinstance(given, Mapping) or not given:
        raise _refused(
            controller, "its 'RANGES' must be a dictionary with the lowest and highest value of "
            f"each weight to search, but is {_short(given)}"
        )
    found = {}
    for name, ends in given.items():
        if name not in weights:
            raise _refused(
                controller, f"its 'RANGES' name {_short(name)}, which is none of its weights "
                f"({', '.join(weights)})"
            )
        pair = list(ends) if isinstance(ends, list | tuple) else []
        if len(pair) != 2 or not all(map(_number, pair)) or not pair[0] < pair[1]:
            raise _refused(
                controller, f"its range of {name} must be two numbers in their order, but is "
                f"{_short(ends)}"
            )
        found[name] = (float(pair[0]), float(pair[1]))
    return found


def _middle(low: float, high: float) -> float:
    return math.sqrt(low * high) if low > 0.0 else 0.5 * (low + high)


def _number(value: Any) -> bool:
    real = isinstance(value, int | float) and not isinstance(value, bool)
    return real and math.isfinite(value)


def _short(value: Any) -> str:
    """A value in a message."""
    try:
        text = " ".join(repr(value).split())
    except Exception:  # a user's own repr
        text = f"a {type(value).__name__}"
    return text if len(text) <= 60 else text[:57] + "..."
