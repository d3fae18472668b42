"""Numbers of many runs in which the worst may be infinite: percentiles, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence


def wilson(successes: int, n: int, z: float = 1.959964) -> tuple[float, float]:
    """Confidence interval of a proportion, 95 % for the default z.

    (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    Args:
        successes: How many of the runs succeeded.
        n: Number of runs, at least one.
        z: Quantile of the normal distribution.

    Source: E. B. Wilson, Probable inference, the law of succession, and statistical inference,
        JASA 22 (1927). Holds for independent runs, also where none or all succeed.
    """
    assert 0 <= successes <= n and n > 0, (successes, n)
    p, zz = successes / n, z * z
    middle = p + zz / (2 * n)
    half = z * math.sqrt(p * (1.0 - p) / n + zz / (4 * n * n))
    low, high = (middle - half) / (1 + zz / n), (middle + half) / (1 + zz / n)
    return (0.0 if successes == 0 else low), (1.0 if successes == n else high)


def percentile(values: Iterable[float], share: float) -> float:
    """The smallest value that this share of all do not exceed: one of them, never between two.

    So a lost run, which is infinite here, is counted as the worst there is and does not blur
    what the others did.
    """
    ordered = sorted(values)
    return ordered[max(math.ceil(share * len(ordered) - 1e-9), 1) - 1]


def median(values: Iterable[float]) -> float:
    """The middle value, the upper one of two."""
    ordered = sorted(values)
    return ordered[len(ordered) // 2]


def percentile_interval(
    values: Sequence[float], share: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Confidence interval of a percentile, from the values in their order; ends may be infinite.

    The number of values below the true percentile is binomial (n, share); the interval goes from
    the value that has at most (1 - confidence) / 2 of that distribution below it to the one with as
    much above. With few values an end lies beyond all of them: the smallest value, or infinity.

    Args:
        values: What was measured, at least one, independent of each other.
        share: Which percentile, from 0 to 1.
        confidence: How often the interval holds the true value, at least.

    Source: H. A. David and H. N. Nagaraja, Order Statistics, section 7.1. No distribution of the
        values is assumed.
    """
    n, tail = len(values), 0.5 * (1.0 - confidence)
    ordered = sorted(values)
    assert n > 0 and 0.0 < share < 1.0, (n, share)
    low = high = 0
    total = 0.0
    for k in range(n + 1):  # logarithms: the coefficients are beyond all floats
        ways = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
        total += math.exp(ways + k * math.log(share) + (n - k) * math.log1p(-share))
        if total <= tail:
            low = k + 1
        if total < 1.0 - tail:
            high = k + 1
    return ordered[max(low - 1, 0)], ordered[high] if high < n else math.inf
