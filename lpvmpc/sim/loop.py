"""The closed loop: plant, controller and scenario, one control period after the other.

At every control instant the true state of the car is projected on the path and previewed, the
controller commands, and all of it is recorded (`running`); then the plant moves on by one period
under the wind and the friction of the place where it is. The controller is told neither. In a world
with sensors (`world`) it is given their estimate and the road from there; what is scored stays the
truth.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from inspect import GEN_CLOSED, getgeneratorstate
from typing import TYPE_CHECKING, Any

from lpvmpc.errors import LPVMPCError
from lpvmpc.interface import Controller, State
from lpvmpc.plant.deviations import Deviations
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.guard import Alarm
from lpvmpc.sim.log import Log
from lpvmpc.sim.process.isolated import Isolated
from lpvmpc.sim.running import Progress, Running, running
from lpvmpc.sim.world import World

if TYPE_CHECKING:
    from lpvmpc.road.scenario import Scenario
    from lpvmpc.traffic.users import Traffic


def simulate(
    plant: Plant,
    controller: Controller | Isolated,
    scenario: Scenario,
    *,
    seed: int = 0,
    laps: int = 1,
    start_offset: tuple[float, float] = (0.0, 0.0),
    world: str | os.PathLike[str] | Mapping[str, Any] | World = "ideal",
    estimator: str | None = None,
    delay: int = 0,
    latency: float | None = None,
    deviations: Deviations | None = None,
    step_timeout: float | None = None,
    progress: Progress | None = None,
    name: str | None = None,
    options: dict[str, Any] | None = None,
    traffic: Traffic | None = None,
) -> Log:
    """Drive a scenario from its start to its end, or until the car is lost.

    The car starts trimmed on the reference: at its speed, curvature and wind, everything settled.
    A closed track is driven for whole laps. Ctrl-C ends the run early; the Log then holds what
    was recorded until then, with `meta["reason"] == "interrupted"`. A controller or an estimator
    that fails after the first instant ends the run as a lost car does: its sentence is the reason.

    Args:
        plant: The car; reset here, its friction set from the scenario.
        controller: Anything with `reset(rng)` and `command(state, preview)`, see `interface`; or an
            `Isolated`, which names one that is to live in a process of its own.
        scenario: Path, speed, wind and friction.
        seed: Seed of everything random: the generator given to the controller, and apart from it
            the world and its sensors.
        laps: Number of laps, 1 to `MAX_LAPS`; more than one on closed tracks only.
        start_offset: Where the car starts beside the reference: ey [m], left positive, and its
            course against the path's, epsi [rad].
        world: What reality does that nobody is told: a name of `WORLDS`, a TOML file, a `World`;
            see `world.load_world`.
        estimator: What makes a state of what is measured: a name of `ESTIMATORS` or `module:Class`
            (default: "ekf", and "none" where the sensors are exact).
        delay: Number of control periods after which a command reaches the car, 0 to `MAX_DELAY`;
            until then it holds the trimmed command.
        latency: Time that passes besides, in physics steps, before a command reaches the car [s],
            0 to 0.2 (default: the world's). Neither is told to the controller here.
        deviations: How the car differs from the one that the controller knows (default: the
            world's, and in a world that leaves the car alone the plant's own).
        step_timeout: Longest wall-clock time of one call of the controller, and of one of the
            estimator [s]; None: no limit.
        progress: Called at every control instant with the driven fraction of the path.
        name: Name of the controller in results (default: its attribute `name`, else its class).
        options: Further options to record in the trace.
        traffic: Other road users, of whom the controller is told nothing; a contact ends the run.

    Returns:
        The Log; `meta` says whether the run completed, and why not.

    Raises:
        OptionError: An option outside its domain, or a controller of another control period.
        UnknownNameError, DataError: No such world or estimator.
        EstimatorError: The estimator raised, hung, or has no state, at the first instant.
        ControllerError: The controller raised, hung, or returned something that is no command, at
            the first instant.
    """
    with Alarm().installed() as alarm:
        return _driven(plant, running(
            plant, controller, scenario, alarm, seed=seed, laps=laps, start_offset=start_offset,
            world=world, estimator=estimator, delay=delay, latency=latency, deviations=deviations,
            step_timeout=step_timeout, progress=progress, name=name, options=options,
            traffic=traffic,
        ))


def _driven(plant: Plant, run: Running) -> Log:
    """Move the plant as the run says, to its end."""
    state: State | None = None  # what begins a generator
    error: BaseException | None = None
    while True:
        try:
            push = run.throw(error) if error is not None else run.send(state)  # type: ignore[arg-type]
            error = None
            state = plant.step(push.command, wind=push.wind)
        except StopIteration as end:
            log: Log = end.value
            return log
        except (LPVMPCError, KeyboardInterrupt) as raised:
            if getgeneratorstate(run) == GEN_CLOSED:  # the run itself raised, and is over
                raise
            error = raised
