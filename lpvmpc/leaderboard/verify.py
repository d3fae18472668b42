"""Whether rows are true: a sample of them is driven again, and compared."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.leaderboard.rows import sha256
from lpvmpc.sim.batch import Run, foundation

COMPARED = ("s_end_m", "lateral_rmse_m", "lateral_max_m", "lateral_p95_m", "speed_rmse_mps")
"""What is compared where the bytes of two traces differ."""
TOLERANCE = 0.01
"""By how much it may differ, in shares of it: on another processor the last bits do, and the car
drives almost the same."""


@dataclass(frozen=True, kw_only=True)
class Check:
    """A row and what driving it again has given."""

    run: Run
    """What was driven."""
    identical: bool
    """Whether the traces have the same bytes, or there is neither."""
    differs: str
    """What differs by more than the tolerance; empty where nothing does."""

    @property
    def ok(self) -> bool:
        """Whether the row is true."""
        return self.identical or not self.differs


def sample(rows: Sequence[Mapping[str, Any]], count: int) -> list[Mapping[str, Any]]:
    """So many of the rows, always the same ones of a file, in its order; 0: all."""
    if count == 0 or count >= len(rows):
        return list(rows)
    chosen = np.random.default_rng(0).choice(len(rows), count, replace=False)
    return [rows[i] for i in sorted(chosen)]


def compare(
    rows: Sequence[Mapping[str, Any]], drive: Callable[[Sequence[Run]], list[dict[str, Any]]]
) -> list[Check]:
    """Drive rows again.

    Args:
        rows: Rows as `rows.read_rows` gives them.
        drive: Drives runs, as `batch.drive_all` does.

    Raises:
        OptionError: A row that describes no run.
    """
    runs = [Run.of_text(str(row["run"])) for row in rows]
    return [
        Check(
            run=run,
            identical=(row["trace_sha256"] or "") == (result["trace_sha256"] or "")
            and not differences(row, result),
            differs=differences(row, result),
        )
        for run, row, result in zip(runs, rows, drive(runs), strict=True)
    ]


def differences(row: Mapping[str, Any], result: Mapping[str, Any]) -> str:
    """The first thing in which a row and a new result differ; empty where they agree."""
    if bool(row["completed"]) != bool(result["completed"]):
        is_now = "completes" if result["completed"] else f"does not: {result['reason']}"
        return f"completed is {row['completed']}, but the run {is_now}"
    for name in COMPARED:
        told, value = row[name], result[name]
        told = None if told is None or math.isnan(told) else float(told)
        if (told is None) != (value is None):
            return f"{name} is {told}, now {value}"
        if told is not None and not math.isclose(told, value, rel_tol=TOLERANCE, abs_tol=1e-6):
            return f"{name} is {told:.6g}, now {value:.6g}"
    return ""


def told(
    file: str | os.PathLike[str], found: Sequence[Check], rows: int, facts: Mapping[str, Any]
) -> Iterable[str]:
    """What has come of it, a line each."""
    yield f"{os.fspath(file)}: SHA-256 {sha256(file)}."
    if facts.get("foundation") != foundation():
        yield (
            "It was made by another version of the package, or of what it needs: rows may differ "
            "for that reason alone."
        )
    for one in found:
        if not one.ok:
            yield f"DIFFERS: {one.run.controller}, {one.run.text()}: {one.differs}."
    same = sum(one.identical for one in found)
    near = sum(one.ok and not one.identical for one in found)
    yield (
        f"{len(found)} of {rows} rows driven again: {same} with the same trace to the bit, {near} "
        f"the same within {100 * TOLERANCE:g} %, {len(found) - same - near} different."
    )
