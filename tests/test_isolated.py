"""A controller in a process of its own: the same drive, and no way out of it."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from lpvmpc import Isolated, load_controller, simulate
from lpvmpc.errors import ControllerError, OptionError, UnknownNameError
from lpvmpc.interface import AxleForces, Command, Diagnostics, Preview, State
from lpvmpc.road.path import Path as Road
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.speed_profile import SpeedProfile
from lpvmpc.sim.driver import Answer
from lpvmpc.sim.process import wire

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs a POSIX system")

SOURCE = '''
import itertools, os, signal, subprocess, sys, threading, time
import numpy as np
class Mine:
    """Does nothing for five instants, then what its class is for."""
    calls = 0
    def reset(self, rng): pass
    def command(self, state, preview):
        self.calls += 1
        return self.later(state, preview) if self.calls > 5 else (0.0, 0.0)
    def later(self, state, preview): return 0.0, 0.0
class Raises(Mine):
    def later(self, state, preview): raise ValueError("not today")
class Interrupts(Mine):
    def later(self, state, preview): raise KeyboardInterrupt
class NotANumber(Mine):
    def later(self, state, preview): return float("nan"), 0.0
class Nothing(Mine):
    def later(self, state, preview): pass
class Shape(Mine):
    def later(self, state, preview): return np.zeros((2, 3))
class Sleeps(Mine):
    def later(self, state, preview):
        signal.signal(signal.SIGALRM, signal.SIG_IGN)
        while True:
            try: time.sleep(0.01)
            except: pass
class Exits(Mine):
    def later(self, state, preview): os._exit(0)
class Killed(Mine):
    def later(self, state, preview): os.kill(os.getpid(), signal.SIGKILL)
class Endless(Mine):
    def later(self, state, preview): return sum(itertools.repeat(0.0)), 0.0
class Hoards(Mine):
    def later(self, state, preview):
        self.hoard = bytearray(2 << 30)
        return 0.0, 0.0
class Leaves(Mine):
    """Leaves a process behind that holds all that this one has open, and ends."""
    def later(self, state, preview):
        if not os.fork(): time.sleep(600)
        os._exit(7)
class Forks(Mine):
    """Leaves one in a session of its own."""
    def later(self, state, preview):
        if self.calls == 6 and not os.fork():
            os.setsid()
            open(FILE, "w").write(str(os.getpid()))
            time.sleep(600)
        while not os.path.exists(FILE) or not open(FILE).read(): pass
        return 0.0, 0.0
class Lies(Mine):
    """Writes to whatever it has open what is no message."""
    def later(self, state, preview):
        for descriptor in range(3, 64):
            try: os.write(descriptor, b"x" * 64)
            except OSError: pass
        return 0.0, 0.0
class Thinks(Mine):
    """Works between the calls, and stops the clock."""
    def reset(self, rng):
        threading.Thread(target=self.think, daemon=True).start()
        time.process_time_ns = time.perf_counter_ns = lambda: 0
    def think(self):
        while True: sum(range(1000))
    def later(self, state, preview):
        end = time.monotonic() + 0.02
        while time.monotonic() < end: pass
        return 0.0, 0.0
class Scribbles(Mine):
    def later(self, state, preview):
        preview.vx_ref.setflags(write=True)
        preview.vx_ref[:] = 77.0
        return 0.0, 0.0
class Init(Mine):
    def __init__(self): sum(itertools.repeat(0.0))
class Weights(Mine):
    weights = {"q": float("nan")}
class Talks(Mine):
    name, Np, preview_steps, weights = "talker", 3, 7, {"q": 1.5}
    def later(self, state, preview):
        assert len(preview.x) == 8 and not state.wheel_speed.flags.writeable
        assert "lpvmpc.plant.plant" not in sys.modules
        self.diagnostics = type("D", (), {"fallback": "braking", "prediction": np.ones((4, 5))})()
        if self.calls == 6: print("out of the way")
        return 0.0, 0.0
'''


@pytest.fixture
def mine(user_module):
    user_module(SOURCE)
    return "mine"


# The same drive -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "options", "world"), [
    ("stanley", {}, "rtk"), ("lpv-mpc", {"stiffness": "oracle", "delay": 1}, "ideal"),
    pytest.param("lpv-mpc", {}, "fleet", marks=pytest.mark.slow),
    pytest.param("lpv-mpc-paper", {}, "ideal", marks=pytest.mark.slow),
    pytest.param("lmpc-pso-pid", {}, "ideal", marks=pytest.mark.slow),
    pytest.param("pure-pursuit", {}, "production", marks=pytest.mark.slow)])
def test_the_trace_has_the_bytes_of_a_drive_in_this_process(plant, tmp_path, name, options, world):
    road = Road.from_curvature([0.0, 0.0, 0.02, -0.02, 0.0], 15.0)
    bend = Scenario(name="bend", path=road, speed=SpeedProfile.constant(12.0, road))
    traces = []
    for kind in (load_controller, Isolated):
        log = simulate(plant, kind(name, **options), bend, seed=5, world=world, name=name,
                       delay=options.get("delay", 0))
        log.write(tmp_path)
        traces.append((tmp_path / "trace.parquet").read_bytes())
        assert log.meta["completed"]
        assert log.meta["told_axle_forces"] is (options.get("stiffness") == "oracle")
        if kind is Isolated:  # measured out here, messages included
            assert np.median(log.timing["wall_us"] - log.timing["step_us"]) > 0.0
    assert traces[0] == traces[1]


def test_what_it_says_of_itself_and_of_its_commands_arrives(point_plant, straight, mine, capfd):
    log = simulate(point_plant, Isolated(f"{mine}:Talks"), straight)
    assert log.meta["completed"] and log.meta["controller"] == "talker"
    assert log.meta["Np"] == 3 and log.weights == {"q": 1.5}
    assert log.meta["has_qp"] and (log.columns["fallback"][5:-1] == 2).all()
    assert log.columns["pred_y_m_3"][6] == pytest.approx(1.0)
    assert (log.timing["step_us"] > 0.0).all() and len(log.timing["t_s"]) == len(log)
    out, err = capfd.readouterr()
    assert out == "" and "out of the way" in err


def test_what_it_writes_to_is_no_part_of_the_record(point_plant, straight, mine):
    log = simulate(point_plant, Isolated(f"{mine}:Scribbles"), straight)
    assert log.meta["completed"] and (log.columns["vx_ref_mps"] == 10.0).all()


# No way out ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "sentence"), [
    ("Raises", "raised in command at t = 0.165 s: ValueError: not today"),
    ("Interrupts", "raised in command at t = 0.165 s: KeyboardInterrupt"),
    ("NotANumber", "returned (nan, 0.0) at t = 0.165 s, but must return two finite numbers"),
    ("Nothing", "returned None at t = 0.165 s"),
    ("Shape", "at t = 0.165 s, but must return two finite numbers"),
    ("Sleeps", "did not return from command within 0.3 s at t = 0.165 s"),
    ("Exits", "ended its process with code 0 in command at t = 0.165 s"),
    ("Killed", "was ended by signal 9 (SIGKILL) in command at t = 0.165 s"),
    ("Endless", "did not return from command within 0.3 s at t = 0.165 s"),
    ("Hoards", "raised in command at t = 0.165 s: MemoryError"),
    ("Leaves", "ended its process with code 7 in command at t = 0.165 s"),
    ("Lies", "sent what is no answer from command at t = 0.165 s")])
def test_every_misbehaviour_is_the_end_of_its_run_alone(point_plant, straight, mine, name,
                                                        sentence):
    before = children()
    begin = time.monotonic()
    log = simulate(point_plant, Isolated(f"{mine}:{name}"), straight, name=f"mine:{name}",
                   step_timeout=0.3 if "within 0.3 s" in sentence else 20.0)
    assert log.meta["reason"].startswith(f"Controller 'mine:{name}' ") or name == "Lies"
    assert sentence in log.meta["reason"] and "\n" not in log.meta["reason"]
    assert not log.meta["completed"] and len(log) == 6  # what was measured is there
    assert time.monotonic() - begin < 30.0
    assert children() == before


@pytest.mark.parametrize(("name", "sentence"), [
    ("Init", r"its import and constructor within 1 s at t = 0.000 s \(start_timeout\)"),
    ("Weights", "controller weight q is nan, but must be a finite number"),
    ("Absent", "has no class 'Absent'")])
def test_what_cannot_be_made_is_refused(point_plant, straight, mine, name, sentence):
    before = children()
    with pytest.raises(ControllerError, match=sentence):
        simulate(point_plant, Isolated(f"{mine}:{name}", start_timeout=1.0), straight)
    assert children() == before


def test_an_import_that_never_ends_is_given_up(point_plant, straight, user_module):
    user_module("import itertools\nsum(itertools.repeat(0.0))\n")
    with pytest.raises(ControllerError, match="'mine:Mine' did not return from its import"):
        simulate(point_plant, Isolated("mine:Mine", start_timeout=0.5), straight)


def test_the_first_command_may_take_longer(point_plant, straight, user_module):
    user_module("import time\nclass Mine:\n    calls = 0\n    def reset(self, rng): pass\n"
                "    def command(self, state, preview):\n        self.calls += 1\n"
                "        if self.calls in (1, 9): time.sleep(0.8)\n        return 0.0, 0.0\n")
    log = simulate(point_plant, Isolated("mine:Mine", first_timeout=30.0), straight,
                   step_timeout=0.4)
    assert log.meta["reason"].endswith(
        "did not return from command within 0.4 s at t = 0.264 s (--step-timeout)")
    with pytest.raises(ControllerError, match=r"within 0.2 s at t = 0.000 s \(first_timeout\)"):
        simulate(point_plant, Isolated("mine:Mine", first_timeout=0.2), straight)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
def test_what_it_started_in_a_session_of_its_own_ends_with_it(
    point_plant, straight, mine, tmp_path, monkeypatch
):
    (tmp_path / "mine.py").write_text(f"FILE = {str(tmp_path / 'pid')!r}\n" + SOURCE)
    log = simulate(point_plant, Isolated(f"{mine}:Forks"), straight)
    assert len(log) >= 6 and gone(int((tmp_path / "pid").read_text()))


def test_the_package_says_no_as_ever(point_plant, straight):
    with pytest.raises((ControllerError, UnknownNameError), match="Unknown controller 'mpc'"):
        simulate(point_plant, Isolated("mpc"), straight)
    for name, wrong in (("start_timeout", 0.0), ("first_timeout", -1.0), ("memory", 100),
                        ("memory", 0.5)):
        with pytest.raises(OptionError, match=name):
            Isolated("stanley", **{name: wrong})


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs the clock of a process")
def test_threads_between_the_calls_and_a_stopped_clock_are_charged(point_plant, mine):
    road = Road.from_curvature(np.zeros(2), 10.0)
    short = Scenario(name="short", path=road, speed=SpeedProfile.constant(10.0, road))
    log = simulate(point_plant, Isolated(f"{mine}:Thinks"), short)
    assert log.meta["completed"] and len(log) == 31
    assert np.median(log.timing["step_us"][6:]) > 10e3  # it worked for 20 ms


def test_it_ends_with_the_one_that_started_it(mine, tmp_path):
    """Killed without a word in the middle of a call that never returns."""
    (tmp_path / "drive.py").write_text(
        "import numpy as np\n"
        "from lpvmpc import Isolated\n"
        "from lpvmpc.interface import Preview, State\n"
        "with Isolated('mine:Endless').driver(None, None) as driver:\n"
        "    print(driver._process.pid, flush=True)\n"
        "    driver.reset(1)\n"
        "    for _ in range(6):\n"
        "        driver.ask(0.0, State(*np.zeros(9), np.zeros(4)), Preview(0, 0, 0, *np.zeros((5, "
        "11))), None)\n"
    )
    parent = subprocess.Popen([sys.executable, "drive.py"], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    time.sleep(0.3)
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert gone(child)


def gone(pid):
    """Whether a process is gone, or goes in a moment."""
    end = time.monotonic() + 10.0
    while alive(pid) and time.monotonic() < end:
        time.sleep(0.02)
    return not alive(pid)


def alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def children():
    """Processes that this one has started, and those that have lost their parent."""
    listed = subprocess.run(["ps", "-A", "-o", "pid=,args="], capture_output=True, text=True)
    return {line for line in listed.stdout.splitlines()
            if "sim.process.child" in line and line.split()[-1] == str(os.getpid())}


# The bytes between them ---------------------------------------------------------------------------


def test_an_instant_arrives_bit_for_bit():
    rng = np.random.default_rng(0)
    state = State(*rng.normal(size=9).tolist(), rng.normal(size=4))
    preview = Preview(*rng.normal(size=3).tolist(), *rng.normal(size=(5, 8)))
    axles = AxleForces(*rng.normal(size=9).tolist())
    for told in (None, axles):
        t, *found = wire.of_instant(wire.instant(0.1, state, preview, told))
        assert t == 0.1 and found[2] == told
        for was, now in ((state, found[0]), (preview, found[1])):
            assert type(now) is type(was)
            assert all(np.array_equal(a, b) for a, b in zip(was, now, strict=True))
        assert found[1].kappa.flags.c_contiguous and found[1].kappa.flags.writeable


def test_an_answer_arrives_or_is_refused():
    told = Diagnostics(solved=False, fallback="driving", prediction=np.ones((4, 5)))
    given = Answer(Command(0.1, -2.0), told, 12.5, 13.0)
    payload = wire.answer(given)
    found = wire.of_answer(payload, 3)
    assert found.command == given.command and found.cpu_us == 12.5 and found.wall_us == 13.0
    assert found.told.fallback == "driving" and not found.told.solved
    assert np.array_equal(found.told.prediction, told.prediction)
    assert wire.of_answer(wire.answer(given._replace(told=None)), 3).told is None
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(2000):  # whatever arrives is an answer or refused
        length = rng.integers(len(payload) + 1) if rng.random() < 0.5 else len(payload)
        wrong = bytearray(payload[:length])
        for i in rng.integers(len(wrong), size=3) if wrong else ():
            wrong[i] = rng.integers(256)
        try:
            wire.of_answer(bytes(wrong), 3)
        except wire.WireError:
            refused += 1
    assert refused > 500
    with pytest.raises(wire.WireError):
        wire.of_answer(payload, 4)  # of another horizon
    with pytest.raises(wire.WireError):
        wire.of_answer(wire.answer(given._replace(command=Command(float("nan"), 0.0))), 3)
