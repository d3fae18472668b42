"""How many laps a minute many closed loops do: in processes, and side by side in one process."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from lpvmpc.bench.speed import Figure
from lpvmpc.bench.together import drive_together
from lpvmpc.errors import LPVMPCError
from lpvmpc.sim.batch import Run, drive_all
from lpvmpc.sim.log import Log
from lpvmpc.sim.metrics import details, metrics

CARS = (1, 4, 16, 64, 256)
"""Cars side by side whose laps are counted."""
LAPS = 32
"""Laps of a measurement on one core and on two."""
STRAIGHT, RADIUS = 30.0, 15.0
"""The road: an oval of two such straights [m] and two half circles [m]."""


def measure_together(
    period_us: float, rounds: int = 3, cars: Sequence[int] = CARS, laps: int = LAPS
) -> list[Figure]:
    """Laps of the LPV-MPC on an oval, by processes and side by side, on one core and on two.

    Both ways give the same results, measures included. In every round the ways take turns; the
    growth with the number of cars is measured once.

    Args:
        period_us: CPU time of the physics of one period [us].
        rounds: Number of rounds.
        cars: Numbers of cars side by side; as many laps are driven, at least four.
        laps: Laps on one core and on two; as many cars side by side.
    """
    with tempfile.TemporaryDirectory() as folder:
        road = Path(folder) / "oval.csv"
        road.write_text(oval())

        def side_by_side(n: int, at_once: int, threads: int) -> None:
            for _, log in drive_together(runs(road, n), cars=at_once, threads=threads):
                if not isinstance(log, Log):
                    raise LPVMPCError(f"A lap has failed: {log}.")
                check({**metrics(log), **details(log)})

        def processes(n: int, jobs: int) -> None:
            for result in drive_all(runs(road, n), jobs=jobs):
                check(result)

        processes(2, 2)  # compiles, and starts the processes, which then wait for the next call
        side_by_side(2, 2, 2)
        rows, physics = [], []
        for _ in range(rounds):
            one, cpu = spent(lambda: processes(laps, 1))
            two, _ = spent(lambda: processes(laps, 2))
            thread, _ = spent(lambda: side_by_side(laps, laps, 1))
            threads, _ = spent(lambda: side_by_side(laps, laps, 2))
            rows.append((one, two, thread, threads))
            physics.append(period_us * 1e-6 * laps * periods(road) / cpu)
        growth = []
        for n in cars:
            _, cpu = spent(partial(side_by_side, max(n, 4), n, 1))
            growth.append(60.0 * max(n, 4) / cpu)
    one, two, thread, threads = np.array(rows).T
    rate = 60.0 * laps
    share = np.array(physics)
    return [
        Figure(key="laps_1_process", text="one process", unit="laps/min", pick="most",
               rounds=tuple(rate / one)),
        Figure(key="laps_2_processes", text="two processes", unit="laps/min", pick="most",
               rounds=tuple(rate / two)),
        Figure(key="laps_2_processes_per_core", text="two processes, per core",
               unit="laps/min", pick="most", rounds=tuple(0.5 * rate / two)),
        Figure(key="laps_1_thread", text=f"{laps} cars side by side, one thread", unit="laps/min",
               pick="most", rounds=tuple(rate / thread)),
        Figure(key="laps_2_threads", text=f"{laps} cars side by side, two threads",
               unit="laps/min", pick="most", rounds=tuple(rate / threads)),
        Figure(key="laps_2_threads_per_core",
               text=f"{laps} cars side by side, two threads, per core",
               unit="laps/min", pick="most", rounds=tuple(0.5 * rate / threads)),
        Figure(key="processes_scaling", text="gain of the second process", unit="x",
               pick="middle", rounds=tuple(one / two)),
        Figure(key="side_by_side_scaling", text="gain of the second thread", unit="x",
               pick="middle", rounds=tuple(thread / threads)),
        Figure(key="physics_share", text="share of the physics in a lap", unit="",
               pick="middle", rounds=tuple(share)),
        Figure(key="side_by_side_bound", unit="x", pick="middle",
               text="gain of a second thread in the physics alone, at best",
               rounds=tuple(1.0 / (1.0 - 0.5 * share))),
        Figure(key="overlap_bound", unit="x", pick="middle",
               text="the same while other cars' controllers are asked, at best",
               rounds=tuple(1.0 / np.maximum(0.5, 1.0 - share))),
        Figure(key="side_by_side_ratio", text="two threads side by side / two processes", unit="x",
               pick="middle", rounds=tuple(two / threads)),
        *(Figure(key=f"laps_{n}_cars_per_cpu_min", unit="laps/min of CPU", pick="most",
                 text=f"{n} car{'s' * (n > 1)} side by side, one thread", rounds=(value,))
          for n, value in zip(cars, growth, strict=True)),
        Figure(key="growth", text=f"{cars[-1]} cars / {cars[0]}, laps per CPU time",
               unit="x", pick="most", rounds=(growth[-1] / growth[0],)),
    ]


def oval() -> str:
    """The road as a CSV file."""
    bend = np.linspace(0.0, math.pi, 17)[:-1]
    line = np.arange(0.0, STRAIGHT, 3.0)
    x = np.concatenate([line, STRAIGHT + RADIUS * np.sin(bend), STRAIGHT - line,
                        -RADIUS * np.sin(bend)])
    y = np.concatenate([0.0 * line, RADIUS * (1.0 - np.cos(bend)), 2.0 * RADIUS + 0.0 * line,
                        RADIUS * (1.0 + np.cos(bend))])
    rows = [f"{a:.4f},{b:.4f},4,4" for a, b in zip(x, y, strict=True)]
    return "\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *rows]) + "\n"


def runs(road: Path, n: int) -> list[Run]:
    """Laps that differ in their seeds, so that none is driven for another."""
    return [Run(scenario=str(road), scenario_options={"closed": True}, seed=i) for i in range(n)]


def periods(road: Path) -> int:
    """Control periods of a lap."""
    (result,) = drive_all(runs(road, 1))
    return round(result["duration_s"] / 0.033)


def check(result: dict[str, object]) -> None:
    """Refuse to time laps that were not driven to their end.

    Raises:
        LPVMPCError: One was not.
    """
    if not result["completed"]:
        raise LPVMPCError(f"A lap was not completed: {result['reason']}.")


def spent(call: Callable[[], None]) -> tuple[float, float]:
    """Wall time and CPU time of this process that a call takes [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - wall, time.process_time() - cpu
