"""How long a whole search of weights takes."""

from __future__ import annotations

import time

from lpvmpc.bench.speed import Figure

LIMIT = 360.0
"""Bar of a search [s]."""


def measure_search(jobs: int, generations: int = 15, population: int = 20) -> list[Figure]:
    """Wall time of the genetic search of the LPV-MPC's weights, on both tuning roads.

    Args:
        jobs: Number of processes.
        generations: Generations after the first population.
        population: Individuals.
    """
    from lpvmpc.kit.workers import workers
    from lpvmpc.tune import tuning

    task = tuning.Task(worlds=("ideal",), generations=generations, population=population)
    begin = time.perf_counter()
    with workers(jobs) as pool:
        tuned = tuning.tune(task, map=pool.map)
    wall = time.perf_counter() - begin
    what = f"{generations} generations of {population}, {len(task.scenarios)} roads, {jobs} jobs"
    return [
        Figure(key="search_s", text=what, unit="s", rounds=(wall,), limit=LIMIT),
        Figure(key="search_evaluations", text="weight sets driven", unit="",
               rounds=(float(tuned.evaluations),)),
    ]
