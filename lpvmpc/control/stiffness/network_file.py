"""Files of trained networks: reading the weights, and checking what they hold."""

from __future__ import annotations

import json
import os
import warnings
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.car.current import current
from lpvmpc.errors import DataError, OptionError
from lpvmpc.kit import safetensors

FORMAT = "lpvmpc-network-1"
"""Name and version of the weights' format, kept in the file's metadata."""
N_EVEN = 3
"""Number of features beside the slip: roll moment, longitudinal force, load."""
SECANT_INPUTS = ("vx_mps", "vy_mps", "delta_rad", "ax_mps2", "r_radps")
"""Inputs of the paper's network, columns of the data."""
SECANT_SIZES = (5, 16, 28, 16, 9, 2)
"""Sizes of the paper's network."""


@dataclass(frozen=True)
class Weights:
    """A trained network: its arrays, and where it comes from."""

    kind: str
    """`network` or `network-secant`."""
    arrays: dict[str, npt.NDArray[Any]]
    """Arrays by name, checked."""
    metadata: dict[str, str]
    """Texts of the file: hashes of data and car, command, seed, versions, R2."""


def shipped(kind: str) -> Path:
    """File of the weights that come with the package."""
    return Path(str(resources.files("lpvmpc.control") / "weights" / f"{kind}.safetensors"))


def made_for_the_car(kind: str) -> Path:
    """File of the weights of the car that is meant: in its folder, or the packaged one."""
    car = current()
    own = None if car is None or car.folder is None else car.folder / f"{kind}.safetensors"
    return own if own is not None and own.is_file() else shipped(kind)


def load_weights(kind: str, file: str | os.PathLike[str] | None = None) -> Weights:
    """Read and check weights; a warning tells where a file of before has no checksum.

    Args:
        kind: `network` or `network-secant`.
        file: A safetensors file (default: the one in the folder of `--car`, or the packaged one).

    Raises:
        DataError: The file is missing, damaged, of another format, kind or shape, not finite, or
            trained on another car than the one of `--car`.
    """
    if kind not in ("network", "network-secant"):
        raise OptionError("kind", kind, "'network' or 'network-secant'")
    path = made_for_the_car(kind) if file is None else Path(file)
    arrays, metadata = safetensors.read(path)
    if (car := current()) is not None and metadata.get("car_sha256") != car.sha256:
        own = "" if path.parent != shipped(kind).parent else "none was trained on it, and "
        raise DataError(
            f"{car} has no {kind} of its own: {own}{str(path)!r} is of a car of hash "
            f"{metadata.get('car_sha256', '')[:12]}, not {car.sha256[:12]}; lpvmpc collect and "
            f"lpvmpc train with --car {car} make one, and --stiffness constant needs none."
        )
    if metadata.get("format") != FORMAT:
        raise DataError(
            f"The weights {str(path)!r} have the format {metadata.get('format')!r}, but must have "
            f"{FORMAT!r}; data_gen/train.py makes them anew."
        )
    if metadata.get("kind") != kind:
        raise DataError(
            f"The weights {str(path)!r} are of a {metadata.get('kind')!r}, but must be of a "
            f"{kind!r}."
        )
    for name, shape in _shapes(kind, arrays).items():
        found = arrays[name].shape if name in arrays else None
        if found != shape:
            raise DataError(
                f"The weights {str(path)!r} have {name} of shape {found}, but must have {shape}."
            )
        if not np.isfinite(arrays[name]).all():
            raise DataError(f"The weights {str(path)!r} have a {name} that is not finite.")
    if safetensors.SHA256 not in metadata:
        warnings.warn(
            f"The weights {str(path)!r} have no checksum, so damage to them cannot be told; "
            "data_gen/train.py writes one.",
            stacklevel=2,
        )
    return Weights(kind, arrays, metadata)


def _shapes(kind: str, arrays: dict[str, npt.NDArray[Any]]) -> dict[str, tuple[int, ...]]:
    """Names and shapes that weights must have."""
    if kind == "network":
        n = arrays["u"].shape[-1] if "u" in arrays and arrays["u"].ndim == 2 else 0
        shapes: dict[str, tuple[int, ...]] = {name: (2, max(n, 1)) for name in ("u", "b", "w")}
        shapes |= {"V": (2, max(n, 1), N_EVEN), "slip_max": (2,)}
        return shapes | {"z_low": (2, N_EVEN), "z_high": (2, N_EVEN)}
    shapes = {}
    for i, (n, m) in enumerate(zip(SECANT_SIZES[:-1], SECANT_SIZES[1:], strict=True)):
        shapes |= {f"W{i}": (m, n), f"b{i}": (m,)}
    for name in ("x_mean", "x_std", "x_low", "x_high"):
        shapes[name] = (SECANT_SIZES[0],)
    return shapes | {"y_mean": (2,), "y_std": (2,)}


def facts(weights: Weights) -> dict[str, Any]:
    """What the weights say about themselves, for records: texts that hold JSON are decoded."""
    decoded: dict[str, Any] = {}
    for key, text in weights.metadata.items():
        try:
            decoded[key] = json.loads(text)
        except ValueError:
            decoded[key] = text
    return decoded
