"""The counterparts of the paper's Figs. 4 to 11, the ablation and the tunings, as pictures.

Each function returns a matplotlib Figure sized for one column (88 mm) or two columns (181 mm);
pyplot is never used.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.kit.files import into, write_picture
from lpvmpc.paper.measurements import DrivenEntry, Evidence
from lpvmpc.paper.runs import LMPC, OURS, PLAIN
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
    RUNS,
    SKY,
    blank,
    peak,
    styled,
)
from lpvmpc.published import LOSSES, SOLVE_MEAN_MS, TRACKING
from lpvmpc.sim.metrics import wrap
from lpvmpc.tune import sphere_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DASHED, DOTTED = (0, (4, 2)), (0, (1, 1.5))
LINES = {OURS: (RUNS[0], "LPV-MPC (ours)", 0.8), LMPC: (RUNS[1], "LMPC with PSO-PID", 1.6)}
"""Colour, name and width of the controllers; ours is drawn over the baseline, and thinner."""
CASES = {
    "paper": (BLUE, "o"), "paper-loop": (ORANGE, "s"), "double-lane-change": (GREEN, "^"),
    "circuit-0.5": (PINK, "v"), "circuit-0.87": (RED, "D"),
}
"""Colour and marker of the ablation's roads."""
LOST = 8.0
"""Where lost cars are drawn, times the largest error of the others."""

def save_all(e: Evidence, folder: Path) -> dict[str, Path]:
    """Draw and write every figure as PNG; those that nothing stands behind are left out.

    Raises:
        OutputError: The folder or a file cannot be written.
    """
    files = {}
    with into(folder):
        for name, (draw, stands) in FIGURES.items():
            file = folder / f"{name}.png"
            if not stands(e):
                file.unlink(missing_ok=True)  # of an earlier report
                continue
            write_picture(file, draw(e), DPI)
            files[name] = file
    return files


@styled
def learning_curve(e: Evidence) -> Figure:
    """Loss of the paper's network on our data over the epochs (Fig. 4)."""
    training = e.trainings["network-secant"]
    figure = blank(COLUMN, 2.4)
    axis = figure.subplots()
    axis.set_title("Learning curve of the paper's network")
    epoch, train, test = np.array(training.curve).T
    axis.plot(epoch, train, color=BLUE, label="training")
    axis.plot(epoch, test, color=ORANGE, label="runs held out")
    axis.axhline(LOSSES["training"], color=BLUE, lw=0.9, ls=DASHED, label="paper, training")
    axis.axhline(LOSSES["validation"], color=ORANGE, lw=0.9, ls=DOTTED, label="paper, validation")
    axis.set_yscale("log")
    axis.set_xlim(0.0, float(epoch[-1]))
    axis.set(xlabel="epoch", ylabel="mean square error [-]")
    axis.legend(ncols=2)
    return figure


@styled
def stiffness(e: Evidence) -> Figure:
    """Secant stiffness along a driven lap, and predicted over true (Fig. 5)."""
    s = e.stiffness
    figure = blank(DOUBLE, 3.9)
    grid = figure.subplots(2, 2, width_ratios=(2.4, 1.0))
    names = {"network-secant": ("paper's network", ORANGE), "network": ("our network", BLUE)}
    for i, axle in enumerate(("front", "rear")):
        along, against = grid[i]
        true = 1e-3 * s.true[:, i]
        low, top = 0.75 * float(true.min()), 1.2 * float(true.max())
        along.plot(s.t, true, color="black", lw=1.6, label="car", zorder=2)
        ends = [low, top]
        against.plot(ends, ends, color="black", lw=0.6, ls=DASHED)
        for kind, (name, colour) in names.items():
            said = 1e-3 * s.said[kind][:, i]
            along.plot(s.t, said, color=colour, lw=0.8, label=name, zorder=3)
            against.plot(true, said, ".", ms=1.2, color=colour, rasterized=True,
                         label=f"{name}, R² {s.r2(kind)[i]:.3f}")
        along.set_ylabel(f"{axle} [kN/rad]")
        along.set_xlim(float(s.t[0]), float(s.t[-1]))
        along.set_ylim(low, top)
        against.set(xlim=(low, top), ylim=(low, top), ylabel="predicted [kN/rad]")
        against.legend(loc="upper left", markerscale=5.0, handletextpad=0.2)
    grid[0, 0].set_title(f"Secant stiffness of the axles ({s.title})")
    grid[1, 0].set_xlabel("time [s]")
    grid[1, 1].set_xlabel("true [kN/rad]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    return figure


def sphere_function(e: Evidence) -> Figure:
    """The genetic algorithm on the sphere function (Fig. 6)."""
    return sphere_report.draw(e.sphere)


@styled
def speed_wind(e: Evidence) -> Figure:
    """Wind, speed, and how far the speed is off, of both controllers (Fig. 7)."""
    figure, axes = _rows((1.0, 1.5, 1.0), 3.9, "Wind and speed (paper)")
    c = e.logs[OURS].columns
    axes[0].plot(c["t_s"], c["wind_mps"], color=GREEN)
    axes[1].plot(c["t_s"], c["vx_ref_mps"], color="black", lw=0.8, ls=DASHED, label="reference",
                 zorder=4)
    for log, look in _both(e):
        own = log.columns
        axes[1].plot(own["t_s"], own["vx_mps"], **look)
        axes[2].plot(own["t_s"], own["vx_mps"] - own["vx_ref_mps"], **look)
    _labels(axes, ("wind [m/s]", "speed [m/s]", "error [m/s]"))
    _below(figure, axes[1], 3)
    return figure


@styled
def path(e: Evidence) -> Figure:
    """The driven paths, with zooms where the baseline's error is told (Fig. 8)."""
    runs = {name: e.logs[key].columns for key, (_, name, _) in LINES.items()}
    return path_figure.draw(runs, "Path (paper)", focus=LINES[LMPC][1])


@styled
def commands(e: Evidence) -> Figure:
    """Steering, acceleration and lateral velocity of both controllers (Fig. 9)."""
    figure, axes = _rows((1.0, 1.0, 1.0), 4.0, "Commands and lateral velocity (paper)")
    for log, look in _both(e):
        c = log.columns
        axes[0].plot(c["t_s"], np.rad2deg(c["delta_cmd_rad"]), **look)
        axes[1].plot(c["t_s"], c["ax_cmd_mps2"], **look)
        axes[2].plot(c["t_s"], c["vy_mps"], **look)
    _labels(axes, ("steering [deg]", "accel. [m/s²]", "lateral [m/s]"))
    _below(figure, axes[0], 2)
    return figure


@styled
def errors(e: Evidence) -> Figure:
    """Tracking errors of both controllers beside the paper's printed ones (Fig. 10).

    Left: with sign. Right: magnitude on a logarithmic scale, with RMSE; dashed and dotted are the
    RMSE and the largest error that the paper prints of its controller.
    """
    figure = blank(DOUBLE, 4.9)
    axes = figure.subplots(4, 2, sharex=True, width_ratios=(1.0, 1.0))
    kinds: tuple[tuple[str, str, Callable[[Any], Any], float, float | None, float | None], ...] = (
        ("lateral", "mm", lambda c: c["ey_m"], 1e3, TRACKING["lateral_rmse_m"],
         TRACKING["lateral_max_m"]),
        ("heading", "deg", lambda c: c["epsi_rad"], 180.0 / np.pi, TRACKING["heading_rmse_rad"],
         TRACKING["heading_max_rad"]),
        ("course", "deg", lambda c: wrap(c["epsi_rad"] + np.arctan2(c["vy_mps"], c["vx_mps"])),
         180.0 / np.pi, None, None),
        ("speed", "m/s", lambda c: c["vx_mps"] - c["vx_ref_mps"], 1.0, TRACKING["speed_rmse_mps"],
         TRACKING["speed_max_mps"]),
    )
    for (signed, magnitude), (name, unit, of, scale, rmse, largest) in zip(
        axes, kinds, strict=True
    ):
        low, high = np.inf, 0.0
        for log, look in _both(e):
            t, error = log.columns["t_s"], scale * of(log.columns)
            own = float(np.sqrt(np.mean(np.square(error))))
            colour = look["color"]
            signed.plot(t, error, **look)
            magnitude.semilogy(t, np.maximum(np.abs(error), 1e-9), color=colour, lw=0.4, alpha=0.5)
            magnitude.axhline(own, color=colour, lw=look["lw"], label=f"RMSE {own:.3g}")
            low, high = min(low, 0.1 * own), max(high, peak(error))
        for value, dash2, what in ((rmse, DASHED, "paper RMSE"), (largest, DOTTED, "paper max")):
            if value is not None:
                magnitude.axhline(scale * value, color="black", lw=1.0, ls=dash2,
                                  label=f"{what} {scale * value:.3g}")
                high = max(high, scale * value)
        magnitude.set_ylim(low, 2.5 * high)
        signed.set_ylabel(f"{name} [{unit}]")
        magnitude.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    axes[0, 0].set_title("Tracking errors (paper)")
    axes[0, 1].set_title("Magnitude")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    figure.align_ylabels(axes)
    _below(figure, axes[0, 0], 2)
    return figure


@styled
def computation_time(e: Evidence) -> Figure:
    """Time to solve, and of the whole control step, against the control period (Fig. 11)."""
    log = e.logs[OURS]
    t, solve, step = (np.asarray(log.timing[k], float) for k in ("t_s", "solve_us", "step_us"))
    period = 1e3 * float(log.meta["Ts"])
    figure = blank(COLUMN, 2.7)
    axis = figure.subplots()
    axis.set_title("Computation time (paper)")
    for values, light, dark, name in (
        (step, SKY, BLUE, "control step"), (solve, "#F5CF80", ORANGE, "QP solve"),
    ):
        own = 1e-3 * values
        axis.plot(t, own, ".", ms=1.4, color=light, rasterized=True)
        axis.axhline(own.mean(), color=dark, lw=1.4, label=f"{name}, mean {own.mean():.2g} ms")
    paper = SOLVE_MEAN_MS
    axis.axhline(paper, color=RED, lw=1.0, ls=DASHED, label=f"paper, mean {paper:.1f} ms")
    axis.axhline(period, color="black", lw=1.0, ls=DOTTED, label=f"period {period:.0f} ms")
    axis.set_yscale("log")
    axis.set_ylim(0.5e-3 * float(solve.min()), 2.0 * max(period, 1e-3 * float(step.max())))
    axis.set_xlim(float(t[0]), float(t[-1]))
    axis.set(xlabel="time [s]", ylabel="thread CPU time [ms]")
    _below(figure, axis, 2)
    return figure


@styled
def ablation(e: Evidence) -> Figure:
    """Lateral RMSE on each road, from the printed formulas to the full controller."""
    lines: list[tuple[str, list[DrivenEntry]]] = []
    for group in ("printed", "corrected"):
        for entry in e.entries(group):
            rows = [r for r in e.rows if r.entry.group == group and r.entry.key == entry.key]
            if group == "printed" and entry.controller == PLAIN:
                continue  # the first of the next group
            lines.append((entry.key, rows))
    figure = blank(DOUBLE, 0.9 + 0.17 * len(lines))
    axis = figure.subplots()
    axis.set_title("From the printed formulas to the full controller: lateral RMSE")
    place = np.arange(len(lines))
    completed = [1e3 * row.rmse for _, rows in lines for row in rows if row.completed]
    lost_at = LOST * max(completed, default=1.0)
    for case in e.cases("corrected"):
        colour, marker = CASES.get(case.key, (GREY, "o"))
        own = [next((r for r in rows if r.case.key == case.key), None) for _, rows in lines]
        rmse = [1e3 * r.rmse if r is not None and r.completed else np.nan for r in own]
        axis.plot(rmse, place, color=colour, marker=marker, ms=3.2, lw=0.8, label=case.title)
        shift = 0.12 * (list(CASES).index(case.key) - 2) if case.key in CASES else 0.0
        lost = [k for k, r in enumerate(own) if r is not None and not r.completed]
        axis.plot([lost_at * 10.0**shift] * len(lost), lost, "x", color=colour, ms=4.0, mew=1.2)
    axis.axvspan(lost_at / 2.2, lost_at * 2.2, color="#F4F4F4", lw=0.0)
    axis.text(lost_at, -0.9, "lost", ha="center", va="bottom", fontsize=6.8)
    axis.set_xscale("log")
    axis.set_xlim(right=lost_at * 2.2)
    axis.set_yticks(place, [name for name, _ in lines])
    axis.set_ylim(len(lines) - 0.5, -0.9)
    axis.set_xlabel("lateral RMSE [mm]")
    _below(figure, axis, 5)
    return figure


@styled
def tuning(e: Evidence) -> Figure:
    """Best cost over the evaluations, for every controller that was tuned."""
    figure = blank(COLUMN, 2.9)
    axis = figure.subplots()
    axis.set_title("Tuning: best cost so far")
    colours = (BLUE, RED, ORANGE, GREEN, PINK)
    for (name, one), colour in zip(e.tunings.items(), colours, strict=False):
        count = [entry[1] for entry in one.history]
        best = np.minimum.accumulate([entry[2] for entry in one.history])
        axis.step(count, best, where="post", color=colour, lw=1.3, label=name)
    axis.set_yscale("log")
    for which in (axis.yaxis.set_major_formatter, axis.yaxis.set_minor_formatter):
        which("{x:g}")
    axis.set_xlim(0.0, 1.02 * max(one.budget for one in e.tunings.values()))
    axis.set(xlabel="evaluations", ylabel="cost")
    _below(figure, axis, 2)
    return figure


def _always(e: Evidence) -> bool:
    return True


FIGURES: dict[str, tuple[Callable[[Evidence], Figure], Callable[[Evidence], bool]]] = {
    "fig4-learning-curve": (learning_curve, lambda e: "network-secant" in e.trainings),
    "fig5-stiffness": (stiffness, _always),
    "fig6-sphere": (sphere_function, _always),
    "fig7-speed-wind": (speed_wind, _always),
    "fig8-path": (path, _always),
    "fig9-commands": (commands, _always),
    "fig10-errors": (errors, _always),
    "fig11-computation-time": (computation_time, _always),
    "ablation": (ablation, lambda e: bool(e.entries("corrected"))),
    "tuning": (tuning, lambda e: bool(e.tunings)),
}
"""All pictures by the names of their files, and whether anything stands behind them."""


def _both(e: Evidence) -> list[tuple[Any, dict[str, Any]]]:
    """Log and look of the baseline, then of ours, which is drawn over it."""
    found = []
    for name in (LMPC, OURS):
        colour, label, width = LINES[name]
        found.append((e.logs[name], {"color": colour, "label": label, "lw": width}))
    return found


def _rows(ratios: tuple[float, ...], height: float, title: str) -> tuple[Figure, Any]:
    """One column of axes that share the time axis."""
    figure = blank(COLUMN, height)
    axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
    axes[0].set_title(title)
    axes[-1].set_xlabel("time [s]")
    return figure, axes


def _labels(axes: Sequence[Axes], labels: Sequence[str]) -> None:
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    axes[0].figure.align_ylabels(axes)  # type: ignore[union-attr]


def _below(figure: Figure, axis: Axes, columns: int) -> None:
    """The legend of an axis below the figure, ours before the baseline."""
    handles, labels = axis.get_legend_handles_labels()
    order = sorted(range(len(labels)), key=lambda i: labels[i] == LINES[LMPC][1])
    figure.legend(
        [handles[i] for i in order], [labels[i] for i in order], loc="outside lower center",
        ncols=columns,
    )
