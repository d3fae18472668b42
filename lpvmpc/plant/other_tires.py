"""A car on the tires of a property file: for `--tire`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from lpvmpc.car.tir import TirFile, read_tir_file
from lpvmpc.kit.files import read_bytes
from lpvmpc.plant.car_folder import LARGEST, Car, driving, read_car, write_car
from lpvmpc.plant.vehicle_xml import with_tires


@contextmanager
def driving_on(
    place: str | os.PathLike[str] | None, tire: str | os.PathLike[str]
) -> Iterator[tuple[Car, TirFile]]:
    """Mean a car on other tires, as `driving` means a car.

    It is another car, with a lateral limit of its own, which is measured: networks and weights of
    the car on its own tires are not its own.

    Args:
        place: The car, as `read_car` takes it.
        tire: Property file of all four tires.

    Raises:
        ModelError, DataError: As `read_car` and `read_tir_file`.
        OptionError: The tires do not fit the car.
    """
    file, car = read_tir_file(Path(tire)), read_car(place)
    text = read_bytes(car.file, LARGEST).decode()
    name = f"{car.name}-{Path(tire).stem}"
    with TemporaryDirectory() as folder:
        own = Path(folder) / name
        write_car(own, with_tires(text, file.coefficients, file.coefficients), name=name)
        with driving(own) as one:
            yield one, file
