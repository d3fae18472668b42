"""The stiffness data: columns, labels, writing and reading; docs/dataset.md says it in prose.

One row per control instant of a manoeuvre, as Parquet. The slip angle of an axle is the mean of its
two wheels' after relaxation, weighted by their loads: the angle that makes the force, and the one
that the controller predicts. Its label is the secant stiffness, force over slip; where the slip is
too small to divide by, the slope of the tire law at zero slip.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from lpvmpc.car import tire
from lpvmpc.control.stiffness import network
from lpvmpc.errors import DataError
from lpvmpc.interface import State
from lpvmpc.kit.files import whole
from lpvmpc.learn.columns import COLUMNS, SHA256, Digest, checksum, what_is_wrong
from lpvmpc.plant import callbacks
from lpvmpc.plant.mjcf import tires
from lpvmpc.units import Array

if TYPE_CHECKING:
    import mujoco

    from lpvmpc.car.params import VehicleParams

FORMAT = "lpvmpc-stiffness-1"
"""Name and version of the file format, kept in the file's metadata."""
MOST_ROWS = 100_000_000
"""Most rows of a file."""

ALPHA_SMALL, ALPHA_LARGE = 0.004, 0.012
"""Below the first slip angle the label is the slope, above the second the secant [rad]."""


class Instant(NamedTuple):
    """What is kept of one control instant."""

    state: State
    """Motion at the instant."""
    outputs: Array
    """Forces and slips in the columns that callbacks.py names, one physics step earlier."""
    wind: float
    """Side wind from the car's left to its right [m/s]."""
    roll: float
    """Roll angle [rad]."""
    roll_rate: float
    """Roll rate [rad/s]."""
    drive: float
    """Drive or brake acceleration that reaches the wheels, before resistances [m/s2]."""


# Labels ------------------------------------------------------------------------------------------


def secant_stiffness(alpha: npt.ArrayLike, Fy: npt.ArrayLike, slope_zero: npt.ArrayLike) -> Array:
    """Label of an axle: secant stiffness, at small slip the slope, with a smooth passage.

    C = w Fy / alpha + (1 - w) slope_zero,   w = t^2 (3 - 2 t),
    t = (|alpha| - ALPHA_SMALL) / (ALPHA_LARGE - ALPHA_SMALL) within [0, 1]

    The slope at zero rather than the local one, since a secant falls from the first like
    1 - c alpha^2, but the local slope like 1 - 3 c alpha^2.

    Args:
        alpha: Slip angle of the axle [rad], shape (...,).
        Fy: Its lateral force [N], shape (...,).
        slope_zero: Slope of force over slip angle at slip angle zero [N/rad], shape (...,).

    Returns:
        C [N/rad], shape (...,); continuous, with its first derivative, in all arguments.
    """
    alpha, Fy = np.asarray(alpha, float), np.asarray(Fy, float)
    t = np.clip((np.abs(alpha) - ALPHA_SMALL) / (ALPHA_LARGE - ALPHA_SMALL), 0.0, 1.0)
    w = t * t * (3.0 - 2.0 * t)
    return w * Fy / np.where(w > 0.0, alpha, 1.0) + (1.0 - w) * np.asarray(slope_zero, float)


@njit(cache=True)
def _slope(rubber, ratio, alpha, Fz, friction):
    """Slope of a tire's lateral force over its slip angle [N/rad].

    Central difference of the tire law; a step of 1e-4 is exact to 1e-5 of the slope.
    """
    h = 1e-4
    high = tire.forces(rubber, ratio, math.tan(alpha + h), Fz, friction)[1]
    low = tire.forces(rubber, ratio, math.tan(alpha - h), Fz, friction)[1]
    return (high - low) / (2.0 * h)


@njit(cache=True)
def _slopes(axles, outputs, friction, local, at_zero):
    """Slopes of each axle's lateral force over a slip angle that both wheels share, in place."""
    for k in range(outputs.shape[0]):
        for axle in range(2):
            local[k, axle] = at_zero[k, axle] = 0.0
            for wheel in range(2 * axle, 2 * axle + 2):
                Fz = outputs[k, callbacks.FZ + wheel]
                ratio = outputs[k, callbacks.SLIP_RATIO + wheel]
                alpha = outputs[k, callbacks.SLIP_ANGLE + wheel]
                local[k, axle] += _slope(axles[axle], ratio, alpha, Fz, friction)
                at_zero[k, axle] += _slope(axles[axle], ratio, 0.0, Fz, friction)


def table_of(
    rows: Sequence[Instant], run: int, kind: str, *, model: mujoco.MjModel, friction: float,
    mass: float, Ts: float,
) -> dict[str, npt.NDArray[Any]]:
    """Columns of one run.

    Args:
        rows: What was recorded, at least one row.
        run: Number of the run.
        kind: Kind of manoeuvre.
        model: The car, for the law and the coefficients of its tires.
        friction: Scale of the road's peak friction.
        mass: Mass of the car [kg].
        Ts: Control period [s].

    Returns:
        One array of shape (n,) per name of `COLUMNS`.
    """
    n = len(rows)
    o = np.array([row.outputs for row in rows])
    states = [row.state for row in rows]
    slope, slope_zero = np.empty((n, 2)), np.empty((n, 2))
    _slopes(tires(model), o, friction, slope, slope_zero)

    def axle(first: int, i: int) -> Array:
        return o[:, first + 2 * i] + o[:, first + 2 * i + 1]

    Fy = [axle(callbacks.FY, i) for i in range(2)]
    Fz = o[:, callbacks.FZ : callbacks.FZ + 4]
    moment = o[:, callbacks.SLIP_ANGLE : callbacks.SLIP_ANGLE + 4] * Fz
    alpha = [moment[:, i : i + 2].sum(axis=1) / Fz[:, i : i + 2].sum(axis=1) for i in (0, 2)]
    mu = o[:, callbacks.MU : callbacks.MU + 4]
    values: dict[str, Any] = {
        "run": np.full(n, run, dtype=np.int32),
        "manoeuvre": np.full(n, kind),
        "t_s": np.arange(n) * Ts,
        "vx_mps": [s.vx for s in states],
        "vy_mps": [s.vy for s in states],
        "delta_rad": [s.delta for s in states],
        "ax_mps2": [s.ax for s in states],
        "r_radps": [s.r for s in states],
        "Cf_Nprad": secant_stiffness(alpha[0], Fy[0], slope_zero[:, 0]),
        "Cr_Nprad": secant_stiffness(alpha[1], Fy[1], slope_zero[:, 1]),
        "Fyf_N": Fy[0],
        "Fyr_N": Fy[1],
        "alpha_f_rad": alpha[0],
        "alpha_r_rad": alpha[1],
        "Fzf_N": axle(callbacks.FZ, 0),
        "Fzr_N": axle(callbacks.FZ, 1),
        "mu": (mu * Fz).sum(axis=1) / Fz.sum(axis=1),
        "wind_mps": [row.wind for row in rows],
        "ay_mps2": [s.ay for s in states],
        "Fxf_N": axle(callbacks.FX, 0),
        "Fxr_N": axle(callbacks.FX, 1),
        "slope_f_Nprad": slope[:, 0],
        "slope_r_Nprad": slope[:, 1],
        "slope_zero_f_Nprad": slope_zero[:, 0],
        "slope_zero_r_Nprad": slope_zero[:, 1],
        "alpha_kin_f_rad": o[:, callbacks.ALPHA_F],
        "alpha_kin_r_rad": o[:, callbacks.ALPHA_R],
        "drive_mps2": [row.drive for row in rows],
        "roll_rad": [row.roll for row in rows],
        "roll_rate_radps": [row.roll_rate for row in rows],
        "friction": np.full(n, friction),
        "mass_kg": np.full(n, mass),
    }
    return {name: np.asarray(values[name]) for name in COLUMNS}


# Files -------------------------------------------------------------------------------------------


def schema() -> Any:
    """Arrow schema of the columns."""
    import pyarrow as pa

    kinds = {"run": pa.int32(), "manoeuvre": pa.string()}
    return pa.schema([(name, kinds.get(name, pa.float64())) for name in COLUMNS])


def metadata(facts: dict[str, Any]) -> dict[str, str]:
    """Metadata of a file: format, meaning of the columns, and the given facts, as JSON."""
    facts = {**facts, "format": FORMAT, "columns": COLUMNS}
    return {key: json.dumps(facts[key], sort_keys=True) for key in sorted(facts)}


@dataclass(frozen=True)
class Dataset:
    """Stiffness data in memory."""

    columns: dict[str, npt.NDArray[Any]]
    """Arrays of shape (n,) by the names of `COLUMNS`, and perhaps more."""
    meta: dict[str, Any]
    """Metadata of the file: seed, options, versions, hashes."""
    sha256: str
    """Hash of the file's bytes."""
    checked: bool = True
    """Whether the file has a checksum, which fits; False for one written without."""

    def __len__(self) -> int:
        return len(self.columns["run"])

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        return self.columns[name]

    @property
    def kinds(self) -> list[str]:
        """Kinds of manoeuvres in the data, sorted."""
        return sorted(set(self.columns["manoeuvre"]))


def read(file: str | os.PathLike[str]) -> Dataset:
    """Read and check a data file.

    Raises:
        DataError: It is missing, damaged, of another format, lacks columns, or holds what no car
            does.
    """
    path = Path(file)
    with _open(path) as parquet:
        meta = read_metadata(path, parquet)
        with _damaged(path):
            table = parquet.read(columns=list(COLUMNS))
            columns = _arrays(table)
    if not len(columns["run"]):
        raise DataError(f"The data in {str(path)!r} have no rows.")
    told = meta.pop(SHA256, None)
    if told is not None and told != checksum(columns, meta):
        raise DataError(f"The data in {str(path)!r} are damaged: their checksum is another.")
    if wrong := what_is_wrong(columns):
        raise DataError(f"The data in {str(path)!r} hold {wrong}.")
    columns["manoeuvre"] = columns["manoeuvre"].astype(str)
    return Dataset(columns, meta, file_sha256(path), checked=told is not None)


def read_metadata(path: Path, parquet: Any = None) -> dict[str, Any]:
    """Metadata of a data file, after checking its format and columns.

    Raises:
        DataError: It is missing, damaged, or of another format.
    """
    if parquet is None:
        with _open(path) as opened:
            return read_metadata(path, opened)
    with _damaged(path):
        raw = parquet.metadata.metadata or {}
        found = parquet.schema_arrow
    try:
        meta = {k.decode(): json.loads(v) for k, v in raw.items() if not k.startswith(b"ARROW")}
    except (ValueError, RecursionError) as error:
        raise DataError(f"{str(path)!r} has metadata that are not JSON.") from error
    if meta.get("format") != FORMAT:
        raise DataError(
            f"{str(path)!r} has the format {repr(meta.get('format'))[:40]}, but must have "
            f"{FORMAT!r}; data_gen/collect.py makes it anew."
        )
    for field in schema():
        count = found.names.count(field.name)
        if count != 1:
            raise DataError(f"{str(path)!r} lacks the column {field.name}." if not count else
                            f"{str(path)!r} has the column {field.name} {count} times.")
        if found.field(field.name).type != field.type:
            raise DataError(
                f"Column {field.name} of {str(path)!r} is of type {found.field(field.name).type}, "
                f"but must be {field.type}."
            )
    if parquet.metadata.num_rows > MOST_ROWS:
        raise DataError(f"{str(path)!r} has {parquet.metadata.num_rows} rows, but may have at most "
                        f"{MOST_ROWS}.")
    return meta


def _open(path: Path) -> Any:
    import pyarrow.parquet as pq

    if not os.path.isfile(path):
        kind = ": it is no ordinary file" if os.path.exists(path) else ""
        raise DataError(
            f"There is no data file {str(path)!r}{kind}; data_gen/collect.py makes one."
        )
    try:
        # by default pyarrow keeps all of a file that it reads in batches
        return pq.ParquetFile(path, pre_buffer=False)
    except Exception as error:  # a damaged file may end anywhere in the library
        raise DataError(f"{str(path)!r} is damaged or no Parquet file: {_first(error)}.") from error


@contextmanager
def _damaged(path: Path) -> Iterator[None]:
    """Say that a file is damaged where the library cannot read it."""
    try:
        yield
    except Exception as error:
        raise DataError(f"The data in {str(path)!r} are damaged: {_first(error)}.") from error


def _arrays(table: Any) -> dict[str, npt.NDArray[Any]]:
    """The columns of a table or a batch of one."""
    for name in COLUMNS:
        if table.column(name).null_count:
            raise ValueError(f"column {name} has rows without a value")
    return {name: table.column(name).to_numpy(zero_copy_only=False) for name in COLUMNS}


def _first(error: Exception) -> str:
    """First line of a library's message, without a full stop."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")


def batches(path: Path, rows: int = 16384) -> Iterator[dict[str, npt.NDArray[Any]]]:
    """The columns of a data file in pieces, so that memory stays flat.

    Raises:
        DataError: As `read`; that the checksum does not fit is known after the last piece.
    """
    digest = Digest()
    with _open(path) as parquet:
        meta = read_metadata(path, parquet)
        pieces = parquet.iter_batches(rows, columns=list(COLUMNS))
        while True:
            with _damaged(path):
                batch = next(pieces, None)
                if batch is None:
                    break
                piece = _arrays(batch)
            digest.add(piece)
            if wrong := what_is_wrong(piece):
                raise DataError(f"The data in {str(path)!r} hold {wrong}.")
            yield piece
    if SHA256 in meta and meta[SHA256] != digest.hexdigest(meta):
        raise DataError(f"The data in {str(path)!r} are damaged: their checksum is another.")


def write(
    file: str | os.PathLike[str], columns: dict[str, npt.NDArray[Any]], facts: dict[str, Any]
) -> None:
    """Write data, whole or not at all, with their checksum.

    Args:
        file: The Parquet file.
        columns: Arrays of shape (n,), all of `COLUMNS`.
        facts: What the file says about itself, as JSON can hold it.

    Raises:
        OutputError: It cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    fields = schema()
    table = pa.table([pa.array(columns[f.name], type=f.type) for f in fields], schema=fields)
    texts = metadata(facts)
    told = {key: json.loads(text) for key, text in texts.items()}
    texts[SHA256] = json.dumps(checksum(_arrays(table), told))
    with whole(file) as part:
        pq.write_table(
            table.replace_schema_metadata(texts), part, compression="zstd", write_statistics=False
        )


def file_sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def samples_of(data: Dataset, car: VehicleParams) -> dict[str, Array]:
    """Arguments of `network.forces_of` from the data."""
    masses, index = np.unique(data["mass_kg"], return_inverse=True)
    norms = np.array([network.normalisation(car, m) for m in masses])[index]
    return {
        "alpha": np.column_stack([data["alpha_f_rad"], data["alpha_r_rad"]]),
        "Fx": np.column_stack([data["Fxf_N"], data["Fxr_N"]]),
        "ax": data["ax_mps2"],
        "roll": car.K_phi * data["roll_rad"] + car.C_phi * data["roll_rate_radps"],
        "friction": data["friction"],
        "norms": norms,
    }
