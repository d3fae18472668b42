"""A run as a page or for other tools: what `track`, `view` and `export` write beside its trace."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.commands.parts.track_table import rows
from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.files import write_text

if TYPE_CHECKING:
    from lpvmpc.sim.log import Log

REPORT = "report.html"
FILM_WIDTH = 640
"""Width of the film inside a page [px]: a tenth of the bytes of the film beside it."""


def write_page(log: Log, content: Mapping[str, Any], folder: Path,
               video: Path | None = None) -> Path:
    """Write report.html, with a small copy of the film in it where there is one.

    Args:
        log: The run, with two rows or more.
        content: What metrics.json holds of it.
        folder: Where the page goes.
        video: Film of the run.
    """
    from lpvmpc.picture.page import page

    target = folder / REPORT
    with tempfile.TemporaryDirectory() as place:
        small = None
        if video is not None:
            from lpvmpc.picture.video.encode import smaller

            small = smaller(video, Path(place) / "film.mp4", FILM_WIDTH)
        table = [(label, ours, paper if content["scenario"] == "paper" else "")
                 for label, ours, paper in rows(dict(content), log)]
        write_text(target, page(log, content, table, small))
    return target


def check_two_rows(log: Log) -> None:
    """Refuse a run in which nothing moves.

    Raises:
        LPVMPCError: It has fewer than two instants.
    """
    if len(log) < 2:
        raise LPVMPCError("The run has fewer than two instants, so there is nothing to show.")


def film_of(folder: Path, name: str, newer_than: Path) -> Path | None:
    """The film that `track --render` made of a run, unless the run is newer."""
    for place in (Path("videos"), folder.parent.parent / "videos"):
        video = place / f"{name}.mp4"
        try:
            if video.stat().st_mtime >= newer_than.stat().st_mtime:
                return video
        except OSError:
            continue
        print(f"Note: {video} is older than the run, so it is left out.", file=sys.stderr)
    return None
