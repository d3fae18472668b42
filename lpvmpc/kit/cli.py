"""What the command-line scripts share: options from a dataclass, exit codes, one-line errors."""

from __future__ import annotations

import io
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from ctypes.util import find_library
from pathlib import Path

from lpvmpc.errors import LPVMPCError, OptionError, OutputError
from lpvmpc.kit.options import Option, OptionsT, parse
from lpvmpc.kit.signals import sigterm_is_ctrl_c

__all__ = [
    "Option", "check_choice", "check_number", "check_opengl", "cores", "parse", "run",
    "writable_folder",
]

DONE, BAD_INPUT, NOT_COMPLETED, INTERRUPTED = 0, 2, 3, 130
"""Exit codes: done; bad input (one line on stderr); the run did not complete; Ctrl-C or
SIGTERM."""


def run(
    options: type[OptionsT],
    main: Callable[[OptionsT], int],
    arguments: Sequence[str] | None = None,
) -> int:
    """Parse the command line into a dataclass, call `main` with it, and return the exit code.

    Args:
        options: Frozen dataclass of the script's options; its docstrings are the help.
        main: Does the work and returns an exit code.
        arguments: Command line (default: sys.argv).
    """
    for stream in (sys.stdout, sys.stderr):  # names of files need not be text
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        with sigterm_is_ctrl_c():
            return main(parse(options, arguments))
    except LPVMPCError as error:
        print("Error:", " ".join(str(error).split()), file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("Interrupted.", file=sys.stderr)
        return INTERRUPTED


def check_number(name: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """Refuse a number outside [low, high], or NaN; None is fine (the option was not given).

    Raises:
        OptionError: With the option's name, its value and the allowed range.
    """
    if value is not None and not (math.isfinite(value) and low <= value <= high):
        raise OptionError(name, value, f"from {low:g} to {high:g}{unit and ' ' + unit}")


def check_choice(name: str, value: str | None, choices: Iterable[str]) -> None:
    """Refuse a word that is none of the choices; None is fine (the option was not given).

    Raises:
        OptionError: With the option's name, its value and the choices.
    """
    known = list(choices)
    if value is not None and value not in known:
        raise OptionError(name, value, f"one of {', '.join(known)}")


def cores() -> int:
    """Number of cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_opengl() -> None:
    """Ignore a MUJOCO_GL whose library is not there, and say so, before MuJoCo is imported.

    The import would fail with an obscure error, even where nothing is drawn.
    """
    backend = os.environ.get("MUJOCO_GL", "").lower().strip()
    library = {"egl": "EGL", "osmesa": "OSMesa"}.get(backend)
    if library and find_library(library) is None:
        print(
            f"Warning: MUJOCO_GL is {backend}, but lib{library} is not installed; it is ignored.",
            file=sys.stderr,
        )
        del os.environ["MUJOCO_GL"]


def writable_folder(folder: Path) -> Path:
    """Make a folder where needed, and find out now whether it can be written.

    Raises:
        OutputError: It cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        why = error.strerror or str(error)
        raise OutputError(f"Cannot write into {os.fspath(folder)!r}: {why}.") from error
    return folder
