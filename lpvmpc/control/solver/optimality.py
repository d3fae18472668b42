"""Whether a quadratic program can be solved, and whether an answer is its solution.

min 0.5 z'Hz + g'z  s.t.  lo <= Cz <= hi, with H symmetric positive definite. Nothing here trusts
what a solver says of itself, and no tolerance depends on the unit of the cost.
"""

from __future__ import annotations

import numpy as np
from numba import njit

GOOD, NOT_FINITE, NOT_CONVEX, CROSSED = range(4)
"""What `factor` finds: a QP for the solver; one with a NaN or an infinity; one whose cost has no
least value or more than one; one with a lower bound above the upper."""
ROUNDING = 1e-14
"""Least pivot of a convex Hessian relative to its diagonal: what rounding leaves of zero."""


@njit(cache=True)
def _magnitude(row):
    """Sum of absolute values, in four parts that the processor adds at the same time."""
    a = b = c = d = 0.0
    n = len(row)
    for i in range(0, n - 3, 4):
        a += abs(row[i])
        b += abs(row[i + 1])
        c += abs(row[i + 2])
        d += abs(row[i + 3])
    for i in range(n - n % 4, n):
        a += abs(row[i])
    return (a + b) + (c + d)


@njit(cache=True, error_model="numpy")
def factor(H, g, C, lo, hi, U):
    """Whether a QP can be handed to a solver, and the Cholesky factor of its Hessian, in place.

    Args:
        H: Hessian, shape (n, n); symmetric, its upper triangle is read.
        g: Gradient, shape (n,).
        C: Constraint matrix, shape (m, n).
        lo: Lower bounds, shape (m,), -inf allowed.
        hi: Upper bounds, shape (m,), inf allowed.
        U: Receives the upper triangular factor, H = U'U, shape (n, n).

    Returns:
        GOOD, NOT_FINITE, NOT_CONVEX or CROSSED.
    """
    n, m = g.shape[0], lo.shape[0]
    total = 0.0  # a NaN or an infinity survives any sum
    for row in range(n):
        total += _magnitude(H[row]) + abs(g[row])
    for row in range(m):
        total += _magnitude(C[row])
    if not total < np.inf:
        return NOT_FINITE
    crossed = False
    for i in range(m):
        # a comparison with NaN is false
        if not (lo[i] < np.inf and hi[i] > -np.inf):
            return NOT_FINITE
        if lo[i] > hi[i]:
            crossed = True
    for k in range(n):
        row, i = U[k], 0
        for j in range(k, n):
            row[j] = H[k, j]
        while i + 3 < k:  # four rows at a time: half the time
            u, v, w, x = U[i], U[i + 1], U[i + 2], U[i + 3]
            fu, fv, fw, fx = u[k], v[k], w[k], x[k]
            for j in range(k, n):
                row[j] -= (fu * u[j] + fv * v[j]) + (fw * w[j] + fx * x[j])
            i += 4
        while i < k:
            u = U[i]
            fu = u[k]
            for j in range(k, n):
                row[j] -= fu * u[j]
            i += 1
        pivot = row[k]
        if not pivot > ROUNDING * H[k, k]:
            return NOT_CONVEX
        pivot = 1.0 / np.sqrt(pivot)
        for j in range(k, n):
            row[j] *= pivot
    return CROSSED if crossed else GOOD


@njit(cache=True, error_model="numpy")
def forward(U, b):
    """Solve U'x = b, in place."""
    n = b.shape[0]
    for i in range(n):
        x = b[i] / U[i, i]
        b[i] = x
        for j in range(i + 1, n):
            b[j] -= U[i, j] * x


@njit(cache=True, error_model="numpy")
def backward(U, b):
    """Solve Ux = b, in place."""
    n = b.shape[0]
    for i in range(n - 1, -1, -1):
        x = b[i]
        for j in range(i + 1, n):
            x -= U[i, j] * b[j]
        b[i] = x / U[i, i]


@njit(cache=True, error_model="numpy")
def judge(H, g, C, lo, hi, z, y, U):
    """Largest violation of the optimality conditions, and how far the solution may be.

    The residual is the largest of |Hz + g + C'y|, the bound violation, wrong-signed multipliers on
    one-sided rows, and complementarity |y| min(1, slack of the bound that y belongs to): y > 0
    belongs to the upper bound. Dual quantities are relative to 1 + |g|.

    That depends on the unit of the cost; the distance does not. An answer that misses the
    conditions is the solution of a QP with another gradient and other bounds: the distance is the
    largest of the bound violation; of what the rest of the gradient moves the unconstrained optimum
    by, |H^-1 (Hz + g + C'y)|; and, where a multiplier belongs to a bound that its row does not
    touch, of the smaller of moving the bound there and of what leaving the multiplier out moves the
    row by, min(gap, |y| c'H^-1 c). All are in units of z and of the rows.

    Args:
        H: Hessian, shape (n, n).
        g: Gradient, shape (n,).
        C: Constraint matrix, shape (m, n).
        lo: Lower bounds, shape (m,).
        hi: Upper bounds, shape (m,).
        z: Primal solution, shape (n,).
        y: Multipliers, shape (m,).
        U: From `factor`.

    Returns:
        The residual and the distance [-]; NaN if anything in z or y is.
    """
    n, m = g.shape[0], lo.shape[0]
    Hz, values = H @ z, C @ z
    size, worst, far, bound = 0.0, 0.0, 0.0, False
    for a in range(n):
        size = max(size, abs(g[a]))
    size += 1.0
    moved = np.empty(n)
    for i in range(m):
        violation = max(lo[i] - values[i], values[i] - hi[i])
        gap = hi[i] - values[i] if y[i] > 0.0 else values[i] - lo[i]
        worst = _larger(worst, violation)
        far = _larger(far, violation)
        if y[i] == 0.0:
            continue
        bound = True
        worst = _larger(worst, abs(y[i]) * min(1.0, abs(gap)) / size)
        if abs(gap) > far:
            for a in range(n):
                moved[a] = C[i, a]
            forward(U, moved)
            stiff = 0.0
            for a in range(n):
                stiff += moved[a] * moved[a]
            far = _larger(far, min(abs(gap), abs(y[i]) * stiff))
    for a in range(n):
        moved[a] = g[a] + Hz[a]
    if bound:
        moved += y @ C
    for a in range(n):
        worst = _larger(worst, abs(moved[a]) / size)
    forward(U, moved)
    backward(U, moved)
    for a in range(n):
        far = _larger(far, abs(moved[a]))
    return worst, far


@njit(cache=True)
def _larger(a, b):
    """The larger of two numbers; NaN if either is."""
    if np.isnan(a) or a >= b:
        return a
    return b
