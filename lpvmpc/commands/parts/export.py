"""Write a run for other tools: CSV, or MCAP for Foxglove and PlotJuggler, with a layout for each.

    lpvmpc export runs/paper-lpv-mpc --to mcap

Exit codes: 0 written; 2 bad input, one line on stderr; 130 interrupted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from lpvmpc.commands.parts.view import one_run
from lpvmpc.export.names import FORMATS
from lpvmpc.kit import cli


@dataclass(frozen=True, kw_only=True)
class Options:
    """Write a run's trace for other tools, into the run's folder, with layouts that show it."""

    run: Annotated[
        tuple[Path, ...],
        cli.Option(positional=True, metavar="RUN", help="The run's folder, as runs/paper-lpv-mpc."),
    ] = ()
    to: Annotated[str, cli.Option(help=f"The format: {', '.join(FORMATS)}.")] = "mcap"


def main(options: Options) -> int:
    """Write; returns the exit code."""
    folder = one_run(options.run)
    cli.check_choice("--to", options.to, FORMATS)
    from lpvmpc.export.names import export
    from lpvmpc.export.stored import read_run

    log, content = read_run(folder)
    cli.results_folder(folder)
    for file in export(log, content, folder, options.to):
        print(f"Saved {file}")
    return cli.DONE
