"""Collect stiffness data: manoeuvres on the MuJoCo car up to the grip limit.

    lpvmpc collect --samples 10752 --jobs 2

The same seed and options give the same bytes for any number of jobs. A collection that was
interrupted or killed goes on with --resume. Exit codes: 0 done; 2 bad input, one line on stderr;
130 interrupted.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from lpvmpc.commands.parts.batches import jobs_of
from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.errors import OptionError
from lpvmpc.kit import cli
from lpvmpc.kit.progress import Bar

if TYPE_CHECKING:
    from lpvmpc.learn.coverage import Coverage


@dataclass(frozen=True, kw_only=True)
class Options:
    """Drive random manoeuvres on the MuJoCo car and record what its axles do."""

    samples: int = 10752
    """Number of rows, one per control period."""
    out: Path = Path("data/stiffness.parquet")
    """Parquet file for the data; the coverage picture lies beside it."""
    seed: int = 0
    """Seed of everything random."""
    jobs: int = 0
    """Number of processes (0: one per core; on Ray, per CPU of the cluster)."""
    resume: bool = False
    """Go on with an interrupted collection."""
    friction: tuple[float, ...] = (1.0,)
    """Scale of the road's peak friction: one number, or lowest and highest of the runs."""
    mass: tuple[float, ...] = ()
    """Mass of the car [kg]: one number, or lowest and highest of the runs (default: its own)."""
    backend: Literal["local", "ray"] = "local"
    """Where manoeuvres are driven: processes of this machine, or a Ray cluster."""
    address: Annotated[str | None, cli.Option(metavar="ADDR")] = None
    """Address of the Ray cluster (default: Ray decides, and starts one here)."""
    car: CarPlace = None


@with_car(out="data/{car}.parquet")
def main(options: Options) -> int:
    """Collect, summarise; returns the exit code."""
    cli.check_number("--jobs", options.jobs, 0, 1024)
    friction = pair("--friction", options.friction)
    mass = pair("--mass", options.mass) if options.mass else None
    if options.out.suffix != ".parquet":
        raise OptionError("--out", str(options.out), "a file name ending in .parquet")
    cli.check_opengl()
    from lpvmpc.learn import collect, coverage

    plan = collect.Plan(samples=options.samples, seed=options.seed, friction=friction, mass=mass)
    cli.results_folder(options.out.parent, options.out.name)
    jobs = jobs_of(options.jobs, options.backend, options.address)
    start = time.perf_counter()
    try:
        with Bar("collecting", options.samples, counted=True, unit="samples") as bar:
            found = collect.collect(
                plan, options.out, jobs=jobs, resume=options.resume, backend=options.backend,
                address=options.address, progress=bar.at,
            )
    except KeyboardInterrupt:
        print("Interrupted; --resume goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    took = time.perf_counter() - start
    covered = coverage.of(options.out)
    picture = options.out.with_name(options.out.stem + "-coverage.png")
    coverage.draw(covered, picture)
    print_table(covered)
    made = options.samples - found
    was = f", {found} were there already" if found else ""
    at_once = f"{jobs} jobs" if jobs else "all CPUs of the cluster"
    print(f"{made} samples in {took:.1f} s with {at_once}: {made / took:.0f} samples/s{was}.")
    print(f"Saved {options.out} and {picture}")
    return cli.DONE


def pair(name: str, values: tuple[float, ...]) -> tuple[float, float]:
    """One number or two, as lowest and highest.

    Raises:
        OptionError: There are more or fewer.
    """
    if len(values) not in (1, 2):
        raise OptionError(name, values, "one number, or the lowest and the highest")
    return values[0], values[-1]


def print_table(covered: Coverage) -> None:
    """What was driven, by kind of manoeuvre."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Coverage", title_style="bold", title_justify="left", expand=False)
    table.add_column("manoeuvre", no_wrap=True)
    for name in ("runs", "rows", "vx\nm/s", "ax\nm/s2", "|ay|\nm/s2", "slip f/r\ndeg",
                 "soft\n%"):
        table.add_column(name, justify="right")
    for name, kind in sorted(covered.kinds.items()):
        slips = (f"{value * 57.2958:.1f}" for value in (kind.alpha_f_max, kind.alpha_r_max))
        table.add_row(
            name,
            str(kind.runs),
            str(kind.rows),
            f"{kind.vx_min:.0f}-{kind.vx_max:.0f}",
            f"{kind.ax_min:.0f}..{kind.ax_max:.0f}",
            f"{kind.ay_max:.1f}",
            "/".join(slips),
            f"{100.0 * kind.saturated / kind.rows:.0f}",
        )
    console = Console(width=80 if not sys.stdout.isatty() else None, highlight=False)
    console.print(table)
    print("Soft: an axle at less than half its nominal stiffness.")
