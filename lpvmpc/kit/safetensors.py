"""Named arrays in a safetensors file: numbers and text, nothing that could be executed.

The format: eight bytes with the length of a JSON header, the header (name -> dtype, shape, offsets;
`__metadata__` -> text by text), then the arrays. Written here with sorted names, so that the same
content gives the same bytes.

Source: github.com/huggingface/safetensors, "Format".
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import DataError
from lpvmpc.kit.files import whole

TYPES = {"F64": np.float64, "F32": np.float32, "I64": np.int64}
"""Types that are read and written."""
HEADER_MAX = 10_000_000
"""A longer header is not one of ours [bytes]."""


def write(
    file: str | os.PathLike[str],
    arrays: dict[str, npt.NDArray[Any]],
    metadata: dict[str, str],
) -> None:
    """Write arrays and texts, whole or not at all.

    Raises:
        OutputError: The file cannot be written.
    """
    header: dict[str, Any] = {"__metadata__": dict(sorted(metadata.items()))}
    blobs, offset = [], 0
    names = {np.dtype(dtype): name for name, dtype in TYPES.items()}
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        blob = array.astype(array.dtype.newbyteorder("<")).tobytes()
        header[name] = {
            "dtype": names[array.dtype],
            "shape": list(array.shape),
            "data_offsets": [offset, offset + len(blob)],
        }
        blobs.append(blob)
        offset += len(blob)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # the arrays begin aligned
    with whole(file) as part:
        part.write_bytes(len(text).to_bytes(8, "little") + text + b"".join(blobs))


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
        return _parse(raw)
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"{str(path)!r} is damaged or no safetensors file: {why}.") from error


def _parse(raw: bytes) -> tuple[dict[str, npt.NDArray[Any]], dict[str, str]]:
    """Arrays and texts; any exception means that the bytes are not of the format."""
    size = int.from_bytes(raw[:8], "little")
    if len(raw) < 8 or not 2 <= size <= min(HEADER_MAX, len(raw) - 8):
        raise ValueError("its header is cut off")
    header = json.loads(raw[8 : 8 + size])
    metadata = {str(k): str(v) for k, v in header.pop("__metadata__", {}).items()}
    data = memoryview(raw)[8 + size :]
    arrays, end = {}, 0
    for name, entry in header.items():
        dtype = np.dtype(TYPES[entry["dtype"]]).newbyteorder("<")
        first, last = entry["data_offsets"]
        shape = tuple(int(n) for n in entry["shape"])
        if not (0 <= first <= last <= len(data)) or min(shape, default=0) < 0:
            raise ValueError("its arrays are cut off")
        array = np.frombuffer(data[first:last], dtype).reshape(shape)
        arrays[name] = array.astype(dtype.newbyteorder("="))
        end = max(end, last)
    if end != len(data):
        raise ValueError(f"it has {len(data) - end} bytes too many")
    return arrays, metadata
