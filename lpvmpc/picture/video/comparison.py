"""Two to four controllers side by side in one video, aligned in time, on the same road.

Each has its picture with the instruments of a single run, on scales that all share; below runs
their lateral error. Where a run ends before the others its last picture stays, grey, and says why.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path as FilePath
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.signals import ctrl_c_waits
from lpvmpc.picture import comparison
from lpvmpc.picture.style import RUNS
from lpvmpc.picture.video.encode import Encoder
from lpvmpc.picture.video.hud import FAINT, INK
from lpvmpc.picture.video.render import (
    Motion,
    check_size,
    counted,
    full_scales,
    instruments,
    run_hud,
)
from lpvmpc.picture.video.stage import Chase, Stage

Image = npt.NDArray[np.uint8]

MOST = 4
"""Runs that fit into one video."""
STRIP = 0.28
"""Height of the strip of errors as a share of a picture's."""
PAPER_DARK = (22, 26, 31)


def compare_video(
    runs: comparison.Runs,
    path: str | FilePath,
    *,
    width: int = 960,
    height: int = 540,
    fps: int = 30,
    progress: Callable[[float], None] | None = None,
) -> FilePath:
    """Draw runs of one road beside each other as a video that a browser plays, in real time.

    Interrupted by Ctrl-C, the file ends at the last whole frame, plays, and is kept under its
    name; then KeyboardInterrupt is raised.

    Args:
        runs: Two to four logs by name, all of the same road, each with two rows or more.
        path: File to write, usually .mp4. It appears under its name only when it is closed.
        width: Width of one picture [px], even; the video is twice as wide.
        height: Height of one picture [px], even.
        fps: Frames per simulated second.
        progress: Called after each frame with the finished fraction; without it a progress bar is
            shown when stderr is a terminal.

    Returns:
        The file written.

    Raises:
        LPVMPCError: The runs cannot be compared.
        OptionError: A size or frame rate that cannot be encoded.
        RenderError: No OpenGL on this machine, no encoder, or nothing to draw.
        OutputError: The file cannot be written.
    """
    comparison.check(runs)
    if len(runs) > MOST:
        raise LPVMPCError(f"A video holds up to {MOST} runs, but got {len(runs)}.")
    check_size(width, height, fps)
    path = FilePath(path)
    logs, dt = list(runs.values()), 1.0 / fps
    scales = full_scales(*(comparison.completed(runs) or runs).values())
    sides = [Side(name, log, width, height, fps, scales) for name, log in runs.items()]
    rows = (len(sides) + 1) // 2
    strip = Strip(sides, 2 * width, 2 * round(STRIP * height / 2.0), scales["ey_mm"])
    total = 2 * width, rows * height + strip.height
    frames = max(len(side.motion) for side in sides)
    stage = Stage(logs[0], width, height, dt)  # they share the road, and so the stage
    try:
        with ctrl_c_waits() as interrupted, Encoder(path, *total, fps) as video:
            for k in counted(frames, progress):
                frame = np.full((total[1], total[0], 3), PAPER_DARK, dtype=np.uint8)
                for n, side in enumerate(sides):
                    top, left = n // 2 * height, n % 2 * width
                    frame[top : top + height, left : left + width] = side.picture(stage, k)
                frame[: rows * height, width - 1 : width + 1] = PAPER_DARK
                strip.draw(frame[rows * height :], k)
                video.add(frame)
                if interrupted():
                    raise KeyboardInterrupt
    finally:
        stage.close()
    return path


class Side:
    """One run's picture in the video."""

    def __init__(
        self, name: str, log: Any, width: int, height: int, fps: int, scales: dict[str, float]
    ) -> None:
        """Args: name and log of the run, size of its picture [px], frame rate, shared scales."""
        self.name, self.log = name, log
        self.motion = Motion(log, fps)
        self.chase = Chase(log.scenario.path, 1.0 / fps)
        self.hud = run_hud(log, width, height, name=name, scales=scales)
        self.last: Image = np.zeros((height, width, 3), dtype=np.uint8)
        self.over = False

    def picture(self, stage: Stage, k: int) -> Image:
        """Picture at frame k; after the end of the run the last one, grey."""
        if k < len(self.motion):
            now = self.motion.at(k)
            stage.chase = self.chase
            self.last = stage.picture(now)
            self.hud.draw(self.last, instruments(now))
        elif not self.over:
            self.over = True
            self.last = ended(self.last, *self.reason())
        return self.last

    def reason(self) -> tuple[str, str]:
        """Why the run ended, in two lines."""
        meta = self.log.meta
        c = self.log.columns
        where = f"after {max(c['s_m'][-1], 0.0):.0f} m and {c['t_s'][-1]:.1f} s"
        return ("at the end of the road" if meta["completed"] else str(meta["reason"])), where


def ended(picture: Image, what: str, where: str) -> Image:
    """A grey, darker copy of a picture with two lines of text in its middle."""
    grey = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    dark = cv2.convertScaleAbs(grey, None, 0.55, 0.0)
    height, width = picture.shape[:2]
    k, font, middle = height / 720.0, cv2.FontFace("sans"), width // 2
    for text, size, row, ink, weight in ((what, 36, 0.44, INK, 700), (where, 24, 0.50, FAINT, 500)):
        size = max(round(size * k), 8)
        wide = cv2.getTextSize((10000, 100), text, (0, 0), font, size, weight)[2]
        place = (middle - wide // 2, int(row * height))
        cv2.putText(dark, text, place, ink, font, size, weight, cv2.PUT_TEXT_ALIGN_LEFT)
    return np.asarray(dark, dtype=np.uint8)


class Strip:
    """Lateral error of all runs over time: what is to come faint, what has been in full colour."""

    def __init__(self, sides: list[Side], width: int, height: int, full: float) -> None:
        """Args: the runs, the size of the strip [px], full scale of the error [mm]."""
        self.height, self.width = height, width
        self.k = height / (STRIP * 720.0)  # as in the instruments: 1 at 720 lines
        self.font = cv2.FontFace("sans")
        self.curves = []
        left, right = self._px(90), width - self._px(24)
        top, bottom = self._px(44), height - self._px(34)
        end = max(side.motion.t[-1] for side in sides)
        seen: Image = np.full((height, width, 3), PAPER_DARK, dtype=np.uint8)
        middle = (top + bottom) // 2
        cv2.line(seen, (left, middle), (right, middle), (70, 76, 84), 1)
        for value, row in ((full, top), (0.0, middle), (-full, bottom)):
            text = f"{value:+g}".replace("-", "−") if value else "0"
            self._text(seen, text, (left - self._px(10), row + self._px(5)), 14, FAINT, 500, True)
        self._text(seen, "LATERAL ERROR [mm]", (left, self._px(24)), 13, FAINT, 600)
        step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 200, 1e9) if end / s <= 12.0)
        for t in np.arange(0.0, end + 1e-9, step):
            x = int(left + (right - left) * t / max(end, 1e-9))
            cv2.line(seen, (x, bottom), (x, bottom + self._px(5)), FAINT, 1)
            self._text(seen, f"{t:g} s", (x, bottom + self._px(22)), 13, FAINT, 500)
        x = left + self._px(220)
        for side, colour in zip(sides, RUNS, strict=False):
            ink = tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))
            bright = tuple(int(0.75 * c + 0.25 * 255) for c in ink)
            error = np.clip(1e3 * side.motion.values["ey_m"] / full, -1.0, 1.0)
            u = left + (right - left) * side.motion.t / max(end, 1e-9)
            v = middle - 0.5 * (bottom - top) * np.nan_to_num(error)
            curve = np.round(8.0 * np.stack([u, v], axis=1)).astype(np.int32)
            cv2.polylines(seen, [curve], False, tuple(c // 3 for c in ink), 1, cv2.LINE_AA, 3)
            cv2.line(seen, (x, self._px(20)), (x + self._px(22), self._px(20)), bright,
                     self._px(3), cv2.LINE_AA)
            self._text(seen, side.name, (x + self._px(30), self._px(25)), 16, INK, 500)
            x += self._px(60) + self._wide(side.name, 16)
            self.curves.append((curve, bright))
        self.seen = seen

    def draw(self, frame: Image, k: int) -> None:
        """Write the strip at frame k into a part of a picture; frames must come in order."""
        for curve, ink in self.curves:
            if 0 < k < len(curve):
                cv2.polylines(self.seen, [curve[k - 1 : k + 1]], False, ink, self._px(2),
                              cv2.LINE_AA, 3)
        frame[:] = self.seen
        for curve, ink in self.curves:
            u, v = (curve[min(k, len(curve) - 1)] // 8).tolist()
            cv2.circle(frame, (u, v), self._px(5), ink, -1, cv2.LINE_AA)

    def _px(self, value: float) -> int:
        """Length at 720 lines in pixels of this picture, at least one."""
        return max(int(round(value * self.k)), 1)

    def _text(self, image: Image, text: str, place: tuple[int, int], size: float, colour: Any,
              weight: int, right: bool = False) -> None:
        flags = cv2.PUT_TEXT_ALIGN_RIGHT if right else cv2.PUT_TEXT_ALIGN_LEFT
        cv2.putText(image, text, place, colour, self.font, self._px(size), weight, flags)

    def _wide(self, text: str, size: float) -> int:
        box = cv2.getTextSize((10000, 100), text, (0, 0), self.font, self._px(size), 500)
        return int(box[2])
