"""Model predictive contouring control: where on the path the car is, the plan decides as well.

A point moves along the path, and its speed is an input of the plan. The car's place is told in the
frame of that point: the contouring error c beside it (left positive, in the place of e_y), the lag
error l along the path, the angle to it. What is paid for is

    sum  q_ey c^2 + q_lag l^2 + q_progress (v - v_ref(s))^2  +  the inputs' and v's increments,

and nothing else: there is no reference for lateral speed, yaw rate, heading or steering, as there
is for `nmpc`, and no terminal weight. Where the sources reward progress without limit, the speed of
the point is drawn to that of the reference here, as Brito et al. do, since the benchmark says how
fast the road is driven.

Pose and path are not approximated: the car is driven through each period in the frame in which it
began (`nmpc_model`, the car of `nmpc`), and then told in the frame of the moved point,

    (l, c)+ = R(psi(s) - psi(s+)) ((X, Y) - r(s, s+)),    s+ = s + v Ts,

where r is the path from s to s+ (Simpson's rule) and (X, Y) the car in the frame at s. Estimates,
knowledge of the car, protections, solver and line search are those of `nmpc`.

The weights are set by hand, with a look at short scenarios and the circuit.

Sources: Lam, Manzie, Good, Model predictive contouring control, CDC 2010; Liniger, Domahidi,
Morari, Optimization-based autonomous racing of 1:43 scale RC cars, Optim. Control Appl. Meth. 36
(2015), section 3; Brito, Floor, Ferranti, Alonso-Mora, Model predictive contouring control for
collision avoidance in unstructured dynamic environments, RA-L 4 (2019), for the reference speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import njit

from lpvmpc.car.bicycle import EPSI, EY, NU, NX, VX, VY
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import Tire
from lpvmpc.control.cost import UNITS, increment_weights
from lpvmpc.control.rivals.nmpc import NMPC, NP, TS, NMPCWeights
from lpvmpc.control.rivals.nmpc_model import linearised, period
from lpvmpc.control.rivals.nmpc_sqp import ENOUGH, EXACT_ENOUGH, NOTHING, TRIES, within
from lpvmpc.control.rivals.staged_qp import write
from lpvmpc.control.solver.checked import QPResult
from lpvmpc.control.stiffness.adaptation import MU
from lpvmpc.control.traction import pace
from lpvmpc.control.weights_file import chosen
from lpvmpc.interface import Preview, State
from lpvmpc.units import Array

LAG, RUSH, S = NX, NX + 1, NX + 2
"""States beside the car's: lag error [m], speed of the point beyond the reference's [m/s], and its
progress [m]."""
NZ, NV = NX + 3, NU + 1
"""Number of states; of inputs: those of the car, and the speed of the point [m/s]."""
V_MAX = 100.0
"""Largest speed of the point [m/s]."""
PSI, KAPPA, SPEED = 1, 2, 3
"""Rows of a path, after the progress of its points [m]: heading [rad], curvature [1/m], speed
[m/s]."""


@njit(cache=True)
def at(path, s):
    """Heading, curvature and speed of the path at a progress, and the speed's slope [1/s].

    Curvature and speed are linear between the points, and held beyond the last.

    Args:
        path: Rows as `PSI` says, shape (4, n).
        s: Progress [m].
    """
    n, j = path.shape[1], 0
    while j + 2 < n and s > path[0, j + 1]:
        j += 1
    ds, span = s - path[0, j], path[0, j + 1] - path[0, j]
    kappa, speed = path[KAPPA, j], path[SPEED, j]
    if span <= 1e-9:
        return path[PSI, j] + kappa * ds, kappa, speed, 0.0
    bend, slope = (path[KAPPA, j + 1] - kappa) / span, (path[SPEED, j + 1] - speed) / span
    if ds > span:  # beyond the last point
        end = path[KAPPA, j + 1]
        return path[PSI, j + 1] + end * (ds - span), end, path[SPEED, j + 1], 0.0
    psi = path[PSI, j] + (kappa + 0.5 * bend * ds) * ds
    return psi, kappa + bend * ds, speed + slope * ds, slope


@njit(cache=True)
def place(X, Y, psi, s, v, path, Ts, out, G):
    """The car's pose as the moved point sees it, and its Jacobian, in place.

    Args:
        X: Place of the car along the path's heading at `s`, from its point there [m].
        Y: The same to the left of it [m].
        psi: Heading of the car from that of the path there [rad].
        s: Progress [m].
        v: Speed of the point [m/s].
        path: See `at`.
        Ts: Control period [s].
        out: Receives (c, epsi, l, rush, s) one period later, shape (5,).
        G: Receives their derivatives by (X, Y, psi, s, v), shape (5, 5).
    """
    d = v * Ts
    psi_0, kappa_0, _, _ = at(path, s)
    psi_m, _, speed, slope = at(path, s + 0.5 * d)
    psi_1, kappa_1, _, _ = at(path, s + d)
    turn = psi_1 - psi_0
    cos_t, sin_t = math.cos(turn), math.sin(turn)
    x = X - d / 6.0 * (1.0 + 4.0 * math.cos(psi_m - psi_0) + cos_t)
    y = Y - d / 6.0 * (4.0 * math.sin(psi_m - psi_0) + sin_t)
    lag, c = cos_t * x + sin_t * y, cos_t * y - sin_t * x
    out[0], out[1], out[2], out[3], out[4] = c, psi - turn, lag, v - speed, s + d
    # where the point ends, and where it begins while the car's pose stays as it is seen from it
    end = (-kappa_1 * lag, -kappa_1, -(1.0 - kappa_1 * c))
    along, aside = 1.0 - kappa_0 * Y, kappa_0 * X
    begin = (cos_t * aside - sin_t * along, kappa_0, cos_t * along + sin_t * aside)
    G[:, :] = 0.0
    G[0, 0], G[0, 1] = -sin_t, cos_t
    G[1, 2] = 1.0
    G[2, 0], G[2, 1] = cos_t, sin_t
    for i in range(3):
        G[i, 3] = begin[i] + end[i]
        G[i, 4] = Ts * end[i]
    G[3, 3], G[3, 4] = -slope, 1.0 - 0.5 * Ts * slope
    G[4, 3], G[4, 4] = 1.0, Ts


@njit(cache=True)
def step(z, v, path, model, learned, disturbance, Ts, moved, out, G):
    """One period of the car and of the point, in place.

    Args:
        z: State, shape (14,).
        v: Inputs, shape (3,).
        path: See `at`.
        model: See `nmpc_model`, also for the next two.
        learned: As above.
        disturbance: As above.
        Ts: Control period [s].
        moved: Receives the car's state in the frame in which the period began, shape (11,).
        out: Receives the state, shape (14,).
        G: See `place`.
    """
    period(z[:NX], v[:NU], 0.0, 0.0, model, learned, disturbance, Ts, moved)
    pose = np.empty(5)
    X = z[LAG] + 0.5 * Ts * (onwards(z) + onwards(moved))
    place(X, moved[EY], moved[EPSI], z[S], v[NU], path, Ts, pose, G)
    out[:NX] = moved
    out[EY], out[EPSI], out[LAG], out[RUSH], out[S] = pose


@njit(cache=True)
def onwards(x):
    """Speed of the car along the heading of the frame [m/s]."""
    return x[VX] * math.cos(x[EPSI]) - x[VY] * math.sin(x[EPSI])


@njit(cache=True)
def slope_of_onwards(x, row):
    """Add the derivatives of `onwards` by the state to a row, in place."""
    sin_e, cos_e = math.sin(x[EPSI]), math.cos(x[EPSI])
    row[VX] += cos_e
    row[VY] -= sin_e
    row[EPSI] -= x[VX] * sin_e + x[VY] * cos_e


@njit(cache=True)
def jacobian(z, v, path, model, learned, disturbance, Ts, out, J):
    """As `step`, and its Jacobian by (z, v), in place, shape (14, 17)."""
    car, moved, G = np.empty((NX, NX + NU)), np.empty(NX), np.empty((5, 5))
    step(z, v, path, model, learned, disturbance, Ts, moved, out, G)
    linearised(z[:NX], v[:NU], 0.0, 0.0, model, learned, disturbance, Ts, moved, car)
    # (X, Y, psi, s, v) by (z, v)
    pose, row = np.zeros((5, NZ + NV)), np.zeros(NX)
    slope_of_onwards(moved, row)
    J[:, :] = 0.0
    for i in range(NX):
        for j in range(NX + NU):
            to = j if j < NX else NZ + j - NX
            J[i, to] = car[i, j]
            pose[0, to] += 0.5 * Ts * row[i] * car[i, j]
    row[:] = 0.0
    slope_of_onwards(z, row)
    for j in range(NX):
        pose[0, j] += 0.5 * Ts * row[j]
    pose[0, LAG] = 1.0
    pose[1], pose[2] = J[EY], J[EPSI]
    pose[3, S], pose[4, NZ + NU] = 1.0, 1.0
    for i, to in enumerate((EY, EPSI, LAG, RUSH, S)):
        for j in range(NZ + NV):
            J[to, j] = 0.0
            for m in range(5):
                J[to, j] += G[i, m] * pose[m, j]


@njit(cache=True)
def drive(path, model, learned, disturbance, Ts, q, r, last, aside, vs, zs):
    """States of a plan from `zs[0]` on, in place, and its cost; infinite where they are not finite.

    Args:
        path: See `at`.
        model: See `nmpc_model`, also for the next two.
        learned: As above.
        disturbance: As above.
        Ts: Control period [s].
        q: Weights of the states, shape (14,).
        r: Weights of the inputs' increments, shape (3,).
        last: Inputs of the period before, shape (3,).
        aside: Contouring errors to have: zero, but while the car is led back, shape (N,).
        vs: Inputs, shape (N, 3).
        zs: Receives the states, shape (N + 1, 14).
    """
    moved, G = np.empty(NX), np.empty((5, 5))
    for k in range(len(vs)):
        step(zs[k], vs[k], path, model, learned, disturbance, Ts, moved, zs[k + 1], G)
    return cost(q, r, last, aside, vs, zs)


@njit(cache=True)
def cost(q, r, last, aside, vs, zs):
    """Cost of a plan and its states; see `drive`."""
    total = 0.0
    for k in range(len(vs)):
        for i in range(NZ):
            error = zs[k + 1, i] - (aside[k] if i == EY else 0.0)
            total += q[i] * error * error if q[i] > 0.0 else 0.0
        for m in range(NV):
            rise = vs[k, m] - (vs[k - 1, m] if k > 0 else last[m])
            total += r[m] * rise * rise
    return total if np.isfinite(total + np.sum(zs)) else np.inf


@njit(cache=True)
def linearise(path, model, learned, disturbance, Ts, vs, zs, Ad, Bd, cd):
    """Linearise every period along the plan into Ad, Bd and cd, in place."""
    J, after = np.empty((NZ, NZ + NV)), np.empty(NZ)
    for k in range(len(vs)):
        jacobian(zs[k], vs[k], path, model, learned, disturbance, Ts, after, J)
        Ad[k], Bd[k] = J[:, :NZ], J[:, NZ:]
        cd[k] = after - Ad[k] @ zs[k] - Bd[k] @ vs[k]


@dataclass(frozen=True, kw_only=True)
class MPCCWeights(NMPCWeights):
    """Everything of `MPCC` that is tuned; weights are per second and normalised by `cost.UNITS`."""

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "q_ey": NMPCWeights.RANGES["q_ey"],
        "q_lag": (5.0, 2000.0),
        "q_progress": (0.5, 300.0),
        "r_delta": NMPCWeights.RANGES["r_delta"],
        "r_ax": NMPCWeights.RANGES["r_ax"],
        "r_progress": (0.001, 1.0),
        "observer_gain": NMPCWeights.RANGES["observer_gain"],
        "slip_cap": NMPCWeights.RANGES["slip_cap"],
    }
    """Where tuning searches."""

    q_lag: float = 150.0
    """Weight of the lag error, in the unit of the lateral one."""
    q_progress: float = 30.0
    """Weight of the point's speed error, in the unit of the car's."""
    r_progress: float = 0.01
    """Weight of the point's acceleration, in the unit of `ax`."""
    q_vx: float = 0.0
    """No weight here, as all of the following."""
    q_vy: float = 0.0
    """No weight."""
    q_r: float = 0.0
    """No weight."""
    q_epsi: float = 0.0
    """No weight."""
    terminal: float = 0.0
    """No weight."""


class MPCC(NMPC):
    """Contouring control with the model, estimates, protections and solver of `nmpc`."""

    name = "mpcc"
    by_hand = MPCCWeights()
    sizes = NZ, NV

    def __init__(
        self,
        car: VehicleParams,
        tires: tuple[Tire, Tire],
        *,
        weights: MPCCWeights | Mapping[str, float] | None = None,
        delay: int = 0,
    ) -> None:
        """Build the controller; arguments and errors are those of `NMPC`."""
        w = chosen(self.name, weights, self.by_hand)
        self._q = np.zeros(NZ)
        self._q[[EY, LAG]] = np.array([w.q_ey, w.q_lag]) / UNITS["ey"] ** 2 * TS
        self._q[RUSH] = w.q_progress / UNITS["vx"] ** 2 * TS
        rate = w.r_progress / UNITS["ax"] ** 2 / TS
        self._r = np.append(increment_weights(w, ("delta", "ax"), TS), rate)
        self._vs, self._zs = np.zeros((NP, NV)), np.zeros((NP + 1, NZ))
        self._linear = np.zeros((NP, NZ, NZ)), np.zeros((NP, NZ, NV)), np.zeros((NP, NZ))
        self._bounds = np.zeros((NP, NV)), np.full((NP, NV), V_MAX)
        self._x_ref, self._path = np.zeros((NP, NZ)), np.zeros((4, 2))
        self._last = np.zeros(NV)
        self._goes_on = False
        super().__init__(car, tires, weights=w, delay=delay)

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the run so far. The controller is deterministic: `rng` is not used."""
        super().reset(rng)
        self._goes_on = False

    def write_qp(self, state: State, preview: Preview) -> None:
        """Bounds, the path, and the plan that the search begins with."""
        super().write_qp(state, preview)
        h = self.horizon
        first = h.delay + int(h.lateness[0])
        speed = preview.vx_ref[first:]
        gone = np.append(0.0, np.cumsum(0.5 * (speed[:-1] + speed[1:]) * h.Ts))
        if self._limits.protected:
            friction, allowed = float(self._learned[MU]), h.allowed
            speed = pace(speed, preview.kappa[first:], friction, allowed[3], allowed[4],
                         h.wheels[3], h.Ts)
        self._path = np.array([gone, preview.psi[first:], preview.kappa[first:], speed])
        self._x_ref[:, EY] = h.x_ref[:, EY]
        for bound, of in zip(self._bounds, (h.u_lo, h.u_hi), strict=True):
            bound[:, :NU] = of
        # the point goes on as it was planned; at first, with the car
        point = np.append(self._vs[1:, NU], self._vs[-1, NU])
        if not self._goes_on:
            point[:] = self._last[NU] = onwards(self._xs[0])
        self._last[:NU] = h.queue[-1]
        self._vs[:, :NU], self._vs[:, NU] = self._us, point
        self._zs[0] = 0.0
        self._zs[0, :NX] = self._xs[0]
        if self._cost < np.inf:
            self._cost = drive(*self._about, self._vs, self._zs)

    @property
    def _about(self) -> tuple[Any, ...]:
        """What `drive` takes before a plan."""
        h = self.horizon
        return (self._path, self.model, self._learned, h.disturbance, h.Ts, self._q, self._r,
                self._last, self._x_ref[:, EY])

    def program(self) -> None:
        """Write the quadratic program about the plan."""
        h = self.horizon
        linearise(*self._about[:5], self._vs, self._zs, *self._linear)
        weights = np.broadcast_to(self._q, (NP, NZ)).copy()
        write(
            *self._linear, self._zs[0], self._last, self._x_ref, weights, self._r, NOTHING_AFTER,
            NOTHING_AFTER[0], *self._bounds, np.array([h.du_max[0], np.inf, np.inf]), self.qp.data,
        )

    def search(self, v: Array, value: float) -> tuple[float, bool]:
        """As `nmpc_sqp.search`, with the point."""
        rows = np.append(v[NV:], np.zeros(NV)).reshape(NP, NZ + 2 * NV)
        goal, states = rows[:, NZ : NZ + NV].copy(), np.vstack([self._zs[:1], rows[:, :NZ]])
        promised = cost(*self._about[5:], goal, states)
        gain = value - promised
        if gain <= NOTHING:
            return value, True
        within(self.horizon.handle, goal)
        t = 1.0
        for _ in range(TRIES):
            plan = self._vs + t * (goal - self._vs)
            now = drive(*self._about, plan, states)
            if now <= value - ENOUGH * t * gain:
                self._vs[:], self._zs[:] = plan, states
                return now, t == 1.0 and abs(now - promised) <= EXACT_ENOUGH * now + NOTHING
            t *= 0.5
        return value, True

    def solve(self) -> QPResult:
        """As of `nmpc`; the point goes on where this is solved."""
        result = super().solve()
        self._goes_on = result.solved
        self._us[:], self._xs[:] = self._vs[:, :NU], self._zs[:, :NX]
        self._last[NU] = self._vs[0, NU]
        return result


NOTHING_AFTER: Array = np.zeros((NZ + NV, NZ + NV))
"""There is no terminal weight."""
