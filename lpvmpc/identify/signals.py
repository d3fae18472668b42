"""Signals of a recording: noise, smoothing, and what a signal does between two samples."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import UnivariateSpline

from lpvmpc.units import Array

ORDER = 6
"""Differences of this order see the noise of a signal, and hardly the signal."""
FEW = 10
"""Changes of a held signal from which on a period is looked for."""


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


def changes(t: Array, values: Array) -> Array:
    """When a held signal has changed, as far as its samples tell, before each sample [s].

    A change that a sample shows first happened between it and the one before. Where one regular
    period puts every change there, as that of a controller that is sampled at another rate, its
    times are taken; otherwise the middle.

    Args:
        t: Times of the samples [s], ascending, shape (n,).
        values: The samples, shape (n,).

    Returns:
        Times between each sample and the one before, shape (n - 1,).
    """
    found = 0.5 * (t[1:] + t[:-1])
    seen = np.flatnonzero(np.diff(values) != 0.0)
    if len(seen) < FEW:
        return found
    late, usual = found[seen], float(np.median(np.diff(t[seen + 1])))
    gaps = np.diff(late)
    period = float(gaps[gaps < 1.5 * usual].mean())
    number = np.concatenate([[0.0], np.cumsum(np.round(gaps / period))])
    slope, first = np.polyfit(number, late, 1)
    regular = first + slope * number
    if (np.abs(regular - late) <= 0.6 * np.diff(t)[seen]).all():
        found[seen] = np.clip(regular, t[seen], t[seen + 1])
    return found
