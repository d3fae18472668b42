"""What the axles' lateral force does next: cornering-stiffness models of the adaptive controller.

Every model answers the same question: for each step of the horizon, the affine axle forces
Fy = C alpha + F0 around the predicted slip. The paper's secant stiffness has F0 = 0.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from lpvmpc.errors import OptionError
from lpvmpc.vehicle import Array, State, VehicleParams


class StiffnessModel(Protocol):
    """A model of the axles' lateral force along the predicted trajectory."""

    name: str
    """Name of the model in tables and in metrics.json."""

    def reset(self) -> None:
        """Forget everything learned during a run."""

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """Write the affine axle forces along the horizon.

        Args:
            state: The car's state now.
            prediction: Scheduling trajectory, shape (Np + 1, 11), columns as in `bicycle`.
            tires: Receives (Cf [N/rad], F0f [N], Cr, F0r) per step, shape (Np, 4).
        """


class ConstantStiffness:
    """The same cornering stiffness everywhere: Fy = scale C alpha.

    A value somewhat below the tire's own slope is the safe side: a model that is too stiff
    steers too little near saturation and the observer then overreacts.
    """

    name = "constant"

    def __init__(self, car: VehicleParams, scale: float = 1.0) -> None:
        """Args: the car, and the fraction of its nominal axle stiffness to use."""
        if not (np.isfinite(scale) and 0.05 <= scale <= 5.0):
            raise OptionError("stiffness scale", scale, "a number from 0.05 to 5")
        self.tires = np.array([scale * car.Cf, 0.0, scale * car.Cr, 0.0])

    def reset(self) -> None:
        """Nothing to forget."""

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `StiffnessModel.horizon`."""
        tires[:] = self.tires
