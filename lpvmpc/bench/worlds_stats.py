"""Numbers of many runs: completion with its interval, percentiles that no lost run escapes."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from lpvmpc.bench.worlds import Cell, DrivenCell
from lpvmpc.kit.statistics import median, percentile, wilson


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Runs of one controller in one world on one road."""

    cell: Cell
    """The first of them."""
    n: int
    """Number of runs."""
    completed: int
    """Of these, how many the car got to the end."""
    rmse: tuple[float, float, float]
    """Median, 95th percentile and worst lateral RMSE [m]; infinite for a lost car."""
    largest: tuple[float, float, float]
    """The same of the largest lateral error [m]."""
    steering: float | None
    """Median rms of the steering rate [rad/s], over completed runs."""
    jerk: float | None
    """Median rms of the lateral jerk [m/s3], over completed runs."""
    estimate: float | None
    """Median RMSE of the estimated lateral position [m], over completed runs."""
    share: float | None
    """Median of the estimate's RMSE over the car's, run by run [-]."""

    @property
    def interval(self) -> tuple[float, float]:
        """Confidence interval of the share of completed runs, 95 %."""
        return wilson(self.completed, self.n)


def summary(rows: Sequence[DrivenCell]) -> Summary:
    """What runs that differ in their seeds alone have in common."""
    done = [row.result for row in rows if row.completed]
    rmse = [row.ranked("lateral_rmse_m") for row in rows]
    largest = [row.ranked("lateral_max_m") for row in rows]
    return Summary(
        cell=rows[0].cell,
        n=len(rows),
        completed=len(done),
        rmse=(median(rmse), percentile(rmse, 0.95), max(rmse)),
        largest=(median(largest), percentile(largest, 0.95), max(largest)),
        steering=_middle(result["steer_rate_rms_radps"] for result in done),
        jerk=_middle(result["jerk_rms_mps3"] for result in done),
        estimate=_middle(result["estimate_ey_rmse_m"] for result in done),
        share=_middle(
            result["estimate_ey_rmse_m"] / result["lateral_rmse_m"]
            for result in done if result["estimate_ey_rmse_m"] and result["lateral_rmse_m"]
        ),
    )


def _middle(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None


def grouped(
    rows: Iterable[DrivenCell], key: Callable[[Cell], tuple[str, ...]]
) -> dict[tuple[str, ...], list[DrivenCell]]:
    """Rows by a key of their cells, in the order in which they come."""
    found: dict[tuple[str, ...], list[DrivenCell]] = {}
    for row in rows:
        found.setdefault(key(row.cell), []).append(row)
    return found


def summaries(rows: Iterable[DrivenCell]) -> list[Summary]:
    """One summary for each world, road, controller and stiffness model."""
    groups = grouped(rows, lambda cell: (cell.case, cell.road, cell.controller, cell.model))
    return [summary(group) for group in groups.values()]
