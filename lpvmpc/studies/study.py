"""The frame of the fidelity studies: the car under test, limits, findings, results, the list.

A study is a module of this package with one function `run(car: CarUnderTest) -> StudyResult`. It
takes every plant from the car, which may be broken on purpose, and every expectation from the
documented car: `car.params` and `car.coefficients` are those of the packaged models/vehicle.xml.
"""

from __future__ import annotations

import copy
import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import numpy.typing as npt

from lpvmpc.car.current import current
from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import UnknownNameError
from lpvmpc.kit.findings import Finding, Limit, Table
from lpvmpc.plant.mjcf import compile_model, parameters, tires
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.names import STUDIES
from lpvmpc.units import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TARGET = "handling target"
"""Reason of a limit that is a handling target of models/README.md as it stands."""


@dataclass(frozen=True, kw_only=True)
class StudyFinding(Finding):
    """A figure of a study; its text has at most 38 characters, its unit 8: 80 columns in all."""

    study: str
    """Name of the study, as on the command line."""
    value: float
    """The measured value."""
    limit: Limit
    """What it must be."""
    target: bool = False
    """Whether it is one of the handling targets of models/README.md."""

    def __post_init__(self) -> None:
        """What does not fit the table is our own mistake."""
        assert len(self.figure) <= 38 and "|" not in self.figure, self.figure
        assert len(self.unit) <= 8, self.unit


@dataclass(frozen=True)
class Series:
    """The numbers behind a picture, written as CSV only."""

    name: str
    """Part of the file name, in lower case with hyphens."""
    columns: Mapping[str, npt.ArrayLike]
    """Column by name (with the unit, as in `ay_mps2`), all of one length."""


@dataclass(frozen=True)
class Picture:
    """A matplotlib figure; who writes the report saves it."""

    name: str
    """Part of the file name, in lower case with hyphens."""
    caption: str
    """What it shows, one or two sentences."""
    figure: Figure | None
    """Made by a function under `style.styled`; None once it is saved."""


@dataclass
class StudyResult:
    """What a study found."""

    study: str
    """Name of the study, as on the command line."""
    method: str = ""
    """Definitions, sources and limits of validity, in Markdown."""
    findings: list[StudyFinding] = field(default_factory=list)
    """Figures with limits and verdicts."""
    tables: list[Table] = field(default_factory=list)
    """Further numbers, without verdict."""
    series: list[Series] = field(default_factory=list)
    """Numbers behind the pictures."""
    pictures: list[Picture] = field(default_factory=list)
    """Plots."""
    seconds: float = 0.0
    """CPU time that it took [s], filled in by `runner.conduct`."""

    @property
    def title(self) -> str:
        """Title of the study."""
        return STUDIES[self.study]

    @property
    def ok(self) -> bool:
        """Whether every figure is inside its limit."""
        return all(finding.ok for finding in self.findings)

    def find(
        self, figure: str, value: float, unit: str, limit: Limit, why: str, *, target: bool = False
    ) -> None:
        """Add a figure.

        Args:
            figure: What was measured, in at most 38 characters.
            value: The measured value.
            unit: Its unit, in at most 8 characters; empty for a pure number.
            limit: What it must be.
            why: Where the limit comes from.
            target: Whether it is one of the handling targets of models/README.md, which are the
                packaged car's: of another car it is left out.
        """
        if target and current() is not None:
            return
        finding = StudyFinding(
            study=self.study,
            figure=figure,
            value=float(value),
            unit=unit,
            limit=limit,
            why=why,
            target=target,
        )
        self.findings.append(finding)


@dataclass(frozen=True, kw_only=True)
class CarUnderTest:
    """Where a study gets its plants, and what it may expect of them.

    The plants may be broken on purpose (`reference.broken_cars`); the expectations are always those
    of the documented car. So a study must not take an expectation from `plant.params`.
    """

    model: mujoco.MjModel
    """The compiled car that the plants simulate."""
    documented: mujoco.MjModel
    """The compiled documented car, to read what `params` does not hold; not to be changed."""
    params: VehicleParams
    """Parameters of the documented car."""
    coefficients: tuple[Array, Array]
    """Magic Formula coefficients of the documented front and rear tires."""
    plant_class: Callable[..., Plant] = Plant
    """`Plant`, or a subclass that steps otherwise."""

    @classmethod
    def packaged(cls) -> CarUnderTest:
        """The car of models/vehicle.xml."""
        model = compile_model(visual=False)
        return cls(
            model=copy.copy(model),
            documented=model,
            params=parameters(model),
            coefficients=_coefficients(model),
        )

    def plant(self, **options: Any) -> Plant:
        """A new plant, at rest.

        Args:
            **options: those of `Plant`: friction, Ts, timestep.
        """
        return self.plant_class(self.model, **options)

    def plant_coefficients(self) -> tuple[Array, Array]:
        """Coefficients of the tires on the plants' model, front and rear: what is to be tested."""
        return _coefficients(self.plant().model)


def _coefficients(model: mujoco.MjModel) -> tuple[Array, Array]:
    front, rear = tires(model)
    return front.c, rear.c


Run = Callable[[CarUnderTest], StudyResult]


def load_study(name: str) -> Run:
    """The function of a study.

    Args:
        name: One of `STUDIES`.

    Raises:
        UnknownNameError: There is no such study; the message lists those there are.
    """
    if name not in STUDIES:
        raise UnknownNameError("study", name, STUDIES)
    module = importlib.import_module(f"lpvmpc.studies.{name.replace('-', '_')}")
    run: Run = module.run
    return run


def relative_error(value: npt.ArrayLike, expected: npt.ArrayLike) -> float:
    """Largest |value - expected| / |expected| [-]."""
    value, expected = np.asarray(value, dtype=float), np.asarray(expected, dtype=float)
    return float(np.max(np.abs(value - expected) / np.abs(expected)))
