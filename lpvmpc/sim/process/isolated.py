"""A controller in a process of its own, which reaches neither plant nor recorder.

The process is new, so nothing of this one is in it; what it is sent is what a controller is given,
what it sends back are numbers that are checked. Its time limit is watched from here, and its end is
told in one sentence, whatever it was: an exception, an answer that is none, a hang, also in
compiled code, `os._exit`, a crash, a kill. What it has started is killed with it. Its wall-clock
time is measured here, messages included (0.1 ms); its CPU time is what that process says, and what
it does not say is charged, see `UNTOLD_US`.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from lpvmpc.errors import ControllerError, LPVMPCError, OptionError
from lpvmpc.interface import AxleForces, Declared, Preview, State, declared
from lpvmpc.sim.driver import Answer
from lpvmpc.sim.guard import Guard
from lpvmpc.sim.process import wire

START_TIMEOUT = 60.0
"""Longest time of the import of a user's module and of its constructor, by default [s]."""
MEMORY = 1536
"""Memory that a controller's process may ask for, by default [MiB]."""
UNTOLD_US = 2000.0
"""CPU time that a process may take beside what it tells of a call [us]: its messages take 0.1 ms.
What is more is charged to the call, so threads that work between the calls are no free lunch."""
MARK = "LPVMPC_CONTROLLER"
"""Variable by which the process, and whatever it starts, is known in its environment."""
SLICE = 0.2
"""How often to look whether the process still lives [s]."""
_CODE = (
    "import sys; sys.path[:] = sys.argv[1].split('\\n'); "
    "from lpvmpc.sim.process.child import main; main(*map(int, sys.argv[2:]))"
)


class Isolated:
    """A controller that `simulate` drives in a process of its own, started for each run.

    As in `simulate(Plant(), Isolated("mine:Mine"), scenario, step_timeout=1.0)`.
    """

    def __init__(
        self,
        controller: str,
        *,
        start_timeout: float = START_TIMEOUT,
        first_timeout: float | None = None,
        memory: int = MEMORY,
        output: bool = True,
        **options: Any,
    ) -> None:
        """Say what is to be driven; nothing is started yet.

        Args:
            controller: One of `CONTROLLERS`, or `module:Class`.
            start_timeout: Longest time of its import and constructor [s].
            first_timeout: Longest time of its first command, which may have to compile [s]; None:
                as of every other one.
            memory: Memory that its process may ask for [MiB]; 0: no limit.
            output: Whether what it prints is shown, on stderr.
            options: Options of `load_controller`.

        Raises:
            OptionError: A limit outside its domain, or a system without such processes.
        """
        if not hasattr(os, "killpg"):
            raise OptionError("isolate", True, "left out on this system, which is no POSIX system")
        first = start_timeout if first_timeout is None else first_timeout
        for what, value in (("start_timeout", start_timeout), ("first_timeout", first)):
            if not (math.isfinite(value) and value > 0.0):
                raise OptionError(what, value, "a positive number of seconds")
        if type(memory) is not int or memory < 0 or 0 < memory < 256:
            raise OptionError("memory", memory, "a whole number of MiB from 256, or 0")
        self.controller, self.options = controller, options
        self.start_timeout, self.first_timeout = start_timeout, first_timeout
        self.memory, self.output = memory, output

    @contextmanager
    def driver(self, name: str | None, seconds: float | None) -> Iterator[Process]:
        """The started process, for as long as the context lasts.

        Args:
            name: What to call the controller (default: as it says).
            seconds: Longest wall-clock time of one call [s]; None: no limit.

        Raises:
            LPVMPCError: There is no such controller, or it cannot be made.
        """
        process = Process(self, name or self.controller, seconds)
        try:
            process.load(name)
            yield process
        finally:
            process.close()


class Process:
    """A running controller's process; a `Driver`."""

    def __init__(self, spec: Isolated, name: str, seconds: float | None) -> None:
        """Start it. Args: what it is to make, the controller's name, limit per call [s]."""
        self._spec, self._seconds, self._first = spec, seconds, spec.first_timeout
        self._guard = Guard("Controller", name, ControllerError)
        self.oracle = False
        self._mark = uuid.uuid4().hex
        self._channel, other = socket.socketpair()
        try:
            shown = 2 if spec.output and _is_open(2) else subprocess.DEVNULL
            arguments = ["\n".join(sys.path), other.fileno(), spec.memory << 20, os.getpid()]
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", _CODE, *map(str, arguments)],
                stdin=subprocess.DEVNULL, stdout=shown, stderr=shown, pass_fds=[other.fileno()],
                start_new_session=True, env={**os.environ, MARK: self._mark},
            )
        except OSError as error:
            self._channel.close()
            raise ControllerError(
                f"The process of controller {name!r} cannot be started: {error}."
            ) from error
        finally:
            other.close()
        self._cpu_us = 0.0
        self._busy = True  # from a question to its answer

    def load(self, name: str | None) -> None:
        """Import the controller's module, make it, and read what it says of itself.

        Args:
            name: What to call it (default: as it says).
        """
        self._exchange(b"", wire.READY, "the start of its process", 0.0,
                       START_TIMEOUT, "a machine under load")
        spec = self._spec
        made = wire.Spec(spec.controller, spec.options, name)
        told = self._exchange(
            wire.pack(wire.LOAD, pickle.dumps(tuple(made))), wire.ABOUT,
            "its import and constructor", 0.0, spec.start_timeout, "start_timeout",
        )
        try:
            about, oracle = _about(wire.of_text(told))
        except wire.WireError:
            raise self._nonsense("its import and constructor", 0.0) from None
        self.about = replace(about, name=name) if name else about
        self._guard = Guard("Controller", self.about.name, ControllerError)
        self.oracle = oracle and ":" not in spec.controller
        self._cpu_us = self._spent_us()

    def reset(self, seed: int) -> None:
        """See `Driver`."""
        self._exchange(
            wire.pack(wire.RESET, wire.text(seed)), wire.DONE, "reset", 0.0, self._seconds
        )
        self._cpu_us = self._spent_us()

    def ask(self, t: float, state: State, preview: Preview, axles: AxleForces | None) -> Answer:
        """See `Driver`."""
        message = wire.pack(wire.ASK, wire.instant(t, state, preview, axles))
        first, self._first = self._first, None
        limit, option = (first, "first_timeout") if first else (self._seconds, "--step-timeout")
        begin = time.perf_counter_ns()
        payload = self._exchange(message, wire.COMMAND, "command", t, limit, option)
        wall = (time.perf_counter_ns() - begin) * 1e-3
        try:
            answer = wire.of_answer(payload, self.about.Np)
        except wire.WireError:
            raise self._nonsense("command", t) from None
        before, self._cpu_us = self._cpu_us, self._spent_us()
        spent = self._cpu_us - before
        cpu = spent if spent > answer.cpu_us + UNTOLD_US else answer.cpu_us
        return answer._replace(cpu_us=cpu, wall_us=wall)

    def clamped(self) -> int | None:
        """See `Driver`; None after a failure as well."""
        if self._busy:
            return None
        try:
            payload = self._exchange(wire.pack(wire.END), wire.COUNT, "stiffness", 0.0, 1.0)
            count = wire.of_text(payload)
        except LPVMPCError:
            return None
        return count if type(count) is int else None

    def close(self) -> None:
        """Kill the process and whatever it has started; nothing is left behind."""
        self._channel.close()
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except (ProcessLookupError, PermissionError):  # it has ended, and all it had started
            pass
        self._process.wait()
        for pid in _marked(f"{MARK}={self._mark}"):  # what it has started in a session of its own
            with suppress(ProcessLookupError, PermissionError):
                os.kill(pid, signal.SIGKILL)

    def _exchange(
        self, message: bytes, kind: bytes, what: str, t: float, seconds: float | None,
        option: str = "--step-timeout",
    ) -> bytes:
        """Send a message and wait for the payload of its answer.

        Raises:
            ControllerError: The controller failed, it took too long, or its process has ended.
        """
        self._busy = True
        deadline = math.inf if seconds is None else time.monotonic() + seconds
        try:
            self._channel.settimeout(seconds)
            self._channel.sendall(message)
            got, n = wire.HEADER.unpack(self._read(wire.HEADER.size, deadline))
            if n > wire.MAX_PAYLOAD:
                raise self._nonsense(what, t)
            payload = self._read(n, deadline)
            if got == wire.FAILED:
                raise ControllerError(_sentence(wire.of_text(payload)))
        except TimeoutError:
            assert seconds is not None
            raise self._guard.late(what, t, seconds, option) from None
        except (EOFError, OSError):
            raise self._ended(what, t) from None
        except wire.WireError:
            raise self._nonsense(what, t) from None
        if got != kind:
            raise self._nonsense(what, t)
        self._busy = False
        return payload

    def _read(self, n: int, deadline: float) -> bytes:
        """So many bytes; EOFError where the process has ended, TimeoutError after the deadline."""
        parts = []
        while n:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise TimeoutError
            self._channel.settimeout(min(left, SLICE))
            try:
                part = self._channel.recv(n)
            except TimeoutError:
                if self._process.poll() is not None:  # what it has started may hold the channel
                    raise EOFError from None
                continue
            if not part:
                raise EOFError
            parts.append(part)
            n -= len(part)
        return b"".join(parts)

    def _ended(self, what: str, t: float) -> ControllerError:
        """The error that says how the process has ended."""
        try:
            code = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            how = "closed the channel of its process"
        else:
            if code >= 0:
                how = f"ended its process with code {code}"
            else:
                how = f"was ended by signal {-code} ({signal.Signals(-code).name})"
        return ControllerError(f"Controller {self._guard.name!r} {how} in {what} at t = {t:.3f} s.")

    def _nonsense(self, what: str, t: float) -> ControllerError:
        return ControllerError(
            f"The process of controller {self._guard.name!r} sent what is no answer from {what} at "
            f"t = {t:.3f} s."
        )

    def _spent_us(self) -> float:
        """CPU time of all threads of the process [us]; 0 where the system does not tell (macOS)."""
        if not sys.platform.startswith("linux"):
            return 0.0
        try:
            return time.clock_gettime_ns((~self._process.pid << 3) | 2) * 1e-3  # its CPU clock
        except OSError:  # it has ended
            return self._cpu_us


def _marked(mark: str) -> Iterator[int]:
    """Processes with a mark in their environment (Linux; none elsewhere)."""
    for file in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark.encode() in file.read_bytes().split(b"\0"):
                yield int(file.parent.name)
        except OSError:  # another user's, or ended meanwhile
            continue


def _about(told: Any) -> tuple[Declared, bool]:
    """What the process says of its controller, checked like what a controller says itself."""
    about = told.get("about") if isinstance(told, dict) else None
    if not isinstance(about, dict):
        raise wire.WireError("The process of the controller does not say what it is.")
    said: Any = SimpleNamespace(**{str(key): value for key, value in about.items()})
    said.stiffness = SimpleNamespace(name=about.get("stiffness"))
    return declared(said), told.get("oracle") is True


def _sentence(told: Any) -> str:
    """An error as the process tells it, in one line of printable text."""
    text = "".join(c if c.isprintable() else " " for c in str(told)[:2000])
    return " ".join(text.split())


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True
