"""Road users: bodies that follow a reference of their own, whatever the car does.

A user is a box on the road. It moves along the path at a lateral offset, at a speed that is given
over time, and reacts to nobody. No force acts between it and the car: when they touch, the run is
over. Controllers are told nothing of it; what they see is the road and its reference (`detour`).
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from lpvmpc.errors import DataError, OptionError, UnknownNameError
from lpvmpc.kit.files import read_toml, readable, reading
from lpvmpc.road.path import Path
from lpvmpc.road.scenario import Scenario
from lpvmpc.traffic.boxes import Box

SIDES = ("", "left", "right")
"""Where a detour may pass: where there is more room, or a side that is given."""
MOST = 100
"""Most users of one run."""
START_GAP = 2.0
"""Room that a user leaves before and behind the car on the start line [m]."""


@dataclass(frozen=True, kw_only=True)
class RoadUser:
    """One body on the road and where it goes."""

    name: str
    """What it is called in results."""
    s: float
    """Arc length of its centre along the path when the run begins [m]."""
    ey: float = 0.0
    """Its lateral offset from the path, left positive [m]."""
    speed: tuple[tuple[float, float], ...] = ((0.0, 0.0),)
    """Times [s] and speeds along the path [m/s]: linear between them, held before and after."""
    length: float = 4.1
    """Its length [m]."""
    width: float = 1.75
    """Its width [m]."""
    height: float = 1.5
    """Its height [m], for pictures."""
    side: str = ""
    """On which side of it a detour passes: left, right, or where there is more room."""

    def __post_init__(self) -> None:
        """Refuse what cannot be on a road."""
        what = f"of road user {self.name!r}"
        named = isinstance(self.name, str) and self.name.isprintable() and self.name.strip()
        if not named or len(self.name) > 60:
            raise OptionError("name of a road user", self.name, "1 to 60 printable characters")
        for key, low, high, unit in (
            ("s", 0.0, 1e6, "m"), ("ey", -50.0, 50.0, "m"), ("length", 0.1, 30.0, "m"),
            ("width", 0.1, 5.0, "m"), ("height", 0.1, 6.0, "m"),
        ):
            value = getattr(self, key)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (number and low <= value <= high):  # NaN fails the comparison too
                allowed = f"a number from {low:g} to {high:g} {unit}"
                raise OptionError(f"{key} {what}", value, allowed)
        if self.side not in SIDES:
            raise OptionError(f"side {what}", self.side, "left, right, or left out")
        allowed = "pairs of a time, which rises, and a speed from 0 to 60 m/s"
        try:
            knots = np.asarray(self.speed, dtype=float)
            fine = knots.ndim == 2 and knots.shape[1] == 2 and len(knots) > 0
            fine = fine and bool(np.isfinite(knots).all() and (np.diff(knots[:, 0]) > 0.0).all())
            fine = fine and bool((knots[:, 1] >= 0.0).all() and (knots[:, 1] <= 60.0).all())
        except (TypeError, ValueError):
            fine = False
        if not fine:
            raise OptionError(f"speed {what}", self.speed, allowed)

    def gone(self, t: float) -> float:
        """Distance that it has gone along the path since the start [m], at a time [s]."""
        times, speeds = np.asarray(self.speed, dtype=float).T
        at = np.concatenate([[0.0], times[(times > 0.0) & (times < t)], [t]])
        v = np.interp(at, times, speeds)
        return float(np.sum(0.5 * (v[1:] + v[:-1]) * np.diff(at)))


@dataclass(frozen=True)
class Traffic:
    """The users of a road."""

    path: Path
    """The road along which they move, which a detour leaves as it is."""
    users: tuple[RoadUser, ...]
    """Who is there."""

    def place(self, user: RoadUser, t: float) -> float:
        """Arc length of a user [m] at a time [s]; at the end of an open road it stops."""
        s = user.s + user.gone(t)
        return s % self.path.length if self.path.closed else min(s, self.path.length)

    def box(self, user: RoadUser, t: float) -> Box:
        """Where a user is at a time [s]."""
        return self.box_at(user, self.place(user, t))

    def box_at(self, user: RoadUser, s: float) -> Box:
        """Where a user is when its place along the path is s [m]."""
        x, y, psi, _ = (float(value) for value in self.path.at(s))
        return Box(x - user.ey * math.sin(psi), y + user.ey * math.cos(psi), psi,
                   user.length, user.width)


def parked_car(scenario: Scenario) -> tuple[RoadUser, ...]:
    """A car that stands half on the road, at two fifths of its way."""
    return (RoadUser(name="parked car", s=round(0.4 * scenario.path.length, 1), ey=-0.8,
                     side="left"),)


def braking_lead(scenario: Scenario) -> tuple[RoadUser, ...]:
    """A car ahead, as fast as the reference, that brakes to a stop after five seconds."""
    v = round(min(max(scenario.speed.start, 5.0), 40.0), 1)
    return (RoadUser(name="braking lead", s=round(25.0 + 1.5 * v, 1),
                     speed=((5.0, v), (5.0 + v / 4.0, 0.0))),)


def slow_car(scenario: Scenario) -> tuple[RoadUser, ...]:
    """A car ahead at half the reference's mean speed: one to pass."""
    mean = scenario.path.length / scenario.reference_duration
    return (RoadUser(name="slow car", s=round(25.0 + 1.5 * mean, 1),
                     speed=((0.0, round(0.5 * mean, 1)),)),)


PRESETS: dict[str, Callable[[Scenario], tuple[RoadUser, ...]]] = {
    "parked-car": parked_car, "braking-lead": braking_lead, "slow-car": slow_car,
}
"""Traffic by name."""


def load_traffic(name_or_file: str | os.PathLike[str], scenario: Scenario) -> Traffic:
    """Traffic by name, or from a TOML file, for a road.

    Args:
        name_or_file: A name of `PRESETS`, or a file whose name ends in .toml: tables `[[user]]`
            with the fields of `RoadUser`.
        scenario: What is driven.

    Raises:
        UnknownNameError: No such traffic, or no such field of a user.
        OptionError: A value outside its domain; a user beyond the road's end or on the start line.
        DataError: The file cannot be read.
    """
    given = check_name(name_or_file)
    users = PRESETS[given](scenario) if given in PRESETS else _from_toml(FilePath(given))
    length = scenario.path.length
    for user in users:
        if user.s > length:
            raise OptionError(f"s of road user {user.name!r}", user.s,
                              f"at most the length of the road, {length:.1f} m")
        ahead = min(user.s, length - user.s) if scenario.path.closed else user.s
        if ahead < 0.5 * user.length + 4.0 + START_GAP and abs(user.ey) < 3.0:
            raise OptionError(
                f"s of road user {user.name!r}", user.s,
                f"{0.5 * user.length + 4.0 + START_GAP:.1f} m or more away from the start, where "
                "the car stands",
            )
    return Traffic(scenario.path, users)


def check_name(name_or_file: str | os.PathLike[str]) -> str:
    """The name of traffic or of a TOML file, as text.

    Raises:
        UnknownNameError: It can be neither.
    """
    given = os.fspath(name_or_file)
    if given not in PRESETS and not given.lower().endswith(".toml"):
        raise UnknownNameError("traffic", given, [*PRESETS, "FILE.toml"])
    return given


def _from_toml(file: FilePath) -> tuple[RoadUser, ...]:
    told = readable(file)
    with reading(f"The traffic {told!r}", "TOML file"):
        content = read_toml(file)
    rows = content.get("user")
    if set(content) != {"user"} or not isinstance(rows, list) or not 1 <= len(rows) <= MOST:
        raise DataError(
            f"The traffic {told!r} must hold 1 to {MOST} tables [[user]], nothing else."
        )
    users = tuple(_user(row) for row in rows)
    names = [user.name for user in users]
    if len(set(names)) < len(names):
        raise OptionError("names of road users", ", ".join(names), "a different one for each")
    return users


def _user(row: Mapping[str, Any]) -> RoadUser:
    known = [field.name for field in fields(RoadUser)]
    for key in row:
        if key not in known:
            raise UnknownNameError("field of a road user", key, known)
    for key in ("name", "s"):
        if key not in row:
            raise OptionError(f"{key} of a road user", None, "given")
    speed = row.get("speed", ((0.0, 0.0),))
    if isinstance(speed, int | float) and not isinstance(speed, bool):
        speed = ((0.0, float(speed)),)  # one speed, held
    if isinstance(speed, list):
        speed = tuple(tuple(pair) if isinstance(pair, list) else pair for pair in speed)
    return RoadUser(**{**row, "speed": speed})
