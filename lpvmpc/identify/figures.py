"""Overlay plots: what was measured, what the plant and the linear single track make of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lpvmpc.identify.conduct import TITLES, Replay
from lpvmpc.identify.predict import PLANT
from lpvmpc.identify.scores import channels
from lpvmpc.picture import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LABELS = {"r": "yaw rate [rad/s]", "vy": "vy [m/s]", "ay": "ay [m/s2]"}
"""Axes by channel."""
SEEN = 30.0
"""Length of the excerpt that is drawn [s]: where the car turns most."""


@style.styled
def overlay(replay: Replay) -> Figure:
    """Steering, speed and each channel over time, the differences below: an excerpt."""
    segment = max(replay.segments, key=lambda one: one.t[-1] - one.t[0])
    index = list(replay.segments).index(segment)
    names = list(channels(segment))
    figure = style.blank(style.DOUBLE, 1.1 + 1.55 * len(names))
    axes = figure.subplots(1 + len(names), 1, sharex=True)
    starts = np.arange(segment.t[0], max(segment.t[-1] - SEEN, segment.t[0]) + 1.0, 1.0)
    power = [
        float((segment.r[(segment.t >= t) & (segment.t < t + SEEN)] ** 2).sum()) for t in starts
    ]
    first = float(starts[int(np.argmax(power))])
    part = (segment.t >= first) & (segment.t < first + SEEN)
    t = segment.t[part]
    axes[0].plot(t, np.degrees(segment.delta[part]), color=style.GREY)
    axes[0].set_ylabel("steering [deg]")
    twin = axes[0].twinx()
    twin.plot(t, segment.vx[part], color=style.GREEN)
    twin.set_ylabel("vx [m/s]", color=style.GREEN)
    twin.grid(False)
    for axis, name in zip(axes[1:], names, strict=True):
        axis.plot(t, channels(segment)[name][part], color="black", linewidth=1.6, label="measured")
        for model, colour in ((PLANT, style.BLUE), ("linear", style.RED)):
            values = replay.simulated[model][index][name][part]
            axis.plot(t, values, color=colour, label=TITLES[model], linewidth=0.9)
        axis.set_ylabel(LABELS[name])
    axes[1].legend(ncol=3, loc="upper right")
    axes[-1].set_xlabel("time [s]")
    return figure
