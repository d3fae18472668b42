"""Bounded least squares of a model's parameters on recordings, and how sure they are.

    minimise  sum over channels and samples of ((simulated - measured) / deviation)^2

The deviation of a channel is the standard deviation of what was measured. The differences for the
Jacobian are driven as one batch with the candidate itself. Residuals of a model that is not the
car are alike from sample to sample, so that their number says too much: the covariance is the
sandwich (J'J)^-1 J' S J (J'J)^-1 with S of Newey and West (1987), and never below the one of
white residuals.

What the wheel does between two samples is not recorded: a servo that moves at once and one that
moves late leave the same samples. So, unless `latency` is asked for, a time of up to half a sample
is identified along (`TIMING`): a car that is 3 ms late passes for one with other axles.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.identify.candidate import PARAMETERS, Candidate
from lpvmpc.identify.predict import Predictor
from lpvmpc.identify.recording import Recording
from lpvmpc.identify.scores import channels
from lpvmpc.units import Array

TIMING = "latency"
"""Parameter that is identified along, within half a sample."""
SETTLE = 0.5
"""Beginning of each segment that is not fitted [s]: it shows the first state, which is guessed."""
STEP = 1e-3
"""Step of the differences, of a parameter's scale."""
MEMORY = 1.0
"""Time over which residuals may be alike [s], in the covariance."""
CERTAIN = 1.96
"""Standard deviations of a 95 % interval."""
WIDE = 0.3
"""A 95 % interval whose half width is above this, of the parameter's scale, says little: the
parameter is not identifiable from these data."""
ALIKE = 0.98
"""Two parameters correlated beyond this cannot be told apart."""
INFLATED = 400.0
"""A variance that the other parameters inflate more than this is theirs as well."""
SPUN = 10.0
"""Residual of a car that does not follow, in standard deviations."""
EVALUATIONS = 25
"""Most evaluations of a fit."""


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """A parameter after a fit."""

    name: str
    value: float
    start: float
    low95: float
    high95: float
    deviation: float
    """Its standard deviation."""
    at_bound: bool
    """Whether it lies at the end of its domain."""
    identifiable: bool
    """False where these data say little about it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """What a fit has found."""

    candidate: Candidate
    """With the values found."""
    parameters: tuple[Fitted, ...]
    """In the order asked for."""
    correlations: Array
    """Of the estimates, shape (P, P)."""
    warnings: tuple[str, ...]
    """Sentences."""
    cost: float
    """Mean square of the residuals, in standard deviations of what was measured."""
    evaluations: int
    """How often the batch was driven."""
    timing: Fitted | None
    """Time within a sample by which the wheel is late; None where `latency` was asked for."""

    def as_json(self) -> dict[str, Any]:
        """The same as JSON has it."""
        names = [one.name for one in self.parameters]
        return {
            "parameters": {
                one.name: {
                    "value": one.value, "start": one.start, "low95": one.low95,
                    "high95": one.high95, "std": one.deviation,
                    "unit": PARAMETERS[one.name].unit, "at_bound": one.at_bound,
                    "identifiable": one.identifiable,
                }
                for one in self.parameters
            },
            "correlations": {
                a: {b: float(self.correlations[i, j]) for j, b in enumerate(names)}
                for i, a in enumerate(names)
            },
            "warnings": list(self.warnings), "cost": self.cost, "evaluations": self.evaluations,
            "timing_s": None if self.timing is None else self.timing.value,
        }


def bounds(name: str, start: float) -> tuple[float, float, float]:
    """Least and largest value and scale of a parameter that starts somewhere."""
    p = PARAMETERS[name]
    if p.added:
        return p.low, p.high, p.scale
    return p.low * start, p.high * start, p.scale * abs(start)


class _Problem:
    """Residuals and their Jacobian in scaled parameters, with the last evaluation kept."""

    def __init__(
        self, start: Candidate, names: Sequence[str], segments: Sequence[Recording],
        predict: Predictor, timing: bool,
    ) -> None:
        self.start, self.names, self.segments, self.predict = start, names, segments, predict
        ends = [bounds(name, start.value(name)) for name in names]
        if timing:
            half = 0.5 * max(one.step for one in segments)
            now = start.value(TIMING)
            ends[-1] = now - half, now + half, PARAMETERS[TIMING].scale
        self.scale = np.array([scale for _, _, scale in ends])
        self.low = np.array([low for low, _, _ in ends]) / self.scale
        self.high = np.array([high for _, high, _ in ends]) / self.scale
        self.x0 = np.array([start.value(name) for name in names]) / self.scale
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
        self.jacobian = np.empty((0, 0))
        self.samples: list[int] = []
        self.step: list[float] = []

    def candidate(self, x: Array) -> Candidate:
        values = dict(zip(self.names, (x * self.scale).tolist(), strict=True))
        return self.start.with_values(values)

    def residuals(self, x: Array) -> Array:
        """Shape (n,); drives the differences too."""
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
            self.jacobian = np.zeros_like(self.jacobian)
            return np.full(self.jacobian.shape[0], SPUN)
        self.samples = [part.shape[1] for part in parts]
        self.step = [one.step for one in self.segments for _ in self.columns]
        table = np.concatenate(parts, axis=1)
        self.jacobian = ((table[1:] - table[0]) / steps[:, None]).T
        self.known = x.copy()
        return table[0]

    def derivative(self, x: Array) -> Array:
        """Jacobian, shape (n, P)."""
        if self.known is None or not np.array_equal(x, self.known):
            self.residuals(x)
        return self.jacobian

    def covariance(self, residuals: Array) -> Array:
        """Of the scaled estimates, shape (P, P)."""
        J = self.jacobian
        bread = np.linalg.pinv(J.T @ J, rcond=1e-14)
        dof = max(len(residuals) - J.shape[1], 1)
        white = bread * float(residuals @ residuals) / dof
        meat = np.zeros_like(bread)
        first = 0
        for count, step in zip(self.samples, self.step, strict=True):
            part = slice(first, first + count)
            first += count
            moments = J[part] * residuals[part, None]
            meat += moments.T @ moments
            lags = min(round(MEMORY / step), count // 4)
            for lag in range(1, lags + 1):
                both = moments[lag:].T @ moments[:-lag]
                meat += (1.0 - lag / (lags + 1.0)) * (both + both.T)
        robust = bread @ meat @ bread * (len(residuals) / dof)
        # each parameter's larger variance, with the correlations of the robust one
        wider = np.sqrt(np.maximum(np.diag(white) / np.maximum(np.diag(robust), 1e-300), 1.0))
        return robust * np.outer(wider, wider)


def fit(
    start: Candidate, names: Sequence[str], recordings: Sequence[Recording], predict: Predictor,
    *, evaluations: int = EVALUATIONS,
) -> Fit:
    """Identify parameters from recordings.

    Args:
        start: Where to begin; what is not named keeps its value.
        names: Parameters, of `candidate.PARAMETERS`.
        recordings: What to fit on, all with the same columns.
        predict: The model.
        evaluations: Most evaluations of the batch.

    Raises:
        OptionError: Recordings with different columns.
        LPVMPCError: The car that is begun with cannot follow a recording.
    """
    segments = [one for recording in recordings for one in recording.segments()]
    timing = TIMING not in names
    asked, names = len(names), [*names, TIMING] if timing else list(names)
    problem = _Problem(start, names, segments, predict, timing)
    margin = 1e-9 * (problem.high - problem.low)
    begin = np.clip(problem.x0, problem.low + margin, problem.high - margin)
    found = least_squares(
        problem.residuals, begin, jac=problem.derivative, bounds=(problem.low, problem.high),
        x_scale=1.0, method="trf", ftol=1e-7, xtol=1e-5, gtol=1e-9, max_nfev=evaluations,
    )
    problem.derivative(found.x)
    covariance = problem.covariance(found.fun)
    deviation = np.sqrt(np.diag(covariance))
    correlations = covariance / np.maximum(np.outer(deviation, deviation), 1e-300)
    x, scale = found.x, problem.scale
    near = 1e-3 * (problem.high - problem.low)
    at_bound = (x < problem.low + near) | (x > problem.high - near)
    unseen = (problem.jacobian**2).sum(axis=0) < 1e-8 * (found.fun @ found.fun)
    wide = unseen | (CERTAIN * deviation > WIDE)
    parameters = tuple(
        Fitted(
            name=name, value=float(x[i] * scale[i]), start=start.value(name),
            low95=float((x[i] - CERTAIN * deviation[i]) * scale[i]),
            high95=float((x[i] + CERTAIN * deviation[i]) * scale[i]),
            deviation=float(deviation[i] * scale[i]), at_bound=bool(at_bound[i]),
            identifiable=not bool(wide[i]),
        )
        for i, name in enumerate(names)
    )
    along = parameters[-1] if timing else None
    parameters, correlations = parameters[:asked], correlations[:asked, :asked]
    return Fit(
        candidate=problem.candidate(x), parameters=parameters, correlations=correlations,
        timing=along,
        warnings=tuple(_warnings(parameters, correlations, problem.columns, found.nfev,
                                 evaluations)),
        cost=float(found.fun @ found.fun) / len(found.fun), evaluations=problem.evaluations,
    )


def _inflation(correlations: Array) -> Array:
    """Variance of each estimate over what it were if the others were known, shape (P,)."""
    try:
        return np.diag(np.linalg.inv(correlations)).copy()
    except np.linalg.LinAlgError:
        return np.full(len(correlations), np.inf)


def _warnings(
    parameters: Sequence[Fitted], correlations: Array, columns: Sequence[str], used: int, most: int
) -> list[str]:
    """What a reader should not overlook."""
    told = []
    known = ", ".join(columns)
    for one in parameters:
        unit = PARAMETERS[one.name].unit
        half = one.high95 - one.value
        if not one.identifiable:
            told.append(
                f"{one.name} is not identifiable from these data ({known}): "
                f"{one.value:.6g} +- {half:.2g} {unit}."
            )
        if one.at_bound:
            told.append(f"{one.name} lies at the end of its domain, {one.value:.6g} {unit}.")
    inflation = _inflation(correlations)
    for i, one in enumerate(parameters):
        others = [p.name for k, p in enumerate(parameters) if k != i]
        pair = len(parameters) == 2 or np.abs(np.delete(correlations[i], i)).max() > ALIKE
        if inflation[i] > INFLATED and not pair and one.identifiable:
            told.append(
                f"{one.name} can hardly be told apart from {', '.join(others)} together from "
                f"these data ({known}): they inflate its variance {inflation[i]:.0f} times."
            )
        for j in range(i):
            if abs(correlations[i, j]) > ALIKE:
                told.append(
                    f"{parameters[j].name} and {one.name} cannot be told apart from these data "
                    f"({known}): their correlation is {correlations[i, j]:.3f}."
                )
    if used >= most:
        told.append(f"The fit was stopped after {most} evaluations, before it was done.")
    if not all(math.isfinite(one.value) for one in parameters):
        told.append("The fit has found no numbers.")
    return told
