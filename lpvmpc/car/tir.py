"""Tire property files (.tir): MF5.2, PAC2002, and what MF6.1 has in common with them.

A file has sections of `KEY = value`; `$` and `!` begin a comment. What this package's symmetric
tire can honour is read and brought to SI units, with the user's scaling factors and, for MF6.1, at
the file's inflation pressure; everything else is listed with what it would do (`TirFile.ignored`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lpvmpc.car import tir_entries as entries
from lpvmpc.car.magic_formula import COEFFICIENTS, coefficients
from lpvmpc.errors import DataError
from lpvmpc.kit.files import read_bytes, write_text
from lpvmpc.units import Array


@dataclass(frozen=True, kw_only=True)
class TirFile:
    """What a tire property file gives."""

    format: str
    """`PAC2002`, `MF5.2` or `MF6.1`."""
    coefficients: Array
    """Those of `lpvmpc.car.magic_formula`, in the order of its `COEFFICIENTS`."""
    zero: tuple[str, ...]
    """Coefficients that are not in the file and count as zero, as the formats say."""
    ignored: Mapping[str, str]
    """Entries that are not honoured, and what they would do, by name."""

    def sentences(self) -> list[str]:
        """What is ignored, in groups: the entries, and what they would do."""
        groups: dict[str, list[str]] = {}
        for name, what in self.ignored.items():
            groups.setdefault(what, []).append(name)
        return [f"{', '.join(names)}: {what}." for what, names in groups.items()]


def read_tir(path: str | Path) -> Array:
    """Coefficients of the symmetric tire in a .tir file, for `lpvmpc.car.magic_formula`.

    Args:
        path: Property file; see `read_tir_file`.

    Returns:
        Read-only array in the order of its `COEFFICIENTS`.

    Raises:
        DataError: As `read_tir_file`.
    """
    return read_tir_file(path).coefficients


def read_tir_file(path: str | Path) -> TirFile:
    """A tire property file: what is honoured of it, and what is not.

    Shifts, camber and turn slip are left out, since this package's tire has none; PKY1 is taken
    positive (the file's sign is that of ISO 8855). Of MF6.1, the pressure terms are honoured at the
    file's INFLPRES, and the relaxation lengths follow from the carcass' stiffness.

    Args:
        path: The file.

    Raises:
        DataError: It cannot be read, is of another formula, gives a unit that is none, lacks a
            coefficient, or gives one that is no finite number or that no tire has.
    """
    try:
        text = read_bytes(path).decode("utf-8", errors="replace")
    except OSError as error:
        why = error.strerror or str(error)
        raise DataError(f"{path} cannot be read: {why}.") from None
    reader = _Reader(path, text)
    return reader.file()


def write_tir(path: str | Path, c: Array, comment: str = "") -> None:
    """Write coefficients as a PAC2002 property file in SI units.

    Reading it gives the same numbers, to the last bit.

    Args:
        path: Where to.
        c: Coefficients in the order of `COEFFICIENTS`.
        comment: Text for its head, such as where the numbers come from.

    Raises:
        OutputError: It cannot be written.
    """
    values = dict(zip(COEFFICIENTS, map(float, c), strict=True))
    values["PKY1"] = -values["PKY1"]
    lines = [f"$ {line}".rstrip() for line in comment.splitlines()]
    lines += ["[UNITS]", *(f"{key} = '{unit}'" for key, unit in entries.SI.items())]
    lines += ["[MODEL]", "PROPERTY_FILE_FORMAT = 'PAC2002'"]
    for section, names in entries.WRITTEN.items():
        lines.append(f"[{section}]")
        lines += [f"{entries.KEYS.get(name, name)} = {values[name]!r}" for name in names]
    write_text(path, "\n".join(lines) + "\n")


class _Reader:
    """One file: its entries, and the coefficients they make."""

    def __init__(self, path: str | Path, text: str) -> None:
        self.path = path
        self.units, self.values, self.vendors = _sections(text)
        self.used: set[str] = set()

    def file(self) -> TirFile:
        """Everything, checked."""
        kind = self.kind()
        scale = self.scales()
        values: dict[str, float] = {}
        missing, zero = [], []
        for name in COEFFICIENTS:
            key = entries.KEYS.get(name, name)
            value = self.number(key)
            if value is None:
                value = self.derived(name, values, scale)
            if value is None and name in entries.OPTIONAL:
                value = 0.0
                zero.append(key)
            if value is None:
                missing.append(key)
                continue
            values[name] = value
        if missing:
            raise DataError(f"{self.path} lacks the tire coefficients {', '.join(missing)}.")
        for name, power in entries.DIMENSION.items():
            factor = math.prod(scale[unit] ** n for unit, n in power.items())
            if name not in self.relaxed:
                values[name] *= factor
        notes = self.pressure(values) if kind == "MF6.1" else {}
        notes |= self.load_exponent(values)
        for name in COEFFICIENTS:
            for user in entries.SCALED_BY.get(name, ()):
                given = self.number(user)
                values[name] *= 1.0 if given is None else given
        values["PKY1"] = abs(values["PKY1"])
        self.check(values, scale)
        return TirFile(
            format=kind, coefficients=coefficients(values), zero=tuple(zero),
            ignored={**self.ignored(), **notes},
        )

    def kind(self) -> str:
        """Which formula the file is of."""
        told = self.values.get("PROPERTY_FILE_FORMAT", "").upper()
        fit = self.number("FITTYP")
        self.used.add("PROPERTY_FILE_FORMAT")
        if told and told not in entries.FORMATS:
            raise DataError(
                f"{self.path} has PROPERTY_FILE_FORMAT {told[:40]!r}, whose coefficients are "
                f"another formula's; what can be read is {', '.join(sorted(entries.FORMATS))}."
            )
        if fit is not None and int(fit) not in entries.FITTYP:
            raise DataError(
                f"{self.path} has FITTYP {fit:g}, which is another formula's; what can be read is "
                f"{', '.join(map(str, sorted(entries.FITTYP)))}."
            )
        if fit is not None:
            return entries.FITTYP[int(fit)]
        return entries.FORMATS.get(told, "PAC2002")

    def scales(self) -> dict[str, float]:
        """Factor to the SI unit of each quantity."""
        found = {}
        for quantity, kinds in entries.UNITS.items():
            given = self.units.get(quantity, entries.SI.get(quantity, ""))
            plain = given.lower().rstrip("s") if len(given) > 2 else given.lower()
            factors = {name.rstrip("s") if len(name) > 2 else name: f for name, f in kinds.items()}
            if plain not in factors:
                raise DataError(
                    f"{self.path} gives {quantity} in {given[:40]!r}, but must give it in one of "
                    f"{', '.join(kinds)}."
                )
            found[quantity] = factors[plain]
        return found

    @property
    def relaxed(self) -> tuple[str, ...]:
        """Coefficients of a quotient of lengths, which need no units."""
        return ("PTX1", "PTX2", "PTY1", "PTY2")

    def derived(
        self, name: str, values: Mapping[str, float], scale: Mapping[str, float]
    ) -> float | None:
        """A coefficient of the relaxation length from the carcass' stiffness, as MF6.1 has it.

        sigma_x = K_x / C_x, sigma_y = K_y / C_y, with the slip stiffnesses of the same file.
        """
        if name not in self.relaxed or not {"FNOMIN", "R0", "PKX1", "PKY1", "PKY2"} <= set(values):
            return None
        if name == "PTY2":
            return values["PKY2"] if self.number("LATERAL_STIFFNESS") else None
        key = "LONGITUDINAL_STIFFNESS" if name.startswith("PTX") else "LATERAL_STIFFNESS"
        stiffness = self.number(key)
        if not stiffness:
            return None
        # FNOMIN / (stiffness R0) has no unit: force and length cancel
        share = values["FNOMIN"] / (stiffness * values["R0"])
        angle = scale["ANGLE"]
        return {
            "PTX1": values["PKX1"], "PTX2": values["PKX2"], "PTY1": abs(values["PKY1"]) / angle,
        }[name] * share

    def pressure(self, values: dict[str, float]) -> dict[str, str]:
        """Bring an MF6.1 tire to the file's inflation pressure."""
        nominal, given = self.number("NOMPRES"), self.number("INFLPRES")
        terms = {name: self.number(name) or 0.0 for name in entries.PRESSURE}
        if not nominal or given is None:
            return {}
        dpi = (given - nominal) / nominal
        if not abs(dpi) < 0.6:
            raise DataError(f"{self.path} gives INFLPRES {given:g}, but must give it within 60 % "
                            f"of NOMPRES, {nominal:g}.")
        stiff = 1.0 + terms["PPX1"] * dpi + terms["PPX2"] * dpi**2
        grip_x = 1.0 + terms["PPX3"] * dpi + terms["PPX4"] * dpi**2
        grip_y = 1.0 + terms["PPY3"] * dpi + terms["PPY4"] * dpi**2
        factors = {
            "PKX1": stiff, "PKX2": stiff, "PDX1": grip_x, "PDX2": grip_x, "PDY1": grip_y,
            "PDY2": grip_y, "PKY1": 1.0 + terms["PPY1"] * dpi, "PKY2": 1.0 + terms["PPY2"] * dpi,
            "QDZ1": 1.0 - terms["PPZ1"] * dpi, "KZ": 1.0 + terms["PFZ1"] * dpi,
        }
        for name, factor in factors.items():
            values[name] *= factor
        return {}

    def load_exponent(self, values: dict[str, float]) -> dict[str, str]:
        """Honour PKY4 of MF6.1 at the nominal load: sin(PKY4 atan(1 / PKY2)) for PKY4 other than 2.

        Ky = PKY1 FNOMIN sin(PKY4 atan(Fz / (PKY2 FNOMIN)))
        """
        exponent = self.number("PKY4")
        if exponent is None or exponent == 2.0:
            return {}
        turn = math.atan(1.0 / values["PKY2"])
        values["PKY1"] *= math.sin(exponent * turn) / math.sin(2.0 * turn)
        return {"PKY4": "honoured at the nominal load alone, the stiffness falls otherwise from "
                        "there"}

    def check(self, values: Mapping[str, float], scale: Mapping[str, float]) -> None:
        """Refuse what no tire has."""
        for name, (low, high) in entries.RANGES.items():
            if not low <= values[name] <= high:
                key = entries.KEYS.get(name, name)
                unit = " in SI units, scaled" if name in entries.DIMENSION else ", scaled"
                hint = ""
                if "ANGLE" in entries.DIMENSION.get(name, {}) and scale["ANGLE"] != 1.0:
                    hint = "; the file says that its angles are no radians"
                raise DataError(
                    f"{self.path} gives {key} as {self.values.get(key, '?')[:40]!r}, which is "
                    f"{values[name]:.6g}{unit}, but must be from {low:g} to {high:g}{hint}."
                )

    def ignored(self) -> dict[str, str]:
        """Entries with a number other than zero that are not honoured, and what they would do."""
        found = {}
        for key, text in self.values.items():
            if key in self.used or _plain(text) in (None, 0.0):
                continue
            what = entries.effect(key)
            if what is not None:
                found[key] = what
        for section in self.vendors:
            found[f"[{section}]"] = "a vendor's section, which is not read"
        return found

    def number(self, key: str) -> float | None:
        """A number; None where the file does not give it.

        Raises:
            DataError: It is none, or not finite.
        """
        text = self.values.get(key)
        if text is None:
            for section in self.vendors.values():  # rather a vendor's than none
                text = section.get(key, text)
        if text is None:
            return None
        self.used.add(key)
        number = _plain(text)
        if number is None or not math.isfinite(number):
            raise DataError(
                f"{self.path} gives {key} as {text[:40]!r}, but must give a finite number."
            )
        return number


def _plain(text: str) -> float | None:
    """A number, as Fortran may write it too; None where it is none."""
    try:
        return float(re.sub(r"(?<=[\d.])[dD](?=[+-]?\d)", "e", text))
    except ValueError:
        return None


def _sections(text: str) -> tuple[dict[str, str], dict[str, str], dict[str, dict[str, str]]]:
    """KEY = value of [UNITS], of the formats' sections together, and of each vendor's section.

    They are kept apart because MASS is a unit in the one and the tire's mass in [INERTIA], and a
    vendor may use a name of the formula for something else. Tables, which have no =, are skipped.
    """
    units: dict[str, str] = {}
    values: dict[str, str] = {}
    vendors: dict[str, dict[str, str]] = {}
    section = values
    for line in text.splitlines():
        line = re.split(r"[$!]", line, maxsplit=1)[0].strip()
        if line.startswith("["):
            name = line[1:].partition("]")[0].strip().upper()
            if name == "UNITS":
                section = units
            elif name in entries.SECTIONS:
                section = values
            else:
                section = vendors.setdefault(name, {})
        key, equals, value = line.partition("=")
        if equals:
            section[key.strip().upper()] = value.strip().strip("'\"").lower()
    return units, values, {name: found for name, found in vendors.items() if found}
