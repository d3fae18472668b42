"""What a search by a population is made of, whichever way it moves: `genetic` and `pso` use it.

A search minimises a function of a few bounded numbers that it can only call. It evaluates whole
generations through a `map` that the caller passes, so the same code runs on one core, on many and
on a cluster; all random numbers are drawn before a generation is evaluated, so that the result does
not depend on who finishes first. After each generation its whole state can be kept, and a search
that goes on from there ends in the same bits as one that was never interrupted.

NumPy only; nothing here knows what is tuned.
"""

from __future__ import annotations

import hashlib
import json
import math
import numbers
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import DataError, OptionError

Array = npt.NDArray[np.float64]
Cost = Callable[[Array], float]
Outcome = tuple[float, str | None]
"""Cost of an individual, and what went wrong, if anything."""
Map = Callable[[Callable[[Array], Outcome], list[Array]], Iterable[Outcome]]
"""Applies a function to each individual and gives the outcomes in their order, like `map`."""

FORMAT = 1
"""Version of a saved state; one of another version is refused."""
LARGEST = 1e100
"""Largest magnitude of a bound: sums and differences of such numbers stay finite."""


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


@dataclass(frozen=True)
class Guarded:
    """A cost that always answers: what it raises becomes an infinite cost with its text.

    Picklable where the cost is, so that it can be sent to another process.
    """

    cost: Cost
    """The function to minimise."""

    def __call__(self, individual: Array) -> Outcome:
        """Cost of an individual, infinity where it has none, and what went wrong."""
        try:
            # A copy, so that a cost that writes into its argument cannot change the population.
            value = float(self.cost(np.array(individual)))
        except Exception as error:  # whatever it is: one bad individual must not end the search
            text = " ".join(f"{type(error).__name__}: {error}".split())
            return math.inf, text[:300].rstrip(": ")
        if math.isnan(value) or value == -math.inf:
            return math.inf, f"the cost is {value}"
        return value, None


def evaluate(
    cost: Cost, individuals: Array, map: Map, generation: int
) -> tuple[Array, tuple[Failure, ...]]:
    """Costs of some individuals.

    Args:
        cost: The function to minimise.
        individuals: Shape (k, n).
        map: Calls the cost for each.
        generation: For the failures.

    Returns:
        Costs, shape (k,), never NaN; and those that failed.

    Raises:
        ValueError: `map` gave more or fewer outcomes than there are individuals.
    """
    outcomes = list(map(Guarded(cost), list(individuals)))
    costs, failures = np.empty(len(individuals)), []
    for i, (_, (value, text)) in enumerate(zip(individuals, outcomes, strict=True)):
        costs[i] = value
        if text is not None:
            failures.append(Failure(generation, i, text))
    return costs, tuple(failures)


def summary(individuals: Array, costs: Array) -> Generation:
    """The record of a population, shapes (k, n) and (k,)."""
    finite = costs[np.isfinite(costs)]
    best = int(np.argmin(costs))
    return Generation(
        best=float(costs[best]),
        # Divided before it is summed: costs near the largest float must not overflow.
        mean=float((finite / finite.size).sum()) if finite.size else math.inf,
        worst=float(costs.max()),
        individual=frozen(individuals[best]),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
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

    def check_same(
        self, method: str, settings: dict[str, Any], lower: Array, upper: Array
    ) -> None:
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
    def from_json(cls, value: object) -> State:
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


def record_of(settings: Any, **more: object) -> dict[str, Any]:
    """The fields of a dataclass of settings, and more, as plain numbers and names."""
    both = {**asdict(settings), **more}
    return {key: v.item() if isinstance(v, np.generic) else v for key, v in both.items()}


def check_bounds(lower: npt.ArrayLike, upper: npt.ArrayLike) -> tuple[Array, Array]:
    """The bounds as arrays of shape (n,).

    Raises:
        OptionError: They are no numbers, of different shape, too large or in the wrong order.
    """
    arrays = []
    for name, bound in (("lower", lower), ("upper", upper)):
        try:
            array = np.atleast_1d(np.asarray(bound, dtype=np.float64))
        except (TypeError, ValueError):
            raise OptionError(name, bound, "numbers") from None
        if array.ndim != 1 or not array.size or not (np.abs(array) <= LARGEST).all():
            raise OptionError(name, array.tolist(), f"one list of finite numbers below {LARGEST:g}")
        arrays.append(frozen(array))
    if arrays[0].size != arrays[1].size:
        raise OptionError("upper", arrays[1].tolist(), f"of {arrays[0].size} numbers, like lower")
    if not (arrays[0] <= arrays[1]).all():
        raise OptionError("upper", arrays[1].tolist(), f"from {arrays[0].tolist()} on")
    return arrays[0], arrays[1]


def check_start(start: npt.ArrayLike | None, lower: Array, upper: Array, population: int) -> Array:
    """Initial individuals that the caller wants, shape (k, n), k from 0 to `population`.

    Raises:
        OptionError: Of another shape, too many, or outside the bounds.
    """
    if start is None:
        return np.empty((0, lower.size))
    rows = np.atleast_2d(np.asarray(start, dtype=np.float64))
    if rows.ndim != 2 or rows.shape[1] != lower.size or len(rows) > population:
        allowed = f"at most {population} individuals of {lower.size} numbers"
        raise OptionError("start", rows.tolist(), allowed)
    if not ((rows >= lower) & (rows <= upper)).all():
        allowed = f"from {lower.tolist()} to {upper.tolist()}"
        raise OptionError("start", rows.tolist(), allowed)
    return rows


def first_population(
    rng: np.random.Generator, lower: Array, upper: Array, population: int, start: Array
) -> Array:
    """The individuals in `start`, filled up with uniformly drawn ones, shape (population, n)."""
    drawn = rng.random((population - len(start), lower.size))
    # Rounding may carry the sum beyond the upper bound.
    return np.vstack([start, np.minimum(lower + drawn * (upper - lower), upper)])


def check_count(name: str, value: object, low: int, high: int) -> None:
    """Refuse what is no whole number from low to high.

    Raises:
        OptionError: With the name, the value and the range.
    """
    whole = isinstance(value, numbers.Integral) and not isinstance(value, bool)
    if not (whole and low <= value <= high):  # type: ignore[operator]
        raise OptionError(name, value, f"a whole number from {low} to {high}")


def check_real(name: str, value: object, low: float, high: float) -> None:
    """Refuse what is no number from low to high.

    Raises:
        OptionError: With the name, the value and the range.
    """
    real = isinstance(value, numbers.Real) and not isinstance(value, bool)
    if not (real and low <= value <= high):  # type: ignore[operator]
        raise OptionError(name, value, f"a number from {low:g} to {high:g}")


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
