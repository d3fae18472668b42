"""Planar motion of the whole car out of MuJoCo's coordinates."""

import math

import mujoco
import numpy as np
from numba import njit

from lpvmpc.plant.mjcf import WHEELS
from lpvmpc.units import Array

X, Y, PSI, VX, VY, R, ROLL, PITCH = range(8)
"""Columns of a motion."""


@njit(cache=True)
def planar_motion(qpos, qvel, shares, com, out):
    """Planar motion of the whole car's centre of mass from generalised coordinates.

    The centre of mass moves in the chassis by the suspension travels, weighted by the wheels'
    share of the mass: p = x + R (com + z sum(share q)).

    Args:
        qpos: shape (17,).
        qvel: shape (16,).
        shares: mass of each knuckle with its wheel over the whole mass, shape (4,).
        com: centre of mass in the chassis frame at zero travel [m], shape (3,).
        out: x, y, psi (wrapped), vx, vy, r, roll, pitch, shape (8,).
    """
    w, a, b, c = qpos[3], qpos[4], qpos[5], qpos[6]
    n = 1.0 / math.sqrt(w * w + a * a + b * b + c * c)
    w, a, b, c = w * n, a * n, b * n, c * n
    x0, x1, x2 = 1.0 - 2.0 * (b * b + c * c), 2.0 * (a * b + w * c), 2.0 * (a * c - w * b)
    y0, y1, y2 = 2.0 * (a * b - w * c), 1.0 - 2.0 * (a * a + c * c), 2.0 * (b * c + w * a)
    z0, z1, z2 = 2.0 * (a * c + w * b), 2.0 * (b * c - w * a), 1.0 - 2.0 * (a * a + b * b)
    lift = (shares[0] * qpos[7] + shares[1] * qpos[10]) + (
        shares[2] * qpos[13] + shares[3] * qpos[15]
    )
    lift_rate = (shares[0] * qvel[6] + shares[1] * qvel[9]) + (
        shares[2] * qvel[12] + shares[3] * qvel[14]
    )
    h = com[2] + lift
    p0 = x0 * com[0] + y0 * com[1] + z0 * h
    p1 = x1 * com[0] + y1 * com[1] + z1 * h
    p2 = x2 * com[0] + y2 * com[1] + z2 * h
    w0 = x0 * qvel[3] + y0 * qvel[4] + z0 * qvel[5]
    w1 = x1 * qvel[3] + y1 * qvel[4] + z1 * qvel[5]
    w2 = x2 * qvel[3] + y2 * qvel[4] + z2 * qvel[5]
    v0 = qvel[0] + (w1 * p2 - w2 * p1) + z0 * lift_rate
    v1 = qvel[1] + (w2 * p0 - w0 * p2) + z1 * lift_rate
    s2 = x0 * x0 + x1 * x1
    s = math.sqrt(s2)
    out[0], out[1], out[2] = qpos[0] + p0, qpos[1] + p1, math.atan2(x1, x0)
    out[3] = (v0 * x0 + v1 * x1) / s
    out[4] = (v1 * x0 - v0 * x1) / s
    # psi' = (x0 x1' - x1 x0') / (x0^2 + x1^2) with x' = w cross x
    out[5] = (x0 * (w2 * x0 - w0 * x2) - x1 * (w1 * x2 - w2 * x1)) / s2
    out[6] = math.atan2(y2, z2)
    out[7] = math.asin(min(max(-x2, -1.0), 1.0))


def mass_layout(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Mass shares of the wheels with knuckles, and the centre of mass at zero travel."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    chassis = model.body("chassis").id
    mass = model.body_subtreemass
    shares = np.array([mass[model.body(f"knuckle_{w}").id] for w in WHEELS]) / mass[chassis]
    return shares, data.subtree_com[chassis] - data.xpos[chassis]
