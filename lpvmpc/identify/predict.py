"""What a model makes of a recording: the plant, or a single track."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lpvmpc.identify import single_track
from lpvmpc.identify.candidate import Candidate
from lpvmpc.identify.follow import Push, first_of, replay
from lpvmpc.identify.recording import Recording
from lpvmpc.identify.scores import channels
from lpvmpc.units import Array

Simulated = dict[str, Array]
"""`r`, `vy`, `ay`, `x`, `y`, `psi` over one segment, shapes (n,)."""
Predictor = Callable[[Sequence[Candidate], Recording], list[Simulated]]
"""What gives them, for many candidates on one segment."""
BEGINNING = 1.0
"""Time in which it shows how a segment began [s]."""
PLANT = "plant"
"""Name of the MuJoCo plant among the models."""


def plant(follow: str = "wheels", push: Push | None = None, threads: int = 0) -> Predictor:
    """The MuJoCo plant; see `follow.replay` for the arguments.

    How a segment begins is not recorded: with the wheel held where it is, or as it is being turned.
    Of the two, the one is taken that fits the first second better, once for each segment.
    """
    begun: dict[Recording, bool] = {}

    def predict(candidates: Sequence[Candidate], segment: Recording) -> list[Simulated]:
        if segment not in begun:
            begun[segment] = _turning(candidates[0], segment, follow, threads)
        motion = replay(
            [one.model() for one in candidates], segment, [one.steering for one in candidates],
            follow=follow, push=push, turning=begun[segment], threads=threads,
        )
        names = ("r", "vy", "ay", "x", "y", "psi", "vx", "ax")
        return [
            {name: getattr(motion, name)[i] for name in names} for i in range(len(candidates))
        ]

    return predict


def _turning(candidate: Candidate, segment: Recording, follow: str, threads: int) -> bool:
    """Whether a segment begins as the wheel is being turned."""
    first = first_of(segment, BEGINNING)
    errors = []
    for turning in (False, True):
        motion = replay(
            [candidate.model()], first, [candidate.steering], follow=follow, turning=turning,
            threads=threads,
        )
        wrong = 0.0
        for name, measured in channels(first).items():
            scale = max(float(channels(segment)[name].std()), 1e-6)
            wrong += float((((getattr(motion, name)[0] - measured) / scale) ** 2).sum())
        errors.append(wrong)
    return errors[1] < 0.7 * errors[0]


def track(kind: str) -> Predictor:
    """A single track, one of `single_track.KINDS`."""

    def predict(candidates: Sequence[Candidate], segment: Recording) -> list[Simulated]:
        return [
            single_track.drive(one.single_track(), segment, one.steering, kind)
            for one in candidates
        ]

    return predict
