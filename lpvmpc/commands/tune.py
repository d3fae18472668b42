"""Tune a controller's weights; or show the genetic algorithm that does so on a known function.

    lpvmpc tune --controller lpv-mpc
    lpvmpc tune --controller mine:Mine
    lpvmpc tune --spread runs/seed-0 runs/seed-1 runs/seed-2
    lpvmpc tune --sphere

Prints a table, draws the convergence and writes both beside a Markdown report; weights.toml is what
`lpvmpc track --weights` takes. Exit codes: 0 done; 2 bad input, one line on stderr; 130
interrupted (--resume goes on from there).
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from lpvmpc.commands.parts.the_car import CarPlace, folder_of, with_car
from lpvmpc.control.registry import TUNABLE
from lpvmpc.kit import cli
from lpvmpc.kit.files import write_json, write_text

if TYPE_CHECKING:
    from lpvmpc.tune.checkpoint import SearchState
    from lpvmpc.tune.tuning import SearchStage, Task, Tuned


SPHERE = ("sphere", "generations", "population", "seed", "out", "json")
"""Options that mean something with --sphere."""
SPREAD = ("spread", "jobs", "out", "json", "car")
"""Options that mean something with --spread."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Tune a controller's weights, with the same budget for every controller."""

    controller: Annotated[
        str, cli.Option(help=f"{', '.join(TUNABLE)}, or module:Class of your own.")
    ] = "lpv-mpc"
    scenario: tuple[str, ...] = ()
    """What to tune on (default: two tracks that no result is reported on)."""
    worlds: tuple[str, ...] = ()
    """Worlds to tune in, one draw for each time that a name is there (default: ideal rtk fleet
    fleet)."""
    seeds: int | None = None
    """Draws of each of the worlds (default: 1)."""
    generations: int | None = None
    """Generations (default: 15; with --sphere 100)."""
    population: int | None = None
    """Individuals in the population (default: 20; with --sphere 10)."""
    jobs: int | None = None
    """Processes (default: one per core)."""
    backend: Literal["local", "ray"] = "local"
    """Processes of this machine, or a Ray cluster."""
    address: Annotated[str | None, cli.Option(metavar="ADDR")] = None
    """Address of the Ray cluster (default: one is started here)."""
    resume: bool = False
    """Go on with an interrupted tuning, to the same result."""
    spread: tuple[Path, ...] = ()
    """Folders of finished tunings that differ in --seed alone: write how far they agree, beside the
    shipped weights, into --out (default: runs/tune-spread)."""
    sphere: bool = False
    """Minimise the sphere function from 30 seeds instead, as in the paper's Fig. 6."""
    seed: int = 0
    """Seed of the search; with --sphere the first of 30."""
    out: Path | None = None
    """Folder for the results (default: runs/tune-CONTROLLER; with --sphere docs/results)."""
    car: CarPlace = None
    json: Path | None = None
    """Write the values to this file as well."""


@with_car()
def main(options: Options) -> int:
    """Check the options, do the work, save; returns the exit code."""
    cli.check_number("--generations", options.generations, 1, 10_000)
    cli.check_number("--population", options.population, 2, 10_000)
    cli.check_number("--seed", options.seed, 0, 2**62)
    cli.check_number("--seeds", options.seeds, 1, 1000)
    cli.check_number("--jobs", options.jobs, 1, 10_000)
    cli.check_opengl()
    if options.spread:
        return show_spread(options)
    return show_sphere(options) if options.sphere else tune(options)


def tune(options: Options) -> int:
    """Tune a controller and show what it has brought; returns the exit code."""
    from lpvmpc import load_scenario
    from lpvmpc.kit.workers import workers
    from lpvmpc.sim import batch
    from lpvmpc.tune import tuning, tuning_report
    from lpvmpc.tune.stated import stated

    chosen = {name: getattr(options, name) for name in ("generations", "population", "seeds")}
    task = tuning.Task(
        controller=options.controller,
        scenarios=options.scenario or tuple(tuning.TRACKS),
        worlds=options.worlds or tuning.WORLDS,
        seed=options.seed,
        **{name: value for name, value in chosen.items() if value is not None},
    )
    for name in task.scenarios:  # what cannot be driven is told before anything is
        load_scenario(name, **tuning.TRACKS.get(name, {}))
    stated(task.controller)
    name = task.controller.replace(":", "-")
    whose = f"-{options.car.stem}" if options.car else ""
    out = cli.results_folder(options.out or Path("runs") / f"tune-{name}{whose}")
    cli.result_file(options.json)
    if options.resume and not (out / "checkpoint.json").exists() and is_done(task, out):
        print(f"This tuning is done already; its results are in {out}/.")
        return cli.DONE
    jobs = options.jobs or cli.cores()
    print(f"Tuning {task.controller} on {', '.join(task.scenarios)} in {', '.join(task.worlds)}:")
    print(f"at most {task.budget} evaluations of {len(tuning.runs(task, {}))} runs, {jobs} jobs, "
          f"seed {task.seed}.")
    try:
        with workers(jobs, options.backend, options.address) as pool, GenerationTable() as table:
            tuned = tuning.tune(
                task,
                map=pool.map,
                checkpoint=out / "checkpoint.json",
                resume=options.resume,
                after=table,
            )
        before, after = (
            batch.drive_all(tuning.runs(task, weights), jobs=jobs)
            for weights in (tuned.by_hand, tuned.weights)
        )
    except KeyboardInterrupt:
        if not (out / "checkpoint.json").exists():
            raise  # before its first instant
        print("Interrupted; --resume goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    files = tuning_report.save(tuned, before, after, out)
    if options.json is not None:
        write_json(options.json, tuning_report.as_json(tuned, before, after))
    if (folder := folder_of(options.car)) is not None:
        own = cli.writable_folder(folder / "weights") / f"{name}.toml"
        write_text(own, (out / "weights.toml").read_text(encoding="utf-8"))
    (out / "checkpoint.json").unlink()
    print_result(tuned, before, after)
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE


def is_done(task: Task, out: Path) -> bool:
    """Whether the results of a task lie in a folder: it was stopped after its last step."""
    try:
        found = json.loads((out / "tuning.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and found.get("task") == task.record()


class GenerationTable:
    """The generations as they come: a live table on a terminal, lines elsewhere."""

    COLUMNS = ("search", "generation", "best", "mean", "worst", "calls", "s")

    def __init__(self) -> None:
        self.start = time.perf_counter()
        self.rows: list[tuple[str, ...]] = []
        self.told = 0
        self.live: Any = None

    def __enter__(self) -> GenerationTable:
        if sys.stdout.isatty():
            from rich.live import Live

            self.live = Live(self.table(), auto_refresh=False)
            self.live.start()
        return self

    def __call__(self, stage: SearchStage, state: SearchState) -> None:
        """Called after each generation."""
        last = state.history[-1]
        numbers = (f"{value:.6f}" for value in (last.best, last.mean, last.worst))
        seconds = f"{time.perf_counter() - self.start:.0f}"
        row = stage.method, str(state.generation), *numbers, str(state.evaluations), seconds
        self.rows.append(row)
        if self.live is not None:
            self.live.update(self.table(), refresh=True)
        else:
            if len(self.rows) == 1:
                print(" ".join(name.rjust(10) for name in self.COLUMNS))
            print(" ".join(cell.rjust(10) for cell in row), flush=True)
        new = [f for f in state.failures if f.generation == state.generation]
        for failure in new:
            print(f"Warning: generation {failure.generation}, individual {failure.individual} "
                  f"is charged: {failure.text}", file=sys.stderr)

    def table(self) -> Any:
        """All generations so far."""
        from rich.table import Table as Rows

        table = Rows(title="Tuning", title_style="bold", title_justify="left", expand=False)
        for name in self.COLUMNS:
            table.add_column(name, justify="right")
        for row in self.rows:
            table.add_row(*row)
        return table

    def __exit__(self, *error: object) -> None:
        if self.live is not None:
            self.live.stop()


def print_result(
    tuned: Tuned, before: list[dict[str, Any]], after: list[dict[str, Any]]
) -> None:
    """Weights, and what they bring in the runs that tuned them."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table as Rows

    from lpvmpc.tune.tuning_report import bounds_sentence, driven_rows

    console = Console(width=80 if not sys.stdout.isatty() else None, highlight=False)
    weights = Rows(title="Weights", title_style="bold", title_justify="left", expand=False)
    for name in ("weight", "by hand", "tuned"):
        weights.add_column(name, justify="left" if name == "weight" else "right")
    for name, value in tuned.weights.items():
        weights.add_row(name, f"{tuned.by_hand[name]:.4g}", f"{value:.4g}")
    console.print(weights)
    console.print(bounds_sentence(tuned))
    driven = Rows(title="Driven", title_style="bold", title_justify="left", expand=False)
    for name in ("run", "weights", "lateral\nmm", "course\nrad", "speed\nm/s", ""):
        driven.add_column(name)
    for row in driven_rows(tuned.task, before, after):
        driven.add_row(*map(escape, row))
    console.print(driven)


def show_spread(options: Options) -> int:
    """Lay finished searches side by side, print and save it."""
    from lpvmpc.tune import spread

    cli.only(options, SPREAD)
    out = cli.results_folder(options.out or Path("runs/tune-spread"))
    cli.result_file(options.json)
    found = spread.read(options.spread, options.jobs or cli.cores())
    files = spread.save(found, out)
    if options.json is not None:
        write_json(options.json, spread.as_json(found))
    print(spread.report(found), end="")
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE


def show_sphere(options: Options) -> int:
    """Run, print and save the study of the sphere function."""
    cli.only(options, SPHERE)
    out = cli.results_folder(options.out or Path("docs/results"), "sphere")
    cli.result_file(options.json)
    from lpvmpc.tune import sphere, sphere_report

    def say(what: str) -> None:
        if sys.stderr.isatty():
            print(f"{what} ...", file=sys.stderr)

    settings = replace(
        sphere.SETTINGS,
        generations=options.generations or sphere.SETTINGS.generations,
        population=options.population or sphere.SETTINGS.population,
    )
    study = sphere.run(options.seed, settings=settings, say=say)
    files = sphere_report.save(study, out)
    if options.json is not None:
        write_json(options.json, sphere_report.as_json(study))
    print(sphere_report.report(study), end="")
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE
