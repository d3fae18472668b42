"""Training of the two networks with torch: many splits and seeds side by side.

Runs of one manoeuvre are time series: neighbouring samples are almost equal, and a random split
leaks. So one network is trained with whole runs held out (this one is kept), one with each kind of
manoeuvre held out, and one with the random split, for each seed. They share every step as one batch
of matrices, since such small networks cost overhead, not arithmetic.

What is random depends on (seed, split, epoch) alone, and the optimiser is plain arrays: training
that was interrupted continues to the same bytes.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.stiffness import network_file
from lpvmpc.errors import DataError, LPVMPCError, OptionError
from lpvmpc.kit import safetensors
from lpvmpc.learn.dataset import Dataset
from lpvmpc.learn.families import Family, ForceFamily, Mask, Preset, SecantFamily, as_tensor
from lpvmpc.units import Array

HELD_OUT = 0.25
"""Share of the runs, or of the samples in the random split, that is held out."""
KEEP_EVERY = 10.0
"""Longest time between two checkpoints, from the first epoch that ends after it [s]."""
BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8
"""Constants of Adam."""


PRESETS = {
    "default": Preset(kind="network", epochs=300, batch=256, rate=1e-2, cycle=True),
    "paper": Preset(kind="network-secant", epochs=2500, batch=64, rate=5e-4, cycle=False),
}
"""Ours, and the paper's: 5-16-28-16-9-2 sigmoid, linear output, Adam."""


# Splits ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Split:
    """Which samples train, and which test."""

    name: str
    """`runs`, `random`, or `without KIND`."""
    train: Mask
    """Training samples, shape (n,); the others test."""


def splits(data: Dataset, seed: int) -> list[Split]:
    """Runs held out (of every kind a quarter, at least one), random, and each kind held out.

    Raises:
        DataError: A kind has a single run, or there is a single kind.
    """
    rng = np.random.default_rng([seed, 1])
    run, kind = data["run"], data["manoeuvre"]
    held: list[int] = []
    for name in data.kinds:
        runs = np.unique(run[kind == name])
        if len(runs) < 2:
            raise DataError(
                f"The data have {len(runs)} run of the kind {name}, but at least 2 are needed to "
                "hold runs out; collect more samples."
            )
        count = max(1, round(HELD_OUT * len(runs)))
        held.extend(rng.permutation(runs)[:count])
    if len(data.kinds) < 2:
        raise DataError(
            f"The data have one kind of manoeuvre only, {data.kinds[0]}, but at least 2 are "
            "needed to hold one out."
        )
    found = [Split("runs", ~np.isin(run, held))]
    found.append(Split("random", rng.random(len(data)) >= HELD_OUT))
    found += [Split(f"without {name}", kind != name) for name in data.kinds]
    return found


# Training ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Trained:
    """What training gives."""

    names: list[tuple[int, Split]]
    """Seed and split of each network; the first is the one to keep."""
    weights: list[network_file.Weights]
    """Each network, without metadata."""
    curve: Array
    """Epoch, loss on training and on held-out samples of the first network, shape (k, 3)."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """What to train."""

    preset: Preset
    """How."""
    seeds: tuple[int, ...] = (0,)
    """Seeds; the first one's network is kept."""
    only: tuple[str, ...] = ()
    """Names of the splits (default: all)."""

    def __post_init__(self) -> None:
        """Refuse what cannot be trained."""
        if not 1 <= self.preset.epochs <= 1_000_000:
            raise OptionError("epochs", self.preset.epochs, "a whole number from 1 to 1000000")
        if not self.seeds or any(not 0 <= seed < 2**63 for seed in self.seeds):
            raise OptionError("seeds", self.seeds, "whole numbers from 0")


def preset(name: str, epochs: int | None = None) -> Preset:
    """A preset by name, perhaps with another number of epochs."""
    found = PRESETS[name]
    return found if epochs is None else replace(found, epochs=epochs)


def train(
    data: Dataset,
    job: Job,
    car: VehicleParams,
    *,
    checkpoint: Path | None = None,
    resume: bool = False,
    progress: Callable[[int, float], None] | None = None,
) -> Trained:
    """Train one network per seed and split.

    Args:
        data: Stiffness data.
        job: What to train.
        car: The car that the data are of.
        checkpoint: File for the state of training, written now and then and after an interrupt.
        resume: Go on from that file, where there is one.
        progress: Called after each epoch with its number and the first network's loss.

    Raises:
        DataError: Too few runs to split, or a checkpoint of another training.
        LPVMPCError: The loss is not finite any more.
    """
    torch.set_num_threads(1)  # such small matrices gain nothing from more
    how = job.preset
    names = [(s, split) for s in job.seeds for split in splits(data, s)]
    names = [(s, split) for s, split in names if not job.only or split.name in job.only]
    masks = [split.train for _, split in names]
    family: Family = (
        SecantFamily(data, masks)
        if how.kind == "network-secant"
        else ForceFamily(data, masks, car, how)
    )
    steps = max(min(int(mask.sum()) for mask in masks) // how.batch, 1)
    batch = min(how.batch, min(int(mask.sum()) for mask in masks))
    start = [family.start(np.random.default_rng([s, 2])) for s, _ in names]
    state = _State(as_tensor(np.array(start)))
    facts = _facts(data, job, [f"{s} {split.name}" for s, split in names])
    if resume and checkpoint is not None and checkpoint.is_file():
        state.read(checkpoint, facts)
    held_out = torch.tensor(np.flatnonzero(~masks[0]))[None]
    before, written = state.copy(), time.monotonic()
    try:
        while state.epoch < how.epochs:
            drawn = [_draw(s, i, state.epoch, masks[i], steps, batch)
                     for i, (s, _) in enumerate(names)]
            order = torch.tensor(np.stack(drawn, axis=1))  # (steps, M, batch)
            losses = []
            for k in range(steps):
                position = (state.epoch * steps + k + 1) / (how.epochs * steps)
                rate = how.rate * (_cycle(position) if how.cycle else 1.0)
                losses.append(state.step(family, order[k], rate))
            mean = torch.stack(losses).mean(dim=0)
            if not torch.isfinite(mean).all():
                raise LPVMPCError(f"Training diverged in epoch {state.epoch}: the loss is NaN.")
            state.epoch += 1
            if state.epoch % max(how.epochs // 200, 1) == 0 or state.epoch == how.epochs:
                with torch.no_grad():
                    test = (
                        family.loss(state.parameters[:1], held_out)
                        if len(names) == 1
                        else (_first_only(family, state.parameters, held_out))
                    )
                state.curve.append((state.epoch, float(mean[0]), float(test[0])))
            before = state.copy()
            due = state.epoch % max(how.epochs // 50, 1) == 0
            if checkpoint is not None and (due or time.monotonic() - written > KEEP_EVERY):
                before.write(checkpoint, facts)
                written = time.monotonic()
            if progress is not None:
                progress(state.epoch, float(mean[0]))
    except KeyboardInterrupt:
        if checkpoint is not None:
            before.write(checkpoint, facts)  # the last whole epoch, the first ones too
        raise
    found = state.parameters.detach().numpy().astype(np.float64)
    weights = [
        network_file.Weights(how.kind, family.weights(i, row), {}) for i, row in enumerate(found)
    ]
    return Trained(names, weights, np.array(state.curve))


def _first_only(family: Family, parameters: Tensor, samples: Tensor) -> Tensor:
    """Loss of the first network; the others get the same samples, which costs little."""
    some = samples[:, :: max(samples.shape[1] // 512, 1)]
    return family.loss(parameters, some.expand(len(parameters), -1))


def _draw(seed: int, i: int, epoch: int, mask: Mask, steps: int, batch: int) -> npt.NDArray[Any]:
    """Mini-batches of one epoch, shape (steps, batch)."""
    order = np.random.default_rng([seed, 3, i, epoch]).permutation(np.flatnonzero(mask))
    return order[: steps * batch].reshape(steps, batch)


def _cycle(position: float) -> float:
    """Learning rate over training, from 0 up to 1 at a tenth and down to 0, in half cosines."""
    if position < 0.1:
        return 0.5 - 0.48 * math.cos(math.pi * position / 0.1)
    return 0.5 + 0.5 * math.cos(math.pi * (position - 0.1) / 0.9) + 1e-4


def _facts(data: Dataset, job: Job, names: list[str]) -> dict[str, str]:
    """What a checkpoint must agree with."""
    return {
        "data_sha256": data.sha256,
        "preset": repr(job.preset),
        "networks": json.dumps(names),
    }


class _State:
    """Parameters and Adam's moments, all of shape (M, size)."""

    def __init__(self, parameters: Tensor):
        self.parameters = parameters.requires_grad_()
        self.first, self.second = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self.epoch, self.steps = 0, 0
        self.curve: list[tuple[float, float, float]] = []

    def copy(self) -> _State:
        """The same, in memory of its own."""
        other = _State(self.parameters.detach().clone())
        other.first, other.second = self.first.clone(), self.second.clone()
        other.epoch, other.steps, other.curve = self.epoch, self.steps, list(self.curve)
        return other

    def step(self, family: Family, samples: Tensor, rate: float) -> Tensor:
        """One step of Adam; returns the losses before it, shape (M,)."""
        losses = family.loss(self.parameters, samples)
        (gradient,) = torch.autograd.grad(losses.sum(), self.parameters)
        self.steps += 1
        with torch.no_grad():
            self.first.lerp_(gradient, 1.0 - BETA1)
            self.second.lerp_(gradient * gradient, 1.0 - BETA2)
            size = rate / (1.0 - BETA1**self.steps)
            scale = math.sqrt(1.0 - BETA2**self.steps)
            self.parameters -= size * self.first / (self.second.sqrt() / scale + EPSILON)
        return losses.detach()

    def write(self, file: Path, facts: dict[str, str]) -> None:
        """Save everything that decides how training goes on."""
        arrays = {
            "parameters": self.parameters.detach().numpy(),
            "first": self.first.numpy(),
            "second": self.second.numpy(),
            "curve": np.array(self.curve, dtype=np.float64).reshape(-1, 3),
            "progress": np.array([self.epoch, self.steps], dtype=np.int64),
        }
        safetensors.write(file, arrays, facts)

    def read(self, file: Path, facts: dict[str, str]) -> None:
        """Go on from a saved state.

        Raises:
            DataError: It is damaged, or belongs to another training.
        """
        arrays, left = safetensors.read(file)
        if safetensors.SHA256 not in left:
            raise DataError(f"The checkpoint {os.fspath(file)!r} is damaged: it has no checksum.")
        for key, value in facts.items():
            if left.get(key) != value:
                raise DataError(
                    f"The unfinished training in {os.fspath(file)!r} has another {key}; give the "
                    "same options and data, or start without --resume."
                )
        try:
            for name in ("parameters", "first", "second"):
                mine = getattr(self, name)
                if arrays[name].shape != tuple(mine.shape):
                    raise KeyError(name)
                with torch.no_grad():
                    mine.copy_(torch.from_numpy(arrays[name]))
            self.epoch, self.steps = (int(value) for value in arrays["progress"])
            self.curve = [tuple(row) for row in arrays["curve"]]
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(f"The checkpoint {os.fspath(file)!r} is damaged.") from error
