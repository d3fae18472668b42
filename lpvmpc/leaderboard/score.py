"""How well a controller has driven: who completed in time first, then the worst of the errors.

A run counts as finished where the car reached the end and the controller kept its period: no more
than `LATE_SHARE` of its steps took longer than the 33 ms in which the next command is due. Every
other run is charged: its error is infinite, and no percentile leaves it out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lpvmpc.kit.statistics import median, percentile, percentile_interval, wilson
from lpvmpc.leaderboard.grid import Cell, Row, is_slow

LATE_SHARE = 0.01
"""Share of steps that may be late: with more of them a run is charged."""
SHARE = 0.95
"""Share of the runs that a controller's error covers."""
EFFORT = ("steer_rate_rms_radps", "drive_rate_rms_mps3", "jerk_rms_mps3", "lateral_acc_max_mps2")
"""What driving has asked of car and passengers."""


def completed(row: Row) -> bool:
    """Whether the car reached the end."""
    return bool(row.result["completed"])


def late(row: Row) -> bool:
    """Whether the controller did not keep its period."""
    steps, missed = row.result["steps"], row.result["late_steps"]
    return bool(steps) and missed > LATE_SHARE * steps


def finished(row: Row) -> bool:
    """Whether the car reached the end, and the controller kept its period."""
    return completed(row) and not late(row)


def error(row: Row) -> float:
    """Lateral RMSE of a run [m]; infinite where it is charged."""
    value = row.result["lateral_rmse_m"]
    return float(value) if finished(row) and value is not None else math.inf


def reason(row: Row) -> str:
    """Why a run is charged."""
    if not completed(row):
        return str(row.result["reason"])
    return f"late: {100 * row.result['late_steps'] / row.result['steps']:.0f} % of the steps"


class Board:
    """All rows, by cell and controller."""

    def __init__(self, rows: Sequence[Row]) -> None:
        """Args: the rows, in the order of the grid."""
        self.rows = tuple(rows)
        self.controllers = tuple(dict.fromkeys(row.controller for row in rows))
        """Everybody who drives."""
        self.table: dict[Cell, dict[str, Row]] = {}
        """Rows by cell and controller."""
        for row in rows:
            self.table.setdefault(row.cell, {})[row.controller] = row

    @property
    def slow(self) -> tuple[str, ...]:
        """Who drives a part of the cells alone."""
        return tuple(name for name in self.controllers if is_slow(name))

    @property
    def full(self) -> tuple[str, ...]:
        """Who drives all cells."""
        return tuple(name for name in self.controllers if not is_slow(name))

    def cells(
        self, part: str, world: str | None = None, course: str | None = None,
        by: Iterable[str] = (),
    ) -> list[Cell]:
        """Cells of a part, in a world and on a course, that all of `by` have driven."""
        names = tuple(by)
        return [
            cell for cell, rows in self.table.items()
            if cell.part == part and world in (None, cell.world) and course in (None, cell.course)
            and all(name in rows for name in names)
        ]

    def of(self, controller: str, cells: Iterable[Cell]) -> list[Row]:
        """A controller's rows of some cells; cells that it has not driven are left out."""
        return [self.table[cell][controller] for cell in cells
                if controller in self.table[cell]]

    def worlds(self) -> list[str]:
        """Worlds of the part `worlds`, in their order."""
        return list(dict.fromkeys(cell.world for cell in self.table if cell.part == "worlds"))

    def courses(self) -> list[str]:
        """Courses of the part `worlds`, in their order."""
        return list(dict.fromkeys(cell.course for cell in self.table if cell.part == "worlds"))


@dataclass(frozen=True, kw_only=True)
class Score:
    """What a controller has shown over some cells."""

    controller: str
    """Who drove."""
    n: int
    """Number of runs."""
    completed: int
    """Of these, how many reached the end."""
    finished: int
    """Of these, how many in time as well."""
    p95: float
    """95th percentile of the lateral RMSE [m]; infinite where it falls on a charged run."""
    p95_interval: tuple[float, float]
    """Its confidence interval, 95 %."""
    median: float
    """Median of the same [m]."""
    largest: float
    """95th percentile of the largest lateral error [m]; infinite likewise."""
    step_us: tuple[float | None, float | None, float | None]
    """Median over the runs of the step's median and 99th percentile, and the worst step [us]."""
    step_interval: tuple[float, float] | None
    """Confidence interval of the first of them, 95 %."""
    late_share: float | None
    """Share of all steps that were late."""

    @property
    def interval(self) -> tuple[float, float]:
        """Confidence interval of the share of finished runs, 95 %."""
        return wilson(self.finished, self.n)

    @property
    def order(self) -> tuple[float, float, float, str]:
        """The smaller the better: charged runs, then the 95th percentile, then the median."""
        return (1.0 - self.finished / self.n, self.p95, self.median, self.controller)


def score(rows: Sequence[Row]) -> Score:
    """What a controller's runs have shown.

    Args:
        rows: At least one, all of one controller.
    """
    errors = [error(row) for row in rows]
    largest = [
        float(row.result["lateral_max_m"])
        if finished(row) and row.result["lateral_max_m"] is not None else math.inf
        for row in rows
    ]
    p50, p99, worst = (_step_times(rows, key) for key in ("p50", "p99", "max"))
    steps = sum(int(row.result["steps"] or 0) for row in rows)
    missed = sum(int(row.result["late_steps"] or 0) for row in rows)
    return Score(
        controller=rows[0].controller,
        n=len(rows),
        completed=sum(map(completed, rows)),
        finished=sum(map(finished, rows)),
        p95=percentile(errors, SHARE),
        p95_interval=percentile_interval(errors, SHARE),
        median=median(errors),
        largest=percentile(largest, SHARE),
        step_us=(
            median(p50) if p50 else None, median(p99) if p99 else None, max(worst, default=None)
        ),
        step_interval=percentile_interval(p50, 0.5) if p50 else None,
        late_share=missed / steps if steps else None,
    )


def _step_times(rows: Iterable[Row], key: str) -> list[float]:
    """One of the step times of each run that has any [us]."""
    times = [(row.result["step_time_us"] or {}).get(key) for row in rows]
    return [float(value) for value in times if value is not None]


def ranking(board: Board, cells: Sequence[Cell], controllers: Iterable[str]) -> list[Score]:
    """Scores of controllers over some cells, the best first."""
    found = [score(rows) for name in controllers if (rows := board.of(name, cells))]
    return sorted(found, key=lambda s: s.order)


@dataclass(frozen=True, kw_only=True)
class Effort:
    """What driving has asked for, compared where it can be: on the same runs, all completed."""

    n: int
    """Number of cells."""
    table: Mapping[str, Mapping[str, float]]
    """Median of each of `EFFORT`, by controller."""


def effort(board: Board, cells: Sequence[Cell], controllers: Sequence[str]) -> Effort:
    """Effort over the cells that everybody has completed who completed half of them.

    Whoever loses more is left out: it would leave nothing to compare the others on.
    """
    fit = [
        name for name in controllers
        if (rows := board.of(name, cells)) and 2 * sum(map(completed, rows)) >= len(rows)
    ]
    common = [
        cell for cell in cells
        if all(name in board.table[cell] and completed(board.table[cell][name]) for name in fit)
    ]
    table: dict[str, dict[str, float]] = {}
    for name in fit if common else ():
        results: list[Mapping[str, Any]] = [row.result for row in board.of(name, common)]
        table[name] = {
            key: median(float(r[key]) for r in results if r[key] is not None) for key in EFFORT
        }
    return Effort(n=len(common), table=table)
