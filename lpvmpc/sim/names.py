"""Controllers and scenarios by name, for the packaged car where none is given."""

from __future__ import annotations

import inspect
import os
import sys
import warnings
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.control.registry import make_controller
from lpvmpc.errors import ControllerError, LPVMPCError, described
from lpvmpc.interface import Controller
from lpvmpc.road import scenario

if TYPE_CHECKING:
    import mujoco

    from lpvmpc.car.params import VehicleParams
    from lpvmpc.control.stiffness.network import Weights
    from lpvmpc.units import Array


def load_scenario(
    name_or_csv: str | Path, *, params: VehicleParams | None = None, **options: Any
) -> scenario.Scenario:
    """A scenario by name, or made from a track file, for a car.

    Args:
        name_or_csv: A name of `SCENARIOS`, or a file whose name ends in .csv.
        params: The car (default: the packaged one).
        options: See `scenario.load_scenario`.

    Raises:
        UnknownNameError: No such scenario.
        OptionError: An option outside its domain.
        PathError: A file or a road that cannot be driven.
    """
    return scenario.load_scenario(name_or_csv, params=params or _packaged_car(), **options)


def load_controller(
    name: str, *, car: VehicleParams | None = None, **options: Any
) -> Controller:
    """A controller by name, or a user's class by `module:Class`.

    Args:
        name: One of `CONTROLLERS`, or `module:Class` where the module is found from the current
            directory or PYTHONPATH; of `car`, `delay` and `weights` the class is given what its
            constructor asks for by name.
        car: Parameters of the car it drives (default: the packaged one).
        options: Arguments for the package's makers; see `controllers.make_controller`.

    Raises:
        UnknownNameError: No such name.
        OptionError: An option outside its domain.
        ControllerError: The user's class does not import, or is no controller.
    """
    if ":" not in name:
        return make_controller(name, car or _packaged_car(), _coefficients, **options)
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
        controller = maker(**_asked_for(maker, car, options))
    except LPVMPCError:
        raise
    except (Exception, SystemExit) as error:
        raise ControllerError(
            f"Controller {name!r} cannot be made from what controllers are given (car, delay, "
            f"weights, each where it asks for it): {described(error)}."
        ) from error
    for method in ("reset", "command"):
        if not callable(getattr(controller, method, None)):
            raise ControllerError(
                f"Controller {name!r} has no method {method!r}, but must have reset(rng) and "
                "command(state, preview)."
            )
    return controller


def _asked_for(maker: Any, car: VehicleParams | None, options: dict[str, Any]) -> dict[str, Any]:
    """What a user's class is made with: of car, delay and weights those it names."""
    try:
        parameters = inspect.signature(maker).parameters
    except (TypeError, ValueError):  # some compiled classes have no signature
        return {}
    offered = {"delay": options.get("delay", 0), "weights": options.get("weights")}
    asked = {name: value for name, value in offered.items() if name in parameters}
    if "car" in parameters:
        asked["car"] = car or _packaged_car()
    return asked


def _packaged_car() -> VehicleParams:
    from lpvmpc.plant.mjcf import packaged_car

    return packaged_car()


def _coefficients() -> tuple[Array, Array]:
    """Magic Formula coefficients of the packaged car's tires."""
    from lpvmpc.plant.mjcf import compile_model, tires

    return tires(compile_model(visual=False))


def warn_of_another_car(weights: Weights, model: mujoco.MjModel, file: str = "") -> None:
    """Issue a warning where a network was trained on another car than the one in use.

    Args:
        weights: The network's weights.
        model: The compiled car.
        file: What to call the weights (default: by their kind).
    """
    from lpvmpc.plant.mjcf import car_sha256

    if weights.metadata.get("car_sha256") != car_sha256(model):
        warnings.warn(
            f"The weights {file or weights.kind + '.safetensors'} were trained on another car than "
            "the one in use; data_gen/collect.py and data_gen/train.py make new ones.",
            stacklevel=2,
        )
