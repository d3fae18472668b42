"""Figures of one closed-loop run, drawn from its log alone.

Each function returns a matplotlib Figure sized for one column (88 mm) or two columns (181 mm) of
a conference paper; `save_all` writes them as PNG. The counterparts in the paper (Kebbati et al.)
are named in each docstring. matplotlib is imported on first use, pyplot never: no display and no
global state are needed, and the bytes of a PNG depend on the log and the matplotlib version only.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc import published
from lpvmpc.kit.files import into, write_picture
from lpvmpc.picture import path_figure
from lpvmpc.picture.style import (
    BLUE,
    COLUMN,
    DOUBLE,
    DPI,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    RED,
    SKY,
    STYLE,
    blank,
    peak,
    styled,
    y_label,
)
from lpvmpc.published import TRACKING
from lpvmpc.sim.log import WHEELS
from lpvmpc.units import GRAVITY

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "BLUE", "COLUMN", "DOUBLE", "DPI", "GREEN", "GREY", "ORANGE", "PINK", "RED", "SKY",
    "STYLE", "commands", "computation_time", "errors", "gg", "path", "save_all", "speed_wind",
    "tires",
]


def save_all(log: Any, directory: str | FilePath) -> list[FilePath]:
    """Draw every figure of a run and write it as PNG.

    Args:
        log: Log of `simulate`, with one row or more.
        directory: Where the files go; made if missing.

    Returns:
        The files written, in the order of the paper's figures.

    Raises:
        OutputError: The directory or a file cannot be written.
    """
    directory = FilePath(directory)
    figures: dict[str, Callable[[Any], Figure]] = {
        "speed_wind": speed_wind, "path": path, "commands": commands, "errors": errors,
        "computation_time": computation_time, "tires": tires, "gg": gg,
    }
    files = []
    with into(directory):
        for name, draw in figures.items():
            files.append(directory / f"{name}.png")
            write_picture(files[-1], draw(log), DPI)
    return files


@styled
def speed_wind(log: Any) -> Figure:
    """Speed with its reference, and the side wind, over time (the paper's Fig. 7)."""
    c = log.columns
    figure, (top, bottom) = _rows(log, "Speed and side wind", 2, (1.6, 1.0), height=2.7)
    top.plot(c["t_s"], c["vx_mps"], color=BLUE, lw=1.6, label="driven")
    top.plot(c["t_s"], c["vx_ref_mps"], color="black", lw=0.8, ls=(0, (4, 2)), label="reference")
    y_label(top, "speed [m/s]", legend=2)
    bottom.plot(c["t_s"], c["wind_mps"], color=GREEN)
    y_label(bottom, "wind [m/s]", zero=True)
    bottom.set_xlabel("time [s]")
    return figure


@styled
def path(log: Any) -> Figure:
    """Driven path on the road, with three zooms of the lateral error (the paper's Fig. 8)."""
    return path_figure.draw({"driven": log.columns}, _heading(log, "Path"))


@styled
def commands(log: Any) -> Figure:
    """Steering, acceleration and lateral velocity (the paper's Fig. 9)."""
    c = log.columns
    figure, axes = _rows(log, "Commands and lateral velocity", 3, (1.0, 1.0, 1.0), height=3.5)
    t = c["t_s"]
    axes[0].plot(t, np.rad2deg(c["delta_cmd_rad"]), color=RED, label="command")
    axes[0].plot(t, np.rad2deg(c["delta_rad"]), color="black", lw=0.7, ls=(0, (4, 2)),
                 label="road wheel")
    y_label(axes[0], "steering [deg]", legend=2, zero=True)
    axes[1].plot(t, c["ax_cmd_mps2"], color=RED, label="command")
    axes[1].plot(t, c["ax_mps2"], color="black", lw=0.7, ls=(0, (4, 2)), label="centre of mass")
    y_label(axes[1], "accel. [m/s²]", legend=2, zero=True)
    axes[2].plot(t, c["vy_mps"], color=BLUE)
    y_label(axes[2], "lateral [m/s]", zero=True)
    axes[2].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    return figure


@styled
def errors(log: Any) -> Figure:
    """Tracking errors beside the paper's printed values (the paper's Fig. 10).

    Left: with sign, on their own scale. Right: magnitude on a logarithmic scale, where the
    paper's RMSE and largest error are dashed lines; only on the paper's road, since errors on
    another road are not comparable.
    """
    c = log.columns
    compared = log.meta["scenario"] == "paper"
    figure = blank(DOUBLE, 4.0)
    axes = figure.subplots(3, 2, sharex=True)
    rows = (
        ("lateral", "mm", 1e3 * c["ey_m"], 1e3 * TRACKING["lateral_rmse_m"],
         1e3 * TRACKING["lateral_max_m"]),
        ("heading", "deg", np.rad2deg(c["epsi_rad"]), np.rad2deg(TRACKING["heading_rmse_rad"]),
         np.rad2deg(TRACKING["heading_max_rad"])),
        ("speed", "m/s", c["vx_mps"] - c["vx_ref_mps"], TRACKING["speed_rmse_mps"],
         TRACKING["speed_max_mps"]),
    )
    for (signed, magnitude), (name, unit, error, rmse, largest) in zip(axes, rows, strict=True):
        signed.plot(c["t_s"], error, color=BLUE, lw=0.9)
        y_label(signed, f"{name} [{unit}]", zero=True)
        size = np.maximum(np.abs(error), 1e-4 * largest)  # zeros have no logarithm
        ours = float(np.sqrt(np.nanmean(np.square(error))))
        magnitude.semilogy(c["t_s"], size, color=SKY, lw=0.7, label="|error|")
        magnitude.axhline(ours, color=BLUE, lw=1.2, label=f"RMSE {ours:.3g}")
        if compared:
            magnitude.axhline(rmse, color=RED, lw=1.0, ls=(0, (4, 2)),
                              label=f"paper RMSE {rmse:.3g}")
            magnitude.axhline(largest, color="black", lw=1.0, ls=(0, (1, 1.5)),
                              label=f"paper max {largest:.3g}")
        floor = max(float(np.nanpercentile(size, 2.0)), 1e-3 * rmse)
        top = max(largest, rmse, peak(error)) if compared else peak(error)
        magnitude.set_ylim(min(floor, 0.1 * top), 2.5 * top)
        y_label(magnitude, f"|{name}| [{unit}]")
        magnitude.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    _title(axes[0, 0], log, "Tracking errors")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.align_ylabels(axes)
    return figure


@styled
def computation_time(log: Any) -> Figure:
    """Time of each control step against the control period (the paper's Fig. 11)."""
    t = log.timing["t_s"]
    step = 1e-3 * np.asarray(log.timing["step_us"], dtype=float)  # ms
    period = 1e3 * float(log.meta.get("Ts") or (t[1] - t[0] if t.size > 1 else 0.033))
    figure = blank(COLUMN, 2.4)
    axis = figure.subplots()
    _title(axis, log, "Control step time")
    axis.plot(t, step, ".", ms=1.6, color=SKY, label="step", rasterized=True)
    if step.size:
        p50, p99 = np.percentile(step, (50.0, 99.0))
        axis.axhline(p50, color=BLUE, lw=1.2, label=f"median {p50:.2f} ms")
        axis.axhline(p99, color=ORANGE, lw=1.2, label=f"99th percentile {p99:.2f} ms")
    paper = published.SOLVE_MEAN_MS
    axis.axhline(paper, color=RED, lw=1.0, ls=(0, (4, 2)), label=f"paper, mean {paper:.1f} ms")
    axis.axhline(period, color="black", lw=1.0, ls=(0, (1, 1.5)),
                 label=f"control period {period:.0f} ms")
    axis.set_yscale("log")
    axis.set_ylim(0.5 * min(np.min(step, initial=period), 1.0), 2.5 * max(
        period, np.max(step, initial=0.0)))
    y_label(axis, "thread CPU time [ms]")
    axis.set_xlabel("time [s]")
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


@styled
def tires(log: Any) -> Figure:
    """Slip angle, slip ratio, load and used friction of each wheel.

    Slip angles have the sign of the force that they give, to the left. Used is the share
    |F| / (mu Fz) of the friction that the wheel has at its load; 1 is its peak.
    """
    c = log.columns
    figure = blank(DOUBLE, 5.2)
    axes = figure.subplots(4, 1, sharex=True)
    _title(axes[0], log, "Tires")
    colours = dict(zip(WHEELS, (BLUE, SKY, RED, ORANGE), strict=True))
    for wheel, colour in colours.items():
        Fx, Fy, Fz = (c[f"F{direction}_{wheel}_N"] for direction in "xyz")
        # a wheel in the air has no friction to use
        share = np.hypot(Fx, Fy) / np.where(Fz > 1.0, c[f"mu_{wheel}"] * Fz, np.nan)
        curves = (np.rad2deg(c[f"slip_angle_{wheel}_rad"]), 100.0 * c[f"slip_ratio_{wheel}"],
                  1e-3 * Fz, share)
        for axis, curve in zip(axes, curves, strict=True):
            axis.plot(c["t_s"], curve, color=colour, lw=0.8, label=wheel,
                      ls="-" if wheel[1] == "l" else (0, (5, 1.5)))
    y_label(axes[0], "slip angle [deg]", zero=True)
    y_label(axes[1], "slip ratio [%]", zero=True)
    y_label(axes[2], "load [kN]")
    y_label(axes[3], "used friction")
    axes[2].set_ylim(bottom=0.0)
    axes[3].axhline(1.0, color="black", lw=1.0, ls=(0, (1, 1.5)), label="peak")
    axes[3].set_ylim(0.0, 1.1)
    axes[3].set_xlabel("time [s]")
    figure.align_ylabels(axes)
    figure.legend(*axes[3].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    return figure


@styled
def gg(log: Any) -> Figure:
    """Accelerations of the centre of mass inside the friction circle, coloured by speed."""
    c = log.columns
    figure = blank(COLUMN, 3.0)
    axis = figure.subplots()
    _title(axis, log, "Accelerations")
    points = axis.scatter(c["ay_mps2"], c["ax_mps2"], c=c["vx_mps"], s=2.5, cmap="cividis",
                          linewidths=0.0, rasterized=True, zorder=3)
    bar = figure.colorbar(points, ax=axis, shrink=0.8, pad=0.02)
    bar.set_label("speed [m/s]")
    bar.outline.set_linewidth(0.6)  # type: ignore[operator]
    mu = float(np.mean([np.median(c[f"mu_{w}"]) for w in ("fl", "fr", "rl", "rr")]))
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    radius = mu * GRAVITY
    axis.plot(radius * np.cos(angle), radius * np.sin(angle), color=RED, ls=(0, (4, 2)),
              label=f"friction circle, {mu:.2g} g")
    axis.set_aspect("equal")
    edge = 1.08 * max(radius, peak(c["ay_mps2"]), peak(c["ax_mps2"]))
    ticks = np.arange(-4.0 * (edge // 4.0), edge, 4.0)
    axis.set(xlim=(-edge, edge), ylim=(-edge, edge), xticks=ticks, yticks=ticks)
    y_label(axis, "longitudinal [m/s²]")
    axis.set_xlabel("lateral, left positive [m/s²]")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside lower center")
    return figure


def _rows(log: Any, title: str, count: int, ratios: tuple[float, ...],
          height: float) -> tuple[Figure, Any]:
    """One column of `count` axes that share the time axis."""
    figure = blank(COLUMN, height)
    axes = figure.subplots(count, 1, sharex=True, gridspec_kw={"height_ratios": ratios})
    _title(axes[0], log, title)
    return figure, axes


def _title(axis: Axes, log: Any, what: str) -> None:
    """Title with the scenario and the controller."""
    axis.set_title(_heading(log, what))


def _heading(log: Any, what: str) -> str:
    """What is shown of which run; one cut short says so."""
    note = "" if log.meta.get("completed", True) else ", not completed"
    return f"{what} ({log.meta['scenario']}, {log.meta['controller']}{note})"
