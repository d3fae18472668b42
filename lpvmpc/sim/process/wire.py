"""What goes between the closed loop and a controller's process, and in which bytes.

A message is one letter, the length of its payload, and the payload. What the controller's process
sends is numbers and JSON only, and is checked like any other input: nothing of it is ever run.
"""

from __future__ import annotations

import json
import math
import struct
from typing import Any, NamedTuple

import numpy as np

from lpvmpc.errors import LPVMPCError
from lpvmpc.interface import (
    FALLBACKS,
    AxleForces,
    Command,
    Diagnostics,
    Preview,
    State,
)
from lpvmpc.sim.driver import Answer

HEADER = struct.Struct("<cI")
"""Letter and length of the payload [bytes]."""
MAX_PAYLOAD = 1 << 20
"""Longest payload that is read [bytes]; a preview of 3000 periods has 120 kB."""
LOAD, RESET, ASK, END = b"L", b"R", b"A", b"E"
"""To the controller's process: what to make, forget the last run, one instant, say farewell."""
READY, ABOUT, DONE, COMMAND, COUNT, FAILED = b"y", b"a", b"d", b"c", b"n", b"f"
"""From it: it runs, what the controller says of itself, reset, its command, clamped inputs, error.
"""
_FIXED = struct.Struct("<4d?b4d3i")
_KINDS: tuple[Any, ...] = (State, Preview, AxleForces)


class WireError(LPVMPCError):
    """Bytes that are no message."""


def pack(kind: bytes, payload: bytes = b"") -> bytes:
    """A whole message."""
    return HEADER.pack(kind, len(payload)) + payload


def instant(t: float, state: State, preview: Preview, axles: AxleForces | None) -> bytes:
    """What a controller is given at one instant, as payload."""
    lengths: list[int] = []
    parts: list[Any] = [(t,)]
    for given in (state, preview, axles or ()):
        fields: list[Any] = list(given)
        lengths.append(len(fields))
        for value in fields:
            if type(value) is np.ndarray:
                lengths.append(len(value))
                parts.append(value)
            elif value is None:
                lengths.append(-2)
            else:
                lengths.append(-1)
                parts.append((value,))
    head = struct.pack(f"<i{len(lengths)}i", len(lengths), *lengths)
    return head + np.concatenate(parts, dtype=np.float64).tobytes()


def of_instant(payload: bytes) -> tuple[float, State, Preview, AxleForces | None]:
    """The inverse of `instant`; arrays are views of one new array."""
    (n,) = struct.unpack_from("<i", payload)
    lengths = iter(struct.unpack_from(f"<{n}i", payload, 4))
    numbers = np.frombuffer(payload, dtype=np.float64, offset=4 + 4 * n).copy()
    found: list[Any] = []
    i = 1
    for kind in _KINDS:
        values: list[Any] = []
        for _ in range(next(lengths)):
            length = next(lengths)
            if length == -2:
                values.append(None)
            elif length == -1:
                values.append(float(numbers[i]))
                i += 1
            else:
                values.append(numbers[i : i + length])
                i += length
        found.append(kind._make(values) if values else None)
    state, preview, axles = found
    return float(numbers[0]), state, preview, axles


def answer(given: Answer) -> bytes:
    """What came of asking a controller once, as payload."""
    told = given.told
    d = Diagnostics(prediction=np.zeros((0, 5))) if told is None else told
    prediction = np.ascontiguousarray(d.prediction, dtype=np.float64)
    fixed = _FIXED.pack(
        *given.command, given.cpu_us, given.wall_us, d.solved, FALLBACKS.index(d.fallback),
        d.kkt_residual, d.build_us, d.solve_us, d.check_us, *prediction.shape, told is not None,
    )
    return fixed + prediction.tobytes()


def of_answer(payload: bytes, Np: int) -> Answer:
    """The inverse of `answer`, everything checked.

    Raises:
        WireError: It is no answer of a controller with this horizon [periods].
    """
    try:
        (delta, ax, cpu, wall, solved, fallback, kkt, build, solve, check, rows, columns,
         told) = _FIXED.unpack_from(payload)
        prediction = np.frombuffer(payload, dtype=np.float64, offset=_FIXED.size)
        prediction = prediction.reshape(rows, columns)
        name = FALLBACKS[fallback]
    except (struct.error, ValueError, IndexError) as error:
        raise WireError("It is no answer.") from error
    numbers = (delta, ax, cpu, wall)
    shape = prediction.shape in ((0, 5), (Np + 1, 5))
    if not (all(map(math.isfinite, numbers)) and cpu >= 0.0 and shape and fallback >= 0):
        raise WireError("It is no answer.")
    diagnostics = None
    if told:
        diagnostics = Diagnostics(
            solved=solved, fallback=name, kkt_residual=kkt, build_us=build, solve_us=solve,
            check_us=check, prediction=prediction,
        )
    return Answer(Command(delta, ax), diagnostics, cpu, wall)


def text(value: Any) -> bytes:
    """Something as a payload of JSON."""
    return json.dumps(value).encode()


def of_text(payload: bytes) -> Any:
    """The inverse of `text`.

    Raises:
        WireError: It is no JSON.
    """
    try:
        return json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise WireError("It is no JSON.") from error


class Spec(NamedTuple):
    """What a controller's process is to make; sent by the closed loop, pickled."""

    controller: str
    """Name, or module:Class."""
    options: dict[str, Any]
    """Options of `load_controller`."""
    name: str | None
    """What to call it; None: as it says."""
