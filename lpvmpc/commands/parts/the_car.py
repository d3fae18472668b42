"""The option `--car` of every command that drives, simulates or learns a car.

A command gives its options a field `car: CarPlace = None`, and decorates its main:

    @with_car(out="runs/{car}/worlds")
    def main(options: Options) -> int: ...

Files that are published are the packaged car's: where a car is given, results go to the folders
that the decorator names, unless the command line names others.
"""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

from lpvmpc.kit import cli

CarPlace = Annotated[
    Path | None,
    cli.Option(metavar="DIR|FILE.xml", help=(
        "Another car: a folder such as cars/bmw-320i, with what was made for it, or an MJCF file "
        "(default: the packaged one)."
    )),
]
"""Type of the option."""
TireFile = Annotated[
    Path | None,
    cli.Option(metavar="FILE.tir", help=(
        "Put the car on the tires of a property file (MF5.2, PAC2002, MF6.1); what of it is not "
        "honoured is said."
    )),
]
"""Type of the option `tire`, which a command may have as well."""
OptionsT = TypeVar("OptionsT", bound=Any)


def with_car(**places: str) -> Callable[[Callable[[OptionsT], int]], Callable[[OptionsT], int]]:
    """A command's `main` during which the car of its option `car` is meant.

    Args:
        places: Other defaults of options, with {car} for the car's name.
    """

    def decorate(main: Callable[[OptionsT], int]) -> Callable[[OptionsT], int]:
        @functools.wraps(main)
        def run(options: OptionsT) -> int:
            tire = getattr(options, "tire", None)
            if options.car is None and tire is None:
                return main(options)
            cli.check_opengl()  # before MuJoCo is imported
            with _meant(options.car, tire) as car:
                defaults = {field.name: field.default for field in fields(options)}
                own = {
                    name: Path(place.format(car=car.name)) for name, place in places.items()
                    if getattr(options, name) == defaults[name]
                }
                return main(replace(options, **own))

        return run

    return decorate


@contextmanager
def _meant(place: Path | None, tire: Path | None) -> Iterator[Any]:
    """Mean the car of the options; says what of a tire file is not honoured."""
    from lpvmpc.plant.car_folder import driving

    if tire is None:
        with driving(place) as car:
            yield car
        return
    from lpvmpc.plant.garage import driving_on

    with driving_on(place, tire) as (car, file):
        if file.zero:
            print(f"{tire} does not give {', '.join(file.zero)}: zero.", file=sys.stderr)
        if file.ignored:
            print(f"Not honoured of {tire}:", *file.sentences(), sep="\n  ", file=sys.stderr)
        yield car


def folder_of(place: Path | None) -> Path | None:
    """Folder in which what is made for a car belongs; None for a file alone or no car."""
    return place if place is not None and place.is_dir() else None
