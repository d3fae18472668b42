"""The promises of the reproduction, each with its measured figure and its limit."""

from __future__ import annotations

import math

import numpy as np

from lpvmpc.bench.cases import CHARGE
from lpvmpc.kit.findings import Finding, Limit
from lpvmpc.paper import steering_at_rest
from lpvmpc.paper.measurements import Evidence
from lpvmpc.paper.runs import OURS
from lpvmpc.tune import sphere


def bars(e: Evidence) -> list[Finding]:
    """The promises, each with its figure; a lost car is charged."""
    found = []
    for case, title, key, unit, scale, limit in (
        ("paper", "paper: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 0.5),
        ("paper", "paper: largest lateral error", "lateral_max_m", "mm", 1e3, 3.0),
        ("paper", "paper: speed RMSE", "speed_rmse_mps", "m/s", 1.0, 0.01),
        ("paper-loop", "paper-loop: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 1.0),
        ("double-lane-change", "lane change: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 1.0),
        ("circuit-0.5", "circuit 50 %: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 1.0),
        ("circuit-0.87", "circuit 87 %: lateral RMSE", "lateral_rmse_m", "mm", 1e3, 1.8),
    ):
        row = e.get("tuned", OURS, case)
        value = None
        if row is not None:
            told = row.get(key)
            value = scale * (CHARGE if told is None else told)
        name = f"{case}_{key}" if scale == 1.0 else f"{case}_{key.removesuffix('_m')}_mm"
        found.append(_promise(name, title, value, limit, unit))
    for one in e.rests:
        where = "circle" if one.turning else "straight"
        left = 1e3 * one.left if one.completed else math.inf
        found.append(_promise(
            f"rest_{where}_{one.vx:g}_mrad", f"steering at rest, {where}, {one.vx:g} m/s", left,
            1e3 * steering_at_rest.LIMIT, "mrad",
        ))
    mixed = float(np.median(e.sphere.ours.of("mixed").final))
    found.append(_promise("sphere_mixed", "sphere: median distance, mixed", mixed, sphere.BAR))
    driven = {row.case.scenario for row in e.rows}
    shared = sorted(driven & set(e.tuned_on))
    found.append(_promise(
        "tuned_on_reported", "roads here that also tuned weights", float(len(shared)), 0.0, "roads"
    ))
    return found


def _promise(
    key: str, figure: str, value: float | None, limit: float, unit: str = ""
) -> Finding:
    return Finding(key=key, figure=figure, value=value, unit=unit, limit=Limit.at_most(limit))
