"""The tire law inside MuJoCo: compiled `mjcb_passive` and `mjcb_act_dyn` callbacks.

`install()` gives MuJoCo two C functions, compiled by numba, which read the tires' law and
coefficients from the model's <custom> fields and add tire, brake, drive, steering and air forces to
`qfrc_passive`. So `mj_step(model, data, nstep=33)` runs without Python and without the GIL, and the
same functions serve `mujoco.batch.Batch`.

Callbacks are global to the process. These leave every model alone that does not carry our fields
(`_is_ours`), so other models may be stepped beside the car.

All forces are computed at the state at the beginning of the step and applied in the frames of that
state. The wheels make no MuJoCo contact: the tire's normal force is an explicit spring and damper
of the wheel centre's height over the plane z = 0.
"""

import math
from itertools import accumulate

import mujoco
import numpy as np
from numba import cfunc, njit, types

from lpvmpc.car import tire
from lpvmpc.car.aero import aero_wrench
from lpvmpc.car.tire import Tire
from lpvmpc.errors import LPVMPCError
from lpvmpc.plant import structs
from lpvmpc.plant.mjcf import (
    DRIVE_FRONT,
    LAYOUT,
    NA,
    NQ,
    NU,
    NUMERICS,
    NUSERDATA,
    NV,
    TIRE_LAW,
)
from lpvmpc.plant.structs import chars, doubles, field, ints, longs, offsets
from lpvmpc.plant.vectors import add, clip, cross, dot, subtract, vector

# Where the numerics of mjcf.NUMERICS begin in numeric_data; those of the tires follow them.
_SIZES = dict(NUMERICS)
_ENDS = dict(zip(_SIZES, accumulate(_SIZES.values()), strict=True))
_STARTS = {name: end - _SIZES[name] for name, end in _ENDS.items()}
STEERING, POWERTRAIN, AERO = _STARTS["steering"], _STARTS["powertrain"], _STARTS["aero"]
WHEEL, LOW_SPEED, TIRES = _STARTS["wheel"], _STARTS["low_speed"], sum(_SIZES.values())
_NEXT = len(NUMERICS) + 2  # number of the numeric after the tires'

# Names as zero-ended bytes: of what a model may have besides, and of the laws.
_DRIVE_FRONT = np.frombuffer(DRIVE_FRONT.encode() + b"\0", np.uint8)
_TIRE_LAW = np.frombuffer(TIRE_LAW.encode() + b"\0", np.uint8)
_LAWS = np.array([list(law.NAME.encode().ljust(32, b"\0")) for law in tire.LAWS], np.uint8)

# Columns of userdata: the friction scale less one (so that a cleared row means normal grip), the
# derivatives handed from the passive callback to the actuation callback, and the outputs, which
# belong to the state at the beginning of the last step.
FRICTION = 0  # (4,) friction scale minus one of each wheel
ACT_DOT = 4  # (10,) derivative of act
FX, FY, FZ = 14, 18, 22  # (4,) tire forces along, left of, and normal to each wheel [N]
SLIP_RATIO, SLIP_ANGLE, MU = 26, 30, 34  # (4,) slips [-, rad], peak friction [-]
AX, AY = 38, 39  # acceleration of the centre of mass, yaw frame [m/s2]
ALPHA_F, ALPHA_R = 40, 41  # axle slip angles of the centre of mass's velocity [rad]
AERO_FX, AERO_FY, AERO_MZ = 42, 43, 44  # wrench of the air, yaw frame [N, N m]
TORQUE_DRIVE, TORQUE_BRAKE = 45, 46  # at the wheels, all together [N m]


_M = offsets("mjModel")
_D = offsets("mjData")
_M_NQ, _M_NV, _M_NU, _M_NA = _M["nq"], _M["nv"], _M["nu"], _M["na"]
_M_NUSERDATA, _M_NNUMERICDATA = _M["nuserdata"], _M["nnumericdata"]
_M_NUMERIC, _M_BODY, _M_DOF_M0 = _M["numeric_data"], _M["dof_bodyid"], _M["dof_M0"]
_M_NTEXT, _M_TEXT, _M_TEXT_ADR = _M["ntext"], _M["text_data"], _M["text_adr"]
_M_NNUMERIC, _M_NUMERIC_ADR = _M["nnumeric"], _M["numeric_adr"]
_M_NAME_NUMERIC = _M["name_numericadr"]
_M_NAMES, _M_NAME_TEXT = _M["names"], _M["name_textadr"]
_M_MASS = _M["body_subtreemass"]
_M_DT = _M["opt"] + offsets("mjOption")["timestep"]
_M_ACTADR = _M["actuator_actadr"]
_D_QPOS, _D_QVEL, _D_ACT, _D_CTRL = _D["qpos"], _D["qvel"], _D["act"], _D["ctrl"]
_D_USERDATA, _D_QFRC, _D_ACT_DOT = _D["userdata"], _D["qfrc_passive"], _D["act_dot"]
_D_XPOS, _D_XMAT, _D_COM = _D["xpos"], _D["xmat"], _D["subtree_com"]
_D_XANCHOR, _D_XAXIS = _D["xanchor"], _D["xaxis"]


@njit(cache=True)
def _equal(text, name):
    """Whether a zero-ended text is that name; name is zero-ended too."""
    for i in range(len(name)):
        if text[i] != name[i]:
            return False
        if name[i] == 0:
            break
    return True


@njit(cache=True)
def _named_law(m):
    """Number of the tire law that the model names: the first where none is, -1 where unknown."""
    for i in range(longs(m + _M_NTEXT)[0]):
        name = chars(longs(m + _M_NAMES)[0] + ints(longs(m + _M_NAME_TEXT)[0])[i])
        if _equal(name, _TIRE_LAW):
            text = chars(longs(m + _M_TEXT)[0] + ints(longs(m + _M_TEXT_ADR)[0])[i])
            for law in range(len(_LAWS)):
                if _equal(text, _LAWS[law]):
                    return law
            return -1
    return 0


@njit(cache=True)
def _drive_front(m):
    """Share of the drive on the front axle; 1 where the model does not say."""
    if longs(m + _M_NNUMERIC)[0] > _NEXT:
        name = chars(longs(m + _M_NAMES)[0] + ints(longs(m + _M_NAME_NUMERIC)[0])[_NEXT])
        if _equal(name, _DRIVE_FRONT):
            return field(m, _M_NUMERIC)[ints(longs(m + _M_NUMERIC_ADR)[0])[_NEXT]]
    return 1.0


@njit(cache=True)
def _is_ours(m):
    """Whether the model is a car of this package, so that all fields used below exist."""
    return (
        longs(m + _M_NQ)[0] == NQ
        and longs(m + _M_NV)[0] == NV
        and longs(m + _M_NU)[0] == NU
        and longs(m + _M_NA)[0] == NA
        and longs(m + _M_NUSERDATA)[0] == NUSERDATA
        and longs(m + _M_NNUMERICDATA)[0] >= TIRES
        and field(m, _M_NUMERIC)[0] == LAYOUT
    )


@njit(cache=True)
def ackermann(delta, half_track_over_wheelbase):
    """Angle of the left wheel of an axle steered by delta about one common turning centre.

    tan(delta_left) = tan(delta) / (1 - (t / 2L) tan(delta)); the right wheel has -t.
    """
    t = math.tan(delta)
    return math.atan(t / (1.0 - half_track_over_wheelbase * t))


@njit(cache=True)
def _lag_rate(wanted, value, tau, dt):
    """Mean rate over dt of a first-order lag, so that a step of Euler is exact."""
    return (wanted - value) * (-math.expm1(-dt / tau) / dt)


@njit(cache=True)
def _powertrain(p, act, qvel, mass, spin_inertia, front, out):
    """Torques of the motor and of all brakes at the wheels [N m].

    T = R_w (m + sum(J_w) / R_w^2) ax, limited by the motor's torque and power, or by the brakes.
    """
    R_w = p[WHEEL]
    torque = R_w * (mass + spin_inertia / (R_w * R_w)) * act[1]
    drive = min(max(torque, 0.0), p[POWERTRAIN + 1])
    spin = 0.5 * abs(qvel[8] + qvel[11])
    if front < 1.0:
        spin = front * spin + (1.0 - front) * 0.5 * abs(qvel[13] + qvel[15])
    if drive * spin > p[POWERTRAIN + 2]:
        drive = p[POWERTRAIN + 2] / spin
    brake = min(max(-torque, 0.0), p[POWERTRAIN + 3])
    out[TORQUE_DRIVE], out[TORQUE_BRAKE] = drive, brake
    return drive, brake


@njit(cache=True)
def _damp(rubber, Fx, Fy, Fz, friction, damping, Vsx, Vsy):
    """Damp the tire, which is a spring near standstill, within the friction ellipse."""
    Fx -= damping * Vsx
    Fy -= damping * Vsy
    mux, muy = tire.peak_friction(rubber, Fz)
    fx, fy = Fx / (friction * mux * Fz), Fy / (friction * muy * Fz)
    scale = 1.0 / math.sqrt(max(fx * fx + fy * fy, 1.0))
    return scale * Fx, scale * Fy


@njit(cache=True)
def _tire(p, rubber, wheel, Fz, Vx, Vy, spin, act, dt, out):
    """Relaxation and forces of one tire: Fx, Fy [N], Mz [N m].

    Near standstill the deflection is capped, so that a wheel that was locked does not throw the car
    back, and the tire, elastic by then, is damped.
    """
    Vsx = Vx - p[WHEEL] * spin
    speed = abs(Vx)
    sigma_x, sigma_y = tire.relaxation_lengths(rubber, Fz)
    slow = max(1.0 - speed / p[LOW_SPEED], 0.0)  # 1 at standstill, 0 above the low speed
    cap = p[LOW_SPEED + 3] + slow * (p[LOW_SPEED + 2] - p[LOW_SPEED + 3])
    i = 2 + 2 * wheel
    u = clip(tire.relax(act[i], Vsx, speed, sigma_x, dt), cap * sigma_x)
    v = clip(tire.relax(act[i + 1], Vy, speed, sigma_y, dt), cap * sigma_y)
    out[ACT_DOT + i] = (u - act[i]) / dt
    out[ACT_DOT + i + 1] = (v - act[i + 1]) / dt

    slip_ratio, tan_alpha = u / sigma_x, v / sigma_y
    friction = max(1.0 + out[FRICTION + wheel], 1e-3)
    Fx, Fy, Mz = tire.forces(rubber, slip_ratio, tan_alpha, Fz, friction)
    if slow > 0.0 and Fz > 0.0:
        Fx, Fy = _damp(rubber, Fx, Fy, Fz, friction, p[LOW_SPEED + 1] * slow * slow, Vsx, Vy)
    out[FX + wheel], out[FY + wheel], out[FZ + wheel] = Fx, Fy, Fz
    out[SLIP_RATIO + wheel], out[SLIP_ANGLE + wheel] = slip_ratio, math.atan(tan_alpha)
    out[MU + wheel] = friction * tire.peak_friction(rubber, Fz)[1]
    return Fx, Fy, Mz


@njit(cache=True)
def _passive(m, d, law):
    """Add all forces of the car that MuJoCo does not know to qfrc_passive."""
    p = field(m, _M_NUMERIC)
    coefficients = longs(m + _M_NUMERIC)[0] + 8 * TIRES  # address; those of an axle follow in turn
    dt = doubles(m + _M_DT)[0]
    M0 = field(m, _M_DOF_M0)
    chassis = ints(longs(m + _M_BODY)[0])[0]
    mass = field(m, _M_MASS)[chassis]
    qpos, qvel = field(d, _D_QPOS), field(d, _D_QVEL)
    act, ctrl = field(d, _D_ACT), field(d, _D_CTRL)
    out, qfrc = field(d, _D_USERDATA), field(d, _D_QFRC)
    xanchor, xaxis = field(d, _D_XANCHOR), field(d, _D_XAXIS)

    # Chassis: origin, axes, velocities in the world.
    origin = vector(field(d, _D_XPOS), chassis)
    xmat = doubles(longs(d + _D_XMAT)[0] + 72 * chassis)
    ex, ey = (xmat[0], xmat[3], xmat[6]), (xmat[1], xmat[4], xmat[7])
    ez = (xmat[2], xmat[5], xmat[8])
    velocity = (qvel[0], qvel[1], qvel[2])
    omega = (
        ex[0] * qvel[3] + ey[0] * qvel[4] + ez[0] * qvel[5],
        ex[1] * qvel[3] + ey[1] * qvel[4] + ez[1] * qvel[5],
        ex[2] * qvel[3] + ey[2] * qvel[4] + ez[2] * qvel[5],
    )
    com = subtract(vector(field(d, _D_COM), chassis), origin)

    # Steering servo with a rate limit, drive and brake: lags of the commands.
    delta_max, rate_max = p[STEERING + 2], p[STEERING + 1]
    out[ACT_DOT] = clip(_lag_rate(clip(ctrl[0], delta_max), act[0], p[STEERING], dt), rate_max)
    out[ACT_DOT + 1] = _lag_rate(ctrl[1], act[1], p[POWERTRAIN], dt)
    delta_next = act[0] + dt * out[ACT_DOT]
    spin_inertia = (M0[8] + M0[11]) + (M0[13] + M0[15])
    drive_front = _drive_front(m)
    drive, brake = _powertrain(p, act, qvel, mass, spin_inertia, drive_front, out)

    # Geometry from the wheel centres (joints 3, 6, 8 are the spins fl, fr, rl).
    front_left = vector(xanchor, 3)
    wheelbase = dot(ex, subtract(front_left, vector(xanchor, 8)))
    half_track = 0.5 * dot(ey, subtract(front_left, vector(xanchor, 6)))
    lf = dot(ex, subtract(front_left, origin)) - dot(ex, com)

    force = (0.0, 0.0, 0.0)  # of all tires, world
    moment = (0.0, 0.0, 0.0)  # about the chassis origin
    for axle in range(2):
        rubber = Tire(law, doubles(coefficients + 8 * axle * tire.size(law)))
        # Left and right are added first: such a sum is exact under mirroring.
        axle_force, axle_moment = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        for side in range(2):
            wheel = 2 * axle + side
            if axle == 0:
                susp, dof_susp, spin, dof_spin = (
                    1 + 3 * side,
                    6 + 3 * side,
                    3 + 3 * side,
                    8 + 3 * side,
                )
            else:
                susp, dof_susp, spin, dof_spin = (
                    7 + 2 * side,
                    12 + 2 * side,
                    8 + 2 * side,
                    13 + 2 * side,
                )
            centre = subtract(vector(xanchor, spin), origin)
            height = xanchor[3 * spin + 2]
            axis = vector(xaxis, spin)  # to the left
            up = vector(xaxis, susp)
            rate = qvel[dof_susp]
            sliding = (rate * up[0], rate * up[1], rate * up[2])

            # Heading and left of the wheel in the road plane. The contact point lies below the
            # centre in the wheel's plane, on the road z = 0.
            upright = max(math.sqrt(axis[0] * axis[0] + axis[1] * axis[1]), 1e-6)
            left = (axis[0] / upright, axis[1] / upright)
            ahead = (left[1], -left[0])
            shift = height / upright * axis[2]
            contact = (centre[0] + shift * left[0], centre[1] + shift * left[1], -origin[2])

            v = add(add(velocity, cross(omega, contact)), sliding)
            rise = add(add(velocity, cross(omega, centre)), sliding)[2]
            Fz = tire.vertical_force(rubber, rubber.c[tire.R0] * upright - height, -rise)
            Vx, Vy = v[0] * ahead[0] + v[1] * ahead[1], v[0] * left[0] + v[1] * left[1]
            Fx, Fy, Mz = _tire(p, rubber, wheel, Fz, Vx, Vy, qvel[dof_spin], act, dt, out)

            # Wheel spin: tire, motor, and the dry friction of brake and rolling resistance, which
            # at most stops the wheel within this step.
            R_w = p[WHEEL]
            torque = -R_w * Fx
            share = p[POWERTRAIN + 4]
            if axle == 0:
                torque += 0.5 * drive * drive_front
            else:
                share = 1.0 - share
                if drive_front < 1.0:
                    torque += 0.5 * drive * (1.0 - drive_front)
            dry = 0.5 * share * brake + tire.rolling_resistance(rubber) * R_w * Fz
            stopping = M0[dof_spin] * qvel[dof_spin] / dt + torque
            qfrc[dof_spin] += torque - clip(stopping, dry)

            # Knuckle: the rack carries the tire's moment about the steering axis (so that is not
            # added here), and moves the knuckle to the servo's angle of the end of the step.
            if axle == 0:
                dof = dof_susp + 1
                arm = (half_track if side == 0 else -half_track) / wheelbase
                gap = ackermann(delta_next, arm) - qpos[8 + 3 * side]
                qfrc[dof] += M0[dof] * (gap / dt - qvel[dof]) / dt

            on_road = (Fx * ahead[0] + Fy * left[0], Fx * ahead[1] + Fy * left[1], Fz)
            qfrc[dof_susp] += dot(up, on_road)
            axle_force = add(axle_force, on_road)
            axle_moment = add(axle_moment, add(cross(contact, on_road), (0.0, 0.0, Mz)))
        force = add(force, axle_force)
        moment = add(moment, axle_moment)

    # Air, at the centre of mass of the whole car, in axes that only yaw.
    level = math.sqrt(ex[0] * ex[0] + ex[1] * ex[1])
    cos_psi, sin_psi = ex[0] / level, ex[1] / level
    v = add(velocity, cross(omega, com))
    vx, vy = v[0] * cos_psi + v[1] * sin_psi, v[1] * cos_psi - v[0] * sin_psi
    wind_x = ctrl[2] * cos_psi + ctrl[3] * sin_psi
    wind_y = ctrl[3] * cos_psi - ctrl[2] * sin_psi
    Fx, Fy, Mz = aero_wrench(
        vx - wind_x, vy - wind_y, p[AERO], p[AERO + 1], p[AERO + 2], p[AERO + 3]
    )
    out[AERO_FX], out[AERO_FY], out[AERO_MZ] = Fx, Fy, Mz
    air = (Fx * cos_psi - Fy * sin_psi, Fx * sin_psi + Fy * cos_psi, 0.0)
    force = add(force, air)
    moment = add(moment, add(cross(com, air), (0.0, 0.0, Mz)))

    # The linear part of a free joint is in the world's frame, the angular part in the body's.
    qfrc[0] += force[0]
    qfrc[1] += force[1]
    qfrc[2] += force[2]
    qfrc[3] += dot(ex, moment)
    qfrc[4] += dot(ey, moment)
    qfrc[5] += dot(ez, moment)

    out[AX] = (force[0] * cos_psi + force[1] * sin_psi) / mass
    out[AY] = (force[1] * cos_psi - force[0] * sin_psi) / mass
    # Slip angles of the single track at this instant; a standing car's would be noise.
    vx = max(vx, 0.1)
    out[ALPHA_F] = act[0] - math.atan2(vy + lf * omega[2], vx)
    out[ALPHA_R] = -math.atan2(vy - (wheelbase - lf) * omega[2], vx)


@cfunc(types.void(types.int64, types.int64), cache=True)
def _mjcb_passive(m, d):
    if not _is_ours(m):
        return
    law = _named_law(m) if longs(m + _M_NTEXT)[0] > 0 else 0
    if law >= 0 and longs(m + _M_NNUMERICDATA)[0] >= TIRES + 2 * tire.size(law):
        _passive(m, d, law)


@cfunc(types.float64(types.int64, types.int64, types.int32), cache=True)
def _mjcb_act_dyn(m, d, actuator):
    if not _is_ours(m):
        return 0.0
    out, act_dot = field(d, _D_USERDATA), field(d, _D_ACT_DOT)
    first = ints(longs(m + _M_ACTADR)[0])[actuator]
    if first == 2:  # where there are several states, MuJoCo wants them written
        for i in range(2, NA):
            act_dot[i] = out[ACT_DOT + i]
    return out[ACT_DOT + first]


def install() -> None:
    """Give MuJoCo the callbacks of the car; calling it again does nothing.

    Raises:
        LPVMPCError: another callback is installed, or this MuJoCo lays out its structs otherwise
            than its own description says.
    """
    for name, function in (("passive", _mjcb_passive.ctypes), ("act_dyn", _mjcb_act_dyn.ctypes)):
        present = getattr(mujoco, f"get_mjcb_{name}")()
        if present is function:
            continue
        if present is not None:
            raise LPVMPCError(f"Another mjcb_{name} is installed in MuJoCo; remove it first.")
        structs.check()
        getattr(mujoco, f"set_mjcb_{name}")(function)


def uninstall() -> None:
    """Take the callbacks of the car out of MuJoCo, if they are installed."""
    if mujoco.get_mjcb_passive() is _mjcb_passive.ctypes:
        mujoco.set_mjcb_passive(None)
    if mujoco.get_mjcb_act_dyn() is _mjcb_act_dyn.ctypes:
        mujoco.set_mjcb_act_dyn(None)
