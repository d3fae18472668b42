"""An expert's driving as data: what was seen, what the expert did, for imitation."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import numpy.typing as npt

from lpvmpc.control.rivals.observation import action_of
from lpvmpc.errors import OptionError
from lpvmpc.gym.cars import Cars, setting_of
from lpvmpc.interface import declared
from lpvmpc.kit.files import write_table
from lpvmpc.sim.names import load_controller


def demonstrate(
    steps: int, *, controller: str = "lpv-mpc", seed: int = 0, noise: float = 0.0,
    out: str | os.PathLike[str] | None = None, **setting: Any
) -> dict[str, npt.NDArray[Any]]:
    """Have a controller drive episodes of `Track-v0`, and keep what it saw and did.

    It is given the same state and road as the policy: the estimate in a world with sensors.

    Args:
        steps: Control periods to record.
        controller: Name of a controller, or module:Class.
        seed: Seed of everything.
        noise: Standard deviation of what is added to its action before the car gets it; the
            action that is recorded is without. So data hold how to come back.
        out: File to write as Parquet besides: a column for each entry of the observation, under its
            name, then action_steering, action_acceleration and the rest as returned; controller,
            seed and noise in the metadata.
        setting: Fields of `cars.Setting`.

    Returns:
        Arrays of `steps` rows: `observations` (SIZE, and 4 more in traffic), `actions` (2),
        `rewards`, `terminated`, `truncated`, and `episode`, counted from 0.

    Raises:
        OptionError: Steps or noise outside their domain.
        OutputError: The file cannot be written.
    """
    if type(steps) is not int or steps < 1:
        raise OptionError("steps", steps, "a whole number from 1")
    if not 0.0 <= noise <= 1.0:
        raise OptionError("noise", noise, "from 0 to 1")
    expert = load_controller(controller)
    about = declared(expert)
    rng = np.random.default_rng(seed)
    cars = Cars(1, setting_of(setting), threads=1)
    found: dict[str, npt.NDArray[Any]] = {
        "observations": np.zeros((steps, len(cars.entries)), dtype=np.float32),
        "actions": np.zeros((steps, 2), dtype=np.float32),
        "rewards": np.zeros(steps),
        "terminated": np.zeros(steps, dtype=bool),
        "truncated": np.zeros(steps, dtype=bool),
        "episode": np.zeros(steps, dtype=np.int64),
    }
    episode, ended = -1, True
    for k in range(steps):
        if ended:
            episode += 1
            cars.reset([0], [rng])
            expert.reset(np.random.default_rng([seed, episode]))
        state, preview = cars.sight(0, about.preview_steps)
        action = action_of(expert.command(state, preview), cars.delta_max)
        found["observations"][k], found["actions"][k] = cars.observations()[0], action
        cars.step(np.clip(action + noise * rng.standard_normal(2), -1.0, 1.0)[None, :])
        found["rewards"][k], found["episode"][k] = cars.reward[0], episode
        found["terminated"][k], found["truncated"][k] = cars.lost[0], cars.over[0]
        ended = bool(cars.lost[0] or cars.over[0])
    if out is not None:
        columns: dict[str, npt.NDArray[Any]] = {
            entry.name: found["observations"][:, i] for i, entry in enumerate(cars.entries)
        }
        for i, name in enumerate(("action_steering", "action_acceleration")):
            columns[name] = found["actions"][:, i]
        columns.update({name: found[name] for name in found if found[name].ndim == 1})
        write_table(out, columns, {"controller": controller, "seed": seed, "noise": noise})
    return found
