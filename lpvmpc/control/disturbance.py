"""Disturbance observer: what the model did not predict, as an acceleration.

The disturbance acts on (vx, vy, r) and enters the continuous model, before discretisation, as a
force does: added to the next state instead, it would not move ey and epsi within the period and
leave an offset.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def update(disturbance, predicted, measured, gain, limit, walk, noise, last, Ts):
    """Move the disturbance towards what explains the prediction error of (vx, vy, r), in place.

    d += k (measured - predicted) / Ts, clipped to +-limit

    k is the steady gain of a Kalman filter for a disturbance that walks by `walk` sqrt(t), at most
    `gain`. The noise of the measurements is half the mean square of the differences of successive
    errors: what a disturbance makes is alike from one period to the next, what noise makes is not.

    With a perfect model and a constant disturbance the estimate converges geometrically with
    factor about 1 - k; without steady-state error, since the update stops only when the
    prediction is right.

    Args:
        disturbance: Estimate (3,) [m/s2, m/s2, rad/s2], changed in place.
        predicted: What the model expected for now, shape (11,).
        measured: What was measured, shape (11,).
        gain: Observer gain in (0, 1], per component, shape (3,).
        limit: Largest believable disturbance per component, shape (3,).
        walk: How far the disturbance moves within a second, infinite for k = gain, shape (3,).
        noise: Variance of the errors' noise (3,) [units of the disturbance, squared], changed.
        last: Error of the period before (3,), changed.
        Ts: Control period [s].

    Source: integral-action observers as in Pannocchia and Rawlings, Disturbance models for
    offset-free model-predictive control, AIChE Journal 49 (2003).
    """
    for i in range(3):
        error = (measured[i] - predicted[i]) / Ts
        k = gain[i]
        if walk[i] < np.inf:
            jump = error - last[i]
            last[i] = error
            noise[i] += (0.5 * jump * jump - noise[i]) * Ts / NOISE_MEMORY
            ratio = walk[i] ** 2 * Ts / max(noise[i], 1e-12)
            k = min(k, 0.5 * (np.sqrt(ratio * ratio + 4.0 * ratio) - ratio))
        value = disturbance[i] + k * (measured[i] - predicted[i]) / Ts
        disturbance[i] = min(max(value, -limit[i]), limit[i])


@njit(cache=True)
def quiet(predicted, measured, noise, last, Ts):
    """How free of noise the measurements are, from 0 to 1.

    Beside the noise that `update` sees, that of ey and epsi counts. docs/derivations.md, D13, has
    what the share is in which world.

    Args:
        predicted: What the model expected for now, shape (11,).
        measured: What was measured, shape (11,).
        noise: Variance of the noise of (vx, vy, r, ey, epsi), as rates, shape (5,); the last two
            are changed.
        last: Error of the period before (5,); the last two are changed.
        Ts: Control period [s].
    """
    loud = 0.0
    for i in range(1, 5):
        if i > 2:
            error = (measured[i] - predicted[i]) / Ts
            jump = error - last[i]
            last[i] = error
            noise[i] += (0.5 * jump * jump - noise[i]) * Ts / NOISE_MEMORY
        loud += noise[i] / LOUD[i] ** 2
    return 1.0 / (1.0 + loud * loud)


LOUD = np.array([np.inf, 0.05, 0.02, 0.03, 0.01])
"""Noise at which the measurements count as half quiet: vx does not count, vy [m/s2], r [rad/s2],
ey [m/s] (white noise of 1 mm), epsi [rad/s] (of 0.02 degrees)."""
NOISE_MEMORY = 2.0
"""Time over which the noise is averaged [s]."""
LIMIT = np.array([10.0, 10.0, 10.0])
"""Largest believable disturbance [m/s2, m/s2, rad/s2]: more than one g of misprediction."""
