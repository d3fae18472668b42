"""Named arrays and texts in a safetensors file: nothing in it that could be executed.

The package `safetensors` does the work; here the same content is made to give the same bytes,
and what is wrong with a file is said in one sentence.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

from lpvmpc.errors import DataError
from lpvmpc.kit.files import whole


def write(
    file: str | os.PathLike[str], arrays: dict[str, npt.NDArray[Any]], metadata: dict[str, str]
) -> None:
    """Write arrays and texts, whole or not at all.

    Raises:
        OutputError: The file cannot be written.
    """
    raw = save({name: np.ascontiguousarray(arrays[name]) for name in sorted(arrays)}, metadata)
    header, data = _header(raw)
    header["__metadata__"] = dict(sorted(metadata.items()))  # the package has them in any order
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # the arrays begin aligned
    with whole(file) as part:
        part.write_bytes(len(text).to_bytes(8, "little") + text + data)


def read(file: str | os.PathLike[str]) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
    """Arrays and texts of a file.

    Raises:
        DataError: It is missing, cut off, or not of this format.
    """
    path = Path(file)
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise DataError(f"There is no file {str(path)!r}.") from None
    except OSError as error:
        raise DataError(f"Cannot read {str(path)!r}: {error.strerror or error}.") from error
    try:
        return dict(sorted(load(raw).items())), _header(raw)[0].get("__metadata__", {})
    except (SafetensorError, ValueError, KeyError) as error:  # KeyError: a type that NumPy lacks
        why = " ".join(str(error).split())
        raise DataError(f"{str(path)!r} is damaged or no safetensors file: {why}.") from error


def _header(raw: bytes) -> tuple[dict[str, Any], bytes]:
    """Header and data of a file, which begins with eight bytes that give the header's length."""
    begin = 8 + int.from_bytes(raw[:8], "little")
    return json.loads(raw[8:begin]), raw[begin:]
