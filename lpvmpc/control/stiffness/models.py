"""What the axles' lateral force does next: cornering-stiffness models of the adaptive controller.

Every model answers the same question: for each step of the horizon, the affine axle forces
Fy = C alpha + F0 around the predicted slip. The paper's secant stiffness has F0 = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numba import njit

from lpvmpc.car.axle import Axle, axles, tangent
from lpvmpc.car.bicycle import AF, AR, PHI, A
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import Tire
from lpvmpc.control.stiffness.adaptation import CF, CR, MU, TireAdaptation
from lpvmpc.errors import OptionError
from lpvmpc.interface import AxleForces, State
from lpvmpc.units import Array

if TYPE_CHECKING:
    from lpvmpc.control.stiffness.network_file import Weights as NetworkWeights

C_MIN = 0.05
"""Smallest slope of an axle's force as a fraction of the nominal one: past the tire's peak the
true slope is negative, and a controller must not learn to steer the other way."""


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
            prediction: Scheduling trajectory at the ends of n intervals of the horizon,
                shape (n + 1, 11), columns as in `bicycle`.
            tires: Receives (Cf [N/rad], F0f [N], Cr, F0r) per interval, shape (n, 4).
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


class OracleStiffness:
    """Tangent to the plant's own tire law along the prediction, with the road's true friction."""

    name = "oracle"

    def __init__(self, car: VehicleParams, tires: tuple[Tire, Tire]) -> None:
        """Args: the car, and its front and rear tires."""
        self.car = car
        self.front, self.rear = axles(car, *tires)
        self.reset()

    def reset(self) -> None:
        """Forget the road."""
        self.friction = 1.0

    def observe(self, axle_forces: AxleForces) -> None:
        """Told by the simulation: the road's friction."""
        self.friction = axle_forces.mu / self.car.mu

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `StiffnessModel.horizon`."""
        slopes = (C_MIN * self.car.Cf, C_MIN * self.car.Cr)
        _tangents(self.front, self.rear, prediction, self.friction, slopes, tires)


class SecantOracle:
    """True force over slip angle of each axle now, held over the horizon: the paper's labels."""

    name = "oracle-secant"

    def __init__(self, car: VehicleParams) -> None:
        """Args: the car."""
        self.car = car
        self.reset()

    def reset(self) -> None:
        """Forget the forces."""
        self._forces = (0.0, 0.0)

    def observe(self, axle_forces: AxleForces) -> None:
        """Told by the simulation: the axles' lateral forces."""
        self._forces = (axle_forces.Fyf, axle_forces.Fyr)

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `StiffnessModel.horizon`."""
        car = self.car
        tires[:, 0] = secant(self._forces[0], prediction[0, AF], car.Cf)
        tires[:, 2] = secant(self._forces[1], prediction[0, AR], car.Cr)
        tires[:, [1, 3]] = 0.0


class NetworkStiffness:
    """Tangent to the learned axle forces along the prediction, road friction estimated online."""

    name = "network"

    def __init__(
        self, car: VehicleParams, weights: NetworkWeights | None = None, Ts: float = 0.033
    ) -> None:
        """Args: the car, trained weights (default: the shipped ones), the control period [s]."""
        from lpvmpc.control.stiffness.network import NetworkTire

        self.car = car
        self.tire = NetworkTire(car, weights, Ts=Ts)
        self.adaptation = TireAdaptation(car, Ts)
        self.reset()

    def reset(self) -> None:
        """Forget the road."""
        self.tire.reset()
        self.adaptation.reset()

    @property
    def friction(self) -> float:
        """Estimated scale of the road's friction [-]."""
        return float(self.adaptation.estimate[MU])

    @property
    def clamped(self) -> int:
        """Number of the network's inputs that lay outside the trained range since the reset."""
        return self.tire.clamped

    def learn(
        self, unmodelled: Array, axle_forces: Array, slips: Array, a: float, ay: float
    ) -> None:
        """Told by the controller what the tires mispredicted, and what they did.

        Args:
            unmodelled: Unexplained acceleration of (vy, r), shape (2,).
            axle_forces: Affine forces (Cf, F0f, Cr, F0r) that it was predicted with, shape (4,).
            slips: Slip angles of the axles [rad], shape (2,).
            a: Drive or brake acceleration [m/s2].
            ay: Lateral acceleration [m/s2].
        """
        self.adaptation.update(unmodelled, axle_forces, slips, a, ay)

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `StiffnessModel.horizon`."""
        learned = self.adaptation.estimate
        self.tire.friction = float(learned[MU])
        self.tire.scales = float(learned[CF]), float(learned[CR])
        self.tire.horizon(state, prediction, tires)


class DryNetwork(NetworkStiffness):
    """The same network on a road that is taken to be dry: what estimating friction is worth."""

    name = "network-dry"
    learn = None  # type: ignore[assignment]


SECANT_SLIP = 0.01
"""Slip angle below which a secant is mostly the nominal slope [rad]."""


def secant(force: float, alpha: float, C: float) -> float:
    """Force over slip angle, blended into the nominal slope where the angle is too small.

    (Fy alpha + C e^2) / (alpha^2 + e^2) with e = `SECANT_SLIP`: continuous, and C at rest.
    """
    e2 = SECANT_SLIP**2
    value = (force * alpha + C * e2) / (alpha * alpha + e2)
    return min(max(value, C_MIN * C), 1.5 * C)


@njit(cache=True)
def _tangents(front: Axle, rear: Axle, prediction, friction, C_min, tires):
    """Tangents in the middle of each interval of the prediction, in place."""
    for k in range(tires.shape[0]):
        alpha_f = 0.5 * (prediction[k, AF] + prediction[k + 1, AF])
        alpha_r = 0.5 * (prediction[k, AR] + prediction[k + 1, AR])
        phi = 0.5 * (prediction[k, PHI] + prediction[k + 1, PHI])
        a = 0.5 * (prediction[k, A] + prediction[k + 1, A])
        tires[k, 0], tires[k, 1] = tangent(front, alpha_f, phi, a, friction, C_min[0])
        tires[k, 2], tires[k, 3] = tangent(rear, alpha_r, phi, a, friction, C_min[1])
