"""A stiffness model made wrong on purpose: what does the controller do with bad knowledge?"""

from __future__ import annotations

from typing import Any

import numpy as np

from lpvmpc.control.stiffness.models import StiffnessModel
from lpvmpc.errors import OptionError
from lpvmpc.interface import State
from lpvmpc.units import Array

FACTOR_MIN = 0.05
"""Least factor on an axle's force, however unlucky the draw: a force of the wrong sign, or none,
is no tire."""


class PerturbedStiffness:
    """Another model whose axle forces are all wrong by a factor, drawn anew every period.

    Fy = f (C alpha + F0),   f = scale (1 + noise N(0, 1)), of each axle

    Slope and offset alike: the force is wrong at the operating point too, as it is for a model of
    other tires. What the other model is told (`observe`, `learn`) and asked (`friction`) is passed
    on.
    """

    def __init__(
        self, model: StiffnessModel, *, scale: float = 1.0, noise: float = 0.0, seed: int = 0
    ) -> None:
        """Wrap a model.

        Args:
            model: The model.
            scale: Constant factor, 0.05 to 5.
            noise: Standard deviation of what changes every period, as a fraction, 0 to 1.
            seed: Seed of the noise; every run begins with it anew.

        Raises:
            OptionError: A number outside its domain.
        """
        for name, value, low, high in (
            ("stiffness scale", scale, FACTOR_MIN, 5.0), ("stiffness noise", noise, 0.0, 1.0),
        ):
            if not low <= value <= high:  # NaN fails it too
                raise OptionError(name, value, f"a number from {low:g} to {high:g}")
        if type(seed) is not int or seed < 0:
            raise OptionError("stiffness seed", seed, "a whole number from 0")
        self.model, self.scale, self.noise, self.seed = model, scale, noise, seed
        self.name = model.name + (f" x{scale:g}" if scale != 1.0 else "")
        if noise:
            self.name += f", {100.0 * noise:g} % noise"
        self._random = np.random.default_rng(seed)

    def __getattr__(self, name: str) -> Any:  # what a model may or may not have
        if name == "model":  # not there yet, while a copy is being made
            raise AttributeError(name)
        return getattr(self.model, name)

    def reset(self) -> None:
        """Forget the run so far."""
        self.model.reset()
        self._random = np.random.default_rng(self.seed)

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `StiffnessModel.horizon`."""
        self.model.horizon(state, prediction, tires)
        draw = self._random.standard_normal(2) if self.noise else np.zeros(2)
        factor = np.maximum(self.scale * (1.0 + self.noise * draw), FACTOR_MIN)
        tires *= factor[[0, 0, 1, 1]]
