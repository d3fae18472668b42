"""A worker process: takes calls from its parent, gives answers, and ends with it.

`kit.workers` starts it with the parent's `sys.path`, never with the current folder before the
standard library.
"""

from __future__ import annotations

import os
import pickle
import threading
import traceback
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any

from lpvmpc.errors import LPVMPCError, described

Answer = tuple[bool, Any]
"""Whether the function returned, and what; or what it raised."""


def serve(handle: int) -> None:
    """Answer calls until the parent hangs up.

    Args:
        handle: File descriptor of the connection to it; standard input ends when it ends.
    """
    alive = os.dup(0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    threading.Thread(target=_end_with_parent, args=(alive,), daemon=True).start()
    line = Connection(handle)
    try:
        while True:
            call = line.recv_bytes()
            line.send_bytes(_pickled(answer(call)))
    except (EOFError, OSError):  # the parent is gone
        return


def answer(call: bytes) -> Answer:
    """Make a call that was pickled: a function and its argument."""
    try:
        function, thing = pickle.loads(call)
        return caught(function, thing)
    except Exception as error:  # a module that is not there, perhaps
        return False, LPVMPCError(f"A worker process does not understand its work: "
                                  f"{described(error)}.")


def caught(function: Callable[[Any], Any], thing: Any) -> Answer:
    """What a function returns, or raises; with where, for errors that nobody expects."""
    try:
        return True, function(thing)
    except BaseException as error:
        if not isinstance(error, LPVMPCError | KeyboardInterrupt):
            error.add_note("In a worker process:\n" + traceback.format_exc().rstrip())
        return False, error


def _pickled(found: Answer) -> bytes:
    """An answer as bytes; one that cannot be sent becomes a sentence."""
    try:
        data = pickle.dumps(found)
        if not found[0]:
            pickle.loads(data)  # exceptions can be sent more often than they can be made again
        return data
    except Exception as error:
        what = f"{described(error)}" if found[0] else described(found[1])
        return pickle.dumps((False, LPVMPCError(f"A worker's answer cannot be sent: {what}.")))


def _end_with_parent(alive: int) -> None:
    """End this process with its parent, which may be killed without a word."""
    os.read(alive, 1)
    os._exit(1)
