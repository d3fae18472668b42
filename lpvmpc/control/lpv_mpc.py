"""The adaptive LPV-MPC: one control period from state and preview to command.

Order of one period, as in the paper's Fig. 2: the stiffness model says what the axles do along the
previous prediction; the LPV model is frozen along it and discretised; the observer adds what the
model did not predict; the QP is built, solved and checked; a refused solve has an explicit
fallback. Everything is compiled (prediction.py) or a ProxQP call, on preallocated arrays.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from lpvmpc.car.bicycle import (
    AF,
    AR,
    CORRECTED,
    DELTA,
    EULER,
    EXACT,
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
    slip_angles,
)
from lpvmpc.car.params import VehicleParams
from lpvmpc.control import traction
from lpvmpc.control.formulation import (
    DELTA_MAX_PAPER,
    DELTA_STEP_PAPER,
    PAPER,
    PAPER_WEIGHTS,
    UNITS,
    Formulation,
    Weights,
    changed,
)
from lpvmpc.control.period import accept, advance, compare, period, shift, thin
from lpvmpc.control.qp import QPSolver, n_rows
from lpvmpc.control.stiffness.models import ConstantStiffness, NetworkStiffness, StiffnessModel
from lpvmpc.control.terminal_cost import SPEEDS, cost_to_go
from lpvmpc.control.tracker import BRAKING, NOT_FINITE
from lpvmpc.control.weights_file import chosen
from lpvmpc.errors import OptionError
from lpvmpc.interface import Command, Diagnostics, Preview, State
from lpvmpc.units import Array


class LPVMPC:
    """Linear parameter-varying model predictive controller on ProxQP.

    A controller as every other: `reset(rng)` and `command(state, preview)`. It never sees the
    plant; what it knows of the car is `VehicleParams`.
    """

    name = "lpv-mpc"

    def __init__(
        self,
        car: VehicleParams,
        *,
        stiffness: StiffnessModel | None = None,
        weights: Weights | Mapping[str, float] | None = None,
        formulation: Formulation | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            stiffness: Model of the axle forces; the shipped `network` by default.
            weights: Cost weights, or some of them by name; the shipped ones by default.
            formulation: Parts of the controller; the full one by default.
            delay: Known delay between command and effect [periods], compensated by prediction.

        Raises:
            OptionError: A value outside its domain.
        """
        if not (isinstance(delay, int) and 0 <= delay <= 30):
            raise OptionError("delay", delay, "a whole number of periods from 0 to 30")
        self.car = car
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
        measured = state.vx, state.vy, state.r, preview.ey, preview.epsi, state.delta
        if math.isfinite(sum(measured) + state.ax + state.ay):
            x = np.array(measured + (0.0,) * (NX - A))
            x0 = self._estimate(x, state, preview)
            self._build(x0, state, preview)
            built = time.thread_time_ns()
            result = self.solver.solve(self._H, self._g, self._C, self._lo, self._hi)
        else:  # nothing is learned from it, and the model of this period has no start
            x0, built, result = self._schedule[0], time.thread_time_ns(), NOT_FINITE
            self._blind = True
        if result.solved:
            accept(result.z, self._free, self._forced, self._plan, self._prediction)
            self._refused, fallback = 0, ""
        else:
            fallback = self._fall_back()
        u = self._plan[0]
        command = Command(float(u[0]), float(u[1]))
        shift(self._plan, self._prediction, self._schedule, self._knots, self._queue, x0)
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
        self._x_last: Array = x
        self._kappa_last = kappa
        return self._over_delay(x, preview.kappa)

    def _begin(self, x: Array, state: State, preview: Preview) -> None:
        """First period: assume the car is in a steady state, as an accelerometer would say."""
        car, tires, schedule = self.bicycle, self._tires, self._schedule
        x[AF], x[AR] = slip_angles(max(x[VX], car.vx_min), x[VY], x[R], x[DELTA], car)
        schedule[:] = x
        schedule[:, VX] = np.maximum(preview.vx_ref[: self.Np + 1], car.vx_min)
        thin(schedule, self._knots)
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
        thin(schedule, self._knots)
        self._started = True

    def _observe(self, x: Array, kappa: float, ay: float) -> None:
        """Compare the measured state with what the model expected for it, and learn from it."""
        a = compare(
            x, self._x_last, self._kappa_last, kappa, self._tires[0], self.disturbance,
            self._queue[0], self._constants, self._form, self._method, self.Ts, self._gain,
            self._predicted, self._inner, self._unmodelled, self._offsets,
        )  # fmt: skip
        if self._learn is not None:
            self._learn(self._unmodelled, self._offsets, a, ay)

    def _over_delay(self, x: Array, kappa: Array) -> Array:
        """State at which the command computed now takes effect."""
        for i in range(self.delay):
            ahead = np.empty(NX)
            advance(
                x, x, (kappa[i], kappa[i + 1]), self._tires[0], self.disturbance,
                self._queue[i + 1], self._constants, self._form, self._method, self.Ts, ahead,
            )  # fmt: skip
            x = ahead
        return x

    def _build(self, x0: Array, state: State, preview: Preview) -> None:
        """Adapt, discretise, and write the QP."""
        d = self.delay
        self._schedule[0] = self._knots[0] = x0
        self.stiffness.horizon(state, self._knots, self._tires)
        friction = getattr(self.stiffness, "friction", 1.0)
        drive = self._drive
        if self.formulation.traction:
            ax_min, force, power, m_eff = drive
            self._allowed = traction.hold(
                self._allowed, force / m_eff, x0[A], state.wheel_speed, state.vx, state.r,
                friction, *self._wheels, self.Ts,
            )  # fmt: skip
            drive = ax_min, m_eff * self._allowed, power, m_eff
        # the tires' peak moves to smaller slip as the road gets slippery
        slip_cap = self._slip_cap * min(friction, 1.0)
        period(
            self._schedule, preview.kappa[d:], preview.vx_ref[d:], self._tires, self.disturbance,
            self._queue[-1], self._constants, self._form, self._method, self._steady, self.Ts,
            self._table, self._du_max, self._delta_max, slip_cap, drive, self._q, self._r,
            self._work, self._H, self._g, self._C, self._lo, self._hi,
        )  # fmt: skip

    def _fall_back(self) -> str:
        """A refused solve: keep to the previous plan, already shifted; after three, brake."""
        self._refused += 1
        self._prediction[:] = self._schedule
        if self._refused <= 3:
            return "shifted"
        self._plan[:, 1] = BRAKING
        return "braking"

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
        self._predicted: Array = np.zeros(NX)
        self._inner: Array = np.zeros(NX - A)  # not measured: a, slip, roll
        self._unmodelled: Array = np.zeros(2)
        self._offsets: Array = np.zeros(2)
        self._kappa_last = 0.0
        self._form = CORRECTED if form.matrices == "corrected" else PRINTED
        self._method = EXACT if form.hold == "exact" else EULER
        self._steady = form.reference == "steady"
        self._slip_cap = w.slip_cap if form.slip_cap else np.pi
        self._drive = (car.ax_min, car.F_drive_max, car.P_drive_max, car.m_eff)
        self._wheels = (car.R_w, 0.5 * car.track_f, car.vx_min)
        self._gain = np.full(3, w.observer_gain if form.observer else 0.0)
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


def adaptive(
    car: VehicleParams,
    *,
    stiffness: StiffnessModel | None = None,
    weights: Weights | Mapping[str, float] | None = None,
    formulation: Formulation | Mapping[str, Any] | None = None,
    delay: int = 0,
) -> LPVMPC:
    """The controller `lpv-mpc`: every part, or what `formulation` leaves of them."""
    form = changed(Formulation(), formulation)
    return LPVMPC(car, stiffness=stiffness, weights=weights, formulation=form, delay=delay)


def plain(
    car: VehicleParams,
    *,
    stiffness: StiffnessModel | None = None,
    weights: Weights | Mapping[str, float] | None = None,
    formulation: Formulation | Mapping[str, Any] | None = None,
    delay: int = 0,
) -> LPVMPC:
    """The controller `lpv-mpc-paper`: the paper's plain formulation, constant stiffness."""
    return LPVMPC(
        car,
        stiffness=ConstantStiffness(car) if stiffness is None else stiffness,
        weights=chosen("lpv-mpc-paper", weights, PAPER_WEIGHTS),
        formulation=changed(PAPER, formulation),
        delay=delay,
    )
