"""What tunings and trainings have left in files: read for the report, shipped or made anew."""

from __future__ import annotations

import csv
import json
import os
import statistics
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from lpvmpc.control.weights_file import as_dict, read_weights, shipped_file
from lpvmpc.errors import DataError, LPVMPCError
from lpvmpc.paper.runs import DRIVEN
from lpvmpc.sim.names import load_controller
from lpvmpc.tune import tuning

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Tuning:
    """How a controller was tuned."""

    controller: str
    """Name of the controller."""
    task: Mapping[str, Any]
    """What was asked: scenarios, generations, population, seed."""
    evaluations: int
    """Closed loops' costs that were computed."""
    budget: int
    """Most that were allowed."""
    cost: float
    """Cost of the tuned weights."""
    weights: Mapping[str, float]
    """All tuned weights."""
    before: tuple[Mapping[str, Any], ...]
    """Metrics of the tuning scenarios with the weights set by hand."""
    after: tuple[Mapping[str, Any], ...]
    """The same with the tuned ones."""
    history: tuple[tuple[str, int, float], ...]
    """Search, evaluations so far, and best cost so far of that search, generation by generation."""

    @property
    def first(self) -> float:
        """Cost of the weights set by hand, or of a better one among the first population."""
        return self.history[0][2]


@dataclass(frozen=True, kw_only=True)
class Training:
    """How a network was trained, and how well it fits."""

    kind: str
    """`network` or `network-secant`."""
    curve: tuple[tuple[int, float, float], ...]
    """Epoch, loss on training and on held-out samples."""
    r2: Mapping[tuple[str, str], tuple[float, ...]]
    """R2 of the secant stiffness by split and set, mean of both axles, one for each seed."""
    samples: int
    """Samples in the data."""

    def median(self, split: str, part: str) -> float | None:
        """Median of the R2 over the seeds, as one number like the paper's; None where not told."""
        found = self.r2.get((split, part))
        return None if not found else statistics.median(found)

    def spread(self, split: str, part: str) -> str:
        """Seeds, lowest and highest R2 as text; empty where not told."""
        found = self.r2.get((split, part), ())
        if len(found) < 2:
            return "one seed" if found else ""
        return f"median of {len(found)} seeds, {min(found):.3f} to {max(found):.3f}"


def published() -> Path | None:
    """The folder of results of the source tree; None where the package was installed alone."""
    folder = Path(str(resources.files("lpvmpc"))).parent / "docs" / "results"
    return folder if folder.is_dir() else None


def read_tuning(folder: Path) -> Tuning | None:
    """A tuning's tuning.json and history.csv; None where there are none.

    Raises:
        DataError: They are damaged.
    """
    file, table = folder / "tuning.json", folder / "history.csv"
    if not file.exists() or not table.exists():
        return None

    def parse() -> Tuning:
        value = json.loads(file.read_text())
        rows = list(csv.DictReader(table.read_text().splitlines()))
        return Tuning(
            controller=str(value["controller"]),
            task=dict(value["task"]),
            evaluations=int(value["evaluations"]),
            budget=int(value["budget"]),
            cost=float(value["cost"]),
            weights={name: float(number) for name, number in value["weights"].items()},
            before=tuple(value["before"]),
            after=tuple(value["after"]),
            history=_history(value["task"], rows),
        )

    return _parsed(parse, folder)


def _history(task: Mapping[str, Any], rows: list[dict[str, str]]) -> tuple[Any, ...]:
    """Generations with the evaluations that they took, one search after the other."""
    searches = tuning.stages(
        tuning.Task(
            controller=task["controller"],
            scenarios=tuple(task["scenarios"]),
            generations=task["generations"],
            population=task["population"],
            seed=task["seed"],
        )
    )
    order = [row["search"] for row in rows]  # an older tuning began with the swarm
    found, begin = [], 0
    for stage in sorted(searches, key=lambda stage: order.index(stage.method)):
        own = [row for row in rows if row["search"] == stage.method]
        first = stage.settings.population
        step = (stage.settings.evaluations - first) // max(stage.settings.generations, 1)
        counts = [begin + first + step * k for k in range(len(own))]
        pairs = zip(counts, own, strict=True)
        found += [(stage.method, count, float(row["best"])) for count, row in pairs]
        begin = counts[-1]
    return tuple(found)


def read_training(kind: str, folder: Path) -> Training | None:
    """A training's r2.csv and learning-curve.csv; None where there are none.

    Raises:
        DataError: They are damaged.
    """
    scores, curve = folder / "r2.csv", folder / "learning-curve.csv"
    if not scores.exists() or not curve.exists():
        return None

    def parse() -> Training:
        rows = list(csv.DictReader(scores.read_text().splitlines()))
        r2: dict[tuple[str, str], list[float]] = {}
        for row in rows:
            both = r2.setdefault((row["split"], row["set"]), [])
            both.append(0.5 * (float(row["C_f"]) + float(row["C_r"])))
        rows = [row for row in rows if row["seed"] == rows[0]["seed"]]
        losses = csv.DictReader(curve.read_text().splitlines())
        own = (row for row in rows if row["split"] == "runs" and row["set"] != "also")
        return Training(
            kind=kind,
            curve=tuple((int(r["epoch"]), float(r["train"]), float(r["test"])) for r in losses),
            r2={where: tuple(values) for where, values in r2.items()},
            samples=sum(int(row["samples"]) for row in own),
        )

    found = _parsed(parse, folder)
    if not found.curve or not found.r2:
        raise DataError(f"The results in {os.fspath(folder)!r} are damaged: they are empty.")
    return found


def _parsed(parse: Callable[[], T], folder: Path) -> T:
    """What `parse` gives; whatever is wrong in the files becomes one sentence."""
    try:
        return parse()
    except (OSError, ValueError, KeyError, TypeError, IndexError, LPVMPCError) as error:
        why = f"{type(error).__name__}: {error}".splitlines()[0]
        raise DataError(f"The results in {os.fspath(folder)!r} are damaged: {why}.") from error


# Weights ------------------------------------------------------------------------------------------


def weights_by_hand() -> dict[str, dict[str, float]]:
    """The weights set by hand, of all controllers."""
    found = {}
    for name in DRIVEN:
        made: Any = load_controller(name, weights={})
        found[name] = as_dict(made.weights)
    return found


def shipped_weights(by_hand: Mapping[str, Mapping[str, float]]) -> dict[str, dict[str, float]]:
    """The weights that the package ships, of the controllers that have some.

    Raises:
        DataError: A file is damaged.
    """
    found = {}
    for name, values in by_hand.items():
        file = shipped_file(name)
        if file.exists():
            found[name] = {**values, **read_weights(file, name)}
    return found


def tuned_on(controller: str) -> tuple[str, ...]:
    """The scenarios that the shipped weights of a controller were tuned on; none without some."""
    file = shipped_file(controller)
    if not file.exists():
        return ()
    record = tomllib.loads(file.read_text()).get("record", {})
    return tuple(str(name) for name in record.get("tuned_on", ()))
