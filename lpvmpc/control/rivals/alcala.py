"""The cascade that the paper builds on: a kinematic LPV-MPC outside, a dynamic LPV-LQR inside.

The outer loop plans the yaw rate w on the kinematics of the path's errors,

    ey' = v sinc(chi) chi,    chi' = w - kappa v cos(chi) / (1 - ey kappa),

an LPV system scheduled by speed, course error chi and lateral error, by a quadratic program over 20
periods; the speed's reference is that of the road. The inner loop makes the car turn so fast: it
steers what holds w steadily, and feeds back lateral speed, yaw rate, steering angle and the
integral of the yaw rate's error, with gains from the Riccati equation of the linear single track,
scheduled by speed; another such regulator holds the speed. The outer loop takes the inner one as
infinitely fast, as its authors do, and no loop knows what the tires do near their limit: that is
where one model of all of it, as in `lpv-mpc`, is better.

In place of the authors' linear matrix inequalities there is one Riccati equation for each of 16
speeds, with interpolated gains. A told delay is met by prediction in both loops; a car far beside
its path is led back, the front tires are not steered past their peak, wheels neither spin nor lock.

Sources: Alcala, Puig, Quevedo, Rosolia, Autonomous racing using linear parameter varying - model
predictive control (LPV-MPC), Control Engineering Practice 95 (2020); Alcala, Puig, Quevedo,
Escobet, Gain-scheduling LPV control for autonomous vehicles including friction force estimation
and compensation mechanism, IET Control Theory and Applications 12 (2018), for the cascade.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import SLACK_WEIGHTS, SPEEDS, increment_weights, stage_weights
from lpvmpc.control.formulation import EY_MAX
from lpvmpc.control.horizon import Horizon
from lpvmpc.control.period import BACK, NEAR
from lpvmpc.control.pid import PIDGains, ProtectedPID
from lpvmpc.control.qp import condense
from lpvmpc.control.tracker import REFUSALS, Tracker, checked_delay
from lpvmpc.control.weights_file import check_weights, chosen
from lpvmpc.errors import OptionError
from lpvmpc.interface import Preview, State
from lpvmpc.units import GRAVITY, Array

NX = 2
"""Number of states of the outer loop: ey, chi."""
EY, CHI = range(NX)
PERIODS, TS = 20, 0.033
"""Horizon [periods], control period [s]."""
TURN_STEP = 0.1
"""Largest change of the planned yaw rate in a period [rad/s]."""


@dataclass(frozen=True, kw_only=True)
class AlcalaWeights:
    """Everything of `Alcala` that is tuned; q_ey to r_r are normalised by `cost.UNITS`."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "q_ey": (2.0, 1000.0),
        "q_epsi": (1.0, 2000.0),
        "r_r": (0.05, 100.0),
        "turn": (0.02, 50.0),
        "turn_sum": (0.05, 500.0),
        "speed": (0.1, 100.0),
        "speed_sum": (0.1, 1000.0),
        "slip_cap": (0.1, 0.2),
    }
    """Where tuning searches."""

    q_ey: float = 50.0
    """Outer loop: weight of the lateral error."""
    q_epsi: float = 50.0
    """Outer loop: weight of the course error."""
    r_r: float = 2.0
    """Outer loop: weight of the yaw rate's rate."""
    turn: float = 0.3
    """Inner loop: price of the yaw rate's error, in squares of the steering angle [s2]."""
    turn_sum: float = 1.0
    """Inner loop: price of its integral [-]."""
    speed: float = 30.0
    """Inner loop: price of the speed's error, in squares of the acceleration [1/s2]."""
    speed_sum: float = 60.0
    """Inner loop: price of its integral [1/s4]."""
    slip_cap: float = 0.14
    """Largest front slip angle that a command may ask for [rad]."""

    def __post_init__(self) -> None:
        """Refuse what no cost can mean."""
        check_weights(self)
        for name in ("r_r", "turn_sum", "speed_sum"):
            if (value := getattr(self, name)) < 1e-4:
                raise OptionError(f"weight {name}", value, "a number of at least 1e-4")
        if self.slip_cap < 0.01:
            raise OptionError("weight slip_cap", self.slip_cap, "at least 0.01 rad")


class Alcala(Tracker):
    """Kinematic LPV-MPC over a dynamic LPV-LQR."""

    name = "lpv-mpc-alcala"

    def __init__(
        self,
        car: VehicleParams,
        *,
        weights: AlcalaWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            weights: Weights of both loops, or some by name; the shipped ones by default.
            delay: Known delay between command and effect [periods], compensated by prediction.

        Raises:
            OptionError: A value outside its domain.
        """
        delay = checked_delay(delay)
        self.weights = w = chosen(self.name, weights, AlcalaWeights())
        self._models, self._gains = inner_loop(car, w)
        kp, ki = speed_gains(car, w)
        self.speed = ProtectedPID(car, PIDGains(kp=kp, ki=ki, kd=0.0), TS, delay)
        L = car.wheelbase
        self._understeer = car.m / L * (car.lr / car.Cf - car.lf / car.Cr)
        self._drift = car.m * car.lf / (L * car.Cr)
        self._sent = [0.0] * (delay + 1)
        horizon = Horizon.allocated(
            PERIODS,
            NX,
            1,
            ns=5,  # the car's speeds beside the model's states
            delay=delay,
            Ts=TS,
            car=np.array([car.vx_min, car.mu * GRAVITY]),
            q=stage_weights(w, ("ey", "epsi"), PERIODS, NX, TS),
            r_du=increment_weights(w, ("r",), TS),
            slack_weights=SLACK_WEIGHTS,
            du_max=np.array([TURN_STEP]),
            soft=EY,
            soft_bound=EY_MAX,
            scale=np.ones(1),
        )
        super().__init__(car, horizon)

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        super().reset(rng)
        self.speed.reset()
        self._sum = 0.0

    def estimate(self, state: State, preview: Preview) -> None:
        """Course error and lateral motion, both predicted over the delay."""
        h, vx = self.horizon, max(state.vx, self.car.vx_min)
        if self.informed is None:
            self._sent = [state.delta] * (self.delay + 1)
            h.queue[:, 0] = state.r
        lateral = np.array([state.vy, state.r, state.delta])
        A, B = self._at(vx)[:2]
        ey, chi = preview.ey, preview.epsi + math.atan(state.vy / vx)
        for k in range(self.delay):
            before = lateral
            lateral = A @ lateral + B * self._sent[k + 1]
            turned = TS * 0.5 * (before[1] + lateral[1]) + (lateral[0] - before[0]) / vx
            ey += TS * vx * math.sin(chi + 0.5 * turned)
            chi += turned - TS * float(preview.kappa[k]) * vx * math.cos(chi)
        self._lateral = lateral
        h.schedule[0] = state.vx, lateral[0], lateral[1], ey, chi

    def write_qp(self, state: State, preview: Preview) -> None:
        """The outer loop's QP; the speed's regulator."""
        h = self.horizon
        write(h.handle, state.vx, preview.kappa)
        h.plan[:, 1] = self.speed.command(state, preview.vx_ref)

    def ask(self, delta: float, ax: float) -> tuple[float, float]:
        """The inner loop: the steering angle that turns the car as planned.

        Args:
            delta: Here the yaw rate that the outer loop wants [rad/s].
            ax: Acceleration [m/s2].
        """
        turn, car, vx = delta, self.car, max(float(self.horizon.schedule[0, 0]), self.car.vx_min)
        vy, r, angle = self._lateral
        steady = turn * (car.wheelbase + self._understeer * vx * vx) / vx
        error = np.array(
            [vy - turn * (car.lr - self._drift * vx * vx), r - turn, angle - steady, self._sum]
        )
        wanted = steady - float(self._at(vx)[2] @ error)
        flow = math.atan((vy + car.lf * r) / vx)
        cap, step, last = self.weights.slip_cap, car.delta_rate_max * TS, self._sent[-1]
        asked = min(max(wanted, flow - cap), flow + cap)
        asked = min(max(asked, last - step), last + step)
        asked = min(max(asked, -car.delta_max), car.delta_max)
        if asked == wanted or (r - turn) * (asked - wanted) > 0.0:  # else the integral winds up
            self._sum += TS * (r - turn)
        self._sent = [*self._sent[1:], asked]
        return asked, ax

    def _fall_back(self, state: State, preview: Preview) -> str:
        """A refused solve: the previous plan; after some, the yaw rate that leads to the path."""
        self._refused += 1
        h = self.horizon
        h.prediction[:] = h.schedule[0]
        if self._refused <= REFUSALS or not self.informed:
            return "shifted"
        vx, ey, chi = (float(value) for value in h.schedule[0, [0, 3, 4]])
        towards = -math.atan(ey / BACK / max(vx, self.car.vx_min))
        h.plan[:, 0] = float(preview.kappa[self.delay]) * vx + (towards - chi) / BACK
        return "driving"

    def _at(self, vx: float) -> tuple[Array, Array, Array]:
        """Model and gains of the inner loop at a speed: A (3, 3), B (3,), K (4,)."""
        k = int(np.clip(np.searchsorted(SPEEDS, vx) - 1, 0, len(SPEEDS) - 2))
        share = float(np.clip((vx - SPEEDS[k]) / (SPEEDS[k + 1] - SPEEDS[k]), 0.0, 1.0))
        model = (1.0 - share) * self._models[k] + share * self._models[k + 1]
        gains = (1.0 - share) * self._gains[k] + share * self._gains[k + 1]
        return model[:, :3], model[:, 3], gains


def inner_loop(car: VehicleParams, w: AlcalaWeights) -> tuple[Array, Array]:
    """Models and gains of the yaw rate's regulator at each of `cost.SPEEDS`.

    The states are vy, r and the steering angle, of the linear single track with the servo's lag,
    and the integral of the yaw rate's error; the input is the steering angle asked for.

    Args:
        car: Vehicle parameters.
        w: Prices.

    Returns:
        Discrete (A, B), shape (16, 3, 4); gains, shape (16, 4).
    """
    from scipy.linalg import expm, solve_discrete_are  # 0.1 s to import, needed once

    models, gains = np.zeros((len(SPEEDS), 3, 4)), np.zeros((len(SPEEDS), 4))
    Cf, Cr, lf, lr = car.Cf, car.Cr, car.lf, car.lr
    for n, v in enumerate(SPEEDS):
        M = np.zeros((5, 5))  # vy, r, delta, the sum, and the input
        M[0, :3] = -(Cf + Cr) / (car.m * v), -(lf * Cf - lr * Cr) / (car.m * v) - v, Cf / car.m
        M[1, 0] = -(lf * Cf - lr * Cr) / (car.Iz * v)
        M[1, 1], M[1, 2] = -(lf * lf * Cf + lr * lr * Cr) / (car.Iz * v), lf * Cf / car.Iz
        M[2, 2], M[2, 4] = -1.0 / car.tau_delta, 1.0 / car.tau_delta
        M[3, 1] = 1.0
        step = expm(TS * M)
        A, B = step[:4, :4], step[:4, 4:]
        price = np.diag([0.0, w.turn, 0.0, w.turn_sum])
        S = solve_discrete_are(A, B, price, np.eye(1))
        gains[n] = np.linalg.solve(np.eye(1) + B.T @ S @ B, B.T @ S @ A)[0]
        models[n] = step[:3][:, [0, 1, 2, 4]]
    return models, gains


def speed_gains(car: VehicleParams, w: AlcalaWeights) -> tuple[float, float]:
    """Gains of the speed's regulator on its error and the error's integral [1/s, 1/s2].

    The drive's lag is a state of the design whose feedback is left out.
    """
    from scipy.linalg import expm, solve_discrete_are

    M = np.zeros((4, 4))  # speed, acceleration, the sum, and the input
    M[0, 1], M[1, 1], M[1, 3], M[2, 0] = 1.0, -1.0 / car.tau_ax, 1.0 / car.tau_ax, 1.0
    step = expm(TS * M)
    A, B = step[:3, :3], step[:3, 3:]
    S = solve_discrete_are(A, B, np.diag([w.speed, 0.0, w.speed_sum]), np.eye(1))
    K = np.linalg.solve(np.eye(1) + B.T @ S @ B, B.T @ S @ A)[0]
    return float(K[0]), float(K[2])


@njit(cache=True)
def write(h, speed, kappa):
    """The outer loop's LPV model along the schedule, references, bounds and QP, in place.

    Args:
        h: Handle of a `Horizon`.
        speed: Measured speed [m/s].
        kappa: Curvature from now on [1/m].
    """
    vx_min, most = h.car
    v, Ts, delay, first = max(speed, vx_min), h.Ts, h.delay, 3
    aside = h.schedule[0, first + EY]
    excess = max(abs(aside) - NEAR, 0.0)
    h.soft_bound[0] = EY_MAX + excess
    for k in range(len(h.Ad)):
        ey, chi = h.schedule[k, first + EY], h.schedule[k, first + CHI]
        bend = kappa[delay + k]
        along = v if abs(chi) < 1e-6 else v * np.sin(chi) / chi
        h.Ad[k, EY, EY], h.Ad[k, EY, CHI] = 1.0, Ts * along
        h.Ad[k, CHI, EY], h.Ad[k, CHI, CHI] = 0.0, 1.0
        h.Bd[k, EY, 0], h.Bd[k, CHI, 0] = 0.5 * Ts * Ts * along, Ts
        rate = bend * v * np.cos(chi) / (1.0 - ey * bend)
        h.cd[k, EY], h.cd[k, CHI] = -0.5 * Ts * Ts * along * rate, -Ts * rate
        h.u_lo[k, 0], h.u_hi[k, 0] = -most / v, most / v
        if k == 0:  # what the increments can reach is allowed
            h.u_lo[k, 0] = min(h.u_lo[k, 0], h.queue[-1, 0] + h.du_max[0])
            h.u_hi[k, 0] = max(h.u_hi[k, 0], h.queue[-1, 0] - h.du_max[0])
        ey = np.sign(aside) * excess * np.exp(-(k + 1) * Ts / BACK)
        h.x_ref[k, EY], h.x_ref[k, CHI] = ey, -np.arctan(ey / BACK / v)
    condense(h)
