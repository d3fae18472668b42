"""What is said about the solvers: first what does not hold, then who is how fast."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine, versions_of
from lpvmpc.kit.report import csv_text, finite, record, versions_line, write_report
from lpvmpc.solvers.adapter import ACCURACY, FINE, TOLERANCE
from lpvmpc.solvers.adapters import ADAPTERS
from lpvmpc.solvers.study import EVERY, FAR_OFF, REPEATS, SPOILED, Found, Outcome

DEFAULT, OTHER = "lpvmpc", "active-set"
"""What the loop calls by default, and what it may be told to call."""
BASE = "proxqp-dense"
"""Solver that times are compared with."""
OURS = (DEFAULT, OTHER)
"""Solvers whose times include our checks."""

DEFINITIONS = """\
Each program is that of one control period of `lpv-mpc`, {n} variables and {m} rows condensed, \
11 states more per period in stages; those of a lap are spread evenly over it, and as many more \
have an active row, where there are so many. A solver starts each program cold, as our loop \
does, so that an answer depends on its program alone; warm starts are not measured. Times are \
CPU time of the process, the fastest of {repeats} solves, in turns, and contain update and solve \
as called from Python, not the writing of the program in the solver's form; those of `{default}` \
and `{other}` contain our checks as well, and the column "in the loop" adds our check to all \
others. Solvers in stages are asked for residuals of {fine:g}, those on the condensed program \
for {accuracy:g}, before our check wants {tolerance:g} on the condensed one, so that none is \
refused for a tolerance of its own.

*Solved*: so many programs the solver calls solved. *Accepted*: our check agrees (residual of \
the optimality conditions at most {tolerance:g}, and the answer at most {far:g} of the inputs' \
units from the solution, by its own account). *Wrong*: accepted, and yet further than {far:g} \
from the solution; there must be none. *Wrong claims*: further than that and called solved, \
whatever our check says. The solution is that of the dual active-set method where our check \
finds it a hundred times nearer than it must be. Every {every}th program is spoiled in two ways, \
so that it has no solution: infeasible rows, and a cost that is not convex.
"""


def sentences(outcomes: Sequence[Outcome]) -> list[str]:
    """What follows from the numbers, what does not hold first."""
    found: list[str] = []
    names = [one.solver for one in outcomes[0].found]
    total = sum(len(o.active) for o in outcomes)
    wrong = {n: sum(f.wrong + f.spoiled_accepted for f in _of(outcomes, n)) for n in names}
    bad = [f"{n} ({count})" for n, count in wrong.items() if count]
    if bad:
        found.append(f"WRONG answers were accepted, of {_listed(bad)}.")
    uncertain = sum(o.uncertain for o in outcomes)
    if uncertain:
        found.append(f"{uncertain} programs are left out: their solution is not certain.")
    for n in names:
        some = _of(outcomes, n)
        missed, refused = (total - sum(f.claimed for f in some),
                           sum(f.claimed - f.accepted for f in some))
        if missed:
            found.append(f"{n} did not solve {missed} of {total} programs.")
        if refused:
            found.append(f"{n} called {refused} of {total} programs solved whose answer our check "
                         "refuses.")
    for how in SPOILED:
        claims = {n: sum(f.spoiled[how] for f in _of(outcomes, n)) for n in names}
        liars = [f"{n} {count}" for n, count in claims.items() if count]
        if liars:
            word = "convex" if how == "unbounded" else "feasible"
            spoiled = sum(o.spoiled for o in outcomes)
            found.append(
                f"Of {spoiled} programs that are not {word}, these were called solved: "
                f"{_listed(liars)}; our check before the solve refuses them."
            )
    if not bad:
        found.append(f"No wrong answer was accepted, of {len(names)} solvers on {total} programs.")
    found += _speed(outcomes, names, total)
    return found


def _speed(outcomes: Sequence[Outcome], names: Sequence[str], total: int) -> list[str]:
    """Who is faster than what the loop calls, at equal trust."""
    trusted = [n for n in names if sum(f.accepted for f in _of(outcomes, n)) == total]
    if DEFAULT not in trusted:
        return []
    ratios = {n: _in_loop(outcomes, n) for n in trusted if n != DEFAULT}
    faster = sorted((r, n) for n, r in ratios.items() if r < 1.0)
    if not faster:
        return [f"None that solves all of them is faster than `{DEFAULT}`, our checks included."]
    told = _listed([f"{n} ({r:.2f})" for r, n in faster])
    return [
        f"With our checks before and after, these solve all programs faster than what the loop "
        f"calls by default (median time relative to it, worst lap): {told}."
    ]


def _in_loop(outcomes: Sequence[Outcome], name: str) -> float:
    """Median time with our check relative to what the loop calls, in the lap where it is worst."""
    return max(_loop_us(o, name) / _loop_us(o, DEFAULT) for o in outcomes)


def _loop_us(o: Outcome, name: str) -> float:
    """Median time in the loop, our check included [us]."""
    one = next(f for f in o.found if f.solver == name)
    return one.percentile(50) + (0.0 if name in OURS else o.check_us)


def _listed(texts: Sequence[str]) -> str:
    """Texts as they stand in a sentence."""
    return " and ".join(filter(None, [", ".join(texts[:-1]), texts[-1]]))


def _of(outcomes: Sequence[Outcome], name: str) -> list[Found]:
    return [f for o in outcomes for f in o.found if f.solver == name]


def report(
    outcomes: Sequence[Outcome], lacking: Mapping[str, str], files: Mapping[str, str]
) -> str:
    """The report in Markdown.

    Args:
        outcomes: One per lap.
        lacking: Packages that solvers lack, by solver.
        files: SHA-256 of the file of each lap's programs, by its name.
    """
    m, n = outcomes[0].stream.arrays["A"].shape[1:]
    packages = sorted({package for _, package, _ in ADAPTERS.values() if package})
    installed = ", ".join(f"{k} {v}" for k, v in versions_of(packages).items())
    lines = [
        "# Quadratic programs of our laps, by other solvers",
        "",
        *(f"- {sentence}" for sentence in sentences(outcomes)),
        "",
        f"{machine()}. {versions_line()} Solvers: {installed}.",
        "",
        DEFINITIONS.format(
            n=n, m=m, repeats=REPEATS, default=DEFAULT, other=OTHER, fine=FINE, accuracy=ACCURACY,
            tolerance=TOLERANCE, far=FAR_OFF, every=EVERY,
        ),
    ]
    for o in outcomes:
        lines.append(_table(o))
    names = [f.solver for f in outcomes[0].found]
    lines.append(markdown_table(
        f"Programs without solution that are called solved, of {sum(o.spoiled for o in outcomes)} "
        "of each kind",
        ("solver", "is given", "infeasible", "not convex", "accepted by our check"),
        [
            (name, ADAPTERS[name][2],
             *(sum(f.spoiled[how] for f in _of(outcomes, name)) for how in SPOILED),
             sum(f.spoiled_accepted for f in _of(outcomes, name)))
            for name in names
        ],
        words=("is given",),
    ))
    if lacking:
        told = _listed([f"{name} ({package})" for name, package in lacking.items()])
        lines.append(f"Not installed here: {told}; pip install 'lpvmpc[solvers,nmpc]'.\n")
    told = ", ".join(f"{name} {sha[:16]}" for name, sha in files.items())
    lines.append(
        "Known limits: HPIPM is called through CasADi, and on the condensed program, since one "
        "slack over all periods is no program in stages; qpOASES, FORCES and code generators are "
        "not here; one machine, one car, one horizon.\n"
    )
    lines.append(f"The programs lie in .npz files (SHA-256: {told}), as lpvmpc/solvers/stream.py "
                 "describes. Made by `lpvmpc solvers`.")
    return "\n".join(lines) + "\n"


def _table(o: Outcome) -> str:
    base = next((f for f in o.found if f.solver == BASE), None)
    rows = []
    for f in o.found:
        ratio = f.percentile(50) / base.percentile(50) if base else math.nan
        busy = f.percentile(50, o.active)
        rows.append((
            f.solver, f.claimed, f.accepted, f.wrong, f.wrong_claims, f"{f.furthest:.1e}",
            *(f"{f.percentile(p):.1f}" for p in (50, 99, 100)),
            "-" if math.isnan(busy) else f"{busy:.1f}", f"{ratio:.2f}",
            f"{_loop_us(o, f.solver):.1f}",
        ))
    a = o.stream.about
    where = f"{a.get('scenario')}, grip {a.get('grip')}, world {a.get('world')}"
    return markdown_table(
        f"{o.stream.name}: {len(o.active)} programs ({where}), {int(o.active.sum())} with an "
        f"active row; our check takes {o.check_us:.1f} us",
        ("solver", "solved", "accepted", "wrong", "wrong claims", "furthest", "p50 [us]", "p99",
         "max", "p50, active rows", f"p50 / {BASE}", "in the loop [us]"),
        rows,
    )


def as_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Every number, one row per lap and solver."""
    return [
        {
            "lap": o.stream.name, "solver": f.solver, "programs": len(o.active),
            "with_active_rows": int(o.active.sum()), "solved": f.claimed, "accepted": f.accepted,
            "wrong": f.wrong, "wrong_claims": f.wrong_claims, "furthest": f.furthest,
            "p50_us": f.percentile(50), "p99_us": f.percentile(99), "max_us": f.percentile(100),
            "p50_active_us": finite(f.percentile(50, o.active)), "check_us": o.check_us,
            "in_the_loop_us": _loop_us(o, f.solver), "spoiled_of_each_kind": o.spoiled,
            "infeasible_solved": f.spoiled["infeasible"],
            "unbounded_solved": f.spoiled["unbounded"], "spoiled_accepted": f.spoiled_accepted,
        }
        for o in outcomes for f in o.found
    ]


def save(
    folder: Path, outcomes: Sequence[Outcome], lacking: Mapping[str, str],
    files: Mapping[str, str], copy: Path | None,
) -> list[Path]:
    """Write solvers.md, .csv and .json.

    Raises:
        OutputError: One of them cannot be written.
    """
    rows = as_rows(outcomes)
    packages = sorted({package for _, package, _ in ADAPTERS.values() if package})
    values = {
        "solvers": rows, "sentences": sentences(outcomes), "lacking": dict(lacking),
        "programs_sha256": dict(files),
        "record": record(packages=versions_of(packages), accuracy=ACCURACY, in_stages=FINE,
                         tolerance=TOLERANCE, repeats=REPEATS),
    }
    return write_report(
        folder, "solvers", text=report(outcomes, lacking, files),
        table=csv_text(tuple(rows[0]), (row.values() for row in rows)), values=values, copy=copy,
    )
