"""Vehicle controllers on a MuJoCo car with Pacejka tires.

The public names below are imported when first used, so that `import lpvmpc` stays fast:

    from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate
    log = simulate(Plant(), load_controller("lpv-mpc"), load_scenario("paper"))
    metrics(log)["lateral_rmse_m"]
"""

import os
import sys

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    # `python -m lpvmpc`: Python has put the current folder before the standard library, where a
    # stray random.py would be run; this package must stay where it is found, for workers too
    sys.path.pop(0)
    _home = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if _home not in sys.path:
        sys.path.append(_home)

from importlib import import_module  # noqa: E402
from typing import TYPE_CHECKING  # noqa: E402

from lpvmpc import _numba_cache  # noqa: E402
from lpvmpc._version import __version__  # noqa: E402

if TYPE_CHECKING:
    from lpvmpc.car.params import VehicleParams
    from lpvmpc.control.lpv_mpc import LPVMPC
    from lpvmpc.control.registry import CONTROLLERS
    from lpvmpc.errors import LPVMPCError
    from lpvmpc.interface import Command, Preview, State
    from lpvmpc.plant.plant import Plant
    from lpvmpc.road.names import SCENARIOS
    from lpvmpc.road.path import Path
    from lpvmpc.road.scenario import Scenario
    from lpvmpc.road.speed_profile import SpeedProfile
    from lpvmpc.road.wind import Wind
    from lpvmpc.sim.loop import Log, simulate
    from lpvmpc.sim.metrics import metrics
    from lpvmpc.sim.names import load_controller, load_scenario
    from lpvmpc.sim.process.isolated import Isolated
    from lpvmpc.sim.world import World, load_world

_HOME = {
    "CONTROLLERS": "control.registry",
    "Command": "interface",
    "Isolated": "sim.process.isolated",
    "LPVMPC": "control.lpv_mpc",
    "LPVMPCError": "errors",
    "Log": "sim.loop",
    "Path": "road.path",
    "Plant": "plant.plant",
    "Preview": "interface",
    "SCENARIOS": "road.names",
    "Scenario": "road.scenario",
    "SpeedProfile": "road.speed_profile",
    "State": "interface",
    "VehicleParams": "car.params",
    "Wind": "road.wind",
    "World": "sim.world",
    "load_controller": "sim.names",
    "load_scenario": "sim.names",
    "load_world": "sim.world",
    "metrics": "sim.metrics",
    "simulate": "sim.loop",
}

__all__ = [
    "CONTROLLERS",
    "Isolated",
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
    "World",
    "__version__",
    "load_controller",
    "load_scenario",
    "load_world",
    "metrics",
    "simulate",
]

_numba_cache.place_numba_cache()


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
