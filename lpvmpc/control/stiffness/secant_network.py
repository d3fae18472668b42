"""The paper's network: secant stiffness of both axles from (vx, vy, delta, ax, r), by numba."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from lpvmpc.car import bicycle
from lpvmpc.car.bicycle import DELTA, VX, VY, A, R
from lpvmpc.car.params import VehicleParams
from lpvmpc.control.stiffness.network import SLOPE_MAX, SLOPE_MIN, longitudinal
from lpvmpc.control.stiffness.network_file import SECANT_SIZES, Weights, load_weights
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.interface import State
from lpvmpc.units import Array


def packed(weights: Weights, car: VehicleParams) -> Array:
    """All numbers of the network in one array, which a compiled function takes at once.

    Ranges, means and deviations of the inputs (4 times 5), means and deviations of the outputs (2
    times 2), nominal stiffness (2), then W and b of each layer.
    """
    names = ["x_low", "x_high", "x_mean", "x_std", "y_mean", "y_std"]
    parts = [weights.arrays[name] for name in names] + [np.array([car.Cf, car.Cr])]
    parts += [weights.arrays[f"{name}{i}"] for i in range(5) for name in ("W", "b")]
    return np.concatenate([np.ravel(part).astype(np.float64) for part in parts])


@njit(cache=True)
def secant(x, net, h, g, out):
    """Secant stiffness of both axles from one sample of the paper's inputs, in place.

    Sigmoid layers and a linear output. Inputs are clamped to the trained range, outputs to
    SLOPE_MIN and SLOPE_MAX of the nominal stiffness.

    Args:
        x: (vx, vy, delta, ax, r), shape (5,).
        net: See `packed`.
        h: Scratch, as wide as the widest layer.
        g: Scratch, as h.
        out: Receives Cf, Cr [N/rad], shape (2,).

    Returns:
        Number of clamped inputs.
    """
    clamped = 0
    for i in range(5):
        value = min(max(x[i], net[i]), net[5 + i])
        clamped += value != x[i]
        h[i] = (value - net[10 + i]) / net[15 + i]
    at = 26
    for layer in range(5):
        n, m = SECANT_SIZES[layer], SECANT_SIZES[layer + 1]
        for i in range(m):
            total = net[at + n * m + i]
            for j in range(n):
                total += net[at + i * n + j] * h[j]
            g[i] = total if layer == 4 else 1.0 / (1.0 + math.exp(-total))
        for i in range(m):
            h[i] = g[i]
        at += n * m + m
    for i in range(2):
        nominal = net[24 + i]
        C = net[20 + i] + net[22 + i] * h[i]
        out[i] = min(max(C, SLOPE_MIN * nominal), SLOPE_MAX * nominal)
    return clamped


@njit(cache=True)
def secant_along(
    x, Ts, constants, m_eff, drive_front, brake_front, inertia, net, sample, h, g, pair, tires
):
    """Secant stiffness in the middle of each interval of a prediction, in place; see `along`."""
    clamped = 0
    car = bicycle.unpack(constants)
    for k in range(tires.shape[0]):
        vx = max(0.5 * (x[k, VX] + x[k + 1, VX]), car.vx_min)
        r, delta = 0.5 * (x[k, R] + x[k + 1, R]), 0.5 * (x[k, DELTA] + x[k + 1, DELTA])
        ay = vx * r + (x[k + 1, VY] - x[k, VY]) / Ts
        a = 0.5 * (x[k, A] + x[k + 1, A])
        ax, _, _ = longitudinal(
            a, vx, delta, ay, car, m_eff, drive_front, brake_front, inertia
        )
        sample[0], sample[1] = vx, 0.5 * (x[k, VY] + x[k + 1, VY])
        sample[2], sample[3], sample[4] = delta, ax, r
        clamped += secant(sample, net, h, g, pair)
        tires[k, 0], tires[k, 1], tires[k, 2], tires[k, 3] = pair[0], 0.0, pair[1], 0.0
    return clamped


class SecantNetwork:
    """Stiffness model `network-secant`: the paper's network, F0 = 0."""

    name = "network-secant"

    def __init__(
        self,
        car: VehicleParams,
        weights: Weights | None = None,
        *,
        Ts: float = 0.033,
    ) -> None:
        """Args: as of `NetworkTire`."""
        weights = load_weights("network-secant") if weights is None else weights
        if weights.kind != "network-secant":
            raise OptionError("weights", weights.kind, "weights of a 'network-secant'")
        self.weights = weights
        self.net = packed(weights, car)
        self._constants = np.array(bicycle.Bicycle.of(car))
        self.Ts = Ts
        self._spin = (
            car.m_eff, car.drive_front, car.brake_front, 2.0 * car.J_w / car.R_w**2
        )
        widest = max(SECANT_SIZES)
        self._scratch = (np.zeros(5), np.zeros(widest), np.zeros(widest), np.zeros(2))
        self.reset()

    def reset(self) -> None:
        """Forget the run so far."""
        self.clamped = 0
        """Number of inputs that lay outside the trained range since the last reset."""

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `stiffness.StiffnessModel.horizon`."""
        self.clamped += secant_along(
            prediction, self.Ts, self._constants, *self._spin, self.net, *self._scratch, tires
        )

    def sample(
        self, vx: float, vy: float, delta: float, ax: float, r: float
    ) -> tuple[float, float]:
        """Secant stiffness Cf, Cr [N/rad] of one sample."""
        x, h, g, pair = self._scratch
        x[0], x[1], x[2], x[3], x[4] = vx, vy, delta, ax, r
        if not math.isfinite(vx + vy + delta + ax + r):
            raise LPVMPCError(f"An input of the network is not finite: {x.tolist()}.")
        self.clamped += secant(x, self.net, h, g, pair)
        return float(pair[0]), float(pair[1])

    def stiffness(self, inputs: npt.ArrayLike) -> Array:
        """Secant stiffness (Cf, Cr) [N/rad] of samples (vx, vy, delta, ax, r), shape (n, 5)."""
        samples = np.ascontiguousarray(np.atleast_2d(np.asarray(inputs, np.float64)))
        if samples.shape[1] != 5 or not np.isfinite(samples).all():
            raise LPVMPCError("The inputs of the network must be finite, of shape (n, 5).")
        out = np.empty((len(samples), 2))
        _, h, g, _ = self._scratch
        for sample, pair in zip(samples, out, strict=True):
            self.clamped += secant(sample, self.net, h, g, pair)
        return out
