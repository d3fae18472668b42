"""Record of a run: one row per control instant, written as two Parquet files.

`trace.parquet` holds what is determined by the seed, the options and the versions, and nothing
else: the same run gives the same bytes. `timing.parquet` holds the times that the machine took.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lpvmpc.interface import FALLBACKS
from lpvmpc.kit.files import write_table
from lpvmpc.units import Array

if TYPE_CHECKING:
    from lpvmpc.interface import Preview
    from lpvmpc.road.path import Path
    from lpvmpc.road.scenario import Scenario


WHEELS = ("fl", "fr", "rl", "rr")
MOTION = (
    "t_s",
    "s_m",
    "x_m",
    "y_m",
    "psi_rad",
    "vx_mps",
    "vy_mps",
    "r_radps",
    "delta_rad",
    "ax_mps2",
    "ay_mps2",
    "ey_m",
    "epsi_rad",
    "kappa_radpm",
    "vx_ref_mps",
    "x_ref_m",
    "y_ref_m",
    "psi_ref_rad",
    "delta_cmd_rad",
    "ax_cmd_mps2",
    "roll_rad",
    "kkt_residual",
)
"""Scalar columns of the trace, in the order in which `Recorder.row` takes them."""
PER_WHEEL = ("Fx_{}_N", "Fy_{}_N", "Fz_{}_N", "slip_ratio_{}", "slip_angle_{}_rad", "mu_{}")
TIMES = ("t_s", "step_us", "build_us", "solve_us", "check_us", "wall_us")


@dataclass
class Log:
    """A run: what happened, how long it took, and under which conditions."""

    columns: dict[str, npt.NDArray[Any]]
    """Trace, one array of shape (n,) per column; units are in the names."""
    timing: dict[str, Array]
    """Times of the controller's calls [us], one array of equal length per column: CPU times, those
    of `step_us` of all threads together, and the wall-clock time `wall_us`."""
    meta: dict[str, Any]
    """Scenario, controller, seed, options, outcome, versions, hash of the model."""
    scenario: Scenario
    """What was driven: path, speed, wind and friction, for figures and video."""
    weights: dict[str, Any] = field(default_factory=dict)
    """The controller's weights, where it tells them."""
    road: Path | None = None
    """The road itself, where the reference leaves it to go round traffic; for pictures."""

    def __len__(self) -> int:
        return len(self.columns["t_s"])

    def write(self, folder: str | os.PathLike[str]) -> None:
        """Write trace.parquet and timing.parquet into an existing folder.

        Each file appears under its name only when it is whole.

        Raises:
            OutputError: The folder cannot be written.
        """
        facts = ("scenario", "controller", "stiffness", "seed", "options", "versions", "Ts")
        kept = {k: self.meta[k] for k in (*facts, "model_sha256") if k in self.meta}
        told = {**kept, "fallback": FALLBACKS}
        write_table(FilePath(folder) / "trace.parquet", self.columns, told)
        write_table(FilePath(folder) / "timing.parquet", self.timing, kept)


class Recorder:
    """Preallocated arrays that a running simulation fills, one row per control instant."""

    def __init__(self, rows: int, Np: int, nq: int, delay: int = 0):
        self.n = 0
        """Number of complete rows."""
        self.Np, self.delay = Np, delay
        self.motion = np.full((rows, len(MOTION)), np.nan)
        self.wheels = np.full((rows, len(PER_WHEEL), 4), np.nan)
        self.qpos = np.full((rows, nq), np.nan)
        self.solved = np.ones(rows, dtype=bool)
        self.fallback = np.zeros(rows, dtype=np.int8)
        self.preview = np.full((rows, 3, Np + 1), np.nan)  # x, y, psi of the reference
        self.ey = np.full((rows, Np + 1), np.nan)  # predicted
        self.times = np.zeros((rows, len(TIMES)))
        self.calls = 0
        """Number of calls of the controller: one per row, but for the instant of failure."""

    def prediction(self, preview: Preview, prediction: Array) -> None:
        """Keep the predicted states (vx, vy, r, ey, epsi), shape (Np + 1, 5), of this row.

        The prediction begins after the delay of the run, as far as the preview reaches.
        """
        row, n = self.preview[self.n], self.Np + 1
        first = min(self.delay, len(preview.x) - n)
        for i, points in enumerate((preview.x, preview.y, preview.psi)):
            row[i] = points[first : first + n]
        self.ey[self.n] = prediction[:, 3]

    def log(self, meta: dict[str, Any], scenario: Scenario, weights: dict[str, Any]) -> Log:
        """The complete rows as a Log."""
        n = self.n
        columns: dict[str, npt.NDArray[Any]] = {
            name: self.motion[:n, i].copy() for i, name in enumerate(MOTION[:-1])
        }
        wind = scenario.wind.speed(columns["t_s"], columns["s_m"])
        columns["wind_mps"] = np.broadcast_to(wind, n).astype(np.float64)
        columns["solved"] = self.solved[:n].copy()
        columns["fallback"] = self.fallback[:n].copy()
        columns["kkt_residual"] = self.motion[:n, -1].copy()
        for i, name in enumerate(PER_WHEEL):
            for j, wheel in enumerate(WHEELS):
                columns[name.format(wheel)] = self.wheels[:n, i, j].copy()
        x, y, psi = self.preview[:n, 0], self.preview[:n, 1], self.preview[:n, 2]
        pred_x = x - self.ey[:n] * np.sin(psi)  # (n, Np + 1)
        pred_y = y + self.ey[:n] * np.cos(psi)
        for k in range(self.Np + 1):
            columns[f"pred_x_m_{k}"] = pred_x[:, k].copy()
            columns[f"pred_y_m_{k}"] = pred_y[:, k].copy()
        for i in range(self.qpos.shape[1]):
            columns[f"qpos_{i}"] = self.qpos[:n, i].copy()
        timing = {name: self.times[: self.calls, i].copy() for i, name in enumerate(TIMES)}
        return Log(columns, timing, meta, scenario, weights)
