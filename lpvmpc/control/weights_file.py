"""Controller weights in TOML files: what `eval/tune.py` writes and `eval/track.py --weights` reads.

    controller = "lpv-mpc"
    sha256 = "2b4c..."

    [weights]
    q_ey = 80.0

    [record]
    seed = 0

`weights` may name some of the controller's weights or all of them; those it leaves out keep the
values that were set by hand. `record` says where the weights come from, and is not read. `sha256`
is the checksum of all else in the file (`kit.files.checksum`), which `write_weights` puts there and
a file written by hand needs not have; where it is there, it must fit. The package's own files lie
in `lpvmpc/control/weights/`.
"""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from lpvmpc.car.current import current, per_car
from lpvmpc.errors import DataError, OptionError
from lpvmpc.kit.files import checksum, read_toml, reading, write_text

WeightsT = TypeVar("WeightsT")
PARTS = ("controller", "sha256", "weights", "record")
"""What a file may hold."""
LARGEST = 1e6
"""Largest weight of any controller: beside a larger one, the others are lost in rounding."""


def check_weights(weights: Any) -> None:
    """Refuse weights that are no numbers from 0 to `LARGEST`.

    Args:
        weights: A dataclass of weights.

    Raises:
        OptionError: With the weight's name.
    """
    for field in fields(weights):
        value = getattr(weights, field.name)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and 0.0 <= value <= LARGEST):  # NaN fails it too
            raise OptionError(
                f"weight {field.name}", value, f"a number of at least 0 and at most {LARGEST:g}"
            )


def read_weights(file: str | os.PathLike[str], controller: str | None = None) -> dict[str, float]:
    """Named weights from a file.

    Args:
        file: A TOML file as above.
        controller: The controller they must be for (default: any).

    Raises:
        DataError: The file is missing, no TOML, damaged, for another controller, or holds something
            that is no number.
    """
    path = os.fspath(file)
    with reading(f"Weights file {path!r}", "TOML file"):
        content = read_toml(path)
    for name in content:
        if name not in PARTS:
            raise DataError(f"Weights file {path!r} holds {name!r}, but may hold only "
                            f"{', '.join(PARTS)}.")
    told = content.pop("sha256", None)
    if told is not None and told != _checksum(content):
        raise DataError(f"Weights file {path!r} was changed since it was written: its checksum is "
                        "another; without its line sha256 it is read as written by hand.")
    weights = content.get("weights")
    if not isinstance(weights, dict) or not weights:
        raise DataError(f"Weights file {path!r} has no table [weights] with a number per weight.")
    tuned_for = content.get("controller")
    if not isinstance(tuned_for, str):
        raise DataError(f"Weights file {path!r} does not say for which controller: "
                        'controller = "NAME".')
    if controller is not None and tuned_for != controller:
        raise DataError(f"Weights file {path!r} is for controller {tuned_for!r}, but "
                        f"{controller!r} drives.")
    for name, value in weights.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise DataError(f"Weights file {path!r}: {name} is {value!r}, but must be a number.")
    return {name: float(value) for name, value in weights.items()}


def write_weights(
    file: str | os.PathLike[str],
    controller: str,
    weights: Mapping[str, float],
    record: Mapping[str, Any],
) -> None:
    """Write a weights file, whole or not at all.

    Args:
        file: Where to.
        controller: Name of the controller.
        weights: Value of each weight; written so that reading gives the same floats.
        record: Where they come from: strings, numbers and lists of them.

    Raises:
        OutputError: It cannot be written.
    """
    values = {name: float(value) for name, value in weights.items()}
    content = {"controller": controller, "weights": values, "record": dict(record)}
    lines = [f"controller = {json.dumps(controller)}", f'sha256 = "{_checksum(content)}"', ""]
    lines += ["[weights]"]
    lines += [f"{name} = {value!r}" for name, value in values.items()]
    lines += ["", "[record]"]
    # JSON's strings, numbers and lists are TOML's as well
    lines += [f"{name} = {json.dumps(value)}" for name, value in record.items()]
    write_text(file, "\n".join(lines) + "\n")


def _checksum(content: Mapping[str, Any]) -> str:
    """Checksum of a file's content; a time in a record counts by its text."""
    return checksum(json.loads(json.dumps(content, default=str)))


def apply(weights: WeightsT, changes: Mapping[str, float], source: str = "weights") -> WeightsT:
    """A controller's weights with some replaced.

    Args:
        weights: A dataclass of weights.
        changes: New values by name.
        source: Where they come from, for messages.

    Raises:
        OptionError: There is no such weight, or its value means nothing.
    """
    names = [field.name for field in fields(weights)]  # type: ignore[arg-type]
    for name in changes:
        if name not in names:
            raise OptionError(f"{source}: weight", name, f"one of {', '.join(names)}")
    return replace(weights, **changes)  # type: ignore[type-var]


def shipped_file(controller: str) -> Path:
    """Where the package keeps a controller's tuned weights; a rival's lie beside it."""
    package = Path(str(resources.files("lpvmpc.control")))
    beside = package / "rivals" / "weights" / f"{controller}.toml"
    return beside if beside.exists() else package / "weights" / f"{controller}.toml"


def shipped(controller: str, by_hand: WeightsT) -> WeightsT:
    """The weights a controller drives with where none are given.

    Args:
        controller: Name of the controller.
        by_hand: Its weights as set by hand, for those that the package's file does not name.

    Raises:
        DataError: The package's file is damaged.
    """
    return apply(by_hand, _shipped(controller), f"{controller}.toml")


@per_car
def _shipped(controller: str) -> dict[str, float]:
    file = shipped_file(controller)
    if (car := current()) is not None and car.folder is not None:
        own = car.folder / "weights" / f"{controller}.toml"
        if own.is_file():
            check_car(own)
            return read_weights(own, controller)
        if file.exists():
            warnings.warn(
                f"No weights of {controller} were tuned on {car}; those tuned on the packaged car "
                "are used.", stacklevel=2,
            )
    return read_weights(file, controller) if file.exists() else {}


def check_car(file: str | os.PathLike[str]) -> None:
    """Refuse weights that were tuned on another car than the one that is meant.

    Args:
        file: A readable weights file; one whose record names no car is of the packaged one.

    Raises:
        DataError: They were.
    """
    car, record = current(), read_toml(file).get("record", {})
    told = str(record.get("car_sha256", "")) if isinstance(record, dict) else ""
    if car is not None and told != car.sha256:
        whose = f"a car of hash {told[:12]}" if told else "the packaged car"
        raise DataError(
            f"The weights {os.fspath(file)!r} were tuned on {whose}, but {car} has "
            f"{car.sha256[:12]}; lpvmpc tune --car {car} makes its own."
        )


def chosen(
    controller: str, weights: WeightsT | Mapping[str, float] | None, by_hand: WeightsT
) -> WeightsT:
    """The weights meant by a maker's argument: a dataclass, names with numbers, or None.

    Names with numbers change the weights set by hand: a file gives the same car on every version.

    Raises:
        OptionError: They are nothing of all that.
    """
    if weights is None:
        return shipped(controller, by_hand)
    if isinstance(weights, Mapping):
        return apply(by_hand, weights)
    if not is_dataclass(weights):
        raise OptionError("weights", weights, f"names with numbers, or {type(by_hand).__name__}")
    return weights


def as_dict(weights: Any) -> dict[str, float]:
    """Weights as a plain dictionary."""
    return {name: float(value) for name, value in asdict(weights).items()}
