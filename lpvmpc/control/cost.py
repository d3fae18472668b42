"""What the controllers on a QP weigh: units, weights, and the numbers that the QP takes from them.

To change the cost: its terms are `qp.condense`'s, its weights are here.

The terminal weight says what an error at the end of the horizon still costs afterwards. A third of
a second is short at 25 m/s: without it the controller answers a large error with an oscillation
that grows. It is the cost-to-go of the unconstrained problem on a straight road, from the Riccati
equation of the LPV model at a few speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import AF, AR, CORRECTED, DELTA, NU, NX, PHI, VX, A, Bicycle, P, lpv
from lpvmpc.car.hold import discretise
from lpvmpc.control.formulation import DELTA_MAX_PAPER, EY_MAX
from lpvmpc.control.weights_file import check_weights
from lpvmpc.errors import OptionError
from lpvmpc.units import Array

UNITS = {
    "vx": 1.0,
    "vy": 1.0,
    "r": 0.5,
    "ey": EY_MAX,
    "epsi": DELTA_MAX_PAPER,
    "delta": DELTA_MAX_PAPER,
    "ax": 5.0,
}
"""Size of each variable that counts as one in the cost [m/s, m/s, rad/s, m, rad, rad, m/s2]."""
SLACK_WEIGHTS = np.array([0.0, 1e4])
"""Linear and quadratic price of leaving the ey bound [1/m, 1/m2]. Without a linear one the bound
yields by millimetres, and while it is not active the unconstrained solution is the solution: that
is where ProxQP begins, and it needs one iteration instead of two."""
SPEEDS = np.geomspace(2.0, 45.0, 16)
"""Speeds of the table of terminal weights [m/s]; between them the weight is interpolated, beyond
them held."""
NZ = NX + NU
"""Size of the terminal error: the states, and the input applied last."""

SMALLEST_RATE = 1e-9
"""Smallest weight of an input's rate: without one no plan is better than another."""
DOUBLINGS = 12
"""Most doublings of `_doubled`: 4096 periods, more than two minutes."""


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Everything that is tuned. Weights are per second and normalised by `UNITS`.

    The values here are set by hand; what the controller drives with where none are given is
    `weights/lpv-mpc.toml`, whose record says where they come from.
    """

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "q_vx": (0.5, 300.0),
        "q_vy": (0.001, 10.0),
        "q_r": (0.001, 10.0),
        "q_ey": (5.0, 800.0),
        "q_epsi": (5.0, 2000.0),
        "r_delta": (0.02, 5.0),
        "r_ax": (0.01, 5.0),
        "terminal": (0.2, 3.0),
        "observer_gain": (0.03, 0.9),
        "slip_cap": (0.1, 0.2),
        "calm": (1.0, 20.0),
        "calm_gain": (0.03, 0.9),
    }
    """Where tuning searches: wide enough that no optimum lies on a bound; a report of a tuning
    names those that do."""

    q_vx: float = 50.0
    """Weight of the speed error."""
    q_vy: float = 1.0
    """Weight of the lateral speed error."""
    q_r: float = 0.02
    """Weight of the yaw rate error."""
    q_ey: float = 100.0
    """Weight of the lateral error."""
    q_epsi: float = 100.0
    """Weight of the heading error."""
    r_delta: float = 0.4
    """Weight of the steering rate."""
    r_ax: float = 0.4
    """Weight of the jerk."""
    terminal: float = 1.0
    """Factor on the cost-to-go at the end of the horizon; above 1 it is priced above its worth."""
    observer_gain: float = 0.35
    """Gain of the disturbance observer, 0 to 1."""
    slip_cap: float = 0.14
    """Largest front slip angle that a command may ask for [rad]."""
    calm: float = 1.0
    """Factor on `q_ey` and `q_epsi` where the measurements are free of noise."""
    calm_gain: float = 0.35
    """Gain of the disturbance observer there; no less than `observer_gain` is used."""

    def __post_init__(self) -> None:
        """Refuse what no cost can mean."""
        check_weights(self)
        for name in ("observer_gain", "calm_gain"):
            if getattr(self, name) > 1.0:
                raise OptionError(f"weight {name}", getattr(self, name), "a number from 0 to 1")
        if self.slip_cap < 0.01:
            raise OptionError("weight slip_cap", self.slip_cap, "at least 0.01 rad")
        for name in ("r_delta", "r_ax"):
            if getattr(self, name) < SMALLEST_RATE:
                raise OptionError(
                    f"weight {name}", getattr(self, name), f"a number of at least {SMALLEST_RATE:g}"
                )


SHARED_RANGES = {k: v for k, v in Weights.RANGES.items() if not k.startswith("calm")}
"""Where tuning searches for controllers whose weights do not follow the noise."""
NERVOUS_WEIGHTS = Weights(
    q_vx=30.0, q_vy=0.0, q_r=0.0, q_ey=80.0, q_epsi=80.0, r_delta=0.05, r_ax=0.04, terminal=1.0,
    observer_gain=0.3, slip_cap=0.14,
)
"""What was set by hand for a world without noise; the laps of the networks' data are driven so."""
PAPER_WEIGHTS = replace(NERVOUS_WEIGHTS, q_epsi=800.0, r_delta=0.18, terminal=0.0)
"""Weights for `PAPER`, which loses the MuJoCo car with the weights of the full controller."""


def stage_weights(weights: Any, names: Sequence[str], N: int, nx: int, Ts: float) -> Array:
    """Diagonal weights of the states at every step of the horizon.

    Args:
        weights: Has a number `q_NAME` per name.
        names: Of `UNITS`, in the order of the model's first states.
        N: Periods of the horizon.
        nx: States of the model; those without a name weigh nothing.
        Ts: Control period [s]; weights are per second.

    Returns:
        Shape (N, nx), in SI units.
    """
    q = np.zeros((N, nx))
    for i, name in enumerate(names):
        q[:, i] = getattr(weights, f"q_{name}") / UNITS[name] ** 2 * Ts
    return q


def increment_weights(weights: Any, names: Sequence[str], Ts: float) -> Array:
    """Diagonal weights of the inputs' increments: of their rates, per second.

    Args:
        weights: Has a number `r_NAME` per name.
        names: Of `UNITS`, in the order of the inputs.
        Ts: Control period [s].

    Returns:
        Shape (nu,), in SI units.
    """
    return np.array([getattr(weights, f"r_{name}") / UNITS[name] ** 2 / Ts for name in names])


@lru_cache(maxsize=64)  # ten milliseconds each, and the same for every car of a kind
def kept_cost_to_go(
    car: Bicycle, tires: tuple[float, ...], q: tuple[float, ...], r_du: tuple[float, ...], Ts: float
) -> Array:
    """The same as `cost_to_go`, of numbers that can be looked up; read-only."""
    table = cost_to_go(car, np.array(tires), np.array(q), np.array(r_du), Ts)
    table.flags.writeable = False
    return table


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
            try:
                cost = solve_discrete_are(step, push, stage, np.diag(r_du)) - stage
            except (np.linalg.LinAlgError, ValueError):
                cost = _doubled(step, push, stage, r_du) - stage
            where = used + list(range(NX, NZ))
            table[n][np.ix_(where, where)] = 0.5 * (cost + cost.T)
    return table


def _doubled(step: Array, push: Array, stage: Array, r_du: Array) -> Array:
    """The Riccati equation's smallest solution, where eigenvalues do not tell it.

    With a weight of 0 an error may cost nothing for ever: the closed loop has an eigenvalue on the
    unit circle, and no solution stabilises. The cost over a finite time exists always; after k
    doublings it is that over 2^k periods.

    Source: Chu, Fan, Lin, Wang, Structure-preserving algorithms for periodic discrete-time
    algebraic Riccati equations, 2004, section 2.
    """
    F, G, H = step, (push / r_du) @ push.T, stage
    for _ in range(DOUBLINGS):
        inverse = np.linalg.solve(np.eye(len(F)) + G @ H, np.column_stack([F, G]))
        W, V = np.split(inverse, 2, axis=1)
        before = H
        F, G, H = F @ W, G + F @ V @ F.T, H + F.T @ H @ W
        G, H = 0.5 * (G + G.T), 0.5 * (H + H.T)
        if np.abs(H - before).max() <= 1e-12 * np.abs(H).max():
            break
    return H


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


@njit(cache=True)
def terminal_weight(h, vx, lags):
    """Terminal weight at a speed, and the steady state that it pulls towards, in place.

    Args:
        h: Handle of a `Horizon`: `table` and `x_ref` are read, `terminal` and `z_ref` written.
        vx: Reference speed at the end of the horizon [m/s].
        lags: Lags of steering and drive [s].
    """
    table, weight, z_ref, x_ref = h.table, h.terminal, h.z_ref, h.x_ref[-1]
    n = len(SPEEDS)
    k = 0
    while k < n - 2 and SPEEDS[k + 1] < vx:
        k += 1
    share = min(max((vx - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k]), 0.0), 1.0)
    loud = len(table) // 2 if h.calm != 1.0 else 0  # where the weights for quiet ones begin
    quiet = h.quiet[1] if h.calm != 1.0 else 0.0
    for servo in range(2):
        first, between = 0, 0.0
        known = h.table_lags[:, servo]
        if len(known) > 1:
            while first < len(known) - 2 and known[first + 1] < lags[servo]:
                first += 1
            between = (lags[servo] - known[first]) / (known[first + 1] - known[first])
            between = min(max(between, 0.0), 1.0)
        near, far = k + n * first, k + n * min(first + 1, len(known) - 1)
        for i in range(NZ):
            for j in range(NZ):
                # the drive's lag is that of the speed and what drives it, on a straight road alone
                if (_drives(i) and _drives(j)) == (servo == 1):
                    value = _between(table, near, far, i, j, share, between)
                    if quiet > 0.0:
                        calm = _between(table, near + loud, far + loud, i, j, share, between)
                        value += quiet * (calm - value)
                    weight[i, j] = value
    for i in range(NX):
        z_ref[i] = x_ref[i]
    z_ref[NX], z_ref[NX + 1] = x_ref[DELTA], x_ref[A]


@njit(cache=True)
def _between(table, near, far, i, j, share, between):
    """An entry of the table, linear between speeds and between lags."""
    value = (1.0 - share) * table[near, i, j] + share * table[near + 1, i, j]
    if between > 0.0:
        more = (1.0 - share) * table[far, i, j] + share * table[far + 1, i, j]
        value = (1.0 - between) * value + between * more
    return value


@njit(cache=True)
def _drives(i):
    """Whether a part of the terminal error belongs to the speed and its drive."""
    return i == VX or i == A or i == NX + 1
