"""What commands share that drive many runs: kept results, a progress bar, wrapped sentences."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit import cli

if TYPE_CHECKING:
    from lpvmpc.sim.batch import Run


def prepare(cache: Path, resume: bool, name: str) -> None:
    """Make the folder of results; empty it, or see that there is something to go on from.

    Args:
        cache: The folder.
        resume: Whether to go on from what is there.
        name: What made it, for the message.

    Raises:
        LPVMPCError: Nothing to go on from.
        OutputError: The folder cannot be written.
    """
    if resume and not results(cache):
        raise LPVMPCError(
            f"--resume needs the results of an earlier {name}, but {str(cache)!r} has none; "
            "leave --resume out to begin anew."
        )
    cli.writable_folder(cache)
    if not resume:
        for file in results(cache):
            file.unlink(missing_ok=True)


def results(cache: Path) -> list[Path]:
    """The kept results: files named by a key, and no others."""
    return [file for file in cache.glob("*.json") if re.fullmatch(r"[0-9a-f]{32}", file.stem)]


def driver(jobs: int, cache: Path, progress: Progress) -> Any:
    """Makes a function that drives runs under a title, as the packages below want it."""
    from lpvmpc.sim.batch import drive_all

    def under(title: str) -> Any:
        def drive(runs: Sequence[Run]) -> list[dict[str, Any]]:
            progress.begin(title, len(runs))
            return drive_all(runs, jobs=jobs, cache=cache, progress=progress)

        return drive

    return under


def wrapped(sentence: str) -> str:
    """A sentence in lines of 80 columns, numbers kept together with their unit."""
    kept = re.sub(r"(?<=\d) (?=%|mm)", "\N{NO-BREAK SPACE}", sentence)
    lines = textwrap.fill(kept, 80, break_on_hyphens=False)
    return lines.replace("\N{NO-BREAK SPACE}", " ")


class Progress:
    """Progress bar with runs per second, on a terminal."""

    def __init__(self) -> None:
        self.bar: Any = None
        self.title, self.first = "", True

    def __enter__(self) -> Progress:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            self.bar = Bar(
                "{task.description}", BarColumn(), TextColumn("{task.completed}/{task.total}"),
                TextColumn("{task.fields[rate]} runs/s"), TimeRemainingColumn(),
                console=Console(stderr=True), transient=True,
            )
            self.bar.start()
        return self

    def begin(self, title: str, runs: int) -> None:
        """A new batch."""
        if self.bar is not None:
            for task in self.bar.tasks:
                self.bar.remove_task(task.id)
            self.task = self.bar.add_task(title, total=runs, rate="-")

    def __call__(self, done: int, runs: int) -> None:
        """Called with the number of runs that are done, and of all."""
        if self.bar is not None:
            speed = self.bar.tasks[0].speed
            rate = "-" if speed is None else f"{speed:.2g}"
            self.bar.update(self.task, completed=done, rate=rate)

    def __exit__(self, *error: object) -> None:
        if self.bar is not None:
            self.bar.stop()
