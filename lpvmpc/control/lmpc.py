"""LMPC with PSO-PID, the paper's baseline: lateral MPC on the linear bicycle, speed by a PID.

The lateral model has four states (vy, r, ey, epsi), constant cornering stiffness, and matrices
that depend on the measured speed alone. It is discretised by Euler's rule, as the paper prints it
for both controllers; the errors' reference is zero; there is no observer. The PID does not know
what the steering does, and the steering takes the speed as it comes: that is the decoupling which
the paper argues against. Gains come from particle-swarm optimisation, hence the name.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.formulation import (
    DELTA_MAX_PAPER,
    DELTA_STEP_PAPER,
    EY_MAX,
    SCALE,
    SLACK_WEIGHTS,
    UNITS,
)
from lpvmpc.control.pid import PIDGains, SpeedPID
from lpvmpc.control.qp import QPSolver, condense, n_rows
from lpvmpc.control.stiffness.models import ConstantStiffness
from lpvmpc.control.tracker import BRAKING, NOT_FINITE
from lpvmpc.control.weights_file import chosen
from lpvmpc.errors import OptionError
from lpvmpc.interface import Command, Diagnostics, Preview, State
from lpvmpc.units import Array

NX = 4
"""Number of model states: vy, r, ey, epsi."""
VY, R, EY, EPSI = range(NX)
STEER_SCALE = SCALE[:1].copy()
"""Unit of the steering angle inside the QP [rad]."""


@dataclass(frozen=True, kw_only=True)
class LMPCWeights(PIDGains):
    """Everything of `LMPC` that is tuned.

    Costs are per second and normalised by `formulation.UNITS`.
    """

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "q_vy": (0.01, 10.0),
        "q_r": (0.01, 10.0),
        "q_ey": (8.0, 800.0),
        "q_epsi": (80.0, 8000.0),
        "r_delta": (0.018, 1.8),
        **PIDGains.RANGES,
    }
    """Where tuning searches: a decade to either side of the values set by hand, what these leave
    out near nothing."""

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
def _period(
    x, vx, kappa, queue, car, Ts, du_max, delta_max, q, r_du, work, H, g, C, lo, hi,
):  # fmt: skip
    """Predict over the delay, and write the QP of one period, in place; x becomes its start.

    Euler's rule, x+ = (I + A Ts) x + B Ts delta - (0, 0, 0, vx Ts) kappa. `queue` holds the
    commands on their way to the car and, last, the one of the period before.
    """
    Ad, Bd, cd, x_ref, u_lo, u_hi, terminal, z_ref, free, forced = work
    A, B, x_next = np.empty((NX, NX)), np.empty((NX, 1)), np.empty(NX)
    lateral(vx, car, A, B)
    v = max(vx, car[6])
    delay = len(queue) - 1
    for k in range(delay):
        for i in range(NX):
            rate = B[i, 0] * queue[k + 1, 0]
            for j in range(NX):
                rate += A[i, j] * x[j]
            x_next[i] = x[i] + Ts * rate
        x_next[EPSI] -= Ts * v * kappa[k]
        x[:] = x_next
    u_prev = queue[delay]
    for k in range(len(Ad)):
        for i in range(NX):
            for j in range(NX):
                Ad[k, i, j] = A[i, j] * Ts
            Ad[k, i, i] += 1.0
            Bd[k, i, 0] = B[i, 0] * Ts
            cd[k, i] = 0.0
        cd[k, EPSI] = -Ts * v * kappa[delay + k]
        u_lo[k, 0], u_hi[k, 0] = -delta_max, delta_max
    condense(
        Ad, Bd, cd, x, x_ref, q, r_du, u_prev, u_lo, u_hi, du_max, EY, 1, EY_MAX, SLACK_WEIGHTS,
        STEER_SCALE, terminal, z_ref, H, g, C, lo, hi, free, forced,
    )  # fmt: skip


class LMPC:
    """Lateral LPV-MPC on the linear bicycle, coordinated with a PID on the speed.

    Steering: |delta| and its increment hard, |ey| soft, as in the `LPVMPC`, of which it also has
    the fallback: after a refused solve the previous plan, after three in a row with braking.

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
        if not (isinstance(delay, int) and 0 <= delay <= 30):
            raise OptionError("delay", delay, "a whole number of periods from 0 to 30")
        self.car = car
        self.weights = chosen(self.name, weights, LMPCWeights())
        self.delay = delay
        self.stiffness = ConstantStiffness(self.car)
        self.pid = SpeedPID(self.car, self.weights, self.Ts)
        self._allocate()
        self.reset(np.random.default_rng(0))
        self._warm_up()

    @property
    def preview_steps(self) -> int:
        """Periods of preview needed: the horizon, and the delay before it begins."""
        return self.Np + self.delay

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        self.pid.reset()
        self.solver.reset()
        self.diagnostics = Diagnostics()
        self._started, self._refused = False, 0
        self._ax = 0.0
        self._plan[:] = 0.0
        self._queue[:] = 0.0
        self._prediction[:] = 0.0

    def command(self, state: State, preview: Preview) -> Command:
        """Command of one control period.

        Args:
            state: The car's state now.
            preview: Reference over at least `preview_steps` periods.

        Returns:
            Steering angle [rad] and acceleration [m/s2], within the hard bounds.
        """
        start = time.thread_time_ns()
        if len(preview.kappa) <= self.preview_steps:
            raise OptionError(
                "preview length", len(preview.kappa), f"at least {self.preview_steps + 1} points"
            )
        x = np.array([state.vy, state.r, preview.ey, preview.epsi])
        finite = math.isfinite(x.sum() + state.vx + state.delta)
        built, result = start, NOT_FINITE
        if finite:
            self._build(x, state, preview)
            built = time.thread_time_ns()
            result = self.solver.solve(self._H, self._g, self._C, self._lo, self._hi)
            self._ax = float(self.pid.command(state.vx, preview.vx_ref[0]))
        if result.solved:
            steering = result.z[: self.Np]
            self._plan[:, 0] = steering * STEER_SCALE[0]
            self._prediction[0, 1:] = x
            self._prediction[1:, 1:] = self._free + self._forced @ steering
            self._prediction[:, 0] = state.vx
            self._refused, fallback = 0, ""
        else:
            self._refused += 1
            fallback = "shifted" if self._refused <= 3 else "braking"
        delta = float(self._plan[0, 0])
        command = Command(delta, BRAKING if fallback == "braking" else self._ax)
        self._queue[:-1] = self._queue[1:]
        self._queue[-1] = delta
        self.diagnostics = Diagnostics(
            result.solved,
            fallback,
            result.status,
            result.residual,
            (built - start) * 1e-3,
            result.solve_us,
            result.check_us,
            self._prediction.copy(),
        )
        self._shift()
        return command

    def _build(self, x: Array, state: State, preview: Preview) -> None:
        """Write the QP; the first period takes the measured steering as the one before."""
        if not self._started:
            self._queue[:] = min(max(state.delta, -self._delta_max), self._delta_max)
            self._started = True
        _period(
            x, state.vx, preview.kappa, self._queue, self._constants, self.Ts, self._du_max,
            self._delta_max, self._q, self._r, self._work, self._H, self._g, self._C, self._lo,
            self._hi,
        )  # fmt: skip

    def _shift(self) -> None:
        """Make this period's plan and prediction the next one's fallback."""
        self._plan[:-1] = self._plan[1:]
        self._prediction[:-1] = self._prediction[1:]

    def _warm_up(self) -> None:
        """Load the compiled code before the first period needs it; then start anew."""
        still = State(0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(4))
        flat = np.zeros(self.preview_steps + 1)
        self.command(still, Preview(0.0, 0.0, 0.0, flat, flat + 10.0, flat, flat, flat))
        self.reset(np.random.default_rng(0))

    def _allocate(self) -> None:
        """Arrays that every period reuses, and numbers that never change."""
        w, car, N, Ts = self.weights, self.car, self.Np, self.Ts
        n, m = N + 1, n_rows(N, 1, 1)
        # Bounded by |ey| alone, ProxQP stops at wrong multipliers now and then where its residuals
        # are just good enough (8 of 1657 periods of paper-loop with q_epsi 2000): ten times the
        # accuracy takes one more iteration there, and none where no bound is active.
        self.solver = QPSolver(n, m, tolerance=1e-7)
        self._H, self._g, self._C = np.zeros((n, n)), np.zeros(n), np.zeros((m, n))
        self._lo, self._hi = np.zeros(m), np.zeros(m)
        self._free, self._forced = np.zeros((N, NX)), np.zeros((N, NX, N))
        self._work = (
            np.zeros((N, NX, NX)),  # Ad
            np.zeros((N, NX, 1)),  # Bd
            np.zeros((N, NX)),  # cd
            np.zeros((N, NX)),  # x_ref: the paper's plain one, zero
            np.zeros((N, 1)),  # u_lo
            np.zeros((N, 1)),  # u_hi
            np.zeros((NX + 1, NX + 1)),  # no terminal weight but the last step's
            np.zeros(NX + 1),  # its reference
            self._free,
            self._forced,
        )
        self._plan: Array = np.zeros((N, 1))
        self._prediction: Array = np.zeros((N + 1, 5))
        self._queue: Array = np.zeros((self.delay + 1, 1))
        Cf, _, Cr, _ = self.stiffness.tires
        self._constants = np.array([car.m, car.Iz, car.lf, car.lr, Cf, Cr, car.vx_min])
        costs = [getattr(w, f"q_{name}") / UNITS[name] ** 2 for name in ("vy", "r", "ey", "epsi")]
        self._q = np.tile(np.array(costs) * Ts, (N, 1))
        self._r = np.array([w.r_delta / UNITS["delta"] ** 2 / Ts])
        self._du_max = np.array([min(DELTA_STEP_PAPER, car.delta_rate_max * Ts)])
        self._delta_max = min(DELTA_MAX_PAPER, car.delta_max)
