"""The closed loop: plant, controller and scenario, one control period after the other.

At every control instant the true state of the car is projected on the path and previewed, the
controller commands, and all of it is recorded; then the plant moves on by one period under the wind
and the friction of the place where it is. The controller is told neither.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.control.registry import oracle_of
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.interface import (
    FALLBACKS,
    Command,
    Controller,
    Declared,
    State,
    clamped_inputs,
    declared,
    told_by,
)
from lpvmpc.kit.provenance import model_sha256, versions
from lpvmpc.plant.deviations import Deviations
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.guard import TimeLimit, checked_command
from lpvmpc.sim.log import Log, Recorder

if TYPE_CHECKING:
    from lpvmpc.interface import Preview
    from lpvmpc.road.scenario import Scenario

EY_LOST = 5.0
"""A car further than this from the path has lost it [m], unless the road itself is wider."""
VERGE = 2.0
"""A car further than this beyond the edge of the road has lost it [m]."""
EPSI_LOST = math.pi / 2.0
"""A car turned further than this from the path has lost it [rad]."""
STUCK_SPEED = 0.5
"""A car slower than this, against a faster reference, stands [m/s]."""
STUCK_TIME = 3.0
"""Time for which it must stand to count as stuck [s]."""
TIME_FACTOR = 2.0
"""A run of more than this many times the reference's duration is given up."""
MAX_DELAY = 30
"""Longest delay of the commands [control periods], one second."""
MAX_LAPS = 100
"""Most laps of one run: all of them are kept in memory."""

Progress = Callable[[float], None]


def simulate(
    plant: Plant,
    controller: Controller,
    scenario: Scenario,
    *,
    seed: int = 0,
    laps: int = 1,
    start_offset: tuple[float, float] = (0.0, 0.0),
    delay: int = 0,
    latency: float = 0.0,
    deviations: Deviations | None = None,
    step_timeout: float | None = None,
    progress: Progress | None = None,
    name: str | None = None,
    options: dict[str, Any] | None = None,
) -> Log:
    """Drive a scenario from its start to its end, or until the car is lost.

    The car starts trimmed on the reference: at its speed, curvature and wind, everything settled.
    A closed track is driven for whole laps. Ctrl-C ends the run early; the Log then holds what
    was recorded until then, with `meta["reason"] == "interrupted"`.

    Args:
        plant: The car; reset here, its friction set from the scenario.
        controller: Anything with `reset(rng)` and `command(state, preview)`; see `interface`.
        scenario: Path, speed, wind and friction.
        seed: Seed of the generator given to the controller.
        laps: Number of laps, 1 to `MAX_LAPS`; more than one on closed tracks only.
        start_offset: Where the car starts beside the reference: ey [m], left positive, and its
            course against the path's, epsi [rad].
        delay: Number of control periods after which a command reaches the car, 0 to `MAX_DELAY`;
            until then it holds the trimmed command.
        latency: Time that passes besides, in physics steps, before a command reaches the car [s],
            0 to 0.2. Neither is told to the controller here.
        deviations: How the car differs from the one that the controller knows (default: the
            plant's own).
        step_timeout: Longest wall-clock time of one call of the controller [s]; None: no limit.
        progress: Called at every control instant with the driven fraction of the path.
        name: Name of the controller in results (default: its attribute `name`, else its class).
        options: Further options to record in the trace.

    Returns:
        The Log; `meta` says whether the run completed, and why not.

    Raises:
        OptionError: An option outside its domain, or a controller of another control period.
        ControllerError: The controller raised, hung, or returned something that is no command.
    """
    if type(seed) is not int or seed < 0:
        raise OptionError("seed", seed, "a whole number from 0")
    if type(delay) is not int or not 0 <= delay <= MAX_DELAY:
        raise OptionError("delay", delay, f"a whole number from 0 to {MAX_DELAY}")
    check_start(scenario, laps, start_offset)
    if step_timeout is not None and not (math.isfinite(step_timeout) and step_timeout > 0.0):
        raise OptionError("step_timeout", step_timeout, "a positive number of seconds")
    Ts = plant.Ts
    about = declared(controller)
    if about.Ts is not None and not math.isclose(about.Ts, Ts, rel_tol=1e-9):
        raise OptionError("controller Ts", about.Ts, f"the plant's, {Ts} s")
    if name:
        about = replace(about, name=name)
    before = plant.latency, plant.deviations
    plant.latency = latency
    if deviations is not None:
        plant.deviations = deviations
    loop = _Loop(plant, controller, scenario, about, delay, step_timeout, laps, start_offset)
    wall = time.perf_counter()
    try:
        with loop.limit.installed():
            reason = loop.run(seed, progress)
    except KeyboardInterrupt:
        reason = "interrupted"
    finally:
        plant.friction = loop.grip
        meant = {"latency_s": plant.latency, "deviations": plant.deviations.record()}
        plant.latency, plant.deviations = before
    wall = time.perf_counter() - wall
    meta = loop.meta(reason, wall)
    if laps != 1:
        meant["laps"] = laps
    if tuple(start_offset) != (0.0, 0.0):
        meant["start_offset"] = [float(value) for value in start_offset]
    told = {"delay": delay, **{name: value for name, value in meant.items() if value}}
    meta.update(seed=seed, options={**told, **(options or {})})
    return loop.recorder.log(meta, scenario, about.weights)


def check_start(scenario: Scenario, laps: int, start_offset: tuple[float, float]) -> None:
    """Refuse laps that the road has not, and starts from which the car would be lost at once.

    Raises:
        OptionError: What is wrong with which of them.
    """
    if type(laps) is not int or not 1 <= laps <= MAX_LAPS:
        raise OptionError("laps", laps, f"a whole number from 1 to {MAX_LAPS}")
    if laps > 1 and not scenario.path.closed:
        raise OptionError("laps", laps, f"1: the road of {scenario.name} is not closed")
    try:
        ey, epsi = (float(value) for value in start_offset)
    except (TypeError, ValueError):
        ey = epsi = math.nan
    if not (abs(ey) <= EY_LOST and abs(epsi) < EPSI_LOST):
        raise OptionError("start_offset", start_offset,
                          f"two numbers, ey from {-EY_LOST:g} to {EY_LOST:g} m and epsi between "
                          "-pi/2 and pi/2 rad")  # fmt: skip


class _Loop:
    """State of one running simulation."""

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        scenario: Scenario,
        about: Declared,
        delay: int,
        step_timeout: float | None,
        laps: int,
        start_offset: tuple[float, float],
    ):
        self.plant, self.controller, self.scenario = plant, controller, scenario
        self.about = about
        self.limit = TimeLimit(step_timeout, about.name)
        self.delay = delay
        self.length = laps * scenario.path.length
        self.start_offset = start_offset
        self.reference_duration = laps * scenario.reference_duration
        self.time_limit = TIME_FACTOR * self.reference_duration
        rows = math.ceil(self.time_limit / plant.Ts) + 2
        self.recorder = Recorder(rows, about.Np, len(plant.qpos))
        self.grip = np.array(plant.friction)  # the plant's own, which the road's multiplies
        self.road_friction = scenario.friction
        self.friction = np.ones(4)  # of the road under the wheels
        self.has_qp = False
        self.s_end = self.duration = 0.0
        self.lap_ends: list[float] = []  # when the start line was crossed [s]

    def run(self, seed: int, progress: Progress | None) -> str:
        """Drive; returns why the run ended early, "" at the end of the path."""
        plant, scenario, controller = self.plant, self.scenario, self.controller
        path, Ts, length = scenario.path, plant.Ts, self.length
        state = self._start()
        self.limit.call("reset", 0.0, controller.reset, np.random.default_rng(seed))
        held = plant.held
        queue = deque([held] * self.delay)
        oracle = oracle_of(controller)
        s, stuck, k = 0.0, 0, 0
        while True:
            t, s_before = k * Ts, s
            preview = path.preview(
                state.x, state.y, state.psi, s, scenario.speed.vx, scenario.speed.spacing,
                self.about.preview_steps, Ts,
            )
            s = preview.s
            line = (len(self.lap_ends) + 1) * path.length
            if s >= line:  # the line lies between the last instant and this one
                crossed = t - Ts * (s - line) / (s - s_before)
                self.lap_ends.append(crossed)
                if s >= length:
                    self.s_end, self.duration = length, crossed
                    return ""
            self.s_end, self.duration = s, t
            standing = state.vx < STUCK_SPEED < preview.vx_ref[0]
            stuck = stuck + 1 if standing else 0
            reason = self._lost(preview, t, stuck * Ts)
            if reason:  # this instant counts, with the command that led to it
                self._record(t, state, preview, held, None)
                return reason
            if oracle is not None:
                oracle.observe(plant.axles)
            cpu = time.thread_time_ns()
            answer = self.limit.call("command", t, controller.command, state, preview)
            cpu = time.thread_time_ns() - cpu
            held = command = checked_command(answer, self.about.name, t)
            self._record(t, state, preview, command, cpu * 1e-3)
            if progress is not None:
                progress(s / length)
            if self.delay:
                queue.append(command)
                command = queue.popleft()
            self._lay_road(s)
            try:
                state = plant.step(command, wind=scenario.wind.velocity(t, s, preview.psi[0]))
            except LPVMPCError as error:  # a diverged simulation ends the run, and is its result
                return f"the plant failed: {error}"
            k += 1

    def meta(self, reason: str, wall_s: float) -> dict[str, Any]:
        """What is recorded beside the columns."""
        car = self.plant.params
        return {
            "scenario": self.scenario.name,
            "controller": self.about.name,
            "stiffness": self.about.stiffness,
            "clamped_inputs": clamped_inputs(self.controller),
            "told_axle_forces": oracle_of(self.controller) is not None,
            "Ts": self.plant.Ts,
            "Np": self.about.Np,
            "completed": not reason,
            "reason": reason,
            "s_end_m": self.s_end,
            "duration_s": self.duration,
            "reference_duration_s": self.reference_duration,
            "lap_times_s": np.diff([0.0, *self.lap_ends]).tolist(),
            "has_qp": self.has_qp,
            "footprint_m": (car.lf, car.lr, car.width),
            "wall_s": wall_s,
            "realtime_factor": self.duration / wall_s,
            "versions": versions(),
            "model_sha256": model_sha256(self.plant.nominal_model),
        }

    def _start(self) -> State:
        """The car on the start line, trimmed at the reference's speed, curvature and wind.

        It moves along the path, so in a side wind its axis points a little to windward; beside the
        path or across it where that is asked for.
        """
        scenario = self.scenario
        x, y, psi, kappa = (float(value) for value in scenario.path.at(0.0))
        self._lay_road(0.0)
        wind = scenario.wind.velocity(0.0, 0.0, psi)
        vx = scenario.speed.start
        ey, epsi = self.start_offset
        if ey or epsi:
            x, y, psi = x - ey * math.sin(psi), y + ey * math.cos(psi), psi + epsi
        return self.plant.reset(x, y, psi, vx, kappa=kappa, wind=wind, align="course")

    def _lay_road(self, s: float) -> None:
        """Put the road's friction under the wheels, where the car is at arc length s [m]."""
        if self.road_friction is None:
            return
        car = self.plant.params
        front, rear = self.road_friction(s + car.lf), self.road_friction(s - car.lr)
        if front != self.friction[0] or rear != self.friction[2]:
            self.friction[:2], self.friction[2:] = front, rear
            self.plant.friction = self.grip * self.friction

    def _lost(self, preview: Preview, t: float, stood: float) -> str:
        """Why the run cannot go on, or ""."""
        ey, path = preview.ey, self.scenario.path
        if abs(ey) > EY_LOST:
            room = path.width_at(preview.s, ey) + VERGE if path.has_widths else 0.0
            if abs(ey) > room:
                return f"off the path: |ey| > {max(EY_LOST, room):.3g} m"
        if abs(preview.epsi) > EPSI_LOST:
            return "spun: |epsi| > pi/2"
        if self.plant.rolled_over:
            return "rolled over"
        if stood >= STUCK_TIME:
            return f"stuck: vx < {STUCK_SPEED:g} m/s for {STUCK_TIME:g} s"
        if t > self.time_limit:
            return f"too slow: {TIME_FACTOR:g} times the reference's time"
        return ""

    def _record(
        self,
        t: float,
        state: State,
        preview: Preview,
        command: Command,
        step_us: float | None,
    ) -> None:
        """Fill one row; `step_us` is None where the controller was not called."""
        log, plant = self.recorder, self.plant
        k = log.n
        log.wheels[k] = plant.wheels
        log.qpos[k] = plant.qpos
        residual = math.nan
        if step_us is not None:
            times = 0.0, 0.0, 0.0
            diagnostics = told_by(self.controller)
            if diagnostics is not None:
                self.has_qp = True
                residual = diagnostics.kkt_residual
                log.solved[k] = diagnostics.solved
                log.fallback[k] = FALLBACKS.index(diagnostics.fallback)
                times = diagnostics.build_us, diagnostics.solve_us, diagnostics.check_us
                if len(diagnostics.prediction):
                    log.prediction(preview, diagnostics.prediction)
            log.times[log.calls] = t, step_us, *times
            log.calls += 1
        log.motion[k] = (
            t, preview.s, state.x, state.y, state.psi, state.vx, state.vy, state.r, state.delta,
            state.ax, state.ay, preview.ey, preview.epsi, preview.kappa[0], preview.vx_ref[0],
            preview.x[0], preview.y[0], preview.psi[0], command.delta, command.ax, plant.roll,
            residual,
        )  # fmt: skip
        log.n = k + 1  # last, so that an interrupt never leaves half a row
