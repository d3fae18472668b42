"""Told to stop: SIGTERM and SIGHUP do what Ctrl-C does, and all wait where none may strike."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

ALONE = 2.0
"""Time after being told to stop within which being told again changes nothing [s]: a closing
terminal and batch systems say it twice, and what the first has begun to save is to be saved."""
AGAIN = 0.05
"""Time after which a signal that was swallowed strikes again [s]."""
_TOLD = tuple(
    getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)
)


@contextmanager
def ctrl_c_waits() -> Iterator[Callable[[], bool]]:
    """Put Ctrl-C, and what is treated like it, off until the body is through.

    Yields:
        A function that says whether it was pressed meanwhile.
    """
    pressed: list[int] = []
    if not _main_thread():  # no other thread ever gets it
        yield lambda: False
        return
    before = signal.getsignal(signal.SIGINT)
    ignored = before in (signal.SIG_IGN, None)

    def note(signum: int, frame: FrameType | None) -> None:
        if signum != signal.SIGINT or not ignored:
            pressed.append(signum)

    signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(pressed)
    finally:
        signal.signal(signal.SIGINT, before)
    if pressed:
        if callable(before):
            before(pressed[0], None)
        elif ignored:  # in the background, where SIGTERM alone is heard
            raise KeyboardInterrupt
        else:
            signal.raise_signal(signal.SIGINT)


@dataclass
class _Told:
    """When this process was last told to stop, while `stops` is in force."""

    at: float | None = None


_told = _Told()


def told() -> bool:
    """Whether this process has been told to stop, within `stops`."""
    return _told.at is not None


def heed() -> None:
    """Stop now if that was told a while ago, and some library took no notice.

    Raises:
        KeyboardInterrupt: It was.
    """
    if _told.at is not None and time.monotonic() - _told.at > ALONE:
        raise KeyboardInterrupt


@contextmanager
def stops() -> Iterator[None]:
    """Let SIGTERM and SIGHUP do in the body what Ctrl-C does there, and each but once.

    A signal that the process was started to ignore stays ignored (Ctrl-C in the background,
    SIGHUP under nohup). One that strikes where nothing can be raised, as in a function that
    compiled code calls, strikes again a moment later, without a word.
    """
    if not _main_thread():
        yield
        return
    main = threading.get_ident()
    hook = sys.unraisablehook

    def interrupt(signum: int, frame: FrameType | None) -> None:
        now = time.monotonic()
        if _told.at is None or now - _told.at >= ALONE:
            _told.at = now
            raise KeyboardInterrupt

    def like_ctrl_c(signum: int, frame: FrameType | None) -> None:
        handler = signal.getsignal(signal.SIGINT)  # perhaps it waits
        (handler if callable(handler) else interrupt)(signum, frame)

    def swallowed(what: sys.UnraisableHookArgs) -> None:
        if not issubclass(what.exc_type, KeyboardInterrupt):
            hook(what)
            return
        _told.at = None
        again = threading.Timer(AGAIN, signal.pthread_kill, (main, signal.SIGTERM))
        again.daemon = True
        again.start()

    before = {}
    _told.at = None
    sys.unraisablehook = swallowed
    for number in (signal.SIGINT, *_TOLD):
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            does = interrupt if number == signal.SIGINT else like_ctrl_c
            before[number] = signal.signal(number, does)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        sys.unraisablehook = hook
        _told.at = None


def _main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
