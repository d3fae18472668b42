"""What is driven: a path, a speed, wind and road friction, under a name.

The named scenarios are built here from the data folder; a CSV file makes one of your own.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc import centreline, road
from lpvmpc.errors import OptionError, PathError, UnknownNameError
from lpvmpc.path import Path
from lpvmpc.speed_profile import SpeedProfile, plan
from lpvmpc.vehicle import VehicleParams
from lpvmpc.wind import Wind

Array = npt.NDArray[np.float64]

V_MAX = 21.0
"""Default top speed of planned profiles: the highest of the paper [m/s]."""
AY_MAX = 4.0
"""Default lateral acceleration of planned profiles [m/s2]."""


@dataclass(frozen=True, kw_only=True)
class RoadFriction:
    """Scale on the tires' peak friction along the road: linear between knots, then held."""

    scale: float = 1.0
    """Factor on everything."""
    knots: tuple[float, ...] = (0.0,)
    """Arc lengths [m], increasing."""
    values: tuple[float, ...] = (1.0,)
    """Friction scale at the knots [-]."""
    period: float | None = None
    """Length of a lap on closed paths [m]."""

    def __call__(self, s: float) -> float:
        """Friction scale at an arc length [m]."""
        if len(self.knots) == 1:
            return self.scale * self.values[0]
        return self.scale * float(np.interp(s, self.knots, self.values, period=self.period))


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A road, how fast to drive it, and what disturbs the car on it."""

    name: str
    """Name, or the stem of the CSV file."""
    path: Path
    """The reference path, with the widths of the road."""
    speed: SpeedProfile
    """The reference speed along it."""
    wind: Wind = field(default_factory=Wind)
    """Side wind."""
    friction: Callable[[float], float] | None = None
    """Friction scale at an arc length [m], times the plant's own; None: 1 everywhere."""
    ay_max: float | None = None
    """Lateral acceleration that the speed was planned for [m/s2]; None where it was given."""
    source: str = ""
    """Where the road and its signals come from."""
    options: dict[str, Any] = field(default_factory=dict)
    """The options of `load_scenario` that made it."""

    @property
    def reference_duration(self) -> float:
        """Time that the path, or one lap, takes at the reference speed [s]."""
        return self.speed.duration

    @property
    def ay_peak(self) -> float:
        """Largest lateral acceleration vx^2 kappa of the reference [m/s2]."""
        return float(np.abs(self.speed.vx**2 * self.path.kappa).max())


@dataclass(frozen=True, kw_only=True)
class _Road:
    """A road before the options: the path, and how its speed comes about by default."""

    path: Path
    source: str
    vx: tuple[Array, Array] | None = None  # knots s [m] and speeds [m/s], where given
    wind: Wind = field(default_factory=Wind)
    v_max: float = V_MAX
    ay_max: float | None = AY_MAX
    grip: float | None = None
    constant: bool = False  # one speed for the whole road


@cache
def _data(name: str) -> dict[str, Any]:
    """A JSON file of the package's data folder."""
    text = (resources.files("lpvmpc") / "data" / f"{name}.json").read_text("utf-8")
    data: dict[str, Any] = json.loads(text)
    return data


def _paper_wind() -> Wind:
    """The paper's wind over time: made for a run of 84 s, its last value is held after that."""
    data = _data("paper")
    times = data["wind_dt_s"] * np.arange(len(data["wind_mps"]))
    return Wind(knots=times, speeds=data["wind_mps"])


def _paper() -> _Road:
    data = _data("paper")
    path = Path.from_curvature(data["kappa_radpm"], data["kappa_ds_m"])
    s = data["vx_ds_m"] * np.arange(len(data["vx_mps"]))
    vx = np.array(data["vx_mps"], dtype=float)
    return _Road(path=path, source=data["source"], vx=(s, vx), wind=_paper_wind())


def _paper_loop() -> _Road:
    data = _data("paper")
    path = centreline.fit(data["loop_xy_m"], closed=True).path
    return _Road(path=path, source=data["source"], wind=_paper_wind())


def _own(name: str, **kwargs: Any) -> Callable[[], _Road]:
    """A road of our own from data/roads.json."""

    def build() -> _Road:
        data = _data("roads")[name]
        segments = road.read_segments(data["segments"])
        path = road.from_segments(segments, closed=data["closed"], width=4.0)
        return _Road(path=path, source=data["source"], **kwargs)

    return build


def _double_lane_change() -> _Road:
    """ISO 3888-1: lanes of 15, 25 and 30 m, gaps of 30 and 25 m, offset 3.5 m, at constant speed.

    The lanes' widths follow from the car's and are larger by 0.4 m and more, so each change may
    begin and end 3 m inside a lane, where it is 3 cm off the lane's middle.
    """
    start, inside, offset = 30.0, 3.0, 3.5

    def derivatives(x: Array) -> tuple[Array, Array]:
        _, d_out, dd_out = road.smooth_step(x, start + 15.0 - inside, start + 45.0 + inside)
        _, d_back, dd_back = road.smooth_step(x, start + 70.0 - inside, start + 95.0 + inside)
        return offset * (d_out - d_back), offset * (dd_out - dd_back)

    path = road.from_graph(derivatives, start + 125.0 + 30.0)
    source = "ISO 3888-1 double lane change, through the middle of its lanes."
    return _Road(path=path, source=source, v_max=15.0, ay_max=None, constant=True)


def _slalom() -> _Road:
    """Eight cones 18 m apart, passed at 1.3 m on alternate sides."""
    gap, amplitude, first, cones = 18.0, 1.3, 76.0, 8

    def derivatives(x: Array) -> tuple[Array, Array]:
        last = first + gap * (cones - 1)
        rise, d_rise, dd_rise = road.smooth_step(x, first - 2.0 * gap, first)
        fall, d_fall, dd_fall = road.smooth_step(x, last, last + 2.0 * gap)
        w, dw, ddw = rise - fall, d_rise - d_fall, dd_rise - dd_fall
        k = math.pi / gap
        c, s = np.cos(k * (x - first)), np.sin(k * (x - first))
        slope = amplitude * (dw * c - w * k * s)
        return slope, amplitude * (ddw * c - 2.0 * dw * k * s - w * k * k * c)

    path = road.from_graph(derivatives, first + gap * (cones - 1) + 76.0)
    source = "Slalom of our own design: eight cones 18 m apart, passed at 1.3 m, at 10 m/s."
    return _Road(path=path, source=source, v_max=10.0, ay_max=None, constant=True)


def _skidpad() -> _Road:
    """Two laps of a circle of 30 m radius to the right, then two to the left, at one speed."""
    radius, entry, change, laps = 30.0, 25.0, 40.0, 2
    arc = (2.0 * math.pi * laps - 0.5 * entry / radius) * radius
    segments: list[tuple[float | None, float]] = [
        *road.line(40.0),
        (entry, -1.0 / radius),
        (arc, -1.0 / radius),
        (change, 1.0 / radius),
        (arc, 1.0 / radius),
        (entry, 0.0),
        *road.line(40.0),
    ]
    source = "Skidpad of our own design: two laps right, two laps left, 30 m radius."
    path = road.from_segments(segments)
    return _Road(path=path, source=source, ay_max=None, grip=0.75, constant=True)


def _gusts() -> Wind:
    """Side wind of `tuning-b`: two slow waves between 4 and 36 m/s, repeating after a minute."""
    t = np.arange(0.0, 60.0, 1.5)
    speed = 20.0 + 10.0 * np.sin(t / 60.0 * 4.0 * math.pi) + 6.0 * np.sin(t / 60.0 * 14.0 * math.pi)
    return Wind(knots=t, speeds=speed, period=60.0)


_BUILDERS: dict[str, tuple[str, Callable[[], _Road]]] = {
    "paper": ("the paper's 1280 m of curvature, speed and wind", _paper),
    "paper-loop": ("the closed loop of the paper's Fig. 8 at 4 m/s2, under its wind", _paper_loop),
    "double-lane-change": ("ISO 3888-1 at 15 m/s", _double_lane_change),
    "skidpad": ("figure eight of 30 m radius at 75 % of the grip limit", _skidpad),
    "slalom": ("cones 18 m apart at 10 m/s", _slalom),
    "circuit": ("closed, 1.9 km: hairpin, chicane, double apex, sweepers", _own("circuit")),
    "tuning-a": ("closed, 1.0 km, for tuning only", _own("tuning-a")),
    "tuning-b": ("open, 0.9 km, windy, for tuning only", _own("tuning-b", wind=_gusts())),
}

SCENARIOS: dict[str, str] = {name: about for name, (about, _) in _BUILDERS.items()}
"""What there is to drive, by name."""


def list_scenarios() -> tuple[str, ...]:
    """Names of the scenarios."""
    return tuple(SCENARIOS)


def load_scenario(
    name_or_csv: str | FilePath,
    *,
    v_max: float | None = None,
    ay_max: float | None = None,
    grip: float | None = None,
    closed: bool | None = None,
    wind_scale: float = 1.0,
    friction: float = 1.0,
    params: VehicleParams | None = None,
) -> Scenario:
    """A named scenario, or one from a CSV file.

    Where a scenario comes with its speed (`paper`, a CSV with vx_mps), `v_max` caps it, and
    `ay_max` or `grip` replace it by a planned one. The constant speed of the manoeuvres
    (`double-lane-change`, `slalom`, `skidpad`) is `v_max`, or what `ay_max` or `grip` allow. Elsewhere
    the speed is planned under `v_max` and `ay_max` or `grip`; the drive and the brakes bound it too.

    Args:
        name_or_csv: A name of `list_scenarios()`, or a file whose name ends in .csv.
        v_max: Top speed [m/s].
        ay_max: Lateral acceleration of the plan [m/s2], whatever the friction.
        grip: The same as a fraction of `params.ay_limit` times `friction`.
        closed: Whether a CSV track goes round (None: if its ends meet); False opens a named
            closed one, to be driven once from its start to its end.
        wind_scale: Factor on the wind speed.
        friction: Scale on the road's peak friction.
        params: The car; default: the packaged one.

    Raises:
        UnknownNameError: No such scenario.
        OptionError: An option outside its domain, or `ay_max` and `grip` together.
        PathError: A file or a road that cannot be driven.
    """
    _check_options(v_max, ay_max, grip, wind_scale, friction)
    params = params or VehicleParams.load()
    name = str(name_or_csv)
    if name in _BUILDERS:
        base = _BUILDERS[name][1]()
        path = base.path if closed is None else _with_ends(base.path, closed, name)
    elif isinstance(name_or_csv, FilePath) or name.lower().endswith(".csv") or "/" in name:
        base = _from_csv(FilePath(name_or_csv), closed)
        path, name = base.path, FilePath(name_or_csv).stem
    else:
        raise UnknownNameError("scenario", name, SCENARIOS)
    _check_curvature(path, params, name)

    v_cap = base.v_max if v_max is None else v_max
    if ay_max is None and grip is None:
        ay_max, grip = base.ay_max, base.grip
        given = base.vx
    else:
        given = None
    limit = grip * params.ay_limit * friction if grip is not None else ay_max
    if given is not None:
        speed = SpeedProfile.from_knots(*given, path)
        if v_max is not None:
            speed = SpeedProfile(np.minimum(speed.vx, v_max), path.length, path.closed)
        limit = None
    elif base.constant:
        tightest = float(np.abs(path.kappa).max())
        bend = math.inf if limit is None else math.sqrt(limit / tightest)
        speed = SpeedProfile.constant(min(v_cap, bend), path)
    else:
        assert limit is not None
        speed = plan(path, params, ay_max=limit, v_max=v_cap)
    wind = base.wind
    if wind_scale != 1.0:
        wind = Wind(
            knots=wind.knots,
            speeds=wind.speeds,
            over=wind.over,
            period=wind.period,
            scale=wind_scale,
        )
    return Scenario(
        name=name,
        path=path,
        speed=speed,
        wind=wind,
        friction=None if friction == 1.0 else RoadFriction(scale=float(friction)),
        ay_max=limit,
        source=base.source,
        options={
            "v_max": v_max,
            "ay_max": ay_max,
            "grip": grip,
            "closed": path.closed,
            "wind_scale": wind_scale,
            "friction": friction,
        },
    )


def _check_options(
    v_max: float | None, ay_max: float | None, grip: float | None, wind: float, friction: float
) -> None:
    """Refuse options that no run can mean."""
    for name, value, low, high, unit in (
        ("v_max", v_max, 1.0, 60.0, " m/s"),
        ("ay_max", ay_max, 0.1, 15.0, " m/s2"),
        ("grip", grip, 0.05, 1.2, ""),
        ("wind_scale", wind, 0.0, 10.0, ""),
        ("friction", friction, 0.05, 2.0, ""),
    ):
        if value is None:
            continue
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        if not (number and low <= value <= high):  # NaN fails the comparison too
            raise OptionError(name, value, f"a number from {low:g} to {high:g}{unit}")
    if ay_max is not None and grip is not None:
        raise OptionError("grip", grip, "left out where ay_max is given: both set the same limit")


def _with_ends(path: Path, closed: bool, name: str) -> Path:
    """A named road, opened where asked; an open one cannot be closed."""
    if closed == path.closed:
        return path
    if closed:
        gap = math.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0])
        raise PathError(f"Scenario {name} cannot be closed: its ends are {gap:.3g} m apart.")
    return Path(
        path.kappa,
        path.length,
        x0=float(path.x[0]),
        y0=float(path.y[0]),
        psi0=float(path.psi[0]),
        width=(path.width_right, path.width_left),
        largest_shift=path.largest_shift,
    )


def _from_csv(file: FilePath, closed: bool | None) -> _Road:
    """A road from a track file: smoothed points, and its speed and wind where it has them."""
    track = centreline.read_csv(file)
    try:
        fitted = centreline.fit(
            track.xy, closed=closed, widths=(track.width_right, track.width_left)
        )
    except PathError as error:
        raise PathError(f"{file}: {error}") from None
    path, s, keep = fitted.path, fitted.s, fitted.keep
    period = path.length if path.closed else None
    return _Road(
        path=path,
        source=f"{file}, smoothed; the largest shift of a point is {path.largest_shift:.3f} m.",
        vx=None if track.vx is None else (s, track.vx[:keep]),
        wind=Wind()
        if track.wind is None
        else Wind(knots=s, speeds=track.wind[:keep], over="distance", period=period),
    )


def _check_curvature(path: Path, params: VehicleParams, name: str) -> None:
    """Refuse a road tighter than the turning circle of the centre of mass.

    R_min^2 = (L / tan delta_max)^2 + lr^2
    """
    radius = math.hypot(params.wheelbase / math.tan(params.delta_max), params.lr)
    i = int(np.argmax(np.abs(path.kappa)))
    tightest = abs(float(path.kappa[i]))
    if tightest > 1.0 / radius:
        raise PathError(
            f"The road of {name} has a radius of {1.0 / tightest:.2f} m at {path.s[i]:.1f} m, but "
            f"the car cannot turn tighter than {radius:.2f} m."
        )
