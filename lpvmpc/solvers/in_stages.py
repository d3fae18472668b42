"""Solvers that are given the program in stages, with its states."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from lpvmpc.solvers.adapter import FINE, MANY, Answer, InStages, piqp_settings, proxqp_settings
from lpvmpc.solvers.stream import QP, Stream


class ProxQPSparse(InStages):
    """ProxQP's sparse method on the program in stages."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.prox: Any = import_module("proxsuite").proxqp
        self.qp: Any = None

    def run(self, prepared: Any) -> Any:
        """Update and solve."""
        P, q, E, b, F, lo, hi = prepared
        if self.qp is None:
            self.qp = self.prox.sparse.QP(P.shape[0], E.shape[0], F.shape[0])
            proxqp_settings(self.qp.settings, self.prox, FINE)
            self.qp.init(P, q, E, b, F, lo, hi)
        else:
            self.qp.update(P, q, E, b, F, lo, hi)
        self.qp.solve()
        return self.qp.results

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """As ProxQP has it."""
        solved = raw.info.status == self.prox.PROXQP_SOLVED
        found = Answer(solved, self.stream.condensed(raw.x.copy()), raw.z.copy())
        if not solved:
            self.qp = None
        return found


class PIQPStages(InStages):
    """PIQP on the program in stages, going through the horizon stage by stage."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.piqp: Any = import_module("piqp")
        self.qp: Any = None

    def run(self, prepared: Any) -> Any:
        """Update and solve."""
        P, q, E, b, F, lo, hi = prepared
        if self.qp is None:
            self.qp = self.piqp.SparseSolver()
            piqp_settings(self.qp.settings, FINE)
            self.qp.settings.kkt_solver = self.piqp.sparse_multistage
            self.qp.setup(P, q, E, b, F, lo, hi)
        else:
            self.qp.update(P=P, c=q, A=E, b=b, G=F, h_l=lo, h_u=hi)
        return self.qp.solve()

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """As PIQP has it."""
        r = self.qp.result
        z = self.stream.condensed(r.x.copy())
        return Answer(raw == self.piqp.PIQP_SOLVED, z, r.z_u - r.z_l)


class OSQP(InStages):
    """OSQP on the program in stages, polished."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.osqp: Any = import_module("osqp")
        self.qp: Any = None

    def prepare(self, qp: QP, k: int) -> Any:
        """Upper triangle of P, q, all rows, and their bounds."""
        from scipy.sparse import triu, vstack

        P, q, E, b, F, lo, hi = super().prepare(qp, k)
        rows = vstack([E, F], format="csc")
        lower, upper = np.concatenate([b, lo]), np.concatenate([b, hi])
        return triu(P, format="csc"), q, rows, lower, upper

    def run(self, prepared: Any) -> Any:
        """Update and solve."""
        P, q, A, lo, hi = prepared
        if self.qp is None:
            self.qp = self.osqp.OSQP()
            try:
                self.qp.setup(
                    P, q, A, lo, hi, verbose=False, eps_abs=FINE, eps_rel=0.0, max_iter=MANY,
                    polishing=True, warm_starting=False,
                )
            except self.osqp.OSQPException:  # it does not take what is not convex
                self.qp = None
                return None
        else:
            self.qp.update(Px=P.data, q=q, Ax=A.data, l=lo, u=hi)
        return self.qp.solve(raise_error=False)

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """As OSQP has it."""
        if raw is None:
            return Answer(False, np.full(self.n, np.nan), np.zeros(self.m))
        solved = raw.info.status == "solved"
        if not solved:
            self.qp = None
        z = self.stream.condensed(np.array(raw.x, dtype=float))
        return Answer(solved, z, np.array(raw.y, dtype=float)[self.equations :])


class Clarabel(InStages):
    """Clarabel, an interior-point method, on the program in stages with one-sided rows."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.clarabel: Any = import_module("clarabel")
        s = self.settings = self.clarabel.DefaultSettings()
        s.verbose = False
        # relative to the data, and to its own scaling of it
        s.tol_feas, s.tol_gap_abs, s.tol_gap_rel = 1e-2 * FINE, 1e-2 * FINE, 1e-2 * FINE
        s.max_threads = 1

    def prepare(self, qp: QP, k: int) -> Any:
        """P, q, A, b and cones, and which rows they are."""
        from scipy.sparse import triu, vstack

        P, q, E, b, F, lo, hi = super().prepare(qp, k)
        low, high = np.flatnonzero(lo > -np.inf), np.flatnonzero(hi < np.inf)
        rows = vstack([E, F[high], -F[low]], format="csc")
        cones = [self.clarabel.ZeroConeT(len(b)),
                 self.clarabel.NonnegativeConeT(len(high) + len(low))]
        return (triu(P, format="csc"), q, rows, np.concatenate([b, hi[high], -lo[low]]), cones,
                low, high)

    def run(self, prepared: Any) -> Any:
        """Set up and solve."""
        return self.clarabel.DefaultSolver(*prepared[:5], self.settings).solve()

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """Two one-sided rows are one again."""
        low, high = prepared[5:]
        given, y = np.array(raw.z)[self.equations :], np.zeros(self.m)
        y[high] += given[: len(high)]
        y[low] -= given[len(high) :]
        solved = raw.status == self.clarabel.SolverStatus.Solved
        return Answer(solved, self.stream.condensed(np.array(raw.x)), y)
