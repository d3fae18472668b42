"""Bounded least squares of a model's parameters on recordings, and how sure they are.

    minimise  sum over channels and samples of ((simulated - measured) / deviation)^2
              + pull^2 sum over parameters of ((value - start) / spread)^2

The deviation of a channel is the standard deviation of what was measured; `problem` has the rest.

What the wheel does between two samples is not recorded, and a wheel that is 3 ms late passes for a
car with other axles. It is not fitted, which would take from the axles what noise gives it, but
chosen: straight lines, or the response of the car's own servo to a command held for a sample,
whichever explains the recordings better (`ways`). Whether the recordings ask for another time is
said (`OFF`); the parameter `latency` is there to fit it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpvmpc.identify.candidate import PARAMETERS, Candidate
from lpvmpc.identify.follow import Steering
from lpvmpc.identify.predict import Predictor
from lpvmpc.identify.problem import CRITICAL, Problem
from lpvmpc.identify.recording import Recording
from lpvmpc.units import Array

LATENCY = "latency"
"""Parameter whose absence is checked."""
OFF = 0.002
"""A time [s] that the recordings ask for, beyond which it is said, if it is significant."""
SAME = 1e-4
"""Two ways of the wheel whose mean times differ by less [s] are one."""
PULL = 0.02
"""Level of the residuals that a fit begins with, of a channel's deviation: two per cent."""
NEAR = 0.7
"""Share of the lateral limit from which on a recording shows friction."""
MOVED = 0.1
"""A change below this, of a standard deviation, is none."""
WIDE = 0.3
"""A 95 % interval whose half width is above this, of the parameter's scale or its value if that is
larger, says little: the parameter is not identifiable from these data."""
ALIKE = 0.98
"""Two parameters correlated beyond this cannot be told apart."""
INFLATED = 400.0
"""A variance that the other parameters inflate more than this is theirs as well."""
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
    wheel: str
    """What the wheel does between samples, as was chosen."""

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
            "wheel": self.wheel,
        }


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
        evaluations: Most evaluations of the batch in each descent.

    Raises:
        OptionError: Recordings with different columns.
        LPVMPCError: The car that is begun with cannot follow a recording.
    """
    segments = [one for recording in recordings for one in recording.segments()]
    names = list(names)
    tried: list[Problem] = []
    found: list[Array] = []
    for steering in ways(start, segments):
        tried.append(Problem(replace(start, steering=steering), names, segments, predict, PULL))
        found.append(tried[-1].descend(found[-1] if found else tried[-1].x0, evaluations))
    which = int(np.argmin([float(one.errors @ one.errors) for one in tried]))
    best, x = tried[which], found[which]
    best.pull = best.level()
    if best.asks(x) > MOVED:
        x = best.descend(x, evaluations)
    used = sum(problem.evaluations for problem in tried)
    told = _timing(best, x)
    used += LATENCY not in names
    covariance, certain = best.covariance(), best.certain()
    deviation = np.sqrt(np.diag(covariance))
    correlations = covariance / np.maximum(np.outer(deviation, deviation), 1e-300)
    scale = best.scale
    near = 1e-3 * (best.high - best.low)
    at_bound = (x < best.low + near) | (x > best.high - near)
    power = float(best.errors @ best.errors)
    unseen = (best.jacobian**2).sum(axis=0) < 1e-8 * power
    wide = unseen | (certain * deviation > WIDE * np.maximum(np.abs(x), 1.0))
    parameters = tuple(
        Fitted(
            name=name, value=float(x[i] * scale[i]), start=start.value(name),
            low95=float((x[i] - certain * deviation[i]) * scale[i]),
            high95=float((x[i] + certain * deviation[i]) * scale[i]),
            deviation=float(deviation[i] * scale[i]), at_bound=bool(at_bound[i]),
            identifiable=not bool(wide[i]),
        )
        for i, name in enumerate(names)
    )
    told = [*_warnings(parameters, correlations, best.columns), *told]
    if best.stopped:
        told.append(f"The fit was stopped after {evaluations} evaluations, before it was done.")
    return Fit(
        candidate=best.candidate(x), parameters=parameters, correlations=correlations,
        wheel=_wheel(best.start.steering, segments), warnings=tuple(told),
        cost=power / len(best.errors), evaluations=used,
    )


def visible(recordings: Sequence[Recording], ay_limit: float) -> tuple[str, ...]:
    """The parameters that recordings show, where none are named.

    Yaw rate alone shows the stiffness of the axles. Side speed shows their place, inertia and
    relaxation as well, and, where the car comes near the limit, the friction.

    Args:
        recordings: What is fitted on.
        ay_limit: Lateral limit of the car that is begun with [m/s2].
    """
    if any(one.vy is None for one in recordings):
        return "Cf", "Cr"
    near = max(float(np.percentile(np.abs(one.lateral), 99.0)) for one in recordings)
    friction = ("mu_f", "mu_r") if near > NEAR * ay_limit else ()
    return "lf", "lr", "Cf", "Cr", "Iz", "relaxation", *friction


def ways(start: Candidate, segments: Sequence[Recording]) -> list[Steering]:
    """What the wheel may do between samples: a straight line, or what the car's own servo does.

    The servo's way is among them where none is known, nothing is held, and the two differ in their
    mean times by more than `SAME`.
    """
    law, tau = start.steering, start.numbers.tau_delta
    step = float(np.median([one.step for one in segments]))
    # mean over a sample of (1 - exp(-t / tau)) / (1 - exp(-step / tau)), less a half
    ahead = step * (-1.0 / math.expm1(-step / tau) - tau / step - 0.5)
    if law.servo > 0.0 or ahead < SAME or all(one.held for one in segments):
        return [law]
    return [law, replace(law, servo=tau)]


def _wheel(law: Steering, segments: Sequence[Recording]) -> str:
    if all(one.held for one in segments):
        return "held, as recorded"
    if law.servo > 0.0:
        return f"a servo's response of {1000 * law.servo:.0f} ms to a command held for a sample"
    return "straight lines"


def _timing(problem: Problem, x: Array) -> list[str]:
    """Whether the recordings ask for another time of the wheel: one step of a fit that has it."""
    if LATENCY in problem.names:
        return []
    wider = Problem(
        problem.start, [*problem.names, LATENCY], problem.segments, problem.predict, problem.pull
    )
    at = np.append(x, wider.x0[-1])
    wider.at(at)
    time = float(wider.step(at)[-1] * wider.scale[-1])
    # a hint, not an interval: it may be wrong more often than one in twenty
    sure = CRITICAL[0] * float(np.sqrt(wider.covariance()[-1, -1]) * wider.scale[-1])
    if abs(time) < max(OFF, sure):
        return []
    return [
        f"The recordings would be explained better by a wheel that is {1000 * abs(time):.0f} ms "
        f"{'later' if time > 0.0 else 'earlier'} (+- {1000 * sure:.0f} ms) than they say; --fit "
        f"{' '.join(problem.names)} {LATENCY} identifies that."
    ]


def _inflation(correlations: Array) -> Array:
    """Variance of each estimate over what it were if the others were known, shape (P,)."""
    try:
        return np.diag(np.linalg.inv(correlations)).copy()
    except np.linalg.LinAlgError:
        return np.full(len(correlations), np.inf)


def _warnings(
    parameters: Sequence[Fitted], correlations: Array, columns: Sequence[str]
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
    if not all(math.isfinite(one.value) for one in parameters):
        told.append("The fit has found no numbers.")
    return told
