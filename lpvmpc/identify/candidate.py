"""A car and how its steering was recorded, as numbers that a fit may change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco

from lpvmpc.car.numbers import CarNumbers
from lpvmpc.errors import OptionError, UnknownNameError
from lpvmpc.identify.follow import Steering
from lpvmpc.identify.single_track import SingleTrack
from lpvmpc.plant.mjcf import compile_text
from lpvmpc.plant.vehicle_xml import numbers_of, tires_of, written
from lpvmpc.units import Array


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number that may be identified."""

    about: str
    """What it is."""
    unit: str
    """Its unit."""
    low: float
    """Least value: of `scale`, added to the start value where `added`, else times it."""
    high: float
    """Largest value, likewise."""
    spread: float
    """How well it is known beforehand, as a standard deviation, of its scale."""
    scale: float = 1.0
    """What counts as a large change, of the start value unless `added`."""
    added: bool = False
    """Whether low and high are absolute."""
    steering: bool = False
    """Whether it belongs to the recording's steering instead of the car."""


PARAMETERS: dict[str, Parameter] = {
    "m": Parameter(about="mass", unit="kg", low=0.4, high=3.0, spread=0.3),
    "lf": Parameter(about="centre of mass to front axle", unit="m", low=0.5, high=1.8, spread=0.25),
    "lr": Parameter(about="centre of mass to rear axle", unit="m", low=0.5, high=1.8, spread=0.25),
    "Iz": Parameter(about="yaw inertia", unit="kg m2", low=0.4, high=2.5, spread=0.3),
    "h": Parameter(about="height of the centre of mass", unit="m", low=0.5, high=1.8, spread=0.3),
    "mu_f": Parameter(
        about="peak friction of the front tires", unit="-", low=0.4, high=2.0, spread=0.2),
    "mu_r": Parameter(
        about="peak friction of the rear tires", unit="-", low=0.4, high=2.0, spread=0.2),
    "Cf": Parameter(
        about="cornering stiffness of the front axle", unit="N/rad", low=0.2, high=5.0, spread=0.6),
    "Cr": Parameter(
        about="cornering stiffness of the rear axle", unit="N/rad", low=0.2, high=5.0, spread=0.6),
    "relaxation": Parameter(
        about="factor on the lateral relaxation lengths", unit="-", low=0.15, high=5.0, spread=0.6),
    "damping": Parameter(
        about="factor on the dampers, which roll feels", unit="-", low=0.2, high=6.0, spread=1.0),
    "steer_lag": Parameter(
        about="time constant of the steering after the recorded angle", unit="s", low=0.0, high=0.3,
        spread=2.0, scale=0.03, added=True, steering=True),
    "steer_offset": Parameter(
        about="road-wheel angle where zero is recorded", unit="rad", low=-0.05, high=0.05,
        spread=2.0, scale=0.005, added=True, steering=True),
    "steer_ratio": Parameter(
        about="road-wheel angle per recorded angle", unit="-", low=0.5, high=2.0, spread=0.2,
        added=True, steering=True),
    "latency": Parameter(
        about="time by which the road wheel is later than recorded", unit="s", low=-0.1, high=0.3,
        spread=2.0, scale=0.03, added=True, steering=True),
}
"""What `--fit` knows."""
FACTORS = ("relaxation", "damping")
"""Those that multiply several numbers of a car."""
IN_SINGLE_TRACK = {
    "linear": ("m", "lf", "lr", "Iz", "Cf", "Cr", "steer_lag", "steer_offset", "steer_ratio",
               "latency"),
    "nonlinear": ("m", "lf", "lr", "Iz", "Cf", "Cr", "mu_f", "mu_r", "steer_lag", "steer_offset",
                  "steer_ratio", "latency"),
}
"""What of that the single tracks have."""


def check_names(names: Sequence[str]) -> None:
    """Refuse parameters that do not exist, or are named twice.

    Raises:
        UnknownNameError: There is no such parameter.
        OptionError: One is named twice.
    """
    for name in names:
        if name not in PARAMETERS:
            raise UnknownNameError("parameter", name, PARAMETERS)
        if list(names).count(name) > 1:
            raise OptionError("--fit", " ".join(names), "parameters named once each")


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A car, with the steering of a recording."""

    numbers: CarNumbers
    """Of the car."""
    tire_f: Array
    """Magic Formula coefficients of the front tires, before the numbers change them."""
    tire_r: Array
    """Those of the rear tires."""
    steering: Steering = Steering()
    """Between the recorded angle and the knuckle."""
    relaxation: float = 1.0
    """Factor on the relaxation lengths, whose numbers stay."""
    damping: float = 1.0
    """Factor on the dampers, whose numbers stay."""

    @classmethod
    def of(cls, model: mujoco.MjModel, steering: Steering | None = None) -> Candidate:
        """A compiled car.

        Raises:
            ModelError: Its tires do not follow the Magic Formula.
        """
        front, rear = tires_of(model)
        return cls(
            numbers=numbers_of(model), tire_f=front, tire_r=rear, steering=steering or Steering()
        )

    def value(self, name: str) -> float:
        """Value of a parameter."""
        if name in FACTORS:
            return float(getattr(self, name))
        if PARAMETERS[name].steering:
            return float(getattr(self.steering, name.removeprefix("steer_")))
        return float(getattr(self.numbers, name))

    def with_values(self, values: Mapping[str, float]) -> Candidate:
        """The same with other values; where the mass changes, roll and pitch inertia follow it.

        Raises:
            OptionError: A number that no car has.
        """
        steering = {
            n.removeprefix("steer_"): v for n, v in values.items() if PARAMETERS[n].steering
        }
        car = {n: float(v) for n, v in values.items()
               if not PARAMETERS[n].steering and n not in FACTORS}
        if "m" in car:
            ratio = car["m"] / self.numbers.m
            car |= {"Ixx": self.numbers.Ixx * ratio, "Iyy": self.numbers.Iyy * ratio}
        if "Iz" in car:  # mass moved along the car turns pitch and yaw alike
            car["Iyy"] = car.get("Iyy", self.numbers.Iyy) + car["Iz"] - self.numbers.Iz
        return replace(
            self, numbers=replace(self.numbers, **car), steering=replace(self.steering, **steering),
            relaxation=values.get("relaxation", self.relaxation),
            damping=values.get("damping", self.damping),
        )

    def car(self) -> CarNumbers:
        """Numbers of the car, the factors in them."""
        n = self.numbers
        assert n.sigma_f is not None and n.sigma_r is not None
        return replace(
            n, sigma_f=n.sigma_f * self.relaxation, sigma_r=n.sigma_r * self.relaxation,
            damper_f=n.damper_f * self.damping, damper_r=n.damper_r * self.damping,
        )

    def xml(self, title: str = "A car", ay_limit: float | None = None) -> str:
        """Its MJCF."""
        return written(self.car(), self.tire_f, self.tire_r, title=title, ay_limit=ay_limit)

    def model(self) -> mujoco.MjModel:
        """Compiled."""
        return compile_text(self.xml())

    def single_track(self) -> SingleTrack:
        """Constants of its single tracks."""
        n = self.numbers
        return SingleTrack(
            n.m, n.Iz, n.lf, n.lr, *(float(v or 0.0) for v in (n.Cf, n.Cr, n.mu_f, n.mu_r))
        )
