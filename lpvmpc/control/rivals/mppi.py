"""Model predictive path integral control: steering by the best of many random futures.

In every control period 3 x 1024 plans are drawn around the plan before, each drives a nonlinear
model of the car over 15 periods, and the new plan is their mean, weighted by exp(-cost / lambda).
The second and third thousand are drawn more closely. The random numbers come from the generator
that `reset` is given: the same seed gives the same bytes. Nothing is linearised and nothing needs a
gradient; the price is noise in the command, and two hundred times the time of `lpv-mpc`.

The model is the single track with the lags of steering and drive, relaxation, and axle forces that
follow the adapted tangents up to the friction limit; roll is left out. Cost, references, estimates,
adaptation, told delay, start and stop, and protections are those of `lpv-mpc`, its disturbance
observer included.

Source: Williams, Drews, Goldfain, Rehg, Theodorou, Information-theoretic model predictive control:
theory and applications to autonomous driving, IEEE Transactions on Robotics 34 (2018); here with
several passes, increments as noise, and a temperature relative to the spread of the costs.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import AF, AR, DELTA, EPSI, EY, NU, NX, VX, VY, A, R, unpack
from lpvmpc.car.params import VehicleParams
from lpvmpc.control.cost import NZ, SHARED_RANGES, Weights
from lpvmpc.control.formulation import Formulation
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.period import ahead
from lpvmpc.control.solver.checked import QPResult
from lpvmpc.control.stiffness.models import StiffnessModel
from lpvmpc.control.weights_file import chosen
from lpvmpc.interface import Preview, State
from lpvmpc.units import GRAVITY

PERIODS = 15
"""Horizon [control periods]."""
SAMPLES = 1024
"""Plans that are drawn in each pass; half of them mirror the others."""
SPREADS = (1.0, 0.4, 0.15)
"""Spread of each pass, as a share of `spread_delta` and `spread_ax`."""
HELD = 3
"""Periods for which an increment is drawn at once, a divisor of the horizon: fewer to find."""
SUBSTEPS = 3
"""Steps of the model in a period."""


@dataclass(frozen=True, kw_only=True)
class MPPIWeights(Weights):
    """Everything of `MPPI` that is tuned; what it shares with `cost.Weights` means the same."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        **SHARED_RANGES,
        "spread_delta": (0.0005, 0.02),
        "spread_ax": (0.02, 2.0),
        "temperature": (0.005, 0.5),
    }
    """Where tuning searches."""

    spread_delta: float = 0.004
    """Standard deviation of the steering's increments in the first pass [rad]."""
    spread_ax: float = 0.2
    """The same of the acceleration's [m/s2]."""
    temperature: float = 0.05
    """lambda, as a share of the standard deviation of the costs [-]."""


class MPPI(LPVMPC):
    """Model predictive path integral controller."""

    name = "mppi"

    def __init__(
        self,
        car: VehicleParams,
        *,
        stiffness: StiffnessModel | None = None,
        weights: MPPIWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller.

        Args:
            car: Vehicle parameters.
            stiffness: Model of the axle forces; the shipped `network` by default.
            weights: Cost weights, spreads and temperature, or some by name; the shipped by default.
            delay: Known delay between command and effect [periods], compensated by prediction.

        Raises:
            OptionError: A value outside its domain.
        """
        chosen_weights = chosen(self.name, weights, MPPIWeights())
        self._spread = np.array([chosen_weights.spread_delta, chosen_weights.spread_ax])
        self._temperature = chosen_weights.temperature
        L, mg = car.wheelbase, car.m * GRAVITY
        self._most = car.mu * mg * np.array([car.lr, car.lf]) / L  # what the axles can give [N]
        self._rng = np.random.default_rng(0)
        self._costs = np.zeros(SAMPLES)
        super().__init__(
            car,
            stiffness=stiffness,
            weights=chosen_weights,
            formulation=Formulation(Np=PERIODS, span=3),
            delay=delay,
        )

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far; `rng` draws the plans of the next."""
        super().reset(rng)
        self._rng = rng

    def write_qp(self, state: State, preview: Preview) -> None:
        """As `LPVMPC`, for references and bounds; the curvature ahead besides."""
        super().write_qp(state, preview)
        h = self.horizon
        late = h.delay + int(h.lateness[0])
        self._kappa = ahead(h.handle, preview.kappa[late:], preview.vx_ref[late:])

    def solve(self) -> QPResult:
        """The mean of the drawn plans in place of the quadratic program's solution."""
        start = time.thread_time_ns()
        h = self.horizon
        most = self._most * min(getattr(self.stiffness, "friction", 1.0), 1.0)
        plan = h.plan.copy()
        within(h.handle, plan)
        for share in SPREADS:
            half = self._rng.standard_normal((SAMPLES // 2, PERIODS // HELD, NU))
            half = np.repeat(share * self._spread * half, HELD, axis=1)
            improve(
                h.handle, plan, np.concatenate([half, -half]), self._kappa, most,
                self._temperature, self._costs,
            )
        z = np.zeros(len(h.g))
        z[: plan.size] = (plan / h.scale).ravel()
        ok = bool(np.isfinite(z).all())
        used = (time.thread_time_ns() - start) * 1e-3
        return QPResult(z, ok, "SOLVED" if ok else "NOT_FINITE", 0.0, used, 0.0)


@njit(cache=True)
def within(h, plan):
    """Bring a plan within the bounds of inputs and increments, in place."""
    for m in range(NU):
        before = h.queue[-1, m]
        for k in range(len(plan)):
            value = min(max(plan[k, m], h.u_lo[k, m]), h.u_hi[k, m])
            if m < len(h.du_max):
                value = min(max(value, before - h.du_max[m]), before + h.du_max[m])
            plan[k, m] = before = value


@njit(cache=True)
def step(x, u, kappa, tires, most, disturbance, car, share_delta, share_a, dt):
    """One step of the nonlinear single track, in place.

    Args:
        x: State of `bicycle`, shape (11,); roll is left alone.
        u: Commands (delta [rad], ax [m/s2]), shape (2,).
        kappa: Curvature [1/m].
        tires: Affine axle forces (Cf, F0f, Cr, F0r), shape (4,).
        most: Friction limits of the axles [N], shape (2,).
        disturbance: Unmodelled accelerations of (vx, vy, r), shape (3,).
        car: `Bicycle` constants.
        share_delta: What the steering answers within the step, 1 - exp(-dt / lag) [-].
        share_a: The same of the drive.
        dt: The step [s].
    """
    x[DELTA] += share_delta * (u[0] - x[DELTA])
    x[A] += share_a * (u[1] - x[A])
    vx, vy, r, delta = max(x[VX], car.vx_min), x[VY], x[R], x[DELTA]
    alpha_f = delta - np.arctan2(vy + car.lf * r, vx)
    alpha_r = -np.arctan2(vy - car.lr * r, vx)
    x[AF] += (1.0 - np.exp(-vx * dt / car.sigma_f)) * (alpha_f - x[AF])
    x[AR] += (1.0 - np.exp(-vx * dt / car.sigma_r)) * (alpha_r - x[AR])
    Fyf = min(max(tires[0] * x[AF] + tires[1], -most[0]), most[0])
    Fyr = min(max(tires[2] * x[AR] + tires[3], -most[1]), most[1])
    drag = car.c_roll * car.m * GRAVITY + car.k_drag * vx * vx
    sin, cos = np.sin(delta), np.cos(delta)
    x[VX] += dt * (x[A] + r * vy - (Fyf * sin + drag) / car.m + disturbance[0])
    x[VY] += dt * ((Fyf * cos + Fyr) / car.m - r * vx + disturbance[1])
    x[R] += dt * ((car.lever_f * Fyf * cos - car.lever_r * Fyr) / car.Iz + disturbance[2])
    # the position moves with the mean of the speeds before and after
    vx, vy, r = 0.5 * (vx + max(x[VX], car.vx_min)), 0.5 * (vy + x[VY]), 0.5 * (r + x[R])
    sin, cos = np.sin(x[EPSI]), np.cos(x[EPSI])
    along = (vx * cos - vy * sin) / (1.0 - x[EY] * kappa)
    x[EY] += dt * (vx * sin + vy * cos)
    x[EPSI] += dt * (r - kappa * along)


@njit(cache=True)
def cost_of(h, plan, kappa, most, car, x, z):
    """Cost of a plan, with the model's states along it; as `qp.condense` has it.

    Args:
        h: Handle of a `Horizon`, as `period.write` leaves it.
        plan: Commands, shape (15, 2).
        kappa: Curvature at the ends of the periods [1/m], shape (16,).
        most: See `step`.
        car: As above.
        x: Room for a state, shape (11,).
        z: Room for a terminal error, shape (13,).
    """
    N, q, dt = len(plan), h.q, h.Ts / SUBSTEPS
    span = N // len(h.axle_forces)
    share_delta, share_a = 1.0 - np.exp(-dt / car.tau_delta), 1.0 - np.exp(-dt / car.tau_ax)
    x[:] = h.schedule[0]
    cost = 0.0
    for k in range(N):
        for m in range(NU):
            du = plan[k, m] - (plan[k - 1, m] if k > 0 else h.queue[-1, m])
            cost += h.r_du[m] * du * du
        middle = 0.5 * (kappa[k] + kappa[k + 1])
        for _ in range(SUBSTEPS):
            step(
                x, plan[k], middle, h.axle_forces[k // span], most, h.disturbance, car,
                share_delta, share_a, dt,
            )
        for i in range(EPSI + 1):
            error = x[i] - h.x_ref[k, i]
            cost += q[k, i] * error * error
    for i in range(NX):
        z[i] = x[i] - h.z_ref[i] if i <= AR else 0.0
    for m in range(NU):
        z[NX + m] = plan[N - 1, m] - h.z_ref[NX + m]
    for i in range(NZ):
        for j in range(NZ):
            cost += z[i] * h.terminal[i, j] * z[j]
    return cost


@njit(cache=True)
def improve(h, plan, noise, kappa, most, temperature, costs):
    """Replace a plan by the weighted mean of those drawn around it, in place.

    Args:
        h: See `cost_of`, also for the rest.
        plan: As above; within its bounds.
        noise: Increments to add, shape (samples, 15, 2).
        kappa: As above.
        most: As above.
        temperature: lambda as a share of the standard deviation of the costs [-].
        costs: Receives the costs, shape (samples,).
    """
    car, n = unpack(h.car), len(noise)
    x, z, drawn = np.empty(NX), np.empty(NZ), np.empty((n, *plan.shape))
    for i in range(n):
        for m in range(NU):
            walked = 0.0
            for k in range(len(plan)):
                walked += noise[i, k, m]
                drawn[i, k, m] = plan[k, m] + walked
        within(h, drawn[i])
        value = cost_of(h, drawn[i], kappa, most, car, x, z)
        costs[i] = value if np.isfinite(value) else 1e30
    least, scale = costs.min(), max(temperature * costs.std(), 1e-12)
    plan[:] = 0.0
    total = 0.0
    for i in range(n):
        weight = np.exp(-(costs[i] - least) / scale)
        total += weight
        for k in range(len(plan)):
            for m in range(NU):
                plan[k, m] += weight * drawn[i, k, m]
    plan /= total
