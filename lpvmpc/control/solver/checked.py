"""A quadratic program solved twice at most, and never believed without a check.

ProxQP solves; what it does not solve, or what our own check of the answer refuses, a dual
active-set method solves: it starts from nothing, and ends after finitely many steps.
"""

from __future__ import annotations

import functools
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.control.solver import active_set
from lpvmpc.control.solver.optimality import GOOD, factor, judge
from lpvmpc.errors import OptionError, UnknownNameError
from lpvmpc.units import Array

# ProxQP's AVX builds round differently at different memory addresses, so that the last bits of a
# solution with active bounds change from process to process. The build without is as fast for
# problems of this size, and gives the same bits always and on any x86 processor.
for _build in ("avx512", "avx2"):
    sys.modules.setdefault(f"proxsuite.proxsuite_pywrap_{_build}", None)  # type: ignore[arg-type]
import proxsuite  # noqa: E402

SOLVERS = ("proxqp", "active-set")
"""Who solves first: ProxQP, and what it leaves the active-set method; or that method alone."""
FAR = 100.0
"""How far an answer may be from the solution, in tolerances: 1e-4 of the inputs' units, that is
10 urad of steering and 0.1 mm/s2."""
STEPS = 5
"""Steps of the active-set method per variable and row, at most."""
SHARE = 0.01
"""Violation that it leaves, as a share of the tolerance."""
REFUSED = ("SOLVED", "NOT_FINITE", "NOT_CONVEX", "INFEASIBLE")
"""Status of what `factor` finds."""
ENDED = ("SOLVED", "INFEASIBLE", "MAX_STEPS")
"""Status of how the active-set method ends."""
_SOLVED = proxsuite.proxqp.PROXQP_SOLVED


@dataclass(slots=True)
class QPResult:
    """Outcome of one solve; `z` is meaningful only when `solved` is true."""

    z: Array
    """Solution, shape (n,)."""
    solved: bool
    """A solver found it and our own optimality check agrees."""
    status: str
    """`SOLVED`; `NOT_FINITE`, `NOT_CONVEX`, `INFEASIBLE` or `MAX_STEPS` where there is no answer;
    `WRONG` where our check refuses it."""
    residual: float
    """KKT residual, see `judge` [-]; NaN when there is no solution."""
    solve_us: float
    """Thread CPU time of the solvers [us]."""
    check_us: float
    """Thread CPU time of the checks before and after [us]."""
    iterations: int = 0
    """ProxQP's inner iterations, and steps of the active-set method."""
    second: bool = False
    """Whether it took the second try."""


class QPSolver:
    """Solves a sequence of QPs of one size.

    No solver's status is trusted: ProxQP stops on signed sums that can cancel, so every answer
    passes `judge`. Data that are not finite are refused before the call, since they would poison
    ProxQP's object; so is a cost that is not strictly convex, whose stationary points would pass
    every check. ProxQP's iterations are few, since what it does not solve in those it hardly ever
    solves in many. Each solve starts from the equality-constrained guess: warm starts give wrong
    answers now and then, and make a result depend on its history.

    Source: Bambade et al., PROX-QP, RSS 2022; Goldfarb and Idnani 1983.
    """

    def __init__(
        self,
        n: int,
        m: int,
        tolerance: float = 1e-6,
        max_iter: int = 6,
        first: str = "proxqp",
    ) -> None:
        """Build the solver.

        Args:
            n: Number of variables.
            m: Number of rows.
            tolerance: Largest KKT residual; an answer is within `FAR` of these of the solution.
            max_iter: ProxQP's outer iterations, and its inner ones in each.
            first: One of `SOLVERS`.
        """
        if not (np.isfinite(tolerance) and 0.0 < tolerance < 1.0):
            raise OptionError("QP tolerance", tolerance, "a number between 0 and 1")
        if max_iter < 1:
            raise OptionError("QP max_iter", max_iter, "at least 1")
        if first not in SOLVERS:
            raise UnknownNameError("solver", first, list(SOLVERS))
        self.n, self.m, self.tolerance, self.max_iter = n, m, tolerance, max_iter
        self.first = first
        self._U = np.zeros((n, n))
        _load()
        self._prox: proxsuite.proxqp.dense.QP | None = None
        self._scaled_by: tuple[Array, ...] = ()  # the QP that ProxQP scales all later ones by

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
            The result; never raises for a QP that cannot be solved.
        """
        start = time.thread_time_ns()
        found = factor(H, g, C, lo, hi, self._U)
        if found != GOOD:
            self._prox = None
            spent = (time.thread_time_ns() - start) * 1e-3
            none = np.full(self.n, np.nan)
            return QPResult(none, False, REFUSED[found], np.nan, 0.0, spent)
        checked = time.thread_time_ns()
        if self.first == "proxqp":
            prox = self._prox
            if prox is None:
                prox = self._begin(H, g, C, lo, hi)
            else:
                prox.update(H=H, g=g, C=C, l=lo, u=hi)
            prox.solve()
            solved = time.thread_time_ns()
            z = self._z.copy()
            residual, far = judge(H, g, C, lo, hi, z, self._y, self._U)
            good, iterations = self._accepts(residual, far), self._info.iter
            if good and self._info.status == _SOLVED:
                done = time.thread_time_ns()
                check_us = (checked - start + done - solved) * 1e-3
                solve_us = (solved - checked) * 1e-3
                return QPResult(
                    z, True, "SOLVED", residual, solve_us, check_us, iterations
                )
            self._prox = None  # what it has learned from this one is no good for the next
            second = True
        else:
            iterations, second = 0, False
        z, y = np.empty(self.n), np.empty(self.m)
        ended, steps = active_set.solve(
            self._U, H, g, C, lo, hi, SHARE * self.tolerance, STEPS * (self.n + self.m), z, y
        )
        status, iterations = ENDED[ended], iterations + steps
        solved = time.thread_time_ns()
        residual = np.nan
        if ended == active_set.SOLVED:
            residual, far = judge(H, g, C, lo, hi, z, y, self._U)
            if not self._accepts(residual, far):
                status = "WRONG"
        good = status == "SOLVED"
        done = time.thread_time_ns()
        solve_us, check_us = (solved - checked) * 1e-3, (checked - start + done - solved) * 1e-3
        return QPResult(z, good, status, residual, solve_us, check_us, iterations, second)

    def _accepts(self, residual: float, far: float) -> bool:
        """Whether an answer passes; NaN does not."""
        return residual <= self.tolerance and far <= FAR * self.tolerance

    def __getstate__(self) -> dict[str, Any]:
        """All but ProxQP's object; the QP that it began with makes the same one again."""
        names = ("n", "m", "tolerance", "max_iter", "first")
        kept = {name: getattr(self, name) for name in names}
        return kept | {"_scaled_by": () if self._prox is None else self._scaled_by}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """A solver that answers as the one that was copied."""
        vars(self).update(state)
        self._prox, self._U = None, np.zeros((self.n, self.n))
        if self._scaled_by:
            self._begin(*self._scaled_by)

    def _begin(self, *qp: Array) -> proxsuite.proxqp.dense.QP:
        """A new ProxQP object, scaled by its first QP (H, g, C, lo, hi)."""
        prox = self._prox = self._new_solver()
        H, g, C, lo, hi = self._scaled_by = tuple(array.copy() for array in qp)
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


@functools.cache
def _load() -> None:
    """Load the compiled second try, 20 ms, before it is needed: least x^2 with x >= 1."""
    one, far = np.eye(1), np.array([np.inf])
    active_set.solve(one, one, np.zeros(1), one, np.ones(1), far, 1e-9, 9, np.empty(1), np.empty(1))
