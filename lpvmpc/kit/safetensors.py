"""Named arrays and texts in a safetensors file: nothing in it that could be executed.

The package `safetensors` does the work; here the same content is made to give the same bytes,
and what is wrong with a file is said in one sentence. The text `sha256` is the checksum of all
arrays and of the other texts; a file that has one must fit it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from safetensors import SafetensorError
from safetensors.numpy import load, save

from lpvmpc.errors import DataError
from lpvmpc.kit.files import MOST, read_bytes, whole

SHA256 = "sha256"
"""Name of the text that is the checksum."""
LARGEST = 256 * MOST
"""Largest file that is read [bytes]."""


def write(
    file: str | os.PathLike[str], arrays: dict[str, npt.NDArray[Any]], metadata: dict[str, str]
) -> None:
    """Write arrays and texts, whole or not at all, with their checksum.

    Raises:
        OutputError: The file cannot be written.
    """
    arrays = {name: np.ascontiguousarray(arrays[name]) for name in sorted(arrays)}
    metadata = {**metadata, SHA256: checksum(arrays, metadata)}
    header, data = _header(save(arrays, metadata))
    header["__metadata__"] = dict(sorted(metadata.items()))  # the package has them in any order
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # the arrays begin aligned
    with whole(file) as part:
        part.write_bytes(len(text).to_bytes(8, "little") + text + data)


def read(file: str | os.PathLike[str]) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
    """Arrays and texts of a file, whose checksum is among them if it has one.

    Raises:
        DataError: It is missing, damaged, or not of this format.
    """
    path = Path(file)
    try:
        raw = read_bytes(path, LARGEST)
    except FileNotFoundError:
        raise DataError(f"There is no file {str(path)!r}.") from None
    except OSError as error:
        raise DataError(f"Cannot read {str(path)!r}: {error.strerror or error}.") from error
    try:
        arrays = dict(sorted(load(raw).items()))
        metadata: dict[str, str] = _header(raw)[0].get("__metadata__", {})
        if SHA256 in metadata and metadata[SHA256] != checksum(arrays, metadata):
            raise ValueError("its checksum is another")
    except (SafetensorError, ValueError, KeyError, RecursionError) as error:
        why = " ".join(str(error).split())  # KeyError: a type that NumPy lacks
        raise DataError(f"{str(path)!r} is damaged or no safetensors file: {why}.") from error
    return arrays, metadata


def checksum(arrays: Mapping[str, npt.NDArray[Any]], metadata: Mapping[str, str]) -> str:
    """SHA-256 of arrays and texts, whatever their order; the text `sha256` is left out."""
    texts = {key: text for key, text in metadata.items() if key != SHA256}
    digest = hashlib.sha256(json.dumps(texts, sort_keys=True).encode())
    for name in sorted(arrays):
        array = arrays[name]
        digest.update(f"\0{name}\0{array.dtype.str}\0{array.shape}\0".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _header(raw: bytes) -> tuple[dict[str, Any], bytes]:
    """Header and data of a file, which begins with eight bytes that give the header's length."""
    begin = 8 + int.from_bytes(raw[:8], "little")
    return json.loads(raw[8:begin]), raw[begin:]
