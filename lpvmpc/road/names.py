"""Names of the roads, without what they are made of: for help texts, which must come at once."""

from __future__ import annotations

SCENARIOS = {
    "paper": "the paper's 1280 m of curvature, speed and wind",
    "paper-loop": "the closed loop of the paper's Fig. 8 at 4 m/s2, under its wind",
    "double-lane-change": "ISO 3888-1 at 15 m/s",
    "skidpad": "figure eight of 30 m radius at 75 % of the grip limit",
    "slalom": "cones 18 m apart at 10 m/s",
    "circuit": "closed, 1.9 km: hairpin, chicane, double apex, sweepers",
    "tuning-a": "closed, 1.0 km, for tuning only",
    "tuning-b": "open, 0.9 km, windy, for tuning only",
}
"""What there is to drive, by name. A road is built by the function of `catalogue` that has its
name, with underscores."""
