"""Pictures of the worlds: which share of runs stays below an error, and margins as bars."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from lpvmpc.bench.margins import Margin
from lpvmpc.bench.worlds import MODELS, ROADS, Cell, DrivenCell
from lpvmpc.bench.worlds_stats import grouped
from lpvmpc.bench.worlds_verdict import Found, reach
from lpvmpc.picture import style as house

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHOWN = ("paper", "circuit-65", "circuit-80")
"""Roads of the pictures, a line each."""
LOST_LEVEL = 0.09
"""How far below no runs at all those are marked who lost every run [share of runs]."""
ROW_HEIGHT = 1.55
"""Height of a line of pictures [inch]."""


def pictures(found: Found) -> dict[str, Figure]:
    """The pictures of what was driven, by the names of their files."""
    drawn = {}
    if rows := [row for row in found.rows.get("worlds", ()) if row.cell.case != "ideal"]:
        drawn["worlds.png"] = shares(rows, lambda cell: cell.controller, found.plan.controllers)
    if found.margins:
        drawn["worlds-margins.png"] = bars(found.margins)
    if rows := list(found.rows.get("adaptation", ())):
        rows = [row for row in rows if row.cell.case != "ideal"]
        drawn["worlds-adaptation.png"] = shares(rows, lambda cell: cell.model, tuple(MODELS))
    return drawn


@house.styled
def shares(rows: Sequence[DrivenCell], who: Callable[[Cell], str], names: Sequence[str]) -> Figure:
    """Share of runs whose RMSE stays below a value, over the value: worlds beside each other.

    Args:
        rows: The runs.
        who: Whose curve a run belongs to.
        names: All of these, in their order.
    """
    worlds = list(dict.fromkeys(row.cell.case for row in rows))
    roads = [road for road in SHOWN if any(row.cell.road == road for row in rows)]
    groups = grouped(rows, lambda cell: (cell.case, cell.road, who(cell)))
    powers = _decades([1e3 * row.rmse for row in rows if row.completed])
    figure = house.blank(house.DOUBLE, 0.45 + ROW_HEIGHT * len(roads))
    grid = figure.subplots(len(roads), len(worlds), sharex=True, sharey=True, squeeze=False)
    for axes_of_road, road in zip(grid, roads, strict=True):
        for axes, world in zip(axes_of_road, worlds, strict=True):
            for i, name in enumerate(names):
                _curve(axes, groups.get((world, road, name), ()), i, name)
            axes.set_xscale("log")
            axes.set_xticks(powers)
            axes.set_xticks([], minor=True)
            axes.set_xlim(powers[0], powers[-1])
            axes.set_ylim(-2.0 * LOST_LEVEL, 1.03)
            axes.set_yticks([0.0, 0.5, 1.0])
            _mark_lost(axes, groups, (world, road), names)
        axes_of_road[0].set_ylabel(f"{ROADS[road].title}\nshare of runs")
    for axes, world in zip(grid[0], worlds, strict=True):
        axes.set_title(world)
    for axes in grid[-1]:
        axes.set_xlabel("lateral RMSE [mm]")
    _legend(figure, names)
    return figure


def _decades(values: Sequence[float]) -> list[float]:
    """The powers of ten from below all values to above them."""
    low, high = min(values, default=1.0), max(values, default=10.0)
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high) + 1e-9)
    return [10.0**i for i in range(first, last + 1)]


def _lost(
    groups: Mapping[tuple[str, ...], Sequence[DrivenCell]], where: tuple[str, str],
    names: Sequence[str],
) -> list[str] | None:
    """Who has no curve in a world on a road, since every run was lost; None where nobody drove."""
    driven = {name: groups[(*where, name)] for name in names if (*where, name) in groups}
    if not driven:
        return None
    return [name for name, rows in driven.items() if not any(row.completed for row in rows)]


def _mark_lost(
    axes: Any, groups: Mapping[tuple[str, ...], Sequence[DrivenCell]], where: tuple[str, str],
    names: Sequence[str],
) -> None:
    """A cross for everyone who lost all runs, below the axis of no runs, where no curve comes."""
    below = axes.get_yaxis_transform()  # x as a share of the width, y as a share of the runs
    lost = _lost(groups, where, names)
    for k, name in enumerate(reversed(lost or [])):
        axes.plot(0.96 - 0.06 * k, -LOST_LEVEL, "x", color=_colour(names.index(name)), ms=3.5,
                  mew=1.2, transform=below)
    if lost is None or lost:
        text = "not driven" if lost is None else "all lost"
        axes.text(0.98 - 0.06 * (len(lost or [])), -LOST_LEVEL, text, fontsize=5.5, ha="right",
                  va="center", transform=below, color=house.GREY)


def _curve(axes: Any, rows: Sequence[DrivenCell], i: int, name: str) -> None:
    """One curve; it ends at the share of completed runs."""
    if not rows:
        return
    values = sorted(1e3 * row.rmse for row in rows if row.completed)
    levels = [(k + 1) / len(rows) for k in range(len(values))]
    colour = _colour(i)
    axes.step([*values[:1], *values], [0.0, *levels] if values else [], where="post",
              color=colour, label=name)
    if values:
        axes.plot(values[-1], levels[-1], "o", color=colour, ms=2.5)


def _legend(figure: Figure, names: Sequence[str]) -> None:
    from matplotlib.lines import Line2D

    lines = [Line2D([], [], color=_colour(i)) for i in range(len(names))]
    figure.legend(lines, list(names), loc="outside lower center", ncols=min(len(names), 5))


def _colour(i: int) -> str:
    return house.RUNS[i % len(house.RUNS)]


@house.styled
def bars(found: Sequence[Margin]) -> Figure:
    """Margins of every controller, one picture for each kind of deviation."""
    kinds = list(dict.fromkeys(m.kind for m in found))
    names = list(dict.fromkeys(m.controller for m in found))
    columns = 4
    lines = -(-len(kinds) // columns)
    figure = house.blank(house.DOUBLE, (0.45 + 0.16 * len(names)) * lines + 0.6)
    grid = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes in grid[len(kinds) :]:
        axes.set_axis_off()
    for i, (axes, kind) in enumerate(zip(grid, kinds, strict=False)):
        for m in (m for m in found if m.kind == kind):
            y, share = names.index(m.controller), max(reach(m), 0.0)
            axes.barh(y, share, color=_colour(y), height=0.7)
            if m.failed is None:
                axes.plot(1.0, y, ">", color=_colour(y), ms=4, clip_on=False)
            elif m.held is None:
                axes.text(0.02, y, "none", va="center", fontsize=6.0, color=_colour(y))
        axes.set_xlim(0.0, 1.0)
        axes.set_xticks([0.0, 0.5, 1.0], [f"{kind.at(share):.3g}" for share in (0.0, 0.5, 1.0)])
        axes.set_yticks(range(len(names)), names if i % columns == 0 else [""] * len(names))
        axes.invert_yaxis()
        axes.grid(False, axis="y")
        axes.set_title(kind.title.replace("`", ""))
        axes.set_xlabel(kind.unit)
    return figure
