"""LMPC with PSO-PID, the paper's baseline: lateral MPC on the linear bicycle, speed by a PID.

The lateral model has four states (vy, r, ey, epsi), constant cornering stiffness, and matrices
that depend on the measured speed alone. It is discretised by Euler's rule, as the paper prints it
for both controllers; the errors' reference is zero; there is no observer. The PID does not know
what the steering does, and the steering takes the speed as it comes: that is the decoupling which
the paper argues against. Gains come from particle-swarm optimisation, hence the name.

`lmpc-pso-pid` has the protections of `lpv-mpc`, none of which changes the method: a car far beside
its path is led back to it, the front tires are not steered past their peak, wheels neither spin nor
lock, the PID knows the delay of its commands, and a factor on the nominal stiffness is tuned. The
paper's plain form, which loses the car from 0.3 m beside a straight road, is `lmpc-pso-pid-plain`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.hold import EULER, EXACT
from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import SLACK_WEIGHTS, increment_weights, stage_weights
from lpvmpc.control.formulation import DELTA_MAX_PAPER, DELTA_STEP_PAPER, EY_MAX, SCALE
from lpvmpc.control.horizon import Horizon
from lpvmpc.control.period import BACK, NEAR
from lpvmpc.control.pid import PIDGains, ProtectedPID, SpeedPID
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
EULER_FROM = 6.0
"""Speed from which on Euler's rule is used [m/s]: it is stable above 5.3 for this package's car."""


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
        "stiffness": (0.3, 1.5),
        "slip_cap": (0.1, 0.2),
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
    stiffness: float = 1.0
    """Factor on the nominal cornering stiffness; the plain form has none."""
    slip_cap: float = 0.14
    """Largest front slip angle that a command may ask for [rad]; the plain form has none."""

    def __post_init__(self) -> None:
        """Refuse what no cost can mean."""
        super().__post_init__()
        if self.r_delta <= 0.0:
            raise OptionError("weight r_delta", self.r_delta, "a number above 0")
        if self.slip_cap < 0.01:
            raise OptionError("weight slip_cap", self.slip_cap, "at least 0.01 rad")


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
def _held(h, vx):
    """One period of the model: x+ = (Ad, Bd, Ed) (x, delta, -vx kappa), shape (6, 6).

    Euler's rule, Ad = I + A Ts, as the paper has it. With the protections the exact hold, the
    exponential of the augmented matrix, below `EULER_FROM`, where Euler's is unstable.
    """
    A, B, size = np.empty((NX, NX)), np.empty((NX, 1)), NX + 2
    lateral(vx, h.car, A, B)
    M = np.zeros((size, size))
    for i in range(NX):
        for j in range(NX):
            M[i, j] = A[i, j] * h.Ts
        M[i, NX] = B[i, 0] * h.Ts
    M[EPSI, NX + 1] = h.Ts
    step = np.eye(size)
    if h.method == EULER or vx >= EULER_FROM:
        return step + M
    doublings = 0
    while np.abs(M).sum() > 0.5:
        M *= 0.5
        doublings += 1
    for n in range(8, 0, -1):  # Horner's scheme of the exponential's series
        step = np.eye(size) + _product(M, step) / n
    for _ in range(doublings):
        step = _product(step, step)
    return step


@njit(cache=True)
def _product(left, right):
    """The product of two small matrices, with BLAS left out."""
    out = np.zeros(left.shape)
    for i in range(len(left)):
        for k in range(len(left)):
            for j in range(len(left)):
                out[i, j] += left[i, k] * right[k, j]
    return out


@njit(cache=True)
def _begin(h, vx, kappa):
    """Predict from schedule[0] over the delay, in place; `queue` holds the commands until then."""
    x_next, v, x = np.empty(NX), max(vx, h.car[6]), h.schedule[0, 1:]
    step = _held(h, vx)
    for k in range(len(h.queue) - 1):
        for i in range(NX):
            x_next[i] = step[i, NX] * h.queue[k + 1, 0] - step[i, NX + 1] * v * kappa[k]
            for j in range(NX):
                x_next[i] += step[i, j] * x[j]
        x[:] = x_next


@njit(cache=True)
def _write(h, vx, kappa):
    """Write the QP of one period, in place, discretised as above."""
    v, delay = max(vx, h.car[6]), len(h.queue) - 1
    step = _held(h, vx)
    for k in range(len(h.Ad)):
        for i in range(NX):
            for j in range(NX):
                h.Ad[k, i, j] = step[i, j]
            h.Bd[k, i, 0] = step[i, NX]
            h.cd[k, i] = -step[i, NX + 1] * v * kappa[delay + k]
        h.u_lo[k, 0], h.u_hi[k, 0] = -h.delta_max, h.delta_max
    if h.approach:
        _protect(h, v)
    condense(h)


@njit(cache=True)
def _protect(h, vx):
    """Lead the car back to its path, and bound the front slip angle, in place.

    As `period.references` and `period.bounds` do for `lpv-mpc`; the flow at the front axle is that
    of the schedule, and what the increment bounds can reach is always allowed.
    """
    x_ref, schedule, u_lo, u_hi = h.x_ref, h.schedule, h.u_lo, h.u_hi
    lf, step, u_prev = h.car[2], h.du_max[0], h.queue[-1, 0]
    aside = schedule[0, 1 + EY]
    excess = max(abs(aside) - NEAR, 0.0)
    h.soft_bound[0] = EY_MAX + excess
    for k in range(len(u_lo)):
        ey = np.sign(aside) * excess * np.exp(-(k + 1) * h.Ts / BACK)
        x_ref[k, EY] = ey
        x_ref[k, EPSI] = -np.arctan(ey / BACK / vx)
        flow = np.arctan2(schedule[k, 1 + VY] + lf * schedule[k, 1 + R], vx)
        least = (u_lo[k - 1, 0] if k > 0 else u_prev) - step
        most = (u_hi[k - 1, 0] if k > 0 else u_prev) + step
        low = max(-h.delta_max, min(flow - h.slip_cap, h.delta_max))
        high = min(h.delta_max, max(flow + h.slip_cap, -h.delta_max))
        u_lo[k, 0] = min(max(low, least), most)
        u_hi[k, 0] = max(min(high, most), least)


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
        protect: bool = True,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            weights: Cost weights and PID gains, or some of them by name; the shipped by default.
            delay: Known delay between command and effect [periods]; the steering is compensated
                by prediction, and unless plain the PID's as well.
            protect: Whether with the protections, or in the paper's plain form.

        Raises:
            OptionError: A value outside its domain.
        """
        delay = checked_delay(delay)
        if not protect:
            self.name = f"{LMPC.name}-plain"
        self.weights = w = chosen(self.name, weights, LMPCWeights())
        self.stiffness = ConstantStiffness(car, w.stiffness if protect else 1.0)
        N, Ts = self.Np, self.Ts
        self.pid = ProtectedPID(car, w, Ts, delay) if protect else SpeedPID(car, w, Ts)
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
            method=EXACT if protect else EULER,
            approach=protect,
            slip_cap=w.slip_cap if protect else np.pi,
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
        if isinstance(self.pid, ProtectedPID):
            h.plan[:, 1] = self.pid.command(state, preview.vx_ref)
        else:
            h.plan[:, 1] = self.pid.command(state.vx, preview.vx_ref[0])

    def accept(self, z: Array) -> None:
        """As every tracker, but BLAS sums the prediction: traces keep its last bits."""
        super().accept(z)
        h = self.horizon
        h.prediction[1:, 1:] = h.free + h.forced @ z[: self.Np]
