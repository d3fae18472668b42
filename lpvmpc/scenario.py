"""What is driven: a path, a speed, wind and road friction, under a name."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from lpvmpc.errors import UnknownNameError
from lpvmpc.path import Path
from lpvmpc.speed_profile import SpeedProfile
from lpvmpc.wind import Wind


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A road, how fast to drive it, and what disturbs the car on it."""

    name: str
    path: Path
    speed: SpeedProfile
    wind: Wind = Wind()
    source: str = ""

    @property
    def reference_duration(self) -> float:
        """Time that the path takes at the reference speed [s]."""
        return self.speed.duration


@cache
def _data(name: str) -> dict[str, Any]:
    """A JSON file of the package's data folder."""
    return json.loads((resources.files("lpvmpc") / "data" / f"{name}.json").read_text("utf-8"))


def load_scenario(name: str, *, wind_scale: float = 1.0) -> Scenario:
    """First version: the paper's scenario only."""
    if name != "paper":
        raise UnknownNameError("scenario", name, ["paper"])
    data = _data("paper")
    path = Path.from_curvature(data["kappa_radpm"], data["kappa_ds_m"])
    knots = [data["vx_ds_m"] * i for i in range(len(data["vx_mps"]))]
    speed = SpeedProfile.from_knots(knots, data["vx_mps"], path)
    times = [data["wind_dt_s"] * i for i in range(len(data["wind_mps"]))]
    wind = Wind(knots=times, speeds=data["wind_mps"], scale=wind_scale)
    return Scenario(name=name, path=path, speed=speed, wind=wind, source=data["source"])
