"""A genetic algorithm for a few bounded numbers, on any function that can only be called.

Each generation draws pairs of parents, crosses and mutates them into two children, evaluates the
children and keeps the best of parents and children. The parents of a pair are both drawn by the
roulette wheel, which prefers the better in proportion to how much better they are, or both by
tournament, which looks at their order only; which of the two, two random numbers decide.

Source: Kebbati et al., "Autonomous driving using an optimized neural network based adaptive
LPV-MPC controller", Algorithm 1 and Table 1. Where these leave a choice, and why we chose:

- Survival. Algorithm 1 replaces the population by its offspring, but its offspring are 80 % of it:
  the best of both survive, as in the authors' published code. So the best is never lost.
- Pressure. A roulette wheel needs the scale of the costs. Ours measures them from the best, in
  units of their mean distance to it, so that a constant added to the cost changes nothing; in
  units of the mean cost, as in the authors' code, a constant would take the pressure away.
- Crossover. "Uniform" means that each variable is decided on its own. On real numbers that is
  either an exchange of the parents' values or, as in the authors' code, a blend of them with a
  weight that may reach a fifth beyond either parent: extended intermediate recombination
  (Muehlenbein and Schlierkamp-Voosen, Evolutionary Computation 1(1), 1993). An exchange only
  reorders values that mutation found; a blend makes new ones, at a scale that follows the spread of
  the population, and so goes on converging where a mutation of fixed size no longer hits. We blend;
  `crossover="exchange"` is there to compare, and docs/results/sphere.md does.
- Mutation. Table 1's rate is per variable: mutating a whole individual or nothing mostly destroys
  what crossover has built. What leaves the bounds is put on them, since an optimum on a bound is
  common among weights and could not be reached by reflection.
- Ties. A child as good as a parent replaces it, so that a population on a plateau still wanders.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace as replaced
from functools import partial
from typing import Any, Literal, get_args

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import UnknownNameError
from lpvmpc.tune.checkpoint import Result, SearchState, frozen
from lpvmpc.tune.search import (
    Cost,
    Map,
    Search,
    check_bounds,
    check_count,
    check_real,
    evaluate,
    record_of,
    summary,
)
from lpvmpc.units import Array

Selection = Literal["mixed", "roulette", "tournament"]
Crossover = Literal["blend", "exchange"]
Algorithm = Literal["ours", "printed"]
Survival = Literal["best", "offspring"]
Scale = Literal["excess", "cost"]
Step = Literal["range", "own"]
PARTS: dict[Algorithm, dict[str, Any]] = {
    "ours": {"survival": "best", "scale": "excess", "step": "range"},
    "printed": {"survival": "offspring", "scale": "cost", "step": "own"},
}
"""Settings in which the algorithms differ."""

METHOD = "genetic"
"""Name of this search in a saved state."""


@dataclass(frozen=True, kw_only=True)
class GeneticSettings:
    """Parameters of the genetic algorithm; those of Table 1 unless said otherwise."""

    generations: int = 15
    """Generations after the first population."""
    population: int = 20
    """Individuals in the population."""
    offspring: float = 0.8
    """Children per generation, as a fraction of the population; made in pairs."""
    pressure: float = 0.75
    """Selection pressure of the roulette wheel; 0 is none."""
    mutation_rate: float = 0.3
    """Probability with which each variable of a child is mutated."""
    sigma: float = 0.15
    """Standard deviation of a mutation, in the unit that `step` names."""
    crossover: Crossover = "blend"
    """How two parents give two children: blend of their values, or exchange. Not in Table 1."""
    reach: float = 0.2
    """How far beyond its parents a blend may go, in units of their distance. Not in Table 1."""
    rivals: int = 2
    """Individuals in a tournament. Not in Table 1; the weakest tournament there is."""
    survival: Survival = "best"
    """Who makes up the next population: the best of parents and children, or the children alone,
    made until it is full."""
    scale: Scale = "excess"
    """Unit of the roulette wheel: the mean distance to the best cost, or the mean cost."""
    step: Step = "range"
    """Unit of sigma: the variable's range, or that of the variable itself."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        check_count("generations", self.generations, 0, 1_000_000)
        check_count("population", self.population, 2, 1_000_000)
        check_real("offspring", self.offspring, 0.0, 1.0)
        check_real("pressure", self.pressure, 0.0, 100.0)
        check_real("mutation_rate", self.mutation_rate, 0.0, 1.0)
        check_real("sigma", self.sigma, 0.0, 1.0)
        if self.crossover not in get_args(Crossover):
            raise UnknownNameError("crossover", self.crossover, get_args(Crossover))
        check_real("reach", self.reach, 0.0, 1.0)
        check_count("rivals", self.rivals, 1, self.population)
        for name, value, choices in (("survival", self.survival, get_args(Survival)),
                                     ("scale", self.scale, get_args(Scale)),
                                     ("step", self.step, get_args(Step))):
            if value not in choices:
                raise UnknownNameError(name, value, choices)

    def of(self, algorithm: Algorithm) -> GeneticSettings:
        """The same settings for an algorithm: `ours`, or Algorithm 1 as it is `printed`.

        Raises:
            UnknownNameError: No such algorithm.
        """
        if algorithm not in PARTS:
            raise UnknownNameError("algorithm", algorithm, tuple(PARTS))
        return replaced(self, **PARTS[algorithm])

    @property
    def pairs(self) -> int:
        """Pairs of children per generation, at least one; of an odd one out, one child is kept."""
        if self.survival == "offspring":
            return (self.population + 1) // 2
        return max(1, round(self.offspring * self.population / 2))

    @property
    def children(self) -> int:
        """Children that are evaluated in a generation."""
        return self.population if self.survival == "offspring" else 2 * self.pairs

    @property
    def evaluations(self) -> int:
        """Calls of the cost in a whole search."""
        return self.population + self.generations * self.children


def minimise(
    cost: Cost,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    seed: int,
    settings: GeneticSettings | None = None,
    selection: Selection = "mixed",
    map: Map = map,
    start: npt.ArrayLike | None = None,
    state: SearchState | None = None,
    after: Callable[[SearchState], None] | None = None,
) -> Result:
    """Minimise a function within bounds.

    Args:
        cost: Gives the cost of an individual, an array of shape (n,). One that is not finite counts
            as infinitely bad; one that raises as well, and is named in the result.
        lower: Lower bounds, shape (n,).
        upper: Upper bounds, shape (n,).
        seed: Decides all random numbers.
        settings: Parameters (default: those of Table 1).
        selection: How parents are drawn.
        map: Evaluates a generation; `map` itself, or one that uses processes or a cluster.
        start: Individuals that the first population shall contain, shape (k, n), such as weights
            that are known to work; looked at only where no state is given.
        state: Go on from here.
        after: Called with the state after the first population and after each generation.

    Returns:
        The best individual, its cost, and how it was found.

    Raises:
        OptionError: Bounds, seed or start make no sense.
        UnknownNameError: No such selection.
        DataError: The state is of another search.
    """
    settings = settings or GeneticSettings()
    low, high = check_bounds(lower, upper)
    check_count("seed", seed, 0, 2**63 - 1)
    if selection not in get_args(Selection):
        raise UnknownNameError("selection", selection, get_args(Selection))
    record = record_of(settings, selection=selection, seed=seed)
    search = Search(method=METHOD, settings=record, cost=cost, lower=low, upper=high, map=map)
    return search.run(partial(_advance, search, settings, selection), state, after, start=start)


def _advance(
    search: Search, settings: GeneticSettings, selection: Selection, state: SearchState
) -> SearchState:
    """One generation: pairs of parents, their children, and who of both survives."""
    rng = state.rng()
    individuals, costs = state.arrays["individuals"], state.arrays["costs"]
    chances = wheel(costs, settings.pressure, settings.scale)
    children: list[Array] = []
    for _ in range(settings.pairs):
        if selection == "mixed":
            roulette, tournament = rng.random(2)
            way = "roulette" if roulette >= tournament else "tournament"
        else:
            way = selection
        if way == "roulette":
            pair = rng.choice(len(costs), size=2, p=chances)
        else:
            pair = np.array([_tournament(rng, costs, settings.rivals) for _ in range(2)])
        children += _cross(rng, individuals[pair[0]], individuals[pair[1]], settings)
    young = _mutate(rng, np.array(children), state.lower, state.upper, settings)
    young = young[: settings.children]
    # What is worse than the worst parent does not survive, where parents may.
    limit = float(costs.max()) if settings.survival == "best" else math.inf
    young_costs, failures = evaluate(
        search.cost, young, search.map, state.generation + 1, limit=limit
    )
    everyone, all_costs = young, young_costs
    if settings.survival == "best":
        # Children first: a stable sort then prefers them among equals.
        everyone, all_costs = np.vstack([young, individuals]), np.concatenate([young_costs, costs])
    kept = np.argsort(all_costs, kind="stable")[: len(costs)]
    individuals, costs = frozen(everyone[kept]), frozen(all_costs[kept])
    return replaced(
        state,
        generator=dict(rng.bit_generator.state),
        arrays={"individuals": individuals, "costs": costs},
        history=(*state.history, summary(individuals, costs)),
        evaluations=state.evaluations + len(young),
        failures=state.failures + failures,
    )


def wheel(costs: Array, pressure: float, scale: Scale = "excess") -> Array:
    """Chances of the roulette wheel, after Boltzmann.

    p_i = exp(-pressure (c_i - c_best) / u) / sum,   u = mean(c - c_best), or |mean(c)|

    Args:
        costs: Shape (k,), infinity for the infinitely bad, whose chance is zero.
        pressure: Selection pressure; the mean individual is drawn exp(-pressure) times as often as
            the best, where costs are measured from the best.
        scale: Their unit u: `excess`, their mean distance to the best, or `cost`, their mean.

    Returns:
        Chances, shape (k,), of sum 1: equal ones where all costs are equal or infinite.
    """
    finite = np.isfinite(costs)
    if not finite.any():
        return np.full(costs.size, 1.0 / costs.size)
    excess = np.full(costs.size, math.inf)
    # Halved, so that the difference of two costs near the largest float does not overflow.
    excess[finite] = 0.5 * costs[finite] - 0.5 * costs[finite].min()
    unit = excess if scale == "excess" else 0.5 * costs
    mean = abs(float((unit[finite] / np.count_nonzero(finite)).sum()))
    if mean > 0.0:
        excess[finite] /= mean
    chances = np.where(finite, np.exp(-pressure * np.where(finite, excess, 0.0)), 0.0)
    return chances / chances.sum()


def _tournament(rng: np.random.Generator, costs: Array, rivals: int) -> int:
    """The best of some individuals drawn without preference."""
    drawn = rng.choice(len(costs), size=rivals, replace=False)
    return int(drawn[np.argmin(costs[drawn])])


def _cross(
    rng: np.random.Generator, one: Array, other: Array, settings: GeneticSettings
) -> tuple[Array, Array]:
    """Two children of two parents, each variable decided on its own."""
    if settings.crossover == "exchange":
        heads = rng.random(one.size) < 0.5
        return np.where(heads, one, other), np.where(heads, other, one)
    weight = rng.uniform(-settings.reach, 1.0 + settings.reach, one.size)
    # In this form, what the parents have in common stays as it is, to the bit.
    return other + weight * (one - other), one + weight * (other - one)


def _mutate(
    rng: np.random.Generator, children: Array, lower: Array, upper: Array, settings: GeneticSettings
) -> Array:
    """Children with some variables moved, put back within the bounds; shape (k, n)."""
    moved = rng.random(children.shape) < settings.mutation_rate
    unit = upper - lower if settings.step == "range" else 1.0
    step = settings.sigma * unit * rng.standard_normal(children.shape)
    return np.clip(np.where(moved, children + step, children), lower, upper)
