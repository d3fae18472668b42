"""Closed loops on roads that nobody has tuned for, in all worlds: what was driven, and what failed.

Run i drives road `random-i`, from 1,000 on the short `hairpin-i`, in one of the five worlds, at 40
to 80 % of the grip that road and tires have in this run, under a latency of up to 40 ms that nobody
is told, from up to 1 m beside the line. The plan knows the friction that the world draws, for a
plan that asks for more than there is can be driven by nobody; what it costs not to know it is in
docs/results/worlds.md.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lpvmpc.reliability.causes import causes
from lpvmpc.sim.batch import Run
from lpvmpc.sim.world import WORLDS, children, load_world

CONTROLLER = "lpv-mpc"
GRIP = (0.4, 0.8)
"""Range of the plan's share of the grip that there is."""
LATENCY = 40
"""Longest latency of the commands [ms]."""
BESIDE = 1.0
"""Furthest start beside the line [m]."""
WHOLE = 1000
"""Runs on whole roads; all later ones are on short ones, of a hairpin and little else."""
PERIOD_US = 33_000.0
"""The control period [us]."""


def random_run(number: int, controller: str = CONTROLLER) -> Run:
    """A run by its number, which is its seed as well."""
    rng = np.random.default_rng([number, 0x10095])
    world = list(WORLDS)[number % len(WORLDS)]
    grip = float(rng.uniform(*GRIP)) * held(world, number)
    latency = int(rng.integers(LATENCY + 1)) / 1000.0
    beside = float(rng.uniform(-BESIDE, BESIDE))
    return Run(
        label=f"{number}",
        scenario=f"{'random' if number < WHOLE else 'hairpin'}-{number}",
        scenario_options={"grip": round(grip, 4)},
        controller=controller,
        world=world,
        latency=latency,
        start_offset=(round(beside, 4), 0.0),
        seed=number,
    )


def held(world: str, seed: int) -> float:
    """Share of the nominal grip that road and tires have in a run; the weaker axle counts."""
    draw = load_world(world).sample(next(children(seed)))
    car = draw.deviations
    return min(draw.surface.friction * min(car.mu_f, car.mu_r), 1.0)


@dataclass(frozen=True, kw_only=True)
class Driven:
    """What many runs came to."""

    runs: int
    """Number of runs."""
    completed: int
    """Of these completed."""
    exceptions: int
    """Runs that raised."""
    not_finite: int
    """Runs with a result that is no number."""
    late: int
    """Runs with a step of the controller longer than the period."""
    slowest_step_us: float
    """The longest step of all [us]."""
    longest_wall_s: float
    """The run that took longest [s]."""
    fallbacks: int
    """Control instants at which the QP was refused."""
    left_road: int
    """Completed runs that were off the road for a while."""
    rmse_mm: tuple[float, float]
    """Median and 95th percentile of the lateral RMSE of the completed ones [mm]."""
    by_world: dict[str, tuple[int, int, int, int]]
    """By world, of whole roads and of short ones: all runs, and the completed ones."""
    seconds: tuple[float, float]
    """How long a run drives, by the car's clock: the median, and all together [s]."""
    lost: tuple[tuple[Run, str], ...]
    """The runs that did not complete, and why."""

    @property
    def causes(self) -> Counter[str]:
        """How often what ended a run."""
        return Counter(reason.partition(":")[0] for _, reason in self.lost)


def driven(
    count: int, drive: Callable[[Sequence[Run]], list[dict[str, Any]]]
) -> Driven:
    """Drive so many random runs; find out why some did not complete.

    Args:
        count: Number of runs.
        drive: Drives runs; the results in their order.
    """
    runs = [random_run(number) for number in range(count)]
    found = summed(runs, drive(runs))
    whys = causes([run for run, _ in found.lost], drive)
    told = tuple((run, f"{reason}; {why}")
                 for (run, reason), why in zip(found.lost, whys, strict=True))
    return replace(found, lost=told)


def summed(runs: Sequence[Run], results: Sequence[dict[str, Any]]) -> Driven:
    """What the results of `drive_all` come to."""
    pairs = list(zip(runs, results, strict=True))
    raised = [r for _, r in pairs if r["s_end_m"] is None]
    done = [r for _, r in pairs if r["completed"]]
    steps = [r["step_time_us"]["max"] for _, r in pairs if r["step_time_us"]]
    errors = [1e3 * r["lateral_rmse_m"] for r in done]
    times = [r["duration_s"] for _, r in pairs if r["duration_s"]]
    worlds: dict[str, list[tuple[bool, bool]]] = {name: [] for name in WORLDS}
    for run, r in pairs:
        worlds[str(run.world)].append((run.seed >= WHOLE, bool(r["completed"])))
    return Driven(
        runs=len(pairs),
        completed=len(done),
        exceptions=len(raised),
        not_finite=sum(not _finite(r) for _, r in pairs),
        late=sum(step > PERIOD_US for step in steps),
        slowest_step_us=max(steps, default=math.nan),
        longest_wall_s=max((r["wall_s"] for _, r in pairs if r["wall_s"]), default=math.nan),
        fallbacks=sum(r["qp"]["fallback"] for _, r in pairs if r["qp"]),
        left_road=sum(r["left_road_s"] > 0.0 for r in done),
        rmse_mm=(float(np.median(errors)), float(np.percentile(errors, 95))) if errors else
        (math.nan, math.nan),
        by_world={
            name: (sum(not short for short, _ in all_), all_.count((False, True)),
                   sum(short for short, _ in all_), all_.count((True, True)))
            for name, all_ in worlds.items() if all_
        },
        seconds=(float(np.median(times)) if times else math.nan, float(sum(times))),
        lost=tuple((run, _why(r)) for run, r in pairs if not r["completed"]),
    )


def _why(result: dict[str, Any]) -> str:
    """What ended a run, and where."""
    if result["s_end_m"] is None:
        return f"raised: {result['reason']}"
    asked = result["lateral_acc_max_mps2"]
    return (f"{result['reason']}, at {result['s_end_m']:.0f} m, largest lateral acceleration "
            f"{asked:.2f} m/s2")


def _finite(value: Any) -> bool:
    """Whether all numbers of a result are finite."""
    if isinstance(value, dict):
        return all(map(_finite, value.values()))
    if isinstance(value, list | tuple):
        return all(map(_finite, value))
    return not isinstance(value, float) or math.isfinite(value)
