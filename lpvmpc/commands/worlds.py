"""Measure what holds outside the perfect world, and write the report.

    lpvmpc worlds --jobs 2
    lpvmpc worlds --parts margins --resume

Every controller drives with one thing wrong at a time, in sampled worlds, and until it fails; and
lpv-mpc with each stiffness model. Results are kept run by run: --resume goes on where an
interrupted run stopped, and puts parts that were driven before into the same report. Exit codes: 0
measured, promises met or not; 2 bad input; 130 interrupted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from lpvmpc.commands.parts.batches import driver, jobs_of, prepare, wrapped
from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.errors import OptionError
from lpvmpc.kit import cli
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.report import write_report

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lpvmpc.bench.worlds import Drive, GridPlan
    from lpvmpc.bench.worlds_verdict import Found
    from lpvmpc.sim.batch import Run

NAME = "worlds"
QUICK_OUT = Path("runs/worlds-quick")
FAILED = "failed"
"""Folder in the cache for runs that gave no log; a resumed part drives them again."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Drive in worlds that the controllers are not told of: deviations, samples, margins."""

    quick: bool = False
    """A look instead of the report: few seeds, two roads, coarse margins, into runs/worlds-quick
    (unless --out)."""
    resume: bool = False
    """Use the results that an earlier run has kept, where nothing they depend on changed."""
    jobs: int = 0
    """Number of processes (0: one per core; on Ray, per CPU of the cluster)."""
    seeds: int | None = None
    """Seeds of each sampled world (default: 100; 4 with --quick)."""
    parts: tuple[str, ...] = ()
    """Parts to drive: deviations, worlds, margins, adaptation (default: all); with --resume, the
    report also holds the others where they were driven before."""
    controllers: tuple[str, ...] = ()
    """Who drives: names, or module:Class of your own (default: all but the rivals)."""
    out: Path | None = None
    """Folder for worlds.md, .csv, .json and .png (default: docs/results)."""
    cache: Path = Path("runs/worlds")
    """Folder where results are kept, emptied unless --resume is given."""
    car: CarPlace = None
    json: Path | None = None
    """Write the values to this file as well."""
    backend: Literal["local", "ray"] = "local"
    """Where runs are driven: processes of this machine, or a Ray cluster."""
    address: Annotated[str | None, cli.Option(metavar="ADDR")] = None
    """Address of the Ray cluster (default: Ray decides, and starts one here)."""


@with_car(out="runs/{car}/worlds", cache="runs/{car}/worlds/kept")
def main(options: Options) -> int:
    """Drive, print, save; returns the exit code."""
    cli.check_number("--jobs", options.jobs, 0, 1024)
    cli.check_number("--seeds", options.seeds, 1, 10_000)
    cli.check_opengl()
    parts = chosen_parts(options.parts)
    plan = plan_of(options)
    out = options.out or (QUICK_OUT if options.quick else Path("docs/results"))
    cli.results_folder(out, NAME)
    cli.result_file(options.json)
    prepare(options.cache, options.resume, NAME)
    jobs = jobs_of(options.jobs, options.backend, options.address)
    try:
        with Bar(counted=True, unit="runs") as bar:
            under = driver(jobs, options.cache, bar, options.backend, options.address)
            found = drive(plan, parts, options.cache, under)
    except KeyboardInterrupt:
        print("Interrupted; --resume goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    from lpvmpc.bench import worlds_report
    from lpvmpc.bench.worlds_pictures import pictures

    drawn = pictures(found)
    files = write_report(
        out,
        NAME,
        text=worlds_report.report(found, jobs=jobs, pictures=list(drawn)),
        table=worlds_report.as_csv(found),
        values=worlds_report.as_json(found, jobs=jobs),
        copy=options.json,
        pictures=drawn,
    )
    print(summary(found))
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE


def chosen_parts(given: Sequence[str]) -> tuple[str, ...]:
    """The parts that were asked for, in their own order; commas may stand for blanks.

    Raises:
        OptionError: There is no such part.
    """
    from lpvmpc.bench.worlds import PARTS

    words = [word for words in given for word in words.split(",") if word]
    for word in words:
        cli.check_choice("--parts", word, PARTS)
    return tuple(part for part in PARTS if not words or part in words)


def plan_of(options: Options) -> GridPlan:
    """How much is driven.

    Raises:
        OptionError: A controller that is named twice.
        UnknownNameError, ControllerError: A controller that does not exist.
    """
    from lpvmpc.bench.worlds import QUICK, SHIPPED, GridPlan
    from lpvmpc.sim.names import load_controller

    controllers = options.controllers or SHIPPED
    for name in controllers:
        if controllers.count(name) > 1:
            raise OptionError("--controllers", " ".join(controllers), "each name once")
        load_controller(name)
    changes: dict[str, Any] = dict(QUICK) if options.quick else {}
    if options.seeds is not None:
        changes["seeds"] = options.seeds
    return GridPlan(controllers=tuple(controllers), **changes)


class _NotKept(Exception):
    """A part that was not asked for has not been driven before, not all of it."""


def drive(plan: GridPlan, parts: Sequence[str], cache: Path, under: Any) -> Found:
    """Drive the parts that were asked for, and look up the others.

    Args:
        plan: How much is driven.
        parts: The parts to drive.
        cache: Folder of kept results.
        under: Gives the function that drives runs under a title.
    """
    from lpvmpc.bench.margins import margins
    from lpvmpc.bench.worlds import CELLS, OURS, PARTS, drive_cells
    from lpvmpc.bench.worlds_verdict import Found

    rows, bounds = {}, None
    for part in PARTS:
        if part == "adaptation" and OURS not in plan.controllers:
            continue
        run = keeping(under(part), cache) if part in parts else looking_up(cache)
        try:
            if part == "margins":
                bounds = margins(plan, run)
            else:
                rows[part] = drive_cells(CELLS[part](plan), run)
        except _NotKept:
            pass
    return Found(plan=plan, rows=rows, margins=bounds)


def keeping(drive: Drive, cache: Path) -> Drive:
    """Drives runs, and keeps those that failed apart, so that `looking_up` finds all."""
    from lpvmpc.sim.batch import keep_result

    def driven(runs: Sequence[Run]) -> list[dict[str, Any]]:
        results = drive(runs)
        for run, result in zip(runs, results, strict=True):
            if result["s_end_m"] is None:
                keep_result(cli.writable_folder(cache / FAILED), run.key(), result)
        return results

    return driven


def looking_up(cache: Path) -> Drive:
    """Gives what was kept, and drives nothing."""
    from lpvmpc.sim.batch import read_result

    def found(runs: Sequence[Run]) -> list[dict[str, Any]]:
        results = []
        for run in runs:
            key = run.key()
            result = read_result(cache, key) or read_result(cache / FAILED, key)
            if result is None:
                raise _NotKept
            results.append(result)
        return results

    return found


def summary(found: Found) -> str:
    """What is printed: sentences at 80 columns, and the promises."""
    from lpvmpc.bench.worlds_bars import bars
    from lpvmpc.bench.worlds_verdict import sentences
    from lpvmpc.kit.findings import promises_sentence

    return "\n".join(wrapped(s) for s in (*sentences(found), promises_sentence(bars(found))))
