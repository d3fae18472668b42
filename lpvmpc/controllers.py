"""The controllers by name, a user's own by `module:Class`, and the guard around what they do.

A controller is any class with `reset(rng)` and `command(state, preview) -> Command(delta, ax)`.
Optional attributes: `Np` (steps of the preview it wants, default 10), `Ts` (its control period, to
match the plant's), `diagnostics` (after each command: solved, fallback, kkt_residual, build_us,
solve_us, check_us, prediction), `weights` (a dictionary saved beside the results).
"""

from __future__ import annotations

import math
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, Protocol

from lpvmpc.errors import ControllerError, LPVMPCError, OptionError, UnknownNameError
from lpvmpc.vehicle import Command, State

if TYPE_CHECKING:
    import numpy as np

    from lpvmpc.formulation import Formulation
    from lpvmpc.path import Preview


class Controller(Protocol):
    """What drives the car: sees the state and the road ahead, returns a command."""

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last run; `rng` is the only source of randomness a controller may use."""

    def command(self, state: State, preview: Preview) -> Command:
        """Steering angle [rad] and acceleration [m/s2] for the coming control period."""


STIFFNESS_MODELS = {
    "constant": ("stiffness", "ConstantStiffness"),
    "network": ("stiffness", "NetworkStiffness"),
    "network-dry": ("stiffness", "DryNetwork"),
    "network-secant": ("secant_network", "SecantNetwork"),
    "oracle": ("stiffness", "OracleStiffness"),
    "oracle-secant": ("stiffness", "SecantOracle"),
}
"""Stiffness models by name: module and class, made from the car."""


def _lpv_mpc(**options: Any) -> Controller:
    from lpvmpc.formulation import Formulation
    from lpvmpc.mpc import LPVMPC

    return LPVMPC(**_with_formulation(_with_stiffness(options), Formulation()))


def _lpv_mpc_paper(**options: Any) -> Controller:
    from lpvmpc.formulation import PAPER, PAPER_WEIGHTS
    from lpvmpc.mpc import LPVMPC
    from lpvmpc.weights_file import chosen

    options["stiffness"] = options.get("stiffness") or "constant"
    options["weights"] = chosen("lpv-mpc-paper", options.get("weights"), PAPER_WEIGHTS)
    return LPVMPC(**{"formulation": PAPER, **_with_formulation(_with_stiffness(options), PAPER)})


def _with_stiffness(options: dict[str, Any]) -> dict[str, Any]:
    """The options with the stiffness model in place of its name and of what changes it."""
    options = dict(options)
    parts = ("file", "scale", "noise", "seed")
    wrong = {k: options.pop(f"stiffness_{k}") for k in parts if f"stiffness_{k}" in options}
    name = options.get("stiffness")
    if not isinstance(name, str):
        if not wrong:
            return options
        given = ", ".join(f"stiffness_{part}" for part in wrong)
        raise OptionError("stiffness", name, f"a model by name, since {given} is given")
    if name not in STIFFNESS_MODELS:
        raise UnknownNameError("stiffness model", name, STIFFNESS_MODELS)
    from lpvmpc.vehicle import VehicleParams

    module, model = STIFFNESS_MODELS[name]
    car = options.get("car") or VehicleParams.load()
    trained = []
    if (file := wrong.pop("file", None)) is not None:
        from lpvmpc.network import load_weights

        trained = [load_weights(name, file)]
    made = getattr(import_module(f"lpvmpc.{module}"), model)(car, *trained)
    if wrong:
        from lpvmpc.perturbed import PerturbedStiffness

        made = PerturbedStiffness(made, **wrong)
    return {**options, "car": car, "stiffness": made}


def _with_formulation(options: dict[str, Any], default: Formulation) -> dict[str, Any]:
    """The options with a formulation in place of a dictionary of what differs from the default."""
    given = options.get("formulation")
    if not isinstance(given, dict):
        return options
    known = [f.name for f in fields(default)]
    for name in given:
        if name not in known:
            raise UnknownNameError("part of the formulation", name, known)
    return {**options, "formulation": replace(default, **given)}


def _lmpc_pso_pid(**options: Any) -> Controller:
    from lpvmpc.baselines import LMPC

    return LMPC(**_without_stiffness("lmpc-pso-pid", options))


def _stanley(**options: Any) -> Controller:
    from lpvmpc.baselines import Stanley

    return Stanley(**_without_stiffness("stanley", options))


def _pure_pursuit(**options: Any) -> Controller:
    from lpvmpc.baselines import PurePursuit

    return PurePursuit(**_without_stiffness("pure-pursuit", options))


def _without_stiffness(name: str, options: dict[str, Any]) -> dict[str, Any]:
    """The options for a controller that adapts nothing; asking it to is a mistake."""
    options = dict(options)
    stiffness = options.pop("stiffness", None)
    if stiffness not in (None, "constant"):
        raise OptionError("stiffness", stiffness, f"left out for {name}, which adapts to nothing")
    return options


CONTROLLERS: dict[str, Callable[..., Controller]] = {
    "lpv-mpc": _lpv_mpc,
    "lpv-mpc-paper": _lpv_mpc_paper,
    "lmpc-pso-pid": _lmpc_pso_pid,
    "stanley": _stanley,
    "pure-pursuit": _pure_pursuit,
}
"""Makers of the controllers by name; each imports what it needs when it is called."""


def load_controller(name: str, **options: Any) -> Controller:
    """A controller by name, or a user's class by `module:Class`.

    Args:
        name: One of `CONTROLLERS`, or `module:Class` where the module is found from the current
            directory or PYTHONPATH and the class is made without arguments.
        options: Arguments for the makers in `CONTROLLERS`; the stiffness model may be named, be
            given the network of a `stiffness_file`, and made wrong by `stiffness_scale`,
            `stiffness_noise` and `stiffness_seed` (see `perturbed`); a formulation may be a
            dictionary of what differs from the default.

    Raises:
        UnknownNameError: No such name.
        ControllerError: The user's class does not import, or is no controller.
    """
    if ":" not in name:
        if name not in CONTROLLERS:
            raise UnknownNameError("controller", name, [*CONTROLLERS, "module:Class (your own)"])
        return CONTROLLERS[name](**options)
    module_name, _, class_name = name.partition(":")
    if os.getcwd() not in sys.path:  # a script has its own folder there, not the current one
        sys.path.insert(0, os.getcwd())
    try:
        module = import_module(module_name)
    except (Exception, SystemExit) as error:
        if isinstance(error, ModuleNotFoundError) and error.name == module_name.partition(".")[0]:
            why = "there is no such module in the current directory or PYTHONPATH"
        else:
            why = described(error)
        raise ControllerError(f"Controller {name!r} cannot be imported: {why}.") from error
    maker = getattr(module, class_name, None)
    if not callable(maker):
        classes = sorted(k for k, v in vars(module).items() if isinstance(v, type) and k[0] != "_")
        raise ControllerError(
            f"Controller {name!r} does not exist: module {module_name!r} has no class "
            f"{class_name!r}; it has {', '.join(classes) or 'none'}."
        )
    try:
        controller = maker()
    except LPVMPCError:
        raise
    except (Exception, SystemExit) as error:
        raise ControllerError(
            f"Controller {name!r} cannot be made without arguments: {described(error)}."
        ) from error
    for method in ("reset", "command"):
        if not callable(getattr(controller, method, None)):
            raise ControllerError(
                f"Controller {name!r} has no method {method!r}, but must have reset(rng) and "
                "command(state, preview)."
            )
    return controller


def described(error: BaseException) -> str:
    """An exception in one line: its class and the first line of its message."""
    first = (str(error).strip().splitlines() or [""])[0].rstrip(".")
    return f"{type(error).__name__}: {first}" if first else type(error).__name__


def checked_command(answer: Any, name: str, t: float) -> Command:
    """The answer of a controller as a Command of two finite numbers.

    Args:
        answer: What `command` returned: a Command, or any pair of numbers.
        name: The controller, for the message.
        t: Simulated time [s], for the message.

    Raises:
        ControllerError: The answer is something else.
    """
    try:
        delta, ax = answer
        if type(answer) is not Command and isinstance(answer, str | bytes | dict | set):
            raise TypeError
        command = Command(float(delta), float(ax))
        if math.isfinite(command.delta) and math.isfinite(command.ax):
            return command
    except (TypeError, ValueError):
        pass  # raised below, for every kind of wrong answer alike
    text = repr(answer)
    text = text if len(text) <= 80 else text[:77] + "..."
    raise ControllerError(
        f"Controller {name!r} returned {' '.join(text.split())} at t = {t:.3f} s, but must return "
        "two finite numbers: Command(delta [rad], ax [m/s2])."
    )


class _OutOfTime(BaseException):
    """Raised inside a controller that takes too long.

    Not an Exception, so that a controller's own `except Exception` does not swallow it.
    """


class TimeLimit:
    """Wall-clock limit on each call of a controller.

    On the main thread of a POSIX system an alarm interrupts Python code that hangs. Elsewhere, and
    in compiled code that never comes back to Python, a call can only be judged once it has ended.
    """

    def __init__(self, seconds: float | None, name: str):
        """Args: limit per call [s], None for none; the controller's name for the message."""
        self.seconds, self.name = seconds, name
        self.armed = (
            seconds is not None
            and hasattr(signal, "setitimer")
            and threading.current_thread() is threading.main_thread()
        )

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Take over SIGALRM for the duration of a run."""
        if not self.armed:
            yield
            return

        def ring(signum: int, frame: object) -> None:
            raise _OutOfTime

        before = signal.signal(signal.SIGALRM, ring)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)

    def call(self, what: str, t: float, function: Callable[..., Any], *args: Any) -> Any:
        """Call a controller's method.

        Args:
            what: Name of the method, for the message.
            t: Simulated time [s], for the message.
            function: The method.
            args: Its arguments.

        Raises:
            ControllerError: It raised, or took longer than the limit.
        """
        if self.seconds is None:
            return self._caught(what, t, function, *args)
        start = time.monotonic()
        try:
            if self.armed:
                signal.setitimer(signal.ITIMER_REAL, self.seconds)
            answer = self._caught(what, t, function, *args)
            if self.armed:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
        except _OutOfTime:
            raise self._late(what, t) from None
        if not self.armed and time.monotonic() - start > self.seconds:
            raise self._late(what, t)
        return answer

    def _caught(self, what: str, t: float, function: Callable[..., Any], *args: Any) -> Any:
        try:
            return function(*args)
        except LPVMPCError:
            raise
        except (Exception, SystemExit) as error:
            raise ControllerError(
                f"Controller {self.name!r} raised in {what} at t = {t:.3f} s: {described(error)}."
            ) from error

    def _late(self, what: str, t: float) -> ControllerError:
        return ControllerError(
            f"Controller {self.name!r} did not return from {what} within {self.seconds:g} s at "
            f"t = {t:.3f} s (--step-timeout)."
        )
