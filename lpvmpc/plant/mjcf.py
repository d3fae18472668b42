"""The car's MJCF: compiling it, checking that it is our car, reading its parameters."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from importlib import resources
from pathlib import Path as FilePath

import mujoco
import numpy as np

from lpvmpc.car import tire
from lpvmpc.car.current import current, per_car
from lpvmpc.car.params import VehicleParams
from lpvmpc.car.tire import LAWS, MAGIC_FORMULA, Tire
from lpvmpc.errors import ModelError, UnknownNameError
from lpvmpc.units import GRAVITY, Array

# Sizes of the model, by which the callbacks recognise it.
NQ, NV, NU, NA, NUSERDATA = 17, 16, 5, 10, 56
LAYOUT = 1
"""Version of the layout of the numerics; the value of the numeric `lpvmpc_vehicle`."""

NUMERICS = (
    ("lpvmpc_vehicle", 1),
    ("steering", 3),
    ("powertrain", 5),
    ("aero", 4),
    ("wheel", 1),
    ("low_speed", 4),
    ("body", 2),
    ("ay_limit", 1),
)
"""Names and sizes of the <custom> numerics, in the order that the callbacks read."""
TIRES = ("tire_f", "tire_r")
"""Numerics that follow these: coefficients of the front and the rear tires, as the law has them."""
DRIVE_FRONT = "drive_front"
"""Numeric that may follow those: share of the drive on the front axle [-]; without it, all."""
TIRE_LAW = "tire_law"
"""Name of the <custom> text that names the tire law; without it the law is the first of `LAWS`."""

WHEELS = ("fl", "fr", "rl", "rr")
"""Order of the wheels everywhere."""
JOINTS = (
    "chassis",
    *("susp_fl", "steer_fl", "spin_fl"),
    *("susp_fr", "steer_fr", "spin_fr"),
    *("susp_rl", "spin_rl"),
    *("susp_rr", "spin_rr"),
)
"""Joints in the order of qpos and qvel."""
ACTUATORS = ("steer", "drive", "wind_x", "wind_y", "tires")
"""Actuators in the order of ctrl."""

PACKAGE = FilePath(str(resources.files("lpvmpc")))
"""Folder of the package; models/ lies in it in a wheel, beside it in a checkout."""

VX_MIN = 1.0
"""Speed below which the single-track model is not used [m/s]: its slip angles divide by vx."""


def models_dir() -> FilePath:
    """Folder of the MJCF files: lpvmpc/models in a wheel, models/ in a checkout.

    Raises:
        ModelError: neither exists.
    """
    for folder in (PACKAGE / "models", PACKAGE.parent / "models"):
        if (folder / "vehicle.xml").is_file():
            return folder
    raise ModelError(f"No models/vehicle.xml beside {PACKAGE}; the installation is damaged.")


def model_path(name: str) -> FilePath:
    """Path of a packaged MJCF file by its name, with or without .xml.

    Raises:
        UnknownNameError: there is no such file; the message lists those there are.
    """
    folder = models_dir()
    path = folder / (name if name.endswith(".xml") else f"{name}.xml")
    if not path.is_file():
        raise UnknownNameError("model", name, (file.stem for file in folder.glob("*.xml")))
    return path


def compile_model(path: str | FilePath | None = None, *, visual: bool = True) -> mujoco.MjModel:
    """Compile an MJCF file and check that it is our car.

    Args:
        path: file (default: that of `--car`, or the packaged models/vehicle.xml).
        visual: keep what is only drawn; without it a step is a little faster and the same.

    Raises:
        ModelError: the file cannot be read or compiled, or is not a car of this package.
    """
    if path is None:
        meant = current()
        path = model_path("vehicle") if meant is None else meant.file
    path = FilePath(path)
    if not path.is_file():
        raise ModelError(f"There is no MJCF file {path}.")
    return _compiled(lambda: mujoco.MjSpec.from_file(str(path)), str(path), visual)


def compile_text(xml: str, source: str = "The text", *, visual: bool = False) -> mujoco.MjModel:
    """Compile the text of an MJCF file that needs no other files, and check that it is our car.

    Args:
        xml: The text.
        source: What to call it in messages.
        visual: As in `compile_model`.

    Raises:
        ModelError: As `compile_model`.
    """
    return _compiled(lambda: mujoco.MjSpec.from_string(xml), source, visual)


def _compiled(
    parse: Callable[[], mujoco.MjSpec], source: str, visual: bool
) -> mujoco.MjModel:
    try:
        spec = parse()
        spec.compiler.discardvisual = not visual
        model = spec.compile()
    except ValueError as error:  # MuJoCo reports schema and compile errors as ValueError
        reason = " ".join(str(error).split()).rstrip(".")
        raise ModelError(f"{source} is no valid MJCF file: {reason}.") from None
    check_model(model, source)
    return model


def check_model(model: mujoco.MjModel, source: str = "The model") -> None:
    """Raise ModelError unless the model is a car of this package.

    Args:
        model: compiled model.
        source: what to call it in the message.
    """

    def names(kind: mujoco.mjtObj, count: int) -> tuple[str, ...]:
        return tuple(mujoco.mj_id2name(model, kind, i) or "(unnamed)" for i in range(count))

    numerics = names(mujoco.mjtObj.mjOBJ_NUMERIC, model.nnumeric)
    sizes = [int(size) for size in model.numeric_size]
    law = LAWS[tire_law(model, source)]
    n = len(NUMERICS)
    checks = {
        "joints": (names(mujoco.mjtObj.mjOBJ_JOINT, model.njnt), JOINTS),
        "actuators": (names(mujoco.mjtObj.mjOBJ_ACTUATOR, model.nactuator), ACTUATORS),
        "custom numerics": (tuple(zip(numerics, sizes, strict=True))[:n], NUMERICS),
        f"custom numerics after {NUMERICS[-1][0]}": (numerics[n : n + 2], TIRES),
        "sizes nq, nv, nu, na, nuserdata": (
            (model.nq, model.nv, model.nu, model.na, model.nuserdata),
            (NQ, NV, NU, NA, NUSERDATA),
        ),
    }
    for what, (found, wanted) in checks.items():
        if found != wanted:
            raise ModelError(
                f"{source} is not a car of this package: its {what} must be "
                f"{_words(wanted)}, not {_words(found)}."
            )
    if DRIVE_FRONT in numerics[n + 3 :]:
        raise ModelError(f"{source} gives {DRIVE_FRONT} elsewhere than right after {TIRES[1]}.")
    if not 0.0 <= drive_front(model) <= 1.0:
        raise ModelError(f"{source} gives {drive_front(model):g} for {DRIVE_FRONT}, which must be "
                         "a share from 0 to 1.")
    if model.numeric_data[0] != LAYOUT:
        raise ModelError(
            f"{source} has layout version {model.numeric_data[0]:g}, but must have {LAYOUT}."
        )
    for name, size in zip(TIRES, sizes[n:], strict=False):
        if size != len(law.COEFFICIENTS):
            raise ModelError(
                f"{source} gives {size} coefficients in {name}, but the tire law {law.NAME!r} has "
                f"{len(law.COEFFICIENTS)}: {_words(law.COEFFICIENTS)}."
            )
        for coefficient, value in zip(law.COEFFICIENTS, numeric(model, name), strict=True):
            if not np.isfinite(value):
                raise ModelError(
                    f"{source} gives {value} for the tire coefficient {coefficient} in {name}, "
                    "which is not a finite number."
                )
            if value <= 0.0 and coefficient in law.POSITIVE:
                raise ModelError(
                    f"{source} gives {value:g} for the tire coefficient {coefficient} in {name}, "
                    "which must be positive."
                )


def _words(items: tuple[object, ...]) -> str:
    return ", ".join(str(item) for item in items) or "(none)"


def numeric(model: mujoco.MjModel, name: str) -> Array:
    """Copy of the values of a <custom> numeric."""
    return np.array(model.numeric(name).data, dtype=np.float64)


def drive_front(model: mujoco.MjModel) -> float:
    """Share of the drive on the front axle of a compiled model [-]."""
    there = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, DRIVE_FRONT) >= 0
    return float(numeric(model, DRIVE_FRONT)[0]) if there else 1.0


def tire_law(model: mujoco.MjModel, source: str = "The model") -> int:
    """Number of the tire law that a compiled model names, an index of `LAWS`.

    Args:
        model: compiled model.
        source: what to call it in the message.

    Raises:
        ModelError: there is no such law; the message lists those there are.
    """
    text = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, TIRE_LAW)
    if text < 0:
        return MAGIC_FORMULA
    names = [law.NAME for law in LAWS]
    name = bytes(model.text_data)[int(model.text_adr[text]) :].partition(b"\0")[0].decode()
    if name not in names:
        raise ModelError(
            f"{source} names the unknown tire law {name!r}; the choices are "
            f"{', '.join(sorted(names))}."
        )
    return names.index(name)


def parameters(model: mujoco.MjModel) -> VehicleParams:
    """Parameters of a compiled car; lengths and inertia are those of the settled pose.

    Cf, Cr are 2 times the slope of the tire at the static load m g lr / 2L, m g lf / 2L.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)  # qpos0 is the settled pose
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    chassis = model.body("chassis").id
    com = data.subtree_com[chassis]
    m = float(model.body_subtreemass[chassis])
    # The chassis frame may lie beside the centre of mass: parallel axes.
    offset = com - data.xpos[chassis]
    Iz = float(inertia[5, 5] - m * (offset[0] ** 2 + offset[1] ** 2))
    centre = {w: data.xpos[model.body(f"wheel_{w}").id] for w in WHEELS}
    lf, lr = float(centre["fl"][0] - com[0]), float(com[0] - centre["rl"][0])
    tau_delta, delta_rate_max, delta_max = numeric(model, "steering")
    tau_ax, torque_drive, power, torque_brake, brake_front = numeric(model, "powertrain")
    rho_air, CdA, CyA, x_cy = numeric(model, "aero")
    (R_w,) = numeric(model, "wheel")
    length, width = numeric(model, "body")
    tire_f, tire_r = tires(model)
    Fz_f = m * GRAVITY * lr / (2.0 * (lf + lr))
    Fz_r = m * GRAVITY * lf / (2.0 * (lf + lr))
    Ixx = float(inertia[3, 3] - m * (offset[1] ** 2 + offset[2] ** 2))
    for w in WHEELS:  # the wheels stay on the road while the body rolls
        unsprung = float(model.body_mass[model.body(f"wheel_{w}").id])
        Ixx -= unsprung * float(centre[w][1] - com[1]) ** 2
    roll_f = _roll(model, centre, "f", tire_f.c[tire.KZ])
    roll_r = _roll(model, centre, "r", tire_r.c[tire.KZ])
    springs = roll_f[0] + roll_r[0]
    values = dict(
        m=m,
        Iz=Iz,
        lf=lf,
        lr=lr,
        track_f=centre["fl"][1] - centre["fr"][1],
        track_r=centre["rl"][1] - centre["rr"][1],
        h=com[2],
        width=width,
        length=length,
        R_w=R_w,
        J_w=model.body_inertia[model.body("wheel_fl").id, 1],
        mu=tire.peak_friction(tire_f, tire_f.c[tire.FNOMIN])[1],
        Cf=2.0 * tire.cornering_stiffness(tire_f, Fz_f),
        Cr=2.0 * tire.cornering_stiffness(tire_r, Fz_r),
        Ixx=Ixx,
        K_phi=springs - m * GRAVITY * float(com[2]),
        C_phi=roll_f[1] + roll_r[1],
        roll_share_front=roll_f[0] / springs,
        trail_f=tire.pneumatic_trail(tire_f, 0.0, Fz_f),
        trail_r=tire.pneumatic_trail(tire_r, 0.0, Fz_r),
        sigma_f=tire.relaxation_lengths(tire_f, Fz_f)[1],
        sigma_r=tire.relaxation_lengths(tire_r, Fz_r)[1],
        c_roll=tire.rolling_resistance(tire_f),
        rho_air=rho_air,
        CdA=CdA,
        CyA=CyA,
        x_cy=x_cy,
        tau_delta=tau_delta,
        delta_max=delta_max,
        delta_rate_max=delta_rate_max,
        tau_ax=tau_ax,
        F_drive_max=torque_drive / R_w,
        P_drive_max=power,
        F_brake_max=torque_brake / R_w,
        brake_front=brake_front,
        drive_front=drive_front(model),
        ay_limit=numeric(model, "ay_limit")[0],
        vx_min=VX_MIN,
    )
    return VehicleParams(**{name: float(value) for name, value in values.items()})


@per_car
def packaged_car() -> VehicleParams:
    """Parameters of the car that is meant where none is named: models/vehicle.xml, or `--car`'s.

    Raises:
        ModelError: the file is broken; the installation is damaged.
    """
    return parameters(compile_model(visual=False))


def tires(model: mujoco.MjModel) -> tuple[Tire, Tire]:
    """The front and the rear tires of a compiled car: their law and copies of the coefficients."""
    law = tire_law(model)
    return Tire(law, numeric(model, "tire_f")), Tire(law, numeric(model, "tire_r"))


def _roll(
    model: mujoco.MjModel, centre: dict[str, Array], axle: str, KZ: float
) -> tuple[float, float]:
    """Roll stiffness [N m/rad] and damping [N m s/rad] of an axle's springs, bar and tires.

    Per wheel in roll, a spring K = k + 2 k_bar in series with the tire's KZ; the damper works on
    the share KZ / (K + KZ) of the travel, twice.
    """
    joint, bar = model.joint(f"susp_{axle}l"), model.tendon(f"antiroll_{axle}")
    spring = float(np.ravel(model.jnt_stiffness[joint.id])[0])
    spring += 2.0 * float(np.ravel(model.tendon_stiffness[bar.id])[0])
    share = KZ / (spring + KZ)
    half_track = 0.5 * float(centre[f"{axle}l"][1] - centre[f"{axle}r"][1])
    damping = float(model.dof_damping[joint.dofadr[0]])
    return 2.0 * half_track**2 * spring * share, 2.0 * half_track**2 * damping * share**2


def car_sha256(model: mujoco.MjModel) -> str:
    """Hash of the physical numbers of a car: masses, springs, dampers, tires, drive, air.

    To nine digits, so that neither comments or shapes in the MJCF nor another MuJoCo changes it.
    """
    digest = hashlib.sha256()
    law = tire_law(model)
    if law != MAGIC_FORMULA:  # which needs no name
        digest.update(LAWS[law].NAME.encode())
    arrays = (
        model.body_mass, model.body_inertia, model.body_pos, model.body_ipos, model.jnt_stiffness,
        model.jnt_range, model.qpos0, model.qpos_spring, model.dof_damping, model.dof_armature,
        model.tendon_stiffness, model.numeric_data,
    )
    for array in arrays:
        for value in np.ravel(array):
            digest.update(f"{float(value) + 0.0:.9g},".encode())
    return digest.hexdigest()
