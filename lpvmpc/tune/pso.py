"""A particle swarm for a few bounded numbers, on any function that can only be called.

Each particle flies on, drawn towards the best place it remembers and towards the best that any
particle remembers:

    v <- chi (v + c1 u1 (own best - x) + c2 u2 (best of all - x)),   x <- x + v,

u1, u2 uniform in [0, 1] for each variable; chi = 2 / (c - 2 + sqrt(c^2 - 4 c)) with c = c1 + c2 > 4
makes the swarm contract by itself.

Sources: Clerc and Kennedy, "The particle swarm: explosion, stability, and convergence in a
multidimensional complex space", IEEE Transactions on Evolutionary Computation 6(1), 2002; for steps
of at most a variable's range, Eberhart and Shi, "Comparing inertia weights and constriction factors
in particle swarm optimization", CEC 2000; for the size of the swarm, 10 + 2 sqrt(n), and for what
happens on a bound, Zambrano-Bigiarini et al., "Standard particle swarm optimisation 2011 at
CEC-2013: a baseline for future PSO improvements", CEC 2013: a particle that would leave the bounds
is put on them and comes back with half its speed. If it rested there, a swarm that has met on a
bound could never leave it.

The baseline of Kebbati et al. tunes its three PID gains by a swarm. The default spends as many
evaluations as the genetic algorithm of that paper does.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from dataclasses import replace as replaced
from functools import partial

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import OptionError
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

BOUNCE = 0.5
"""Speed with which a particle comes back from a bound, as a fraction of that it came with."""
METHOD = "pso"
"""Name of this search in a saved state."""


@dataclass(frozen=True, kw_only=True)
class SwarmSettings:
    """Parameters of the particle swarm."""

    generations: int = 19
    """Moves of the swarm; 19 of 13 particles cost what 15 generations of `genetic` do."""
    population: int = 13
    """Particles; 13 for three variables."""
    own: float = 2.05
    """Attraction c1 of the best place a particle remembers."""
    common: float = 2.05
    """Attraction c2 of the best place that any particle remembers."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        check_count("generations", self.generations, 0, 1_000_000)
        check_count("population", self.population, 1, 1_000_000)
        check_real("own", self.own, 0.0, 100.0)
        check_real("common", self.common, 0.0, 100.0)
        if self.own + self.common <= 4.0:
            raise OptionError("own + common", self.own + self.common, "above 4")

    @property
    def constriction(self) -> float:
        """The factor chi."""
        c = self.own + self.common
        return 2.0 / (c - 2.0 + math.sqrt(c * c - 4.0 * c))

    @property
    def evaluations(self) -> int:
        """Calls of the cost in a whole search."""
        return self.population * (1 + self.generations)


def minimise(
    cost: Cost,
    lower: npt.ArrayLike,
    upper: npt.ArrayLike,
    *,
    seed: int,
    settings: SwarmSettings | None = None,
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
        settings: Parameters.
        map: Evaluates a generation; `map` itself, or one that uses processes or a cluster.
        start: Places where the first particles shall be, shape (k, n); looked at only where no
            state is given.
        state: Go on from here.
        after: Called with the state after the first evaluation and after each move.

    Returns:
        The best individual, its cost, and how it was found.

    Raises:
        OptionError: Bounds, seed or start make no sense.
        DataError: The state is of another search.
    """
    settings = settings or SwarmSettings()
    low, high = check_bounds(lower, upper)
    check_count("seed", seed, 0, 2**63 - 1)
    record = record_of(settings, seed=seed)
    search = Search(method=METHOD, settings=record, cost=cost, lower=low, upper=high, map=map)
    return search.run(partial(_advance, search, settings), state, after, start=start, more=_at_rest)


def _at_rest(places: Array) -> dict[str, Array]:
    """Where the particles are, beside what they remember, and their speeds."""
    return {"places": places, "speeds": np.zeros_like(places)}


def _advance(search: Search, settings: SwarmSettings, state: SearchState) -> SearchState:
    """One move of the swarm."""
    rng, lower, upper = state.rng(), state.lower, state.upper
    best, costs = np.array(state.arrays["individuals"]), np.array(state.arrays["costs"])
    x, v = state.arrays["places"], state.arrays["speeds"]
    own, common = rng.random((2, *x.shape))
    leader = best[np.argmin(costs)]
    v = settings.constriction * (
        v + settings.own * own * (best - x) + settings.common * common * (leader - x)
    )
    v = np.clip(v, lower - upper, upper - lower)
    beyond = (x + v < lower) | (x + v > upper)
    x = np.clip(x + v, lower, upper)
    v = np.where(beyond, -BOUNCE * v, v)
    now, failures = evaluate(  # what is worse than all that is remembered is not remembered
        search.cost, x, search.map, state.generation + 1, limit=float(costs.max())
    )

    # As good as before counts as better, so that a swarm on a plateau still wanders.
    better = now <= costs
    best[better], costs[better] = x[better], now[better]
    return replaced(
        state,
        generator=dict(rng.bit_generator.state),
        arrays={
            "individuals": frozen(best),
            "costs": frozen(costs),
            "places": frozen(x),
            "speeds": frozen(v),
        },
        history=(*state.history, summary(best, costs)),
        evaluations=state.evaluations + len(x),
        failures=state.failures + failures,
    )
