"""What is measured of traffic while a car drives: where everybody is, and how near they come."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.traffic.boxes import footprint, gap
from lpvmpc.traffic.users import Traffic
from lpvmpc.units import Array

COLUMNS = ("x_m", "y_m", "psi_rad", "s_m", "gap_m")
"""What is kept of each user, row by row; a trace has `user0_x_m` and so on."""
Pose = tuple[dict[str, Any], float, float, float]
"""A user in a picture: what `users_of` says of it, its middle x, y [m], its heading [rad]."""


class Watch:
    """The traffic of one run, as it is met."""

    def __init__(self, traffic: Traffic, car: VehicleParams, rows: int) -> None:
        """Args: who is there; the car that drives; the most rows of its record."""
        self.traffic, self.car = traffic, car
        self.record: Array = np.full((rows, len(traffic.users), len(COLUMNS)), np.nan)

    def look(self, row: int, t: float, x: float, y: float, psi: float) -> str:
        """Note where everybody is.

        Args:
            row: Number of the control instant.
            t: Its time [s].
            x: The car's centre of mass [m].
            y: The same [m].
            psi: Its heading [rad].

        Returns:
            Name of a user that the car touches; "" where it touches nobody.
        """
        own, touched = footprint(self.car, x, y, psi), ""
        for i, user in enumerate(self.traffic.users):
            s = self.traffic.place(user, t)
            box = self.traffic.box_at(user, s)
            room = gap(own, box)
            self.record[row, i] = box.x, box.y, box.psi, s, room
            touched = touched or (user.name if room <= 0.0 else "")
        return touched

    def columns(self, n: int) -> dict[str, Array]:
        """Columns of the trace, n rows each."""
        return {
            f"user{i}_{name}": self.record[:n, i, j].copy()
            for i in range(len(self.traffic.users)) for j, name in enumerate(COLUMNS)
        }


def users_of(traffic: Traffic) -> list[dict[str, Any]]:
    """Who is there, for the record of a run and for pictures."""
    return [
        {"name": user.name, "length_m": user.length, "width_m": user.width,
         "height_m": user.height} for user in traffic.users
    ]


def poses(traffic: Traffic, t: float) -> list[Pose]:
    """Who is where at a time t [s], for pictures."""
    found = []
    for user, told in zip(traffic.users, users_of(traffic), strict=True):
        box = traffic.box(user, t)
        found.append((told, box.x, box.y, box.psi))
    return found


@dataclass(frozen=True, kw_only=True)
class Encounter:
    """How near a car came to one user."""

    name: str
    """Its name."""
    gap_min_m: float | None
    """Smallest distance of the two bodies [m], at a control instant."""
    gap_min_t_s: float | None
    """When that was [s]."""
    headway_min_s: float | None
    """Smallest time headway while the car was behind it in its way: distance over speed [s]."""
    contact: bool
    """Whether they touched, which ends a run."""


def encounters(log: Any) -> list[Encounter]:
    """How near the car of a run came to each user; empty without traffic.

    Args:
        log: A Log of `simulate`.
    """
    c = log.columns
    lf, lr, width = log.meta["footprint_m"]
    found = []
    for i, user in enumerate(log.meta.get("traffic", [])):
        room = c[f"user{i}_gap_m"]
        if not len(room):
            found.append(Encounter(name=user["name"], gap_min_m=None, gap_min_t_s=None,
                                   headway_min_s=None, contact=False))
            continue
        k = int(np.argmin(room))
        # the user's place in the frame of the car
        dx, dy = c[f"user{i}_x_m"] - c["x_m"], c[f"user{i}_y_m"] - c["y_m"]
        cos, sin = np.cos(c["psi_rad"]), np.sin(c["psi_rad"])
        ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
        behind = (ahead > 0.5 * (lf + lr)) & (np.abs(aside) < 0.5 * (width + user["width_m"]))
        headway = room[behind] / np.maximum(c["vx_mps"][behind], 0.1)
        least = float(headway.min()) if len(headway) else math.inf
        found.append(Encounter(
            name=user["name"], gap_min_m=float(room[k]), gap_min_t_s=float(c["t_s"][k]),
            headway_min_s=least if math.isfinite(least) else None, contact=bool(room[k] <= 0.0),
        ))
    return found
