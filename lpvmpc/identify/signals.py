"""Signals of a recording: noise, smoothing, and what a signal does between two samples."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import UnivariateSpline

from lpvmpc.units import Array

ORDER = 6
"""Differences of this order see the noise of a signal, and hardly the signal."""


def noise(values: Array) -> float:
    """Standard deviation of white noise on a signal of shape (n,), by its differences.

    Differences of order k multiply the variance of white noise by the binomial (2k over k). Their
    median is taken, so that a few jumps of the signal are no noise.
    """
    if len(values) <= ORDER:
        return 0.0
    middle = float(np.median(np.abs(np.diff(values, ORDER)))) / 0.6745
    return middle / math.sqrt(math.comb(2 * ORDER, ORDER))


def spline(t: Array, values: Array) -> UnivariateSpline:
    """A cubic spline of a signal over ascending times, smoothed as far as its noise asks for."""
    return UnivariateSpline(t, values, s=len(t) * max(noise(values), 1e-6) ** 2)


def between(t: Array, values: Array, times: Array, servo: float = 0.0) -> Array:
    """A signal at times between its samples; constant outside.

    Args:
        t: Times of the samples [s], ascending, shape (n,).
        values: The samples, shape (n,).
        times: Where it is asked for [s], shape (k,).
        servo: Time constant [s] of a first-order lag that goes towards a command held from sample
            to sample, and passes through the samples; 0: straight lines.

    Returns:
        Its values, shape (k,).
    """
    if servo <= 0.0:
        return np.interp(times, t, values)
    k = np.clip(np.searchsorted(t, times, "right") - 1, 0, len(t) - 2)
    long = t[k + 1] - t[k]
    share = np.clip((times - t[k]) / long, 0.0, 1.0)
    share = np.expm1(-share * long / servo) / np.expm1(-long / servo)
    return values[k] + share * (values[k + 1] - values[k])
