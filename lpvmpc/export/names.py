"""The formats by name, and what each leaves in a run's folder."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.files import write_json, write_text

if TYPE_CHECKING:
    from lpvmpc.sim.log import Log

FORMATS = ("csv", "mcap")
FILES = ("trace.csv", "trace.mcap", "plotjuggler.xml", "foxglove.json")
"""All files that an export may leave."""


def check_format(kind: str | None) -> None:
    """Refuse, before anything is driven, a format whose package is missing; None is fine.

    Raises:
        LPVMPCError: The package mcap is not installed.
    """
    if kind == "mcap" and find_spec("mcap") is None:
        raise LPVMPCError("MCAP files need the package mcap; install it with: pip install "
                          "'lpvmpc[mcap]'.")


def export(log: Log, content: Mapping[str, Any], folder: Path, kind: str) -> list[Path]:
    """Write a run's trace in a format of `FORMATS`, and the layouts that show it.

    Args:
        log: The run.
        content: What metrics.json holds of it; it goes into the MCAP file as an attachment.
        folder: An existing folder.
        kind: The format.

    Returns:
        The files: the trace, the layout for PlotJuggler and, for MCAP, that for Foxglove.

    Raises:
        LPVMPCError: The package mcap is not installed.
        OutputError: A file cannot be written.
    """
    from lpvmpc.export.layouts import foxglove, plotjuggler

    check_format(kind)
    trace, layout = folder / f"trace.{kind}", folder / "plotjuggler.xml"
    if kind == "csv":
        from lpvmpc.export.csv_file import write_csv

        write_csv(log, trace)
        write_text(layout, plotjuggler(log, topics=False))
        return [trace, layout]
    from lpvmpc.export.mcap_file import write_mcap

    write_mcap(log, content, trace)
    write_text(layout, plotjuggler(log, topics=True))
    write_json(folder / "foxglove.json", foxglove(log))
    return [trace, layout, folder / "foxglove.json"]
