"""Disturbance observer: what the model did not predict, as an acceleration.

The disturbance acts on (vx, vy, r) and enters the continuous model, before discretisation, as a
force does: added to the next state instead, it would not move ey and epsi within the period and
leave an offset.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def update(disturbance, predicted, measured, gain, limit, Ts):
    """Move the disturbance towards what explains the prediction error of (vx, vy, r), in place.

    d += gain (measured - predicted) / Ts, clipped to +-limit

    With a perfect model and a constant disturbance the estimate converges geometrically with
    factor about 1 - gain; without steady-state error, since the update stops only when the
    prediction is right.

    Args:
        disturbance: Estimate (3,) [m/s2, m/s2, rad/s2], changed in place.
        predicted: What the model expected for now, shape (11,).
        measured: What was measured, shape (11,).
        gain: Observer gain in (0, 1], per component, shape (3,).
        limit: Largest believable disturbance per component, shape (3,).
        Ts: Control period [s].

    Source: integral-action observers as in Pannocchia and Rawlings, Disturbance models for
    offset-free model-predictive control, AIChE Journal 49 (2003).
    """
    for i in range(3):
        value = disturbance[i] + gain[i] * (measured[i] - predicted[i]) / Ts
        disturbance[i] = min(max(value, -limit[i]), limit[i])


LIMIT = np.array([10.0, 10.0, 10.0])
"""Largest believable disturbance [m/s2, m/s2, rad/s2]: more than one g of misprediction."""
