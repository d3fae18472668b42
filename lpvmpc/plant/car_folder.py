"""A car as a folder: its model, what was made for it, and where it all comes from.

    cars/NAME/
      vehicle.xml          the car, in the layout of models/vehicle.xml
      provenance.json      its name, its hash (`mjcf.car_sha256`), and what made it
      README.md            its card: sources and grades
      car.toml             the numbers it was written from, if it was (`car_file`)
      network.safetensors  networks trained on it, if there are any; also network-secant.safetensors
      weights/NAME.toml    weights tuned on it, if there are any, by the controller's name

Whatever is made for a car says in itself for which: `provenance.json` under `car_sha256`, a network
in its metadata, weights in their record. A vehicle.xml that was changed since is refused; so are a
network and weights of another car. A model file alone is a car too, for which
nothing was made.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import mujoco

from lpvmpc.car.current import PLACE, SHA256, current
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import Tire
from lpvmpc.errors import DataError, ModelError
from lpvmpc.kit.files import (
    into,
    read_bytes,
    read_json,
    reading,
    write_json,
    write_text,
)
from lpvmpc.kit.provenance import commit, versions
from lpvmpc.plant.mjcf import car_sha256, compile_model, compile_text, model_path, parameters, tires

MODEL, PROVENANCE, CARD, WEIGHTS = "vehicle.xml", "provenance.json", "README.md", "weights"
"""Names in a car's folder; the last is a folder itself."""
LARGEST = 16 << 20
"""Largest model file [bytes]."""
PACKAGED = "zoe"
"""Name of the packaged car, models/vehicle.xml."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Car:
    """A car: a compiled model that is only read, and where it lies."""

    name: str
    """What to call it."""
    file: Path
    """Its MJCF file."""
    folder: Path | None
    """Folder of what was made for it; None for a model file alone, and for the packaged car."""
    model: mujoco.MjModel
    """The compiled car, without what is only drawn."""

    @property
    def packaged(self) -> bool:
        """Whether it has the numbers of the packaged car, for which the shipped files were made."""
        return self.sha256 == packaged_sha256()

    @cached_property
    def sha256(self) -> str:
        """Hash of its physical numbers."""
        return car_sha256(self.model)

    @cached_property
    def params(self) -> VehicleParams:
        """Its parameters."""
        return parameters(self.model)

    @property
    def tires(self) -> tuple[Tire, Tire]:
        """Its front and rear tires."""
        return tires(self.model)

    def __reduce__(self) -> tuple[Any, ...]:  # a worker process reads it again
        return read_car, (str(self.folder or self.file),)


def read_car(place: str | os.PathLike[str] | None = None) -> Car:
    """The car of a folder, or of a model file.

    Args:
        place: A folder as above, or an MJCF file (default: the car of `driving`, or the packaged
            one).

    Raises:
        ModelError: There is no such folder or file, it holds no car of this package, or its
            vehicle.xml is not the one that its files were made for.
        DataError: provenance.json is missing or damaged.
    """
    if place is None and (meant := current()) is not None:
        place = meant.place
    if place is None:
        file = model_path("vehicle")
        return Car(name=PACKAGED, file=file, folder=None, model=compile_model(file, visual=False))
    path = Path(place)
    if path.is_file():
        if path.suffix.lower() != ".xml":
            raise ModelError(f"{str(path)!r} is no car: it must be a folder with a {MODEL}, or a "
                             "file whose name ends in .xml.")
        model = compile_model(path, visual=False)
        return Car(name=path.stem, file=path, folder=None, model=model)
    if not path.is_dir():
        raise ModelError(f"There is no car {str(path)!r}: it must be a folder with a {MODEL}, or "
                         "an MJCF file.")
    file = path / MODEL
    if not file.is_file():
        raise ModelError(f"{str(path)!r} is no car: it has no {MODEL}.")
    told = _provenance(path)
    model = compile_model(file, visual=False)
    car = Car(name=str(told["name"]), file=file, folder=path, model=model)
    if told["car_sha256"] != car.sha256:
        raise ModelError(
            f"{str(file)!r} was changed since its files were made, or is another car's: its hash "
            f"is {car.sha256[:12]}, {PROVENANCE} says {str(told['car_sha256'])[:12]}; "
            f"python -m lpvmpc.plant.garage {path} takes it for the folder's car."
        )
    return car


def write_car(
    folder: str | os.PathLike[str],
    xml: str,
    *,
    name: str | None = None,
    made_by: str = "",
    record: Mapping[str, Any] | None = None,
    card: str | None = None,
) -> Car:
    """Write a car's folder: model, provenance and card; what else lies there stays.

    Args:
        folder: Where to; made where needed.
        xml: Text of its vehicle.xml; `vehicle_xml.written` makes one.
        name: What to call it (default: the folder's name).
        made_by: The command or function that made it.
        record: Where its numbers come from: anything that JSON has.
        card: Text of README.md (default: none is written).

    Returns:
        The car, as `read_car` gives it.

    Raises:
        ModelError: The text is no car of this package.
        OutputError: The folder cannot be written.
    """
    place = Path(folder)
    model = compile_text(xml, str(place / MODEL))
    with into(place):
        write_text(place / MODEL, xml)
    content = {
        "name": name or place.resolve().name,
        "car_sha256": car_sha256(model),
        "made_by": made_by,
        "commit": commit(),
        "versions": versions(),
        **dict(record or {}),
    }
    write_json(place / PROVENANCE, content)
    if card is not None:
        write_text(place / CARD, card)
    return read_car(place)


def adopt(folder: str | os.PathLike[str]) -> Car:
    """Take a vehicle.xml that was put or changed by hand as the folder's car.

    What was made for the car of before no longer fits, and is refused by its hash.

    Raises:
        ModelError: There is no vehicle.xml, or it is no car of this package.
        OutputError: The folder cannot be written.
    """
    place = Path(folder)
    if not (place / MODEL).is_file():
        raise ModelError(f"{str(place)!r} is no car: it has no {MODEL}.")
    text = read_bytes(place / MODEL, LARGEST).decode("utf-8", "replace")
    return write_car(place, text, made_by="lpvmpc.plant.car_folder.adopt")


def _provenance(folder: Path) -> dict[str, Any]:
    """What provenance.json says."""
    file = folder / PROVENANCE
    with reading(repr(str(file)), "JSON"):
        told = read_json(file)
    if not isinstance(told, dict) or not {"name", "car_sha256"} <= set(told):
        raise DataError(f"{str(file)!r} must hold 'name' and 'car_sha256'.")
    return told


@cache
def packaged_sha256() -> str:
    """Hash of the packaged car."""
    return car_sha256(compile_model(model_path("vehicle"), visual=False))


@contextmanager
def driving(place: str | os.PathLike[str] | None) -> Iterator[Car]:
    """Mean this car wherever none is named, here and in processes that are started meanwhile.

    `Plant()`, `load_controller`, `load_scenario`, data, networks, weights and kept results are then
    its own: what was made for another car is refused.

    Args:
        place: As `read_car` takes it; None: what is meant anyway.

    Raises:
        ModelError, DataError: As `read_car`.
    """
    car = read_car(place)
    before = {name: os.environ.get(name) for name in (PLACE, SHA256)}
    if place is not None:
        os.environ[PLACE] = str((car.folder or car.file).resolve())
        os.environ[SHA256] = car.sha256
    try:
        yield car
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
