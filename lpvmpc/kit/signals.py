"""Told to stop: SIGTERM and SIGHUP do what Ctrl-C does, and all wait where none may strike."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

ALONE = 2.0
"""Time after being told to stop within which being told again changes nothing [s]: a closing
terminal and batch systems say it twice, and what the first has begun to save is to be saved."""
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


@contextmanager
def stops() -> Iterator[None]:
    """Let SIGTERM and SIGHUP do in the body what Ctrl-C does there, and each but once.

    A signal that the process was started to ignore stays ignored (Ctrl-C in the background,
    SIGHUP under nohup).
    """
    if not _main_thread():
        yield
        return
    last = -ALONE

    def interrupt(signum: int, frame: FrameType | None) -> None:
        nonlocal last
        if time.monotonic() - last >= ALONE:
            last = time.monotonic()
            raise KeyboardInterrupt

    def told(signum: int, frame: FrameType | None) -> None:
        handler = signal.getsignal(signal.SIGINT)  # perhaps it waits
        (handler if callable(handler) else interrupt)(signum, frame)

    before = {}
    for number in (signal.SIGINT, *_TOLD):
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            before[number] = signal.signal(number, interrupt if number == signal.SIGINT else told)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
