"""Files that are whole or not there: written beside their place, and renamed when complete.

And files as users give them: whatever lies under a name, reading it ends, at once, in the content
of an ordinary file of a size that such files have, or in an exception that says why not.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.errors import DataError, LPVMPCError, OutputError
from lpvmpc.kit.signals import ctrl_c_waits

if TYPE_CHECKING:
    import numpy.typing as npt
    from matplotlib.figure import Figure

MOST = 1 << 20
"""Largest file of settings that is read [bytes]."""
DEEPEST = 20
"""Most levels of lists and tables within each other in a file of settings."""
_WORD = r"""(?:(?<![\w-])[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*"""
_DEEP_KEY = re.compile(rf"(?:{_WORD}\.[ \t]*){{{DEEPEST},}}")
LONGEST = 256
"""Most bits of a whole number in such a file."""
KINDS = (
    (stat.S_ISDIR, "a directory"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"), (stat.S_ISBLK, "a device"),
)
"""What a name may stand for that is no ordinary file."""


def read_bytes(file: str | os.PathLike[str], most: int = MOST) -> bytes:
    """The bytes of an ordinary file.

    Args:
        file: Its name.
        most: Its largest size.

    Raises:
        OSError: It cannot be read, is no ordinary file (a pipe or a device may have no end), or is
            larger; `strerror` says which.
    """
    try:
        mode = os.stat(file).st_mode
        for found, name in KINDS:
            if found(mode):
                raise OSError(errno.EINVAL, f"it is {name}, not a file")
        with open(file, "rb") as opened:
            raw = opened.read(most + 1)
    except ValueError as error:  # a zero byte
        raise OSError(errno.EINVAL, "no file can have this name") from error
    if len(raw) > most:
        raise OSError(errno.EFBIG, f"it is larger than {most / 2**20:g} MiB")
    return raw


def read_toml(file: str | os.PathLike[str]) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        OSError: As `read_bytes`.
        ValueError: It is no TOML, or nested more deeply than any settings are.
    """
    text = read_bytes(file).decode("utf-8-sig")
    if _DEEP_KEY.search(text):  # tomllib's time grows with the square of a key's length
        raise _too_deep()
    try:
        return _plain(tomllib.loads(text))
    except RecursionError:
        raise _too_deep() from None


def read_json(file: str | os.PathLike[str], most: int = 64 * MOST) -> Any:
    """The content of a JSON file.

    Raises:
        OSError: As `read_bytes`.
        ValueError: It is no JSON, or nested more deeply than any settings are.
    """
    text = read_bytes(file, most).decode("utf-8")
    try:
        return _plain(json.loads(text))
    except RecursionError:
        raise _too_deep() from None


def _plain(content: Any) -> Any:
    """The same, unless it holds what Python cannot even print: see `DEEPEST` and `LONGEST`."""
    level = [content]
    for _ in range(DEEPEST):
        if not level:
            return content
        if any(isinstance(value, int) and value.bit_length() > LONGEST for value in level):
            raise ValueError(f"it holds a whole number of more than {LONGEST} bits")
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
        ]
    if level:
        raise _too_deep()
    return content


def _too_deep() -> ValueError:
    return ValueError(f"it is nested more than {DEEPEST} levels deep")


def checksum(content: Any) -> str:
    """SHA-256 of what JSON can hold, however it was laid out in its file."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


@contextmanager
def reading(what: str, form: str) -> Iterator[None]:
    """Say in one sentence what cannot be read.

    Args:
        what: What is read, for the sentence.
        form: What it is if it is whole.

    Raises:
        DataError: In place of an OSError or a ValueError of the body.
    """
    try:
        yield
    except OSError as error:
        raise DataError(f"{what} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:
        raise DataError(f"{what} is no {form}: {' '.join(str(error).split())}.") from error


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
