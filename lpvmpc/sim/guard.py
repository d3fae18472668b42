"""The guard around what a controller does: its answers are checked, its time is limited."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from lpvmpc.errors import ControllerError, LPVMPCError, described
from lpvmpc.interface import Command


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
        command = Command(float(delta), float(ax))
        if math.isfinite(command.delta) and math.isfinite(command.ax):
            return command
    except (TypeError, ValueError):
        pass  # raised below, for every kind of wrong answer alike
    text = repr(answer)
    text = text if len(text) <= 80 else text[:77] + "..."
    raise ControllerError(
        f"Controller {name!r} returned {' '.join(text.split())} at t = {t:.3f} s, but must return "
        "two finite numbers: Command(delta [rad], ax [m/s2])."
    )


class _OutOfTime(BaseException):
    """Raised inside a controller that takes too long.

    Not an Exception, so that a controller's own `except Exception` does not swallow it.
    """


class TimeLimit:
    """Wall-clock limit on each call of a controller.

    On the main thread of a POSIX system an alarm interrupts Python code that hangs. Elsewhere, and
    in compiled code that never comes back to Python, a call can only be judged once it has ended.
    """

    def __init__(self, seconds: float | None, name: str):
        """Args: limit per call [s], None for none; the controller's name for the message."""
        self.seconds, self.name = seconds, name
        self.armed = (
            seconds is not None
            and hasattr(signal, "setitimer")
            and threading.current_thread() is threading.main_thread()
        )

    @contextmanager
    def installed(self) -> Iterator[None]:
        """Take over SIGALRM for the duration of a run."""
        if not self.armed:
            yield
            return

        def ring(signum: int, frame: object) -> None:
            raise _OutOfTime

        before = signal.signal(signal.SIGALRM, ring)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)

    def call(self, what: str, t: float, function: Callable[..., Any], *args: Any) -> Any:
        """Call a controller's method.

        Args:
            what: Name of the method, for the message.
            t: Simulated time [s], for the message.
            function: The method.
            args: Its arguments.

        Raises:
            ControllerError: It raised, or took longer than the limit.
        """
        if self.seconds is None:
            return self._caught(what, t, function, *args)
        start = time.monotonic()
        try:
            if self.armed:
                signal.setitimer(signal.ITIMER_REAL, self.seconds)
            answer = self._caught(what, t, function, *args)
            if self.armed:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
        except _OutOfTime:
            raise self._late(what, t) from None
        if not self.armed and time.monotonic() - start > self.seconds:
            raise self._late(what, t)
        return answer

    def _caught(self, what: str, t: float, function: Callable[..., Any], *args: Any) -> Any:
        try:
            return function(*args)
        except LPVMPCError:
            raise
        except (Exception, SystemExit) as error:
            raise ControllerError(
                f"Controller {self.name!r} raised in {what} at t = {t:.3f} s: {described(error)}."
            ) from error

    def _late(self, what: str, t: float) -> ControllerError:
        return ControllerError(
            f"Controller {self.name!r} did not return from {what} within {self.seconds:g} s at "
            f"t = {t:.3f} s (--step-timeout)."
        )
