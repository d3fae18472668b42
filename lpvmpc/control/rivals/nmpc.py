"""Nonlinear MPC: what `lpv-mpc` is measured against where time does not matter.

In every control period an optimal control problem of 20 periods is solved on a nonlinear model of
the car, by sequential quadratic programming: Gauss-Newton Hessians, HPIPM for the quadratic
programs, and a line search on the cost. It has what `lpv-mpc` has: the lags of steering and drive,
relaxation and roll; the car's own tires at the loads that the model's states give; an observer for
what the model lacks; friction, stiffness and the steering's lag learned online; slip cap and
traction control; and geometry after refused solves. In place of an anti-lock model, which it lacks
as well, the acceleration is bounded by the friction ellipses of the axles. The soft bound on the
lateral error is left out: its weight does the same.

`nmpc-textbook` is what most papers have in its place: the dynamic bicycle with linear tires, no
lags, no observer, nothing learned.

The weights are set by hand, by a look at seven sets on pieces of the reported roads in the ideal
world (the textbook's: six sets, on whole roads, `rtk` among them); the terminal weight of `nmpc` is
five times the cost-to-go. A search by the common budget takes 260 evaluations of eight runs each
and has not been made: `eval/tune.py --controller nmpc` makes it.

A user who has acados can compare with its solver: the model of `nmpc_model` is written out, and
its cost and bounds are those of `nmpc_sqp`; a controller of one's own is named as `module:Class`.

Sources: Diehl, Bock, Schloeder, A real-time iteration scheme for nonlinear optimization in optimal
feedback control, SIAM J. Control Optim. 43 (2005), for shifting and Gauss-Newton; Nocedal and
Wright, Numerical Optimization, chapter 18; Frison and Diehl, HPIPM, IFAC 2020; Gros et al., From
linear to nonlinear MPC, Int. J. Control 93 (2020); Verschueren et al., Towards time-optimal race
car driving using nonlinear MPC in real-time, CDC 2014, for the car.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lpvmpc.car.axle import axles
from lpvmpc.car.bicycle import DELTA, NU, NX, PHI, VX, VY, A, Bicycle, R
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import Tire
from lpvmpc.control.cost import (
    NZ,
    SHARED_RANGES,
    SPEEDS,
    Weights,
    cost_to_go,
    increment_weights,
    stage_weights,
)
from lpvmpc.control.formulation import DELTA_MAX_PAPER, DELTA_STEP_PAPER, SCALE
from lpvmpc.control.horizon import Horizon
from lpvmpc.control.lpv_mpc import LOOK_AHEAD, TABLE_LAGS, WALK
from lpvmpc.control.rivals import nmpc_sqp
from lpvmpc.control.rivals.nmpc_model import Model, rates, slips
from lpvmpc.control.rivals.staged_qp import StagedQP, write
from lpvmpc.control.servo import LATENCIES, ServoBank, drive_of, steering_of
from lpvmpc.control.solver.checked import QPResult
from lpvmpc.control.stiffness.adaptation import CF, CR, MU, TireAdaptation
from lpvmpc.control.tracker import Tracker, checked_delay
from lpvmpc.control.weights_file import chosen
from lpvmpc.interface import Preview, State
from lpvmpc.units import Array

NP, TS = 20, 0.033
"""Prediction horizon [periods], control period [s]."""
ITERATIONS = 6
"""Most quadratic programs in a period: one to two are the rule, six take a third of the period."""
TOLERANCE = 1e-3
"""Largest KKT residual of a quadratic program that is used; the line search judges what it is
worth."""
V_SLIP_TEXTBOOK = 3.0
"""Speed below which the textbook's slip angles are those at this one [m/s]: without relaxation the
model becomes too stiff for the integrator."""


@dataclass(frozen=True, kw_only=True)
class NMPCWeights(Weights):
    """Everything of `NMPC` that is tuned; units and meaning are those of `cost.Weights`."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        **SHARED_RANGES,
        "terminal": (0.5, 20.0),
        "slip_cap": (0.1, 0.3),
    }
    """Where tuning searches."""

    q_vx: float = 30.0
    """Weight of the speed error."""
    q_vy: float = 0.1
    """Weight of the lateral speed error."""
    q_r: float = 0.005
    """Weight of the yaw rate error."""
    q_ey: float = 150.0
    """Weight of the lateral error."""
    q_epsi: float = 30.0
    """Weight of the heading error: that of steady cornering is not the best one in a transient."""
    r_delta: float = 0.05
    """Weight of the steering rate."""
    r_ax: float = 0.04
    """Weight of the jerk."""
    terminal: float = 5.0
    """Factor on the cost-to-go at the end of the horizon."""
    observer_gain: float = 0.5
    """Gain of the disturbance observer, 0 to 1."""


class NMPC(Tracker):
    """Nonlinear MPC with the knowledge, estimates and protections of `lpv-mpc`."""

    name = "nmpc"
    textbook = False
    """Whether the model is the plain dynamic bicycle, and nothing is learned."""
    by_hand = NMPCWeights()
    """What it drives with where no weights are given and none are shipped."""
    sizes = NX, NU
    """States and inputs of the quadratic program."""

    def __init__(
        self,
        car: VehicleParams,
        tires: tuple[Tire, Tire],
        *,
        weights: NMPCWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            tires: Its front and rear tires, as the data sheet has them.
            weights: Cost weights, or some of them by name; those set by hand by default.
            delay: Known delay between command and effect [periods], compensated by prediction.

        Raises:
            OptionError: A value outside its domain.
            LPVMPCError: CasADi or its HPIPM is not installed.
        """
        delay = checked_delay(delay)
        self.weights = w = chosen(self.name, weights, self.by_hand)
        bicycle = Bicycle.of(car)
        if self.textbook:
            bicycle = bicycle.simplified(lags=False, relaxation=False, roll=False, trail=False)
        self._nominal = bicycle
        v_slip = V_SLIP_TEXTBOOK if self.textbook else car.vx_min
        self.model = Model(bicycle, *axles(car, *tires), self.textbook, car.Cf, car.Cr, v_slip)
        self._limits = nmpc_sqp.Limits(car.mu, car.m_eff, car.brake_front, not self.textbook)
        self._slip_cap = float(w.slip_cap)
        learned = () if self.textbook else (steering_of, drive_of)
        self.banks = [ServoBank(servo(car), TS, delay) for servo in learned]
        self.adaptation = None if self.textbook else TireAdaptation(car, TS)
        self._learned = np.ones(3)
        self._kappa = np.zeros(NP + 1)
        self._us, self._xs = np.zeros((NP, NU)), np.zeros((NP + 1, NX))
        self._cost = np.inf
        self.qp = StagedQP(NP, *self.sizes, self.name)
        super().__init__(car, _horizon(car, bicycle, w, delay, self.textbook))
        if not self.textbook:
            self.preview_steps += LOOK_AHEAD

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        super().reset(rng)
        if self.adaptation is not None:
            self.adaptation.reset()
        self._learned[:] = 1.0
        self._lags(self._nominal.tau_delta, self._nominal.tau_ax)

    @property
    def disturbance(self) -> Array:
        """Estimated accelerations of (vx, vy, r) that the model lacks, shape (3,)."""
        return self.horizon.disturbance

    def estimate(self, state: State, preview: Preview) -> None:
        """Drive lag, disturbance, tires, and the state at which this period's command acts."""
        h = self.horizon
        x = np.zeros(NX)
        x[: A] = state.vx, state.vy, state.r, preview.ey, preview.epsi, state.delta
        if self.informed is None:
            self._begin(x, state)
        elif not self.informed:  # the period before was not measured: no prediction to compare with
            x[A:] = h.inner
        if self.banks and self.informed is not None:
            steering, drive = self.banks
            lag, h.lateness[0] = steering.update(state.delta)
            self._lags(lag, drive.lag)
        compared = bool(self.informed)
        nmpc_sqp.predict(h.handle, x, preview.kappa, compared, state.ax, self.model, self._learned)
        if self.banks and compared:
            slow, _ = drive.update(h.driven[0], steering.latency)
            self._lags(lag, slow)
        if compared and self.adaptation is not None:
            self.adaptation.update(h.unmodelled, h.acting, h.slips, float(x[A]), state.ay)
            self._learned[:] = self.adaptation.estimate[[MU, CF, CR]]

    def _lags(self, steering: float, drive: float) -> None:
        """Give the model the lags of steering and drive [s]."""
        car = self.model.car._replace(tau_delta=steering, tau_ax=drive)
        self.model = self.model._replace(car=car)

    def ask(self, delta: float, ax: float) -> tuple[float, float]:
        """What to ask for, so that wheels and drive do this [rad, m/s2]."""
        if not self.banks:
            return delta, ax
        steering, drive = self.banks
        return steering.ask(delta), drive.asked(ax / drive.gain)

    def write_qp(self, state: State, preview: Preview) -> None:
        """Bounds, references, and the plan that the search begins with."""
        h = self.horizon
        first = h.delay + int(h.lateness[0])
        self._cost = nmpc_sqp.begin(
            h.handle, preview.kappa[first:], preview.vx_ref[first:], state.wheel_speed, self.model,
            self._learned, self._limits, self._slip_cap, self._kappa, self._us, self._xs,
        )

    def solve(self) -> QPResult:
        """Sequential quadratic programming, from the plan of the period before."""
        start = time.thread_time_ns()
        value, status, residual, spent, n = self._cost, "NOT_FINITE", np.nan, 0.0, 0
        while n < ITERATIONS and value < np.inf:
            self.program()
            v, error, outcome, us = self.qp.solve()
            spent += us
            if n == 0 or outcome == "SOLVED":
                status, residual = outcome, error
            if outcome != "SOLVED" or not error <= TOLERANCE:
                break
            n += 1
            value, done = self.search(v, value)
            if done:
                break
        others = (time.thread_time_ns() - start) * 1e-3 - spent
        solved = n > 0
        if not solved and status == "SOLVED":
            status = "WRONG"
        return QPResult(self._us.ravel(), solved, status, residual, spent, others, n)

    def program(self) -> None:
        """Write the quadratic program about the plan."""
        h = self.horizon
        plan = (self._kappa, self.model, self._learned, self._us, self._xs)
        nmpc_sqp.linearise(h.handle, *plan)
        write(
            h.Ad, h.Bd, h.cd, h.schedule[0], h.queue[-1], h.x_ref, h.q, h.r_du, h.terminal,
            h.z_ref, h.u_lo, h.u_hi, np.array([h.du_max[0], np.inf]), self.qp.data,
        )

    def search(self, v: Array, value: float) -> tuple[float, bool]:
        """Go towards the solution of the quadratic program.

        Args:
            v: The solution, as `staged_qp` orders it.
            value: Cost of the plan.

        Returns:
            Cost of the new plan, and whether it is done.
        """
        plan = (self._kappa, self.model, self._learned)
        found: tuple[float, bool] = nmpc_sqp.search(
            self.horizon.handle, v, *plan, value, self._us, self._xs
        )
        return found

    def accept(self, z: Array) -> None:
        """Make the plan that was found the plan, and its states the prediction."""
        self.horizon.plan[:] = self._us
        self.horizon.prediction[:] = self._xs

    def _begin(self, x: Array, state: State) -> None:
        """First period: assume the car is in a steady state, as an accelerometer would say."""
        h, model = self.horizon, self.model
        x[A + 1 : A + 3] = slips(x, x[DELTA], model)
        if model.car.K_phi > 0.0:
            x[PHI] = model.car.m * model.car.h * state.ay / model.car.K_phi
        dx = np.empty(NX)
        rates(x, np.array([x[DELTA], 0.0]), 0.0, model, self._learned, np.zeros(3), dx)
        # vx' is what the model lacks of a (still 0) and of the measured ax = vx' - r vy
        x[A] = state.ax + state.r * state.vy - dx[VX]
        if h.gain.any():
            h.disturbance[VY] = state.ay - (dx[VY] + state.r * state.vx)
            h.disturbance[R] = -dx[R]
        h.inner[:] = x[A:]
        h.queue[:] = h.plan[:] = x[[DELTA, A]]
        h.schedule[:] = x
        for bank, value in zip(self.banks, (x[DELTA], x[A]), strict=False):
            bank.reset(float(value))


class TextbookNMPC(NMPC):
    """The same solver on the dynamic bicycle with linear tires, without lags and observer."""

    name = "nmpc-textbook"
    textbook = True
    # without the servo's lag in its model it must steer more slowly, or it sways
    by_hand = NMPCWeights(
        q_ey=100.0, q_epsi=800.0, q_vy=1.0, q_r=0.02, r_delta=2.0, r_ax=0.4, terminal=1.0
    )


def _horizon(
    car: VehicleParams, bicycle: Bicycle, weights: Weights, delay: int, textbook: bool
) -> Horizon:
    """Arrays that every period reuses, and numbers that never change."""
    q = stage_weights(weights, ("vx", "vy", "r", "ey", "epsi"), NP, NX, TS)
    r_du = increment_weights(weights, ("delta", "ax"), TS)
    lags = np.array([bicycle.tau_delta, bicycle.tau_ax]) * TABLE_LAGS[: 1 if textbook else None]
    table = np.zeros((len(SPEEDS) * len(lags), NZ, NZ))
    if weights.terminal > 0.0:
        axle_forces = np.array([car.Cf, 0.0, car.Cr, 0.0])
        cars = [bicycle._replace(tau_delta=float(lag), tau_ax=float(slow)) for lag, slow in lags]
        costs = [cost_to_go(one, axle_forces, q[0], r_du, TS) for one in cars]
        table = weights.terminal * np.concatenate(costs)
    return Horizon.allocated(
        NP,
        NX,
        NU,
        delay=delay,
        Ts=TS,
        car=np.array(bicycle),
        q=q,
        r_du=r_du,
        table=table,
        table_lags=lags,
        unknown=0 if textbook else LATENCIES - 1,
        walk=WALK,
        delta_max=min(DELTA_MAX_PAPER, car.delta_max),
        # the servo's rate; the drive has only its lag
        du_max=np.array([min(DELTA_STEP_PAPER, car.delta_rate_max * TS)]),
        drive=(car.ax_min, car.F_drive_max, car.P_drive_max, car.m_eff),
        wheels=(car.R_w, 0.5 * car.track_f, car.vx_min, car.ay_limit, car.drive_front),
        scale=SCALE,
        gain=0.0 if textbook else weights.observer_gain,
    )
