"""A recording of a car: reading it, refusing what cannot be one, cutting it into segments."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lpvmpc.errors import DataError
from lpvmpc.identify import signals
from lpvmpc.kit.files import MOST, read_bytes
from lpvmpc.units import Array

NEEDED = ("t_s", "delta_rad", "vx_mps", "r_radps")
"""Columns that a recording must have."""
OPTIONAL = ("vy_mps", "ax_mps2", "ay_mps2")
"""Columns that it may have; others are ignored."""
LARGEST = 64 * MOST
"""Largest file that is read [bytes]."""
SHORTEST = 2.0
"""Shortest segment that is replayed [s]."""
SLOWEST = 2.0
"""Speed below which nothing is replayed [m/s]: yaw rate over steering says nothing of a car there,
and vx must stay above the speed at which the plant's tires become springs at standstill."""
FEWEST = 20
"""Fewest samples of a segment."""
JUMP = 20.0
"""A change of vx beyond this [m/s2] is a jump, of one car into another run."""
NOISE = 0.5
"""What a change of vx may be besides, of noise [m/s]."""
GAP = 3.0
"""A step of time longer than this many usual steps is a gap."""
HELD = 0.4
"""Share of samples that repeat the one before in a held command's steering."""
FIRST = 5
"""Samples whose straight line gives the first speed and yaw rate: one alone is noise."""
SPARSE = 0.2
"""Longest usual step of time [s]: five samples a second do not show a steering movement."""
LIMITS = {
    "delta_rad": (0.9, "rad"), "vx_mps": (100.0, "m/s"), "vy_mps": (40.0, "m/s"),
    "r_radps": (5.0, "rad/s"), "ax_mps2": (30.0, "m/s2"), "ay_mps2": (30.0, "m/s2"),
}
"""Largest absolute values that a car can have."""
DEGREES = {"delta_rad": 120.0, "r_radps": 300.0}
"""Below these, values that are too large for radians are degrees."""
HAND_WHEEL = (9.0, 25.0)
"""Ratios of a steering gear: hand wheel over road wheel."""
WHEELBASES = (1.5, 4.5)
"""Wheelbases of cars [m]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """What was measured of a car, in SI units, ISO 8855 signs; all arrays of shape (n,)."""

    name: str
    """Where it comes from."""
    t: Array
    """Time [s], ascending."""
    delta: Array
    """Road-wheel steering angle [rad]."""
    vx: Array
    """Longitudinal speed of the centre of mass [m/s]."""
    r: Array
    """Yaw rate [rad/s]."""
    vy: Array | None = None
    """Lateral speed of the centre of mass [m/s]."""
    ax: Array | None = None
    """Longitudinal acceleration of the centre of mass [m/s2]."""
    ay: Array | None = None
    """Lateral acceleration of the centre of mass [m/s2]."""

    @property
    def step(self) -> float:
        """Usual time between two samples [s]."""
        return float(np.median(np.diff(self.t)))

    @property
    def lateral(self) -> Array:
        """Lateral acceleration r vx [m/s2], shape (n,): what a steady turn at this yaw rate has."""
        return self.r * self.vx

    @cached_property
    def _speed(self) -> signals.UnivariateSpline:
        """The speed as a smoothed spline."""
        return signals.spline(self.t, self.vx)

    @cached_property
    def _angle(self) -> Array:
        """The steering angle at the samples [rad], without its white noise.

        Noise of what drives a model is not like noise of what it is compared with: the fit would
        look for a model that answers it less (one that is late, or soft).
        """
        return self.delta if self.held else signals.spline(self.t, self.delta)(self.t)

    @cached_property
    def held(self) -> bool:
        """Whether the steering is a held command: it stands still, then jumps, while it moves."""
        change = np.abs(np.diff(self.delta))
        moving = np.flatnonzero(change > 0.0)
        if len(moving) < 5:
            return False
        inner = change[moving[0] : moving[-1] + 1]
        return bool((inner == 0.0).mean() > HELD)

    def steering(self, times: Array, servo: float = 0.0) -> Array:
        """Steering angle at equally spaced times [rad].

        Between samples as `signals.between` says. Where `held`, it changes as `signals.changes`
        says, and its mean over the step that ends at each time is given.
        """
        if not self.held or len(times) < 2:
            return signals.between(self.t, self._angle, times, servo)
        dt = times[1] - times[0]
        middle, half = signals.changes(self.t, self.delta), 0.5 * self.step
        ends = np.concatenate([[self.t[0] - half], middle, [self.t[-1] + half]])
        total = np.concatenate([[0.0], np.cumsum(self.delta * np.diff(ends))])

        def until(time: Array) -> Array:
            inside = np.interp(time, ends, total)
            early = np.minimum(time - ends[0], 0.0) * self.delta[0]
            late = np.maximum(time - ends[-1], 0.0) * self.delta[-1]
            return inside + early + late

        return (until(times) - until(times - dt)) / dt

    def speed(self, times: Array) -> tuple[Array, Array]:
        """Smoothed speed [m/s] and its derivative [m/s2] at times [s]; constant outside."""
        inside = np.clip(times, self.t[0], self.t[-1])
        moving = (times >= self.t[0]) & (times <= self.t[-1])
        spline = self._speed
        return spline(inside), np.where(moving, spline.derivative()(inside), 0.0)

    def first(self, values: Array) -> float:
        """A column's value at the start, of the straight line through its first samples."""
        start = self.t[:FIRST] - self.t[0]
        return float(np.polyfit(start, values[:FIRST], 1)[1])

    def rows(self, first: int, last: int) -> Recording:
        """Samples `first` to `last`, the last one not included.

        Raises:
            DataError: There are no such rows, or too few.
        """
        n = len(self.t)
        if not (0 <= first < last <= n and last - first >= FEWEST):
            raise DataError(
                f"The rows {first} to {last} of {self.name} were asked for, but must be at least "
                f"{FEWEST} of its {n}."
            )
        pick = slice(first, last)
        return self._of(lambda values: values[pick])

    def _of(self, change: Callable[[Array], Array]) -> Recording:
        vy, ax, ay = (None if v is None else change(v) for v in (self.vy, self.ax, self.ay))
        return Recording(
            name=self.name, t=change(self.t), delta=change(self.delta), vx=change(self.vx),
            r=change(self.r), vy=vy, ax=ax, ay=ay,
        )

    def segments(self) -> list[Recording]:
        """The parts that are replayed on their own.

        A recording is cut at gaps in time (more than `GAP` usual steps), at jumps of vx (faster
        than `JUMP`, noise allowed for) and where the car is slower than `SLOWEST`; parts shorter
        than `SHORTEST` are left out.

        Raises:
            DataError: Nothing is left.
        """
        dt = np.diff(self.t)
        cut = dt > GAP * self.step
        cut |= np.abs(np.diff(self.vx)) > JUMP * dt + NOISE
        slow = self.vx < SLOWEST
        cut |= slow[1:] | slow[:-1]
        edges = [0, *(np.flatnonzero(cut) + 1), len(self.t)]
        parts = [
            self.rows(first, last)
            for first, last in zip(edges[:-1], edges[1:], strict=True)
            if last - first >= FEWEST and self.t[last - 1] - self.t[first] >= SHORTEST
        ]
        if not parts:
            raise DataError(
                f"Recording {self.name} has no {SHORTEST:g} s in one piece above {SLOWEST:g} m/s, "
                "without gaps in t_s and jumps in vx_mps."
            )
        return parts


def read_recording(file: str | os.PathLike[str]) -> Recording:
    """Read a recording, a CSV file with the columns `NEEDED`, and perhaps those of `OPTIONAL`.

    Args:
        file: Its header names the columns, in any order; `#` may stand before it.

    Raises:
        DataError: It cannot be read, or cannot be a recording of a car; one sentence says why.
    """
    path = Path(file)
    names, rows = table_of(path)
    for name in NEEDED:
        if name not in names:
            raise DataError(
                f"Recording {path} has no column {name}; it must have {', '.join(NEEDED)}, and may "
                f"have {', '.join(OPTIONAL)}, but has {', '.join(names)[:200]}."
            )
    if len(rows) < FEWEST:
        raise DataError(
            f"Recording {path} has {len(rows)} samples, but must have at least {FEWEST}."
        )
    table = np.array(rows)
    known = [name for name in (*NEEDED, *OPTIONAL) if name in names]
    columns = {name: np.ascontiguousarray(table[:, names.index(name)]) for name in known}
    _check(path, columns)
    return Recording(
        name=path.name,
        t=columns["t_s"], delta=columns["delta_rad"], vx=columns["vx_mps"], r=columns["r_radps"],
        vy=columns.get("vy_mps"), ax=columns.get("ax_mps2"), ay=columns.get("ay_mps2"),
    )


def table_of(path: Path, what: str = "recording") -> tuple[list[str], list[list[float]]]:
    """Names of the columns and the rows of numbers of a file that is called `what`."""
    one = what.capitalize()
    try:
        lines = read_bytes(path, LARGEST).decode("utf-8-sig").splitlines()
    except FileNotFoundError:
        raise DataError(f"There is no {what} {path}.") from None
    except UnicodeDecodeError:
        raise DataError(f"{one} {path} is not a text file.") from None
    except OSError as error:
        raise DataError(f"{one} {path} cannot be read: {error.strerror or error}.") from None
    names: list[str] = []
    rows: list[list[float]] = []
    separator = ","
    for number, line in enumerate((one.strip() for one in lines), start=1):
        if not line:
            continue
        if not names:
            text = line.lstrip("#").strip()
            if line.startswith("#") and "t_s" not in text:
                continue  # a comment above the header
            separator = next((mark for mark in ";\t" if mark in text), ",")
            names = [word.strip().strip('"') for word in text.split(separator)]
            if len(set(names)) != len(names):
                raise DataError(f"{one} {path} names a column twice: {text[:200]}.")
            continue
        if line.startswith("#"):
            continue
        words = line.split(separator)
        if len(words) != len(names):
            raise DataError(
                f"Line {number} of {what} {path} has {len(words)} columns, but the header "
                f"names {len(names)}."
            )
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise DataError(
                f"Line {number} of {what} {path} holds {line[:60]!r}, but must hold numbers."
            ) from None
        rows.append(row)
    if not names:
        raise DataError(f"{one} {path} is empty.")
    return names, rows


def _check(path: Path, columns: dict[str, Array]) -> None:
    """Refuse what cannot be a recording of a car."""
    for name, values in columns.items():
        bad = ~np.isfinite(values)
        if bad.any():
            raise DataError(
                f"Recording {path} has {values[bad][0]} in column {name}, sample "
                f"{int(np.argmax(bad))}, but all numbers must be finite."
            )
    t = columns["t_s"]
    step = np.diff(t)
    if (step <= 0.0).any():
        i = int(np.argmax(step <= 0.0))
        what = "repeats" if step[i] == 0.0 else "goes back"
        raise DataError(
            f"Time {what} in recording {path}: t_s is {t[i]:g} in sample {i} and {t[i + 1]:g} in "
            "the next, but must grow."
        )
    usual = float(np.median(step))
    if usual > SPARSE:
        hint = "; are these milliseconds?" if usual >= 1.0 else ""
        raise DataError(
            f"Recording {path} has a sample every {usual:g} s, but must have one every "
            f"{SPARSE:g} s or more often{hint}."
        )
    if t[-1] - t[0] < SHORTEST:
        raise DataError(
            f"Recording {path} is {t[-1] - t[0]:.3g} s long, but must be at least "
            f"{SHORTEST:g} s."
        )
    for name, (largest, unit) in LIMITS.items():
        if name in columns:
            _check_size(path, name, columns[name], largest, unit)
    _check_speed(path, columns["vx_mps"])
    _check_steering(path, columns)


def _check_size(path: Path, name: str, values: Array, largest: float, unit: str) -> None:
    top = float(np.abs(values).max())
    if top <= largest:
        return
    hint = ""
    if name in DEGREES and top <= DEGREES[name]:
        hint = f"; are these degrees{'' if name == 'delta_rad' else ' per second'}? 1 degree is "
        hint += f"{math.radians(1.0):.5f} rad"
        if name == "delta_rad":
            hint += ", and the road wheel's angle is needed, not the hand wheel's"
    elif name == "delta_rad":
        hint = "; is it the hand wheel's angle? The road wheel's is needed"
    elif name == "vx_mps":
        hint = "; are these kilometres per hour?"
    raise DataError(
        f"Recording {path} has {name} up to {top:.4g}, but no car has more than {largest:g} "
        f"{unit}{hint}."
    )


def _check_speed(path: Path, vx: Array) -> None:
    if np.median(vx) < 0.0:
        raise DataError(
            f"Recording {path} drives backwards (vx_mps is {np.median(vx):.3g} in the median), but "
            "only driving forwards is replayed."
        )
    if vx.max() < SLOWEST:
        raise DataError(
            f"Recording {path} is never faster than {vx.max():.3g} m/s, but must be above "
            f"{SLOWEST:g} m/s somewhere."
        )


def _check_steering(path: Path, columns: dict[str, Array]) -> None:
    """Refuse a recording without steering, of the other sign, or of the hand wheel's angle.

    A single track turns with r = vx delta / (L + K vx^2); its apparent wheelbase, vx delta / r, is
    L where the car is slow, and larger where it is fast (by K vx^2, that is two or three times, but
    not twelve).
    """
    delta, vx, r = (columns[name] for name in ("delta_rad", "vx_mps", "r_radps"))
    moving = vx >= SLOWEST
    steering, yaw = delta[moving] * vx[moving], r[moving]
    if steering.std() < 1e-3 or yaw.std() < 1e-3:
        raise DataError(
            f"Recording {path} drives straight on (the standard deviation of delta_rad is "
            f"{delta[moving].std():.2g} rad, of r_radps {yaw.std():.2g} rad/s), but only bends say "
            "something about a car."
        )
    steering, yaw = steering - steering.mean(), yaw - yaw.mean()
    alike = float(steering @ yaw / math.sqrt((steering @ steering) * (yaw @ yaw)))
    apparent = float(steering @ yaw / (yaw @ yaw))
    if alike < -0.5:
        raise DataError(
            f"Steering and yaw rate have opposite signs in recording {path} (correlation "
            f"{alike:.2f}), but left must be positive in delta_rad and in r_radps."
        )
    if alike < 0.5:
        return
    slowest = float(np.percentile(vx[moving], 10))
    low, high = HAND_WHEEL
    largest = WHEELBASES[1] + 0.008 * float(np.median(vx[moving])) ** 2
    if apparent > largest:
        ratio = apparent / 2.7
        hint = (
            "; is delta_rad the hand wheel's angle? The road wheel's is needed, 12 to 20 times "
            "smaller" if ratio > 0.5 * low and ratio < 4.0 * high
            else "; are these degrees?" if ratio > 30.0 else ""
        )
        raise DataError(
            f"The car of recording {path} turns as one with a wheelbase of {apparent:.3g} m would "
            f"(vx delta / r, from {slowest:.2g} m/s on), but must turn as a car of "
            f"{WHEELBASES[0]:g} to {WHEELBASES[1]:g} m{hint}."
        )
    if apparent < 0.3 * WHEELBASES[0]:
        raise DataError(
            f"The car of recording {path} turns as one with a wheelbase of {apparent:.2g} m would "
            f"(vx delta / r), but must turn as a car of {WHEELBASES[0]:g} to {WHEELBASES[1]:g} m; "
            "are r_radps degrees per second?"
        )
