"""A car in numbers: what a model file of one is written from, and the short TOML that gives them.

    name = "mine"
    tire = "mine.tir"        # or tire_f and tire_r; without, the packaged car's tires

    [numbers]                # SI units; what is left out is taken from the packaged car
    m = 1420.0
    lf = 1.15
    lr = 1.45
    Cf = 110e3

    [sources]                # for the card: grade (measured, published, computed, fitted, assumed)
    m = "published: the maker's data sheet"

`lpvmpc.plant.vehicle_xml` writes the MJCF.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from lpvmpc.errors import DataError, OptionError
from lpvmpc.kit.files import read_toml, reading

GRADES = ("measured", "published", "computed", "fitted", "assumed")
"""How well a number is known; models/README.md says what each means."""
PARTS = ("name", "title", "tire", "tire_f", "tire_r", "numbers", "sources")
"""What a car.toml may hold."""


def _between(low: float, high: float) -> Any:
    return field(metadata={"low": low, "high": high})


def _asked(low: float, high: float) -> Any:
    return field(default=None, metadata={"low": low, "high": high})


@dataclass(frozen=True, kw_only=True)
class CarNumbers:
    """The numbers of a car, beside the shape of its tires."""

    m: float = _between(200.0, 20000.0)
    """Mass of the whole car [kg]."""
    lf: float = _between(0.3, 5.0)
    """Centre of mass to front axle [m]."""
    lr: float = _between(0.3, 5.0)
    """Centre of mass to rear axle [m]."""
    h: float = _between(0.1, 2.5)
    """Height of the centre of mass over the road, at rest [m]."""
    Ixx: float = _between(20.0, 50000.0)
    """Roll inertia of the whole car, wheels included, about its centre of mass [kg m2]."""
    Iyy: float = _between(50.0, 200000.0)
    """Pitch inertia, the same [kg m2]."""
    Iz: float = _between(50.0, 200000.0)
    """Yaw inertia, the same [kg m2]."""
    track_f: float = _between(0.5, 3.0)
    """Front track [m]."""
    track_r: float = _between(0.5, 3.0)
    """Rear track [m]."""
    length: float = _between(1.0, 15.0)
    """Length of the body [m]."""
    width: float = _between(0.6, 3.5)
    """Width of the body without mirrors [m]."""
    height: float = _between(0.5, 4.5)
    """Height of the body [m]."""
    R0: float = _between(0.1, 0.8)
    """Unloaded radius of a tire [m]; a tire file's own wins."""
    R_w: float = _between(0.1, 0.8)
    """Rolling radius [m]."""
    wheel_mass: float = _between(2.0, 200.0)
    """Mass of a wheel with its tire [kg]."""
    J_w: float = _between(0.02, 50.0)
    """Spin inertia of a wheel [kg m2]."""
    knuckle_f: float = _between(1.0, 200.0)
    """Mass of what moves with a front wheel but does not spin [kg]."""
    knuckle_r: float = _between(1.0, 200.0)
    """The same of a rear wheel [kg]."""
    spring_f: float = _between(3e3, 1e6)
    """Front spring, at the wheel [N/m]."""
    spring_r: float = _between(3e3, 1e6)
    """Rear spring, at the wheel [N/m]."""
    damper_f: float = _between(100.0, 1e5)
    """Front damper, at the wheel [N s/m]."""
    damper_r: float = _between(100.0, 1e5)
    """Rear damper, at the wheel [N s/m]."""
    antiroll_f: float = _between(0.0, 1e6)
    """Front anti-roll bar: force per difference of the wheels' travels [N/m]."""
    antiroll_r: float = _between(0.0, 1e6)
    """The same at the rear [N/m]."""
    tau_delta: float = _between(0.005, 1.0)
    """Time constant of the steering [s]."""
    delta_rate_max: float = _between(0.05, 20.0)
    """Largest rate of the road-wheel angle [rad/s]."""
    delta_max: float = _between(0.1, 1.2)
    """Largest road-wheel angle [rad]."""
    tau_ax: float = _between(0.005, 2.0)
    """Time constant of drive and brakes [s]."""
    drive_torque: float = _between(50.0, 50000.0)
    """Largest torque of the motor at all driven wheels together [N m]."""
    power: float = _between(1e3, 2e6)
    """Largest power [W]."""
    brake_torque: float = _between(500.0, 100000.0)
    """Largest torque of all brakes [N m]."""
    brake_front: float = _between(0.05, 0.95)
    """Share of the brakes on the front axle [-]."""
    drive_front: float = _between(0.0, 1.0)
    """Share of the drive on the front axle [-]: 1 front-driven, 0 rear-driven."""
    rho_air: float = _between(0.0, 2.0)
    """Air density [kg/m3]."""
    CdA: float = _between(0.0, 20.0)
    """Drag area [m2]."""
    CyA: float = _between(0.0, 60.0)
    """Side-wind area [m2]."""
    x_cy: float = _between(-3.0, 3.0)
    """Lever of the side force ahead of the centre of mass [m]."""
    mu_f: float | None = _asked(0.1, 3.0)
    """Lateral peak friction of the front tires at their nominal load [-] (default: the tire's)."""
    mu_r: float | None = _asked(0.1, 3.0)
    """The same of the rear tires [-]."""
    Cf: float | None = _asked(5e3, 5e6)
    """Cornering stiffness of the front axle at static load [N/rad] (default: the tire's)."""
    Cr: float | None = _asked(5e3, 5e6)
    """The same of the rear axle [N/rad]."""
    sigma_f: float | None = _asked(0.05, 3.0)
    """Lateral relaxation length in front at static load [m] (default: the tire's)."""
    sigma_r: float | None = _asked(0.05, 3.0)
    """The same at the rear [m]."""
    trail_f: float | None = _asked(0.0, 0.2)
    """Pneumatic trail in front at static load [m] (default: the tire's)."""
    trail_r: float | None = _asked(0.0, 0.2)
    """The same at the rear [m]."""

    def __post_init__(self) -> None:
        """Refuse what no car has."""
        for one in fields(self):
            value, low, high = getattr(self, one.name), one.metadata["low"], one.metadata["high"]
            if value is None and one.default is None:
                continue
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and low <= value <= high):
                raise OptionError(one.name, value, f"a number from {low:g} to {high:g}")


NAMES = tuple(one.name for one in fields(CarNumbers))
"""Names of the numbers."""


CARRYING = ("spring_f", "spring_r", "damper_f", "damper_r", "antiroll_f", "antiroll_r",
            "drive_torque", "power", "brake_torque")
"""Numbers that grow with the mass of a car, so that it rides, drives and brakes alike."""


@dataclass(frozen=True, kw_only=True)
class CarFile:
    """What a car.toml says."""

    name: str
    """Name of the car."""
    title: str
    """What it is, for the card."""
    numbers: Mapping[str, float]
    """The numbers that it gives."""
    sources: Mapping[str, tuple[str, str]]
    """Grade and source by number."""
    tires: tuple[Path | None, Path | None]
    """Tire files of front and rear; None: the packaged car's tires."""

    def completed(self, base: CarNumbers) -> tuple[CarNumbers, list[str]]:
        """All numbers, and the names of those taken from the base.

        Inertias that are not given follow mass and size: pitch and yaw whichever of the two is
        given, or the wheelbase, and roll the track, with the base's gyration radii. Springs, bars,
        dampers, drive and brakes that are not given are the base's in proportion to the mass.

        Raises:
            OptionError: A number outside its domain.
        """
        given = dict(self.numbers)
        changes: dict[str, Any] = {}
        like = replace(base, **given)
        mass = like.m / base.m
        base_track, track = base.track_f + base.track_r, like.track_f + like.track_r
        long = mass * ((like.lf + like.lr) / (base.lf + base.lr)) ** 2
        for name, other in (("Iyy", "Iz"), ("Iz", "Iyy")):
            scale = float(given[other]) / getattr(base, other) if other in given else long
            changes[name] = getattr(base, name) * scale
        changes["Ixx"] = base.Ixx * mass * (track / base_track) ** 2
        changes |= {name: getattr(base, name) * mass for name in CARRYING}
        if "R0" in given and "R_w" not in given:
            changes["R_w"] = base.R_w / base.R0 * given["R0"]
        tire = ("mu_f", "mu_r", "Cf", "Cr", "sigma_f", "sigma_r", "trail_f", "trail_r")
        changes |= dict.fromkeys(tire)  # those of the tires as they are
        numbers = replace(base, **{**changes, **given})
        defaults = [name for name in NAMES if name not in given and name not in tire]
        return numbers, defaults


def read_car_file(file: str | os.PathLike[str]) -> CarFile:
    """Read a car.toml.

    Args:
        file: The file.

    Raises:
        DataError: It cannot be read, is no TOML, or holds something that no car.toml has.
    """
    path = os.fspath(file)
    with reading(f"Car file {path!r}", "TOML file"):
        content = read_toml(path)
    for key in content:
        if key not in PARTS:
            raise DataError(f"Car file {path!r} holds {key!r}, but may hold only "
                            f"{', '.join(PARTS)}.")
    numbers, sources = content.get("numbers"), content.get("sources", {})
    if not isinstance(numbers, dict) or not numbers:
        raise DataError(f"Car file {path!r} has no table [numbers], such as m = 1420.0.")
    for name, value in numbers.items():
        if name not in NAMES:
            raise DataError(f"Car file {path!r} gives {name!r}, but the numbers of a car are "
                            f"{', '.join(NAMES)}.")
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise DataError(f"Car file {path!r}: {name} is {value!r}, but must be a number.")
    texts = {key: content.get(key, "") for key in ("name", "title", "tire", "tire_f", "tire_r")}
    for key, text in texts.items():
        if not isinstance(text, str):
            raise DataError(f"Car file {path!r}: {key} is {text!r}, but must be a text.")
    folder = Path(path).parent
    return CarFile(
        name=texts["name"] or Path(path).resolve().parent.name,
        title=texts["title"],
        numbers={name: float(value) for name, value in numbers.items()},
        sources=_sources(path, sources),
        tires=tuple(  # type: ignore[arg-type]
            folder / file if (file := texts[key] or texts["tire"]) else None
            for key in ("tire_f", "tire_r")
        ),
    )


def _sources(path: str, sources: Any) -> dict[str, tuple[str, str]]:
    """Grade and source of each number, of `[sources]`."""
    if not isinstance(sources, dict):
        raise DataError(f"Car file {path!r}: [sources] must be a table of texts.")
    found = {}
    for name, text in sources.items():
        grade, colon, source = text.partition(":") if isinstance(text, str) else ("", "", "")
        if grade not in GRADES or not colon:
            raise DataError(
                f"Car file {path!r}: the source of {name} is {text!r}, but must be a grade "
                f"({', '.join(GRADES)}), a colon, and where the number comes from."
            )
        found[str(name)] = grade, source.strip()
    return found
