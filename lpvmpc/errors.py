"""Exceptions: one base class, and one class per kind of wrong input.

A message is one sentence holding the name, the value given and what is allowed. The command-line
scripts print it on one line and exit with status 2.
"""

from collections.abc import Iterable


class LPVMPCError(Exception):
    """Base class of every error that lpvmpc raises on purpose."""


class OptionError(LPVMPCError, ValueError):
    """An option or parameter lies outside its allowed domain."""

    def __init__(self, name: str, value: object, allowed: str) -> None:
        """Args: name of the option, the value given, and the allowed domain in words."""
        super().__init__(f"{name} is {value!r}, but must be {allowed}.")
        self.name, self.value, self.allowed = name, value, allowed

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:  # to come out of a worker process
        return type(self), (self.name, self.value, self.allowed)


class UnknownNameError(LPVMPCError, KeyError):
    """A scenario, controller or model name does not exist."""

    def __init__(self, kind: str, name: str, choices: Iterable[str]) -> None:
        """Args: kind of thing asked for, the name given, and the existing names."""
        self.kind, self.name, self.choices = kind, name, sorted(choices)
        self.message = f"Unknown {kind} {name!r}; the choices are {', '.join(self.choices)}."
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr
        return self.message

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:  # to come out of a worker process
        return type(self), (self.kind, self.name, self.choices)


class PathError(LPVMPCError, ValueError):
    """A path or track file cannot be driven or read."""


class ModelError(LPVMPCError, ValueError):
    """An MJCF file is broken or is not our vehicle."""


class DataError(LPVMPCError, ValueError):
    """A data or weights file is missing, damaged or of another version."""


class ControllerError(LPVMPCError, RuntimeError):
    """A controller does not import, raises, hangs or returns something that is no command."""


class EstimatorError(LPVMPCError, RuntimeError):
    """An estimator does not import, raises or returns something that is no state."""


class RenderError(LPVMPCError, RuntimeError):
    """Pictures cannot be made on this machine."""


class OutputError(LPVMPCError, OSError):
    """A result cannot be written where it was asked for."""


LONGEST = 300
"""Most characters that are quoted of a message that somebody else has written."""


def described(error: BaseException) -> str:
    """An exception in one line: its class and the first line of its message.

    An exception of a user's class, whose message may itself raise or be endless, is no exception.
    """
    name = type(error).__name__
    try:
        lines = str(error).strip().splitlines() or [""]
    except Exception:
        return name
    first = "".join(c if c.isprintable() else " " for c in lines[0][:LONGEST]).rstrip(". ")
    return f"{name}: {first}" if first else name
