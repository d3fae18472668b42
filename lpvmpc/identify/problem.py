"""The least squares of a fit: residuals, their derivatives, and how sure the estimates are.

The differences for the Jacobian are driven as one batch with the candidate itself. Residuals of a
model that is not the car are alike from sample to sample, so that their number says too much: the
covariance is the sandwich (J'J)^-1 J' S J (J'J)^-1 with S of Newey and West (1987), and never below
the one of white residuals. Such an S comes from the residuals themselves and is uncertain too, the
more so the shorter the recording: the 95 % intervals are as many standard deviations wide as Kiefer
and Vogelsang (2005, table 1) give for it.

Each parameter is pulled weakly to where it began, as if that were known to `Parameter.spread`. The
pull is weighed by the level of the residuals (`Problem.level`): where a recording says something,
it vanishes; where it says nothing, the parameter stays where it was.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.identify.candidate import PARAMETERS, Candidate
from lpvmpc.identify.predict import Predictor
from lpvmpc.identify.recording import Recording
from lpvmpc.identify.scores import channels
from lpvmpc.units import Array

SETTLE = 0.5
"""Beginning of each segment that is not fitted [s]: it shows the first state, which is guessed."""
STEP = 1e-3
"""Step of the differences, of a parameter's scale."""
MEMORY = 1.0
"""Time over which residuals may be alike [s], in the covariance."""
CRITICAL = (1.9600, 2.9694, 0.4160, -0.5324)
"""Standard deviations of a 95 % interval by the share b of a recording over which residuals may be
alike: a cubic in b, for the weights of Newey and West (Kiefer and Vogelsang 2005, table 1)."""
SPUN = 10.0
"""Residual of a car that does not follow, in standard deviations."""


def bounds(name: str, start: float) -> tuple[float, float, float]:
    """Least and largest value and scale of a parameter that starts somewhere."""
    p = PARAMETERS[name]
    if p.added:
        return p.low, p.high, p.scale
    return p.low * start, p.high * start, p.scale * abs(start)


class Problem:
    """Residuals and their Jacobian in scaled parameters, with the last evaluation kept.

    The pull to the start stands in the last rows: `pull` (x - x0) / spread for each parameter.
    """

    def __init__(
        self, start: Candidate, names: Sequence[str], segments: Sequence[Recording],
        predict: Predictor, pull: float,
    ) -> None:
        self.start, self.names, self.segments, self.predict = start, names, segments, predict
        self.pull = pull
        ends = [bounds(name, start.value(name)) for name in names]
        self.scale = np.array([scale for _, _, scale in ends])
        self.low = np.array([low for low, _, _ in ends]) / self.scale
        self.high = np.array([high for _, high, _ in ends]) / self.scale
        self.x0 = np.array([start.value(name) for name in names]) / self.scale
        self.spread = np.array([PARAMETERS[name].spread for name in names])
        self.fitted = [one.t >= one.t[0] + SETTLE for one in segments]
        self.measured = [list(channels(one).values()) for one in segments]
        self.columns = list(channels(segments[0]))
        if any(list(channels(one)) != self.columns for one in segments):
            raise OptionError(
                "--fit-on", ", ".join(sorted({one.name for one in segments})),
                "recordings with the same columns"
            )
        self.deviations = [
            max(float(np.concatenate(
                [channels(one)[name][use]
                 for one, use in zip(segments, self.fitted, strict=True)]).std()), 1e-6)
            for name in self.columns
        ]
        self.evaluations = 0
        self.known: Array | None = None
        self.errors = np.empty(0)
        self.jacobian = np.empty((0, 0))
        self.stopped = False
        self.samples: list[int] = []
        self.times: list[float] = []

    def candidate(self, x: Array) -> Candidate:
        """The candidate of scaled parameters, shape (P,)."""
        values = dict(zip(self.names, (x * self.scale).tolist(), strict=True))
        return self.start.with_values(values)

    def descend(self, begin: Array, evaluations: int) -> Array:
        """Scaled parameters of the least squares within the bounds, shape (P,)."""
        margin = 1e-9 * (self.high - self.low)
        first = np.clip(begin, self.low + margin, self.high - margin)
        found = least_squares(
            lambda x: np.append(self.at(x), self.pull * (x - self.x0) / self.spread), first,
            jac=lambda x: np.vstack([self.derivative(x), np.diag(self.pull / self.spread)]),
            bounds=(self.low, self.high), x_scale=1.0, method="trf", ftol=1e-6, xtol=1e-5,
            gtol=1e-9, max_nfev=evaluations,
        )
        self.at(found.x)
        self.stopped = found.nfev >= evaluations
        return np.asarray(found.x)

    def at(self, x: Array) -> Array:
        """Residuals against what was measured, shape (n,); drives the differences too."""
        if self.known is not None and np.array_equal(x, self.known):
            return self.errors
        steps = np.where(x + STEP <= self.high, STEP, -STEP)
        tries = [x, *(x + h * np.eye(len(x))[i] for i, h in enumerate(steps))]
        self.evaluations += 1
        parts: list[Array] = []  # (1 + P, n of a segment and channel)
        try:
            candidates = [self.candidate(one) for one in tries]
            for segment, use in zip(self.segments, self.fitted, strict=True):
                driven = self.predict(candidates, segment)
                for name, deviation in zip(self.columns, self.deviations, strict=True):
                    errors = [
                        (one[name] - channels(segment)[name])[use] / deviation for one in driven
                    ]
                    parts.append(np.stack(errors))
        except LPVMPCError:  # such a car does not drive there
            if self.known is None:
                raise
            return np.full(len(self.errors), SPUN)  # which is not gone to
        self.samples = [part.shape[1] for part in parts]
        self.times = [one.step for one in self.segments for _ in self.columns]
        table = np.concatenate(parts, axis=1)
        self.jacobian = ((table[1:] - table[0]) / steps[:, None]).T
        self.errors = table[0]
        self.known = x.copy()
        return self.errors

    def derivative(self, x: Array) -> Array:
        """Derivatives of the residuals, shape (n, P)."""
        self.at(x)
        return self.jacobian

    def step(self, x: Array) -> Array:
        """The step of Gauss and Newton from x, bounds apart, shape (P,)."""
        errors, J = self.at(x), self.derivative(x)
        weight = (self.pull / self.spread) ** 2
        push = J.T @ errors + weight * (x - self.x0)
        return -np.linalg.solve(J.T @ J + np.diag(weight), push)

    def asks(self, x: Array) -> float:
        """That step in standard deviations of the estimates, the largest; 0 beyond the bounds."""
        step = self.step(x)
        inside = (x + step > self.low) & (x + step < self.high)
        return float(np.max(np.abs(step) / np.sqrt(np.diag(self.covariance())) * inside))

    def level(self) -> float:
        """Standard deviation that independent samples had, were they as many as the residuals.

        The variance of the mean of residuals that are alike is that of independent ones of this
        level: the mean square, times 1 + 2 sum of their correlations over `MEMORY`.
        """
        total, first = 0.0, 0
        for count, step in zip(self.samples, self.times, strict=True):
            part = self.errors[first : first + count]
            first += count
            power = float(part @ part)
            lags = self.lags(count, step)
            alike = sum(
                (1.0 - lag / (lags + 1.0)) * float(part[lag:] @ part[:-lag])
                for lag in range(1, lags + 1)
            )
            total += max(power + 2.0 * alike, power)
        return float(np.sqrt(total / first))

    def lags(self, count: int, step: float) -> int:
        """Number of samples over which the residuals of a channel may be alike."""
        return min(round(MEMORY / step), count // 4)

    def certain(self) -> float:
        """Half the width of a 95 % interval, in standard deviations of `covariance` [-]."""
        alike = sum(map(self.lags, self.samples, self.times))
        share = alike / max(sum(self.samples), 1)
        return float(np.polynomial.Polynomial(CRITICAL)(share))

    def covariance(self) -> Array:
        """Of the scaled estimates by these data alone, without the pull, shape (P, P)."""
        J, residuals = self.jacobian, self.errors
        bread = np.linalg.pinv(J.T @ J, rcond=1e-14)
        dof = max(len(residuals) - J.shape[1], 1)
        white = bread * float(residuals @ residuals) / dof
        meat = np.zeros_like(bread)
        first = 0
        for count, step in zip(self.samples, self.times, strict=True):
            part = slice(first, first + count)
            first += count
            moments = J[part] * residuals[part, None]
            meat += moments.T @ moments
            lags = self.lags(count, step)
            for lag in range(1, lags + 1):
                both = moments[lag:].T @ moments[:-lag]
                meat += (1.0 - lag / (lags + 1.0)) * (both + both.T)
        robust = bread @ meat @ bread * (len(residuals) / dof)
        # each parameter's larger variance, with the correlations of the robust one
        wider = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(robust), 1e-300), 1.0))
        return robust * np.outer(wider, wider)
