"""Names of the studies and of the broken cars: for help texts, which must come at once."""

from __future__ import annotations

STUDIES = {
    "tire": "Tire: slip characteristics",
    "static": "Static: mass, loads, rest, suspension",
    "straight": "Straight line: resistances, acceleration, braking",
    "steady-state": "Steady state: circular driving (ISO 4138)",
    "transient": "Transient: lateral response (ISO 7401)",
    "lane-change": "Lane changes (ISO 3888-1, 3888-2)",
    "load-transfer": "Load transfer and roll",
    "numerics": "Numerics: convergence, chatter, energy",
    "cross-model": "Cross-model: single track, CommonRoad multibody",
    "wind": "Wind: side wind and gusts",
}
"""Studies in the order of the report: name on the command line and title. The module of a study is
its name with underscores."""

BROKEN = {
    "wrong-trail": "sign of the pneumatic trail",
    "double-friction": "tire friction doubled",
    "narrow-track": "track narrower by a tenth",
    "late-forces": "tire forces one physics step late",
}
"""Cars that are broken on purpose, by name. The function of `reference.broken_cars` that breaks one
has its name with underscores."""
