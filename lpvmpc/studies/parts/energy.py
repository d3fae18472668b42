"""Where the energy of a drive goes: a ledger of the plant's own forces and motion."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.interface import Command
from lpvmpc.plant import callbacks
from lpvmpc.plant.mjcf import WHEELS, drive_front, numeric, tires
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import SPIN_QVEL
from lpvmpc.units import Array

SUSPENSION_QPOS, SUSPENSION_QVEL = (7, 10, 13, 15), (6, 9, 12, 14)
"""Columns of the suspension travels fl, fr, rl, rr."""
STEER_QPOS, STEER_QVEL = (8, 11), (7, 10)
"""Columns of the two steered hinges."""
SLIP, CARCASS = "tire slip", "tire carcass"
FLOWS = ("drive", "brakes", "rolling", SLIP, CARCASS, "tire damping", "dampers", "air",
         "steering", "stops")
"""Powers of the ledger: what enters the car, negative for what leaves it."""
STORES = ("kinetic", "gravity", "springs", "tire springs")
"""Energies of the ledger."""


@dataclass(frozen=True)
class Ledger:
    """Energy of the car at n instants, and the mean powers between them.

    Their balance, change of the energy against work of the powers, is `residual`.
    """

    t: Array
    """Instants, one physics step apart [s], shape (n,)."""
    stores: dict[str, Array]
    """Energies by name [J], each of shape (n,)."""
    flows: dict[str, Array]
    """Powers by name, into the car [W], each of shape (n - 1,)."""

    def stored(self) -> Array:
        """Energy of the car [J], shape (n,)."""
        total: Array = np.sum(list(self.stores.values()), axis=0)
        return total

    def work(self, name: str) -> float:
        """Work of one power over the whole time [J]."""
        return float(self.flows[name] @ np.diff(self.t))

    def change(self, name: str) -> float:
        """Change of one energy over the whole time [J]."""
        return float(self.stores[name][-1] - self.stores[name][0])

    def residual(self) -> Array:
        """Energy that came from nowhere since the start [J], shape (n,)."""
        powers = np.sum(list(self.flows.values()), axis=0)
        work = np.concatenate([[0.0], np.cumsum(powers * np.diff(self.t))])
        stored = self.stored()
        unexplained: Array = stored - stored[0] - work
        return unexplained


@dataclass(frozen=True)
class Recording:
    """States of every physics step, and the forces that acted from each to the next."""

    qpos: Array
    """Shape (n + 1, 17)."""
    qvel: Array
    """Shape (n + 1, 16)."""
    act: Array
    """Shape (n + 1, 10)."""
    outputs: Array
    """Columns that callbacks.py names, shape (n, NUSERDATA)."""
    energy: Array
    """MuJoCo's potential and kinetic energy, shape (n, 2)."""
    passive: Array
    """Generalised forces of the steered hinges [N m], shape (n, 2)."""
    stops: Array
    """Generalised forces of the suspension's stops, shape (n, 16)."""


def record(plant: Plant, commands: Array, repeat: int) -> Recording:
    """Drive and write down every physics step.

    Args:
        plant: A plant whose control period is its physics step, at the start of the drive.
        commands: (delta, ax), shape (m, 2).
        repeat: Number of physics steps for which each command holds.
    """
    m, d = plant.model, plant.data
    m.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    n = len(commands) * repeat
    out = Recording(
        np.empty((n + 1, m.nq)), np.empty((n + 1, m.nv)), np.empty((n + 1, m.na)),
        np.empty((n, m.nuserdata)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, m.nv)),
    )
    k = 0
    for delta, ax in commands:
        command = Command(float(delta), float(ax))
        for _ in range(repeat):
            out.qpos[k], out.qvel[k], out.act[k] = d.qpos, d.qvel, d.act
            plant.step(command)
            # all of these belong to the state at the beginning of the step
            out.outputs[k], out.energy[k] = d.userdata, d.energy
            out.passive[k] = d.qfrc_passive[list(STEER_QVEL)]
            out.stops[k] = d.qfrc_constraint
            k += 1
    out.qpos[k], out.qvel[k], out.act[k] = d.qpos, d.qvel, d.act
    return out


def ledger(plant: Plant, r: Recording) -> Ledger:
    """Energies and powers of a recording.

    Forces are those that the engine applied; the velocities on which they act are worked out here
    from the coordinates, independently of the engine and of `plant.callbacks`, as means over the
    step. A tire's slip power Fx Vsx + Fy Vy + Mz omega_z is divided in two: what its carcass takes
    up or gives back, F u' for the deflection u of the contact patch, and the rest, which slides.

    Args:
        plant: The plant of the recording, for the numbers of its model.
        r: What was recorded.
    """
    m = plant.model
    dt = float(m.opt.timestep)
    body = _Body(m, r)
    flows = {name: np.zeros(len(r.outputs)) for name in FLOWS}
    compression_energy = np.zeros(len(r.outputs))
    (R_w,) = numeric(m, "wheel")
    brake_front = numeric(m, "powertrain")[4]
    shares = 0.5 * np.array([brake_front, brake_front, 1.0 - brake_front, 1.0 - brake_front])
    spin = body.rates[:, list(SPIN_QVEL)]  # (n, 4)
    share = drive_front(plant.model)
    driven = share * spin[:, :2].mean(axis=1) + (1.0 - share) * spin[:, 2:].mean(axis=1)
    flows["drive"] += r.outputs[:, callbacks.TORQUE_DRIVE] * driven
    for i in range(4):
        c = tires(m)[i // 2].c
        Fx, Fy, Fz, angle = (
            r.outputs[:, column + i]
            for column in (callbacks.FX, callbacks.FY, callbacks.FZ, callbacks.SLIP_ANGLE)
        )
        wheel = body.wheel(i)
        Mz = -_trail(c, np.tan(angle), Fz) * Fy
        u, v = np.diff(r.act[:, 2 + 2 * i]) / dt, np.diff(r.act[:, 3 + 2 * i]) / dt
        slip = Fx * (wheel.Vx - R_w * spin[:, i]) + Fy * wheel.Vy + Mz * body.omega[:, 2]
        carcass = -(Fx * u + Fy * v)
        flows[SLIP] += slip - carcass
        flows[CARCASS] += carcass
        flows["rolling"] -= c[mf.QSY1] * R_w * Fz * spin[:, i]
        flows["brakes"] -= shares[i] * r.outputs[:, callbacks.TORQUE_BRAKE] * spin[:, i]
        pressed = np.maximum(c[mf.R0] * wheel.upright - wheel.height, 0.0)
        flows["tire damping"] += (Fz - c[mf.KZ] * pressed) * wheel.rise
        compression_energy += 0.5 * c[mf.KZ] * pressed**2
    flows["dampers"] -= (body.rates**2) @ m.dof_damping
    forward, leftward = body.air_speed(plant)
    flows["air"] += (
        r.outputs[:, callbacks.AERO_FX] * forward
        + r.outputs[:, callbacks.AERO_FY] * leftward
        + r.outputs[:, callbacks.AERO_MZ] * body.omega[:, 2]
    )
    flows["steering"] += np.sum(r.passive * body.rates[:, list(STEER_QVEL)], axis=1)
    flows["stops"] += np.sum(r.stops * body.rates, axis=1)
    springs = _springs(m, r.qpos[:-1])
    stores = {
        "kinetic": r.energy[:, 1],
        "gravity": r.energy[:, 0] - springs,
        "springs": springs,
        "tire springs": compression_energy,
    }
    # the last recorded force leads beyond the last recorded energy
    t = np.linspace(0.0, dt * (len(r.outputs) - 1), len(r.outputs))
    return Ledger(t, stores, {name: flow[:-1] for name, flow in flows.items()})


@dataclass(frozen=True)
class _Wheel:
    """Motion of one wheel, each of shape (n,)."""

    Vx: Array
    """Velocity of the contact point along the wheel's heading [m/s]."""
    Vy: Array
    """The same to its left."""
    rise: Array
    """The same upwards."""
    height: Array
    """Height of the wheel centre [m]."""
    upright: Array
    """Cosine of the wheel's lean."""


class _Body:
    """Positions at the beginning of each step, and velocities in its middle."""

    def __init__(self, m: mujoco.MjModel, r: Recording):
        self.m = m
        self.q = r.qpos[:-1]
        self.rates: Array = 0.5 * (r.qvel[1:] + r.qvel[:-1])
        self.R = _rotation(self.q[:, 3:7])
        self.omega = np.einsum("nij,nj->ni", self.R, self.rates[:, 3:6])

    def point(self, inside: Array) -> Array:
        """Vector from the chassis' origin in world axes, of a point in the chassis (n, 3)."""
        vector: Array = np.einsum("nij,nj->ni", self.R, inside)
        return vector

    def velocity(self, arm: Array) -> Array:
        """Velocity of a point fixed in the chassis, by its vector from the origin (n, 3)."""
        moving: Array = self.rates[:, :3] + np.cross(self.omega, arm)
        return moving

    def wheel(self, i: int) -> _Wheel:
        """Motion of a wheel: its contact point lies in the wheel's plane, on the road."""
        place = self.m.body_pos[self.m.body(f"knuckle_{WHEELS[i]}").id]
        inside = np.tile(place, (len(self.q), 1))
        inside[:, 2] += self.q[:, SUSPENSION_QPOS[i]]
        centre = self.point(inside)
        height = self.q[:, 2] + centre[:, 2]
        steer = self.q[:, STEER_QPOS[i]] if i < 2 else np.zeros(len(self.q))
        axis = self.point(np.stack([-np.sin(steer), np.cos(steer), 0.0 * steer], axis=1))
        upright = np.hypot(axis[:, 0], axis[:, 1])
        left = axis[:, :2] / upright[:, None]
        aside = height * axis[:, 2] / upright
        contact = np.stack(
            [centre[:, 0] + aside * left[:, 0], centre[:, 1] + aside * left[:, 1], -self.q[:, 2]],
            axis=1,
        )
        sliding = self.rates[:, SUSPENSION_QVEL[i], None] * self.R[:, :, 2]
        v = self.velocity(contact) + sliding
        return _Wheel(
            Vx=v[:, 0] * left[:, 1] - v[:, 1] * left[:, 0],
            Vy=v[:, 0] * left[:, 0] + v[:, 1] * left[:, 1],
            rise=v[:, 2],
            height=height,
            upright=upright,
        )

    def air_speed(self, plant: Plant) -> tuple[Array, Array]:
        """Forward and leftward speed of the centre of mass, on which the air acts."""
        data = mujoco.MjData(self.m)
        mujoco.mj_kinematics(self.m, data)
        mujoco.mj_comPos(self.m, data)
        chassis = self.m.body("chassis").id
        mass = self.m.body_subtreemass
        inside = np.tile(data.subtree_com[chassis] - data.xpos[chassis], (len(self.q), 1))
        for i, wheel in enumerate(WHEELS):
            share = mass[self.m.body(f"knuckle_{wheel}").id] / mass[chassis]
            inside[:, 2] += share * self.q[:, SUSPENSION_QPOS[i]]
        v = self.velocity(self.point(inside))
        ahead = self.R[:, :2, 0] / np.hypot(self.R[:, 0, 0], self.R[:, 1, 0])[:, None]
        return np.sum(v[:, :2] * ahead, axis=1), v[:, 1] * ahead[:, 0] - v[:, 0] * ahead[:, 1]


def _rotation(quaternions: Array) -> Array:
    """Rotation matrices of unit quaternions w, x, y, z: shape (n, 4) to (n, 3, 3)."""
    w, x, y, z = quaternions.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _trail(c: Array, tan_alpha: Array, Fz: Array) -> Array:
    """Pneumatic trail t = R0 QDZ1 (Fz / FNOMIN) cos(QCZ1 atan(QBZ1 tan_alpha)) [m]."""
    shape = np.cos(c[mf.QCZ1] * np.arctan(c[mf.QBZ1] * tan_alpha))
    trail: Array = c[mf.R0] * c[mf.QDZ1] * Fz / c[mf.FNOMIN] * shape
    return trail


def _springs(m: mujoco.MjModel, qpos: Array) -> Array:
    """Energy of the suspension's springs and anti-roll bars [J], shape (n,)."""
    energy = np.zeros(len(qpos))
    for wheel, column in zip(WHEELS, SUSPENSION_QPOS, strict=True):
        spring = float(np.ravel(m.jnt_stiffness[m.joint(f"susp_{wheel}").id])[0])
        energy += 0.5 * spring * (qpos[:, column] - m.qpos_spring[column]) ** 2
    for axle, (left, right) in zip("fr", ((7, 10), (13, 15)), strict=True):
        bar = float(np.ravel(m.tendon_stiffness[m.tendon(f"antiroll_{axle}").id])[0])
        energy += 0.5 * bar * (qpos[:, left] - qpos[:, right]) ** 2
    return energy
