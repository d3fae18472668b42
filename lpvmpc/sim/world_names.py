"""Names of the worlds, without what they are made of: for help texts, which must come at once."""

from __future__ import annotations

WORLD_NAMES = {
    "ideal": "everything is as the controller believes",
    "rtk": "the nominal test car with GNSS/INS",
    "production": "the nominal car with the sensors and the latency of a series car",
    "fleet": "one of many cars, on a real road, with the sensors of a test car",
    "fleet-production": "one of many cars, on a real road, with its own sensors and latency",
}
"""What each is, by name; `world.WORLDS` has them."""
