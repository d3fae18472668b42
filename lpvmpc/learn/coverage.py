"""What the stiffness data cover: a table by kind of manoeuvre, and a picture."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.kit.files import write_picture
from lpvmpc.learn import dataset

PANELS = (
    ("speed [m/s]", (0.0, 32.0), "lateral acceleration [m/s²]", (-9.0, 9.0)),
    ("longitudinal acceleration [m/s²]", (-9.0, 6.0), "lateral acceleration [m/s²]", (-9.0, 9.0)),
    ("front slip angle [deg]", (-15.0, 15.0), "front stiffness [kN/rad]", (0.0, 160.0)),
    ("rear slip angle [deg]", (-15.0, 15.0), "rear stiffness [kN/rad]", (0.0, 260.0)),
    ("front slip angle [deg]", (-15.0, 15.0), "front drive or brake force [kN]", (-10.0, 7.0)),
    ("rear slip angle [deg]", (-15.0, 15.0), "rear brake force [kN]", (-4.0, 1.0)),
)
"""Axes of the picture: label and range of x and of y."""
BINS = 120


@dataclass
class Kind:
    """What one kind of manoeuvre covers; largest values are of the absolute value."""

    rows: int = 0
    runs: int = 0
    vx_min: float = np.inf
    vx_max: float = 0.0
    ay_max: float = 0.0
    ax_min: float = np.inf
    ax_max: float = -np.inf
    alpha_f_max: float = 0.0
    alpha_r_max: float = 0.0
    saturated: int = 0
    """Rows in which an axle has less than half its nominal stiffness."""
    last_run: int = -1


@dataclass
class Coverage:
    """Summary of a data file, filled in pieces, so that memory stays flat."""

    kinds: dict[str, Kind] = field(default_factory=dict)
    """By kind."""
    histograms: Any = field(default_factory=lambda: np.zeros((len(PANELS), BINS, BINS)))
    """Number of rows per cell of each panel."""

    def add(self, c: dict[str, Any]) -> None:
        """Count some rows, in the order of the file."""
        for name in np.unique(c["manoeuvre"].astype(str)):
            rows = c["manoeuvre"] == name
            kind = self.kinds.setdefault(str(name), Kind())
            runs = np.unique(c["run"][rows])
            kind.rows += int(rows.sum())
            kind.runs += len(runs) - int(runs[0] == kind.last_run)
            kind.last_run = int(runs[-1])
            kind.vx_min = min(kind.vx_min, float(c["vx_mps"][rows].min()))
            kind.vx_max = max(kind.vx_max, float(c["vx_mps"][rows].max()))
            kind.ax_min = min(kind.ax_min, float(c["ax_mps2"][rows].min()))
            kind.ax_max = max(kind.ax_max, float(c["ax_mps2"][rows].max()))
            for key, column in (("ay_max", "ay_mps2"), ("alpha_f_max", "alpha_f_rad"),
                                ("alpha_r_max", "alpha_r_rad")):
                largest = float(np.abs(c[column][rows]).max())
                setattr(kind, key, max(getattr(kind, key), largest))
            low = (c["Cf_Nprad"][rows] < 64e3) | (c["Cr_Nprad"][rows] < 107e3)
            kind.saturated += int(low.sum())
        alpha_f, alpha_r = np.degrees(c["alpha_f_rad"]), np.degrees(c["alpha_r_rad"])
        pairs = (
            (c["vx_mps"], c["ay_mps2"]),
            (c["ax_mps2"], c["ay_mps2"]),
            (alpha_f, c["Cf_Nprad"] * 1e-3),
            (alpha_r, c["Cr_Nprad"] * 1e-3),
            (alpha_f, c["Fxf_N"] * 1e-3),
            (alpha_r, c["Fxr_N"] * 1e-3),
        )
        for i, ((x, y), (_, xs, _, ys)) in enumerate(zip(pairs, PANELS, strict=True)):
            self.histograms[i] += np.histogram2d(x, y, bins=BINS, range=(xs, ys))[0]


def of(file: Path) -> Coverage:
    """Coverage of a data file."""
    found = Coverage()
    for rows in dataset.batches(file):
        found.add(rows)
    return found


def draw(found: Coverage, file: Path) -> None:
    """Write the picture.

    Raises:
        OutputError: It cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, counts, panel in zip(
        figure.subplots(2, 3).T.flat, found.histograms, PANELS, strict=True
    ):
        x, xs, y, ys = panel
        shown = np.ma.masked_equal(counts.T, 0)
        extent = (*xs, *ys)
        norm = LogNorm(vmin=1, vmax=max(counts.max(), 2))
        axes.imshow(shown, origin="lower", extent=extent, aspect="auto", norm=norm, cmap="viridis")
        axes.set_xlabel(x)
        axes.set_ylabel(y)
        axes.grid(alpha=0.3)
    rows = sum(kind.rows for kind in found.kinds.values())
    figure.suptitle(f"What the {rows:,} samples cover (colour: samples per cell, logarithmic)")
    write_picture(file, figure, dpi=110)
