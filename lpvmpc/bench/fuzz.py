"""Random quadratic programs against the solver of the controllers.

Whether a problem has a solution is known from how it is made, and whether an answer is it is judged
here without anything that the solver says or uses: from the answer alone. Of a convex problem the
answer z is the solution where it keeps the bounds and Hz + g is a sum of normals of touched rows,
each with the sign that pushes inwards. The nearest such sum is a non-negative least-squares
problem; what it leaves, measured by H^-1, bounds how far z is from the solution.

Source: Nocedal and Wright, Numerical Optimization, chapter 16; Lawson and Hanson, Solving Least
Squares Problems, chapter 23.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.control.solver.checked import QPSolver
from lpvmpc.units import Array

QP = tuple[Array, Array, Array, Array, Array]
"""H, g, C, lo, hi."""
TOUCHED = 5e-4
"""A row that is no further from its bound is touched, in units of the row."""
WRONG = 1e-3
"""An answer further than this from the solution, relative to its size, is wrong: of steering at its
unit of 0.1 rad, 0.1 mrad."""


@dataclass(frozen=True)
class Kind:
    """A kind of problem."""

    make: Callable[[np.random.Generator], QP]
    """Makes one."""
    solvable: bool
    """Whether it has a solution, and only one."""
    share: float
    """Share of all problems."""


def _convex(rng: np.random.Generator, spread: float = 3.0) -> QP:
    """A strictly convex cost, eigenvalues over `spread` decades, and rows around a point."""
    n, m = int(rng.integers(2, 32)), int(rng.integers(1, 121))
    turn = np.linalg.qr(rng.standard_normal((n, n)))[0]
    values = 10.0 ** rng.uniform(-0.5 * spread, 0.5 * spread, n)
    H = (turn * values) @ turn.T
    # the unconstrained optimum is some way off the point, which is inside all rows
    inside = rng.standard_normal(n)
    g = -H @ (inside + 10.0 ** rng.uniform(-1.0, 1.0) * rng.standard_normal(n))
    C = rng.standard_normal((m, n))
    middle = C @ inside
    lo, hi = (middle + sign * rng.exponential(1.0, m) for sign in (-1.0, 1.0))
    lo[rng.random(m) < 0.2], hi[rng.random(m) < 0.2] = -np.inf, np.inf
    return 0.5 * (H + H.T), g, C, lo, hi


def _tracking(rng: np.random.Generator) -> QP:
    """Condensed tracking of a random system: bounded inputs and increments, a soft bound."""
    N, nx, nu = int(rng.integers(4, 13)), int(rng.integers(2, 6)), int(rng.integers(1, 3))
    A = np.eye(nx) + 0.15 * rng.standard_normal((nx, nx))
    B, n = 0.5 * rng.standard_normal((nx, nu)), N * nu
    x, answer = 2.0 * rng.standard_normal(nx), np.zeros((nx, n))
    q, r = 10.0 ** rng.uniform(-2.0, 1.0, nx), 10.0 ** rng.uniform(-2.0, 0.0)
    steps = np.eye(n) - np.eye(n, k=-nu)
    H, g, soft, free = 2.0 * r * steps.T @ steps, np.zeros(n), [], []
    for k in range(N):
        x, answer = A @ x, A @ answer
        answer[:, k * nu : (k + 1) * nu] = B
        H += 2.0 * (answer.T * q) @ answer
        g += 2.0 * (answer.T * q) @ (x - 0.3 * rng.standard_normal(nx))
        soft.append(answer[0].copy())
        free.append(x[0])
    u_max, du_max = 10.0 ** rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(-1.0, 0.5)
    rows, ones, bound = np.array(soft), np.ones((N, 1)), rng.uniform(0.1, 1.0)
    C = np.block([
        [np.eye(n), np.zeros((n, 1))],
        [steps, np.zeros((n, 1))],
        [rows, -ones],
        [rows, ones],
        [np.zeros((1, n)), np.ones((1, 1))],
    ])
    far = np.full(N, np.inf)
    lo = np.concatenate([np.full(n, -u_max), np.full(n, -du_max), -far, -bound - np.array(free),
                         [0.0]])
    hi = np.concatenate([np.full(n, u_max), np.full(n, du_max), bound - np.array(free), far,
                         [np.inf]])
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[n, n] = 0.5 * (H + H.T), 2e4
    return whole, np.append(g, 0.0), C, lo, hi


def _scaled(rng: np.random.Generator) -> QP:
    """One of the above, its cost in another unit, 1e-8 to 1e8."""
    H, g, *rows = (_tracking if rng.random() < 0.5 else _convex)(rng)
    factor = 10.0 ** rng.uniform(-8.0, 8.0)
    return factor * H, factor * g, *rows


def _ill(rng: np.random.Generator) -> QP:
    """Badly conditioned: eigenvalues over up to ten decades."""
    return _convex(rng, spread=rng.uniform(6.0, 10.0))


def _degenerate(rng: np.random.Generator) -> QP:
    """Equations among the rows, and rows twice, some of those in other units."""
    H, g, C, lo, hi = _convex(rng)
    n, m = len(g), len(lo)
    equations = int(rng.integers(0, min(n, m)))
    both = np.isfinite(lo[:equations]) & np.isfinite(hi[:equations])
    start = np.flatnonzero(both)
    if len(start):  # a point in the middle of those rows; the others make room for it
        inside = np.linalg.lstsq(C[start], 0.5 * (lo[start] + hi[start]), rcond=None)[0]
        values = C @ inside
        others = np.setdiff1d(np.arange(m), start)
        lo[others] = np.minimum(lo[others], values[others])
        hi[others] = np.maximum(hi[others], values[others])
        lo[start] = hi[start] = values[start]
    again = rng.integers(0, m, m // 2)
    units = 10.0 ** rng.uniform(-1.0, 1.0, len(again)) * (rng.random(len(again)) < 0.5) + 1.0
    return H, g, np.vstack([C, units[:, None] * C[again]]), np.r_[lo, units * lo[again]], np.r_[
        hi, units * hi[again]]


def _non_convex(rng: np.random.Generator) -> QP:
    """One direction or more in which the cost falls ever faster; the rows may bound it."""
    H, *rest = _convex(rng)
    values, vectors = np.linalg.eigh(H)
    k = int(rng.integers(1, len(values) + 1))
    values[:k] *= -(10.0 ** rng.uniform(-2.0, 0.0, k))
    H = (vectors * values) @ vectors.T
    return 0.5 * (H + H.T), *rest


def _infeasible(rng: np.random.Generator) -> QP:
    """Two rows that contradict each other, or a sum of rows that contradicts them."""
    H, g, C, lo, hi = _convex(rng)
    k = int(rng.integers(1, len(lo) + 1))
    share = rng.exponential(1.0, k)
    most = hi[:k].copy()
    most[~np.isfinite(most)] = 1.0
    hi[:k] = most
    lo[:k] = np.minimum(lo[:k], most)
    gap = 10.0 ** rng.uniform(-2.0, 1.0)
    return H, g, np.vstack([C, share @ C[:k]]), np.append(lo, share @ most + gap), np.append(
        hi, np.inf)


def _broken(rng: np.random.Generator) -> QP:
    """A NaN or an infinity in the data."""
    qp = _convex(rng)
    array = qp[int(rng.integers(4))]
    array.flat[int(rng.integers(array.size))] = rng.choice([np.nan, np.inf])
    return qp


KINDS = {
    "convex": Kind(_convex, True, 0.2),
    "tracking": Kind(_tracking, True, 0.3),
    "scaled by 1e-8 to 1e8": Kind(_scaled, True, 0.2),
    "badly conditioned": Kind(_ill, True, 0.1),
    "degenerate": Kind(_degenerate, True, 0.05),
    "non-convex": Kind(_non_convex, False, 0.05),
    "infeasible": Kind(_infeasible, False, 0.08),
    "not finite": Kind(_broken, False, 0.02),
}
"""All kinds, by name."""


def distance(qp: QP, z: Array) -> float:
    """How far an answer is from the solution of a strictly convex QP at most, by itself alone.

    Args:
        qp: H, g, C, lo, hi.
        z: The answer, shape (n,).

    Returns:
        Relative to 1 + |z| in the norm of H at unit mean eigenvalue [-], or the violation of a
        row, whichever is larger; infinite for an answer that is no number.
    """
    from scipy.optimize import nnls

    H, g, C, lo, hi = qp
    if not np.isfinite(z).all():
        return np.inf
    L = np.linalg.cholesky(H)
    values = C @ z
    short = max(float((lo - values).max()), float((values - hi).max()), 0.0)
    low, high = values - lo <= TOUCHED, hi - values <= TOUCHED
    normals = np.vstack([C[low], -C[high]])
    pull = np.linalg.solve(L, H @ z + g)
    if len(normals):
        # unit columns: the rows' own lengths say nothing
        columns = np.linalg.solve(L, normals.T)
        columns /= np.linalg.norm(columns, axis=0)
        left = float(nnls(columns, pull, maxiter=50 * columns.shape[1])[1])
    else:
        left = float(np.linalg.norm(pull))
    stiffness = np.sqrt(np.trace(H) / len(g))
    return max(short, left / stiffness / (1.0 + float(np.abs(z).max())))


def qps(count: int = 20_000, seed: int = 0, first: str = "proxqp") -> dict[str, Any]:
    """Solve random problems and count what went wrong.

    Args:
        count: Number of problems, shared among `KINDS`.
        seed: Seed.
        first: See `QPSolver`.

    Returns:
        count, seed; solvable: how many have a solution; refused: how many of those got none;
        wrong: how many of the answers to those are not their solution; answered: how many got an
        answer though they have none; slow: how many took more than 5 ms of CPU time; worst_ms,
        p50_us, p99_us; second: how many took the second try; kinds: the same by kind.
    """
    rng = np.random.default_rng(seed)
    names, shares = list(KINDS), np.array([kind.share for kind in KINDS.values()])
    rows: list[tuple[float, ...]] = []
    for index in rng.choice(len(names), count, p=shares / shares.sum()):
        kind = KINDS[names[index]]
        qp = kind.make(rng)
        solver = QPSolver(len(qp[1]), len(qp[3]), first=first)
        if not rows:
            solver.solve(*qp)  # loads the compiled code
        before = time.thread_time_ns()
        result = solver.solve(*qp)
        spent = (time.thread_time_ns() - before) * 1e-3
        wrong = kind.solvable and result.solved and not distance(qp, result.z) <= WRONG
        rows.append((index, spent, result.solved, wrong, result.second))
    table = np.array(rows)
    kinds = {}
    for index, name in enumerate(names):
        own = table[table[:, 0] == index]
        if len(own):
            kinds[name] = _counts(own, KINDS[name].solvable)
    total = {
        key: sum(one[key] for one in kinds.values())
        for key in ("solvable", "refused", "wrong", "answered", "slow", "second")
    }
    times_us = table[:, 1]
    times = {
        "worst_ms": float(times_us.max() * 1e-3),
        "p50_us": float(np.percentile(times_us, 50)),
        "p99_us": float(np.percentile(times_us, 99)),
    }
    return {"count": count, "seed": seed, **total, **times, "kinds": kinds}


def _counts(own: Array, solvable: bool) -> dict[str, Any]:
    """Counts of one kind from its rows."""
    _, spent, solved, wrong, second = own.T
    return {
        "count": len(own),
        "solvable": len(own) if solvable else 0,
        "refused": int((solved == 0).sum()) if solvable else 0,
        "wrong": int(wrong.sum()),
        "answered": 0 if solvable else int(solved.sum()),
        "slow": int((spent > 5000.0).sum()),
        "second": int(second.sum()),
        "worst_ms": float(spent.max() * 1e-3),
    }
