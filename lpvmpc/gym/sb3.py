"""`TrackVec-v0` as stable-baselines3 wants its vector environments, observations scaled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv

from lpvmpc.gym.track_vec import TrackVecEnv
from lpvmpc.units import Array


class Adapter(VecEnv):  # type: ignore[misc]
    """Episodes that end begin anew in the same step, as the library expects."""

    def __init__(self, env: TrackVecEnv, scales: Array) -> None:
        """Args: the cars, with `autoreset_mode` SAME_STEP; what observations are divided by."""
        self.env, self.scales = env, scales.astype(np.float32)
        own = env.single_observation_space
        assert isinstance(own, spaces.Box)
        seen = spaces.Box(own.low / self.scales, own.high / self.scales, dtype=np.float32)
        self._actions: Any = None
        self._rewards: list[float] = []
        super().__init__(env.num_envs, seen, env.single_action_space)

    def reset(self) -> Any:
        """Begin everywhere; the seeds of `seed` are those of the episodes."""
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        found, _ = self.env.reset(seed=None if seeds is None else list(seeds))
        self._reset_seeds()
        return found / self.scales

    def step_async(self, actions: Any) -> None:
        """Note the actions."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Drive one period."""
        found, reward, lost, over, info = self.env.step(self._actions)
        self._rewards.append(float(reward.mean()))
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(lost | over):
            infos[i] = {"terminal_observation": info["final_obs"][i] / self.scales,
                        "TimeLimit.truncated": bool(over[i])}
        return found / self.scales, reward.astype(np.float32), lost | over, infos

    def mean_reward(self) -> float:
        """Mean reward of a period since the last call."""
        mean = float(np.mean(self._rewards))
        self._rewards.clear()
        return mean

    def close(self) -> None:
        """Close the cars."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the cars, the same for each."""
        return [getattr(self.env, attr_name, None) for _ in self._numbers(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set one."""
        setattr(self.env, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> Any:
        """No method of a single car can be called."""
        raise NotImplementedError(f"A car of TrackVec-v0 has no method of its own ({method_name}).")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Nothing is wrapped."""
        return [False for _ in self._numbers(indices)]

    def _numbers(self, indices: Any) -> Sequence[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else list(indices)
