"""A discrete PID controller of the speed, beside a lateral controller that leaves it alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.weights_file import check_weights

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

    def command(self, vx: float, vx_ref: float) -> float:
        """Acceleration of one control period.

        Args:
            vx: Measured speed [m/s].
            vx_ref: Reference speed now [m/s].

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
        ax = min(max(wanted, self.car.ax_min), self.car.ax_max(vx))
        if ax == wanted or error * (wanted - ax) < 0.0:
            self._integral += g.ki * Ts * error
        return ax
