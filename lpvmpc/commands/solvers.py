"""Have other solvers solve the quadratic programs of our laps: how fast, and whether it is true.

    lpvmpc solvers
    lpvmpc solvers --programs runs/solvers/limit.npz --solvers active-set daqp

Drives three laps with `lpv-mpc`, keeps their programs in .npz files, has every installed solver
solve them, and checks each answer itself. Prints the report and writes it as solvers.md, .csv and
.json. Exit codes: 0 done; 2 bad input, one line on stderr; 3 a wrong answer was accepted; 130
interrupted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from lpvmpc.errors import OptionError, UnknownNameError
from lpvmpc.kit import cli

if TYPE_CHECKING:
    from lpvmpc.solvers.stream import Stream

QUICK_OUT = Path("runs/solvers-quick")


@dataclass(frozen=True, kw_only=True)
class Options:
    """Have other solvers solve the quadratic programs of our laps."""

    solvers: tuple[str, ...] = ()
    """Who solves (default: all that are installed)."""
    programs: tuple[Path, ...] = ()
    """Files with programs of an earlier run (default: laps are driven, and theirs are kept)."""
    count: int | None = None
    """Programs of each lap, spread over it (default: 1000; 100 with --quick)."""
    quick: bool = False
    """A look: few programs, into runs/solvers-quick (unless --out)."""
    keep: Path = Path("runs/solvers")
    """Folder for the files with the programs."""
    out: Path | None = None
    """Folder for solvers.md, solvers.csv and solvers.json (default: docs/results)."""
    json: Path | None = None
    """Write the values to this file as well."""


def main(options: Options) -> int:
    """Record or read, solve, check, save; returns the exit code."""
    cli.check_number("--count", options.count, 1, 1_000_000)
    cli.check_opengl()
    out = options.out or (QUICK_OUT if options.quick else Path("docs/results"))
    cli.results_folder(out, "solvers")
    cli.result_file(options.json)
    from lpvmpc.solvers import report, study
    from lpvmpc.solvers.adapters import ADAPTERS, available

    names, lacking = available()
    for name in options.solvers:
        if name not in ADAPTERS:
            raise UnknownNameError("solver", name, ADAPTERS)
        if name in lacking:
            raise OptionError("--solvers", name, f"installed: it needs {lacking[name]}")
        if options.solvers.count(name) > 1:
            raise OptionError("--solvers", " ".join(options.solvers), "each name once")
    names = list(options.solvers) or names
    outcomes, files = [], {}
    for stream, file in streams(options):
        say(f"{stream.name}: {len(stream)} programs, {len(names)} solvers")
        outcomes.append(study.measure(stream, names))
        files[stream.name] = sha256(file)
    print(report.report(outcomes, lacking, files), end="")
    written = report.save(out, outcomes, lacking, files, options.json)
    print(f"Saved {out}/ ({', '.join(file.name for file in written)})")
    wrong = any(f.wrong or f.spoiled_accepted for o in outcomes for f in o.found)
    return cli.NOT_COMPLETED if wrong else cli.DONE


def streams(options: Options) -> list[tuple[Stream, Path]]:
    """The programs and the files they lie in."""
    from lpvmpc.solvers import stream as streams

    if options.programs:
        return [(streams.load(file), file) for file in options.programs]
    cli.writable_folder(options.keep)
    count, found = options.count or (100 if options.quick else 1000), []
    for lap in streams.LAPS:
        say(f"{lap.key}: driving")
        file = options.keep / f"{lap.key}.npz"
        streams.save(file, streams.record(lap, count))
        found.append((streams.load(file), file))
    return found


def sha256(file: Path) -> str:
    """SHA-256 of a file."""
    import hashlib

    return hashlib.sha256(file.read_bytes()).hexdigest()


def say(what: str) -> None:
    """Tell a person at a terminal what is going on."""
    if sys.stderr.isatty():
        print(f"{what} ...", file=sys.stderr)
