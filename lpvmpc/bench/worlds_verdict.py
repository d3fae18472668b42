"""What follows from the worlds: sentences and promises, whichever way the numbers fall."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from lpvmpc.bench.margins import Margin
from lpvmpc.bench.verdict import MATTERS
from lpvmpc.bench.worlds import ADAPTED, DEVIATIONS, OURS, ROADS, DrivenCell, GridPlan
from lpvmpc.bench.worlds_stats import Summary, grouped, summaries

COMPARED = (
    ("network-secant", "constant", "the paper's claim"),
    ("network", "constant", "ours"),
    ("network", "network-secant", "ours beside the paper's"),
    ("network", "network-dry", "online learning"),
)
"""Stiffness models that are compared: which, against which, and what that asks."""


@dataclass(frozen=True, kw_only=True)
class Found:
    """All that was driven."""

    plan: GridPlan
    """How much."""
    rows: Mapping[str, Sequence[DrivenCell]] = field(default_factory=dict)
    """Runs of each part that was driven, the margins left out."""
    margins: Sequence[Margin] | None = None
    """The margins, where they were searched."""

    @property
    def worlds(self) -> list[Summary]:
        """Summaries of the sampled worlds."""
        return summaries(self.rows.get("worlds", ()))

    @property
    def adaptation(self) -> list[Summary]:
        """Summaries of the stiffness models."""
        return summaries(self.rows.get("adaptation", ()))

    @property
    def parts(self) -> list[str]:
        """The parts that were driven."""
        return [*self.rows, *(["margins"] if self.margins is not None else [])]

    def every_row(self) -> list[DrivenCell]:
        """All runs, part by part."""
        rows = [row for part in self.rows.values() for row in part]
        return rows + [row for margin in self.margins or () for row in margin.rows]


def sentences(found: Found) -> list[str]:
    """What the numbers say, one statement each; what speaks against `lpv-mpc` comes first."""
    told: list[Callable[[], Iterator[str]]] = [
        lambda: rivals(found.worlds),
        lambda: completion(found.worlds),
        lambda: estimator(found.worlds),
        lambda: deviations(found.rows.get("deviations", ())),
        lambda: margins_said(found.margins or ()),
        lambda: adaptation(found),
    ]
    return [sentence for tell in told for sentence in tell()]


def rivals(found: Sequence[Summary]) -> Iterator[str]:
    """Where another controller has a better 95th percentile, or completes more runs."""
    ours = {(s.cell.case, s.cell.road): s for s in found if s.cell.controller == OURS}
    others = [s for s in found if s.cell.controller != OURS and (s.cell.case, s.cell.road) in ours]
    if not others:
        return
    none = True
    measures: tuple[tuple[str, Callable[[Summary], float]], ...] = (
        ("RMSE", lambda s: s.rmse[1]), ("largest error", lambda s: s.largest[1]),
    )
    for name, of in measures:
        where: dict[str, list[str]] = {}
        for s in others:
            own = ours[s.cell.case, s.cell.road]
            if of(s) < of(own):
                better = where.setdefault(f"{place(s)} ({OURS} {mm(of(own))})", [])
                better.append(f"`{s.cell.controller}` {mm(of(s))}")
        if where:
            none = False
            yield (
                f"A rival has a better 95th percentile of the {name} than `{OURS}`: in "
                f"{listed(where)}."
            )
    if none:
        yield (
            f"No rival has a better 95th percentile than `{OURS}`, neither of the RMSE nor of the "
            "largest error, in any world on any road."
        )
    more: dict[str, list[str]] = {}
    for s in others:
        own = ours[s.cell.case, s.cell.road]
        if s.completed > own.completed:
            there = f"{place(s)} ({OURS} {own.completed} of {own.n})"
            more.setdefault(there, []).append(f"`{s.cell.controller}` {s.completed}")
    if more:
        yield (
            f"A rival completes more runs than `{OURS}`: in "
            f"{listed(more)}."
        )


def listed(where: Mapping[str, Sequence[str]]) -> str:
    """Places, each with who is better there."""
    return "; ".join(f"{there} {', '.join(who)}" for there, who in where.items())


def completion(found: Sequence[Summary]) -> Iterator[str]:
    """Where `lpv-mpc` loses the car."""
    own = [s for s in found if s.cell.controller == OURS]
    lost = [f"{place(s)} {s.n - s.completed} of {s.n}" for s in own if s.completed < s.n]
    if lost:
        yield f"`{OURS}` loses the car in {', '.join(lost)}; the runs are listed below."
    elif own:
        yield f"`{OURS}` completes all {sum(s.n for s in own)} runs in the sampled worlds."


def estimator(found: Sequence[Summary]) -> Iterator[str]:
    """What share of the error is the estimator's."""
    parts = [
        f"{100.0 * s.share:.0f} % in {place(s)}"
        for s in found
        if s.cell.controller == OURS and s.share is not None and s.cell.road == "circuit-65"
    ]
    if parts:
        yield (
            f"The estimator's own lateral RMSE is, as a share of that of `{OURS}` (median of the "
            f"completed runs), {', '.join(parts)}; the rest is the controller's."
        )


def deviations(rows: Sequence[DrivenCell]) -> Iterator[str]:
    """What each deviation alone does to `lpv-mpc`, and where another keeps closer."""
    own = {(r.cell.case, r.cell.road): r for r in rows if r.cell.controller == OURS}
    if not own:
        return
    titles = {one.key: one.title for one in DEVIATIONS}
    lost: dict[str, list[str]] = {}
    for (case, road), r in own.items():
        if not r.completed:
            lost.setdefault(titles[case], []).append(ROADS[road].title)
    if lost:
        parts = [f"{case} ({', '.join(roads)})" for case, roads in lost.items()]
        yield f"Alone, with the true state, these deviations lose `{OURS}`: {', '.join(parts)}."
    else:
        yield f"No deviation alone loses `{OURS}` on any road."
    closer: dict[str, dict[str, list[str]]] = {}
    for r in rows:
        mine = own.get((r.cell.case, r.cell.road))
        if mine is not None and r.ranked("lateral_rmse_m") < mine.ranked("lateral_rmse_m"):
            roads_of = closer.setdefault(titles[r.cell.case], {})
            roads_of.setdefault(ROADS[r.cell.road].title, []).append(f"`{r.cell.controller}`")
    if closer:
        parts = [
            f"{case} ({'; '.join(f'{road}: ' + ', '.join(who) for road, who in roads.items())})"
            for case, roads in closer.items()
        ]
        yield f"Alone, these leave a rival a smaller RMSE than `{OURS}`: {', '.join(parts)}."


def margins_said(found: Sequence[Margin]) -> Iterator[str]:
    """How far each thing may be wrong, and where another bears more."""
    own = {m.kind.key: m for m in found if m.controller == OURS}
    if own:
        parts = [f"{m.kind.title} {margin_text(m)}" for m in own.values()]
        yield f"How far `{OURS}` holds on circuit 65 %: {', '.join(parts)}."
    more = [
        f"`{m.controller}` of {m.kind.title} ({margin_text(m)} against {margin_text(mine)})"
        for m in found
        if (mine := own.get(m.kind.key)) is not None and reach(m) > reach(mine)
    ]
    if more:
        yield f"A rival bears more than `{OURS}`: {', '.join(more)}."
    elif len(own) and len({m.controller for m in found}) > 1:
        yield f"No rival bears more than `{OURS}` of any deviation."


def reach(margin: Margin) -> float:
    """How far a margin goes, from 0 to 1 of the range; -1 where not even nothing held."""
    if margin.held is None:
        return -1.0
    kind = margin.kind
    if kind.geometric:
        return math.log(margin.held / kind.none) / math.log(kind.end / kind.none)
    return (margin.held - kind.none) / (kind.end - kind.none)


def margin_text(margin: Margin) -> str:
    """A margin with its unit, in a sentence."""
    if margin.held is None:
        return "none"
    to = "at least to" if margin.failed is None else "to"
    return f"{to} {margin.held:.3g} {margin.kind.unit}"


def adaptation(found: Found) -> Iterator[str]:
    """What each stiffness model is worth against another, world by world."""
    table = {(s.cell.case, s.cell.road, s.cell.model): s for s in found.adaptation}
    runs = grouped(found.rows.get("adaptation", ()), lambda c: (c.case, c.road, c.model))
    for model, than, what in COMPARED:
        won: list[int] = []
        for case in ADAPTED:
            parts = []
            for road in ROADS:
                a, b = table.get((case, road, model)), table.get((case, road, than))
                if a is None or b is None:
                    continue
                verdict = compared(a.rmse[1], b.rmse[1])
                won.append(verdict)
                pairs = zip(runs[case, road, model], runs[case, road, than], strict=True)
                each = [compared(x.ranked("lateral_rmse_m"), y.ranked("lateral_rmse_m"))
                        for x, y in pairs]
                word = {1: "helps", -1: "hurts", 0: "changes nothing that matters"}[verdict]
                lost = [s.n - s.completed for s in (a, b)]
                parts.append(
                    f"{ROADS[road].title} it {word} ({mm(a.rmse[1])} against {mm(b.rmse[1])}; "
                    f"better in {each.count(1)}, worse in {each.count(-1)} of {len(each)} seeds"
                    + (f"; lost {lost[0]} against {lost[1]})" if any(lost) else ")")
                )
            if parts:
                yield (
                    f"`{model}` against `{than}` ({what}) in `{case}`, 95th percentile of the "
                    f"RMSE: on {', on '.join(parts)}."
                )
        if won:
            yield (
                f"In all, `{model}` against `{than}` ({what}) {judged(won)}: it helps in "
                f"{won.count(1)}, hurts in {won.count(-1)} and changes nothing that matters in "
                f"{won.count(0)} of {len(won)} worlds and roads."
            )


def compared(error: float, other: float) -> int:
    """1 where an error is smaller than the other by what matters, -1 where larger, else 0.

    Two infinite ones, lost cars, are alike.
    """
    if error == other:
        return 0
    return 1 if error * MATTERS <= other else -1 if other * MATTERS <= error else 0


def judged(won: Sequence[int]) -> str:
    """Several comparisons in a word."""
    better, worse = won.count(1), won.count(-1)
    if better and not worse:
        return "is worth it"
    if better > worse:
        return "is worth it more often than not"
    return "is not worth it" if worse else "makes no difference"


def place(s: Summary) -> str:
    """World and road of a summary."""
    return f"`{s.cell.case}` on {ROADS[s.cell.road].title}"


def mm(value: float) -> str:
    """A length in millimetres, or that the car was lost."""
    if math.isinf(value):
        return "lost"
    value *= 1e3
    digits = 2 if value < 1.0 else 1 if value < 10.0 else 0
    return f"{value:.{digits}f} mm"
