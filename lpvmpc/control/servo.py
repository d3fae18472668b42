"""How steering and drive really answer: their lag, latency, gain and offset, learned online.

What a servo does is measured, what it was asked for is known. A bank of models of the servo, each
with another lag and another whole number of periods of latency, is driven with the commands; each
is compared with the measurement by a regression

    measured = gain model + offset + error,

so that a misaligned wheel and a wrong ratio are found too. The answer is the mean over the bank,
weighted by the likelihood of the errors and a prior that believes the data sheet. Every model is
driven by the commands alone, never by the measurement, so that noise does not bias it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams

LAGS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0)
"""Lags of the bank, as multiples of the data sheet's [-]."""
LATENCIES = 4
"""Latencies of the bank: 0 to 3 whole periods beyond the one that is known; what lies between is
met by a shorter or longer lag."""
MEMORY = 15.0
"""Time over which errors are remembered [s]."""
LAG_STD, LATENCY_STD = 0.5, 0.7
"""How far the logarithm of the lag's factor [-] and the latency [periods] are expected from what
is known, standard deviations."""
GAINS = (0.7, 1.4)
"""Gains that are believed [-]; measurements that do not follow the commands say others."""
INDEPENDENT = 0.2
"""Share of the errors that count as independent of each other: neighbours are not."""
N_SUMS = 5
"""Sums of a regression: of model, measured, model^2, model measured, measured^2."""


@njit(cache=True)
def _advance(outputs, sums, shared, history, lags, share, measured, trust, rate, keep, Ts):
    """Drive the bank over the period that has ended and compare it with what was measured.

    Args:
        outputs: What the models do, in the servo's unit, shape (latencies, lags), changed.
        sums: Sums of the regressions, shape (latencies, lags, 5), changed.
        shared: Weight of all errors that are remembered, shape (1,), changed.
        history: What was asked for that was in force over the last periods were there no unknown
            latency, newest last.
        lags: Lags of the models [s], shape (lags,).
        share: What each lag answers within a period, 1 - exp(-Ts / lag), shape (lags,).
        measured: What the servo does now.
        trust: Weight of that, 0 to 1.
        rate: Its largest rate of change, per second.
        keep: What a period leaves of the memory [-].
        Ts: Control period [s].
    """
    shared[0] = keep * shared[0] + trust
    step = rate * Ts
    for d in range(outputs.shape[0]):
        command = history[len(history) - 1 - d]
        for n in range(outputs.shape[1]):
            move = share[n] * (command - outputs[d, n])
            model = outputs[d, n] + min(max(move, -step), step)
            outputs[d, n] = model
            s = sums[d, n]
            s[0] = keep * s[0] + trust * model
            s[1] = keep * s[1] + trust * measured
            s[2] = keep * s[2] + trust * model * model
            s[3] = keep * s[3] + trust * model * measured
            s[4] = keep * s[4] + trust * measured * measured


@njit(cache=True)
def _judge(sums, weight, prior, resolution, log_lags, priors, latency, out):
    """Lag, latency, gain and offset from the sums, in place.

    Args:
        sums: Sums of the regressions, shape (latencies, lags, 5).
        weight: Weight of all errors [-].
        prior: Precision of gain and offset before anything was seen, shape (2,).
        resolution: See `Servo`.
        log_lags: Logarithms of the lags, shape (lags,).
        priors: Logarithm of each model's prior, shape (latencies, lags).
        latency: Where it is known: latency beyond the one of the history [periods]; else -1.
        out: Receives lag [s], latency [periods], gain [-], offset, shape (4,).
    """
    n_d, n_l = sums.shape[0], sums.shape[1]
    gains, offsets, errors = np.empty((n_d, n_l)), np.empty((n_d, n_l)), np.empty((n_d, n_l))
    least = np.inf
    for d in range(n_d):
        for n in range(n_l):
            s = sums[d, n]
            # what is left without the model: e = delta - model = (gain - 1) model + offset
            e0, em, ee = s[1] - s[0], s[3] - s[2], s[4] - 2.0 * s[3] + s[2]
            a, b, c = s[2] + prior[0], s[0], weight + prior[1]
            det = a * c - b * b
            g, o = (em * c - e0 * b) / det, (a * e0 - b * em) / det
            gains[d, n], offsets[d, n] = g, o
            left = ee - 2.0 * (g * em + o * e0) + g * g * s[2] + 2.0 * g * o * s[0] + o * o * weight
            errors[d, n] = max(left, 0.0)
            least = min(least, errors[d, n])
    noise = max(least / max(weight, 1.0), resolution**2)
    best = -np.inf
    for d in range(n_d):
        for n in range(n_l):
            errors[d, n] = priors[d, n] - 0.5 * INDEPENDENT * (errors[d, n] - least) / noise
            best = max(best, errors[d, n])
    # the latency is a whole number: the likeliest; the rest is the mean over its lags
    if latency < 0:
        sure = -1.0
        for d in range(n_d):
            total = 0.0
            for n in range(n_l):
                total += math.exp(errors[d, n] - best)
            if total > sure:
                sure, latency = total, d
    else:
        best = -np.inf
        for n in range(n_l):
            best = max(best, errors[latency, n])
    total, lag, gain, offset = 0.0, 0.0, 0.0, 0.0
    for n in range(n_l):
        w = math.exp(errors[latency, n] - best)
        total += w
        lag += w * log_lags[n]
        gain += w * gains[latency, n]
        offset += w * offsets[latency, n]
    out[0], out[1] = math.exp(lag / total), float(latency)
    out[2] = min(max(1.0 + gain / total, GAINS[0]), GAINS[1])
    out[3] = offset / total


@njit(cache=True)
def _learn(outputs, sums, shared, history, lags, share, measured, trust, rate, keep, Ts,
           prior, resolution, log_lags, priors, latency, out):
    """`_advance` and `_judge` in one call, which costs its own."""
    _advance(outputs, sums, shared, history, lags, share, measured, trust, rate, keep, Ts)
    _judge(sums, shared[0], prior, resolution, log_lags, priors, latency, out)


@dataclass(frozen=True, kw_only=True)
class Servo:
    """What is known of a servo before it is driven. Its unit is rad or m/s2."""

    lag: float
    """Time constant of the data sheet [s]."""
    rate: float = math.inf
    """Largest rate of change [unit/s]."""
    gain_std: float
    """How far the gain is expected from 1, standard deviation [-]."""
    offset_std: float
    """How far the offset is expected from 0, standard deviation [unit]."""
    noise: float
    """Error of a measurement that the trust in gain and offset is measured in [unit]."""
    resolution: float
    """Error that is never held against a model [unit]: what rounding, the rate limit and what is
    not modelled leave."""


def steering_of(car: VehicleParams) -> Servo:
    """The steering; its unit is rad."""
    return Servo(lag=car.tau_delta, rate=car.delta_rate_max, gain_std=0.05, offset_std=0.02,
                 noise=1e-4, resolution=2e-5)


def drive_of(car: VehicleParams) -> Servo:
    """The drive and the brakes; their unit is m/s2.

    What the measured acceleration says of them is rough: slip, resistances and another mass are in
    it.
    """
    return Servo(lag=car.tau_ax, gain_std=0.2, offset_std=0.5, noise=0.1, resolution=0.05)


class ServoBank:
    """Learns how a servo answers, from commands and measurements."""

    def __init__(self, servo: Servo, Ts: float, delay: int = 0) -> None:
        """Args: the servo (its data sheet is the prior), control period [s], delay [periods]."""
        lags = servo.lag * np.array(LAGS)
        self._lags, self._share = lags, -np.expm1(-Ts / lags)
        self._log_lags = np.log(lags)
        self._rate, self._Ts = servo.rate, Ts
        self._keep = math.exp(-Ts / MEMORY)
        self._nominal, self._resolution = servo.lag, servo.resolution
        latency = np.arange(LATENCIES)[:, None] / LATENCY_STD
        self._priors = -0.5 * (latency**2 + (np.log(LAGS) / LAG_STD) ** 2)
        self._prior = (servo.noise / np.array([servo.gain_std, servo.offset_std])) ** 2
        self._outputs, self._sums = np.zeros(self._priors.shape), np.zeros((*self._priors.shape, 5))
        self._shared, self._out = np.zeros(1), np.zeros(4)
        self._history = np.zeros(delay + LATENCIES)
        self.reset(0.0)

    def reset(self, value: float) -> None:
        """Forget all; the servo stands at a value [unit]."""
        self._outputs[:] = value
        self._sums[:] = 0.0
        self._shared[:] = 0.0
        self._history[:] = value
        self._out[:] = self._nominal, 0.0, 1.0, 0.0

    def ask(self, value: float) -> float:
        """What to ask for, so that the servo does this [unit]; it is remembered."""
        history, step = self._history, self._rate * self._Ts
        asked = (value - float(self._out[3])) / float(self._out[2])
        # gain and offset move, the servo's rate does not
        return self.asked(min(max(asked, history[-1] - step), history[-1] + step))

    def asked(self, value: float) -> float:
        """Remember what is asked for [unit]."""
        history = self._history
        history[:-1] = history[1:]
        history[-1] = value
        return float(value)

    def update(
        self, measured: float, latency: int = -1, trust: float = 1.0
    ) -> tuple[float, float]:
        """Learn from a period.

        Args:
            measured: What the servo does at its end [unit].
            latency: Where it is known from elsewhere: that beyond the known delay [periods].
            trust: Weight of the measurement, 0 where something else than the servo decided.

        Returns:
            Lag of the servo [s], and latency beyond the known one [periods].
        """
        _learn(
            self._outputs, self._sums, self._shared, self._history[:LATENCIES], self._lags,
            self._share, measured, trust, self._rate, self._keep, self._Ts,
            self._prior, self._resolution, self._log_lags, self._priors, latency, self._out,
        )
        return float(self._out[0]), float(self._out[1])

    @property
    def lag(self) -> float:
        """Time constant of the servo [s]."""
        return float(self._out[0])

    @property
    def latency(self) -> int:
        """Latency beyond the one that is known [control periods]."""
        return int(self._out[1])

    @property
    def gain(self) -> float:
        """What the servo does per what is asked for [-]."""
        return float(self._out[2])

    @property
    def offset(self) -> float:
        """What the servo does where nothing is asked for [unit]."""
        return float(self._out[3])
