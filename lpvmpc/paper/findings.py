"""What follows from the evidence: the paper's numbers beside ours, promises, sentences.

Everything here is computed, whichever way it falls; what was not measured is None.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lpvmpc.bench.cases import CHARGE, geometric_mean
from lpvmpc.control.registry import CONTROLLERS
from lpvmpc.kit.findings import Finding, Limit
from lpvmpc.paper import steering_at_rest
from lpvmpc.paper.measurements import Evidence, Row
from lpvmpc.paper.printed_formulas import SLIPS
from lpvmpc.paper.runs import LMPC, OURS, PAPERS, PLAIN
from lpvmpc.tune import sphere

MATTERS = 1.1
"""Two errors count as different where their ratio is at least this."""
DEGREE = 180.0 / math.pi

# The paper's numbers ------------------------------------------------------------------------------

Value = float | str | None


@dataclass(frozen=True, kw_only=True)
class Number:
    """One number of the paper beside ours."""

    key: str
    """Name in the files."""
    group: str
    """Table that it belongs to, a key of `TABLES`."""
    text: str
    """What it is."""
    unit: str = ""
    """Unit of all values."""
    paper: Value = None
    """What the paper prints; None where it prints nothing."""
    ours: Value = None
    """Ours; None where it was not measured."""
    third: Value = None
    """Ours at a third of the wind speed, as in the authors' code; None elsewhere."""
    remark: str = ""
    """What has to be known to compare them."""
    digits: int = 3
    """Digits that are shown."""


TABLES = {
    "tracking": "Tracking on the paper's road",
    "baseline": "The baseline: LMPC with PSO-PID on the paper's road",
    "computation": "Computation",
    "network": "The network",
    "search": "The genetic algorithm",
    "conditions": "Conditions",
}
"""Tables of numbers and their titles."""
PAPER_LMPC = {"lateral_rmse_m": 0.1367, "speed_rmse_mps": 0.1459}
PAPER_OURS = {"lateral_rmse_m": 0.0217, "speed_rmse_mps": 0.101}
PAPER_RATIO = {key: PAPER_LMPC[key] / PAPER_OURS[key] for key in PAPER_LMPC}
"""Errors printed in the paper, and how many times larger the baseline's are."""
IMPOSSIBLE = "impossible: below its own RMSE"


def numbers(e: Evidence) -> list[Number]:
    """Every number of the paper, with ours."""
    return [*_tracking(e), *_baseline(e), *_computation(e), *_network(e), *_search(e),
            *_conditions(e)]  # fmt: skip


def _tracking(e: Evidence) -> Iterable[Number]:
    for key, text, unit, paper, scale, remark in (
        ("lateral_rmse_m", "lateral error, RMSE", "m", 0.0217, 1.0, ""),
        ("lateral_max_m", "lateral error, largest", "m", 0.08, 1.0, ""),
        ("heading_rmse_rad", "heading error, RMSE", "rad", 0.0465, 1.0,
         "contains the angle that a car in side wind must have"),
        ("heading_max_rad", "heading error, largest", "deg", 11.0, DEGREE, "the same"),
        ("course_rmse_rad", "course error, RMSE", "rad", None, 1.0,
         "heading plus sideslip: the direction of motion"),
        ("speed_rmse_mps", "speed error, RMSE", "m/s", 0.101, 1.0, ""),
        ("speed_max_mps", "speed error, largest", "m/s", 0.087, 1.0, f"paper's {IMPOSSIBLE}"),
    ):
        ours, third = (_scaled(_get(e, OURS, case, key), scale)
                       for case in ("paper", "paper-third"))  # fmt: skip
        yield Number(key=key, group="tracking", text=text, unit=unit, paper=paper, ours=ours,
                     third=third, remark=remark)  # fmt: skip


def _baseline(e: Evidence) -> Iterable[Number]:
    names = {"lateral_rmse_m": ("lateral error, RMSE", "m"),
             "speed_rmse_mps": ("speed error, RMSE", "m/s")}  # fmt: skip
    for key, (text, unit) in names.items():
        ours, third = (_get(e, LMPC, case, key) for case in ("paper", "paper-third"))
        yield Number(key=f"lmpc_{key}", group="baseline", text=text, unit=unit,
                     paper=PAPER_LMPC[key], ours=ours, third=third)  # fmt: skip
    for other, than, remark in (
        (OURS, "ours", ""), (PAPERS, PAPERS, "the comparison that the paper makes"),
        (PLAIN, PLAIN, "the same without the network"),
    ):  # fmt: skip
        for key, (text, _) in names.items():
            ours, third = (ratio(e, key, other=other, case=case)
                           for case in ("paper", "paper-third"))  # fmt: skip
            what = text.partition(" ")[0]
            yield Number(key=f"{other}_ratio_{key}", group="baseline", unit="times",
                         text=f"{what} RMSE over that of {than}", paper=PAPER_RATIO[key],
                         ours=ours, third=third, remark=remark)  # fmt: skip
    yield _aggressive(e)


def _aggressive(e: Evidence) -> Number:
    """The paper says of the PSO-PID that it is more aggressive, and gives no number."""
    jerk = {}
    for name in (LMPC, OURS):
        change = np.diff(e.logs[name].columns["ax_cmd_mps2"]) / float(e.logs[name].meta["Ts"])
        jerk[name] = float(np.sqrt(np.mean(np.square(change))))
    value = jerk[LMPC] / jerk[OURS] if jerk[OURS] > 0.0 else None
    return Number(key="jerk_ratio", group="baseline", unit="times", paper="larger", ours=value,
                  text="RMS of the commanded jerk over ours",
                  remark='"more aggressive, as it cannot handle constraints"')  # fmt: skip


def _computation(e: Evidence) -> Iterable[Number]:
    times = e.logs[OURS].timing
    solve, step = (1e-3 * np.asarray(times[name], dtype=float) for name in ("solve_us", "step_us"))
    mean = float(step.mean())
    for key, text, unit, paper, ours, remark in (
        ("solve_mean_ms", "mean time to solve", "ms", 11.3, float(solve.mean()),
         "paper: Gurobi through Yalmip, Ryzen 7 5800H; ours: ProxQP, this machine"),
        ("step_mean_ms", "mean time of a control step", "ms", None, mean,
         "adaptation, model, QP, solve, check"),
        ("step_p99_ms", "99th percentile of a control step", "ms", None,
         float(np.percentile(step, 99.0)), "of a period of 33 ms"),
        ("rate_hz", "rate that the mean allows", "Hz", 95.0, 1e3 / mean,
         "paper: 1 / 11.3 ms is 88 Hz, not 95"),
    ):
        yield Number(key=key, group="computation", text=text, unit=unit, paper=paper, ours=ours,
                     remark=remark)  # fmt: skip


def _network(e: Evidence) -> Iterable[Number]:
    theirs, ours = e.trainings.get("network-secant"), e.trainings.get("network")
    last = theirs.curve[-1] if theirs else (None, None, None)

    def score(training: object, split: str, part: str) -> float | None:
        return training.mean(split, part) if training else None  # type: ignore[attr-defined]

    for key, text, paper, value, remark in (
        ("r2_train", "R2, training, random split", 0.88, score(theirs, "random", "train"), ""),
        ("r2_test", "R2, test, random split", 0.78, score(theirs, "random", "test"),
         "leaks: neighbouring samples are almost equal"),
        ("r2_runs_train", "R2, training, runs held out", None, score(theirs, "runs", "train"), ""),
        ("r2_runs_test", "R2, test, runs held out", None, score(theirs, "runs", "test"),
         "whole runs are new to the network"),
        ("loss_train", "loss, training", 0.196, last[1],
         "ours: runs held out; paper's is not 1 - R2, 0.12, as it should be"),
        ("loss_test", "loss, validation", 0.226, last[2], "ours: runs held out"),
        ("samples", "samples", 10752.0, float(theirs.samples) if theirs else None,
         "paper: CarSim; ours: the MuJoCo car"),
        ("r2_ours_test", "R2 of our network, runs held out", None, score(ours, "runs", "test"),
         "another network: force and slope from slip, load, friction"),
    ):
        yield Number(key=key, group="network", text=text, paper=paper, ours=value, remark=remark)
    for kind, name in (("network-secant", "paper's network"), ("network", "our network")):
        for axle, value in zip(("front", "rear"), e.stiffness.r2(kind), strict=True):
            yield Number(key=f"r2_driven_{kind}_{axle}", group="network", ours=value,
                         text=f"R2 along {e.stiffness.title}, {name}, {axle}",
                         remark="a driven lap that is in no data (Fig. 5)")  # fmt: skip


def _search(e: Evidence) -> Iterable[Number]:
    seeds = len(e.sphere.selections[0].seeds)
    for runs in e.sphere.selections:
        yield Number(
            key=f"sphere_{runs.selection}", group="search", digits=5,
            text=f"sphere function, {runs.selection}", paper=sphere.PAPER[runs.selection],
            ours=sphere.OPTIMUM + float(np.median(runs.final)),
            remark=f"optimum {sphere.OPTIMUM:g}; paper: one run, ours: median of {seeds}",
        )  # fmt: skip
    tuned = e.tunings.get(OURS)
    for key, text, unit, paper in (
        ("lateral_rmse_m", "tuned: lateral RMSE", "m", 0.0217),
        ("heading_rmse_rad", "tuned: heading RMSE", "rad", 0.0465),
        ("speed_rmse_mps", "tuned: speed RMSE", "m/s", 0.101),
    ):
        worst = None
        if tuned is not None and all(result["completed"] for result in tuned.after):
            worst = max(float(result[key]) for result in tuned.after)
        yield Number(key=f"tuned_{key}", group="search", text=text, unit=unit, paper=paper,
                     ours=worst, remark="paper: the test itself tunes; ours: worst tuning road")


def _conditions(e: Evidence) -> Iterable[Number]:
    c = e.logs[OURS].columns
    for key, text, unit, paper, column, remark in (
        ("wind", "side wind", "m/s", "25 to 50", "wind_mps",
         "the authors' code divides it by 3 and puts it 0.4 m behind the centre of mass"),
        ("speed", "reference speed", "m/s", "5 to 21", "vx_ref_mps",
         "the loop of Fig. 8 would ask for 60 m/s2; the authors' signals do not"),
    ):
        span = f"{c[column].min():.3g} to {c[column].max():.3g}"
        yield Number(key=key, group="conditions", text=text, unit=unit, paper=paper, ours=span,
                     remark=remark)  # fmt: skip
    yield Number(key="friction", group="conditions", text="friction 0.82",
                 paper="a drag of 12.7 kN", ours="the tires' peak",
                 remark="as printed it would brake with 8 m/s2")  # fmt: skip
    yield Number(key="weights", group="conditions", text="entries of Q for five states",
                 paper=6.0, ours=5.0, remark="unusable as printed")  # fmt: skip


def ratio(
    e: Evidence, key: str, *, other: str = OURS, case: str = "paper", lmpc: str = "tuned",
    ours: str = "tuned",
) -> float | None:  # fmt: skip
    """How many times larger an error of the baseline is than another controller's.

    Args:
        e: The evidence.
        key: Which error.
        other: The other controller.
        case: The road.
        lmpc: Weights of the baseline: `tuned` or `by hand`.
        ours: Weights of the other.
    """
    a, b = (_get(e, name, case, key, group) for name, group in ((LMPC, lmpc), (other, ours)))
    return None if a is None or b is None else a / b


def _get(e: Evidence, name: str, case: str, key: str, group: str = "tuned") -> float | None:
    """A metric of a controller; None where it was not driven, or lost the car."""
    row = e.get(group, name, case)
    return None if row is None else row.get(key)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value


# Promises -----------------------------------------------------------------------------------------


def bars(e: Evidence) -> list[Finding]:
    """The promises, each with its figure; a lost car is charged."""
    found = []
    for case, title, key, unit, scale, limit in (
        ("paper", "paper: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 0.5),
        ("paper", "paper: largest lateral error", "lateral_max_m", "mm", 1e3, 3.0),
        ("paper", "paper: speed RMSE", "speed_rmse_mps", "m/s", 1.0, 0.01),
        ("paper-loop", "paper-loop: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 1.0),
        ("double-lane-change", "lane change: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 1.0),
        ("circuit-0.5", "circuit 50 %: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 1.0),
        ("circuit-0.87", "circuit 87 %: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 3.0),
    ):
        row = e.get("tuned", OURS, case)
        value = None
        if row is not None:
            told = row.get(key)
            value = scale * (CHARGE if told is None else told)
        name = f"{case}_{key}" if scale == 1.0 else f"{case}_{key.removesuffix('_m')}_mm"
        found.append(_promise(name, title, value, limit, unit))
    for one in e.rests:
        where = "circle" if one.turning else "straight"
        left = 1e3 * one.left if one.completed else math.inf
        found.append(_promise(
            f"rest_{where}_{one.vx:g}_mrad", f"steering at rest, {where}, {one.vx:g} m/s", left,
            1e3 * steering_at_rest.LIMIT, "mrad",
        ))  # fmt: skip
    mixed = float(np.median(e.sphere.of("mixed").final))
    found.append(_promise("sphere_mixed", "sphere: median distance, mixed", mixed, sphere.BAR))
    driven = {row.case.scenario for row in e.rows}
    shared = sorted(driven & set(e.tuned_on))
    found.append(_promise(
        "tuned_on_reported", "roads here that also tuned weights", float(len(shared)), 0.0, "roads"
    ))  # fmt: skip
    return found


def _promise(
    key: str, figure: str, value: float | None, limit: float, unit: str = ""
) -> Finding:
    return Finding(key=key, figure=figure, value=value, unit=unit, limit=Limit.at_most(limit))


# Sentences ----------------------------------------------------------------------------------------


def sentences(e: Evidence) -> list[str]:
    """What the numbers say, one statement each."""
    told: list[Callable[[Evidence], str | None]] = [
        _on_the_papers_road, _ratios, _claim, _printed, _chain, _without, _weights, _step_times,
        lambda e: sphere.verdict(e.sphere),
    ]  # fmt: skip
    return [sentence for tell in told if (sentence := tell(e)) is not None]


def _on_the_papers_road(e: Evidence) -> str | None:
    row = e.get("tuned", OURS, "paper")
    if row is None:
        return None
    if not row.completed:
        return f"Our controller loses the paper's road at {row.result['s_end_m']:.0f} m."
    factor = 1e3 * PAPER_OURS["lateral_rmse_m"] / (1e3 * row.rmse)
    return (
        f"On the paper's road in full wind, nine times the force of the authors' code, our "
        f"controller keeps a lateral RMSE of {1e3 * row.rmse:.2f} mm where the paper prints "
        f"{1e3 * PAPER_OURS['lateral_rmse_m']:.1f} mm, {_times(factor)}. The plants differ, so "
        "that alone says little about the method; the ratios below say more."
    )


def _ratios(e: Evidence) -> str | None:
    parts = []
    for key, name in (("lateral_rmse_m", "lateral"), ("speed_rmse_mps", "speed")):
        found = [
            value
            for lmpc in ("tuned", "by hand") for ours in ("tuned", "by hand")
            if (value := ratio(e, key, lmpc=lmpc, ours=ours)) is not None
        ]  # fmt: skip
        now = ratio(e, key)
        if now is None:
            return None
        spread = f"{min(found):.1f} to {max(found):.1f} over the weights"
        parts.append(f"{now:.1f} ({spread}; paper {PAPER_RATIO[key]:.1f}) for the {name} error")
    return f"The baseline's RMSE is larger than ours by a factor of {' and '.join(parts)}."


def _claim(e: Evidence) -> str | None:
    """Does the paper's controller beat the baseline, as the paper says?"""
    parts = []
    for key, name in (("lateral_rmse_m", "lateral"), ("speed_rmse_mps", "speed")):
        values = [ratio(e, key, other=PAPERS, lmpc=group, ours=group)
                  for group in ("tuned", "by hand")]  # fmt: skip
        known = [value for value in values if value is not None]
        if not known:
            return None
        verdict = (
            "confirmed" if min(known) >= MATTERS
            else "not confirmed" if max(known) < MATTERS
            else "confirmed with some weights only"
        )  # fmt: skip
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
    for name in CONTROLLERS:
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


def _ablated(e: Evidence, group: str, key: str) -> list[Row]:
    return [row for row in e.rows if (row.entry.group, row.entry.key) == (group, key)]


def _factor(worse: Sequence[Row], better: Sequence[Row]) -> float:
    """Ratio of the geometric means of the lateral RMSE, lost cars charged."""
    return geometric_mean(r.rmse for r in worse) / geometric_mean(r.rmse for r in better)


def _times(factor: float) -> str:
    return f"{factor:.0f} times more" if factor >= 1.0 else f"{1.0 / factor:.1f} times less"


def _of(count: int, total: int) -> str:
    return "all" if count == total else "none of the" if not count else f"{count} of {total}"


def _listed(names: Sequence[str]) -> str:
    """Names as a list in a sentence."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else list(names))

