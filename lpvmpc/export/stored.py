"""A run as it lies in its folder, read back as the log that it was.

`lpvmpc track` leaves metrics.json, trace.parquet and timing.parquet. Together they hold all that a
log does but for the road, which is made again from the options and compared with the trace.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import DataError, LPVMPCError
from lpvmpc.kit.files import checksum, read_bytes, read_json
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.road.scenario import Scenario
from lpvmpc.sim.log import MOTION, Log
from lpvmpc.sim.metrics import KEYS
from lpvmpc.sim.names import load_scenario
from lpvmpc.traffic.detour import detour
from lpvmpc.traffic.users import Traffic, load_traffic
from lpvmpc.traffic.watch import users_of

ROAD = ("v_max", "ay_max", "grip", "closed", "smoothing", "wind_scale", "friction")
"""Options of a run that make its scenario."""
APART = 1e-3
"""Furthest that the road may lie from the one that was driven [m]: rounding of other versions."""
TABLES = ("trace.parquet", "timing.parquet")
"""The tables of a run."""
LARGEST = 2**30
"""Most bytes of one of them: an hour of driving takes a tenth."""
TEXTS = "scenario", "controller", "reason", "model_sha256"
GROUPS = ("step_time_us", "qp", "world", "versions")
"""Metrics that are a text, and those that are several under a name; others are numbers."""


def sealed(content: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """What metrics.json is to hold, with checksums in its record: its own, and the tables'.

    Args:
        content: The metrics and the run's `record`.
        folder: Where the tables lie.
    """
    tables = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in TABLES}
    # as it will be read: tuples are lists there
    plain = json.loads(json.dumps(content))
    return {**content, "record": {**content["record"],
                                  "sha256": {**tables, "metrics.json": checksum(plain)}}}


def read_run(folder: str | os.PathLike[str]) -> tuple[Log, dict[str, Any]]:
    """A run of `lpvmpc track`.

    Args:
        folder: The run's folder, as runs/paper-lpv-mpc.

    Returns:
        The log, and the content of metrics.json: the metrics, and the run's `record`.

    Raises:
        DataError: There is no run, one of its files is damaged (see `sealed`), or its
            road is not there any more.
    """
    path = Path(folder)
    try:
        result = read_json(path / "metrics.json")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise DataError(f"{os.fspath(folder)!r} holds no run of `lpvmpc track`: metrics.json: "
                        f"{why}.") from error
    kept = _checksums(result, path)
    (columns, facts), (timing, _) = (_table(path / name, kept.get(name)) for name in TABLES)
    lacking = [name for name in MOTION[:-1] if name not in columns]
    lacking += [f"timing {name}" for name in ("t_s", "step_us", "solve_us") if name not in timing]
    if lacking:
        raise DataError(f"{os.fspath(path)!r} holds no whole run: it has no {', '.join(lacking)}.")
    _check_columns(path, columns, timing)
    try:
        record, versions = result["record"], result["versions"]
        options = {**record["options"], **facts["options"]}
        known = {"clamped_inputs": record["clamped_inputs"], "Ts": facts["Ts"], "options": options}
        name, weights = str(options["scenario"]), dict(record["weights"])
        told = ("scenario", "controller", "stiffness", "seed", "completed", "reason", "world",
                "estimator", "duration_s", "reference_duration_s", "lap_times_s")
        meta = {**{key: result[key] for key in told}, **known, "versions": versions}
    except (KeyError, TypeError, ValueError) as error:
        what = str(error) if isinstance(error, KeyError) else "what a run is"
        raise DataError(f"{os.fspath(path)!r} holds no whole run: metrics.json and trace.parquet "
                        f"lack {what}.") from error
    _check_facts(path, result, meta)
    if record.get("footprint_m"):
        meta["footprint_m"] = record["footprint_m"]
    scenario, traffic = _road(name, options, columns)
    log = Log(columns, timing, meta, scenario, weights)
    if traffic is not None:
        log.meta["traffic"], log.road = users_of(traffic), traffic.path
    return log, result


def _checksums(result: Any, path: Path) -> dict[str, str]:
    """The tables' checksums, where the run has some; a warning where not.

    Raises:
        DataError: metrics.json has another checksum than its own, or no record.
    """
    record = result.get("record") if isinstance(result, dict) else None
    if not isinstance(record, dict):
        raise DataError(f"{os.fspath(path)!r} holds no whole run: metrics.json has no record.")
    found = record.get("sha256")
    if not isinstance(found, dict):
        warnings.warn(f"The run in {os.fspath(path)!r} has no checksums: damage may go unseen.",
                      stacklevel=2)
        return {}
    bare = {**result, "record": {k: v for k, v in record.items() if k != "sha256"}}
    if found.get("metrics.json") != checksum(bare):
        raise DataError(f"{os.fspath(path / 'metrics.json')!r} is damaged or was edited: its "
                        "checksum is another one.")
    return {name: str(found.get(name)) for name in TABLES}


def _table(
    file: Path, sha256: str | None
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Columns and metadata of a Parquet file.

    Args:
        file: The file.
        sha256: Its checksum; None where nobody knows it.

    Raises:
        DataError: It cannot be read, or has another checksum.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        raw = read_bytes(file, LARGEST)
        if sha256 is not None and hashlib.sha256(raw).hexdigest() != sha256:
            raise DataError(f"{os.fspath(file)!r} is damaged: its checksum is another one.")
        table = pq.read_table(io.BytesIO(raw))
        metadata = table.schema.metadata or {}
        facts = {key.decode(): json.loads(value) for key, value in metadata.items()}
        names = table.column_names
        if len(set(names)) < len(names):
            raise ValueError("it has a column twice")
        return {name: table[name].to_numpy() for name in names}, facts
    except (OSError, pa.ArrowException, ValueError) as error:
        if isinstance(error, DataError):
            raise
        why = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        why = (why or "it cannot be read").rstrip(".")
        raise DataError(f"{os.fspath(file)!r} is no table of a run: {why}.") from error


def _check_columns(path: Path, *tables: Mapping[str, npt.NDArray[Any]]) -> None:
    """Refuse what is no number, and a motion or a time that is infinite or NaN.

    Raises:
        DataError: Which column it is.
    """
    for table in tables:
        for name, values in table.items():
            number = values.dtype.kind in "biuf"
            if not number or (name in (*MOTION[:-1], "t_s") and not np.isfinite(values).all()):
                raise DataError(f"{os.fspath(path)!r} holds no whole run: its column {name!r} has "
                                "what is no number.")


def _check_facts(path: Path, result: Mapping[str, Any], meta: Mapping[str, Any]) -> None:
    """Refuse what pages and layouts could not print.

    Raises:
        DataError: Which of the metrics it is.
    """
    flat = {name: result.get(name) for name in KEYS if name not in (*TEXTS, *GROUPS)}
    laps, estimator, stiffness = (
        flat.pop(name, None) for name in ("lap_times_s", "estimator", "stiffness"))
    wrong = [name for name, value in flat.items() if not (value is None or _number(value))]
    wrong += [name for name in TEXTS if not isinstance(result.get(name), str)]
    wrong += [name for name in GROUPS if not isinstance(result.get(name), dict | None)]
    wrong += [name for name in ("duration_s", "reference_duration_s", "completed")
              if meta[name] is None]
    wrong += [] if all(isinstance(one, str | None) for one in (estimator, stiffness)) else [
        "estimator or stiffness"]
    wrong += [] if isinstance(laps, list) and all(map(_number, laps)) else ["lap_times_s"]
    wrong += [] if _number(meta["Ts"]) and meta["Ts"] > 0.0 else ["Ts"]
    if wrong:
        raise DataError(f"{os.fspath(path)!r} holds no whole run: what it has for "
                        f"{', '.join(wrong)} is of the wrong kind.")


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


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
