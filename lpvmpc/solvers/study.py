"""Who solves the recorded programs, how fast, and whether it is true.

The solution z* of a program is that of the dual active-set method, where our check finds it a
hundred times nearer than it would have to be; a program without such a solution is left out, and
counted. An answer is *accepted* where its solver calls it solved and our check agrees; it is
*wrong* where it is further than `FAR_OFF` from z*. That no accepted answer is wrong is what the
check is for.

Programs that have no solution are made from the recorded ones: a row that no input can meet, or a
cost without a least value. Whoever claims to have solved one of these is counted as well.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from lpvmpc.control.solver import active_set
from lpvmpc.control.solver.checked import FAR, STEPS
from lpvmpc.control.solver.optimality import GOOD, factor, judge
from lpvmpc.solvers.adapter import TOLERANCE, Adapter
from lpvmpc.solvers.adapters import ADAPTERS
from lpvmpc.solvers.condensed import Ours
from lpvmpc.solvers.stream import QP, Stream
from lpvmpc.units import Array

FAR_OFF = FAR * TOLERANCE
"""Distance from the solution beyond which an answer is wrong, in the inputs' units."""
CERTAIN = 0.01
"""Share of our check's bounds within which the solution itself must be."""
EVERY = 10
"""Every this many programs one is spoiled."""
SPOILED = ("infeasible", "unbounded")
"""How."""
REPEATS = 5
"""Solves of a program of which the fastest counts."""


@dataclass(kw_only=True)
class Found:
    """What a solver has shown on a stream."""

    solver: str
    """Its name."""
    claimed: int = 0
    """Programs that it calls solved."""
    accepted: int = 0
    """Those of them that our check agrees with."""
    wrong: int = 0
    """Accepted ones that are further from the solution than allowed: there must be none."""
    wrong_claims: int = 0
    """The same of those that it calls solved, whatever our check says."""
    furthest: float = 0.0
    """Largest distance of an accepted answer from the solution, in the inputs' units."""
    spoiled: dict[str, int] = field(default_factory=lambda: dict.fromkeys(SPOILED, 0))
    """Programs without solution that it calls solved, by how they were spoiled."""
    spoiled_accepted: int = 0
    """Those that our check agrees with: there must be none."""
    times: list[float] = field(default_factory=list)
    """CPU time of each program [us]."""

    def percentile(self, p: float, chosen: Array | None = None) -> float:
        """Percentile of the times, of some of the programs [us]; NaN where there are none."""
        times = np.array(self.times)
        times = times if chosen is None else times[chosen]
        return float(np.percentile(times, p)) if len(times) else float("nan")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What all solvers have shown on a stream."""

    stream: Stream
    """The programs."""
    active: Array
    """Whether any row is active at the solution, of each program that has one for certain."""
    uncertain: int
    """Programs left out, since the solution is not certain."""
    spoiled: int
    """Programs of each of `SPOILED`."""
    check_us: float
    """CPU time of our check, before and after [us], median."""
    found: tuple[Found, ...]
    """By solver."""


def measure(
    stream: Stream, names: Sequence[str], say: Callable[[int, int], None] | None = None
) -> Outcome:
    """Have solvers solve a stream, program by program, in turns.

    Args:
        stream: The programs.
        names: Keys of `ADAPTERS`.
        say: Called with the number of programs that are done, and of all.
    """
    solvers: list[tuple[Found, Adapter]] = [
        (Found(solver=name), ADAPTERS[name][0](stream)) for name in names
    ]
    for _, solver in solvers:  # what is compiled or allocated at the first call
        prepared = solver.prepare(stream.qp(0), 0)
        solver.answer(prepared, solver.run(prepared))
    active, checks, uncertain, spoiled = [], [], 0, 0
    for k in range(len(stream)):
        qp = stream.qp(k)
        sure = solution(qp)
        if sure is None:
            uncertain += 1
            continue
        z, y, U = sure
        active.append(bool(np.any(y != 0.0)))
        checks.append(_check_time(qp, z, y, U))
        turn = k % len(solvers)
        for found, solver in solvers[turn:] + solvers[:turn]:
            _ask(found, solver, qp, k, z, U)
        if k % EVERY == 0:
            spoiled += 1
            for found, _ in solvers:
                for how in SPOILED:
                    _ask_spoiled(found, stream, spoil(qp, how), k, how)
        if say is not None:
            say(k + 1, len(stream))
    return Outcome(
        stream=stream, active=np.array(active, dtype=bool), uncertain=uncertain, spoiled=spoiled,
        check_us=float(np.median(checks)) if checks else float("nan"),
        found=tuple(found for found, _ in solvers),
    )


def solution(qp: QP) -> tuple[Array, Array, Array] | None:
    """Solution, multipliers, and the Hessian's factor; None where the solution is not certain."""
    U = np.zeros_like(qp.H)
    if factor(*qp, U) != GOOD:
        return None
    z, y = np.empty(len(qp.g)), np.empty(len(qp.lo))
    steps = 10 * STEPS * (len(z) + len(y))
    active_set.solve(U, *qp, 1e-3 * CERTAIN * TOLERANCE, steps, z, y)
    residual, far = judge(*qp, z, y, U)
    return (z, y, U) if residual <= CERTAIN * TOLERANCE and far <= CERTAIN * FAR_OFF else None


def spoil(qp: QP, how: str) -> QP:
    """A program that has no solution.

    Args:
        qp: One that has.
        how: One of `SPOILED`. Infeasible: the first input's increment is told to be where its
            bounds are not. Unbounded: the first input's cost has a negative curvature; within the
            input's bounds there is a least value still, but nothing here looks for such a one.
    """
    H, lo, hi = qp.H.copy(), qp.lo.copy(), qp.hi.copy()
    if how == "unbounded":
        H[0, 0] -= 2.0 * np.linalg.eigvalsh(H)[-1]
    else:
        row = len(qp.g) - 1  # the rows of the inputs come first, then those of the increments
        lo[row] = hi[0] + 1.0
        hi[row] = lo[row] + 1.0
    return QP(H, qp.g, qp.C, lo, hi)


def _check_time(qp: QP, z: Array, y: Array, U: Array) -> float:
    """CPU time of the check before and after [us]."""
    best = np.inf
    for _ in range(REPEATS):
        start = time.process_time_ns()
        factor(*qp, U)
        judge(*qp, z, y, U)
        best = min(best, (time.process_time_ns() - start) * 1e-3)
    return best


def _ask(found: Found, solver: Adapter, qp: QP, k: int, z: Array, U: Array) -> None:
    """Have a program solved, look at the clock and at the answer."""
    prepared, best = solver.prepare(qp, k), np.inf
    for _ in range(REPEATS):
        start = time.process_time_ns()
        raw = solver.run(prepared)
        best = min(best, (time.process_time_ns() - start) * 1e-3)
    answer = solver.answer(prepared, raw)
    found.times.append(best)
    if not answer.claimed:
        return
    distance = float(np.max(np.abs(answer.z - z)))
    found.claimed += 1
    found.wrong_claims += not distance <= FAR_OFF
    if isinstance(solver, Ours):
        good = True  # it has checked its answer
    else:
        residual, far = judge(*qp, answer.z, answer.y, U)
        good = residual <= TOLERANCE and far <= FAR_OFF
    if good:
        found.accepted += 1
        found.wrong += not distance <= FAR_OFF
        found.furthest = max(found.furthest, distance)


def _ask_spoiled(found: Found, stream: Stream, qp: QP, k: int, how: str) -> None:
    """Offer a program that has no solution, to a solver that may break of it."""
    solver = ADAPTERS[found.solver][0](stream)
    with _quiet():
        prepared = solver.prepare(qp, k)
        answer = solver.answer(prepared, solver.run(prepared))
    if not answer.claimed:
        return
    found.spoiled[how] += 1
    U = np.zeros_like(qp.H)
    if isinstance(solver, Ours):
        found.spoiled_accepted += 1
    elif factor(*qp, U) == GOOD:
        residual, far = judge(*qp, answer.z, answer.y, U)
        found.spoiled_accepted += bool(residual <= TOLERANCE and far <= FAR_OFF)


@contextmanager
def _quiet() -> Iterator[None]:
    """Compiled code that prints why it cannot solve what cannot be solved is not heard."""
    sys.stdout.flush()
    kept = [os.dup(stream) for stream in (1, 2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        for stream in (1, 2):
            os.dup2(nowhere, stream)
        yield
    finally:
        for stream, old in zip((1, 2), kept, strict=True):
            os.dup2(old, stream)
            os.close(old)
        os.close(nowhere)
