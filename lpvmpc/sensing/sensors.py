"""Sensors: what the car measures of its own motion, with all that is wrong with it.

One `Channel` describes each signal; at a control instant it reads

    y = q( (1 + scale) x(t_s - latency) + bias + wander(t) + std n )

with n white, q rounding to the quantum, t_s the newest sample, scale and bias constant in a run and
wander a first-order Gauss-Markov process of the given standard deviation and time constant. A
sample that is lost, or not due yet, leaves the last one standing, as on a car's bus; the pose alone
says by NaN that it has nothing new. All is drawn from one generator, so a seed gives the same run.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import fields

import numpy as np

from lpvmpc.interface import Measurement, State
from lpvmpc.sensing.channels import EXACT, PRODUCTION, RTK, Channel, Sensing
from lpvmpc.units import Array

__all__ = ["EXACT", "PRODUCTION", "RTK", "Channel", "Sensing", "Sensors"]

X, PSI, VX, VY, R, AX, AY, DELTA, WHEELS = 0, 2, 3, 4, 5, 6, 7, 8, 9
N = 13
"""Signals in a row: x, y, psi, vx, vy, r, ax, ay, delta, four wheels."""
_UNITS = (
    ("x", "m"), ("y", "m"), ("psi", "rad"), ("vx", "mps"), ("vy", "mps"), ("r", "radps"),
    ("ax", "mps2"), ("ay", "mps2"), ("delta", "rad"), ("wheel_fl", "radps"),
    ("wheel_fr", "radps"), ("wheel_rl", "radps"), ("wheel_rr", "radps"),
)


class Sensors:
    """The sensors of one run.

    Attributes:
        drawn: What is constant in this run and not zero: biases, scale errors, latencies, with
            units in the names. With `sensing.lane`, `x_bias_m` is the error across the path.
    """

    def __init__(self, sensing: Sensing, Ts: float, rng: np.random.Generator) -> None:
        """Draw what is constant in a run.

        Args:
            sensing: The sensors.
            Ts: Control period [s].
            rng: Source of all their errors.
        """
        self.sensing, self.Ts, self._rng = sensing, Ts, rng
        self.drawn: dict[str, float] = {}
        self._exact = sensing.exact
        if self._exact:
            return
        self._std = self._per_signal("std")
        self._quantum = self._per_signal("quantum")
        spread, width = self._per_signal("bias_std"), self._per_signal("bias_range")
        self._bias = spread * rng.standard_normal(N) + width * rng.uniform(-1.0, 1.0, N)
        self._gain = 1.0 + self._per_signal("scale_range") * rng.uniform(-1.0, 1.0, N)
        self._wander_std = self._per_signal("wander_std")
        self._keep = np.exp(-Ts / self._per_signal("wander_time"))
        self._stir = self._wander_std * np.sqrt(1.0 - self._keep**2)
        self._wander = self._wander_std * rng.standard_normal(N)
        if sensing.lane:
            self._bias[1] = self._wander[1] = self._stir[1] = self._std[1] = 0.0
        self._rate = self._per_signal("rate")
        self._dropout = self._per_signal("dropout")
        ages = np.array([self._channel(i).latency for i in range(N)])
        self._latency = ages[:, 0] + (ages[:, 1] - ages[:, 0]) * rng.uniform(0.0, 1.0, N)
        self._phase = rng.uniform(0.0, 1.0, N)
        absent = [i for i in range(N) if not self._channel(i).measured]
        self._absent = np.array(absent, dtype=int)
        pose = sensing.position
        self._pose_in_time = not (pose.rate or pose.latency[1] or pose.dropout)
        self._others_in_time = not (
            self._rate[VX:].any() or self._latency[VX:].any() or self._dropout[VX:].any()
        )
        self._quantised = np.flatnonzero(self._quantum)
        longest = max(ages.max(), self._latency.max())
        slowest = max((1.0 / rate for rate in self._rate if rate), default=0.0)
        self._past = deque[tuple[float, Array, float]](
            maxlen=math.ceil((longest + slowest) / Ts) + 3
        )
        self._frame = 0
        self._in_flight = deque[tuple[float, float, Array]](maxlen=256)
        self._index = np.full(N, -1.0)
        self._held = np.full(N, np.nan)
        for values, neutral, what, unit in (
            (self._bias, 0.0, "bias", True),
            (self._gain - 1.0, 0.0, "scale", False),
            (self._latency * (np.arange(N) >= VX), 0.0, "latency_s", False),
        ):
            for i in np.flatnonzero(values != neutral):
                if i not in absent:
                    name, of = _UNITS[i]
                    self.drawn[f"{name}_{what}" + f"_{of}" * unit] = float(values[i])

    def measure(self, state: State, psi_path: float, t: float) -> Measurement:
        """What the sensors say now; called once at each control instant, in order.

        Args:
            state: The true state.
            psi_path: Heading of the path beside the car [rad]: across it lies a lane's error.
            t: Time of this instant [s], a multiple of the control period.
        """
        if self._exact:
            x, y, psi, vx, vy, r, delta, ax, ay, wheel_speed = state
            return Measurement(x, y, psi, 0.0, vx, vy, r, ax, ay, delta, wheel_speed)
        rng = self._rng
        true = np.empty(N)
        true[:WHEELS] = (
            state.x, state.y, state.psi, state.vx, state.vy, state.r, state.ax, state.ay,
            state.delta,
        )
        true[WHEELS:] = state.wheel_speed
        self._past.append((t, true, psi_path))
        if len(self._past) > 1:
            self._wander = self._keep * self._wander + self._stir * rng.standard_normal(N)
        if self._others_in_time:
            read = self._spoilt(true, psi_path)
        else:
            read = self._held_signals(t)
        if self._pose_in_time:
            age, pose = 0.0, self._spoilt(true, psi_path) if not self._others_in_time else read
        else:
            age, pose = self._newest_pose(t)
        if self._absent.size:
            read = read.copy()
            read[self._absent] = np.nan
        x, y, psi = (float(value) for value in pose[:VX])
        if not self.sensing.psi.measured:
            psi = math.nan
        vx, vy, r, ax, ay, delta = (float(value) for value in read[VX:WHEELS])
        return Measurement(x, y, psi, age, vx, vy, r, ax, ay, delta, read[WHEELS:].copy())

    def _spoilt(self, true: Array, psi_path: float) -> Array:
        """True signals with all errors of this instant, shape (N,)."""
        error = self._bias + self._wander + self._std * self._rng.standard_normal(N)
        read = self._gain * true + error
        if self.sensing.lane:
            read[0] = true[0] - error[0] * math.sin(psi_path)
            read[1] = true[1] + error[0] * math.cos(psi_path)
        i = self._quantised
        read[i] = self._quantum[i] * np.round(read[i] / self._quantum[i])
        return read

    def _held_signals(self, t: float) -> Array:
        """All signals but the pose, with rates, latencies and losses: the last sample stands."""
        due = np.where(self._rate > 0.0, np.floor(t * self._rate + self._phase), t / self.Ts)
        new = due > self._index
        self._index = due
        lost = self._rng.uniform(size=N) < self._dropout
        first = np.isnan(self._held)
        taken = np.full(N, t)
        rated = self._rate > 0.0
        taken[rated] = (due[rated] - self._phase[rated]) / self._rate[rated]
        seen = np.array([self._at(when)[i] for i, when in enumerate(taken - self._latency)])
        fresh = self._spoilt(seen, 0.0)
        self._held = np.where(first | (new & ~lost), fresh, self._held)
        return self._held

    def _newest_pose(self, t: float) -> tuple[float, Array]:
        """Age and reading of the newest pose that has arrived since the last instant."""
        pose, rng = self.sensing.position, self._rng
        while True:
            if pose.rate:
                taken = (self._frame + self._phase[0]) / pose.rate
            else:
                taken = self._frame * self.Ts
            if taken > t + 1e-9:
                break
            self._frame += 1
            low, high = pose.latency
            arrival = taken + low + (high - low) * rng.uniform()
            lost = rng.uniform() < pose.dropout
            if not lost:
                reading = self._spoilt(self._at(taken), self._past[-1][2])
                self._in_flight.append((arrival, taken, reading))
        here = [frame for frame in self._in_flight if frame[0] <= t + 1e-9]
        if not here:
            return math.nan, np.full(N, np.nan)
        _, taken, reading = max(here, key=lambda frame: frame[1])
        # a pose taken before it that arrives later is of no use
        later = [frame for frame in self._in_flight if frame[1] > taken]
        self._in_flight.clear()
        self._in_flight.extend(later)
        return max(t - taken, 0.0), reading

    def _at(self, t: float) -> Array:
        """True signals at a time between the instants, shape (N,).

        Linear but for the pose, which follows the cubic of its values and rates: linear
        interpolation would cut a bend by 1 mm.
        """
        past = self._past
        if t >= past[-1][0] or len(past) == 1:
            return past[-1][1]
        i = len(past) - 2
        while i > 0 and past[i][0] > t:
            i -= 1
        (t0, a, _), (t1, b, _) = past[i], past[i + 1]
        h = t1 - t0
        u = min(max((t - t0) / h, 0.0), 1.0)
        value = (1.0 - u) * a + u * b
        p0, p1 = _rates(a), _rates(b)
        w = u * u * (3.0 - 2.0 * u)
        value[:VX] = (
            (1.0 - w) * a[:VX] + w * b[:VX]
            + h * u * (1.0 - u) * ((1.0 - u) * p0 - u * p1)
        )
        return value

    def _channel(self, i: int) -> Channel:
        names = [field.name for field in fields(Sensing)]
        return getattr(self.sensing, names[0 if i < PSI else min(i - 1, 8)])

    def _per_signal(self, key: str) -> Array:
        return np.array([getattr(self._channel(i), key) for i in range(N)], dtype=np.float64)


def _rates(signals: Array) -> Array:
    """Rates of x, y, psi [m/s, m/s, rad/s], shape (3,)."""
    c, s = math.cos(signals[PSI]), math.sin(signals[PSI])
    vx, vy = signals[VX], signals[VY]
    return np.array([c * vx - s * vy, s * vx + c * vy, signals[R]])
