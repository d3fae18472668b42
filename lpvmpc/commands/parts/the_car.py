"""The option `--car` of every command that drives, simulates or learns a car.

A command gives its options a field `car: CarPlace = None`, and decorates its main:

    @with_car(out="runs/{car}/worlds")
    def main(options: Options) -> int: ...

Files that are published are the packaged car's: where a car is given, results go to the folders
that the decorator names, unless the command line names others.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
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
OptionsT = TypeVar("OptionsT", bound=Any)


def with_car(**places: str) -> Callable[[Callable[[OptionsT], int]], Callable[[OptionsT], int]]:
    """A command's `main` during which the car of its option `car` is meant.

    Args:
        places: Other defaults of options, with {car} for the car's name.
    """

    def decorate(main: Callable[[OptionsT], int]) -> Callable[[OptionsT], int]:
        @functools.wraps(main)
        def run(options: OptionsT) -> int:
            if options.car is None:
                return main(options)
            cli.check_opengl()  # before MuJoCo is imported
            from lpvmpc.plant.car_folder import driving

            with driving(options.car) as car:
                defaults = {field.name: field.default for field in fields(options)}
                own = {
                    name: Path(place.format(car=car.name)) for name, place in places.items()
                    if getattr(options, name) == defaults[name]
                }
                return main(replace(options, **own))

        return run

    return decorate


def folder_of(place: Path | None) -> Path | None:
    """Folder in which what is made for a car belongs; None for a file alone or no car."""
    return place if place is not None and place.is_dir() else None
