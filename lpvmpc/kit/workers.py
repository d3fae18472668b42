"""Processes that work for this one: on this machine, or on a Ray cluster.

What a caller may rely on, wherever the work is done: answers come one by one as they are ready, or
all in their order; no more is held in memory than is being worked on; only this process acts on
Ctrl-C and other signals, and then ends what the workers do; a worker that dies is told in one
sentence; none outlives this process. Functions, arguments and answers must be picklable: a function
has to lie in a module that can be imported.
"""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from itertools import islice
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any, TypeVar

from lpvmpc.errors import LPVMPCError, OptionError, described
from lpvmpc.kit.signals import ctrl_c_waits
from lpvmpc.kit.worker import Answer, caught

BACKENDS = ("local", "ray")
"""Where work can be done: processes of this machine, or a Ray cluster."""
DIED = "A worker process died (killed, or out of memory?); fewer jobs need less memory."
ONE_THREAD = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS",
)
"""What tells numerical libraries in a worker to use one thread."""
T = TypeVar("T")
R = TypeVar("R")


class Pool:
    """What does the work; this one is the calling process itself."""

    def each(self, function: Callable[[T], R], things: Iterable[T]) -> Iterator[R]:
        """Answers for many things, each as soon as it is there, in any order.

        Args:
            function: What to call; it and its answers must be picklable.
            things: Its arguments, taken as there is room.
        """
        return map(function, things)

    def map(self, function: Callable[[T], R], things: Iterable[T]) -> list[R]:
        """Answers for many things, in their order."""
        answers = dict(self.each(partial(_numbered, function), enumerate(things)))
        return [answers[i] for i in range(len(answers))]


def _numbered(function: Callable[[T], R], item: tuple[int, T]) -> tuple[int, R]:
    return item[0], function(item[1])


# Processes of this machine ------------------------------------------------------------------------


class Worker:
    """A process of `kit.worker`, in a group of its own: no signal of a terminal reaches it."""

    START = "import sys; sys.path[:] = {path}; from lpvmpc.kit.worker import serve; serve({handle})"

    def __init__(self) -> None:
        self.made_in = _surroundings()
        path = [entry or os.getcwd() for entry in sys.path]
        self.line, theirs = Pipe()
        with theirs, ctrl_c_waits():  # a process that is half started could not be ended
            # -P: neither the current folder nor that of a script comes first
            code = self.START.format(path=ascii(path), handle=theirs.fileno())
            words = [sys.executable, "-P", *(f"-W{how}" for how in sys.warnoptions), "-c", code]
            self.process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                pass_fds=[theirs.fileno()],
                env={**os.environ, **dict.fromkeys(ONE_THREAD, "1")},
                process_group=0,
            )

    def give(self, function: Callable[[Any], Any], thing: Any) -> None:
        """Give it a call to make; it must have answered the one before."""
        call = pickle.dumps((function, thing))
        with suppress(OSError):  # it is gone, which its answer will tell
            self.line.send_bytes(call)

    def answer(self, died: str) -> Answer:
        """Its answer, once `wait` has named its line.

        Raises:
            LPVMPCError: It died.
        """
        try:
            found: Answer = pickle.loads(self.line.recv_bytes())
        except (EOFError, OSError):
            raise LPVMPCError(died) from None
        return found

    def fits(self) -> bool:
        """Whether it lives, and was started where this process still is."""
        return self.made_in == _surroundings() and self.process.poll() is None

    def end(self) -> None:
        """End it at once, with all that it has started: it has nothing to save."""
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self.process.pid, signal.SIGKILL)
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.line.close()
        self.process.wait()


def _surroundings() -> tuple[object, ...]:
    """What a worker has taken from this process when it was started."""
    return os.getcwd(), tuple(sys.path), tuple(sorted(os.environ.items()))


_resting: list[Worker] = []
"""Workers that wait for the next pool: they have imported and compiled what they need."""


@atexit.register
def _dismiss() -> None:
    """End those that rest."""
    while _resting:
        _resting.pop().end()


class _Processes(Pool):
    """Processes of this machine; they stay from one call to the next, with what they have made."""

    def __init__(self, jobs: int, died: str) -> None:
        self.jobs, self.died = jobs, died
        self.all: list[Worker] = []
        self.free: list[Worker] = []

    def each(self, function: Callable[[T], R], things: Iterable[T]) -> Iterator[R]:
        left, busy = iter(things), dict[Connection, Worker]()
        ready: list[Answer] = []
        try:
            while True:
                for thing in islice(left, self.jobs - len(busy)):
                    worker = self.free.pop() if self.free else self._more()
                    busy[worker.line] = worker
                    worker.give(function, thing)
                for returned, value in ready:  # only now: nobody is to wait for who asks
                    if not returned:
                        raise value
                    yield value
                if not busy:
                    return
                ready = []
                for line in wait(list(busy)):
                    assert isinstance(line, Connection)
                    ready.append(busy[line].answer(self.died))
                    self.free.append(busy.pop(line))
        finally:
            for worker in busy.values():  # nobody waits for them any more
                worker.end()
                self.all.remove(worker)

    def _more(self) -> Worker:
        """One that rests, or a new one."""
        while _resting:
            worker = _resting.pop()
            self.all.append(worker)
            if worker.fits():
                return worker
            worker.end()
            self.all.remove(worker)
        self.all.append(Worker())
        return self.all[-1]

    def rest(self) -> None:
        """Let those that are free wait for the next pool, and end the others."""
        while self.all:
            worker = self.all.pop()
            if worker in self.free:
                _resting.append(worker)
            else:
                worker.end()

    def stop(self) -> None:
        """End them all."""
        while self.all:
            self.all.pop().end()


# A Ray cluster ------------------------------------------------------------------------------------


RETRIES = 3
"""How often a thing is done again whose worker, or whose machine, has died."""
ANSWERS = 10.0
"""Longest time that the cluster's address may take to accept a connection [s]."""


class _Ray(Pool):
    """A Ray cluster, that works on so many things at a time."""

    def __init__(self, jobs: int, died: str) -> None:
        import ray

        self.jobs = jobs or max(int(ray.cluster_resources().get("CPU", 1)), 1)
        self.died = died
        self.call: Any = ray.remote(max_retries=RETRIES)(caught)

    def each(self, function: Callable[[T], R], things: Iterable[T]) -> Iterator[R]:
        import ray

        left, busy = iter(things), list[Any]()
        while True:
            busy += [self.call.remote(function, thing) for thing in
                     islice(left, self.jobs - len(busy))]
            if not busy:
                return
            (done,), busy = ray.wait(busy)
            try:
                returned, value = ray.get(done)
            except ray.exceptions.RayError as error:
                cause = getattr(error, "cause", None)  # the work did not even begin there
                why = self.died if cause is None else f"Work on Ray fails: {described(cause)}."
                raise LPVMPCError(why) from error
            if not returned:
                raise value
            yield value


@contextmanager
def workers(
    jobs: int = 1, backend: str = "local", address: str | None = None, died: str = DIED
) -> Iterator[Pool]:
    """Workers, for as long as the context lasts.

    Args:
        jobs: Number of processes; with 1, all happens in this one (unless on Ray). On Ray, 0 is
            one for each CPU of the cluster.
        backend: One of `BACKENDS`.
        address: Address of the Ray cluster (default: Ray decides, and starts one here).
        died: What to say where a worker dies.

    Raises:
        OptionError: A number of jobs below 1, an unknown backend, an address without Ray.
        LPVMPCError: Ray is not installed or not reachable, or a worker process died.
    """
    check(jobs, backend, address)
    if backend == "ray":
        with _ray(address):
            yield _Ray(jobs, died)
    elif jobs == 1:
        yield Pool()
    else:
        pool = _Processes(jobs, died)
        try:
            yield pool
            pool.rest()
        finally:
            pool.stop()


def check(jobs: int, backend: str = "local", address: str | None = None) -> None:
    """Refuse workers that cannot be started.

    Raises:
        OptionError: As `workers`.
    """
    if backend not in BACKENDS:
        raise OptionError("backend", backend, " or ".join(BACKENDS))
    least = 0 if backend == "ray" else 1
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < least:
        raise OptionError("jobs", jobs, f"a whole number from {least}")
    if address is not None and backend != "ray":
        raise OptionError("address", address, "left out unless the backend is 'ray'")


def _listens(address: str) -> None:
    """See that somebody listens where Ray is to be; Ray itself would look for minutes.

    Raises:
        OSError: Nobody does.
    """
    import ray

    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not (host and port.isdecimal()):  # "auto" and the like are Ray's to find
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWERS).close()
    except OSError:
        if host not in ("localhost", "127.0.0.1"):
            raise
        here = ray.util.get_node_ip_address()  # what Ray makes of them
        socket.create_connection((here, int(port)), timeout=ANSWERS).close()


@contextmanager
def _ray(address: str | None) -> Iterator[None]:
    """Ray started or reached."""
    try:
        import ray
    except ImportError:
        raise LPVMPCError(
            "The backend 'ray' needs the package ray; install it with: pip install "
            "'lpvmpc[cluster]'."
        ) from None
    ours = not ray.is_initialized()
    if ours:
        told = signal.getsignal(signal.SIGTERM)
        try:
            if address is not None:
                _listens(address)
            ray.init(address=address, log_to_driver=False, include_dashboard=False)
        except Exception as error:  # Ray raises plain Exceptions too
            where = "cannot be started" if address is None else f"at {address!r} cannot be reached"
            raise LPVMPCError(f"Ray {where}: {described(error)}.") from error
        finally:  # Ray takes SIGTERM for itself
            with suppress(ValueError):  # not in the main thread
                signal.signal(signal.SIGTERM, told)
    try:
        yield
    finally:
        if ours:
            ray.shutdown()
