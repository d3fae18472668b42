"""Runs of a user's class, whose controller lives in a process that may hang, die or hoard memory.

What a controller of the package does is known; a user's may call `os._exit`, loop in compiled code,
fill the memory, or reach for the plant. It drives as an `Isolated`, so it can do none of this to
anybody else: its run is ended and charged, and the others go on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from lpvmpc.errors import LPVMPCError, described
from lpvmpc.kit.workers import check, workers
from lpvmpc.sim import batch
from lpvmpc.sim.batch import Run
from lpvmpc.sim.metrics import details, metrics
from lpvmpc.sim.process.isolated import Isolated

STEP_TIMEOUT = 1.0
"""Longest wall-clock time of one call of a controller [s]."""
START = 120.0
"""The same of its import and constructor, and of its first command, which may compile [s]."""
MEMORY = 2048
"""Memory that it may ask for [MiB]."""
CHANCES = 2
"""So many runs of a class may hang before their first command; if none has come further, the others
are charged as they are, and not driven."""
AT_START = ("(start_timeout).", "(first_timeout).")
"""How the reasons of such runs end."""


def drive_all(
    runs: Sequence[Run], *, jobs: int, backend: str = "local", address: str | None = None,
    cache: Path | None = None, progress: Callable[[int, int], None] | None = None,
) -> list[dict[str, Any]]:
    """As `batch.drive_all`, but nothing that a controller does can end more than its own run.

    A class that hangs at every start is charged with all its runs, see `Starts`.

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
    starts = Starts()
    for key, run in zip(keys, runs, strict=True):
        if key in found:
            starts.add(run, found[key])
    done = sum(key in found for key in keys)
    if progress is not None:
        progress(done, len(runs))

    def keep(key: str, result: dict[str, Any]) -> None:
        nonlocal done
        found[key] = result
        if cache is not None:
            batch.keep_result(cache, key, result)
        done += keys.count(key)
        if progress is not None:
            progress(done, len(runs))

    def worth_it() -> Iterator[tuple[str, Run]]:
        for key, run in missing.items():
            if hopeless := starts.hopeless(run):
                keep(key, batch.charged(run, hopeless))
            else:
                yield key, run

    if missing:
        with workers(jobs, backend, address, batch.DIED) as pool:
            for key, result in pool.each(outcome, worth_it()):
                starts.add(missing[key], result)
                keep(key, result)
    return [found[key] for key in keys]


class Starts:
    """Which classes hang before their first command, whatever they are to drive.

    A start may take minutes, since it may compile; a class that hangs there in every run would take
    a benchmark hours to say the same of each.
    """

    def __init__(self) -> None:
        self._hung: dict[str, int] = {}
        self._reasons: dict[str, str] = {}
        self._started: set[str] = set()

    def add(self, run: Run, result: Mapping[str, Any]) -> None:
        """Note how a run has ended."""
        name, reason = run.controller, str(result["reason"])
        if reason.endswith(AT_START):
            self._hung[name] = self._hung.get(name, 0) + 1
            self._reasons[name] = reason
        else:
            self._started.add(name)

    def hopeless(self, run: Run) -> str:
        """The reason why a run need not be driven; empty where it must."""
        name = run.controller
        if name in self._started or self._hung.get(name, 0) < CHANCES:
            return ""
        return self._reasons[name]


def outcome(item: tuple[str, Run]) -> tuple[str, dict[str, Any]]:
    """Drive a run, given with its key, and measure it; an error becomes its result.

    Raises:
        KeyboardInterrupt: Ctrl-C.
    """
    key, run = item
    try:
        isolated = Isolated(run.controller, start_timeout=START, first_timeout=START,
                            memory=MEMORY, output=False, **run.controller_options)
        log = batch.drive(run, isolated, STEP_TIMEOUT)
    except LPVMPCError as error:
        return key, batch.charged(run, " ".join(str(error).split()))
    except Exception as error:  # one broken run must not take the others' results away
        return key, batch.charged(run, described(error))
    if log.meta["reason"] == "interrupted":
        raise KeyboardInterrupt
    return key, {**metrics(log), **details(log)}
