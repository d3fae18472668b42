"""Why a random run did not complete: it is driven again, each time with one hardship less.

Seed, road and all other draws stay the same, so that what lets the run complete is what it needed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from lpvmpc.sim.batch import Run
from lpvmpc.sim.world import children, load_world

LESS_GRIP = 0.9
"""Factor on the grip that the plan asks for, where that is the hardship."""
EXACT = {"production": "ideal", "rtk": "ideal"}
"""Worlds of which nothing is left without their sensors' errors."""
NOMINAL = {"fleet": "rtk", "fleet-production": "production"}
"""Worlds by what is left of them with the car and the road that the controller knows."""


def eased(run: Run) -> dict[str, Run]:
    """The same run with one hardship less each, by what was taken away."""
    world = str(run.world)
    found = {"without the latency": replace(run, latency=0.0)}
    if run.start_offset[0]:
        found["started on the line"] = replace(run, start_offset=(0.0, 0.0))
    if world != "ideal":
        exact = EXACT.get(world) or {"base": world, "name": f"{world}-exact", "sensing": "exact"}
        found["with exact sensors"] = replace(run, world=exact)
    if world in NOMINAL:
        # its friction is the world's, or the plan would ask for another share of it
        friction = load_world(world).sample(next(children(run.seed))).surface.friction
        nominal = {"base": NOMINAL[world], "name": f"{world}-nominal",
                   "road": {"friction": friction}}
        found["with the nominal car on a level road"] = replace(run, world=nominal)
    grip = round(LESS_GRIP * run.scenario_options["grip"], 4)
    found["with a tenth less grip asked for"] = replace(
        run, scenario_options={**run.scenario_options, "grip": grip})
    return found


def causes(
    lost: Sequence[Run], drive: Callable[[Sequence[Run]], list[dict[str, Any]]]
) -> list[str]:
    """For each lost run a phrase on what lets it complete, and what does not.

    Args:
        lost: Runs that did not complete.
        drive: Drives runs; the results in their order.
    """
    trials = [(i, what, one) for i, run in enumerate(lost) for what, one in eased(run).items()]
    results = drive([one for _, _, one in trials]) if trials else []
    phrases = []
    for i in range(len(lost)):
        own = [(what, bool(result["completed"]))
               for (k, what, _), result in zip(trials, results, strict=True) if k == i]
        helps = [what for what, done in own if done]
        not_so = [what for what, done in own if not done]
        text = f"completes {', '.join(helps)}" if helps else "one hardship less does not help"
        phrases.append(text + (f"; not {', '.join(not_so)}" if helps and not_so else ""))
    return phrases
