"""How fast the plant, the controller, a lap, a frame and the start are.

Every measurement is repeated in rounds. A time is the best round's, because on a shared machine
the others' work only ever adds to it; a ratio of two times taken in the same round is the median
round's, because noise moves it either way.
"""

from __future__ import annotations

import copy
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.stiffness.models import ConstantStiffness, NetworkStiffness, StiffnessModel
from lpvmpc.errors import LPVMPCError
from lpvmpc.interface import Command
from lpvmpc.plant import callbacks
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import SPIN_QVEL, STEER
from lpvmpc.road.scenario import Scenario
from lpvmpc.sim.log import Log
from lpvmpc.sim.loop import simulate


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One quantity, measured in several rounds."""

    key: str
    """Its name in JSON and CSV, with the unit."""
    text: str
    """What it is."""
    unit: str
    """Unit of the value."""
    rounds: tuple[float, ...]
    """Value of each round."""
    pick: Literal["least", "most", "middle"] = "least"
    """Which round counts: least for times, most for speeds, middle for ratios."""
    limit: float | None = None
    """Bar: the value must be at most this, or at least where `pick` is most; None: no bar."""

    def __post_init__(self) -> None:
        """Keep plain numbers, which JSON takes."""
        object.__setattr__(self, "rounds", tuple(float(value) for value in self.rounds))

    @property
    def value(self) -> float:
        """The value that counts."""
        if self.pick == "middle":
            return statistics.median(self.rounds)
        return min(self.rounds) if self.pick == "least" else max(self.rounds)

    @property
    def ok(self) -> bool | None:
        """Whether the bar is met; None without one."""
        if self.limit is None:
            return None
        return self.value >= self.limit if self.pick == "most" else self.value <= self.limit


# --- plant ---


def measure_plant(rounds: int = 5, blocks: int = 40, periods: int = 10) -> list[Figure]:
    """Physics step with tires against the bare mj_step of the same model, and Plant.step.

    The bare car floats at its usual height, rolling at 15 m/s, with no gravity and its springs
    unloaded: without the callbacks the tires carry nothing, and on its stops the constraint solver
    would make the bare step the slower one. Both compute every joint, spring and collision pair.
    Bare, tires and Plant.step take turns in short blocks, so that all meet the same machine.

    Args:
        rounds: Number of rounds.
        blocks: Blocks per round; the fastest counts.
        periods: Control periods of 33 steps per block.
    """
    plant = Plant()
    plant.reset(vx=15.0, kappa=0.01)
    start, steer = plant.save(), float(plant.data.ctrl[STEER])
    steps = periods * plant.nstep
    bare = copy.copy(plant.model)
    bare.opt.gravity[:] = 0.0
    bare.qpos_spring[:] = bare.qpos0
    floating = mujoco.MjData(bare)

    def time_bare() -> float:
        mujoco.mj_resetData(bare, floating)
        floating.qpos[2] = plant.data.qpos[2]
        floating.qvel[0] = 15.0
        floating.qvel[list(SPIN_QVEL)] = 15.0 / plant.params.R_w
        callbacks.uninstall()
        try:
            spent = thread_us(lambda: repeat(mujoco.mj_step, periods, bare, floating, plant.nstep))
        finally:
            callbacks.install()
        return spent / steps

    def time_tires() -> float:
        plant.restore(start)
        plant.data.ctrl[STEER] = steer + 0.02
        model, data = plant.model, plant.data
        return thread_us(lambda: repeat(mujoco.mj_step, periods, model, data, plant.nstep)) / steps

    def time_plant() -> float:
        plant.restore(start)
        command = Command(steer + 0.02, float(plant.data.ctrl[STEER + 1]))
        return thread_us(lambda: repeat(plant.step, periods, command)) / periods

    best = np.empty((rounds, 3))
    for i in range(rounds):
        times = np.array([[time_bare(), time_tires(), time_plant()] for _ in range(blocks)])
        best[i] = times.min(axis=0)
        for data in (floating, plant.data):
            if data.ncon or data.nefc:
                raise LPVMPCError("The car touches something while its steps are timed.")
    bare_us, tires_us, period_us = best.T
    factor = 1e6 * plant.Ts / period_us
    return [
        Figure(key="bare_step_us", text="bare mj_step", unit="us", rounds=tuple(bare_us)),
        Figure(key="tire_step_us", text="mj_step with tires", unit="us", rounds=tuple(tires_us)),
        Figure(key="plant_step_ratio", text="step with tires / bare step", unit="",
               rounds=tuple(tires_us / bare_us), pick="middle", limit=1.5),
        Figure(key="plant_period_us", text="Plant.step: 33 steps and the state", unit="us",
               rounds=tuple(period_us)),
        Figure(key="plant_realtime_factor", text="the same, against real time", unit="x",
               rounds=tuple(factor), pick="most", limit=80.0),
    ]


def repeat(call: Callable[..., object], times: int, *arguments: object) -> None:
    """Call something several times."""
    for _ in range(times):
        call(*arguments)


def thread_us(call: Callable[[], object]) -> float:
    """CPU time of this thread that a call takes [us]."""
    before = time.thread_time_ns()
    call()
    return (time.thread_time_ns() - before) * 1e-3


# --- controller and lap ---


def measure_loops(
    roads: Sequence[tuple[str, Scenario]], rounds: int = 5
) -> tuple[list[list[Figure]], Log]:
    """Control step, whole and in parts, and the whole simulation of some roads.

    The roads take turns, so that a busy minute of the machine does not hit one of them alone. Every
    round drives a road to the same commands, so step k does the same work in each; the figures
    `quiet` take the fastest round of every single step.

    Args:
        roads: Prefix of the keys, and what is driven with the LPV-MPC.
        rounds: Number of rounds, after one that warms up.

    Returns:
        The figures of each road, and the log of a run.
    """
    plant = Plant()
    controller = LPVMPC(plant.params)
    runs: list[list[tuple[Log, float]]] = [[] for _ in roads]
    for i in range(rounds + 1):
        for (_, scenario), kept in zip(roads, runs, strict=True):
            before = time.thread_time()
            log = simulate(plant, controller, scenario)
            spent = time.thread_time() - before
            if not log.meta["completed"]:
                raise LPVMPCError(f"{scenario.name} was not completed: {log.meta['reason']}.")
            if i:
                kept.append((log, spent))
    return [loop_figures(label, kept) for (label, _), kept in zip(roads, runs, strict=True)], log


def loop_figures(label: str, runs: Sequence[tuple[Log, float]]) -> list[Figure]:
    """Figures of several runs of one road, each with the CPU time of the whole simulation [s]."""
    steps, lap, cpu = [], [], []
    for log, spent in runs:
        part = log.timing["build_us"], log.timing["solve_us"], log.timing["check_us"]
        steps.append(np.column_stack([log.timing["step_us"], sum(part), *part]))
        lap.append(log.meta["duration_s"] / log.meta["wall_s"])
        cpu.append(log.meta["duration_s"] / spent)
    times = np.array(steps)  # (rounds, steps, quantities)
    p50, p99 = np.percentile(times, (50.0, 99.0), axis=1)  # (rounds, quantities)
    quiet = np.percentile(times.min(axis=0), (50.0, 99.0), axis=0)  # (2, quantities)
    road = runs[0][0].meta["scenario"]
    names = ("control_step", "build_solve_check", "build", "solve", "check")
    texts = ("control step", "build + solve + check", "build", "solve", "check")
    limits = ((250.0, 800.0), (120.0, 600.0), (None, None), (None, None), (None, None))
    figures = []
    for j, (name, text) in enumerate(zip(names, texts, strict=True)):
        for values, percent, limit in zip((p50, p99), ("p50", "p99"), limits[j], strict=True):
            figures.append(Figure(key=f"{label}{name}_{percent}_us", text=f"{text}, {percent}",
                                  unit="us", rounds=tuple(values[:, j]), limit=limit))
    for j in range(2):
        for value, percent in zip(quiet[:, j], ("p50", "p99"), strict=True):
            figures.append(Figure(
                key=f"{label}{names[j]}_quiet_{percent}_us", unit="us", rounds=(value,),
                text=f"{texts[j]}, {percent}, fastest at each instant",
            ))
    figures += [
        Figure(key=f"{label}lap_realtime_factor", text=f"{road} without video, against real time",
               unit="x", rounds=tuple(lap), pick="most", limit=40.0),
        Figure(key=f"{label}lap_cpu_realtime_factor", text="the same by CPU time", unit="x",
               rounds=tuple(cpu), pick="most"),
    ]
    return figures


def measure_adaptation(scenario: Scenario, rounds: int = 5) -> list[Figure]:
    """What adapting the stiffness costs: the network against constant stiffness, taking turns.

    Args:
        scenario: What is driven.
        rounds: Number of rounds, after one that warms up.
    """
    plant = Plant()
    car = plant.params
    models: list[StiffnessModel] = [ConstantStiffness(car), NetworkStiffness(car)]
    controllers = [LPVMPC(car, stiffness=model) for model in models]
    times = np.empty((rounds + 1, 2))
    for i in range(rounds + 1):
        for j, controller in enumerate(controllers):
            spent = simulate(plant, controller, scenario).timing
            parts = spent["build_us"] + spent["solve_us"] + spent["check_us"]
            times[i, j] = np.median(parts)
    constant, network = times[1:].T
    text = "build + solve + check, p50"
    return [
        Figure(key="constant_build_solve_check_p50_us", text=f"{text}, constant stiffness",
               unit="us", rounds=tuple(constant)),
        Figure(key="network_build_solve_check_p50_us", text=f"{text}, network", unit="us",
               rounds=tuple(network)),
        Figure(key="adaptation_ratio", text="network / constant", unit="",
               rounds=tuple(network / constant), pick="middle"),
    ]


# --- video ---


def measure_frame(log: Log, rounds: int = 5, frames: int = 25) -> list[Figure]:
    """Wall time of a frame of video, drawn and encoded, at two sizes.

    Args:
        log: A run to film, of which the first second is used.
        rounds: Number of rounds.
        frames: Frames per round; the first five are not counted, the median is.

    Raises:
        RenderError: No OpenGL here.
    """
    from lpvmpc.picture.video.render import render_video

    rows = math.ceil(frames / 30.0 / log.meta["Ts"]) + 1
    short = replace(
        log,
        columns={name: column[:rows] for name, column in log.columns.items()},
        timing={name: column[:rows] for name, column in log.timing.items()},
    )
    figures = []
    for width, height in ((1280, 720), (320, 180)):
        medians = []
        for _ in range(rounds):
            clock = FrameClock()
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "frame.mp4"
                render_video(short, file, width=width, height=height, progress=clock)
            medians.append(1e3 * float(np.median(np.diff(clock.at)[5:])))
        figures.append(Figure(key=f"frame_{height}p_ms", unit="ms", rounds=tuple(medians),
                              text=f"a frame of video, {width} x {height}"))
    return figures


class FrameClock:
    """Notes when each frame was finished."""

    def __init__(self) -> None:
        """No frame yet."""
        self.at: list[float] = []

    def __call__(self, _fraction: float) -> None:
        """A frame is finished."""
        self.at.append(time.perf_counter())
