"""The condensed quadratic program of a linear tracking MPC, and ProxQP solving it.

Knows nothing of cars: a time-varying affine system x+ = Ad x + Bd u + cd, diagonal weights on
states and on input increments, hard bounds on inputs and increments, and one soft bound on one
state, relaxed by a single slack. The decision vector is z = (u_0, ..., u_{N-1}, slack), with
inputs divided by `scale` so that all entries are of order one.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from lpvmpc.errors import OptionError
from lpvmpc.units import Array

# ProxQP's AVX builds round differently at different memory addresses, so that the last bits of a
# solution with active bounds change from process to process. The build without is as fast for
# problems of this size, and gives the same bits always and on any x86 processor.
for _build in ("avx512", "avx2"):
    sys.modules.setdefault(f"proxsuite.proxsuite_pywrap_{_build}", None)  # type: ignore[arg-type]
import proxsuite  # noqa: E402


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


@njit(cache=True)
def kkt_residual(H, g, C, lo, hi, z, y):
    """Largest violation of the optimality conditions of  min 0.5 z'Hz + g'z, lo <= Cz <= hi.

    The largest of |Hz + g + C'y|, the bound violation, wrong-signed multipliers on one-sided
    rows, and complementarity |y| min(1, slack of the bound that y belongs to): y > 0 belongs to
    the upper bound. Dual quantities are relative to 1 + |g|.

    Args:
        H: Hessian, shape (n, n).
        g: Gradient, shape (n,).
        C: Constraint matrix, shape (m, n).
        lo: Lower bounds, shape (m,).
        hi: Upper bounds, shape (m,).
        z: Primal solution, shape (n,).
        y: Multipliers, shape (m,).

    Returns:
        The residual [-]; NaN if anything in z or y is.
    """
    n, m = g.shape[0], lo.shape[0]
    Hz, yC, values = H @ z, y @ C, C @ z
    size, worst = 0.0, 0.0
    for a in range(n):
        size = max(size, abs(g[a]))
    size += 1.0
    for i in range(m):
        violation = max(lo[i] - values[i], values[i] - hi[i])
        gap = hi[i] - values[i] if y[i] > 0.0 else values[i] - lo[i]
        worst = _larger(worst, violation)
        worst = _larger(worst, abs(y[i]) * min(1.0, abs(gap)) / size)
    for a in range(n):
        worst = _larger(worst, abs(g[a] + Hz[a] + yC[a]) / size)
    return worst


@njit(cache=True)
def _larger(a, b):
    """The larger of two numbers; NaN if either is."""
    if np.isnan(a) or a >= b:
        return a
    return b


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


@njit(cache=True)
def all_finite(H, g, C, lo, hi):
    """Whether a QP can be handed to a solver: no NaN anywhere, no infinity but in the bounds."""
    total = 0.0  # a NaN or an infinity survives any sum
    for array in (H, C):
        for row in range(array.shape[0]):
            total += _magnitude(array[row])
    for value in g:
        total += abs(value)
    if not total < np.inf:
        return False
    for i in range(len(lo)):
        # a comparison with NaN is false
        if not (lo[i] < np.inf and hi[i] > -np.inf):
            return False
    return True


AGAIN = 0.01
"""Factor on ProxQP's own residuals where its first answer is not optimal by our measure."""
SOLVED = proxsuite.proxqp.PROXQP_SOLVED
"""The only status that counts as success."""


@dataclass
class QPResult:
    """Outcome of one solve; `z` is meaningful only when `solved` is true."""

    z: Array
    """Solution, shape (n,)."""
    solved: bool
    """ProxQP said SOLVED and our own optimality check agrees."""
    status: str
    """ProxQP's status, `NOT_FINITE` when it was not asked, or `WRONG` when our check refuses."""
    residual: float
    """KKT residual from `kkt_residual` [-]; NaN when there is no solution."""
    solve_us: float
    """Thread CPU time in ProxQP [us]."""
    check_us: float
    """Thread CPU time in the two checks [us]."""
    iterations: int = 0
    """ProxQP's inner iterations."""


class QPSolver:
    """One ProxQP object for a sequence of QPs of one size.

    ProxQP's status is not trusted alone: its duality gap is a signed sum that can cancel, so every
    solution passes `kkt_residual`. One that does not is asked for once more, with `AGAIN` of the
    residuals: 81 of 12,000 random problems, of which that solves 79. Data that are not finite are
    refused before the call, since they would poison the object. Each solve starts from the
    equality-constrained guess: warm starts give wrong answers now and then, and make a result
    depend on its history.

    Source: Bambade et al., PROX-QP, RSS 2022.
    """

    def __init__(self, n: int, m: int, tolerance: float = 1e-6, max_iter: int = 50) -> None:
        """Args: number of variables and rows, KKT tolerance, and the iteration limit."""
        if not (np.isfinite(tolerance) and 0.0 < tolerance < 1.0):
            raise OptionError("QP tolerance", tolerance, "a number between 0 and 1")
        if max_iter < 1:
            raise OptionError("QP max_iter", max_iter, "at least 1")
        self.n, self.m, self.tolerance, self.max_iter = n, m, tolerance, max_iter
        self._prox: proxsuite.proxqp.dense.QP | None = None
        self._first: tuple[Array, ...] = ()  # the QP that ProxQP scales all later ones by

    def reset(self) -> None:
        """Forget the solver's history, so that the next solve depends on its data alone."""
        self._prox = None

    def solve(self, H: Array, g: Array, C: Array, lo: Array, hi: Array) -> QPResult:
        """Solve  min 0.5 z'Hz + g'z  s.t.  lo <= Cz <= hi.

        Args:
            H: Hessian, shape (n, n), symmetric positive definite.
            g: Gradient, shape (n,).
            C: Constraint matrix, shape (m, n).
            lo: Lower bounds, shape (m,), -inf allowed.
            hi: Upper bounds, shape (m,), inf allowed.

        Returns:
            The result; never raises for a solver that does not finish.
        """
        start = time.thread_time_ns()
        if not all_finite(H, g, C, lo, hi):
            self._prox = None
            spent = (time.thread_time_ns() - start) * 1e-3
            return QPResult(np.full(self.n, np.nan), False, "NOT_FINITE", np.nan, 0.0, spent)
        checked = time.thread_time_ns()
        prox = self._prox
        if prox is None:
            prox = self._begin(H, g, C, lo, hi)
        else:
            prox.update(H=H, g=g, C=C, l=lo, u=hi)
        prox.solve()
        solved = time.thread_time_ns()
        z = self._z.copy()
        residual = kkt_residual(H, g, C, lo, hi, z, self._y)
        good, name = self._info.status == SOLVED, "SOLVED"
        if good and not residual <= self.tolerance:
            prox.settings.eps_abs *= AGAIN
            prox.settings.eps_duality_gap_abs *= AGAIN
            prox.solve()
            z = self._z.copy()
            residual = kkt_residual(H, g, C, lo, hi, z, self._y)
            good = self._info.status == SOLVED
            self._prox = None  # its settings are not those of the next solve
            solved = time.thread_time_ns()
        if not good:
            name = str(self._info.status).rsplit(".", 1)[-1].removeprefix("PROXQP_")
        elif not residual <= self.tolerance:
            good, name = False, "WRONG"
        iterations = self._info.iter
        if not good:
            self._prox = None
        done = time.thread_time_ns()
        check_us = (checked - start + done - solved) * 1e-3
        return QPResult(z, good, name, residual, (solved - checked) * 1e-3, check_us, iterations)

    def __getstate__(self) -> dict[str, Any]:
        """All but ProxQP's object; the QP that it began with makes the same one again."""
        kept = {name: getattr(self, name) for name in ("n", "m", "tolerance", "max_iter")}
        return kept | {"_first": () if self._prox is None else self._first}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A solver that answers as the one that was copied."""
        vars(self).update(state)
        self._prox = None
        if self._first:
            self._begin(*self._first)

    def _begin(self, *qp: Array) -> proxsuite.proxqp.dense.QP:
        """A new ProxQP object, scaled by its first QP (H, g, C, lo, hi)."""
        prox = self._prox = self._new_solver()
        H, g, C, lo, hi = self._first = tuple(array.copy() for array in qp)
        prox.init(H=H, g=g, C=C, l=lo, u=hi)
        # views of ProxQP's own memory: asking for them again each time costs 5 us
        self._z, self._y, self._info = prox.results.x, prox.results.z, prox.results.info
        return prox

    def _new_solver(self) -> proxsuite.proxqp.dense.QP:
        prox = proxsuite.proxqp.dense.QP(
            self.n,
            0,
            self.m,
            False,
            proxsuite.proxqp.dense.HessianType.Dense,
            proxsuite.proxqp.dense.DenseBackend.PrimalDualLDLT,
        )
        settings = prox.settings
        guess = proxsuite.proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
        settings.initial_guess = guess
        # ProxQP's own accuracy is set well below ours: its norms are scaled, ours are not
        settings.eps_abs = 0.1 * self.tolerance
        settings.eps_rel = 0.0
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs = self.tolerance
        settings.eps_duality_gap_rel = 0.0
        # Our QPs are feasible by construction (soft state bound, reachable input bounds), and the
        # test for infeasibility is wrong now and then: in 12 of 800 random problems.
        settings.eps_primal_inf = 1e-16
        # The unconstrained guess then meets the tolerance at once where no bound is active.
        settings.default_rho = 1e-8
        settings.default_mu_in = 1e-4
        settings.max_iter = self.max_iter
        settings.max_iter_in = self.max_iter
        return prox
