"""A made-up log of a kinematic car on a winding road, for testing pictures without the plant.

It has the columns, units and shapes of a real log; its numbers are only plausible.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from lpvmpc.plant.mjcf import model_path
from lpvmpc.road.path import Path

TS = 0.033
NP = 10
WHEELS = ("fl", "fr", "rl", "rr")
LF, LR, HALF_TRACK, H, M, G = 1.2, 1.6, 0.755, 0.55, 1575.0, 9.81


def fake_path(length: float = 600.0, closed: bool = False) -> Path:
    """A winding road, or a rounded loop of about the same length."""
    if closed:
        s = np.linspace(0.0, length, int(length / 0.2) + 1)
        kappa = 2.0 * np.pi / length * (1.0 + 0.6 * np.cos(4.0 * np.pi * s / length))
        return Path(kappa, length, closed=True)
    s = np.arange(0.0, length + 0.1, 10.0)
    return Path.from_curvature(0.008 * np.sin(s / 25.0) + 0.006 * np.sin(s / 61.0 + 1.0), 10.0)


def fake_log(duration: float = 20.0, name: str = "paper", length: float = 600.0,
             qpos: bool = True) -> SimpleNamespace:
    """A log of `duration` seconds: speed 8..18 m/s, millimetre errors, a gusty side wind."""
    path = fake_path(length)
    t = np.arange(0.0, duration, TS)
    n = t.size
    vx = 13.0 + 5.0 * np.sin(t / 6.0 - 0.8)
    s = np.concatenate([[0.0], np.cumsum(vx[:-1] * TS)])
    x, y, psi, kappa = path.at(s)
    ey = 0.0009 * np.sin(t * 1.3) + 0.0004 * np.sin(t * 7.0)
    epsi = -0.004 * np.sin(t / 3.0)
    ax = np.gradient(vx, TS)
    ay = vx**2 * kappa
    delta = 2.8 * kappa + 0.0044 * ay
    columns: dict[str, Any] = {
        "t_s": t, "s_m": s,
        "x_m": x - ey * np.sin(psi), "y_m": y + ey * np.cos(psi), "psi_rad": psi + epsi,
        "vx_mps": vx + 0.004 * np.sin(t * 2.0), "vy_mps": LR * vx * kappa - 0.01 * ay,
        "r_radps": vx * kappa, "delta_rad": delta, "ax_mps2": ax, "ay_mps2": ay,
        "ey_m": ey, "epsi_rad": epsi, "kappa_radpm": kappa, "vx_ref_mps": vx,
        "x_ref_m": x, "y_ref_m": y, "psi_ref_rad": psi,
        "delta_cmd_rad": np.interp(t + TS, t, delta), "ax_cmd_mps2": ax + 0.3,
        "wind_mps": 38.0 + 12.0 * np.sin(t / 4.0), "roll_rad": 0.006 * ay,
        "solved": np.ones(n, dtype=bool), "fallback": np.zeros(n, dtype=np.int8),
        "kkt_residual": np.full(n, 1e-9),
    }
    side = {"fl": 1.0, "fr": -1.0, "rl": 1.0, "rr": -1.0}
    for wheel in WHEELS:
        front = wheel[0] == "f"
        share = (LR if front else LF) / (LF + LR) / 2.0
        Fz = M * G * share - side[wheel] * 0.5 * M * ay * H / (2.0 * HALF_TRACK)
        columns[f"Fx_{wheel}_N"] = M * ax / 2.0 * front
        columns[f"Fy_{wheel}_N"] = M * ay * share
        columns[f"Fz_{wheel}_N"] = Fz
        columns[f"slip_ratio_{wheel}"] = 0.005 * ax * front
        columns[f"slip_angle_{wheel}_rad"] = 0.01 * ay
        columns[f"mu_{wheel}"] = np.full(n, 0.82)
    for k in range(NP + 1):
        xk, yk, psik, _ = path.at(s + vx * k * TS)
        columns[f"pred_x_m_{k}"], columns[f"pred_y_m_{k}"] = xk, yk + 0.0 * psik
    if qpos:
        columns.update(_qpos(columns, s))
    rng = np.random.default_rng(0)
    step = 180.0 + 40.0 * rng.gamma(2.0, 1.0, n)
    timing = {"t_s": t, "step_us": step, "build_us": 0.3 * step, "solve_us": 0.4 * step,
              "check_us": 0.1 * step}
    meta = {"scenario": name, "controller": "lpv-mpc", "seed": 0, "completed": True,
            "reason": "end of the path", "Ts": TS}
    return SimpleNamespace(columns=columns, timing=timing, meta=meta, road=None,
                           scenario=SimpleNamespace(name=name, path=path, cones=np.empty((0, 2))))


def _qpos(columns: dict[str, Any], s: Any) -> dict[str, Any]:
    """Generalised coordinates of the packaged car: free joint, slides, steering, spins."""
    import mujoco


    model = mujoco.MjModel.from_xml_path(str(model_path("vehicle.xml")))
    n = s.size
    q = np.tile(model.qpos0, (n, 1))
    yaw, roll = columns["psi_rad"], columns["roll_rad"]
    q[:, 0], q[:, 1] = columns["x_m"], columns["y_m"]
    q[:, 3] = np.cos(yaw / 2) * np.cos(roll / 2)
    q[:, 4] = np.cos(yaw / 2) * np.sin(roll / 2)
    q[:, 5] = np.sin(yaw / 2) * np.sin(roll / 2)
    q[:, 6] = np.sin(yaw / 2) * np.cos(roll / 2)
    for j in range(model.njnt):
        name, address = model.joint(j).name, model.jnt_qposadr[j]
        if "steer" in name:
            q[:, address] = columns["delta_rad"]
        elif "spin" in name:
            q[:, address] = s / 0.31
    return {f"qpos_{i}": q[:, i] for i in range(model.nq)}
