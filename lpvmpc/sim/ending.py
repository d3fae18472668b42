"""When a run ends early, and from which starts it would at once."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from lpvmpc.errors import OptionError

if TYPE_CHECKING:
    from lpvmpc.interface import Preview
    from lpvmpc.plant.plant import Plant
    from lpvmpc.road.path import Path
    from lpvmpc.road.scenario import Scenario

EY_LOST = 5.0
"""A car further than this from the path has lost it [m], unless the road itself is wider."""
VERGE = 2.0
"""A car further than this beyond the edge of the road has lost it [m]."""
EPSI_LOST = math.pi / 2.0
"""A car turned further than this from the path has lost it [rad]."""
STUCK_SPEED = 0.5
"""A car slower than this, against a faster reference, stands [m/s]."""
STUCK_TIME = 3.0
"""Time for which it must stand to count as stuck [s]."""
TIME_FACTOR = 2.0
"""A run of more than this many times the reference's duration is given up."""
MAX_LAPS = 100
"""Most laps of one run: all of them are kept in memory."""


def check_start(scenario: Scenario, laps: int, start_offset: tuple[float, float]) -> None:
    """Refuse laps that the road does not have, and starts from which the car would be lost at once.

    Raises:
        OptionError: What is wrong with which of them.
    """
    if type(laps) is not int or not 1 <= laps <= MAX_LAPS:
        raise OptionError("laps", laps, f"a whole number from 1 to {MAX_LAPS}")
    if laps > 1 and not scenario.path.closed:
        raise OptionError("laps", laps, f"1: the road of {scenario.name} is not closed")
    try:
        ey, epsi = (float(value) for value in start_offset)
    except (TypeError, ValueError):
        ey = epsi = math.nan
    if not (abs(ey) <= EY_LOST and abs(epsi) < EPSI_LOST):
        raise OptionError("start_offset", start_offset,
                          f"two numbers, ey from {-EY_LOST:g} to {EY_LOST:g} m and epsi between "
                          "-pi/2 and pi/2 rad")


def why_lost(
    plant: Plant, path: Path, preview: Preview, t: float, stood: float, time_limit: float
) -> str:
    """Why a run cannot go on, or "".

    Args:
        plant: The car.
        path: The road.
        preview: Where the car truly is on it.
        t: Time since the start [s].
        stood: Time for which it has stood [s].
        time_limit: Time that the run may take [s].
    """
    ey = preview.ey
    if abs(ey) > EY_LOST:
        room = path.width_at(preview.s, ey) + VERGE if path.has_widths else 0.0
        if abs(ey) > room:
            return f"off the path: |ey| > {max(EY_LOST, room):.3g} m"
    if abs(preview.epsi) > EPSI_LOST:
        return "spun: |epsi| > pi/2"
    if plant.rolled_over:
        return "rolled over"
    if stood >= STUCK_TIME:
        return f"stuck: vx < {STUCK_SPEED:g} m/s for {STUCK_TIME:g} s"
    if t > time_limit:
        return f"too slow: {TIME_FACTOR:g} times the reference's time"
    return ""
