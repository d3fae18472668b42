"""What every controller on a QP does alike: one tracker, one handle, and copies of both."""

import copy
import pickle
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import lpvmpc
from lpvmpc.control.horizon import Horizon
from lpvmpc.control.lmpc import LMPC
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.qp import condense
from lpvmpc.control.solver.checked import QPResult
from lpvmpc.control.tracker import BRAKING, Tracker
from lpvmpc.errors import OptionError
from lpvmpc.interface import Preview, State
from lpvmpc.paper import printed_formulas
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.names import load_scenario

PACKAGE = str(Path(lpvmpc.__file__).parent)
TS = 0.033
TRACKERS = {"lpv-mpc": LPVMPC, "lmpc-pso-pid": LMPC, "printed": printed_formulas.Printed_none}


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def seen(ey=0.1, epsi=0.02, vx=15.0, kappa=0.005, n=13):
    """State and preview of a car beside its line in a wide bend."""
    state = State(0.0, 0.0, 0.0, vx, 0.02, kappa * vx, 0.01, 0.1, 1.0, np.full(4, vx / 0.3))
    flat = np.zeros(n + 1)
    return state, Preview(0.0, ey, epsi, flat + kappa, flat + vx + 0.5, flat, flat, flat)


class Integrator(Tracker):
    """The shortest tracker: the lateral error is the sum of steering, on a car that keeps speed."""

    name = "integrator"
    weights: dict[str, float] = {}

    def __init__(self, car):
        one = np.ones(1)
        h = Horizon.allocated(
            4, 5, 1, Ts=TS, car=one, q=np.tile([0.0, 0.0, 0.0, 1.0, 0.0], (4, 1)), r_du=1e-6 * one,
            du_max=10.0 * one, scale=one, soft=3, soft_bound=10.0, slack_weights=np.ones(2),
            Ad=np.eye(5), u_lo=-1.0, u_hi=1.0,
        )
        h.Bd[:, 3, 0] = 1.0
        super().__init__(car, h)

    def write_qp(self, state, preview):
        condense(self.horizon.handle)


# The seam ---------------------------------------------------------------------------------------


def test_a_new_tracker_is_one_hook(car):
    controller = Integrator(car)
    state, preview = seen(ey=0.3)
    assert controller.command(state, preview).delta == pytest.approx(-0.3, abs=1e-4)
    np.testing.assert_allclose(controller.diagnostics.prediction[1:, 3], 0.0, atol=1e-4)
    np.testing.assert_allclose(controller.diagnostics.prediction[:, 0], 15.0)
    controller.solver.solve = lambda *qp: QPResult(np.empty(0), False, "NO", np.nan, 0.0, 0.0)
    last = [controller.command(state, preview).ax for _ in range(4)]
    assert last == [0.0, 0.0, 0.0, 0.5]  # geometry drives: the speed is 0.5 m/s below its reference


@pytest.mark.parametrize("name", TRACKERS)
def test_every_tracker_checks_and_falls_back_alike(car, name):
    controller = TRACKERS[name](car)
    state, preview = seen()
    controller.reset(np.random.default_rng(0))
    controller.command(state, preview)
    assert controller.diagnostics.solved
    wanted = controller.horizon.plan[:4, 0].copy()
    got = []
    for part in ("vx", "vy", "r", "delta"):
        got.append(controller.command(state._replace(**{part: np.nan}), preview))
        assert controller.diagnostics.status == "NOT_FINITE"
    # what is learned of the steering, gain and offset, is 1 and 0 to rounding here
    np.testing.assert_allclose([command.delta for command in got], wanted, rtol=0.0, atol=1e-9)
    assert [command.ax == BRAKING for command in got] == [False, False, False, True]
    steps = controller.least_preview
    with pytest.raises(OptionError, match=f"length is {steps}, but must be at least {steps + 1} "):
        controller.command(state, seen(n=steps - 1)[1])


@pytest.mark.parametrize("name", ["lpv-mpc", "lmpc-pso-pid"])
@pytest.mark.parametrize("delay", [-1, 31, 1.0])
def test_every_tracker_refuses_an_impossible_delay(car, name, delay):
    with pytest.raises(OptionError, match="delay is .* a whole number of periods from 0 to 30"):
        TRACKERS[name](car, delay=delay)


class Counted(LPVMPC):
    """Counts the Python calls of one period in the middle of a run."""

    period = 0

    def command(self, state, preview):
        self.period += 1
        if self.period != 40:
            return super().command(state, preview)
        self.calls = Counter()

        def count(frame, event, _):
            file = frame.f_code.co_filename
            if event == "call" and file.startswith(PACKAGE):
                self.calls[file, frame.f_code.co_name] += 1

        sys.setprofile(count)
        try:
            return super().command(state, preview)
        finally:
            sys.setprofile(None)


def test_one_period_walks_through_few_files_and_calls():
    plant = Plant()
    controller = Counted(plant.params)
    controller.period = 0  # warming up drove some
    simulate(plant, controller, load_scenario("slalom"))
    files = {file for file, _ in controller.calls}
    assert any(file.endswith("network.py") for file in files)  # it adapts
    assert controller.diagnostics.solved
    assert 5 < len(files) <= 9, sorted(files)
    assert 10 < sum(controller.calls.values()) <= 30, controller.calls


# The handle -------------------------------------------------------------------------------------


def test_the_handle_shares_the_arrays(car):
    controller = LPVMPC(car)
    h = controller.horizon
    h.H[:] = np.nan
    controller.command(*seen())
    assert np.isfinite(h.H).all()
    with pytest.raises(AttributeError):  # numbers are copied: to change one would do nothing
        h.delta_max = 1.0


def test_all_handles_have_one_type(car):
    """Else each controller would compile what it shares with the others anew."""
    types = {maker(car).horizon.handle._numba_type_ for maker in (*TRACKERS.values(), Integrator)}
    assert len(types) == 1


PERIOD = """
import numpy as np
from lpvmpc.control import period, qp, horizon
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.plant.mjcf import packaged_car
LPVMPC(packaged_car())
for function in (horizon._make, period.estimate, period.write, period.accept, period.shift):
    hits, misses = function.stats.cache_hits, function.stats.cache_misses
    print(function.__name__, sum(hits.values()), sum(misses.values()))
"""


def test_the_compiled_period_is_kept_between_processes():
    run = [sys.executable, "-c", PERIOD]
    subprocess.run(run, check=True, capture_output=True)  # whoever comes first compiles
    told = subprocess.run(run, check=True, capture_output=True, text=True).stdout.split("\n")
    for line in filter(None, told):
        name, hits, misses = line.split()
        assert (int(hits), int(misses)) == (1, 0), name
    assert len([line for line in told if line]) == 5


# Copies -----------------------------------------------------------------------------------------


def commands(controller, periods):
    """Bytes of the commands along a weaving reference."""
    out = []
    for k in range(periods):
        state, preview = seen(ey=0.2 * np.cos(0.3 * k), epsi=0.03 * np.sin(0.2 * k))
        out.append(controller.command(state, preview))
    return np.array(out).tobytes()


@pytest.mark.parametrize("way", [copy.deepcopy, lambda one: pickle.loads(pickle.dumps(one))])
@pytest.mark.parametrize("name", TRACKERS)
def test_a_copy_in_the_middle_of_a_run_drives_on_the_same(car, name, way):
    controller = TRACKERS[name](car)
    controller.reset(np.random.default_rng(0))
    commands(controller, 15)
    other = way(controller)
    ours = commands(controller, 30)
    assert commands(other, 30) == ours  # and the first one has not moved the second
    other.reset(np.random.default_rng(0))
    controller.reset(np.random.default_rng(0))
    assert commands(other, 10) == commands(controller, 10)


def test_a_copy_from_another_process_drives_the_same(car, tmp_path):
    controller = LPVMPC(car)
    (tmp_path / "controller.pkl").write_bytes(pickle.dumps(controller))
    code = (
        "import pickle, sys; from tests.test_tracker import commands; "
        "print(commands(pickle.load(open(sys.argv[1], 'rb')), 20).hex())"
    )
    told = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "controller.pkl")],
        check=True, capture_output=True, text=True, cwd=Path(__file__).parents[1],
    ).stdout.strip()
    assert told == commands(controller, 20).hex()
