"""The single tracks of the textbooks, driven by a recording as the plant is.

Linear:      Fy = C alpha, small angles.
Nonlinear:   Fy = mu Fz tanh(C alpha / (mu Fz)) at the static axle load, true angles.

Both have no roll, no load transfer, no relaxation, no trail; their speed is the recorded one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from lpvmpc.identify.follow import Steering
from lpvmpc.identify.recording import Recording
from lpvmpc.units import GRAVITY, Array

KINDS = ("linear", "nonlinear")
"""Their names."""
STEP = 0.001
"""Step of integration [s], Runge-Kutta of fourth order; the wheel's angle moves as the plant's."""


class SingleTrack(NamedTuple):
    """Constants of a single track."""

    m: float
    """Mass [kg]."""
    Iz: float
    """Yaw inertia [kg m2]."""
    lf: float
    """Centre of mass to front axle [m]."""
    lr: float
    """Centre of mass to rear axle [m]."""
    Cf: float
    """Front axle cornering stiffness [N/rad]."""
    Cr: float
    """Rear axle cornering stiffness [N/rad]."""
    mu_f: float
    """Friction in front [-]."""
    mu_r: float
    """Friction at the rear [-]."""


@njit(cache=True)
def _rates(vy, r, delta, vx, p, linear):
    """Rates vy' = (Fyf cos(delta) + Fyr) / m - r vx, r' = (lf Fyf cos(delta) - lr Fyr) / Iz."""
    m, Iz, lf, lr, Cf, Cr, mu_f, mu_r = p
    if linear:
        alpha_f, alpha_r = delta - (vy + lf * r) / vx, -(vy - lr * r) / vx
        front, rear = Cf * alpha_f, Cr * alpha_r
    else:
        alpha_f, alpha_r = delta - math.atan2(vy + lf * r, vx), -math.atan2(vy - lr * r, vx)
        top_f = mu_f * m * GRAVITY * lr / (lf + lr)
        top_r = mu_r * m * GRAVITY * lf / (lf + lr)
        front = top_f * math.tanh(Cf * alpha_f / top_f) * math.cos(delta)
        rear = top_r * math.tanh(Cr * alpha_r / top_r)
    return (front + rear) / m - r * vx, (lf * front - lr * rear) / Iz


@njit(cache=True)
def _drive(t, delta, vx, vy0, r0, free, p, linear, out):
    """Integrate over the times t with delta, vx at them, linear between; out gets vy, r, ay."""
    vy, r = vy0, r0
    if free:  # vy was not measured: the one at which the axles carry r vx at this yaw rate
        for _ in range(2000):
            d, _ = _rates(vy, r, delta[0], vx[0], p, linear)
            vy += STEP * d
    for k in range(len(t)):
        d, _ = _rates(vy, r, delta[k], vx[k], p, linear)
        out[k, 0], out[k, 1], out[k, 2] = vy, r, d + r * vx[k]
        if k + 1 == len(t):
            break
        h = t[k + 1] - t[k]
        d1, v1 = 0.5 * (delta[k] + delta[k + 1]), 0.5 * (vx[k] + vx[k + 1])
        a0, b0 = _rates(vy, r, delta[k], vx[k], p, linear)
        a1, b1 = _rates(vy + 0.5 * h * a0, r + 0.5 * h * b0, d1, v1, p, linear)
        a2, b2 = _rates(vy + 0.5 * h * a1, r + 0.5 * h * b1, d1, v1, p, linear)
        a3, b3 = _rates(vy + h * a2, r + h * b2, delta[k + 1], vx[k + 1], p, linear)
        vy += h / 6.0 * (a0 + 2.0 * a1 + 2.0 * a2 + a3)
        r += h / 6.0 * (b0 + 2.0 * b1 + 2.0 * b2 + b3)


def drive(
    p: SingleTrack, recording: Recording, steering: Steering, kind: str
) -> dict[str, Array]:
    """Drive a single track by one segment of a recording.

    Args:
        p: Its constants.
        recording: The segment.
        steering: Between recorded angle and road wheel.
        kind: One of `KINDS`.

    Returns:
        vy [m/s], r [rad/s], ay [m/s2] and x, y [m], psi [rad] from the start, shapes (n,).
    """
    fine = np.arange(recording.t[0], recording.t[-1] + STEP, STEP)
    vx = recording.speed(fine)[0]
    free = recording.vy is None
    vy0 = 0.0 if recording.vy is None else recording.first(recording.vy)
    out = np.empty((len(fine), 3))
    _drive(
        fine, steering.angle(recording, fine), vx, vy0, recording.first(recording.r), free,
        tuple(p), kind == "linear", out,
    )
    vy, r, ay = out.T

    def integral(rate: Array) -> Array:
        return np.concatenate([[0.0], np.cumsum(0.5 * STEP * (rate[1:] + rate[:-1]))])

    psi = integral(r)
    x = integral(vx * np.cos(psi) - vy * np.sin(psi))
    y = integral(vx * np.sin(psi) + vy * np.cos(psi))
    found = {"vy": vy, "r": r, "ay": ay, "x": x, "y": y, "psi": psi}
    return {name: np.interp(recording.t, fine, values) for name, values in found.items()}
