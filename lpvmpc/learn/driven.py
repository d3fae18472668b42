"""How well a network tells the tires along a driven lap: from the truth, and from what is known.

R2 on collected data gives a network the car's true slip, forces and friction. A controller has
none of these: it predicts slip from an estimated state, and friction is estimated too. Here a lap
is driven, and what the network says is compared with the car's tires, once from the truth and once
from what the controller had.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lpvmpc.car.bicycle import AF, AR
from lpvmpc.car.tire import forces
from lpvmpc.control.stiffness import network
from lpvmpc.control.stiffness.network_file import SECANT_INPUTS, Weights, load_weights
from lpvmpc.control.stiffness.secant_network import SecantNetwork
from lpvmpc.interface import State
from lpvmpc.learn.dataset import ALPHA_LARGE, secant_stiffness
from lpvmpc.learn.scores import r2
from lpvmpc.plant.mjcf import compile_model, packaged_car, tires
from lpvmpc.plant.plant import Plant
from lpvmpc.sim import batch
from lpvmpc.sim.log import Log
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.names import load_controller
from lpvmpc.units import Array

GIVEN = {
    "truth": "true slip, drive force, roll, mass and friction",
    "dry": "the same, but friction 1",
    "estimated": "the same, but friction as the controller estimated it",
    "controller": "what the controller has: its own slip, forces and friction, true state",
    "rtk": "the same in the world `rtk`: the filter's state, not the true one",
}
"""What `network` can be told along a lap."""
GIVEN_SECANT = {
    "truth": "true vx, vy, delta, ax, r",
    "controller": "the controller's predicted vx, vy, delta, ax, r, true state",
    "rtk": "the same in the world `rtk`",
}
"""What `network-secant` can be told."""


# Labels of a lap ----------------------------------------------------------------------------------


def axle_truth(log: Log) -> tuple[Array, Array, Array]:
    """Slip angle [rad], lateral force [N], slope at zero slip [N/rad] of both axles, shape (n, 2).

    As in the data: an axle's slip angle is that of its wheels, weighted by their loads. By the
    similarity law the slope at zero slip is that of the dry road.
    """
    c, law = log.columns, tires(compile_model(visual=False))
    alpha, Fy, slope = (np.zeros((len(c["t_s"]), 2)) for _ in range(3))
    step = 1e-4  # rad; a central difference over it is exact to 1e-5 of the slope
    for axle, wheels in enumerate((("fl", "fr"), ("rl", "rr"))):
        load = sum(c[f"Fz_{wheel}_N"] for wheel in wheels)
        for wheel in wheels:
            Fz, ratio = c[f"Fz_{wheel}_N"], c[f"slip_ratio_{wheel}"]
            alpha[:, axle] += c[f"slip_angle_{wheel}_rad"] * Fz / load
            Fy[:, axle] += c[f"Fy_{wheel}_N"]
            for k in range(len(Fz)):
                side = [forces(law[axle], ratio[k], np.tan(angle), Fz[k], 1.0)[1]
                        for angle in (step, -step)]
                slope[k, axle] += (side[0] - side[1]) / (2.0 * step)
    return alpha, Fy, slope


def labels(log: Log) -> tuple[Array, Array]:
    """Slip angle [rad] and secant stiffness [N/rad] of both axles, shape (n, 2), from a log."""
    alpha, Fy, slope = axle_truth(log)
    return alpha, secant_stiffness(alpha, Fy, slope)


def said(log: Log, weights: Weights, friction: float | Array = 1.0) -> Array:
    """Secant stiffness that a network gives along a log from the truth [N/rad], shape (n, 2).

    Ours is given the plant's slip angles and drive forces, and a friction.
    """
    car, c = packaged_car(), log.columns
    if weights.kind == "network-secant":
        inputs = [c[name] for name in SECANT_INPUTS]
        return SecantNetwork(car, weights).stiffness(np.column_stack(inputs))
    alpha, _, _ = axle_truth(log)
    n = len(c["t_s"])
    Fx = np.column_stack([c["Fx_fl_N"] + c["Fx_fr_N"], c["Fx_rl_N"] + c["Fx_rr_N"]])
    rate = np.gradient(c["roll_rad"], log.meta["Ts"])
    roll = car.K_phi * c["roll_rad"] + car.C_phi * rate
    norms = np.repeat(network.normalisation(car)[None], n, axis=0)  # (n, 2, numbers)
    Fy, slope, slope_zero = (np.empty((n, 2)) for _ in range(3))
    net = network.NetworkTire(car, weights).net
    mu = np.broadcast_to(np.asarray(friction, dtype=float), (n,)).copy()
    network.forces_of(alpha, Fx, c["ax_mps2"], roll, mu, norms, net, Fy, slope, slope_zero)
    return secant_stiffness(alpha, Fy, slope_zero)


# What the controller had --------------------------------------------------------------------------


class Overheard:
    """A stiffness model whose answers are kept: slip, tangent and friction of every period.

    Everything else that the model may have or lack (`learn`, `friction`) is passed on.
    """

    def __init__(self, model: Any) -> None:
        """Args: the model."""
        self.model, self.name = model, model.name
        self._clear()

    def __getattr__(self, name: str) -> Any:  # what a model may or may not have
        if name == "model":  # not there yet, while a copy is being made
            raise AttributeError(name)
        return getattr(self.model, name)

    def _clear(self) -> None:
        self.rows: list[tuple[float, ...]] = []
        self._last: State | None = None

    def reset(self) -> None:
        """Forget the run so far."""
        self.model.reset()
        self._clear()

    def horizon(self, state: State, prediction: Array, tires: Array) -> None:
        """See `StiffnessModel.horizon`."""
        self.model.horizon(state, prediction, tires)
        friction = float(getattr(self.model, "friction", 1.0))
        row = (prediction[0, AF], prediction[0, AR], *tires[0], friction)
        if state is self._last:  # asked a second time in the first period
            self.rows[-1] = row
        else:
            self.rows.append(row)
        self._last = state

    def table(self, n: int) -> Array:
        """Slip front, rear [rad], Cf, F0f, Cr, F0r, friction of n periods, shape (n, 7)."""
        found = np.array(self.rows)
        if not n - 1 <= len(found) <= n:  # the last instant of a run has no command
            raise AssertionError(f"{len(found)} periods were overheard, {n} driven")
        return np.vstack([found, found[-1:]])[:n]


@dataclass(frozen=True, kw_only=True)
class Row:
    """R2 along a lap."""

    kind: str
    """`network` or `network-secant`."""
    given: str
    """What the network was told, a key of `GIVEN` or `GIVEN_SECANT`."""
    road: float
    """Friction of the road, announced to nobody."""
    seed: int
    """Seed of the world."""
    C: tuple[float, float]
    """R2 of the secant stiffness, front and rear, where the slip is above `ALPHA_LARGE`."""
    Fy: tuple[float, float]
    """R2 of the axle's lateral force, on the same rows."""


def lap(kind: str, road: float, world: str, seed: int, grip: float) -> tuple[Log, Array]:
    """Drive a lap of `circuit` with a network, and overhear it."""
    from lpvmpc.control.registry import make_stiffness

    car = packaged_car()
    model = Overheard(make_stiffness(kind, car, lambda: tires(compile_model(visual=False))))
    run = batch.Run(scenario="circuit", scenario_options={"grip": grip}, road=road)
    controller = load_controller("lpv-mpc", stiffness=model)
    log = simulate(Plant(), controller, batch.scenario_of(run), world=world, seed=seed)
    return log, model.table(len(log.columns["t_s"]))


def rows_of(kind: str, road: float, seeds: Sequence[int], grip: float) -> list[Row]:
    """All ways of telling a network, along laps on one road; the world's seeds for `rtk`."""
    log, heard = lap(kind, road, "ideal", 0, grip)
    weights = load_weights(kind)
    found = []

    def add(given: str, log: Log, C: Array, alpha: Array, seed: int = 0) -> None:
        slip, Fy, slope = axle_truth(log)
        true = secant_stiffness(slip, Fy, slope)
        R_C, R_F = [], []
        for i in range(2):
            some = np.abs(slip[:, i]) > ALPHA_LARGE
            R_C.append(r2(true[some, i], C[some, i]))
            R_F.append(r2(Fy[some, i], (C * alpha)[some, i]))
        found.append(Row(kind=kind, given=given, road=road, seed=seed,
                         C=(R_C[0], R_C[1]), Fy=(R_F[0], R_F[1])))

    alpha = axle_truth(log)[0]
    add("truth", log, said(log, weights, road), alpha)
    if kind == "network":
        if road != 1.0:
            add("dry", log, said(log, weights, 1.0), alpha)
        add("estimated", log, said(log, weights, heard[:, 6]), alpha)
    for world, given, several in (("ideal", "controller", [0]), ("rtk", "rtk", seeds)):
        for seed in several:
            if world != "ideal":
                log, heard = lap(kind, road, world, seed, grip)
            slip, slopes, offsets = heard[:, :2], heard[:, [2, 4]], heard[:, [3, 5]]
            C = secant_stiffness(slip, slopes * slip + offsets, slopes)
            add(given, log, C, slip, seed)
    return found


# Networks of several seeds ------------------------------------------------------------------------


def networks(folder: Path, kind: str) -> dict[int, str | None]:
    """Trained networks of a kind by seed: the shipped one (None), and those of a folder."""
    found: dict[int, str | None] = {}
    for file in [None, *sorted((folder / kind).glob("seed*.safetensors"))]:
        weights = load_weights(kind, file)
        found[int(weights.metadata["seed"])] = None if file is None else str(file)
    return found
