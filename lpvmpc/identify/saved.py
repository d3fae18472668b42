"""The car that was identified, as a folder that `--car` reads."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from lpvmpc.identify.candidate import PARAMETERS
from lpvmpc.identify.conduct import Replay
from lpvmpc.identify.fit import Fit
from lpvmpc.identify.follow import Steering
from lpvmpc.identify.predict import PLANT
from lpvmpc.kit.files import read_json
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.plant.car_folder import PROVENANCE, Car, write_car
from lpvmpc.plant.vehicle_xml import stated

STEERING = "recorded_steering"
"""Entry of provenance.json: what lies between the recordings' angle and the road wheel."""


def save(folder: Path, replay: Replay) -> Car:
    """Write the identified car: vehicle.xml, provenance.json, README.md.

    Its lateral limit is measured anew. What was identified of the recording's steering is no part
    of the car: it is kept beside it, and applied where the car replays another recording.

    Raises:
        OutputError: The folder cannot be written.
    """
    fit = replay.fits[PLANT]
    candidate = fit.candidate
    n = candidate.car()
    written = replace(candidate, numbers=n, relaxation=1.0, damping=1.0)
    title = f"Identified from {', '.join(replay.fitted_on)}"
    record: dict[str, Any] = {
        "identified": fit.as_json(), "fit_on": list(replay.fitted_on),
        STEERING: asdict(candidate.steering),
        "replayed": {replay.recording.name: {
            name: one.r2 for name, one in replay.scores[PLANT].whole.items()
        }},
    }
    return write_car(
        folder, stated(written.xml(title)), made_by="lpvmpc replay", record=record,
        card=_card(title, fit, replay),
    )


def steering_of(folder: Path) -> Steering | None:
    """What `save` has kept of the recordings' steering; None where it was not identified."""
    told = read_json(folder / PROVENANCE).get(STEERING)
    if not isinstance(told, dict) or set(told) != set(asdict(Steering())):
        return None
    found = Steering(**{name: float(value) for name, value in told.items()})
    return None if found == Steering() else found


def _card(title: str, fit: Fit, replay: Replay) -> str:
    rows = [
        [one.name, PARAMETERS[one.name].about, f"{one.value:.6g}",
         f"{one.low95:.6g} to {one.high95:.6g}", PARAMETERS[one.name].unit,
         "identified" if one.identifiable else "identified, but hardly visible in the recording"]
        for one in fit.parameters
    ]
    scores = ", ".join(
        f"{name} {one.r2:.4f}" for name, one in replay.scores[PLANT].whole.items()
        if one.r2 is not None
    )
    lines = [
        f"# {title}", "",
        "Written by `lpvmpc replay --fit ... --save`. What is not in this table is the packaged "
        "car's, or that of the car which the fit began with.", "",
        markdown_table(
            "Identified", ["parameter", "what", "value", "95 % interval", "unit", "grade"], rows,
            ["what", "unit", "grade"],
        ),
        f"R2 on {replay.recording.name}: {scores}.", "",
        *(f"- {one}" for one in fit.warnings),
    ]
    return "\n".join(lines).rstrip() + "\n"
