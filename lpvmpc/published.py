"""Numbers that the paper prints of its runs (Kebbati et al.), each typed here alone.

Its largest speed error is below its RMSE, which cannot be; quoted as printed.
"""

from __future__ import annotations

import math

HEADING_MAX_DEG = 11.0
"""Largest heading error of its controller [deg]."""
TRACKING = {
    "lateral_rmse_m": 0.0217,
    "lateral_max_m": 0.08,
    "heading_rmse_rad": 0.0465,
    "heading_max_rad": math.radians(HEADING_MAX_DEG),
    "speed_rmse_mps": 0.101,
    "speed_max_mps": 0.087,
}
"""Errors of its controller on its road, by the keys of metrics.json."""
BASELINE = {"lateral_rmse_m": 0.1367, "speed_rmse_mps": 0.1459}
"""Errors of its baseline, LMPC with PSO-PID, there."""
SOLVE_MEAN_MS = 11.3
"""Mean time to solve its QP [ms]: Gurobi through Yalmip, Ryzen 7 5800H."""
LOSSES = {"training": 0.196, "validation": 0.226}
"""Losses of its network, training and validation."""
