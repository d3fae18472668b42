"""The numbers of the leaderboard as CSV and JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from lpvmpc.kit.report import csv_text, finite, record
from lpvmpc.leaderboard.grid import COURSES, FIRST_SEED, Plan
from lpvmpc.leaderboard.score import LATE_SHARE, Board, error, finished, ranking, reason
from lpvmpc.leaderboard.significance import CHARGE
from lpvmpc.leaderboard.verdict import compared, drawn_ranks, reference, sentences


def table(board: Board) -> list[dict[str, Any]]:
    """Scores by world and course, `all` among both, as plain values."""
    found = []
    for world in (None, *board.worlds()):
        for course in (None, *board.courses()):
            for names, what in ((board.full, "full"), (board.controllers, "common")):
                cells = board.cells("worlds", world, course, by=names)
                if not names or not cells or (what == "common" and not board.slow):
                    continue
                for i, s in enumerate(ranking(board, cells, names)):
                    low, high = s.interval
                    found.append({
                        "cells": what, "world": world or "all", "course": course or "all",
                        "rank": i + 1, "controller": s.controller, "runs": s.n,
                        "completed": s.completed, "finished": s.finished, "share_low": low,
                        "share_high": high, "p95_m": finite(s.p95),
                        "p95_low_m": finite(s.p95_interval[0]),
                        "p95_high_m": finite(s.p95_interval[1]), "median_m": finite(s.median),
                        "largest_p95_m": finite(s.largest), "step_p50_us": s.step_us[0],
                        "step_p50_low_us": s.step_interval and finite(s.step_interval[0]),
                        "step_p50_high_us": s.step_interval and finite(s.step_interval[1]),
                        "step_p99_us": s.step_us[1], "step_max_us": s.step_us[2],
                        "late_share": s.late_share,
                    })
    return found


def as_csv(board: Board) -> str:
    """The scores, a line each."""
    lines = table(board)
    return csv_text(list(lines[0]), ([*line.values()] for line in lines))


def as_json(
    board: Board, plan: Plan, *, jobs: int, lacking: Mapping[str, str], rows_sha256: str
) -> dict[str, Any]:
    """Sentences, scores and tests, and under which conditions."""
    counts = Counter(row.controller for row in board.rows)
    return {
        "sentences": sentences(board),
        "scores": [line for line in table(board) if line["course"] == "all"],
        "ranks": [
            {"over": where, "n": r.n, "mean": dict(r.mean), "p": finite(r.p),
             "critical_difference": finite(r.difference), "groups": [list(g) for g in r.groups]}
            for where, r in drawn_ranks(board)
        ],
        "against": reference(board),
        "pairs": [
            {"world": world, **{k: finite(v) for k, v in asdict(pair).items()},
             "verdict": pair.verdict}
            for world, tested in compared(board).items() for pair in tested
        ],
        "limits": [
            {"controller": name, "grip": cell.grip, "friction": cell.friction,
             "rmse_m": finite(error(row)), "reason": "" if finished(row) else reason(row)}
            for cell in board.cells("limits") for name, row in board.table[cell].items()
        ],
        "runs": dict(counts),
        "rows_sha256": rows_sha256,
        "record": record(
            jobs=jobs, plan=asdict(plan), slow=list(board.slow), lacking=dict(lacking),
            first_seed=FIRST_SEED, courses={k: asdict(c) for k, c in COURSES.items()},
            late_share=LATE_SHARE, charge_m=CHARGE,
        ),
    }
