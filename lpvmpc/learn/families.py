"""Families of networks in training: M networks of one kind, the rows of one tensor."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.stiffness import network
from lpvmpc.control.stiffness.network_file import N_EVEN, SECANT_INPUTS, SECANT_SIZES
from lpvmpc.learn.dataset import Dataset, samples_of
from lpvmpc.units import Array

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Preset:
    """How a network is trained."""

    kind: str
    """`network` or `network-secant`."""
    epochs: int
    """Passes through the training data."""
    batch: int
    """Samples per step."""
    rate: float
    """Learning rate; its peak where it rises and falls."""
    cycle: bool
    """Whether the rate rises over the first tenth and falls to zero, as half cosines."""
    units: int = 8
    """Hidden units per axle of `network`."""
    slope_weight: float = 0.1
    """Weight of the error of the local slope beside that of the force, for `network`."""


class Family(Protocol):
    """M networks of one kind, whose parameters are the rows of one tensor."""

    size: int
    """Number of parameters of one network."""

    def start(self, rng: np.random.Generator) -> Array:
        """Random parameters of one network, shape (size,)."""

    def loss(self, parameters: Tensor, samples: Tensor) -> Tensor:
        """Mean loss of each network on its samples: (M, size), (M, batch) -> (M,)."""

    def weights(self, i: int, parameters: Array) -> dict[str, npt.NDArray[Any]]:
        """Arrays of network i for a weights file."""


def _scaling(values: Array, masks: list[Mask]) -> tuple[Array, Array]:
    """Mean and standard deviation over each mask, shape (M, ...) each."""
    mean = np.array([values[m].mean(axis=0) for m in masks])
    std = np.array([values[m].std(axis=0) for m in masks])
    return mean, np.maximum(std, 1e-9)


def as_tensor(values: npt.ArrayLike) -> Tensor:
    """Values in single precision, as the networks are trained."""
    return torch.tensor(np.asarray(values), dtype=torch.float32)


class SecantFamily:
    """The paper's networks: standardised inputs to standardised secant stiffness."""

    def __init__(self, data: Dataset, masks: list[Mask]):
        x = np.column_stack([data[name] for name in SECANT_INPUTS])
        y = np.column_stack([data["Cf_Nprad"], data["Cr_Nprad"]])
        self.x_mean, self.x_std = _scaling(x, masks)
        self.y_mean, self.y_std = _scaling(y, masks)
        self.range = [(x[m].min(axis=0), x[m].max(axis=0)) for m in masks]
        self._x, self._y = as_tensor(x), as_tensor(y)
        self._scale = [as_tensor(a)[:, None] for a in (self.x_mean, self.x_std)]
        self._target = [as_tensor(a)[:, None] for a in (self.y_mean, self.y_std)]
        self._shapes = list(zip(SECANT_SIZES[:-1], SECANT_SIZES[1:], strict=True))
        self.size = sum(n * m + m for n, m in self._shapes)

    def start(self, rng: np.random.Generator) -> Array:
        """Glorot uniform weights and zero biases, as Keras does."""
        parts = []
        for n, m in self._shapes:
            limit = math.sqrt(6.0 / (n + m))
            parts += [rng.uniform(-limit, limit, n * m), np.zeros(m)]
        return np.concatenate(parts)

    def _layers(self, p: Any) -> list[tuple[Any, Any]]:
        """Weights (..., n, m) and biases (..., 1, m) of each layer."""
        layers, at = [], 0
        for n, m in self._shapes:
            W, b = p[..., at : at + n * m], p[..., at + n * m : at + n * m + m]
            layers.append((W.reshape(*W.shape[:-1], n, m), b.reshape(*b.shape[:-1], 1, m)))
            at += n * m + m
        return layers

    def loss(self, parameters: Tensor, samples: Tensor) -> Tensor:
        """Mean square error of the standardised stiffness."""
        h = (self._x[samples] - self._scale[0]) / self._scale[1]
        layers = self._layers(parameters)
        for i, (W, b) in enumerate(layers):
            h = torch.baddbmm(b, h, W)
            if i < len(layers) - 1:
                h = torch.sigmoid(h)
        y = (self._y[samples] - self._target[0]) / self._target[1]
        return (h - y).square().mean(dim=(1, 2))

    def weights(self, i: int, parameters: Array) -> dict[str, npt.NDArray[Any]]:
        """See `Family`."""
        arrays = {}
        for k, (W, b) in enumerate(self._layers(parameters)):
            arrays[f"W{k}"], arrays[f"b{k}"] = np.ascontiguousarray(W.T), b[0]
        arrays["x_low"], arrays["x_high"] = self.range[i]
        for name in ("x_mean", "x_std", "y_mean", "y_std"):
            arrays[name] = getattr(self, name)[i]
        return {name: np.asarray(a, np.float32) for name, a in arrays.items()}


class ForceFamily:
    """Our networks: dimensionless force and slope of both axles; see network.py."""

    def __init__(self, data: Dataset, masks: list[Mask], car: VehicleParams, preset: Preset):
        n = len(data)
        args = samples_of(data, car)
        s, D, z = np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2, N_EVEN))
        for k in range(n):
            for i in range(2):
                s[k, i], D[k, i] = network.features(
                    args["alpha"][k, i], args["Fx"][k, i], args["ax"][k], args["roll"][k],
                    args["friction"][k], args["norms"][k, i], z[k, i],
                )
        y = np.column_stack([data["Fyf_N"], data["Fyr_N"]]) / D
        slope = np.column_stack([data["slope_f_Nprad"], data["slope_r_Nprad"]])
        slope /= args["norms"][:, :, network.C0]
        self.mean, self.std = _scaling(z, masks)
        self.low = [z[m].min(axis=0) for m in masks]
        for low in self.low:  # of squares, whose roots the data have on both sides of zero
            low[:, :2] = 0.0
        self.high = [z[m].max(axis=0) for m in masks]
        self.slip_max = [np.abs(s[m]).max(axis=0) for m in masks]
        self._s, self._z, self._y, self._slope = map(as_tensor, (s, z, y, slope))
        self._scale = [as_tensor(a)[:, None] for a in (self.mean, self.std)]
        self.units, self.slope_weight = preset.units, preset.slope_weight
        self.size = 2 * self.units * (3 + N_EVEN)

    def start(self, rng: np.random.Generator) -> Array:
        """Parameters u, b, w and V of both axles, normally distributed."""
        n = 2 * self.units
        parts = [(n, 1.0), (n, 0.5), (n, 0.3), (n * N_EVEN, 0.3)]
        return np.concatenate([scale * rng.standard_normal(count) for count, scale in parts])

    def _parts(self, p: Any) -> tuple[Any, Any, Any, Any]:
        """u, b, w of shape (..., 2, units) and V of shape (..., 2, units, N_EVEN)."""
        n, lead = 2 * self.units, p.shape[:-1]
        u, b, w = (p[..., i * n : (i + 1) * n].reshape(*lead, 2, self.units) for i in range(3))
        return u, b, w, p[..., 3 * n :].reshape(*lead, 2, self.units, N_EVEN)

    def loss(self, parameters: Tensor, samples: Tensor) -> Tensor:
        """Squared errors of the force, weighted like its secant, and of the slope."""
        u, b, w, V = (part.unsqueeze(1) for part in self._parts(parameters))  # (M, 1, 2, units)
        s = self._s[samples]  # (M, batch, 2)
        z = (self._z[samples] - self._scale[0]) / self._scale[1]
        e = b + (V * z.unsqueeze(3)).sum(-1)
        q = u * s.unsqueeze(3)
        plus, minus = torch.tanh(e + q), torch.tanh(e - q)
        y = 0.5 * (w * (plus - minus)).sum(-1)
        slope = 0.5 * (w * u * (2.0 - plus * plus - minus * minus)).sum(-1)
        # an error of the force counts like one of the stiffness, but for the smallest slips
        error = (y - self._y[samples]).square() / (s * s + 0.1)
        error = error + self.slope_weight * (slope - self._slope[samples]).square()
        return error.mean(dim=(1, 2))

    def weights(self, i: int, parameters: Array) -> dict[str, npt.NDArray[Any]]:
        """See `Family`; the standardisation goes into V and b."""
        u, b, w, V = self._parts(parameters)
        V = V / self.std[i][:, None]
        b = b - (V * self.mean[i][:, None]).sum(axis=-1)
        arrays = {"u": u, "b": b, "w": w, "V": V, "slip_max": self.slip_max[i]}
        arrays |= {"z_low": self.low[i], "z_high": self.high[i]}
        return {name: np.asarray(a, np.float64) for name, a in arrays.items()}
