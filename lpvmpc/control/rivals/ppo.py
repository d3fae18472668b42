"""A driver that was learned: a small network from what is seen to what is commanded.

    action = clip(W3 tanh(W2 tanh(W1 o + b1) + b2) + b3, -1, 1),   o = observation / scale

`o` is what `observation.TABLE` lists, the action steering and acceleration. The weights were found
by proximal policy optimisation in `TrackVec-v0` (`eval/learn.py`); here NumPy alone evaluates
the mean of the policy, with no noise and no library of learning.

It knows no bound but those of its action, plans nothing, estimates nothing, and has no fallback:
where training never took it, nothing says what it does.

Source: Schulman et al., Proximal policy optimization algorithms, arXiv:1707.06347 (2017).
"""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.rivals.observation import (
    SCALES,
    SIZE,
    STEPS,
    TABLE,
    action_of,
    command_of,
    observe,
)
from lpvmpc.errors import DataError
from lpvmpc.interface import Command, Preview, State
from lpvmpc.kit import safetensors
from lpvmpc.units import Array

SHIPPED = Path(str(resources.files("lpvmpc.control.rivals"))) / "weights" / "ppo.safetensors"
"""The policy that ships: what `eval/learn.py` makes of its defaults."""
LAYERS = ("0", "1", "2")
"""Names of the layers: `w0`, `b0` and so on."""


class PPO:
    """The learned driver."""

    name = "ppo"
    preview_steps = STEPS
    Ts = 0.033

    def __init__(self, car: VehicleParams, *, file: str | os.PathLike[str] = SHIPPED) -> None:
        """Read a policy.

        Args:
            car: Vehicle parameters; of these it uses the largest steering angle alone.
            file: Policy as `eval/learn.py` writes it (default: the one that ships).

        Raises:
            DataError: The file is missing, damaged, or holds no policy for these observations.
        """
        self.delta_max = car.delta_max
        path = Path(file)
        arrays, told = safetensors.read(path)
        try:
            self.layers = [
                (arrays[f"w{i}"].astype(np.float64), arrays[f"b{i}"].astype(np.float64))
                for i in LAYERS
            ]
        except KeyError as error:
            raise DataError(f"{path} holds no policy: there is no array {error}.") from None
        sizes = [SIZE, *(w.shape[0] for w, _ in self.layers)]
        fits = all(w.shape[1:] == (size,) and b.shape == (w.shape[0],)
                   for size, (w, b) in zip(sizes, self.layers, strict=False))
        if told.get("observation") != names() or not fits or sizes[-1] != 2:
            raise DataError(f"{path} holds a policy of other observations or actions than ours.")
        self.last: Array = np.zeros(2)
        self._first = True

    def reset(self, rng: np.random.Generator) -> None:
        """Forget the last run."""
        self._first = True

    def command(self, state: State, preview: Preview) -> Command:
        """The policy's mean for what is seen."""
        if self._first:  # in training a car begins with what holds it; here that is not told
            self.last = action_of(Command(state.delta, 0.0), self.delta_max)
            self._first = False
        self.last = self.act(observe(state, preview, self.last))
        return command_of(self.last, self.delta_max)

    def act(self, observation: npt.NDArray[np.floating]) -> Array:
        """Action of an observation in SI units, shape (..., SIZE) to (..., 2)."""
        x = observation / SCALES
        for w, b in self.layers[:-1]:
            x = np.tanh(x @ w.T + b)
        w, b = self.layers[-1]
        action: Array = np.clip(x @ w.T + b, -1.0, 1.0)
        return action


def names() -> str:
    """The observations in order, as the file of a policy names them."""
    return " ".join(entry.name for entry in TABLE)
