"""Learn a driver by proximal policy optimisation in `TrackVec-v0`, with stable-baselines3.

The policy is a network of two hidden layers of 64 with tanh, from the scaled observation to the
action; nothing of the package's controllers is in it. The same seed on the same versions gives the
same bytes: torch has one thread, and the physics is the same for any number of threads.

    python eval/learn.py --seed 1 --out runs/ppo.safetensors
    python eval/learn.py --card

Exit codes: 0 learned; 2 bad input; 130 interrupted, nothing saved.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.control.rivals.observation import SCALES
from lpvmpc.control.rivals.ppo import names
from lpvmpc.errors import DataError, LPVMPCError, OptionError
from lpvmpc.gym.cars import Setting
from lpvmpc.gym.track_vec import TrackVecEnv
from lpvmpc.kit import cli, safetensors
from lpvmpc.kit.provenance import versions, versions_of

Progress = Callable[[int, float, float], None]
"""Called after each update with control periods driven, mean reward a period, and minutes."""


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Everything that decides what is learned."""

    steps: int = 2_400_000
    """Control periods driven by all cars together."""
    seed: int = 0
    """Seed of network, noise, roads and worlds."""
    cars: int = 64
    """Cars at once."""
    horizon: int = 32
    """Periods that each drives between two updates."""
    minibatch: int = 256
    """Samples of a gradient step."""
    epochs: int = 10
    """Times that each sample is used."""
    rate: float = 5e-4
    """Learning rate at the start; it falls linearly to a tenth."""
    gamma: float = 0.98
    """Discount a period."""
    log_std: float = -1.7
    """Logarithm of the first noise on the actions."""
    worlds: tuple[str, ...] = ("ideal", "rtk", "fleet", "fleet")
    """Worlds of the episodes, each as likely as the next."""
    max_steps: int = 400
    """Longest episode [periods]."""


def learn(recipe: Recipe, progress: Progress | None = None, threads: int = 2) -> dict[str, Any]:
    """Train a policy.

    Args:
        recipe: What and how.
        progress: See `Progress`.
        threads: Threads of the physics.

    Returns:
        Its arrays by name, as `ppo.PPO` reads them, and the curve under "curve": rows of periods
        and mean reward.

    Raises:
        LPVMPCError: stable-baselines3 is not installed.
    """
    try:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.callbacks import BaseCallback

        from lpvmpc.gym.sb3 import Adapter
    except ImportError as error:
        raise LPVMPCError(
            f"Learning needs {error.name}; install it with: pip install 'lpvmpc[rl]'."
        ) from None
    torch.set_num_threads(1)
    setting = Setting(worlds=recipe.worlds, max_steps=recipe.max_steps)
    env = TrackVecEnv(recipe.cars, threads=threads, autoreset_mode="SameStep", **asdict(setting))
    adapter = Adapter(env, SCALES)
    model = PPO(
        "MlpPolicy", adapter, seed=recipe.seed, n_steps=recipe.horizon, device="cpu",
        batch_size=recipe.minibatch, n_epochs=recipe.epochs, gamma=recipe.gamma, gae_lambda=0.95,
        learning_rate=lambda left: recipe.rate * (0.1 + 0.9 * left), ent_coef=0.0,
        policy_kwargs={"log_std_init": recipe.log_std, "net_arch": [64, 64],
                       "activation_fn": torch.nn.Tanh},
    )
    begin, curve = time.monotonic(), []

    class Watch(BaseCallback):
        """Notes the mean reward of each batch of periods."""

        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            mean = adapter.mean_reward()
            curve.append((int(self.num_timesteps), mean))
            if progress is not None:
                progress(int(self.num_timesteps), mean, (time.monotonic() - begin) / 60.0)

    model.learn(total_timesteps=recipe.steps, callback=Watch())
    env.close()
    policy = model.policy
    stack = [policy.mlp_extractor.policy_net[0], policy.mlp_extractor.policy_net[2],
             policy.action_net]
    arrays: dict[str, Any] = {}
    for i, layer in enumerate(stack):
        arrays[f"w{i}"] = layer.weight.detach().numpy().copy()
        arrays[f"b{i}"] = layer.bias.detach().numpy().copy()
    return {**arrays, "curve": np.array(curve)}


def save(file: str | os.PathLike[str], learned: dict[str, Any], recipe: Recipe) -> None:
    """Write a policy with its recipe and versions.

    Raises:
        OutputError: The file cannot be written.
    """
    used = {**versions(), **versions_of(["torch", "stable_baselines3", "gymnasium"])}
    told = {"observation": names(), "recipe": repr(recipe), "versions": repr(used)}
    safetensors.write(file, learned, told)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Learn a driver in the package's worlds."""

    steps: int = Recipe.steps
    """Control periods driven by all cars together."""
    seed: int = 0
    """Seed of everything."""
    threads: int = 2
    """Threads of the physics; they do not change the result."""
    out: Path = Path("runs/ppo.safetensors")
    """File for the policy; its controller takes it as `file`."""
    card: bool = False
    """Drive the shipped policy on roads of no training, and write its card into docs/results,
    instead of learning."""
    policy: Path | None = None
    """With --card, drive this file in place of the shipped policy; the card goes beside it."""
    jobs: int = 0
    """Processes that drive for the card (0: one per core)."""


def main(options: Options) -> int:
    """Learn and save; returns the exit code."""
    cli.check_number("--steps", options.steps, 1, 1_000_000_000)
    cli.check_number("--seed", options.seed, 0, 2**31 - 1)
    cli.check_number("--threads", options.threads, 0, 1024)
    cli.check_number("--jobs", options.jobs, 0, 10_000)
    if options.card:
        return show_card(options)
    if options.policy is not None:
        raise OptionError("--policy", str(options.policy), "left out without --card")
    cli.results_folder(options.out.parent, options.out.name)

    def say(periods: int, reward: float, minutes: float) -> None:
        if sys.stderr.isatty():
            text = f"{periods} periods, mean reward {reward:.3f}, {minutes:.1f} min"
            print(text, file=sys.stderr)

    recipe = Recipe(steps=options.steps, seed=options.seed)
    begin = time.monotonic()
    learned = learn(recipe, say, options.threads)
    save(options.out, learned, recipe)
    minutes, curve = (time.monotonic() - begin) / 60.0, learned["curve"]
    print(f"{int(curve[-1, 0])} periods in {minutes:.1f} min; mean reward of a period from "
          f"{curve[0, 1]:.3f} to {curve[-1, 1]:.3f}.")
    print(f"Saved {options.out}")
    return cli.DONE


def show_card(options: Options) -> int:
    """Drive a policy and write its card; returns the exit code."""
    from lpvmpc.control.rivals.ppo import SHIPPED
    from lpvmpc.gym import card

    file = options.policy or SHIPPED
    folder = Path("docs/results") if options.policy is None else file.parent
    if "curve" not in safetensors.read(file)[0]:  # told before anything is driven
        raise DataError(f"{file} holds no curve of a training, as eval/learn.py writes it.")
    folder = cli.results_folder(folder, "ppo")
    cases = card.drive(file, options.jobs or cli.cores())
    files = card.save(file, cases, folder)
    print("\n".join(card.sentences(cases)))
    print(f"Saved {folder}/ ({', '.join(one.name for one in files)})")
    return cli.DONE
