"""One replay from beginning to end: fit, if asked for, then compare the plant and single tracks."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lpvmpc.identify import push as pushes
from lpvmpc.identify.candidate import IN_SINGLE_TRACK, Candidate, check_names
from lpvmpc.identify.fit import Fit, fit
from lpvmpc.identify.follow import Push
from lpvmpc.identify.predict import PLANT, Predictor, Simulated, plant, track
from lpvmpc.identify.recording import Recording
from lpvmpc.identify.scores import Scores, error_energy, scores
from lpvmpc.identify.single_track import KINDS

MODELS = (PLANT, *KINDS)
"""The models, in the order of tables."""
TITLES = {
    PLANT: "MuJoCo plant", "linear": "linear single track", "nonlinear": "nonlinear single track",
}
"""What they are called."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Replay:
    """What a replay has found."""

    recording: Recording
    segments: Sequence[Recording]
    """Of the recording."""
    names: tuple[str, ...]
    """Parameters asked for; empty where nothing was fitted."""
    fitted_on: tuple[str, ...]
    """Names of the recordings that were fitted on."""
    fits: Mapping[str, Fit]
    """By model."""
    candidates: Mapping[str, Candidate]
    """By model."""
    simulated: Mapping[str, Sequence[Simulated]]
    """By model, segment by segment."""
    scores: Mapping[str, Scores]
    """By model."""
    energies: Mapping[str, Mapping[str, float]]
    """Error energy by model and channel."""
    follow: str
    """What followed the speed."""
    unpushed: Mapping[str, float | None] | None
    """Where a side force and a yaw moment acted besides: the plant's R2 by channel without them."""
    more: dict[str, Any] = field(default_factory=dict)
    """What a command adds."""

    def ratio(self, model: str, channel: str = "all") -> float:
        """Error energy of the plant over that of another model."""
        return self.energies[PLANT][channel] / max(self.energies[model][channel], 1e-30)

    def as_json(self) -> dict[str, Any]:
        """Everything printed, as JSON has it."""
        return {
            "recording": self.recording.name,
            "samples": sum(len(one.t) for one in self.segments),
            "segments": [[float(one.t[0]), float(one.t[-1])] for one in self.segments],
            "steering_held": self.recording.held, "follow": self.follow,
            "push": self.unpushed is not None,
            "r2_without_push": None if self.unpushed is None else dict(self.unpushed),
            "fit": list(self.names), "fit_on": list(self.fitted_on),
            "models": {
                model: {
                    **self.scores[model].as_json(),
                    "error_energy": dict(self.energies[model]),
                    **({"fit": self.fits[model].as_json()} if model in self.fits else {}),
                }
                for model in MODELS
            },
            "error_energy_ratio": {
                kind: {channel: self.ratio(kind, channel) for channel in self.energies[kind]}
                for kind in KINDS
            },
            **self.more,
        }


def conduct(
    start: Candidate, recording: Recording, names: Sequence[str] = (),
    fit_on: Sequence[Recording] = (), *, follow: str = "wheels", push: Push | None = None,
    track_names: Sequence[str] | None = None, fits: Mapping[str, Fit] | None = None,
    progress: Callable[[str], None] = lambda what: None,
) -> Replay:
    """Replay a recording, perhaps after a fit.

    Args:
        start: The car.
        recording: What is replayed and scored.
        names: Parameters to identify; the single tracks identify those of them that they have.
        fit_on: Recordings to fit on (default: the one that is scored).
        follow: What follows the speed; see `follow.FOLLOW`.
        push: Side force and yaw moment that act besides while the recording is scored.
        track_names: Parameters that the single tracks identify instead, of those they have.
        fits: Fits of an earlier call with the same names and `fit_on`, taken instead of new ones.
        progress: Called with what begins.

    Raises:
        UnknownNameError: A parameter that does not exist.
        DataError: A recording has no segment that can be replayed, or the push was identified on
            the one that is scored.
        LPVMPCError: The car cannot follow.
    """
    check_names(names)
    segments = recording.segments()
    predictors: dict[str, Predictor] = {PLANT: plant(follow, push)}
    predictors |= {kind: track(kind) for kind in KINDS}
    made: dict[str, Fit] = dict(fits or {})
    candidates = dict.fromkeys(MODELS, start)
    basis = list(fit_on) or [recording]
    if names:
        for model in MODELS:
            wanted = names if model == PLANT or track_names is None else track_names
            own = [n for n in wanted if model == PLANT or n in IN_SINGLE_TRACK[model]]
            if own and model not in made:
                progress(f"fitting the {TITLES[model]}")
                predict = plant(follow) if model == PLANT else predictors[model]
                made[model] = fit(start, own, basis, predict)
    candidates |= {model: one.candidate for model, one in made.items()}
    progress("replaying")
    unpushed = None
    if push is not None:
        pushes.check(push, recording)
        alone = [plant(follow)([candidates[PLANT]], one)[0] for one in segments]
        unpushed = {name: one.r2 for name, one in scores(segments, alone).whole.items()}
    simulated = {
        model: [predictors[model]([candidates[model]], one)[0] for one in segments]
        for model in MODELS
    }
    return Replay(
        recording=recording, segments=segments, names=tuple(names),
        fitted_on=tuple(one.name for one in basis) if names else (), fits=made,
        candidates=candidates, simulated=simulated,
        scores={model: scores(segments, simulated[model]) for model in MODELS},
        energies={model: error_energy(segments, simulated[model]) for model in MODELS},
        follow=follow, unpushed=unpushed,
    )
