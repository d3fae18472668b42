"""How far can the simulated car be trusted? Run the fidelity studies and write their report.

    lpvmpc fidelity
    lpvmpc fidelity tire steady-state

Prints every figure with its limit and verdict, and writes fidelity.md and fidelity.csv, and in
fidelity/ the pictures and the numbers behind them. Exit codes: 0 all figures are inside their
limits; 2 bad input; 3 some figure is outside; 130 interrupted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lpvmpc.commands.parts.the_car import CarPlace, TireFile, with_car
from lpvmpc.errors import UnknownNameError
from lpvmpc.kit import cli
from lpvmpc.kit.files import replacing, write_json
from lpvmpc.kit.report import write_report
from lpvmpc.studies.names import BROKEN, STUDIES

if TYPE_CHECKING:
    from lpvmpc.studies.study import StudyResult


@dataclass(frozen=True, kw_only=True)
class Options:
    """Run the fidelity studies of the simulated car: each figure with its limit and verdict.

    The exit code is 0 when all figures are inside their limits, and 3 when one is not.
    """

    studies: Annotated[
        tuple[str, ...],
        cli.Option(
            positional=True,
            metavar="STUDY",
            help=f"Studies to run (default: all): {', '.join(STUDIES)}.",
        ),
    ] = ()
    jobs: int = 0
    """Processes that run studies at the same time; 0 for one per core."""
    out: Path | None = None
    """Folder of the report (default: docs/results for all studies, else runs/fidelity)."""
    car: CarPlace = None
    tire: TireFile = None
    json: Path | None = None
    """Write figures, limits and verdicts to this file as well."""
    broken: Annotated[
        str | None,
        cli.Option(metavar="NAME", help=(
            "Study a car that is broken on purpose, to see what the studies notice: "
            f"{', '.join(BROKEN)}."
        )),
    ] = None


@with_car(out="runs/{car}/fidelity")
def main(options: Options) -> int:
    """Run, print, save; returns the exit code."""
    cli.check_number("--jobs", options.jobs, 0, 1024)
    cli.check_opengl()
    from lpvmpc.studies import report, runner

    for name in options.studies:
        if name not in STUDIES:
            raise UnknownNameError("study", name, STUDIES)
    if options.broken is not None and options.broken not in BROKEN:
        raise UnknownNameError("broken car", options.broken, BROKEN)
    names = [name for name in STUDIES if name in options.studies or not options.studies]
    published = len(names) == len(STUDIES) and options.broken is None
    out = options.out or Path("docs/results" if published else "runs/fidelity")
    cli.results_folder(out, "fidelity")
    cli.result_file(options.json)

    how = " ".join(["python eval/fidelity.py", *options.studies])
    for name in ("car", "tire"):
        if getattr(options, name) is not None:
            how += f" --{name} {getattr(options, name)}"
    if options.broken is not None:
        how += f" --broken {options.broken}"
    files = ["fidelity.md", "fidelity.csv", *(f"fidelity/{name}-*" for name in names)]
    with replacing(out, files) as new:
        results = runner.conduct(
            names,
            new / "fidelity",
            broken=options.broken,
            jobs=options.jobs or cli.cores(),
            progress=say,
        )
        car = " on ".join(str(x) for x in (options.car, options.tire) if x is not None) or None
        text = report.markdown(results, "fidelity", how, options.broken, car)
        write_report(new, "fidelity", text=text, table=report.as_csv(results))
    if options.json is not None:
        write_json(options.json, report.as_json(results))
    print(report.table(results), end="")
    count = sum(len(result.findings) for result in results)
    bad = sum(not finding.ok for result in results for finding in result.findings)
    print(f"{count - bad} of {count} figures are inside their limits.")
    print(f"Saved {out}/ (fidelity.md, fidelity.csv, fidelity/)")
    return cli.NOT_COMPLETED if bad else cli.DONE


def say(result: StudyResult) -> None:
    """One line on a terminal for each study that is done."""
    if sys.stderr.isatty():
        print(f"{result.study} took {result.seconds:.0f} s of CPU time", file=sys.stderr)
