"""Who drives: a controller in this process, asked once per control period and measured.

`sim.loop` talks to a driver only. This one holds the controller itself; the one of
`sim.process.isolated` holds a process in which the controller lives.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from lpvmpc.control.registry import oracle_of
from lpvmpc.errors import ControllerError, LPVMPCError, OptionError
from lpvmpc.interface import (
    AxleForces,
    Command,
    Controller,
    Declared,
    Diagnostics,
    Preview,
    State,
    clamped_inputs,
    declared,
    told_by,
)
from lpvmpc.sim.guard import Alarm, Guard, checked_command, own_copy


class Answer(NamedTuple):
    """What came of asking a controller once."""

    command: Command
    """Its command, two finite numbers."""
    told: Diagnostics | None
    """What it tells of it."""
    cpu_us: float
    """CPU time of the call, all threads [us]."""
    wall_us: float
    """Wall-clock time of the call [us]."""


class Driver(Protocol):
    """What the closed loop asks for commands."""

    about: Declared
    """What the controller says of itself."""
    oracle: bool
    """Whether it is told the true axle forces."""

    def reset(self, seed: int) -> None:
        """Make the controller forget its last run; its generator is made from the seed."""

    def ask(self, t: float, state: State, preview: Preview, axles: AxleForces | None) -> Answer:
        """The command for a control instant t [s]; `axles` where it is told them.

        Raises:
            LPVMPCError: The controller failed; the message is one sentence.
        """

    def clamped(self) -> int | None:
        """Inputs of its network outside the trained range; None: it has none."""


class InProcess:
    """A controller in this process."""

    def __init__(
        self,
        controller: Controller,
        name: str | None = None,
        alarm: Alarm | None = None,
        seconds: float | None = None,
    ) -> None:
        """Read what the controller says of itself.

        Args:
            controller: The controller.
            name: What to call it (default: as it says).
            alarm: What interrupts it; None where somebody else watches the time.
            seconds: Longest wall-clock time of one call [s]; None: no limit.

        Raises:
            OptionError: An attribute that cannot be what it has to be.
            ControllerError: Reading them took too long, or raised.
        """
        self._controller = controller
        called = name or type(controller).__name__
        guard = Guard("Controller", called, ControllerError, alarm, seconds)
        about = guard.call("its attributes", 0.0, declared, controller)
        self.about: Declared = replace(about, name=name) if name else about
        self._guard = Guard("Controller", self.about.name, ControllerError, alarm, seconds)
        self._oracle = oracle_of(controller)
        self.oracle = self._oracle is not None
        # compiled for writable arrays; what it writes to is its own copy as well
        self._ours = type(controller).__module__.startswith("lpvmpc.control.")

    def reset(self, seed: int) -> None:
        """See `Driver`."""
        self._guard.call("reset", 0.0, self._controller.reset, np.random.default_rng(seed))

    def ask(self, t: float, state: State, preview: Preview, axles: AxleForces | None) -> Answer:
        """See `Driver`."""
        if self._oracle is not None:
            self._oracle.observe(axles)
        seen = own_copy(state, writable=self._ours)
        ahead = own_copy(preview, writable=self._ours)
        answer: Answer = self._guard.call("command", t, self._command, t, seen, ahead)
        return answer

    def _command(self, t: float, seen: State, ahead: Preview) -> Answer:
        points = len(ahead.x)
        wall, cpu = time.perf_counter_ns(), time.process_time_ns()
        answer = self._controller.command(seen, ahead)
        cpu, wall = time.process_time_ns() - cpu, time.perf_counter_ns() - wall
        command = checked_command(answer, self.about.name, t)
        told = told_by(self._controller, self.about.Np, trusted=self._ours)
        if told is not None and len(told.prediction) > points:
            raise OptionError("diagnostics.prediction", told.prediction.shape,
                              f"no longer than the preview of {points} points")
        return Answer(command, told, cpu * 1e-3, wall * 1e-3)

    def clamped(self) -> int | None:
        """See `Driver`."""
        try:
            count: int | None = self._guard.call("stiffness", 0.0, clamped_inputs, self._controller)
        except LPVMPCError:  # all is driven: a count that cannot be read is none
            return None
        return count
