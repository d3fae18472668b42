"""Reading the tire coefficients of .tir property files (MF5.2, PAC2002)."""

import math
import re
from pathlib import Path

from lpvmpc.car.magic_formula import COEFFICIENTS, coefficients
from lpvmpc.errors import DataError
from lpvmpc.kit.files import read_bytes
from lpvmpc.units import Array

_NAMES_IN_FILE = {
    "R0": "UNLOADED_RADIUS",
    "KZ": "VERTICAL_STIFFNESS",
    "CZ": "VERTICAL_DAMPING",
}
_SCALED_BY = {
    "FNOMIN": ("LFZO",),
    "KZ": ("LCZ",),
    **{name: ("LMUX",) for name in ("PDX1", "PDX2")},
    **{name: ("LMUY",) for name in ("PDY1", "PDY2")},
    **{name: ("LEX",) for name in ("PEX1", "PEX2")},
    **{name: ("LEY",) for name in ("PEY1", "PEY2")},
    **{name: ("LKX",) for name in ("PKX1", "PKX2")},
    "PCX1": ("LCX",),
    "PCY1": ("LCY",),
    "PKY1": ("LKY",),
    "RBX1": ("LXAL",),
    "RBY1": ("LYKA",),
    **{name: ("LSGKP",) for name in ("PTX1", "PTX2")},
    "PTY1": ("LSGAL",),
    "QDZ1": ("LTR",),
}
"""User scaling factors; those not in the file are 1."""
_OPTIONAL = {"CZ": 0.0, "QSY1": 0.0}
_SI = {"LENGTH": "meter", "FORCE": "newton", "ANGLE": "radians", "MASS": "kg", "TIME": "second"}


def read_tir(path: str | Path) -> Array:
    """Coefficients of the symmetric tire in a .tir file, for `lpvmpc.car.magic_formula`.

    Shifts, camber, turn slip and pressure terms are left out, since this package's tire has none;
    PKY1 is taken positive (the file's sign is that of ISO 8855). User scaling factors are applied.

    Args:
        path: property file in SI units.

    Returns:
        Read-only array in the order of its `COEFFICIENTS`.

    Raises:
        DataError: the file cannot be read, is not in SI units, lacks a coefficient, or gives one
            that is no finite number.
    """
    try:
        text = read_bytes(path).decode("utf-8", errors="replace")
    except OSError as error:
        why = error.strerror or str(error)
        raise DataError(f"{path} cannot be read: {why}.") from None
    units, entries = _entries(text)
    for quantity, unit in _SI.items():
        given = units.get(quantity, unit)
        if given.rstrip("s") != unit.rstrip("s"):
            raise DataError(
                f"{path} gives {quantity} in {given[:40]!r}, but must give it in {unit}."
            )
    values, missing = {}, []
    for name in COEFFICIENTS:
        key = _NAMES_IN_FILE.get(name, name)
        if key in entries:
            values[name] = _number(path, key, entries[key])
            for factor in _SCALED_BY.get(name, ()):
                values[name] *= _number(path, factor, entries.get(factor, "1"))
        elif name in _OPTIONAL:
            values[name] = _OPTIONAL[name]
        else:
            missing.append(key)
    if missing:
        raise DataError(f"{path} lacks the tire coefficients {', '.join(missing)}.")
    values["PKY1"] = abs(values["PKY1"])
    return coefficients(values)


def _entries(text: str) -> tuple[dict[str, str], dict[str, str]]:
    """KEY = value of the section [UNITS], and of all others; a $ or ! begins a comment.

    They are kept apart because MASS is a unit in the one and the tire's mass in [INERTIA].
    """
    units: dict[str, str] = {}
    values: dict[str, str] = {}
    section = values
    for line in text.splitlines():
        line = re.split(r"[$!]", line, maxsplit=1)[0].strip()
        if line.startswith("["):
            section = units if line[1:].partition("]")[0].strip().upper() == "UNITS" else values
        key, equals, value = line.partition("=")
        if equals:
            section[key.strip().upper()] = value.strip().strip("'\"").lower()
    return units, values


def _number(path: str | Path, key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise DataError(f"{path} gives {key} as {value[:40]!r}, but must give a finite number.")
    return number
