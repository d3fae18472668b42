"""What is written over a video frame: instruments at the bottom, title, map of the road.

Drawn with OpenCV into an RGB image in place. Labels, scales and the map are drawn once; a frame
only darkens its panels, adds them, and writes the numbers that change.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]

INK, FAINT = (245, 247, 250), (168, 178, 190)
ACCENT, WARM = (86, 180, 233), (255, 176, 60)
BEFORE, AFTER = (150, 160, 172), (255, 176, 60)
SHADE = 0.32
"""Brightness of the picture behind the instruments."""


class Hud:
    """Instruments for pictures of one size and one run."""

    def __init__(self, width: int, height: int, *, title: str, subtitle: str, road: Any,
                 scales: Mapping[str, float]) -> None:
        """Draw what does not change.

        Args:
            width: Width of the pictures [px].
            height: Height of the pictures [px].
            title: Scenario.
            subtitle: Controller.
            road: Points of the path for the map [m], shape (n, 2).
            scales: Full scale of the instruments: `ey_mm`, `steer_deg`, `acc_mps2`, `wind_mps`.
        """
        self.k = height / 720.0
        self.scales = dict(scales)
        self.font = cv2.FontFace("sans")
        self.size = (height, width)
        self.strip_top = height - self._px(96)
        self.cells = self._cells(width)
        self.still = np.zeros((height, width, 3), dtype=np.uint8)
        title_wide = max(self._wide(title, 22, 700), self._wide(subtitle, 16, 500))
        self.clock = self._px(30 + 40 + 90) + title_wide  # right end of the time
        self.panels: list[tuple[slice, slice]] = [
            (slice(self.strip_top, height), slice(0, width)),
            (slice(self._px(16), self._px(92)), slice(self._px(16), self.clock + self._px(16))),
        ]
        self._title(title, subtitle)
        self._labels()
        self._map(road, width)

    def draw(self, frame: Image, now: Mapping[str, float]) -> None:
        """Write the instruments into a frame.

        Args:
            frame: RGB picture of the size given at construction, changed in place.
            now: Values of this instant: t_s, vx_mps, vx_ref_mps, ey_mm, steer_deg, ax_mps2,
                ay_mps2, wind_mps, step_ms, x_m, y_m, psi_rad. NaN is shown as a dash.
        """
        for rows, columns in self.panels:
            patch = frame[rows, columns]
            cv2.convertScaleAbs(patch, patch, SHADE, 0.0)
            cv2.add(patch, self.still[rows, columns], patch)
        k = self._px
        base = self.strip_top
        self._text(frame, f"{now['t_s']:.1f} s", (self.clock, k(50)), 22, INK, 600, right=True)

        x = self.cells["speed"]
        self._text(frame, _number(now["vx_mps"], 1), (x + k(86), base + k(70)), 40, INK, 600, True)
        self._text(frame, f"{_number(now['vx_ref_mps'], 1)} ref", (x + k(96), base + k(48)), 15,
                   FAINT, 500)
        self._gauge(frame, "error", now["ey_mm"], self.scales["ey_mm"], 2, left_positive=True)
        self._gauge(frame, "steer", now["steer_deg"], self.scales["steer_deg"], 1, True)

        x = self.cells["acc"]
        centre = (x + k(46), base + k(50))
        radius = k(36)
        full = self.scales["acc_mps2"]
        if np.isfinite(now["ax_mps2"] + now["ay_mps2"]):
            dot = np.clip(np.array((-now["ay_mps2"], -now["ax_mps2"])) / full, -1.2, 1.2) * radius
            tip = (int(centre[0] + dot[0]), int(centre[1] + dot[1]))
            cv2.line(frame, centre, tip, WARM, k(2), cv2.LINE_AA)
            cv2.circle(frame, tip, k(5), WARM, -1, cv2.LINE_AA)
        for row, key in ((54, "ax_mps2"), (78, "ay_mps2")):
            self._text(frame, _number(now[key], 1, sign=True), (x + k(166), base + k(row)), 20, INK,
                       600, True)

        x = self.cells["wind"]
        self._text(frame, _number(abs(now["wind_mps"]), 0), (x + k(62), base + k(70)), 34, INK, 600,
                   True)
        if np.isfinite(now["wind_mps"]) and abs(now["wind_mps"]) > 0.5:
            reach = k(14 + 42 * min(abs(now["wind_mps"]) / self.scales["wind_mps"], 1.0))
            middle, side = x + k(128), 1 if now["wind_mps"] > 0 else -1
            y = base + k(74)
            cv2.arrowedLine(frame, (middle - side * reach // 2, y), (middle + side * reach // 2, y),
                            ACCENT, k(3), cv2.LINE_AA, 0, 0.28)

        x = self.cells["step"]
        self._text(frame, _number(now["step_ms"], 2), (x + k(84), base + k(70)), 34, INK, 600, True)
        self._car_on_map(frame, now)

    def _px(self, value: float) -> int:
        """Length at 720 lines in pixels of this picture, at least one."""
        return max(int(round(value * self.k)), 1)

    def _cells(self, width: int) -> dict[str, int]:
        """Left edge of each instrument, spread over the width."""
        widths = {"speed": 176, "error": 270, "steer": 250, "acc": 230, "wind": 176, "step": 160}
        gap = (width / self.k - sum(widths.values())) / 2.0
        edges, x = {}, max(gap, 0.0)
        for name, size in widths.items():
            edges[name] = self._px(x + 8)
            x += size
        return edges

    def _text(self, image: Image, text: str, place: tuple[int, int], size: float, colour: Any,
              weight: int = 400, right: bool = False) -> None:
        """Write on a baseline that starts, or with `right` ends, at a place."""
        flags = cv2.PUT_TEXT_ALIGN_RIGHT if right else cv2.PUT_TEXT_ALIGN_LEFT
        cv2.putText(image, text, place, colour, self.font, self._px(size), weight, flags)

    def _wide(self, text: str, size: float, weight: int) -> int:
        """Width of a text [px]."""
        box = cv2.getTextSize((10000, 100), text, (0, 0), self.font, self._px(size), weight)
        return int(box[2])

    def _title(self, title: str, subtitle: str) -> None:
        k = self._px
        self._text(self.still, title, (k(30), k(50)), 22, INK, 700)
        self._text(self.still, subtitle, (k(30), k(78)), 16, FAINT, 500)

    def _labels(self) -> None:
        """Names, units and scales of the instruments."""
        k, base, still = self._px, self.strip_top, self.still
        for name, label in (("speed", "SPEED"), ("error", "LATERAL ERROR"), ("steer", "STEERING"),
                            ("wind", "SIDE WIND"), ("step", "CONTROL STEP")):
            self._text(still, label, (self.cells[name], base + k(24)), 13, FAINT, 600)
        x = self.cells["speed"]
        self._text(still, "m/s", (x + k(96), base + k(70)), 16, FAINT)
        x = self.cells["wind"]
        self._text(still, "m/s", (x + k(70), base + k(54)), 16, FAINT)
        x = self.cells["step"]
        self._text(still, "ms", (x + k(92), base + k(70)), 16, FAINT)
        for name, key in (("error", "ey_mm"), ("steer", "steer_deg")):
            left, right, y = self._bar(name)
            cv2.line(still, (left, y), (right, y), (70, 76, 84), k(8), cv2.LINE_AA)
            middle = (left + right) // 2
            cv2.line(still, (middle, y - k(9)), (middle, y + k(9)), FAINT, k(2))
            self._text(still, f"±{self.scales[key]:g}", (right, base + k(24)), 13, FAINT, 500, True)
        x = self.cells["acc"]
        centre = (x + k(46), base + k(50))
        cv2.circle(still, centre, k(36), (96, 104, 114), k(1), cv2.LINE_AA)
        cv2.circle(still, centre, k(18), (70, 76, 84), k(1), cv2.LINE_AA)
        cv2.line(still, (centre[0] - k(36), centre[1]), (centre[0] + k(36), centre[1]),
                 (70, 76, 84), k(1))
        cv2.line(still, (centre[0], centre[1] - k(36)), (centre[0], centre[1] + k(36)),
                 (70, 76, 84), k(1))
        self._text(still, "ACCELERATION", (x + k(94), base + k(24)), 13, FAINT, 600)
        for row, label in ((54, "x"), (78, "y")):
            self._text(still, label, (x + k(98), base + k(row)), 16, FAINT)
            self._text(still, "m/s²", (x + k(172), base + k(row)), 14, FAINT)
        for name in ("error", "steer", "acc", "wind", "step"):
            edge = self.cells[name] - k(14)
            cv2.line(still, (edge, base + k(14)), (edge, base + k(82)), (64, 70, 78), 1)

    def _bar(self, name: str) -> tuple[int, int, int]:
        """Left end, right end and height of a gauge's bar."""
        x, wide = self.cells[name], {"error": 234, "steer": 214}[name]
        return x, x + self._px(wide), self.strip_top + self._px(79)

    def _gauge(self, frame: Image, name: str, value: float, full: float, digits: int,
               left_positive: bool) -> None:
        """Number above a bar with a marker; positive values lie to the left, as on the road."""
        k = self._px
        left, right, y = self._bar(name)
        unit = {"error": "mm", "steer": "deg"}[name]
        self._text(frame, _number(value, digits, sign=True), (left + k(104), y - k(20)), 28, INK,
                   600, True)
        self._text(frame, unit, (left + k(112), y - k(20)), 15, FAINT)
        if not np.isfinite(value):
            return
        share = float(np.clip(value / full, -1.0, 1.0)) * (-1.0 if left_positive else 1.0)
        middle = (left + right) // 2
        tip = int(middle + share * (right - left) / 2)
        cv2.line(frame, (middle, y), (tip, y), ACCENT, k(8), cv2.LINE_AA)
        cv2.circle(frame, (tip, y), k(7), INK, -1, cv2.LINE_AA)

    def _map(self, road: Any, width: int) -> None:
        """Small map with north up, at the top right."""
        k = self._px
        side, margin = k(190), k(16)
        points = np.asarray(road, dtype=float)
        low, high = points.min(axis=0), points.max(axis=0)
        scale = (side - k(36)) / max(float((high - low).max()), 1.0)
        box = np.maximum((high - low) * scale, k(30)).astype(int) + k(36)
        top, left = margin, width - margin - int(box[0])
        self.panels.append((slice(top, top + int(box[1])), slice(left, left + int(box[0]))))
        centre = np.array((left + box[0] / 2.0, top + box[1] / 2.0))
        self.on_map = (centre - 0.5 * (low + high) * (1, -1) * scale, scale)
        line = np.round(8.0 * np.stack(self._pixel(points[:, 0], points[:, 1]), axis=1))
        cv2.polylines(self.still, [line.astype(np.int32)], False, BEFORE, k(3), cv2.LINE_AA, 3)

    def _pixel(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Place on the map of a point of the world [m]."""
        origin, scale = self.on_map
        return origin[0] + scale * np.asarray(x), origin[1] - scale * np.asarray(y)

    def _car_on_map(self, frame: Image, now: Mapping[str, float]) -> None:
        u, v = self._pixel(now["x_m"], now["y_m"])
        if not np.isfinite(u + v):
            return
        c, s = np.cos(now["psi_rad"]), -np.sin(now["psi_rad"])  # the picture's y points down
        size = self.k * np.array(((9.0, 0.0), (-6.0, 5.5), (-6.0, -5.5)))
        arrow = np.stack([u + c * size[:, 0] - s * size[:, 1],
                          v + s * size[:, 0] + c * size[:, 1]], axis=1)
        polygon = np.round(8.0 * arrow).astype(np.int32)
        cv2.fillPoly(frame, [polygon], AFTER, cv2.LINE_AA, 3)


def _number(value: float, digits: int, sign: bool = False) -> str:
    """A number with a true minus sign and without a negative zero; a dash for NaN."""
    if not np.isfinite(value):
        return "–"
    text = f"{value:{'+' if sign else ''}.{digits}f}"
    if float(text) == 0.0:
        text = text.lstrip("+-")
    return text.replace("-", "−")
