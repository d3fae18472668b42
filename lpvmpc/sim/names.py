"""Controllers, estimators and scenarios by name, for the packaged car where none is given."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.control.registry import make_controller
from lpvmpc.errors import (
    ControllerError,
    EstimatorError,
    LPVMPCError,
    OptionError,
    UnknownNameError,
    described,
)
from lpvmpc.interface import Controller, Estimator
from lpvmpc.sensing.exact import Exact
from lpvmpc.sim.own import own_module

if TYPE_CHECKING:
    import mujoco

    from lpvmpc.car.params import VehicleParams
    from lpvmpc.car.tire import Tire
    from lpvmpc.control.stiffness.network_file import Weights
    from lpvmpc.road.scenario import Scenario
    from lpvmpc.sensing.sensors import Sensing

ESTIMATORS = ("ekf", "none")
"""The package's own estimators."""


def load_scenario(
    name_or_csv: str | Path, *, params: VehicleParams | None = None, **options: Any
) -> Scenario:
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
    from lpvmpc.road import scenario  # compiled code: not for a process that only controls

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
        options: Arguments for the package's makers; see `control.registry.make_controller`.

    Raises:
        UnknownNameError: No such name.
        OptionError: An option outside its domain.
        ControllerError: The user's class does not import, or is no controller.
    """
    if not isinstance(name, str):
        raise OptionError("controller", name, "a name or module:Class")
    if ":" not in name:
        return make_controller(name, car or _packaged_car(), _tires, **options)
    offered = {
        "car": lambda: car or _packaged_car(),
        "delay": lambda: options.get("delay", 0),
        "weights": lambda: options.get("weights"),
    }
    methods = {"reset": "reset(rng)", "command": "command(state, preview)"}
    return _users(name, "controller", ControllerError, offered, methods)


def load_estimator(
    name: str, *, car: VehicleParams | None = None, sensing: Sensing, Ts: float
) -> Estimator:
    """An estimator by name, or a user's class by `module:Class`.

    Args:
        name: One of `ESTIMATORS`, or `module:Class` where the module is found from the current
            directory or PYTHONPATH; of `car`, `sensing` and `Ts` the class is given what its
            constructor asks for by name.
        car: Parameters of the car, as the controller knows it (default: the packaged one).
        sensing: The sensors, as their maker describes them; what was drawn is not told.
        Ts: Control period [s].

    Raises:
        UnknownNameError: No such name.
        EstimatorError: The user's class does not import, or is no estimator.
    """
    if name == "ekf":
        from lpvmpc.sensing.ekf import EKF  # compiled code: not for a run without it

        return EKF(car or _packaged_car(), sensing, Ts)
    if name == "none":
        return Exact(car or _packaged_car(), Ts)
    if ":" not in name:
        raise UnknownNameError("estimator", name, [*ESTIMATORS, "module:Class"])
    offered = {"car": lambda: car or _packaged_car(), "sensing": lambda: sensing, "Ts": lambda: Ts}
    methods = {"reset": "reset(first, rng)", "update": "update(measured, command)"}
    return _users(name, "estimator", EstimatorError, offered, methods)


def _users(
    name: str,
    kind: str,
    error_class: type[LPVMPCError],
    offered: dict[str, Callable[[], Any]],
    methods: dict[str, str],
) -> Any:
    """An object of a user's class, given whatever its constructor names of what is offered."""
    Kind = kind.capitalize()
    module_name, _, class_name = name.partition(":")
    try:
        module = own_module(module_name)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if isinstance(error, ModuleNotFoundError) and error.name == module_name.partition(".")[0]:
            why = "there is no such module in the current directory or PYTHONPATH"
        else:
            why = described(error)
        raise error_class(f"{Kind} {name!r} cannot be imported: {why}.") from error
    maker = getattr(module, class_name, None)
    if not callable(maker):
        classes = sorted(k for k, v in vars(module).items() if isinstance(v, type) and k[0] != "_")
        raise error_class(
            f"{Kind} {name!r} does not exist: module {module_name!r} has no class "
            f"{class_name!r}; it has {', '.join(classes) or 'none'}."
        )
    try:
        parameters: Iterable[str] = inspect.signature(maker).parameters
    except (TypeError, ValueError):  # some compiled classes have no signature
        parameters = ()
    try:
        made = maker(**{key: offered[key]() for key in offered if key in parameters})
    except (LPVMPCError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise error_class(
            f"{Kind} {name!r} cannot be made from what {kind}s are given ({', '.join(offered)}, "
            f"each where it asks for it): {described(error)}."
        ) from error
    for method in methods:
        try:
            there = callable(getattr(made, method, None))
        except Exception:  # a property of its own
            there = False
        if not there:
            raise error_class(
                f"{Kind} {name!r} has no method {method!r}, but must have "
                f"{' and '.join(methods.values())}."
            )
    return made


def _packaged_car() -> VehicleParams:
    from lpvmpc.plant.mjcf import packaged_car

    return packaged_car()


def _tires() -> tuple[Tire, Tire]:
    """Front and rear tires of the packaged car."""
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
