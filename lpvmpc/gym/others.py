"""Other road users in the environments: where they are, what is seen of them, and who is touched.

They are those of `lpvmpc.traffic`, whose places and times count from where and when the episode's
car starts. Each period takes a Python call per car and user, unlike the rest of the environments.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.rivals.observation import Entry
from lpvmpc.road.scenario import Scenario
from lpvmpc.traffic.boxes import footprint, gap
from lpvmpc.traffic.users import Traffic, load_traffic
from lpvmpc.traffic.watch import Pose, poses
from lpvmpc.units import Array

ENTRIES: tuple[Entry, ...] = (
    Entry("user_gap", "m", 100.0, 20.0),
    Entry("user_offset", "m", 10.0, 2.0),
    Entry("user_room", "m", 10.0, 2.0),
    Entry("user_closing", "m/s", 100.0, 5.0),
)
"""What is seen of the nearest user ahead or beside, behind the entries of the table: from bumper to
bumper along the road, 0 beside each other; its middle beside the car's, left positive; the room
between their sides, negative where it is in the way; how fast the car comes nearer along the road.
It is the truth in every world: nothing is sensed of traffic."""
BOUNDS: Array = np.array([entry.bound for entry in ENTRIES])
NOBODY: Array = np.array([100.0, 0.0, 10.0, 0.0])
"""The same with nobody ahead."""
LEAST: Array = np.array([0.0, -10.0, -10.0, -100.0])
"""Lower bounds: a gap is not negative."""


class Others:
    """The traffic of N cars, each in an episode of its own."""

    def __init__(self, name: str | os.PathLike[str], car: VehicleParams, n: int) -> None:
        """Args: traffic by name or file; the car; how many of it."""
        self.name, self.car = name, car
        self.traffic: list[Traffic | None] = [None] * n
        self.seen: Array = np.tile(NOBODY, (n, 1))
        self.gap: Array = np.full(n, np.inf)
        """Smallest distance of each car's body from anybody's [m], 0 in contact."""

    def begin(self, i: int, scenario: Scenario, s: float) -> None:
        """Put the traffic of a road before car i, which starts at arc length s [m].

        Raises:
            OptionError, UnknownNameError, DataError: There is no such traffic on this road.
        """
        there = load_traffic(self.name, scenario)
        users = tuple(replace(user, s=user.s + s) for user in there.users)
        self.traffic[i] = Traffic(there.path, users)

    def look(self, i: int, t: float, state: Array, s: float, ey: float, epsi: float) -> None:
        """Find the nearest user ahead of car i, and the gap.

        Args:
            i: Number of the car.
            t: Time since the episode began [s].
            state: Its x, y, psi, vx, vy, ... as in `seeing`.
            s: Its arc length [m].
            ey: Its lateral error [m].
            epsi: Its heading error [rad].
        """
        traffic = self.traffic[i]
        assert traffic is not None
        self.seen[i], self.gap[i] = NOBODY, np.inf
        x, y, psi, vx, vy = (float(value) for value in state[:5])
        if not np.isfinite(x + y + psi + vx + vy):
            return
        own = footprint(self.car, x, y, psi)
        path, nearest = traffic.path, np.inf
        middle = s + 0.5 * (self.car.lf - self.car.lr)
        for user in traffic.users:
            place = traffic.place(user, t)
            self.gap[i] = min(self.gap[i], gap(own, traffic.box_at(user, place)))
            ahead = place - middle
            if path.closed:
                ahead = (ahead + 0.5 * path.length) % path.length - 0.5 * path.length
            reach = 0.5 * (user.length + self.car.length)
            if ahead < -reach or ahead - reach >= nearest:  # passed, or further than another
                continue
            nearest = ahead - reach
            offset = user.ey - ey
            stands = not path.closed and place >= path.length
            speed = 0.0 if stands else float(np.interp(t, *np.asarray(user.speed, dtype=float).T))
            self.seen[i] = (
                nearest, offset, abs(offset) - 0.5 * (user.width + self.car.width),
                vx * np.cos(epsi) - vy * np.sin(epsi) - speed,
            )
        np.clip(self.seen[i], LEAST, BOUNDS, out=self.seen[i])
        # one beyond the bound of the gap is as good as nobody
        if nearest >= NOBODY[0]:
            self.seen[i] = NOBODY

    def poses(self, i: int, t: float) -> list[Pose]:
        """Everybody before car i at a time t [s] of its episode, for pictures."""
        traffic = self.traffic[i]
        assert traffic is not None
        return poses(traffic, t)
