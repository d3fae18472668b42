"""Path tracking by geometry: pure pursuit and the Stanley law, each with a PID for the speed.

Neither predicts anything: a known delay of the commands is not compensated, and side wind is met
with a lateral offset. Both are here so that a reader can place the other results.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.pid import PIDGains, SpeedPID
from lpvmpc.control.tracker import checked_delay
from lpvmpc.control.weights_file import chosen
from lpvmpc.errors import OptionError
from lpvmpc.interface import Command, Preview, State

PREVIEW_STEPS = 60
"""Control periods of preview, 2 s: as far as a lookahead or the front axle may reach."""

WeightsT = TypeVar("WeightsT", bound=PIDGains)


class Geometric(Generic[WeightsT]):
    """What both share: speed by PID, commands within the car's bounds, a hold for bad data."""

    name: str
    Ts = 0.033
    """Control period [s]."""
    preview_steps = PREVIEW_STEPS
    weights: WeightsT

    def __init__(self, car: VehicleParams, weights: WeightsT, delay: int) -> None:
        """Args: the car, weights, delay (not compensated) [periods]."""
        checked_delay(delay)
        self.car = car
        self.weights = weights
        self.pid = SpeedPID(self.car, weights, self.Ts)
        self._last = Command(0.0, 0.0)

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        self.pid.reset()
        self._last = Command(0.0, 0.0)

    def command(self, state: State, preview: Preview) -> Command:
        """Command of one control period.

        Args:
            state: The car's state now; the last command is held while it is not finite.
            preview: Reference along the road ahead, `preview_steps` periods.

        Returns:
            Steering angle [rad] and acceleration [m/s2], within the bounds of the car.
        """
        delta = self.steer(state, preview)
        if math.isfinite(delta + state.vx):  # the PID would remember what is no number
            limit = self.car.delta_max
            ax = self.pid.command(state.vx, preview.vx_ref[0])
            self._last = Command(min(max(delta, -limit), limit), float(ax))
        return self._last

    def steer(self, state: State, preview: Preview) -> float:
        """Steering angle before the bounds [rad]."""
        raise NotImplementedError


# Pure pursuit -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class PurePursuitWeights(PIDGains):
    """Everything of `PurePursuit` that is tuned."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "lookahead_time": (0.05, 1.5),
        "lookahead_min": (0.5, 15.0),
        **PIDGains.RANGES,
    }
    """Where tuning searches: from lookaheads too short to be stable to some that cut bends."""

    lookahead_time: float = 0.3
    """Lookahead distance per speed [s]."""
    lookahead_min: float = 3.0
    """Smallest lookahead distance [m]."""

    def __post_init__(self) -> None:
        """Refuse what is no weight."""
        super().__post_init__()
        if self.lookahead_min <= 0.0:
            raise OptionError("weight lookahead_min", self.lookahead_min, "a number above 0")


def pursuit_angle(forward: float, left: float, wheelbase: float) -> float:
    """Steering angle whose circle leads the rear axle through a point.

    delta = atan(2 L sin(alpha) / ld) = atan(2 L left / ld^2),   ld^2 = forward^2 + left^2

    Args:
        forward: Distance of the point ahead of the rear axle, along the car [m].
        left: Distance to its left [m].
        wheelbase: L, the distance between the axles [m].

    Returns:
        Road-wheel angle [rad], left positive.

    Source: Coulter, Implementation of the pure pursuit path tracking algorithm, CMU-RI-TR-92-01.
    """
    return math.atan2(2.0 * wheelbase * left, forward * forward + left * left)


class PurePursuit(Geometric[PurePursuitWeights]):
    """Steers the rear axle along the circle through a point of the path ahead.

    The point lies at the distance ld = max(lookahead_min, lookahead_time vx) from the rear axle;
    where the preview ends before, its last point is pursued. Without slip in the law, the car of
    this package drives bends on their outside, by millimetres to decimetres.
    """

    name = "pure-pursuit"

    def __init__(
        self,
        car: VehicleParams,
        *,
        weights: PurePursuitWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters; the packaged car by default.
            weights: Lookahead and gains, or some of them by name; the shipped by default.
            delay: Accepted like every controller's, and not compensated.

        Raises:
            OptionError: A value outside its domain.
        """
        super().__init__(car, chosen(self.name, weights, PurePursuitWeights()), delay)

    def steer(self, state: State, preview: Preview) -> float:
        """Steering angle before the bounds [rad]."""
        cos, sin, lr = math.cos(state.psi), math.sin(state.psi), self.car.lr
        dx, dy = preview.x - (state.x - lr * cos), preview.y - (state.y - lr * sin)
        distance = np.hypot(dx, dy)
        ld = max(self.weights.lookahead_min, self.weights.lookahead_time * state.vx)
        beyond = distance >= ld
        k = int(np.argmax(beyond)) if beyond.any() else len(distance) - 1
        x, y = dx[k], dy[k]
        if k > 0 and distance[k] > ld:  # between two points, straight: the sagitta is below 1 mm
            share = (ld - distance[k - 1]) / (distance[k] - distance[k - 1])
            x, y = dx[k - 1] + share * (x - dx[k - 1]), dy[k - 1] + share * (y - dy[k - 1])
        return pursuit_angle(cos * x + sin * y, cos * y - sin * x, self.car.wheelbase)


# Stanley ----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class StanleyWeights(PIDGains):
    """Everything of `Stanley` that is tuned."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "k_e": (0.2, 100.0),
        "softening": (0.03, 100.0),
        "yaw_damping": (0.005, 0.5),
        "slip_share": (0.05, 3.0),
        **PIDGains.RANGES,
    }
    """Where tuning searches: wide enough that no optimum lies on a bound."""

    k_e: float = 6.0
    """Gain of the front axle's lateral error [1/s]: the error decays at this rate."""
    softening: float = 1.0
    """Speed added in the law so that it stays calm when slow [m/s]; 0 for none."""
    yaw_damping: float = 0.15
    """Steering per yaw rate against the path's [s]; 0 for none."""
    slip_share: float = 1.0
    """Share of the steady front slip that is steered in advance [-]; 0 for none."""


def stanley_angle(
    heading: float, error: float, vx: float, yaw: float, slip: float, weights: StanleyWeights
) -> float:
    """The Stanley steering law.

    delta = -(psi_e - slip_share slip) - atan(k_e e / (softening + vx)) - yaw_damping (r - r_path)

    Args:
        heading: psi_e, heading of the car against the path at the front axle, left positive [rad].
        error: e, offset of the front axle to the left of the path [m].
        vx: Speed [m/s].
        yaw: r - r_path, yaw rate of the car less the path's [rad/s].
        slip: Steady slip of the front tires on the path's curvature [rad].
        weights: Gains.

    Returns:
        Road-wheel angle [rad], left positive.

    Source: Hoffmann, Tomlin, Montemerlo, Thrun, Autonomous automobile trajectory tracking for
    off-road driving, ACC 2007; their damping of the servo is left out, since this one is fast.
    """
    w = weights
    approach = math.atan2(w.k_e * error, w.softening + max(vx, 0.0))
    return w.slip_share * slip - heading - approach - w.yaw_damping * yaw


class Stanley(Geometric[StanleyWeights]):
    """Steers the front wheels along the path at the front axle, and towards it."""

    name = "stanley"

    def __init__(
        self,
        car: VehicleParams,
        *,
        weights: StanleyWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters; the packaged car by default.
            weights: Gains, or some of them by name; the shipped by default.
            delay: Accepted like every controller's, and not compensated.

        Raises:
            OptionError: A value outside its domain.
        """
        super().__init__(car, chosen(self.name, weights, StanleyWeights()), delay)
        # alpha_f = Fyf / Cf with Fyf = m lr / L ay, the front axle's share of the force in a bend
        self._slip_per_ay = self.car.m * self.car.lr / (self.car.wheelbase * self.car.Cf)

    def steer(self, state: State, preview: Preview) -> float:
        """Steering angle before the bounds [rad]."""
        x = state.x + self.car.lf * math.cos(state.psi)
        y = state.y + self.car.lf * math.sin(state.psi)
        error, psi, kappa = path_at(preview, x, y)
        r_path = kappa * state.vx
        heading = math.remainder(state.psi - psi, math.tau)
        slip = self._slip_per_ay * r_path * state.vx
        return stanley_angle(heading, error, state.vx, state.r - r_path, slip, self.weights)


def path_at(preview: Preview, x: float, y: float) -> tuple[float, float, float]:
    """The previewed path beside a point.

    Between two previewed points the path is taken as straight: they are less than a metre apart,
    and in bends closer, so that the sagitta stays below a millimetre.

    Args:
        preview: The road ahead.
        x: Point [m].
        y: Point [m].

    Returns:
        Offset of the point from the path's tangent, left positive [m]; heading of the path [rad];
        its curvature [1/m].
    """
    dx, dy = np.diff(preview.x), np.diff(preview.y)
    to_x, to_y = x - preview.x[:-1], y - preview.y[:-1]
    length2 = np.maximum(dx * dx + dy * dy, 1e-12)  # a reference that stands repeats its points
    share = np.clip((to_x * dx + to_y * dy) / length2, 0.0, 1.0)
    off_x, off_y = to_x - share * dx, to_y - share * dy
    k = int(np.argmin(off_x * off_x + off_y * off_y))
    t = share[k]
    psi = preview.psi[k] + t * (preview.psi[k + 1] - preview.psi[k])
    kappa = preview.kappa[k] + t * (preview.kappa[k + 1] - preview.kappa[k])
    error = math.cos(psi) * off_y[k] - math.sin(psi) * off_x[k]
    return float(error), float(psi), float(kappa)
