"""The adaptive LPV-MPC: one control period from state and preview to command.

Order of one period, as in the paper's Fig. 2: the stiffness model says what the axles do along the
previous prediction; the LPV model is frozen along it and discretised; the observer adds what the
model did not predict; the QP is built, solved and checked; a refused solve has an explicit
fallback. Everything is compiled or a ProxQP call, on preallocated arrays.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import ClassVar, Literal

import numpy as np
from numba import njit

from lpvmpc import observer
from lpvmpc.bicycle import (
    AF,
    AR,
    CORRECTED,
    DELTA,
    EULER,
    EXACT,
    EY,
    NU,
    NX,
    PHI,
    PRINTED,
    VX,
    VY,
    A,
    Bicycle,
    R,
    derivative,
    hold,
    lpv,
    slip_angles,
    steady_state,
    unpack,
)
from lpvmpc.errors import OptionError
from lpvmpc.path import Preview
from lpvmpc.qp import QPResult, QPSolver, condense, n_rows
from lpvmpc.stiffness import NetworkStiffness, StiffnessModel
from lpvmpc.terminal import SPEEDS, cost_to_go
from lpvmpc.vehicle import Array, Command, State, VehicleParams
from lpvmpc.weights_file import chosen

DELTA_STEP_PAPER = np.pi / 12
"""Largest steering increment per period of the paper's Table 2 [rad]."""
DELTA_MAX_PAPER = np.pi / 6
"""Largest steering angle of the paper's Table 2 [rad]."""
EY_MAX = 0.3
"""Lateral error bound of the paper's Table 2 [m]."""
BRAKING = -3.0
"""Acceleration of the last fallback [m/s2]."""
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
SLIP_RATIO = 0.1
"""Slip of a driven wheel from which on the drive is held back, on a dry road [-]: two thirds of the
tires' peak, which moves to smaller slip with the friction."""
FRICTION_MIN = 0.5
"""Smallest friction that is believed here: where little grip is used the estimate drifts."""
RELEASE = 6.0
"""Rate at which it is released again [m/s3]."""
SCALE = np.array([0.1, 1.0])
"""Units of the inputs inside the QP [rad, m/s2], so that its entries are of order one."""
SLACK_WEIGHTS = np.array([0.0, 1e4])
"""Linear and quadratic price of leaving the ey bound [1/m, 1/m2]. Without a linear one the bound
yields by millimetres, and while it is not active the unconstrained solution is the solution: that
is where ProxQP begins, and it needs one iteration instead of two."""


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Everything that is tuned. Weights are per second and normalised by `UNITS`.

    The values here are set by hand; what the controller drives with where none are given is
    `weights/lpv-mpc.toml`, which `eval/tune.py` wrote.
    """

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "q_vx": (3.0, 300.0),
        "q_vy": (0.01, 10.0),
        "q_r": (0.01, 10.0),
        "q_ey": (8.0, 800.0),
        "q_epsi": (8.0, 800.0),
        "r_delta": (0.005, 0.5),
        "r_ax": (0.004, 0.4),
        "terminal": (0.0, 1.0),
        "observer_gain": (0.1, 0.6),
        "slip_cap": (0.1, 0.18),
    }
    """Where tuning searches: a decade to either side of the values set by hand, what these leave
    out near nothing, and for gain and cap the values that keep this car on the road."""

    q_vx: float = 30.0
    """Weight of the speed error."""
    q_vy: float = 0.0
    """Weight of the lateral speed error."""
    q_r: float = 0.0
    """Weight of the yaw rate error."""
    q_ey: float = 80.0
    """Weight of the lateral error."""
    q_epsi: float = 80.0
    """Weight of the heading error."""
    r_delta: float = 0.05
    """Weight of the steering rate."""
    r_ax: float = 0.04
    """Weight of the jerk."""
    terminal: float = 1.0
    """Factor on the cost-to-go at the end of the horizon, 0 to 1."""
    observer_gain: float = 0.3
    """Gain of the disturbance observer, 0 to 1."""
    slip_cap: float = 0.14
    """Largest front slip angle that a command may ask for [rad]."""

    def __post_init__(self) -> None:
        """Refuse what no cost can mean."""
        for f in fields(self):
            value = getattr(self, f.name)
            ok = isinstance(value, int | float) and np.isfinite(value) and value >= 0.0
            if not ok:
                raise OptionError(f"weight {f.name}", value, "a number of at least 0")
        if self.observer_gain > 1.0:
            raise OptionError("weight observer_gain", self.observer_gain, "a number from 0 to 1")
        if self.slip_cap < 0.01:
            raise OptionError("weight slip_cap", self.slip_cap, "at least 0.01 rad")
        for name in ("r_delta", "r_ax"):
            if getattr(self, name) <= 0.0:
                raise OptionError(f"weight {name}", getattr(self, name), "a number above 0")


@dataclass(frozen=True, kw_only=True)
class Formulation:
    """What the controller is made of; each field is one step from the paper's form to ours."""

    hold: Literal["exact", "euler"] = "exact"
    """Discretisation: exact zero-order hold, or the paper's Euler."""
    matrices: Literal["corrected", "printed"] = "corrected"
    """Lateral error row: A45 = vx sinc(epsi), or as printed A41 = sin(epsi), A45 = 0."""
    reference: Literal["steady", "plain"] = "steady"
    """State reference: steady-state cornering, or [vx_ref, 0, 0, 0, 0]."""
    lags: bool = True
    """Servo lags as model states."""
    relaxation: bool = True
    """Relaxation of the tires as model states."""
    roll: bool = True
    """Roll of the body as model states."""
    trail: bool = True
    """Pneumatic trail of the tires."""
    observer: bool = True
    """Disturbance observer."""
    slip_cap: bool = True
    """Bound on the front slip angle that a command may ask for."""
    traction: bool = True
    """Traction control: less drive force where the wheel speeds tell that a driven wheel spins."""
    span: int = 2
    """Periods of the horizon that share one frozen model and one row of the ey bound; a divisor of
    Np. Two halve the time to build and cost no accuracy that shows."""
    Np: int = 10
    """Prediction horizon [periods]."""
    Ts: float = 0.033
    """Control period [s]."""

    def __post_init__(self) -> None:
        """Check names and ranges."""
        for name, allowed in (
            ("hold", ("exact", "euler")),
            ("matrices", ("corrected", "printed")),
            ("reference", ("steady", "plain")),
        ):
            if getattr(self, name) not in allowed:
                raise OptionError(name, getattr(self, name), " or ".join(allowed))
        if not 2 <= self.Np <= 100:
            raise OptionError("Np", self.Np, "a whole number from 2 to 100")
        if not (1 <= self.span <= self.Np and self.Np % self.span == 0):
            raise OptionError("span", self.span, f"a divisor of Np = {self.Np}")
        if not (np.isfinite(self.Ts) and 0.001 <= self.Ts <= 0.5):
            raise OptionError("Ts", self.Ts, "a number of seconds from 0.001 to 0.5")


PAPER = Formulation(
    hold="euler",
    span=1,
    reference="plain",
    lags=False,
    relaxation=False,
    roll=False,
    trail=False,
    observer=False,
    slip_cap=False,
    traction=False,
)
"""The paper's plain formulation on the corrected matrices."""


PAPER_WEIGHTS = Weights(q_epsi=800.0, r_delta=0.18, terminal=0.0)
"""Weights for `PAPER`, which loses the MuJoCo car with the weights of the full controller."""
NOT_FINITE = QPResult(np.empty(0), False, "NOT_FINITE", np.nan, 0.0, 0.0)
"""Outcome of a period whose measurement is not a number."""


@dataclass
class Diagnostics:
    """What happened inside the last `LPVMPC.command`."""

    solved: bool = True
    """Whether the QP was solved and its solution passed the check."""
    fallback: str = ""
    """Empty, or which fallback was used: `shifted` or `braking`."""
    status: str = "SOLVED"
    """Status of the solve."""
    kkt_residual: float = 0.0
    """KKT residual of the solution [-]."""
    build_us: float = 0.0
    """Thread CPU time of adaptation, model and QP building [us]."""
    solve_us: float = 0.0
    """Thread CPU time in ProxQP [us]."""
    check_us: float = 0.0
    """Thread CPU time of the checks [us]."""
    prediction: Array = field(default_factory=lambda: np.zeros((1, 5)))
    """Predicted (vx, vy, r, ey, epsi), shape (Np + 1, 5)."""
    disturbance: Array = field(default_factory=lambda: np.zeros(3))
    """Estimated unmodelled accelerations of (vx, vy, r), shape (3,)."""


@njit(cache=True)
def _model(schedule, kappa, tires, disturbance, car, form, method, Ts, Ad, Bd, cd):
    """Freeze the LPV model along the schedule and discretise it, in place.

    One row of `tires` and one model serve N / len(tires) periods; the exact hold is frozen in the
    middle of them, Euler at their start, as the paper's.
    """
    span = Ad.shape[0] // tires.shape[0]
    A_, B_, c_ = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    inputs, held = np.empty((NX, NU + 1)), np.empty((NX, NU + 1))
    where = np.empty(NX)
    for n in range(tires.shape[0]):
        k = n * span
        end = k if method == EULER else k + span
        for i in range(NX):
            where[i] = 0.5 * (schedule[k, i] + schedule[end, i])
        lpv(where, 0.5 * (kappa[k] + kappa[end]), tires[n], car, form, A_, B_, c_)
        for i in range(NX):
            for m in range(NU):
                inputs[i, m] = B_[i, m]
            inputs[i, NU] = c_[i] + (disturbance[i] if i < 3 else 0.0)
        hold(A_, inputs, Ts, method, Ad[k], held)
        if car.tau_delta == 0.0:  # the steering follows at once
            Ad[k, DELTA, DELTA], held[DELTA, 0] = 0.0, 1.0
        if car.tau_ax == 0.0:
            Ad[k, A, A], held[A, 1] = 0.0, 1.0
        for j in range(k, k + span):
            for i in range(NX):
                for m in range(NX):
                    Ad[j, i, m] = Ad[k, i, m]
                for m in range(NU):
                    Bd[j, i, m] = held[i, m]
                cd[j, i] = held[i, NU]


@njit(cache=True)
def _references(vx_ref, kappa, tires, disturbance, car, steady, x_ref):
    """State reference at steps 1..N of the horizon, in place."""
    N = x_ref.shape[0]
    span = N // tires.shape[0]
    for k in range(N):
        x_ref[k] = 0.0
        if steady:
            law = tires[k // span]
            steady_state(vx_ref[k + 1], kappa[k + 1], law, disturbance, car, x_ref[k])
        x_ref[k, VX] = vx_ref[k + 1]


@njit(cache=True)
def _terminal(table, vx, x_ref, weight, z_ref):
    """Terminal weight at a speed, and the steady state that it pulls towards, in place."""
    n = len(SPEEDS)
    k = 0
    while k < n - 2 and SPEEDS[k + 1] < vx:
        k += 1
    share = min(max((vx - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k]), 0.0), 1.0)
    for i in range(NX + NU):
        for j in range(NX + NU):
            weight[i, j] = (1.0 - share) * table[k, i, j] + share * table[k + 1, i, j]
    for i in range(NX):
        z_ref[i] = x_ref[i]
    z_ref[NX], z_ref[NX + 1] = x_ref[DELTA], x_ref[A]


@njit(cache=True)
def _bounds(schedule, u_prev, du_max, delta_max, slip_cap, car, drive, u_lo, u_hi):
    """Input bounds along the horizon, in place; always reachable within the increment bounds.

    Steering: +-delta_max, and no front slip angle above `slip_cap` along the prediction, since
    past the tire's peak more steering turns the car less. Acceleration: motor torque and power at
    the predicted speed, and the brakes.
    """
    ax_min, force, power, m_eff = drive
    for k in range(u_lo.shape[0]):
        vx = max(schedule[k, VX], car.vx_min)
        flow = np.arctan2(schedule[k, VY] + car.lf * schedule[k, R], vx)
        u_lo[k, 0] = max(-delta_max, min(flow - slip_cap, delta_max))
        u_hi[k, 0] = min(delta_max, max(flow + slip_cap, -delta_max))
        u_lo[k, 1] = ax_min
        u_hi[k, 1] = min(force, power / vx) / m_eff
        for m in range(len(du_max)):  # what the increment bounds can reach is allowed
            reach = (k + 1) * du_max[m]
            u_lo[k, m] = min(u_lo[k, m], u_prev[m] + reach)
            u_hi[k, m] = max(u_hi[k, m], u_prev[m] - reach)


@njit(cache=True)
def _period(
    schedule, kappa, vx_ref, tires, disturbance, u_prev, constants, form, method, steady, Ts, table,
    du_max, delta_max, slip_cap, drive, q, r_du, work, H, g, C, lo, hi,
):  # fmt: skip
    """Model, references, bounds and QP of one period; one call, since each call costs its own."""
    car = unpack(constants)
    Ad, Bd, cd, x_ref, u_lo, u_hi, terminal, z_ref, free, forced = work
    _model(schedule, kappa, tires, disturbance, car, form, method, Ts, Ad, Bd, cd)
    _references(vx_ref, kappa, tires, disturbance, car, steady, x_ref)
    _terminal(table, vx_ref[len(x_ref)], x_ref[-1], terminal, z_ref)
    _bounds(schedule, u_prev, du_max, delta_max, slip_cap, car, drive, u_lo, u_hi)
    condense(
        Ad, Bd, cd, schedule[0], x_ref, q, r_du, u_prev, u_lo, u_hi, du_max, EY,
        len(x_ref) // len(tires), EY_MAX, SLACK_WEIGHTS, SCALE, terminal, z_ref, H, g, C, lo,
        hi, free, forced,
    )  # fmt: skip


@njit(cache=True)
def _unpack(z, free, forced, x0, scale, plan, prediction):
    """Turn a QP solution into the input plan and the predicted states, in place."""
    N, nx = free.shape
    for k in range(N):
        for m in range(NU):
            plan[k, m] = z[k * NU + m] * scale[m]
    for i in range(nx):
        prediction[0, i] = x0[i]
    for k in range(N):
        for i in range(nx):
            value = free[k, i]
            for a in range((k + 1) * NU):
                value += forced[k, i, a] * z[a]
            prediction[k + 1, i] = value


@njit(cache=True)
def _advance(x, x_next, kappas, tires, disturbance, u, constants, form, method, Ts, out):
    """One-period prediction from x, with the model frozen between x and x_next, in place."""
    car = unpack(constants)
    A_, B_, c_ = np.empty((NX, NX)), np.empty((NX, NU)), np.empty(NX)
    Ad, rate, held = np.empty((NX, NX)), np.zeros((NX, NU + 1)), np.empty((NX, NU + 1))
    lpv(0.5 * (x + x_next), 0.5 * (kappas[0] + kappas[1]), tires, car, form, A_, B_, c_)
    for i in range(NX):
        rate[i, 0] = B_[i, 0] * u[0] + B_[i, 1] * u[1] + c_[i]
        if i < 3:
            rate[i, 0] += disturbance[i]
    hold(A_, rate, Ts, method, Ad, held)
    for i in range(NX):
        out[i] = held[i, 0]
        for j in range(NX):
            out[i] += Ad[i, j] * x[j]
    if car.tau_delta == 0.0:
        out[DELTA] = u[0]
    if car.tau_ax == 0.0:
        out[A] = u[1]


class LPVMPC:
    """Linear parameter-varying model predictive controller on ProxQP.

    A controller as every other: `reset(rng)` and `command(state, preview)`. It never sees the
    plant; what it knows of the car is `VehicleParams`.
    """

    name = "lpv-mpc"

    def __init__(
        self,
        car: VehicleParams | None = None,
        *,
        stiffness: StiffnessModel | None = None,
        weights: Weights | Mapping[str, float] | None = None,
        formulation: Formulation | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters; the packaged car by default.
            stiffness: Model of the axle forces; the shipped `network` by default.
            weights: Cost weights, or some of them by name; the shipped ones by default.
            formulation: Parts of the controller; the full one by default.
            delay: Known delay between command and effect [periods], compensated by prediction.

        Raises:
            OptionError: A value outside its domain.
        """
        if not (isinstance(delay, int) and 0 <= delay <= 30):
            raise OptionError("delay", delay, "a whole number of periods from 0 to 30")
        self.car = car if car is not None else VehicleParams.load()
        self.formulation = formulation if formulation is not None else Formulation()
        if stiffness is None:
            stiffness = NetworkStiffness(self.car, Ts=self.formulation.Ts)
        self.stiffness = stiffness
        self.weights = chosen("lpv-mpc", weights, Weights())
        self.delay = delay
        self.Np, self.Ts = self.formulation.Np, self.formulation.Ts
        parts = ("lags", "relaxation", "roll", "trail")
        included = {name: getattr(self.formulation, name) for name in parts}
        self.bicycle = Bicycle.of(self.car).simplified(**included)
        self._constants = np.array(self.bicycle)
        self._learn = getattr(self.stiffness, "learn", None)  # a model that adapts to the road
        self._allocate()
        self._warm_up()

    @property
    def preview_steps(self) -> int:
        """Periods of preview needed: the horizon, and the delay before it begins."""
        return self.Np + self.delay

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        self.stiffness.reset()
        self.solver.reset()
        self.disturbance = np.zeros(3)
        self.diagnostics = Diagnostics()
        self._started, self._blind = False, False
        self._refused = 0
        self._allowed = np.inf
        self._plan[:] = 0.0
        self._queue[:] = 0.0

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
        x = np.zeros(NX)
        x[:A] = state.vx, state.vy, state.r, preview.ey, preview.epsi, state.delta
        if math.isfinite(x.sum() + state.ax + state.ay):
            x0 = self._estimate(x, state, preview)
            self._build(x0, state, preview)
            built = time.thread_time_ns()
            result = self.solver.solve(self._H, self._g, self._C, self._lo, self._hi)
        else:  # nothing is learned from it, and the model of this period has no start
            x0, built, result = self._schedule[0], time.thread_time_ns(), NOT_FINITE
            self._blind = True
        if result.solved:
            _unpack(result.z, self._free, self._forced, x0, SCALE, self._plan, self._prediction)
            self._refused, fallback = 0, ""
        else:
            fallback = self._fall_back()
        u = self._plan[0]
        command = Command(float(u[0]), float(u[1]))
        self._queue[:-1] = self._queue[1:]
        self._queue[-1] = u
        self._shift(x0)
        self.diagnostics = Diagnostics(
            result.solved,
            fallback,
            result.status,
            result.residual,
            (built - start) * 1e-3,
            result.solve_us,
            result.check_us,
            self._prediction[:, :5].copy(),
            self.disturbance.copy(),
        )
        return command

    def _warm_up(self) -> None:
        """Load the compiled code, 50 ms, before the first period needs it; then start anew."""
        self.reset(np.random.default_rng(0))
        still = State(0.0, 0.0, 0.0, 10.0, 0.0, 0.0, 0.0, 0.0, 0.0, np.zeros(4))
        flat = np.zeros(self.preview_steps + 1)
        preview = Preview(0.0, 0.0, 0.0, flat, flat + 10.0, flat, flat, flat)
        for _ in range(2):  # the second period also compares with the first
            self.command(still, preview)
        self.reset(np.random.default_rng(0))

    # one period, step by step -------------------------------------------------------------

    def _estimate(self, x: Array, state: State, preview: Preview) -> Array:
        """Drive lag, disturbance, and the state at which this period's command takes effect."""
        kappa = preview.kappa[0]
        if not self._started:
            self._begin(x, state, preview)
        elif self._blind:  # the period before was not measured: no prediction to compare with
            x[A:] = self._inner
        else:
            self._observe(x, kappa, state.ay)
        self._blind = False
        self._x_last[:] = x
        self._kappa_last = kappa
        return self._over_delay(x, preview.kappa)

    def _begin(self, x: Array, state: State, preview: Preview) -> None:
        """First period: assume the car is in a steady state, as an accelerometer would say."""
        car, tires, schedule = self.bicycle, self._tires, self._schedule
        x[AF], x[AR] = slip_angles(max(x[VX], car.vx_min), x[VY], x[R], x[DELTA], car)
        schedule[:] = x
        schedule[:, VX] = np.maximum(preview.vx_ref[: self.Np + 1], car.vx_min)
        self._knots[:] = schedule[:: self.formulation.span]
        self.stiffness.horizon(state, self._knots, tires)
        if car.K_phi > 0.0:
            x[PHI] = car.m * car.h * state.ay / car.K_phi
        dx = derivative(x, x[[DELTA, A]], preview.kappa[0], tires[0], car)
        # vx' is what the model lacks of a (still 0) and of the measured ax = vx' - r vy
        x[A] = state.ax + state.r * state.vy - dx[VX]
        if self.formulation.observer:
            self.disturbance[VY] = state.ay - (dx[VY] + state.r * max(state.vx, car.vx_min))
            self.disturbance[R] = -dx[R]
        self._inner[:] = x[A:]
        u = x[[DELTA, A]]
        self._queue[:] = u
        self._plan[:] = u
        schedule[:, A] = x[A]
        self._started = True

    def _observe(self, x: Array, kappa: float, ay: float) -> None:
        """Compare the measured state with what the model expected for it."""
        form, predicted = self.formulation, self._predicted
        applied = self._queue[0]
        _advance(
            self._x_last, x, (self._kappa_last, kappa), self._tires[0], self.disturbance, applied,
            self._constants, self._form, self._method, self.Ts, predicted,
        )  # fmt: skip
        if self._learn is not None:
            unmodelled = self.disturbance[1:] + (x[1:3] - predicted[1:3]) / self.Ts
            self._learn(unmodelled, self._tires[0, [1, 3]].copy(), predicted[A], ay)
        self._inner[:] = predicted[A:]
        x[A:] = self._inner
        if form.observer:
            observer.update(self.disturbance, predicted, x, self._gain, observer.LIMIT, self.Ts)

    def _over_delay(self, x: Array, kappa: Array) -> Array:
        """State at which the command computed now takes effect."""
        for i in range(self.delay):
            ahead = np.empty(NX)
            _advance(
                x, x, (kappa[i], kappa[i + 1]), self._tires[0], self.disturbance,
                self._queue[i + 1], self._constants, self._form, self._method, self.Ts, ahead,
            )  # fmt: skip
            x = ahead
        return x

    def _build(self, x0: Array, state: State, preview: Preview) -> None:
        """Adapt, discretise, and write the QP."""
        d = self.delay
        self._schedule[0] = x0
        self._knots[:] = self._schedule[:: self.formulation.span]
        self.stiffness.horizon(state, self._knots, self._tires)
        ax_min, force, power, m_eff = self._drive
        if self.formulation.traction:
            force = m_eff * self._hold_traction(state, x0[A], force / m_eff)
        # the tires' peak moves to smaller slip as the road gets slippery
        slip_cap = self._slip_cap * min(getattr(self.stiffness, "friction", 1.0), 1.0)
        _period(
            self._schedule, preview.kappa[d:], preview.vx_ref[d:], self._tires, self.disturbance,
            self._queue[-1], self._constants, self._form, self._method, self._steady, self.Ts,
            self._table, self._du_max, self._delta_max, slip_cap,
            (ax_min, force, power, m_eff), self._q,
            self._r, self._work, self._H, self._g, self._C, self._lo, self._hi,
        )  # fmt: skip

    def _hold_traction(self, state: State, a: float, most: float) -> float:
        """Largest acceleration to ask for, so that no driven wheel spins [m/s2].

        Where the wheel speeds tell more slip than `SLIP_RATIO` times the friction, less than what
        is driven with now, in proportion; from there on it rises by at most `RELEASE`.
        """
        car, spin = self.car, state.wheel_speed
        turn = 0.5 * car.track_f * state.r
        left = spin[0] * car.R_w / max(state.vx - turn, car.vx_min)
        right = spin[1] * car.R_w / max(state.vx + turn, car.vx_min)
        slip = float(max(left, right)) - 1.0
        allowed = min(self._allowed + RELEASE * self.Ts, most)
        friction = getattr(self.stiffness, "friction", 1.0)
        bound = SLIP_RATIO * min(max(friction, FRICTION_MIN), 1.0)
        if slip > bound:
            allowed = min(allowed, max(a, 0.0) * bound / slip)
        self._allowed = allowed
        return allowed

    def _fall_back(self) -> str:
        """A refused solve: keep to the previous plan, already shifted; after three, brake."""
        self._refused += 1
        self._prediction[:] = self._schedule
        if self._refused <= 3:
            return "shifted"
        self._plan[:, 1] = BRAKING
        return "braking"

    def _shift(self, x0: Array) -> None:
        """Make this period's plan and prediction the next one's schedule and fallback."""
        self._prediction[0] = x0
        self._schedule[:-1] = self._prediction[1:]
        self._schedule[-1] = self._prediction[-1]
        self._plan[:-1] = self._plan[1:]

    def _allocate(self) -> None:
        """Arrays that every period reuses, and numbers that never change."""
        form, w, car = self.formulation, self.weights, self.car
        N, n = form.Np, form.Np * NU + 1
        m = n_rows(N, NU, 1, form.span)  # the servo's rate; the drive has only its lag
        self.solver = QPSolver(n, m)
        self._H, self._g, self._C = np.zeros((n, n)), np.zeros(n), np.zeros((m, n))
        self._lo, self._hi = np.zeros(m), np.zeros(m)
        self._free, self._forced = np.zeros((N, NX)), np.zeros((N, NX, N * NU))
        self._work = (
            np.zeros((N, NX, NX)),  # Ad
            np.zeros((N, NX, NU)),  # Bd
            np.zeros((N, NX)),  # cd
            np.zeros((N, NX)),  # x_ref
            np.zeros((N, NU)),  # u_lo
            np.zeros((N, NU)),  # u_hi
            np.zeros((NX + NU, NX + NU)),  # terminal weight
            np.zeros(NX + NU),  # its reference
            self._free,
            self._forced,
        )
        self._tires, self._knots = np.zeros((N // form.span, 4)), np.zeros((N // form.span + 1, NX))
        self._schedule: Array = np.zeros((N + 1, NX))
        self._prediction: Array = np.zeros((N + 1, NX))
        self._plan: Array = np.zeros((N, NU))
        self._queue: Array = np.zeros((self.delay + 1, NU))
        self._x_last: Array = np.zeros(NX)
        self._predicted: Array = np.zeros(NX)
        self._inner: Array = np.zeros(NX - A)  # not measured: a, slip, roll
        self._kappa_last = 0.0
        self._form = CORRECTED if form.matrices == "corrected" else PRINTED
        self._method = EXACT if form.hold == "exact" else EULER
        self._steady = form.reference == "steady"
        self._slip_cap = w.slip_cap if form.slip_cap else np.pi
        self._drive = (car.ax_min, car.F_drive_max, car.P_drive_max, car.m_eff)
        self._gain = np.full(3, w.observer_gain)
        self._q = np.zeros((N, NX))
        for i, name in enumerate(("vx", "vy", "r", "ey", "epsi")):
            self._q[:, i] = getattr(w, f"q_{name}") / UNITS[name] ** 2 * self.Ts
        self._r = np.array(
            [w.r_delta / UNITS["delta"] ** 2 / self.Ts, w.r_ax / UNITS["ax"] ** 2 / self.Ts]
        )
        self._table = np.zeros((len(SPEEDS), NX + NU, NX + NU))
        if w.terminal > 0.0 and self._steady:
            tires = np.array([car.Cf, 0.0, car.Cr, 0.0])
            self._table = w.terminal * cost_to_go(self.bicycle, tires, self._q[0], self._r, form.Ts)
        step = min(DELTA_STEP_PAPER, car.delta_rate_max * self.Ts)
        self._du_max = np.array([step])
        self._delta_max = min(DELTA_MAX_PAPER, car.delta_max)
