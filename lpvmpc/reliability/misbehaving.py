"""Controllers that do wrong, at a moment drawn by seed, and what became of their runs.

`lpvmpc.reliability.misbehaving:sleeps_command_7` is a controller that answers seven commands and
then sleeps under a bare except; whatever it does must end its own run, in time and in one sentence,
with all that was measured until then, and leave no process behind.
"""

from __future__ import annotations

import itertools
import math
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.errors import LPVMPCError

if TYPE_CHECKING:
    from lpvmpc.plant.plant import Plant
    from lpvmpc.road.scenario import Scenario

MODULE = "lpvmpc.reliability.misbehaving"
STEP_TIMEOUT, START_TIMEOUT = 1.0, 4.0
"""Limits per call, and for import and constructor [s]."""
MEMORY = 1024
"""Memory that they may ask for [MiB]."""
PATIENCE = 60.0
"""No run may take longer than its limits by more than this on a loaded machine [s]."""
LATEST = 12
"""They answer at most so many commands before they do wrong."""


class Stubborn(BaseException):
    """An exception that `except Exception` does not catch, with a message that cannot be told."""

    def __str__(self) -> str:
        raise RuntimeError("no message")


class Odd:
    """Neither a number nor an array, and not to be shown."""

    def __float__(self) -> float:
        raise LookupError("no number")

    def __array__(self, *_: object, **__: object) -> Any:
        raise LookupError("no array")

    def __repr__(self) -> str:
        raise RuntimeError("no text")


def _raises(error: Callable[[], BaseException]) -> None:
    raise error()


def _sleeps() -> None:
    """Under a bare except, and deaf to the alarm."""
    signal.signal(signal.SIGALRM, signal.SIG_IGN)
    while True:
        try:
            time.sleep(0.01)
        except BaseException:
            continue


def _endless() -> None:
    """In compiled code that never comes back to Python."""
    sum(itertools.repeat(0))


def _hoards() -> None:
    np.ones((2 << 30) // 8)


def _leaves() -> None:
    """Ends, and leaves a process behind that holds everything open."""
    if os.fork() == 0:
        time.sleep(600.0)
    os._exit(7)


def _meddles() -> None:
    """Writes into whatever is open what nobody has asked for."""
    for descriptor in range(3, 64):
        try:
            os.write(descriptor, b"\xff" * 64)
        except OSError:
            continue


RAISES: dict[str, Callable[[], None]] = {
    "raises": partial(_raises, partial(ValueError, "not\ntoday")),
    "exits": partial(_raises, partial(SystemExit, 3)),
    "stubborn": partial(_raises, Stubborn),
    "closes": partial(_raises, GeneratorExit),
    "interrupts": partial(_raises, KeyboardInterrupt),
}
"""What every way of driving survives."""
ENDS: dict[str, Callable[[], None]] = {
    "sleeps": _sleeps,
    "endless": _endless,
    "leaves": _leaves,
    "kills": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "aborts": os.abort,
    "quits": partial(os._exit, 0),
    "hoards": _hoards,
    "meddles": _meddles,
}
"""What only a process of its own survives."""
ANSWERS: dict[str, Any] = {
    "nothing": None,
    "nan": (math.nan, 0.0),
    "infinite": (0.0, -math.inf),
    "huge": (10**400, 0.0),
    "shape": np.zeros((2, 3)),
    "three": (0.0, 0.0, 0.0),
    "text": ("0.1", "0"),
    "odd": (Odd(), 0.0),
    "complex": (1j, 0.0),
}
"""Answers that are no commands."""
TOLD: dict[str, tuple[str, Any]] = {
    "telling-prediction": ("prediction", np.zeros((3, 3))),
    "telling-odd": ("prediction", Odd()),
    "telling-huge": ("kkt_residual", 10**400),
    "telling-fallback": ("fallback", "panic"),
}
"""Diagnostics that are none: field and value."""


class Misbehaving:
    """Answers some commands, then does wrong."""

    what, where, when = "", "", 0

    def __init__(self) -> None:
        self.calls = 0
        self._act("init")

    def reset(self, rng: np.random.Generator) -> None:
        """See `Controller`."""
        self._act("reset")

    def command(self, state: Any, preview: Any) -> Any:
        """See `Controller`; the wrong answer when it is time."""
        self.calls += 1
        if self.calls <= self.when or self.where != "command":
            return 0.0, 0.0
        self._act("command")
        if self.what in TOLD:
            name, value = TOLD[self.what]
            self.diagnostics = type("Diagnostics", (), {name: value})()
        return ANSWERS.get(self.what, (0.0, 0.0))

    def _act(self, where: str) -> None:
        act = {**RAISES, **ENDS}.get(self.what)
        if where == self.where and act is not None:
            act()


def __getattr__(name: str) -> type:
    """A class by what it does, where, and after how many commands: `sleeps_command_7`."""
    what, _, rest = name.partition("_")
    where, _, when = rest.partition("_")
    known = {**RAISES, **ENDS, **ANSWERS, **TOLD}
    if what not in known or where not in ("init", "reset", "command") or not when.isdigit():
        raise AttributeError(name)
    return type(name, (Misbehaving,), {"what": what, "where": where, "when": int(when)})


@dataclass
class Trials:
    """What became of many runs of controllers that do wrong."""

    seed: int
    """Seed of what was tried."""
    tried: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Runs by what was done, and "here" or "isolated"."""
    told: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Of these ended as they have to be."""
    faults: list[str] = field(default_factory=list)
    """Each that was not, and why."""
    longest_s: float = 0.0
    """The longest run, limits included [s]."""


def controllers(seed: int, here: int = 200, isolated: int = 40) -> Trials:
    """Drive controllers that do wrong.

    Args:
        seed: Seed of what each does, where and when.
        here: Number of runs in this process, of what only raises or answers wrongly.
        isolated: Number of runs in processes of their own, of everything.
    """
    from lpvmpc.plant.plant import Plant
    from lpvmpc.road.path import Path as Road
    from lpvmpc.road.scenario import Scenario
    from lpvmpc.road.speed_profile import SpeedProfile

    rng = np.random.default_rng([seed, 0xBAD])
    road = Road.from_curvature(np.zeros(2), 10.0)
    scenario = Scenario(name="short", path=road, speed=SpeedProfile.constant(10.0, road))
    plant, found = Plant(), Trials(seed)
    mild = (*RAISES, *ANSWERS, *TOLD)
    for mode, kinds, count in (("here", mild, here), ("isolated", (*ENDS, *mild), isolated)):
        for i in range(count):
            what = kinds[i % len(kinds)]
            where = "command"
            if what in RAISES or what in ENDS:
                where = str(rng.choice(["init", "reset", "command", "command"]))
            if what == "meddles":  # elsewhere it is what is answered next
                where = "command"
            if what == "interrupts" and mode == "here" and where == "init":
                where = "reset"  # in this process it is Ctrl-C
            name = f"{MODULE}:{what}_{where}_{rng.integers(LATEST + 1)}"
            begin = time.monotonic()
            fault = _fault(name, mode == "isolated", plant, scenario)
            took = time.monotonic() - begin
            if not fault and took > START_TIMEOUT + STEP_TIMEOUT + PATIENCE:
                fault = f"took {took:.0f} s"
            found.longest_s = max(found.longest_s, took)
            found.tried[what, mode] += 1
            found.told[what, mode] += not fault
            if fault:
                found.faults.append(f"{name} {mode}: {fault}")
    return found


def _fault(name: str, isolated: bool, plant: Plant, scenario: Scenario) -> str:
    """What is wrong with how a run ended, or ""."""
    from lpvmpc.sim.loop import simulate
    from lpvmpc.sim.metrics import metrics
    from lpvmpc.sim.names import load_controller
    from lpvmpc.sim.process.isolated import Isolated

    _, where, when = name.rpartition(":")[2].split("_")
    at_once = where != "command" or when == "0"
    try:
        driver: Any
        if isolated:
            driver = Isolated(name, start_timeout=START_TIMEOUT, memory=MEMORY, output=False)
        else:
            driver = load_controller(name)
        log = simulate(plant, driver, scenario, step_timeout=STEP_TIMEOUT, name=name)
        sentence, rows = str(log.meta["reason"]), len(log)
        if metrics(log)["completed"]:
            return "it completed"
    except LPVMPCError as error:
        sentence, rows = str(error), -1
    except BaseException as error:
        return f"{type(error).__name__} came through"
    if not (sentence.isprintable() and 0 < len(sentence) <= 600):
        return f"no sentence: {sentence[:80]!r}"
    if rows != (-1 if at_once else int(when) + 1):
        return f"{rows} instants are measured"
    end = time.monotonic() + 5.0
    while (left := left_behind()) and time.monotonic() < end:
        time.sleep(0.02)  # a process that is killed takes a moment to be gone
    return f"processes {left} are left behind" if left else ""


def left_behind() -> list[int]:
    """Processes of controllers that this process has started and that still run (Linux)."""
    found = []
    if sys.platform.startswith("linux"):
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                words = (folder / "cmdline").read_bytes().split(b"\0")
            except OSError:
                continue
            if any(b"lpvmpc.sim.process.child" in word for word in words):
                if str(os.getpid()).encode() in words[-2:]:
                    found.append(int(folder.name))
    return found
