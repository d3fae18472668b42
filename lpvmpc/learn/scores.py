"""How well a trained network fits: R2, relative error by slip, and pictures.

R2 is of the secant stiffness labels Cf, Cr, for both networks, so that they compare with each other
and with the paper's; for `network` also of the axle's force and its local slope.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lpvmpc.car.params import VehicleParams
from lpvmpc.control.stiffness import network, network_file
from lpvmpc.control.stiffness.secant_network import SecantNetwork
from lpvmpc.kit.files import write_picture, write_text
from lpvmpc.kit.report import csv_text
from lpvmpc.learn.dataset import Dataset, samples_of, secant_stiffness
from lpvmpc.units import Array

if TYPE_CHECKING:
    from lpvmpc.learn.train import Trained

PAPER_R2 = {"train": 0.88, "test": 0.78}
"""Printed in the paper, for a random split."""
SLIPS = np.radians([0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 15.0])
"""Edges of the ranges of slip angle [rad]."""
AXLES = ("f", "r")


@dataclass(frozen=True)
class Prediction:
    """What a network says about data; columns front, rear."""

    C: Array
    """Secant stiffness [N/rad], shape (n, 2)."""
    Fy: Array | None = None
    """Lateral force [N], shape (n, 2), where the network gives it."""
    slope: Array | None = None
    """Local slope [N/rad], shape (n, 2), where the network gives it."""


def predict(weights: network_file.Weights, data: Dataset, car: VehicleParams) -> Prediction:
    """The network's answers, by the code that the controller runs."""
    if weights.kind == "network-secant":
        inputs = np.column_stack([data[name] for name in network_file.SECANT_INPUTS])
        return Prediction(SecantNetwork(car, weights).stiffness(inputs))
    samples, n = samples_of(data, car), len(data)
    Fy, slope, slope_zero = (np.empty((n, 2)) for _ in range(3))
    net = network.NetworkTire(car, weights).net
    network.forces_of(*samples.values(), net, Fy, slope, slope_zero)
    C = secant_stiffness(samples["alpha"], Fy, slope_zero)
    return Prediction(C, Fy, slope)


def r2(true: Array, predicted: Array) -> float:
    """Coefficient of determination, 1 - sum (y - p)^2 / sum (y - mean y)^2; NaN without spread."""
    spread = float(((true - true.mean()) ** 2).sum())
    return 1.0 - float(((true - predicted) ** 2).sum()) / spread if spread > 0.0 else float("nan")


def scores(p: Prediction, data: Dataset, mask: npt.NDArray[np.bool_]) -> dict[str, float]:
    """R2 on some samples: C_f, C_r and, where there are, Fy_f, Fy_r, slope_f, slope_r."""
    found = {}
    for quantity, column in (("C", "C{}_Nprad"), ("Fy", "Fy{}_N"), ("slope", "slope_{}_Nprad")):
        values = getattr(p, quantity)
        if values is not None:
            for i, axle in enumerate(AXLES):
                true = data[column.format(axle)][mask]
                found[f"{quantity}_{axle}"] = r2(true, values[mask, i])
    return found


def score_all(
    trained: Trained, data: Dataset, car: VehicleParams, also: Dataset | None = None
) -> list[dict[str, Any]]:
    """One row per network and set: seed, split, set (train, test, also), samples, R2."""
    rows = []
    for (seed, split), weights in zip(trained.names, trained.weights, strict=True):
        p = predict(weights, data, car)
        sets = {"train": (p, data, split.train), "test": (p, data, ~split.train)}
        if also is not None and split.name == "runs":
            every = np.ones(len(also), dtype=bool)
            sets["also"] = (predict(weights, also, car), also, every)
        for name, (answer, of, mask) in sets.items():
            row = {"seed": seed, "split": split.name, "set": name, "samples": int(mask.sum())}
            rows.append({**row, **scores(answer, of, mask)})
    return rows


def by_slip(
    p: Prediction, data: Dataset, mask: npt.NDArray[np.bool_]
) -> list[dict[str, float | int | str]]:
    """Relative error of the secant stiffness by range of the slip angle, per axle."""
    rows: list[dict[str, float | int | str]] = []
    for i, axle in enumerate(AXLES):
        alpha, true = np.abs(data[f"alpha_{axle}_rad"]), data[f"C{axle}_Nprad"]
        for low, high in zip(SLIPS[:-1], SLIPS[1:], strict=True):
            rows_in = mask & (alpha >= low) & (alpha < high)
            if not rows_in.any():
                continue
            error = np.abs(p.C[rows_in, i] / true[rows_in] - 1.0)
            rows.append(
                {
                    "axle": axle,
                    "slip_from_deg": round(float(np.degrees(low)), 6),
                    "slip_to_deg": round(float(np.degrees(high)), 6),
                    "samples": int(rows_in.sum()),
                    "median_error": float(np.median(error)),
                    "p95_error": float(np.quantile(error, 0.95)),
                }
            )
    return rows


def summary(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Median, lowest and highest R2 of C over the seeds, by split and set."""
    found = []
    for split, name in dict.fromkeys((row["split"], row["set"]) for row in rows):
        some = [row for row in rows if (row["split"], row["set"]) == (split, name)]
        line: dict[str, Any] = {"split": split, "set": name, "seeds": len(some)}
        for key in ("C_f", "C_r"):
            values = [row[key] for row in some]
            line[key] = (float(np.median(values)), min(values), max(values))
        found.append(line)
    return found


def write_csv(file: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows of equal keys.

    Raises:
        OutputError: The file cannot be written.
    """
    write_text(file, csv_text(list(rows[0]), (row.values() for row in rows)))


def draw(folder: Path, trained: Trained, data: Dataset, car: VehicleParams) -> None:
    """Write learning-curve.png and prediction.png of the first network, the one to keep.

    Raises:
        OutputError: They cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    curve = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = curve.subplots()
    axes.semilogy(trained.curve[:, 0], trained.curve[:, 1], label="training")
    axes.semilogy(trained.curve[:, 0], trained.curve[:, 2], label="held-out runs")
    axes.set_xlabel("epoch")
    axes.set_ylabel("loss")
    axes.legend()
    axes.grid(alpha=0.3)

    test = ~trained.names[0][1].train
    p = predict(trained.weights[0], data, car)
    answer = Figure(figsize=(11.0, 8.0), layout="constrained")
    panels = answer.subplots(2, 2)
    rows = np.flatnonzero(test)[:1200]  # nine or so held-out runs, one after the other
    for i, (axle, name) in enumerate(zip(AXLES, ("front", "rear"), strict=True)):
        true = data[f"C{axle}_Nprad"] * 1e-3
        left, right = panels[i]
        left.plot(true[rows], label="label")
        left.plot(p.C[rows, i] * 1e-3, lw=0.8, label="network")
        left.set_xlabel("sample of the held-out runs")
        left.set_ylabel(f"{name} stiffness [kN/rad]")
        left.legend(loc="lower right")
        right.plot(true[test], p.C[test, i] * 1e-3, ".", ms=2, alpha=0.4)
        ends = [0.0, float(true.max())]
        right.plot(ends, ends, "k", lw=0.8)
        right.set_xlabel(f"{name} label [kN/rad]")
        right.set_ylabel("network [kN/rad]")
        right.set_title(f"R² {r2(true[test], p.C[test, i] * 1e-3):.4f} on held-out runs")
        right.grid(alpha=0.3)
    for figure, name in ((curve, "learning-curve.png"), (answer, "prediction.png")):
        FigureCanvasAgg(figure)
        write_picture(folder / name, figure, dpi=110)
