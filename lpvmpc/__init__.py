"""Vehicle controllers on a MuJoCo car with Pacejka tires.

The public names below are imported when first used, so that `import lpvmpc` stays fast:

    from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate
    log = simulate(Plant(), load_controller("lpv-mpc"), load_scenario("paper"))
    metrics(log)["lateral_rmse_m"]
"""

from importlib import import_module
from typing import TYPE_CHECKING

from lpvmpc import _cache
from lpvmpc._version import __version__

# Eager, because the function and its module share one name: importing lpvmpc.metrics later would
# otherwise put the module in the function's place.
from lpvmpc.metrics import metrics

if TYPE_CHECKING:
    from lpvmpc.controllers import CONTROLLERS
    from lpvmpc.errors import LPVMPCError
    from lpvmpc.interface import Command, Preview, State
    from lpvmpc.mpc import LPVMPC
    from lpvmpc.names import load_controller, load_scenario
    from lpvmpc.path import Path
    from lpvmpc.plant import Plant
    from lpvmpc.scenario import SCENARIOS, Scenario
    from lpvmpc.simulation import Log, simulate
    from lpvmpc.speed_profile import SpeedProfile
    from lpvmpc.vehicle import VehicleParams
    from lpvmpc.wind import Wind

_HOME = {
    "CONTROLLERS": "controllers",
    "Command": "interface",
    "LPVMPC": "mpc",
    "LPVMPCError": "errors",
    "Log": "simulation",
    "Path": "path",
    "Plant": "plant",
    "Preview": "interface",
    "SCENARIOS": "scenario",
    "Scenario": "scenario",
    "SpeedProfile": "speed_profile",
    "State": "interface",
    "VehicleParams": "vehicle",
    "Wind": "wind",
    "load_controller": "names",
    "load_scenario": "names",
    "simulate": "simulation",
}

__all__ = [
    "CONTROLLERS",
    "LPVMPC",
    "SCENARIOS",
    "Command",
    "LPVMPCError",
    "Log",
    "Path",
    "Plant",
    "Preview",
    "Scenario",
    "SpeedProfile",
    "State",
    "VehicleParams",
    "Wind",
    "__version__",
    "load_controller",
    "load_scenario",
    "metrics",
    "simulate",
]

_cache.place_numba_cache()


def __getattr__(name: str) -> object:
    """Import a public name from its module at first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'lpvmpc' has no attribute {name!r}")
    try:
        module = import_module(f"lpvmpc.{_HOME[name]}")
    except AttributeError as error:  # left as it is, Python would only say "cannot import name"
        raise ImportError(f"lpvmpc.{_HOME[name]} cannot be imported: {error}") from error
    value = getattr(module, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
