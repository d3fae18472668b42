"""What is each car's own: the world that was drawn for its episode, and where it starts."""

from __future__ import annotations

import copy
import math

import mujoco
import numpy as np

from lpvmpc.interface import Command, State
from lpvmpc.kit.provenance import model_sha256
from lpvmpc.plant.actuation import Actuation
from lpvmpc.plant.deviations import NOMINAL, deviated
from lpvmpc.plant.mjcf import parameters
from lpvmpc.plant.motion import mass_layout
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import FRICTION, Snapshot
from lpvmpc.plant.trim import gravity, place
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.surface import PLAIN
from lpvmpc.sensing.sensors import Sensors
from lpvmpc.sim.ground import Ground
from lpvmpc.sim.names import load_estimator
from lpvmpc.sim.world import World
from lpvmpc.units import Array

SPEED_STEP, AY_STEP = 1.0, 2.0
"""Steady states are settled at whole multiples of these [m/s, m/s2], then kept."""
SLOWEST, FASTEST, AY_MOST = 2.0, 40.0, 4.0
"""Domain of these states."""


_KEPT: dict[str, dict[tuple[int, int], Snapshot]] = {}
"""Steady states by the car's hash: all environments of a process share them."""


class Starts:
    """Steady states of the nominal car, each settled when it is first asked for."""

    def __init__(self, plant: Plant) -> None:
        """Args: the car that settles; its state is changed by every new one."""
        self.plant = plant
        self.layout = mass_layout(plant.nominal_model)
        self._kept = _KEPT.setdefault(model_sha256(plant.nominal_model), {})

    def state(self, vx: float, kappa: float, x: float, y: float, course: float) -> Array:
        """Integration state of a car near a steady state, moved to a place and a course.

        The speed is rounded to `SPEED_STEP`, the lateral acceleration vx^2 kappa towards zero to
        `AY_STEP`: the car begins within that of the reference's.
        """
        speed = round(min(max(vx, SLOWEST), FASTEST) / SPEED_STEP)
        v = speed * SPEED_STEP
        bend = math.trunc(min(max(v * v * kappa, -AY_MOST), AY_MOST) / AY_STEP)
        self.plant.restore(self._settled(speed, bend))
        place(self.plant.data, self.layout, x, y, course, course=True)
        return self.plant.save().state

    def settle_all(self, fastest: float = 21.0, kappa: float = 0.1) -> int:
        """Settle them now, so that no episode has to wait for its own.

        Args:
            fastest: Speed up to which [m/s]; the default is that of roads without another limit.
            kappa: Curvature up to which [1/m].

        Returns:
            How many there are then.
        """
        bends = round(AY_MOST / AY_STEP)
        for speed in range(round(SLOWEST / SPEED_STEP), math.floor(fastest / SPEED_STEP) + 1):
            for bend in range(-bends, bends + 1):
                if abs(bend) * AY_STEP <= kappa * (speed * SPEED_STEP) ** 2:
                    self._settled(speed, bend)
        return len(self._kept)

    def _settled(self, speed: int, bend: int) -> Snapshot:
        """A steady state by its multiples."""
        if (speed, bend) not in self._kept:
            v = speed * SPEED_STEP
            self.plant.reset(vx=v, kappa=bend * AY_STEP / (v * v))
            self._kept[speed, bend] = self.plant.save()
        return self._kept[speed, bend]


class One:
    """The world of one car's episode."""

    def __init__(
        self, world: World, scenario: Scenario, starts: Starts, userdata: Array, estimate: bool,
        rng: np.random.Generator,
    ) -> None:
        """Draw it.

        Args:
            world: What is drawn from.
            scenario: What is driven.
            starts: The nominal car, and its steady states.
            userdata: The car's row in the batch.
            estimate: Whether what its sensors say is asked for.
            rng: Generator of everything.
        """
        self.draw = draw = world.sample(rng)
        plant = starts.plant
        self.userdata = userdata
        self.params = plant.params
        nominal = plant.nominal_model
        level = draw.surface.level
        self.model: mujoco.MjModel | None = None
        self.layout = starts.layout
        if draw.deviations != NOMINAL:
            self.model = deviated(nominal, draw.deviations)
            self.layout = mass_layout(self.model)
        elif not level:
            self.model = copy.copy(nominal)
        latency = round(draw.latency / plant.latency_step)
        self.actuation: Actuation | None = None
        if draw.deviations != NOMINAL or latency:
            real = self.params if self.model is None else parameters(self.model)
            gain = self.params.R_w * self.params.m_eff / (real.R_w * real.m_eff)
            self.actuation = Actuation(draw.deviations, gain, latency)
        self.wind = draw.wind(scenario.wind)
        self.windy = not self.wind.calm
        self.scenario, self.level = scenario, level
        self.uneven = draw.surface != PLAIN or scenario.friction is not None
        self.ground: Ground | None = None
        self.senses = estimate and not draw.sensing.exact
        self._turned = False
        self._rng = rng
        if self.senses:
            self.sensors = Sensors(draw.sensing, plant.Ts, rng)
            self.estimator = load_estimator(
                "ekf", car=self.params, sensing=draw.sensing, Ts=plant.Ts
            )
        self.servo = draw.deviations if draw.steering_sensor == "servo" else None

    # --- what `Ground` asks of a plant ---

    @property
    def friction(self) -> Array:
        """Friction scale under each wheel, shape (4,)."""
        return 1.0 + self.userdata[FRICTION]

    @friction.setter
    def friction(self, scale: Array) -> None:
        self.userdata[FRICTION] = scale - 1.0

    def tilt(self, grade: float, bank: float, psi: float) -> None:
        """See `Plant.tilt`."""
        along, left, down = gravity(grade, bank)
        c, s = math.cos(psi), math.sin(psi)
        assert self.model is not None
        self.model.opt.gravity[:] = c * along - s * left, s * along + c * left, down
        self._turned = True

    # --- an episode ---

    def begin(self) -> None:
        """Lay the road; the car's state is in the batch."""
        self.friction = np.ones(4)
        if self.uneven:
            self.ground = Ground(self, self.scenario, self.draw.surface)  # type: ignore[arg-type]

    def start(self, held: Command) -> Command:
        """The command for what servo and drive hold at the start."""
        return held if self.actuation is None else self.actuation.start(*held)

    def lay(self, s: float, psi: float) -> bool:
        """Put the road under the car; whether its model has changed."""
        assert self.ground is not None
        self._turned = False
        self.ground.lay(s, psi)
        return self._turned

    def look(
        self, state: State, psi_path: float, t: float, held: Command, fresh: bool
    ) -> State:
        """What sensors and filter say of the true state."""
        if fresh:
            self.estimator.reset(state, self._rng)
        given = state
        if self.servo is not None:
            delta = (state.delta - self.servo.steer_offset) / self.servo.steer_ratio
            given = state._replace(delta=delta)
        found = self.estimator.update(self.sensors.measure(given, psi_path, t), held)
        if not np.isfinite(found[:9]).all():
            self.estimator.reset(state, self._rng)
            return state
        return found
