"""The progress bar of the commands: on a terminal alone, and gone when the work is done."""

from __future__ import annotations

import sys
from typing import Any

from lpvmpc.kit.signals import heed


class Bar:
    """How far some work is, on stderr where that is a terminal; elsewhere it shows nothing.

    rich is imported where there is something to show.
    """

    def __init__(
        self, title: str = "", total: float = 1.0, *, counted: bool = False, unit: str = ""
    ) -> None:
        """What is done, and of how much.

        Args:
            title: What is being done; empty where `begin` will say it.
            total: When it is done.
            counted: Show `done/total`; otherwise the share in percent.
            unit: Of what so many are done per second; empty where the rate says nothing.
        """
        self.title, self.total = title, total
        self.counted, self.unit = counted, unit
        self.bar: Any = None
        self.task: Any = None

    def __enter__(self) -> Bar:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            columns: list[Any] = []
            if self.counted:
                columns = ["{task.description}", BarColumn(),
                           TextColumn("{task.completed}/{task.total}")]
                if self.unit:
                    columns.append(TextColumn(f"{{task.fields[rate]}} {self.unit}/s"))
                columns.append(TimeRemainingColumn())
            self.bar = Progress(*columns, console=Console(stderr=True), transient=True)
            if self.title:
                self.begin(self.title, self.total)
            self.bar.start()
        return self

    def begin(self, title: str, total: float) -> None:
        """Something else begins, in place of what was shown."""
        self.title, self.total = title, total
        if self.bar is None:
            return
        if self.task is not None:
            self.bar.remove_task(self.task)
        self.task = self.bar.add_task(title, total=total, rate="-")

    def at(self, done: float, title: str | None = None) -> None:
        """So much is done.

        Args:
            done: Between 0 and the total.
            title: What is being done now (default: what it was).
        """
        heed()
        if self.bar is None:
            return
        speed = self.bar.tasks[0].speed
        rate = "-" if speed is None else f"{speed:.2g}" if speed < 10.0 else f"{speed:.0f}"
        self.bar.update(self.task, completed=done, description=title, rate=rate)

    def __exit__(self, *error: object) -> None:
        if self.bar is not None:
            self.bar.stop()
