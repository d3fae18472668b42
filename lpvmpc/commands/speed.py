"""Measure how fast the package is on this machine: plant, controller, lap, frame, start-up.

    lpvmpc speed --json speed.json

Prints a table and writes it as speed.md, speed.csv and speed.json. Exit codes: 0 measured, bars
met or not; 2 bad input; 130 interrupted.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.errors import RenderError
from lpvmpc.kit import cli
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import csv_text, record, versions_line, write_report

if TYPE_CHECKING:
    from lpvmpc.bench.speed import Figure

DEFINITIONS = """\
Definitions: every measurement is repeated in {rounds} rounds. A time or a speed is the best \
round's, since on a shared machine other work only ever slows it down; the ratio of two times is \
the middle round's. "Rounds" are the least and the most of them. Steps and periods are CPU time \
of their thread; laps, frames, starts and rollouts are wall time where nothing else is said. \
"Verdict" compares the value with the bar.

- bare step: the same model with the callbacks taken out, without gravity and with unloaded \
springs, so that it floats at its usual height and rests on no stop.
- control step: one call of the LPV-MPC's `command`, in the closed loop; p50 and p99 are over all \
steps of a road. Build is estimate, adaptation, model and QP; solve is ProxQP; check is our \
own test of data and solution.
- "fastest at each instant": all rounds drive the same road to the same commands, so step k does \
the same work in each; this takes the fastest of each single step before the percentile.
- start to first physics step: of `python -m lpvmpc track` driving `paper`, compiled code cached.
- gain of a second process: two processes busy with one-threaded rollouts, against one alone; two \
undisturbed cores give 2.
- many closed loops: laps of an oval of {length:.0f} m by the LPV-MPC, each with its measures. \
Processes drive one lap after the other. Side by side, all cars are in one process: one thread \
asks their controllers in turn, then all are moved in one threaded call. Either way each lap has \
the same bytes. "At best" is what the share of the physics allows where all else stays in one \
thread and nothing is lost. Tune, worlds and benchmark use the faster way, processes.
- search: `lpvmpc tune --worlds ideal`, from the start of its processes to the last generation.
"""
SEARCH = "Search of weights"
"""Title of the section that is made where it is asked for."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Measure how fast the package is on this machine."""

    rounds: int = 5
    """Rounds of every measurement; the best counts."""
    quick: bool = False
    """A look instead of a measurement: one round on a short road."""
    search: bool = False
    """Measure a whole search of weights as well, which takes minutes."""
    out: Path = Path("docs/results")
    """Folder for speed.md, speed.csv and speed.json."""
    car: CarPlace = None
    json: Path | None = None
    """Write the values to this file as well."""


@with_car(out="runs/{car}/speed")
def main(options: Options) -> int:
    """Measure, print, save; returns the exit code."""
    cli.check_number("--rounds", options.rounds, 1, 100)
    cli.check_opengl()
    out = cli.results_folder(options.out, "speed")
    cli.result_file(options.json)
    rounds = 1 if options.quick else options.rounds
    from lpvmpc.bench.speed_processes import Load

    meanwhile = Load()
    sections = measure(rounds, options.quick)
    if options.search:
        from lpvmpc.commands.parts.search_time import measure_search

        say("a search")
        searched = measure_search(cli.cores(), *((1, 4) if options.quick else ()))
        sections.append((SEARCH, searched))
    figures = [figure for _, section in sections for figure in section]
    load = meanwhile.describe()
    text = report(sections, rounds, load)
    files = write_report(
        out,
        "speed",
        text=text,
        table=as_csv(figures),
        values=as_json(figures, rounds, load),
        copy=options.json,
    )
    print(text, end="")
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE


def say(what: str) -> None:
    """Tell a terminal what is being measured."""
    if sys.stderr.isatty():
        print(f"measuring {what} ...", file=sys.stderr)


def measure(rounds: int, quick: bool) -> list[tuple[str, list[Figure]]]:
    """All figures, under the titles of their tables."""
    from lpvmpc import load_scenario
    from lpvmpc.bench import speed, speed_processes, speed_together

    say("the plant")
    plant = speed.measure_plant(rounds, blocks=5 if quick else 40)
    say("the controller")
    roads = [("", load_scenario("double-lane-change" if quick else "paper"), "")]
    if not quick:
        roads.append(("circuit_", load_scenario("circuit", grip=0.87), ", 87 % of the grip"))
    figures, log = speed.measure_loops([(label, scenario) for label, scenario, _ in roads], rounds)
    titles = [f"Closed loop on {scenario.name}{how}" for _, scenario, how in roads]
    loops = list(zip(titles, figures, strict=True))
    say("what adapting costs")
    adapting = speed.measure_adaptation(roads[-1][1], rounds)
    say("the video")
    try:
        frames = speed.measure_frame(log, 1 if quick else min(rounds, 3), 12 if quick else 25)
    except RenderError as error:
        print("Warning: no frame measured:", " ".join(str(error).split()), file=sys.stderr)
        frames = []
    say("the start")
    start = speed_processes.measure_start(rounds)
    say("many simulations at once")
    many = speed_processes.measure_rollouts(rounds, simulations=4 if quick else 16)
    say("many closed loops")
    period_us = next(figure.value for figure in plant if figure.key == "plant_period_us")
    cars, laps = ((1, 4), 4) if quick else (speed_together.CARS, speed_together.LAPS)
    loops_at_once = speed_together.measure_together(period_us, min(rounds, 3), cars, laps)
    return [
        ("Plant, one core", plant),
        *loops,
        (f"Adapting the stiffness, on {roads[-1][1].name}", adapting),
        ("Video", frames),
        ("Start-up", start),
        ("Many simulations at once", many),
        ("Many closed loops at once", loops_at_once),
    ]


def report(sections: list[tuple[str, list[Figure]]], rounds: int, load: str) -> str:
    """The report in Markdown."""
    from lpvmpc.bench.speed_together import RADIUS, STRAIGHT

    length = 2.0 * (STRAIGHT + math.pi * RADIUS)
    lines = [
        "# Speed",
        "",
        f"Machine: {machine()}; meanwhile {load}.",
        versions_line(),
        "",
        DEFINITIONS.format(rounds=rounds, length=length),
    ]
    header = ("quantity", "value", "rounds", "unit", "bar", "verdict")
    for title, figures in sections:
        if figures:
            lines.append(markdown_table(title, header, [row(figure) for figure in figures]))
    bad = [
        f"{f.text} ({title})" for title, figures in sections for f in figures if f.ok is False
    ]
    lines.append(f"Bars not met: {'; '.join(bad)}." if bad else "All bars are met.")
    lines.append("None was set after a result had been seen.")
    searched = any(title == SEARCH for title, _ in sections)
    command = "python eval/speed.py" + " --search" * searched
    lines += ["", f"Made by `{command}`; the rounds are in speed.csv beside this file."]
    return "\n".join(lines) + "\n"


def row(figure: Figure) -> tuple[str, ...]:
    """A figure as a row of its table."""
    bar = "" if figure.limit is None else (">= " if figure.pick == "most" else "<= ")
    low, high = number(min(figure.rounds)), number(max(figure.rounds))
    span = low if low == high else f"{low} to {high}"
    return (
        figure.text,
        number(figure.value),
        span,
        figure.unit,
        bar and bar + f"{figure.limit:g}",
        {None: "", True: "met", False: "MISSED"}[figure.ok],
    )


def number(value: float) -> str:
    """A value with three digits, or all digits before the point."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def as_csv(figures: list[Figure]) -> str:
    """All figures with all rounds, one line each."""
    header = ("key", "quantity", "unit", "value", "limit", "ok", "rounds")
    body = []
    for f in figures:
        rounds = " ".join(f"{value:.6g}" for value in f.rounds)
        limit = None if f.limit is None else str(f.limit)
        body.append((f.key, f.text, f.unit, f.value, limit, f.ok, rounds))
    return csv_text(header, body)


def as_json(figures: list[Figure], rounds: int, load: str) -> dict[str, Any]:
    """One object: the values by key, and under which conditions they were measured."""
    return {
        **{f.key: f.value for f in figures},
        "bars": {f.key: {"limit": f.limit, "ok": f.ok} for f in figures if f.limit is not None},
        "record": record(rounds=rounds, load=load),
    }
