"""Margins: how far one thing may be wrong until the car is lost, or 0.3 m beside its line.

Each kind of deviation is driven outwards from nothing in steps, and between the last step that
held and the first that did not by bisection. The steps are for what is not monotone: a car that is
lost at some deviation and not at a larger one has the margin of the smaller.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from lpvmpc.bench.worlds import DEG, FIRST_SEED, ROADS, Cell, Drive, DrivenCell, GridPlan
from lpvmpc.sim.batch import Run

OFF = 0.3
"""A largest lateral error beyond this is too much [m]."""
ROAD = "circuit-65"
"""Road on which margins are measured."""
NOISE_SEEDS = 5
"""Seeds with each of which a car must hold, where noise is drawn."""


@dataclass(frozen=True, kw_only=True)
class MarginKind:
    """A kind of deviation, from none to more than anything can take."""

    key: str
    """Name in the files."""
    title: str
    """Name in the tables."""
    unit: str
    """Unit of its values, as they are printed."""
    none: float
    """The value at which nothing is wrong."""
    end: float
    """The end of what is tried."""
    run: Callable[[Run, float], Run]
    """A run with this value."""
    seeds: int = 1
    """Seeds that all must hold."""
    geometric: bool = False
    """Whether steps are factors rather than distances."""
    whole: bool = False
    """Whether there are whole values alone."""

    def at(self, share: float) -> float:
        """The value at a share of the way from none to the end."""
        if self.geometric:
            return self.none * (self.end / self.none) ** share
        value = self.none + share * (self.end - self.none)
        return float(round(value)) if self.whole else value


def _car(name: str, per_unit: float) -> Callable[[Run, float], Run]:
    return lambda run, value: replace(run, deviations={name: per_unit * value})


def _noise(run: Run, factor: float) -> Run:
    return replace(run, world={"name": "rtk", "base": "rtk", "sensing": {"scale": factor}})


KINDS = (
    MarginKind(key="latency", title="latency, untold", unit="ms", none=0.0, end=200.0,
         whole=True,
         run=lambda run, ms: replace(run, latency=1e-3 * ms)),
    MarginKind(key="noise", title="noise of `rtk`, filtered", unit="times", none=1.0, end=32.0,
         run=_noise, seeds=NOISE_SEEDS, geometric=True),
    MarginKind(key="Cf-less", title="front stiffness, softer", unit="%", none=100.0, end=20.0,
         run=_car("Cf", 0.01)),
    MarginKind(key="Cf-more", title="front stiffness, stiffer", unit="%", none=100.0, end=260.0,
         run=_car("Cf", 0.01)),
    MarginKind(key="Cr-less", title="rear stiffness, softer", unit="%", none=100.0, end=20.0,
         run=_car("Cr", 0.01)),
    MarginKind(key="Cr-more", title="rear stiffness, stiffer", unit="%", none=100.0, end=260.0,
         run=_car("Cr", 0.01)),
    MarginKind(key="offset", title="steering offset", unit="deg", none=0.0, end=5.6,
         run=_car("steer_offset", DEG)),
    MarginKind(key="friction", title="friction, unannounced", unit="of nominal", none=1.0, end=0.2,
         run=lambda run, value: replace(run, road=value)),
)
"""What is made wrong."""


@dataclass(frozen=True, kw_only=True)
class Margin:
    """How far one kind of deviation may go with one controller."""

    kind: MarginKind
    """What was made wrong."""
    controller: str
    """Who drove."""
    held: float | None
    """The furthest value up to which all that was tried held; None where not even none held."""
    failed: float | None
    """The nearest value that did not hold; None where the end of the range did."""
    why: str
    """What happened there."""
    rows: tuple[DrivenCell, ...]
    """All runs, in the order in which they were driven."""


class _MarginSearch:
    """The margin of one kind and one controller, while it is being searched."""

    def __init__(self, kind: MarginKind, controller: str, plan: GridPlan) -> None:
        self.kind, self.controller, self.plan = kind, controller, plan
        self.rows: list[DrivenCell] = []
        self.why: dict[float, str] = {}  # by share of the range
        self.low, self.high = -1.0, math.inf

    def wanted(self, share: float) -> list[tuple[Cell, Run]]:
        """The runs at a share of the range."""
        value = self.kind.at(share)
        road = ROADS[ROAD]
        found = []
        for seed in range(FIRST_SEED, FIRST_SEED + self.kind.seeds):
            cell = Cell(part="margins", case=self.kind.key, road=ROAD, controller=self.controller,
                        seed=seed, value=value)
            run = Run(label=f"{self.kind.key} {value:g} {self.controller}", scenario=road.scenario,
                      scenario_options=dict(road.options), controller=self.controller, seed=seed)
            found.append((cell, self.kind.run(run, value)))
        return found

    def learn(self, share: float, rows: Sequence[DrivenCell]) -> None:
        """Keep what runs at a share have shown."""
        self.rows += rows
        self.why[share] = next((why for row in rows if (why := failure(row.result))), "")
        bad = [s for s, why in self.why.items() if why]
        self.high = min(bad, default=math.inf)
        self.low = max((s for s, why in self.why.items() if not why and s < self.high),
                       default=-1.0)

    def middle(self) -> float | None:
        """Where to try next between the two; None where there is no such place."""
        return 0.5 * (self.low + self.high) if 0.0 <= self.low < self.high <= 1.0 else None

    def margin(self) -> Margin:
        """What is known now."""
        ends = self.high <= 1.0
        return Margin(
            kind=self.kind,
            controller=self.controller,
            held=self.kind.at(self.low) if self.low >= 0.0 else None,
            failed=self.kind.at(self.high) if ends else None,
            why=self.why[self.high] if ends else "",
            rows=tuple(self.rows),
        )


def failure(result: Mapping[str, Any]) -> str:
    """Why a run does not count as held, in a word or two; "" where it does."""
    if not result["completed"]:
        reason = str(result["reason"])
        if result["s_end_m"] is None:  # nothing was driven at all
            return "refused: " + reason
        return reason.partition(":")[0] or "lost"
    return "" if float(result["lateral_max_m"]) <= OFF else f"more than {OFF:g} m off"


def margins(plan: GridPlan, drive: Drive) -> list[Margin]:
    """Search all margins of all controllers, side by side.

    Args:
        plan: Who drives, and how finely is searched.
        drive: Drives the runs of one round.
    """
    searches = [
        _MarginSearch(kind, controller, plan) for kind in KINDS for controller in plan.controllers
    ]
    shares = [i / plan.margin_steps for i in range(plan.margin_steps + 1)]
    _round([(search, share) for search in searches for share in shares], drive)
    for _ in range(plan.margin_halvings):
        between = [(search, search.middle()) for search in searches]
        _round([(search, share) for search, share in between if share is not None], drive)
    return [search.margin() for search in searches]


def _round(asked: Sequence[tuple[_MarginSearch, float]], drive: Drive) -> None:
    """Drive what is asked, all at once, and tell each search."""
    wanted = [search.wanted(share) for search, share in asked]
    results = iter(drive([run for runs in wanted for _, run in runs]))
    for (search, share), runs in zip(asked, wanted, strict=True):
        search.learn(share, [DrivenCell(cell=cell, result=next(results)) for cell, _ in runs])


def finest(kind: MarginKind, plan: GridPlan) -> str:
    """How fine a margin is, as it is printed."""
    share = 1.0 / (plan.margin_steps * 2**plan.margin_halvings)
    if kind.geometric:
        return f"x{(kind.end / kind.none) ** share:.3g}"
    return f"{abs(kind.end - kind.none) * share:.2g} {kind.unit}"
