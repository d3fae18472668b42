"""Train a network on stiffness data, and say how well it fits what it has not seen.

    lpvmpc train                     # ours
    lpvmpc train --preset paper      # the paper's network and training

The network that is kept is trained with a quarter of the runs held out. Beside it, one is trained
for each kind of manoeuvre held out and one for the random split, for each seed. Exit codes: 0 done;
2 bad input, one line on stderr; 130 interrupted, and --resume goes on.
"""

from __future__ import annotations

import json
import shlex
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from lpvmpc.commands.parts.the_car import CarPlace, folder_of, with_car
from lpvmpc.errors import DataError, LPVMPCError, OptionError
from lpvmpc.kit import cli
from lpvmpc.kit.files import replacing
from lpvmpc.kit.progress import Bar

if TYPE_CHECKING:
    from lpvmpc.learn.dataset import Dataset
    from lpvmpc.learn.train import Trained


@dataclass(frozen=True, kw_only=True)
class Options:
    """Train a network of the tires and report R2 on held-out data."""

    data: Path = Path("data/stiffness.parquet")
    """Data from data_gen/collect.py."""
    out: Path | None = None
    """Weights file (default: network.safetensors or network-secant.safetensors in the folder of
    --car, or in data/)."""
    preset: Literal["default", "paper"] = "default"
    """Ours, or the paper's network and training."""
    epochs: int | None = None
    """Passes through the training data (default: the preset's)."""
    seed: int = 0
    """Seed of the network that is kept."""
    seeds: int | None = None
    """Number of seeds for the table of R2 (default: 5, for the paper's preset 1)."""
    also: Path | None = None
    """Further data, of another friction, on which R2 is told."""
    resume: bool = False
    """Go on with an interrupted training."""
    car: CarPlace = None


@with_car(data="data/{car}.parquet")
def main(options: Options) -> int:
    """Train, evaluate, save; returns the exit code."""
    cli.check_number("--seed", options.seed, 0, 2**62)
    cli.check_number("--seeds", options.seeds, 1, 100)
    cli.check_number("--epochs", options.epochs, 1, 1_000_000)
    cli.check_opengl()
    from lpvmpc.kit import safetensors
    from lpvmpc.learn import dataset

    try:
        from lpvmpc.learn import train
    except ImportError as error:
        if error.name != "torch":
            raise
        raise LPVMPCError("Training needs torch; pip install 'lpvmpc[train]' brings it.") from None

    preset = train.preset(options.preset, options.epochs)
    folder = folder_of(options.car) or Path("data")
    out = options.out or folder / f"{preset.kind}.safetensors"
    if out.suffix != ".safetensors":
        raise OptionError("--out", str(out), "a file name ending in .safetensors")
    data = dataset.read(options.data)
    also = None if options.also is None else dataset.read(options.also)
    car = check_car(data)
    cli.results_folder(out.parent, out.name)
    count = options.seeds or (5 if options.preset == "default" else 1)
    seeds = tuple(range(options.seed, options.seed + count))
    job = train.Job(preset=preset, seeds=seeds)
    checkpoint = out.with_name(out.name + ".checkpoint")
    start = time.perf_counter()
    try:
        with Bar("training", preset.epochs) as bar:
            trained = train.train(
                data, job, car, checkpoint=checkpoint, resume=options.resume,
                progress=lambda epoch, loss: bar.at(epoch, f"training, loss {loss:.3g}"),
            )
    except KeyboardInterrupt:
        print("Interrupted; --resume goes on from here.", file=sys.stderr)
        return cli.INTERRUPTED
    took = time.perf_counter() - start
    fit = f"{out.stem}-fit"
    with replacing(out.parent, [out.name, *(f"{fit}/{file}" for file in FIT)]) as new:
        rows, slips = save_fit(trained, data, also, car, cli.writable_folder(new / fit))
        about = facts(options, preset.kind, data, rows)
        safetensors.write(new / out.name, trained.weights[0].arrays, about)
    checkpoint.unlink(missing_ok=True)
    print(f"{len(trained.names)} networks, {preset.epochs} epochs in {took:.0f} s")
    print_tables(rows, slips)
    print(f"Saved {out} and {out.with_suffix('')}-fit/")
    return cli.DONE


def check_car(data: Dataset) -> Any:
    """The car's parameters; a line on stderr where the data are of another car.

    Raises:
        DataError: They are of another car than that of --car.
    """
    from lpvmpc.car.current import current
    from lpvmpc.plant.mjcf import car_sha256, compile_model, parameters

    model = compile_model(visual=False)
    if not data.checked:
        print("Warning: the data have no checksum, so damage to them cannot be told.",
              file=sys.stderr)
    if data.meta.get("car_sha256") != car_sha256(model):
        if (car := current()) is not None:
            told = str(data.meta.get("car_sha256"))[:12]
            raise DataError(
                f"The data were collected with a car of hash {told}, but {car} has "
                f"{car.sha256[:12]}; lpvmpc collect --car {car} collects its own."
            )
        print("Warning: the data were collected with another vehicle.xml.", file=sys.stderr)
    return parameters(model)


def facts(options: Options, kind: str, data: Dataset, rows: list[dict[str, Any]]) -> dict[str, str]:
    """What the weights file says about itself."""
    from lpvmpc.control.stiffness.network_file import FORMAT
    from lpvmpc.kit.provenance import versions

    kept = {row["set"]: [round(row["C_f"], 4), round(row["C_r"], 4)] for row in rows[:2]}
    # without --resume: a training that was interrupted leaves the same bytes
    given = " ".join(shlex.quote(word) for word in sys.argv[1:] if word != "--resume")
    return {
        "format": FORMAT,
        "kind": kind,
        "seed": str(options.seed),
        "command": f"python data_gen/train.py {given}".strip(),
        "data_sha256": data.sha256,
        "data": json.dumps({k: data.meta.get(k) for k in ("samples", "seed", "friction")}),
        "car_sha256": str(data.meta.get("car_sha256")),
        "model_sha256": str(data.meta.get("model_sha256")),
        "R2_C_front_rear": json.dumps(kept),
        "versions": json.dumps(versions(), sort_keys=True),
    }


FIT = ("r2.csv", "slip.csv", "learning-curve.csv", "learning-curve.png", "prediction.png")
"""What lies in the folder beside the weights, and is replaced with them."""


def save_fit(
    trained: Trained, data: Dataset, also: Dataset | None, car: Any, folder: Path
) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Save R2, relative errors and pictures; returns the rows of R2 and of the errors."""
    from lpvmpc.learn import scores

    rows = scores.score_all(trained, data, car, also)
    scores.write_csv(folder / "r2.csv", [{**dict.fromkeys(rows[0], ""), **row} for row in rows])
    kept = scores.predict(trained.weights[0], data, car)
    slips = scores.by_slip(kept, data, ~trained.names[0][1].train)
    scores.write_csv(folder / "slip.csv", slips)
    scores.write_csv(
        folder / "learning-curve.csv",
        [{"epoch": int(e), "train": a, "test": b} for e, a, b in trained.curve.tolist()],
    )
    scores.draw(folder, trained, data, car)
    return rows, slips


def print_tables(rows: list[dict[str, Any]], slips: list[dict[str, Any]]) -> None:
    """R2 by split, and the relative error by slip angle."""
    from rich.console import Console
    from rich.table import Table

    from lpvmpc.learn import scores

    console = Console(width=80 if not sys.stdout.isatty() else None, highlight=False)
    table = Table(
        title="R2 of the secant stiffness: median over seeds (lowest)",
        title_style="bold", title_justify="left", expand=False,
    )
    for name in ("held out", "set"):
        table.add_column(name, no_wrap=True)
    table.add_column("front", justify="right")
    table.add_column("rear", justify="right")
    names = {"runs": "a quarter of the runs", "random": "random samples"}
    for line in scores.summary(rows):
        if line["set"] == "train" and line["split"] not in names:
            continue
        cells = [f"{line[k][0]:.4f} ({line[k][1]:.4f})" for k in ("C_f", "C_r")]
        held = names.get(line["split"], line["split"].removeprefix("without "))
        table.add_row(held, {"also": "further data"}.get(line["set"], line["set"]), *cells)
    console.print(table)
    paper = scores.PAPER_R2
    print(f"Paper: {paper['train']} train, {paper['test']} test, random split, other labels.")
    table = Table(
        title="Relative error of the secant stiffness on held-out runs",
        title_style="bold", title_justify="left", expand=False,
    )
    for name in ("slip angle [deg]", "front median", "95 %", "rear median", "95 %"):
        table.add_column(name, justify="right")
    ranges = dict.fromkeys((row["slip_from_deg"], row["slip_to_deg"]) for row in slips)
    for low, high in ranges:
        cells = []
        for axle in scores.AXLES:
            found = [r for r in slips if r["axle"] == axle and r["slip_from_deg"] == low]
            for key in ("median_error", "p95_error"):
                cells.append(f"{100.0 * found[0][key]:.2f} %" if found else "-")
        table.add_row(f"{low:g}-{high:g}", *cells)
    console.print(table)
