"""The package's controllers and stiffness models by name.

A new controller is one file with a class or maker that takes the car first (`interface` says what
it must have), and one line in `CONTROLLERS`; its tuned weights lie in `weights/NAME.toml`. A rival
has its line in `rivals.RIVALS`, its file and its weights beside it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from lpvmpc.control.rivals import RIVALS
from lpvmpc.errors import ControllerError, OptionError, UnknownNameError

if TYPE_CHECKING:  # the help of a command lists the names, and must come at once
    from lpvmpc.car.params import VehicleParams
    from lpvmpc.car.tire import Tire
    from lpvmpc.control.stiffness.models import StiffnessModel
    from lpvmpc.interface import Controller

CONTROLLERS = {
    "lpv-mpc": ("lpv_mpc", "adaptive"),
    "lpv-mpc-paper": ("lpv_mpc", "plain"),
    "lmpc-pso-pid": ("lmpc", "LMPC"),
    "stanley": ("geometric", "Stanley"),
    "pure-pursuit": ("geometric", "PurePursuit"),
    **{name: (f"rivals.{rival.module}", rival.maker) for name, rival in RIVALS.items()},
}
"""Controllers by name: module of this package, and class or maker; the default first."""
CORE = tuple(name for name in CONTROLLERS if name not in RIVALS)
"""The paper's controllers, ours and the simple ones: what the commands that tell of the paper, of
adaptation and of worlds compare unless told otherwise."""

TUNABLE = tuple(
    name for name in CONTROLLERS if not (name in RIVALS and RIVALS[name].learned)
)
"""Those with weights that `tune` can search; the others were trained."""

STIFFNESS_MODELS = {
    "constant": ("stiffness.models", "ConstantStiffness"),
    "network": ("stiffness.models", "NetworkStiffness"),
    "network-dry": ("stiffness.models", "DryNetwork"),
    "network-secant": ("stiffness.secant_network", "SecantNetwork"),
    "oracle": ("stiffness.models", "OracleStiffness"),
    "oracle-secant": ("stiffness.models", "SecantOracle"),
}
"""Stiffness models by name: module and class, made from the car."""


def make_controller(
    name: str, car: VehicleParams, tires: Callable[[], tuple[Tire, Tire]], **options: Any
) -> Controller:
    """A controller of the package by name.

    Args:
        name: One of `CONTROLLERS`.
        car: Parameters of the car it drives.
        tires: Gives the front and the rear tires; called for the oracle and for who asks for them.
        options: Arguments of its maker. A stiffness model may be named, be given the network of a
            `stiffness_file`, and made wrong by `stiffness_scale`, `stiffness_noise` and
            `stiffness_seed` (see `perturbed`); a formulation may be a dictionary of what differs
            from the default.

    Raises:
        UnknownNameError: No such controller, stiffness model or part of a formulation.
        OptionError: An option outside its domain, or one that this controller does not have.
        ControllerError: A package that it needs is not installed.
    """
    if name not in CONTROLLERS:
        raise UnknownNameError("controller", name, [*CONTROLLERS, "module:Class (your own)"])
    if (rival := RIVALS.get(name)) is not None and (package := rival.missing()) is not None:
        raise ControllerError(
            f"Controller {name!r} needs the package {package}; install it with: pip install "
            f"'lpvmpc[{rival.extra}]'."
        )
    maker = _attribute(*CONTROLLERS[name])
    known = inspect.signature(maker).parameters
    if "stiffness" in known:
        options = _with_stiffness(options, car, tires)
    elif (asked := options.pop("stiffness", None)) not in (None, "constant"):
        raise OptionError("stiffness", asked, f"left out for {name}, which adapts to nothing")
    if "tires" in known:
        options = {**options, "tires": tires()}
    for option in options:
        if option not in known:
            raise OptionError(f"option {option}", options[option], f"left out for {name}")
    return maker(car, **options)


def _with_stiffness(
    options: dict[str, Any], car: VehicleParams, tires: Callable[[], tuple[Tire, Tire]]
) -> dict[str, Any]:
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
    return {**options, "stiffness": make_stiffness(name, car, tires, **wrong)}


def make_stiffness(
    name: str,
    car: VehicleParams,
    tires: Callable[[], tuple[Tire, Tire]],
    *,
    file: str | None = None,
    **wrong: Any,
) -> StiffnessModel:
    """A stiffness model by name.

    Args:
        name: One of `STIFFNESS_MODELS`.
        car: Parameters of the car.
        tires: Gives the front and the rear tires; called for the oracle alone.
        file: Trained network in place of the shipped one.
        wrong: What makes it wrong on purpose: `scale`, `noise`, `seed` of `PerturbedStiffness`.

    Raises:
        UnknownNameError: No such model.
        DataError: The network's file is missing, damaged, or of another kind.
        OptionError: A number outside its domain.
    """
    if name not in STIFFNESS_MODELS:
        raise UnknownNameError("stiffness model", name, STIFFNESS_MODELS)
    maker = _attribute(*STIFFNESS_MODELS[name])
    more: list[Any] = []
    if "tires" in inspect.signature(maker).parameters:
        more.append(tires())
    if file is not None:
        from lpvmpc.control.stiffness.network_file import load_weights

        more.append(load_weights(name, file))
    model: StiffnessModel = maker(car, *more)
    if wrong:
        from lpvmpc.control.stiffness.perturbed import PerturbedStiffness

        model = PerturbedStiffness(model, **wrong)
    return model


def oracle_of(controller: Controller) -> Any:
    """The oracle that a controller of this package drives with; None for all other controllers.

    Only it is told the true axle forces. A user's class is not, whatever its methods are called
    and whatever it keeps as its `stiffness`.
    """
    from lpvmpc.control.stiffness.models import OracleStiffness, SecantOracle

    if not type(controller).__module__.startswith("lpvmpc."):
        return None
    model = getattr(controller, "stiffness", None)
    inner = getattr(model, "model", model)  # of a perturbed one
    return model if isinstance(inner, OracleStiffness | SecantOracle) else None


def _attribute(module: str, name: str) -> Any:
    """A class or function of this package, imported now."""
    return getattr(import_module(f"lpvmpc.control.{module}"), name)
