"""A run as one HTML file that needs nothing else: film, linked plots, maps, settings, numbers.

`page.html` holds the layout, `page.js` the script. All numbers are computed here, from the log
alone; the script draws them, and moves one instant through all of them.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.kit.report import page_of
from lpvmpc.picture.style import BLUE, GREEN, GREY, ORANGE, RED, SKY
from lpvmpc.sim.log import WHEELS
from lpvmpc.units import Array

MOST = 40_000
"""Instants that a page holds; of a longer run it holds every second one, every third, ..."""
SPACING = 1.0
"""Distance of the points of the road's edges [m]; more on a long road."""
RUNGS = 8
"""Points of each prediction."""
INK = ""
"""Colour of a curve that has the text's."""


def page(log: Any, result: Mapping[str, Any], rows: Iterable[tuple[str, str, str]],
         video: FilePath | None = None) -> str:
    """The page.

    Args:
        log: Log of `simulate`, or of `read_run`, with two rows or more.
        result: The run's metrics, and what led to them under `record`, as metrics.json has it.
        rows: The table: label, value of this run, value of the paper (or an empty text).
        video: A film of the run from its first instant, which a browser plays.

    Returns:
        HTML; everything in it is in it, so that it opens offline.
    """
    every = math.ceil(len(log.columns["t_s"]) / MOST)
    title = f"{result['controller']} on {result['scenario']}"
    verdict = "Completed." if result["completed"] else f"Not completed: {result['reason']}."
    if every > 1:
        verdict += f" Every {every}. instant is shown."
    film = "" if video is None else base64.b64encode(video.read_bytes()).decode()
    script = (resources.files("lpvmpc.picture") / "page.js").read_text("utf-8")
    return page_of("lpvmpc.picture", "page.html", _data(log, every), {
        "TITLE": html.escape(title),
        "VERDICT": html.escape(verdict),
        "CLASS": "about" if result["completed"] else "bad",
        "FILM": film,
        "NUMBERS": _numbers(list(rows)),
        "SETTINGS": "\n".join(_settings(result)),
        "SCRIPT": script,
    })


def _numbers(rows: list[tuple[str, str, str]]) -> str:
    """The table's rows in HTML, with a column for the paper where it has numbers."""
    beside = any(paper for _, _, paper in rows)
    text = ["<tr><th>quantity</th><th>this run</th>" + "<th>paper</th>" * beside + "</tr>"]
    for label, ours, paper in rows:
        cells = (label, ours, paper) if beside else (label, ours)
        text.append("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>")
    return "\n".join(text)


def _settings(result: Mapping[str, Any]) -> Iterable[str]:
    """Groups of settings, each a list that can be folded."""
    record = result.get("record", {})
    weights = record.get("weights", {})
    given = {**record.get("options", {}), "seed": result["seed"], "stiffness": result["stiffness"],
             "estimator": result["estimator"]}
    origin = {"commit": record.get("commit"), "machine": record.get("machine"),
              **result["versions"], "model_sha256": result["model_sha256"]}
    groups = {
        "Settings": {k: v for k, v in given.items() if v not in (None, False)},
        "World": {"world": result["world"]["name"], **_flat(result["world"]["drawn"]),
                  **_flat(record.get("estimator_unknowns") or {}, "estimated ")},
        "Weights": _flat(weights),
        "Where it comes from": origin,
        "Warnings": dict(enumerate(record.get("warnings", []), 1)),
    }
    for name, values in groups.items():
        if not values:
            continue
        lines = "".join(f"<dt>{html.escape(str(key))}</dt><dd>{html.escape(_shown(value))}</dd>"
                        for key, value in values.items())
        yield f"<details open><summary>{name}</summary><dl>{lines}</dl></details>"


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested settings as one level, names joined by dots."""
    flat: dict[str, Any] = {}
    for key, value in values.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f"{before}{key}."))
        else:
            flat[f"{before}{key}"] = value
    return flat


def _shown(value: Any) -> str:
    """A setting as text; numbers with the digits that a reader wants."""
    if isinstance(value, float):
        return f"{value:.5g}"
    if isinstance(value, list | tuple):
        return ", ".join(map(_shown, value[:8])) + (" ..." if len(value) > 8 else "")
    return "-" if value is None else str(value)


# Data ---------------------------------------------------------------------------------------------


def _data(log: Any, every: int) -> dict[str, Any]:
    """What the script draws; arrays are little-endian single precision in base64."""
    c = {name: np.asarray(column, float)[::every] for name, column in log.columns.items()}
    car = log.meta.get("footprint_m")
    lf, lr, width = car if car else (1.2, 1.4, 1.7)
    start = np.hypot(c["pred_x_m_0"] - c["x_m"], c["pred_y_m_0"] - c["y_m"]) \
        if "pred_x_m_0" in c else np.zeros(len(c["t_s"]))
    # a told delay puts the start of a prediction up to a second ahead; further off it is not one
    real = np.where(start < c["vx_mps"] + 3.0, 1.0, np.nan)
    forces = [[_packed(c[f"F{way}_{wheel}_N"]) for way in "xy"] for wheel in WHEELS]
    steps = [int(name.rpartition("_")[2]) for name in c if name.startswith("pred_x_m_")]
    rungs = steps[:: max(1, len(steps) // RUNGS)]
    return {
        **{short: _packed(c[name]) for short, name in (
            ("t", "t_s"), ("x", "x_m"), ("y", "y_m"), ("psi", "psi_rad"), ("delta", "delta_rad"),
            ("vx", "vx_mps"), ("s", "s_m"))},
        "forces": forces,
        "horizon": [[_packed(real * c[f"pred_{way}_m_{k}"]) for way in "xy"] for k in rungs],
        "car": {"lf": lf, "lr": lr, "width": width},
        "road": _road(log.scenario.path),
        "users": [
            {"length": user["length_m"], "width": user["width_m"],
             "pose": [_packed(c[f"user{i}_{name}"]) for name in ("x_m", "y_m", "psi_rad")]}
            for i, user in enumerate(log.meta.get("traffic", []))
        ],
        "cones": np.round(np.asarray(log.scenario.cones, float), 2).tolist(),
        "plots": [
            {"title": title, "unit": unit, "digits": digits, "curves": [
                {"name": name, "color": colour, "dash": dash, "values": _packed(values)}
                for name, colour, dash, values in curves
            ]} for title, unit, digits, curves in _plots(log, c, every)
        ],
    }


def _packed(values: npt.ArrayLike) -> str:
    """Numbers in base64; those that are not finite stay NaN."""
    return base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()


def _road(path: Any) -> dict[str, Any]:
    """Edges and centre line of the road, as x and y in turns."""
    count = int(min(max(path.length / SPACING, 2.0), MOST)) + 1
    s = np.linspace(0.0, path.length, count)
    x, y, psi, _ = path.at(s)
    sides = {"left": np.interp(s, path.s, path.width_left), "centre": np.zeros(count),
             "right": -np.interp(s, path.s, path.width_right)}
    return {name: _packed(np.stack([x - d * np.sin(psi), y + d * np.cos(psi)], axis=1).ravel())
            for name, d in sides.items()}


Curve = tuple[str, str, str, Array]


def _plots(log: Any, c: Mapping[str, Array],
           every: int) -> Iterable[tuple[str, str, int, list[Curve]]]:
    """Title, unit, digits and curves of each plot; all are over the time of the instants."""
    dashed = "5 3"
    lateral = [("true", BLUE, "", 1e3 * c["ey_m"])]
    heading = [("true", BLUE, "", np.rad2deg(c["epsi_rad"]))]
    if "est_ey_m" in c:
        lateral.append(("estimated", ORANGE, "", 1e3 * c["est_ey_m"]))
        heading.append(("estimated", ORANGE, "", np.rad2deg(c["est_epsi_rad"])))
    yield "Lateral error, left positive", "mm", 2, lateral
    yield "Heading error", "deg", 3, heading
    yield "Speed error", "m/s", 4, [("driven", BLUE, "", c["vx_mps"] - c["vx_ref_mps"])]
    yield "Speed", "m/s", 2, [("driven", BLUE, "", c["vx_mps"]),
                              ("reference", INK, dashed, c["vx_ref_mps"])]
    yield "Steering", "deg", 2, [("command", RED, "", np.rad2deg(c["delta_cmd_rad"])),
                                 ("road wheel", INK, dashed, np.rad2deg(c["delta_rad"]))]
    yield "Acceleration", "m/s²", 2, [("command", RED, "", c["ax_cmd_mps2"]),
                                      ("longitudinal", INK, dashed, c["ax_mps2"]),
                                      ("lateral", BLUE, "", c["ay_mps2"])]
    used = []
    for wheel, colour in zip(WHEELS, (BLUE, SKY, RED, ORANGE), strict=True):
        Fx, Fy, Fz = (c[f"F{way}_{wheel}_N"] for way in "xyz")
        share = np.hypot(Fx, Fy) / np.where(Fz > 1.0, c[f"mu_{wheel}"] * Fz, np.nan)
        used.append((wheel, colour, "", 100.0 * share))
    yield "Friction used", "%", 0, used
    if np.any(np.nan_to_num(c["wind_mps"])):
        yield "Side wind", "m/s", 1, [("wind", GREEN, "", c["wind_mps"])]
    users = log.meta.get("traffic", [])
    if users:
        nearest = np.min([c[f"user{i}_gap_m"] for i in range(len(users))], axis=0)
        yield "Gap to the nearest road user", "m", 2, [("bodies", GREEN, "", nearest)]
    step = np.asarray(log.timing["step_us"], float)[::every][: len(c["t_s"])]
    if len(step) == len(c["t_s"]):
        yield "Control step", "ms", 3, [("CPU time", GREY, "", 1e-3 * step)]
