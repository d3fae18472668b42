"""The tire law inside MuJoCo: compiled `mjcb_passive` and `mjcb_act_dyn` callbacks.

`install()` gives MuJoCo two C functions, compiled by numba, which read the tire coefficients from
the model's <custom> numerics and add tire, brake, drive, steering and air forces to
`qfrc_passive`. So `mj_step(model, data, nstep=33)` runs without Python and without the GIL, and the
same functions serve `mujoco.batch.Batch`.

Callbacks are global to the process. These leave every model alone that does not carry our fields
(`_is_ours`), so other models may be stepped beside the car.

All forces are computed at the state at the beginning of the step and applied in the frames of that
state. The wheels make no MuJoCo contact: the tire's normal force is an explicit spring and damper
of the wheel centre's height over the plane z = 0.
"""

import ctypes
import math
from functools import cache

import mujoco
import numpy as np
from mujoco.introspect import ast_nodes, structs
from numba import carray, cfunc, njit, types
from numba.extending import intrinsic

from lpvmpc import tire
from lpvmpc.aero import aero_wrench
from lpvmpc.errors import LPVMPCError
from lpvmpc.model import LAYOUT, NA, NQ, NU, NUSERDATA, NV

# Where the numerics of model.NUMERICS begin in numeric_data.
STEERING, POWERTRAIN, AERO, WHEEL, LOW_SPEED = 1, 4, 9, 13, 14
TIRE_F = 21
TIRE_R = TIRE_F + tire.N_COEFFICIENTS
N_NUMERIC = TIRE_R + tire.N_COEFFICIENTS

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
POWER_TIRE = 47  # power of the tire forces on the car, wheels included [W]


def field_offsets(name: str) -> dict[str, int]:
    """Byte offset of every field of a MuJoCo struct, as the installed version lays it out."""
    return {field: getattr(_structure(name), field).offset for field, _ in _fields(name)}


@cache
def _structure(name: str) -> type[ctypes.Structure]:
    """MuJoCo struct as a ctypes type."""
    return type(name, (ctypes.Structure,), {"_fields_": _fields(name)})


@cache
def _fields(name: str) -> list[tuple[str, type]]:
    return [(field.name, _c_type(field.type)) for field in structs.STRUCTS[name].fields]


_C_TYPES: dict[str, type] = {
    "int": ctypes.c_int, "unsigned int": ctypes.c_uint, "unsigned char": ctypes.c_ubyte,
    "float": ctypes.c_float, "double": ctypes.c_double, "char": ctypes.c_char,
    "size_t": ctypes.c_size_t, "uint64_t": ctypes.c_uint64, "uintptr_t": ctypes.c_size_t,
    "mjtNum": ctypes.c_double, "mjtByte": ctypes.c_ubyte, "mjtBool": ctypes.c_bool,
    "mjtSize": ctypes.c_int64,
}  # fmt: skip


def _c_type(kind: object) -> type:
    """ctypes type of a declaration in mujoco.introspect."""
    if isinstance(kind, ast_nodes.PointerType):
        return ctypes.c_void_p
    if isinstance(kind, ast_nodes.ArrayType):
        count = math.prod(kind.extents)
        return _c_type(kind.inner_type) * count
    if isinstance(kind, ast_nodes.AnonymousStructDecl):
        fields = [(field.name, _c_type(field.type)) for field in kind.fields]
        return type("anonymous", (ctypes.Structure,), {"_fields_": fields})
    assert isinstance(kind, ast_nodes.ValueType), kind
    if kind.name in _C_TYPES:
        return _C_TYPES[kind.name]
    if kind.name in structs.STRUCTS:
        return _structure(kind.name)
    return ctypes.c_int  # an enumeration


_M = field_offsets("mjModel")
_D = field_offsets("mjData")
_M_NQ, _M_NV, _M_NU, _M_NA = _M["nq"], _M["nv"], _M["nu"], _M["na"]
_M_NUSERDATA, _M_NNUMERICDATA = _M["nuserdata"], _M["nnumericdata"]
_M_NUMERIC, _M_BODY, _M_DOF_M0 = _M["numeric_data"], _M["dof_bodyid"], _M["dof_M0"]
_M_MASS = _M["body_subtreemass"]
_M_DT = _M["opt"] + field_offsets("mjOption")["timestep"]
_M_ACTADR = _M["actuator_actadr"]
_D_QPOS, _D_QVEL, _D_ACT, _D_CTRL = _D["qpos"], _D["qvel"], _D["act"], _D["ctrl"]
_D_USERDATA, _D_QFRC, _D_ACT_DOT = _D["userdata"], _D["qfrc_passive"], _D["act_dot"]
_D_XPOS, _D_XMAT, _D_COM = _D["xpos"], _D["xmat"], _D["subtree_com"]
_D_XANCHOR, _D_XAXIS = _D["xanchor"], _D["xaxis"]


def _pointer_cast(element):  # type: ignore[no-untyped-def]
    """Make an intrinsic that turns an address into a pointer to `element`."""

    @intrinsic
    def cast(typing_context, address):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            return builder.inttoptr(args[0], context.get_value_type(signature.return_type))

        return types.CPointer(element)(types.int64), codegen

    return cast


_doubles = _pointer_cast(types.float64)
_longs = _pointer_cast(types.int64)
_ints = _pointer_cast(types.int32)


@njit(cache=True)
def _array(struct, offset):
    """Pointer to the doubles to which the field at `offset` of a struct points."""
    return _doubles(_longs(struct + offset)[0])


@njit(cache=True)
def _is_ours(m):
    """Whether the model is a car of this package, so that all fields used below exist."""
    return (
        _longs(m + _M_NQ)[0] == NQ
        and _longs(m + _M_NV)[0] == NV
        and _longs(m + _M_NU)[0] == NU
        and _longs(m + _M_NA)[0] == NA
        and _longs(m + _M_NUSERDATA)[0] == NUSERDATA
        and _longs(m + _M_NNUMERICDATA)[0] >= N_NUMERIC
        and _array(m, _M_NUMERIC)[0] == LAYOUT
    )


@njit(cache=True)
def ackermann(delta, half_track_over_wheelbase):
    """Angle of the left wheel of an axle steered by delta about one common turning centre.

    tan(delta_left) = tan(delta) / (1 - (t / 2L) tan(delta)); the right wheel has -t.
    """
    t = math.tan(delta)
    return math.atan(t / (1.0 - half_track_over_wheelbase * t))


@njit(cache=True)
def _cross(a0, a1, a2, b0, b1, b2):
    return a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0


@njit(cache=True)
def _passive(m, d):
    """Add all forces of the car that MuJoCo does not know to qfrc_passive."""
    p = _array(m, _M_NUMERIC)
    dt = _doubles(m + _M_DT)[0]
    M0 = _array(m, _M_DOF_M0)
    chassis = _ints(_longs(m + _M_BODY)[0])[0]
    mass = _array(m, _M_MASS)[chassis]
    qpos, qvel = _array(d, _D_QPOS), _array(d, _D_QVEL)
    act, ctrl = _array(d, _D_ACT), _array(d, _D_CTRL)
    out, qfrc = _array(d, _D_USERDATA), _array(d, _D_QFRC)
    xpos, xmat = _array(d, _D_XPOS), _array(d, _D_XMAT)
    com = _array(d, _D_COM)
    xanchor, xaxis = _array(d, _D_XANCHOR), _array(d, _D_XAXIS)
    tires = carray(_doubles(_longs(m + _M_NUMERIC)[0] + 8 * TIRE_F), (2, tire.N_COEFFICIENTS))

    # Chassis: position, rotation, angular velocity in the world.
    b = 3 * chassis
    x0, x1, x2 = xpos[b], xpos[b + 1], xpos[b + 2]
    b = 9 * chassis
    r00, r01, r02 = xmat[b], xmat[b + 1], xmat[b + 2]
    r10, r11, r12 = xmat[b + 3], xmat[b + 4], xmat[b + 5]
    r20, r21, r22 = xmat[b + 6], xmat[b + 7], xmat[b + 8]
    w0 = r00 * qvel[3] + r01 * qvel[4] + r02 * qvel[5]
    w1 = r10 * qvel[3] + r11 * qvel[4] + r12 * qvel[5]
    w2 = r20 * qvel[3] + r21 * qvel[4] + r22 * qvel[5]
    norm = math.sqrt(r00 * r00 + r10 * r10)
    cos_psi, sin_psi = r00 / norm, r10 / norm

    # Steering servo: first-order lag with a rate limit, integrated exactly over the step.
    tau, rate_max, delta_max = p[STEERING], p[STEERING + 1], p[STEERING + 2]
    delta = act[0]
    target = min(max(ctrl[0], -delta_max), delta_max)
    rate = (target - delta) * (-math.expm1(-dt / tau) / dt)
    rate = min(max(rate, -rate_max), rate_max)
    out[ACT_DOT] = rate
    delta_next = delta + dt * rate

    # Drive and brake: first-order lag of the wanted acceleration, then torque and power limits.
    tau = p[POWERTRAIN]
    R_w = p[WHEEL]
    out[ACT_DOT + 1] = (ctrl[1] - act[1]) * (-math.expm1(-dt / tau) / dt)
    inertia = (M0[8] + M0[11]) + (M0[13] + M0[15])
    torque = R_w * (mass + inertia / (R_w * R_w)) * act[1]
    spin_f = 0.5 * abs(qvel[8] + qvel[11])
    drive = min(max(torque, 0.0), p[POWERTRAIN + 1])
    if drive * spin_f > p[POWERTRAIN + 2]:
        drive = p[POWERTRAIN + 2] / spin_f
    brake = min(max(-torque, 0.0), p[POWERTRAIN + 3])
    out[TORQUE_DRIVE], out[TORQUE_BRAKE] = drive, brake

    v_low, damping = p[LOW_SPEED], p[LOW_SPEED + 1]
    cap_low, cap_high = p[LOW_SPEED + 2], p[LOW_SPEED + 3]

    # Geometry of the axles in the chassis frame, from the anchors: no number is typed twice.
    wheelbase = 0.0
    half_track = 0.0
    f0, f1 = xanchor[9] - xanchor[18], xanchor[10] - xanchor[19]
    f2 = xanchor[11] - xanchor[20]
    half_track = 0.5 * (r01 * f0 + r11 * f1 + r21 * f2)
    f0, f1 = xanchor[9] - xanchor[24], xanchor[10] - xanchor[25]
    f2 = xanchor[11] - xanchor[26]
    wheelbase = r00 * f0 + r10 * f1 + r20 * f2

    total0, total1, total2 = 0.0, 0.0, 0.0  # force of all tires
    moment0, moment1, moment2 = 0.0, 0.0, 0.0  # moment about the chassis origin
    power = 0.0
    for axle in range(2):
        c = tires[axle]
        # Sums of a left and a right term are exact under mirroring; running sums would not be.
        sum0, sum1, sum2, sum3, sum4, sum5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for side in range(2):
            wheel = 2 * axle + side
            if axle == 0:
                dof_s, dof_w, jnt_s, jnt_w = 6 + 3 * side, 8 + 3 * side, 1 + 3 * side, 3 + 3 * side
            else:
                dof_s, dof_w, jnt_s, jnt_w = (
                    12 + 2 * side, 13 + 2 * side, 7 + 2 * side, 8 + 2 * side
                )  # fmt: skip
            j = 3 * jnt_w
            c0, c1, c2 = xanchor[j], xanchor[j + 1], xanchor[j + 2]  # wheel centre
            a0, a1, a2 = xaxis[j], xaxis[j + 1], xaxis[j + 2]  # spin axis, to the left
            j = 3 * jnt_s
            s0, s1, s2 = xaxis[j], xaxis[j + 1], xaxis[j + 2]  # suspension axis, upward
            susp_rate = qvel[dof_s]

            # Heading e and left n of the wheel in the road plane; tilt of its plane.
            cos_tilt = max(math.sqrt(a0 * a0 + a1 * a1), 1e-6)
            e0, e1 = a1 / cos_tilt, -a0 / cos_tilt
            n0, n1 = -e1, e0

            # Contact point: from the centre down the wheel's plane, to the road.
            drop = c2 / cos_tilt
            p0, p1 = c0 + drop * a2 * n0, c1 + drop * a2 * n1
            l0, l1, l2 = p0 - x0, p1 - x1, -x2
            v0, v1, v2 = _cross(w0, w1, w2, l0, l1, l2)
            v0, v1 = qvel[0] + v0 + s0 * susp_rate, qvel[1] + v1 + s1 * susp_rate
            k0, k1, k2 = _cross(w0, w1, w2, c0 - x0, c1 - x1, c2 - x2)
            centre_rate = qvel[2] + k2 + s2 * susp_rate

            Fz = tire.vertical_force(c, c[tire.R0] * cos_tilt - c2, -centre_rate)

            # Slip velocities and relaxation.
            Vx, Vy = v0 * e0 + v1 * e1, v0 * n0 + v1 * n1
            spin = qvel[dof_w]
            Vsx = Vx - R_w * spin
            speed = abs(Vx)
            sigma_x, sigma_y = tire.relaxation_lengths(c, Fz)
            u_old, v_old = act[2 + 2 * wheel], act[3 + 2 * wheel]
            u = tire.relax(u_old, Vsx, speed, sigma_x, dt)
            v = tire.relax(v_old, Vy, speed, sigma_y, dt)
            low = max(1.0 - speed / v_low, 0.0)
            cap = cap_high + low * (cap_low - cap_high)
            u = min(max(u, -cap * sigma_x), cap * sigma_x)
            v = min(max(v, -cap * sigma_y), cap * sigma_y)
            out[ACT_DOT + 2 + 2 * wheel] = (u - u_old) / dt
            out[ACT_DOT + 3 + 2 * wheel] = (v - v_old) / dt
            slip_ratio, tan_alpha = u / sigma_x, v / sigma_y
            if low > 0.0 and Fz > 0.0:  # damps the elastic tire near standstill
                low = damping * low * low * (3.0 - 2.0 * low)
                slip_ratio -= low * Vsx / tire.slip_stiffness(c, Fz)
                tan_alpha -= low * Vy / tire.cornering_stiffness(c, Fz)

            friction = max(1.0 + out[FRICTION + wheel], 1e-3)
            Fx, Fy, Mz = tire.forces(c, slip_ratio, tan_alpha, Fz, friction)
            out[FX + wheel], out[FY + wheel], out[FZ + wheel] = Fx, Fy, Fz
            out[SLIP_RATIO + wheel], out[SLIP_ANGLE + wheel] = slip_ratio, math.atan(tan_alpha)
            out[MU + wheel] = friction * tire.peak_friction(c, Fz)[1]

            # Wheel spin: tire, motor, and the dry friction of brake and rolling resistance, which
            # at most stops the wheel within this step.
            on_wheel = -R_w * Fx
            if axle == 0:
                on_wheel += 0.5 * drive
                share = p[POWERTRAIN + 4]
            else:
                share = 1.0 - p[POWERTRAIN + 4]
            dry = 0.5 * share * brake + c[tire.QSY1] * R_w * Fz
            stop = M0[dof_w] * spin / dt + on_wheel
            qfrc[dof_w] += on_wheel - min(max(stop, -dry), dry)

            # Suspension.
            g0, g1 = Fx * e0 + Fy * n0, Fx * e1 + Fy * n1
            qfrc[dof_s] += s0 * g0 + s1 * g1 + s2 * Fz

            # Knuckle: the rack carries the tire's moment about the steering axis (so it is not
            # added here), and moves the knuckle to the angle of the servo at the end of the step.
            if axle == 0:
                dof = dof_s + 1
                arm = (half_track if side == 0 else -half_track) / wheelbase
                angle = ackermann(delta_next, arm)
                q = qpos[8 + 3 * side]
                qfrc[dof] += M0[dof] * ((angle - q) / dt - qvel[dof]) / dt

            t0, t1, t2 = _cross(l0, l1, l2, g0, g1, Fz)
            sum0, sum1, sum2 = sum0 + g0, sum1 + g1, sum2 + Fz
            sum3, sum4, sum5 = sum3 + t0, sum4 + t1, sum5 + (t2 + Mz)
            power += Fx * Vsx + Fy * Vy
        total0, total1, total2 = total0 + sum0, total1 + sum1, total2 + sum2
        moment0, moment1, moment2 = moment0 + sum3, moment1 + sum4, moment2 + sum5
    out[POWER_TIRE] = power

    # Air, at the centre of mass of the whole car.
    b = 3 * chassis
    l0, l1, l2 = com[b] - x0, com[b + 1] - x1, com[b + 2] - x2
    v0, v1, v2 = _cross(w0, w1, w2, l0, l1, l2)
    v0, v1 = qvel[0] + v0, qvel[1] + v1
    u0, u1 = ctrl[2] - v0, ctrl[3] - v1
    Fx, Fy, Mz = aero_wrench(
        u0 * cos_psi + u1 * sin_psi, u1 * cos_psi - u0 * sin_psi,
        p[AERO], p[AERO + 1], p[AERO + 2], p[AERO + 3],
    )  # fmt: skip
    out[AERO_FX], out[AERO_FY], out[AERO_MZ] = Fx, Fy, Mz
    g0, g1 = Fx * cos_psi - Fy * sin_psi, Fx * sin_psi + Fy * cos_psi
    t0, t1, t2 = _cross(l0, l1, l2, g0, g1, 0.0)
    total0, total1 = total0 + g0, total1 + g1
    moment0, moment1, moment2 = moment0 + t0, moment1 + t1, moment2 + (t2 + Mz)

    qfrc[0] += total0
    qfrc[1] += total1
    qfrc[2] += total2
    # The angular part of a free joint is in the body's frame.
    qfrc[3] += r00 * moment0 + r10 * moment1 + r20 * moment2
    qfrc[4] += r01 * moment0 + r11 * moment1 + r21 * moment2
    qfrc[5] += r02 * moment0 + r12 * moment1 + r22 * moment2

    out[AX] = (total0 * cos_psi + total1 * sin_psi) / mass
    out[AY] = (total1 * cos_psi - total0 * sin_psi) / mass
    # Axle slip angles of the single track at the same instant.
    vx, vy = v0 * cos_psi + v1 * sin_psi, v1 * cos_psi - v0 * sin_psi
    rf = r00 * (xanchor[9] - com[b]) + r10 * (xanchor[10] - com[b + 1])
    rf += r20 * (xanchor[11] - com[b + 2])
    vx = max(vx, 0.1)  # the angle of a standing car would be noise
    out[ALPHA_F] = delta - math.atan2(vy + rf * w2, vx)
    out[ALPHA_R] = -math.atan2(vy - (wheelbase - rf) * w2, vx)


@cfunc(types.void(types.int64, types.int64), cache=True)
def _mjcb_passive(m, d):
    if _is_ours(m):
        _passive(m, d)


@cfunc(types.float64(types.int64, types.int64, types.int32), cache=True)
def _mjcb_act_dyn(m, d, actuator):
    if not _is_ours(m):
        return 0.0
    out, act_dot = _array(d, _D_USERDATA), _array(d, _D_ACT_DOT)
    first = _ints(_longs(m + _M_ACTADR)[0])[actuator]
    if first == 2:  # for more than one state MuJoCo wants them written
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
        _check_layout()
        getattr(mujoco, f"set_mjcb_{name}")(function)


def uninstall() -> None:
    """Take the callbacks of the car out of MuJoCo, if they are installed."""
    if mujoco.get_mjcb_passive() is _mjcb_passive.ctypes:
        mujoco.set_mjcb_passive(None)
    if mujoco.get_mjcb_act_dyn() is _mjcb_act_dyn.ctypes:
        mujoco.set_mjcb_act_dyn(None)


@cache
def _check_layout() -> None:
    """Compare the address of every array that MuJoCo shows to Python with the computed layout."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><size nuserdata='1'/><custom><numeric name='n' data='1'/></custom>"
        "<worldbody><body><freejoint/><geom size='1'/></body><body><joint name='j'/>"
        "<geom size='1'/></body></worldbody>"
        "<actuator><general joint='j' dyntype='integrator'/></actuator></mujoco>"
    )
    data = mujoco.MjData(model)
    for struct, offsets in ((model, _M), (data, _D)):
        for name, offset in offsets.items():
            value = getattr(struct, name, None)
            if isinstance(value, np.ndarray) and value.size and value.base is not None:
                address = ctypes.c_void_p.from_address(struct._address + offset).value
                if address not in (value.ctypes.data, None):
                    raise LPVMPCError(
                        f"MuJoCo {mujoco.__version__} lays out {name} otherwise than it describes; "
                        "install the version named in constraints.txt."
                    )
