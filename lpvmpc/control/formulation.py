"""What the adaptive LPV-MPC is made of and what it weighs: its parts, limits, units and weights.

`PAPER` is the paper's plain formulation, `Formulation()` ours; each field that differs is one step
between them, and each can be switched off alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Literal

import numpy as np

from lpvmpc.errors import OptionError, UnknownNameError

DELTA_STEP_PAPER = np.pi / 12
"""Largest steering increment per period of the paper's Table 2 [rad]."""
DELTA_MAX_PAPER = np.pi / 6
"""Largest steering angle of the paper's Table 2 [rad]."""
EY_MAX = 0.3
"""Lateral error bound of the paper's Table 2 [m]."""
UNITS = {
    "vx": 1.0,
    "vy": 1.0,
    "r": 0.5,
    "ey": EY_MAX,
    "epsi": DELTA_MAX_PAPER,
    "delta": DELTA_MAX_PAPER,
    "ax": 5.0,
}
"""Size of each variable that counts as one in the cost [m/s, m/s, rad/s, m, rad, rad, m/s2]."""
SCALE = np.array([0.1, 1.0])
"""Units of the inputs inside the QP [rad, m/s2], so that its entries are of order one."""
SLACK_WEIGHTS = np.array([0.0, 1e4])
"""Linear and quadratic price of leaving the ey bound [1/m, 1/m2]. Without a linear one the bound
yields by millimetres, and while it is not active the unconstrained solution is the solution: that
is where ProxQP begins, and it needs one iteration instead of two."""


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Everything that is tuned. Weights are per second and normalised by `UNITS`.

    The values here are set by hand; what the controller drives with where none are given is
    `weights/lpv-mpc.toml`, which `eval/tune.py` wrote.
    """

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "q_vx": (3.0, 300.0),
        "q_vy": (0.01, 10.0),
        "q_r": (0.01, 10.0),
        "q_ey": (8.0, 800.0),
        "q_epsi": (8.0, 800.0),
        "r_delta": (0.005, 0.5),
        "r_ax": (0.004, 0.4),
        "terminal": (0.0, 1.0),
        "observer_gain": (0.1, 0.6),
        "slip_cap": (0.1, 0.18),
    }
    """Where tuning searches: a decade to either side of the values set by hand, what these leave
    out near nothing, and for gain and cap the values that keep this car on the road."""

    q_vx: float = 30.0
    """Weight of the speed error."""
    q_vy: float = 0.0
    """Weight of the lateral speed error."""
    q_r: float = 0.0
    """Weight of the yaw rate error."""
    q_ey: float = 80.0
    """Weight of the lateral error."""
    q_epsi: float = 80.0
    """Weight of the heading error."""
    r_delta: float = 0.05
    """Weight of the steering rate."""
    r_ax: float = 0.04
    """Weight of the jerk."""
    terminal: float = 1.0
    """Factor on the cost-to-go at the end of the horizon, 0 to 1."""
    observer_gain: float = 0.3
    """Gain of the disturbance observer, 0 to 1."""
    slip_cap: float = 0.14
    """Largest front slip angle that a command may ask for [rad]."""

    def __post_init__(self) -> None:
        """Refuse what no cost can mean."""
        for f in fields(self):
            value = getattr(self, f.name)
            ok = isinstance(value, int | float) and np.isfinite(value) and value >= 0.0
            if not ok:
                raise OptionError(f"weight {f.name}", value, "a number of at least 0")
        if self.observer_gain > 1.0:
            raise OptionError("weight observer_gain", self.observer_gain, "a number from 0 to 1")
        if self.slip_cap < 0.01:
            raise OptionError("weight slip_cap", self.slip_cap, "at least 0.01 rad")
        for name in ("r_delta", "r_ax"):
            if getattr(self, name) <= 0.0:
                raise OptionError(f"weight {name}", getattr(self, name), "a number above 0")


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
)
"""The paper's plain formulation on the corrected matrices."""


PAPER_WEIGHTS = Weights(q_epsi=800.0, r_delta=0.18, terminal=0.0)
"""Weights for `PAPER`, which loses the MuJoCo car with the weights of the full controller."""


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
