"""What a search by a population is made of, whichever way it moves: `genetic` and `pso` use it.

A search minimises a function of a few bounded numbers that it can only call. It evaluates whole
generations through a `map` that the caller passes, so the same code runs on one core, on many and
on a cluster; all random numbers are drawn before a generation is evaluated, so that the result does
not depend on who finishes first. After each generation its whole state can be kept, and a search
that goes on from there ends in the same bits as one that was never interrupted.

NumPy only; nothing here knows what is tuned.
"""

from __future__ import annotations

import math
import numbers
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import OptionError
from lpvmpc.tune.checkpoint import Failure, Generation, Result, SearchState, frozen
from lpvmpc.units import Array

Cost = Callable[[Array], float]
"""What is minimised. It may have a method `up_to(limit)`, which gives the same cost below the limit
and above it any number that is above it too: it can stop where its value no longer matters."""
Outcome = tuple[float, str | None]
"""Cost of an individual, and what went wrong, if anything."""
Map = Callable[[Callable[[Array], Outcome], list[Array]], Iterable[Outcome]]
"""Applies a function to each individual and gives the outcomes in their order, like `map`."""

LARGEST = 1e100
"""Largest magnitude of a bound: sums and differences of such numbers stay finite."""


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
    cost: Cost, individuals: Array, map: Map, generation: int, limit: float = math.inf
) -> tuple[Array, tuple[Failure, ...]]:
    """Costs of some individuals.

    Args:
        cost: The function to minimise.
        individuals: Shape (k, n).
        map: Calls the cost for each.
        generation: For the failures.
        limit: Costs above it need not be exact: these individuals change nothing. It is known
            before any of them is evaluated, so the outcome does not depend on who is first.

    Returns:
        Costs, shape (k,), never NaN; and those that failed.

    Raises:
        ValueError: `map` gave more or fewer outcomes than there are individuals.
    """
    up_to: Callable[[float], Cost] | None = getattr(cost, "up_to", None)
    if up_to is not None and math.isfinite(limit):
        cost = up_to(limit)
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


@dataclass(frozen=True, kw_only=True)
class Search:
    """One search: which, how, of what, and between which bounds."""

    method: str
    """Its name in a saved state."""
    settings: dict[str, Any]
    """All that decides it, besides the bounds and the cost: see `record_of`."""
    cost: Cost
    """The function to minimise."""
    lower: Array
    """Lower bounds, shape (n,)."""
    upper: Array
    """Upper bounds, shape (n,)."""
    map: Map
    """Evaluates a generation."""

    def begin(
        self, start: npt.ArrayLike | None, more: Callable[[Array], dict[str, Array]]
    ) -> SearchState:
        """Draw and evaluate the first population.

        Args:
            start: Individuals that it shall contain, shape (k, n).
            more: What else moves the population, from its individuals.
        """
        rng = np.random.default_rng(self.settings["seed"])
        population = self.settings["population"]
        given = check_start(start, self.lower, self.upper, population)
        individuals = first_population(rng, self.lower, self.upper, population, given)
        costs, failures = evaluate(self.cost, individuals, self.map, 0)
        return SearchState(
            method=self.method,
            settings=self.settings,
            lower=self.lower,
            upper=self.upper,
            generator=dict(rng.bit_generator.state),
            arrays={
                "individuals": frozen(individuals),
                "costs": frozen(costs),
                **{name: frozen(array) for name, array in more(individuals).items()},
            },
            history=(summary(individuals, costs),),
            evaluations=len(individuals),
            failures=failures,
        )

    def run(
        self,
        advance: Callable[[SearchState], SearchState],
        state: SearchState | None,
        after: Callable[[SearchState], None] | None,
        *,
        start: npt.ArrayLike | None = None,
        more: Callable[[Array], dict[str, Array]] = lambda _: {},
    ) -> Result:
        """Go from a state, or from the first population, through all generations.

        Args:
            advance: Makes one generation.
            state: Go on from here.
            after: Called with the state after the first population and after each generation.
            start: See `begin`; looked at only where no state is given.
            more: See `begin`.

        Raises:
            DataError: The state is of another search.
        """
        if state is None:
            state = self.begin(start, more)
            if after is not None:
                after(state)
        else:
            state.check_same(self.method, self.settings, self.lower, self.upper)
        while state.generation < self.settings["generations"]:
            state = advance(state)
            if after is not None:
                after(state)
        return state.result()


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
