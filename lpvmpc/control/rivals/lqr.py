"""Gain-scheduled LQR with preview feed-forward: what `lpv-mpc` is without constraints and solver.

The steering and the acceleration are those that hold the coming bends steadily, plus a feedback of
the errors against them, plus what the preview tells of how these steady states change:

    du = -K (x_1 - x_ss,1, u - u_ss,1) - F s,    s = sum over j of (Acl')^j S w_j

x_1 is the state that the last input leads to; x_ss and u_ss are the steady cornering of the path's
curvature at the predicted speed on the adapted tires; w_j is by how much the car cannot follow
them, as curvature, speed and disturbance change. S begins at the end of the preview with the
solution of the Riccati equation on a straight road, scheduled by speed and by the lags of steering
and drive as they are learned, and comes back by Riccati's recursion through the models of the
preview's periods; K and Acl follow from it. Within its bounds the plan is that of the quadratic
program without constraints. Commands are cut to what servo, front tires, drive and brakes take; the
feedback knows nothing of these bounds, nor of the road's edge, and that is what the quadratic
program of `lpv-mpc` is for. Estimates, adaptation, told delay, start and stop, and protections are
those of `lpv-mpc`.

Sources: Kapania and Gerdes, Design of a feedback-feedforward steering controller for accurate path
tracking and stability at the limits of handling, Vehicle System Dynamics 53 (2015), for steady
cornering as feed-forward; Tomizuka, Optimal continuous finite preview problem, IEEE TAC 20 (1975),
for the preview; Anderson and Moore, Optimal Control: Linear Quadratic Methods, chapter 4.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import DELTA, NU, NX, A
from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import NZ, SHARED_RANGES, Weights
from lpvmpc.control.formulation import Formulation
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.solver.checked import QPResult
from lpvmpc.control.stiffness.models import StiffnessModel
from lpvmpc.control.weights_file import chosen

PREVIEW = 20
"""Periods of preview."""


@dataclass(frozen=True, kw_only=True)
class LQRWeights(Weights):
    """Everything of `LQR` that is tuned; units and meaning are those of `cost.Weights`."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        name: ends for name, ends in SHARED_RANGES.items() if name != "terminal"
    }
    """Where tuning searches; the cost-to-go has no factor here."""

    q_vx: float = 20.0
    """Weight of the speed error."""
    r_delta: float = 0.3
    """Weight of the steering rate."""


class LQR(LPVMPC):
    """Linear-quadratic regulator about steady cornering, with preview."""

    name = "lqr"

    def __init__(
        self,
        car: VehicleParams,
        *,
        stiffness: StiffnessModel | None = None,
        weights: LQRWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            stiffness: Model of the axle forces; the shipped `network` by default.
            weights: Cost weights, or some of them by name; the shipped ones by default.
            delay: Known delay between command and effect [periods], compensated by prediction.

        Raises:
            OptionError: A value outside its domain.
        """
        super().__init__(
            car,
            stiffness=stiffness,
            weights=chosen(self.name, weights, LQRWeights()),
            formulation=Formulation(Np=PREVIEW),
            delay=delay,
        )

    def solve(self) -> QPResult:
        """The regulator's plan in place of the quadratic program's."""
        start = time.thread_time_ns()
        h = self.horizon
        z = np.zeros(len(h.g))
        regulate(h.handle, z)
        ok = bool(np.isfinite(z).all())
        used = (time.thread_time_ns() - start) * 1e-3
        return QPResult(z, ok, "SOLVED" if ok else "NOT_FINITE", 0.0, used, 0.0)


@njit(cache=True)
def gains(Ad, Bd, S, r_du, step, BtS, inverse, closed):
    """Feedback of one period and the closed loop that it makes, in place.

    K = (R + B'SB)^-1 B'SA for the state (x, u before) and the input's increment:
    A = [[Ad, Bd], [0, I]], B = [Bd; I].

    Args:
        Ad: Transition matrix, shape (11, 11).
        Bd: Input matrix, shape (11, 2).
        S: Cost of a state, its own period included, shape (13, 13).
        r_du: Price of the increments, shape (2,).
        step: Receives A, shape (13, 13).
        BtS: Receives B'S, shape (2, 13).
        inverse: Receives (R + B'SB)^-1, shape (2, 2).
        closed: Receives A - BK, shape (13, 13).
    """
    for i in range(NZ):
        for j in range(NZ):
            step[i, j] = 0.0
            if i < NX:
                step[i, j] = Ad[i, j] if j < NX else Bd[i, j - NX]
            elif i == j:
                step[i, j] = 1.0
    for m in range(NU):
        for j in range(NZ):
            value = S[NX + m, j]
            for i in range(NX):
                value += Bd[i, m] * S[i, j]
            BtS[m, j] = value
    M = np.empty((NU, NU))
    for m in range(NU):
        for p in range(NU):
            value = BtS[m, NX + p] + (r_du[m] if m == p else 0.0)
            for i in range(NX):
                value += BtS[m, i] * Bd[i, p]
            M[m, p] = value
    det = M[0, 0] * M[1, 1] - M[0, 1] * M[1, 0]
    inverse[0, 0], inverse[1, 1] = M[1, 1] / det, M[0, 0] / det
    inverse[0, 1], inverse[1, 0] = -M[0, 1] / det, -M[1, 0] / det
    for j in range(NZ):
        first, second = 0.0, 0.0
        for i in range(NZ):
            first += BtS[0, i] * step[i, j]
            second += BtS[1, i] * step[i, j]
        K0 = inverse[0, 0] * first + inverse[0, 1] * second
        K1 = inverse[1, 0] * first + inverse[1, 1] * second
        for i in range(NX):
            closed[i, j] = step[i, j] - Bd[i, 0] * K0 - Bd[i, 1] * K1
        closed[NX, j] = step[NX, j] - K0
        closed[NX + 1, j] = step[NX + 1, j] - K1


@njit(cache=True)
def back(S, q, step, BtS, closed, out):
    """Riccati's recursion over one period, S = Q + A'S (A - BK), in place.

    Args:
        S: Cost of the state after the period, shape (13, 13).
        q: Price of the states, shape (11,).
        step: See `gains`, also for the rest.
        BtS: As above.
        closed: As above.
        out: Receives the cost of the state before, shape (13, 13).
    """
    half = np.empty((NZ, NZ))
    for i in range(NZ):
        for j in range(NZ):
            value = 0.0
            for k in range(NZ):
                value += S[i, k] * closed[k, j]
            half[i, j] = value
    for i in range(NZ):
        for j in range(i + 1):
            value = q[i] if i == j and i < NX else 0.0
            for k in range(NZ):
                value += step[k, i] * half[k, j]
            out[i, j] = out[j, i] = value


@njit(cache=True)
def regulate(h, z):
    """The regulator's inputs over the preview, within their bounds, in place.

    Args:
        h: Handle of a `Horizon`, as `period.write` leaves it.
        z: Receives the inputs in units of `h.scale`, period by period; what follows is left.
    """
    N, q = len(h.plan), h.q[0]
    S, before = h.terminal.copy(), np.empty((NZ, NZ))
    for i in range(NX):
        S[i, i] += q[i]
    step, closed = np.empty((NZ, NZ)), np.empty((NZ, NZ))
    BtS, inverse = np.empty((N, NU, NZ)), np.empty((N, NU, NU))
    s, w, pull = np.zeros((N, NZ)), np.empty(NZ), np.empty(NZ)
    for k in range(N - 1, -1, -1):  # s[k]: what the preview tells of the state after period k
        gains(h.Ad[k], h.Bd[k], S, h.r_du, step, BtS[k], inverse[k], closed)
        if k == 0:
            break
        now, then = h.x_ref[k - 1], h.x_ref[k]
        for i in range(NX):
            value = h.cd[k, i] - then[i] + h.Bd[k, i, 0] * now[DELTA] + h.Bd[k, i, 1] * now[A]
            for j in range(NX):
                value += h.Ad[k, i, j] * now[j]
            w[i] = value
        w[NX], w[NX + 1] = now[DELTA] - then[DELTA], now[A] - then[A]
        for i in range(NZ):
            value = s[k, i]
            for j in range(NZ):
                value += S[i, j] * w[j]
            pull[i] = value
        for i in range(NZ):
            value = 0.0
            for j in range(NZ):
                value += closed[j, i] * pull[j]
            s[k - 1, i] = value
        back(S, q, step, BtS[k], closed, before)
        S, before = before, S
    x, u, f = h.schedule[0].copy(), h.queue[-1].copy(), np.empty(NZ)
    want = np.empty(NU)
    for k in range(N):
        now = h.x_ref[k]
        for i in range(NX):
            value = h.cd[k, i] - now[i] + h.Bd[k, i, 0] * u[0] + h.Bd[k, i, 1] * u[1]
            for j in range(NX):
                value += h.Ad[k, i, j] * x[j]
            f[i] = value
        f[NX], f[NX + 1] = u[0] - now[DELTA], u[1] - now[A]
        for m in range(NU):
            value = s[k, NX + m]
            for i in range(NX):
                value += h.Bd[k, i, m] * s[k, i]
            for i in range(NZ):
                value += BtS[k, m, i] * f[i]
            want[m] = value
        for m in range(NU):
            v = -(inverse[k, m, 0] * want[0] + inverse[k, m, 1] * want[1])
            if m < len(h.du_max):
                v = min(max(v, -h.du_max[m]), h.du_max[m])
            f[NX + m] = min(max(u[m] + v, h.u_lo[k, m]), h.u_hi[k, m]) - u[m]
        for i in range(NX):
            x[i] = f[i] + now[i] + h.Bd[k, i, 0] * f[NX] + h.Bd[k, i, 1] * f[NX + 1]
        for m in range(NU):
            u[m] += f[NX + m]
            z[k * NU + m] = u[m] / h.scale[m]
