"""Measure what adapting the cornering stiffness is worth, and write the report.

    lpvmpc ablation --jobs 2

Every stiffness model drives every case, with the disturbance observer and without it. Results are
kept run by run, so that --resume goes on where an interrupted one stopped. Exit codes: 0
measured, promises met or not; 2 bad input; 130 interrupted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lpvmpc.commands.parts.batches import driver, prepare, wrapped
from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.kit import cli
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.report import write_report

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lpvmpc.bench.cases import DrivenCase, FactorSearch

NAME = "ablation"
QUICK_OUT = Path("runs/ablation-quick")


@dataclass(frozen=True, kw_only=True)
class Options:
    """Compare stiffness models in closed loop: accuracy, survival, robustness."""

    quick: bool = False
    """A look instead of the report: a few cases, into runs/ablation-quick (unless --out)."""
    resume: bool = False
    """Use the results that an earlier ablation has kept, where nothing they depend on changed."""
    jobs: int = 0
    """Number of processes (0: one per core)."""
    out: Path | None = None
    """Folder for ablation.md, .csv, .json and .png (default: docs/results)."""
    cache: Path = Path("runs/ablation")
    """Folder where results are kept, emptied unless --resume is given."""
    car: CarPlace = None
    json: Path | None = None
    """Write the values to this file as well."""


@with_car(out="runs/{car}/ablation", cache="runs/{car}/ablation/kept")
def main(options: Options) -> int:
    """Drive, print, save; returns the exit code."""
    cli.check_number("--jobs", options.jobs, 0, 1024)
    cli.check_opengl()
    out = options.out or (QUICK_OUT if options.quick else Path("docs/results"))
    cli.results_folder(out, NAME)
    cli.result_file(options.json)
    prepare(options.cache, options.resume, NAME)
    from lpvmpc.bench import cases as ablation
    from lpvmpc.bench import report

    jobs = options.jobs or cli.cores()
    quick = options.quick
    cases = [c for c in ablation.CASES if not quick or c.key in ablation.QUICK]
    tuning = ablation.SEARCH if not quick else ablation.roads(("tuning-a",), (0.76,))
    coarse, fine = (ablation.COARSE[1::2], ()) if quick else (ablation.COARSE, ablation.FINE)
    try:
        with Bar(counted=True, unit="runs") as bar:
            drive = driver(jobs, options.cache, bar)
            searches = ablation.search(drive("best constant"), tuning, coarse, fine)
            best = {observer: found.best for observer, found in searches.items()}
            rows = ablation.compare(cases, best, drive("comparison"))
    except KeyboardInterrupt:
        print("Interrupted; --resume goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    text = report.report(rows, searches, quick=quick, jobs=jobs, picture=f"{NAME}.png")
    files = write_report(
        out,
        NAME,
        text=text,
        table=report.as_csv(rows),
        values=report.as_json(rows, searches, quick=quick, jobs=jobs),
        copy=options.json,
        picture=report.draw(rows),
    )
    print(summary(rows, searches))
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE


def summary(rows: Sequence[DrivenCase], searches: Mapping[bool, FactorSearch]) -> str:
    """What is printed, at 80 columns: the summary, the promises, the sentences."""
    from lpvmpc.bench import report
    from lpvmpc.bench.verdict import Results, bars, sentences
    from lpvmpc.kit.findings import promises_sentence

    found = bars(Results(rows))
    parts = [
        report.summary_table(Results(rows)),
        report.promises(found),
        promises_sentence(found),
        "",
        *sentences(Results(rows), dict(searches)),
    ]
    return "\n".join(part if "\n" in part else wrapped(part) for part in parts)
