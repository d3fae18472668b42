"""A side force and a yaw moment over time that no column records: wind, say.

They are identified on one recording, written to a file, and applied to other recordings of the same
time, which say by it whether they were the same there. A car is never scored with a push that was
identified on the recording that it is scored on: that would explain anything.

The plant is held at the recorded side speed and yaw rate (`follow.replay`, pulls); what it takes to
hold it is what is missing. Splines with a knot every second leave of it what is smooth.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import make_lsq_spline

from lpvmpc.errors import DataError
from lpvmpc.identify.candidate import Candidate
from lpvmpc.identify.follow import CHUNK, Push, replay
from lpvmpc.identify.recording import Recording, table_of
from lpvmpc.kit.files import write_text
from lpvmpc.plant.mjcf import parameters
from lpvmpc.units import Array

COLUMNS = ("t_s", "side_force_N", "yaw_moment_Nm")
"""Columns of a push's file."""
KNOTS = 1.0
"""Time between two knots [s]: what is faster is noise, or the car."""
SOURCE = "# identified on "
"""What the first line of the file begins with."""
SAMPLE = 0.1
"""Time between two rows of the file [s]."""


def identify(candidate: Candidate, recording: Recording, follow: str = "wheels") -> Push:
    """The push that was missing in a recording.

    Args:
        candidate: The car, with the recording's steering.
        recording: With or without a measured side speed: without, no side force is identified.
        follow: What follows the speed.

    Raises:
        DataError: It has no segment that can be replayed.
        LPVMPCError: The car cannot follow.
    """
    model = candidate.model()
    dt, p = float(model.opt.timestep), parameters(model)
    parts = []
    for segment in recording.segments():
        pulls: list[Array] = []
        replay([model], segment, [candidate.steering], follow=follow, pulls=pulls)
        pull = np.array(pulls)[:, 0]  # (chunks, 2)
        t = segment.t[0] + dt * CHUNK * (np.arange(len(pull)) + 0.5)
        inside = t <= segment.t[-1]
        parts.append((t[inside], _smooth(t[inside], pull[inside])))
    t = np.concatenate([one for one, _ in parts])
    pull = np.concatenate([two for _, two in parts])
    at = np.arange(t[0], t[-1], SAMPLE)
    force, moment = (
        scale * np.interp(at, t, pull[:, j]) for j, scale in enumerate((p.m, p.Iz))
    )
    return Push(t=at, force=force, moment=moment, source=recording.name)


def _smooth(t: Array, values: Array) -> Array:
    """Least-squares cubic splines through columns over time, shape (n, k)."""
    inner = np.linspace(t[0], t[-1], max(2, round((t[-1] - t[0]) / KNOTS) + 1))
    knots = np.concatenate([[t[0]] * 3, inner, [t[-1]] * 3])
    return np.asarray(make_lsq_spline(t, values, knots)(t))


def write(file: Path, push: Push) -> None:
    """Write a push as CSV.

    Raises:
        OutputError: It cannot be written.
    """
    lines = [f"{SOURCE}{push.source}", ",".join(COLUMNS)]
    for row in zip(push.t, push.force, push.moment, strict=True):
        lines.append(",".join(f"{value:.6g}" for value in row))
    write_text(file, "\n".join(lines) + "\n")


def read(file: Path) -> Push:
    """Read a push.

    Raises:
        DataError: It cannot be read, or is none.
    """
    names, rows = table_of(file, what="push")
    if tuple(names) != COLUMNS:
        raise DataError(f"Push {file} must have the columns {', '.join(COLUMNS)}, but has "
                        f"{', '.join(names)[:200]}.")
    table = np.array(rows).reshape(-1, len(COLUMNS))
    if len(table) < 2 or not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0.0).any():
        raise DataError(f"Push {file} must hold at least two rows of finite numbers, with t_s "
                        "growing.")
    first = Path(file).read_text(encoding="utf-8-sig").partition("\n")[0]
    source = first.removeprefix(SOURCE).strip() if first.startswith(SOURCE) else ""
    return Push(t=table[:, 0], force=table[:, 1], moment=table[:, 2], source=source)


def check(push: Push, recording: Recording) -> None:
    """Refuse a push for a recording that it was identified on, or that is of another time.

    Raises:
        DataError: It would explain anything, or nothing is known of it there.
    """
    if push.source == recording.name:
        raise DataError(f"The push was identified on {recording.name} itself, whose scores would "
                        "say nothing with it; it must be applied to another recording.")
    if recording.t[0] < push.t[0] - KNOTS or recording.t[-1] > push.t[-1] + KNOTS:
        raise DataError(
            f"The push acts from {push.t[0]:.1f} to {push.t[-1]:.1f} s, but {recording.name} was "
            f"recorded from {recording.t[0]:.1f} to {recording.t[-1]:.1f} s."
        )
