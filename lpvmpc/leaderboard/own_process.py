"""Runs of a user's class, in a process that may hang, die or take too much memory.

What a controller of the package does is known; a user's may call `os._exit`, loop in compiled code
or fill the memory. Such a run is ended from outside and charged, and the others go on.
"""

from __future__ import annotations

import atexit
import os
import time
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from lpvmpc.errors import LPVMPCError, described
from lpvmpc.kit.files import write_json
from lpvmpc.kit.workers import Worker, check, workers
from lpvmpc.plant.plant import Plant
from lpvmpc.sim import batch
from lpvmpc.sim.batch import Run
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import details, metrics
from lpvmpc.sim.names import load_controller

STEP_TIMEOUT = 1.0
"""Longest wall-clock time of one call of a controller [s]; Python code is interrupted by then."""
SILENCE = 15.0
"""Longest time without a control period, after which the process is ended [s]."""
START = 120.0
"""The same before the first one: imports, compilation, the class's own constructor [s]."""
MEMORY = 2 * 1024**3
"""Memory that the process may take [bytes]."""


def drive_all(
    runs: Sequence[Run], *, jobs: int, backend: str = "local", address: str | None = None,
    cache: Path | None = None, progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """As `batch.drive_all`, but nothing that a controller does can end more than its own run.

    Args:
        runs: What to drive.
        jobs: Number of processes.
        backend: One of `kit.workers.BACKENDS`.
        address: Address of the Ray cluster.
        cache: Folder of results kept by key; failed runs are kept as well, for driving them again
            may take as long as they hang.
        progress: Called after each run.
    """
    check(jobs, backend, address)
    keys = [run.key() for run in runs]
    found: dict[str, dict[str, Any]] = {}
    if cache is not None:
        found = {k: value for k in keys if (value := batch.read_result(cache, k)) is not None}
    missing = {key: run for key, run in zip(keys, runs, strict=True) if key not in found}
    done = sum(key in found for key in keys)
    if progress is not None:
        progress(done, len(runs))
    if missing:
        with workers(jobs, backend, address, batch.DIED) as pool:
            for key, result in pool.each(outcome, missing.items()):
                found[key] = result
                if cache is not None:
                    write_json(cache / f"{key}.json", result)
                done += keys.count(key)
                if progress is not None:
                    progress(done, len(runs))
    return [found[key] for key in keys]


def outcome(item: tuple[str, Run]) -> tuple[str, dict[str, Any]]:
    """Drive a run, given with its key, in another process, and measure it."""
    key, run = item
    with TemporaryDirectory() as folder:
        pulse = Path(folder) / "pulse"
        worker, begin = _worker(), time.monotonic()
        whole = False
        try:
            worker.give(_driven, (run, str(pulse)))
            while not worker.line.poll(0.2):
                why = _silent(pulse, begin)
                if why:
                    return key, batch.charged(run, why)
            returned, value = worker.answer("died")
            whole = True
        except LPVMPCError:
            return key, batch.charged(
                run, f"Controller {run.controller!r} ended its process: os._exit, a crash, or no "
                "memory left."
            )
        finally:
            if whole:
                _resting.append(worker)  # the next run need not import and compile again
            else:
                worker.end()
    if returned:
        return key, value
    if isinstance(value, KeyboardInterrupt):
        raise value
    text = str(value) if isinstance(value, LPVMPCError) else described(value)
    return key, batch.charged(run, " ".join(text.split()))


_resting: list[Worker] = []
"""The process that has driven the last run, where it is still fit for the next."""


def _worker() -> Worker:
    """A process that rests, or a new one."""
    while _resting:
        worker = _resting.pop()
        if worker.fits():
            return worker
        worker.end()
    return Worker()


@atexit.register
def _dismiss() -> None:
    while _resting:
        _resting.pop().end()


def _silent(pulse: Path, begin: float) -> str:
    """Why a process is to be ended; empty while it drives."""
    try:
        silent = time.time() - pulse.stat().st_mtime
    except OSError:
        started = time.monotonic() - begin < START
        return "" if started else f"The controller has not started within {START:g} s."
    return "" if silent < SILENCE else (
        f"The controller hung: no command for {SILENCE:g} s, and no way to interrupt it."
    )


def _driven(item: tuple[Run, str]) -> dict[str, Any]:
    """Drive a run here, and show a pulse while it goes on."""
    run, pulse = item
    _limit_memory()
    last = 0.0

    def beat(_: float) -> None:
        nonlocal last
        if time.monotonic() - last > 0.5:
            last = time.monotonic()
            Path(pulse).touch()

    controller = load_controller(run.controller, **run.controller_options)
    log = simulate(
        _plant(), controller, batch.scenario_of(run), seed=run.seed, world=run.world,
        estimator=run.estimator, step_timeout=STEP_TIMEOUT, progress=beat,
        name=run.controller, options={"road": run.road},
    )
    if log.meta["reason"] == "interrupted":
        raise KeyboardInterrupt
    return {**metrics(log), **details(log)}


@cache
def _plant() -> Plant:
    """The car of this process."""
    return Plant()


@cache
def _limit_memory() -> None:
    """Let this process take no more than `MEMORY`, where the system can be told so."""
    try:
        import resource
    except ImportError:
        return
    if hasattr(resource, "RLIMIT_DATA") and os.name == "posix":
        resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
