"""CommonRoad's multibody car with our parameters, for the cross-model study.

    python -m lpvmpc.studies.reference.multibody

drives `vehicle_dynamics_mb` of CommonRoad's vehicle models (TU Munich, BSD-3; Althoff and
Wuersching, "CommonRoad: Vehicle Models", 2020; `pip install ".[fidelity]"`) and writes
lpvmpc/data/multibody.json, which the study reads; so the study itself does not need that package,
and a test repeats the computation where it is installed.

Their model has 29 states: a body on two rigid axles with roll, pitch, heave and compliant lateral
joints, and four Magic Formula tires. What ours has and theirs has not: load dependence of friction
and cornering stiffness, relaxation, pneumatic trail, Ackermann steering, drag and rolling
resistance, gyroscopic wheels. What theirs has and ours has not is set to zero (shifts, camber,
lateral compliance of tire and suspension), and the compliant joint is made stiff.
"""

from __future__ import annotations

import json
import math
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
from scipy.integrate import solve_ivp

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.current import current, per_car
from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import LPVMPCError
from lpvmpc.plant.mjcf import compile_model, parameters, tires
from lpvmpc.units import GRAVITY, Array

FILE = Path(str(resources.files("lpvmpc.studies") / "data" / "multibody.json"))

SPEED = 20.0
"""Driving speed of all runs [m/s]."""
STEERS = tuple(round(0.005 * k, 3) for k in range(1, 17))
"""Road wheel angles of the steady states [rad]."""
SETTLE = 5.0
"""Time at each angle, of which the first tenth is spent on turning the wheel [s]."""
SINE, PERIOD, SINE_TIME = 0.05, 2.0, 3.0
"""Amplitude [rad], period [s] of one sine of steering, and how long its answer is followed [s]."""
SAMPLE = 0.02
"""Time between two stored samples of that answer [s]."""

STATE = ("delta_rad", "vx_mps", "vy_mps", "r_radps", "roll_rad")
"""What is kept of their 29 states: these columns of them, roll with our sign."""
_COLUMNS = (2, 3, 10, 5, 6)
_SIGNS = (1.0, 1.0, 1.0, 1.0, -1.0)


def sine(t: float) -> float:
    """Road wheel angle of the transient [rad]: one sine after 0.2 s."""
    phase = (t - 0.2) / PERIOD
    return SINE * math.sin(2.0 * math.pi * phase) if 0.0 < phase < 1.0 else 0.0


def sine_rate(t: float) -> float:
    """Its derivative [rad/s]."""
    phase = (t - 0.2) / PERIOD
    rate = SINE * 2.0 * math.pi / PERIOD
    return rate * math.cos(2.0 * math.pi * phase) if 0.0 < phase < 1.0 else 0.0


def effective_stiffness(p: VehicleParams) -> tuple[float, float]:
    """Axle stiffness that gives a car without trails our steady state [N/rad].

    With a = lf - t_f, b = lr + t_r: Cf lr (a + b) / (L b), Cr lf (a + b) / (L a).
    """
    a, b, L = p.lf - p.trail_f, p.lr + p.trail_r, p.wheelbase
    return p.Cf * p.lr * (a + b) / (L * b), p.Cr * p.lf * (a + b) / (L * a)


class Parameters(SimpleNamespace):
    """Their parameters by their names, with one tire set for each axle.

    Their model knows one set and hands it to its tire functions wheel by wheel, front left, front
    right, rear left, rear right; so this gives out the front set twice, then the rear set twice.
    """

    tire_sets: tuple[SimpleNamespace, SimpleNamespace]
    handed_out: int

    @property
    def tire(self) -> SimpleNamespace:
        """The tire set of the next wheel."""
        axle = self.handed_out // 2 % 2
        self.handed_out += 1
        return self.tire_sets[axle]


def translate(model: mujoco.MjModel) -> Parameters:
    """Our car in their parameters."""
    p = parameters(model)
    chassis = model.body("chassis").id
    m_s = float(model.body_mass[chassis])
    unsprung = [2.0 * float(model.body_subtreemass[model.body(f"knuckle_{a}l").id]) for a in "fr"]
    loads = [
        0.5 * GRAVITY * (m_s * p.lr / p.wheelbase + unsprung[0]),
        0.5 * GRAVITY * (m_s * p.lf / p.wheelbase + unsprung[1]),
    ]
    joints = [model.joint(f"susp_{axle}l") for axle in "fr"]
    springs = [float(np.ravel(model.jnt_stiffness[joint.id])[0]) for joint in joints]
    dampers = [float(model.dof_damping[joint.dofadr[0]]) for joint in joints]
    bars = [float(np.ravel(model.tendon_stiffness[model.tendon(f"antiroll_{a}").id])[0])
            for a in "fr"]
    inertia = np.zeros(9)
    mujoco.mju_quat2Mat(inertia, model.body_iquat[chassis])
    R = inertia.reshape(3, 3)
    own = R @ np.diag(model.body_inertia[chassis]) @ R.T
    KZ = float(tires(model)[0].c[mf.KZ])
    stiffness = effective_stiffness(p)
    sets = tuple(
        _tire_set(one.c, load, C)
        for one, load, C in zip(tires(model), loads, stiffness, strict=True)
    )
    return Parameters(
        tire_sets=sets, handed_out=0,
        steering=SimpleNamespace(min=-p.delta_max, max=p.delta_max, v_min=-10.0, v_max=10.0),
        longitudinal=SimpleNamespace(a_max=50.0, v_max=100.0, v_min=-10.0, v_switch=100.0),
        m=p.m, m_s=m_s, m_uf=unsprung[0], m_ur=unsprung[1], a=p.lf, b=p.lr,
        I_Phi_s=own[0, 0], I_y_s=own[1, 1], I_z=p.Iz, I_xz_s=0.0,
        K_sf=springs[0], K_sdf=dampers[0], K_sr=springs[1], K_sdr=dampers[1],
        # their bars are torsion springs of the axle, negative
        K_tsf=-bars[0] * p.track_f**2, K_tsr=-bars[1] * p.track_r**2,
        T_f=p.track_f, T_r=p.track_r, K_ras=2e6, K_rad=1e5, K_zt=KZ,
        # their roll axis goes down with the tires; this puts it on the road
        h_raf=loads[0] / KZ, h_rar=loads[1] / KZ, h_cg=p.h,
        h_s=float(model.qpos0[2] + model.body_ipos[chassis][2]),
        I_uf=unsprung[0] * (p.track_f / 2.0) ** 2, I_ur=unsprung[1] * (p.track_r / 2.0) ** 2,
        I_y_w=p.J_w, K_lt=0.0, R_w=p.R_w, T_sb=p.brake_front, T_se=p.drive_front,
        D_f=0.0, D_r=0.0, E_f=0.0, E_r=0.0,
    )


def _tire_set(c: Array, load: float, axle_stiffness: float) -> SimpleNamespace:
    """One axle's tires in their coefficients, at their static load; no shifts, no camber."""
    zeros = ("p_dx3", "p_hx1", "p_vx1", "r_hx1", "p_dy3", "p_hy1", "p_hy3", "p_vy1", "p_vy3",
             "r_by3", "r_hy1", "r_vy1", "r_vy3", "r_vy4", "r_vy5", "r_vy6")
    return SimpleNamespace(
        p_cx1=c[mf.PCX1], p_dx1=c[mf.PDX1], p_ex1=c[mf.PEX1], p_kx1=c[mf.PKX1],
        r_bx1=c[mf.RBX1], r_bx2=c[mf.RBX2], r_cx1=c[mf.RCX1], r_ex1=c[mf.REX1],
        p_cy1=c[mf.PCY1], p_dy1=c[mf.PDY1], p_ey1=c[mf.PEY1],
        p_ky1=-0.5 * axle_stiffness / load,
        r_by1=c[mf.RBY1], r_by2=c[mf.RBY2], r_cy1=c[mf.RCY1], r_ey1=c[mf.REY1],
        **dict.fromkeys(zeros, 0.0),
    )


def drive(steer_rate: Any, seconds: float, every: float, side: float = 1.0) -> Array:
    """Drive their car at SPEED, an integral controller holding it.

    Args:
        steer_rate: Rate of the road wheel angle [rad/s] at a time [s].
        seconds: How long.
        every: Time between samples [s].
        side: -1 steers to the other side.

    Returns:
        Samples of `STATE`, shape (n, 5).

    Raises:
        ImportError: commonroad-vehicle-models is not installed.
    """
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

    p = translate(compile_model(visual=False))

    def derivative(t: float, x: Array) -> list[float]:
        missing = SPEED - x[3]
        inputs = [side * steer_rate(t), 6.0 * missing + 4.0 * x[29]]
        return [*vehicle_dynamics_mb(list(x[:29]), inputs, p), missing]

    start = [*init_mb([0.0, 0.0, 0.0, SPEED, 0.0, 0.0, 0.0], p), 0.0]
    times = np.linspace(0.0, seconds, round(seconds / every) + 1)
    solution = solve_ivp(
        derivative, (0.0, seconds), start, "LSODA", t_eval=times, rtol=1e-8, atol=1e-10,
        max_step=0.02,
    )
    assert solution.status == 0, solution.message
    assert p.handed_out % 16 == 0  # four tire functions, four wheels each
    rows: Array = solution.y[list(_COLUMNS)].T * _SIGNS
    return rows


def compute() -> dict[str, Any]:
    """Steady states and the transient of their car.

    Raises:
        ImportError: commonroad-vehicle-models is not installed.
    """
    step = STEERS[0]

    def staircase(t: float) -> float:
        turning = t % SETTLE < 0.1 * SETTLE
        return step / (0.1 * SETTLE) if turning else 0.0

    steady = drive(staircase, SETTLE * len(STEERS), SETTLE)[1:]
    transient = drive(sine_rate, SINE_TIME, SAMPLE)
    mirrored = drive(sine_rate, SINE_TIME, SAMPLE, side=-1.0)
    unmirrored = np.abs(mirrored * (-1.0, 1.0, -1.0, -1.0, -1.0) - transient).max()
    return {
        "speed_mps": SPEED,
        "columns": list(STATE),
        "steady": steady.tolist(),
        "transient": transient.tolist(),
        "left_against_right": float(unmirrored),
    }


@per_car
def read() -> dict[str, Any]:
    """The stored values, as `compute` returns them; of another car than the packaged one, computed.

    Raises:
        LPVMPCError: commonroad-vehicle-models is not installed, and another car is meant.
    """
    if (car := current()) is not None:
        try:
            return compute()
        except ImportError:
            raise LPVMPCError(
                f"Comparing {car} with CommonRoad's multibody car needs the package "
                "commonroad-vehicle-models; pip install 'lpvmpc[fidelity]' brings it."
            ) from None
    stored: dict[str, Any] = json.loads(FILE.read_text())
    return stored


def main() -> None:
    """Compute and store the values."""
    from importlib.metadata import version

    name = "commonroad-vehicle-models"
    content = {"source": f"vehicle_dynamics_mb of {name} {version(name)}", **compute()}
    lines = []
    for key, value in content.items():
        text = json.dumps(value)
        if key in ("steady", "transient"):
            rows = ",\n  ".join(json.dumps([round(x, 9) + 0.0 for x in row]) for row in value)
            text = f"[\n  {rows}\n ]"
        lines.append(f' "{key}": {text}')
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main()
