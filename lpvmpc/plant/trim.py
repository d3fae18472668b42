"""Steady states of the plant: driving straight or on a circle, in wind."""

import math
from collections import OrderedDict
from typing import NamedTuple

import mujoco
import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import OptionError
from lpvmpc.kit.provenance import model_sha256
from lpvmpc.plant.motion import PITCH, PSI, ROLL, VX, VY, R, planar_motion
from lpvmpc.units import GRAVITY, Array

INTEGRATION_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""What of MuJoCo's state decides a simulation's future."""
PERIOD = 0.01
"""Time between two corrections while the car settles [s]."""
TIME_MAX = 25.0
"""Simulated time after which a state that has not settled is called impossible [s]."""
TOLERANCE = 1e-8
"""Largest error of a settled speed [m/s] or yaw rate [rad/s], and largest change of either or of
roll and pitch [rad] per second."""
CALM_PERIODS = 10
"""Number of periods in a row within the tolerance."""
TOLERANCE_END = 1e-4
"""What must hold at TIME_MAX for a slow state (near the limit of grip) still to count."""
VX_STANDING = 0.1
"""Below this speed the car stands on its brakes [m/s]."""
MOST_KEPT = 512
"""Steady states that are kept for the next time; 1.3 kB each."""
_kept: OrderedDict[tuple[object, ...], Array] = OrderedDict()
"""Steady states of this process by all that decides them, the last used last."""


class Steady(NamedTuple):
    """A steady state that is asked for."""

    vx: float
    """Longitudinal speed [m/s]."""
    kappa: float
    """Curvature of the path of the centre of mass [1/m]."""
    wind: tuple[float, float]
    """Velocity of the air [m/s] along and to the left of the car's axis."""
    tilt: tuple[float, float]
    """Grade and bank of the road in the same direction; gravity turns with the car."""
    course: bool
    """Whether `wind` is along and to the left of the car's course instead."""


def settled(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    car: VehicleParams,
    layout: tuple[Array, Array],
    wanted: Steady,
) -> None:
    """What `settle` does, to the bit; the second time at once.

    A search or a benchmark begins the same run over and over, and settling takes as long as driving
    six seconds of it. What is kept is found by every number of the model and of the state.

    Args and errors: as `settle`.
    """
    size = mujoco.mj_stateSize(model, INTEGRATION_STATE)
    start, end = np.empty(size), np.empty(size)
    mujoco.mj_getState(model, data, start, INTEGRATION_STATE)
    key = model_sha256(model), start.tobytes(), wanted
    if key in _kept:
        _kept.move_to_end(key)
        mujoco.mj_setState(model, data, _kept[key], INTEGRATION_STATE)
        return
    settle(model, data, car, layout, wanted)
    mujoco.mj_getState(model, data, end, INTEGRATION_STATE)
    _kept[key] = end
    while len(_kept) > MOST_KEPT:
        _kept.popitem(last=False)


def settle(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    car: VehicleParams,
    layout: tuple[Array, Array],
    wanted: Steady,
) -> None:
    """Simulate until the car drives steadily at a speed on a circle of a curvature.

    Two integral controllers act on the commands, one on the yaw rate (its wanted value is
    kappa |V|, since the sideslip angle is constant), one on the speed. Suspension, tires, servo,
    drive and wheel spins settle with them. The deviation falls by e every 1 / bandwidth.

    Args:
        model: compiled car.
        data: its state, rolling straight ahead at vx; left in the settled state, somewhere, with
            the commands that hold it.
        car: parameters.
        layout: mass shares and centre of mass, from motion.mass_layout.
        wanted: the state.

    Raises:
        OptionError: the car cannot hold such a state.
    """
    vx, kappa, wind, tilt, course = wanted
    nstep = max(round(PERIOD / model.opt.timestep), 1)
    dt = nstep * model.opt.timestep
    L, K = car.wheelbase, car.m / car.wheelbase * (car.lr / car.Cf - car.lf / car.Cr)
    yaw_gain = max(vx, 0.5) / (L + K * vx * vx)  # linear single track
    bandwidth = min(4.0, max(vx, 0.5))  # [1/s]: a slow car's tires relax over a longer time
    delta = math.atan(kappa * (L + K * vx * vx))
    ax = 0.0 if vx >= VX_STANDING else -1.0
    data.act[0], data.act[1] = delta, ax
    data.qvel[1] = kappa * vx * (car.lr - car.lf * car.m * vx * vx / (L * car.Cr))
    data.qvel[5] = kappa * vx
    pull, tilted = gravity(*tilt), tilt != (0.0, 0.0)
    now, old = np.zeros(8), np.zeros(8)
    planar_motion(data.qpos, data.qvel, *layout, now)
    error, calm = math.inf, 0
    for _ in range(round(TIME_MAX / dt)):
        old[:] = now
        turn = now[PSI]
        if course:
            turn += math.atan2(now[VY], max(now[VX], VX_STANDING))
        cos, sin = math.cos(turn), math.sin(turn)
        air = cos * wind[0] - sin * wind[1], sin * wind[0] + cos * wind[1]
        data.ctrl[:4] = delta, ax, *air
        if tilted:
            model.opt.gravity[0] = cos * pull[0] - sin * pull[1]
            model.opt.gravity[1] = sin * pull[0] + cos * pull[1]
        mujoco.mj_step(model, data, nstep=nstep)
        planar_motion(data.qpos, data.qvel, *layout, now)
        if vx >= VX_STANDING:
            missing_r = kappa * math.hypot(now[VX], now[VY]) - now[R]
            missing_vx = vx - now[VX]
            delta += dt * bandwidth * missing_r / yaw_gain
            delta = min(max(delta, -car.delta_max), car.delta_max)
            # poles of v'' = 4 (vx - v) - 4 v' at -2: as fast as the drive's lag allows
            ax += dt * 4.0 * missing_vx - 4.0 * (now[VX] - old[VX])
            ax = min(max(ax, -3.0), 3.0)
            error = max(abs(missing_vx), abs(missing_r))
        else:
            error = abs(now[VX])
        change = max(abs(now[i] - old[i]) / dt for i in (VX, VY, R, ROLL, PITCH))
        error = max(error, change)
        calm = calm + 1 if error < TOLERANCE else 0
        if calm == CALM_PERIODS:
            return
    if not error < TOLERANCE_END:
        raise OptionError(
            "kappa", kappa, f"a curvature that the car can hold at {vx:g} m/s in this wind"
        )


def gravity(grade: float, bank: float) -> tuple[float, float, float]:
    """Gravity along, to the left of, and up from a road of such slopes [m/s2].

    g (-grade, bank, -1) / sqrt(1 + grade^2 + bank^2)

    Args:
        grade: rise per length ahead [-].
        bank: fall per length to the left [-].
    """
    g = GRAVITY / math.sqrt(1.0 + grade * grade + bank * bank)
    return 0.0 - g * grade, g * bank, -g  # 0.0 -: on a level road +0.0, as in the model file


def place(
    data: mujoco.MjData, layout: tuple[Array, Array], x: float, y: float, psi: float, course: bool
) -> float:
    """Turn and move the car as a whole; only its pose and its world-frame velocity change.

    Args:
        data: state of the car.
        layout: mass shares and centre of mass, from motion.mass_layout.
        x: position of the centre of mass [m].
        y: the same [m].
        psi: direction [rad] of the car's axis, or of its course.
        course: whether psi is that of the course.

    Returns:
        The heading [rad].
    """
    motion = np.zeros(8)
    planar_motion(data.qpos, data.qvel, *layout, motion)
    if course and motion[VX] >= VX_STANDING:
        psi -= math.atan2(motion[VY], motion[VX])
    turn = psi - motion[PSI]
    q = np.array([math.cos(turn / 2.0), 0.0, 0.0, math.sin(turn / 2.0)])
    mujoco.mju_mulQuat(data.qpos[3:7], q, data.qpos[3:7].copy())
    mujoco.mju_rotVecQuat(data.qvel[:3], data.qvel[:3].copy(), q)
    planar_motion(data.qpos, data.qvel, *layout, motion)
    data.qpos[0] += x - motion[0]
    data.qpos[1] += y - motion[1]
    return psi
