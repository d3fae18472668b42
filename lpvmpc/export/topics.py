"""Where each column of a trace goes in a file of topics: its topic, its field, its place there."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from lpvmpc.sim.log import WHEELS

TOPICS = {
    "/car": ("s_m", "x_m", "y_m", "psi_rad", "vx_mps", "vy_mps", "r_radps", "delta_rad", "ax_mps2",
             "ay_mps2", "roll_rad"),
    "/error": ("ey_m", "epsi_rad"),
    "/reference": ("kappa_radpm", "vx_ref_mps", "x_ref_m", "y_ref_m", "psi_ref_rad"),
    "/command": ("delta_cmd_rad", "ax_cmd_mps2"),
    "/solver": ("solved", "fallback", "kkt_residual"),
    "/wind": ("wind_mps",),
}
"""Columns by topic, but for those that a rule names."""
RULES = (
    (re.compile(r"pred_([xy]_m)_(\d+)"), "/prediction"),
    (re.compile(r"(qpos)_(\d+)"), "/qpos"),
    (re.compile(r"meas_(\w+)"), "/measured"),
    (re.compile(r"est_(\w+)"), "/estimate"),
)
"""Patterns of further columns: the field, and the place in its list; their topics."""
OTHER = "/trace"
"""Topic of what nobody has named."""


@dataclass(frozen=True)
class Place:
    """Where a column's values are found."""

    topic: str
    field: str
    index: int | None = None
    """Place in the field's list; None: the field is the value."""


def place_of(column: str) -> Place:
    """Where a column goes: every column has a place, and no two the same.

    The instant `t_s` is a field of `/car`, and the time of every message besides.
    """
    if column == "t_s":
        return Place("/car", column)
    for topic, columns in TOPICS.items():
        if column in columns:
            return Place(topic, column)
    for pattern, topic in RULES:
        if found := pattern.fullmatch(column):
            field, *index = found.groups()
            return Place(topic, field, int(index[0]) if index else None)
    for wheel in WHEELS:
        if column.startswith(("F", "slip_", "mu_")) and f"_{wheel}" in column:
            return Place(f"/tire/{wheel}", column.replace(f"_{wheel}", ""))
    return Place(OTHER, column)


def places_of(columns: Iterable[str]) -> dict[str, Place]:
    """The places of columns, by their names."""
    return {column: place_of(column) for column in columns}
