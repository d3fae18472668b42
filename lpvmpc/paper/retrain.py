"""Tuning and training anew, each in its own folder; what is there already is kept.

Without this the report stands on the weights, networks and tuning reports that are shipped.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lpvmpc.errors import DataError, LPVMPCError
from lpvmpc.kit.workers import workers
from lpvmpc.sim import batch
from lpvmpc.tune import tuning, tuning_report

Say = Callable[[str, int, int], None]
"""Told what is being done, and how much of how much is."""
PRESETS = {"paper": "network-secant", "default": "network"}
"""Presets of `learn.train` and the kinds of network that they make."""
SAMPLES = 10752
"""Rows of data, as many as the paper's."""
FRICTIONS = (0.4, 1.0)
"""Road frictions of the further data on which the fit is told."""


# Tuning -------------------------------------------------------------------------------------------


def tune(task: tuning.Task, folder: Path, jobs: int, say: Say) -> Path:
    """Tune a controller, or go on, or find that it is done.

    Args:
        task: What to tune.
        folder: Where tuning.json, weights.toml and the rest go.
        jobs: Number of processes.
        say: Told about each generation.

    Returns:
        The folder.

    Raises:
        LPVMPCError: No weights could be driven, or a worker process died.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if _task(folder) == task.record():
        return folder
    checkpoint = folder / "checkpoint.json"
    total = task.budget

    def after(stage: tuning.SearchStage, state: tuning.SearchState) -> None:
        say(f"tuning {task.controller}", min(state.evaluations, total), total)

    with workers(jobs) as pool:
        options: dict[str, Any] = {"map": pool.map, "checkpoint": checkpoint, "after": after}
        try:
            tuned = tuning.tune(task, resume=checkpoint.exists(), **options)
        except DataError:  # of another version, or cut off while it was written
            tuned = tuning.tune(task, **options)
    before, found = (
        batch.drive_all(tuning.runs(task, weights)) for weights in (tuned.by_hand, tuned.weights)
    )
    tuning_report.save(tuned, before, found, folder)
    checkpoint.unlink(missing_ok=True)
    return folder


def _task(folder: Path) -> Any:
    """The task whose result lies in a folder; None without one."""
    try:
        return json.loads((folder / "tuning.json").read_text())["task"]
    except (OSError, ValueError, KeyError):
        return None


# Training -----------------------------------------------------------------------------------------


def train(
    folder: Path, jobs: int, say: Say, *, samples: int = SAMPLES, epochs: int | None = None
) -> dict[str, Path]:
    """Collect data and train both networks, or go on, or find that it is done.

    Args:
        folder: Where data, networks and their fits go.
        jobs: Number of processes that collect.
        say: Told about rows and epochs.
        samples: Rows of data.
        epochs: Passes through the data (default: as the presets say).

    Returns:
        File of the network by kind; its fit lies beside it in a folder of the same name.

    Raises:
        LPVMPCError: torch is missing, a worker process died, or training diverged.
    """
    try:
        import torch  # noqa: F401
    except ImportError:
        raise LPVMPCError(
            "--retrain needs torch; pip install 'lpvmpc[train]' brings it."
        ) from None
    from lpvmpc.plant.mjcf import compile_model, parameters

    folder.mkdir(parents=True, exist_ok=True)
    car = parameters(compile_model(visual=False))
    data = _collected(folder / "stiffness.parquet", jobs, say, samples=samples, seed=0)
    also = _collected(
        folder / "friction.parquet", jobs, say, samples=samples, seed=1, friction=FRICTIONS
    )
    return {
        kind: _trained(folder / f"{kind}.safetensors", preset, epochs, data, also, car, say)
        for preset, kind in PRESETS.items()
    }


def _collected(file: Path, jobs: int, say: Say, **what: Any) -> Any:
    """Data of a plan, from the file or driven."""
    from lpvmpc.learn import collect, dataset

    plan = collect.Plan(**what)

    def progress(rows: int) -> None:
        say(f"collecting {file.stem}", rows, plan.samples)

    try:
        collect.collect(plan, file, jobs=jobs, resume=True, progress=progress)
        return dataset.read(file)
    except DataError:  # of another plan or version, or damaged
        file.unlink(missing_ok=True)
        collect.collect(plan, file, jobs=jobs, progress=progress)
        return dataset.read(file)


def _trained(
    out: Path, preset: str, epochs: int | None, data: Any, also: Any, car: Any, say: Say
) -> Path:
    """A network trained on the data, with its fit."""
    from lpvmpc.control.stiffness import network_file
    from lpvmpc.kit import safetensors
    from lpvmpc.kit.provenance import versions
    from lpvmpc.learn import scores, train

    how = train.preset(preset, epochs)
    facts = {
        "format": network_file.FORMAT,
        "kind": how.kind,
        "seed": "0",
        "command": "python eval/reproduce.py --retrain",
        "data_sha256": data.sha256,
        "data": json.dumps({k: data.meta.get(k) for k in ("samples", "seed", "friction")}),
        "car_sha256": str(data.meta.get("car_sha256")),
        "model_sha256": str(data.meta.get("model_sha256")),
        "preset": repr(how),
        "versions": json.dumps(versions(), sort_keys=True),
    }
    folder = out.with_suffix("")
    try:
        if safetensors.read(out)[1] == facts and (folder / "learning-curve.csv").exists():
            return out
    except DataError:
        pass  # there is none, or an unfinished one
    job = train.Job(preset=how, only=("runs", "random"))
    options: dict[str, Any] = {
        "checkpoint": out.with_name(out.name + ".checkpoint"),
        "progress": lambda epoch, loss: say(f"training {how.kind}", epoch, how.epochs),
    }
    try:
        trained = train.train(data, job, car, resume=True, **options)
    except DataError:  # the checkpoint is of another training
        trained = train.train(data, job, car, **options)
    folder.mkdir(exist_ok=True)
    rows = scores.score_all(trained, data, car, also)
    scores.write_csv(folder / "r2.csv", [{**dict.fromkeys(rows[0], ""), **row} for row in rows])
    curve = [{"epoch": int(e), "train": a, "test": b} for e, a, b in trained.curve.tolist()]
    scores.write_csv(folder / "learning-curve.csv", curve)
    scores.draw(folder, trained, data, car)
    safetensors.write(out, trained.weights[0].arrays, facts)
    options["checkpoint"].unlink(missing_ok=True)
    return out
