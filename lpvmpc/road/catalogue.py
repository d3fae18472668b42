"""The named roads: what each is made of, and how fast it is driven unless told otherwise."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from lpvmpc.road import centreline, cones, segments
from lpvmpc.road.path import Path
from lpvmpc.road.wind import Wind
from lpvmpc.units import Array

V_MAX = 21.0
"""Default top speed of planned profiles: the highest of the paper [m/s]."""
AY_MAX = 4.0
"""Default lateral acceleration of planned profiles [m/s2]."""


@dataclass(frozen=True, kw_only=True)
class Road:
    """A road before the options: the path, and how its speed comes about by default."""

    path: Path
    """The reference path."""
    source: str
    """Where the road and its signals come from."""
    vx: tuple[Array, Array] | None = None
    """Arc lengths [m] and speeds [m/s] of the road's own speed, shapes (k,)."""
    wind: Wind = field(default_factory=Wind)
    """Side wind."""
    warnings: tuple[str, ...] = ()
    """What a user should know about how it was made."""
    v_max: float = V_MAX
    """Top speed [m/s]."""
    ay_max: float | None = AY_MAX
    """Lateral acceleration to plan for [m/s2]."""
    grip: float | None = None
    """The same as a fraction of what the car can hold, in place of `ay_max`."""
    constant: bool = False
    """Whether the whole road is driven at one speed."""
    cones: Callable[[float], Array] | None = None
    """Where cones stand [m], shape (n, 2), by the width of the vehicle [m]; None: nowhere."""


@cache
def _data(name: str) -> dict[str, Any]:
    """A JSON file of the package's data folder."""
    text = (resources.files("lpvmpc.road") / "data" / f"{name}.json").read_text("utf-8")
    data: dict[str, Any] = json.loads(text)
    return data


def _paper_wind() -> Wind:
    """The paper's wind over time: made for a run of 84 s, its last value is held after that."""
    data = _data("paper")
    times = data["wind_dt_s"] * np.arange(len(data["wind_mps"]))
    return Wind(knots=times, speeds=data["wind_mps"])


def paper() -> Road:
    """The road that the paper drives, with its speed and wind."""
    data = _data("paper")
    path = Path.from_curvature(data["kappa_radpm"], data["kappa_ds_m"])
    s = data["vx_ds_m"] * np.arange(len(data["vx_mps"]))
    vx = np.array(data["vx_mps"], dtype=float)
    return Road(path=path, source=data["source"], vx=(s, vx), wind=_paper_wind())


def paper_loop() -> Road:
    """The closed road of the paper's Fig. 8."""
    data = _data("paper")
    path = centreline.fit(data["loop_xy_m"], closed=True).path
    return Road(path=path, source=data["source"], wind=_paper_wind())


def _own(name: str, **kwargs: Any) -> Callable[[], Road]:
    """A road of our own from data/roads.json."""

    def build() -> Road:
        data = _data("roads")[name]
        pieces = segments.read_segments(data["segments"])
        path = segments.from_segments(pieces, closed=data["closed"], width=4.0)
        return Road(path=path, source=data["source"], **kwargs)

    return build


def double_lane_change() -> Road:
    """ISO 3888-1: lanes of 15, 25 and 30 m, gaps of 30 and 25 m, offset 3.5 m, at constant speed.

    The lanes' widths follow from the car's and are larger by 0.4 m or more, so each change may
    begin and end 3 m inside a lane, where it is 3 cm off the lane's middle.
    """
    start, inside, offset = 30.0, 3.0, 3.5

    def derivatives(x: Array) -> tuple[Array, Array]:
        _, d_out, dd_out = segments.smooth_step(x, start + 15.0 - inside, start + 45.0 + inside)
        _, d_back, dd_back = segments.smooth_step(x, start + 70.0 - inside, start + 95.0 + inside)
        return offset * (d_out - d_back), offset * (dd_out - dd_back)

    path = segments.from_graph(derivatives, start + 125.0 + 30.0)
    source = "ISO 3888-1 double lane change, through the middle of its lanes."

    def places(width: float) -> Array:
        return cones.double_lane_change(width).cones[:, :2] + (start, 0.0)

    return Road(path=path, source=source, v_max=15.0, ay_max=None, constant=True, cones=places)


def slalom() -> Road:
    """Eight cones 18 m apart, passed at 1.3 m on alternate sides."""
    gap, amplitude, first, count = 18.0, 1.3, 76.0, 8

    def derivatives(x: Array) -> tuple[Array, Array]:
        last = first + gap * (count - 1)
        rise, d_rise, dd_rise = segments.smooth_step(x, first - 2.0 * gap, first)
        fall, d_fall, dd_fall = segments.smooth_step(x, last, last + 2.0 * gap)
        w, dw, ddw = rise - fall, d_rise - d_fall, dd_rise - dd_fall
        k = math.pi / gap
        c, s = np.cos(k * (x - first)), np.sin(k * (x - first))
        slope = amplitude * (dw * c - w * k * s)
        return slope, amplitude * (ddw * c - 2.0 * dw * k * s - w * k * k * c)

    path = segments.from_graph(derivatives, first + gap * (count - 1) + 76.0)
    source = "Slalom of our own design: eight cones 18 m apart, passed at 1.3 m, at 10 m/s."

    def places(_: float) -> Array:
        return np.column_stack([first + gap * np.arange(count), np.zeros(count)])

    return Road(path=path, source=source, v_max=10.0, ay_max=None, constant=True, cones=places)


def skidpad() -> Road:
    """Two laps of a circle of 30 m radius to the right, then two to the left, at one speed."""
    radius, entry, change, laps = 30.0, 25.0, 40.0, 2
    arc = (2.0 * math.pi * laps - 0.5 * entry / radius) * radius
    pieces: list[tuple[float | None, float]] = [
        *segments.line(40.0),
        (entry, -1.0 / radius),
        (arc, -1.0 / radius),
        (change, 1.0 / radius),
        (arc, 1.0 / radius),
        (entry, 0.0),
        *segments.line(40.0),
    ]
    source = "Skidpad of our own design: two laps right, two laps left, 30 m radius."
    path = segments.from_segments(pieces)
    return Road(path=path, source=source, ay_max=None, grip=0.75, constant=True)


def _gusts() -> Wind:
    """Side wind of `tuning-b`: two slow waves between 4 and 36 m/s, repeating after a minute."""
    t = np.arange(0.0, 60.0, 1.5)
    speed = 20.0 + 10.0 * np.sin(t / 60.0 * 4.0 * math.pi) + 6.0 * np.sin(t / 60.0 * 14.0 * math.pi)
    return Wind(knots=t, speeds=speed, period=60.0)


circuit = _own("circuit")
tuning_a = _own("tuning-a")
tuning_b = _own("tuning-b", wind=_gusts())


def build(name: str) -> Road:
    """The road of this name, one of `names.SCENARIOS`: what its function makes."""
    road: Road = globals()[name.replace("-", "_")]()
    return road
