"""The guard around what others have written: answers are checked, time is limited.

A controller or an estimator may raise, hang or return anything at all. Here each of that becomes
one sentence; what it is given is its own copy, so that writing to it changes no record.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple, TypeVar

import numpy as np

from lpvmpc.errors import ControllerError, LPVMPCError, described
from lpvmpc.interface import Command, State, shown

T = TypeVar("T", bound=NamedTuple)


def own_copy(given: T, *, writable: bool) -> T:
    """A named tuple with arrays of its own, so that nobody else's are written to.

    Args:
        given: A State, Preview or Measurement.
        writable: Whether its arrays may be written to; otherwise numpy refuses it. Code that was
            compiled for writable arrays would be compiled a second time for others.
    """
    copies = []
    for value in given:
        if type(value) is np.ndarray:
            value = value.copy()
            if not writable:
                value.flags.writeable = False
        copies.append(value)
    return type(given)._make(copies)


def checked_command(answer: Any, name: str, t: float) -> Command:
    """The answer of a controller as a Command of two finite numbers.

    Args:
        answer: What `command` returned: a Command, or any pair of numbers.
        name: The controller, for the message.
        t: Simulated time [s], for the message.

    Raises:
        ControllerError: The answer is something else.
    """
    try:
        delta, ax = answer
        if type(answer) is not Command and isinstance(answer, str | bytes | dict | set):
            raise TypeError
        if isinstance(delta, str | bytes) or isinstance(ax, str | bytes):
            raise TypeError
        command = Command(float(delta), float(ax))
        if math.isfinite(command.delta) and math.isfinite(command.ax):
            return command
    except Exception:  # whatever its own conversion raises; refused below, all alike
        pass
    raise ControllerError(
        f"Controller {name!r} returned {shown(answer)} at t = {t:.3f} s, but must return "
        "two finite numbers: Command(delta [rad], ax [m/s2])."
    )


def checked_state(answer: Any) -> State | None:
    """The answer of an estimator as a State of finite numbers; None where it is none.

    The wheels' speeds may be NaN, where no sensor measures them.
    """
    if type(answer) is not State:
        return None
    try:
        x, y, psi, vx, vy, r, delta, ax, ay = numbers = [float(value) for value in answer[:9]]
        wheel_speed = np.array(answer.wheel_speed, dtype=np.float64)
    except Exception:  # whatever its own conversion raises
        return None
    if wheel_speed.shape != (4,) or not all(map(math.isfinite, numbers)):
        return None
    return State(x, y, psi, vx, vy, r, delta, ax, ay, wheel_speed)


class _OutOfTime(BaseException):
    """Raised inside a controller that takes too long.

    Not an Exception, so that a controller's own `except Exception` does not swallow it.
    """


class Alarm:
    """Interrupts Python code that takes too long, and knows who interrupts.

    On the main thread of a POSIX system only; elsewhere, and in code that catches everything or
    never comes back to Python, a call can only be judged once it has ended.
    """

    def __init__(self) -> None:
        self.works = False
        self.pressed = True
        """Whether a KeyboardInterrupt may be the user's Ctrl-C."""
        self._on = False

    @contextmanager
    def installed(self) -> Iterator[Alarm]:
        """Take over SIGALRM, and witness SIGINT, for the duration of a run."""
        if threading.current_thread() is not threading.main_thread():
            self.pressed = False  # no other thread ever gets it
            yield self
            return
        before: dict[int, Any] = {}
        interrupt = signal.getsignal(signal.SIGINT)

        def ring(signum: int, frame: object) -> None:
            if self._on:
                raise _OutOfTime

        def press(signum: int, frame: Any) -> None:
            self.pressed = True
            if callable(interrupt):
                interrupt(signum, frame)

        self.pressed = False
        if callable(interrupt):
            before[signal.SIGINT] = signal.signal(signal.SIGINT, press)
        if hasattr(signal, "setitimer"):
            before[signal.SIGALRM] = signal.signal(signal.SIGALRM, ring)
            self.works = True
        try:
            yield self
        finally:
            self.works = False
            if hasattr(signal, "setitimer"):
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            for number, handler in before.items():
                signal.signal(number, handler)

    def start(self, seconds: float) -> None:
        """Ring in some seconds."""
        self._on = True
        if self.works:
            signal.setitimer(signal.ITIMER_REAL, seconds)

    def stop(self) -> None:
        """Do not ring any more."""
        self._on = False
        if self.works:
            signal.setitimer(signal.ITIMER_REAL, 0.0)


class Guard:
    """Calls what a user has written: within a time limit, and with one sentence for any failure."""

    def __init__(
        self,
        kind: str,
        name: str,
        error: type[LPVMPCError] = ControllerError,
        alarm: Alarm | None = None,
        seconds: float | None = None,
    ) -> None:
        """Watch over one object.

        Args:
            kind: What it is, as a sentence begins: "Controller", "Estimator".
            name: Its name.
            error: What to raise.
            alarm: What interrupts it; None where somebody else watches the time.
            seconds: Wall-clock limit per call [s]; None: no limit.
        """
        self.kind, self.name, self.error = kind, name, error
        self.alarm = alarm
        self.seconds = seconds if alarm is not None else None

    def call(self, what: str, t: float, function: Callable[..., Any], *args: Any) -> Any:
        """Call something of it.

        Args:
            what: Name of the method, for the message.
            t: Simulated time [s], for the message.
            function: The method.
            args: Its arguments.

        Raises:
            LPVMPCError: It raised, or took longer than the limit; of the class given above, unless
                it raised one itself.
            KeyboardInterrupt: Ctrl-C.
        """
        if self.seconds is None or self.alarm is None:
            return self._caught(what, t, function, *args)
        start = time.monotonic()
        try:
            try:
                self.alarm.start(self.seconds)
                answer = self._caught(what, t, function, *args)
            finally:
                self.alarm.stop()
        except _OutOfTime:
            raise self.late(what, t, self.seconds) from None
        if time.monotonic() - start > self.seconds:  # it could not be interrupted
            raise self.late(what, t, self.seconds)
        return answer

    def _caught(self, what: str, t: float, function: Callable[..., Any], *args: Any) -> Any:
        try:
            return function(*args)
        except (LPVMPCError, _OutOfTime):
            raise
        except KeyboardInterrupt as error:
            if self.alarm is not None and self.alarm.pressed:
                raise
            raise self.raised(what, t, described(error)) from error
        except BaseException as error:  # SystemExit and whatever else a user may raise
            raise self.raised(what, t, described(error)) from error

    def raised(self, what: str, t: float, why: str) -> LPVMPCError:
        """The error that says that it raised."""
        return self.error(f"{self.kind} {self.name!r} raised in {what} at t = {t:.3f} s: {why}.")

    def late(
        self, what: str, t: float, seconds: float, option: str = "--step-timeout"
    ) -> LPVMPCError:
        """The error that says that it took too long, and which option sets the limit."""
        return self.error(
            f"{self.kind} {self.name!r} did not return from {what} within {seconds:g} s at "
            f"t = {t:.3f} s ({option})."
        )
