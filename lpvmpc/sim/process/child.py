"""What runs in a controller's process: it makes the controller, asks it, and answers."""

from __future__ import annotations

import os
import pickle
import socket
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from lpvmpc.errors import ControllerError, LPVMPCError, described
from lpvmpc.sim.driver import InProcess
from lpvmpc.sim.names import load_controller
from lpvmpc.sim.process import wire


def main(descriptor: int, memory: int, parent: int) -> None:
    """Serve one controller until the other side says farewell or is gone.

    Args:
        descriptor: The socket to the closed loop.
        memory: Most memory that this process may ask for [bytes]; 0: no limit.
        parent: Process that this one must not outlive.
    """
    _end_with(parent)
    channel = socket.socket(fileno=descriptor)
    channel.sendall(wire.pack(wire.READY))
    driver: InProcess | None = None
    while True:
        kind, payload = _receive(channel)
        try:
            if kind == wire.LOAD:
                spec = wire.Spec(*pickle.loads(payload))
                _limit(memory)
                driver = _made(spec)
                about = {"about": asdict(driver.about), "oracle": driver.oracle}
                reply = wire.pack(wire.ABOUT, wire.text(about))
            elif driver is None or kind == wire.END:
                count = None if driver is None else driver.clamped()
                reply = wire.pack(wire.COUNT, wire.text(count))
            elif kind == wire.RESET:
                driver.reset(wire.of_text(payload))
                reply = wire.pack(wire.DONE)
            else:
                answer = driver.ask(*wire.of_instant(payload))
                reply = wire.pack(wire.COMMAND, wire.answer(answer))
        except LPVMPCError as error:
            reply = _failed(str(error))
        except BaseException as error:  # MemoryError in this code too
            reply = _failed(f"The process of the controller failed: {described(error)}.")
        channel.sendall(reply)


def _made(spec: wire.Spec) -> InProcess:
    """The controller."""
    try:
        controller = load_controller(spec.controller, **spec.options)
    except KeyboardInterrupt as error:  # nobody else sends one to this process
        raise ControllerError(
            f"Controller {spec.controller!r} cannot be made: {described(error)}."
        ) from error
    return InProcess(controller, spec.name)


def _failed(sentence: str) -> bytes:
    return wire.pack(wire.FAILED, wire.text(sentence[:2000]))


def _receive(channel: socket.socket) -> tuple[bytes, bytes]:
    """The next message; ends the process where the other side is gone."""
    kind, length = wire.HEADER.unpack(_exactly(channel, wire.HEADER.size))
    return kind, _exactly(channel, length)


def _exactly(channel: socket.socket, n: int) -> bytes:
    parts = []
    while n:
        part = channel.recv(n)
        if not part:
            os._exit(0)
        parts.append(part)
        n -= len(part)
    return b"".join(parts)


def _limit(memory: int) -> None:
    """Let this process ask for no more memory than that beside what it has; dump no core."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory:
        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        most = _data() + memory
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def _data() -> int:
    """Memory that this process has asked for until now [bytes]; 0 where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    sizes = [line.split()[1] for line in lines if line.startswith("VmData:")]
    return 1024 * int(sizes[0]) if sizes else 0


def _end_with(parent: int) -> None:
    """Be killed when the parent ends, even where it has no time to say so (Linux)."""
    if sys.platform.startswith("linux"):
        import ctypes
        import signal

        libc: Any = ctypes.CDLL(None)
        libc.prctl(1, int(signal.SIGKILL), 0, 0, 0)  # PR_SET_PDEATHSIG
    if os.getppid() != parent:  # it has ended meanwhile
        os._exit(1)
