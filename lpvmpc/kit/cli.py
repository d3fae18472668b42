"""What the command-line scripts share: options from a dataclass, exit codes, one-line errors."""

from __future__ import annotations

import ctypes
import math
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from ctypes.util import find_library
from dataclasses import fields
from pathlib import Path
from typing import Any

from lpvmpc.errors import LPVMPCError, OptionError, OutputError
from lpvmpc.kit import locks
from lpvmpc.kit.options import Option, OptionsT, parse
from lpvmpc.kit.signals import stops, told
from lpvmpc.kit.streams import Lasting, lasting

__all__ = [
    "Option", "check_choice", "check_number", "check_opengl", "cores", "one_line", "parse",
    "result_file", "results_folder", "run", "writable_folder",
]

DONE, BAD_INPUT, NOT_COMPLETED, INTERRUPTED = 0, 2, 3, 130
"""Exit codes: done; bad input (one line on stderr); the run did not complete; Ctrl-C, SIGTERM or
SIGHUP."""
LONGEST = 1000
"""Most characters of a message: a name on the command line may have any length."""
WRITTEN = ("json", "save_push", "out")
"""Options that name a file of results."""
NO_CACHE = "cannot cache function"
"""How numba begins to say that none of the folders for compiled code can be written."""
BACKENDS = {
    "linux": ("egl", "glfw", "glx", "osmesa"), "win32": ("glfw", "wgl"), "darwin": ("cgl", "glfw"),
}
"""What MUJOCO_GL may be, by the system."""
SWITCHES = ("disable", "disabled", "off", "false", "0", "enable", "enabled", "on", "true", "1")
"""What else it may be."""


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
    try:
        with lasting() as printed, stops(), _plain_warnings():
            return _run(options, main, arguments, printed)
    except KeyboardInterrupt:  # at the first or the last instant
        return INTERRUPTED


def _run(
    options: type[OptionsT],
    main: Callable[[OptionsT], int],
    arguments: Sequence[str] | None,
    printed: Lasting,
) -> int:
    """The same, where nothing that is printed can fail."""
    try:
        check_environment()
        with locks.claims():
            given = parse(options, arguments)
            _spare(given)
            code = main(given)
    except LPVMPCError as error:
        print("Error:", one_line(str(error)), file=sys.stderr)
        code = BAD_INPUT
    except Exception as error:
        if told():  # compiled modules turn Ctrl-C into errors of their own
            code = _interrupted()
        elif isinstance(error, RuntimeError) and str(error).startswith(NO_CACHE):
            print("Error: No folder for compiled code can be written; NUMBA_CACHE_DIR names one.",
                  file=sys.stderr)
            code = BAD_INPUT
        else:
            raise
    except KeyboardInterrupt:
        code = _interrupted()
    except SystemExit as ended:
        printed.flush()
        if ended.code or not printed.lost:
            raise
        code = DONE  # the help, which a full disk has lost
    if code == INTERRUPTED:
        # where Ctrl-C has struck in compiled code that called Python, Python would end by SIGINT in
        # place of this exit code; a call of that kind that returns makes it forget
        ctypes.pythonapi.PyRun_SimpleString(b"pass")
    printed.flush()
    if printed.lost:
        print(f"Error: Cannot write to standard output: {printed.lost}.", file=sys.stderr)
        code = code or BAD_INPUT
    return code


def _spare(options: Any) -> None:
    """Refuse to write a result over a file that another option reads.

    Raises:
        OptionError: With the names of both options.
    """
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    for name in WRITTEN:
        file = values.pop(name, None)
        if not isinstance(file, Path) or not file.is_file():
            continue
        for other, value in values.items():
            for read in value if isinstance(value, tuple) else (value,):
                if isinstance(read, str | Path) and _is(file, read):
                    raise OptionError(_flag(name), os.fspath(file),
                                      f"another file than that of {_flag(other)}, which is read")


def _is(file: Path, name: str | Path) -> bool:
    """Whether a name is that of a file, by whatever way."""
    with suppress(OSError, ValueError):  # a word that names none
        return os.path.samefile(file, name)
    return False


def _interrupted() -> int:
    """Say so, and give the exit code."""
    print("Interrupted.", file=sys.stderr)
    return INTERRUPTED


def one_line(text: str) -> str:
    """A text on one line, of at most `LONGEST` characters, without what a terminal would obey."""
    line = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))
    return line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Show warnings of the package as a sentence, without file, line and source."""
    before = warnings.showwarning

    def show(message: Any, category: Any, *where: Any, **more: Any) -> None:
        if category is UserWarning:
            print("Warning:", one_line(str(message)), file=sys.stderr)
        else:
            before(message, category, *where, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = before


def only(options: Any, names: Sequence[str]) -> None:
    """Refuse options that mean nothing with the first of some.

    Args:
        options: Dataclass of all options.
        names: Those that may be given; the first is the reason.

    Raises:
        OptionError: Another one is not at its default.
    """
    for field in fields(options):
        value = getattr(options, field.name)
        if field.name not in names and value != field.default:
            told = os.fspath(value) if isinstance(value, Path) else value
            raise OptionError(_flag(field.name), told, f"left out with {_flag(names[0])}")


def _flag(name: str) -> str:
    """What a field is called on the command line."""
    return f"--{name.replace('_', '-')}"


def check_number(name: str, value: float | None, low: float, high: float, unit: str = "") -> None:
    """Refuse a number outside [low, high], or NaN; None is fine (the option was not given).

    Raises:
        OptionError: With the option's name, its value and the allowed range.
    """
    if value is not None and not (math.isfinite(value) and low <= value <= high):
        ends = (str(end) if isinstance(end, int) else f"{end:g}" for end in (low, high))
        raise OptionError(name, value, f"from {' to '.join(ends)}{unit and ' ' + unit}")


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
    """Ignore a MUJOCO_GL that does not exist here, and say so, before MuJoCo is imported.

    The import would fail with an obscure error, even where nothing is drawn.
    """
    backend = os.environ.get("MUJOCO_GL", "").lower().strip()
    if not backend:
        return
    library = {"egl": "EGL", "osmesa": "OSMesa"}.get(backend)
    if library and find_library(library) is None:
        why = f"lib{library} is not installed"
    elif backend in SWITCHES or backend in BACKENDS.get(sys.platform, BACKENDS["linux"]):
        return
    else:
        known = ", ".join(BACKENDS.get(sys.platform, BACKENDS["linux"]))
        why = f"must be one of {known}, off"
    print(f"Warning: MUJOCO_GL is {one_line(backend)}, but {why}; it is ignored.", file=sys.stderr)
    del os.environ["MUJOCO_GL"]


def check_environment() -> None:
    """Ignore settings of libraries that these refuse with a traceback, and say so.

    matplotlib reads its backend when the first picture is drawn, after the drive; numba its number
    of threads when the first loop is compiled. Neither matters here.
    """
    for name, fine, what in (
        ("MPLBACKEND", _is_backend, "a known backend"),
        ("NUMBA_NUM_THREADS", lambda v: v.isascii() and v.isdigit() and int(v[-9:]) > 0,
         "a whole number above 0"),
    ):
        value = os.environ.get(name, "")
        if value and not fine(value):
            print(f"Warning: {name} is {one_line(value)}, but must be {what}; it is ignored.",
                  file=sys.stderr)
            del os.environ[name]


def _is_backend(name: str) -> bool:
    """Whether matplotlib knows a backend; it is imported for that, where one is set."""
    del os.environ["MPLBACKEND"]  # or the import itself would fail
    try:
        from matplotlib.backends import backend_registry

        return bool(backend_registry.is_valid_backend(name))
    finally:
        os.environ["MPLBACKEND"] = name


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
        taken = isinstance(error, FileExistsError)
        why = "it is no folder" if taken else error.strerror or str(error)
        raise OutputError(f"Cannot write into {os.fspath(folder)!r}: {why}.") from error
    return folder


def result_file(file: Path | None) -> None:
    """Find out now whether a file of results can be written; None is fine (it was not asked for).

    Raises:
        OutputError: It cannot.
    """
    if file is None:
        return
    if file.is_dir():
        raise OutputError(f"Cannot write {os.fspath(file)!r}: it is a folder, not a file.")
    writable_folder(file.parent)


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
