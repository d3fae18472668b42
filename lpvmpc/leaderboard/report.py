"""The leaderboard as Markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import at_a_time, versions_line
from lpvmpc.leaderboard.grid import FIRST_SEED, PARTS, Cell, Plan, Row
from lpvmpc.leaderboard.profiles import profiles
from lpvmpc.leaderboard.score import (
    EFFORT,
    LATE_SHARE,
    Board,
    Score,
    completed,
    effort,
    finished,
    late,
    ranking,
    reason,
    score,
)
from lpvmpc.leaderboard.significance import ALPHA, CHARGE
from lpvmpc.leaderboard.verdict import (
    compared,
    drawn_ranks,
    mm,
    p_text,
    reference,
    sentences,
)

TITLE = "Leaderboard"
FACTORS = (1.0, 1.1, 1.25, 1.5, 2.0, 5.0, 10.0)
"""Factors of the profile tables."""
DEFINITIONS = """\
Definitions:

- Every run is one closed loop on the MuJoCo car, which begins trimmed on the road at its first \
speed; control every 33 ms. What is scored is the true centre of mass at every control instant. \
A cell is road, speed, world, friction, wind and seed; all controllers drive it with the same \
seed, so they meet the same car, road and noise.
- A run is lost when the car is more than 5 m off the path (on a road that states its widths also \
2 m beyond its edge), turned by more than 90 degrees, rolled over, stuck, or needs twice the \
reference's time, and when the controller raises, hangs or returns no command.
- A run is late when more than {late:g} % of the controller's steps took longer than the 33 ms in \
which the next command is due (CPU time; the simulated car waits for it, a real one would not).
- Finished: neither lost nor late. All other runs are charged: they count as the worst there is \
and no percentile or rank leaves them out; where a number is needed it is {charge:g} m.
- The score: the share of finished runs first, then the 95th percentile of the lateral RMSE over \
the runs, then its median. The percentile is the RMSE of a run, the smallest that 95 % of all do \
not exceed; "charged" where it falls on a charged run. Its interval (95 %) is that of order \
statistics, open ("from") where the runs are too few to close it; that of the finished share is \
Wilson's.
- Controllers know the nominal car and nothing of what is drawn. Weights are those that the \
package ships; see docs/results/tuning and the record in each weights file.
- Effort is compared on the same runs alone, which everybody has completed who completed half.
- Tests are over paired runs: Friedman with Nemenyi's critical difference for mean ranks, \
Wilcoxon's signed ranks with Holm's correction for one against each other; level {alpha:g}.
"""


def report(
    board: Board, plan: Plan, *, jobs: int, lacking: Mapping[str, str], rows_sha256: str,
    pictures: Sequence[str],
) -> str:
    """The report in Markdown.

    Args:
        board: What was driven.
        plan: How much that is.
        jobs: Number of runs at a time.
        lacking: Controllers that were left out, and the packages they lack.
        rows_sha256: Hash of the file of rows.
        pictures: Names of the pictures that were drawn.
    """
    quick = " (quick look: a few runs, not the report)" if plan.quick else ""
    lines = [
        f"# {TITLE}{quick}",
        "",
        f"Machine: {machine()}; {at_a_time(jobs)}.",
        versions_line(),
        f"Seeds: from {FIRST_SEED}, others for each course and world; the same for every "
        f"controller; tuning uses seeds below 50000. {len(board.rows)} runs, {len(board.table)} "
        "cells.",
        f"Rows: benchmark-rows.parquet, SHA-256 {rows_sha256}.",
        *_left_out(board, lacking),
        "",
        DEFINITIONS.format(late=100 * LATE_SHARE, charge=CHARGE, alpha=ALPHA),
        "Parts: " + "; ".join(f"`{part}`, {about}" for part, about in PARTS.items()) + ".",
        "",
        "## Verdict",
        "",
        *(f"- {sentence}" for sentence in sentences(board)),
        "",
        *_worlds(board, pictures),
        *_courses(board),
        *_profiles(board, pictures),
        *_effort(board),
        *_limits(board, pictures),
        *_wind(board),
        *_significance(board),
        *_charged(board),
        "## Limits",
        "",
        "- One type of car and one kind of tire; the ranges of the worlds are assumed in part "
        "(docs/worlds.md grades each).",
        "- Step times are those of one machine, of Python, numba and compiled solvers as they "
        "come; they say what a controller costs here, not what it could cost.",
        "- Each controller drives with one set of weights everywhere.",
        "",
        f"Made by `python eval/benchmark.py{' --quick' if plan.quick else ''}`; benchmark.html "
        "shows the same with filters; docs/submit.md says how to enter and to verify a result.",
    ]
    return "\n".join(lines) + "\n"


def _left_out(board: Board, lacking: Mapping[str, str]) -> Iterable[str]:
    if board.slow:
        names = ", ".join(f"`{name}`" for name in board.slow)
        count = sum(row.controller == board.slow[0] for row in board.rows)
        yield (
            f"Slow controllers drive a part of the cells, {count} each: {names}. They are ranked "
            "in the tables \"runs that all have driven\", and compared pair by pair."
        )
    for name, package in lacking.items():
        yield f"Left out: `{name}`, since the package {package} is not installed."


# Scores -------------------------------------------------------------------------------------------


def _worlds(board: Board, pictures: Sequence[str]) -> Iterable[str]:
    yield "## By world\n"
    for world in board.worlds():
        full = board.full or board.controllers
        cells = board.cells("worlds", world, by=full)
        yield score_table(f"`{world}`, {len(cells)} runs each", ranking(board, cells, full))
        common = board.cells("worlds", world, by=board.controllers)
        if board.slow and common and board.full:
            title = f"`{world}`, the {len(common)} runs that all have driven"
            yield score_table(title, ranking(board, common, board.controllers))
    if "benchmark-pareto.png" in pictures:
        yield "![Error against step time](benchmark-pareto.png)\n"
        yield (
            "95th percentile of the lateral RMSE against the median step time, with 95 % "
            "intervals, dotted where the runs are too few to close them; a triangle: charged. "
            "Below and left is better.\n"
        )


def score_table(title: str, found: Sequence[Score]) -> str:
    """Scores, the best first."""
    header = ("controller", "finished", "95 % interval", "lost", "late", "RMSE: 95th", "interval",
              "median", "largest: 95th", "step p50 [us]", "p99", "worst", "late steps")
    body = []
    for s in found:
        low, high = s.interval
        p50, p99, worst = ("-" if t is None else f"{t:.0f}" for t in s.step_us)
        body.append([
            f"`{s.controller}`", f"{s.finished} of {s.n}", f"{100 * low:.0f} to {100 * high:.0f} %",
            s.n - s.completed, s.completed - s.finished, mm(s.p95),
            interval_text(s), mm(s.median), mm(s.largest),
            p50, p99, worst, "-" if s.late_share is None else f"{100 * s.late_share:.2g} %",
        ])
    return markdown_table(f"{title}: lateral errors", header, body)


def interval_text(s: Score) -> str:
    """The interval of the 95th percentile; open above where the runs are too few to close it."""
    low, high = s.p95_interval
    if math.isinf(high) and s.finished == s.n:
        return f"from {mm(low)}"
    return f"{mm(low)} to {mm(high)}" if math.isfinite(low) else mm(low)


def _courses(board: Board) -> Iterable[str]:
    yield "## By course\n"
    for world in board.worlds():
        body = []
        for course in board.courses():
            cells = board.cells("worlds", world, course)
            if cells:
                body.append([course, *(course_text(board.of(name, cells))
                                       for name in board.controllers)])
        title = f"`{world}`: 95th percentile of the lateral RMSE [mm]; charged runs of all"
        yield markdown_table(title, ("course", *board.controllers), body)


def course_text(rows: Sequence[Row]) -> str:
    """A cell of the table of courses."""
    if not rows:
        return "-"
    s = score(rows)
    bad = s.n - s.finished
    value = "charged" if math.isinf(s.p95) else mm(s.p95).removesuffix(" mm")
    return f"{value} ({bad}/{s.n})" if bad else value


# Profiles, effort, limits, wind -------------------------------------------------------------------


def _profiles(board: Board, pictures: Sequence[str]) -> Iterable[str]:
    yield "## Performance profiles\n"
    yield (
        "Share of the cells that a controller drives within a factor of the best one's error "
        "(Dolan and More); charged runs are never within any.\n"
    )
    groups = [(board.full, "all cells")] if board.full else []
    if board.slow:
        groups.append((board.controllers, "the cells that all have driven"))
    for names, what in groups:
        cells = board.cells("worlds", by=names)
        if not cells:
            continue
        header = ("controller", *(f"{factor:g}x" for factor in FACTORS), "finished")
        found = sorted(profiles(board, cells, names), key=lambda p: (-p.within(2.0), p.controller))
        body = [
            [f"`{p.controller}`", *(f"{100 * p.within(f):.0f} %" for f in (*FACTORS, 1e300))]
            for p in found
        ]
        yield markdown_table(f"Within a factor of the best, {what} ({len(cells)})", header, body)
    if "benchmark-profiles.png" in pictures:
        yield "![Performance profiles](benchmark-profiles.png)\n"


def _effort(board: Board) -> Iterable[str]:
    yield "## Effort\n"
    for world in board.worlds():
        names = board.full or board.controllers
        found = effort(board, board.cells("worlds", world, by=names), names)
        if not found.n:
            continue
        header = ("controller", "steering rate [rad/s]", "drive rate [m/s3]", "jerk [m/s3]",
                  "lateral acceleration used [m/s2]")
        body = [
            [f"`{name}`", *(f"{values[key]:.3g}" for key in EFFORT)]
            for name, values in sorted(found.table.items(), key=lambda item: item[1][EFFORT[0]])
        ]
        title = f"`{world}`: medians over the {found.n} runs that these have all completed"
        yield markdown_table(title, header, body)


def _limits(board: Board, pictures: Sequence[str]) -> Iterable[str]:
    cells = board.cells("limits")
    if not cells:
        return
    yield "## Grip and friction\n"
    grips = sorted({cell.grip or 0.0 for cell in cells})
    frictions = sorted({cell.friction for cell in cells}, reverse=True)
    place = {(cell.friction, cell.grip): cell for cell in cells}
    body = []
    for friction in frictions:
        for name in board.controllers:
            rows = [board.table[place[friction, grip]].get(name) for grip in grips]
            if any(rows):
                body.append([f"{friction:g}", f"`{name}`", *map(limit_text, rows)])
    header = ("friction", "controller", *(f"{100 * grip:.0f} %" for grip in grips))
    title = "Circuit, ideal world, by share of the grip: lateral RMSE / largest error [mm]"
    yield markdown_table(title, header, body, words=("controller",))
    if "benchmark-heat.png" in pictures:
        yield "![Error over friction and speed](benchmark-heat.png)\n"


def limit_text(row: Row | None) -> str:
    """A cell of the table of limits."""
    if row is None:
        return "-"
    if not completed(row):
        where = row.result["s_end_m"]
        return "failed" if where is None else f"lost at {where:.0f} m"
    largest = row.result["lateral_max_m"]
    text = f"{mm(row.result['lateral_rmse_m'])} / {mm(largest)}".replace(" mm", "")
    return f"late ({text})" if late(row) else text


def _wind(board: Board) -> Iterable[str]:
    cells = board.cells("wind")
    if not cells:
        return
    yield "## Wind\n"
    body = []
    for world in dict.fromkeys(cell.world for cell in cells):
        for wind in sorted({cell.wind for cell in cells}):
            here = [c for c in cells if c.world == world and c.wind == wind]
            if here:
                body.append([world, f"{wind:g}", len(here), *(
                    course_text(board.of(name, here)) for name in board.full)])
    title = "`paper` by the factor on its wind: 95th percentile of the lateral RMSE [mm]"
    yield markdown_table(title, ("world", "wind", "runs", *board.full), body)


# Significance -------------------------------------------------------------------------------------


def _significance(board: Board) -> Iterable[str]:
    yield "## Significance\n"
    for where, found in drawn_ranks(board):
        groups = [" ".join(str(i + 1) for i, group in enumerate(found.groups) if name in group)
                  for name in found.mean]
        body = [
            [f"`{name}`", f"{rank:.2f}", group]
            for (name, rank), group in zip(found.mean.items(), groups, strict=True)
        ]
        about = "not tested" if math.isnan(found.p) else (
            f"Friedman {p_text(found.p)}, critical difference {found.difference:.2f}"
        )
        title = f"Mean rank in {where}, {found.n} paired runs: {about}"
        yield markdown_table(title, ("controller", "mean rank", "group"), body)
    yield "Controllers that share a group are not told apart; no group: not tested.\n"
    us = reference(board)
    lines = [
        [world, f"`{p.second}`", p.n, f"{p.ratio:.3g}", f"{p.wins} / {p.losses}", p_text(p.p),
         {1: "worse", -1: "BETTER", 0: "cannot be told"}[p.verdict]]
        for world, tested in compared(board).items() for p in tested
    ]
    header = ("world", "controller", "pairs", f"its RMSE / {us}'s", f"{us} better / worse", "Holm",
              "it is")
    title = f"Each controller against `{us}`, cells of all parts"
    yield markdown_table(title, header, lines, words=("controller", "it is"))


# Charged runs -------------------------------------------------------------------------------------


def _charged(board: Board) -> Iterable[str]:
    yield "## Charged runs\n"
    groups: dict[tuple[str, str, str, str], list[Row]] = {}
    for row in board.rows:
        if not finished(row):
            cell = row.cell
            where = cell.course if cell.part == "worlds" else place_text(cell)
            kind = reason(row) if not completed(row) else "late"
            key = (row.controller, cell.world, where, kind)
            groups.setdefault(key, []).append(row)
    if not groups:
        yield "None.\n"
        return
    body = []
    for (name, world, where, why), rows in groups.items():
        seeds = [row.cell.seed for row in rows]
        few = ", ".join(map(str, seeds[:4])) + (", ..." if len(seeds) > 4 else "")
        body.append([f"`{name}`", world, where, len(rows), why.replace("|", "\\|"), few])
    header = ("controller", "world", "course", "runs", "reason", "seeds")
    words = ("world", "course", "reason", "seeds")
    yield markdown_table("Runs that are charged", header, body, words=words)


def place_text(cell: Cell) -> str:
    """A cell of the parts `limits` and `wind` in words."""
    if cell.part == "wind":
        return f"{cell.course}, wind x{cell.wind:g}"
    return f"{cell.course} {100 * (cell.grip or 0.0):.0f} %, friction {cell.friction:g}"
