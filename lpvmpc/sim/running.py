"""One run of the closed loop, up to where the car moves: what moves it is up to who asks.

`running` is a generator. At every control instant it projects the true state of the car on the
path, previews the road, asks the controller and records all of it; then it says how the car is to
be driven for one control period, and waits for the state at its end. `loop.simulate` moves one car
at a time; `bench.together` moves many in one call.
"""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lpvmpc.errors import EstimatorError, LPVMPCError, OptionError
from lpvmpc.interface import FALLBACKS, Command, Controller, State
from lpvmpc.kit.provenance import model_sha256, versions
from lpvmpc.plant.deviations import NOMINAL, Deviations
from lpvmpc.plant.plant import Plant
from lpvmpc.road.surface import Surface
from lpvmpc.sensing.sensors import Sensors
from lpvmpc.sim.driver import Answer, Driver, InProcess
from lpvmpc.sim.ending import STUCK_SPEED, TIME_FACTOR, check_start, why_lost
from lpvmpc.sim.ground import Ground
from lpvmpc.sim.guard import Alarm, Guard
from lpvmpc.sim.log import Log, Recorder
from lpvmpc.sim.names import load_estimator
from lpvmpc.sim.perception import Perception
from lpvmpc.sim.process.isolated import Isolated
from lpvmpc.sim.world import Draw, World, children, load_world
from lpvmpc.traffic.watch import Watch, users_of

if TYPE_CHECKING:
    from lpvmpc.interface import Preview
    from lpvmpc.road.scenario import Scenario
    from lpvmpc.traffic.users import Traffic

MAX_DELAY = 30
"""Longest delay of the commands [control periods], one second."""

Progress = Callable[[float], None]


class Push(NamedTuple):
    """How the car is to be driven for one control period."""

    command: Command
    """Held for the period, once it has reached the car."""
    wind: tuple[float, float]
    """Velocity of the air in the world [m/s]."""


Running = Generator[Push, State, Log]
"""A run on its way: it yields a `Push`, is sent the state after it, and returns the Log. What could
not move the car is thrown into it (LPVMPCError: the run ends, and that is its reason), and so is
KeyboardInterrupt, at which it returns what was recorded."""


def running(
    plant: Plant,
    controller: Controller | Isolated,
    scenario: Scenario,
    alarm: Alarm,
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
) -> Running:
    """A run; `alarm` interrupts a controller that takes too long.

    All else, and what is raised when the run is first asked: see `loop.simulate`. Nobody else may
    use the plant until the run has ended.
    """
    for what, value in (("plant", plant), ("controller", controller), ("scenario", scenario)):
        if value is None or isinstance(value, str | type):
            maker = "Plant()" if what == "plant" else f"load_{what}(name)"
            raise OptionError(what, value, f"an object, as {maker} gives")
    if estimator is not None and not isinstance(estimator, str):
        raise OptionError("estimator", estimator, "a name or module:Class")
    if type(seed) is not int or seed < 0:
        raise OptionError("seed", seed, "a whole number from 0")
    if type(delay) is not int or not 0 <= delay <= MAX_DELAY:
        raise OptionError("delay", delay, f"a whole number from 0 to {MAX_DELAY}")
    check_start(scenario, laps, start_offset)
    if step_timeout is not None and not (math.isfinite(step_timeout) and step_timeout > 0.0):
        raise OptionError("step_timeout", step_timeout, "a positive number of seconds")
    with _driving(controller, name, alarm, step_timeout) as driver:
        about, Ts = driver.about, plant.Ts
        if about.Ts is not None and not math.isclose(about.Ts, Ts, rel_tol=1e-9):
            raise OptionError("controller Ts", about.Ts, f"the plant's, {Ts} s")
        worlds, senses, guesses = children(seed)
        draw = load_world(world).sample(worlds)
        if estimator is None:
            estimator = "none" if draw.sensing.exact else "ekf"
        if deviations is None and draw.deviations != NOMINAL:
            deviations = draw.deviations
        if latency is None:
            step = plant.latency_step
            latency = round(draw.latency / step) * step
        with _changed(plant, latency, deviations, draw.surface.level):
            meant = replace(draw, latency=plant.latency, deviations=plant.deviations)
            scenario = replace(scenario, wind=draw.wind(scenario.wind))
            loop = _Loop(plant, driver, scenario, delay, laps, start_offset, draw.surface)
            if traffic is not None:
                loop.traffic = Watch(traffic, plant.params, loop.rows)
            if not draw.sensing.exact or estimator != "none":
                sensors = Sensors(draw.sensing, Ts, senses)
                servo = plant.deviations if draw.steering_sensor == "servo" else None
                limit = step_timeout if ":" in estimator else None  # the package's may compile
                guard = Guard("Estimator", estimator, EstimatorError, alarm, limit)
                guess = load_estimator(estimator, car=plant.params, sensing=draw.sensing, Ts=Ts)
                loop.perception = Perception(
                    scenario, sensors, guess, guard, servo, about.preview_steps, loop.rows
                )
            wall = time.perf_counter()
            try:
                reason = yield from loop.run(seed, progress, guesses)
            except KeyboardInterrupt:
                reason = "interrupted"
            wall = time.perf_counter() - wall
        meta = loop.meta(reason, wall)
    told = {"delay": delay, **loop.told(meant, estimator)}
    if laps != 1:
        told["laps"] = laps
    if tuple(start_offset) != (0.0, 0.0):
        told["start_offset"] = [float(value) for value in start_offset]
    meta.update(seed=seed, options={**told, **(options or {})})
    meta.update(world={"name": draw.name, "drawn": loop.drawn(meant)}, estimator=estimator)
    log = loop.recorder.log(meta, scenario, about.weights)
    if loop.perception is not None:
        log.columns.update(loop.perception.columns(len(log)))
    if traffic is not None and loop.traffic is not None:
        log.columns.update(loop.traffic.columns(len(log)))
        log.meta["traffic"], log.road = users_of(traffic), traffic.path
    return log


def _driving(
    controller: Controller | Isolated, name: str | None, alarm: Alarm, seconds: float | None
) -> AbstractContextManager[Driver]:
    """The driver of a controller, which lives here or in a process of its own."""
    if isinstance(controller, Isolated):
        return controller.driver(name, seconds)
    return nullcontext(InProcess(controller, name, alarm, seconds))


@contextmanager
def _changed(
    plant: Plant, latency: float, deviations: Deviations | None, level: bool
) -> Iterator[None]:
    """Change a plant for a run; afterwards car, latency, friction and level are as before."""
    before = plant.latency, plant.deviations, plant.friction
    try:
        plant.latency = latency
        if deviations is not None:
            plant.deviations = deviations
        yield
    finally:
        plant.latency, plant.deviations, plant.friction = before
        if not level:
            plant.tilt()


def sentence(error: object) -> str:
    """An error as the reason for which a run ended: one line, without its full stop."""
    return " ".join(str(error).split()).rstrip(".")


class _Loop:
    """State of one running simulation."""

    def __init__(
        self,
        plant: Plant,
        driver: Driver,
        scenario: Scenario,
        delay: int,
        laps: int,
        start_offset: tuple[float, float],
        surface: Surface,
    ):
        self.plant, self.driver, self.scenario = plant, driver, scenario
        self.about = driver.about
        self.delay = delay
        self.length = laps * scenario.path.length
        self.start_offset = start_offset
        self.reference_duration = laps * scenario.reference_duration
        self.time_limit = TIME_FACTOR * self.reference_duration
        self.rows = math.ceil(self.time_limit / plant.Ts) + 2
        self.recorder = Recorder(self.rows, driver.about.Np, len(plant.qpos), delay)
        self.ground = Ground(plant, scenario, surface)
        self.perception: Perception | None = None
        self.traffic: Watch | None = None
        self.has_qp = False
        self.s_end = self.duration = 0.0
        self.lap_ends: list[float] = []  # when the start line was crossed [s]

    def run(
        self, seed: int, progress: Progress | None, guesses: np.random.Generator
    ) -> Generator[Push, State, str]:
        """Drive; returns why the run ended early, "" at the end of the path."""
        plant, scenario, driver = self.plant, self.scenario, self.driver
        path, Ts, length = scenario.path, plant.Ts, self.length
        state = self._start()
        driver.reset(seed)
        held = plant.held
        perception = self.perception
        if perception is not None:
            perception.start(state, guesses)
        queue = deque([held] * self.delay)
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
            reason = why_lost(plant, path, preview, t, stuck * Ts, self.time_limit)
            if self.traffic is not None:
                touched = self.traffic.look(self.recorder.n, t, state.x, state.y, state.psi)
                reason = reason or (f"contact with {touched}" if touched else "")
            if reason:  # this instant counts, with the command that led to it
                self._record(t, state, preview, preview, held, None)
                return reason
            seen, ahead = state, preview
            try:
                if perception is not None:
                    seen, ahead = perception.look(state, preview.psi[0], t, held)
                answer = driver.ask(t, seen, ahead, plant.axles if driver.oracle else None)
            except LPVMPCError as error:
                if k == 0:  # nothing is driven yet
                    raise
                self._record(t, state, preview, preview, held, None)
                return sentence(error)
            held = command = answer.command
            self._record(t, state, preview, ahead, command, answer)
            if progress is not None:
                progress(s / length)
            if self.delay:
                queue.append(command)
                command = queue.popleft()
            self.ground.lay(s, preview.psi[0])
            try:
                state = yield Push(command, scenario.wind.velocity(t, s, preview.psi[0]))
            except LPVMPCError as error:  # a diverged simulation ends the run, and is its result
                return f"the plant failed: {error}"
            k += 1

    def meta(self, reason: str, wall_s: float) -> dict[str, Any]:
        """What is recorded beside the columns."""
        car = self.plant.params
        events, unknowns, wrong = 0, dict[str, float](), ""
        if self.perception is not None:
            events, unknowns, wrong = self.perception.told()
        reason = reason or sentence(wrong)
        return {
            "scenario": self.scenario.name,
            "controller": self.about.name,
            "stiffness": self.about.stiffness,
            "clamped_inputs": self.driver.clamped(),
            "told_axle_forces": self.driver.oracle,
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
            "estimator_events": events,
            "estimator_unknowns": unknowns,
            "wall_s": wall_s,
            "realtime_factor": self.duration / wall_s,
            "versions": versions(),
            "model_sha256": model_sha256(self.plant.nominal_model),
        }

    def drawn(self, meant: Draw) -> dict[str, Any]:
        """The numbers of this run's world; empty in the ideal one."""
        found = meant.record()
        if self.perception is not None and self.perception.sensors.drawn:
            found["sensors"] = dict(self.perception.sensors.drawn)
        return found

    def told(self, meant: Draw, estimator: str) -> dict[str, Any]:
        """What the trace is to say of the world, where it is not the ideal one."""
        found = self.drawn(meant)
        if not found and self.perception is None:
            return {}
        return {"world": meant.name, "drawn": found, "estimator": estimator}

    def _start(self) -> State:
        """The car on the start line, trimmed at the reference's speed, curvature and wind.

        It moves along the path, so in a side wind its axis points a little to windward; beside the
        path or across it where that is asked for.
        """
        scenario = self.scenario
        x, y, psi, kappa = (float(value) for value in scenario.path.at(0.0))
        self.ground.lay(0.0, psi)
        wind = scenario.wind.velocity(0.0, 0.0, psi)
        vx = scenario.speed.start
        ey, epsi = self.start_offset
        if ey or epsi:
            x, y, psi = x - ey * math.sin(psi), y + ey * math.cos(psi), psi + epsi
        return self.plant.reset(x, y, psi, vx, kappa=kappa, wind=wind, align="course")

    def _record(
        self,
        t: float,
        state: State,
        preview: Preview,
        ahead: Preview,
        command: Command,
        answer: Answer | None,
    ) -> None:
        """Fill one row; the controller saw `ahead`, and did not answer where `answer` is None."""
        log, plant = self.recorder, self.plant
        k = log.n
        log.wheels[k] = plant.wheels
        log.qpos[k] = plant.qpos
        residual = math.nan
        if answer is not None:
            times = 0.0, 0.0, 0.0
            diagnostics = answer.told
            if diagnostics is not None:
                self.has_qp = True
                residual = diagnostics.kkt_residual
                log.solved[k] = diagnostics.solved
                log.fallback[k] = FALLBACKS.index(diagnostics.fallback)
                times = diagnostics.build_us, diagnostics.solve_us, diagnostics.check_us
                if len(diagnostics.prediction):
                    log.prediction(ahead, diagnostics.prediction)
            log.times[log.calls] = t, answer.cpu_us, *times, answer.wall_us
            log.calls += 1
        log.motion[k] = (
            t, preview.s, state.x, state.y, state.psi, state.vx, state.vy, state.r, state.delta,
            state.ax, state.ay, preview.ey, preview.epsi, preview.kappa[0], preview.vx_ref[0],
            preview.x[0], preview.y[0], preview.psi[0], command.delta, command.ax, plant.roll,
            residual,
        )
        log.n = k + 1  # last, so that an interrupt never leaves half a row
