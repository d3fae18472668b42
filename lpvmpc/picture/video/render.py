"""Video of a run, made from its log alone.

A frame is composed in three steps that can be used apart: `Motion` tells where everything is at
the frame's time, `Stage.picture` draws the world, `Hud.draw` writes over it. `render_video` runs
them for every frame and encodes H.264 (VP9 where PyAV comes without libx264), which browsers play.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from lpvmpc.errors import OptionError, RenderError
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.signals import ctrl_c_waits
from lpvmpc.picture.video.encode import Encoder
from lpvmpc.picture.video.hud import Hud
from lpvmpc.picture.video.stage import Stage
from lpvmpc.units import Array


def render_video(log: Any, path: str | FilePath, *, width: int = 1280, height: int = 720,
                 fps: int = 30, progress: Callable[[float], None] | None = None) -> FilePath:
    """Draw a run as a video that a browser plays, in real time.

    Interrupted by Ctrl-C, the file ends at the last whole frame, plays, and is kept under its
    name; then KeyboardInterrupt is raised.

    Args:
        log: Log of `simulate`, with two rows or more.
        path: File to write, usually .mp4. It appears under its name only when it is closed.
        width: Width of the picture [px], even.
        height: Height of the picture [px], even.
        fps: Frames per simulated second.
        progress: Called after each frame with the finished fraction; without it a progress bar is
            shown when stderr is a terminal.

    Returns:
        The file written.

    Raises:
        OptionError: A size or frame rate that cannot be encoded.
        RenderError: No OpenGL on this machine, no encoder, or nothing to draw.
        OutputError: The file cannot be written.
    """
    check_size(width, height, fps)
    path = FilePath(path)
    motion = Motion(log, fps)
    stage = Stage(log, width, height, 1.0 / fps)
    try:
        hud = run_hud(log, width, height)
        with ctrl_c_waits() as interrupted, Encoder(path, width, height, fps) as video:
            for k in counted(len(motion), progress):
                now = motion.at(k)
                frame = stage.picture(now)
                hud.draw(frame, instruments(now))
                video.add(frame)
                if interrupted():
                    raise KeyboardInterrupt
    finally:
        stage.close()
    return path


def check_size(width: int, height: int, fps: int) -> None:
    """Refuse pictures that cannot be encoded.

    Raises:
        OptionError: With the size or frame rate, and what is allowed.
    """
    for name, value in (("width", width), ("height", height)):
        if not 64 <= value <= 4096 or value % 2:
            raise OptionError(name, value, "an even number of pixels from 64 to 4096")
    if not 1 <= fps <= 240:
        raise OptionError("fps", fps, "a number of frames per second from 1 to 240")


class Motion:
    """Where the car was at each frame, between the rows of a log.

    Everything is interpolated linearly, the attitude of the car along the shortest turn. Wheel
    spins are angles that keep counting, so they need no care.
    """

    def __init__(self, log: Any, fps: float) -> None:
        """Interpolate all columns at the frames' times, up to the first row that is not finite."""
        c = log.columns
        nq = sum(name.startswith("qpos_") for name in c)
        steps = sum(name.startswith("pred_x_m_") for name in c)
        place = [c[name] for name in (*(f"qpos_{i}" for i in range(nq)), "s_m", "x_m", "y_m",
                                      "psi_rad", "vx_mps")]
        whole = np.isfinite(np.stack(place, axis=1).astype(float)).all(axis=1)
        rows = len(whole) if whole.all() else int(np.argmin(whole))
        if rows < 2 or not nq:
            raise RenderError("The log has fewer than two rows with a finite position of the car, "
                              "so there is nothing to film.")
        t = np.asarray(c["t_s"], dtype=float)[:rows]
        self.t = np.arange(t[0], t[-1] + 1e-9, 1.0 / fps)
        self.row = np.clip(np.searchsorted(t, self.t, side="right") - 1, 0, t.size - 2)
        self.part = (self.t - t[self.row]) / (t[self.row + 1] - t[self.row])
        self.values = {name: self._between(np.asarray(column, dtype=float))
                       for name, column in c.items() if not name.startswith(("qpos_", "pred_"))}
        self.values["step_us"] = np.asarray(log.timing["step_us"], dtype=float)[self.row]
        qpos = np.stack(place[:nq], axis=1).astype(float)
        self.qpos = self._between(qpos)
        self.qpos[:, 3:7] = slerp(qpos[self.row, 3:7], qpos[self.row + 1, 3:7], self.part)
        horizon = [np.stack([c[f"pred_{a}_m_{k}"] for a in "xy"], axis=1) for k in range(steps)]
        self.horizon = (self._between(np.stack(horizon, axis=1)) if steps
                        else np.empty((self.t.size, 0, 2)))  # (frames, Np + 1, 2)

    def __len__(self) -> int:
        return self.t.size

    def at(self, k: int) -> dict[str, Any]:
        """Columns of the log at frame k, with `qpos` (nq,) and `horizon` (Np + 1, 2)."""
        return {name: float(v[k]) for name, v in self.values.items()} | {
            "qpos": self.qpos[k], "horizon": self.horizon[k]}

    def _between(self, column: Array) -> Array:
        """Linear interpolation of rows, shape (rows, ...) to (frames, ...)."""
        part = self.part.reshape((-1,) + (1,) * (column.ndim - 1))
        return (1.0 - part) * column[self.row] + part * column[self.row + 1]


def slerp(a: Array, b: Array, part: Array) -> Array:
    """Shortest turn from quaternion a to b, shape (n, 4), at part 0..1, shape (n,)."""
    a = a / np.linalg.norm(a, axis=1, keepdims=True)
    b = b / np.linalg.norm(b, axis=1, keepdims=True)
    dot = np.sum(a * b, axis=1)
    b = np.where(dot[:, None] < 0.0, -b, b)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    # For equal attitudes the quotient of sines is that of the angles.
    sine = np.where(angle > 1e-6, np.sin(angle), 1.0)
    wa = np.where(angle > 1e-6, np.sin((1.0 - part) * angle) / sine, 1.0 - part)
    wb = np.where(angle > 1e-6, np.sin(part * angle) / sine, part)
    return wa[:, None] * a + wb[:, None] * b


def run_hud(log: Any, width: int, height: int, *, name: str | None = None,
            scales: dict[str, float] | None = None) -> Hud:
    """Instruments of a run, named after its controller and scaled to it where nothing is given."""
    path = log.scenario.path
    road = np.stack(path.at(np.linspace(0.0, path.length, 400))[:2], axis=1)
    return Hud(width, height, title=str(log.meta["scenario"]), road=road,
               scales=scales or full_scales(log), subtitle=name or str(log.meta["controller"]))


def full_scales(*logs: Any) -> dict[str, float]:
    """Full scales of the instruments that suit one run, or several beside each other."""

    def full(curve: Callable[[Any], Any], steps: tuple[float, ...]) -> float:
        """The first step above all but the rarest values."""
        values = np.abs(np.concatenate([curve(log.columns) for log in logs]))
        finite = values[np.isfinite(values)]
        peak = float(np.percentile(finite, 99.5)) if finite.size else 0.0
        return next((step for step in steps if step >= peak), steps[-1])

    return {
        "ey_mm": full(lambda c: 1e3 * c["ey_m"],
                      (2, 5, 10, 20, 50, 100, 200, 500, 1000, 5000)),
        "steer_deg": full(lambda c: np.rad2deg(c["delta_rad"]), (5, 10, 20, 30)),
        "acc_mps2": full(lambda c: np.hypot(c["ax_mps2"], c["ay_mps2"]), (4, 8, 12)),
        "wind_mps": max(full(lambda c: c["wind_mps"], (10, 20, 40, 60)), 10.0),
    }


def instruments(now: dict[str, Any]) -> dict[str, float]:
    """What the instruments show at one instant, in their units."""
    return {
        **{name: now[name] for name in ("t_s", "vx_mps", "vx_ref_mps", "ax_mps2", "ay_mps2",
                                        "wind_mps", "x_m", "y_m", "psi_rad")},
        "ey_mm": 1e3 * now["ey_m"], "steer_deg": math.degrees(now["delta_rad"]),
        "step_ms": 1e-3 * now["step_us"],
    }


def counted(count: int, progress: Callable[[float], None] | None) -> Iterator[int]:
    """0, 1, ..., count - 1, telling the progress."""
    with Bar("filming", count) if progress is None else contextlib.nullcontext() as bar:
        for k in range(count):
            yield k
            if progress is not None:
                progress((k + 1) / count)
            elif bar is not None:
                bar.at(k + 1)
