"""A reference that goes round other road users, planned before the run.

Where the reference, at its own timing, would come near a user, the path is shifted sideways: along
each change by the polynomial of least jerk, 10 u^3 - 15 u^4 + 6 u^5, whose length keeps the lateral
acceleration of the shift below `AY`. Heading and curvature of the shifted path are those of the
formulas for a curve at an offset e(s) from another,

    d s' = sqrt((1 - kappa e)^2 + e'^2) d s,   psi' = psi + atan2(e', 1 - kappa e),

and its speed is planned anew, nowhere above the old one. Wind and friction that change along the
road stay where they are. What comes out is a road like any other: preview, scoring and pictures
know nothing of the detour.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import PathError
from lpvmpc.road.path import Path
from lpvmpc.road.scenario import Scenario, turning_radius
from lpvmpc.road.speed_profile import SpeedProfile, plan
from lpvmpc.traffic.boxes import footprint, gap
from lpvmpc.traffic.users import RoadUser, Traffic
from lpvmpc.units import Array

CLEARANCE = 0.8
"""Room between the sides of car and user when they are beside each other [m]."""
MARGIN = 10.0
"""Room along the road, before and behind, for which the shift is held [m]."""
AY = 1.5
"""Largest lateral acceleration of a shift on a straight road [m/s2]."""
SHORTEST = 15.0
"""Shortest change of the shift [m]."""
GRIP = 0.8
"""Share of the car's grip for the speed of a detour on a road whose speed is given."""
PEAK = 10.0 / math.sqrt(3.0)
"""Largest second derivative of the polynomial."""


def detour(scenario: Scenario, traffic: Traffic, car: VehicleParams) -> Scenario:
    """The same scenario with a reference round its traffic.

    Args:
        scenario: What is driven; the first lap of it is looked at.
        traffic: Who is there.
        car: The car that passes.

    Returns:
        A scenario with another path and speed; the same one where nobody is in the way.

    Raises:
        PathError: There is no room, or it would have to pass on both sides at once.
    """
    zones = [zone for user in traffic.users for zone in _zones(scenario, traffic, user, car)]
    if not zones:
        return scenario
    path = scenario.path
    shift = _shift(path, scenario.speed, zones)
    new, s_old = _shifted(path, shift)
    radius = turning_radius(car)
    if radius * float(np.abs(new.kappa).max()) >= 1.0:
        raise PathError(f"The detour round the traffic of {scenario.name} is tighter than the car "
                        f"can turn, {radius:.2f} m.")
    limit = scenario.ay_max if scenario.ay_max is not None else GRIP * car.ay_limit
    planned = plan(new, car, ay_max=limit, v_max=float(scenario.speed.vx.max()))
    speed = SpeedProfile(np.minimum(planned.vx, scenario.speed.at(s_old)), new.length, new.closed,
                         scenario.speed.rest)
    wind, friction = scenario.wind, scenario.friction
    s_new = np.interp(path.s, s_old, new.s)
    if wind.over == "distance":
        knots = np.asarray(wind.knots, dtype=float)
        beyond = knots - np.clip(knots, 0.0, path.length)
        knots = np.interp(knots, path.s, s_new) + beyond
        wind = replace(wind, knots=knots, period=None if wind.period is None else new.length)
    if friction is not None:
        friction = _Moved(friction, new.s, s_old)
    found = replace(scenario, path=new, speed=speed, wind=wind, friction=friction,
                    source=f"{scenario.source} With a detour round its traffic.")
    _check(found, traffic, car)
    return found


@dataclass(frozen=True)
class _Moved:
    """The friction of the old path at arc lengths of the new one."""

    friction: Callable[[float], float]
    s_new: Array
    s_old: Array

    def __call__(self, s: float) -> float:
        """Friction scale at an arc length [m], lap after lap."""
        laps, rest = divmod(s, float(self.s_new[-1]))
        here = float(np.interp(rest, self.s_new, self.s_old))
        return self.friction(laps * float(self.s_old[-1]) + here)


def _times(scenario: Scenario) -> Array:
    """When the reference is at the points of its path [s]."""
    v = scenario.speed.at(scenario.path.s)
    return np.append(0.0, np.cumsum(scenario.path.spacing * 2.0 / (v[1:] + v[:-1])))


def _zones(
    scenario: Scenario, traffic: Traffic, user: RoadUser, car: VehicleParams
) -> list[tuple[float, float, float]]:
    """Where the reference is near a user: first and last arc length, and the shift there [m]."""
    path = scenario.path
    beside = 0.5 * (car.width + user.width) + CLEARANCE
    if abs(user.ey) >= beside:
        return []
    there = np.array([traffic.place(user, float(t)) for t in _times(scenario)])
    ahead = there - path.s
    if path.closed:
        ahead = (ahead + 0.5 * path.length) % path.length - 0.5 * path.length
    near = np.abs(ahead) < 0.5 * (car.length + user.length) + MARGIN
    if not near.any():
        return []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    found = []
    for a, b in zip(edges[::2], edges[1::2] - 1, strict=True):
        left = float(path.width_left[a : b + 1].min()) - user.ey
        right = float(path.width_right[a : b + 1].min()) + user.ey
        side = user.side or ("left" if left >= right else "right")
        room, shift = (left, user.ey + beside) if side == "left" else (right, user.ey - beside)
        if room < 0.5 * user.width + CLEARANCE + car.width:
            raise PathError(
                f"There is no room to pass {user.name!r} on the {side} at {path.s[a]:.0f} m: "
                f"{room - 0.5 * user.width:.1f} m from its side to the road's edge, but the car "
                f"needs {CLEARANCE + car.width:.1f} m."
            )
        found.append((float(path.s[a]), float(path.s[b]), shift))
    return found


def _shift(path: Path, speed: SpeedProfile, zones: list[tuple[float, float, float]]) -> Array:
    """The shift along the path, its first and second derivative, shape (3, n + 1)."""
    whole: list[tuple[float, float, float, float]] = []
    for a, b, e in sorted(zones):
        v = float(speed.at(np.array([a, b])).max())
        change = max(SHORTEST, v * math.sqrt(PEAK * abs(e) / AY))
        if whole and a - change < whole[-1][1] + whole[-1][3]:  # one leads into the other
            first, last, size, longest = whole[-1]
            if size * e < 0.0:
                raise PathError(f"Traffic at {last:.0f} and {a:.0f} m is too near for a detour "
                                "that passes one on the left and the other on the right.")
            larger = max(size, e, key=abs)
            whole[-1] = first, max(last, b), larger, max(change, longest)
        else:
            whole.append((a, b, e, change))
    out = np.zeros((3, len(path.s)))
    for a, b, e, change in whole:
        if not path.closed and (a < change or path.length - b < change):
            change = max(min(change, a, path.length - b), 1e-3)
            if change < SHORTEST:
                raise PathError(f"Traffic at {a:.0f} m is too near an end of the road to be "
                                "passed.")
        for sign, start in ((1.0, a - change), (-1.0, b + change)):
            u = sign * (path.s - start) / change
            if path.closed:  # a change may lie across the start line
                u = (u * change + 0.5 * path.length) % path.length - 0.5 * path.length
                u /= change
            on = (u > 0.0) & (u < 1.0)
            w = u[on]
            out[0, on] = e * w**3 * (10.0 - 15.0 * w + 6.0 * w**2)
            out[1, on] = sign * e / change * 30.0 * w**2 * (1.0 - w) ** 2
            out[2, on] = e / change**2 * 60.0 * w * (1.0 - w) * (1.0 - 2.0 * w)
        inside = (path.s >= a) & (path.s <= b)
        out[0, inside], out[1:, inside] = e, 0.0
    return out


def _shifted(path: Path, shift: Array) -> tuple[Path, Array]:
    """The path at an offset, and the arc length of the old one at its points [m]."""
    e, slope, bend = shift
    along = 1.0 - path.kappa * e
    if along.min() <= 0.1:
        raise PathError("The detour would pass beyond the centre of a bend.")
    stretch = np.hypot(along, slope)
    change = np.gradient(path.kappa, path.spacing)
    # d/ds of atan2(e', 1 - kappa e), and of the old heading
    turn = (bend * along + slope * (change * e + path.kappa * slope)) / stretch**2
    kappa = (path.kappa + turn) / stretch
    s_new = np.append(0.0, np.cumsum(0.5 * path.spacing * (stretch[1:] + stretch[:-1])))
    grid = np.linspace(0.0, s_new[-1], len(path.s))
    x, y, psi, _ = (float(value) for value in path.at(0.0))
    s_old = np.interp(grid, s_new, path.s)
    sides = (np.interp(s_old, path.s, path.width_right + e),
             np.interp(s_old, path.s, path.width_left - e))
    start = math.atan2(slope[0], along[0])
    new = Path(
        np.interp(grid, s_new, kappa), float(s_new[-1]), x0=x - e[0] * math.sin(psi),
        y0=y + e[0] * math.cos(psi), psi0=psi + start, closed=path.closed,
        width=sides, largest_shift=path.largest_shift,
    )
    return new, s_old


def _check(scenario: Scenario, traffic: Traffic, car: VehicleParams) -> None:
    """Refuse a detour whose own reference comes too near after all: its timing is another.

    In a bend the corners of both are nearer to each other than their sides, so it is not the whole
    clearance that is asked for.
    """
    times, path = _times(scenario), scenario.path
    for i in range(0, len(path.s), max(1, round(2.0 / path.spacing))):
        own = footprint(car, float(path.x[i]), float(path.y[i]), float(path.psi[i]))
        for user in traffic.users:
            room = gap(own, traffic.box(user, float(times[i])))
            if room < 0.5 * CLEARANCE:
                raise PathError(f"No detour was found round {user.name!r}: the reference would "
                                f"come within {room:.2f} m of it at {path.s[i]:.0f} m.")
