"""Disturbance observer: what the model did not predict, as an acceleration."""

from __future__ import annotations

import numpy as np
from numba import njit

from lpvmpc.bicycle import NX


@njit(cache=True)
def predict(Ad, G, B, c, x, u, disturbance, x_out):
    """One-step prediction x+ = Ad x + G (B u + c + E d), in place.

    The disturbance d acts on (vx, vy, r) and enters before discretisation, as a force does: added
    to the next state instead, it would not move ey and epsi within the period and leave an offset.

    Args:
        Ad: Transition matrix, shape (9, 9).
        G: Integral of the transition matrix over the period, shape (9, 9).
        B: Continuous input matrix, shape (9, 2).
        c: Constant term, shape (9,).
        x: State, shape (9,).
        u: Command, shape (2,).
        disturbance: Accelerations of (vx, vy, r), shape (3,).
        x_out: Receives the predicted state, shape (9,).
    """
    rate = B @ u + c
    rate[:3] += disturbance
    for i in range(NX):
        x_out[i] = 0.0
        for j in range(NX):
            x_out[i] += Ad[i, j] * x[j] + G[i, j] * rate[j]


@njit(cache=True)
def update(disturbance, predicted, measured, gain, limit, Ts):
    """Move the disturbance towards what explains the prediction error of (vx, vy, r), in place.

    d += gain (measured - predicted) / Ts, clipped to +-limit

    With a perfect model and a constant disturbance the estimate converges geometrically with
    factor about 1 - gain; without steady-state error, since the update stops only when the
    prediction is right.

    Args:
        disturbance: Estimate (3,) [m/s2, m/s2, rad/s2], changed in place.
        predicted: What the model expected for now, shape (9,).
        measured: What was measured, shape (9,).
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
