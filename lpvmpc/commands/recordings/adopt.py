"""From a recording to a driven car, in one command: a car of one's own, end to end.

    lpvmpc adopt recording.csv --out cars/mine
    lpvmpc adopt recording.csv --out cars/mine --resume

Identifies the car on the first part of the recording and checks it on the seconds held back; then
collects tire data with it, trains its network, tunes lpv-mpc, drives `circuit` in the ideal world
and with the sensors of `rtk`, and writes adopt.md into the car's folder: what to believe, and what
not. A stage that is through is not repeated: --resume goes on where it stopped, within a stage too.
Exit codes: 0 done; 2 bad input; 3 the car did not complete the circuit; 130 interrupted.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any

from lpvmpc.errors import DataError, LPVMPCError, OptionError
from lpvmpc.kit import cli
from lpvmpc.kit.files import read_json, write_json, write_text
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.progress import Bar
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import versions_line

if TYPE_CHECKING:
    from lpvmpc.identify.conduct import Replay

STAGES = {"fit": 120.0, "collect": 120.0, "train": 120.0, "tune": 240.0, "drive": 60.0}
"""Stages in their order, and how long each takes on two cores, for the estimate [s]."""
DONE_FILE = "adopt.json"
"""Which stages are through, with their times and results."""
GRIP = 0.87
"""Share of the lateral limit at which `circuit` is driven."""
BARS = {"ideal": (2.0, 20.0), "rtk": (6.0, 40.0)}
"""Worlds where it is driven; median RMSE and worst largest error there that are asked for [mm]."""
SEEDS = {"ideal": (0,), "rtk": tuple(range(10))}
"""Draws of each world."""
POPULATION = 6
"""Individuals of the search for weights, which begins with those that ship."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Adopt a recorded car: identify it, train and tune a controller for it, drive it, report."""

    recording: Annotated[tuple[Path, ...], cli.Option(
        positional=True, metavar="RECORDING",
        help="CSV file as `lpvmpc replay` reads it; of several, all are identified on.",
    )] = ()
    out: Path | None = None
    """Folder of the car."""
    fit: tuple[str, ...] = ()
    """Parameters to identify, as `lpvmpc replay` names them (default: what the recording shows: Cf
    and Cr; with vy_mps lf, lr and Iz as well; mu_f and mu_r where it drives near the limit)."""
    held_back: float = 0.25
    """Share of the recording, at its end, on which the car is checked and not identified."""
    car: Path | None = None
    """Car to begin with: mass, inertia, springs and what else is not identified (default: the
    packaged one)."""
    samples: int = 10752
    """Number of tire samples."""
    epochs: int | None = None
    """Passes of training over the data (default: the preset's)."""
    generations: int = 2
    """Generations of the search for weights; 0 keeps those that ship."""
    resume: bool = False
    """Go on after the last stage that is through."""
    jobs: int = 0
    """Processes; 0 for one per core."""


def main(options: Options) -> int:
    """Run the stages that are missing; returns the exit code."""
    if not options.recording:
        raise OptionError("RECORDING", None, "the CSV file of a recording")
    if options.out is None:
        raise OptionError("--out", None, "the folder of the car, cars/mine say")
    cli.check_number("--held-back", options.held_back, 0.05, 0.8)
    cli.check_number("--generations", options.generations, 0, 1000)
    cli.check_number("--samples", options.samples, 2000, 1_000_000)
    cli.check_number("--jobs", options.jobs, 0, 1024)
    from lpvmpc.identify.candidate import check_names

    check_names(options.fit)
    out = options.out
    cli.results_folder(out, "adopt")
    through = _through(out / DONE_FILE, options)
    work: dict[str, Callable[[Options, Path], dict[str, Any]]] = {
        "fit": _fit, "collect": _collect, "train": _train, "tune": _tune, "drive": _drive,
    }
    for number, name in enumerate(STAGES, start=1):
        if name in through["stages"]:
            print(f"{name}: done before")
            continue
        print(f"{name}: stage {number} of {len(STAGES)} begins; about "
              f"{_left(through['stages']) / 60:.0f} minutes left", flush=True)
        begun = time.monotonic()
        result = work[name](options, out)
        through["stages"][name] = {"seconds": time.monotonic() - begun, **result}
        write_json(out / DONE_FILE, through)
    text = _report(through)
    write_text(out / "adopt.md", text)
    print(text)
    print(f"Saved {out}/ (vehicle.xml, network.safetensors, weights/, adopt.md, adopt.json)")
    runs = [run for runs in through["stages"]["drive"]["runs"].values() for run in runs]
    return cli.DONE if all(one["completed"] for one in runs) else cli.NOT_COMPLETED


def _left(stages: Mapping[str, Any]) -> float:
    """Time that is left [s]: what the stages usually take, times how slow this machine was."""
    usual = sum(STAGES[name] for name in stages)
    slow = sum(one["seconds"] for one in stages.values()) / usual if usual else 1.0
    return slow * sum(seconds for name, seconds in STAGES.items() if name not in stages)


def _run(main: Callable[[Any], int], options: Any) -> None:
    """Another command; an interruption of it is one of this.

    Raises:
        KeyboardInterrupt: It was interrupted.
        LPVMPCError: It did not end well.
    """
    code = main(options)
    if code == cli.INTERRUPTED:
        raise KeyboardInterrupt
    if code != cli.DONE:
        raise LPVMPCError(f"{main.__module__.rpartition('.')[2]} ended with exit code {code}.")


def _through(file: Path, options: Options) -> dict[str, Any]:
    """Stages that are through.

    Raises:
        OptionError: The folder holds an adoption already, or one with other options.
    """
    asked = {
        "recording": [str(one) for one in options.recording], "fit": list(options.fit),
        "held_back": options.held_back, "car": str(options.car or ""), "samples": options.samples,
        "epochs": options.epochs, "generations": options.generations,
    }
    if not file.exists():
        return {"options": asked, "stages": {}}
    if not options.resume:
        raise OptionError("--out", str(file.parent), "a folder without adopt.json; --resume goes "
                          "on with what it holds")
    try:
        told = read_json(file)
    except (OSError, ValueError) as error:
        raise DataError(f"{file} cannot be read: {error}.") from None
    if not isinstance(told, dict) or told.get("options") != asked:
        raise OptionError("--resume", str(file.parent), "given with the options of before")
    return told


def _fit(options: Options, out: Path) -> dict[str, Any]:
    """Identify the car on the first part of each recording, check it on the rest."""
    from lpvmpc.identify.candidate import Candidate
    from lpvmpc.identify.conduct import conduct
    from lpvmpc.identify.fit import visible
    from lpvmpc.identify.recording import read_recording
    from lpvmpc.identify.saved import save
    from lpvmpc.plant.car_folder import read_car

    recordings = [read_recording(file) for file in options.recording]
    cuts = [round(len(one.t) * (1.0 - options.held_back)) for one in recordings]
    first = [one.rows(0, cut) for one, cut in zip(recordings, cuts, strict=True)]
    rest = [one.rows(cut, len(one.t)) for one, cut in zip(recordings, cuts, strict=True)]
    car = read_car(options.car)
    start = Candidate.of(car.model)
    names = options.fit or visible(first, car.params.ay_limit)
    print(f"Identifying {', '.join(names)} on {', '.join(one.name for one in first)}", flush=True)
    found = conduct(start, rest[0], names, first)
    checks = [found]
    for other in rest[1:]:
        checks.append(conduct(found.candidates["plant"], other))
    save(out, found)
    fit = found.fits["plant"]
    return {
        "fit": fit.as_json(), "ratio_linear": found.ratio("linear"),
        "held_back": {one.recording.name: _told(one) for one in checks},
    }


def _told(replay: Replay) -> dict[str, float | None]:
    return {name: one.r2 for name, one in replay.scores["plant"].whole.items()}


def _collect(options: Options, out: Path) -> dict[str, Any]:
    from lpvmpc.commands import collect

    _run(collect.main, collect.Options(
        samples=options.samples, out=out / "stiffness.parquet", car=out, jobs=options.jobs,
        resume=True,
    ))
    return {"samples": options.samples}


def _train(options: Options, out: Path) -> dict[str, Any]:
    from lpvmpc.commands import train

    _run(train.main, train.Options(
        data=out / "stiffness.parquet", car=out, epochs=options.epochs, resume=True,
        out=out / "network.safetensors",
    ))
    return {}


def _tune(options: Options, out: Path) -> dict[str, Any]:
    from lpvmpc.commands import tune

    folder = out / "tuning"
    if options.generations:
        _run(tune.main, tune.Options(
            controller="lpv-mpc", worlds=tuple(BARS), generations=options.generations,
            population=POPULATION, car=out,
            jobs=options.jobs or cli.cores(), out=folder,
            resume=any((folder / name).exists() for name in ("checkpoint.json", "tuning.json")),
        ))
    return {"generations": options.generations}


def _drive(options: Options, out: Path) -> dict[str, Any]:
    from lpvmpc.plant.car_folder import driving
    from lpvmpc.sim import batch

    runs = [
        batch.Run(scenario="circuit", scenario_options={"grip": GRIP}, world=world, seed=seed)
        for world, seeds in SEEDS.items() for seed in seeds
    ]
    with driving(out), Bar("driving", len(runs), counted=True) as bar:
        driven = batch.drive_all(
            runs, jobs=options.jobs or cli.cores(), cache=cli.writable_folder(out / "runs"),
            progress=lambda done, total: bar.at(done),
        )
    told = [{"seed": run.seed, "world": run.world, **{name: one[name] for name in (
        "completed", "reason", "lateral_rmse_m", "lateral_max_m", "duration_s",
    )}} for run, one in zip(runs, driven, strict=True)]
    return {"runs": {world: [one for one in told if one["world"] == world] for world in SEEDS}}


def _driven(runs: Mapping[str, Sequence[Mapping[str, Any]]]) -> tuple[list[str], list[list[str]]]:
    """What does not hold of the drives, and the rows of their table."""
    missed, rows = [], []
    for world, found in runs.items():
        whole = [one for one in found if one["completed"]]
        for one in found:
            if not one["completed"]:
                missed.append(f"- In the world {world}, draw {one['seed']}, the car did not "
                              f"complete: {one['reason']}.")
        cells = [world, f"{len(whole)} of {len(found)}"]
        if whole:
            values = (1000 * median(one["lateral_rmse_m"] for one in whole),
                      1000 * max(one["lateral_max_m"] for one in whole))
            for what, value, most in zip(("median RMSE", "worst largest"), values, BARS[world],
                                         strict=True):
                cells += [f"{value:.2f}", f"{most:g}"]
                if not value <= most:
                    missed.append(f"- In the world {world} the {what} is {value:.2f} mm, more "
                                  f"than the {most:g} mm of the packaged car.")
            cells.append(f"{median(one['duration_s'] for one in whole):.1f}")
        else:
            cells += ["-"] * 5
        rows.append(cells)
    return missed, rows


def _report(through: dict[str, Any]) -> str:
    """What was found, and what to believe of it."""
    stages = through["stages"]
    fit = stages["fit"]["fit"]
    believe = [f"- {one}" for one in fit["warnings"]]
    for name, scores in stages["fit"]["held_back"].items():
        for channel, r2 in scores.items():
            if r2 is not None and r2 < 0.95:
                believe.append(f"- On the held-back seconds of {name} the car explains only "
                               f"{r2:.3f} of {channel}: do not trust it beyond gentle driving.")
    if stages["fit"]["ratio_linear"] > 1.0:
        believe.append("- A linear single track, fitted alike, is nearer to the held-back seconds.")
    missed, drives = _driven(stages["drive"]["runs"])
    believe += missed
    rows = [
        [name, f"{one['value']:.6g}", f"{one['low95']:.6g} to {one['high95']:.6g}", one["unit"]]
        for name, one in fit["parameters"].items()
    ]
    times = ", ".join(f"{name} {one['seconds']:.0f} s" for name, one in stages.items())
    total = sum(one["seconds"] for one in stages.values()) / 60
    held = [
        [name, *(f"{r2:.4f}" for r2 in scores.values() if r2 is not None)]
        for name, scores in stages["fit"]["held_back"].items()
    ]
    channels = [name for name, r2 in next(iter(stages["fit"]["held_back"].values())).items()
                if r2 is not None]
    return "\n".join([
        f"# The car of {', '.join(through['options']['recording'])}", "",
        *(believe or ["Nothing was found that speaks against the identified car."]), "",
        "What is not identified is that of the car that was begun with; see README.md. A recording "
        "says nothing of what it does not hold: of friction where it only drives gently, of mass "
        "where no force is known.", "",
        f"{machine()}. {versions_line()}", f"Time: {total:.1f} minutes ({times}).", "",
        markdown_table("Identified", ["parameter", "value", "95 % interval", "unit"], rows,
                       ["unit"]),
        markdown_table("R2 on the held-back seconds", ["recording", *channels], held),
        markdown_table(
            f"lpv-mpc, own network, on circuit at {100 * GRIP:g} % of the lateral limit [mm]",
            ["world", "completed", "median RMSE", "asked for", "worst largest", "asked for", "time "
             "[s]"], drives,
        ),
    ])
