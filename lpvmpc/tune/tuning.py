"""What is tuned, where, and by which searches: the weights of every controller, by one budget.

A weight set drives tuning roads in drawn worlds; `driving` says what that costs. The LPV-MPC's
weights are found by the genetic algorithm. A controller with a PID on its speed has its
lateral weights found first, by the genetic algorithm, and then its gains by the particle swarm,
both within the number of evaluations that the LPV-MPC has; the other way round the swarm would
judge gains by runs that are lost beside the line. Positive weights are searched by their logarithm,
since they act by ratios. The weights set by hand are among the first population.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.control.registry import CONTROLLERS, TUNABLE
from lpvmpc.control.rivals import RIVALS
from lpvmpc.errors import LPVMPCError, OptionError, UnknownNameError
from lpvmpc.kit.files import checksum
from lpvmpc.sim import batch
from lpvmpc.sim.names import load_controller
from lpvmpc.sim.world import load_world
from lpvmpc.tune import checkpoint as checkpoints
from lpvmpc.tune import driving, genetic, pso
from lpvmpc.tune.checkpoint import Result, SearchState
from lpvmpc.tune.search import Map
from lpvmpc.tune.stated import is_own, sources, stated
from lpvmpc.units import Array

TRACKS: dict[str, dict[str, Any]] = {"tuning-a": {"grip": 0.8}, "tuning-b": {}}
"""Tracks made for tuning, and the options they are driven with: one near the limit of grip, one in
a side wind. No result is reported on them."""
GRIP_LESS_FRICTION = 0.65
"""Grip at which such a road is driven in worlds that take friction away: what `fleet` may leave,
0.8 x 0.9 of the friction that the plan counts on, still carries the car. A run that nobody can
drive would be among the worst of every weight set and tell them apart no more."""
WORLDS = ("ideal", "rtk", "fleet", "fleet")
"""Worlds of a tuning: one draw for each time that a name is there."""
FIRST_SEED = 1000
"""Seed of the first draw; reports begin at 100000."""
MAX_RUNS = 10_000
"""Most runs of a weight set, which keeps the seeds below those of reports."""
PID_GAINS = ("kp", "ki", "kd")
"""Weights that the particle swarm finds."""
WITHOUT_EFFECT = {
    "lpv-mpc-paper": ("terminal", "observer_gain", "slip_cap"),
    "lpv-mpc-protected": ("terminal", "observer_gain"),
    "lmpc-pso-pid-plain": ("stiffness", "slip_cap"),
}
"""Weights of parts that a controller does not have."""
NEAR = 0.02
"""Share of its range within which a weight counts as on its bound."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """What decides the outcome of a tuning."""

    controller: str = "lpv-mpc"
    """Name of the controller, or `module:Class`."""
    scenarios: tuple[str, ...] = tuple(TRACKS)
    """Names of scenarios, or CSV files."""
    worlds: tuple[str, ...] = WORLDS
    """Names of worlds, or TOML files; a name that is there twice is drawn twice."""
    seeds: int = 1
    """Draws of each entry of `worlds`, each on every scenario."""
    generations: int = 15
    """Generations of the genetic algorithm after its first population."""
    population: int = 20
    """Individuals in its population."""
    seed: int = 0
    """Seed of the searches; the runs have their own, the same for every search."""

    def __post_init__(self) -> None:
        """Refuse what cannot be tuned."""
        if not is_own(self.controller) and self.controller not in CONTROLLERS:
            raise UnknownNameError("controller", self.controller, [*TUNABLE, "module:Class"])
        if not self.scenarios:
            raise OptionError("scenarios", self.scenarios, "at least one name")
        if not self.worlds:
            raise OptionError("worlds", self.worlds, "at least one name")
        for world in self.worlds:
            load_world(world)
        most = MAX_RUNS // (len(self.scenarios) * len(self.worlds))
        if not 1 <= self.seeds <= most:
            raise OptionError("seeds", self.seeds, f"a whole number from 1 to {most}")
        if not 1 <= self.generations <= 10_000:
            raise OptionError("generations", self.generations, "a whole number from 1 to 10000")
        if not 4 <= self.population <= 10_000:
            raise OptionError("population", self.population, "a whole number from 4 to 10000")

    @property
    def budget(self) -> int:
        """Evaluations that the genetic algorithm alone would take; no controller has more."""
        return _genetic(self.generations, self.population).evaluations

    def record(self) -> dict[str, Any]:
        """The task and what its costs depend on, for files."""
        return {
            "controller": self.controller,
            "scenarios": list(self.scenarios),
            "worlds": list(self.worlds),
            "seeds": self.seeds,
            "generations": self.generations,
            "population": self.population,
            "seed": self.seed,
            "prices": driving.prices(),
            "foundation": batch.foundation(self.controller in RIVALS),
            **({"module": checksum(list(own))} if (own := sources(self.controller)) else {}),
        }


# What is searched ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Space:
    """Some weights as coordinates of a search."""

    ranges: Mapping[str, tuple[float, float]]
    """Lowest and highest value by name."""

    def coordinates(self, weights: Mapping[str, float]) -> Array:
        """Coordinates of the weights, shape (n,): log10 of those that must be positive.

        Values outside the ranges are put on their bounds.
        """
        values = [
            min(max(weights[name], low), high) for name, (low, high) in self.ranges.items()
        ]
        return np.array([self._map(n, v) for n, v in zip(self.ranges, values, strict=True)])

    def weights(self, coordinates: Array) -> dict[str, float]:
        """The weights at some coordinates, shape (n,)."""
        found = {}
        for (name, (low, high)), value in zip(self.ranges.items(), coordinates, strict=True):
            value = float(10.0**value) if low > 0.0 else float(value)
            found[name] = min(max(value, low), high)  # the power may round beyond a bound
        return found

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper coordinates, shape (n,) each."""
        low, high = (
            np.array([self._map(name, pair[side]) for name, pair in self.ranges.items()])
            for side in (0, 1)
        )
        return low, high

    def _map(self, name: str, value: float) -> float:
        return math.log10(value) if self.ranges[name][0] > 0.0 else value


@dataclass(frozen=True)
class SearchStage:
    """One search among the weights."""

    method: str
    """"genetic" or "pso"."""
    space: Space
    """What it searches."""
    settings: genetic.GeneticSettings | pso.SwarmSettings
    """How."""


def stages(task: Task) -> tuple[SearchStage, ...]:
    """The searches of a task, in their order; together they stay within its budget."""
    ranges = {
        name: bounds
        for name, bounds in stated(task.controller).ranges.items()
        if name not in WITHOUT_EFFECT.get(task.controller, ())
    }
    pid = () if is_own(task.controller) else PID_GAINS  # a user's kp may be anything
    gains = {name: ranges.pop(name) for name in pid if name in ranges}
    if not gains:
        settings = _genetic(task.generations, task.population)
        return (SearchStage("genetic", Space(ranges), settings),)
    lateral = _genetic(task.generations // 2, task.population)
    left = task.budget - lateral.evaluations
    particles = min(pso.SwarmSettings().population, left)
    swarm = pso.SwarmSettings(generations=left // particles - 1, population=particles)
    return SearchStage("genetic", Space(ranges), lateral), SearchStage("pso", Space(gains), swarm)


def _genetic(generations: int, population: int) -> genetic.GeneticSettings:
    return genetic.GeneticSettings(generations=generations, population=population)


# What is driven -----------------------------------------------------------------------------------


def runs(task: Task, weights: Mapping[str, float]) -> tuple[batch.Run, ...]:
    """The closed loops of a task; each has its own draw, but for worlds that draw nothing.

    The seeds begin at `FIRST_SEED`, so that those of reports are never met here.
    """
    found: list[batch.Run] = []
    for n in range(task.seeds):
        for world in task.worlds:
            if n > 0 and load_world(world).ideal:
                continue  # it would be the same run again
            for name in task.scenarios:
                seed = FIRST_SEED + len(found)
                found.append(
                    batch.Run(
                        label=f"{name}, {world}",
                        scenario=name,
                        scenario_options=options_of(name, world),
                        controller=task.controller,
                        controller_options={"weights": dict(weights)},
                        world=world,
                        seed=seed,
                    )
                )
    return tuple(found)


def options_of(scenario: str, world: str) -> dict[str, Any]:
    """How a road of a tuning is driven in a world."""
    options = dict(TRACKS.get(scenario, {}))
    if "grip" in options and "friction" in load_world(world).road:
        options["grip"] = GRIP_LESS_FRICTION
    return options


# Tuning -------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """What a tuning has found."""

    task: Task
    """What was asked."""
    by_hand: dict[str, float]
    """The controller's weights as set by hand."""
    weights: dict[str, float]
    """All its weights, tuned."""
    results: tuple[Result, ...]
    """What each stage found."""

    @property
    def on_bounds(self) -> tuple[str, ...]:
        """Weights that ended within `NEAR` of their range from one of its ends."""
        found: list[str] = []
        for stage in stages(self.task):
            point = stage.space.coordinates(self.weights)
            low, high = stage.space.bounds
            near = np.minimum(point - low, high - point) <= NEAR * (high - low)
            found += [name for name, on in zip(stage.space.ranges, near, strict=True) if on]
        return tuple(found)

    @property
    def evaluations(self) -> int:
        """Calls of the cost."""
        return sum(result.evaluations for result in self.results)


def tune(
    task: Task,
    *,
    map: Map = map,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
    after: Callable[[SearchStage, SearchState], None] | None = None,
) -> Tuned:
    """Tune a controller.

    Args:
        task: What to tune.
        map: Evaluates a generation, such as that of `kit.workers`.
        checkpoint: File that holds the search after each generation; None keeps nothing.
        resume: Go on from the checkpoint, to the same result as without a break.
        after: Called with the stage and its state after each generation.

    Raises:
        DataError: The checkpoint is missing, damaged, of another task or of another version.
        OutputError: It cannot be written.
        LPVMPCError: No individual of a stage could be driven.
    """
    by_hand = stated(task.controller).weights
    file = None if checkpoint is None else Path(checkpoint)
    states = checkpoints.read(file, task.record()) if resume and file is not None else []

    def save() -> None:
        if file is not None:
            checkpoints.write(file, task.record(), states)

    if not states:
        save()  # a tuning that is interrupted before its first generation can be resumed, too
    current, results = dict(by_hand), []
    for i, stage in enumerate(stages(task)):

        def keep(state: SearchState, i: int = i, stage: SearchStage = stage) -> None:
            states[i:] = [state]
            save()
            if after is not None:
                after(stage, state)

        low, high = stage.space.bounds
        result = _search(stage)(
            driving.DrivingCost(task.controller, runs(task, current), stage.space),
            low,
            high,
            seed=task.seed,
            settings=stage.settings,
            map=map,
            start=stage.space.coordinates(current)[None],
            state=states[i] if i < len(states) else None,
            after=keep,
        )
        if not math.isfinite(result.cost):
            why = result.failures[0].text if result.failures else "no cost is finite"
            raise LPVMPCError(f"No weights of {task.controller} could be driven: {why}.")
        current |= stage.space.weights(result.best)
        results.append(result)
    load_controller(task.controller, weights=current)  # the controller takes them
    return Tuned(task=task, by_hand=by_hand, weights=current, results=tuple(results))


def _search(stage: SearchStage) -> Callable[..., Result]:
    return genetic.minimise if stage.method == "genetic" else pso.minimise
