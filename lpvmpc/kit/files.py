"""Files that are whole or not there: written beside their place, and renamed when complete."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.errors import LPVMPCError, OutputError
from lpvmpc.kit.signals import ctrl_c_waits

if TYPE_CHECKING:
    import numpy.typing as npt
    from matplotlib.figure import Figure


@contextmanager
def writing(place: str | os.PathLike[str], *, into: bool = False) -> Iterator[None]:
    """Say in one sentence what cannot be written.

    Args:
        place: What is written, for the sentence.
        into: Whether it is a folder that is written into.

    Raises:
        OutputError: In place of an OSError of the body.
    """
    try:
        yield
    except LPVMPCError:  # some are OSErrors too, and say what they mean
        raise
    except OSError as error:
        what = f"{'into ' if into else ''}{os.fspath(place)!r}"
        raise OutputError(f"Cannot write {what}: {error.strerror or error}.") from error


@contextmanager
def whole(file: str | os.PathLike[str]) -> Iterator[Path]:
    """Where to write a file that appears under its name only when it is whole.

        with whole("trace.parquet") as part:
            part.write_bytes(...)

    Args:
        file: The file's name; its folder must be there, an older file of that name is replaced.

    Yields:
        A name beside it, ending in `.part`. If the body raises, what it wrote there is removed.

    Raises:
        OutputError: The file cannot be written: an OSError of the body, or of the renaming.
    """
    path = Path(file)
    # the process in the name: one that was told to stop may still be writing the same file
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with writing(path):
            yield part
            os.replace(part, path)
    finally:
        with suppress(OSError):
            part.unlink(missing_ok=True)


@contextmanager
def into(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """A folder to write files into, made where it is missing.

    Raises:
        OutputError: It cannot be made, or an OSError of the body.
    """
    path = Path(folder)
    with writing(path, into=True):
        path.mkdir(parents=True, exist_ok=True)
        yield path


@contextmanager
def replacing(folder: str | os.PathLike[str], names: Sequence[str]) -> Iterator[Path]:
    """A folder for results that replace the earlier ones all at once.

    The earlier ones stay until the body is through; if it raises, they stay for good. Ctrl-C waits
    while they are exchanged.

    Args:
        folder: An existing folder, which may hold earlier results and other files.
        names: Names of the results, patterns like `figures/*.png` among them. The first goes first
            and comes last: where it is, all is there.

    Yields:
        An empty folder, in which the body writes under the same names.

    Raises:
        OutputError: The folder cannot be written.
    """
    path = Path(folder)
    part = path / f".new.{os.getpid()}.part"
    try:
        with writing(path, into=True):
            part.mkdir()
            yield part
            new = [file for name in reversed(names) for file in sorted(part.glob(name))]
            with ctrl_c_waits():
                for name in names:
                    for file in path.glob(name):
                        file.unlink()
                for file in new:
                    target = path / file.relative_to(part)
                    target.parent.mkdir(exist_ok=True)
                    os.replace(file, target)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def readable(name: str | os.PathLike[str]) -> str:
    """The name of a file as text; bytes that are no text become the replacement character."""
    return os.fsencode(name).decode("utf-8", "replace")


def write_text(file: str | os.PathLike[str], text: str) -> None:
    """Write a text in UTF-8, whole or not at all.

    Raises:
        OutputError: The file cannot be written.
    """
    with whole(file) as part:
        part.write_text(text, encoding="utf-8", newline="")


def write_json(file: str | os.PathLike[str], value: object) -> None:
    """Write a value as JSON, whole or not at all.

    Raises:
        ValueError: A number is not finite, which JSON does not have.
        OutputError: The file cannot be written.
    """
    write_text(file, json.dumps(value, indent=2, allow_nan=False) + "\n")


def write_picture(file: str | os.PathLike[str], figure: Figure, dpi: int) -> None:
    """Write a figure as PNG, whole or not at all, without the version of the library in it.

    Raises:
        OutputError: The file cannot be written.
    """
    with whole(file) as part:
        figure.savefig(part, format="png", dpi=dpi, metadata={"Software": None})


def write_table(
    file: str | os.PathLike[str], columns: Mapping[str, npt.NDArray[Any]], facts: Mapping[str, Any]
) -> None:
    """Write columns of equal length as Parquet, whole or not at all.

    The bytes depend on the arguments and on pyarrow's version alone: fixed settings, keys of the
    metadata sorted, no times.

    Args:
        file: The file.
        columns: Arrays of shape (n,) by name; the names carry the units.
        facts: Metadata by name: values that JSON can hold.

    Raises:
        OutputError: The file cannot be written.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    metadata = {key: json.dumps(facts[key], sort_keys=True) for key in sorted(facts)}
    table = pa.table({name: pa.array(column) for name, column in columns.items()})
    with whole(file) as part:
        pq.write_table(
            table.replace_schema_metadata(metadata),
            part,
            compression="zstd",
            use_dictionary=False,
            write_statistics=False,
        )
