"""Which closed loops the leaderboard drives: courses, worlds, grip, friction, wind and seeds.

A `Cell` is a closed loop without its controller; every controller drives it with the same seed, so
that any two can be compared pair by pair. Three parts: `worlds` (all courses in all worlds, many
seeds), `limits` (the circuit by grip and friction, nothing drawn), `wind` (the paper's road in no
wind and in twice its own).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lpvmpc.control.registry import CONTROLLERS
from lpvmpc.control.rivals import RIVALS
from lpvmpc.sim.batch import Run

OURS = "lpv-mpc"
"""The controller that the sentences are about, where it drives."""
WORLDS = ("ideal", "rtk", "production", "fleet")
"""Worlds in the order of the tables."""
FIRST_SEED = 100_000
"""Seeds count from here; tuning draws its worlds with seeds below 50000."""
PARTS = {
    "worlds": "all courses in all worlds",
    "limits": "the circuit by grip and friction, in the ideal world",
    "wind": "the paper's road without wind and in twice its own",
}
"""Parts of the grid and what they are."""


@dataclass(frozen=True, kw_only=True)
class Course:
    """A road, and how fast it is driven."""

    key: str
    """Name in the tables and files."""
    scenario: str
    """Name of the scenario."""
    grip: float | None = None
    """Share of the grip that its speed asks for; None: the scenario's own speed."""
    stream: int
    """Its seeds begin at `FIRST_SEED` + 1000 times this, and 10000 further for each world, so that
    no two courses and no two worlds draw the same."""
    windy: bool = False
    """Whether the scenario has a wind of its own."""


COURSES = {
    course.key: course
    for course in (
        Course(key="paper", scenario="paper", stream=0, windy=True),
        Course(key="paper-loop", scenario="paper-loop", stream=1, windy=True),
        Course(key="circuit-65", scenario="circuit", grip=0.65, stream=2),
        Course(key="circuit-80", scenario="circuit", grip=0.80, stream=3),
        Course(key="double-lane-change", scenario="double-lane-change", stream=4),
        Course(key="slalom", scenario="slalom", stream=5),
        Course(key="skidpad", scenario="skidpad", grip=0.65, stream=6),
    )
}
"""Courses of the part `worlds`, by key."""
LIMITS = Course(key="circuit", scenario="circuit", stream=7)
"""What is driven by grip and friction."""
WIND = Course(key="paper", scenario="paper", stream=8, windy=True)
"""What is driven in other winds."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One closed loop, whoever drives."""

    part: str
    """A key of `PARTS`."""
    course: str
    """Name of the course."""
    scenario: str
    """Name of its scenario."""
    world: str
    """One of `WORLDS`."""
    grip: float | None
    """Share of the grip that the speed asks for; None: the scenario's own speed."""
    friction: float = 1.0
    """Scale on the road's friction, which the planned speed follows."""
    wind: float = 0.0
    """Factor on the scenario's wind; 0 where it has none."""
    seed: int
    """Seed of everything random."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is driven."""

    controllers: tuple[str, ...]
    """Who drives: names of the package, or module:Class."""
    courses: tuple[str, ...] = tuple(COURSES)
    """Keys of the courses of `worlds`."""
    worlds: tuple[str, ...] = WORLDS
    """Worlds of `worlds`."""
    seeds: int = 20
    """Seeds of each course in each world that draws anything."""
    grips: tuple[float, ...] = (0.5, 0.65, 0.8, 0.87, 0.96, 1.0)
    """Shares of the grip of `limits`."""
    frictions: tuple[float, ...] = (1.0, 0.8, 0.6, 0.4)
    """Frictions of `limits`."""
    winds: tuple[float, ...] = (0.0, 2.0)
    """Factors of `wind`."""
    wind_seeds: int = 5
    """Seeds of `wind` in the world `rtk`."""
    slow_courses: tuple[str, ...] = tuple(COURSES)
    """Courses that slow controllers drive too."""
    slow_seeds: int = 3
    """Seeds that slow controllers drive too."""
    quick: bool = False
    """Whether this is a look, not the report."""

    def cells(self, controller: str) -> list[Cell]:
        """What a controller drives; a slow one a part of what all others do."""
        slow = is_slow(controller)
        found = [
            _cell("worlds", COURSES[key], world, i)
            for world in self.worlds
            for key in self.courses if not slow or key in self.slow_courses
            for i in range(self.seeds_in(world, slow))
        ]
        found += [
            _cell("limits", LIMITS, "ideal", 0, grip=grip, friction=friction)
            for friction in self.frictions if not slow or (friction == 1.0 and not self.quick)
            for grip in self.grips
        ]
        found += [
            _cell("wind", WIND, world, i, wind=wind)
            for wind in self.winds if not slow
            for world in ("ideal", "rtk") if world in self.worlds
            for i in range(1 if world == "ideal" else self.wind_seeds)
        ]
        return found

    def seeds_in(self, world: str, slow: bool = False) -> int:
        """Number of seeds in a world; one where nothing is drawn."""
        if world == "ideal":
            return 1
        return min(self.seeds, self.slow_seeds) if slow else self.seeds

    @property
    def slow(self) -> tuple[str, ...]:
        """The controllers that drive a part alone."""
        return tuple(name for name in self.controllers if is_slow(name))


QUICK: Mapping[str, Any] = {
    "courses": ("paper", "double-lane-change", "slalom"), "seeds": 2, "grips": (0.65, 0.96),
    "frictions": (1.0, 0.6), "winds": (), "slow_courses": ("double-lane-change",),
    "slow_seeds": 2, "quick": True,
}
"""What differs in a quick look."""


def _cell(
    part: str, course: Course, world: str, i: int, *, grip: float | None = None, **more: float
) -> Cell:
    """A cell of a course; `i` counts its seeds."""
    more.setdefault("wind", 1.0 if course.windy else 0.0)
    return Cell(
        part=part, course=course.key, scenario=course.scenario, world=world,
        grip=course.grip if grip is None else grip,
        seed=FIRST_SEED + 10_000 * WORLDS.index(world) + 1000 * course.stream + i, **more,
    )


def is_slow(controller: str) -> bool:
    """Whether a controller is marked as one that takes long."""
    return controller in RIVALS and RIVALS[controller].slow


def available() -> tuple[list[str], dict[str, str]]:
    """The package's controllers that can drive here, and what the others lack: package by name."""
    lacking = {name: gone for name, rival in RIVALS.items() if (gone := rival.missing())}
    return [name for name in CONTROLLERS if name not in lacking], lacking


def run_of(cell: Cell, controller: str) -> Run:
    """The closed loop of a cell with a controller."""
    options: dict[str, Any] = {}
    if cell.grip is not None:
        options["grip"] = cell.grip
    if cell.friction != 1.0:
        options["friction"] = cell.friction
    if cell.wind not in (0.0, 1.0) or (cell.wind == 0.0 and cell.part == "wind"):
        options["wind_scale"] = cell.wind
    where = f"{cell.part} {cell.course} {cell.world} {cell.grip} {cell.friction} {cell.wind}"
    return Run(
        label=f"{where} {cell.seed} {controller}", scenario=cell.scenario,
        scenario_options=options, controller=controller, world=cell.world, seed=cell.seed,
    )


@dataclass(frozen=True, kw_only=True)
class Row:
    """A cell that a controller has driven."""

    cell: Cell
    """What was driven."""
    controller: str
    """Who drove."""
    result: Mapping[str, Any] = field(repr=False)
    """What it has shown, as `sim.batch.KEPT` names it."""


def planned(plan: Plan) -> list[tuple[Cell, str]]:
    """All cells with their controllers, in the order of the rows."""
    return [(cell, name) for name in plan.controllers for cell in plan.cells(name)]


def rows_of(pairs: Sequence[tuple[Cell, str]], results: Sequence[Mapping[str, Any]]) -> list[Row]:
    """Rows of what was driven, in the order of the pairs."""
    return [
        Row(cell=cell, controller=name, result=result)
        for (cell, name), result in zip(pairs, results, strict=True)
    ]
