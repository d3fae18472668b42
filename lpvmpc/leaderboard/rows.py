"""The rows of the leaderboard as Parquet: one per closed loop, and a second table of their times.

`benchmark-rows.parquet` holds what seed, options and versions decide, in the order of the grid: the
same command gives the same bytes, whatever the number of processes and however often it was
stopped. `benchmark-times.parquet` holds what the machine took. Each row carries its `sim.batch.Run`
as a line of JSON, so that it can be driven again without the grid it came from (`verify`).
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.errors import DataError
from lpvmpc.kit.files import write_table
from lpvmpc.kit.provenance import commit, machine, versions
from lpvmpc.leaderboard.grid import Cell, Plan, Row, run_of
from lpvmpc.sim.batch import KEPT, foundation

FORMAT = 1
"""Version of the files."""
ROWS, TIMES = "benchmark-rows.parquet", "benchmark-times.parquet"
"""Names of the files."""
NAMES = tuple(f.name for f in fields(Cell))
"""Columns that say what was driven; `grip` is NaN at a scenario's own speed."""
NUMBERS = (
    "s_end_m", "distance_m", "duration_s", "reference_duration_s", "lateral_rmse_m",
    "lateral_p95_m", "lateral_max_m", "heading_rmse_rad", "heading_max_rad", "course_rmse_rad",
    "speed_rmse_mps", "speed_max_mps", "lateral_acc_max_mps2", "left_road_s",
    "steer_rate_rms_radps", "drive_rate_rms_mps3", "jerk_rms_mps3", "estimate_ey_rmse_m",
)
"""Measured columns; NaN where a run has none."""
STEP_TIMES = ("mean", "p50", "p99", "max")
"""Columns of the times [us]."""


def write_rows(folder: str | os.PathLike[str], rows: Sequence[Row], plan: Plan) -> list[Path]:
    """Write both tables into an existing folder.

    Raises:
        OutputError: They cannot be written.
    """
    files = [Path(folder) / ROWS, Path(folder) / TIMES]
    facts = {"format": FORMAT, "plan": asdict(plan), "versions": versions(),
             "foundation": foundation(), "rivals": foundation(True)}
    names = _names(rows)
    measured: dict[str, Any] = {
        "completed": np.array([bool(row.result["completed"]) for row in rows]),
        "reason": _texts(row.result["reason"] for row in rows),
        **{key: _numbers(row.result[key] for row in rows) for key in NUMBERS},
        "qp_solved": _numbers((row.result["qp"] or {}).get("solved") for row in rows),
        "qp_fallback": _numbers((row.result["qp"] or {}).get("fallback") for row in rows),
        "trace_sha256": _texts(row.result["trace_sha256"] for row in rows),
        "run": _texts(run_of(row.cell, row.controller).text() for row in rows),
    }
    times: dict[str, Any] = {
        **{f"step_{key}_us": _numbers((row.result["step_time_us"] or {}).get(key) for row in rows)
           for key in STEP_TIMES},
        "steps": _numbers(row.result["steps"] for row in rows),
        "late_steps": _numbers(row.result["late_steps"] for row in rows),
        "wall_s": _numbers(row.result["wall_s"] for row in rows),
    }
    write_table(files[0], {**names, **measured}, facts)
    write_table(files[1], {**names, **times}, {**facts, "machine": machine(), "commit": commit()})
    return files


def _names(rows: Sequence[Row]) -> dict[str, Any]:
    """Columns that say what was driven, and by whom."""
    columns: dict[str, Any] = {}
    for name in NAMES:
        values = [getattr(row.cell, name) for row in rows]
        texts = name in ("part", "course", "scenario", "world")
        columns[name] = (
            _texts(values) if texts else np.array(values, dtype=np.int64) if name == "seed"
            else _numbers(values)
        )
    return {**columns, "controller": _texts(row.controller for row in rows)}


def _texts(values: Iterable[Any]) -> Any:
    return np.array(["" if value is None else str(value) for value in values], dtype=object)


def _numbers(values: Iterable[Any]) -> Any:
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)


def read_rows(
    file: str | os.PathLike[str],
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """The rows of a file, one dictionary each, and what it says of itself.

    Raises:
        DataError: The file is missing, damaged, or holds no rows of a leaderboard.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = os.fspath(file)
    try:
        table = pq.read_table(path)
    except (OSError, pa.ArrowException) as error:
        why = " ".join(str(error).split())[:120]
        raise DataError(f"Rows {path!r} cannot be read: {why}.") from error
    lacking = [name for name in ("run", "completed", "trace_sha256", *NUMBERS)
               if name not in table.column_names]
    if lacking:
        raise DataError(f"Rows {path!r} are not those of a benchmark: no column {lacking[0]!r}.")
    metadata: Mapping[bytes, bytes] = table.schema.metadata or {}
    try:
        facts = {key.decode(): json.loads(value) for key, value in metadata.items()}
    except (UnicodeDecodeError, ValueError) as error:
        raise DataError(f"Rows {path!r} have damaged metadata: {error}.") from error
    if facts.get("format") != FORMAT:
        raise DataError(
            f"Rows {path!r} have format {facts.get('format')!r}, but this version reads {FORMAT}."
        )
    return table.to_pylist(), facts


def sha256(file: str | os.PathLike[str]) -> str:
    """SHA-256 of a file: what a submitted result is known by."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


assert {*NUMBERS, "completed", "reason", "qp", "trace_sha256", "step_time_us"} <= set(KEPT)
