"""How the steering really answers: its lag, latency, gain and offset, learned online.

The angle that the wheels have is measured, the angle that was asked for is known. A bank of models
of the servo, each with another lag and another whole number of periods of latency, is driven with
the commands; each is compared with the measured angle by a regression

    delta = gain delta_model + offset + error,

so that a misaligned wheel and a wrong ratio are found too. The answer is the mean over the bank,
weighted by the likelihood of the errors and a prior that believes the data sheet. Every model is
driven by the commands alone, never by the measurement, so that noise does not bias it.
"""

from __future__ import annotations

import math

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
GAIN_STD, OFFSET_STD = 0.05, 0.02
"""How far the gain [-] and the offset [rad] are expected from 1 and 0, standard deviations."""
LAG_STD, LATENCY_STD = 0.5, 0.7
"""The same for the logarithm of the lag's factor and for the latency [periods]."""
RESOLUTION = 2e-5
"""Error that is never held against a model [rad]: what rounding and the rate limit leave."""
INDEPENDENT = 0.2
"""Share of the errors that count as independent of each other: neighbours are not."""
N_SUMS = 5
"""Sums of a regression: of model, angle, model^2, model angle, angle^2."""


@njit(cache=True)
def _advance(angles, sums, shared, history, lags, share, measured, rate, keep, Ts):
    """Drive the bank over the period that has ended and compare it with the measured angle.

    Args:
        angles: Angles of the models [rad], shape (latencies, lags), changed.
        sums: Sums of the regressions, shape (latencies, lags, 5), changed.
        shared: Weight of all errors that are remembered, shape (1,), changed.
        history: Angles asked for that were in force over the last periods were there no unknown
            latency, newest last [rad].
        lags: Lags of the models [s], shape (lags,).
        share: What each lag answers within a period, 1 - exp(-Ts / lag), shape (lags,).
        measured: Angle now [rad].
        rate: Largest rate of the servo [rad/s].
        keep: What a period leaves of the memory [-].
        Ts: Control period [s].
    """
    shared[0] = keep * shared[0] + 1.0
    step = rate * Ts
    for d in range(angles.shape[0]):
        command = history[len(history) - 1 - d]
        for n in range(angles.shape[1]):
            move = share[n] * (command - angles[d, n])
            model = angles[d, n] + min(max(move, -step), step)
            angles[d, n] = model
            s = sums[d, n]
            s[0] = keep * s[0] + model
            s[1] = keep * s[1] + measured
            s[2] = keep * s[2] + model * model
            s[3] = keep * s[3] + model * measured
            s[4] = keep * s[4] + measured * measured


@njit(cache=True)
def _judge(sums, weight, prior, log_lags, priors, out):
    """Lag, latency, gain and offset from the sums, in place.

    Args:
        sums: Sums of the regressions, shape (latencies, lags, 5).
        weight: Weight of all errors [-].
        prior: Precision of gain and offset before anything was seen [1, 1/rad2], shape (2,).
        log_lags: Logarithms of the lags, shape (lags,).
        priors: Logarithm of each model's prior, shape (latencies, lags).
        out: Receives lag [s], latency [periods], gain [-], offset [rad], shape (4,).
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
    noise = max(least / max(weight, 1.0), RESOLUTION**2)
    best = -np.inf
    for d in range(n_d):
        for n in range(n_l):
            errors[d, n] = priors[d, n] - 0.5 * INDEPENDENT * (errors[d, n] - least) / noise
            best = max(best, errors[d, n])
    # the latency is a whole number: the likeliest; the rest is the mean over its lags
    sure, latency = -1.0, 0
    for d in range(n_d):
        total = 0.0
        for n in range(n_l):
            total += math.exp(errors[d, n] - best)
        if total > sure:
            sure, latency = total, d
    total, lag, gain, offset = 0.0, 0.0, 0.0, 0.0
    for n in range(n_l):
        w = math.exp(errors[latency, n] - best)
        total += w
        lag += w * log_lags[n]
        gain += w * gains[latency, n]
        offset += w * offsets[latency, n]
    out[0], out[1] = math.exp(lag / total), float(latency)
    out[2], out[3] = 1.0 + gain / total, offset / total


class SteeringBank:
    """Learns how the steering answers, from commands and measured angles."""

    def __init__(self, car: VehicleParams, Ts: float, delay: int = 0) -> None:
        """Args: the car (its data sheet is the prior), control period [s], delay [periods]."""
        lags = car.tau_delta * np.array(LAGS)
        self._lags, self._share = lags, -np.expm1(-Ts / lags)
        self._log_lags = np.log(lags)
        self._rate, self._Ts = car.delta_rate_max, Ts
        self._keep = math.exp(-Ts / MEMORY)
        self._nominal = car.tau_delta
        latency = np.arange(LATENCIES)[:, None] / LATENCY_STD
        self._priors = -0.5 * (latency**2 + (np.log(LAGS) / LAG_STD) ** 2)
        noise = 1e-4  # an angle's error of 0.6 degrees: what the prior's trust is measured in
        self._prior = np.array([(noise / GAIN_STD) ** 2, (noise / OFFSET_STD) ** 2])
        self._angles, self._sums = np.zeros(self._priors.shape), np.zeros((*self._priors.shape, 5))
        self._shared, self._out = np.zeros(1), np.zeros(4)
        self._history = np.zeros(delay + LATENCIES)
        self.reset(0.0)

    def reset(self, delta: float) -> None:
        """Forget all; the wheels stand at an angle [rad]."""
        self._angles[:] = delta
        self._sums[:] = 0.0
        self._shared[:] = 0.0
        self._history[:] = delta
        self._out[:] = self._nominal, 0.0, 1.0, 0.0

    def ask(self, delta: float) -> float:
        """The angle to ask for, so that the wheels have this one [rad]; it is remembered."""
        history, step = self._history, self._rate * self._Ts
        asked = (delta - float(self._out[3])) / float(self._out[2])
        # gain and offset move, the servo's rate does not
        asked = min(max(asked, history[-1] - step), history[-1] + step)
        history[:-1] = history[1:]
        history[-1] = asked
        return float(asked)

    def update(self, measured: float) -> tuple[float, float]:
        """Learn from a period.

        Args:
            measured: Angle of the wheels at its end [rad].

        Returns:
            Lag of the servo [s], and latency beyond the known one [periods].
        """
        _advance(
            self._angles, self._sums, self._shared, self._history[:LATENCIES], self._lags,
            self._share, measured, self._rate, self._keep, self._Ts,
        )
        _judge(self._sums, self._shared[0], self._prior, self._log_lags, self._priors, self._out)
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
        """Angle of the wheels per angle asked for [-]."""
        return float(self._out[2])

    @property
    def offset(self) -> float:
        """Angle of the wheels where none is asked for [rad]."""
        return float(self._out[3])
