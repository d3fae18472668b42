"""How far searches of one task agree that differ in their seed: the spread of what they found.

A genetic algorithm draws, so one search is one draw of its result. `read` takes the folders that
searches of the same task left, `report` lays them side by side: what each found, what it costs, and
what the shipped weights cost in the same runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpvmpc.control.weights_file import as_dict
from lpvmpc.errors import DataError, OptionError
from lpvmpc.kit.files import read_json, replacing, write_json, write_text
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import commit, machine
from lpvmpc.kit.report import record
from lpvmpc.kit.workers import workers
from lpvmpc.sim import batch
from lpvmpc.sim.names import load_controller
from lpvmpc.tune import driving, tuning
from lpvmpc.tune.stated import is_own, stated
from lpvmpc.tune.tuning import Task

NEEDED: Mapping[str, type | tuple[type, ...]] = {
    "task": dict, "weights": dict, "cost": (int, float), "evaluations": int, "on_bounds": list,
    "record": dict,
}
"""What is read of a search's tuning.json, and its types."""
FILES = ("spread.md", "spread.json")
"""What `save` leaves."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Searches of one task with different seeds, and the shipped weights beside them."""

    task: Task
    """The task, with the first search's seed."""
    seeds: tuple[int, ...]
    """Seed of each search."""
    weights: tuple[Mapping[str, float], ...]
    """What each found."""
    costs: tuple[float, ...]
    """What that costs."""
    on_bounds: tuple[tuple[str, ...], ...]
    """Weights that ended on a bound, search by search."""
    evaluations: tuple[int, ...]
    """How many weight sets each drove."""
    commits: tuple[str, ...]
    """Commit of each search."""
    shipped: Mapping[str, float]
    """The weights that the package ships."""
    shipped_cost: float
    """What these cost in the same runs, driven now."""


def read(folders: Sequence[Path], jobs: int) -> Spread:
    """The searches in some folders; the shipped weights are driven on the same runs.

    Args:
        folders: At least two, each with the tuning.json of one search.
        jobs: Processes that drive.

    Raises:
        OptionError: Fewer than two folders, searches of different tasks, or a seed twice.
        DataError: A folder without a tuning, or with a damaged one.
    """
    if len(folders) < 2:
        raise OptionError("--spread", len(folders), "at least two folders of searches")
    found = [_read(folder) for folder in folders]
    first = {**found[0]["task"], "seed": None}
    for folder, one in zip(folders, found, strict=True):
        for key, value in {**one["task"], "seed": None}.items():
            if first.get(key) != value:
                raise OptionError(
                    f"{key} of {folder}", value, f"that of {folders[0]}, {first.get(key)}"
                )
    seeds = tuple(one["task"]["seed"] for one in found)
    if len(set(seeds)) < len(seeds):
        raise OptionError("seeds", ", ".join(map(str, seeds)), "a different one for each search")
    kept = found[0]["task"]
    task = Task(
        controller=kept["controller"], scenarios=tuple(kept["scenarios"]),
        worlds=tuple(kept["worlds"]), seeds=kept["seeds"], generations=kept["generations"],
        population=kept["population"], seed=kept["seed"],
    )
    shipped = stated(task.controller).weights
    if not is_own(task.controller):
        shipped = as_dict(load_controller(task.controller).weights)  # type: ignore[attr-defined]
    return Spread(
        task=task, seeds=seeds,
        weights=tuple(one["weights"] for one in found),
        costs=tuple(float(one["cost"]) for one in found),
        on_bounds=tuple(tuple(one["on_bounds"]) for one in found),
        evaluations=tuple(one["evaluations"] for one in found),
        commits=tuple(str(one["record"].get("commit")) for one in found),
        shipped=shipped, shipped_cost=_cost(task, shipped, jobs),
    )


def _read(folder: Path) -> dict[str, Any]:
    path = folder / "tuning.json"
    try:
        found = read_json(path)
    except OSError as error:
        raise DataError(
            f"{path} cannot be read ({error.strerror}); --spread takes folders of finished tunings."
        ) from error
    except ValueError as error:
        raise DataError(
            f"{path} is no JSON; --spread takes folders of finished tunings."
        ) from error
    values = found if isinstance(found, dict) else {}
    missing = [key for key, kind in NEEDED.items() if not isinstance(values.get(key), kind)]
    if missing:
        raise DataError(f"{path} holds no tuning: {', '.join(missing)} missing or no such value.")
    return dict(found)


def _cost(task: Task, weights: Mapping[str, float], jobs: int) -> float:
    """What a weight set costs in the runs of a task."""
    with workers(jobs) as pool:
        costs = list(pool.map(_run_cost, list(tuning.runs(task, weights))))
    return driving.risk(costs)


def _run_cost(run: batch.Run) -> float:
    return driving.cost(batch.drive(run), driving.scale(run))


def report(spread: Spread) -> str:
    """The spread in Markdown: first what it says, then what each search found."""
    task, costs = spread.task, spread.costs
    low, high = min(costs), max(costs)
    better = sum(cost < spread.shipped_cost for cost in costs)
    names = ", ".join(map(str, spread.seeds))
    lines = [
        f"# {len(costs)} searches for the weights of {task.controller}",
        "",
        f"Searches at commit {', '.join(sorted(set(spread.commits)))}; this page at {commit()}; "
        f"{machine()}. Seeds {names}; otherwise the same task: {task.generations} generations of "
        f"{task.population}, on {', '.join(task.scenarios)} in {', '.join(task.worlds)}.",
        "",
        f"- The searches end at costs of {low:.3f} to {high:.3f}, {high / low:.2f} times from the "
        "best to the worst.",
        f"- The shipped weights cost {spread.shipped_cost:.3f} in the same runs: "
        f"{better} of {len(costs)} searches found cheaper ones.",
        "",
        markdown_table(
            "Searches",
            ("seed", "evaluations", "cost", "on a bound"),
            [(str(seed), str(n), f"{cost:.4f}", ", ".join(on) or "-") for seed, n, cost, on in
             zip(spread.seeds, spread.evaluations, costs, spread.on_bounds, strict=True)],
        ),
        markdown_table(
            "Weights",
            ("weight", "shipped", *(f"seed {seed}" for seed in spread.seeds), "largest / smallest"),
            [_row(name, spread) for name in spread.weights[0]],
        ),
        "A weight whose last column is large is one that the cost hardly knows.\n",
    ]
    return "\n".join(lines)


def _row(name: str, spread: Spread) -> tuple[str, ...]:
    values = [one[name] for one in spread.weights]
    ratio = max(values) / min(values) if min(values) > 0.0 else math.inf
    shipped = spread.shipped.get(name)
    return (
        name, "-" if shipped is None else f"{shipped:.4g}", *(f"{value:.4g}" for value in values),
        f"{ratio:.2f}" if math.isfinite(ratio) else "-",
    )


def save(spread: Spread, folder: Path) -> list[Path]:
    """Write spread.md and spread.json, both together.

    Raises:
        OutputError: One of them cannot be written.
    """
    with replacing(folder, FILES) as new:
        write_text(new / FILES[0], report(spread))
        write_json(new / FILES[1], as_json(spread))
    return [folder / name for name in FILES]


def as_json(spread: Spread) -> dict[str, Any]:
    """One object with all numbers of the report."""
    return {
        "controller": spread.task.controller,
        "seeds": list(spread.seeds),
        "costs": list(spread.costs),
        "evaluations": list(spread.evaluations),
        "weights": [dict(one) for one in spread.weights],
        "on_bounds": [list(one) for one in spread.on_bounds],
        "shipped": dict(spread.shipped),
        "shipped_cost": spread.shipped_cost,
        "record": record(),
    }
