"""Files that were whole and are damaged now: none may be taken for what it was not.

Each kind of file that the package writes and reads again is written small, damaged in many ways and
read. The answer counts as `refused` where reading raises a sentence (or, for a kept result, drives
anew), as `harmless` where the same content was read, as `told` where a warning says that nothing
vouches for it, and as `silent` where other content was taken for good. `raised` is an exception
that is no sentence. The last two are faults.
"""

from __future__ import annotations

import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.control.stiffness import network_file
from lpvmpc.control.weights_file import read_weights, write_weights
from lpvmpc.errors import LPVMPCError
from lpvmpc.kit import safetensors
from lpvmpc.learn import columns, dataset
from lpvmpc.sim import batch
from lpvmpc.tune import checkpoint

WAYS = ("byte", "bit", "zeros", "cut", "gap", "doubled", "noise")
"""How files are damaged: a byte or a bit changed, a stretch zeroed, the end lost, a stretch lost,
a stretch twice, a stretch of noise."""
FAULTS = ("silent", "raised")
"""Outcomes that must not be."""


@dataclass(frozen=True, kw_only=True)
class Subject:
    """A kind of file."""

    name: str
    """What it is called in the report."""
    write: Callable[[Path], Any]
    """Writes a whole one at a path."""
    read: Callable[[Path], Any]
    """Reads one: content that can be compared, or None where it is to be made anew."""


@dataclass(frozen=True, kw_only=True)
class Damaged:
    """How a kind of file fared."""

    name: str
    """The kind."""
    outcomes: Counter[str]
    """How often what was answered."""
    examples: tuple[str, ...]
    """Faults, one line each."""


class Told(Exception):
    """A warning said that nothing vouches for the content."""


def damaged(raw: bytes, rng: np.random.Generator) -> bytes:
    """The bytes of a file after some damage, never the same bytes."""
    while True:
        way = WAYS[int(rng.integers(len(WAYS)))]
        at = int(rng.integers(len(raw)))
        to = min(at + int(rng.integers(1, 200)), len(raw))
        new = bytearray(raw)
        if way == "byte":
            new[at] ^= int(rng.integers(1, 256))
        elif way == "bit":
            new[at] ^= 1 << int(rng.integers(8))
        elif way == "zeros":
            new[at:to] = bytes(to - at)
        elif way == "cut":
            del new[at:]
        elif way == "gap":
            del new[at:to]
        elif way == "doubled":
            new[at:at] = new[at:to]
        else:
            new[at:to] = rng.bytes(to - at)
        if bytes(new) != raw:
            return bytes(new)


def fuzz(subject: Subject, count: int, seed: int = 0) -> Damaged:
    """Damage a file of a kind so many times, and read it each time."""
    outcomes, examples = Counter[str](), list[str]()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "file"
        subject.write(file)
        raw, whole = file.read_bytes(), subject.read(file)
        for i in range(count):
            file.write_bytes(damaged(raw, np.random.default_rng([seed, i])))
            outcome, what = _read(subject, file, whole)
            outcomes[outcome] += 1
            if outcome in FAULTS:
                examples.append(f"{i}: {outcome}: {what}")
    return Damaged(name=subject.name, outcomes=outcomes, examples=tuple(examples))


def _read(subject: Subject, file: Path, whole: Any) -> tuple[str, str]:
    """The outcome of reading a damaged file, and what was said."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            found = subject.read(file)
    except (Told, UserWarning) as word:
        return "told", str(word)
    except LPVMPCError as error:
        return "refused", str(error)
    except Exception as error:
        return "raised", repr(error)
    if found is None:
        return "refused", "made anew"
    return ("harmless", "") if _same(found, whole) else ("silent", "other content")


def _same(one: Any, other: Any) -> bool:
    """Whether two contents are equal, arrays among them."""
    if isinstance(one, np.ndarray) or isinstance(other, np.ndarray):
        return type(one) is type(other) and one.dtype == other.dtype and np.array_equal(one, other)
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_same, one, other))
    return bool(one == other)


# Kinds -------------------------------------------------------------------------------------------


def _write_data(file: Path) -> None:
    rng = np.random.default_rng(0)
    values: dict[str, Any] = {}
    for name in dataset.COLUMNS:
        low, high = columns.RANGES.get(name, (0, 0))
        values[name] = rng.uniform(max(low, -1e3), min(high, 1e3), 60)
    values["run"] = np.repeat(np.arange(3, dtype=np.int32), 20)
    values["manoeuvre"] = np.repeat(["slalom", "brake", "circle"], 20)
    dataset.write(file, values, {"seed": 0})


def _read_data(file: Path) -> Any:
    data = dataset.read(file)
    if not data.checked:
        raise Told("no checksum")
    return dict(data.columns), data.meta


def _network(kind: str) -> Subject:
    shipped = network_file.shipped(kind).read_bytes()

    def read(file: Path) -> Any:
        weights = network_file.load_weights(kind, file)
        return weights.arrays, weights.metadata

    return Subject(name=f"{kind} weights", write=lambda file: file.write_bytes(shipped), read=read)


def _write_tuned(file: Path) -> None:
    write_weights(file, "stanley", {"k_e": 2.5, "kp": 20.0, "ki": 1.0 / 3.0}, {"seed": 0})


def _write_training(file: Path) -> None:
    rng = np.random.default_rng(0)
    arrays = {"parameters": rng.normal(size=(2, 40)), "progress": np.array([3, 60])}
    safetensors.write(file, arrays, {"preset": "default", "networks": "2"})


def _read_training(file: Path) -> Any:
    arrays, facts = safetensors.read(file)
    if safetensors.SHA256 not in facts:
        raise Told("no checksum")  # `learn.train` refuses it
    return arrays, facts


def _state() -> checkpoint.SearchState:
    rng = np.random.default_rng(0)
    best = checkpoint.frozen(rng.uniform(size=4))
    return checkpoint.SearchState(
        method="genetic",
        settings={"population": 6, "generations": 9},
        lower=checkpoint.frozen(np.zeros(4)),
        upper=checkpoint.frozen(np.ones(4)),
        generator=dict(rng.bit_generator.state),
        arrays={"individuals": checkpoint.frozen(rng.uniform(size=(6, 4))),
                "costs": checkpoint.frozen(rng.uniform(size=6))},
        history=(checkpoint.Generation(0.1, 0.2, 0.3, best),),
        evaluations=6,
    )


def _write_search(file: Path) -> None:
    checkpoint.write(file, _TASK, [_state()])


def _read_search(file: Path) -> Any:
    return [state.to_json() for state in checkpoint.read(file, _TASK)]


_TASK = {"controller": "stanley", "seed": 0}


_KEY = "0" * 32


def _write_result(file: Path) -> None:
    result = dict.fromkeys(batch.KEPT, 0.25) | {"scenario": "paper", "completed": True}
    batch.keep_result(file.parent, _KEY, result)
    (file.parent / f"{_KEY}.json").replace(file)


def _read_result(file: Path) -> Any:
    kept = file.parent / f"{_KEY}.json"
    kept.write_bytes(file.read_bytes())
    return batch.read_result(file.parent, _KEY)


def subjects() -> list[Subject]:
    """The kinds of files."""
    return [
        Subject(name="data set", write=_write_data, read=_read_data),
        _network("network"),
        _network("network-secant"),
        Subject(name="tuned weights", write=_write_tuned, read=read_weights),
        Subject(name="checkpoint of a training", write=_write_training, read=_read_training),
        Subject(name="checkpoint of a tuning", write=_write_search, read=_read_search),
        Subject(name="kept result", write=_write_result, read=_read_result),
    ]
