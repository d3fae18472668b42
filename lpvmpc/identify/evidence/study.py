"""The evidence that ships: docs/results/replay.md, written by `lpvmpc replay --study`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from lpvmpc.identify import figures, report
from lpvmpc.identify.candidate import Candidate
from lpvmpc.identify.conduct import Replay, conduct
from lpvmpc.identify.evidence.multibody import record
from lpvmpc.identify.recording import read_recording
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import csv_text, versions_line, write_report
from lpvmpc.plant.mjcf import compile_model

CARSIM = Path(str(resources.files("lpvmpc.identify") / "data" / "carsim_run1.csv"))
"""The recording that ships."""
CARSIM_ROWS = (300, 900)
"""Samples on which it is fitted."""
CARSIM_NAMES = ("Iz", "damping", "h", "lr")
"""What is fitted there: yaw rate shows the inertia, vy the lever of the rear axle, and both show
roll (height of the centre of mass, dampers), which sways the tires."""
CARSIM_TRACK_NAMES = ("Cf", "Cr", "Iz", "latency")
"""What the single tracks are fitted with there: the linear one's best of seven sets of four."""
MULTIBODY_NAMES = ("lf", "lr", "Cf", "Cr", "Iz", "mu_f", "mu_r", "relaxation")
"""What is fitted to CommonRoad's car."""
GENTLE, HARD = 0.03, 0.065
"""Its steering amplitudes [rad]: to 4 m/s2, and to its limit."""
LIMITS = {
    "carsim rows": (("r", 0.9985), ("vy", 0.995)), "carsim": (("r", 0.995), ("vy", 0.98)),
    "multibody gentle": (("r", 0.99),), "multibody hard": (("r", 0.95),),
}
"""Smallest R2 that was asked for."""
RATIOS = {"carsim rows": 0.15, "multibody gentle": 0.5, "multibody hard": 0.5}
"""Largest ratio of error energies, plant over linear single track, that was asked for."""
TITLES = {
    "unfitted": "carsim_run1.csv, the packaged car as it is",
    "carsim rows": "carsim_run1.csv, fitted on rows 300 to 900, scored there",
    "carsim": "carsim_run1.csv, the same fit, whole",
    "multibody gentle": "CommonRoad multibody BMW 320i, other manoeuvres, gentle",
    "multibody hard": "CommonRoad multibody BMW 320i, other manoeuvres, to its limit",
}
"""Headings."""
CAN = """\
What this shows, and what not. `carsim_run1.csv` is another simulator's car, driven gently (3.2
m/s2): it says nothing of the limit. Its steering is a command held for 0.1 s; what the wheel did is
not recorded. CommonRoad's car is other people's equations and another tire, driven to its limit,
but without relaxation and load dependence. Neither is a measurement of a real car. The four
parameters of the first fit, the way a segment begins and that commands are held for 0.1 s were
chosen among some thirty tries on this file, the whole-run scores of the first fifteen in sight:
"whole" is not held out. The single tracks were given the best of seven sets of four. A fit
of yaw rate and vy cannot tell mass, inertia and stiffness apart (only their ratios); the numbers of
such a car are those that make it move alike. The limits were set before the first of these
results had been seen.
"""


def replays(progress: Callable[[str], None]) -> dict[str, Replay]:
    """All replays, by the names of `TITLES`."""
    base = Candidate.of(compile_model(visual=False))
    carsim = read_recording(CARSIM)
    rows = carsim.rows(*CARSIM_ROWS)
    progress("carsim_run1.csv")
    found = {"unfitted": conduct(base, carsim)}
    found["carsim rows"] = conduct(base, rows, CARSIM_NAMES, [rows], track_names=CARSIM_TRACK_NAMES)
    found["carsim"] = conduct(
        base, carsim, CARSIM_NAMES, [rows], fits=found["carsim rows"].fits
    )
    progress("CommonRoad multibody")
    fit_on = [record(GENTLE, seconds=15.0), record(HARD, seconds=15.0)]
    fits = None
    for name, top in (("multibody gentle", GENTLE), ("multibody hard", HARD)):
        other = record(top, seconds=15.0, phase=2.0)
        found[name] = conduct(base, other, MULTIBODY_NAMES, fit_on, fits=fits)
        fits = found[name].fits
    return found


def verdicts(found: dict[str, Replay]) -> list[tuple[str, str, float, str, bool]]:
    """Case, figure, value, limit and whether it holds."""
    rows = []
    for case, limits in LIMITS.items():
        for channel, least in limits:
            r2 = found[case].scores["plant"].whole[channel].r2 or 0.0
            rows.append((case, f"{report.NAMES[channel]} R2", r2, f">= {least:g}", r2 >= least))
    for case, most in RATIOS.items():
        ratio = found[case].ratio("linear")
        rows.append((case, "error energy over the linear single track's", ratio, f"<= {most:g}",
                     ratio <= most))
    return rows


def write(out: Path, progress: Callable[[str], None]) -> dict[str, Any]:
    """Replay everything and write replay.md, replay.csv, replay.json and pictures.

    Raises:
        ImportError: commonroad-vehicle-models is not installed.
        OutputError: The folder cannot be written.
    """
    found = replays(progress)
    rows = verdicts(found)
    values = {name: one.as_json() for name, one in found.items()}
    cells = [[case, what, f"{value:.4f}", limit, "ok" if ok else "**missed**"]
             for case, what, value, limit, ok in rows]
    write_report(
        out, "replay", text=_text(found, rows, cells), values=values,
        table=csv_text(["case", "figure", "value", "limit", "ok"], rows),
        pictures={f"replay-{name.replace(' ', '-')}.png": figures.overlay(one)
                  for name, one in found.items() if name in ("carsim", "multibody hard")},
    )
    return values


def _text(
    found: dict[str, Replay], rows: Sequence[tuple[str, str, float, str, bool]],
    cells: Sequence[Sequence[str]],
) -> str:
    missed = [f"- {TITLES[case]}: {what} is {value:.4f}, asked for was {limit}."
              for case, what, value, limit, ok in rows if not ok]
    warned = [f"- {TITLES[name]}: {one}" for name in ("carsim", "multibody hard")
              for one in found[name].fits["plant"].warnings]
    lines = [
        "# Replayed recordings", "", "`python eval/replay.py --study`", "",
        f"{machine()}. {versions_line()}", "", "**What does not hold**", "",
        *(missed or ["- All figures that were asked for hold."]), *warned, "", CAN,
        report.METHOD.format(follow=report.FOLLOWED["wheels"]),
        markdown_table("Figures and limits", ["case", "figure", "value", "limit", "verdict"], cells,
                       ["figure", "limit", "verdict"]),
    ]
    for name, one in found.items():
        lines += [f"## {TITLES[name]}", "", *report.tables(one)]
        if name in ("carsim", "multibody hard"):
            lines += [f"![Overlay](replay-{name.replace(' ', '-')}.png)", ""]
    return "\n".join(lines)
