"""The leaderboard as one HTML file that needs nothing else: a sortable table and live plots.

`page.html` holds the layout, the style and the script; here the numbers are put into it. All of
them are computed in Python: the script sorts, filters and draws, and decides nothing.
"""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from typing import Any

from lpvmpc.kit.report import finite, page_of
from lpvmpc.leaderboard.grid import is_slow
from lpvmpc.leaderboard.pictures import colour
from lpvmpc.leaderboard.profiles import profiles
from lpvmpc.leaderboard.score import Board, completed, effort, finished, reason
from lpvmpc.leaderboard.tables import table

OPEN = 8
"""Sentences that are shown at once: who is better than us comes first, see `verdict.sentences`."""
CUT = 1000.0
"""Largest factor of the best that the curves go to."""


def page(board: Board, values: Mapping[str, Any]) -> str:
    """The page.

    Args:
        board: What was driven.
        values: Its numbers, as `tables.as_json` gives them.
    """
    record = values["record"]
    about = (
        f"{len(board.rows)} runs in {len(board.table)} cells; {record['machine']}; commit "
        f"{record['commit'] or 'unknown'}; rows SHA-256 {values['rows_sha256']}"
    )
    return page_of("lpvmpc.leaderboard", "page.html", _data(board, values), {
        "ABOUT": html.escape(about),
        "QUICK": "<p class='note'>A quick look: a few runs, not the report.</p>"
        if record["plan"]["quick"] else "",
        "SENTENCES": _folded([_marked(text) for text in values["sentences"]]),
    })


def _folded(sentences: Sequence[str]) -> str:
    """Sentences as a list, those after the first `OPEN` behind a click."""
    first, rest = ("\n".join(f"<li>{text}</li>" for text in part)
                   for part in (sentences[:OPEN], sentences[OPEN:]))
    shown = f"<ul class='verdict'>\n{first}\n</ul>"
    if not rest:
        return shown
    more = f"<summary>{len(sentences) - OPEN} more sentences</summary>"
    return f"{shown}\n<details>{more}\n<ul class='verdict'>\n{rest}\n</ul>\n</details>"


def _marked(text: str) -> str:
    """A sentence in HTML; what is between backticks is code."""
    return re.sub(r"`([^`]*)`", r"<code>\1</code>", html.escape(text))


def _data(board: Board, values: Mapping[str, Any]) -> dict[str, Any]:
    scores = table(board)
    return {
        "controllers": [
            {"name": name, "color": colour(board, name), "slow": is_slow(name)}
            for name in board.controllers
        ],
        "worlds": ["all", *board.worlds()],
        "courses": ["all", *board.courses()],
        "scores": {"keys": list(scores[0]), "rows": [
            [_short(value) for value in line.values()] for line in scores
        ]},
        "effort": _efforts(board),
        "profiles": _curves(board),
        "limits": values["limits"],
        "ranks": values["ranks"],
        "pairs": values["pairs"],
        "against": values["against"],
        "charged": _charged(board),
    }


def _short(value: Any) -> Any:
    """A value with as many digits as are shown."""
    return float(f"{value:.5g}") if isinstance(value, float) else value


def _sets(board: Board) -> dict[str, tuple[str, ...]]:
    """Who is compared on which cells: those of all that are not slow, those that all drive."""
    sets = {"full": board.full or board.controllers}
    if board.slow and board.full:
        sets["common"] = board.controllers
    return sets


def _curves(board: Board) -> dict[str, Any]:
    """Profiles by `cells|world|course`: corners of each controller's curve."""
    found: dict[str, Any] = {}
    for what, names in _sets(board).items():
        for world in (None, *board.worlds()):
            for course in (None, *board.courses()):
                cells = board.cells("worlds", world, course, by=names)
                if cells:
                    found[f"{what}|{world or 'all'}|{course or 'all'}"] = {"n": len(cells), "of": {
                        p.controller: [
                            [float(f"{factor:.4g}"), float(f"{share:.4g}")]
                            for factor, share in p.steps() if factor <= CUT
                        ] for p in profiles(board, cells, names)
                    }}
    return found


def _efforts(board: Board) -> dict[str, Any]:
    """Effort by `cells|world|course`."""
    found: dict[str, Any] = {}
    for what, names in _sets(board).items():
        for world in (None, *board.worlds()):
            for course in (None, *board.courses()):
                cells = board.cells("worlds", world, course, by=names)
                one = effort(board, cells, names)
                found[f"{what}|{world or 'all'}|{course or 'all'}"] = {"n": one.n, "of": {
                    name: [_short(finite(value)) for value in values.values()]
                    for name, values in one.table.items()
                }}
    return found


def _charged(board: Board) -> list[list[Any]]:
    """Charged runs: controller, world, course, grip, friction, wind, seed, reason."""
    return [
        [row.controller, row.cell.world, row.cell.course, row.cell.grip, row.cell.friction,
         row.cell.wind, row.cell.seed, reason(row) if not completed(row) else f"({reason(row)})"]
        for row in board.rows if not finished(row)
    ]
