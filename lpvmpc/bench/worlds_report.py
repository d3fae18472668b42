"""The worlds as a report: Markdown, CSV and JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from lpvmpc.bench.cases import CHARGE
from lpvmpc.bench.margins import NOISE_SEEDS, OFF, Margin, finest
from lpvmpc.bench.report import cell, origins, short, weights
from lpvmpc.bench.verdict import MATTERS
from lpvmpc.bench.worlds import (
    COMBINED,
    DEVIATION_ROADS,
    DEVIATIONS,
    FIRST_SEED,
    MODELS,
    OURS,
    PARTS,
    RAW,
    ROADS,
    SAMPLED,
    SHIPPED,
    TUNING_SEEDS,
    DrivenCell,
    GridPlan,
)
from lpvmpc.bench.worlds_bars import bars
from lpvmpc.bench.worlds_stats import Summary, grouped
from lpvmpc.bench.worlds_verdict import RESOLVED, Found, comparisons, margin_text, sentences
from lpvmpc.kit.findings import promises_sentence, promises_table
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import at_a_time, csv_text, finite, record, versions_line

TITLE = "What holds outside the perfect world"
DEFINITIONS = """\
Definitions:

- Every run is one closed loop on the MuJoCo car, which begins trimmed on the road at its first \
speed, control every 33 ms. What is scored is the true centre of mass, at every control instant \
from the first: lateral RMSE and largest error. Speeds are planned for the nominal car on a dry \
road: "circuit 65 %" asks for 65 % of its lateral grip, without wind; `paper` has its side wind.
- The controller and the estimator know the nominal car and nothing of what is wrong. One set of \
weights drives everything, for `lpv-mpc`: {weights}. {origins}
- A run is lost when the car is more than 5 m off the path (on a road that states its widths also \
2 m beyond its edge), turned by more than 90 degrees, rolled over, stuck, or needs twice the \
reference's time. A lost run counts as the worst there is and is never dropped: a percentile that \
falls on one is written "lost".
- The median and the 95th percentile are values of single runs, the smallest that half and 95 % \
of all do not exceed; the interval of the completed share is Wilson's, 95 %.
- Steering is the rms of the commanded angle's rate, jerk the rms of the lateral acceleration's \
change from period to period, over the period; both, and the columns of the estimator, are \
medians over the completed runs. Its share is the RMSE of the estimated lateral position over \
that of the car, run by run.
- A margin is the furthest value up to which everything that was tried held: the car reached the \
end and was never more than {off:g} m off. {steps} steps outwards over a range, then {halvings} \
bisections between the last that held and the first that did not; noise must hold with each of \
{noise} seeds.
- Errors of two stiffness models count as different where one is at least {matters:g} times the \
other and {resolved:g} mm more, a hundredth of the noise of a good position sensor.
"""
SET_BEFORE = (
    "No limit was set after a result of this controller had been seen: they were set before it was "
    "built, when a random search over weights alone reached most of them. They are floors: what is "
    "reached, and less than half of some, is kept by tests/test_acceptance.py and "
    "tests/test_holds.py."
)
SEEN = (
    f"The reported seeds were not all unseen: D14 of docs/derivations.md was built while looking "
    f"at `fleet` on circuit 80 % with seeds {FIRST_SEED} to {FIRST_SEED + 199}."
)


def report(found: Found, *, jobs: int, pictures: Sequence[str]) -> str:
    """The report in Markdown.

    Args:
        found: What was driven.
        jobs: Number of runs at a time.
        pictures: Names of the pictures that were drawn.
    """
    plan, rows = found.plan, found.every_row()
    last = FIRST_SEED + plan.seeds - 1
    missing = [part for part in PARTS if part not in found.parts]
    findings = bars(found)
    options = f"--seeds {plan.seeds}" + (" --quick" if plan.quick else "")
    lines = [
        f"# {TITLE}" + (" (quick look: a few runs, not the report)" if plan.quick else ""),
        "",
        f"Machine: {machine()}; {at_a_time(jobs)}.",
        versions_line(),
        f"Seeds: {FIRST_SEED} to {last} in the sampled worlds, the same for every controller; "
        f"tuning uses seeds below {TUNING_SEEDS}, so none of these. {SEEN} {len(rows)} runs.",
        *([f"Not driven yet: {', '.join(missing)}."] if missing else []),
        "",
        DEFINITIONS.format(weights=weights(), origins=origins(SHIPPED), off=OFF,
                           steps=plan.margin_steps, halvings=plan.margin_halvings,
                           noise=NOISE_SEEDS, matters=MATTERS, resolved=1e3 * RESOLVED),
        "## Verdict",
        "",
        *(f"- {sentence}" for sentence in sentences(found)),
        "",
        promises_table(f"Promises about `{OURS}`", findings, _shown),
        promises_sentence(findings),
        "",
        SET_BEFORE,
        "",
        *_worlds(found, pictures),
        *_deviations(found.rows.get("deviations", ())),
        *_margins(found, pictures),
        *_adaptation(found, pictures),
        "## Limits",
        "",
        f"- One type of car and one kind of tire; {len({row.cell.road for row in rows})} roads. "
        "The ranges of the worlds are assumed in part: docs/worlds.md grades each.",
        "- What is drawn is drawn independently and uniformly; real faults come together.",
        "- A margin is that of one thing alone, on one road at one speed, with a true state (but "
        "for noise); several small deviations at once may lose a car that bears each of them.",
        "- Geometric controllers have no prediction: a delay that is told is not compensated by "
        "`stanley` and `pure-pursuit`.",
        "",
        f"Made by `python eval/worlds.py {options}`, or part by part with `--parts NAME --resume`; "
        "every run is in worlds.csv beside this file.",
    ]
    return "\n".join(lines) + "\n"


def _shown(value: float) -> str:
    return "lost" if math.isinf(value) else f"{value:.3g}"


# Sampled worlds -----------------------------------------------------------------------------------


def _worlds(found: Found, pictures: Sequence[str]) -> Iterable[str]:
    if "worlds" not in found.rows:
        return
    combined = ", ".join(f"{name} {value:.3g}" for name, value in COMBINED["car"].items())
    yield "## Sampled worlds\n"
    yield (
        "The worlds are those of docs/worlds.md. `combined` is `rtk` with the same car for every "
        f"seed ({combined}, in SI units) and {1e3 * COMBINED['latency']:.0f} ms of untold "
        "latency.\n"
    )
    for key in SAMPLED:
        here = [s for s in found.worlds if s.cell.case == key]
        if here:
            yield summary_table(f"`{key}`", here, lambda s: [s.cell.controller])
    if "worlds.png" in pictures:
        yield "![Share of runs that stay below an error](worlds.png)\n"
        yield (
            "Share of all runs whose lateral RMSE stays below a value. A lost run never does, so a "
            "curve ends at the share that was completed.\n"
        )
    yield lost_table([row for row in found.rows["worlds"] if not row.completed])


def summary_table(title: str, found: Sequence[Summary], name: Any) -> str:
    """Summaries as a table: who completed how many, how exactly, and at what effort."""
    header = (
        "road", "who", "completed", "95 % interval", "RMSE: median", "95th", "largest: median",
        "95th", "worst", "steering [rad/s]", "jerk [m/s3]", "estimate [mm]", "its share",
    )
    body = []
    for s in found:
        low, high = s.interval
        body.append([
            ROADS[s.cell.road].title, *name(s), f"{s.completed} of {s.n}",
            f"{100 * low:.0f} to {100 * high:.0f} %",
            *(in_mm(value) for value in s.rmse[:2]), *(in_mm(value) for value in s.largest),
            _number(s.steering, ".2f"), _number(s.jerk, ".1f"),
            "-" if s.estimate is None else short(1e3 * s.estimate),
            "-" if s.share is None else f"{100 * s.share:.0f} %",
        ])
    return markdown_table(f"{title}: lateral errors [mm]", header, body, words=("who",))


def in_mm(value: float) -> str:
    """A length in mm without its unit; "lost" where it is infinite."""
    return "lost" if math.isinf(value) else short(1e3 * value)


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def lost_table(rows: Sequence[DrivenCell]) -> str:
    """Lost runs by world, road, controller and reason, with the first seeds of each."""
    if not rows:
        return "No run in these worlds was lost.\n"
    body = []
    groups = grouped(rows, lambda c: (c.case, c.road, c.controller))
    for (case, road, controller), lost in groups.items():
        reasons = Counter(str(row.result["reason"]) for row in lost)
        for reason, count in sorted(reasons.items(), key=lambda item: (-item[1], item[0])):
            seeds = [row.cell.seed for row in lost if str(row.result["reason"]) == reason]
            few = ", ".join(map(str, seeds[:4])) + (", ..." if count > 4 else "")
            plain = reason.replace("|", "\\|")  # which would end the cell
            body.append([case, ROADS[road].title, controller, count, plain, few])
    header = ("world", "road", "controller", "runs", "reason", "seeds")
    words = ("road", "controller", "reason", "seeds")
    return markdown_table("Lost runs in the sampled worlds", header, body, words=words)


# Deviations ---------------------------------------------------------------------------------------


def _deviations(rows: Sequence[DrivenCell]) -> Iterable[str]:
    if not rows:
        return
    noise = RAW["sensing"]
    yield "## One deviation at a time\n"
    yield (
        "True state, no filter, all else nominal. Noise: white, "
        f"{100 * noise['position']['std']:g} cm, 0.1 deg, "
        f"{noise['vx']['std']:g} m/s on vx and on vy, 0.1 deg/s.\n"
    )
    controllers = list(dict.fromkeys(row.cell.controller for row in rows))
    table = {(r.cell.case, r.cell.road, r.cell.controller): r for r in rows}
    for road in DEVIATION_ROADS:
        body = [
            [one.title, *(cell(table.get((one.key, road, who))) for who in controllers)]
            for one in DEVIATIONS
            if any((one.key, road, who) in table for who in controllers)
        ]
        if body:
            title = f"{ROADS[road].title}: lateral RMSE / largest error [mm]"
            yield markdown_table(title, ("deviation", *controllers), body)


# Margins ------------------------------------------------------------------------------------------


def _margins(found: Found, pictures: Sequence[str]) -> Iterable[str]:
    if not found.margins:
        return
    yield "## Margins\n"
    yield margins_table(found.margins, found.plan)
    yield (
        f"\"at least\": the end of what was tried held. After the value: what ended it, \"{OFF:g} "
        "m\" where the car reached the end but was once further off; \"refused\" where there is no "
        "such car, because it is unstable from below 15 m/s.\n"
    )
    if "worlds-margins.png" in pictures:
        yield "![Margins of each controller](worlds-margins.png)\n"
        yield "An arrow: at least so much.\n"


def margins_table(found: Sequence[Margin], plan: GridPlan) -> str:
    """One line for each kind, one column for each controller."""
    controllers = list(dict.fromkeys(m.controller for m in found))
    table = {(m.kind.key, m.controller): m for m in found}
    kinds = list(dict.fromkeys(m.kind for m in found))
    body = [
        [f"{kind.title} [{kind.unit}]", finest(kind, plan),
         *(_margin(table[kind.key, who]) for who in controllers)]
        for kind in kinds
    ]
    title = f"How far each thing may be wrong: circuit 65 %, never more than {OFF:g} m off"
    return markdown_table(title, ("deviation", "resolution", *controllers), body)


def _margin(m: Margin) -> str:
    why = {"more": f"{OFF:g} m", "off": "off the path"}.get(m.why.split(" ")[0], m.why)
    why = why.partition(":")[0]
    if m.held is None:
        return f"none ({why})"
    if m.failed is None:
        return f"at least {m.held:.3g}"
    return f"{m.held:.3g} ({why})"


# Adaptation ---------------------------------------------------------------------------------------


def _adaptation(found: Found, pictures: Sequence[str]) -> Iterable[str]:
    if "adaptation" not in found.rows:
        return
    yield "## What adapting the stiffness is worth there\n"
    seeds = min(found.plan.seeds, found.plan.model_seeds)
    yield (f"`{OURS}` with each stiffness model, one set of weights, the first {seeds} of the "
           "seeds above:\n")
    yield "\n".join(f"- `{name}`: {model.about}." for name, model in MODELS.items()) + "\n"
    for key in dict.fromkeys(s.cell.case for s in found.adaptation):
        here = [s for s in found.adaptation if s.cell.case == key]
        yield summary_table(f"Stiffness models in `{key}`", here, lambda s: [s.cell.model])
    body = [
        [f"`{one.model}` for `{one.than}`", one.case, ROADS[one.road].title,
         in_mm(one.errors[0]), in_mm(one.errors[1]), one.word,
         f"{one.seeds[0]} / {one.seeds[1]} of {one.n}", f"{one.lost[0]} / {one.lost[1]}"]
        for one in comparisons(found)
    ]
    header = ("model", "world", "road", "95th", "of the other", "it", "better / worse", "lost")
    title = "One stiffness model in place of another: 95th percentile of the RMSE [mm]"
    yield markdown_table(title, header, body, words=("world", "road", "it"))
    if "worlds-adaptation.png" in pictures:
        yield "![Share of runs below an error, by stiffness model](worlds-adaptation.png)\n"


# Files --------------------------------------------------------------------------------------------

COLUMNS = (
    "completed", "reason", "s_end_m", "duration_s", "lateral_rmse_m", "lateral_max_m",
    "course_rmse_rad", "speed_rmse_mps", "left_road_s", "steer_rate_rms_radps", "jerk_rms_mps3",
    "estimate_ey_rmse_m",
)
"""Of each run in worlds.csv."""


def as_csv(found: Found) -> str:
    """Every run, one line each; nothing in it depends on the machine's speed."""
    names = ("part", "case", "road", "controller", "model", "seed", "value")
    body = (
        [*(getattr(row.cell, name) for name in names), *(row.result[name] for name in COLUMNS)]
        for row in found.every_row()
    )
    return csv_text((*names, *COLUMNS), body)


def as_json(found: Found, *, jobs: int) -> dict[str, Any]:
    """Promises, sentences, summaries and margins, and under which conditions."""
    return {
        "bars": {
            f.key: {"text": f.figure, "value": None if f.value is None else finite(f.value),
                    "unit": f.unit, "limit": f.limit and f.limit.bound,
                    "at_least": f.limit is not None and f.limit.is_lower, "ok": f.ok}
            for f in bars(found)
        },
        "sentences": sentences(found),
        "worlds": [_record(s) for s in found.worlds],
        "adaptation": [_record(s) for s in found.adaptation],
        "margins": [
            {"kind": m.kind.key, "unit": m.kind.unit, "controller": m.controller, "held": m.held,
             "failed": m.failed, "why": m.why, "text": margin_text(m)}
            for m in found.margins or ()
        ],
        "record": record(
            jobs=jobs, parts=found.parts, plan=asdict(found.plan), first_seed=FIRST_SEED,
            tuning_seeds_below=TUNING_SEEDS, lost_is_charged_m=CHARGE,
        ),
    }


def _record(s: Summary) -> dict[str, Any]:
    """A summary for JSON; None where a percentile is a lost run."""
    of = ("median", "p95", "worst")
    return {
        "world": s.cell.case, "road": s.cell.road, "controller": s.cell.controller,
        "model": s.cell.model, "runs": s.n, "completed": s.completed, "interval": s.interval,
        "rmse_m": {k: finite(v) for k, v in zip(of, s.rmse, strict=True)},
        "largest_m": {k: finite(v) for k, v in zip(of, s.largest, strict=True)},
        "steer_rate_rms_radps": s.steering, "jerk_rms_mps3": s.jerk,
        "estimate_ey_rmse_m": s.estimate, "estimate_share": s.share,
    }
