"""Track files: the CSV format of a road with its widths, speed and wind."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from lpvmpc.errors import PathError
from lpvmpc.units import Array

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m", "vx_mps", "wind_mps")
"""Columns of the format, in its order; the first two are needed."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """What a track file says, point by point."""

    xy: Array
    """Points of the centre line [m], shape (k, 2)."""
    width_right: Array | None = None
    """Distance to the right road edge [m], shape (k,)."""
    width_left: Array | None = None
    """Distance to the left road edge [m], shape (k,)."""
    vx: Array | None = None
    """Reference speed [m/s], shape (k,)."""
    wind: Array | None = None
    """Wind speed from left to right [m/s], shape (k,)."""


def read_csv(file: str | FilePath) -> Track:
    """Read a track file: `# x_m,y_m,w_tr_right_m,w_tr_left_m[,vx_mps][,wind_mps]`.

    The header names the columns, in any order; without a header the first columns are those of the
    format, in its order. Widths may be missing.

    Raises:
        PathError: With one sentence that names the file, the line and what is wrong.
    """
    file = FilePath(file)
    if file.is_dir():
        raise PathError(f"The track file {file} is a directory.")
    if not file.exists():
        raise PathError(f"The track file {file} does not exist.")
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise PathError(f"The track file {file} is not a text file.") from None
    except OSError as error:
        raise PathError(f"The track file {file} cannot be read: {error.strerror}.") from None
    names: list[str] | None = None
    rows: list[list[float]] = []
    for number, text in enumerate((line.strip() for line in lines), start=1):
        words = [word.strip() for word in text.lstrip("#").split(",")]
        if text.startswith("#") or (not rows and names is None and "x_m" in words):
            names = words if names is None and "x_m" in words else names
        elif text:
            rows.append(_numbers(words, f"Line {number} of {file}"))
            if len(rows[-1]) != len(rows[0]):
                raise PathError(
                    f"Line {number} of {file} has {len(rows[-1])} columns, but the first row of "
                    f"numbers has {len(rows[0])}."
                )
    if not rows:
        raise PathError(f"The track file {file} holds no points.")
    width = len(rows[0])
    if width < 2:
        raise PathError(f"The track file {file} has one column, but needs x_m and y_m.")
    if names is None:
        names = list(COLUMNS[:width])
    if len(names) != width or "y_m" not in names or len(set(names)) != width:
        raise PathError(
            f"The track file {file} has {width} columns of numbers, but its header says "
            f"{','.join(names)!r}; it must name each column once, x_m and y_m among them."
        )
    table = dict(zip(names, np.array(rows).T, strict=True))
    _check_track(table, file)
    return Track(
        xy=np.column_stack([table["x_m"], table["y_m"]]),
        width_right=table.get("w_tr_right_m"),
        width_left=table.get("w_tr_left_m"),
        vx=table.get("vx_mps"),
        wind=table.get("wind_mps"),
    )


def _numbers(words: list[str], where: str) -> list[float]:
    """The numbers of one line, all finite."""
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        bad = str(error).rpartition(": ")[2]
        raise PathError(f"{where} holds {bad}, which is not a number.") from None
    if not all(math.isfinite(value) for value in values):
        raise PathError(f"{where} holds NaN or infinity, but all numbers must be finite.")
    return values


def _check_track(table: dict[str, Array], file: FilePath) -> None:
    """Refuse widths, speeds and winds that no road has."""
    for name, low, high in (
        ("w_tr_right_m", 0.0, 100.0),
        ("w_tr_left_m", 0.0, 100.0),
        ("vx_mps", 1.0, 60.0),
        ("wind_mps", -100.0, 100.0),
    ):
        column = table.get(name)
        if column is not None and not (low <= column.min() and column.max() <= high):
            raise PathError(
                f"Column {name} of {file} goes from {column.min():g} to {column.max():g}, but must "
                f"stay within {low:g} and {high:g}."
            )
