"""Track files: a road with its widths, speed and wind as a table of text, and race lines."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from lpvmpc.errors import PathError
from lpvmpc.kit.files import MOST, read_bytes
from lpvmpc.units import Array

COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m", "vx_mps", "wind_mps")
"""Columns of the format, in its order; the first two are needed."""
ALIASES = {
    "x": "x_m",
    "y": "y_m",
    "width_right": "w_tr_right_m",
    "width_left": "w_tr_left_m",
    "w_tr_right": "w_tr_right_m",
    "w_tr_left": "w_tr_left_m",
}
"""Other names that are read. What is named in neither is ignored: the s_m, psi_rad,
kappa_radpm and ax_mps2 of a race line follow from its points and speeds."""
SLOWEST = 0.1
"""Slowest reference speed between the ends [m/s]."""
FASTEST = 60.0
"""Fastest reference speed [m/s]."""
LARGEST = 64 * MOST
"""Largest file that is read [bytes]: a million points."""
SHOWN = 40
"""Most characters of a file's line that a sentence repeats."""


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
    lines: tuple[int, ...] = ()
    """Line of the file on which each point stands, from 1."""


def read_csv(file: str | FilePath) -> Track:
    """Read a track file: `# x_m,y_m,w_tr_right_m,w_tr_left_m[,vx_mps][,wind_mps]`.

    A race line `s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2` is read as well. The header
    names the columns, in any order, with or without its #; a file without one may hold x and y
    alone. Columns are separated by semicolons, tabs or commas. Widths may be missing.

    Raises:
        PathError: With one sentence that names the file, the line and what is wrong.
    """
    file = FilePath(file)
    names: list[str] | None = None
    separator = ","
    rows: list[list[float]] = []
    numbers: list[int] = []
    for number, text in enumerate((line.strip() for line in _lines(file)), start=1):
        if not text:
            continue
        if not rows:
            separator = next((mark for mark in ";\t" if mark in text), ",")
        words = [word.strip() for word in text.lstrip("#").split(separator)]
        known = [ALIASES.get(word.lower(), word) for word in words]
        if text.startswith("#") or (not rows and names is None and "x_m" in known):
            names = known if names is None and "x_m" in known else names
            continue
        rows.append(_numbers(words, f"Line {number} of {file}"))
        numbers.append(number)
        if len(rows[-1]) != len(rows[0]):
            raise PathError(
                f"Line {number} of {file} has {len(rows[-1])} columns, but the first row of "
                f"numbers has {len(rows[0])}."
            )
    if not rows:
        raise PathError(f"The track file {file} holds no points.")
    table = dict(zip(_names(names, len(rows[0]), file), np.array(rows).T, strict=True))
    _check_track(table, numbers, file)
    return Track(
        xy=np.column_stack([table["x_m"], table["y_m"]]),
        width_right=table.get("w_tr_right_m"),
        width_left=table.get("w_tr_left_m"),
        vx=table.get("vx_mps"),
        wind=table.get("wind_mps"),
        lines=tuple(numbers),
    )


def _lines(file: FilePath) -> list[str]:
    """The lines of a text file."""
    try:
        return read_bytes(file, LARGEST).decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        raise PathError(f"The track file {file} does not exist.") from None
    except UnicodeDecodeError:
        raise PathError(f"The track file {file} is not a text file.") from None
    except OSError as error:
        why = error.strerror or str(error)
        raise PathError(f"The track file {file} cannot be read: {why}.") from None


def _names(names: list[str] | None, width: int, file: FilePath) -> list[str]:
    """Names of the columns, of which there are `width`."""
    if width < 2:
        raise PathError(f"The track file {file} has one column, but needs x_m and y_m.")
    if names is None:
        if width > 2:
            raise PathError(
                f"The track file {file} has {width} columns of numbers and no header that names "
                f"them; its first line must be like '# {','.join(COLUMNS[:4])}' (only a file of "
                "two columns, x and y, needs none)."
            )
        return list(COLUMNS[:2])
    if len(names) != width or "y_m" not in names or len(set(names)) != width:
        raise PathError(
            f"The track file {file} has {width} columns of numbers, but its header says "
            f"{_short(','.join(names))!r}; it must name each column once, x_m and y_m among them."
        )
    return names


def _numbers(words: list[str], where: str) -> list[float]:
    """The numbers of one line, all finite."""
    bad = next((word for word in words if not _is_number(word)), None)
    if bad is not None:
        raise PathError(f"{where} holds {_short(bad)!r}, which is not a number.")
    values = [float(word) for word in words]
    if not all(math.isfinite(value) for value in values):
        raise PathError(f"{where} holds NaN or infinity, but all numbers must be finite.")
    return values


def _is_number(word: str) -> bool:
    if "_" in word or not word.isascii():  # Python would read 1_0 as ten
        return False
    try:
        float(word)
    except ValueError:
        return False
    return True


def _short(text: str) -> str:
    """The beginning of a text that may have any length."""
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


def _check_track(table: dict[str, Array], lines: list[int], file: FilePath) -> None:
    """Refuse widths, speeds and winds that no road has; the sentence names the row."""
    for name, low, high, unit in (
        ("w_tr_right_m", 0.0, 100.0, "m"),
        ("w_tr_left_m", 0.0, 100.0, "m"),
        ("vx_mps", SLOWEST, FASTEST, "m/s"),
        ("wind_mps", -100.0, 100.0, "m/s"),
    ):
        column = table.get(name)
        if column is None:
            continue
        bad = ~((low <= column) & (column <= high))
        allowed = f"from {low:g} to {high:g} {unit}"
        if name == "vx_mps":  # a car may start from rest, and stop where the road ends
            bad[[0, -1]] &= column[[0, -1]] != 0.0
            allowed += ", or 0 in the first and the last row"
        if bad.any():
            i = int(np.argmax(bad))
            raise PathError(
                f"{name} is {column[i]:g} in row {i + 1} (line {lines[i]}) of {file}, but must be "
                f"{allowed}."
            )
