"""Folders that one run at a time writes into.

The system forgets a lock with the process that holds it, however that ends, so that nothing that a
killed run has left is in the way of the next.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from lpvmpc.errors import OutputError

_held: dict[Path, int] = {}
"""Lock files of this process, with their descriptors."""
_UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)


def claim(folder: Path, name: str = "") -> None:
    """Claim a folder, or one name in it, until the end of `claims`, or of this process.

    Leftovers there of processes that were killed are removed.

    Args:
        folder: An existing folder that can be written.
        name: What is written in it, where the folder is shared; empty: all.

    Raises:
        OutputError: Another process has claimed it.
    """
    file = folder.resolve() / f".{name}{name and '.'}lock"
    if file in _held:
        return
    while True:
        try:
            handle = os.open(file, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            why = error.strerror or str(error)
            raise OutputError(f"Cannot write into {os.fspath(folder)!r}: {why}.") from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in _UNSUPPORTED:  # as on some network drives
                who = os.read(handle, 200).decode("utf-8", "replace").strip()
                os.close(handle)
                where = os.fspath(folder / name)
                raise OutputError(
                    f"Another run{who and f' ({who})'} is writing into {where!r}; wait for it, or "
                    "choose another place."
                ) from None
        if _is(handle, file):
            break
        os.close(handle)  # its holder has ended, and removed it, since it was opened
    os.ftruncate(handle, 0)
    os.write(handle, f"process {os.getpid()}, {os.path.basename(sys.argv[0])}".encode())
    _held[file] = handle
    _sweep(folder)


@contextmanager
def claims() -> Iterator[None]:
    """Give back after the body what was claimed in it."""
    before = set(_held)
    try:
        yield
    finally:
        for file in set(_held) - before:
            handle = _held.pop(file)
            with suppress(OSError):
                file.unlink()
            os.close(handle)


def _is(handle: int, file: Path) -> bool:
    """Whether an open file still lies under its name."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(file))
    except FileNotFoundError:
        return False


def _sweep(folder: Path) -> None:
    """Remove what `kit.files` had begun to write in processes that are no more."""
    for part in folder.glob("*.part"):
        found = re.search(r"\.(\d+)\.part$", part.name)
        if found is None or _lives(int(found[1])):
            continue
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass
    return True
