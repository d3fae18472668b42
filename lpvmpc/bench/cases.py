"""What adapting the cornering stiffness is worth: which closed loops are compared, and how.

Every stiffness model drives every case, with and without the disturbance observer, under one set of
weights. Constant stiffness is given its best value first, searched on the tuning roads alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lpvmpc.sim.batch import Run
from lpvmpc.sim.ending import EY_LOST

Drive = Callable[[Sequence[Run]], list[dict[str, Any]]]
"""Drives runs and gives their metrics in order, as `batch.drive_all` does."""

CHARGE = EY_LOST
"""RMSE and largest error charged to a run that did not complete [m]: where a car counts as lost."""


# What drives --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Model:
    """One row of the tables: a controller with a stiffness model."""

    key: str
    """Name in the tables and files."""
    stiffness: str
    """Name of the stiffness model."""
    controller: str = "lpv-mpc"
    """Name of the controller."""


MODELS = (
    Model(key="constant", stiffness="constant"),
    Model(key="constant-best", stiffness="constant"),
    Model(key="network-secant", stiffness="network-secant"),
    Model(key="network", stiffness="network"),
    Model(key="oracle-secant", stiffness="oracle-secant"),
    Model(key="oracle", stiffness="oracle"),
)
"""The models that are compared; `constant-best` is scaled by what `search` finds."""
DRY = Model(key="network-dry", stiffness="network-dry")
"""What estimating friction is worth: on slippery roads, the network without the estimate."""
PLAIN = Model(key="lpv-mpc-paper", stiffness="constant", controller="lpv-mpc-paper")
"""The paper's plain formulation: constant stiffness, no observer, no lags, no feed-forward."""
ABOUT = {
    "constant": "the nominal stiffness everywhere",
    "constant-best": "the nominal stiffness times its best factor",
    "network-secant": "the paper's network: force over slip angle, predicted from vx, vy, delta, "
    "ax, r",
    "network-dry": "ours on a road taken to be dry, whatever it mispredicts; slippery roads only",
    "network": "ours: force and local slope along the prediction, friction estimated online",
    "oracle-secant": "the plant's own force over slip angle, now",
    "oracle": "the plant's own tire law along the prediction, friction known",
    "lpv-mpc-paper": "another controller, the paper's plain formulation, with nominal stiffness "
    "and weights of its own",
}
"""What each model is, for the report."""


# What is driven -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Case:
    """One column of the tables: a road and how it is driven."""

    key: str
    """Name in the files, unique."""
    title: str
    """Name in the tables."""
    group: str
    """Table that it belongs to, a key of `GROUPS`."""
    scenario: str
    """Name of the scenario, or a CSV file."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `load_scenario`."""
    road: float | tuple[tuple[float, float], ...] = 1.0
    """Unannounced friction, see `batch.Run`."""
    wrong: Mapping[str, Any] = field(default_factory=dict)
    """What makes the stiffness model wrong: `stiffness_scale`, `stiffness_noise` and its seed."""

    def models(self) -> tuple[Model, ...]:
        """Who drives it; an oracle that is made wrong is none, and one constant is enough."""
        if not self.wrong:
            return (*MODELS, *([DRY] if self.group == "friction" else []), PLAIN)
        return tuple(m for m in MODELS if m.key in ("constant", "network-secant", "network"))


GROUPS = {
    "grip": "Circuit without wind, by the share of the grip that its speed asks for",
    "road": "Other roads",
    "friction": "Slippery roads: circuit at friction 0.5, announced and not",
    "wrong": "Models made wrong: circuit at 87 % of the grip",
}
"""Tables and their titles."""
GRIPS = (0.5, 0.65, 0.76, 0.87, 0.92, 0.96, 1.0)
"""Shares of the grip limit that the circuit is driven at."""
STEPS = (616.0, 850.0, 1200.0, 1600.0)
"""Where the road becomes slippery [m]: in the middle of the hairpin of 10 m radius, and of bends
of 110, 20 and 150 m, where the whole of the planned lateral acceleration is asked for."""
NOISE_SEEDS = (0, 1, 2)
"""Seeds of the noise on the stiffness."""


def _circuit(group: str, key: str, title: str, grip: float, **more: Any) -> Case:
    options = {"grip": grip, **more.pop("options", {})}
    return Case(key=key, title=title, group=group, scenario="circuit", options=options, **more)


def _slippery_from(s: float) -> tuple[tuple[float, float], ...]:
    """A dry road that is slippery from an arc length [m] on, where 0.5 is announced all along."""
    return ((0.0, 2.0), (s, 2.0), (s + 0.5, 1.0))


CASES = (
    *(_circuit("grip", f"circuit-{grip:g}", f"{100 * grip:.0f} %", grip) for grip in GRIPS),
    Case(key="paper", title="paper, wind", group="road", scenario="paper"),
    Case(key="paper-calm", title="paper, calm", group="road", scenario="paper",
         options={"wind_scale": 0.0}),
    Case(key="paper-loop", title="paper-loop, wind", group="road", scenario="paper-loop"),
    Case(key="double-lane-change", title="lane change", group="road",
         scenario="double-lane-change"),
    Case(key="slalom", title="slalom", group="road", scenario="slalom"),
    Case(key="skidpad", title="skidpad", group="road", scenario="skidpad"),
    _circuit("friction", "slippery-0.8", "friction 0.5 at 80 %", 0.8, options={"friction": 0.5}),
    _circuit("friction", "slippery-0.92", "friction 0.5 at 92 %", 0.92, options={"friction": 0.5}),
    _circuit("friction", "drop", "drop to 0.75", 0.76, road=0.75),
    *(_circuit("friction", f"step-{s:.0f}", f"step at {s:.0f} m", 0.8, road=_slippery_from(s),
               options={"friction": 0.5}) for s in STEPS),
    *(_circuit("wrong", f"wrong-{scale:g}", f"x{scale:g}", 0.87, wrong={"stiffness_scale": scale})
      for scale in (0.7, 1.3)),
    *(_circuit("wrong", f"noise-{seed}", f"10 % noise, seed {seed}", 0.87,
               wrong={"stiffness_noise": 0.1, "stiffness_seed": seed}) for seed in NOISE_SEEDS),
)
"""Everything that is driven."""
QUICK = ("circuit-0.76", "circuit-0.92", "double-lane-change", "drop")
"""Keys of the cases of a quick look."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What a closed loop has shown."""

    result: Mapping[str, Any]
    """Its metrics."""

    @property
    def completed(self) -> bool:
        """Whether the car reached the end."""
        return bool(self.result["completed"])

    @property
    def rmse(self) -> float:
        """Lateral RMSE [m]; `CHARGE` where the car was lost."""
        return charge(self.result, "lateral_rmse_m")

    @property
    def largest(self) -> float:
        """Largest lateral error [m]; `CHARGE` where the car was lost."""
        return charge(self.result, "lateral_max_m")


@dataclass(frozen=True, kw_only=True)
class DrivenCase(Measured):
    """One cell of the tables: a case driven by a model."""

    case: Case
    """What was driven."""
    model: Model
    """Who drove."""
    observer: bool
    """Whether with the disturbance observer."""


def charge(result: Mapping[str, Any], key: str) -> float:
    """An error of a run [m]; `CHARGE` where it did not complete."""
    value = result[key]
    return float(value) if result["completed"] and value is not None else CHARGE


def run_of(case: Case, model: Model, observer: bool, scale: float = 1.0) -> Run:
    """The closed loop of a case, a model and a scale of its stiffness."""
    options: dict[str, Any] = {"stiffness": model.stiffness}
    if scale != 1.0:
        options["stiffness_scale"] = scale
    options.update(case.wrong)
    if not observer and model.controller == "lpv-mpc":  # the plain formulation has none anyway
        options["formulation"] = {"observer": False}
    return Run(
        label=f"{case.key} {model.key}{'' if observer else ' without observer'}",
        scenario=case.scenario,
        scenario_options=dict(case.options),
        controller=model.controller,
        controller_options=options,
        road=case.road,
    )


def compare(cases: Iterable[Case], best: Mapping[bool, float], drive: Drive) -> list[DrivenCase]:
    """Drive every case by all its models, with and without the observer.

    Args:
        cases: What to drive.
        best: Factor of `constant-best`, with the observer and without it.
        drive: Drives the runs.
    """
    planned = [
        (case, model, observer)
        for case in cases
        for observer in (True, False)
        for model in case.models()
        if not (observer and model is PLAIN)
    ]
    runs = [
        run_of(case, model, observer, best[observer] if model.key == "constant-best" else 1.0)
        for case, model, observer in planned
    ]
    return [
        DrivenCase(case=case, model=model, observer=observer, result=result)
        for (case, model, observer), result in zip(planned, drive(runs), strict=True)
    ]


def count(cases: Iterable[Case]) -> int:
    """Number of runs of `compare`."""
    return sum(2 * len(case.models()) - (PLAIN in case.models()) for case in cases)


# The best constant stiffness ----------------------------------------------------------------------


def roads(names: Iterable[str], grips: Iterable[float]) -> tuple[Case, ...]:
    """Roads at several shares of the grip."""
    return tuple(
        Case(key=f"{name}-{grip:g}", title=f"{name}, {100 * grip:.0f} %", group="search",
             scenario=name, options={"grip": grip})
        for name in names for grip in grips
    )


SEARCH = roads(("tuning-a", "tuning-b"), (0.65, 0.76, 0.87, 0.92))
"""Roads on which the best constant stiffness is searched; none is among `CASES`."""
COARSE = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2)
"""Factors on the nominal stiffness that are tried first."""
FINE = (-0.075, -0.05, -0.025, 0.025, 0.05, 0.075)
"""What is tried around the best of them."""


@dataclass(frozen=True, kw_only=True)
class FactorSearch:
    """How good each constant stiffness is on the tuning roads."""

    cost: Mapping[float, float]
    """Geometric mean of the lateral RMSE over the roads [m], by factor; lost runs are charged."""
    lost: Mapping[float, int]
    """Number of lost runs, by factor."""

    @property
    def best(self) -> float:
        """The factor of least cost."""
        return min(self.cost, key=lambda scale: (self.cost[scale], scale))

    @property
    def at_an_end(self) -> bool:
        """Whether the best is the smallest or largest that was tried, so that more may be."""
        return self.best in (min(self.cost), max(self.cost))


def search(
    drive: Drive,
    cases: Sequence[Case] = SEARCH,
    coarse: Sequence[float] = COARSE,
    fine: Sequence[float] = FINE,
) -> dict[bool, FactorSearch]:
    """Find the best factor on the nominal stiffness, with the observer and without it.

    Args:
        drive: Drives the runs.
        cases: Roads to try them on.
        coarse: Factors tried first.
        fine: Distances from the best of those, tried next.
    """
    tried: dict[bool, set[float]] = {True: set(coarse), False: set(coarse)}
    found = _costs(drive, cases, tried)
    if fine:
        for observer, scales in tried.items():
            best = found[observer].best
            scales |= {round(best + step, 6) for step in fine if best + step > 0.1}
        found = _costs(drive, cases, tried, found)
    return found


def _costs(
    drive: Drive,
    cases: Sequence[Case],
    tried: Mapping[bool, Iterable[float]],
    known: Mapping[bool, FactorSearch] | None = None,
) -> dict[bool, FactorSearch]:
    """Drive what is not known yet, and all costs."""
    model = MODELS[0]
    planned = [
        (observer, scale)
        for observer, scales in tried.items()
        for scale in sorted(scales)
        if known is None or scale not in known[observer].cost
    ]
    runs = [run_of(case, model, observer, s) for observer, s in planned for case in cases]
    results = iter(drive(runs))
    cost = {observer: dict(known[observer].cost) if known else {} for observer in tried}
    lost = {observer: dict(known[observer].lost) if known else {} for observer in tried}
    for observer, scale in planned:
        here = [next(results) for _ in cases]
        cost[observer][scale] = geometric_mean(charge(r, "lateral_rmse_m") for r in here)
        lost[observer][scale] = sum(not r["completed"] for r in here)
    return {
        observer: FactorSearch(cost=dict(sorted(cost[observer].items())), lost=lost[observer])
        for observer in tried
    }


def geometric_mean(values: Iterable[float]) -> float:
    """Geometric mean of positive values: each road counts alike, however large its errors."""
    logs = [math.log(max(value, 1e-9)) for value in values]
    return math.exp(math.fsum(logs) / len(logs))
