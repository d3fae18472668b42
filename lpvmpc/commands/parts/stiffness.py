"""Say what the networks tell of the tires along driven laps, and how far trainings differ.

    lpvmpc stiffness

Prints the report and writes it as stiffness.md, stiffness.csv and stiffness.json. Exit codes: 0
done; 2 bad input, one line on stderr; 130 interrupted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.kit import cli

KINDS = ("network", "network-secant")
GRIP = 0.76


@dataclass(frozen=True, kw_only=True)
class Options:
    """Say what the networks tell of the tires along driven laps."""

    seeds: int = 3
    """Seeds of the world `rtk`."""
    quick: bool = False
    """A look: one seed of the world, the shipped networks alone."""
    jobs: int | None = None
    """Processes for the closed loops (default: one per core)."""
    out: Path = Path("docs/results")
    """Folder for stiffness.md, stiffness.csv and stiffness.json; the networks of other seeds are
    looked for in network/ and network-secant/ below it."""
    car: CarPlace = None
    json: Path | None = None
    """Write the values to this file as well."""


@with_car(out="runs/{car}/stiffness")
def main(options: Options) -> int:
    """Drive, compare, save; returns the exit code."""
    cli.check_number("--seeds", options.seeds, 1, 1000)
    cli.check_number("--jobs", options.jobs, 1, 10_000)
    cli.check_opengl()
    out = cli.writable_folder(options.out)
    cli.result_file(options.json)
    from lpvmpc.learn import driven, driven_report
    from lpvmpc.sim import batch

    def say(what: str) -> None:
        if sys.stderr.isatty():
            print(f"{what} ...", file=sys.stderr)

    seeds = range(100_000, 100_000 + (1 if options.quick else options.seeds))
    rows = []
    for kind in KINDS:
        for road in (1.0, 0.75):
            say(f"laps with {kind}, friction {road:g}")
            rows += driven.rows_of(kind, road, seeds, GRIP)
    trained = []
    for kind in KINDS:
        for seed, file in driven.networks(out, kind).items():
            if options.quick and file is not None:
                continue
            say(f"roads with {kind}, seed {seed}")
            results = batch.drive_all(
                driven_report.runs(kind, file), jobs=options.jobs or cli.cores()
            )
            trained.append(driven_report.Trained(
                kind=kind, seed=seed, r2=driven_report.fit(kind, file), results=tuple(results)
            ))
    print(driven_report.report(rows, trained, GRIP), end="")
    files = driven_report.save(out, rows, trained, GRIP, options.json)
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE
