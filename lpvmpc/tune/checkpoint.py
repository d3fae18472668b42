"""Where a search by a population stands: its generations, and all that is needed to go on.

A saved state ends in the same bits as a search that was never interrupted; one that is damaged, of
another version or of another search is refused with a sentence.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import DataError
from lpvmpc.kit.files import read_json, write_json
from lpvmpc.units import Array

FORMAT = 1
"""Version of a saved state; one of another version is refused."""
FILE_FORMAT = 1
"""Version of a file of them."""


@dataclass(frozen=True)
class Failure:
    """An individual whose cost could not be told; it was charged with infinity."""

    generation: int
    """Generation it belongs to; 0 is the first population."""
    individual: int
    """Its place among those evaluated in that generation, from 0."""
    text: str
    """The exception, or what is wrong with the number."""


@dataclass(frozen=True, eq=False)
class Generation:
    """The population after a generation; for a swarm, the best places its particles remember."""

    best: float
    """Lowest cost so far."""
    mean: float
    """Mean of the finite costs; infinity where there are none."""
    worst: float
    """Highest cost, infinity included."""
    individual: Array
    """The best individual so far, shape (n,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Result:
    """What a search has found."""

    best: Array
    """The best individual, shape (n,)."""
    cost: float
    """Its cost; infinity if no individual had a finite one."""
    history: tuple[Generation, ...]
    """First population and each generation."""
    evaluations: int
    """Number of calls of the cost."""
    failures: tuple[Failure, ...]
    """Individuals that were charged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchState:
    """A search after a generation: all that is needed to go on as if nothing had happened."""

    method: str
    """Which search: "genetic" or "pso"."""
    settings: dict[str, Any]
    """All that decides it, besides the bounds and the cost; the seed as well."""
    lower: Array
    """Lower bounds, shape (n,)."""
    upper: Array
    """Upper bounds, shape (n,)."""
    generator: dict[str, Any]
    """State of the random number generator."""
    arrays: dict[str, Array]
    """The population: "individuals", shape (k, n), "costs", shape (k,), and what else moves it."""
    history: tuple[Generation, ...]
    """First population and each generation so far."""
    evaluations: int
    """Number of calls of the cost so far."""
    failures: tuple[Failure, ...] = ()
    """Individuals that were charged so far."""

    @property
    def generation(self) -> int:
        """Generations done; 0 after the first population was evaluated."""
        return len(self.history) - 1

    def result(self) -> Result:
        """What has been found so far."""
        last = self.history[-1]
        return Result(
            best=last.individual,
            cost=last.best,
            history=self.history,
            evaluations=self.evaluations,
            failures=self.failures,
        )

    def rng(self) -> np.random.Generator:
        """A generator that goes on where this one's stopped."""
        rng = np.random.default_rng(0)
        rng.bit_generator.state = self.generator
        return rng

    def check_same(self, method: str, settings: dict[str, Any], lower: Array, upper: Array) -> None:
        """Refuse to go on with a search that was begun in another way.

        Raises:
            DataError: With what differs.
        """
        if self.method != method:
            raise DataError(f"The saved state is of the search {self.method!r}, not {method!r}.")
        differs = [
            f"{name.replace('_', ' ')} {self.settings.get(name)}, not {settings.get(name)}"
            for name in sorted({*self.settings, *settings})
            if self.settings.get(name) != settings.get(name)
        ]
        if self.lower.size != lower.size:
            differs.append(f"{self.lower.size} variables, not {lower.size}")
        elif not (np.array_equal(self.lower, lower) and np.array_equal(self.upper, upper)):
            differs.append("other bounds")
        if differs:
            raise DataError(f"The saved state was made with {'; '.join(differs)}.")

    def to_json(self) -> dict[str, Any]:
        """The state as a value that `json` writes without loss; null is an infinite cost."""
        body = {
            "method": self.method,
            "settings": self.settings,
            "lower": self.lower.tolist(),
            "upper": self.upper.tolist(),
            "generator": self.generator,
            "arrays": {name: _plain(array) for name, array in self.arrays.items()},
            "history": [
                [*_plain(np.array([g.best, g.mean, g.worst])), _plain(g.individual)]
                for g in self.history
            ],
            "evaluations": self.evaluations,
            "failures": [list(asdict(failure).values()) for failure in self.failures],
        }
        return {"format": FORMAT, "sha256": _digest(body), "state": body}

    @classmethod
    def from_json(cls, value: object) -> SearchState:
        """The state from what `to_json` gave.

        Raises:
            DataError: It is something else, of another version, or damaged.
        """
        if not (isinstance(value, dict) and {"format", "sha256", "state"} <= value.keys()):
            raise DataError("This is no saved state of a search.")
        if value["format"] != FORMAT:
            raise DataError(
                f"The saved state has format {value['format']!r}; this version reads {FORMAT}."
            )
        body = value["state"]
        try:
            if value["sha256"] != _digest(body):
                raise ValueError("its checksum is another")
            if type(body["evaluations"]) is not int or not isinstance(body["method"], str):
                raise TypeError("its values are of other types")
            state = cls(
                method=body["method"],
                settings=dict(body["settings"]),
                lower=frozen(body["lower"]),
                upper=frozen(body["upper"]),
                generator=body["generator"],
                arrays={name: _array(rows) for name, rows in body["arrays"].items()},
                history=tuple(
                    Generation(_number(best), _number(mean), _number(worst), frozen(individual))
                    for best, mean, worst, individual in body["history"]
                ),
                evaluations=int(body["evaluations"]),
                failures=tuple(Failure(*fields) for fields in body["failures"]),
            )
            state.rng()
            state.history[-1]
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise DataError(f"The saved state is damaged: {error}.") from error
        return state


def frozen(values: npt.ArrayLike) -> Array:
    """A read-only copy."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _plain(array: Array) -> list[Any]:
    """An array as lists of numbers, infinity as None: JSON has no infinity."""
    if array.ndim > 1:
        return [_plain(row) for row in array]
    return [None if math.isinf(value) else value for value in array.tolist()]


def _array(rows: list[Any]) -> Array:
    """The array from such lists."""
    if rows and isinstance(rows[0], list):
        return frozen([_array(row) for row in rows])
    return frozen([_number(value) for value in rows])


def _number(value: float | None) -> float:
    """A number from such a list."""
    return math.inf if value is None else float(value)


def _digest(body: object) -> str:
    """SHA-256 of a JSON value, however it was laid out in its file."""
    text = json.dumps(body, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


# Files -------------------------------------------------------------------------------------------


def write(file: Path, task: Mapping[str, Any], states: Sequence[SearchState]) -> None:
    """Write the states of a tuning's stages, whole or not at all.

    Args:
        file: Where to.
        task: What decides the tuning, as JSON can hold it.
        states: A state per stage that was begun.

    Raises:
        OutputError: It cannot be written.
    """
    saved = [state.to_json() for state in states]
    write_json(file, {"format": FILE_FORMAT, "task": dict(task), "stages": saved})


def read(file: Path, task: Mapping[str, Any]) -> list[SearchState]:
    """The states of the stages of a tuning, to go on from.

    Args:
        file: What `write` wrote.
        task: What decides the tuning now.

    Raises:
        DataError: It is missing, damaged, or of another task or version.
    """
    name = repr(os.fspath(file))
    try:
        value = read_json(file)
    except OSError as error:
        why = error.strerror or str(error)
        raise DataError(f"There is no tuning to resume in {name}: {why}.") from error
    except ValueError as error:
        raise DataError(f"The checkpoint {name} is damaged: {error}.") from error
    if not (isinstance(value, dict) and {"format", "task", "stages"} <= value.keys()
            and isinstance(value["task"], dict) and isinstance(value["stages"], list)):
        raise DataError(f"{name} is no checkpoint of a tuning.")
    if value["format"] != FILE_FORMAT:
        raise DataError(f"The checkpoint {name} has format {value['format']!r}; this version reads "
                        f"{FILE_FORMAT}.")
    then = value["task"]
    differs = [key for key in task if then.get(key) != task[key]]
    if differs == ["foundation"]:
        raise DataError(f"The checkpoint {name} was made with another version of the package; "
                        "without --resume the tuning begins anew.")
    if differs:
        shown = "; ".join(f"{k} {then.get(k)}, not {task[k]}" for k in differs
                          if k != "foundation")
        raise DataError(f"The checkpoint {name} was made with {shown}.")
    try:
        return [SearchState.from_json(state) for state in value["stages"]]
    except DataError as error:
        raise DataError(f"The checkpoint {name} is damaged: {error}") from error
