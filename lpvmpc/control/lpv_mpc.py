"""The adaptive LPV-MPC: one control period from state and preview to command.

Order of one period, as in the paper's Fig. 2: the observer adds what the model did not predict; the
stiffness model says what the axles do along the previous prediction; the LPV model is frozen along
it and discretised; the QP is built. The rest is every tracker's (tracker.py). The numerics are
compiled (period.py), on preallocated arrays (horizon.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lpvmpc.car.bicycle import (
    AF,
    AR,
    CORRECTED,
    DELTA,
    EPSI,
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
    slip_angles,
)
from lpvmpc.car.hold import EULER, EXACT
from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import (
    NZ,
    PAPER_WEIGHTS,
    SLACK_WEIGHTS,
    SPEEDS,
    Weights,
    increment_weights,
    kept_cost_to_go,
    stage_weights,
)
from lpvmpc.control.formulation import (
    DELTA_MAX_PAPER,
    DELTA_STEP_PAPER,
    EY_MAX,
    PAPER,
    SCALE,
    Formulation,
    changed,
)
from lpvmpc.control.horizon import Horizon
from lpvmpc.control.period import estimate, thin, write
from lpvmpc.control.servo import LATENCIES, ServoBank, drive_of, steering_of
from lpvmpc.control.stiffness.models import ConstantStiffness, NetworkStiffness, StiffnessModel
from lpvmpc.control.tracker import Tracker, checked_delay
from lpvmpc.control.weights_file import chosen
from lpvmpc.interface import Preview, State
from lpvmpc.units import Array

TAU_DELTA, TAU_AX = Bicycle._fields.index("tau_delta"), Bicycle._fields.index("tau_ax")
"""Places of the lags of steering and drive among the model's constants."""
TABLE_LAGS = ((1.0, 1.0), (2.0, 2.0), (3.0, 4.0))
"""Lags of steering and drive that terminal weights are made for, as multiples of the data sheet's.
On a straight road the two have no common state, so each is interpolated by itself."""
LOOK_AHEAD = 100
"""Periods beyond the horizon over which bends are looked for that the road's friction does not take
at the reference speed: 3.3 s, in which a car brakes from 25 to 8 m/s."""
WALK = np.array([2.0, 2.0, 2.0])
"""How far a disturbance is believed to move within a second [m/s2, m/s2, rad/s2]: the paper's wind
rises by 3 m/s2 in one."""


class LPVMPC(Tracker):
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
        solver: str = "proxqp",
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            stiffness: Model of the axle forces; the shipped `network` by default.
            weights: Cost weights, or some of them by name; the shipped ones by default.
            formulation: Parts of the controller; the full one by default.
            delay: Known delay between command and effect [periods], compensated by prediction.
            solver: Who solves the QPs first, see `QPSolver`.

        Raises:
            OptionError: A value outside its domain.
            UnknownNameError: No such solver.
        """
        delay = checked_delay(delay)
        self.formulation = form = formulation if formulation is not None else Formulation()
        if stiffness is None:
            stiffness = NetworkStiffness(car, Ts=form.Ts)
        self.stiffness, self.drives_on = stiffness, form.drive_on
        self.weights = chosen("lpv-mpc", weights, Weights())
        parts = {part: getattr(form, part) for part in ("lags", "relaxation", "roll", "trail")}
        self.bicycle = Bicycle.of(car).simplified(**parts)
        self._learn = getattr(stiffness, "learn", None)  # a model that adapts to the road
        learned = (steering_of, drive_of) if form.steering and form.lags else ()
        self.banks = [ServoBank(servo(car), form.Ts, delay) for servo in learned]
        horizon = _horizon(car, self.bicycle, form, self.weights, delay)
        super().__init__(car, horizon, solver=solver)
        if form.decoupled and form.traction:
            self.preview_steps += LOOK_AHEAD

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        super().reset(rng)
        self.stiffness.reset()

    @property
    def disturbance(self) -> Array:
        """Estimated accelerations of (vx, vy, r) that the model lacks, shape (3,)."""
        return self.horizon.disturbance

    def estimate(self, state: State, preview: Preview) -> None:
        """Drive lag, disturbance, and the state at which this period's command takes effect."""
        h = self.horizon
        x = np.array(
            [state.vx, state.vy, state.r, preview.ey, preview.epsi, state.delta, 0.0, 0.0, 0.0, 0.0,
             0.0]
        )
        if self.informed is None:
            self._begin(x, state, preview)
        elif not self.informed:  # the period before was not measured: no prediction to compare with
            x[A:] = h.inner
        if self.banks and self.informed is not None:
            steering, drive = self.banks
            h.car[TAU_DELTA], h.lateness[0] = steering.update(state.delta)
        a = estimate(h.handle, x, preview.kappa, bool(self.informed), state.ax)
        if self.banks and self.informed:
            # what a wheel that spins or locks gives says nothing of the drive
            rolling = float(h.allowed[1] >= h.allowed[2] or x[A] > 0.0)
            h.car[TAU_AX], _ = drive.update(h.driven[0], steering.latency, rolling)
        if self.informed and self._learn is not None:
            self._learn(h.unmodelled, h.acting, h.slips, a, state.ay)

    def ask(self, delta: float, ax: float) -> tuple[float, float]:
        """What to ask for, so that wheels and drive do this [rad, m/s2]."""
        if not self.banks:
            return delta, ax
        steering, drive = self.banks
        return steering.ask(delta), drive.asked(ax / drive.gain)

    def write_qp(self, state: State, preview: Preview) -> None:
        """Adapt, discretise, and write the QP."""
        h = self.horizon
        self.stiffness.horizon(state, h.knots, h.axle_forces)
        friction = getattr(self.stiffness, "friction", 1.0)
        write(h.handle, preview.kappa, preview.vx_ref, state.wheel_speed, friction)

    def _begin(self, x: Array, state: State, preview: Preview) -> None:
        """First period: assume the car is in a steady state, as an accelerometer would say."""
        h, car = self.horizon, self.bicycle
        x[AF], x[AR] = slip_angles(max(x[VX], car.vx_min), x[VY], x[R], x[DELTA], car)
        h.schedule[:] = x
        h.schedule[:, VX] = np.maximum(preview.vx_ref[: self.Np + 1], car.vx_min)
        thin(h.schedule, h.knots)
        self.stiffness.horizon(state, h.knots, h.axle_forces)
        if car.K_phi > 0.0:
            x[PHI] = car.m * car.h * state.ay / car.K_phi
        dx = derivative(x, x[[DELTA, A]], preview.kappa[0], h.axle_forces[0], car)
        # vx' is what the model lacks of a (still 0) and of the measured ax = vx' - r vy
        x[A] = state.ax + state.r * state.vy - dx[VX]
        if self.formulation.observer:
            h.disturbance[VY] = state.ay - (dx[VY] + state.r * max(state.vx, car.vx_min))
            h.disturbance[R] = -dx[R]
        h.inner[:] = x[A:]
        u = x[[DELTA, A]]
        h.queue[:] = u
        h.plan[:] = u
        for bank, value in zip(self.banks, (x[DELTA], x[A]), strict=False):
            bank.reset(value)
        h.car[[TAU_DELTA, TAU_AX]] = self.bicycle.tau_delta, self.bicycle.tau_ax
        h.schedule[:, A] = x[A]
        thin(h.schedule, h.knots)


def _horizon(
    car: VehicleParams, bicycle: Bicycle, form: Formulation, weights: Weights, delay: int
) -> Horizon:
    """Arrays that every period reuses, and numbers that never change."""
    N, Ts = form.Np, form.Ts
    q = stage_weights(weights, ("vx", "vy", "r", "ey", "epsi"), N, NX, Ts)
    r_du = increment_weights(weights, ("delta", "ax"), Ts)
    steady = form.reference == "steady"
    nominal = np.array([bicycle.tau_delta, bicycle.tau_ax])
    lags = nominal * (TABLE_LAGS if form.steering and form.lags else TABLE_LAGS[:1])
    calm = weights.calm if form.noise else 1.0
    quiet = q[0] * np.where(np.isin(np.arange(NX), (EY, EPSI)), calm, 1.0)
    table = np.zeros((len(SPEEDS) * len(lags), NZ, NZ))
    if weights.terminal > 0.0 and steady:
        axle_forces = car.Cf, 0.0, car.Cr, 0.0
        cars = [bicycle._replace(tau_delta=float(lag), tau_ax=float(slow)) for lag, slow in lags]
        levels = [q[0]] if calm == 1.0 else [q[0], quiet]
        costs = [kept_cost_to_go(one, axle_forces, tuple(at), tuple(r_du), Ts)
                 for at in levels for one in cars]
        table = weights.terminal * np.concatenate(costs)
    elif calm != 1.0:
        table = np.concatenate([table, table])
    return Horizon.allocated(
        N,
        NX,
        NU,
        delay=delay,
        Ts=Ts,
        car=np.array(bicycle),
        form=CORRECTED if form.matrices == "corrected" else PRINTED,
        method=EXACT if form.hold == "exact" else EULER,
        steady=steady,
        q=q,
        r_du=r_du,
        table=table,
        table_lags=lags,
        decoupled=form.decoupled,
        damped=form.damped,
        calm=calm,
        calm_gain=weights.calm_gain if form.observer else 0.0,
        approach=form.approach,
        unknown=LATENCIES - 1 if form.steering and form.lags else 0,
        walk=(WALK if form.noise else np.inf),
        slack_weights=SLACK_WEIGHTS,
        delta_max=min(DELTA_MAX_PAPER, car.delta_max),
        # the servo's rate; the drive has only its lag
        du_max=np.array([min(DELTA_STEP_PAPER, car.delta_rate_max * Ts)]),
        slip_cap=weights.slip_cap if form.slip_cap else np.pi,
        drive=(car.ax_min, car.F_drive_max, car.P_drive_max, car.m_eff),
        wheels=(car.R_w, 0.5 * car.track_f, car.vx_min, car.ay_limit, car.drive_front),
        traction=form.traction,
        soft=EY,
        soft_every=form.span,
        soft_bound=EY_MAX,
        scale=SCALE,
        gain=weights.observer_gain if form.observer else 0.0,
    )


def adaptive(
    car: VehicleParams,
    *,
    stiffness: StiffnessModel | None = None,
    weights: Weights | Mapping[str, float] | None = None,
    formulation: Formulation | Mapping[str, Any] | None = None,
    delay: int = 0,
    solver: str = "proxqp",
) -> LPVMPC:
    """The controller `lpv-mpc`: every part, or what `formulation` leaves of them."""
    form = changed(Formulation(), formulation)
    return LPVMPC(
        car, stiffness=stiffness, weights=weights, formulation=form, delay=delay, solver=solver
    )


def plain(
    car: VehicleParams,
    *,
    stiffness: StiffnessModel | None = None,
    weights: Weights | Mapping[str, float] | None = None,
    formulation: Formulation | Mapping[str, Any] | None = None,
    delay: int = 0,
    solver: str = "proxqp",
) -> LPVMPC:
    """The controller `lpv-mpc-paper`: the paper's plain formulation, constant stiffness."""
    return LPVMPC(
        car,
        stiffness=ConstantStiffness(car) if stiffness is None else stiffness,
        weights=chosen("lpv-mpc-paper", weights, PAPER_WEIGHTS),
        formulation=changed(PAPER, formulation),
        delay=delay,
        solver=solver,
    )
