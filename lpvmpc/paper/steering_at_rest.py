"""Does the steering come to rest? A gust pushes the car off the line, then nothing is left to do.

Without the gust a run starts, and stays, in equilibrium, even where that is unstable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lpvmpc.road.path import Path
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.speed_profile import SpeedProfile
from lpvmpc.road.wind import Wind
from lpvmpc.sim.log import Log

SPEEDS = (2.0, 5.0, 10.0, 20.0, 30.0)
"""Speeds at which it is looked at [m/s]."""
LIMIT = 3.5e-6
"""Largest peak to peak of the steering angle at rest [rad]: twice what was measured (1.76e-6, at
2 m/s) when it was set. A thousand times more, a degree at the hand wheel, would not yet be felt."""
ANSWERED = 1.4e-3
"""Least peak to peak that shows that the gust was answered [rad]: half of the least measured."""
GUST_ENDS = 1.1
"""When the gust is over [s]."""
WATCHED = 5.0
"""Last part of the run, in which the steering has to rest [s]; the run takes twice that."""
AY, TIGHTEST = 2.0, 0.1
"""Lateral acceleration [m/s2] and largest curvature [1/m] of the circles: 0.4 m/s2 at 2 m/s."""


@dataclass(frozen=True, kw_only=True)
class GustAnswer:
    """What the steering did."""

    vx: float
    """Speed [m/s]."""
    turning: bool
    """On a circle, or straight on."""
    completed: bool
    """Whether the car reached the end."""
    answered: float
    """Peak to peak of the steering command over the whole run [rad]."""
    left: float
    """Peak to peak over its last part [rad]."""

    @property
    def ok(self) -> bool:
        """Whether the gust was answered, and the steering then came to rest."""
        return self.completed and self.answered > ANSWERED and self.left <= LIMIT


def scenario(vx: float, turning: bool) -> Scenario:
    """Ten seconds at one speed [m/s], straight or on a circle, with a gust in the first."""
    kappa = min(AY / vx**2, TIGHTEST) if turning else 0.0
    road = Path.from_curvature([kappa, kappa], 2.0 * WATCHED * vx)
    gust = Wind(knots=(0.0, 1.0, GUST_ENDS), speeds=(10.0, 10.0, 0.0))
    return Scenario(
        name="circle" if turning else "straight",
        path=road,
        speed=SpeedProfile.constant(vx, road),
        wind=gust,
    )


def of(log: Log, vx: float, turning: bool) -> GustAnswer:
    """Judge a run of `scenario`."""
    t, delta = log.columns["t_s"], log.columns["delta_cmd_rad"]
    return GustAnswer(
        vx=vx,
        turning=turning,
        completed=bool(log.meta["completed"]),
        answered=float(np.ptp(delta)),
        left=float(np.ptp(delta[t > t[-1] - WATCHED])),
    )
