"""The contract between controller, simulator and plant: what each of them gives and gets."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from lpvmpc.units import Array


class State(NamedTuple):
    """True or estimated state of the car at one control instant.

    The frame is ISO 8855: x forward, y left, counter-clockwise angles positive. Position and
    velocity are those of the centre of mass of the whole car.
    """

    x: float
    """Position [m]."""
    y: float
    """Position [m]."""
    psi: float
    """Heading [rad], unwrapped."""
    vx: float
    """Longitudinal speed, body frame [m/s]."""
    vy: float
    """Lateral speed, body frame [m/s]."""
    r: float
    """Yaw rate [rad/s]."""
    delta: float
    """Real road-wheel angle of the equivalent single track [rad]."""
    ax: float
    """Longitudinal acceleration of the centre of mass [m/s2], gravity excluded."""
    ay: float
    """Lateral acceleration of the centre of mass [m/s2], gravity excluded."""
    wheel_speed: Array
    """Spin of the wheels fl, fr, rl, rr [rad/s], shape (4,)."""


class Command(NamedTuple):
    """What a controller asks of the car for one control period."""

    delta: float
    """Road-wheel steering angle [rad], left positive."""
    ax: float
    """Drive (positive) or brake (negative) acceleration before resistances [m/s2]."""


class AxleForces(NamedTuple):
    """True forces and slip angles of the axles; only the oracle stiffness model is told them."""

    Fyf: float
    """Lateral force of the front wheels across their heading [N]."""
    Fyr: float
    """Lateral force of the rear wheels [N]."""
    Fzf: float
    """Load of the front axle [N]."""
    Fzr: float
    """Load of the rear axle [N]."""
    alpha_f: float
    """Front slip angle of the single track [rad]."""
    alpha_r: float
    """Rear slip angle of the single track [rad]."""
    Fxf: float
    """Longitudinal force of the front wheels along their heading [N]."""
    Fxr: float
    """Longitudinal force of the rear wheels [N]."""
    mu: float
    """Peak friction of the four wheels, weighted by their loads [-]."""


class Preview(NamedTuple):
    """The reference seen from the car: where it is now, and what comes along the horizon.

    Arrays have shape (Np + 1,) and hold the times 0, Ts, ..., Np Ts of a point that starts at the
    projection of the car and moves along the path at the reference speed.
    """

    s: float
    """Arc length of the projection [m]; counts up without wrapping on closed paths."""
    ey: float
    """Lateral error of the car, left positive [m]."""
    epsi: float
    """Heading error of the car, wrapped to (-pi, pi] [rad]."""
    kappa: Array
    """Curvature [1/m]."""
    vx_ref: Array
    """Reference speed [m/s]."""
    x: Array
    """Position of the moving point [m]."""
    y: Array
    """Position of the moving point [m]."""
    psi: Array
    """Heading of the path [rad], continuous along the horizon and from lap to lap."""


@dataclass
class Diagnostics:
    """What happened inside the last `LPVMPC.command`."""

    solved: bool = True
    """Whether the QP was solved and its solution passed the check."""
    fallback: str = ""
    """Empty, or which fallback was used: `shifted` or `braking`."""
    status: str = "SOLVED"
    """Status of the solve."""
    kkt_residual: float = 0.0
    """KKT residual of the solution [-]."""
    build_us: float = 0.0
    """Thread CPU time of adaptation, model and QP building [us]."""
    solve_us: float = 0.0
    """Thread CPU time in ProxQP [us]."""
    check_us: float = 0.0
    """Thread CPU time of the checks [us]."""
    prediction: Array = field(default_factory=lambda: np.zeros((1, 5)))
    """Predicted (vx, vy, r, ey, epsi), shape (Np + 1, 5)."""
    disturbance: Array = field(default_factory=lambda: np.zeros(3))
    """Estimated unmodelled accelerations of (vx, vy, r), shape (3,)."""


class Controller(Protocol):
    """What drives the car: sees the state and the road ahead, returns a command."""

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last run; `rng` is the only source of randomness a controller may use."""

    def command(self, state: State, preview: Preview) -> Command:
        """Steering angle [rad] and acceleration [m/s2] for the coming control period."""
