"""What is driven: a path, a speed, wind and road friction, under a name.

The named ones are in `catalogue`; a CSV file makes one of your own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import OptionError, PathError, UnknownNameError
from lpvmpc.kit.files import readable
from lpvmpc.road import catalogue, centreline, random_road, track_file
from lpvmpc.road.catalogue import Road
from lpvmpc.road.demand import shortfalls, start_speed_limit
from lpvmpc.road.names import SCENARIOS
from lpvmpc.road.path import Path
from lpvmpc.road.speed_profile import SpeedProfile, plan
from lpvmpc.road.wind import Wind
from lpvmpc.units import Array


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
    cones: Array = field(default_factory=lambda: np.empty((0, 2)))
    """Where cones stand [m], shape (n, 2), for pictures: the car drives through them unharmed."""
    warnings: tuple[str, ...] = ()
    """What a user should know before driving, one sentence each: points that were moved, a
    reference that asks for more than the car has."""

    @property
    def reference_duration(self) -> float:
        """Time that the path, or one lap, takes at the reference speed [s]."""
        return self.speed.duration


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
    smoothing: float | None = None,
    wind_scale: float = 1.0,
    friction: float = 1.0,
    params: VehicleParams,
) -> Scenario:
    """A named scenario, or one from a CSV file.

    Where a scenario comes with its speed (`paper`, a CSV with vx_mps), `v_max` caps it, and
    `ay_max` or `grip` replace it by a planned one. The manoeuvres (`double-lane-change`, `slalom`,
    `skidpad`) are driven at one speed: `v_max`, or less where `ay_max` or `grip` ask for it. All
    other speeds are planned under `v_max`, `ay_max` or `grip`, and the car's drive and brakes.

    Args:
        name_or_csv: A name of `list_scenarios()`, random-NUMBER or hairpin-NUMBER (see
            `random_road`), or a file whose name ends in .csv.
        v_max: Top speed [m/s].
        ay_max: Lateral acceleration of the plan [m/s2], whatever the friction.
        grip: The same as a fraction of `params.ay_limit` times `friction`.
        closed: Whether a CSV track goes round (None: if its ends meet); False opens a named
            closed one, to be driven once from its start to its end.
        smoothing: Cut-off wavelength of the smoothing of a CSV's points [m], 0 for almost none;
            None: as long as it cuts no corner. See `centreline.fit`.
        wind_scale: Factor on the wind speed.
        friction: Scale on the road's peak friction.
        params: The car.

    Raises:
        UnknownNameError: No such scenario.
        OptionError: An option outside its domain, or `ay_max` and `grip` together.
        PathError: A file or a road that cannot be driven.
    """
    _check_options(v_max, ay_max, grip, wind_scale, friction)
    name = str(name_or_csv)
    drawn = random_road.by_name(name)
    if name in SCENARIOS or drawn is not None:
        if smoothing is not None:
            raise OptionError("smoothing", smoothing, f"left out: {name} is made of no points")
        base = catalogue.build(name) if drawn is None else drawn
        path = base.path if closed is None else _with_ends(base.path, closed, name)
    elif isinstance(name_or_csv, FilePath) or name.lower().endswith(".csv") or "/" in name:
        base = _from_csv(FilePath(name_or_csv), closed, smoothing, params)
        path, name = base.path, readable(FilePath(name_or_csv).stem)
    else:
        names = [*SCENARIOS, *(f"{kind}-NUMBER" for kind in random_road.KINDS), "FILE.csv"]
        raise UnknownNameError("scenario", name, names)
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
            speed = speed.capped(v_max)
        limit = None
    elif base.constant:
        tightest = float(np.abs(path.kappa).max())
        bend = math.inf if limit is None else math.sqrt(limit / tightest)
        speed = SpeedProfile.constant(min(v_cap, bend), path)
    else:
        assert limit is not None
        speed = plan(path, params, ay_max=limit, v_max=v_cap)
    scale = None if friction == 1.0 else RoadFriction(scale=float(friction))
    _check_start(path, speed, params, friction, base.vx is not None and given is not None, name)
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
        friction=scale,
        ay_max=limit,
        source=base.source,
        options={
            "v_max": v_max,
            "ay_max": ay_max,
            "grip": grip,
            "closed": path.closed,
            **({} if smoothing is None else {"smoothing": smoothing}),
            "wind_scale": wind_scale,
            "friction": friction,
        },
        cones=base.cones(params.width) if base.cones is not None else np.empty((0, 2)),
        warnings=(*base.warnings, *_too_much(path, speed, params, scale, name, limit)),
    )


def _check_options(
    v_max: float | None, ay_max: float | None, grip: float | None, wind: float, friction: float
) -> None:
    """Refuse options that make no sense in any run."""
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
        width=(path.width_right, path.width_left) if path.has_widths else None,
        largest_shift=path.largest_shift,
    )


def _from_csv(
    file: FilePath, closed: bool | None, smoothing: float | None, params: VehicleParams
) -> Road:
    """A road from a track file: smoothed points, and its speed and wind where it has them."""
    track = track_file.read_csv(file)
    try:
        fitted = centreline.fit(
            track.xy,
            closed=closed,
            smoothing=smoothing,
            widths=(track.width_right, track.width_left),
            radius=turning_radius(params),
        )
        path, s, keep = fitted.path, fitted.s, fitted.keep
        if path.closed and track.vx is not None and track.vx[:keep].min() == 0.0:
            raise PathError("vx_mps is 0 at an end, but a closed road is driven without a stop.")
    except PathError as error:
        raise PathError(f"{file}: {error}") from None
    period = path.length if path.closed else None
    told = readable(file)
    warnings = []
    for i, distance in fitted.bad:
        warnings.append(
            f"Row {i + 1} (line {track.lines[i]}) of {told} lies {distance:.2f} m beside the line "
            "through its neighbours; it is taken for a bad measurement and put onto that line."
        )
    if fitted.moved is not None:
        i, shift = fitted.moved
        warnings.append(
            f"Smoothing over {fitted.cut_off:.3g} m moved row {i + 1} (line {track.lines[i]}) of "
            f"{told} by {shift:.2f} m; the option smoothing sets its length."
        )
    return Road(
        path=path,
        source=f"{told}, smoothed over {fitted.cut_off:.0f} m, which moved its points by up to "
        f"{path.largest_shift:.2f} m.",
        vx=None if track.vx is None else (s, track.vx[:keep]),
        wind=Wind()
        if track.wind is None
        else Wind(knots=s, speeds=track.wind[:keep], over="distance", period=period),
        warnings=tuple(warnings),
    )


def _check_start(
    path: Path, speed: SpeedProfile, params: VehicleParams, friction: float, given: bool, name: str
) -> None:
    """Refuse a first speed that the car cannot hold: it would have no state to start from."""
    fastest = start_speed_limit(float(path.kappa[0]), params, friction)
    if speed.start > fastest:
        what = "vx_mps of row 1" if given else "the speed at the start"
        raise PathError(
            f"The road of {name} cannot be driven from its start: {what} is {speed.start:.4g} m/s, "
            f"but the car can hold at most {fastest:.4g} m/s there; the option v_max caps it."
        )


def _too_much(
    path: Path,
    speed: SpeedProfile,
    params: VehicleParams,
    friction: RoadFriction | None,
    name: str,
    limit: float | None,
) -> list[str]:
    """A sentence where the reference asks for more than car and road have."""
    found = shortfalls(path, speed, params, friction)
    if not found:
        return []
    kind = "reference" if limit is None else "planned"
    on = "" if friction is None else f" at a friction of {friction.scale:g}"
    hint = "" if limit is None else "; with the option grip a plan follows the friction"
    return [
        f"The {kind} speed of {name} asks for more than the car has{on}: "
        f"{', and '.join(str(one) for one in found)}{hint}."
    ]


def turning_radius(params: VehicleParams) -> float:
    """Radius of the smallest circle that the centre of mass can drive [m].

    R_min^2 = (L / tan delta_max)^2 + lr^2
    """
    return math.hypot(params.wheelbase / math.tan(params.delta_max), params.lr)


def _check_curvature(path: Path, params: VehicleParams, name: str) -> None:
    """Refuse a road tighter than the turning circle of the centre of mass."""
    radius = turning_radius(params)
    i = int(np.argmax(np.abs(path.kappa)))
    tightest = abs(float(path.kappa[i]))
    if tightest > 1.0 / radius:
        raise PathError(
            f"The road of {name} has a radius of {1.0 / tightest:.2f} m at {path.s[i]:.1f} m, but "
            f"the car cannot turn tighter than {radius:.2f} m."
        )
