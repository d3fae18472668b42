"""Processes that work for this one: on this machine, or on a Ray cluster.

What a caller may rely on, wherever the work is done: answers come one by one as they are ready, or
all in their order; no more is held in memory than is being worked on; only this process acts
on Ctrl-C, which then ends what the workers do; a worker that dies is told in one sentence.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from itertools import islice
from typing import Any, TypeVar

from lpvmpc.errors import LPVMPCError, OptionError, described
from lpvmpc.kit.signals import ctrl_c_waits

BACKENDS = ("local", "ray")
"""Where work can be done: processes of this machine, or a Ray cluster."""
DIED = "A worker process died (killed, or out of memory?); fewer jobs need less memory."
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


class _Processes(Pool):
    """Processes of this machine; they stay from one call to the next, with what they have made."""

    def __init__(self) -> None:
        self.answers: Any = None

    def each(self, function: Callable[[T], R], things: Iterable[T]) -> Iterator[R]:
        from joblib import Parallel

        # one thing per message: it takes long, and is to be kept as soon as it is done
        parallel = Parallel(return_as="generator_unordered", batch_size=1)
        with ctrl_c_waits():  # joblib cannot stop processes that it has half started
            self.answers = parallel(_calls(function, things, os.getpid()))
        return iter(self.answers)

    def stop(self) -> None:
        """End what the workers are still doing: nobody waits for it, perhaps after Ctrl-C."""
        if self.answers is not None:
            with warnings.catch_warnings():  # throwing work away is intended
                warnings.filterwarnings("ignore", ".* tasks .*", UserWarning, "joblib")
                self.answers.close()


class _Ray(Pool):
    """A Ray cluster; it cannot give answers one by one, so some things are done at a time."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def each(self, function: Callable[[T], R], things: Iterable[T]) -> Iterator[R]:
        from joblib import Parallel

        calls = _calls(function, things, None)
        with Parallel(batch_size=1) as parallel:
            while some := list(islice(calls, 4 * self.jobs)):
                yield from parallel(some)

    def map(self, function: Callable[[T], R], things: Iterable[T]) -> list[R]:
        from joblib import Parallel

        answers: list[R] = Parallel(batch_size=1, pre_dispatch="all")(
            _calls(function, things, None)
        )
        return answers


@contextmanager
def workers(
    jobs: int = 1, backend: str = "local", address: str | None = None, died: str = DIED
) -> Iterator[Pool]:
    """Workers, for as long as the context lasts.

    Args:
        jobs: Number of processes; with 1, all happens in this one (unless on Ray).
        backend: One of `BACKENDS`.
        address: Address of the Ray cluster (default: Ray decides, and starts one here).
        died: What to say where a worker dies.

    Raises:
        OptionError: A number of jobs below 1, an unknown backend, an address without Ray.
        LPVMPCError: Ray is not installed or not reachable, or a worker process died.
    """
    check(jobs, backend, address)
    if backend == "local" and jobs == 1:
        yield Pool()
        return
    from joblib import parallel_config
    from joblib.externals.loky.process_executor import BrokenProcessPool

    try:
        if backend == "ray":
            with _ray(address), parallel_config("ray", n_jobs=jobs):
                yield _Ray(jobs)
        else:
            pool = _Processes()
            with parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
                try:
                    yield pool
                finally:
                    pool.stop()
    except BrokenProcessPool as error:
        raise LPVMPCError(died) from error


def check(jobs: int, backend: str = "local", address: str | None = None) -> None:
    """Refuse workers that cannot be started.

    Raises:
        OptionError: As `workers`.
    """
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise OptionError("jobs", jobs, "a whole number from 1")
    if backend not in BACKENDS:
        raise OptionError("backend", backend, " or ".join(BACKENDS))
    if address is not None and backend != "ray":
        raise OptionError("address", address, "left out unless the backend is 'ray'")


def _calls(function: Callable[[T], R], things: Iterable[T], parent: int | None) -> Iterator[Any]:
    from joblib import delayed

    return (delayed(_call)(parent, function, thing) for thing in things)


def _call(parent: int | None, function: Callable[[T], R], thing: T) -> R:
    """Call a function in a worker, which its parent alone tells when to stop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if parent is not None:
        _end_with(parent)
    return function(thing)


@cache
def _end_with(parent: int) -> None:
    """End this process soon after its parent, which may be killed without a word."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.2)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _ray(address: str | None) -> Iterator[None]:
    """Ray started or reached, and known to joblib."""
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError:
        raise LPVMPCError(
            "The backend 'ray' needs the package ray; install it with: pip install "
            "'lpvmpc[cluster]'."
        ) from None
    register_ray()
    ours = not ray.is_initialized()
    if ours:
        try:
            ray.init(address=address, log_to_driver=False, include_dashboard=False)
        except Exception as error:  # Ray raises plain Exceptions too
            where = "cannot be started" if address is None else f"at {address!r} cannot be reached"
            raise LPVMPCError(f"Ray {where}: {described(error)}.") from error
    try:
        yield
    finally:
        if ours:
            ray.shutdown()
