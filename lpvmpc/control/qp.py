"""The condensed quadratic program of a linear tracking MPC.

Knows nothing of cars: a time-varying affine system x+ = Ad x + Bd u + cd, diagonal weights on
states and on input increments, hard bounds on inputs and increments, and one soft bound on one
state, relaxed by a single slack. The decision vector is z = (u_0, ..., u_{N-1}, slack), with
inputs divided by `scale` so that all entries are of order one.
"""

from __future__ import annotations

import numpy as np
from numba import njit


def n_rows(N: int, nu: int, n_rates: int, soft_every: int = 1) -> int:
    """Number of constraint rows: inputs, bounded increments, soft bound on both sides, slack."""
    return N * nu + N * n_rates + 2 * (N // soft_every) + 1


@njit(cache=True)
def condense(h):
    """Write the QP  min 0.5 z'Hz + g'z  s.t.  lo <= Cz <= hi  of one control period, in place.

    sum_{k=1..N} |x_k - x_ref_k|^2_q + sum_{k=0..N-1} |u_k - u_{k-1}|^2_r_du
        + |(x_N, u_{N-1}) - z_ref|^2_terminal + slack_weights[0] slack + slack_weights[1] slack^2

    for x_{k+1} = Ad_k x_k + Bd_k u_k + cd_k from the last nx states of schedule[0], with
    u_{-1} = queue[-1].

    Rows in order: inputs (N nu), increments (N n_rates), upper soft bound (N / soft_every), lower
    soft bound (the same), slack >= 0 (1).

    Args:
        h: Handle of a `Horizon`. Read are Ad, Bd, cd, schedule, queue, x_ref, q, r_du, terminal,
            z_ref, slack_weights, u_lo, u_hi, du_max, soft, soft_every, soft_bound and scale;
            written are H, g, C, lo, hi, free and forced.

    Source: Maciejowski, Predictive Control with Constraints, chapter 3.
    """
    Ad, Bd, cd, x_ref, q, r_du, scale = h.Ad, h.Bd, h.cd, h.x_ref, h.q, h.r_du, h.scale
    terminal, z_ref, slack_weights, du_max = h.terminal, h.z_ref, h.slack_weights, h.du_max
    u_lo, u_hi, soft, soft_bound, soft_every = h.u_lo, h.u_hi, h.soft, h.soft_bound[0], h.soft_every
    H, g, C, lo, hi, free, forced = h.H, h.g, h.C, h.lo, h.hi, h.free, h.forced
    u_prev = h.queue[-1]
    x0 = h.schedule[0, h.schedule.shape[1] - Bd.shape[1] :]
    N, nx, nu = Bd.shape
    n = N * nu + 1
    forced[:] = 0.0
    # responses of the states to x0 and to each input
    for k in range(N):
        for i in range(nx):
            value = cd[k, i]
            for j in range(nx):
                value += Ad[k, i, j] * (x0[j] if k == 0 else free[k - 1, j])
            free[k, i] = value
            for m in range(nu):
                forced[k, i, k * nu + m] = Bd[k, i, m] * scale[m]
            if k > 0:
                for j in range(nx):
                    a = Ad[k, i, j]
                    if a != 0.0:
                        for col in range(k * nu):
                            forced[k, i, col] += a * forced[k - 1, j, col]
    # cost
    H[:] = 0.0
    g[:] = 0.0
    for k in range(N):
        for i in range(nx):
            w = q[k, i]
            if w == 0.0:
                continue
            error = free[k, i] - x_ref[k, i]
            for a in range((k + 1) * nu):
                fa = w * forced[k, i, a]
                g[a] += 2.0 * fa * error
                for b in range(a + 1):
                    H[a, b] += 2.0 * fa * forced[k, i, b]
    nz = nx + nu
    error_N = np.empty(nz)
    last = np.zeros((nz, N * nu))
    for i in range(nx):
        error_N[i] = free[N - 1, i] - z_ref[i]
        for a in range(N * nu):
            last[i, a] = forced[N - 1, i, a]
    for m in range(nu):
        error_N[nx + m] = -z_ref[nx + m]
        last[nx + m, (N - 1) * nu + m] = scale[m]
    weighted = np.zeros(N * nu)
    for i in range(nz):
        weighted[:] = 0.0
        pull = 0.0
        for j in range(nz):
            w = 2.0 * terminal[i, j]
            if w != 0.0:
                pull += w * error_N[j]
                for a in range(N * nu):
                    weighted[a] += w * last[j, a]
        for a in range(N * nu):
            v = last[i, a]
            if v != 0.0:
                g[a] += v * pull
                for b in range(a + 1):
                    H[a, b] += v * weighted[b]
    for k in range(N):
        for m in range(nu):
            a = k * nu + m
            w = 2.0 * r_du[m] * scale[m] ** 2
            H[a, a] += w
            if k == 0:
                g[a] -= w * u_prev[m] / scale[m]
            else:
                H[a - nu, a - nu] += w
                H[a, a - nu] -= w
    for a in range(n):
        for b in range(a):
            H[b, a] = H[a, b]
    g[n - 1] = slack_weights[0]
    H[n - 1, n - 1] = 2.0 * slack_weights[1]
    # constraints
    C[:] = 0.0
    n_rates = len(du_max)
    rate = N * nu
    upper = rate + N * n_rates
    n_soft = N // soft_every
    lower = upper + n_soft
    for k in range(N):
        for m in range(nu):
            a = k * nu + m
            C[a, a] = 1.0
            lo[a] = u_lo[k, m] / scale[m]
            hi[a] = u_hi[k, m] / scale[m]
            if m >= n_rates:
                continue
            row = rate + k * n_rates + m
            C[row, a] = 1.0
            lo[row] = -du_max[m] / scale[m]
            hi[row] = du_max[m] / scale[m]
            if k == 0:
                lo[row] += u_prev[m] / scale[m]
                hi[row] += u_prev[m] / scale[m]
            else:
                C[row, a - nu] = -1.0
    for i in range(n_soft):
        k = (i + 1) * soft_every - 1
        for a in range((k + 1) * nu):
            C[upper + i, a] = forced[k, soft, a]
            C[lower + i, a] = forced[k, soft, a]
        C[upper + i, n - 1] = -1.0
        C[lower + i, n - 1] = 1.0
        lo[upper + i] = -np.inf
        hi[upper + i] = soft_bound - free[k, soft]
        lo[lower + i] = -soft_bound - free[k, soft]
        hi[lower + i] = np.inf
    C[lower + n_soft, n - 1] = 1.0
    lo[lower + n_soft] = 0.0
    hi[lower + n_soft] = np.inf
