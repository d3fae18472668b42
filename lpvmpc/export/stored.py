"""A run as it lies in its folder, read back as the log that it was.

`lpvmpc track` leaves metrics.json, trace.parquet and timing.parquet. Together they hold all that a
log does but for the road, which is made again from the options and compared with the trace.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import DataError, LPVMPCError
from lpvmpc.kit.files import read_json
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.road.scenario import Scenario
from lpvmpc.sim.log import MOTION, Log
from lpvmpc.sim.names import load_scenario
from lpvmpc.traffic.detour import detour
from lpvmpc.traffic.users import Traffic, load_traffic
from lpvmpc.traffic.watch import users_of

ROAD = ("v_max", "ay_max", "grip", "closed", "smoothing", "wind_scale", "friction")
"""Options of a run that make its scenario."""
APART = 1e-3
"""Furthest that the road may lie from the one that was driven [m]: rounding of other versions."""


def read_run(folder: str | os.PathLike[str]) -> tuple[Log, dict[str, Any]]:
    """A run of `lpvmpc track`.

    Args:
        folder: The run's folder, as runs/paper-lpv-mpc.

    Returns:
        The log, and the content of metrics.json: the metrics, and the run's `record`.

    Raises:
        DataError: There is no run, one of its files is damaged, or its road is not there any more.
    """
    path = Path(folder)
    try:
        result = read_json(path / "metrics.json")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise DataError(f"{os.fspath(folder)!r} holds no run of `lpvmpc track`: metrics.json: "
                        f"{why}.") from error
    columns, facts = _table(path / "trace.parquet")
    timing, _ = _table(path / "timing.parquet")
    lacking = [name for name in MOTION[:-1] if name not in columns]
    lacking += [f"timing {name}" for name in ("t_s", "step_us", "solve_us") if name not in timing]
    if lacking:
        raise DataError(f"{os.fspath(path)!r} holds no whole run: it has no {', '.join(lacking)}.")
    try:
        record, versions = result["record"], result["versions"]
        options = {**record["options"], **facts["options"]}
        known = {"clamped_inputs": record["clamped_inputs"], "Ts": facts["Ts"], "options": options}
        name, weights = str(options["scenario"]), dict(record["weights"])
        kept = ("scenario", "controller", "stiffness", "seed", "completed", "reason", "world",
                "estimator", "duration_s", "reference_duration_s", "lap_times_s")
        meta = {**{key: result[key] for key in kept}, **known, "versions": versions}
    except (KeyError, TypeError) as error:
        raise DataError(f"{os.fspath(path)!r} holds no whole run: metrics.json and trace.parquet "
                        f"lack {error}.") from error
    if record.get("footprint_m"):
        meta["footprint_m"] = record["footprint_m"]
    scenario, traffic = _road(name, options, columns)
    log = Log(columns, timing, meta, scenario, weights)
    if traffic is not None:
        log.meta["traffic"], log.road = users_of(traffic), traffic.path
    return log, result


def _table(file: Path) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Columns and metadata of a Parquet file.

    Raises:
        DataError: It cannot be read.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(file)
        metadata = table.schema.metadata or {}
        facts = {key.decode(): json.loads(value) for key, value in metadata.items()}
    except (OSError, pa.ArrowException, ValueError) as error:
        why = str(error).partition("\n")[0] or "it cannot be read"
        raise DataError(f"{os.fspath(file)!r} is no table of a run: {why}") from error
    return {name: table[name].to_numpy() for name in table.column_names}, facts


def _road(
    name: str, options: Mapping[str, Any], columns: Mapping[str, Any]
) -> tuple[Scenario, Traffic | None]:
    """The scenario that was driven, and its traffic.

    Raises:
        DataError: It is not there any more, or has changed since.
    """
    given = {key: options[key] for key in ROAD if options.get(key) is not None}
    try:
        scenario, traffic = load_scenario(name, **given), None
        if options.get("traffic") is not None:
            traffic = load_traffic(str(options["traffic"]), scenario)
            if options.get("detour"):
                scenario = detour(scenario, traffic, packaged_car())
    except LPVMPCError as error:
        raise DataError(f"The road of this run cannot be made again. {error}") from error
    x, y = scenario.path.at(columns["s_m"])[:2]
    apart = np.hypot(x - columns["x_ref_m"], y - columns["y_ref_m"])
    if not np.nanmax(apart, initial=0.0) < APART:
        raise DataError(f"The road {name!r} is another one than the run's: it lies up to "
                        f"{np.nanmax(apart):.3g} m apart.")
    return scenario, traffic
