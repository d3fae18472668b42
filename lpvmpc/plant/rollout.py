"""Many simulations of the plant at once, through mujoco.batch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
from mujoco.batch import Batch

from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.plant import callbacks
from lpvmpc.plant.motion import PSI, planar_motion
from lpvmpc.units import Array

STEER, DRIVE, WIND_X, WIND_Y = range(4)
"""Columns of ctrl."""
SPIN_QPOS, SPIN_QVEL = (9, 12, 14, 16), (8, 11, 13, 15)
"""Columns of the wheels' spins fl, fr, rl, rr."""
FRICTION = slice(callbacks.FRICTION, callbacks.FRICTION + 4)
"""Columns of userdata with the friction scales less one."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that decides the plant's future; for Plant.restore and Plant.rollout."""

    state: Array
    """MuJoCo's integration state (with ctrl, userdata, warm start), read-only."""
    psi: float
    """Unwrapped heading [rad]."""
    actuation: Any = None
    """Commands on their way into the car, where it has a latency or deviations."""


class Rollouts(NamedTuple):
    """N simulations of T control periods; what is recorded is the end of each period."""

    motion: Array
    """x, y [m], psi (unwrapped) [rad], vx, vy [m/s], r [rad/s], roll, pitch [rad], shape
    (N, T, 8)."""
    delta: Array
    """Road-wheel angle [rad], shape (N, T)."""
    acceleration: Array
    """ax, ay of the centre of mass [m/s2], shape (N, T, 2)."""
    wheel_speed: Array
    """Spin of the wheels [rad/s], shape (N, T, 4)."""
    qpos: Array
    """Generalised coordinates, shape (N, T, 17)."""
    outputs: Array
    """Forces and slips in the columns that callbacks.py names, shape (N, T, NUSERDATA)."""
    final: list[Snapshot]
    """The N states at the end."""


def rollout(
    model: mujoco.MjModel,
    nstep: int,
    layout: tuple[Array, Array],
    snapshots: Snapshot | Sequence[Snapshot],
    commands: npt.ArrayLike,
    wind: npt.ArrayLike | None,
    friction: npt.ArrayLike | None,
    threads: int,
) -> Rollouts:
    """See Plant.rollout; model, physics steps per period and motion.mass_layout are the plant's."""
    commands = np.asarray(commands, dtype=np.float64)
    if commands.ndim != 3 or commands.shape[2] != 2 or not np.isfinite(commands).all():
        raise OptionError("commands", commands.shape, "finite numbers of shape (N, T, 2)")
    N, T, _ = commands.shape
    wind = np.zeros((N, T, 2)) if wind is None else np.asarray(wind, dtype=np.float64)
    if wind.shape != (N, T, 2) or not np.isfinite(wind).all():
        raise OptionError("wind", wind.shape, f"finite numbers of shape {(N, T, 2)}")
    starts = [snapshots] * N if isinstance(snapshots, Snapshot) else list(snapshots)
    if len(starts) != N:
        raise OptionError("snapshots", len(starts), f"one, or N = {N} as the commands")

    batch = Batch(model, N, threads)
    batch.state[:] = [start.state for start in starts]
    names = ("qpos", "qvel", "act", "ctrl", "userdata")
    qpos, qvel, act, ctrl, userdata = (batch.bind(name) for name in names)
    if friction is not None:
        scale = np.asarray(friction, dtype=np.float64)
        userdata[:, FRICTION] = (
            friction_scale(scale[:, None] if scale.ndim == 1 else scale, (N, 4)) - 1
        )
    out = Rollouts(
        motion=np.empty((N, T, 8)),
        delta=np.empty((N, T)),
        acceleration=np.empty((N, T, 2)),
        wheel_speed=np.empty((N, T, 4)),
        qpos=np.empty((N, T, model.nq)),
        outputs=np.empty((N, T, model.nuserdata)),
        final=[],
    )
    for k in range(T):
        ctrl[:, STEER : DRIVE + 1] = commands[:, k]
        ctrl[:, WIND_X : WIND_Y + 1] = wind[:, k]
        batch.step(nstep=nstep)
        for i in range(N):
            planar_motion(qpos[i], qvel[i], *layout, out.motion[i, k])
        out.delta[:, k] = act[:, 0]
        out.wheel_speed[:, k] = qvel[:, SPIN_QVEL]
        out.qpos[:, k] = qpos
        out.outputs[:, k] = userdata
    if not np.isfinite(out.motion).all():
        raise LPVMPCError("A simulation of the rollout has diverged.")
    out.acceleration[:] = out.outputs[:, :, callbacks.AX : callbacks.AY + 1]
    before = np.array([start.psi for start in starts])[:, None]
    out.motion[:, :, PSI] = np.unwrap(np.hstack([before, out.motion[:, :, PSI]]))[:, 1:]
    for i in range(N):
        state = batch.state[i].copy()
        state.flags.writeable = False
        out.final.append(Snapshot(state, float(out.motion[i, -1, PSI])))
    return out


def friction_scale(scale: float | npt.ArrayLike, shape: tuple[int, ...]) -> Array:
    """Check friction scales and spread them over a shape that ends with the four wheels."""
    values = np.asarray(scale, dtype=np.float64)
    fits = values.ndim <= len(shape) and all(
        n in (1, m) for n, m in zip(values.shape[::-1], shape[::-1], strict=False)
    )
    if not fits or not ((values >= 0.01) & (values <= 2.0)).all():
        raise OptionError("friction", scale, "one number, or one per wheel, from 0.01 to 2")
    return np.broadcast_to(values, shape)
