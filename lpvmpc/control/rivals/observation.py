"""What a learned driver is told and what it answers, as numbers in a fixed order.

The environments of `lpvmpc.gym` and the controllers that were trained in them share this file, so
that a policy sees on the road what it saw in training. Signs and frame are those of `State`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from lpvmpc.interface import Command, Preview, State
from lpvmpc.units import Array

STRIDE = 3
"""Periods between two points of the preview."""
POINTS = 11
"""Points of the preview, the first beside the car."""
STEPS = STRIDE * (POINTS - 1)
"""Periods of preview: 0.99 s at a period of 33 ms."""
DRIVE, BRAKE = 4.0, 8.0
"""Acceleration [m/s2] that an action of 1 and of -1 asks for."""


@dataclass(frozen=True)
class Entry:
    """One quantity of an observation."""

    name: str
    """Its name; those of the preview end with the time ahead in periods."""
    unit: str
    """Its unit."""
    bound: float
    """It is cut to plus and minus this."""
    scale: float
    """A usual size; a policy divides by it."""


TABLE: tuple[Entry, ...] = (
    Entry("ey", "m", 20.0, 1.0),
    Entry("epsi", "rad", math.pi, 0.2),
    Entry("vx", "m/s", 100.0, 20.0),
    Entry("vx_error", "m/s", 100.0, 2.0),
    Entry("vy", "m/s", 50.0, 0.5),
    Entry("r", "rad/s", 20.0, 0.5),
    Entry("delta", "rad", 1.0, 0.2),
    Entry("ax", "m/s2", 100.0, 4.0),
    Entry("ay", "m/s2", 100.0, 4.0),
    Entry("last_steering", "-", 1.0, 0.5),
    Entry("last_acceleration", "-", 1.0, 0.5),
    *(Entry(f"kappa_{STRIDE * j}", "1/m", 1.0, 0.05) for j in range(POINTS)),
    *(Entry(f"vx_ref_{STRIDE * j}", "m/s", 100.0, 20.0) for j in range(POINTS)),
)
"""An observation, in order. `vx_error` is vx less the reference beside the car; `last_...` are the
two numbers of the action before; the rest are fields of `State` and `Preview`."""
SIZE = len(TABLE)
"""Numbers in an observation."""
BOUNDS: Array = np.array([entry.bound for entry in TABLE])
SCALES: Array = np.array([entry.scale for entry in TABLE])


@njit(cache=True)
def fill(ey, epsi, vx, vy, r, delta, ax, ay, steering, acceleration, kappa, vx_ref, bounds, out):
    """Write an observation, cut to its bounds, to `out`, shape (SIZE,)."""
    out[0], out[1], out[2], out[3] = ey, epsi, vx, vx - vx_ref[0]
    out[4], out[5], out[6], out[7], out[8] = vy, r, delta, ax, ay
    out[9], out[10] = steering, acceleration
    for j in range(POINTS):
        out[11 + j] = kappa[STRIDE * j]
        out[11 + POINTS + j] = vx_ref[STRIDE * j]
    for i in range(out.size):
        if out[i] != out[i]:
            out[i] = 0.0
        out[i] = min(max(out[i], -bounds[i]), bounds[i])


def observe(state: State, preview: Preview, last: Array) -> npt.NDArray[np.float32]:
    """The observation of a state and a preview of at least `STEPS` periods, shape (SIZE,).

    Args:
        state: True or estimated state.
        preview: The road from there.
        last: The action before, shape (2,).
    """
    out = np.zeros(SIZE, dtype=np.float32)
    fill(preview.ey, preview.epsi, state.vx, state.vy, state.r, state.delta, state.ax, state.ay,
         last[0], last[1], preview.kappa, preview.vx_ref, BOUNDS, out)
    return out


def command_of(action: Array, delta_max: float) -> Command:
    """The command of an action, two numbers that are cut to -1 and 1.

    delta = a_0 delta_max,   ax = 4 m/s2 a_1 where a_1 > 0, 8 m/s2 a_1 where it brakes
    """
    steering = min(max(float(action[0]), -1.0), 1.0)
    push = min(max(float(action[1]), -1.0), 1.0)
    return Command(steering * delta_max, push * (DRIVE if push > 0.0 else BRAKE))


def action_of(command: Command, delta_max: float) -> Array:
    """The action that gives a command, cut to -1 and 1, shape (2,)."""
    push = command.ax / (DRIVE if command.ax > 0.0 else BRAKE)
    action: Array = np.clip([command.delta / delta_max, push], -1.0, 1.0)
    return action
