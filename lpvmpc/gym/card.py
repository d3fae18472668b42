"""The card of a learned driver: how it was trained, and what it does and does not drive.

    python eval/learn.py --card
    python eval/learn.py --card --policy runs/ppo.safetensors

Its roads and seeds were in no training: training drives random roads alone, with seeds below 50000.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.control.rivals.ppo import SHIPPED
from lpvmpc.kit import safetensors
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import csv_text, finite, record, versions_line, write_report
from lpvmpc.sim import batch
from lpvmpc.sim.batch import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEDS = range(100_000, 100_010)
"""Seeds of the sampled worlds; those of worlds.md begin there, too."""
GRIPS = (0.5, 0.65, 0.8, 0.92)
"""Grips at which the circuit is driven."""
WORLDS = ("ideal", "rtk", "fleet", "production")
"""Worlds it is driven in."""
HEADER = ("road", "world", "runs", "completed", "lateral_rmse_median_m", "lateral_max_worst_m",
          "steer_rate_rms_median_radps")
"""Columns of the table with every number."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One road in one world, with all its seeds."""

    road: str
    """What is driven, in words."""
    world: str
    """Name of the world."""
    results: tuple[dict[str, Any], ...]
    """Metrics of each run."""

    @property
    def completed(self) -> int:
        """Runs that reached the end."""
        return sum(bool(one["completed"]) for one in self.results)

    def row(self) -> tuple[object, ...]:
        """Its numbers in the order of `HEADER`; nothing where no run arrived."""
        arrived = [one for one in self.results if one["completed"]]

        def middle(key: str) -> float | None:
            values = sorted(one[key] for one in arrived)
            return values[(len(values) - 1) // 2] if values else None

        worst = max((one["lateral_max_m"] for one in arrived), default=None)
        return (self.road, self.world, len(self.results), self.completed,
                middle("lateral_rmse_m"), worst, middle("steer_rate_rms_radps"))


def drive(file: Path, jobs: int) -> list[Case]:
    """Drive every road in every world.

    Args:
        file: The policy.
        jobs: Processes.
    """
    options = {} if file == SHIPPED else {"file": str(file.resolve())}
    roads: dict[str, tuple[str, dict[str, float]]] = {"paper": ("paper", {})}
    for grip in GRIPS:
        roads[f"circuit {grip:.0%}".replace("%", " %")] = ("circuit", {"grip": grip})
    plan = [
        (road, world, [
            Run(label=f"{road}, {world}", scenario=name, scenario_options=chosen, controller="ppo",
                controller_options=options, world=world, seed=seed)
            for seed in (SEEDS[:1] if world == "ideal" else SEEDS)
        ])
        for road, (name, chosen) in roads.items()
        for world in WORLDS
    ]
    found = iter(batch.drive_all([run for _, _, runs in plan for run in runs], jobs=jobs))
    return [
        Case(road=road, world=world, results=tuple(next(found) for _ in runs))
        for road, world, runs in plan
    ]


def sentences(cases: Sequence[Case]) -> list[str]:
    """What follows from the numbers: first where it loses the car."""
    lost = [case for case in cases if case.completed < len(case.results)]
    said = []
    if lost:
        told = "; ".join(f"{len(c.results) - c.completed} of {len(c.results)} on {c.road} in "
                         f"`{c.world}`" for c in lost)
        said.append(f"It loses the car: {told}.")
    fine = [case for case in cases if case not in lost]
    if fine:
        told = ", ".join(f"{c.road} in `{c.world}`" for c in fine)
        said.append(f"It completes every run of: {told}.")
    return said


def report(cases: Sequence[Case], told: dict[str, str], curve: Any) -> str:
    """The card in Markdown.

    Args:
        cases: What was driven.
        told: Texts of the policy's file.
        curve: Periods and mean reward of a period, shape (n, 2).
    """
    rows = []
    for case in cases:
        road, world, n, completed, rmse, worst, rate = case.row()
        rows.append((
            road, world, f"{completed} of {n}", _mm(rmse), _mm(worst),
            "-" if rate is None else f"{rate:.2f}",
        ))
    lines = [
        "# A learned driver",
        "",
        f"Machine: {machine()}. {versions_line()}",
        "",
        *(f"- {sentence}" for sentence in sentences(cases)),
        "",
        "`ppo` is a network of two hidden layers of 64 with tanh, from what "
        "`lpvmpc/control/rivals/observation.py` lists to steering and acceleration; it remembers "
        "its last action and nothing else, plans nothing and knows no bound but those of its "
        "action. It was trained by proximal policy optimisation (Schulman et al. 2017, "
        "stable-baselines3) in `TrackVec-v0`, from random weights, on random roads, with nothing "
        f"of our controllers in it: {int(curve[-1, 0]):,} control periods, the mean reward of a "
        f"period from {curve[0, 1]:.2f} to {curve[-1, 1]:.2f}. One training seed stands behind "
        "this page.",
        "",
        f"- Recipe: `{told.get('recipe', 'not told')}`",
        f"- Versions of the training: `{told.get('versions', 'not told')}`",
        "",
        markdown_table(
            "Driven on roads and with seeds that no training has seen",
            ("road", "world", "completed", "RMSE, median [mm]", "largest, worst [mm]",
             "steering, median [rad/s]"),
            rows,
        ),
        "Medians and worst of the runs that arrive; the true centre of mass is scored, in sampled "
        f"worlds with seeds {SEEDS[0]} to {SEEDS[-1]}. Made by `python eval/learn.py --card`.",
    ]
    return "\n".join(lines) + "\n"


def _mm(value: object) -> str:
    return f"{1e3 * value:.0f}" if isinstance(value, float) else "-"


def save(file: Path, cases: Sequence[Case], folder: Path) -> list[Path]:
    """Write ppo.md, ppo.csv, ppo.json and ppo.png.

    Raises:
        DataError: The policy's file is damaged.
        OutputError: One of them cannot be written.
    """
    arrays, told = safetensors.read(file)
    curve = arrays["curve"]
    rows = [case.row() for case in cases]
    values = {
        "cases": [dict(zip(HEADER, map(finite, row), strict=True)) for row in rows],
        "periods": int(curve[-1, 0]), "reward": [float(curve[0, 1]), float(curve[-1, 1])],
        "recipe": told.get("recipe"), "record": record(),
    }
    return write_report(
        folder, "ppo", text=report(cases, told, curve), table=csv_text(HEADER, rows),
        values=values, picture=draw(curve),
    )


def draw(curve: Any) -> Figure:
    """Mean reward of a period over the periods driven."""
    import matplotlib
    from matplotlib.figure import Figure

    from lpvmpc.picture.figures import BLUE, COLUMN, STYLE

    with matplotlib.rc_context({**matplotlib.rcParamsDefault, **STYLE}):
        figure = Figure(figsize=(COLUMN, 2.2))
        axis = figure.subplots()
        axis.set_title("Training of ppo")
        axis.plot(1e-6 * curve[:, 0], curve[:, 1], color=BLUE, lw=0.8)
        axis.set_xlim(0.0, math.ceil(10.0 * 1e-6 * curve[-1, 0]) / 10.0)
        axis.set_xlabel("million control periods, all cars")
        axis.set_ylabel("reward of a period")
        figure.canvas.draw()
    return figure
