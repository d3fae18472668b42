"""What is tuned, where, and at which cost: the weights of every controller, by the same budget.

The cost of some weights is, summed over the scenarios,

    RMSE(ey) / m + RMSE(epsi) / rad + RMSE(vx - vx_ref) / (m/s)  +  C rms(d2 delta) / Ts

The first three are the paper's. The last charges a nervous command: d2 delta is the second
difference of the commanded steering angle, C = `NERVOUS`. A car that is lost costs
`LOST` (2 - driven share of the path) instead, more than any that arrives.

The LPV-MPC's weights are found by the genetic algorithm. A controller with a PID on its speed has
its gains found first, by the particle swarm, and then its lateral weights by the genetic algorithm,
both within the number of evaluations that the LPV-MPC has. Positive weights are searched by their
logarithm, since they act by ratios. The weights set by hand are among the first population.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.control.registry import CONTROLLERS
from lpvmpc.control.weights_file import apply, as_dict
from lpvmpc.errors import DataError, LPVMPCError, OptionError, UnknownNameError
from lpvmpc.kit.files import write_json
from lpvmpc.sim import batch
from lpvmpc.sim.log import Log
from lpvmpc.sim.metrics import metrics
from lpvmpc.sim.names import load_controller
from lpvmpc.tune import genetic, pso
from lpvmpc.tune.checkpoint import Result, State
from lpvmpc.tune.search import Map
from lpvmpc.units import Array

TRACKS: dict[str, dict[str, Any]] = {"tuning-a": {"grip": 0.8}, "tuning-b": {}}
"""Tracks made for tuning, and the options they are driven with: one near the limit of grip, one in
a side wind. No result is reported on them."""
NERVOUS = 0.1
"""Price of a nervous command [s/rad]: a steering angle that alternates by +-1 mrad from period to
period costs as much as 12 mm."""
LOST = 10.0
"""Price of losing the car."""
PID_GAINS = ("kp", "ki", "kd")
"""Weights that the particle swarm finds."""
WITHOUT_EFFECT = {"lpv-mpc-paper": ("terminal", "observer_gain", "slip_cap")}
"""Weights of parts that a controller does not have."""
DIGITS = 9
"""Decimals of a cost. Beyond them lies what differs between processors."""
FORMAT = 1
"""Version of a checkpoint."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """What decides the outcome of a tuning."""

    controller: str = "lpv-mpc"
    """Name of the controller."""
    scenarios: tuple[str, ...] = tuple(TRACKS)
    """Names of scenarios, or CSV files."""
    generations: int = 15
    """Generations of the genetic algorithm after its first population."""
    population: int = 20
    """Individuals in its population."""
    seed: int = 0
    """Seed of the searches and of the runs."""

    def __post_init__(self) -> None:
        """Refuse what cannot be tuned."""
        if self.controller not in CONTROLLERS:
            raise UnknownNameError("controller", self.controller, CONTROLLERS)
        if not self.scenarios:
            raise OptionError("scenarios", self.scenarios, "at least one name")
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
            "generations": self.generations,
            "population": self.population,
            "seed": self.seed,
            "foundation": batch.foundation(),
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
class Stage:
    """One search among the weights."""

    method: str
    """"genetic" or "pso"."""
    space: Space
    """What it searches."""
    settings: genetic.Settings | pso.Settings
    """How."""


def stages(task: Task) -> tuple[Stage, ...]:
    """The searches of a task, in their order; together they stay within its budget."""
    weights = _by_hand(task.controller)
    ranges = {
        name: bounds
        for name, bounds in weights.RANGES.items()
        if name not in WITHOUT_EFFECT.get(task.controller, ())
    }
    gains = {name: ranges.pop(name) for name in PID_GAINS if name in ranges}
    if not gains:
        settings = _genetic(task.generations, task.population)
        return (Stage("genetic", Space(ranges), settings),)
    lateral = _genetic(task.generations // 2, task.population)
    left = task.budget - lateral.evaluations
    particles = min(pso.Settings().population, left)
    swarm = pso.Settings(generations=left // particles - 1, population=particles)
    return Stage("pso", Space(gains), swarm), Stage("genetic", Space(ranges), lateral)


def _genetic(generations: int, population: int) -> genetic.Settings:
    return genetic.Settings(generations=generations, population=population)


def _by_hand(controller: str) -> Any:
    """A controller's weights as set by hand."""
    return load_controller(controller, weights={}).weights  # type: ignore[attr-defined]


# What it costs ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DrivingCost:
    """Cost of a point of the search; picklable, so that workers can be sent it."""

    controller: str
    """Name of the controller."""
    runs: tuple[batch.Run, ...]
    """What is driven, with the weights that are not searched."""
    space: Space
    """What the point means."""

    def __call__(self, coordinates: Array) -> float:
        """Drive, and sum up.

        Raises:
            LPVMPCError: The controller failed.
            KeyboardInterrupt: Ctrl-C.
        """
        total = 0.0
        for run in self.runs:
            weights = {**run.controller_options["weights"], **self.space.weights(coordinates)}
            log = batch.drive(with_weights(run, weights))
            if log.meta["reason"] == "interrupted":
                raise KeyboardInterrupt
            total += cost(log)
        return round(total, DIGITS)


def cost(log: Log) -> float:
    """Cost of one run, as at the head of this file."""
    result = metrics(log)
    if not result["completed"]:
        return LOST * (2.0 - min(result["s_end_m"] / log.scenario.path.length, 1.0))
    errors = result["lateral_rmse_m"] + result["heading_rmse_rad"] + result["speed_rmse_mps"]
    return float(errors + NERVOUS * nervousness(log))


def nervousness(log: Log) -> float:
    """Root mean square of the commanded steering rate's change from period to period [rad/s]."""
    change = np.diff(log.columns["delta_cmd_rad"], 2)
    return float(np.sqrt(np.mean(np.square(change)))) / log.meta["Ts"] if len(change) else 0.0


def with_weights(run: batch.Run, weights: Mapping[str, float]) -> batch.Run:
    """A run with other weights."""
    options = {**run.controller_options, "weights": dict(weights)}
    return replace(run, controller_options=options)


def runs(task: Task, weights: Mapping[str, float]) -> tuple[batch.Run, ...]:
    """The closed loops of a task."""
    return tuple(
        batch.Run(
            label=name,
            scenario=name,
            scenario_options=TRACKS.get(name, {}),
            controller=task.controller,
            controller_options={"weights": dict(weights)},
            seed=task.seed,
        )
        for name in task.scenarios
    )


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
    def evaluations(self) -> int:
        """Calls of the cost."""
        return sum(result.evaluations for result in self.results)


def tune(
    task: Task,
    *,
    map: Map = map,
    checkpoint: str | os.PathLike[str] | None = None,
    resume: bool = False,
    after: Callable[[Stage, State], None] | None = None,
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
    by_hand = as_dict(_by_hand(task.controller))
    file = None if checkpoint is None else Path(checkpoint)
    states = _read(file, task) if resume and file is not None else []
    current, results = dict(by_hand), []
    for i, stage in enumerate(stages(task)):

        def keep(state: State, i: int = i, stage: Stage = stage) -> None:
            states[i:] = [state]
            if file is not None:
                saved = [one.to_json() for one in states]
                write_json(file, {"format": FORMAT, "task": task.record(), "stages": saved})
            if after is not None:
                after(stage, state)

        low, high = stage.space.bounds
        result = _search(stage)(
            DrivingCost(task.controller, runs(task, current), stage.space),
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
    apply(_by_hand(task.controller), current)  # the controller takes them
    return Tuned(task=task, by_hand=by_hand, weights=current, results=tuple(results))


def _search(stage: Stage) -> Callable[..., Result]:
    return genetic.minimise if stage.method == "genetic" else pso.minimise


def _read(file: Path, task: Task) -> list[State]:
    """The states of the stages in a checkpoint.

    Raises:
        DataError: It is missing, damaged, or of another task or version.
    """
    name = repr(os.fspath(file))
    try:
        value = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        why = error.strerror or str(error)
        raise DataError(f"There is no tuning to resume in {name}: {why}.") from error
    except ValueError as error:
        raise DataError(f"The checkpoint {name} is damaged: {error}.") from error
    if not (isinstance(value, dict) and {"format", "task", "stages"} <= value.keys()):
        raise DataError(f"{name} is no checkpoint of a tuning.")
    if value["format"] != FORMAT:
        raise DataError(f"The checkpoint {name} has format {value['format']!r}; this version reads "
                        f"{FORMAT}.")  # fmt: skip
    now = task.record()
    differs = [key for key in now if value["task"].get(key) != now[key]]
    if differs == ["foundation"]:
        raise DataError(f"The checkpoint {name} was made with another version of the package; "
                        "without --resume the tuning begins anew.")  # fmt: skip
    if differs:
        shown = "; ".join(f"{k} {value['task'].get(k)}, not {now[k]}" for k in differs
                          if k != "foundation")  # fmt: skip
        raise DataError(f"The checkpoint {name} was made with {shown}.")
    try:
        return [State.from_json(state) for state in value["stages"]]
    except DataError as error:
        raise DataError(f"The checkpoint {name} is damaged: {error}") from error
