"""What commands share that drive many runs: kept results, wrapped sentences."""

from __future__ import annotations

import re
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit import cli
from lpvmpc.kit.files import write_text
from lpvmpc.kit.progress import Bar

if TYPE_CHECKING:
    from lpvmpc.sim.batch import Run


def prepare(cache: Path, resume: bool, name: str) -> None:
    """Claim the folder of results; empty it, or see that there is something to go on from.

    Args:
        cache: The folder.
        resume: Whether to go on from what is there.
        name: What made it, for the message.

    Raises:
        LPVMPCError: Nothing to go on from.
        OutputError: The folder cannot be written, or another run is writing there.
    """
    begun = cache / f"{name}.begun"  # one that was interrupted before its first result goes on too
    if resume and not results(cache) and not begun.is_file():
        raise LPVMPCError(
            f"--resume needs the results of an earlier {name}, but {str(cache)!r} has none; "
            "leave --resume out to begin anew."
        )
    cli.results_folder(cache)
    write_text(begun, "")
    if not resume:
        for file in results(cache):
            file.unlink(missing_ok=True)


def results(cache: Path) -> list[Path]:
    """The kept results: files named by a key, and no others."""
    return [file for file in cache.glob("*.json") if re.fullmatch(r"[0-9a-f]{32}", file.stem)]


def jobs_of(asked: int, backend: str, address: str | None) -> int:
    """Number of runs at a time; 0 on a Ray cluster: as many as it has CPUs.

    Raises:
        OptionError: An address without Ray.
    """
    from lpvmpc.kit.workers import check

    jobs = asked or (cli.cores() if backend == "local" else 0)
    check(jobs, backend, address)
    return jobs


def driver(
    jobs: int, cache: Path | None, bar: Bar, backend: str = "local", address: str | None = None
) -> Any:
    """Makes a function that drives runs under a title, as the packages below want it.

    Args:
        jobs: Number of runs at a time; 0 on a Ray cluster: as many as it has CPUs.
        cache: Folder of kept results; None keeps nothing.
        bar: Shows how far it is.
        backend: One of `kit.workers.BACKENDS`.
        address: Address of the Ray cluster.
    """
    from lpvmpc.sim.batch import drive_all

    def under(title: str) -> Any:
        def drive(runs: Sequence[Run]) -> list[dict[str, Any]]:
            bar.begin(title, len(runs))
            return drive_all(runs, jobs=jobs, cache=cache, backend=backend, address=address,
                             progress=lambda done, _: bar.at(done))

        return drive

    return under


def interleaved(
    drive: Callable[[Sequence[Run]], list[dict[str, Any]]], runs: Sequence[Run], of: Sequence[str]
) -> list[dict[str, Any]]:
    """Drive runs so that all they belong to advance alike, and the time left can be told.

    Args:
        drive: Drives runs.
        runs: What to drive.
        of: What each belongs to, such as its controller.

    Returns:
        Results in the order of the runs.
    """
    count, seen = Counter(of), Counter[str]()
    share = []
    for name in of:
        share.append((seen[name] + 0.5) / count[name])
        seen[name] += 1
    order = sorted(range(len(runs)), key=lambda i: (share[i], i))
    results = dict(zip(order, drive([runs[i] for i in order]), strict=True))
    return [results[i] for i in range(len(runs))]


def wrapped(sentence: str) -> str:
    """A sentence in lines of 80 columns, numbers kept together with their unit."""
    kept = re.sub(r"(?<=\d) (?=%|mm)", "\N{NO-BREAK SPACE}", sentence)
    lines = textwrap.fill(kept, 80, break_on_hyphens=False)
    return lines.replace("\N{NO-BREAK SPACE}", " ")
