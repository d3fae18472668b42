"""Whether a window can be opened here."""

from __future__ import annotations

import os
import sys

from lpvmpc.errors import RenderError


def check_display(what: str, instead: str) -> None:
    """Refuse a window where there is no display.

    Args:
        what: The command or option that needs it.
        instead: A sentence on what works without one.

    Raises:
        RenderError: Neither DISPLAY nor WAYLAND_DISPLAY is set.
    """
    if sys.platform.startswith("linux"):
        if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise RenderError(f"{what} needs a display, but neither DISPLAY nor WAYLAND_DISPLAY is "
                              f"set; {instead}")
