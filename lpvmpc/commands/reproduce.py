"""Put every number and figure of the paper beside ours, and write the report.

    lpvmpc reproduce --jobs 2

Drives what is needed with the shipped weights and networks. Results of closed loops are kept by
the hash of everything they depend on: after an interruption, or an edit that changes nothing for
them, the same command goes on. Exit codes: 0 written, promises met or not; 2 bad input; 130
interrupted.
"""

from __future__ import annotations

import sys
import textwrap
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from lpvmpc.kit import cli
from lpvmpc.kit.files import replacing
from lpvmpc.kit.findings import promises_sentence
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.report import write_report

if TYPE_CHECKING:
    from lpvmpc.paper.measurements import Evidence, Say
    from lpvmpc.paper.records import Tuning

NAME = "paper"
QUICK_OUT = Path("runs/reproduce-quick")


@dataclass(frozen=True, kw_only=True)
class Options:
    """Reproduce the paper: its numbers, figures and comparisons beside ours."""

    quick: bool = False
    """A look instead of the report: fewer roads, into runs/reproduce-quick (unless --out)."""
    retune: bool = False
    """Tune the weights of every controller anew, within --cache, and drive with those."""
    retrain: bool = False
    """Collect data and train the networks anew, within --cache, and drive with those."""
    jobs: int = 0
    """Number of processes (0: one per core)."""
    out: Path | None = None
    """Folder for paper.md, .csv, .json and paper/*.png (default: docs/results)."""
    cache: Path = Path("runs/reproduce")
    """Folder where results, tunings and trainings are kept from one call to the next."""
    json: Path | None = None
    """Write the values to this file as well."""


def main(options: Options) -> int:
    """Measure, print, save; returns the exit code."""
    cli.check_number("--jobs", options.jobs, 0, 1024)
    cli.check_opengl()
    out = options.out or (QUICK_OUT if options.quick else Path("docs/results"))
    cli.results_folder(out, NAME)
    cache = cli.results_folder(options.cache)
    cli.result_file(options.json)
    jobs, start = options.jobs or cli.cores(), time.perf_counter()
    from lpvmpc.paper import figures, measurements, report

    try:
        with Bar(counted=True) as bar:
            say = teller(bar)
            networks = retrain(cache, jobs, options.quick, say) if options.retrain else None
            tunings = retune(cache, jobs, options.quick, say) if options.retune else None
            found = measurements.gather(
                quick=options.quick, jobs=jobs, cache=cache, say=say, tunings=tunings,
                networks=networks,
            )
            say("figures", 0, 1)
            with replacing(out, [f"{NAME}.md", f"{NAME}.csv", f"{NAME}.json", f"{NAME}/*"]) as new:
                pictures = figures.save_all(found, new / NAME)
                found = replace(found, seconds=time.perf_counter() - start)
                addresses = {name: f"{NAME}/{file.name}" for name, file in pictures.items()}
                write_report(
                    new,
                    NAME,
                    text=report.report(found, addresses),
                    table=report.as_csv(found),
                    values=report.as_json(found),
                    copy=options.json,
                )
    except KeyboardInterrupt:
        print("Interrupted; the same command goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    print(summary(found))
    print(f"Saved {out}/ ({NAME}.md, {NAME}.csv, {NAME}.json, {NAME}/*.png)")
    return cli.DONE


def retune(cache: Path, jobs: int, quick: bool, say: Say) -> dict[str, Tuning]:
    """Every controller's weights tuned anew; a quick look does a handful of evaluations."""
    from lpvmpc.paper import records, retrain, runs
    from lpvmpc.tune import tuning

    found = {}
    for name in runs.DRIVEN:
        task = tuning.Task(controller=name)
        folder = cache / "tuning" / name
        if quick:
            task = tuning.Task(
                controller=name, scenarios=("tuning-b",), worlds=("ideal", "fleet"),
                generations=2, population=4,
            )
            folder = cache / "tuning-quick" / name
        one = records.read_tuning(retrain.tune(task, folder, jobs, say))
        assert one is not None  # it was written just now
        found[name] = one
    return found


def retrain(cache: Path, jobs: int, quick: bool, say: Say) -> dict[str, Path]:
    """Both networks trained anew; a quick look passes through the data a few times only."""
    from lpvmpc.paper import retrain

    if quick:
        return retrain.train(cache / "training-quick", jobs, say, epochs=40)
    return retrain.train(cache / "training", jobs, say)


def summary(found: Evidence) -> str:
    """What is printed, at 80 columns: the promises and the sentences."""
    from lpvmpc.paper import findings, report, sentences

    bars = findings.bars(found)
    parts = [report.promises(bars), promises_sentence(bars), ""]
    parts += [f"- {sentence}" for sentence in (*sentences.sentences(found), *found.missing)]
    return "\n".join(
        part if "\n" in part else textwrap.fill(part, 80, subsequent_indent="  ")
        for part in parts
    )


def teller(bar: Bar) -> Say:
    """Tells a bar what is done, how much, and of how much."""

    def say(what: str, done: int, total: int) -> None:
        if (what, total) != (bar.title, bar.total):
            bar.begin(what, total)
        bar.at(done)

    return say
