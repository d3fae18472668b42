"""What the numbers say, in sentences: a rival's win first."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence

from lpvmpc.leaderboard.grid import OURS, Cell
from lpvmpc.leaderboard.score import Board, Score, completed, error, finished, late, ranking
from lpvmpc.leaderboard.significance import ALPHA, Pair, Ranks, pairs, ranks

ALL = "all worlds"
"""Key of what is over all worlds together."""


def reference(board: Board) -> str:
    """Whom the sentences are about: `OURS`, or the best of those that drive all cells."""
    if OURS in board.controllers:
        return OURS
    names = board.full or board.controllers
    return ranking(board, board.cells("worlds", by=names), names)[0].controller


def compared(board: Board) -> dict[str, list[Pair]]:
    """The reference against everybody else, by world and over all; cells of all parts."""
    us = reference(board)
    others = [name for name in board.controllers if name != us]
    worlds = list(dict.fromkeys(cell.world for cell in board.table))
    found = {
        world: pairs(board, [cell for cell in board.table if cell.world == world], us, others)
        for world in worlds
    }
    if len(worlds) > 1:
        found[ALL] = pairs(board, list(board.table), us, others)
    return found


def drawn_ranks(board: Board) -> list[tuple[str, Ranks]]:
    """Mean ranks in each drawn world and over all of them, with what they are over."""
    found = []
    for names, what in ((board.full, ""), (board.controllers, ", with the slow ones")):
        if len(names) < 2 or (names == board.controllers and not board.slow and what):
            continue
        drawn = [c for c in board.cells("worlds", by=names) if c.world != "ideal"]
        for world in (*dict.fromkeys(cell.world for cell in drawn), None):
            cells = [cell for cell in drawn if world in (None, cell.world)]
            if cells:
                where = f"`{world}`" if world else "all drawn worlds"
                found.append((f"{where}{what}", ranks(board, cells, names)))
    return found


def sentences(board: Board) -> list[str]:
    """The verdict, a sentence each: first what speaks for the rivals, then what for us."""
    us, found = reference(board), compared(board)
    leaders = list(_leaders(board))
    parts: list[str] = []
    parts += _wins_of_rivals(us, found)
    parts += _more_finished(board, us)
    parts += [text for name, text in leaders if name != us]
    parts += _best_at_limits(board, us, theirs=True)
    parts += [text for name, text in leaders if name == us]
    parts += _wins_of_ours(us, found)
    parts += _best_at_limits(board, us, theirs=False)
    parts += _ranks(board)
    parts += _cost(board, us)
    parts += _charged(board)
    return parts


def _in(world: str) -> str:
    return "Over all worlds" if world == ALL else f"In `{world}`"


def _wins_of_rivals(us: str, found: dict[str, list[Pair]]) -> Iterable[str]:
    none = True
    for world, tested in found.items():
        for pair in tested:
            if pair.verdict < 0:
                none = False
                yield (
                    f"{_in(world)}, `{pair.second}` is better than `{us}`: its lateral RMSE is "
                    f"{times(1.0 / pair.ratio)} smaller (median of {pair.n} paired runs, smaller "
                    f"in {pair.losses} of them, {p_text(pair.p)})."
                )
    if none and any(found.values()):
        yield (
            f"Nobody is significantly better than `{us}` in any world, over paired runs "
            f"(Wilcoxon and Holm, level {ALPHA:g})."
        )


def _more_finished(board: Board, us: str) -> Iterable[str]:
    for world in board.worlds():
        for name in board.controllers:
            if name == us:
                continue
            cells = board.cells("worlds", world, by=(us, name))
            theirs, ours = (sum(map(finished, board.of(who, cells))) for who in (name, us))
            if theirs > ours:
                yield (
                    f"In `{world}`, `{name}` finishes more runs than `{us}`: {theirs} against "
                    f"{ours} of {len(cells)}."
                )


def _leaders(board: Board) -> Iterable[tuple[str, str]]:
    """Who leads by the score, and in which words."""
    for world in board.worlds():
        names = board.full or board.controllers
        order = ranking(board, board.cells("worlds", world, by=names), names)
        text = f"By the score, `{order[0].controller}` leads in `{world}` ({score_text(order[0])})"
        if len(order) > 1:
            text += f", before `{order[1].controller}` ({score_text(order[1])})"
        yield order[0].controller, text + "."
        common = board.cells("worlds", world, by=board.controllers)
        if board.slow and board.full and common:
            first, second = ranking(board, common, board.controllers)[:2]
            yield first.controller, (
                f"On the {counted(len(common))} of `{world}` that the slow controllers have driven "
                f"too, `{first.controller}` leads ({score_text(first)}), before "
                f"`{second.controller}` ({score_text(second)})."
            )


def _wins_of_ours(us: str, found: dict[str, list[Pair]]) -> Iterable[str]:
    for world, tested in found.items():
        better = [pair for pair in tested if pair.verdict > 0]
        if better:
            each = ", ".join(f"`{pair.second}` ({times(pair.ratio)})" for pair in better)
            yield f"{_in(world)}, `{us}` has a significantly smaller RMSE than {each}."
        open_ = [pair for pair in tested if pair.verdict == 0]
        if open_:
            each = ", ".join(
                f"`{pair.second}` ({times(pair.ratio)}, {pair.n} pairs, {p_text(pair.p)})"
                for pair in open_
            )
            yield f"{_in(world)}, it cannot be told whether `{us}` is better than {each}."


def _best_at_limits(board: Board, us: str, theirs: bool) -> Iterable[str]:
    """In how many cells of the part `limits` who is the best; rivals' wins or the rest."""
    sets = {"everybody drives who is not slow": board.full} if board.full else {}
    if board.slow:
        sets["all drive"] = board.controllers
    for what, names in sets.items():
        cells = board.cells("limits", by=names)
        if not cells or len(names) < 2:
            continue
        best = Counter(name for cell in cells for name in best_of(board, cell, names))
        if (best[us] < max(best.values(), default=0)) is not theirs:
            continue
        nobody = sum(not best_of(board, cell, names) for cell in cells)
        each = ", ".join(f"`{name}` in {count}" for name, count in best.most_common())
        yield (
            f"On the circuit by grip and friction the smallest error is that of {each or 'nobody'} "
            f"of the {len(cells)} cells that {what}"
            + (f"; nobody finishes {nobody}." if nobody else ".")
        )


def best_of(board: Board, cell: Cell, names: Sequence[str]) -> tuple[str, ...]:
    """Who has the smallest error in a cell; nobody where nobody finishes."""
    errors = {name: error(board.table[cell][name]) for name in names}
    best = min(errors.values())
    return tuple(name for name in names if errors[name] == best < math.inf)


def _ranks(board: Board) -> Iterable[str]:
    names = board.full if len(board.full) > 1 else board.controllers
    cells = [c for c in board.cells("worlds", by=names) if c.world != "ideal"]
    if len(names) < 2 or not cells:
        return
    found = ranks(board, cells, names)
    order = ", ".join(f"`{name}` {rank:.2f}" for name, rank in found.mean.items())
    if math.isnan(found.p):
        yield f"Mean ranks over {found.n} paired runs in the drawn worlds: {order}; not tested."
        return
    differ = "differ" if found.p < ALPHA else "do not differ"
    text = (
        f"Mean ranks over {found.n} paired runs in the drawn worlds: {order}; they {differ} "
        f"(Friedman, {p_text(found.p)}), two of them significantly where they are more than "
        f"{found.difference:.2f} apart (Nemenyi)"
    )
    alike = [group for group in found.groups if len(group) > 1]
    if alike:
        each = "; ".join(", ".join(f"`{name}`" for name in group) for group in alike)
        text += f"; not told apart: {each}"
    yield text + "."


def _cost(board: Board, us: str) -> Iterable[str]:
    order = [s for s in ranking(board, board.cells("worlds"), board.controllers)
             if s.step_us[0] is not None]
    ours = next((s for s in order if s.controller == us), None)
    if ours is None or not ours.step_us[0]:
        return
    rest = sorted((s for s in order if s is not ours), key=lambda s: s.step_us[0] or 0.0)
    each = ", ".join(
        f"`{s.controller}` {s.step_us[0]:.0f} us "
        f"({times((s.step_us[0] or 0.0) / ours.step_us[0])})" for s in rest
    )
    yield (
        f"A step of `{us}` takes {ours.step_us[0]:.0f} us (median of CPU time)"
        + (f"; of the others: {each}." if each else ".")
    )


def _charged(board: Board) -> Iterable[str]:
    clean = []
    for name in board.controllers:
        rows = [row for row in board.rows if row.controller == name]
        lost = [row for row in rows if not completed(row)]
        slow = [row for row in rows if completed(row) and late(row)]
        if not lost and not slow:
            clean.append(f"`{name}`")
            continue
        text = f"`{name}` is charged {len(lost) + len(slow)} of {len(rows)} runs"
        why = []
        if lost:
            worlds = Counter(row.cell.world for row in lost)
            where = ", ".join(f"{n} in `{world}`" for world, n in worlds.items())
            why.append(f"{len(lost)} did not reach the end ({where})")
        if slow:
            why.append(f"{len(slow)} were driven too late")
        yield f"{text}: {'; '.join(why)}."
    if clean:
        yield f"No run is charged to {', '.join(clean)}."


def score_text(s: Score) -> str:
    """A score in words."""
    return f"{s.finished} of {s.n} finished, 95th percentile {mm(s.p95)}"


def mm(value: float) -> str:
    """A length in millimetres, or that it is charged."""
    if math.isinf(value):
        return "charged"
    value *= 1e3
    digits = 2 if value < 10.0 else 1 if value < 100.0 else 0
    return f"{value:.{digits}f} mm"


def counted(n: int) -> str:
    """A number of runs in words."""
    return "one run" if n == 1 else f"{n} runs"


def times(ratio: float) -> str:
    """A factor in words."""
    return f"{ratio:.3g} times" if ratio < 10.0 else f"{ratio:.0f} times"


def p_text(p: float) -> str:
    """A p-value in words."""
    return "not tested" if math.isnan(p) else "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"
