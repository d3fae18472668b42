"""The ablation as a report: Markdown, CSV, JSON, and a picture of error over grip."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from lpvmpc.bench.cases import (
    ABOUT,
    CHARGE,
    DRY,
    GRIPS,
    GROUPS,
    MODELS,
    PLAIN,
    DrivenCase,
    FactorSearch,
    Measured,
    Model,
    geometric_mean,
)
from lpvmpc.bench.verdict import Results, bars, sentences
from lpvmpc.kit.findings import Finding, promises_sentence, promises_table
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import csv_text, record, versions_line
from lpvmpc.picture import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFINITIONS = """\
Definitions:

- Every cell is one closed loop on the MuJoCo car, which begins trimmed on the road at its first \
speed: true state without noise or delay, control every 33 ms. Errors are those of the true centre \
of mass to the path, at every control instant from the first; RMSE is over all of them.
- A run is lost when the car is more than 5 m off the path (on a road that states its widths also \
2 m beyond its edge), turned by more than 90 degrees, rolled over, stuck, or needs twice the \
reference's time; tables say where. In means and ratios a lost run \
is charged 5 m as its RMSE and as its largest error.
- The share of the grip, in percent, is the lateral acceleration that the speed is planned for, \
over the car's steady limit times the announced friction.
- "Drop to 0.75" is a road of 0.75 of the friction that the speed was planned for, for the whole \
lap; "step at s" is a road planned for friction 0.5 throughout, which is dry (1.0) up to s and has \
0.5 from there on. Neither is announced to any controller; the oracles are told the true friction \
of where they are.
- x0.7, x1.3 and noise multiply the axle forces that the model tells the controller, offset and \
slope alike; the noise is drawn anew each period for each axle.
- "Made wrong" is each of these, at 87 % of the grip. "Beside the oracle": up to 87 % of the grip \
an error may be 1.3 times that of `oracle` plus 1 mm, at 92 % twice that of `oracle`.
- "Duration off" is by how much the lap's time differs from the reference's.
- "The better constant" of a case is the better of `constant` and `constant-best`. Two errors \
count as alike where their ratio is below 1.1.
- All models drive with one set of weights, with the observer and without it. They were searched \
with `network` and the observer (`eval/tune.py`), five of them set by hand afterwards, three while \
looking at circuit 96 and 100 % (docs/derivations.md, D13): {weights}.
- Everything is deterministic: one run per cell has no spread. The noise is driven with three \
seeds.
"""


def report(
    rows: Sequence[DrivenCase],
    searches: Mapping[bool, FactorSearch],
    *,
    quick: bool,
    jobs: int,
    picture: str,
) -> str:
    """The report in Markdown."""
    table, found = Results(rows), bars(Results(rows))
    title = "What adapting the cornering stiffness is worth"
    lines = [
        f"# {title}" + (" (quick look: a few cases, not the report)" if quick else ""),
        "",
        f"Machine: {machine()}; {jobs} run{'s' if jobs > 1 else ''} at a time.",
        versions_line(),
        "Seeds: 0 for the controllers (none of them draws), 0, 1 and 2 for the noise.",
        "",
        DEFINITIONS.format(weights=weights()),
        "Models:",
        "",
        *(f"- `{model.key}`: {ABOUT[model.key]}." for model in (*MODELS, DRY, PLAIN)),
        "",
        "## Verdict",
        "",
        *(f"- {sentence}" for sentence in sentences(table, dict(searches))),
        "",
        promises(found),
        promises_sentence(found),
        "",
        "No limit was set after a result had been seen.",
        "",
        "## Tables",
        "",
        summary_table(table),
        *(group_table(rows, group) for group in GROUPS),
        gain_table(table),
        f"![Error over grip]({picture})",
        "",
        "Lateral error on circuit over the share of the grip, without wind. A cross above the "
        "dotted line is a lost car.",
        "",
        "## The best constant stiffness",
        "",
        search_table(searches),
        "Searched on the tuning roads alone, which none of the tables above contains; the best is "
        "what `constant-best` drives with.",
        "",
        "## Limits",
        "",
        "- One car, one set of tires, one set of weights; no sensor noise and no delay here.",
        "- The weights were tuned with `network`; each other model might do better with its own.",
        "- The networks were trained on data of this plant, so they know its tires as well as data "
        "can tell them. What a wrong model costs is in the table of models made wrong.",
        "- Step times are CPU time of the thread on circuit at 87 %, and depend on what else the "
        "machine does.",
        "",
        f"Made by `python eval/ablation.py{' --quick' if quick else ''}`; every run is in "
        "ablation.csv beside this file.",
    ]
    return "\n".join(lines) + "\n"


def weights() -> str:
    """The weights that the controller ships with."""
    from lpvmpc.control.cost import Weights
    from lpvmpc.control.weights_file import shipped

    used = asdict(shipped("lpv-mpc", Weights()))
    return ", ".join(f"{name} {value:g}" for name, value in used.items())


def origins(controllers: Iterable[str]) -> str:
    """Where the weights of each controller come from, by the records of their files."""
    from lpvmpc.control.weights_file import shipped_file

    groups: dict[str, list[str]] = {}
    for name in controllers:
        file = shipped_file(name)
        record = tomllib.loads(file.read_text()).get("record", {}) if file.exists() else {}
        if not record.get("tuned_on"):
            how = f"set by {record.get('set_by', 'hand')}"
        elif record.get("worlds"):
            how = f"tuned in {', '.join(dict.fromkeys(record['worlds']))}"
        else:
            how = "tuned in the ideal world alone"
        groups.setdefault(how, []).append(f"`{name}`")
    parts = [f"{how} for {', '.join(names)}" for how, names in groups.items()]
    return f"Weights were {'; '.join(parts)}."


def cell(row: Measured | None) -> str:
    """RMSE and largest error of a run in mm, or where it was lost."""
    if row is None:
        return "-"
    if row.completed:
        return f"{short(1e3 * row.rmse)} / {short(1e3 * row.largest)}"
    return _lost(row)


def _lost(row: Measured) -> str:
    reason, s = str(row.result["reason"]), row.result["s_end_m"]
    if s is None:
        return "failed"
    kinds = {"off": "off", "spun": "spun", "rolled": "rolled", "stuck": "stuck", "too": "slow"}
    return f"{kinds.get(reason.partition(' ')[0].rstrip(':'), 'failed')} at {s:.0f} m"


def short(value: float) -> str:
    """A length with two digits or all before the point."""
    return f"{value:.2f}" if value < 1.0 else f"{value:.1f}" if value < 10.0 else f"{value:.0f}"


def _lines(rows: Sequence[DrivenCase]) -> list[tuple[Model, bool]]:
    """The lines of a table: models with the observer, then without, then the plain one."""
    there = {(r.model.key, r.observer) for r in rows}
    wanted = [(m, observer) for observer in (True, False) for m in (*MODELS, DRY, PLAIN)]
    return [(m, observer) for m, observer in wanted if (m.key, observer) in there]


def group_table(rows: Sequence[DrivenCase], group: str) -> str:
    """Errors of all models in the cases of a group; empty where none was driven."""
    rows = [r for r in rows if r.case.group == group]
    if not rows:
        return ""
    table = Results(rows)
    cases = list({r.case.key: r.case for r in rows}.values())
    body = [
        [m.key, _yes(observer), *(cell(table.get(case.key, m.key, observer)) for case in cases)]
        for m, observer in _lines(rows)
    ]
    header = ["model", "observer", *(case.title for case in cases)]
    return markdown_table(f"{GROUPS[group]}: lateral RMSE / largest error [mm]", header, body)


def gain_table(table: Results) -> str:
    """How many times more exact than the better constant each model is on the circuit."""
    body = []
    for m, observer in _lines([r for r in table.rows if r.case.group == "grip"]):
        if m.stiffness != "constant":
            gains = [table.gain(f"circuit-{grip:g}", m.key, observer) for grip in GRIPS]
            body.append([m.key, _yes(observer), *("-" if g is None else f"{g:.2g}" for g in gains)])
    header = ["model", "observer", *(f"{100 * grip:.0f} %" for grip in GRIPS)]
    title = "Circuit without wind: RMSE of the better constant over the model's"
    return markdown_table(title, header, body)


def summary_table(table: Results) -> str:
    """Per model: lost runs, typical error, and step times on one road."""
    body = []
    for m, observer in _lines([r for r in table.rows if not r.case.wrong and r.model != DRY]):
        rows = table.of(m.key, observer)
        timed = table.get("circuit-0.87", m.key, observer) or rows[0]
        times = timed.result["step_time_us"] or {}
        p50, p99 = times.get("p50"), times.get("p99")
        lost = sum(not r.completed for r in rows)
        body.append([
            m.key, _yes(observer), f"{lost} of {len(rows)}",
            short(1e3 * geometric_mean(r.rmse for r in rows)),
            "-" if p50 is None else f"{p50:.0f}", "-" if p99 is None else f"{p99:.0f}",
        ])
    header = ("model", "observer", "lost", "RMSE [mm]", "p50 [us]", "p99 [us]")
    title = "All roads, no model made wrong: geometric mean of the RMSE; step time"
    return markdown_table(title, header, body)


def search_table(searches: Mapping[bool, FactorSearch]) -> str:
    """Cost of each constant stiffness that was tried."""
    scales = sorted({scale for found in searches.values() for scale in found.cost})
    body = []
    for scale in scales:
        line = [f"x{scale:g}"]
        for observer in (True, False):
            found = searches[observer]
            if scale not in found.cost:
                line.append("")
                continue
            lost = f" ({found.lost[scale]} lost)" if found.lost[scale] else ""
            best = " best" if scale == found.best else ""
            line.append(f"{1e3 * found.cost[scale]:.2f}{lost}{best}")
        body.append(line)
    header = ("stiffness", "with observer", "without observer")
    title = "Constant stiffness on the tuning roads: geometric mean of the lateral RMSE [mm]"
    return markdown_table(title, header, body)


def promises(found: Sequence[Finding]) -> str:
    """The promises that were measured, with figure, limit and verdict."""
    title = "Promises about the network with the observer; circuit without wind"
    return promises_table(
        title, found, lambda value: f"{value:.3f}" if 0.0 < value < 1.0 else f"{value:.3g}"
    )


def _yes(observer: bool) -> str:
    return "yes" if observer else "no"


# Files --------------------------------------------------------------------------------------------

COLUMNS = (
    "completed", "reason", "s_end_m", "duration_s", "reference_duration_s", "lateral_rmse_m",
    "lateral_max_m", "heading_rmse_rad", "course_rmse_rad", "speed_rmse_mps",
)
"""Metrics in ablation.csv."""


def as_csv(rows: Iterable[DrivenCase]) -> str:
    """Every run, one line each."""
    header = ("group", "case", "model", "observer", *COLUMNS, "step_p50_us", "step_p99_us")
    body = []
    for row in rows:
        times = row.result["step_time_us"] or {}
        who = (row.case.group, row.case.key, row.model.key, _yes(row.observer))
        values = (row.result[name] for name in COLUMNS)
        body.append((*who, *values, times.get("p50"), times.get("p99")))
    return csv_text(header, body)


def as_json(
    rows: Sequence[DrivenCase], searches: Mapping[bool, FactorSearch], *, quick: bool, jobs: int
) -> dict[str, Any]:
    """One object: the promises by key, the sentences, the searches, every run, the conditions."""
    table = Results(rows)
    return {
        "bars": {
            bar.key: {
                "text": bar.figure, "value": bar.value, "unit": bar.unit,
                "limit": bar.limit and bar.limit.bound,
                "at_least": bar.limit is not None and bar.limit.is_lower, "ok": bar.ok,
            }
            for bar in bars(table)
        },
        "sentences": sentences(table, dict(searches)),
        "constant": {
            _yes(observer): {
                "best": found.best,
                "cost_m": {f"{scale:g}": cost for scale, cost in found.cost.items()},
            }
            for observer, found in searches.items()
        },
        "runs": [
            {
                "group": row.case.group, "case": row.case.key, "model": row.model.key,
                "observer": row.observer, **{name: row.result[name] for name in COLUMNS},
                "step_time_us": row.result["step_time_us"],
            }
            for row in rows
        ],
        "record": record(quick=quick, jobs=jobs),
    }


@style.styled
def draw(rows: Sequence[DrivenCase]) -> Figure:
    """The picture: errors on the circuit over the share of the grip, log scale."""
    styles = {
        "constant": (style.GREY, "o", "-"), "constant-best": ("black", "o", "-"),
        "network-secant": (style.ORANGE, "s", "-"), "network": (style.BLUE, "D", "-"),
        "oracle-secant": (style.ORANGE, "s", "--"), "oracle": (style.BLUE, "D", "--"),
        "lpv-mpc-paper": (style.RED, "^", "-"),
    }
    rows = [row for row in rows if row.case.group == "grip"]
    figure, grid = style.axes(2, 2, height=5.2, sharex=True, sharey="row")
    for line, measure in zip(grid, ("rmse", "largest"), strict=True):
        for axes, observer in zip(line, (True, False), strict=True):
            for i, (m, _) in enumerate(e for e in _lines(rows) if e[1] == observer):
                own = [r for r in rows if r.model is m and r.observer == observer]
                colour, marker, dash = styles[m.key]
                grip = [100.0 * r.case.options["grip"] for r in own]
                error = [1e3 * getattr(r, measure) if r.completed else None for r in own]
                face = "white" if dash == "--" else colour
                axes.plot(grip, error, dash, color=colour, marker=marker, ms=3, mfc=face,
                          label=m.key)
                lost = [g for g, e in zip(grip, error, strict=True) if e is None]
                # one above the other, where several models lose the car at the same speed
                height = 1e3 * CHARGE * 1.3 ** (i + 1)
                axes.plot(lost, [height] * len(lost), "x", color=colour, ms=4, mew=1.2)
            axes.axhline(1e3 * CHARGE, color="black", lw=0.6, ls=":")
            axes.set_yscale("log")
            axes.set_ylim(top=1e3 * CHARGE * 1.3 ** (len(styles) + 1))
    for axes, title in zip(grid[0], ("with the observer", "without it"), strict=True):
        axes.set_title(title)
    grid[0, 0].set_ylabel("lateral RMSE [mm]")
    grid[1, 0].set_ylabel("largest lateral error [mm]")
    for axes in grid[1]:
        axes.set_xlabel("share of the grip [%]")
    handles, labels = grid[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, handlelength=2.4)
    return figure
