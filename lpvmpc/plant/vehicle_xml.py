"""Writing a car's MJCF from numbers, in the layout of models/vehicle.xml.

The packaged file is the template: bodies, joints and names stay, every physical number is replaced,
and the drawn body is stretched. Masses, inertias and spring preloads are such that the car stands
level at zero suspension travel, with the given mass, inertia and centre of mass as a whole.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.numbers import CarFile, CarNumbers
from lpvmpc.car.tir import read_tir
from lpvmpc.errors import ModelError, OptionError
from lpvmpc.plant.limit import largest_lateral_acceleration
from lpvmpc.plant.mjcf import (
    WHEELS,
    compile_model,
    compile_text,
    model_path,
    numeric,
    parameters,
    tire_law,
    tires,
)
from lpvmpc.plant.plant import Plant
from lpvmpc.units import GRAVITY, Array

KNUCKLE = (0.25, 0.25, 0.2)
"""Inertia of a knuckle about its own centre [kg m2]; assumed, and of no weight."""
ACROSS = 0.5 / 0.9
"""Inertia of a wheel about a diameter over that about its axle [-]."""
BODY = (2.8, 1.73, 1.56, 0.53, -0.2)
"""Wheelbase, width, height, height of the centre of mass, and middle of the wheelbase of the drawn
body of the template [m]."""
HEADER = """
    {title}

    Written by lpvmpc.plant.vehicle_xml from numbers; frame, units and orders as in
    models/vehicle.xml. WITHOUT THE CALLBACKS OF lpvmpc/plant/callbacks.py THE TIRES CARRY NOTHING.
  """


def numbers_of(model: mujoco.MjModel) -> CarNumbers:
    """The numbers of a compiled car.

    Args:
        model: A car whose tires follow the Magic Formula.
    """
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    p = parameters(model)
    offset = data.subtree_com[model.body("chassis").id] - data.xpos[model.body("chassis").id]
    tau_ax, torque, power, brake, share = numeric(model, "powertrain")
    front, rear = tires(model)

    def of_axle(name: str, values: Array) -> float:
        return float(np.ravel(values[model.joint(name).id])[0])

    def damper(name: str) -> float:
        return float(model.dof_damping[model.joint(name).dofadr[0]])

    def bar(name: str) -> float:
        return float(np.ravel(model.tendon_stiffness[model.tendon(name).id])[0])

    def mass(name: str) -> float:
        return float(model.body_mass[model.body(name).id])

    return CarNumbers(
        m=p.m, lf=p.lf, lr=p.lr, h=p.h,
        Ixx=float(inertia[3, 3] - p.m * (offset[1] ** 2 + offset[2] ** 2)),
        Iyy=float(inertia[4, 4] - p.m * (offset[0] ** 2 + offset[2] ** 2)),
        Iz=p.Iz, track_f=p.track_f, track_r=p.track_r, length=p.length, width=p.width,
        height=BODY[2], R0=float(front.c[mf.R0]), R_w=p.R_w,
        wheel_mass=mass("wheel_fl"), J_w=p.J_w,
        knuckle_f=mass("knuckle_fl"), knuckle_r=mass("knuckle_rl"),
        spring_f=of_axle("susp_fl", model.jnt_stiffness),
        spring_r=of_axle("susp_rl", model.jnt_stiffness),
        damper_f=damper("susp_fl"), damper_r=damper("susp_rl"),
        antiroll_f=bar("antiroll_f"), antiroll_r=bar("antiroll_r"),
        tau_delta=p.tau_delta, delta_rate_max=p.delta_rate_max, delta_max=p.delta_max,
        tau_ax=float(tau_ax), drive_torque=float(torque), power=float(power),
        brake_torque=float(brake), brake_front=float(share), drive_front=p.drive_front,
        rho_air=p.rho_air, CdA=p.CdA, CyA=p.CyA, x_cy=p.x_cy,
        mu_f=mf.peak_friction(front.c, front.c[mf.FNOMIN])[1],
        mu_r=mf.peak_friction(rear.c, rear.c[mf.FNOMIN])[1],
        Cf=p.Cf, Cr=p.Cr, sigma_f=p.sigma_f, sigma_r=p.sigma_r, trail_f=p.trail_f,
        trail_r=p.trail_r,
    )


def tires_of(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Magic Formula coefficients of the front and the rear tires of a compiled car.

    Raises:
        ModelError: Its tires follow another law.
    """
    if tire_law(model) != 0:
        raise ModelError("The car's tires follow another law than the Magic Formula, which alone "
                         "can be written from numbers.")
    front, rear = tires(model)
    return front.c, rear.c


def car_of(file: CarFile) -> tuple[str, list[str]]:
    """The MJCF of a car.toml, with its lateral limit measured.

    Returns:
        The text, and the names of the numbers taken from the packaged car.

    Raises:
        OptionError: A number outside its domain, or numbers that no car can have together.
        DataError: A tire file cannot be read.
    """
    base = compile_model(model_path("vehicle"), visual=False)
    numbers, defaults = file.completed(numbers_of(base))
    own = tires_of(base)
    loads = static_loads(numbers)
    coefficients = []
    for axle in range(2):
        tir = file.tires[axle]
        if tir is not None:
            coefficients.append(read_tir(tir))
            continue
        c = own[axle].copy()
        c[mf.KZ] *= numbers.m / numbers_of(base).m
        c[mf.CZ] *= numbers.m / numbers_of(base).m
        c[mf.FNOMIN], c[mf.R0] = loads[axle], numbers.R0
        coefficients.append(c)
    title = file.title or file.name
    return stated(written(numbers, coefficients[0], coefficients[1], title=title)), defaults


def static_loads(n: CarNumbers) -> tuple[float, float]:
    """Load of a front and of a rear wheel at rest [N]."""
    half = 0.5 * n.m * GRAVITY / (n.lf + n.lr)
    return half * n.lr, half * n.lf


def fitted(
    c: Array, load: float, mu: float | None, C: float | None, sigma: float | None,
    trail: float | None,
) -> Array:
    """Tire coefficients changed to what is asked of them; None leaves them as they are.

    Args:
        c: Magic Formula coefficients, shape (n,).
        load: Load of a wheel at rest [N].
        mu: Lateral peak friction at the nominal load [-]; the longitudinal one changes alike.
        C: Cornering stiffness of the axle at that load [N/rad].
        sigma: Lateral relaxation length there [m].
        trail: Pneumatic trail there [m].
    """
    c = np.array(c)
    if mu is not None:
        c[[mf.PDX1, mf.PDX2, mf.PDY1, mf.PDY2]] *= mu / mf.peak_friction(c, c[mf.FNOMIN])[1]
    if C is not None:
        c[mf.PKY1] *= 0.5 * C / mf.cornering_stiffness(c, load)
    if sigma is not None:
        c[mf.PTY1] *= sigma / mf.relaxation_lengths(c, load)[1]
    if trail is not None:
        if c[mf.QDZ1] == 0.0:
            c[mf.QDZ1] = 1.0
        c[mf.QDZ1] *= trail / mf.pneumatic_trail(c, 0.0, load)
    return c


def written(
    numbers: CarNumbers, tire_f: Array, tire_r: Array, *, ay_limit: float | None = None,
    title: str = "A car",
) -> str:
    """Text of the MJCF of a car.

    Args:
        numbers: Its numbers.
        tire_f: Magic Formula coefficients of the front tires, before `numbers` changes them.
        tire_r: Those of the rear tires.
        ay_limit: Largest lateral acceleration [m/s2]; `stated` measures it (default: a guess).
        title: What the car is, for the header.

    Raises:
        OptionError: Numbers that no car can have together.
    """
    n = numbers
    loads = static_loads(n)
    front = fitted(tire_f, loads[0], n.mu_f, n.Cf, n.sigma_f, n.trail_f)
    rear = fitted(tire_r, loads[1], n.mu_r, n.Cr, n.sigma_r, n.trail_r)
    radii = [c[mf.R0] - load / c[mf.KZ] for c, load in zip((front, rear), loads, strict=True)]
    if not 0.5 * n.R_w < min(radii) <= max(radii) < 1.2 * n.R_w:
        raise OptionError("R_w", n.R_w, f"near the loaded radius of the tires, {radii[0]:.3f} m")
    root = _template()
    root.set("model", "vehicle")
    header = root[0]  # the comment
    header.text = HEADER.format(title=title.replace("--", "- -"))
    _bodies(root, n, radii)
    _suspension(root, n, loads)
    own = largest(front, rear) if ay_limit is None else ay_limit
    values: dict[str, Iterable[float]] = {
        "steering": (n.tau_delta, n.delta_rate_max, n.delta_max),
        "powertrain": (n.tau_ax, n.drive_torque, n.power, n.brake_torque, n.brake_front),
        "aero": (n.rho_air, n.CdA, n.CyA, n.x_cy),
        "wheel": (n.R_w,), "body": (n.length, n.width), "ay_limit": (own,),
        "tire_f": front, "tire_r": rear,
    }
    for name, data in values.items():
        _found(root, f".//numeric[@name='{name}']").set("data", _text(data))
    slow = _found(root, ".//numeric[@name='low_speed']")
    speed, damping, *caps = map(float, slow.get("data", "").split())
    slow.set("data", _text((speed, damping * min(n.m / 1575.0, 1.0), *caps)))
    if n.drive_front != 1.0:
        last = _found(root, ".//numeric[@name='tire_r']")
        custom = _found(root, "custom")
        share = ET.Element("numeric", name="drive_front", data=_text((n.drive_front,)))
        last.tail, share.tail = (last.tail or "") + "  ", last.tail
        custom.insert(list(custom).index(last) + 1, share)
    _shape(root, n)
    spin = _text((15.0 / n.R_w,))
    _found(root, ".//key[@name='rest']").set("qpos", f"0 0 {n.h!r} 1 0 0 0 {'0 ' * 10}".strip())
    start = _found(root, ".//key[@name='straight_15']")
    start.set("qpos", f"0 0 {n.h!r} 1 0 0 0 {'0 ' * 10}".strip())
    start.set("qvel", f"15 0 0 0 0 0 0 0 {spin} 0 0 {spin} 0 {spin} 0 {spin}")
    return ET.tostring(root, encoding="unicode") + "\n"


def stated(xml: str) -> str:
    """The same car with its lateral limit measured and stated.

    Raises:
        ModelError: The text is no car.
    """
    root = ET.fromstring(xml, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    limit = round(largest_lateral_acceleration(Plant(compile_text(xml))), 2)
    _found(root, ".//numeric[@name='ay_limit']").set("data", _text((limit,)))
    return ET.tostring(root, encoding="unicode") + "\n"


def with_tires(xml: str, tire_f: Array, tire_r: Array) -> str:
    """The same car on other tires, its wheels at their height, its lateral limit measured."""
    numbers = numbers_of(compile_text(xml))
    radius = 0.5 * float(tire_f[mf.R0] + tire_r[mf.R0])
    own = replace(
        numbers, R_w=numbers.R_w / numbers.R0 * radius, mu_f=None, mu_r=None, Cf=None, Cr=None,
        sigma_f=None, sigma_r=None, trail_f=None, trail_r=None,
    )
    return stated(written(own, tire_f, tire_r, title="A car on other tires"))


def largest(front: Array, rear: Array) -> float:
    """A guess of the lateral limit [m/s2], until it is measured."""
    return 0.87 * GRAVITY * min(float(c[mf.PDY1]) for c in (front, rear))


# Parts of the file --------------------------------------------------------------------------------


def _template() -> ET.Element:
    parser = ET.XMLParser(target=ET.TreeBuilder(insert_comments=True))
    return ET.parse(model_path("vehicle"), parser).getroot()


def _found(root: ET.Element, path: str) -> ET.Element:
    node = root.find(path)
    assert node is not None, path
    return node


def _text(values: Iterable[float]) -> str:
    return " ".join(f"{float(value):.12g}" for value in values)


def _bodies(root: ET.Element, n: CarNumbers, radii: list[float]) -> None:
    """Masses, inertias and places, so that the whole car has those of the numbers."""
    wheel = (ACROSS * n.J_w, n.J_w, ACROSS * n.J_w)
    places = {
        "fl": (n.lf, 0.5 * n.track_f, radii[0] - n.h),
        "fr": (n.lf, -0.5 * n.track_f, radii[0] - n.h),
        "rl": (-n.lr, 0.5 * n.track_r, radii[1] - n.h),
        "rr": (-n.lr, -0.5 * n.track_r, radii[1] - n.h),
    }
    m, moment = n.m, np.zeros(3)
    inertia = np.diag([n.Ixx, n.Iyy, n.Iz])
    for name in WHEELS:
        r = np.array(places[name])
        knuckle = n.knuckle_f if name[0] == "f" else n.knuckle_r
        own = knuckle + n.wheel_mass
        m, moment = m - own, moment - own * r
        inertia -= np.diag(wheel) + np.diag(KNUCKLE) + own * (r @ r * np.eye(3) - np.outer(r, r))
        body = _found(root, f".//body[@name='knuckle_{name}']")
        body.set("pos", _text(r))
        _found(body, "inertial").set("mass", _text((knuckle,)))
        spinning = _found(body, f"body[@name='wheel_{name}']/inertial")
        spinning.set("mass", _text((n.wheel_mass,)))
        spinning.set("diaginertia", _text(wheel))
        radius = radii[0] if name[0] == "f" else radii[1]
        _found(body, f"site[@name='contact_{name}']").set("pos", _text((0.0, 0.0, -radius)))
    if m < 0.2 * n.m:
        raise OptionError("m", n.m, f"far more than the wheels and knuckles weigh, {n.m - m:g} kg")
    at = moment / m
    inertia -= m * (at @ at * np.eye(3) - np.outer(at, at))
    axes = np.linalg.eigvalsh(inertia)
    if axes[0] <= 0.0 or axes[0] + axes[1] < axes[2]:
        raise OptionError(
            "Ixx, Iyy, Iz", (n.Ixx, n.Iyy, n.Iz),
            "inertias that a body can have besides its wheels: each smaller than the other two "
            "together"
        )
    chassis = _found(root, ".//body[@name='chassis']")
    chassis.set("pos", _text((0.0, 0.0, n.h)))
    own_inertia = _found(chassis, "inertial")
    own_inertia.set("pos", _text(at))
    own_inertia.set("mass", _text((m,)))
    order = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    own_inertia.set("fullinertia", _text(inertia[ij] + 0.0 for ij in order))


def _suspension(root: ET.Element, n: CarNumbers, loads: tuple[float, float]) -> None:
    """Springs with their preload, dampers, anti-roll bars."""
    for axle, load in zip("fr", loads, strict=True):
        spring = float(getattr(n, f"spring_{axle}"))
        carried = load - GRAVITY * (n.wheel_mass + float(getattr(n, f"knuckle_{axle}")))
        joint = _found(root, f".//default[@class='susp_{axle}']/joint")
        joint.set("stiffness", _text((spring,)))
        joint.set("springref", _text((-carried / spring,)))
        joint.set("damping", _text((getattr(n, f"damper_{axle}"),)))
        bar = _found(root, f".//fixed[@name='antiroll_{axle}']")
        bar.set("stiffness", _text((getattr(n, f"antiroll_{axle}"),)))


def _shape(root: ET.Element, n: CarNumbers) -> None:
    """Stretch what is drawn, and the boxes that touch the ground when the car lies on it."""
    wheelbase, width, height, com, middle = BODY
    scale = np.array([(n.lf + n.lr) / wheelbase, n.width / width, n.height / height])
    shift = np.array([0.5 * (n.lf - n.lr) - scale[0] * middle, 0.0, scale[2] * com - n.h])
    meshes = _found(root, ".//default[@class='shape']/mesh")
    meshes.set("scale", _text(0.001 * scale))
    chassis = _found(root, ".//body[@name='chassis']")
    for geom in chassis.findall("geom"):
        kind = geom.get("class")
        if kind == "arch":
            side = 1.0 if "left" in geom.get("name", "") else -1.0
            front = "front" in geom.get("name", "")
            track = n.track_f if front else n.track_r
            x = n.lf if front else -n.lr
            geom.set("pos", _text((x, side * (0.5 * track - 0.003), 0.034 + n.R0 - 0.022 - n.h)))
        elif geom.get("mesh"):
            geom.set("pos", _text(shift))
        else:
            for key in ("fromto", "pos"):
                if key in geom.attrib:
                    points = np.array(geom.get(key, "").split(), dtype=float).reshape(-1, 3)
                    geom.set(key, _text((points * scale + shift).ravel()))
            if geom.get("type") == "box":
                size = np.array(geom.get("size", "").split(), dtype=float)
                geom.set("size", _text(size * scale))
    for name, share in (("arch", 1.2), ("tire", 1.0), ("rim", 0.69)):
        geom = _found(root, f".//default[@class='{name}']/geom")
        _, half = geom.get("size", "").split()
        geom.set("size", f"{share * n.R0:.4g} {half}")
