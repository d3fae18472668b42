"""`lpvmpc/Track-v0`: one car on a road, a gymnasium environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from lpvmpc.control.rivals.observation import BOUNDS
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.gym import checks
from lpvmpc.gym.cars import Cars, setting_of
from lpvmpc.gym.others import BOUNDS as OTHERS
from lpvmpc.gym.others import LEAST
from lpvmpc.gym.window import Window
from lpvmpc.interface import Preview, State

FPS = 30
"""Pictures per second, one a control period."""

OBSERVATION = spaces.Box(-BOUNDS.astype(np.float32), BOUNDS.astype(np.float32), dtype=np.float32)
"""`control.rivals.observation.TABLE` in order, in SI units."""
IN_TRAFFIC = spaces.Box(
    np.append(-BOUNDS, LEAST).astype(np.float32), np.append(BOUNDS, OTHERS).astype(np.float32),
    dtype=np.float32,
)
"""The same with `others.ENTRIES` behind."""
ACTION = spaces.Box(-1.0, 1.0, (2,), np.float32)
"""Steering, times the largest road-wheel angle; acceleration, 4 m/s2 at 1 and -8 m/s2 at -1."""


class TrackEnv(gymnasium.Env[npt.NDArray[np.float32], npt.NDArray[np.float32]]):
    """One car on a road; docs/gymnasium.md has the table of observations, reward and ends.

    Example:
        env = gymnasium.make("lpvmpc/Track-v0", worlds=["rtk"], roads=["circuit"])
        observation, info = env.reset(seed=1)
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": FPS}  # noqa: RUF012

    def __init__(
        self, render_mode: str | None = None, *, width: int = 640, height: int = 360, **setting: Any
    ) -> None:
        """Make it.

        Args:
            render_mode: None, "rgb_array" or "human".
            width: Of the pictures [px].
            height: The same [px].
            setting: Fields of `cars.Setting`: roads, worlds, observe, random_start, max_steps,
                traffic.
        """
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise OptionError("render_mode", render_mode, "None, 'rgb_array' or 'human'")
        self.render_mode = render_mode
        checks.size(width, height)
        self.cars = Cars(1, setting_of(setting), threads=1)
        self.action_space = ACTION
        self.observation_space = OBSERVATION if self.cars.others is None else IN_TRAFFIC
        self._window = Window(width, height, show=render_mode == "human")
        self._why_not = checks.UNBEGUN

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[npt.NDArray[np.float32], dict[str, Any]]:
        """Begin an episode: road, world, car and start are drawn from the seed.

        Args:
            seed: Seed of the generator; None goes on with the one there is.
            options: road, world, s, ey, epsi, vx to fix instead of drawing them.

        Raises:
            OptionError, UnknownNameError: Options that mean nothing.
            LPVMPCError: It is closed.
        """
        if self._why_not == checks.CLOSED:
            raise LPVMPCError(checks.CLOSED)
        super().reset(seed=seed)
        self._why_not = checks.UNBEGUN  # until all below has worked
        self.cars.reset([0], [self.np_random], options)
        self._why_not = ""
        if self.render_mode == "human":
            self.render()
        return self.cars.observations()[0], self.cars.told(0)

    def step(
        self, action: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold an action for one control period of 33 ms; what is beyond -1 and 1 is cut.

        Raises:
            LPVMPCError: No two finite numbers; the episode has not begun or has ended; it is
                closed.
        """
        cars = self.cars
        self._check()
        cars.step(checks.actions_of(action, (2,))[None, :])
        if cars.lost[0] or cars.over[0]:
            self._why_not = checks.ENDED
        if self.render_mode == "human":
            self.render()
        return (cars.observations()[0], float(cars.reward[0]), bool(cars.lost[0]),
                bool(cars.over[0]), cars.told(0))

    def _check(self, ended: bool = False) -> None:
        """Refuse what is not possible now; `ended`: an ended episode is no reason.

        Raises:
            LPVMPCError: Why not.
        """
        if self._why_not and not (ended and self._why_not == checks.ENDED):
            raise LPVMPCError(self._why_not)

    def sight(self, steps: int) -> tuple[State, Preview]:
        """What a controller with a preview of so many periods is given now."""
        self._check(ended=True)
        return self.cars.sight(0, steps)

    def render(self) -> npt.NDArray[np.uint8] | None:  # type: ignore[override]
        """A picture, shape (height, width, 3), or None in the window of "human"."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() of an environment without render_mode draws nothing.")
            return None
        self._check(ended=True)
        cars = self.cars
        number = int(cars.road[0])
        path = cars.roads.scenarios[number].path
        return self._window.draw(number, path, cars.qpos[0], cars.states[0], cars.drawn(0))

    def close(self) -> None:
        """Give window and OpenGL back."""
        self._window.close()
        self._why_not = checks.CLOSED
