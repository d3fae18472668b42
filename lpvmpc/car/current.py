"""The car that is meant where none is named: the packaged one, or that of `--car`.

It is kept in the environment, so that processes that are started meanwhile mean the same car.
`lpvmpc.plant.car_folder.driving` sets it; what is made for a car is looked up here.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, wraps
from pathlib import Path
from typing import TypeVar, TypeVarTuple

PLACE, SHA256 = "LPVMPC_CAR", "LPVMPC_CAR_SHA256"
"""Variables: the car's folder or model file, and the hash of its numbers."""
Ts = TypeVarTuple("Ts")
T = TypeVar("T")


@dataclass(frozen=True)
class Current:
    """A car that is not meant anyway."""

    place: Path
    """Its folder, or its model file."""
    sha256: str
    """Hash of its numbers."""

    @property
    def file(self) -> Path:
        """Its model file."""
        return self.place if self.place.suffix.lower() == ".xml" else self.place / "vehicle.xml"

    @property
    def folder(self) -> Path | None:
        """Folder of what was made for it; None for a model file alone."""
        return None if self.place.suffix.lower() == ".xml" else self.place

    def __str__(self) -> str:
        near = os.path.relpath(self.place)
        return str(self.place) if near.startswith("..") else near


def current() -> Current | None:
    """The car of `--car`; None where the packaged one is meant."""
    place, sha256 = os.environ.get(PLACE), os.environ.get(SHA256)
    return Current(Path(place), sha256) if place and sha256 else None


def per_car(function: Callable[[*Ts], T]) -> Callable[[*Ts], T]:
    """`functools.cache`, with one cache for each car that is meant."""
    kept = cache(lambda sha256, place, *arguments: function(*arguments))

    @wraps(function)
    def call(*arguments: *Ts) -> T:
        return kept(os.environ.get(SHA256), os.environ.get(PLACE), *arguments)

    return call
