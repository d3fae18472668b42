"""Path tracking by geometry: pure pursuit and the Stanley law, each with a PID for the speed.

Side wind is met with a lateral offset. A known delay of the commands is met by asking the law where
the car will be when they arrive, and a car far beside its path is led back to it, as by `lpv-mpc`.
Both are here so that a reader can place the other results.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.period import BACK, NEAR
from lpvmpc.control.pid import PIDGains, ProtectedPID
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
        """Args: the car, weights, known delay [periods]."""
        self.delay = checked_delay(delay)
        """Known delay between command and effect [periods]."""
        self.preview_steps = PREVIEW_STEPS + delay
        self.car = car
        self.weights = weights
        self.pid = ProtectedPID(car, weights, self.Ts, delay)
        # the steady single track: r = vx delta / (L + K vx^2), vy = r (lr - m lf vx^2 / (L Cr))
        L = car.wheelbase
        self._understeer = car.m / L * (car.lr / car.Cf - car.lf / car.Cr)
        self._drift = car.m * car.lf / (L * car.Cr)
        self._lag = -math.expm1(-self.Ts / car.tau_delta)
        self.reset(np.random.default_rng(0))

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        self.pid.reset()
        self._last = Command(0.0, 0.0)
        self._sent: list[float] | None = None

    def command(self, state: State, preview: Preview) -> Command:
        """Command of one control period.

        Args:
            state: The car's state now; the last command is held while it is not finite.
            preview: Reference along the road ahead, at least `preview_steps` periods.

        Returns:
            Steering angle [rad] and acceleration [m/s2], within the bounds of the car.
        """
        seen = self._ahead(state) if self.delay else state
        delta = self.steer(seen, preview)
        if math.isfinite(delta + state.vx):  # the PID would remember what is no number
            limit = self.car.delta_max
            ax = self.pid.command(state, preview.vx_ref)
            self._last = Command(min(max(delta, -limit), limit), float(ax))
        if self._sent is not None:
            self._sent = [*self._sent[1:], self._last.delta]
        return self._last

    def _ahead(self, state: State) -> State:
        """Where the steady single track is when this period's command arrives."""
        if self._sent is None:  # until now the steering was held
            self._sent = [state.delta] * self.delay
        x, y, psi, vx = state.x, state.y, state.psi, state.vx
        vy, r, angle = 0.0, 0.0, state.delta
        steady = vx / (self.car.wheelbase + self._understeer * vx * vx)
        for delta in self._sent:
            angle += self._lag * (delta - angle)
            r = steady * angle
            vy = r * (self.car.lr - self._drift * vx * vx)
            middle = psi + 0.5 * self.Ts * r
            x += self.Ts * (vx * math.cos(middle) - vy * math.sin(middle))
            y += self.Ts * (vx * math.sin(middle) + vy * math.cos(middle))
            psi += self.Ts * r
        return state._replace(x=x, y=y, psi=psi, vy=vy, r=r, delta=angle)

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
        "understeer_share": (0.05, 3.0),
        **PIDGains.RANGES,
    }
    """Where tuning searches: from lookaheads too short to be stable to some that cut bends."""

    lookahead_time: float = 0.3
    """Lookahead distance per speed [s]."""
    lookahead_min: float = 3.0
    """Smallest lookahead distance [m]."""
    understeer_share: float = 0.0
    """Share of the steady understeer that is steered in addition [-]; 0 for none, as published."""

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
            delay: Known delay between command and effect [periods], compensated by prediction.

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
        if self.delay:  # what lies behind the car that is looked from
            beyond[: int(np.argmin(distance))] = False
        k = int(np.argmax(beyond)) if beyond.any() else len(distance) - 1
        x, y = dx[k], dy[k]
        if k > 0 and distance[k] > ld:  # between two points, straight: the sagitta is below 1 mm
            share = (ld - distance[k - 1]) / (distance[k] - distance[k - 1])
            x, y = dx[k - 1] + share * (x - dx[k - 1]), dy[k - 1] + share * (y - dy[k - 1])
        aside, _ = led_back(path_at(preview, state.x, state.y)[0], state.vx)
        if aside:
            aside *= math.exp(-ld / (BACK * max(state.vx, self.car.vx_min)))
            x, y = x - aside * math.sin(preview.psi[k]), y + aside * math.cos(preview.psi[k])
        L = self.car.wheelbase
        angle = pursuit_angle(cos * x + sin * y, cos * y - sin * x, L)
        understeer = self.weights.understeer_share * self._understeer * state.vx * state.vx
        return angle + understeer * math.tan(angle) / L


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
            delay: Known delay between command and effect [periods], compensated by prediction.

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
        aside, towards = led_back(error, state.vx)
        return stanley_angle(
            heading - towards, error - aside, state.vx, state.r - r_path, slip, self.weights
        )


def led_back(error: float, vx: float) -> tuple[float, float]:
    """How a car that is further than `NEAR` beside its path is led back, not pulled.

    Args:
        error: Its offset to the left [m].
        vx: Its speed [m/s].

    Returns:
        Offset [m] and heading against the path [rad] that it is to have: they bring it to `NEAR`
        with the time constant `BACK`; 0, 0 for a car that is near.
    """
    aside = math.copysign(max(abs(error) - NEAR, 0.0), error)
    return aside, -math.atan(aside / BACK / max(vx, 1.0))


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
