"""LMPC with PSO-PID, the paper's baseline: lateral MPC on the linear bicycle, speed by a PID.

The lateral model has four states (vy, r, ey, epsi), constant cornering stiffness, and matrices
that depend on the measured speed alone. It is discretised by Euler's rule, as the paper prints it
for both controllers; the errors' reference is zero; there is no observer. The PID does not know
what the steering does, and the steering takes the speed as it comes: that is the decoupling which
the paper argues against. Gains come from particle-swarm optimisation, hence the name.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import SLACK_WEIGHTS, increment_weights, stage_weights
from lpvmpc.control.formulation import DELTA_MAX_PAPER, DELTA_STEP_PAPER, EY_MAX, SCALE
from lpvmpc.control.horizon import Horizon
from lpvmpc.control.pid import PIDGains, SpeedPID
from lpvmpc.control.qp import condense
from lpvmpc.control.stiffness.models import ConstantStiffness
from lpvmpc.control.tracker import Tracker, checked_delay
from lpvmpc.control.weights_file import chosen
from lpvmpc.errors import OptionError
from lpvmpc.interface import Preview, State
from lpvmpc.units import Array

NX = 4
"""Number of model states: vy, r, ey, epsi."""
VY, R, EY, EPSI = range(NX)


@dataclass(frozen=True, kw_only=True)
class LMPCWeights(PIDGains):
    """Everything of `LMPC` that is tuned.

    Costs are per second and normalised by `cost.UNITS`.
    """

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "q_vy": (0.001, 100.0),
        "q_r": (0.001, 10.0),
        "q_ey": (5.0, 800.0),
        "q_epsi": (5.0, 8000.0),
        "r_delta": (0.02, 5.0),
        **PIDGains.RANGES,
    }
    """Where tuning searches: wide enough that no optimum lies on a bound."""

    q_vy: float = 0.0
    """Weight of the lateral speed."""
    q_r: float = 0.0
    """Weight of the yaw rate."""
    q_ey: float = 80.0
    """Weight of the lateral error."""
    q_epsi: float = 800.0
    """Weight of the heading error."""
    r_delta: float = 0.18
    """Weight of the steering rate."""

    def __post_init__(self) -> None:
        """Refuse what no cost can mean."""
        super().__post_init__()
        if self.r_delta <= 0.0:
            raise OptionError("weight r_delta", self.r_delta, "a number above 0")


@njit(cache=True)
def lateral(vx, car, A, B):
    """Matrices of the linear bicycle x' = A x + B delta - (0, 0, 0, vx) kappa, in place.

    vy'   = -(Cf + Cr) / (m vx) vy - (vx + (lf Cf - lr Cr) / (m vx)) r + Cf / m delta
    r'    = -(lf Cf - lr Cr) / (Iz vx) vy - (lf^2 Cf + lr^2 Cr) / (Iz vx) r + lf Cf / Iz delta
    ey'   = vy + vx epsi
    epsi' = r - vx kappa

    Args:
        vx: Speed [m/s].
        car: Constants (m, Iz, lf, lr, Cf, Cr, vx_min), shape (7,).
        A: Receives the system matrix, shape (4, 4).
        B: Receives the input column, shape (4, 1).

    Source: Rajamani, Vehicle Dynamics and Control, section 2.3; the printed signs corrected as in
    docs/derivations.md.
    """
    m, Iz, lf, lr, Cf, Cr, vx_min = car
    v = max(vx, vx_min)
    A[:] = 0.0
    B[:] = 0.0
    A[VY, VY] = -(Cf + Cr) / (m * v)
    A[VY, R] = -(lf * Cf - lr * Cr) / (m * v) - v
    A[R, VY] = -(lf * Cf - lr * Cr) / (Iz * v)
    A[R, R] = -(lf * lf * Cf + lr * lr * Cr) / (Iz * v)
    A[EY, VY], A[EY, EPSI] = 1.0, v
    A[EPSI, R] = 1.0
    B[VY, 0] = Cf / m
    B[R, 0] = lf * Cf / Iz


@njit(cache=True)
def _begin(h, vx, kappa):
    """Predict from schedule[0] over the delay, in place; `queue` holds the commands until then.

    Euler's rule, x+ = (I + A Ts) x + B Ts delta - (0, 0, 0, vx Ts) kappa.
    """
    A, B, x_next = np.empty((NX, NX)), np.empty((NX, 1)), np.empty(NX)
    lateral(vx, h.car, A, B)
    v, Ts, x = max(vx, h.car[6]), h.Ts, h.schedule[0, 1:]
    for k in range(len(h.queue) - 1):
        for i in range(NX):
            rate = B[i, 0] * h.queue[k + 1, 0]
            for j in range(NX):
                rate += A[i, j] * x[j]
            x_next[i] = x[i] + Ts * rate
        x_next[EPSI] -= Ts * v * kappa[k]
        x[:] = x_next


@njit(cache=True)
def _write(h, vx, kappa):
    """Write the QP of one period, in place, discretised as above."""
    A, B = np.empty((NX, NX)), np.empty((NX, 1))
    lateral(vx, h.car, A, B)
    v, Ts, delay = max(vx, h.car[6]), h.Ts, len(h.queue) - 1
    for k in range(len(h.Ad)):
        for i in range(NX):
            for j in range(NX):
                h.Ad[k, i, j] = A[i, j] * Ts
            h.Ad[k, i, i] += 1.0
            h.Bd[k, i, 0] = B[i, 0] * Ts
            h.cd[k, i] = 0.0
        h.cd[k, EPSI] = -Ts * v * kappa[delay + k]
        h.u_lo[k, 0], h.u_hi[k, 0] = -h.delta_max, h.delta_max
    condense(h)


class LMPC(Tracker):
    """Lateral LPV-MPC on the linear bicycle, coordinated with a PID on the speed.

    Steering: |delta| and its increment hard, |ey| soft, as in the `LPVMPC`.

    Source: Kebbati et al., section IV, where it is called LMPC; Kebbati et al., Coupled PSO-PID
    based longitudinal control and LPV-MPC based lateral control for autonomous vehicles, ECC 2022.
    """

    name = "lmpc-pso-pid"
    Np = 10
    """Prediction horizon [periods]."""
    Ts = 0.033
    """Control period [s]."""

    def __init__(
        self,
        car: VehicleParams,
        *,
        weights: LMPCWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            weights: Cost weights and PID gains, or some of them by name; the shipped by default.
            delay: Known delay between command and effect [periods]; the steering is compensated
                by prediction, the PID is not.

        Raises:
            OptionError: A value outside its domain.
        """
        delay = checked_delay(delay)
        self.weights = w = chosen(self.name, weights, LMPCWeights())
        self.stiffness = ConstantStiffness(car)
        self.pid = SpeedPID(car, w, self.Ts)
        N, Ts = self.Np, self.Ts
        Cf, _, Cr, _ = self.stiffness.tires
        horizon = Horizon.allocated(
            N,
            NX,
            1,
            ns=5,  # the speed beside the model's states
            delay=delay,
            Ts=Ts,
            car=np.array([car.m, car.Iz, car.lf, car.lr, Cf, Cr, car.vx_min]),
            q=stage_weights(w, ("vy", "r", "ey", "epsi"), N, NX, Ts),
            r_du=increment_weights(w, ("delta",), Ts),
            slack_weights=SLACK_WEIGHTS,
            delta_max=min(DELTA_MAX_PAPER, car.delta_max),
            du_max=np.array([min(DELTA_STEP_PAPER, car.delta_rate_max * Ts)]),
            soft=EY,
            soft_bound=EY_MAX,
            scale=SCALE[:1],
        )
        # Bounded by |ey| alone, ProxQP stops at wrong multipliers now and then where its residuals
        # are just good enough (8 of 1657 periods of paper-loop with q_epsi 2000): ten times the
        # accuracy takes one more iteration there, and none where no bound is active.
        super().__init__(car, horizon, tolerance=1e-7)

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        super().reset(rng)
        self.pid.reset()

    def estimate(self, state: State, preview: Preview) -> None:
        """The measured state, predicted over the delay."""
        super().estimate(state, preview)
        h = self.horizon
        if self.informed is None:  # the measured steering is the command before
            h.queue[:, 0] = min(max(state.delta, -h.delta_max), h.delta_max)
        if self.delay:
            _begin(h.handle, state.vx, preview.kappa)

    def write_qp(self, state: State, preview: Preview) -> None:
        """The QP decides on the steering, the PID on the acceleration."""
        h = self.horizon
        _write(h.handle, state.vx, preview.kappa)
        h.plan[:, 1] = self.pid.command(state.vx, preview.vx_ref[0])

    def accept(self, z: Array) -> None:
        """As every tracker, but BLAS sums the prediction: traces keep its last bits."""
        super().accept(z)
        h = self.horizon
        h.prediction[1:, 1:] = h.free + h.forced @ z[: self.Np]
