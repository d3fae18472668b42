"""The car on its springs as a linear system, and the modes that the plant really has."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.plant.mjcf import WHEELS, numeric
from lpvmpc.plant.plant import Plant
from lpvmpc.units import Array

Z, ROLL, PITCH = 2, 3, 4
"""Coordinates of the body within x, y, z, roll, pitch, yaw; four suspension travels follow."""
N = 10
"""Number of coordinates."""
MOVING = (Z, ROLL, PITCH, 6, 7, 8, 9)
"""Coordinates that have a restoring force: on a road without grip, x, y and yaw have none."""


def linear_model(model: mujoco.MjModel) -> tuple[Array, Array, Array]:
    """Mass, damping and stiffness of the standing car on a road without grip.

    Small motion about the settled pose: the chassis moves and turns as a rigid body, each wheel
    with its knuckle slides along the chassis' vertical axis on a spring, a damper, an anti-roll
    bar and, against the road, the tire's spring and damper. The weight destabilises: rolling
    about the road by -m g h, pitching (about wheels that stand upright) by -m g times the height
    of the centre of mass over the wheel centres.

    Args:
        model: compiled car.

    Returns:
        M, C, K of M q'' + C q' + K q = 0 with q = (x, y, z, roll, pitch, yaw, travels fl, fr, rl,
        rr), each (10, 10), in SI units.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    chassis = model.body("chassis").id
    com = data.subtree_com[chassis].copy()
    g = -model.opt.gravity[2]

    def jacobian(point: Array) -> Array:
        """Velocity of a point of the chassis over the rates of the coordinates, (3, N)."""
        x, y, z = point - com
        J = np.zeros((3, N))
        J[:, :3] = np.eye(3)
        J[:, 3:6] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        return J

    M, C, K = (np.zeros((N, N)) for _ in range(3))

    def add_body(body: int, J: Array, spin: bool = False) -> None:
        M[:] += model.body_mass[body] * J.T @ J
        R = data.ximat[body].reshape(3, 3)
        inertia = R @ np.diag(model.body_inertia[body]) @ R.T
        if spin:  # the wheel turns freely about y: the chassis' pitching does not turn it
            inertia[1, 1] = 0.0
        M[3:6, 3:6] += inertia

    add_body(chassis, jacobian(data.xipos[chassis]))
    for i, wheel in enumerate(WHEELS):
        axle = wheel[0]
        knuckle, rim = model.body(f"knuckle_{wheel}").id, model.body(f"wheel_{wheel}").id
        J = jacobian(data.xipos[rim])
        J[2, 6 + i] = 1.0
        add_body(knuckle, J)
        add_body(rim, J, spin=True)
        joint = model.joint(f"susp_{wheel}")
        K[6 + i, 6 + i] += float(np.ravel(model.jnt_stiffness[joint.id])[0])
        C[6 + i, 6 + i] += float(model.dof_damping[joint.dofadr[0]])
        c = numeric(model, f"tire_{axle}")
        K += c[mf.KZ] * np.outer(J[2], J[2])
        C += c[mf.CZ] * np.outer(J[2], J[2])
    for first, bar in ((6, "antiroll_f"), (8, "antiroll_r")):
        k = float(np.ravel(model.tendon_stiffness[model.tendon(bar).id])[0])
        K[first : first + 2, first : first + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    weight = float(model.body_subtreemass[chassis]) * g
    centres = np.mean([data.xpos[model.body(f"wheel_{w}").id][2] for w in WHEELS])
    K[ROLL, ROLL] -= weight * com[2]
    K[PITCH, PITCH] -= weight * (com[2] - centres)
    return M, C, K


def system(M: Array, C: Array, K: Array) -> Array:
    """Matrix A of x' = A x, x the moving coordinates and their rates, (14, 14).

    x, y and yaw have no forces, so that their rates follow from the conserved momentum.
    """
    move = list(MOVING)
    rest = [i for i in range(N) if i not in MOVING]
    M = M[np.ix_(move, move)] - M[np.ix_(move, rest)] @ np.linalg.solve(
        M[np.ix_(rest, rest)], M[np.ix_(rest, move)]
    )
    n = len(move)
    A = np.zeros((2 * n, 2 * n))
    A[:n, n:] = np.eye(n)
    A[n:, :n] = -np.linalg.solve(M, K[np.ix_(move, move)])
    A[n:, n:] = -np.linalg.solve(M, C[np.ix_(move, move)])
    return A


def poles(M: Array, C: Array, K: Array) -> Array:
    """Eigenvalues of the moving coordinates [1/s], those with positive frequency, (7,) complex."""
    return upper(np.linalg.eigvals(system(M, C, K)))


def free_motion(M: Array, C: Array, K: Array, start: Array, times: Array) -> Array:
    """Displacements and rates after a displacement `start` in the order of MOVING, (n, 14)."""
    values, vectors = np.linalg.eig(system(M, C, K))
    weights = np.linalg.solve(vectors, np.concatenate([start, np.zeros(len(start))]))
    motion: Array = np.real(np.exp(np.outer(times, values)) * weights @ vectors.T)
    return motion


def stiffness(K: Array, coordinate: int) -> float:
    """Stiffness of one moving coordinate when all others give way."""
    others = [i for i in MOVING if i != coordinate]
    give = np.linalg.solve(K[np.ix_(others, others)], K[others, coordinate])
    return float(K[coordinate, coordinate] - K[coordinate, others] @ give)


def upper(values: Any) -> Array:
    """Eigenvalues with positive imaginary part, by size."""
    values = values[values.imag > 1e-6]
    return values[np.argsort(np.abs(values))]


def without_grip(plant: Plant) -> Plant:
    """Take all horizontal tire forces away, so that only the suspension acts."""
    for axle in "fr":
        c = plant.model.numeric(f"tire_{axle}").data
        c[[mf.PKX1, mf.PKX2, mf.PKY1, mf.QSY1]] = 0.0
    plant.model.numeric("low_speed").data[1] = 0.0
    return plant


def record(plant: Plant, start: Array, time: float) -> Array:
    """Free motion of the standing car after a small displacement.

    Args:
        plant: with Ts equal to the physics step.
        start: displacement in the order of `MOVING` [m, rad], shape (7,).
        time: how long [s].

    Returns:
        Displacements and their rates at each step, shape (n, 14).
    """
    plant.reset(trim=False)
    model, data = plant.model, plant.data
    data.qpos[:] = model.qpos0
    travel = [int(model.joint(f"susp_{w}").qposadr[0]) for w in WHEELS]
    rate = [int(model.joint(f"susp_{w}").dofadr[0]) for w in WHEELS]
    height = data.qpos[2]
    data.qpos[2] += start[0]
    data.qpos[4:6] = 0.5 * start[1:3]  # small angles
    data.qpos[travel] = model.qpos0[travel] + start[3:]
    data.qvel[:] = 0.0
    states = np.empty((round(time / model.opt.timestep) + 1, 2 * len(MOVING)))
    for row in states:
        row[0] = data.qpos[2] - height
        row[1:3] = 2.0 * data.qpos[4:6]
        row[3:7] = data.qpos[travel] - model.qpos0[travel]
        row[7] = data.qvel[2]
        row[8:10] = data.qvel[3:5]
        row[10:] = data.qvel[rate]
        mujoco.mj_step(model, data)
    return states


def identify(plant: Plant, time: float = 0.25) -> Array:
    """Poles of the plant's suspension, from its free motion alone.

    Each coordinate is displaced once by a tenth of a millimetre (or milliradian); one matrix A,
    x[k+1] = A x[k], is fitted to all records, and its eigenvalues are poles: log(z) / dt.

    Returns:
        As `poles`.
    """
    runs = [record(plant, 1e-4 * row, time) for row in np.eye(len(MOVING))]
    before = np.concatenate([run[:-1] for run in runs])
    after = np.concatenate([run[1:] for run in runs])
    A = np.linalg.lstsq(before, after, rcond=None)[0].T
    z = np.linalg.eigvals(A).astype(complex)
    values: Array = np.log(z) / plant.model.opt.timestep
    return upper(values)
