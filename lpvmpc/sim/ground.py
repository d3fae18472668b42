"""The road under the car: friction of the scenario and of the world, and the world's slopes."""

from __future__ import annotations

import numpy as np

from lpvmpc.plant.plant import Plant
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.surface import PLAIN, Surface


class Ground:
    """Lays the road under a plant, place by place; a plain one costs nothing.

    Friction is that of the scenario along the road times that of the world on each side, under each
    wheel where it is. Slopes are those beside the centre of mass, in the direction of the path,
    held for a control period; see `Plant.tilt` for what that neglects.
    """

    def __init__(self, plant: Plant, scenario: Scenario, surface: Surface) -> None:
        """Args: the car, whose own friction the road's multiplies; scenario and world's road."""
        self.plant, self.surface, self.along = plant, surface, scenario.friction
        self._plain = surface == PLAIN and scenario.friction is None
        self._own = np.array(plant.friction)
        self._friction = np.ones(4)
        length = scenario.path.length
        slopes = surface.grade, surface.bank
        if scenario.path.closed:
            slopes = surface.grade.around(length), surface.bank.around(length)
        self._grade, self._bank = slopes
        self._lap = length if scenario.path.closed else None

    def lay(self, s: float, psi: float) -> None:
        """Put the road of arc length s [m] and heading psi [rad] under the car."""
        if self._plain:
            return
        car, surface, along = self.plant.params, self.surface, self.along
        front, rear = (along(s + car.lf), along(s - car.lr)) if along is not None else (1.0, 1.0)
        if surface.patches:
            front *= self._patch(s + car.lf)
            rear *= self._patch(s - car.lr)
        friction = (front * surface.left, front * surface.right,
                    rear * surface.left, rear * surface.right)
        if (self._friction != friction).any():
            self._friction[:] = friction
            self.plant.friction = self._own * self._friction
        if not surface.level:
            self.plant.tilt(self._grade(s), self._bank(s), psi)

    def _patch(self, s: float) -> float:
        """Factor of the patches at an arc length [m], the same in every lap."""
        return self.surface.patch(s if self._lap is None else s % self._lap)
