"""A dual active-set method for small strictly convex quadratic programs.

It starts at the unconstrained optimum and takes in one violated row after the other, each time
along the shortest way that keeps the multipliers' signs; so it ends after finitely many steps, with
a solution to the last digits or the proof that there is none. It depends neither on a guess nor on
the unit of the cost, and knows no tolerance of convergence.

Source: Goldfarb, Idnani, A numerically stable dual method for solving strictly convex quadratic
programs, Mathematical Programming 27, 1983.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lpvmpc.control.solver.optimality import backward, forward

SOLVED, INFEASIBLE, MAX_STEPS = range(3)
"""How `solve` ended."""
DEPENDENT = 1e-20
"""Square of the part of a row's normal that counts as none: what rounding leaves of it."""
REFINED = 3
"""So often at most an answer is refined, and rows that it then violates are taken in."""


@njit(cache=True, error_model="numpy")
def solve(U, H, g, C, lo, hi, tolerance, max_steps, z, y):
    """Solve  min 0.5 z'Hz + g'z  s.t.  lo <= Cz <= hi.

    Args:
        U: Upper triangular factor of the Hessian, H = U'U, shape (n, n).
        H: Hessian, shape (n, n).
        g: Gradient, shape (n,).
        C: Constraint matrix, shape (m, n).
        lo: Lower bounds, shape (m,), -inf allowed.
        hi: Upper bounds, shape (m,), inf allowed, none below `lo`.
        tolerance: Violation of a row that is none.
        max_steps: Most steps.
        z: Receives the solution, shape (n,).
        y: Receives the multipliers, positive at upper bounds, shape (m,).

    Returns:
        SOLVED, INFEASIBLE or MAX_STEPS; with the last two z and y are no solution. And the number
        of steps.
    """
    n, m = g.shape[0], lo.shape[0]
    # rows k of W: the columns of U^-1 times an orthogonal matrix, of which the first q span the
    # active normals: W N = [R; 0]
    W, R = np.empty((n, n)), np.empty((n, n))
    z[:] = -g
    forward(U, z)
    backward(U, z)
    q = 0
    active, side = np.empty(n, np.int64), np.empty(n)
    force, push = np.zeros(n + 1), np.zeros(n)
    held = np.zeros(m, np.bool_)
    size = np.ones(m)
    normal, d, move = np.empty(n), np.empty(n), np.empty(n)
    steps, refined, clean = 0, 0, False
    while True:
        # the row that is violated most, by its distance
        values = C @ z
        worst, chosen, sign = 0.0, -1, 1.0
        for i in range(m):
            if held[i]:
                continue
            below, above = lo[i] - values[i], values[i] - hi[i]
            violation = max(below, above)
            if violation > tolerance and violation > worst * size[i]:
                if steps == 0 and chosen < 0:  # most problems come to their end without
                    _start(U, C, W, R, size)
                if size[i] == 0.0:
                    return INFEASIBLE, steps
                worst, chosen, sign = violation / size[i], i, 1.0 if below > above else -1.0
        if chosen < 0:
            if clean or refined == REFINED:
                break
            clean = True
            refined += 1
            if q == 0:
                move[:] = -(g + H @ z)
                forward(U, move)
                backward(U, move)
                z += move
                continue
            _refine(W, R, H, g, C, lo, hi, active, side, force, q, z)
            continue
        clean = False
        for a in range(n):
            normal[a] = sign * C[chosen, a]
        missing = worst * size[chosen]
        force[q] = 0.0
        while True:
            steps += 1
            if steps > max_steps:
                return MAX_STEPS, steps
            total = rest = 0.0
            for k in range(n):
                x = 0.0
                for a in range(n):
                    x += W[k, a] * normal[a]
                d[k] = x
                total += x * x
                if k >= q:
                    rest += x * x
            for i in range(q - 1, -1, -1):
                x = d[i]
                for j in range(i + 1, q):
                    x -= R[i, j] * push[j]
                push[i] = x / R[i, i]
            # how far until a multiplier is zero, and until the row holds
            dual, leaving = np.inf, -1
            for i in range(q):
                if push[i] > 0.0 and side[i] != 0.0 and force[i] < dual * push[i]:
                    dual, leaving = force[i] / push[i], i
            primal = missing / rest if rest > DEPENDENT * total else np.inf
            step = min(dual, primal)
            if step == np.inf:
                return INFEASIBLE, steps
            for i in range(q):
                force[i] -= step * push[i]
            force[q] += step
            if primal < np.inf:
                move[:] = 0.0
                for k in range(q, n):
                    for a in range(n):
                        move[a] += d[k] * W[k, a]
                for a in range(n):
                    z[a] += step * move[a]
                missing -= step * rest
            if primal <= dual:
                break
            held[active[leaving]] = False
            _drop(W, R, active, side, force, leaving, q)
            q -= 1
        _add(W, R, d, q)
        active[q] = chosen
        # a row that is an equation is never left, on whichever side it was met
        side[q] = sign if lo[chosen] < hi[chosen] else 0.0
        if side[q] == 0.0 and sign < 0.0:
            _flip(R, force, q)
        held[chosen] = True
        q += 1
    y[:] = 0.0
    for i in range(q):
        y[active[i]] = -force[i] if side[i] >= 0.0 else force[i]
    return SOLVED, steps


@njit(cache=True, error_model="numpy")
def _start(U, C, W, R, size):
    """The inverse of U and the lengths of the rows, in place."""
    n = len(U)
    R[:] = 0.0
    W[:] = 0.0
    for k in range(n):
        W[k, k] = 1.0 / U[k, k]
        for j in range(k - 1, -1, -1):
            x = 0.0
            for i in range(j + 1, k + 1):
                x += U[j, i] * W[k, i]
            W[k, j] = -x / U[j, j]
    for i in range(len(C)):
        length = 0.0
        for a in range(n):
            length += C[i, a] * C[i, a]
        size[i] = np.sqrt(length)


@njit(cache=True, error_model="numpy")
def _flip(R, force, q):
    """Turn the normal of the row taken in last, in place."""
    for i in range(q + 1):
        R[i, q] = -R[i, q]
    force[q] = -force[q]


@njit(cache=True, error_model="numpy")
def _rotate(c, s, a, b):
    """Turn two rows into each other, in place."""
    for i in range(len(a)):
        x, y = a[i], b[i]
        a[i], b[i] = c * x + s * y, c * y - s * x


@njit(cache=True, error_model="numpy")
def _add(W, R, d, q):
    """Take in a normal whose image under W is d, as column q of R, in place."""
    for k in range(len(d) - 1, q, -1):
        if d[k] == 0.0:
            continue
        length = np.hypot(d[k - 1], d[k])
        _rotate(d[k - 1] / length, d[k] / length, W[k - 1], W[k])
        d[k - 1] = length
    for i in range(q + 1):
        R[i, q] = d[i]


@njit(cache=True, error_model="numpy")
def _drop(W, R, active, side, force, leaving, q):
    """Leave an active row, of q; the multiplier of the row to come moves along. In place."""
    for j in range(leaving, q - 1):
        active[j], side[j], force[j] = active[j + 1], side[j + 1], force[j + 1]
        for i in range(j + 2):
            R[i, j] = R[i, j + 1]
    force[q - 1] = force[q]
    for j in range(leaving, q - 1):
        length = np.hypot(R[j, j], R[j + 1, j])
        if length == 0.0:
            continue
        c, s = R[j, j] / length, R[j + 1, j] / length
        _rotate(c, s, W[j], W[j + 1])
        _rotate(c, s, R[j, j : q - 1], R[j + 1, j : q - 1])


@njit(cache=True, error_model="numpy")
def _refine(W, R, H, g, C, lo, hi, active, side, force, q, z):
    """One step of iterative refinement on the active rows: solution and multipliers, in place."""
    n = len(z)
    error = -(g + H @ z)
    short, push = np.empty(q), np.empty(q)
    for i in range(q):
        row = C[active[i]]
        value = 0.0
        sign = -1.0 if side[i] < 0.0 else 1.0
        for a in range(n):
            value += row[a] * z[a]
            error[a] += sign * row[a] * force[i]
        short[i] = lo[active[i]] - value if sign > 0.0 else value - hi[active[i]]
    for i in range(q):  # R'x = short
        x = short[i]
        for j in range(i):
            x -= R[j, i] * short[j]
        short[i] = x / R[i, i]
    turned = W @ error
    for i in range(q - 1, -1, -1):
        x = short[i] - turned[i]
        for j in range(i + 1, q):
            x -= R[i, j] * push[j]
        push[i] = x / R[i, i]
    for i in range(q):
        force[i] += push[i]
        turned[i] = short[i]
    for a in range(n):
        value = 0.0
        for k in range(n):
            value += W[k, a] * turned[k]
        z[a] += value
