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
from lpvmpc.road import catalogue, centreline, track_file
from lpvmpc.road.catalogue import Road
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
        name_or_csv: A name of `list_scenarios()`, or a file whose name ends in .csv.
        v_max: Top speed [m/s].
        ay_max: Lateral acceleration of the plan [m/s2], whatever the friction.
        grip: The same as a fraction of `params.ay_limit` times `friction`.
        closed: Whether a CSV track goes round (None: if its ends meet); False opens a named
            closed one, to be driven once from its start to its end.
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
    if name in SCENARIOS:
        base = catalogue.build(name)
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
        cones=base.cones(params.width) if base.cones is not None else np.empty((0, 2)),
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


def _from_csv(file: FilePath, closed: bool | None) -> Road:
    """A road from a track file: smoothed points, and its speed and wind where it has them."""
    track = track_file.read_csv(file)
    try:
        fitted = centreline.fit(
            track.xy, closed=closed, widths=(track.width_right, track.width_left)
        )
    except PathError as error:
        raise PathError(f"{file}: {error}") from None
    path, s, keep = fitted.path, fitted.s, fitted.keep
    period = path.length if path.closed else None
    return Road(
        path=path,
        source=f"{file}, smoothed over {fitted.cut_off:.0f} m, which moved its points by up to "
        f"{path.largest_shift:.2f} m.",
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
