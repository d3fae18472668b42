"""A replay as text: the tables of the command line, and Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from lpvmpc.identify.candidate import PARAMETERS
from lpvmpc.identify.conduct import MODELS, TITLES, Replay
from lpvmpc.identify.predict import PLANT
from lpvmpc.identify.scores import Score
from lpvmpc.identify.single_track import KINDS
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.report import csv_text, versions_line

NAMES = {"r": "yaw rate", "vy": "vy", "ay": "ay"}
"""Channels in words."""
METHOD = """\
The plant is driven with the recorded steering **at the knuckle**: the servo is bypassed (no lag, no
rate limit), the angle is linear between samples, or held where the recording holds it. {follow}
Each segment begins with the car held at the first recorded speed and yaw rate until springs and
tires are settled. R2 = 1 - sum (simulated - measured)^2 / sum (measured - mean)^2; NRMSE is the
root mean square of the difference over the measured range; gain and lag are the amplitude and the
delay (positive: the simulation is late) at which the two are most alike; error energy is 1 - R2,
added over yaw rate and vy. The single tracks have the same values of the same parameters, or were
fitted to the same samples.
"""
FOLLOWED = {
    "wheels": "The car's own driven wheels and brakes follow the recorded speed, without lag and "
              "with limits lifted.",
    "force": "A force on the whole car at the height of the road follows the recorded speed.",
}
"""Sentences."""


def _r2(one: Score) -> str:
    return "-" if one.r2 is None else f"{one.r2:.5f}"


def _cells(one: Score) -> list[str]:
    nrmse = "-" if one.nrmse is None else f"{100 * one.nrmse:.2f} %"
    gain = "-" if one.gain is None else f"{one.gain:.3f}"
    lag = "-" if one.lag_s is None else f"{1000 * one.lag_s:.0f} ms"
    return [_r2(one), nrmse, gain, lag]


def tables(replay: Replay) -> list[str]:
    """Markdown tables of a replay: fit, whole, windows, bands, drift."""
    found = fit_tables(replay)
    rows = []
    for model in MODELS:
        for name, one in replay.scores[model].whole.items():
            ratio = "-" if model == PLANT else f"{replay.ratio(model, name):.3f}" if (
                name in replay.energies[model]) else "-"
            rows.append([TITLES[model], NAMES[name], *_cells(one), ratio])
    found.append(markdown_table(
        "Whole recording; last column: error energy of the plant over this model's",
        ["model", "channel", "R2", "NRMSE", "gain", "lag", "ratio"], rows, ["channel"],
    ))
    windows = replay.scores[PLANT].windows
    found.append(_parts("Plant, by window [s]", windows, replay, "windows"))
    found.append(_parts(
        "Plant and linear single track, by lateral acceleration abs(r vx) [m/s2]",
        replay.scores[PLANT].bands, replay, "bands",
    ))
    drift = [
        [f"{one['from_s']:.1f} to {one['to_s']:.1f}", f"{one['distance_m']:.0f} m",
         f"{one['position_m']:.2f} m", f"{one['position_max_m']:.2f} m",
         f"{57.29578 * one['heading_max_rad']:.2f} deg"]
        for one in replay.scores[PLANT].drift
    ]
    found.append(markdown_table(
        "Plant, drift of the pose from where the measured speeds lead",
        ["segment [s]", "distance", "position at the end", "largest", "largest heading"], drift,
    ))
    return found


def _parts(
    title: str, parts: Sequence[tuple[float, float, Mapping[str, Score]]], replay: Replay,
    kind: str,
) -> str:
    channels = list(replay.scores[PLANT].whole)
    header = ["from to", "samples", *(f"{NAMES[name]} R2" for name in channels)]
    if kind == "bands":
        header += [f"{NAMES[name]} R2, linear" for name in channels]
    rows = []
    for i, (low, high, by) in enumerate(parts):
        cells = [f"{low:g} to {high:g}", str(by["r"].samples), *(_r2(by[n]) for n in channels)]
        if kind == "bands":
            other = replay.scores["linear"].bands[i][2]
            cells += [_r2(other[n]) for n in channels]
        rows.append(cells)
    return markdown_table(title, header, rows)


def fit_tables(replay: Replay) -> list[str]:
    """Parameters of the fits, correlations, warnings; nothing where nothing was fitted."""
    if not replay.fits:
        return []
    rows = []
    for model, fit in replay.fits.items():
        for one in fit.parameters:
            notes = ["" if one.identifiable else "not identifiable", "bound" * one.at_bound]
            rows.append([
                TITLES[model], one.name, PARAMETERS[one.name].unit, f"{one.start:.6g}",
                f"{one.value:.6g}", f"{one.low95:.6g} to {one.high95:.6g}",
                ", ".join(filter(None, notes)) or "ok",
            ])
    found = [markdown_table(
        f"Fitted on {', '.join(replay.fitted_on)}",
        ["model", "parameter", "unit", "start", "value", "95 % interval", "note"], rows,
        ["parameter", "unit", "note"],
    )]
    found.append("The wheel between samples, as chosen: " + "; ".join(
        f"{TITLES[model]} {fit.wheel}" for model, fit in replay.fits.items()) + ".\n")
    fit = replay.fits[PLANT]
    names = [one.name for one in fit.parameters]
    if len(names) > 1:
        found.append(markdown_table(
            "Plant, correlations of the estimates", ["", *names],
            [[name, *(f"{fit.correlations[i, j]:.2f}" for j in range(len(names)))]
             for i, name in enumerate(names)],
        ))
    if fit.warnings:
        found.append("\n".join(f"- Warning: {one}" for one in fit.warnings) + "\n")
    return found


def printed(replay: Replay) -> str:
    """What the command prints."""
    lines = [
        f"{replay.recording.name}: {len(replay.recording.t)} samples, "
        f"{len(replay.segments)} segment(s), steering "
        f"{'held between commands' if replay.recording.held else 'linear between samples'}; servo "
        f"bypassed; {replay.follow} follow the speed.",
        "",
    ]
    lines[1:1] = _pushed(replay)
    text = "\n".join([*lines, *tables(replay)])
    for kind in KINDS:
        text += (
            f"Error energy of the plant over that of the {TITLES[kind]}: {replay.ratio(kind):.3f}\n"
        )
    return text


def _pushed(replay: Replay) -> list[str]:
    if replay.unpushed is None:
        return []
    without = ", ".join(f"{NAMES[name]} {'-' if r2 is None else f'{r2:.5f}'}"
                        for name, r2 in replay.unpushed.items())
    return ["A side force and a yaw moment that no column records act besides on the plant, not on "
            f"the single tracks; without them its R2 is: {without}."]


def as_csv(replay: Replay) -> str:
    """Every score as rows."""
    rows = []
    for model in MODELS:
        own = replay.scores[model]
        parts = [("whole", 0.0, 0.0, own.whole)]
        parts += [("window", *one) for one in own.windows]
        parts += [("band", *one) for one in own.bands]
        for kind, low, high, by in parts:
            for name, one in by.items():
                rows.append([
                    model, kind, low, high, name, one.samples, one.r2, one.nrmse, one.rmse,
                    one.gain, one.lag_s,
                ])
    header = ["model", "part", "from", "to", "channel", "samples", "r2", "nrmse", "rmse", "gain",
              "lag_s"]
    return csv_text(header, rows)


def markdown(replay: Replay, how: str) -> str:
    """The report of one replay."""
    held = "held between commands" if replay.recording.held else "linear between samples"
    head = [
        f"# Replay of {replay.recording.name}", "", f"`{how}`", "", versions_line(), "",
        *weak_points(replay), "",
        METHOD.format(follow=FOLLOWED[replay.follow]),
        f"{len(replay.recording.t)} samples, {len(replay.segments)} segment(s); the steering is "
        f"{held}.", "",
        *(f"**{one}**\n" for one in _pushed(replay)),
    ]
    return "\n".join([*head, *tables(replay)]) + "\n![Overlay](replay.png)\n"


def weak_points(replay: Replay) -> list[str]:
    """What does not hold, first."""
    told = [f"- {one}" for fit in replay.fits.values() for one in fit.warnings]
    for name, one in replay.scores[PLANT].whole.items():
        if one.r2 is not None and one.r2 < 0.95:
            told.append(f"- The plant's {NAMES[name]} explains only {one.r2:.3f} of what was "
                        "measured.")
    for kind in KINDS:
        if replay.ratio(kind) > 1.0:
            told.append(f"- The {TITLES[kind]} is nearer to what was measured than the plant is.")
    return told or ["No parameter is at its bound or unidentifiable, and the plant is nearer to "
                    "what was measured than the single tracks are."]
