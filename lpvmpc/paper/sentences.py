"""What the numbers say, one statement each, whichever way it falls."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from lpvmpc.bench.cases import geometric_mean
from lpvmpc.paper.measurements import DrivenEntry, Evidence
from lpvmpc.paper.printed_formulas import SLIPS
from lpvmpc.paper.printed_numbers import PAPER_RATIO, ratio
from lpvmpc.paper.runs import DRIVEN, OURS, PAPERS
from lpvmpc.published import TRACKING
from lpvmpc.tune import sphere

MATTERS = 1.1
"""Two errors count as different where their ratio is at least this."""


def sentences(e: Evidence) -> list[str]:
    """What the numbers say, one statement each."""
    told: list[Callable[[Evidence], str | None]] = [
        _on_the_papers_road, _ratios, _claim, _printed, _chain, _without, _weights, _step_times,
        lambda e: sphere.verdict(e.sphere),
    ]
    return [sentence for tell in told if (sentence := tell(e)) is not None]


def _on_the_papers_road(e: Evidence) -> str | None:
    row = e.get("tuned", OURS, "paper")
    if row is None:
        return None
    if not row.completed:
        return f"Our controller loses the paper's road at {row.result['s_end_m']:.0f} m."
    factor = 1e3 * TRACKING["lateral_rmse_m"] / (1e3 * row.rmse)
    return (
        f"On the paper's road in full wind, nine times the force of the authors' code, our "
        f"controller keeps a lateral RMSE of {1e3 * row.rmse:.2f} mm where the paper prints "
        f"{1e3 * TRACKING['lateral_rmse_m']:.1f} mm, {_times(factor)}. The plants differ, so "
        "that alone says little about the method; the ratios below say more."
    )


def _ratios(e: Evidence) -> str | None:
    parts = []
    for key, name in (("lateral_rmse_m", "lateral"), ("speed_rmse_mps", "speed")):
        found = [
            value
            for lmpc in ("tuned", "by hand") for ours in ("tuned", "by hand")
            if (value := ratio(e, key, lmpc=lmpc, ours=ours)) is not None
        ]
        now = ratio(e, key)
        if now is None:
            return None
        spread = f"{_two(min(found))} to {_two(max(found))} over the weights"
        parts.append(f"{_two(now)} ({spread}; paper {PAPER_RATIO[key]:.1f}) for the {name} error")
    return f"The baseline's RMSE is larger than ours by a factor of {' and '.join(parts)}."


def _claim(e: Evidence) -> str | None:
    """Does the paper's controller beat the baseline, as the paper says?"""
    parts = []
    for key, name in (("lateral_rmse_m", "lateral"), ("speed_rmse_mps", "speed")):
        values = [ratio(e, key, other=PAPERS, lmpc=group, ours=group)
                  for group in ("tuned", "by hand")]
        known = [value for value in values if value is not None]
        if not known:
            return None
        verdict = (
            "confirmed" if min(known) >= MATTERS
            else "not confirmed" if max(known) < MATTERS
            else "confirmed with some weights only"
        )
        shown = " and ".join(f"{value:.2f}" for value in known)
        how = " (tuned and by hand)" if len(known) == 2 else ""
        parts.append(f"{name} {shown}{how}, paper {PAPER_RATIO[key]:.1f}, {verdict}")
    return (
        "The paper puts its advantage over the baseline down to the more accurate model and the "
        "coupling. Its own controller, the plain formulation with its network, has just these; "
        f"the baseline's RMSE over that controller's: {'; '.join(parts)}."
    )


def _printed(e: Evidence) -> str | None:
    """What the printed slips do."""
    start = _ablated(e, "printed", "as printed")
    if not start:
        return None
    lost = sum(not row.completed for row in start)
    text = f"As printed the formulas lose the car on {_of(lost, len(start))} roads"
    alone = {name: _ablated(e, "alone", name) for name in SLIPS}
    base = _ablated(e, "alone", "none")
    if not base or not all(alone.values()):
        return text + "."
    fatal = [name for name, rows in alone.items() if not all(row.completed for row in rows)]
    cost = {name: _factor(rows, base) for name, rows in alone.items() if name not in fatal}
    costly = [f"{name} ({value:.1f} times)" for name, value in cost.items() if value >= MATTERS]
    harmless = [name for name, value in cost.items() if value < MATTERS]
    for names, what in (
        (fatal, "alone it is lost somewhere with"),
        (costly, "the lateral RMSE grows with"),
        (harmless, "and by less than 10 % with"),
    ):
        if names:
            text += f"; {what} {_listed(names)}"
    return text + "."


def _chain(e: Evidence) -> str | None:
    """What each part adds, in order."""
    entries = e.entries("corrected")
    gains = []
    for before, after in zip(entries, entries[1:], strict=False):
        a, b = (_ablated(e, "corrected", entry.key) for entry in (before, after))
        if a and b:
            gains.append((_factor(a, b), after))
    if not gains:
        return None
    shown = sorted(gains, key=lambda pair: -pair[0])
    best = [f"{entry.text} ({gain:.1f})" for gain, entry in shown[:4] if gain >= MATTERS]
    worse = [f"{entry.text} ({gain:.2f})" for gain, entry in shown[::-1] if gain < 1.0 / MATTERS]
    text = (
        f"From the plain formulation to the full controller the lateral RMSE falls by a factor of "
        f"{math.prod(gain for gain, _ in gains):.0f} (geometric mean over the roads, lost cars "
        f"charged); most of it by {_listed(best) or 'no single part'}"
    )
    if worse:
        text += f"; on the way {_listed(worse)} made it larger"
    return text + "."


def _without(e: Evidence) -> str | None:
    """Which parts the full controller needs."""
    base = _ablated(e, "without", "full")
    needed, idle, harmful = [], [], []
    for entry in e.entries("without")[1:]:
        rows = _ablated(e, "without", entry.key)
        if not base or not rows:
            return None
        lost = sum(not row.completed for row in rows)
        factor = _factor(rows, base)
        name = entry.key.removeprefix("- ")
        if lost > sum(not row.completed for row in base):
            needed.append((math.inf, f"{name} (lost on {lost} of {len(rows)} roads)"))
        elif factor >= MATTERS:
            needed.append((factor, f"{name} ({factor:.1f})"))
        elif factor > 1.0 / MATTERS:
            idle.append(name)
        else:
            harmful.append(f"{name} ({factor:.2f})")
    if not base:
        return None
    needed.sort(key=lambda pair: -pair[0])
    text = "Each part taken alone from the full controller multiplies the lateral RMSE: "
    text += _listed([name for _, name in needed]) or "none by more than a tenth"
    if idle:
        text += f"; hardly at all {_listed(idle)}"
    if harmful:
        text += f"; without these it is smaller: {_listed(harmful)}"
    return text + "."


def _weights(e: Evidence) -> str | None:
    """What tuning has changed, per controller."""
    parts = []
    for name in DRIVEN:
        if name not in e.equipment.tuned:
            continue
        tuned, by_hand = ([row for row in e.rows if row.entry.group == group
                           and row.entry.key == name] for group in ("tuned", "by hand"))
        if tuned and by_hand:
            parts.append(f"{name} {_factor(by_hand, tuned):.2f}")
    if not parts:
        return None
    return (
        "With the weights set by hand the lateral RMSE is so many times that with the tuned ones "
        f"(geometric mean over all roads): {', '.join(parts)}."
    )


def _step_times(e: Evidence) -> str | None:
    """Step times as ratios."""
    times = step_times(e)
    ours = times.get(OURS)
    others = {name: value for name, value in times.items() if name != OURS}
    if ours is None or not others:
        return None
    shown = ", ".join(f"{name} {value / ours:.2f}" for name, value in others.items())
    return f"A step of the other controllers takes, over a step of ours: {shown}."


def step_times(e: Evidence, which: str = "p50") -> dict[str, float]:
    """The best of the roads' median step times [us], or of another quantile, by controller."""
    found: dict[str, float] = {}
    for row in e.rows:
        value = (row.result["step_time_us"] or {}).get(which)
        if row.entry.group == "tuned" and value is not None:
            found[row.entry.key] = min(value, found.get(row.entry.key, math.inf))
    return found


def _ablated(e: Evidence, group: str, key: str) -> list[DrivenEntry]:
    return [row for row in e.rows if (row.entry.group, row.entry.key) == (group, key)]


def _factor(worse: Sequence[DrivenEntry], better: Sequence[DrivenEntry]) -> float:
    """Ratio of the geometric means of the lateral RMSE, lost cars charged."""
    return geometric_mean(r.rmse for r in worse) / geometric_mean(r.rmse for r in better)


def _times(factor: float) -> str:
    return f"{_two(factor)} times more" if factor >= 1.0 else f"{_two(1.0 / factor)} times less"


def _two(value: float) -> str:
    """Two digits: no more are known of a ratio to an error that the physics step moves."""
    return f"{value:.1f}" if value < 10.0 else f"{float(f'{value:.2g}'):.0f}"


def _of(count: int, total: int) -> str:
    return "all" if count == total else "none of the" if not count else f"{count} of {total}"


def _listed(names: Sequence[str]) -> str:
    """Names as a list in a sentence."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else list(names))
