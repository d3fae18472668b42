import importlib
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from lpvmpc.interface import Command, State
from lpvmpc.kit import cli
from lpvmpc.plant.deviations import NOMINAL
from lpvmpc.plant.outputs import Wheels
from lpvmpc.road.path import Path as Road
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.speed_profile import SpeedProfile

ROOT = Path(__file__).parents[1]


def pytest_configure():
    """Let Ctrl-C be tested: what a shell starts in the background is told to ignore it."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def root() -> Path:
    return ROOT


@pytest.fixture
def straight():
    """100 m straight on at 10 m/s, no wind."""
    road = Road.from_curvature(np.zeros(2), 100.0)
    return Scenario(name="straight", path=road, speed=SpeedProfile.constant(10.0, road))


@pytest.fixture(scope="session")
def plant():
    from lpvmpc.plant.plant import Plant

    return Plant()


@pytest.fixture(scope="module")
def command(request):
    """The module of the command that a test module names as COMMAND."""
    return importlib.import_module(f"lpvmpc.commands.{request.module.COMMAND}")


@pytest.fixture
def run(command, tmp_path, monkeypatch, capsys):
    """Runs the command in an empty folder: (exit code, stdout, stderr)."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        code = cli.run(command.Options, command.main, [str(a) for a in arguments])
        output = capsys.readouterr()
        return code, output.out, output.err

    return call


class PointPlant:
    """A car that turns and accelerates exactly as commanded: for rules that need no physics."""

    Ts = 0.033
    params = SimpleNamespace(lf=1.2, lr=1.6, width=1.8)
    nominal_model = mujoco.MjModel.from_xml_string("<mujoco/>")
    held = Command(0.0, 0.0)
    latency, latency_step, deviations = 0.0, 0.001, NOMINAL
    roll = 0.0
    rolled_over = False

    def __init__(self):
        self.friction = np.ones(4)
        self.commands = []
        self.x = self.y = self.psi = self.vx = 0.0

    def tilt(self, grade=0.0, bank=0.0, psi=0.0):
        pass

    def reset(self, x, y, psi, vx, *, kappa=0.0, wind=(0.0, 0.0), align="heading"):
        self.x, self.y, self.psi, self.vx = x, y, psi, vx
        return self.state

    @property
    def state(self):
        return State(self.x, self.y, self.psi, self.vx, 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(4))

    def step(self, command, wind=(0.0, 0.0)):
        self.commands.append(command)
        self.psi += self.vx / 2.8 * np.tan(command.delta) * self.Ts
        self.vx += command.ax * self.Ts
        self.x += self.vx * np.cos(self.psi) * self.Ts
        self.y += self.vx * np.sin(self.psi) * self.Ts
        return self.state

    @property
    def qpos(self):
        return np.array([self.x, self.y, 0.0, 1.0, 0.0, 0.0, self.psi])

    @property
    def wheels(self):
        return Wheels(*np.zeros((5, 4)), mu=0.82 * self.friction)


@pytest.fixture
def point_plant():
    return PointPlant()


@pytest.fixture
def point_plant_class():
    return PointPlant


@pytest.fixture
def user_module(tmp_path, monkeypatch):
    """Writes a module of a user's controllers into an empty current directory."""
    monkeypatch.chdir(tmp_path)
    before = set(sys.modules)

    def write(source: str, name: str = "mine") -> str:
        (tmp_path / f"{name}.py").write_text(source)
        return name

    yield write
    for name in set(sys.modules) - before:
        if getattr(sys.modules[name], "__file__", None) and str(tmp_path) in str(
            sys.modules[name].__file__
        ):
            del sys.modules[name]
    sys.path[:] = [p for p in sys.path if p != str(tmp_path)]
