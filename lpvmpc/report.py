"""What a result says about itself: versions, machine, commit, and tables in Markdown."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import mujoco

PACKAGES = ("mujoco", "numba", "numpy", "proxsuite", "pyarrow")
"""Packages on whose versions a trace depends."""


@cache
def versions() -> dict[str, str]:
    """Versions of lpvmpc, Python and the packages that a trace depends on."""
    from lpvmpc import __version__

    found = {"lpvmpc": __version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def model_sha256(model: mujoco.MjModel) -> str:
    """SHA-256 of the compiled model: every number that the physics uses, and MuJoCo's layout."""
    import mujoco
    import numpy as np

    binary = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, binary)
    return hashlib.sha256(binary.tobytes()).hexdigest()


@cache
def machine() -> str:
    """Processor, number of cores this process may use, and system, in one line."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                cpu = line.partition(":")[2].strip()
                break
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{cpu}, {cores} cores, {platform.system()} {platform.machine()}"


@cache
def commit() -> str | None:
    """Commit of the working tree this package lies in; None outside one or without git."""
    try:
        answer = subprocess.run(
            ["git", "describe", "--always", "--dirty", "--abbrev=12"],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip() or None


def markdown_table(title: str, header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table under one line of title, columns padded so that diffs stay readable.

    Args:
        title: What the table shows; also keeps `git diff` of two reports readable.
        header: Column names, shape (n,); the first column is left-aligned, the others right.
        rows: Cells, each row of shape (n,).
    """
    cells = [[str(cell) for cell in header], *([str(cell) for cell in row] for row in rows)]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    lines = [
        "| " + " | ".join(
            cell.ljust(w) if i == 0 else cell.rjust(w)
            for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        ) + " |"
        for row in cells
    ]  # fmt: skip
    rule = "|" + "|".join(
        "-" * (w + 2) if i == 0 else "-" * (w + 1) + ":" for i, w in enumerate(widths)
    ) + "|"  # fmt: skip
    return "\n".join([f"**{title}**", "", lines[0], rule, *lines[1:], ""])
