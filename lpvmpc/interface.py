"""The contract between controller, simulator and plant: what each of them gives and gets."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, is_dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from lpvmpc.errors import OptionError, described
from lpvmpc.units import Array

FALLBACKS = ("", "shifted", "braking", "driving")
"""What a controller may do after a refused solve; the trace writes 0 to 3."""


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


class Measurement(NamedTuple):
    """What the sensors say at one control instant; frame and signs are those of `State`."""

    x: float
    """Position of the centre of mass [m]; NaN where there is no new sample of the pose."""
    y: float
    """The same [m]."""
    psi: float
    """Heading [rad], unwrapped; NaN where there is no new sample, or none is ever taken."""
    pose_age: float
    """Time since the pose was taken [s]; NaN where there is no new sample."""
    vx: float
    """Longitudinal speed [m/s]; NaN where it is not measured."""
    vy: float
    """Lateral speed [m/s]; NaN where it is not measured, as in every series car."""
    r: float
    """Yaw rate [rad/s]."""
    ax: float
    """Longitudinal acceleration of the centre of mass [m/s2], gravity excluded."""
    ay: float
    """Lateral acceleration of the centre of mass [m/s2], gravity excluded."""
    delta: float
    """Road-wheel angle of the equivalent single track [rad]."""
    wheel_speed: Array
    """Spin of the wheels fl, fr, rl, rr [rad/s], shape (4,); NaN where it is not measured."""


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
    """What happened inside the last `command`."""

    solved: bool = True
    """Whether the QP was solved and its solution passed the check."""
    fallback: str = ""
    """Empty, or which fallback was used: `shifted`, `braking` or `driving`."""
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
    """What drives the car: sees the state and the road ahead, returns a command.

    These two methods are all that a class must have. It may have more, which `declared` and
    `told_by` read and nobody else does:

    - `name` (str): what to call it in results; default: the name of its class;
    - `Ts` (float): its control period [s], refused where it is not the plant's;
    - `Np` (int): horizon of its `diagnostics.prediction` [periods]; default 10;
    - `preview_steps` (int): periods of preview that it wants; default `Np`;
    - `weights` (a dataclass, or numbers and texts by name): saved beside the results;
    - `stiffness`: an object whose `name` says what it adapts with, and whose `clamped` counts the
      inputs that lay outside the range it was trained in;
    - `diagnostics` (`Diagnostics`, or an object with some of its fields): what happened inside the
      last `command`; whoever has it is listed with its solver's record.
    """

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last run; `rng` is the only source of randomness a controller may use."""

    def command(self, state: State, preview: Preview) -> Command:
        """Steering angle [rad] and acceleration [m/s2] for the coming control period."""


class Estimator(Protocol):
    """What stands between sensors and controller: measurements in, the state at this instant out.

    Two attributes are optional: `events` (int), how often it diverged and was reset in this run,
    and `unknowns` (dict of float), the slow unknowns it has found and their standard deviations.
    """

    def reset(self, first: State, rng: np.random.Generator) -> None:
        """Forget the last run and start from a known state.

        Args:
            first: State at the first control instant, as it is on the start line.
            rng: The only source of randomness an estimator may use.
        """

    def update(self, measured: Measurement, command: Command) -> State:
        """The state now, from what was measured now; called once at every control instant.

        The first call after `reset` belongs to the instant of its first state, each further one
        lies one control period later.

        Args:
            measured: What the sensors say at this instant.
            command: The command sent for the period that just ended; latency may keep it from
                the car, so the measured steering angle is the better witness.
        """


@dataclass(frozen=True, kw_only=True)
class Declared:
    """What a controller says of itself, read once before a run and checked."""

    name: str
    """What to call it."""
    Ts: float | None
    """Control period [s]; None: any."""
    Np: int
    """Horizon of its predictions [periods]."""
    preview_steps: int
    """Periods of preview that it wants."""
    weights: dict[str, Any]
    """Its weights by name."""
    stiffness: str | None
    """Name of what it adapts with; None: it does not say."""


MAX_PREVIEW = 3000
"""Longest preview that a controller may ask for [periods]."""


def declared(controller: Controller) -> Declared:
    """Read what a controller says of itself, each attribute once; see `Controller`.

    Raises:
        OptionError: An attribute that cannot be what it has to be, or cannot be read; the message
            names it.
    """
    name = _read(controller, "name") or type(controller).__name__
    if not (isinstance(name, str) and len(name) <= 200 and name.isprintable()):
        raise OptionError("controller name", shown(name), "a text of up to 200 characters")
    Ts = _read(controller, "Ts")
    if Ts is not None and not (_is_number(Ts) and Ts > 0.0):
        raise OptionError("controller Ts", shown(Ts), "a number of seconds above 0")
    Np = _steps("Np", _read(controller, "Np", 10))
    steps = _steps("preview_steps", _read(controller, "preview_steps", Np))
    stiffness = _read(_read(controller, "stiffness"), "name")
    return Declared(
        name=str(name),
        Ts=None if Ts is None else float(Ts),
        Np=Np,
        preview_steps=steps,
        weights=_weights(_read(controller, "weights")),
        stiffness=stiffness if isinstance(stiffness, str) else None,
    )


def _weights(given: Any) -> dict[str, Any]:
    """Weights as a controller tells them, checked: plain numbers and texts by name."""
    allowed = "a dataclass, or numbers by name"
    try:
        weights: Any = {} if given is None else given
        if is_dataclass(weights) and not isinstance(weights, type):
            weights = asdict(weights)
        items = list(weights.items()) if isinstance(weights, Mapping) else None
    except (Exception, SystemExit) as error:
        raise OptionError("controller weights", _Text(described(error)), allowed) from error
    if items is None:
        raise OptionError("controller weights", shown(given), allowed)
    for key, value in items:
        if not (isinstance(key, str) and (isinstance(value, str | bool) or _is_number(value))):
            what = key if isinstance(key, str) else shown(key)
            raise OptionError(
                f"controller weight {what}", shown(value), "a finite number or a text"
            )
    return {key: value.item() if isinstance(value, np.number) else value for key, value in items}


def clamped_inputs(controller: Controller) -> int | None:
    """Inputs of its network outside the trained range since the reset; None: it has none."""
    count = _read(_read(controller, "stiffness"), "clamped")
    return count if type(count) is int else None


def told_by(controller: Controller, Np: int, trusted: bool = False) -> Diagnostics | None:
    """What a controller tells of its last command; fields that it leaves out have their defaults.

    Args:
        controller: Who tells.
        Np: Horizon that it has declared [periods].
        trusted: Whether a `Diagnostics` of it needs no check.

    Returns:
        A copy with checked fields; `prediction` is empty where none is told.

    Raises:
        OptionError: A field that cannot be what it has to be; the message names it.
    """
    if trusted:
        own = getattr(controller, "diagnostics", None)
        if type(own) is Diagnostics:
            return own
    told = _read(controller, "diagnostics")
    if told is None:
        return None
    whole = Diagnostics(prediction=np.zeros((0, 5)))
    solved = _read(told, "solved", True)
    if not isinstance(solved, bool | np.bool_ | int):
        raise OptionError("diagnostics.solved", shown(solved), "True or False")
    whole.solved = bool(solved)
    fallback = _read(told, "fallback", "")
    if not (isinstance(fallback, str) and fallback in FALLBACKS):
        raise OptionError("diagnostics.fallback", shown(fallback), f"one of {FALLBACKS}")
    whole.fallback = str(fallback)
    for name in ("kkt_residual", "build_us", "solve_us", "check_us"):
        value = _read(told, name, 0.0)
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise OptionError(f"diagnostics.{name}", shown(value), "a number")
        try:
            setattr(whole, name, float(value))
        except (ArithmeticError, TypeError, ValueError):  # 10**400, a complex number
            raise OptionError(f"diagnostics.{name}", shown(value), "a number") from None
    prediction = _read(told, "prediction")
    if prediction is None:
        return whole
    shape: object = type(prediction).__name__
    try:
        whole.prediction = np.array(prediction, dtype=np.float64)
        shape = whole.prediction.shape
    except (Exception, SystemExit):  # refused below, as every wrong shape
        whole.prediction = np.zeros(1)
    if whole.prediction.shape == (1, 5) and type(told) is Diagnostics:  # left at its default
        whole.prediction = np.zeros((0, 5))
    if whole.prediction.shape not in ((Np + 1, 5), (0, 5)):
        raise OptionError(
            "diagnostics.prediction", shape, f"numbers of shape (Np + 1, 5) = ({Np + 1}, 5)"
        )
    return whole


class _Text(str):
    """A text that an error message shows without quotes."""

    __repr__ = str.__str__


def shown(value: Any) -> Any:
    """A value for a message, even where it cannot be shown; at most 80 characters."""
    try:
        text = " ".join(repr(value).split())
    except (Exception, SystemExit):  # 10**5000 too
        text = f"an object of class {type(value).__name__}"
    return _Text(text if len(text) <= 80 else text[:77] + "...")


def _read(thing: Any, name: str, default: Any = None) -> Any:
    """An attribute of something that a user has written; its default where there is none."""
    try:
        value = getattr(thing, name, default)
    except (Exception, SystemExit) as error:
        raise OptionError(
            f"attribute {name} of {type(thing).__name__}", _Text(described(error)), "readable"
        ) from error
    return default if value is None else value


def _steps(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer):
        raise OptionError(f"controller {name}", shown(value), "a whole number")
    if not 1 <= value <= MAX_PREVIEW:
        raise OptionError(f"controller {name}", shown(value), f"from 1 to {MAX_PREVIEW}")
    return int(value)


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return False
    try:
        return math.isfinite(value)
    except (ArithmeticError, TypeError, ValueError):  # 10**400, a complex number
        return False
