"""The path of one run or of several, with zooms of the lateral error (the paper's Fig. 8).

The error is millimetres on a road of a kilometre, so the zooms are straightened: distance along
the path against the error across it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.picture.style import COLUMN, RED, RUNS, blank, peak, y_label

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPAN = 25.0
"""Half the width of a zoom along the path [m]."""


def draw(runs: Mapping[str, dict[str, Any]], title: str, focus: str | None = None) -> Figure:
    """Paths on the road and three zooms, in the style that the caller has set.

    Args:
        runs: Columns of each run's log, by its name in the legend.
        title: Title of the figure.
        focus: The run whose places are zoomed, and whose error must fit (default: the first).
    """
    main = runs[focus or next(iter(runs))]
    longest = max(runs.values(), key=lambda c: float(c["s_m"][-1]))
    wide, high = np.ptp(longest["x_ref_m"]) + 40.0, np.ptp(longest["y_ref_m"]) + 40.0  # m
    tall = float(np.clip(2.9 * high / wide, 0.9, 2.9))  # inch
    figure = blank(COLUMN, tall + 1.95 + 0.15 * (len(runs) // 2))
    grid = figure.add_gridspec(2, 3, height_ratios=(tall, 1.0))
    plane = figure.add_subplot(grid[0, :])
    plane.set_title(title)
    plane.plot(longest["x_ref_m"], longest["y_ref_m"], color="#D4D4D4", lw=4.0,
               solid_capstyle="round", label="road")
    plane.plot(longest["x_ref_m"], longest["y_ref_m"], color="black", lw=0.8, ls=(0, (4, 2)),
               label="reference", zorder=4)
    for n, ((name, c), colour) in enumerate(zip(runs.items(), RUNS, strict=False)):
        plane.plot(c["x_m"], c["y_m"], color=colour, lw=1.6, label=name, zorder=3.0 - 0.1 * n)
        if c["s_m"][-1] < longest["s_m"][-1] - SPAN:  # lost here
            plane.plot(c["x_m"][-1], c["y_m"][-1], "x", color=colour, ms=6.0, mew=1.6, zorder=5)
    plane.plot(main["x_m"][0], main["y_m"][0], "o", color="black", ms=3.5, label="start", zorder=5)
    plane.set_aspect("equal", adjustable="datalim")
    y_label(plane, "y [m]")
    plane.set_xlabel("x [m]")
    handles, labels = plane.get_legend_handles_labels()
    figure.legend(handles, labels, ncols=4 if len(runs) == 1 else 3, loc="outside lower center")

    for index, (letter, (what, row)) in enumerate(zip("ABC", zooms(main).items(), strict=True)):
        mark = (float(main["x_m"][row]), float(main["y_m"][row]))
        plane.plot(*mark, "o", ms=5.0, mfc="white", mec=RED, mew=1.0, zorder=6)
        plane.annotate(letter, mark, xytext=(4, 4), textcoords="offset points", color=RED,
                       weight="bold", zorder=7)
        zoom = figure.add_subplot(grid[1, index])
        zoom.axhline(0.0, color="black", lw=0.8, ls=(0, (4, 2)))
        limit = 0.01  # mm
        for n, (c, colour) in enumerate(zip(runs.values(), RUNS, strict=False)):
            along = c["s_m"] - main["s_m"][row]
            near = np.abs(along) <= SPAN
            zoom.plot(along[near], 1e3 * c["ey_m"][near], color=colour, lw=1.2,
                      zorder=3.0 - 0.1 * n)
            if c is main:
                limit = max(1.15e3 * peak(c["ey_m"][near]), limit)
        zoom.set_ylim(-limit, limit)
        zoom.set_title(f"{letter}  {what}", fontsize=6.8, color=RED)
        y_label(zoom, "left error [mm]" if index == 0 else "")
        zoom.locator_params(axis="y", nbins=3)
        zoom.set_xlim(-SPAN, SPAN)
        zoom.set_xticks((-20, 0, 20))
        zoom.set_xlabel(f"s − {max(main['s_m'][row], 0.0):.0f} [m]")
    return figure


def zooms(c: dict[str, Any]) -> dict[str, int]:
    """Three rows worth a closer look, by what happens there.

    The largest lateral error, the tightest bend, and the strongest wind; where two of them are one
    place, or there is no wind, the next largest errors elsewhere.
    """
    error = np.nan_to_num(np.abs(c["ey_m"]))
    rows = {"largest error": int(np.argmax(error))}
    elsewhere = np.ones(len(error), dtype=bool)

    def beyond(row: int) -> None:
        elsewhere[np.abs(c["s_m"] - c["s_m"][row]) <= 2.0 * SPAN] = False

    beyond(rows["largest error"])
    for what, name in (("tightest bend", "kappa_radpm"), ("peak wind", "wind_mps")):
        row = int(np.argmax(np.nan_to_num(np.abs(c[name]))))
        if elsewhere[row] and abs(c[name][row]) > 0.0:
            rows[what] = row
            beyond(row)
    for what in ("second error", "third error"):
        if len(rows) < 3:  # on a road too short for three places, somewhere
            rows[what] = int(np.argmax(np.where(elsewhere, error, -1.0)))
            beyond(rows[what])
    return rows
