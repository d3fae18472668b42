"""Where a result comes from: versions, model, machine, commit."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from collections.abc import Iterable
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from lpvmpc._version import __version__

if TYPE_CHECKING:
    import mujoco

PACKAGES = ("mujoco", "numba", "numpy", "proxsuite", "pyarrow")
"""Packages on whose versions a trace depends."""
CODE = (":(top)", ":(top,exclude)docs/results")
"""What git looks at for changes."""


@cache
def versions() -> dict[str, str]:
    """Versions of lpvmpc, Python and the packages that a trace depends on."""
    return {"lpvmpc": __version__, "python": platform.python_version(), **versions_of(PACKAGES)}


def versions_of(packages: Iterable[str]) -> dict[str, str]:
    """Versions of installed packages, and which are not installed."""
    found = {}
    for package in packages:
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
def commit(folder: Path = Path(__file__).parent) -> str | None:
    """Commit of the working tree this package lies in; None outside one or without git.

    It ends in `-dirty` where a tracked file other than the results differs: the results of one
    script do not change what the next one measures.
    """
    name = _git(folder, "describe", "--always", "--abbrev=12")
    if not name:
        return None
    changed = _git(folder, "status", "--porcelain", "--untracked-files=no", "--", *CODE)
    return f"{name}-dirty" if changed else name


def _git(folder: Path, *words: str) -> str | None:
    """What git says; None where it fails."""
    try:
        answer = subprocess.run(
            ["git", *words], cwd=folder, capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip()
