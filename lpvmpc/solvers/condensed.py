"""Solvers that are given the condensed program: our own first."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from lpvmpc.control.solver.checked import QPSolver
from lpvmpc.solvers.adapter import (
    ACCURACY,
    MANY,
    TOLERANCE,
    UNBOUNDED,
    Adapter,
    Answer,
    piqp_settings,
    proxqp_settings,
)
from lpvmpc.solvers.stream import QP, Stream


class Ours(Adapter):
    """What the loop calls: a solver, the check before and after, and the second try."""

    first = "proxqp"

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.solver = QPSolver(self.n, self.m, TOLERANCE, first=self.first)

    def run(self, prepared: QP) -> Any:
        """Check, solve, check."""
        return self.solver.solve(*prepared)

    def answer(self, prepared: QP, raw: Any) -> Answer:
        """The multipliers are looked at inside; outside its word is believed."""
        return Answer(raw.solved, raw.z, np.full(self.m, np.nan))


class OursActiveSet(Ours):
    """The same with the active-set method alone."""

    first = "active-set"


class ProxQPDense(Adapter):
    """ProxQP on the condensed program."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.prox: Any = import_module("proxsuite").proxqp
        self.qp: Any = None

    def run(self, prepared: QP) -> Any:
        """Update and solve."""
        H, g, C, lo, hi = prepared
        if self.qp is None:
            kind = self.prox.dense.HessianType.Dense, self.prox.dense.DenseBackend.PrimalDualLDLT
            self.qp = self.prox.dense.QP(self.n, 0, self.m, False, *kind)
            proxqp_settings(self.qp.settings, self.prox, ACCURACY)
            self.qp.init(H=H, g=g, C=C, l=lo, u=hi)
        else:
            self.qp.update(H=H, g=g, C=C, l=lo, u=hi)
        self.qp.solve()
        return self.qp.results

    def answer(self, prepared: QP, raw: Any) -> Answer:
        """As ProxQP has it."""
        solved = raw.info.status == self.prox.PROXQP_SOLVED
        found = Answer(solved, raw.x.copy(), raw.z.copy())
        if not solved:
            self.qp = None  # what it has learned from this one is no good for the next
        return found


class PIQPDense(Adapter):
    """PIQP on the condensed program; the rows of the inputs are bounds of variables."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.piqp: Any = import_module("piqp")
        self.qp: Any = None

    def prepare(self, qp: QP, k: int) -> Any:
        """P, c, G, h_l, h_u, x_l, x_u."""
        b = self.n - 1
        x_l, x_u = np.append(qp.lo[:b], -np.inf), np.append(qp.hi[:b], np.inf)
        P, G = np.asfortranarray(qp.H), np.asfortranarray(qp.C[b:])
        return P, qp.g, G, qp.lo[b:], qp.hi[b:], x_l, x_u

    def run(self, prepared: Any) -> Any:
        """Update and solve."""
        P, c, G, h_l, h_u, x_l, x_u = prepared
        if self.qp is None:
            self.qp = self.piqp.DenseSolver()
            piqp_settings(self.qp.settings, ACCURACY)
            self.qp.setup(P, c, None, None, G, h_l, h_u, x_l, x_u)
        else:
            self.qp.update(P=P, c=c, G=G, h_l=h_l, h_u=h_u, x_l=x_l, x_u=x_u)
        return self.qp.solve()

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """Multipliers of bounds first, as the rows are."""
        r, b = self.qp.result, self.n - 1
        y = np.concatenate([(r.z_bu - r.z_bl)[:b], r.z_u - r.z_l])
        return Answer(raw == self.piqp.PIQP_SOLVED, r.x.copy(), y)


class DAQP(Adapter):
    """DAQP, a dual active-set method; the rows of the inputs are bounds of variables."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.daqp: Any = import_module("daqp")
        self.sense = np.zeros(self.m, dtype=np.int32)

    def prepare(self, qp: QP, k: int) -> Any:
        """H, f, A without the rows of bounds, upper and lower bounds."""
        big = 1e30
        return (np.array(qp.H), np.array(qp.g), np.ascontiguousarray(qp.C[self.n - 1 :]),
                np.minimum(qp.hi, big), np.maximum(qp.lo, -big))

    def run(self, prepared: Any) -> Any:
        """Solve."""
        return self.daqp.solve(
            *prepared, self.sense, primal_tol=0.1 * ACCURACY, dual_tol=1e-12, iter_limit=MANY
        )

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """As DAQP has it."""
        x, _, flag, info = raw
        return Answer(flag == 1, np.array(x), np.array(info["lam"]))


class Quadprog(Adapter):
    """The dual active-set method of Goldfarb and Idnani in C, on one-sided rows."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.solve: Any = import_module("quadprog").solve_qp

    def prepare(self, qp: QP, k: int) -> Any:
        """G, a, C' and b of  C'x >= b, and which rows they are."""
        low, high = np.flatnonzero(qp.lo > -np.inf), np.flatnonzero(qp.hi < np.inf)
        rows = np.concatenate([qp.C[low], -qp.C[high]]).T.copy()
        return qp.H, -qp.g, rows, np.concatenate([qp.lo[low], -qp.hi[high]]), low, high

    def run(self, prepared: Any) -> Any:
        """Solve; it raises where it finds none."""
        try:
            return self.solve(*prepared[:4])
        except ValueError:
            return None

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """Two one-sided rows are one again."""
        y = np.zeros(self.m)
        if raw is None:
            return Answer(False, np.full(self.n, np.nan), y)
        low, high = prepared[4:]
        y[low] -= raw[4][: len(low)]
        y[high] += raw[4][len(low) :]
        return Answer(True, raw[0], y)


class HPIPM(Adapter):
    """HPIPM through CasADi, on the condensed program as one stage."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        casadi: Any = import_module("casadi")
        dense = {"h": casadi.Sparsity.dense(self.n, self.n),
                 "a": casadi.Sparsity.dense(self.m - self.n + 1, self.n)}
        options = {
            "N": 0, "nx": [self.n], "nu": [0], "ng": [self.m - self.n + 1], "error_on_fail": False,
            "hpipm": {"mode": "balance", "iter_max": 60, "res_g_max": ACCURACY,
                      "res_b_max": ACCURACY, "res_d_max": ACCURACY, "res_m_max": 0.01 * ACCURACY},
        }
        self.conic = casadi.conic("qp", "hpipm", dense, options)
        # CasADi reads and writes these arrays in place, without copies by way of its matrices
        self.buffer, self.evaluate = self.conic.buffer()
        names = self.conic.name_in()
        self.into = {name: np.zeros(self.conic.nnz_in(i)) for i, name in enumerate(names)}
        self.out = [np.zeros(self.conic.nnz_out(i)) for i in range(self.conic.n_out())]

    def prepare(self, qp: QP, k: int) -> Any:
        """What CasADi reads, by its names."""
        b = self.n - 1
        lo, hi = np.maximum(qp.lo, -UNBOUNDED), np.minimum(qp.hi, UNBOUNDED)
        return {
            "h": qp.H.ravel(order="F"), "g": qp.g, "a": qp.C[b:].ravel(order="F"),
            "lba": lo[b:], "uba": hi[b:], "lbx": np.append(lo[:b], -UNBOUNDED),
            "ubx": np.append(hi[:b], UNBOUNDED),
        }

    def run(self, prepared: Any) -> Any:
        """Hand over and solve."""
        for name, values in prepared.items():
            self.into[name][:] = values
        for i, array in enumerate(self.into.values()):  # the solver moves the pointers it is given
            self.buffer.set_arg(i, array.data)
        for i, array in enumerate(self.out):
            self.buffer.set_res(i, array.data)
        self.evaluate()
        return self.buffer.stats()["success"]

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """Multipliers of bounds first, as the rows are."""
        z, _, rows, bounds = self.out
        y = np.concatenate([bounds[: self.n - 1], rows])
        return Answer(bool(raw), z.copy(), y)
