"""Numbers from a Log: tracking errors, the solver's record, step times.

Definitions. Every error is that of the true centre of mass, taken at every control instant from
the first; an RMSE is the plain root of the mean square over those instants.

- lateral: ey, the signed distance to the path; heading: epsi = psi - psi_path, wrapped;
  course: epsi + atan2(vy, vx), the direction of motion against the path's; speed: vx - vx_ref.
- distance: length of the driven line; s_end: arc length reached along the path.
- left road: the time of those instants at which a corner of the car is beyond the road's edge. The
  corners are those of the rectangle from axle to axle, as wide as the body. A road that states no
  widths counts as `lpvmpc.road.path.WIDTH` wide on either side.
- lap times: from crossing to crossing of a closed track's start line, complete laps only.
- steering rate: root mean square of the commanded angle's change from one instant to the next,
  over the control period; what a restless controller asks of its servo.
- estimate: ey of the estimated position less the true one; None where nothing was estimated.
- step time: CPU time of the controller's `command`, all threads together [us].
"""

from __future__ import annotations

import hashlib
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.units import Array

if TYPE_CHECKING:
    from lpvmpc.sim.log import Log


KEYS = (
    "scenario",
    "controller",
    "stiffness",
    "seed",
    "completed",
    "reason",
    "s_end_m",
    "distance_m",
    "duration_s",
    "reference_duration_s",
    "lateral_rmse_m",
    "lateral_max_m",
    "heading_rmse_rad",
    "heading_max_rad",
    "course_rmse_rad",
    "speed_rmse_mps",
    "speed_max_mps",
    "lateral_acc_max_mps2",
    "left_road_s",
    "lap_times_s",
    "step_time_us",
    "qp",
    "world",
    "estimator",
    "steer_rate_rms_radps",
    "estimate_ey_rmse_m",
    "wall_s",
    "realtime_factor",
    "versions",
    "model_sha256",
)
"""Keys of `metrics`, in the order they are written."""
DETAILS = (
    "lateral_p95_m", "jerk_rms_mps3", "drive_rate_rms_mps3", "steps", "late_steps", "trace_sha256",
)
"""Keys of `details`."""


def metrics(log: Log) -> dict[str, Any]:
    """Summary of one run, as written to metrics.json.

    Args:
        log: A run, complete or not; an empty one (stopped before the first instant) gives None for
            whatever cannot be measured.

    Returns:
        Dictionary with exactly the keys `KEYS`: plain Python numbers, strings, dictionaries and
        None, ready for JSON. Units are in the names; `qp` counts solved and refused steps.
    """
    c, meta = log.columns, log.meta
    course = wrap(c["epsi_rad"] + np.arctan2(c["vy_mps"], c["vx_mps"]))
    speed_error = c["vx_mps"] - c["vx_ref_mps"]
    driven = np.hypot(np.diff(c["x_m"]), np.diff(c["y_m"]))
    values = {
        **{key: meta[key] for key in KEYS if key in meta},
        "distance_m": float(driven.sum()),
        "lateral_rmse_m": rms(c["ey_m"]),
        "lateral_max_m": largest(c["ey_m"]),
        "heading_rmse_rad": rms(c["epsi_rad"]),
        "heading_max_rad": largest(c["epsi_rad"]),
        "course_rmse_rad": rms(course),
        "speed_rmse_mps": rms(speed_error),
        "speed_max_mps": largest(speed_error),
        "lateral_acc_max_mps2": largest(c["ay_mps2"]),
        "left_road_s": left_road_time(log),
        "lap_times_s": meta.get("lap_times_s", []) if log.scenario.path.closed else [],
        "step_time_us": step_times(log.timing["step_us"]),
        "qp": solver_record(log),
        "world": meta.get("world", {"name": "ideal", "drawn": {}}),
        "estimator": meta.get("estimator", "none"),
        "steer_rate_rms_radps": rms(np.diff(c["delta_cmd_rad"]) / meta["Ts"]),
        "estimate_ey_rmse_m": estimate_error(log),
    }
    return {key: values[key] for key in KEYS}


def left_road_time(log: Log) -> float | None:
    """Time for which a corner of the car was beyond the road's edge [s].

    A corner a ahead of the centre of mass and b to its left is at, to second order in a,
      a sin(epsi) + b cos(epsi) - kappa a^2 / 2 + ey
    beside the path; a is lf or -lr, b half the body's width or its negative.
    """
    if "footprint_m" not in log.meta:  # no car has driven
        return None
    c, path = log.columns, log.scenario.path
    lf, lr, width = log.meta["footprint_m"]
    period = path.length if path.closed else None
    right, left = (
        np.interp(c["s_m"], path.s, side, period=period)
        for side in (path.width_right, path.width_left)
    )
    beyond = np.zeros(len(log), dtype=bool)
    for a in (lf, -lr):
        axle = c["ey_m"] + a * np.sin(c["epsi_rad"]) - 0.5 * c["kappa_radpm"] * a**2
        half = 0.5 * width * np.abs(np.cos(c["epsi_rad"]))
        beyond |= (axle + half > left) | (axle - half < -right)
    return float(log.meta["Ts"] * np.count_nonzero(beyond))


def estimate_error(log: Log) -> float | None:
    """RMS of the estimated lateral error less the true one [m]; None without an estimator.

    At the instant at which a car is lost nothing is estimated any more.
    """
    if "est_ey_m" not in log.columns:
        return None
    error = log.columns["est_ey_m"] - log.columns["ey_m"]
    return rms(error[np.isfinite(error)])


def jerk_rms(log: Log) -> float | None:
    """Root mean square of the lateral jerk [m/s3]; None where there are no two instants.

    The change of the centre of mass's lateral acceleration from one control instant to the next,
    over the control period: what a passenger feels of a restless controller.
    """
    return rms(np.diff(log.columns["ay_mps2"]) / log.meta["Ts"])


def details(log: Log) -> dict[str, Any]:
    """What is kept of a run beside its `metrics`, when many are compared; keys `DETAILS`.

    - lateral p95: what 95 % of the instants' |ey| do not exceed;
    - lateral jerk: the change of the centre of mass's lateral acceleration from one control instant
      to the next, over the control period; what a passenger feels of a restless controller;
    - drive rate: the same of the commanded acceleration, root mean square;
    - steps, late steps: calls of the controller, and those of them that took longer than the
      control period;
    - trace: SHA-256 of the trace's columns, which times are no part of.
    """
    c, Ts = log.columns, log.meta["Ts"]
    ey = np.abs(c["ey_m"])
    return {
        "lateral_p95_m": _finite(float(np.percentile(ey, 95.0))) if len(ey) else None,
        "jerk_rms_mps3": jerk_rms(log),
        "drive_rate_rms_mps3": rms(np.diff(c["ax_cmd_mps2"]) / Ts),
        "steps": len(log.timing["step_us"]),
        "late_steps": int(np.count_nonzero(log.timing["step_us"] > 1e6 * Ts)),
        "trace_sha256": trace_sha256(log),
    }


def trace_sha256(log: Log) -> str:
    """SHA-256 of the names and the values of the trace's columns, in their order."""
    digest = hashlib.sha256()
    for name, column in log.columns.items():
        digest.update(f"{name} {column.dtype.str} ".encode() + np.ascontiguousarray(column).data)
    return digest.hexdigest()


def wrap(angle: Array) -> Array:
    """The angle in [-pi, pi) [rad], shape (...,)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def rms(error: Array) -> float | None:
    """Root of the mean square of an error, shape (n,); None without samples."""
    return _finite(math.sqrt(np.mean(np.square(error)))) if len(error) else None


def largest(error: Array) -> float | None:
    """Largest magnitude of an error, shape (n,); None without samples."""
    return _finite(np.max(np.abs(error))) if len(error) else None


def step_times(step_us: Array) -> dict[str, float | None]:
    """Mean, median, 99th percentile and worst of the controller's step times [us], shape (n,)."""
    if not len(step_us):
        return dict.fromkeys(("mean", "p50", "p99", "max"))
    p50, p99 = np.percentile(step_us, (50.0, 99.0))
    return {
        "mean": float(np.mean(step_us)),
        "p50": float(p50),
        "p99": float(p99),
        "max": float(np.max(step_us)),
    }


def solver_record(log: Log) -> dict[str, Any]:
    """Number of solved and of refused QPs, and the largest KKT residual among the solved.

    A controller without a QP has zero of both and no residual.
    """
    solved = log.columns["solved"].astype(bool)
    fallback = log.columns["fallback"] != 0
    residual = log.columns["kkt_residual"][solved]
    residual = residual[np.isfinite(residual)]
    has_qp = bool(log.meta.get("has_qp", True))
    return {
        "solved": int(solved.sum()) if has_qp else 0,
        "fallback": int(fallback.sum()) if has_qp else 0,
        "max_kkt_residual": float(residual.max()) if has_qp and len(residual) else None,
    }


def _finite(value: float) -> float | None:
    """The value as a plain float, None when it is NaN or infinite (JSON has neither)."""
    return float(value) if math.isfinite(value) else None
