"""N cars in one process: their physics in one `mujoco.batch`, each with its road, car and world.

What the environments do lies here; `Track-v0` is this with one car, so both drive alike.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from mujoco.batch import Batch, SimulationError

from lpvmpc.control.rivals.observation import (
    BOUNDS,
    SIZE,
    STEPS,
    TABLE,
    action_of,
    command_of,
)
from lpvmpc.errors import LPVMPCError, OptionError, UnknownNameError
from lpvmpc.gym import checks, seeing
from lpvmpc.gym.one import One, Starts
from lpvmpc.gym.others import ENTRIES, Others
from lpvmpc.gym.roads import Roads
from lpvmpc.interface import Command, Preview, State
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import SPIN_QVEL, STEER, WIND_X, WIND_Y
from lpvmpc.sim.ending import EPSI_LOST, EY_LOST, STUCK_SPEED, STUCK_TIME, VERGE
from lpvmpc.sim.world import World, load_world
from lpvmpc.traffic.users import check_name
from lpvmpc.traffic.watch import Pose
from lpvmpc.units import Array

ROLL_LOST = math.radians(60.0)
"""A car that leans further has rolled over [rad]."""
SEES = ("estimate", "truth")
"""What may be observed: the estimate of the world's sensors, or the true state."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What the episodes of an environment are drawn from.

    Raises:
        OptionError: A value outside its domain.
        UnknownNameError: No such world.
    """

    roads: Sequence[str] = tuple(f"random-{i}" for i in range(32))
    """Scenarios or CSV files; each episode draws one."""
    scenario_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `load_scenario`, as grip or v_max."""
    worlds: Sequence[str | Mapping[str, Any] | World] = ("ideal",)
    """Worlds; each episode draws one, and then its car, road surface, air and sensors from it."""
    observe: str = "estimate"
    """"estimate": what the world's sensors and the Kalman filter say (the truth where they are
    exact); "truth": the true state in any world."""
    random_start: bool = True
    """Whether an episode begins anywhere on the road, up to 0.5 m and 0.05 rad beside it and at 80
    to 100 % of its speed; else at its start, on it, at its speed."""
    max_steps: int = 1000
    """Control periods after which an episode is truncated."""
    traffic: str | os.PathLike[str] | None = None
    """Other road users, see `lpvmpc.traffic`, as far ahead of the car's start as of a road's; the
    observation then ends with `others.ENTRIES`, and a contact ends the episode."""

    def __post_init__(self) -> None:
        """Check what is given."""
        if isinstance(self.roads, str) or not self.roads:
            raise OptionError("roads", self.roads, "one or more names of scenarios, as a list")
        for road in self.roads:
            if not isinstance(road, str | os.PathLike):
                raise OptionError("roads", self.roads, "names of scenarios or CSV files")
        if not isinstance(self.scenario_options, Mapping):
            raise OptionError("scenario_options", self.scenario_options,
                              "a dictionary of options of load_scenario")
        if isinstance(self.worlds, str | Mapping) or not self.worlds:
            raise OptionError("worlds", self.worlds, "one or more worlds, as a list")
        for world in self.worlds:
            if not isinstance(world, str | os.PathLike | Mapping | World):
                raise OptionError("worlds", self.worlds, "names, TOML files, or their contents")
        if not isinstance(self.random_start, bool | np.bool_):
            raise OptionError("random_start", self.random_start, "True or False")
        if self.observe not in SEES:
            raise OptionError("observe", self.observe, " or ".join(SEES))
        checks.whole("max_steps", self.max_steps, 1, 1_000_000)
        if not isinstance(self.traffic, str | os.PathLike | None):
            raise OptionError("traffic", self.traffic, "a name, a TOML file, or None")
        if self.traffic is not None:
            check_name(self.traffic)


def setting_of(given: Mapping[str, Any]) -> Setting:
    """A Setting from what an environment was given besides.

    Raises:
        UnknownNameError: An option that there is not, or no such world.
        OptionError: A value outside its domain.
    """
    known = [field.name for field in fields(Setting)]
    for name in given:
        if name not in known:
            raise UnknownNameError("option of the environment", name, known)
    return Setting(**given)


class Cars:
    """N cars, stepped together."""

    def __init__(self, n: int, setting: Setting, threads: int = 0) -> None:
        """Args: number of cars, what their episodes are drawn from, threads (0: all cores)."""
        checks.whole("num_envs", n, 1, 100_000)
        checks.whole("threads", threads, 0, 1024)
        self.n, self.setting = n, setting
        self.worlds = [load_world(world) for world in setting.worlds]
        self.roads = Roads(tuple(map(os.fspath, setting.roads)), setting.scenario_options)
        self.plant = Plant()
        self.starts = Starts(self.plant)
        self.batch = Batch(self.plant.nominal_model, n, threads)
        self.qpos, self.qvel, self.act, self.ctrl, self.userdata = (
            self.batch.bind(name) for name in ("qpos", "qvel", "act", "ctrl", "userdata")
        )
        self.ones: list[One | None] = [None] * n
        self.delta_max = self.plant.params.delta_max
        shares, com = self.starts.layout
        self.shares, self.com = np.tile(shares, (n, 1)), np.tile(com, (n, 1))
        self.states: Array = np.zeros((n, seeing.STATE))
        self.seen: Array = np.zeros((n, seeing.STATE))
        self.where: Array = np.zeros((n, 5))
        self.where_seen: Array = np.zeros((n, 5))
        self.road = np.zeros(n, dtype=np.int64)
        self.steps = np.zeros(n, dtype=np.int64)
        self.standing = np.zeros(n, dtype=np.int64)
        self.last: Array = np.zeros((n, 2))
        self.reward: Array = np.zeros(n)
        self.lost, self.over = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
        self._observation = np.zeros((n, SIZE), dtype=np.float32)
        self._truth = np.zeros((n, SIZE), dtype=np.float32)
        self._limits = np.array([EPSI_LOST, ROLL_LOST, STUCK_SPEED, STUCK_TIME])
        self.entries, self.others = TABLE, None
        if setting.traffic is not None:
            self.entries = (*TABLE, *ENTRIES)
            self.others = Others(setting.traffic, self.plant.params, n)

    def reset(
        self, which: Sequence[int], rngs: Sequence[np.random.Generator],
        options: Mapping[str, Any] | None = None,
    ) -> None:
        """Begin an episode for some of the cars.

        Args:
            which: Their numbers.
            rngs: A generator for each of all N cars.
            options: What to fix instead of drawing, see `checks.OWN`.

        Raises:
            OptionError, UnknownNameError: Something in the options that there is not.
        """
        own = checks.start_of(options)
        changed = False
        for i in which:
            changed |= self._reset_one(i, rngs[i], own)
        if changed:
            self._set_models()
        rows = np.asarray(which, dtype=np.int64)
        self.steps[rows] = 0
        self.standing[rows] = 0
        self._see(rows, fresh=True)

    def _reset_one(self, i: int, rng: np.random.Generator, own: dict[str, Any]) -> bool:
        """Draw an episode for car i; whether the models of the batch have changed."""
        old, self.ones[i] = self.ones[i], None  # whatever fails below, this one has not begun
        names = self.roads.names
        name = str(own.get("road", names[int(rng.integers(len(names)))]))
        world = self.worlds[int(rng.integers(len(self.worlds)))]
        if "world" in own:
            world = load_world(own["world"])
        draws = rng.uniform(-1.0, 1.0, 4) if self.setting.random_start else np.array([-1, 0, 0, 1])
        self.road[i] = number = self.roads.number(name)
        scenario = self.roads.scenarios[number]
        length = scenario.path.length
        room = length if scenario.path.closed else max(length - 60.0, 0.0)
        s = float(own.get("s", 0.5 * (draws[0] + 1.0) * room))
        if s > length:
            raise OptionError("s", s, f"at most the length of {name}, {length:.1f} m")
        ey, epsi = float(own.get("ey", 0.5 * draws[1])), float(own.get("epsi", 0.05 * draws[2]))
        x, y, psi, kappa = (float(value) for value in scenario.path.at(s))
        reference = float(np.interp(s % length if scenario.path.closed else s, np.linspace(
            0.0, scenario.speed.length, len(scenario.speed.vx)), scenario.speed.vx))
        vx = float(own.get("vx", reference * (0.9 + 0.1 * draws[3])))
        x, y = x - ey * math.sin(psi), y + ey * math.cos(psi)
        estimate = self.setting.observe == "estimate"
        one = One(world, scenario, self.starts, self.userdata[i], estimate, rng)
        self.ones[i] = one
        self.batch.state[i] = self.starts.state(vx, kappa, x, y, psi + epsi)
        one.begin()
        if self.others is not None:
            self.others.begin(i, scenario, s)
        held = Command(float(self.ctrl[i, 0]), float(self.ctrl[i, 1]))
        held = one.start(held)
        self.last[i] = action_of(held, self.delta_max)
        self.shares[i], self.com[i] = one.layout
        self.states[i, 2] = psi
        self.where[i, 0] = self.where_seen[i, 0] = s
        return one.model is not None or (old is not None and old.model is not None)

    def _set_models(self) -> None:
        """Give each car its model; all the nominal one where none differs."""
        own = [one.model if one is not None else None for one in self.ones]
        if any(model is not None for model in own):
            nominal = self.plant.nominal_model
            self.batch.set_models([nominal if model is None else model for model in own])
        else:
            self.batch.set_models(None)

    def step(self, actions: npt.ArrayLike, idle: npt.NDArray[np.bool_] | None = None) -> None:
        """Drive all cars for one control period; `reward`, `lost` and `over` are then its own.

        Args:
            actions: Steering and acceleration, cut to -1 and 1, shape (N, 2).
            idle: Cars that stay as they are, shape (N,); what is said of them means nothing.

        Raises:
            LPVMPCError: An action is not finite.
        """
        given = checks.actions_of(actions, (self.n, 2))
        before = self.last
        self.last = np.clip(given, -1.0, 1.0)
        push = self.last[:, 1]
        commands = np.empty((self.n, 2))
        commands[:, 0] = self.last[:, 0] * self.delta_max
        commands[:, 1] = push * np.where(push > 0.0, 4.0, 8.0)
        tilted = False
        for i, one in enumerate(self.ones):
            if one is None:
                raise LPVMPCError(checks.UNBEGUN)
            if one.uneven:
                tilted |= one.lay(self.where[i, seeing.S], self.where[i, seeing.PSI])
            if one.windy:
                t = float(self.steps[i]) * self.plant.Ts
                s, psi = self.where[i, seeing.S], self.where[i, seeing.PSI]
                self.ctrl[i, WIND_X : WIND_Y + 1] = one.wind.velocity(t, s, psi)
        if tilted:
            self._set_models()
        driven = None if idle is None or not idle.any() else np.flatnonzero(~idle)
        self._physics(commands, driven)
        self.steps += 1
        self._see(driven, fresh=False)
        roads = self.roads
        seeing.judge(
            roads.table, roads.index, roads.spacing, self.road, self.states, self.where, self.last,
            before, self.standing, self.steps, self.setting.max_steps, EY_LOST, VERGE,
            self.plant.Ts, self._limits, self.reward, self.lost, self.over,
        )
        if self.others is not None:
            touched = self.others.gap <= 0.0
            self.lost |= touched
            self.over &= ~touched
            self.reward[touched] = 0.0

    def _physics(self, commands: Array, driven: npt.NDArray[np.int64] | None) -> None:
        """One control period, in pieces where commands arrive in the middle of it."""
        nstep, ctrl = self.plant.nstep, self.ctrl
        ctrl[:, STEER : STEER + 2] = commands
        plans = {
            i: list(one.actuation.segments(Command(*commands[i]), nstep))
            for i, one in enumerate(self.ones) if one is not None and one.actuation is not None
        }
        ends = {nstep}
        for plan in plans.values():
            ends.update(np.cumsum([steps for steps, _, _ in plan]).tolist())
        done = 0
        for end in sorted(ends):
            for i, plan in plans.items():
                at = 0
                for steps, delta, ax in plan:
                    at += steps
                    if done < at:
                        ctrl[i, STEER], ctrl[i, STEER + 1] = delta, ax
                        break
            try:
                self.batch.step(driven, nstep=int(end - done))
            except SimulationError as error:
                self.qpos[error.ids] = math.nan
            done = end

    def _see(self, rows: npt.NDArray[np.int64] | None, fresh: bool) -> None:
        """Find the true states and what is seen of them, of some cars (None: all)."""
        part = slice(None) if rows is None else rows
        roads, Ts = self.roads, self.plant.Ts
        states, where, truth = self.states[part], self.where[part], self._truth[part]
        seeing.motions(self.qpos[part], self.qvel[part], self.act[part], self.userdata[part],
                       self.shares[part], self.com[part], states)
        seeing.look(roads.table, roads.index, roads.spacing, self.road[part], states,
                    self.last[part], BOUNDS, Ts, where, truth)
        self.states[part], self.where[part], self._truth[part] = states, where, truth
        self._observation[part], self.seen[part] = truth, states
        self.where_seen[part] = np.where(
            np.array([one is not None and one.senses for one in self.ones])[part][:, None],
            self.where_seen[part], where,
        )
        if self.others is not None:
            for i in range(self.n) if rows is None else rows:
                if self.others.traffic[i] is not None:
                    place = self.where[i, [seeing.S, seeing.EY, seeing.EPSI]].tolist()
                    self.others.look(int(i), float(self.steps[i]) * Ts, self.states[i], *place)
        if self.setting.observe == "truth":
            return
        for i in range(self.n) if rows is None else rows:
            one = self.ones[i]
            if one is None or not one.senses or not np.isfinite(self.states[i]).all():
                continue
            held = command_of(self.last[i], self.delta_max)
            found = one.look(self.state(i), float(self.where[i, seeing.PSI]),
                             float(self.steps[i]) * Ts, held, fresh)
            self.seen[i, :9] = found[:9]
            alone = slice(i, i + 1)
            seeing.look(roads.table, roads.index, roads.spacing, self.road[alone],
                        self.seen[alone], self.last[alone], BOUNDS, Ts,
                        self.where_seen[alone], self._observation[alone])

    def observations(self) -> npt.NDArray[np.float32]:
        """What all cars see now, a copy, shape (N, SIZE), or (N, len(entries)) in traffic."""
        if self.others is None:
            return self._observation.copy()
        return np.hstack([self._observation, self.others.seen.astype(np.float32)])

    def state(self, i: int) -> State:
        """True state of car i."""
        return self._state(self.states[i], i)

    def _state(self, row: Array, i: int) -> State:
        x, y, psi, vx, vy, r, delta, ax, ay = (float(value) for value in row[:9])
        spins = self.qvel[i, list(SPIN_QVEL)].copy()
        return State(x, y, psi, vx, vy, r, delta, ax, ay, wheel_speed=spins)

    def sight(self, i: int, steps: int = STEPS) -> tuple[State, Preview]:
        """State and preview that a controller would be given for car i; what the policy sees."""
        state = self._state(self.seen[i], i)
        scenario = self.roads.scenarios[self.road[i]]
        preview = scenario.path.preview(
            state.x, state.y, state.psi, self.where_seen[i, 0], scenario.speed.vx,
            scenario.speed.spacing, steps, self.plant.Ts,
        )
        return state, preview

    def told(self, i: int) -> dict[str, Any]:
        """What the `info` of car i says: numbers of the truth, and what was drawn."""
        one = self.ones[i]
        assert one is not None
        traffic = {} if self.others is None else {"gap": float(self.others.gap[i])}
        return {
            "s": float(self.where[i, seeing.S]), "ey": float(self.where[i, seeing.EY]),
            "epsi": float(self.where[i, seeing.EPSI]), "vx": float(self.states[i, 3]),
            "vx_ref": float(self.where[i, seeing.VX_REF]),
            "road": self.roads.scenarios[self.road[i]].name, "world": one.draw.name,
            **traffic,
        }

    def drawn(self, i: int) -> list[Pose]:
        """Who is around car i, for pictures; see `Others.poses`."""
        if self.others is None:
            return []
        return self.others.poses(i, float(self.steps[i]) * self.plant.Ts)


