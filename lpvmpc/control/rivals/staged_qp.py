"""The quadratic program of a tracking MPC in its stages, and HPIPM solving it through CasADi.

Where `control.qp` eliminates the states, here they stay, and the solver goes through the horizon
stage by stage: its time grows with N, not with its cube. The variables in their order are

    v = (du_0, [x_1, u_0, du_1], [x_2, u_1, du_2], ..., [x_N, u_{N-1}]),

so that bounds on inputs and on their increments are bounds on variables, and the equations

    x_{k+1} = Ad_k x_k + Bd_k (u_{k-1} + du_k) + cd_k,   u_k = u_{k-1} + du_k.

Source: Frison, Diehl, HPIPM: a high-performance quadratic programming framework for model
predictive control, IFAC 2020; Andersson et al., CasADi, Math. Prog. Comp. 11 (2019).
"""

from __future__ import annotations

import time
from importlib import import_module
from typing import Any

import numpy as np
from numba import njit

from lpvmpc.errors import LPVMPCError
from lpvmpc.units import Array

ITERATIONS = 40
"""Most iterations of the interior-point method; it takes about ten."""
UNBOUNDED = 1e4
"""Bound of what has none: HPIPM as CasADi calls it does not stop where a bound is infinite."""
MISSING = (
    "Controller {name!r} solves its problem by CasADi with HPIPM, which is not installed here: "
    "pip install 'lpvmpc[nmpc]'."
)
"""What to say where CasADi is absent."""


@njit(cache=True)
def write(Ad, Bd, cd, x0, u_prev, x_ref, q, r_du, terminal, z_ref, u_lo, u_hi, du_max, data):
    """Write the QP  min 0.5 v'Hv + g'v  of a horizon into the arrays that the solver reads.

    sum_{k=1..N} |x_k - x_ref_k|^2_q + sum_{k=0..N-1} |du_k|^2_r_du + |(x_N, u_{N-1}) - z_ref|^2_P

    Args:
        Ad: Transition matrices, shape (N, nx, nx).
        Bd: Input matrices, shape (N, nx, nu).
        cd: Constant terms, shape (N, nx).
        x0: State at the beginning, shape (nx,).
        u_prev: Input of the period before, shape (nu,).
        x_ref: Reference of the states at steps 1..N, shape (N, nx).
        q: Diagonal weights of the states, shape (N, nx).
        r_du: Diagonal weights of the increments, shape (nu,).
        terminal: P, shape (nx + nu, nx + nu).
        z_ref: Its reference, shape (nx + nu,).
        u_lo: Lower bounds of the inputs, shape (N, nu).
        u_hi: Upper bounds, shape (N, nu).
        du_max: Largest increments, infinite for none, shape (nu,).
        data: Receives H, g, A, b, lower and upper bounds, as CasADi orders them.
    """
    H, g, A, b, lo, hi = data
    N, nx, nu = Bd.shape
    nz = nx + nu
    # columns of A: those of du_0 first; each column has its own -1 above its block of dynamics
    at = 0
    for m in range(nu):
        for i in range(nx):
            A[at] = Bd[0, i, m]
            at += 1
        for i in range(nu):
            A[at] = 1.0 if i == m else 0.0
            at += 1
    for k in range(1, N + 1):
        for j in range(nz):
            A[at] = -1.0
            at += 1
            if k == N:
                continue
            for i in range(nx):
                A[at] = Ad[k, i, j] if j < nx else Bd[k, i, j - nx]
                at += 1
            for i in range(nu):
                A[at] = 1.0 if i + nx == j else 0.0
                at += 1
        if k == N:
            break
        for m in range(nu):
            for i in range(nx):
                A[at] = Bd[k, i, m]
                at += 1
            for i in range(nu):
                A[at] = 1.0 if i == m else 0.0
                at += 1
    for k in range(N):
        for i in range(nx):
            b[k * nz + i] = -cd[k, i]
        for m in range(nu):
            b[k * nz + nx + m] = 0.0
    for i in range(nx):
        for j in range(nx):
            b[i] -= Ad[0, i, j] * x0[j]
        for m in range(nu):
            b[i] -= Bd[0, i, m] * u_prev[m]
    for m in range(nu):
        b[nx + m] = -u_prev[m]
    # cost and bounds
    at, v = 0, 0
    for k in range(N + 1):
        if k > 0:
            for i in range(nx):
                w = 2.0 * q[k - 1, i]
                lo[v], hi[v] = -UNBOUNDED, UNBOUNDED
                g[v] = -w * x_ref[k - 1, i]
                if k < N:
                    H[at] = w
                    at += 1
                v += 1
            for m in range(nu):
                lo[v], hi[v] = u_lo[k - 1, m], u_hi[k - 1, m]
                g[v] = 0.0
                if k < N:
                    H[at] = 0.0
                    at += 1
                v += 1
        if k < N:
            for m in range(nu):
                hi[v] = min(du_max[m], UNBOUNDED)
                lo[v] = -hi[v]
                g[v] = 0.0
                H[at] = 2.0 * r_du[m]
                at += 1
                v += 1
    first = v - nz
    for j in range(nz):
        for i in range(nz):
            H[at] = 2.0 * terminal[i, j]
            if i == j and i < nx:
                H[at] += 2.0 * q[N - 1, i]
            g[first + i] -= 2.0 * terminal[i, j] * z_ref[j]
            at += 1


@njit(cache=True)
def residual(data, v, lam, mult, N, nx, nu):
    """Largest violation of the optimality conditions by what the solver gave [-].

    |Hv + g + A' mult + lam| relative to 1 + |g|, and |Av - b|; the bounds' part is not in it, since
    inputs are put within their bounds before they are used.

    Args:
        data: What `write` wrote.
        v: Variables, shape (n,).
        lam: Multipliers of their bounds, shape (n,).
        mult: Multipliers of the equations, shape (N (nx + nu),).
        N: Periods.
        nx: States.
        nu: Inputs.
    """
    H, g, A, b, _, _ = data
    nz = nx + nu
    n = len(v)
    dual, primal = g + lam, -b
    size = 1.0 + np.max(np.abs(g))
    at, col = 0, 0
    for k in range(N + 1):
        states = nz if k > 0 else 0
        for j in range(states + (nu if k < N else 0)):
            if j < states:
                row = (k - 1) * nz + j
                dual[col] += A[at] * mult[row]
                primal[row] += A[at] * v[col]
                at += 1
            if k < N:
                for i in range(nz):
                    dual[col] += A[at] * mult[k * nz + i]
                    primal[k * nz + i] += A[at] * v[col]
                    at += 1
            col += 1
    first = n - nz
    for i in range(first):
        dual[i] += H[i] * v[i]
    for j in range(nz):
        for i in range(nz):
            dual[first + i] += H[first + j * nz + i] * v[first + j]
    return max(np.max(np.abs(dual)) / size, np.max(np.abs(primal)))


class StagedQP:
    """One HPIPM object for a sequence of QPs of one size; `data` is written by `write`."""

    def __init__(self, N: int, nx: int, nu: int, name: str) -> None:
        """Args: periods, states, inputs, and the name of the controller, for messages.

        Raises:
            LPVMPCError: CasADi is not installed, or is without HPIPM.
        """
        self.N, self.nx, self.nu, self.name = N, nx, nu, name
        self._make()

    def _make(self) -> None:
        try:
            casadi: Any = import_module("casadi")
        except ImportError as error:
            raise LPVMPCError(MISSING.format(name=self.name)) from error
        if not casadi.has_conic("hpipm"):
            raise LPVMPCError(MISSING.format(name=self.name))
        N, nx, nu = self.N, self.nx, self.nu
        nz = nx + nu
        first = [0] + [nu + (k - 1) * (nz + nu) for k in range(1, N + 1)]  # column of a stage
        n = first[-1] + nz
        A, H = np.eye(n, dtype=bool), np.eye(n, dtype=bool)
        A = np.zeros((N * nz, n), dtype=bool)
        for k in range(N):
            A[k * nz : (k + 1) * nz, first[k] : first[k + 1]] = True
            A[k * nz : (k + 1) * nz, first[k + 1] : first[k + 1] + nz] = np.eye(nz, dtype=bool)
        H[first[N] :, first[N] :] = True
        options = {
            "N": N,
            "nx": [0] + N * [nz],
            "nu": N * [nu] + [0],
            "ng": (N + 1) * [0],
            "error_on_fail": False,
            "hpipm": {"mode": "speed", "iter_max": ITERATIONS},
        }
        pattern = {"a": _pattern(casadi, A), "h": _pattern(casadi, H)}
        self._conic = casadi.conic("nmpc", "hpipm", pattern, options)
        # CasADi reads and writes these arrays in place, without copies by way of its matrices
        self._buffer, self._evaluate = self._conic.buffer()
        names = self._conic.name_in()
        inputs = {name: np.zeros(self._conic.nnz_in(i)) for i, name in enumerate(names)}
        self._outputs = [np.zeros(self._conic.nnz_out(i)) for i in range(self._conic.n_out())]
        self._views = [array.data for array in inputs.values()]
        self._results = [array.data for array in self._outputs]
        self._inputs = inputs
        self.data = tuple(inputs[name] for name in ("h", "g", "a", "lba", "lbx", "ubx"))
        """H, g, A, b, lower and upper bounds."""

    def solve(self) -> tuple[Array, float, str, float]:
        """Solve the QP in `data`.

        Returns:
            Variables, shape (n,), which the next solve overwrites; KKT residual [-]; status, which
            is SOLVED where HPIPM says so; thread CPU time [us].
        """
        start = time.thread_time_ns()
        self._inputs["uba"][:] = self._inputs["lba"]
        for i, view in enumerate(self._views):  # the solver moves the pointers that it is given
            self._buffer.set_arg(i, view)
        for i, view in enumerate(self._results):
            self._buffer.set_res(i, view)
        self._evaluate()
        v, _, mult, lam = self._outputs
        stats = self._buffer.stats()
        error = residual(self.data, v, lam, mult, self.N, self.nx, self.nu)
        status = "SOLVED" if stats["success"] else f"HPIPM_{stats['return_status']}"
        if not np.isfinite(error):
            status = "NOT_FINITE"
        return v, float(error), status, (time.thread_time_ns() - start) * 1e-3

    def __getstate__(self) -> dict[str, Any]:
        """Sizes and name; the solver is made anew from them."""
        return {name: getattr(self, name) for name in ("N", "nx", "nu", "name")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A solver of its own."""
        vars(self).update(state)
        self._make()


def _pattern(casadi: Any, mask: Array) -> Any:
    """A CasADi sparsity from a mask, column by column as it orders them."""
    columns, rows = np.nonzero(mask.T)
    return casadi.Sparsity.triplet(*mask.shape, rows.tolist(), columns.tolist())
