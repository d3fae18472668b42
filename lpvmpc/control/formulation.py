"""What the adaptive LPV-MPC is made of and where its bounds lie: its parts and limits.

`PAPER` is the paper's plain formulation, `Formulation()` ours; each field that differs is one step
between them, and each can be switched off alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from lpvmpc.errors import OptionError, UnknownNameError

DELTA_STEP_PAPER = np.pi / 12
"""Largest steering increment per period of the paper's Table 2 [rad]."""
DELTA_MAX_PAPER = np.pi / 6
"""Largest steering angle of the paper's Table 2 [rad]."""
EY_MAX = 0.3
"""Lateral error bound of the paper's Table 2 [m]."""
SCALE = np.array([0.1, 1.0])
"""Units of the inputs inside the QP [rad, m/s2], so that its entries are of order one."""


@dataclass(frozen=True, kw_only=True)
class Formulation:
    """What the controller is made of; each field is one step from the paper's form to ours."""

    hold: Literal["exact", "euler"] = "exact"
    """Discretisation: exact zero-order hold, or the paper's Euler."""
    matrices: Literal["corrected", "printed"] = "corrected"
    """Lateral error row: A45 = vx sinc(epsi), or as printed A41 = sin(epsi), A45 = 0."""
    reference: Literal["steady", "plain"] = "steady"
    """State reference: steady-state cornering, or [vx_ref, 0, 0, 0, 0]."""
    lags: bool = True
    """Servo lags as model states."""
    relaxation: bool = True
    """Relaxation of the tires as model states."""
    roll: bool = True
    """Roll of the body as model states."""
    trail: bool = True
    """Pneumatic trail of the tires."""
    observer: bool = True
    """Disturbance observer."""
    slip_cap: bool = True
    """Bound on the front slip angle that a command may ask for."""
    traction: bool = True
    """Traction control: less drive force where the wheel speeds tell that a driven wheel spins."""
    decoupled: bool = True
    """Speed errors never steer: the steering's effect on the speed is taken as planned, steady
    cornering and the path's curvature are those of the speed that the car has."""
    approach: bool = True
    """A car far beside its path is led back to it, not pulled."""
    steering: bool = True
    """Lag, latency, gain and offset of the steering are learned online."""
    noise: bool = True
    """The observer's gain follows the noise that it sees."""
    damped: bool = True
    """The model is frozen along the mean of the last two predictions: near a tire's peak the slope
    at one prediction makes the next one jump, and the command would alternate."""
    drive_on: bool = True
    """After several refused solves in a row geometry drives, instead of braking to a standstill."""
    span: int = 2
    """Periods of the horizon that share one frozen model and one row of the ey bound; a divisor of
    Np. Two halve the time to build and cost no accuracy that shows."""
    Np: int = 10
    """Prediction horizon [periods]."""
    Ts: float = 0.033
    """Control period [s]."""

    def __post_init__(self) -> None:
        """Check names and ranges."""
        for name, allowed in (
            ("hold", ("exact", "euler")),
            ("matrices", ("corrected", "printed")),
            ("reference", ("steady", "plain")),
        ):
            if getattr(self, name) not in allowed:
                raise OptionError(name, getattr(self, name), " or ".join(allowed))
        if not 2 <= self.Np <= 100:
            raise OptionError("Np", self.Np, "a whole number from 2 to 100")
        if not (1 <= self.span <= self.Np and self.Np % self.span == 0):
            raise OptionError("span", self.span, f"a divisor of Np = {self.Np}")
        if not (np.isfinite(self.Ts) and 0.001 <= self.Ts <= 0.5):
            raise OptionError("Ts", self.Ts, "a number of seconds from 0.001 to 0.5")


PAPER = Formulation(
    hold="euler",
    span=1,
    reference="plain",
    lags=False,
    relaxation=False,
    roll=False,
    trail=False,
    observer=False,
    slip_cap=False,
    traction=False,
    decoupled=False,
    approach=False,
    steering=False,
    noise=False,
    damped=False,
    drive_on=False,
)
"""The paper's plain formulation on the corrected matrices."""


def changed(default: Formulation, given: Formulation | Mapping[str, Any] | None) -> Formulation:
    """A formulation as it is, or a default with some parts replaced by name.

    Raises:
        UnknownNameError: There is no such part.
        OptionError: A part that cannot have this value.
    """
    if given is None or isinstance(given, Formulation):
        return given or default
    known = [f.name for f in fields(default)]
    for name in given:
        if name not in known:
            raise UnknownNameError("part of the formulation", name, known)
    return replace(default, **given)
