"""Pictures for the Markdown report: profiles, error against time, error over friction and grip."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.leaderboard.profiles import profiles
from lpvmpc.leaderboard.score import Board, Score, error, ranking
from lpvmpc.picture import style as house

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = (*house.RUNS, house.GREY, "#000000", "#8C510A", "#762A83", "#35978F", "#B8E186",
           "#E7298A", "#1F3A93", "#999900", "#C2A5CF", "#B2182B", "#4D4D00")
"""Colours of the controllers, in their order; more of them than the package has controllers."""


def pictures(board: Board) -> dict[str, Figure]:
    """The pictures of what was driven, by the names of their files."""
    drawn = {"benchmark-profiles.png": profile_curves(board), "benchmark-pareto.png": pareto(board)}
    if board.cells("limits"):
        drawn["benchmark-heat.png"] = heat(board)
    return drawn


def colour(board: Board, name: str) -> str:
    """A controller's colour."""
    return COLOURS[board.controllers.index(name) % len(COLOURS)]


@house.styled
def profile_curves(board: Board) -> Figure:
    """Share of the cells driven within a factor of the best, world by world."""
    worlds = board.worlds()
    figure = house.blank(house.DOUBLE, 2.5)
    grid = figure.subplots(1, len(worlds), sharey=True, squeeze=False)[0]
    names = board.full or board.controllers
    for axes, world in zip(grid, worlds, strict=True):
        cells = board.cells("worlds", world, by=names)
        for profile in profiles(board, cells, names) if cells else ():
            corners = profile.steps()
            x = [1.0, *(factor for factor, _ in corners), 100.0]
            y = [0.0, *(share for _, share in corners)]
            axes.step(x, [*y, y[-1]], where="post", label=profile.controller,
                      color=colour(board, profile.controller))
        axes.set_xscale("log")
        axes.set_xlim(1.0, 100.0)
        axes.set_ylim(-0.02, 1.02)
        house.label(axes, "factor of the best RMSE", "", f"{world} ({len(cells)})")
    grid[0].set_ylabel("share of cells")
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6))
    return figure


@house.styled
def pareto(board: Board) -> Figure:
    """95th percentile of the error against the median step time, with intervals."""
    from matplotlib.ticker import LogLocator, NullFormatter

    worlds = board.worlds()
    figure = house.blank(house.DOUBLE, 2.7)
    grid = figure.subplots(1, len(worlds), sharex=True, sharey=True, squeeze=False)[0]
    for axes, world in zip(grid, worlds, strict=True):
        found = [s for s in ranking(board, board.cells("worlds", world), board.controllers)
                 if s.step_us[0]]
        values = [1e3 * s.p95 for s in found if math.isfinite(s.p95)]
        top = 3.0 * max(values, default=1.0)
        for s in sorted(found, key=lambda s: board.controllers.index(s.controller)):
            _point(axes, s, top, colour(board, s.controller))
        axes.set_xscale("log")
        axes.set_yscale("log")
        house.label(axes, "step p50 [us]", "", world)
    left, right = grid[0].get_xlim()
    steps = (1.0, 2.0, 5.0) if right < 50.0 * left else (1.0,)  # labels must not touch
    for axes in grid:
        axes.xaxis.set_major_locator(LogLocator(subs=steps))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    grid[0].set_ylabel("RMSE, 95th percentile [mm]")
    marks: dict[str, Any] = {}
    for axes in grid:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            marks.setdefault(text, handle)
    names = [name for name in board.controllers if name in marks]
    figure.legend([marks[name] for name in names], names, loc="outside lower center",
                  ncols=min(len(names), 6))
    return figure


def _point(axes: Any, s: Score, top: float, color: str) -> None:
    """A controller with its intervals; a triangle at the top where it is charged."""
    x = s.step_us[0]
    assert x is not None
    if math.isinf(s.p95):
        axes.plot([x], [top], marker="^", color=color, ls="none", label=s.controller)
        return
    y = 1e3 * s.p95
    low, high = (1e3 * value for value in s.p95_interval)
    left, right = s.step_interval or (x, x)
    across = [[max(x - left, 0.0)], [max((right if math.isfinite(right) else x) - x, 0.0)]]
    if math.isinf(high):  # open: too few runs to say
        axes.plot([x, x], [y, 2.0 * top], lw=0.6, ls=":", color=color)
        high = y
    up = [[max(y - low, 0.0)], [max(high - y, 0.0)]]
    axes.errorbar([x], [y], xerr=across, yerr=up, marker="o", ms=3.5, lw=0.8, color=color,
                  ls="none", label=s.controller)


@house.styled
def heat(board: Board) -> Figure:
    """Lateral RMSE on the circuit over grip and friction, a map for each controller."""
    from matplotlib.colors import LogNorm

    cells = board.cells("limits")
    grips = sorted({cell.grip or 0.0 for cell in cells})
    frictions = sorted({cell.friction for cell in cells})
    names = [name for name in board.controllers if board.of(name, cells)]
    maps = {}
    for name in names:
        values = np.full((len(frictions), len(grips)), np.nan)
        for cell in cells:
            if name in board.table[cell]:
                at = frictions.index(cell.friction), grips.index(cell.grip or 0.0)
                values[at] = 1e3 * error(board.table[cell][name])
        maps[name] = values
    every = np.concatenate([values.ravel() for values in maps.values()])
    finite = every[np.isfinite(every)]
    low, high = (finite.min(), finite.max()) if len(finite) else (1.0, 10.0)
    norm = LogNorm(max(low, 1e-3), max(high, 2e-3, 1.01 * low))
    columns = min(4, len(names))
    lines = math.ceil(len(names) / columns)
    figure = house.blank(house.DOUBLE, 0.5 + 1.35 * lines)
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False)
    image = None
    for axes in grid.flat[len(names):]:
        axes.set_axis_off()
    for axes, (name, values) in zip(grid.flat, maps.items(), strict=False):
        axes.grid(False)
        axes.set_facecolor("#DDDDDD")
        image = axes.imshow(np.where(np.isfinite(values), values, np.nan), norm=norm,
                            origin="lower", aspect="auto", cmap="viridis")
        for i, j in zip(*np.nonzero(np.isinf(values)), strict=True):
            axes.plot([j], [i], marker="x", color=house.RED, ms=5)
        axes.set_xticks(range(len(grips)), [f"{100 * grip:.0f}" for grip in grips])
        axes.set_yticks(range(len(frictions)), [f"{friction:g}" for friction in frictions])
        axes.set_title(name)
    for axes in grid.flat[max(len(names) - columns, 0) : len(names)]:  # the lowest of each column
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("grip [%]")
    for axes in grid[:, 0]:
        axes.set_ylabel("friction")
    if image is not None:
        figure.colorbar(image, ax=grid, label="RMSE [mm]; x: charged; grey: not driven")
    return figure
