"""Making cars: a folder from its car.toml, and a car on the tires of a property file (`--tire`).

    python -m lpvmpc.plant.garage cars/mine

writes vehicle.xml, provenance.json and the card README.md from cars/mine/car.toml, and measures the
lateral limit; without a car.toml it takes the vehicle.xml that lies there as it is.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from lpvmpc.car.numbers import NAMES, CarFile, read_car_file
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tir import TirFile, read_tir_file
from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.files import read_bytes, write_text
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.plant.car_folder import CARD, LARGEST, Car, adopt, driving, read_car, write_car
from lpvmpc.plant.vehicle_xml import car_of, with_tires


def make(folder: str | os.PathLike[str]) -> tuple[Car, list[str]]:
    """Make a folder's car from its car.toml; without one, take its vehicle.xml as it is.

    Returns:
        The car, and the names of the numbers that were taken from the packaged car.

    Raises:
        ModelError, DataError, OptionError: What lies there is no car.
        OutputError: The folder cannot be written.
    """
    place = Path(folder)
    if not (place / "car.toml").is_file():
        return adopt(place), []
    file = read_car_file(place / "car.toml")
    xml, defaults = car_of(file)
    record = {
        "from": "car.toml", "taken_from_the_packaged_car": defaults,
        "tires": [None if tire is None else tire.name for tire in file.tires],
    }
    car = write_car(
        place, xml, name=file.name, made_by="python -m lpvmpc.plant.garage", record=record
    )
    write_text(place / CARD, card(file, car.params, defaults))
    return car, defaults


def card(file: CarFile, params: VehicleParams, defaults: list[str]) -> str:
    """Text of a car's README.md: its numbers with grades and sources, and what follows of them."""
    rows = [
        [name, f"{file.numbers[name]:.6g}", *file.sources.get(name, ("assumed", "not said"))]
        for name in NAMES if name in file.numbers
    ]
    follows = [
        ["axle stiffness, static load", f"{params.Cf / 1e3:.1f}, {params.Cr / 1e3:.1f} kN/rad"],
        ["steady lateral limit, 100 m circle", f"{params.ay_limit:.2f} m/s2"],
        ["load transfer in front", f"{100.0 * params.roll_share_front:.0f} %"],
        ["relaxation lengths", f"{params.sigma_f:.2f}, {params.sigma_r:.2f} m"],
    ]
    tires = {tire.name for tire in file.tires if tire is not None}
    of = f"The tires are those of {', '.join(sorted(tires))}" if tires else (
        "The tires are the packaged car's, at this car's loads"
    )
    parts = [
        f"# {file.name}\n\n{file.title}\n",
        f"Written by `python -m lpvmpc.plant.garage` from car.toml; grades as in "
        f"models/README.md, SI units, names as in `lpvmpc/car/numbers.py`. {of}; what they are and "
        "what was changed is said there. Nothing was measured on a real car by us.\n",
        markdown_table(
            "Numbers", ("number", "value", "grade", "source"), rows, ("grade", "source")
        ),
        f"\nTaken from the packaged car: {', '.join(defaults) or 'nothing'}.\n",
        markdown_table("What follows", ("quantity", "value"), follows),
        f"What the fidelity studies say of it: `lpvmpc fidelity --car cars/{file.name}`; kept for "
        "the cars that come with the package, in docs/results/cars/.\n",
    ]
    return "\n".join(parts)


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


def main(words: list[str]) -> int:
    """Make the cars of some folders, and say what was taken from the packaged one."""
    if not words or words[0] in ("-h", "--help"):
        print(__doc__)
        return 0
    for folder in words:
        try:
            car, defaults = make(folder)
        except LPVMPCError as error:
            print("Error:", error, file=sys.stderr)
            return 2
        print(f"{car.name}: {car.sha256[:12]}, lateral limit {car.params.ay_limit:.2f} m/s2")
        if defaults:
            print(f"From the packaged car, since car.toml does not say: {', '.join(defaults)}.")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
