"""Standard output that may fail: a closed pipe or a full disk under it never ends the work."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any


class Lasting:
    """A stream like the one it wraps, that says nothing more after a write has failed."""

    def __init__(self, stream: Any) -> None:
        """Args: the stream, or None where the process was started without it."""
        self.stream = stream if stream is not None else open(os.devnull, "w")  # noqa: SIM115
        self.failure: OSError | None = None
        if isinstance(self.stream, io.TextIOWrapper):  # names of files need not be text
            self.stream.reconfigure(errors="backslashreplace")

    def write(self, text: str) -> int:
        """Write, or drop what can no longer be written."""
        if self.failure is None:
            try:
                self.stream.write(text)
            except OSError as error:
                self._failed(error)
        return len(text)

    def flush(self) -> None:
        """Flush; a failure is remembered."""
        if self.failure is None:
            try:
                self.stream.flush()
            except OSError as error:
                self._failed(error)

    def _failed(self, error: OSError) -> None:
        """What is still in buffers goes to nowhere, or Python would complain when it ends."""
        self.failure = error
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())
            os.close(nowhere)
            self.stream.flush()

    @property
    def lost(self) -> str:
        """Why something could not be written; empty also where the reader chose to leave."""
        if self.failure is None or self.failure.errno == errno.EPIPE:
            return ""
        return self.failure.strerror or str(self.failure)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


@contextmanager
def lasting() -> Iterator[Lasting]:
    """Let nothing that is printed in the body fail.

    Yields:
        Standard output, which knows whether something was lost.
    """
    for number in (0, 1, 2):  # a file opened instead would get what libraries print
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    before = sys.stdout, sys.stderr
    out, err = Lasting(sys.stdout), Lasting(sys.stderr)
    sys.stdout, sys.stderr = out, err  # type: ignore[assignment]
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before
