"""Holding the inputs of the single-track model over a period: x' = A x + v becomes x+ = Ad x + G v.

The sizes are those of `bicycle`, written out where that is faster.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import NU, NX
from lpvmpc.units import Array

EXACT, EULER = 0, 1
"""Methods: exact, or the paper's Euler."""


@njit(cache=True)
def hold(A_in, inputs, Ts, method, Ad_out, inputs_out):
    """Zero-order hold of a linear system over one period, in place.

    x+ = Ad x + G v  for x' = A x + v,   Ad = exp(A Ts),   G = integral of exp(A t) dt over Ts

    The exact hold sums the series of G to order 6 on Ts / 2^n (three matrix products, after
    Paterson and Stockmeyer) and doubles it n times: Ad(2h) = Ad(h)^2, G(2h) = G(h) + Ad(h) G(h).
    n comes from the norms of A^2 and A^3, which see the cancellation that the norm of A does not.
    The truncation error is below 1e-6 of the largest entry.

    Args:
        A_in: System matrix, shape (11, 11).
        inputs: Columns v that are held constant: of the two inputs and a constant, shape (11, 3).
        Ts: Period [s].
        method: EXACT, or EULER for Ad = I + A Ts, G = I Ts as printed in the paper's eq. 9.
        Ad_out: Receives Ad, shape (11, 11).
        inputs_out: Receives G times each column, shape (11, 3).

    Source: Al-Mohy and Higham, A new scaling and squaring algorithm for the matrix exponential,
    SIAM J. Matrix Anal. Appl. 31 (2009); doubling of G by splitting the integral.
    """
    if method == EULER:
        for i in range(NX):
            for j in range(NX):
                Ad_out[i, j] = A_in[i, j] * Ts
            Ad_out[i, i] += 1.0
            for j in range(NU + 1):
                inputs_out[i, j] = inputs[i, j] * Ts
        return
    M, M2, M3 = A_in * Ts, np.empty((NX, NX)), np.empty((NX, NX))
    _product(M, M, M2)
    _product(M, M2, M3)
    size = max(_norm(M2) ** (1.0 / 2.0), _norm(M3) ** (1.0 / 3.0))
    doublings = 0
    h = 1.0
    while size * h > 0.6 and doublings < 30:
        h *= 0.5
        doublings += 1
    # S = sum of M^k / (k + 1)!, k = 0..6, so that G = Ts S and Ad = I + M S
    h2, h3 = h * h, h * h * h
    S, tail, square = np.empty((NX, NX)), np.empty((NX, NX)), np.empty((NX, NX))
    for i in range(NX):
        for j in range(NX):
            m1, m2 = h * M[i, j], h2 * M2[i, j]
            M[i, j] = m1
            M3[i, j] *= h3
            M2[i, j] = m1 / 2.0 + m2 / 6.0
            tail[i, j] = m1 / 120.0 + m2 / 720.0 + M3[i, j] / 5040.0
        M2[i, i] += 1.0
        tail[i, i] += 1.0 / 24.0
    _product(M3, tail, S)
    for i in range(NX):
        for j in range(NX):
            S[i, j] += M2[i, j]
    _product(M, S, Ad_out)
    for i in range(NX):
        Ad_out[i, i] += 1.0
    held = np.empty((NX, NU + 1))
    _apply(S, inputs, held)
    for i in range(NX):
        for j in range(NU + 1):
            inputs_out[i, j] = h * Ts * held[i, j]
    for _ in range(doublings):
        _apply(Ad_out, inputs_out, held)
        for i in range(NX):
            for j in range(NU + 1):
                inputs_out[i, j] += held[i, j]
        _product(Ad_out, Ad_out, square)
        for i in range(NX):
            for j in range(NX):
                Ad_out[i, j] = square[i, j]


@njit(cache=True)
def _apply(matrix, columns, out):
    """Multiply: out = matrix columns, for the columns of two inputs and a constant."""
    for i in range(NX):
        first, second, constant = 0.0, 0.0, 0.0
        for k in range(NX):
            a = matrix[i, k]
            if a != 0.0:
                first += a * columns[k, 0]
                second += a * columns[k, 1]
                constant += a * columns[k, 2]
        out[i, 0], out[i, 1], out[i, 2] = first, second, constant


@njit(cache=True)
def _product(left, right, out):
    """Multiply: out = left right, of size NX; skips zeros on the left, where the LPV form has many.

    A row of the result is kept in eleven local numbers instead of a loop over columns: the
    compiler cannot know that the arrays do not overlap, and this is 1.6 times faster.
    """
    for n in range(NX):
        a = b = c = d = e = f = g = h = i = j = k = 0.0
        for m in range(NX):
            v = left[n, m]
            if v != 0.0:
                a += v * right[m, 0]
                b += v * right[m, 1]
                c += v * right[m, 2]
                d += v * right[m, 3]
                e += v * right[m, 4]
                f += v * right[m, 5]
                g += v * right[m, 6]
                h += v * right[m, 7]
                i += v * right[m, 8]
                j += v * right[m, 9]
                k += v * right[m, 10]
        out[n, 0], out[n, 1], out[n, 2], out[n, 3], out[n, 4], out[n, 5] = a, b, c, d, e, f
        out[n, 6], out[n, 7], out[n, 8], out[n, 9], out[n, 10] = g, h, i, j, k


_UNITS = (1.0, 1.0, 0.3, 1.0, 0.1, 0.1, 1.0, 0.1, 0.1, 0.1, 1.0)
"""Units of the states in which forces, rates and slips weigh alike; the norm is then near the
spectral radius, three times smaller than in SI units, and the hold needs one or two doublings."""


@njit(cache=True)
def _norm(matrix):
    """Largest absolute row sum in balanced units."""
    worst = 0.0
    for i in range(NX):
        row = 0.0
        for j in range(NX):
            row += abs(matrix[i, j]) * _UNITS[j]
        worst = max(worst, row / _UNITS[i])
    return worst


def discretise(A: Array, B: Array, c: Array, Ts: float) -> tuple[Array, Array, Array]:
    """Exact zero-order hold of x' = A x + B u + c.

    Args:
        A: System matrix, shape (nx, nx).
        B: Input matrix, shape (nx, nu).
        c: Constant term, shape (nx,).
        Ts: Period [s].

    Returns:
        Ad, Bd, cd of x+ = Ad x + Bd u + cd, shapes as given.
    """
    columns = np.column_stack([B, c])
    Ad, held = np.empty((NX, NX)), np.zeros_like(columns)
    for first in range(0, columns.shape[1], NU + 1):
        some = np.zeros((NX, NU + 1))
        width = columns[:, first : first + NU + 1].shape[1]
        some[:, :width] = columns[:, first : first + width]
        out = np.empty_like(some)
        hold(A, some, Ts, EXACT, Ad, out)
        held[:, first : first + width] = out[:, :width]
    return Ad, held[:, :-1], held[:, -1]
