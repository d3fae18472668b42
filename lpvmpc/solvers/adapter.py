"""What a solver of quadratic programs looks like to the study, and what we ask of it.

An adapter is made for a stream; `prepare` writes a program in the solver's own form, which is not
timed, since a controller would write it so at once; `run` is what a control period would have to
call; `answer` brings solution and multipliers into the form of the condensed program, where our
check looks at them. Nothing is carried from one program to the next but memory and factorisation
patterns: each starts cold, as in our loop, so that an answer depends on its program alone.

All are asked for more than our check wants (`ACCURACY`, `FINE`). ProxQP's settings are those of
`control.solver`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from lpvmpc.solvers.stream import QP, Stream
from lpvmpc.units import Array

ACCURACY = 1e-7
"""Residual that solvers with a tolerance are asked for on the condensed program."""
FINE = 1e-9
"""The same in stages: an error of the dynamics grows over the horizon, and our check looks at the
condensed program."""
TOLERANCE = 1e-6
"""Residual that our check allows."""
MANY = 4000
"""Most iterations of a first-order method."""
UNBOUNDED = 1e4
"""Bound of what has none for a solver that wants finite ones; inputs are of order one."""


class Answer(NamedTuple):
    """What a solver says."""

    claimed: bool
    """Whether it calls this solved."""
    z: Array
    """Solution of the condensed program, shape (n,)."""
    y: Array
    """Multipliers of its rows, positive at upper bounds, shape (m,)."""


class Adapter:
    """A solver, for one stream."""

    def __init__(self, stream: Stream) -> None:
        """Args: the programs that it will be asked to solve."""
        self.stream = stream
        self.m, self.n = stream.arrays["A"].shape[1:]

    def prepare(self, qp: QP, k: int) -> Any:
        """A program in the solver's form; here as it is.

        Args:
            qp: The program, condensed.
            k: Its place in the stream, for those who take it in stages.
        """
        return qp

    def run(self, prepared: Any) -> Any:
        """Solve; this alone is timed."""
        raise NotImplementedError

    def answer(self, prepared: Any, raw: Any) -> Answer:
        """What it has said."""
        raise NotImplementedError


class InStages(Adapter):
    """A solver that takes the program in stages, as sparse matrices of one pattern."""

    def __init__(self, stream: Stream) -> None:
        super().__init__(stream)
        self.equations = len(stream.staged(0).b)

    def prepare(self, qp: QP, k: int) -> Any:
        """P, q, E, b, F, lo, hi, with the bounds and the first input's price of `qp`."""
        from scipy.sparse import csc_matrix

        s = self.stream.staged(k)
        own = self.stream.qp(k)
        costs = s.P.copy()
        costs[0, 0] += qp.H[0, 0] - own.H[0, 0]  # where the program was spoiled on purpose
        sparse = []
        for matrix, mask in zip((costs, s.E, s.F), self.stream.patterns, strict=True):
            assert not np.any(matrix[~mask]), "the pattern lacks an entry"
            made = csc_matrix(mask.astype(float))
            columns = np.repeat(np.arange(made.shape[1]), np.diff(made.indptr))
            made.data[:] = matrix[made.indices, columns]
            sparse.append(made)
        P, E, F = sparse
        return P, s.q, E, s.b, F, qp.lo + s.shift, qp.hi + s.shift


def proxqp_settings(settings: Any, prox: Any, accuracy: float) -> None:
    """ProxQP as `control.solver` sets it, with more iterations: here it has no second try."""
    settings.initial_guess = prox.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
    settings.eps_abs, settings.eps_rel = accuracy, 0.0
    settings.check_duality_gap = True
    settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = TOLERANCE, 0.0
    settings.default_rho, settings.default_mu_in = 1e-8, 1e-4
    settings.eps_primal_inf = 1e-16
    settings.max_iter = settings.max_iter_in = 200


def piqp_settings(settings: Any, accuracy: float) -> None:
    """PIQP at an accuracy."""
    settings.eps_abs, settings.eps_rel = accuracy, 0.0
    settings.eps_duality_gap_abs, settings.eps_duality_gap_rel = accuracy, 0.0
