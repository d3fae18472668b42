"""What a controller and an estimator are given is theirs; whatever they do is one sentence."""

import math
import signal
import time
from types import SimpleNamespace

import numpy as np
import pytest

from lpvmpc import simulate
from lpvmpc.errors import ControllerError, EstimatorError, LPVMPCError, described
from lpvmpc.interface import Command, Diagnostics, State


class Good:
    def reset(self, rng):
        pass

    def command(self, state, preview):
        return 0.0, 0.0


class Unshowable:
    def __repr__(self):
        raise RuntimeError("no")


class Unconvertible:
    def __float__(self):
        raise LookupError("no number")

    def __array__(self, *args, **kwargs):
        raise LookupError("no array")


class Mine(BaseException):
    """Of no class that anybody catches."""

    def __str__(self):
        raise RuntimeError("no message")


def later(action, n=5):
    """A controller that does something at its n-th instant, n from 0."""

    class Later(Good):
        calls = 0

        def command(self, state, preview):
            self.calls += 1
            return action(self, state, preview) if self.calls > n else (0.0, 0.0)

    return Later()


def raising(error):
    def action(*args):
        raise error

    return action


# What it is given -------------------------------------------------------------------------------


@pytest.mark.parametrize("world", ["ideal", "rtk"])
def test_what_it_is_given_is_its_own_and_read_only(plant, straight, world):
    class Scribbler(Good):
        """Makes the reference what it happens to do, if it can."""

        refused = 0

        def command(self, state, preview):
            for array in (preview.vx_ref, preview.kappa, preview.x, preview.y, preview.psi,
                          state.wheel_speed):
                with pytest.raises(ValueError, match="read-only"):
                    array[:] = 77.0
                self.refused += 1
                array.setflags(write=True)  # by force: it is its own copy all the same
                array[:] = 77.0
            return 0.0, 0.0

    scribbler = Scribbler()
    bad = simulate(plant, scribbler, straight, world=world, seed=1)
    good = simulate(plant, Good(), straight, world=world, seed=1)
    assert scribbler.refused >= 6 * (len(bad) - 1)
    for name, column in good.columns.items():
        np.testing.assert_array_equal(bad.columns[name], column, err_msg=name)


def test_the_packages_own_may_scribble_and_change_nothing(plant, straight, monkeypatch):
    from lpvmpc import load_controller
    from lpvmpc.control.geometric import Stanley

    good = simulate(plant, load_controller("stanley"), straight).columns
    command = Stanley.command

    def scribbles(self, state, preview):
        answer = command(self, state, preview)
        preview.vx_ref[:] = state.wheel_speed[:] = 77.0
        return answer

    monkeypatch.setattr(Stanley, "command", scribbles)
    bad = simulate(plant, load_controller("stanley"), straight).columns
    assert all(np.array_equal(bad[name], good[name], equal_nan=True) for name in good)


# What it does -----------------------------------------------------------------------------------

WRONG = [None, math.nan, (math.nan, 0.0), (0.0, math.inf), (10**400, 0.0), ("1", "2"), "12",
         {1: 2, 3: 4}, np.zeros((2, 3)), np.zeros(3), (1j, 0.0), Unconvertible(), Unshowable(),
         (Unconvertible(), 0.0), (Unshowable(), None), [[1.0], [2.0, 3.0]], iter(()), object]


@pytest.mark.parametrize("answer", WRONG, ids=lambda answer: type(answer).__name__)
def test_every_answer_that_is_none_is_one_sentence(point_plant, straight, answer):
    log = simulate(point_plant, later(lambda *_: answer), straight)
    reason = log.meta["reason"]
    assert not log.meta["completed"] and len(log) == 6 and len(log.timing["t_s"]) == 5
    assert reason.startswith("Controller 'Later' returned ") and "at t = 0.165 s" in reason
    assert "\n" not in reason and len(reason) < 250
    with pytest.raises(ControllerError):  # at the first instant there is nothing to save
        simulate(point_plant, later(lambda *_: answer, 0), straight)


@pytest.mark.parametrize("error", [
    ValueError("two\nlines"), SystemExit(3), KeyboardInterrupt(), GeneratorExit(), Mine(),
    MemoryError(), RecursionError("deep"), StopIteration(), ControllerError("Of\nits own.")])
def test_whatever_it_raises_ends_the_run_with_one_sentence(point_plant, straight, error):
    reason = simulate(point_plant, later(raising(error)), straight).meta["reason"]
    assert "\n" not in reason
    if type(error) is not ControllerError:
        assert reason == f"Controller 'Later' raised in command at t = 0.165 s: {described(error)}"

    class Reset(Good):
        def reset(self, rng):
            raise error

    with pytest.raises(ControllerError):
        simulate(point_plant, Reset(), straight)


def test_ctrl_c_is_not_taken_for_its_own(point_plant, straight):
    before = signal.getsignal(signal.SIGINT)
    action = later(lambda *_: signal.raise_signal(signal.SIGINT))
    assert simulate(point_plant, action, straight).meta["reason"] == "interrupted"
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("wrong", [
    {"solved": "no"}, {"fallback": []}, {"fallback": Unshowable()}, {"kkt_residual": 10**400},
    {"solve_us": 1j}, {"prediction": np.zeros((3, 3))}, {"prediction": Unconvertible()},
    {"prediction": np.zeros((12, 5))}, {"prediction": [[1], [2, 3]]}])
@pytest.mark.parametrize("kind", [SimpleNamespace, Diagnostics])
def test_wrong_diagnostics_are_its_failure(point_plant, straight, wrong, kind):
    def action(self, state, preview):
        self.diagnostics = kind(**wrong)
        return 0.0, 0.0

    log = simulate(point_plant, later(action), straight)
    (field,) = wrong
    assert log.meta["reason"].startswith(f"diagnostics.{field} is ") and len(log) == 6


def test_diagnostics_of_the_right_kind_are_recorded(point_plant, straight):
    def action(self, state, preview):
        self.diagnostics = Diagnostics(solved=np.bool_(False), prediction=np.ones((11, 5)))
        return 0.0, 0.0

    columns = simulate(point_plant, later(action, 0), straight).columns
    assert not columns["solved"].any()
    assert columns["pred_y_m_3"] == pytest.approx(1.0)  # a metre to the left of the road


class Attribute:
    """An attribute that cannot be read."""

    def __get__(self, owner, kind=None):
        raise ZeroDivisionError("not to be read")


@pytest.mark.parametrize("name", ["name", "Ts", "Np", "preview_steps", "weights", "stiffness",
                                  "diagnostics"])
def test_an_attribute_that_cannot_be_read_is_named(point_plant, straight, name):
    kind = type("Hidden", (Good,), {name: Attribute()})
    with pytest.raises(LPVMPCError, match=f"attribute {name} of Hidden is ZeroDivisionError"):
        simulate(point_plant, kind(), straight)


@pytest.mark.parametrize(("name", "value"), [
    ("name", 3), ("name", "two\nlines"), ("name", "x" * 201), ("Ts", math.nan), ("Ts", 10**400),
    ("Ts", Unshowable()), ("Np", True), ("Np", 10**5000), ("Np", "10"), ("preview_steps", -1),
    ("preview_steps", 1e3), ("weights", {"q": math.inf}), ("weights", {"q": 10**400}),
    ("weights", {3: 1.0}), ("weights", {"q": Unconvertible()}), ("weights", [1.0]),
    ("weights", {Unshowable(): 1.0}), ("weights", type("W", (), {}))],
    ids=lambda value: value if isinstance(value, str) and len(value) < 20 else type(value).__name__)
def test_a_wrong_attribute_is_one_sentence_before_the_drive(point_plant, straight, name, value):
    made = Good()
    setattr(made, name, value)
    with pytest.raises(LPVMPCError, match=f"controller {name.rstrip('s')}") as caught:
        simulate(point_plant, made, straight)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 250
    assert point_plant.commands == []


def test_the_attributes_are_read_once(point_plant, straight):
    class Changing(Good):
        reads = 0

        @property
        def weights(self):
            self.reads += 1
            return {"q": np.float32(self.reads)}

    made = Changing()
    log = simulate(point_plant, made, straight)
    assert made.reads == 1 and log.weights == {"q": 1.0} and type(log.weights["q"]) is float


def test_hidden_time_is_found_afterwards(point_plant, straight):
    def action(*_):
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            try:
                time.sleep(0.01)
            except:  # noqa: E722
                pass
        return 0.0, 0.0

    log = simulate(point_plant, later(action), straight, step_timeout=0.1)
    assert log.meta["reason"].startswith("Controller 'Later' did not return from command within")


# Estimators -------------------------------------------------------------------------------------

ESTIMATOR = """
import math, time
import numpy as np
from lpvmpc.interface import State
class Mine:
    calls = 0
    def reset(self, first, rng): self.state = first
    def update(self, measured, command):
        self.calls += 1
        return self.state if self.calls <= 5 else self.later(measured)
    def later(self, measured): return self.state
class Raises(Mine):
    def later(self, measured): raise GeneratorExit
class Hangs(Mine):
    def later(self, measured):
        while True: pass
class Nan(Mine):
    def later(self, measured): return self.state._replace(vx=math.nan)
class Huge(Mine):
    def later(self, measured): return self.state._replace(vx=10**400)
class Shape(Mine):
    def later(self, measured): return self.state._replace(wheel_speed=np.zeros(3))
class Scribbles(Mine):
    def later(self, measured):
        measured.wheel_speed[:] = 77.0
class Unknowns(Mine):
    @property
    def unknowns(self): return {"bias": math.nan}
class Events(Mine):
    @property
    def events(self): raise SystemExit
"""


@pytest.mark.parametrize(("name", "sentence"), [
    ("Raises", "'mine:Raises' raised in update at t = 0.165 s: GeneratorExit"),
    ("Hangs", "'mine:Hangs' did not return from update within 0.1 s at t = 0.165 s"),
    ("Nan", "'mine:Nan' returned at t = 0.165 s, twice and after a reset, what is no State"),
    ("Huge", "what is no State"), ("Shape", "what is no State"),
    ("Scribbles", "ValueError: assignment destination is read-only"),
    ("Unknowns", "estimator unknown bias is nan, but must be a finite number"),
    ("Events", "raised in its attributes at t = 0.000 s: SystemExit")])
def test_an_estimator_that_fails_ends_the_run(plant, straight, user_module, name, sentence):
    user_module(ESTIMATOR)
    log = simulate(plant, Good(), straight, world="rtk", estimator=f"mine:{name}",
                   step_timeout=0.1)
    assert not log.meta["completed"] and sentence in log.meta["reason"]
    assert len(log) >= 6 and np.isfinite(log.columns["meas_wheel_speed_fl_radps"][:5]).all()
    assert not (log.columns["meas_wheel_speed_fl_radps"] == 77.0).any()


def test_an_estimator_that_fails_at_once_is_refused(plant, straight, user_module):
    user_module(ESTIMATOR + "class Bad(Mine):\n    def reset(self, first, rng): raise Exception\n")
    with pytest.raises(EstimatorError, match="'mine:Bad' raised in reset at t = 0.000 s"):
        simulate(plant, Good(), straight, world="rtk", estimator="mine:Bad")


def test_a_state_of_other_numbers_is_one_of_floats():
    from lpvmpc.sim.guard import checked_state

    state = State(*np.arange(9, dtype=np.float32), [1, 2, 3, math.nan])
    found = checked_state(state)
    assert all(type(value) is float for value in found[:9]) and found.psi == 2.0
    assert found.wheel_speed.dtype == np.float64
    assert checked_state(Command(0.0, 0.0)) is None and checked_state(None) is None
