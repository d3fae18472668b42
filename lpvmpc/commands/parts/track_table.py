"""What `lpvmpc track` prints of a run, with the paper's numbers beside it on the paper's road."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from lpvmpc import published
from lpvmpc.kit.provenance import machine

if TYPE_CHECKING:
    from lpvmpc.sim.log import Log


def print_table(result: dict[str, Any], log: Log) -> None:
    """The results, with the paper's beside them on the paper's scenario."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console(width=80 if not sys.stdout.isatty() else None, highlight=False)
    beside = result["scenario"] == "paper"
    title = f"{result['controller']} on {result['scenario']}"
    if result["estimate_ey_rmse_m"] is not None or result["world"]["drawn"]:
        title += f", world {result['world']['name']}, estimator {result['estimator']}"
    table = Table(title=escape(title), title_style="bold", title_justify="left", expand=False)
    table.add_column("quantity")
    table.add_column("this run", justify="right")
    if beside:
        table.add_column("paper", justify="right")
    for label, ours, paper in rows(result, log):
        table.add_row(label, ours, *([paper] if beside else []))
    console.print(table)
    if result["completed"] and result["left_road_s"] and log.scenario.path.has_widths:
        console.print(f"Completed, but {result['left_road_s']:.2f} s off the road.", style="yellow")
    elif result["completed"]:
        console.print("Completed.", style="green")
    else:
        console.print(f"Not completed: {escape(result['reason'])}.", style="red")
    used = result["versions"]
    console.print(f"Seed {result['seed']}, MuJoCo {used['mujoco']}, ProxQP {used['proxsuite']}; "
                  f"{machine()}.", style="dim")
    if beside:
        console.print("Paper: Kebbati et al., on CarSim; its largest speed error is below its RMSE"
                      " as printed.", style="dim")


def rows(result: dict[str, Any], log: Log) -> Iterator[tuple[str, str, str]]:
    """Label, value of this run and value of the paper, as text."""

    def number(key: str, unit: str, digits: int = 4, scale: float = 1.0) -> tuple[str, str]:
        ours, paper = result[key], published.TRACKING.get(key)
        shown = "-" if ours is None else f"{scale * ours:.{digits}f} {unit}"
        return shown, "" if paper is None else f"{scale * paper:.{digits}f} {unit}"

    yield "lateral error, RMSE", *number("lateral_rmse_m", "mm", 2, 1e3)
    yield "lateral error, largest", *number("lateral_max_m", "mm", 2, 1e3)
    yield "heading error, RMSE", *number("heading_rmse_rad", "rad")
    yield "heading error, largest", *number("heading_max_rad", "rad")
    yield "course error, RMSE", *number("course_rmse_rad", "rad")
    yield "speed error, RMSE", *number("speed_rmse_mps", "m/s")
    yield "speed error, largest", *number("speed_max_mps", "m/s")
    yield "lateral acceleration, largest", *number("lateral_acc_max_mps2", "m/s2", 2)
    yield "steering rate commanded, RMS", *number("steer_rate_rms_radps", "rad/s", 3)
    if result["estimate_ey_rmse_m"] is not None:
        yield "error of the estimated position, RMSE", *number("estimate_ey_rmse_m", "mm", 2, 1e3)
    if result["left_road_s"] or log.scenario.path.has_widths:
        yield "time off the road", *number("left_road_s", "s", 2)
    yield "distance driven", *number("distance_m", "m", 1)
    yield "duration", *number("duration_s", "s", 2)
    yield "duration of the reference", *number("reference_duration_s", "s", 2)
    laps = result["lap_times_s"]
    if len(laps) > 1:
        yield "lap times", ", ".join(f"{lap:.2f}" for lap in laps[:5]) + " s" + (
            f" ... {laps[-1]:.2f} s" if len(laps) > 5 else ""
        ), ""
    qp, step = result["qp"], result["step_time_us"]
    if qp["solved"] + qp["fallback"]:
        solve = log.timing["solve_us"]
        yield "QPs solved / fallbacks", f"{qp['solved']} / {qp['fallback']}", ""
        paper = f"{published.SOLVE_MEAN_MS:.1f} ms"
        yield "QP solve time, mean", f"{solve.mean() / 1e3:.3f} ms", paper
    if log.meta["clamped_inputs"] is not None:
        yield "network inputs outside the trained range", f"{log.meta['clamped_inputs']}", ""
    if step["p50"] is not None:
        yield "control step, median", f"{step['p50'] / 1e3:.3f} ms", ""
        yield "control step, 99th percentile", f"{step['p99'] / 1e3:.3f} ms", ""
    yield "speed of the simulation", f"{result['realtime_factor']:.0f} x real time", ""
