"""Try what goes wrong: inputs, files, controllers, kills, QPs, roads that nobody knows.

    lpvmpc reliability --jobs 2

Driven runs are kept one by one, the other parts whole, so that --resume goes on where an
interrupted one stopped, at the same commit. Exit codes: 0 tried, promises met or not; 2 bad input;
130 interrupted.
"""

from __future__ import annotations

import json
import sys
import tempfile
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from lpvmpc import commands
from lpvmpc.commands.parts.batches import driver, prepare, wrapped
from lpvmpc.kit import cli
from lpvmpc.kit.files import read_json, write_text
from lpvmpc.kit.findings import promises_sentence
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.provenance import commit
from lpvmpc.kit.report import write_report

if TYPE_CHECKING:
    from lpvmpc.reliability.inputs import Answer
    from lpvmpc.reliability.report import Section

NAME = "reliability"
QUICK_OUT = Path("runs/reliability-quick")
PARTS = ("inputs", "files", "controllers", "kills", "qps", "loops")
"""What may be tried, in the order of the report."""
DAMAGES, HERE, ISOLATED, QPS, RUNS = 2000, 1000, 300, 100_000, 10_000
"""How often a file of each kind is damaged; controllers that do wrong, in this process and in
processes of their own; quadratic programs; random runs."""
QUICK_DAMAGES, QUICK_HERE, QUICK_ISOLATED, QUICK_QPS, QUICK_RUNS = 150, 36, 26, 500, 20
"""The same with --quick."""
KILLS = 20
"""How often each command is killed; with --quick `QUICK_KILLS`, and those of `QUICK_JOBS` alone."""
QUICK_KILLS, QUICK_JOBS = 2, ("collect", "train")
SEED = 0
"""Seed of all of them; the random runs' seeds are their numbers."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Try wrong inputs, damaged files, bad controllers, QPs, random roads; report what happened."""

    quick: bool = False
    """A look instead of the report: fewer of each, into runs/reliability-quick (unless --out)."""
    resume: bool = False
    """Use the runs that an earlier one has kept, where nothing they depend on changed."""
    jobs: int = 0
    """Number of processes (0: one per core)."""
    parts: tuple[str, ...] = ()
    """What to try: inputs, files, controllers, kills, qps, loops (default: all)."""
    runs: int | None = None
    """Random runs (default: 10000, with --quick 20)."""
    out: Path | None = None
    """Folder for reliability.md, .csv and .json (default: docs/results)."""
    cache: Path = Path("runs/reliability")
    """Folder where runs are kept, emptied unless --resume is given."""
    json: Path | None = None
    """Write the values to this file as well."""


def main(options: Options) -> int:
    """Try, print, save; returns the exit code."""
    cli.check_number("--jobs", options.jobs, 0, 1024)
    cli.check_number("--runs", options.runs, 1, 1_000_000)
    for part in options.parts:
        cli.check_choice("--parts", part, PARTS)
    cli.check_opengl()
    parts = [part for part in PARTS if part in options.parts or not options.parts]
    whole = parts == list(PARTS) and not options.quick
    out = cli.writable_folder(options.out or (Path("docs/results") if whole else QUICK_OUT))
    cli.result_file(options.json)
    cli.results_folder(out, NAME)
    prepare(options.cache, options.resume, NAME)
    jobs = options.jobs or cli.cores()
    runs = options.runs or (QUICK_RUNS if options.quick else RUNS)
    try:
        sections = [kept(part, options, runs, jobs) for part in parts]
    except KeyboardInterrupt:
        print("Interrupted; --resume goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    from lpvmpc.reliability import report

    files = write_report(
        out,
        NAME,
        text=report.report(sections, quick=options.quick, jobs=jobs,
                           left_out=[part for part in PARTS if part not in parts]),
        table=report.as_csv(sections),
        values=report.as_json(sections, quick=options.quick, jobs=jobs),
        copy=options.json,
    )
    print(summary(sections))
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE


def options_of_all() -> dict[str, type]:
    """The options of every command but this one, which would try itself."""
    names = [name for name in commands.COMMANDS if name != NAME]
    return {name: import_module(commands.module_of(name)).Options
            for name in names}


def asked() -> list[Answer]:
    """What all commands answer to wrong inputs."""
    from lpvmpc.reliability import inputs

    before = sys.argv
    try:
        with tempfile.TemporaryDirectory() as folder, inputs.set_up(Path(folder)):
            return [inputs.ask(wrong, commands.main)
                    for wrong in inputs.wrong_inputs(options_of_all())]
    finally:
        sys.argv = before


def kept(part: str, options: Options, runs: int, jobs: int) -> Section:
    """The section of a part, as an earlier run of this commit has kept it, or tried and kept."""
    from lpvmpc.reliability import report

    at = commit()
    whose = {"commit": at, "quick": options.quick, "runs": runs if part == "loops" else None}
    file = options.cache / f"{part}.section.json"
    if options.resume and at is not None and not at.endswith("-dirty"):
        try:
            found = read_json(file)
            if found["of"] == whose:
                return report.section_of(found["section"])
        except (OSError, ValueError, TypeError, KeyError):
            pass  # there is none, or a damaged one
    section = tried(part, options, runs, jobs)
    write_text(file, json.dumps({"of": whose, "section": asdict(section)}))
    return section


def tried(part: str, options: Options, runs: int, jobs: int) -> Section:
    """The section of a part."""
    from lpvmpc.reliability import damage, loops, misbehaving, report

    if part == "inputs":
        return report.inputs_section(asked())
    if part == "files":
        count = QUICK_DAMAGES if options.quick else DAMAGES
        found = [damage.fuzz(subject, count, SEED) for subject in damage.subjects()]
        return report.files_section(found, count, SEED)
    if part == "controllers":
        here, isolated = (QUICK_HERE, QUICK_ISOLATED) if options.quick else (HERE, ISOLATED)
        return report.controllers_section(misbehaving.controllers(SEED, here, isolated))
    if part == "kills":
        return killed(options.quick)
    if part == "qps":
        from lpvmpc.bench import fuzz

        return report.qps_section(fuzz.qps(QUICK_QPS if options.quick else QPS, SEED))
    with Bar(counted=True, unit="runs") as bar:
        drive = driver(jobs, options.cache, bar)("random roads")
        return report.loops_section(loops.driven(runs, drive))


def killed(quick: bool) -> Section:
    """The section of the kills."""
    from lpvmpc.reliability import kills
    from lpvmpc.reliability.kills_report import kills_section

    def say(what: str) -> None:
        if sys.stderr.isatty():
            print(what, file=sys.stderr)

    count, names = (QUICK_KILLS, QUICK_JOBS) if quick else (KILLS, tuple(kills.JOBS))
    with tempfile.TemporaryDirectory() as folder:
        found = [
            kills.kill_often(kills.JOBS[name], count, SEED + i, Path(folder, str(i)), say)
            for i, name in enumerate(names)
        ]
    return kills_section(found, SEED)


def summary(sections: list[Section]) -> str:
    """What is printed: sentences at 80 columns."""
    found = [finding for section in sections for finding in section.findings]
    lines = [wrapped(promises_sentence(found))]
    for section in sections:
        told = len(section.faults) or "none"
        lines.append(wrapped(f"{section.title}: {section.tried} tried, {told} to be told one by "
                             "one."))
    return "\n".join(lines)
