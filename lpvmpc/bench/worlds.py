"""What holds outside the perfect world: which closed loops are driven, by whom, and in which world.

A `Cell` is one closed loop by names and numbers; `run_of` makes it one that `sim.batch` drives. The
parts are single deviations (true state, one thing wrong), sampled worlds (sensors, estimator, and
in `fleet` another car and road for each seed), margins (`bench.margins`), and stiffness models in
these worlds.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from lpvmpc.bench.cases import Measured
from lpvmpc.control.registry import CORE
from lpvmpc.sim.batch import Run

Drive = Callable[[Sequence[Run]], list[dict[str, Any]]]
"""Drives runs and gives their results in order, as `batch.drive_all` does."""

PARTS = ("deviations", "worlds", "margins", "adaptation")
"""Parts of the report, each of which can be driven alone."""
FIRST_SEED = 100_000
"""Seeds count from here; tuning draws its worlds with seeds below 50000."""
TUNING_SEEDS = 50_000
"""Tuning uses seeds below this."""
OURS = "lpv-mpc"
"""The controller that the sentences are about."""
SHIPPED = CORE
"""Who drives where nobody is named."""
DEG = math.pi / 180.0


# Roads --------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class PacedRoad:
    """A road, and how fast it is driven."""

    key: str
    """Name in the files."""
    title: str
    """Name in the tables."""
    scenario: str
    """Name of the scenario, or a CSV file."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `load_scenario`."""


def _circuit(percent: int) -> PacedRoad:
    return PacedRoad(key=f"circuit-{percent}", title=f"circuit {percent} %", scenario="circuit",
                options={"grip": percent / 100})


ROADS = {
    road.key: road
    for road in (
        PacedRoad(key="paper", title="paper", scenario="paper"),
        *(_circuit(percent) for percent in (65, 80, 87, 92)),
    )
}
"""The roads by key. The circuit is driven without wind, `paper` in its own."""


# Deviations ---------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Deviation:
    """One thing that is wrong, all else as the controller believes."""

    key: str
    """Name in the files."""
    title: str
    """Name in the tables."""
    car: Mapping[str, float] = field(default_factory=dict)
    """Deviations of the car."""
    latency: float = 0.0
    """Latency that nobody is told [s]."""
    delay: int = 0
    """Delay that the controller is told [control periods]."""
    world: str | Mapping[str, Any] = "ideal"
    """World of the sensors."""
    estimator: str | None = None
    """What makes a state of them."""


RAW: dict[str, Any] = {
    "name": "raw",
    "sensing": {
        "position": {"std": 0.015},
        "psi": {"std": 0.1 * DEG},
        "vx": {"std": 0.03},
        "vy": {"std": 0.03},
        "r": {"std": 0.1 * DEG},
    },
}
"""White noise on all that the controllers look at, for runs without a filter."""

DEVIATIONS = (
    Deviation(key="nominal", title="nominal"),
    Deviation(key="mass", title="mass +20 %", car={"mass": 1.2}),
    Deviation(key="com-height", title="centre of mass 0.1 m higher", car={"com_height": 0.1}),
    Deviation(key="Cf-30", title="Cf -30 %", car={"Cf": 0.7}),
    Deviation(key="Cr-30", title="Cr -30 %", car={"Cr": 0.7}),
    Deviation(key="C-30", title="Cf and Cr -30 %", car={"Cf": 0.7, "Cr": 0.7}),
    Deviation(key="Cr-10", title="Cr -10 %", car={"Cr": 0.9}),
    Deviation(key="mu-f", title="front friction x0.9", car={"mu_f": 0.9}),
    Deviation(key="relaxation", title="relaxation x2", car={"relaxation": 2.0}),
    Deviation(key="steer-lag-2", title="steering lag x2", car={"steer_lag": 2.0}),
    Deviation(key="steer-lag-3", title="steering lag x3", car={"steer_lag": 3.0}),
    Deviation(key="drive-lag", title="drive lag x4", car={"drive_lag": 4.0}),
    Deviation(key="steer-gain", title="steering gain 0.95", car={"steer_ratio": 0.95}),
    Deviation(key="steer-offset", title="steering offset 0.5 deg", car={"steer_offset": 0.5 * DEG}),
    Deviation(key="lever", title="lever of the wind 0.25 m", car={"side_lever": 0.25}),
    *(Deviation(key=f"latency-{ms}", title=f"latency {ms} ms, untold", latency=1e-3 * ms)
      for ms in (20, 25, 33, 40)),
    Deviation(key="delay-3", title="delay of 3 periods, told", delay=3),
    Deviation(key="delay-6", title="delay of 6 periods, told", delay=6),
    Deviation(key="raw-noise", title="noise, no filter", world=RAW, estimator="none"),
)
"""What is wrong, one at a time."""
DEVIATION_ROADS = ("paper", "circuit-65", "circuit-87", "circuit-92")
"""Where it is driven."""


# Worlds -------------------------------------------------------------------------------------------

COMBINED: dict[str, Any] = {
    "name": "combined",
    "base": "rtk",
    "latency": 0.033,
    "car": {"mass": 1.1, "Cr": 0.85, "steer_lag": 1.5, "steer_offset": 0.2 * DEG},
}
"""Several things wrong at once, the same for every seed."""


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """A world that is driven with many seeds."""

    key: str
    """Name in the tables and files."""
    world: str | Mapping[str, Any]
    """A name of `WORLDS`, or what a file of a world holds."""
    roads: tuple[str, ...]
    """Keys of the roads."""
    most_seeds: int = 1_000_000
    """More seeds than this would tell nothing new."""


SAMPLED = {
    world.key: world
    for world in (
        Sampled(key="ideal", world="ideal", roads=(*DEVIATION_ROADS[:2], "circuit-80",
                *DEVIATION_ROADS[2:]), most_seeds=3),
        Sampled(key="rtk", world="rtk", roads=("paper", "circuit-65", "circuit-80", "circuit-87",
                                               "circuit-92")),
        Sampled(key="production", world="production", roads=("paper", "circuit-65", "circuit-80")),
        Sampled(key="fleet", world="fleet", roads=("paper", "circuit-65", "circuit-80")),
        Sampled(key="fleet-production", world="fleet-production",
                roads=("paper", "circuit-65", "circuit-80")),
        Sampled(key="combined", world=COMBINED, roads=("paper", "circuit-65", "circuit-87")),
    )
}
"""The worlds by key. Nothing is drawn in `ideal`, so few seeds do."""


# Adaptation ---------------------------------------------------------------------------------------

@dataclass(frozen=True, kw_only=True)
class DrivenModel:
    """A stiffness model that drives `lpv-mpc` here."""

    about: str
    """What it is, for the report."""
    options: Mapping[str, Any]
    """Options of the controller: its `stiffness`, and what else makes it, as a file or a scale."""


MODELS = {
    "constant": DrivenModel(
        about="the nominal stiffness, always", options={"stiffness": "constant"}
    ),
    "network-secant": DrivenModel(
        about="the paper's network: force over slip angle, predicted from the motion",
        options={"stiffness": "network-secant"},
    ),
    "network-dry": DrivenModel(
        about="our network without online learning: the road is taken to be dry",
        options={"stiffness": "network-dry"},
    ),
    "network": DrivenModel(
        about="our network with online learning of what the road and the car give",
        options={"stiffness": "network"},
    ),
}
"""Stiffness models by their names in the tables."""
ADAPTED = ("ideal", "rtk", "fleet", "fleet-production")
"""Worlds of this comparison."""
ADAPTED_ROADS = ("paper", "circuit-65", "circuit-80")
"""And its roads."""


# What is driven -----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class GridPlan:
    """How much is driven."""

    controllers: tuple[str, ...] = SHIPPED
    """Who drives: names of the package or module:Class."""
    seeds: int = 100
    """Seeds of each sampled world."""
    model_seeds: int = 20
    """The first so many of them are driven with each stiffness model."""
    roads: tuple[str, ...] = tuple(ROADS)
    """Keys of the roads that are kept."""
    margin_steps: int = 8
    """Steps outwards from nothing to the end of what a margin tries."""
    margin_halvings: int = 4
    """Bisections between the last step that held and the first that did not."""
    quick: bool = False
    """Whether this is a look, not the report."""

    def seeds_of(self, world: Sampled) -> range:
        """The seeds of a world."""
        return range(FIRST_SEED, FIRST_SEED + min(self.seeds, world.most_seeds))

    def seeds_of_models(self, world: Sampled) -> range:
        """The seeds of a world that are driven with each stiffness model."""
        return self.seeds_of(world)[: self.model_seeds]


QUICK = {"seeds": 4, "roads": ("paper", "circuit-65"), "margin_steps": 4, "margin_halvings": 1,
         "quick": True}
"""What differs in a quick look."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One closed loop of a part."""

    part: str
    """The part it belongs to."""
    case: str
    """Key of the deviation, world, or kind of margin."""
    road: str
    """Key of the road."""
    controller: str
    """Who drives."""
    model: str = ""
    """Stiffness model, where another than its own was asked for."""
    seed: int = FIRST_SEED
    """Seed of everything random."""
    value: float = 0.0
    """How far a deviation goes, for margins."""


@dataclass(frozen=True, kw_only=True)
class DrivenCell(Measured):
    """A closed loop and what it has shown."""

    cell: Cell
    """What was driven."""

    def ranked(self, key: str) -> float:
        """A metric by which runs are ranked; infinite where the car was lost."""
        value = self.result[key]
        return float(value) if self.completed and value is not None else math.inf


def deviation_cells(plan: GridPlan) -> list[Cell]:
    """Each deviation alone, by every controller on every road."""
    return [
        Cell(part="deviations", case=deviation.key, road=road, controller=controller)
        for deviation in DEVIATIONS
        for road in DEVIATION_ROADS if road in plan.roads
        for controller in plan.controllers
    ]


def world_cells(plan: GridPlan) -> list[Cell]:
    """Every sampled world, by every controller on its roads, with all seeds."""
    return [
        Cell(part="worlds", case=world.key, road=road, controller=controller, seed=seed)
        for world in SAMPLED.values()
        for road in world.roads if road in plan.roads
        for controller in plan.controllers
        for seed in plan.seeds_of(world)
    ]


def adaptation_cells(plan: GridPlan) -> list[Cell]:
    """`lpv-mpc` with each stiffness model, in the worlds of `world_cells`, on their first seeds."""
    return [
        Cell(part="adaptation", case=key, road=road, controller=OURS, model=model, seed=seed)
        for key in ADAPTED
        for road in ADAPTED_ROADS if road in plan.roads
        for model in MODELS
        for seed in plan.seeds_of_models(SAMPLED[key])
    ]


CELLS: Mapping[str, Callable[[GridPlan], list[Cell]]] = {
    "deviations": deviation_cells, "worlds": world_cells, "adaptation": adaptation_cells,
}
"""What each part drives, but for the margins, which are searched."""


def run_of(cell: Cell) -> Run:
    """The closed loop of a deviation, of a world, or of a stiffness model in it."""
    road = ROADS[cell.road]
    run = Run(
        label=f"{cell.case} {cell.road} {cell.controller} {cell.model} {cell.seed}",
        scenario=road.scenario,
        scenario_options=dict(road.options),
        controller=cell.controller,
        controller_options=dict(MODELS[cell.model].options) if cell.model else {},
        seed=cell.seed,
    )
    if cell.part != "deviations":
        return replace(run, world=SAMPLED[cell.case].world)
    (deviation,) = (one for one in DEVIATIONS if one.key == cell.case)
    if deviation.delay:
        run = replace(run, controller_options={"delay": deviation.delay}, delay=deviation.delay)
    return replace(
        run,
        deviations=dict(deviation.car),
        latency=deviation.latency or None,
        world=deviation.world,
        estimator=deviation.estimator,
    )


def drive_cells(cells: Sequence[Cell], drive: Drive) -> list[DrivenCell]:
    """Drive cells; rows in their order."""
    results = drive([run_of(cell) for cell in cells])
    return [DrivenCell(cell=c, result=result) for c, result in zip(cells, results, strict=True)]
