"""The report on what networks tell along driven laps, and on what another training would change."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lpvmpc.control.stiffness.network_file import load_weights
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import csv_text, record, versions_line, write_report
from lpvmpc.learn.driven import GIVEN, GIVEN_SECANT, Row
from lpvmpc.sim.batch import Run

ROADS: dict[str, dict[str, Any]] = {
    "circuit 76 %": {"scenario": "circuit", "scenario_options": {"grip": 0.76}},
    "circuit 87 %": {"scenario": "circuit", "scenario_options": {"grip": 0.87}},
    "circuit 96 %": {"scenario": "circuit", "scenario_options": {"grip": 0.96}},
    "76 %, friction 0.75": {
        "scenario": "circuit", "scenario_options": {"grip": 0.76}, "road": 0.75,
    },
}
"""What the networks of several seeds drive; the last road's friction is announced to nobody."""


@dataclass(frozen=True, kw_only=True)
class Trained:
    """One network, how it fits, and what it drives like."""

    kind: str
    """`network` or `network-secant`."""
    seed: int
    """Seed of its training."""
    r2: tuple[float, float]
    """R2 of the secant stiffness on held-out runs, front and rear."""
    results: tuple[dict[str, Any], ...]
    """Metrics on `ROADS`."""


def runs(kind: str, file: str | None) -> list[Run]:
    """The closed loops of one network."""
    options = {"stiffness": kind} | ({} if file is None else {"stiffness_file": file})
    return [Run(controller_options=options, **what) for what in ROADS.values()]


def fit(kind: str, file: str | None) -> tuple[float, float]:
    """R2 on held-out runs that a network's file tells."""
    front, rear = json.loads(load_weights(kind, file).metadata["R2_C_front_rear"])["test"]
    return float(front), float(rear)


def report(rows: Sequence[Row], trained: Sequence[Trained], grip: float) -> str:
    """The report in Markdown."""
    seeds = sorted({row.seed for row in rows if row.given == "rtk"})
    lines = [
        "# What the networks tell of the tires along a driven lap",
        "",
        f"Machine: {machine()}.",
        versions_line(),
        "",
        f"Definitions: `lpv-mpc` drives a lap of `circuit` at {100 * grip:g} % of the grip with "
        "the network, once on a dry road and once on one of friction 0.75 that nobody is told of. "
        "R2 = 1 - sum (y - y_hat)^2 / sum (y - mean y)^2 over the instants at which the axle's "
        "slip is above 0.012 rad, where force over slip is a stiffness. *Stiffness*: the secant "
        "stiffness, force over slip; *force*: the axle's lateral force. In the rows where the "
        "controller's own slip is used, a wrong slip counts too. "
        f"`rtk`: median of {len(seeds)} seeds of the world. No network has seen this road.",
        "",
    ]
    for kind, words in (("network", GIVEN), ("network-secant", GIVEN_SECANT)):
        body = []
        for given, text in words.items():
            cells = []
            for road in (1.0, 0.75):
                some = [r for r in rows if (r.kind, r.given, r.road) == (kind, given, road)]
                for values in ([r.C for r in some], [r.Fy for r in some]):
                    cells.append(_pair(values))
            body.append((text, *cells))
        lines.append(markdown_table(
            f"R2 of {kind}, front / rear",
            ("given", "stiffness, dry", "force, dry", "stiffness, 0.75", "force, 0.75"), body,
            words=("given",),
        ))
    lines += [
        "`network` does not learn friction: the similarity law `F(alpha; f) = f F(alpha/f; 1)` is "
        "written into it, and the plant scales its tires by the same law. So its R2 on friction "
        "that it was not trained on, with the true friction given, restates that law; what counts "
        "on a road that nobody has announced are the rows of the estimated friction. "
        "`network-secant` has no input from which it could tell the friction.",
        "",
        markdown_table(
            "Three trainings of each network: R2 on held-out runs, and lateral RMSE / largest "
            "error [mm] of `lpv-mpc` with it",
            ("network", "seed", "R2 front", "R2 rear", *ROADS),
            [
                (one.kind, one.seed, *(f"{value:.4f}" for value in one.r2),
                 *(_driven(result) for result in one.results))
                for one in trained
            ],
        ),
        *_spreads(trained),
        "",
        "Seed 0 is the network that is shipped, trained with all splits of docs/dataset.md side by "
        "side; seeds 1 and 2 (docs/results/network and network-secant) were trained anew on data "
        "collected by the same command with today's plant and controllers, with runs held out "
        "alone. R2 of five seeds, all splits: docs/dataset.md.",
        "",
        "Made by `python eval/stiffness.py`; every number is in stiffness.csv beside this file.",
    ]
    return "\n".join(lines) + "\n"


def _pair(values: Sequence[tuple[float, float]]) -> str:
    """Median front and rear over seeds."""
    if not values:
        return "-"
    return " / ".join(f"{statistics.median(v[i] for v in values):.3f}" for i in range(2))


def _driven(result: dict[str, Any]) -> str:
    if not result["completed"]:
        return "lost"
    return f"{1e3 * result['lateral_rmse_m']:.2f} / {1e3 * result['lateral_max_m']:.1f}"


def spread(trained: Sequence[Trained], kind: str, road: int) -> tuple[float, float] | None:
    """Lowest and highest lateral RMSE [m] of the trainings on a road; None where one was lost."""
    results = [one.results[road] for one in trained if one.kind == kind]
    if not results or not all(result["completed"] for result in results):
        return None
    values = [float(result["lateral_rmse_m"]) for result in results]
    return min(values), max(values)


def _spreads(trained: Sequence[Trained]) -> list[str]:
    """One sentence for each kind of network."""
    lines = []
    for kind in dict.fromkeys(one.kind for one in trained):
        ratios = []
        for i, road in enumerate(ROADS):
            pair = spread(trained, kind, i)
            told = "one is lost" if pair is None else f"{pair[1] / pair[0]:.2f}"
            ratios.append(f"{told} ({road})")
        lines.append(f"`{kind}`: worst over best RMSE of the trainings {', '.join(ratios)}.")
    return lines


def save(
    folder: Path, rows: Sequence[Row], trained: Sequence[Trained], grip: float,
    copy: Path | None = None,
) -> list[Path]:
    """Write stiffness.md, stiffness.csv and stiffness.json.

    Raises:
        OutputError: One of them cannot be written.
    """
    body: list[tuple[object, ...]] = [
        ("lap", r.kind, r.given, r.road, r.seed, *r.C, *r.Fy, None, None) for r in rows
    ]
    for one in trained:
        for road, result in zip(ROADS, one.results, strict=True):
            body.append(("trained", one.kind, road, None, one.seed, *one.r2, None, None,
                         result["lateral_rmse_m"] if result["completed"] else None,
                         result["lateral_max_m"] if result["completed"] else None))
    header = ("part", "network", "given", "friction", "seed", "r2_C_f", "r2_C_r", "r2_Fy_f",
              "r2_Fy_r", "lateral_rmse_m", "lateral_max_m")
    values = {
        "laps": [vars(r) for r in rows],
        "trained": [
            {"kind": one.kind, "seed": one.seed, "r2": one.r2,
             "roads": {road: {k: result[k] for k in ("completed", "lateral_rmse_m",
                                                     "lateral_max_m")}
                       for road, result in zip(ROADS, one.results, strict=True)}}
            for one in trained
        ],
        "record": record(grip=grip),
    }
    return write_report(folder, "stiffness", text=report(rows, trained, grip),
                        table=csv_text(header, body), values=values, copy=copy)
