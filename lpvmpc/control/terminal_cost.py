"""Terminal weight: what an error at the end of the horizon still costs afterwards.

A third of a second is short at 25 m/s: without a terminal weight the controller answers a large
error with an oscillation that grows. The weight is the cost-to-go of the unconstrained problem on
a straight road, from the Riccati equation of the LPV model at a few speeds.
"""

from __future__ import annotations

import numpy as np

from lpvmpc.car.bicycle import (
    AF,
    AR,
    CORRECTED,
    DELTA,
    NU,
    NX,
    PHI,
    VX,
    A,
    Bicycle,
    P,
    discretise,
    lpv,
)
from lpvmpc.units import Array

SPEEDS = np.geomspace(2.0, 45.0, 16)
"""Speeds of the table [m/s]; between them the weight is interpolated, beyond them held."""
NZ = NX + NU
"""Size of the terminal error: the states, and the input applied last."""


def cost_to_go(car: Bicycle, tires: Array, q: Array, r_du: Array, Ts: float) -> Array:
    """Cost of a tracking error z = (x, u_prev) over all later periods, at each of `SPEEDS`.

    V(z) = z' P z = min over du of  sum_{k >= 0} |x_{k+1}|^2_q + |du_k|^2_r

    Args:
        car: Constants of the single-track model.
        tires: Affine axle forces (Cf, F0f, Cr, F0r), shape (4,); their offsets do not matter.
        q: Diagonal state weights, shape (11,).
        r_du: Diagonal weights of the input increments, shape (2,).
        Ts: Period [s].

    Returns:
        P, shape (16, 13, 13), symmetric and positive semi-definite.

    Source: Rawlings, Mayne, Diehl, Model Predictive Control, section 2.5; the state is augmented
    by the last input since increments are weighted.
    """
    from scipy.linalg import solve_discrete_are  # 0.1 s to import, needed once
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    table = np.zeros((len(SPEEDS), NZ, NZ))
    A_, B_, c_ = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    used = [i for i in range(NX) if _used(car, i)]
    # with several threads BLAS rounds otherwise, and every command of a run would show it
    with threadpool_limits(1, user_api="blas"):
        for n, vx in enumerate(SPEEDS):
            x = np.zeros(NX)
            x[VX] = vx
            lpv(x, 0.0, tires, car, CORRECTED, A_, B_, c_)
            Ad, Bd, _ = discretise(A_, B_, c_, Ts)
            Ad, Bd = Ad[np.ix_(used, used)], Bd[used]
            size = len(used)
            step = np.block([[Ad, Bd], [np.zeros((NU, size)), np.eye(NU)]])
            push = np.vstack([Bd, np.eye(NU)])
            stage = np.diag(np.append(q[used], np.zeros(NU)))
            cost = solve_discrete_are(step, push, stage, np.diag(r_du)) - stage
            where = used + list(range(NX, NZ))
            table[n][np.ix_(where, where)] = 0.5 * (cost + cost.T)
    return table


def _used(car: Bicycle, state: int) -> bool:
    """Whether the model has this state; one without lag or stiffness just copies its input."""
    if state == DELTA:
        return car.tau_delta > 0.0
    if state == A:
        return car.tau_ax > 0.0
    if state in (AF, AR):
        return car.sigma_f > 0.0
    if state in (PHI, P):
        return car.K_phi > 0.0
    return True
