"""What the command-line scripts share: options from a dataclass, exit codes, one-line errors."""

from __future__ import annotations

import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from ctypes.util import find_library
from pathlib import Path

from lpvmpc.errors import LPVMPCError, OptionError, OutputError
from lpvmpc.kit import locks
from lpvmpc.kit.options import Option, OptionsT, parse
from lpvmpc.kit.signals import stops
from lpvmpc.kit.streams import lasting

__all__ = [
    "Option", "check_choice", "check_number", "check_opengl", "cores", "parse", "results_folder",
    "run", "writable_folder",
]

DONE, BAD_INPUT, NOT_COMPLETED, INTERRUPTED = 0, 2, 3, 130
"""Exit codes: done; bad input (one line on stderr); the run did not complete; Ctrl-C, SIGTERM or
SIGHUP."""


def run(
    options: type[OptionsT],
    main: Callable[[OptionsT], int],
    arguments: Sequence[str] | None = None,
) -> int:
    """Parse the command line into a dataclass, call `main` with it, and return the exit code.

    What is printed may be lost, to a closed pipe or a full disk, without ending the work; a full
    disk is told in the end, and is bad input. SIGTERM and SIGHUP act as Ctrl-C. Folders claimed by
    `results_folder` are free again afterwards.

    Args:
        options: Frozen dataclass of the script's options; its docstrings are the help.
        main: Does the work and returns an exit code.
        arguments: Command line (default: sys.argv).
    """
    with stops(), lasting() as printed:
        try:
            code = main(parse(options, arguments))
        except LPVMPCError as error:
            print("Error:", " ".join(str(error).split()), file=sys.stderr)
            code = BAD_INPUT
        except KeyboardInterrupt:
            print("Interrupted.", file=sys.stderr)
            code = INTERRUPTED
        finally:
            locks.release()
        printed.flush()
        if printed.lost:
            print(f"Error: Cannot write to standard output: {printed.lost}.", file=sys.stderr)
            code = code or BAD_INPUT
    return code


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


def results_folder(folder: Path, name: str = "") -> Path:
    """Make a folder where needed, that this run alone writes results into until it ends.

    Args:
        folder: The folder.
        name: Name of the results, where others may lie beside them.

    Raises:
        OutputError: It cannot be written, or another run is writing there.
    """
    writable_folder(folder)
    locks.claim(folder, name)
    return folder
