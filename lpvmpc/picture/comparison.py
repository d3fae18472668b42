"""Two or more controllers on the same road: pictures over the same arc length, and a table.

Runs come as a mapping of name to Log, and are drawn in its order. Where a car was lost its curves
end with a cross, and the scales are those of the runs that were completed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.files import into, write_picture, write_text
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.picture import path_figure
from lpvmpc.picture.style import DOUBLE, DPI, RUNS, blank, peak, styled, y_label
from lpvmpc.sim.metrics import metrics

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Runs = Mapping[str, Any]
"""Logs by the name that stands in legends and tables."""

MOST = len(RUNS)
"""Runs that can be told apart by colour."""


def check(runs: Runs) -> None:
    """Refuse what cannot be laid side by side.

    Raises:
        LPVMPCError: Fewer than two runs, too many, an empty one, or different roads.
    """
    if not 2 <= len(runs) <= MOST:
        raise LPVMPCError(f"A comparison needs 2 to {MOST} runs, but got {len(runs)}.")
    first_name, first = next(iter(runs.items()))
    for name, log in runs.items():
        if not len(log.columns["t_s"]):
            raise LPVMPCError(f"The run {name!r} is empty, so there is nothing to compare.")
        road = log.meta["scenario"], log.scenario.path.length
        other = first.meta["scenario"], first.scenario.path.length
        if road != other:
            raise LPVMPCError(
                f"The runs {first_name!r} and {name!r} drove different roads: {other[0]} of "
                f"{other[1]:.1f} m and {road[0]} of {road[1]:.1f} m."
            )


def table(runs: Runs) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Header and rows of the numbers side by side, one column per run.

    The steering's restlessness is the root mean square of the commanded steering rate; what the
    road asks for is the same for all.
    """
    numbers = [metrics(log) for log in runs.values()]
    logs = list(runs.values())

    def row(label: str, key: str, scale: float, digits: int) -> tuple[str, ...]:
        return label, *(_text(n[key], scale, digits) for n in numbers)

    return ("quantity", *runs), [
        ("completed", *("yes" if n["completed"] else f"no, {n['s_end_m']:.0f} m" for n in numbers)),
        row("lateral error, RMSE [mm]", "lateral_rmse_m", 1e3, 2),
        row("lateral error, largest [mm]", "lateral_max_m", 1e3, 2),
        row("course error, RMSE [rad]", "course_rmse_rad", 1.0, 4),
        row("heading error, RMSE [rad]", "heading_rmse_rad", 1.0, 4),
        row("speed error, RMSE [m/s]", "speed_rmse_mps", 1.0, 4),
        row("speed error, largest [m/s]", "speed_max_mps", 1.0, 4),
        ("steering rate, RMS [deg/s]", *(_text(restlessness(log), 1.0, 2) for log in logs)),
        row("lateral acceleration [m/s2]", "lateral_acc_max_mps2", 1.0, 2),
        ("QPs refused", *(str(n["qp"]["fallback"]) if n["qp"]["solved"] else "-" for n in numbers)),
        ("control step, median [us]", *(_text(n["step_time_us"]["p50"], 1.0, 0) for n in numbers)),
    ]


def summary(runs: Runs) -> tuple[Sequence[str], list[tuple[str, ...]]]:
    """Header and rows of what matters most, one row per run, for the width of a terminal."""
    header = ("controller", "lateral error\nRMSE / largest\n[mm]", "course\nRMSE\n[rad]",
              "speed\nRMSE\n[m/s]", "steering\nrate\n[deg/s]", "step\n\n[us]")
    rows: list[tuple[str, ...]] = []
    for name, log in runs.items():
        n = metrics(log)
        lateral = _text(n["lateral_rmse_m"], 1e3, 2), _text(n["lateral_max_m"], 1e3, 2)
        rows.append((name, " / ".join(lateral), _text(n["course_rmse_rad"], 1.0, 4),
                     _text(n["speed_rmse_mps"], 1.0, 3), _text(restlessness(log), 1.0, 2),
                     _text(n["step_time_us"]["p50"], 1.0, 0)))
    return header, rows


def restlessness(log: Any) -> float | None:
    """Root mean square of the commanded steering rate [deg/s]; None without two rows."""
    steps = np.diff(np.rad2deg(log.columns["delta_cmd_rad"]))
    return float(np.sqrt(np.mean(np.square(steps)))) / log.meta["Ts"] if len(steps) else None


def _text(value: float | None, scale: float, digits: int) -> str:
    return "-" if value is None else f"{scale * value:.{digits}f}"


def markdown(runs: Runs) -> str:
    """The table, and why runs ended early, in Markdown."""
    title = f"Controllers on {next(iter(runs.values())).meta['scenario']}"
    lines = [markdown_table(title, *table(runs))]
    lines += [
        f"`{name}` did not complete: {log.meta['reason']}, after {log.meta['s_end_m']:.0f} m "
        f"and {log.meta['duration_s']:.1f} s."
        for name, log in runs.items() if not log.meta["completed"]
    ]
    return "\n".join(lines).rstrip() + "\n"


def save_all(runs: Runs, directory: str | FilePath) -> list[FilePath]:
    """Write every picture as PNG, and the table as Markdown.

    Args:
        runs: Logs by name, all of the same road.
        directory: Where the files go; made if missing.

    Returns:
        The files written.

    Raises:
        LPVMPCError: The runs cannot be compared.
        OutputError: The directory or a file cannot be written.
    """
    check(runs)
    directory = FilePath(directory)
    pictures: dict[str, Callable[[Runs], Figure]] = {
        "errors": errors, "signals": signals, "path": path,
    }
    files = []
    with into(directory):
        for name, draw in pictures.items():
            files.append(directory / f"{name}.png")
            write_picture(files[-1], draw(runs), DPI)
        files.append(directory / "comparison.md")
        write_text(files[-1], markdown(runs))
    return files


@styled
def errors(runs: Runs) -> Figure:
    """Tracking errors over arc length: left with sign, right their magnitude and RMSE."""
    figure = blank(DOUBLE, 4.3)
    axes = figure.subplots(3, 2, sharex=True)
    rows: tuple[tuple[str, str, Callable[[Any], Any]], ...] = (
        ("lateral", "mm", lambda c: 1e3 * c["ey_m"]),
        ("course", "deg", lambda c: np.rad2deg(c["epsi_rad"] + np.arctan2(c["vy_mps"],
                                                                          c["vx_mps"]))),
        ("speed", "m/s", lambda c: c["vx_mps"] - c["vx_ref_mps"]),
    )
    for (signed, magnitude), (name, unit, error) in zip(axes, rows, strict=True):
        _curves(signed, runs, error, width=0.8)
        y_label(signed, f"{name} [{unit}]", zero=True)
        top, floor = 1e-9, np.inf
        for (_, log), colour in zip(runs.items(), RUNS, strict=False):
            size = np.abs(error(log.columns))
            rmse = max(float(np.sqrt(np.nanmean(np.square(size)))), 1e-9)
            size = np.maximum(size, 1e-3 * rmse)  # zeros have no logarithm
            magnitude.semilogy(log.columns["s_m"], size, color=colour, lw=0.5, alpha=0.55)
            magnitude.axhline(rmse, color=colour, lw=1.2, label=f"RMSE {rmse:.3g}")
            top, floor = max(top, peak(size)), min(floor, 0.1 * rmse)
        magnitude.set_ylim(floor, 2.0 * top)
        y_label(magnitude, f"|{name}| [{unit}]")
        magnitude.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes[0, 0].set_title(_heading("Tracking errors", runs))
    for axis in axes[-1]:
        axis.set_xlabel("distance along the path [m]")
    figure.align_ylabels(axes)
    _legend(figure, axes[0, 0])
    return figure


@styled
def signals(runs: Runs) -> Figure:
    """Speed, steering and acceleration over arc length."""
    figure = blank(DOUBLE, 4.6)
    axes = figure.subplots(4, 1, sharex=True)
    longest = max((log.columns for log in runs.values()), key=lambda c: float(c["s_m"][-1]))
    _curves(axes[0], runs, lambda c: c["vx_mps"])
    axes[0].plot(longest["s_m"], longest["vx_ref_mps"], color="black", lw=0.8, ls=(0, (4, 2)),
                 label="reference", zorder=4.0)
    y_label(axes[0], "speed [m/s]")
    _curves(axes[1], runs, lambda c: np.rad2deg(c["delta_cmd_rad"]))
    y_label(axes[1], "steering [deg]", zero=True)
    _curves(axes[2], runs, lambda c: c["ax_cmd_mps2"])
    y_label(axes[2], "drive [m/s²]", zero=True)
    _curves(axes[3], runs, lambda c: c["ay_mps2"])
    y_label(axes[3], "lateral [m/s²]", zero=True)
    axes[0].set_title(_heading("Speed and commands", runs))
    axes[-1].set_xlabel("distance along the path [m]")
    figure.align_ylabels(axes)
    _legend(figure, axes[0])
    return figure


@styled
def path(runs: Runs) -> Figure:
    """Paths on the road, zoomed where the least exact of the completed runs is worst."""
    candidates = completed(runs) or runs
    focus = max(candidates, key=lambda name: peak(candidates[name].columns["ey_m"]))
    columns = {name: log.columns for name, log in runs.items()}
    return path_figure.draw(columns, _heading("Paths", runs), focus)


def completed(runs: Runs) -> Runs:
    """The runs that reached the end of the road."""
    return {name: log for name, log in runs.items() if log.meta.get("completed", True)}


def _curves(axis: Axes, runs: Runs, value: Callable[[Any], Any], width: float = 1.0) -> None:
    """One quantity of all runs over arc length; the completed ones decide the scale."""
    scaling = completed(runs) or runs
    low, high = np.inf, -np.inf
    for n, ((name, log), colour) in enumerate(zip(runs.items(), RUNS, strict=False)):
        c = log.columns
        curve = np.asarray(value(c), dtype=float)
        # the first run lies on top: usually it is the one to be seen
        axis.plot(c["s_m"], curve, color=colour, lw=width, label=name, zorder=3.0 - 0.1 * n)
        if name in scaling:
            low, high = min(low, np.nanmin(curve)), max(high, np.nanmax(curve))
        else:
            axis.plot(c["s_m"][-1], curve[-1], "x", color=colour, ms=5.0, mew=1.4)
    room = 0.08 * max(high - low, 1e-6)
    axis.set_ylim(low - room, high + room)


def _legend(figure: Figure, axis: Axes) -> None:
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))


def _heading(what: str, runs: Runs) -> str:
    return f"{what} ({next(iter(runs.values())).meta['scenario']})"
