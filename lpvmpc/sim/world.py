"""Worlds: all that reality does and the controller is not told, under a name.

A `World` says it as values or as ranges; `sample` draws the numbers of one run, and they are
recorded with it. `load_world` knows the presets and reads a TOML file, in SI units:

    about = "a heavy car on a banked, half wet road"
    base = "rtk"                    # start from a preset (default: ideal)
    latency = [0.0, 0.04]           # of the commands [s]: uniform between the two
    steering_sensor = "servo"       # sits before offset, ratio and play; or at the "wheel"
    patches = [[120.0, 160.0, 0.5]] # other friction from 120 to 160 m of the road: a factor

    [sensing]                       # or sensing = "production"
    base = "rtk"                    # start from these sensors (default: the world's own)
    scale = 2.0                     # times noise, biases and wander of the base
    position = {std = 0.02, rate = 10.0, latency = [0.05, 0.10]}   # fields of sensors.Channel

    [car]                           # fields of plant.deviations.Deviations
    load = [0.0, 450.0]             # kg
    Cr = {mean = 1.0, std = 0.1}    # normal, cut at three standard deviations
    steer_offset = 0.0087           # rad

    [road]
    friction = [0.8, 1.0]           # factors; friction_left, friction_right besides
    bank = [-0.04, 0.04]            # fall to the left per length
    grade = [-0.06, 0.06]           # rise per length
    wavelength = 200.0              # m: bank and grade change so fast; 0: constant in a run

    [air]
    wind_scale = [0.5, 1.5]         # factor on the scenario's wind
    side_wind = [-5.0, 5.0]         # m/s from left to right, added to it
    density = 1.0                   # factor
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.errors import DataError, LPVMPCError, OptionError, UnknownNameError
from lpvmpc.kit.files import read_toml, reading
from lpvmpc.plant.actuation import MAX_LATENCY
from lpvmpc.plant.deviations import NOMINAL, Deviations, named
from lpvmpc.road.surface import PLAIN, Slope, Surface
from lpvmpc.road.wind import Wind
from lpvmpc.sensing.channels import EXACT, PRODUCTION, RTK, Channel, Sensing
from lpvmpc.sim.values import Uniform, Value, draw_of, ends_of, is_number, value_of
from lpvmpc.sim.world_names import WORLD_NAMES

DEG = math.pi / 180.0
KNOTS = 32
"""Slopes drawn for a road; it repeats after this many half wavelengths."""
STEERING_SENSORS = ("wheel", "servo")
"""Where the steering angle may be measured."""
ROAD: dict[str, tuple[float, float, float]] = {
    "friction": (1.0, 0.05, 2.0),
    "friction_left": (1.0, 0.05, 2.0),
    "friction_right": (1.0, 0.05, 2.0),
    "bank": (0.0, -0.3, 0.3),
    "grade": (0.0, -0.3, 0.3),
    "wavelength": (0.0, 0.0, 1e5),
}
"""What a road may have: its default, smallest and largest value."""
AIR: dict[str, tuple[float, float, float]] = {
    "wind_scale": (1.0, 0.0, 10.0),
    "side_wind": (0.0, -40.0, 40.0),
    "density": (1.0, 0.2, 5.0),
}
"""What the air may have, likewise; the density's factor is a deviation."""


@dataclass(frozen=True, kw_only=True)
class Draw:
    """The numbers of one run in a world."""

    name: str = "ideal"
    """The world they were drawn from."""
    sensing: Sensing = EXACT
    """The sensors; what is drawn of them is in `Sensors.drawn`."""
    steering_sensor: str = "wheel"
    """Where the steering angle is measured."""
    latency: float = 0.0
    """Latency of the commands [s]."""
    deviations: Deviations = NOMINAL
    """The car."""
    surface: Surface = PLAIN
    """The road."""
    wind_scale: float = 1.0
    """Factor on the scenario's wind [-]."""
    side_wind: float = 0.0
    """Wind from left to right besides [m/s]."""

    def wind(self, wind: Wind) -> Wind:
        """The wind of a scenario as it is in this world."""
        if self.wind_scale == 1.0 and not self.side_wind:
            return wind
        speeds = self.wind_scale * wind.scale * np.asarray(wind.speeds, dtype=float)
        return replace(wind, speeds=speeds + self.side_wind, scale=1.0)

    def record(self) -> dict[str, Any]:
        """What differs from the ideal world, as plain numbers; empty in it."""
        road = {
            name: getattr(self.surface, name)
            for name in ("friction", "friction_left", "friction_right")
            if getattr(self.surface, name) != 1.0
        }
        if self.surface.patches:
            road["patches"] = [list(patch) for patch in self.surface.patches]
        for name in ("bank", "grade"):
            slope: Slope = getattr(self.surface, name)
            if any(slope.values):
                road[name] = slope.values[0] if len(slope.values) == 1 else list(slope.values)
                if len(slope.values) > 1:
                    road["spacing_m"] = slope.spacing
        air = {"wind_scale": self.wind_scale} if self.wind_scale != 1.0 else {}
        if self.side_wind:
            air["side_wind"] = self.side_wind
        found = {
            "latency": self.latency, "car": self.deviations.record(), "road": road, "air": air,
        }
        return {name: value for name, value in found.items() if value}


@dataclass(frozen=True, kw_only=True)
class World:
    """What reality does. Numbers, pairs and {mean, std} become values and ranges.

    Raises:
        OptionError: A value or an end of a range outside its domain.
        UnknownNameError: A name that car, road or air do not have.
    """

    name: str
    """What to call it in results."""
    about: str = ""
    """One line on it."""
    sensing: Sensing = EXACT
    """The sensors."""
    steering_sensor: str = "wheel"
    """Where the steering angle is measured: at the "wheel", or at the "servo", which believes it
    has no offset, ratio or play."""
    latency: Value = 0.0
    """Time after which a command reaches the car [s]; drawn in whole milliseconds."""
    car: Mapping[str, Value] = field(default_factory=dict)
    """Deviations of the car by their names."""
    road: Mapping[str, Value] = field(default_factory=dict)
    """Deviations of the road, the names in `ROAD`."""
    patches: tuple[tuple[float, float, Value], ...] = ()
    """Stretches of other friction: where each begins and ends [m], and the factor there."""
    air: Mapping[str, Value] = field(default_factory=dict)
    """Deviations of the air, the names in `AIR`."""

    def __post_init__(self) -> None:
        """Turn what was given into values, and check both ends of each."""
        if not isinstance(self.sensing, Sensing):
            raise OptionError("world sensing", self.sensing, "the sensors of a car, a Sensing")
        if self.steering_sensor not in STEERING_SENSORS:
            raise OptionError(
                "world steering_sensor", self.steering_sensor, " or ".join(STEERING_SENSORS)
            )
        latency = value_of("latency", self.latency)
        for end in ends_of(latency):
            if not 0.0 <= end <= MAX_LATENCY:
                raise OptionError("world latency", end, f"from 0 to {MAX_LATENCY:g} s")
        object.__setattr__(self, "latency", latency)
        object.__setattr__(self, "patches", _patches(self.patches))
        for group, domain in (("car", None), ("road", ROAD), ("air", AIR)):
            given = getattr(self, group)
            if not isinstance(given, Mapping):
                raise OptionError(f"world {group}", given, "names with their values")
            values = {name: value_of(f"{group} {name}", value) for name, value in given.items()}
            object.__setattr__(self, group, values)
            if domain is None:
                for i in (0, 1):
                    named({name: ends_of(value)[i] for name, value in values.items()})
                continue
            for name, value in values.items():
                if name not in domain:
                    raise UnknownNameError(f"name in a world's {group}", name, domain)
                _, low, high = domain[name]
                for end in ends_of(value):
                    if not low <= end <= high:
                        raise OptionError(f"world {group} {name}", end, f"from {low:g} to {high:g}")
        if "wavelength" in self.road and not isinstance(self.road["wavelength"], float):
            raise OptionError("world road wavelength", self.road["wavelength"], "one number")

    @property
    def ideal(self) -> bool:
        """Whether nothing at all is different from what the controller is told."""
        return self == replace(IDEAL, name=self.name, about=self.about)

    def sample(self, rng: np.random.Generator) -> Draw:
        """Draw the numbers of one run: the same generator gives the same ones.

        Bank and grade that vary are drawn anew every half wavelength, smooth between.
        """
        latency = draw_of(self.latency, rng)
        car = {name: draw_of(value, rng) for name, value in self.car.items()}
        air = {name: draw_of(self.air.get(name, default), rng)
               for name, (default, _, _) in AIR.items()}
        friction = {name: draw_of(self.road.get(name, 1.0), rng)
                    for name in ROAD if name.startswith("friction")}
        wave = draw_of(self.road.get("wavelength", 0.0), rng)
        slopes = {}
        for name in ("grade", "bank"):
            value = self.road.get(name, 0.0)
            varies = wave > 0.0 and not isinstance(value, float)
            values = tuple(draw_of(value, rng) for _ in range(KNOTS if varies else 1))
            slopes[name] = Slope(values=values, spacing=0.5 * wave if varies else 100.0)
        if air["density"] != 1.0:
            car["air_density"] = air["density"]
        return Draw(
            name=self.name,
            sensing=self.sensing,
            steering_sensor=self.steering_sensor,
            latency=round(latency, 3),
            deviations=named(car),
            surface=Surface(
                friction=friction["friction"],
                friction_left=friction["friction_left"],
                friction_right=friction["friction_right"],
                patches=tuple((a, b, draw_of(value, rng)) for a, b, value in self.patches),
                grade=slopes["grade"],
                bank=slopes["bank"],
            ),
            wind_scale=air["wind_scale"],
            side_wind=air["side_wind"],
        )


def _patches(given: Any) -> tuple[tuple[float, float, Value], ...]:
    """Patches as a world has them, checked."""
    found = []
    for patch in given if isinstance(given, list | tuple) else [given]:
        whole = isinstance(patch, list | tuple) and len(patch) == 3
        if not (whole and all(map(is_number, patch[:2])) and 0.0 <= patch[0] < patch[1]):
            raise OptionError("world patches", patch, "[start, end, factor], 0 <= start < end in m")
        value = value_of("patches", patch[2])
        for end in ends_of(value):
            if not 0.05 <= end <= 2.0:
                raise OptionError("world patches friction", end, "from 0.05 to 2")
        found.append((float(patch[0]), float(patch[1]), value))
    return tuple(found)


FLEET_CAR: dict[str, Value] = {
    "load": Uniform(0.0, 450.0),
    "load_x": Uniform(-0.9, 0.0),
    "load_z": Uniform(0.6, 0.9),
    "Cf": Uniform(0.8, 1.2),
    "Cr": Uniform(0.8, 1.2),
    "mu_f": Uniform(0.9, 1.1),
    "mu_r": Uniform(0.9, 1.1),
    "relaxation": Uniform(0.7, 1.5),
    "steer_lag": Uniform(0.7, 2.0),
    "steer_ratio": Uniform(0.97, 1.03),
    "steer_offset": Uniform(-0.5 * DEG, 0.5 * DEG),
    "steer_play": 0.1 * DEG,
    "drive_lag": Uniform(0.5, 3.0),
    "brake_gain": Uniform(0.85, 1.15),
    "side_area": Uniform(0.7, 2.0),
    "side_lever": Uniform(-0.3, 0.3),
}
"""Cars of one type as they are on the road; sources and grades in docs/worlds.md."""
FLEET_ROAD: dict[str, Value] = {
    "friction": Uniform(0.8, 1.0),
    "bank": Uniform(-0.04, 0.04),
    "grade": Uniform(-0.06, 0.06),
    "wavelength": 200.0,
}
"""Roads as they are built; docs/worlds.md."""

IDEAL = World(name="ideal", about=WORLD_NAMES["ideal"])
WORLDS: dict[str, World] = {
    world.name: world
    for world in (
        IDEAL,
        World(name="rtk", about=WORLD_NAMES["rtk"], sensing=RTK),
        World(
            name="production",
            about=WORLD_NAMES["production"],
            sensing=PRODUCTION,
            latency=Uniform(0.04, 0.08),
        ),
        World(
            name="fleet",
            about=WORLD_NAMES["fleet"],
            sensing=RTK,
            steering_sensor="servo",
            latency=Uniform(0.0, 0.04),
            car=FLEET_CAR,
            road=FLEET_ROAD,
        ),
        World(
            name="fleet-production",
            about=WORLD_NAMES["fleet-production"],
            sensing=PRODUCTION,
            steering_sensor="servo",
            latency=Uniform(0.04, 0.08),
            car=FLEET_CAR,
            road=FLEET_ROAD,
        ),
    )
}
"""The presets by name."""
SENSORS: dict[str, Sensing] = {"exact": EXACT, "rtk": RTK, "production": PRODUCTION}
"""Sets of sensors that a file may name."""


def load_world(world: str | os.PathLike[str] | Mapping[str, Any] | World) -> World:
    """A world by name, from a TOML file, or from what such a file holds.

    Args:
        world: A name of `WORLDS`, a file whose name ends in .toml, a dictionary with the contents
            of one (and a `name`), or a World, which is given back.

    Raises:
        UnknownNameError: No such world, or a name in it that there is not.
        DataError: The file cannot be read, or is no TOML.
        OptionError: A value outside its domain, or sensors from which no state can be observed.
    """
    if isinstance(world, World):
        return world
    if isinstance(world, Mapping):
        return _from_table(world, str(world.get("name", "own")))
    if not isinstance(world, str | os.PathLike):
        raise OptionError("world", world, "a name, a file, a dictionary or a World")
    name = os.fspath(world)
    if name in WORLDS:
        return WORLDS[name]
    if not name.lower().endswith(".toml"):
        raise UnknownNameError("world", name, [*WORLDS, "FILE.toml"])
    with reading(f"The world {name!r}", "TOML file"):
        table = read_toml(name)
    try:
        return _from_table(table, Path(name).stem)
    except LPVMPCError as error:
        raise DataError(f"{name}: {error}") from error


def _from_table(table: Mapping[str, Any], name: str) -> World:
    """A World from the contents of a TOML file."""
    known = [f.name for f in fields(World)]
    for key in table:
        if key not in [*known, "base"]:
            raise UnknownNameError("name in a world", key, [*known, "base"])
    base = _base(table.get("base", "ideal"), WORLDS, "world")
    values = {key: value for key, value in table.items() if key not in ("base", "name")}
    for group in ("car", "road", "air"):
        if isinstance(values.get(group), Mapping):
            values[group] = {**getattr(base, group), **values[group]}
    if "sensing" in values:
        values["sensing"] = _sensing(values["sensing"], base.sensing)
    return replace(base, **{"about": "", **values, "name": name})


def _sensing(given: Any, own: Sensing) -> Sensing:
    """Sensors from a name or a table."""
    if not isinstance(given, Mapping):
        return _base(given, SENSORS, "set of sensors")
    table = dict(given)
    sensing = _base(table.pop("base"), SENSORS, "set of sensors") if "base" in table else own
    scale = table.pop("scale", 1.0)
    if not (is_number(scale) and 0.0 <= scale <= 100.0):
        raise OptionError("world sensing scale", scale, "a factor from 0 to 100")
    if scale != 1.0:
        sensing = sensing.scaled(float(scale))
    known = [f.name for f in fields(Sensing)]
    parts = [f.name for f in fields(Channel)]
    for name, value in table.items():
        if name not in known:
            raise UnknownNameError("name in a world's sensing", name, [*known, "base", "scale"])
        if isinstance(value, Mapping) and isinstance(getattr(sensing, name), Channel):
            for part in value:
                if part not in parts:
                    raise UnknownNameError(f"name in sensing {name}", part, parts)
            table[name] = replace(getattr(sensing, name), **value)
    return replace(sensing, **table)


def _base(name: Any, choices: Mapping[str, Any], kind: str) -> Any:
    if not isinstance(name, str) or name not in choices:
        raise UnknownNameError(kind, str(name), choices)
    return choices[name]


def children(seed: int) -> Iterator[np.random.Generator]:
    """Generators of the world, its sensors and its estimator, apart from the controller's own."""
    for key in (1, 2, 3):
        yield np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(key,)))
