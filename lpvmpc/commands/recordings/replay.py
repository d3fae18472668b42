"""How far does the simulated car behave as a recorded one? Replay a recording; identify the car.

    lpvmpc replay --recording drive.csv
    lpvmpc replay --recording drive.csv --fit lf lr Cf Cr --save cars/mine
    lpvmpc replay --recording drive.csv --fit Cf Cr --fit-on other.csv

A recording has the columns t_s, delta_rad (of the road wheel), vx_mps, r_radps, and may have
vy_mps, ax_mps2, ay_mps2. Prints scores of the plant and of two single tracks, fitted alike, and
writes replay.md, replay.csv, replay.json and replay.png. Exit codes: 0 done; 2 bad input;
130 interrupted.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from lpvmpc.commands.parts.the_car import CarPlace, TireFile, with_car
from lpvmpc.errors import OptionError
from lpvmpc.kit import cli
from lpvmpc.kit.files import write_json
from lpvmpc.kit.report import write_report

if TYPE_CHECKING:
    from lpvmpc.identify.candidate import Candidate
    from lpvmpc.identify.conduct import Replay
    from lpvmpc.identify.follow import Steering


@dataclass(frozen=True, kw_only=True)
class Options:
    """Drive the simulated car by a recording, and say how alike the two are; identify the car."""

    recording: Path | None = None
    """CSV file with the columns t_s, delta_rad, vx_mps, r_radps, and perhaps vy_mps, ax_mps2,
    ay_mps2."""
    rows: Annotated[tuple[int, int], cli.Option(metavar="FIRST END")] = (0, 0)
    """Samples to fit on, END not included, of the recording or of each of --fit-on (default: all).
    The whole recording is scored."""
    fit: Annotated[tuple[str, ...], cli.Option(metavar="NAME", help=(
        "Parameters to identify: m, lf, lr, Iz, h, mu_f, mu_r, Cf, Cr, relaxation, damping, "
        "steer_lag, steer_offset, steer_ratio, latency."
    ))] = ()
    fit_on: tuple[Path, ...] = ()
    """Recordings to fit on (default: the one that is scored)."""
    car: CarPlace = None
    follow: Literal["wheels", "force"] = "wheels"
    """What follows the recorded speed: the car's own drive and brakes, without lag and limit, or
    a force on the whole car."""
    tire: TireFile = None
    push: Path | None = None
    """Side force and yaw moment over time that act besides, as --save-push wrote them for another
    recording; scores without them are told as well."""
    save_push: Path | None = None
    """Identify them on the recording that is fitted on, and write them to this CSV file."""
    save: Path | None = None
    """Write the car that was identified into this folder, for --car."""
    study: bool = False
    """Write the evidence that ships, docs/results/replay.md, instead (some ten minutes)."""
    out: Path | None = None
    """Folder of the report (default: runs/replay; of --study: docs/results)."""
    json: Path | None = None
    """Write what was printed to this file as well."""


@with_car()
def main(options: Options) -> int:
    """Replay, print, save; returns the exit code."""
    cli.check_opengl()
    if options.study:
        return _study(options)
    if options.recording is None:
        raise OptionError("--recording", None, "the CSV file of a recording")
    if options.fit_on and not options.fit:
        raise OptionError("--fit-on", str(options.fit_on[0]), "given together with --fit NAME ...")
    if options.save is not None and not options.fit:
        raise OptionError("--save", str(options.save), "given together with --fit NAME ...")
    from lpvmpc.identify import figures, report
    from lpvmpc.identify import push as pushes
    from lpvmpc.identify.candidate import check_names
    from lpvmpc.identify.conduct import conduct
    from lpvmpc.identify.recording import read_recording

    check_names(options.fit)
    if options.save_push is not None and len(options.fit_on) > 1:
        raise OptionError("--save-push", str(options.save_push), "given with one recording")
    recording = read_recording(options.recording)
    basis = [read_recording(file) for file in options.fit_on]
    if options.rows != (0, 0):
        basis = [one.rows(*options.rows) for one in basis or [recording]]
    push = None if options.push is None else pushes.read(options.push)
    if push is not None:
        pushes.check(push, recording)
    start = _start()
    out = options.out or Path("runs/replay")
    cli.results_folder(out, "replay")
    files = (options.json, options.save_push)
    for folder in (*(file.parent if file else None for file in files), options.save):
        if folder is not None:
            cli.writable_folder(folder)
    found = conduct(
        start, recording, options.fit, basis, follow=options.follow, push=push, progress=say
    )
    print(report.printed(found), end="")
    how = f"python eval/replay.py --recording {options.recording}"
    write_report(
        out, "replay", text=report.markdown(found, how), table=report.as_csv(found),
        values=found.as_json(), picture=figures.overlay(found),
    )
    if options.json is not None:
        write_json(options.json, found.as_json())
    print(f"Saved {out}/ (replay.md, replay.csv, replay.json, replay.png)")
    if options.save_push is not None:
        known = pushes.identify(found.candidates["plant"], (basis or [recording])[0],
                                options.follow)
        pushes.write(options.save_push, known)
        print(f"Saved {options.save_push} (side force up to {abs(known.force).max():.0f} N, yaw "
              f"moment up to {abs(known.moment).max():.0f} N m)")
    if options.save is not None:
        _save(options.save, found)
    return cli.DONE


def _start() -> Candidate:
    """The car that is meant, and what is known of its recordings' steering."""
    from lpvmpc.identify.candidate import Candidate
    from lpvmpc.plant.car_folder import read_car

    read = read_car()
    steering = _steering(read.folder)
    if steering is not None:
        print(f"Steering of recordings as identified with this car: {steering}")
    return Candidate.of(read.model, steering)


def _steering(folder: Path | None) -> Steering | None:
    """What `--save` has written of it into a car's folder."""
    from lpvmpc.identify.saved import steering_of

    return None if folder is None else steering_of(folder)


def _save(folder: Path, found: Replay) -> None:
    from lpvmpc.identify.saved import save

    car = save(folder, found)
    print(f"Saved the car in {folder}/ (largest lateral acceleration {car.params.ay_limit:.2f} "
          "m/s2)")


def _study(options: Options) -> int:
    """Write docs/results/replay.md."""
    from lpvmpc.identify.evidence import study

    out = options.out or Path("docs/results")
    cli.results_folder(out, "replay")
    values = study.write(out, say)
    if options.json is not None:
        write_json(options.json, values)
    print(f"Saved {out}/ (replay.md, replay.csv, replay.json, replay-*.png)")
    return cli.DONE


def say(what: str) -> None:
    """What begins, on a terminal."""
    if sys.stderr.isatty():
        print(what, file=sys.stderr)
