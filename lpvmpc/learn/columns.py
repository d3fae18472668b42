"""The columns of stiffness data: what they mean, what a car can do, and their checksum."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

Columns = Mapping[str, npt.NDArray[Any]]

COLUMNS = {
    "run": "number of the run; rows of one run are consecutive",
    "manoeuvre": "kind of manoeuvre",
    "t_s": "time since the start of the recording",
    "vx_mps": "longitudinal speed of the centre of mass, body frame",
    "vy_mps": "lateral speed, left positive",
    "delta_rad": "road-wheel angle of the equivalent single track, left positive",
    "ax_mps2": "longitudinal acceleration of the centre of mass",
    "r_radps": "yaw rate, counter-clockwise positive",
    "Cf_Nprad": "front axle: secant stiffness Fyf / alpha_f, at small slip the slope (label)",
    "Cr_Nprad": "rear axle: secant stiffness Fyr / alpha_r, at small slip the slope (label)",
    "Fyf_N": "front axle: lateral force across the wheels' heading, left positive",
    "Fyr_N": "rear axle: lateral force",
    "alpha_f_rad": "front axle: slip angle after relaxation, positive gives a force to the left",
    "alpha_r_rad": "rear axle: slip angle after relaxation",
    "Fzf_N": "front axle: load",
    "Fzr_N": "rear axle: load",
    "mu": "peak friction of tires and road at their loads, weighted by the loads",
    "wind_mps": "side wind, from the car's left to its right positive",
    "ay_mps2": "lateral acceleration of the centre of mass",
    "Fxf_N": "front axle: longitudinal force along the wheels' heading",
    "Fxr_N": "rear axle: longitudinal force",
    "slope_f_Nprad": "front axle: local slope of the lateral force over the slip angle",
    "slope_r_Nprad": "rear axle: local slope",
    "slope_zero_f_Nprad": "front axle: that slope at slip angle zero, same loads and slip ratios",
    "slope_zero_r_Nprad": "rear axle: slope at slip angle zero",
    "alpha_kin_f_rad": "front axle: slip angle of the single track, delta - atan2(vy + lf r, vx)",
    "alpha_kin_r_rad": "rear axle: slip angle of the single track, -atan2(vy - lr r, vx)",
    "drive_mps2": "drive or brake acceleration asked of the wheels, after its lag",
    "roll_rad": "roll angle of the body, right side down positive",
    "roll_rate_radps": "roll rate of the body",
    "friction": "scale of the road's peak friction",
    "mass_kg": "mass of the car",
}
"""Columns in their order, and what they mean; units are in the names."""

SHA256 = "sha256"
"""Name of the checksum in a file's metadata."""
_STIFFNESS, _FORCE, _ANGLE = (-1e7, 1e7), (-1e5, 1e5), (-1.6, 1.6)
RANGES: dict[str, tuple[float, float]] = {
    "run": (0, 2**31 - 1),
    "t_s": (0.0, 1e6),
    "vx_mps": (-100.0, 100.0),
    "vy_mps": (-100.0, 100.0),
    "delta_rad": _ANGLE,
    "ax_mps2": (-100.0, 100.0),
    "r_radps": (-20.0, 20.0),
    "Cf_Nprad": _STIFFNESS,
    "Cr_Nprad": _STIFFNESS,
    "Fyf_N": _FORCE,
    "Fyr_N": _FORCE,
    "alpha_f_rad": _ANGLE,
    "alpha_r_rad": _ANGLE,
    "Fzf_N": (0.0, 1e5),
    "Fzr_N": (0.0, 1e5),
    "mu": (0.01, 4.0),
    "wind_mps": (-100.0, 100.0),
    "ay_mps2": (-100.0, 100.0),
    "Fxf_N": _FORCE,
    "Fxr_N": _FORCE,
    "slope_f_Nprad": _STIFFNESS,
    "slope_r_Nprad": _STIFFNESS,
    "slope_zero_f_Nprad": _STIFFNESS,
    "slope_zero_r_Nprad": _STIFFNESS,
    "alpha_kin_f_rad": (-3.2, 3.2),
    "alpha_kin_r_rad": (-3.2, 3.2),
    "drive_mps2": (-100.0, 100.0),
    "roll_rad": _ANGLE,
    "roll_rate_radps": (-20.0, 20.0),
    "friction": (0.01, 4.0),
    "mass_kg": (100.0, 10_000.0),
}
"""What no road car exceeds: wide enough for a spin, narrow enough for a damaged exponent."""
LONGEST_NAME = 60
"""Most characters of a manoeuvre's name."""


class Digest:
    """SHA-256 of columns that come in pieces, whatever the pieces."""

    def __init__(self) -> None:
        self._columns: dict[str, Any] = {}

    def add(self, piece: Columns) -> None:
        """Add rows: arrays of shape (k,) by name."""
        for name, values in piece.items():
            digest = self._columns.setdefault(name, hashlib.sha256())
            if values.dtype.kind in "OUS":
                digest.update("".join(f"{len(text)}:{text}" for text in map(str, values)).encode())
            else:
                digest.update(np.ascontiguousarray(values).astype(values.dtype.newbyteorder("<")))

    def hexdigest(self, facts: Mapping[str, Any]) -> str:
        """The checksum of all that was added, and of the metadata without the checksum itself."""
        columns = {name: digest.hexdigest() for name, digest in self._columns.items()}
        told = {key: value for key, value in facts.items() if key != SHA256}
        return hashlib.sha256(json.dumps([columns, told], sort_keys=True).encode()).hexdigest()


def checksum(columns: Columns, facts: Mapping[str, Any]) -> str:
    """The checksum of whole columns; `facts` as JSON gives them back."""
    digest = Digest()
    digest.add(columns)
    return digest.hexdigest(facts)


def what_is_wrong(columns: Columns) -> str:
    """Where columns hold what no car does, as the end of a sentence; "" where they do not."""
    for name, values in columns.items():
        if values.dtype.kind in "OUS":
            for row, text in enumerate(values):
                if not isinstance(text, str) or not 0 < len(text) <= LONGEST_NAME:
                    return (f"{str(text)[:LONGEST_NAME]!r} in column {name}, row {row}, but must "
                            f"hold names of 1 to {LONGEST_NAME} characters")
            continue
        bad = ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            return f"{values[row]} in column {name}, row {row}, but must be finite numbers"
        low, high = RANGES[name]
        bad = (values < low) | (values > high)
        if bad.any():
            row = int(np.argmax(bad))
            return (f"{values[row]:g} in column {name}, row {row}, but no road car is outside "
                    f"{low:g} to {high:g}")
    return ""
