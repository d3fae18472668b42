"""How alike a simulated and a measured motion are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lpvmpc.identify.recording import Recording
from lpvmpc.units import Array

CHANNELS = {"r": "r_radps", "vy": "vy_mps", "ay": "ay_mps2"}
"""What is compared, where it was measured: names here and in recordings."""
WINDOW = 10.0
"""Length of a window [s]."""
BANDS = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 30.0)
"""Edges of the bands of lateral acceleration |r vx| [m/s2]."""
FEWEST = 20
"""Fewest samples that are scored."""
LAG_MAX = 0.3
"""Largest lag that is looked for [s]."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """One channel over some samples."""

    samples: int
    """Their number."""
    r2: float | None
    """1 - sum (simulated - measured)^2 / sum (measured - its mean)^2; None where nothing varies."""
    nrmse: float | None
    """Root mean square of the difference over the measured range."""
    rmse: float
    """The same, unscaled."""
    gain: float | None = None
    """Simulated over measured amplitude, at the lag (regression)."""
    lag_s: float | None = None
    """Time by which the simulated motion is late, where the two are most alike."""


def score(simulated: Array, measured: Array, step: float | None = None) -> Score:
    """Compare two signals of shape (n,); gain and lag where the step of time [s] is given."""
    error = simulated - measured
    spread = float(((measured - measured.mean()) ** 2).sum())
    energy = float((error**2).sum())
    rmse = float(np.sqrt(energy / len(error)))
    span = float(np.ptp(measured))
    if spread <= 0.0 or span <= 0.0:
        return Score(samples=len(error), r2=None, nrmse=None, rmse=rmse)
    gain, lag = (None, None) if step is None else gain_and_lag(simulated, measured, step)
    return Score(
        samples=len(error), r2=1.0 - energy / spread, nrmse=rmse / span, rmse=rmse, gain=gain,
        lag_s=lag,
    )


def gain_and_lag(simulated: Array, measured: Array, step: float) -> tuple[float, float]:
    """Gain and lag [s] at which simulated(t) = gain measured(t - lag) + constant is nearest.

    The lag is where the correlation is largest, by a parabola through the three samples there.
    """
    most = min(round(LAG_MAX / step), len(measured) // 4)
    inner = slice(most, len(measured) - most)
    late = simulated[inner] - simulated[inner].mean()
    shifts = range(-most, most + 1)
    fits = []
    for shift in shifts:
        other = measured[most - shift : len(measured) - most - shift]
        other = other - other.mean()
        power = float(other @ other)
        cross = float(late @ other)
        fits.append((cross / np.sqrt(power) if power > 0.0 else 0.0, cross / max(power, 1e-30)))
    values = np.array([alike for alike, _ in fits])
    best = int(values.argmax())
    lag = float(shifts[best])
    if 0 < best < len(values) - 1:
        left, middle, right = values[best - 1 : best + 2]
        curve = left - 2.0 * middle + right
        if curve < 0.0:
            lag += 0.5 * float(left - right) / float(curve)
    return fits[best][1], lag * step


def channels(recording: Recording) -> dict[str, Array]:
    """What was measured, by name."""
    found = {"r": recording.r}
    if recording.vy is not None:
        found["vy"] = recording.vy
    if recording.ay is not None:
        found["ay"] = recording.ay
    return found


@dataclass(frozen=True, kw_only=True)
class Scores:
    """All scores of one model on one recording."""

    whole: Mapping[str, Score]
    """By channel, over all segments together."""
    windows: Sequence[tuple[float, float, Mapping[str, Score]]]
    """Beginning and end [s], scores by channel."""
    bands: Sequence[tuple[float, float, Mapping[str, Score]]]
    """Least and largest |r vx| [m/s2], scores by channel."""
    drift: Sequence[Mapping[str, float]]
    """By segment: where a car that moves as measured has got to, and how far the simulated one is
    from there."""

    def as_json(self) -> dict[str, Any]:
        """The same as JSON has it."""

        def plain(by: Mapping[str, Score]) -> dict[str, Any]:
            return {CHANNELS[name]: asdict(one) for name, one in by.items()}

        return {
            "whole": plain(self.whole),
            "windows": [
                {"from_s": low, "to_s": high, **plain(by)} for low, high, by in self.windows
            ],
            "bands": [
                {"from_mps2": low, "to_mps2": high, **plain(by)} for low, high, by in self.bands
            ],
            "pose_drift": [dict(one) for one in self.drift],
        }


def scores(
    segments: Sequence[Recording], simulated: Sequence[Mapping[str, Array]]
) -> Scores:
    """Score a model on the segments of a recording.

    Args:
        segments: What was measured.
        simulated: `r`, `vy`, `ay` of the model on each, and `x`, `y`, `psi`; shapes (n,).
    """
    names = list(channels(segments[0]))
    step = segments[0].step
    measured = {
        name: np.concatenate([channels(one)[name] for one in segments]) for name in names
    }
    model = {name: np.concatenate([one[name] for one in simulated]) for name in names}
    time = np.concatenate([one.t for one in segments])
    lateral = np.abs(np.concatenate([one.lateral for one in segments]))

    def at(pick: Array, step: float | None) -> dict[str, Score]:
        return {name: score(model[name][pick], measured[name][pick], step) for name in names}

    windows = []
    for low in np.arange(time[0], time[-1], WINDOW):
        pick = (time >= low) & (time < low + WINDOW)
        if pick.sum() >= FEWEST:
            windows.append((float(low), float(min(low + WINDOW, time[-1])), at(pick, step)))
    bands = []
    for low, high in zip(BANDS[:-1], BANDS[1:], strict=True):
        pick = (lateral >= low) & (lateral < high)
        if pick.sum() >= FEWEST:
            bands.append((low, high, at(pick, None)))
    return Scores(
        whole=at(np.ones(len(time), bool), step), windows=windows, bands=bands,
        drift=[_drift(one, two) for one, two in zip(segments, simulated, strict=True)],
    )


def _drift(segment: Recording, simulated: Mapping[str, Array]) -> dict[str, float]:
    """How far the simulated car is from where the measured speeds lead (dead reckoning).

    Where vy was not measured, the simulated one is taken.
    """
    dt = np.diff(segment.t)
    vy = simulated["vy"] if segment.vy is None else segment.vy

    def integral(values: Array) -> Array:
        return np.concatenate([[0.0], np.cumsum(0.5 * dt * (values[1:] + values[:-1]))])

    psi = integral(segment.r)
    x = integral(segment.vx * np.cos(psi) - vy * np.sin(psi))
    y = integral(segment.vx * np.sin(psi) + vy * np.cos(psi))
    far = np.hypot(simulated["x"] - x, simulated["y"] - y)
    return {
        "from_s": float(segment.t[0]), "to_s": float(segment.t[-1]),
        "distance_m": float(integral(np.hypot(segment.vx, vy))[-1]),
        "position_m": float(far[-1]), "position_max_m": float(far.max()),
        "heading_rad": float(simulated["psi"][-1] - psi[-1]),
        "heading_max_rad": float(np.abs(simulated["psi"] - psi).max()),
    }


def error_energy(
    segments: Sequence[Recording], simulated: Sequence[Mapping[str, Array]],
    pick: Sequence[Array] | None = None,
) -> dict[str, float]:
    """Energy of the errors over that of what was measured, 1 - R2, by channel, and their sum."""
    total: dict[str, float] = {}
    for name in ("r", "vy"):
        if name in channels(segments[0]):
            measured = np.concatenate([channels(one)[name] for one in segments])
            model = np.concatenate([one[name] for one in simulated])
            if pick is not None:
                chosen = np.concatenate(list(pick))
                measured, model = measured[chosen], model[chosen]
            total[name] = float(
                ((model - measured) ** 2).sum() / ((measured - measured.mean()) ** 2).sum()
            )
    total["all"] = sum(total.values())
    return total
