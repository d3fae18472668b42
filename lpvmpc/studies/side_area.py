"""A real hatchback in the wind: its side area, and the roll moment of the air.

The documented car has the side-wind area of the paper's authors, 1.5 m2, and its side force acts at
the height of the centre of mass. A Zoe is 4.08 m long and 1.56 m high; its silhouette fills some
77 % of that rectangle (wheels, ground clearance, screens), 4.9 m2, and a car broadside to the wind
has a side-force coefficient of about 0.75. That makes 3.7 m2, with the centre of pressure at half
the car's height. Both are estimates, here to tell how much the authors' area matters.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from lpvmpc.car.aero import aero_wrench
from lpvmpc.interface import Command, State
from lpvmpc.plant.deviations import Deviations
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.study import CarUnderTest

AREA = 3.7
"""Side-wind area of a hatchback of a Zoe's size [m2]: estimated, see above."""
HEIGHT = 0.78
"""Height of the centre of pressure above the road [m]: half of the car's 1.56 m."""


class TopHeavyWind(Plant):
    """The wind's side force acts higher than the centre of mass, and so rolls the body.

    M = (height - h) Fy about the car's axis, with Fy at the beginning of the control period.
    """

    def step(self, command: Command, wind: tuple[float, float] = (0.0, 0.0)) -> State:
        """See Plant."""
        s, p = self.state, self._actual
        cos, sin = math.cos(s.psi), math.sin(s.psi)
        u = s.vx - (wind[0] * cos + wind[1] * sin)
        v = s.vy - (wind[1] * cos - wind[0] * sin)
        Fy = float(aero_wrench(u, v, p.rho_air, p.CdA, p.CyA, p.x_cy)[1])
        moment = -(HEIGHT - p.h) * Fy  # about the forward axis: a force to the left lifts the left
        chassis = self.model.body("chassis").id
        self.data.xfrc_applied[chassis, 3:] = moment * cos, moment * sin, 0.0
        return super().step(command, wind)


def real(car: CarUnderTest, *, roll: bool) -> CarUnderTest:
    """The same car with a real hatchback's side area.

    Args:
        car: The car.
        roll: Whether the side force acts at `HEIGHT`, so that the air rolls the body as well.
    """
    base: Any = car.plant_class
    parents = (TopHeavyWind, base) if roll and base is not Plant else (
        (TopHeavyWind,) if roll else (base,))
    factor = AREA / car.params.CyA

    def start(self: Any, *args: Any, **options: Any) -> None:
        parents[0].__init__(self, *args, **options)
        self.deviations = Deviations(side_area=factor)

    plant_class = type("RealSide", parents, {"__init__": start, "__doc__": real.__doc__})
    return replace(car, plant_class=plant_class)
