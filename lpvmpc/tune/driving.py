"""What a weight set costs: closed loops in drawn worlds, and the risk over them.

One run that arrives costs c / (1 + c / `LOST`) with

    c = ( RMSE(ey) + `COURSE` RMSE(course) + `SPEED` RMSE(vx - vx_ref)
          + `STEERING` rms(d delta) / Ts + `NERVOUS` rms(d2 delta) / Ts ) / scale of the world

The first three are the paper's sum, in metres, but for the course epsi + atan2(vy, vx) in place of
the heading: in a side wind the car must crab, and that angle, which is physics, would be most of
the cost. d delta and d2 delta are the first and second difference of the commanded steering angle:
noise is not to be answered by steering, nor by a command that alternates. Speed counts little, so
that no speed error is worth an error beside the line.

`SCALES` are the errors of a good run in each world. Without them a weight set would be judged in
the worlds with noise alone: a third of a millimetre more is much in the ideal world and nothing in
the others. The saturation at `LOST` keeps one bad run from outweighing the rest. A run that is lost
costs `LOST` (1 + share of the road not driven), more than any that arrives and at most twice
`LOST`; so a search that loses every car still has a slope.

A weight set costs the mean of its worst fifth of runs (the conditional value at risk at 20 %; at
least one run, and of 8 or 10 runs two) plus `PLAIN` times the mean of all. The worst fifth alone
would not notice the other runs. All weight sets of a search meet the same draws (common random
numbers), so their difference is the weights'.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from lpvmpc.sim import batch
from lpvmpc.sim.log import Log
from lpvmpc.sim.metrics import metrics, rms
from lpvmpc.units import Array

SCALES = {"ideal": 0.001, "rtk": 0.005, "fleet": 0.008, "production": 0.05,
          "fleet-production": 0.05}
"""Lateral error of a good run by world [m]: in the ideal one what the controllers on a QP reach, in
`rtk` half the noise of its position, in `fleet` that and a car that is another; lane cameras leave
ten times as much as `rtk`. They decide what a millimetre in one world is worth in another."""
OTHER_SCALE = SCALES["fleet"]
"""Scale of a world that is not named there [m]."""
COURSE = 1.0
"""Price of the course error [m/rad], as in the paper's sum."""
SPEED = 0.01
"""Price of the speed error [s]: 100 mm/s cost as much as 1 mm beside the line."""
STEERING = 0.01
"""Price of the steering rate [m s/rad]: 0.1 rad/s more cost as much as 1 mm."""
NERVOUS = 0.01
"""Price of a nervous command [m s/rad]: a steering angle that alternates by +-1 mrad from period to
period costs as much as 1.2 mm."""
LOST = 50.0
"""Price of losing the car at the end of the road."""
WORST = 0.2
"""Share of the runs that the risk looks at."""
PLAIN = 0.25
"""Weight of the plain mean beside the mean of the worst."""
RISK = f"mean of the worst {WORST:.0%} of runs + {PLAIN:g} mean of all"
"""The risk in words, for records."""
DIGITS = 9
"""Decimals of a cost. Beyond them lies what differs between processors."""


class Space(Protocol):
    """What makes weights of a point of the search."""

    def weights(self, coordinates: Array) -> dict[str, float]:
        """The weights at some coordinates, shape (n,)."""


@dataclass(frozen=True)
class DrivingCost:
    """Cost of a point of the search; picklable, so that workers can be sent it."""

    controller: str
    """Name of the controller."""
    runs: tuple[batch.Run, ...]
    """What is driven, with the weights that are not searched."""
    space: Space
    """What the point means."""
    limit: float = math.inf
    """Where the cost is certain to exceed this, the remaining runs are not driven."""

    def up_to(self, limit: float) -> DrivingCost:
        """The same cost below the limit; above it any number that is above it too."""
        return replace(self, limit=limit)

    def __call__(self, coordinates: Array) -> float:
        """Drive, the last run first, and sum up.

        Raises:
            LPVMPCError: The controller failed.
            KeyboardInterrupt: Ctrl-C.
        """
        costs: list[float] = []
        for run in reversed(self.runs):
            weights = {**run.controller_options["weights"], **self.space.weights(coordinates)}
            log = batch.drive(with_weights(run, weights))
            if log.meta["reason"] == "interrupted":
                raise KeyboardInterrupt
            costs.append(cost(log, scale(run)))
            so_far = risk(costs, len(self.runs))
            if so_far > self.limit:
                return so_far
        return so_far


def risk(costs: Sequence[float], n: int | None = None) -> float:
    """Mean of the worst fifth of the costs, plus `PLAIN` times the mean of all.

    Args:
        costs: One per run, none negative.
        n: Number of runs, where some are still to come: these count as free, so what is returned
            is never above the risk of all (default: all are there).
    """
    n = n or len(costs)
    worst = max(1, math.ceil(WORST * n - 1e-9))  # 0.2 x 10 is a little above 2
    highest = sorted(costs, reverse=True)[:worst]
    # fsum rounds once, so that one more cost never makes the sum smaller
    return round(math.fsum(highest) / worst + PLAIN * math.fsum(costs) / n, DIGITS)


def cost(log: Log, scale: float) -> float:
    """Cost of one run, as at the head of this file; `scale` is the world's [m]."""
    result = metrics(log)
    if not result["completed"]:
        driven = min(result["s_end_m"] / log.scenario.path.length, 1.0)
        return float(LOST * (2.0 - driven))
    change = np.diff(log.columns["delta_cmd_rad"], 2)
    c = (
        result["lateral_rmse_m"]
        + COURSE * result["course_rmse_rad"]
        + SPEED * result["speed_rmse_mps"]
        + STEERING * (result["steer_rate_rms_radps"] or 0.0)
        + NERVOUS * (rms(change) or 0.0) / log.meta["Ts"]
    ) / scale
    return float(c / (1.0 + c / LOST))


def prices() -> dict[str, Any]:
    """All numbers that decide a cost, for records: a tuning under other ones is another."""
    return {
        "scales_m": {**SCALES, "others": OTHER_SCALE}, "course": COURSE, "speed": SPEED,
        "steering": STEERING, "nervous": NERVOUS, "lost": LOST, "worst": WORST, "plain": PLAIN,
    }


def scale(run: batch.Run) -> float:
    """Lateral error of a good run in the world of this one [m]."""
    return SCALES.get(run.world, OTHER_SCALE) if isinstance(run.world, str) else OTHER_SCALE


def with_weights(run: batch.Run, weights: Mapping[str, float]) -> batch.Run:
    """A run with other weights."""
    options = {**run.controller_options, "weights": dict(weights)}
    return replace(run, controller_options=options)
