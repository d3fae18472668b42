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
    runs = [lambda: rivals(found.worlds), lambda: completion(found.worlds)]
    if any(s.completed < s.n for s in found.worlds if s.cell.controller == OURS):
        runs.reverse()  # a lost car is worse than a rival's smaller error
    told: list[Callable[[], Iterator[str]]] = [
        *runs,
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
        names = ", ".join(f"`{name}`" for name in dict.fromkeys(s.cell.controller for s in others))
        yield (
            f"None of those driven here ({names}) has a better 95th percentile than `{OURS}`, "
            "neither of the RMSE nor of the largest error, in any world on any road; others are "
            "in docs/results/benchmark.md."
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
        yield f"None of those driven here bears more than `{OURS}` of any deviation."


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


HELPS, HURTS, ALIKE = "helps", "hurts", "changes nothing that matters"
BOTH_LOST = "loses the car too"
"""What one stiffness model does in place of another."""
RESOLVED = 1e-4
"""Errors that differ by less are alike [m]: a hundredth of the noise of a good position sensor."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One stiffness model in place of another, in one world on one road."""

    model: str
    """Who drove."""
    than: str
    """In whose place."""
    case: str
    """The world."""
    road: str
    """Key of the road."""
    errors: tuple[float, float]
    """95th percentile of the RMSE of the two [m], infinite for a lost car."""
    seeds: tuple[int, int]
    """With how many seeds the RMSE is better, and worse."""
    n: int
    """Number of seeds."""
    lost: tuple[int, int]
    """Lost runs of the two."""

    @property
    def word(self) -> str:
        """What it does."""
        return compared(*self.errors)


def comparisons(found: Found) -> list[Comparison]:
    """All comparisons of `COMPARED`, seed by seed, where both were driven."""
    table = {(s.cell.case, s.cell.road, s.cell.model): s for s in found.adaptation}
    runs = grouped(found.rows.get("adaptation", ()), lambda c: (c.case, c.road, c.model))
    all_of_them = []
    for model, than, _ in COMPARED:
        for case in ADAPTED:
            for road in ROADS:
                a, b = table.get((case, road, model)), table.get((case, road, than))
                if a is None or b is None:
                    continue
                pairs = zip(runs[case, road, model], runs[case, road, than], strict=True)
                each = [compared(x.ranked("lateral_rmse_m"), y.ranked("lateral_rmse_m"))
                        for x, y in pairs]
                one = Comparison(
                    model=model, than=than, case=case, road=road, errors=(a.rmse[1], b.rmse[1]),
                    seeds=(each.count(HELPS), each.count(HURTS)), n=len(each),
                    lost=(a.n - a.completed, b.n - b.completed),
                )
                all_of_them.append(one)
    return all_of_them


def adaptation(found: Found) -> Iterator[str]:
    """What each stiffness model is worth against another, world by world."""
    for model, than, what in COMPARED:
        here = [one for one in comparisons(found) if (one.model, one.than) == (model, than)]
        if not here:
            continue
        parts = []
        for case in dict.fromkeys(one.case for one in here):
            words: dict[str, list[str]] = {}
            for one in here:
                if one.case == case:
                    errors = " against ".join(map(mm, one.errors))
                    words.setdefault(one.word, []).append(f"{ROADS[one.road].title} ({errors})")
            said = ", ".join(f"it {word} on {', '.join(roads)}" for word, roads in words.items())
            parts.append(f"in `{case}` {said}")
        yield (
            f"`{model}` in place of `{than}` ({what}) {judged([one.word for one in here])}; by the "
            f"95th percentile of the RMSE: {'; '.join(parts)}."
        )


def compared(error: float, other: float) -> str:
    """What an error does in place of the other; infinite ones are lost cars."""
    if math.isinf(error) and math.isinf(other):
        return BOTH_LOST
    if abs(error - other) < RESOLVED:
        return ALIKE
    return HELPS if error * MATTERS <= other else HURTS if other * MATTERS <= error else ALIKE


def judged(words: Sequence[str]) -> str:
    """Several comparisons in one."""
    better, worse = words.count(HELPS), words.count(HURTS)
    if not better and not worse:
        return f"makes no difference in any of {len(words)} worlds and roads"
    kind = "pays" if better > worse else "costs" if worse > better else "pays as often as it costs"
    counts = f"{better} times it helps, {worse} times it hurts"
    return f"{kind}: of {len(words)} worlds and roads {counts}"


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
