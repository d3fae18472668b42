"""`lpvmpc/TrackVec-v0`: many cars in one process, a gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.gym import checks, seeing
from lpvmpc.gym.cars import Cars, setting_of
from lpvmpc.gym.track import ACTION, FPS, IN_TRAFFIC, OBSERVATION
from lpvmpc.gym.window import Window

Observations = npt.NDArray[np.float32]
Flags = npt.NDArray[np.bool_]


class TrackVecEnv(VectorEnv[Observations, npt.NDArray[np.float32], npt.NDArray[np.float64]]):
    """N cars; car i is `Track-v0` with the seed plus i, number for number.

    An episode that has ended begins anew in the step after (`AutoresetMode.NEXT_STEP`, that step's
    action unused and its reward 0), in the same one (`SAME_STEP`, the last observation in
    `info["final_obs"]`), or when `reset` is told so (`DISABLED`, `options={"reset_mask": mask}`).
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"], "render_fps": FPS, "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self, num_envs: int = 1, render_mode: str | None = None, *, threads: int = 0,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, width: int = 320,
        height: int = 180, **setting: Any,
    ) -> None:
        """Make it.

        Args:
            num_envs: Number of cars.
            render_mode: None or "rgb_array".
            threads: Threads of the physics, 0 for all cores.
            autoreset_mode: When an ended episode begins anew.
            width: Of each car's picture [px].
            height: The same [px].
            setting: Fields of `cars.Setting`: roads, worlds, observe, random_start, max_steps,
                traffic.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise OptionError("render_mode", render_mode, "None or 'rgb_array'")
        try:
            self.mode = AutoresetMode(autoreset_mode)
        except ValueError:
            allowed = ", ".join(mode.value for mode in AutoresetMode)
            raise OptionError("autoreset_mode", autoreset_mode, f"one of {allowed}") from None
        checks.size(width, height)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.mode}
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.cars = Cars(num_envs, setting_of(setting), threads)
        seen = OBSERVATION if self.cars.others is None else IN_TRAFFIC
        self.single_observation_space, self.single_action_space = seen, ACTION
        self.observation_space = batch_space(seen, num_envs)
        self.action_space = batch_space(ACTION, num_envs)
        self._rngs = [seeding.np_random(None)[0] for _ in range(num_envs)]
        self._ended: Flags = np.zeros(num_envs, dtype=bool)
        self._windows = [Window(width, height, show=False)] * (render_mode is not None)

    def reset(  # type: ignore[override]
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode for all cars, or for those of `options["reset_mask"]`.

        Args:
            seed: Car i's seed is this plus i, or the i-th; None goes on with what there is.
            options: reset_mask; and road, world, s, ey, epsi, vx to fix instead of drawing them.
        """
        self._check_open()
        if not isinstance(options, Mapping | None):
            raise OptionError("options", options, "a dictionary")
        own = dict(options or {})
        mask = np.asarray(own.pop("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise OptionError("reset_mask", mask, f"a mask of shape ({self.num_envs},), not empty")
        if isinstance(seed, int | np.integer):
            seed = [int(seed) + i for i in range(self.num_envs)]
        if seed is not None and not (isinstance(seed, Sequence | np.ndarray)
                                     and len(seed) == self.num_envs):
            raise OptionError("seed", seed, f"one whole number, or {self.num_envs}")
        which = np.flatnonzero(mask).tolist()
        for i in which:
            if seed is not None and seed[i] is not None:
                self._rngs[i] = seeding.np_random(seed[i])[0]
        self.cars.reset(which, self._rngs, own)
        self._ended[mask] = False
        return self.cars.observations(), self._told(mask)

    def step(  # type: ignore[override]
        self, actions: npt.NDArray[np.float32]
    ) -> tuple[Observations, npt.NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Drive all cars for one control period of 33 ms; what is beyond -1 and 1 is cut.

        Raises:
            LPVMPCError: Actions that are no finite numbers of shape (N, 2); a car whose episode has
                not begun, or has ended and is to be reset by hand; it is closed.
        """
        self._check_open()
        cars, ended = self.cars, self._ended.copy()
        if self.mode == AutoresetMode.DISABLED and ended.any():
            raise OptionError("step", np.flatnonzero(ended).tolist(), "cars that have been reset")
        cars.step(actions, idle=ended)
        reward, lost, over = cars.reward.copy(), cars.lost.copy(), cars.over.copy()
        if ended.any():  # NEXT_STEP: these begin anew and have not been driven
            cars.reset(np.flatnonzero(ended).tolist(), self._rngs)
            reward[ended], lost[ended], over[ended] = 0.0, False, False
        self._ended = lost | over
        info = {}
        if self.mode == AutoresetMode.SAME_STEP and self._ended.any():
            last, mask = cars.observations(), self._ended.copy()
            rows = np.empty(self.num_envs, dtype=object)
            for i in np.flatnonzero(mask):
                rows[i] = last[i]
            info = {"final_obs": rows, "_final_obs": mask,
                    "final_info": self._told(mask), "_final_info": mask.copy()}
            cars.reset(np.flatnonzero(mask).tolist(), self._rngs)
            self._ended[:] = False
        return cars.observations(), reward, lost, over, {**self._told(None), **info}

    def _check_open(self) -> None:
        if self.closed:
            raise LPVMPCError(checks.CLOSED)

    def _told(self, mask: Flags | None) -> dict[str, Any]:
        """Numbers of the truth, by name, of all cars or of those of a mask."""
        there = np.ones(self.num_envs, dtype=bool) if mask is None else mask.copy()
        where = self.cars.where
        found: dict[str, Any] = {
            "s": where[:, seeing.S].copy(), "ey": where[:, seeing.EY].copy(),
            "vx": self.cars.states[:, 3].copy(),
        }
        if self.cars.others is not None:
            found["gap"] = self.cars.others.gap.copy()
        return {**found, **{f"_{name}": there.copy() for name in found}}

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:  # type: ignore[override]
        """A picture of each car, shape (height, width, 3)."""
        if not self._windows:
            return None
        self._check_open()
        if any(one is None for one in self.cars.ones):
            raise LPVMPCError(checks.UNBEGUN)
        cars, pictures = self.cars, []
        for i in range(self.num_envs):
            number = int(cars.road[i])
            path = cars.roads.scenarios[number].path
            picture = self._windows[0].draw(
                number, path, cars.qpos[i], cars.states[i], cars.drawn(i)
            )
            assert picture is not None
            pictures.append(picture)
        return tuple(pictures)

    def close_extras(self, **kwargs: Any) -> None:
        """Give OpenGL back."""
        for window in self._windows:
            window.close()
