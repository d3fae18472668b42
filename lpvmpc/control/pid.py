"""The speed beside a lateral controller: a discrete PID, and what protects the wheels from it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.control import traction
from lpvmpc.control.weights_file import check_weights
from lpvmpc.interface import State

DERIVATIVE_LAG = 0.05
"""Time constant of the derivative's filter [s], that of drive and brake."""


@dataclass(frozen=True, kw_only=True)
class PIDGains:
    """Gains of `SpeedPID`; the weights of a controller that has one add their own to them."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "kp": (0.2, 60.0),
        "ki": (0.05, 200.0),
        "kd": (0.005, 2.0),
    }
    """Where tuning searches: up to gains that make the speed oscillate at 33 ms, so that no optimum
    lies on a bound."""

    kp: float = 6.0
    """Acceleration per speed error [1/s]."""
    ki: float = 6.0
    """Acceleration per integrated speed error [1/s2]."""
    kd: float = 0.2
    """Acceleration per rate of the speed error [-]."""

    def __post_init__(self) -> None:
        """Refuse what is no gain, in the fields of a subclass as well."""
        check_weights(self)


class SpeedPID:
    """Discrete PID on the speed error e = vx_ref - vx, held within what the car can do.

    ax_k = kp e_k + I_k + kd D_k,   I_{k+1} = I_k + ki Ts e_k
    D_k = D_{k-1} + Ts / (lag + Ts) ((e_k - e_{k-1}) / Ts - D_{k-1})

    The derivative is that of the error, not of the measurement: the reference is a smooth profile
    without steps, and its slope is worth knowing. It is filtered with `DERIVATIVE_LAG`. Wind-up is
    prevented by not integrating while the output is at a bound and the error pushes against it.
    There is no feed-forward, as in the paper.

    Source: Astrom and Hagglund, Advanced PID Control, sections 3.3 (filtered derivative) and 3.5
    (conditional integration).
    """

    def __init__(self, car: VehicleParams, gains: PIDGains, Ts: float) -> None:
        """Args: the car, for its drive and brake bounds; the gains; the control period [s]."""
        self.car, self.gains, self.Ts = car, gains, Ts
        self.reset()

    def reset(self) -> None:
        """Forget the run so far."""
        self._integral = self._slope = 0.0
        self._error: float | None = None

    def command(
        self, vx: float, vx_ref: float, least: float = -math.inf, most: float = math.inf
    ) -> float:
        """Acceleration of one control period.

        Args:
            vx: Measured speed [m/s].
            vx_ref: Reference speed now [m/s].
            least: Narrower bounds than the car's [m/s2], of what protects its wheels.
            most: As above.

        Returns:
            Acceleration before resistances [m/s2], within the bounds of brakes and drive.
        """
        g, Ts = self.gains, self.Ts
        error = vx_ref - vx
        if self._error is not None:
            rate = (error - self._error) / Ts
            self._slope += Ts / (DERIVATIVE_LAG + Ts) * (rate - self._slope)
        self._error = error
        wanted = g.kp * error + self._integral + g.kd * self._slope
        ax = min(max(wanted, self.car.ax_min, least), self.car.ax_max(vx), most)
        if ax == wanted or error * (wanted - ax) < 0.0:
            self._integral += g.ki * Ts * error
        return ax


class ProtectedPID:
    """A `SpeedPID` that knows the delay of its commands, and that wheels spin and lock.

    Against a known delay of n periods the PID is given the speed and the reference of n periods
    ahead:

        vx + Ts (sum of the n accelerations on their way) + n Ts b,

    with b the acceleration that the commands do not explain (resistances, grades), an average over
    `UNEXPLAINED`. The wheels are protected as those of `lpv-mpc` are (traction.py).

    Source: Smith, Closer control of loops with dead time, Chemical Engineering Progress 53 (1957).
    """

    def __init__(self, car: VehicleParams, gains: PIDGains, Ts: float, delay: int) -> None:
        """Args: the car, the PID's gains, control period [s], known delay [periods]."""
        self.car, self.Ts, self.delay = car, Ts, delay
        self.pid = SpeedPID(car, gains, Ts)
        self._wheels = car.R_w, 0.5 * car.track_f, car.vx_min
        self._lag = -math.expm1(-Ts / car.tau_ax)
        self.reset()

    def reset(self) -> None:
        """Forget the run so far."""
        self.pid.reset()
        self._sent = [0.0] * (self.delay + 1)  # the one in force first
        self._driven = self._bias = 0.0
        self._last: float | None = None
        self._most = self._least = self._holds = math.inf

    def command(self, state: State, vx_ref: np.ndarray) -> float:
        """Acceleration of one control period [m/s2].

        Args:
            state: The car's state now, finite.
            vx_ref: Reference speed from now on, at least `delay` + 1 points [m/s].
        """
        car, Ts, vx = self.car, self.Ts, state.vx
        before = self._driven
        self._driven += self._lag * (self._sent[0] - self._driven)
        if self._last is not None:
            surprise = (vx - self._last) / Ts - 0.5 * (before + self._driven)
            self._bias += Ts / UNEXPLAINED * (surprise - self._bias)
        self._last = vx
        common = state.wheel_speed, vx, state.r, 1.0, *self._wheels, Ts
        self._most = traction.hold(
            self._most, car.F_drive_max / car.m_eff, self._driven, *common, car.drive_front
        )
        self._least, self._holds = traction.hold_brakes(
            self._least, self._holds, -car.ax_min, self._driven, *common
        )
        on_their_way = sum(self._sent[1:])
        ahead = vx + Ts * (on_their_way + self.delay * self._bias)
        ax = self.pid.command(ahead, float(vx_ref[self.delay]), -self._least, self._most)
        self._sent = [*self._sent[1:], ax]
        return ax


UNEXPLAINED = 0.5
"""Time over which the unexplained acceleration is averaged [s]."""
