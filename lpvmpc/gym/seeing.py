"""All cars at once, compiled: their motion, their place on the road, reward, and who is lost.

 Motion and errors are those of `Plant.state` and `Path.preview`, the limits those of
`sim.ending`; the reference speed is taken at the points of the path's grid.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lpvmpc.control.rivals.observation import STEPS, fill
from lpvmpc.plant.callbacks import AX, AY
from lpvmpc.plant.motion import planar_motion
from lpvmpc.road.clothoid import preview

STATE = 10
"""Numbers of a car's state: x, y, psi (unwrapped), vx, vy, r, delta, ax, ay, roll."""
S, EY, EPSI, VX_REF, PSI = range(5)
"""Columns of where a car is: arc length, errors, and the reference's speed and heading there."""


@njit(cache=True)
def motions(qpos, qvel, act, userdata, shares, com, out):
    """Write the states of N cars to `out`, shape (N, STATE), from MuJoCo's coordinates.

    `out` holds the states before, whose headings are unwrapped.
    """
    motion = np.zeros(8)
    for i in range(qpos.shape[0]):
        planar_motion(qpos[i], qvel[i], shares[i], com[i], motion)
        turn = motion[2] - out[i, 2]
        turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
        out[i, 0], out[i, 1] = motion[0], motion[1]
        out[i, 2] += turn
        out[i, 3], out[i, 4], out[i, 5] = motion[3], motion[4], motion[5]
        out[i, 6] = act[i, 0]
        out[i, 7], out[i, 8] = userdata[i, AX], userdata[i, AY]
        out[i, 9] = motion[6]


@njit(cache=True)
def look(table, index, spacing, road, states, last, bounds, Ts, where, out):
    """Project N cars on their roads and write what they see.

    Args:
        table: See `Roads`.
        index: The same.
        spacing: The same.
        road: Number of each car's road, shape (N,).
        states: Their states, shape (N, STATE).
        last: Their actions before, shape (N, 2).
        bounds: Of the observation.
        Ts: Control period [s].
        where: as `S` ... `PSI` say, shape (N, 5); s is where the search begins.
        out: Observations, shape (N, SIZE).
    """
    for i in range(states.shape[0]):
        a, b = index[road[i], 0], index[road[i], 1]
        rows, h = table[a:b], spacing[road[i]]
        x = states[i]
        if not math.isfinite(x[0] + x[1] + x[2] + x[3]):
            out[i] = 0.0
            continue
        s, ey, epsi, ahead = preview(
            rows, h, index[road[i], 2] == 1, rows[:, 4], h, x[0], x[1], x[2], where[i, 0],
            STEPS, Ts,
        )
        where[i, 0], where[i, 1], where[i, 2] = s, ey, epsi
        where[i, 3], where[i, 4] = ahead[1, 0], ahead[4, 0]
        fill(ey, epsi, x[3], x[4], x[5], x[6], x[7], x[8], last[i, 0], last[i, 1],
             ahead[0], ahead[1], bounds, out[i])


@njit(cache=True)
def judge(table, index, spacing, road, states, where, last, before, standing, steps, most,
          wall, verge, Ts, limits, reward, lost, over):
    """Reward of the last period, whether a car is lost, and whether its episode is over.

    Args:
        table: See `Roads`.
        index: The same.
        spacing: The same.
        road: As in `look`.
        states: The truth, as in `look`.
        where: The same.
        last: As in `look`.
        before: The actions before those of `last`, shape (N, 2).
        standing: Periods for which each car has stood, counted here, shape (N,).
        steps: Periods driven in the episode, shape (N,).
        most: Periods after which an episode is cut.
        wall: Largest |ey| [m].
        verge: Room beyond the road's edge, where that is further out [m].
        Ts: Control period [s].
        limits: Lost beyond |epsi| [rad], |roll| [rad], below vx [m/s], for a time [s].
        reward: Shape (N,).
        lost: The car has left the road, spun, rolled, stands, or its simulation has failed.
        over: The open road is at its end, or the time is over.
    """
    for i in range(states.shape[0]):
        ey, v = where[i, 1], states[i, 3] - where[i, 3]
        turn = (last[i, 0] - before[i, 0]) / 0.05
        push = (last[i, 1] - before[i, 1]) / 0.5
        reward[i] = (
            0.7 / (1.0 + (ey / 0.3) ** 2) + 0.3 / (1.0 + v * v)
            - 0.05 * min(turn * turn, 4.0) - 0.02 * min(push * push, 4.0)
        )
        a, b, h = index[road[i], 0], index[road[i], 1], spacing[road[i]]
        s, n = where[i, 0], b - a - 1
        if index[road[i], 2] == 1:
            s -= math.floor(s / (n * h)) * n * h
        row = a + min(max(int(s / h + 0.5), 0), n)
        room = max(wall, table[row, 6 if ey > 0.0 else 5] + verge)
        stands = states[i, 3] < limits[2] and where[i, 3] > limits[2]
        standing[i] = standing[i] + 1 if stands else 0
        fine = (
            abs(ey) <= room and abs(where[i, 2]) <= limits[0] and abs(states[i, 9]) <= limits[1]
            and standing[i] * Ts < limits[3] and math.isfinite(states[i, 0] + states[i, 3])
        )
        lost[i] = not fine
        if lost[i]:
            reward[i] = 0.0
        ended = index[road[i], 2] == 0 and where[i, 0] >= n * h
        over[i] = not lost[i] and (ended or steps[i] >= most)
