"""Drive every controller over roads, worlds, grip, friction, wind and seeds: the leaderboard.

    lpvmpc benchmark --jobs 2
    lpvmpc benchmark --controllers mine:Mine nmpc lpv-mpc --quick
    lpvmpc benchmark --verify docs/results/benchmark-rows.parquet --sample 20

All controllers drive the same cells with the same seeds. What raises, hangs or returns no command
is a result, and the others go on. Results are kept run by run: --resume goes on where an
interrupted benchmark stopped, and writes the same rows. Exit codes: 0 measured, or verified; 2 bad
input; 3 rows that could not be verified; 130 interrupted.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from lpvmpc.commands.parts.batches import driver, interleaved, jobs_of, prepare, wrapped
from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.errors import OptionError, UnknownNameError
from lpvmpc.kit import cli
from lpvmpc.kit.files import write_text
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.report import write_report

if TYPE_CHECKING:
    from lpvmpc.leaderboard.grid import Plan
    from lpvmpc.leaderboard.score import Board
    from lpvmpc.sim.batch import Run

NAME = "benchmark"
QUICK_OUT = Path("runs/benchmark-quick")


@dataclass(frozen=True, kw_only=True)
class Options:
    """The leaderboard: controllers over roads, worlds, grip, friction, wind and seeds."""

    controllers: tuple[str, ...] = ()
    """Who drives: names, or module:Class of your own (default: all that can drive here)."""
    quick: bool = False
    """A look instead of the report: few seeds and roads, into runs/benchmark-quick (unless
    --out)."""
    resume: bool = False
    """Use the results that an earlier benchmark has kept, where nothing they depend on changed."""
    jobs: int = 0
    """Number of processes (0: one per core; on Ray: one per CPU of the cluster)."""
    seeds: int | None = None
    """Seeds of each course in each drawn world (default: 20; 2 with --quick)."""
    out: Path | None = None
    """Folder for benchmark.md, .html, .csv, .json, rows and pictures (default: docs/results)."""
    cache: Path = Path("runs/benchmark")
    """Folder where results are kept, emptied unless --resume is given."""
    car: CarPlace = None
    json: Path | None = None
    """Write the values to this file as well."""
    verify: Path | None = None
    """Drive a sample of the rows in this file again, and compare; nothing else is done."""
    sample: int = 20
    """Number of rows to verify (0: all)."""
    backend: Literal["local", "ray"] = "local"
    """Where runs are driven: processes of this machine, or a Ray cluster."""
    address: Annotated[str | None, cli.Option(metavar="ADDR")] = None
    """Address of the Ray cluster (default: Ray decides, and starts one here)."""


@with_car(out="runs/{car}/benchmark", cache="runs/{car}/benchmark/kept")
def main(options: Options) -> int:
    """Drive, print, save; returns the exit code."""
    cli.check_number("--jobs", options.jobs, 0, 1024)
    cli.check_number("--seeds", options.seeds, 1, 900)
    cli.check_number("--sample", options.sample, 0, 1_000_000)
    cli.check_opengl()
    if options.verify is not None:
        own = ("out", "cache") if options.car is not None else ()  # the car has set them
        cli.only(options, ("verify", "sample", "jobs", "backend", "address", "car", *own))
        return verify(options, options.verify)
    plan, lacking = plan_of(options)
    out = options.out or (QUICK_OUT if options.quick else Path("docs/results"))
    cli.results_folder(out, NAME)
    cli.result_file(options.json)
    prepare(options.cache, options.resume, NAME)
    from lpvmpc.leaderboard.grid import planned, rows_of, run_of
    from lpvmpc.leaderboard.score import Board

    jobs = jobs_of(options.jobs, options.backend, options.address)
    pairs = planned(plan)
    runs = [run_of(cell, name) for cell, name in pairs]
    try:
        with Bar(counted=True, unit="runs") as bar:
            results = drive(runs, options, jobs, options.cache, bar)
    except KeyboardInterrupt:
        print("Interrupted; --resume goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    board = Board(rows_of(pairs, results))
    names = write(board, plan, out, options, jobs, lacking)
    print(summary(board))
    print(f"Saved {out}/ ({', '.join(names)})")
    return cli.DONE


def drive(
    runs: Sequence[Run], options: Options, jobs: int, cache: Path | None, bar: Bar
) -> list[dict[str, Any]]:
    """Drive runs: those of a user's class in processes of their own, which nothing else depends on.

    Args:
        runs: What to drive.
        options: Where.
        jobs: Number of runs at a time.
        cache: Folder of kept results; None keeps nothing.
        bar: Shows how far it is.
    """
    from lpvmpc.leaderboard import own_process

    def own(theirs: Sequence[Run]) -> list[dict[str, Any]]:
        bar.begin("your own", len(theirs))
        return own_process.drive_all(
            theirs, jobs=jobs, backend=options.backend, address=options.address, cache=cache,
            progress=lambda done, _: bar.at(done),
        )

    packages = driver(jobs, cache, bar, options.backend, options.address)("leaderboard")
    found: dict[int, dict[str, Any]] = {}
    for function, is_own in ((own, True), (packages, False)):
        chosen = [i for i, run in enumerate(runs) if (":" in run.controller) is is_own]
        if chosen:
            some = [runs[i] for i in chosen]
            results = interleaved(function, some, [run.controller for run in some])
            found.update(zip(chosen, results, strict=True))
    return [found[i] for i in range(len(runs))]


def plan_of(options: Options) -> tuple[Plan, dict[str, str]]:
    """How much is driven, and which controllers lack which package.

    Raises:
        OptionError: A controller that is named twice.
        UnknownNameError: A controller that does not exist, or whose module is not there.
    """
    from lpvmpc.control.registry import CONTROLLERS
    from lpvmpc.leaderboard.grid import QUICK, Plan, available
    from lpvmpc.sim.own import file_of

    names, lacking = available()
    if options.controllers:
        for name in options.controllers:
            if options.controllers.count(name) > 1:
                raise OptionError("--controllers", " ".join(options.controllers), "each name once")
            module, _, made = name.partition(":")
            if name not in CONTROLLERS and not (made and file_of(module) is not None):
                raise UnknownNameError("controller", name, [*CONTROLLERS, "module:Class"])
        names = [name for name in options.controllers if name not in lacking]
        lacking = {name: lacking[name] for name in options.controllers if name in lacking}
        if not names:
            raise OptionError("--controllers", " ".join(options.controllers),
                              f"one that can drive here (missing: {', '.join(lacking.values())})")
    changes: dict[str, Any] = dict(QUICK) if options.quick else {}
    if options.seeds is not None:
        changes["seeds"] = options.seeds
    return Plan(controllers=tuple(names), **changes), lacking


def write(
    board: Board, plan: Plan, out: Path, options: Options, jobs: int, lacking: dict[str, str]
) -> list[str]:
    """Write everything; names of the files."""
    from lpvmpc.leaderboard import page, report, rows, tables
    from lpvmpc.leaderboard.pictures import pictures

    parquet = rows.write_rows(out, board.rows, plan)
    sha256 = rows.sha256(parquet[0])
    drawn = pictures(board)
    values = tables.as_json(board, plan, jobs=jobs, lacking=lacking, rows_sha256=sha256)
    html = out / f"{NAME}.html"
    write_text(html, page.page(board, values))
    files = write_report(
        out,
        NAME,
        text=report.report(board, plan, jobs=jobs, lacking=lacking, rows_sha256=sha256,
                           pictures=list(drawn)),
        table=tables.as_csv(board),
        values=values,
        copy=options.json,
        pictures=drawn,
    )
    return [file.name for file in (*files, html, *parquet)]


def verify(options: Options, file: Path) -> int:
    """Drive a sample of rows again and compare; returns the exit code."""
    from lpvmpc.leaderboard import verify as check
    from lpvmpc.leaderboard.rows import read_rows

    rows, facts = read_rows(file)
    chosen = check.sample(rows, options.sample)
    jobs = jobs_of(options.jobs, options.backend, options.address)
    try:
        with Bar(counted=True, unit="runs") as bar:
            found = check.compare(chosen, lambda runs: drive(runs, options, jobs, None, bar))
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return cli.INTERRUPTED
    for line in check.told(file, found, len(rows), facts):
        print(wrapped(line))
    return cli.DONE if all(one.ok for one in found) else cli.NOT_COMPLETED


def summary(board: Board) -> str:
    """What is printed, at 80 columns: a short table, and the sentences."""
    from lpvmpc.kit.markdown import markdown_table
    from lpvmpc.leaderboard.score import ranking
    from lpvmpc.leaderboard.verdict import mm, sentences

    names = board.full or board.controllers
    order = ranking(board, board.cells("worlds", by=names), names)
    rest: Sequence[str] = [name for name in board.controllers if name not in names]
    order += ranking(board, board.cells("worlds"), rest)
    body = [
        [s.controller + ("*" if s.controller in rest else ""), f"{s.finished}/{s.n}", mm(s.p95),
         mm(s.median), "-" if s.step_us[0] is None else f"{s.step_us[0]:.0f} us"]
        for s in order
    ]
    title = "All worlds" + ("; *: a part of the runs" if rest else "")
    table = markdown_table(title, ("controller", "finished", "95th", "median", "step"), body)
    return "\n".join([table, *(wrapped(sentence) for sentence in sentences(board))])
