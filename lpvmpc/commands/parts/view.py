"""Show a run again: in MuJoCo's viewer, or as a page for the browser.

    lpvmpc view runs/paper-lpv-mpc --html

Exit codes: 0 shown; 2 bad input, one line on stderr; 130 interrupted.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from lpvmpc.commands.parts.pages import check_two_rows, film_of, write_page
from lpvmpc.commands.parts.windows import check_display
from lpvmpc.errors import LPVMPCError
from lpvmpc.kit import cli


@dataclass(frozen=True, kw_only=True)
class Options:
    """Replay a run from its trace, in MuJoCo's interactive viewer or as a page."""

    run: Annotated[
        tuple[Path, ...],
        cli.Option(positional=True, metavar="RUN", help="The run's folder, as runs/paper-lpv-mpc."),
    ] = ()
    html: bool = False
    """Write report.html into the folder instead: film, linked plots, map, settings."""
    speed: float = 1.0
    """How fast the viewer replays, as a factor of real time."""


def main(options: Options) -> int:
    """Replay; returns the exit code."""
    folder = one_run(options.run)
    cli.check_number("--speed", options.speed, 0.01, 100.0)
    if not options.html:
        check_display("view", "--html makes a page for the browser.")
    cli.check_opengl()
    from lpvmpc.export.stored import read_run

    log, content = read_run(folder)
    check_two_rows(log)
    if options.html:
        cli.results_folder(folder)
        name = re.sub(r"[^\w.-]+", "-", f"{log.scenario.name}-{log.meta['controller']}")
        film = film_of(folder.absolute(), name, folder / "trace.parquet")
        print(f"Saved {write_page(log, content, folder, film)}")
        return cli.DONE
    from lpvmpc.picture.video.viewer import replay

    replay(log, options.speed)
    return cli.DONE


def one_run(given: tuple[Path, ...]) -> Path:
    """The one folder that was named.

    Raises:
        LPVMPCError: None was, or several.
    """
    if len(given) != 1:
        raise LPVMPCError(f"Name one run's folder, as runs/paper-lpv-mpc; {len(given)} were given.")
    return given[0]
