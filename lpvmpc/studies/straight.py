"""Straight on: coasting, top speed, full acceleration, braking, and what a torque does."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.current import current
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.parts import braking
from lpvmpc.studies.parts.braking import KMH
from lpvmpc.studies.study import CarUnderTest, Picture, Series, StudyResult
from lpvmpc.units import GRAVITY, Array

METHOD = """\
- Coast-down (after ISO 10521-1 and EU 70/220): from 35 to 3 m/s without drive or brakes; the
  deceleration over each 0.5 s, times the mass with the wheels' spin, is fitted by f0 + f1 v +
  f2 v^2. f0 must return the rolling resistance m g c_roll, f2 half of air density times drag area,
  f1 nothing.
- Full acceleration from rest, with as much torque as the driven tires take (90 % of the traction
  limit mu g lr / (L + mu h) in front), until the motor's power limits it. Expected: the integral of
  m_eff dv/dt = min(torque, power / wheel speed) - resistances, the wheels' slip being the drive
  over the driven tires' slip stiffness at static load. The published times of a real Zoe R240
  stand beside the packaged car's, which has another mass and drag area and no limiter at 135 km/h.
- Braking from 100 km/h on a ramp of 1 s. MFDD is the mean fully developed deceleration, between
  80 and 10 % of the initial speed (UN Regulation 13-H). The brakes' balance is fixed and the
  axle that locks first does so at a command that follows from its load and friction at 5 m/s.
  Locked wheels slide at the Magic Formula's force for a slip ratio of -1; brakes too weak to lock
  both axles are made stronger for that stop.
- Constant torque: all resistances and the power limit are taken away, and the torque for 1 m/s2
  must give the same acceleration at any speed and any physics step.
- Lag of the forces: under a drive that sways at 5 Hz, m a[k] = (1 - lag) F[k] + lag F[k-1] is
  fitted step by step. 0: a force moves the car in the step in which it was computed; 1: in the
  next one, a known fault of simulators that keep tires outside of the engine.
- Valid on a dry flat road in still air; no motor map, no battery limits, no ABS.
"""

PUBLISHED = {"0-50 km/h": (3.7, 4.0), "0-100 km/h": (13.2, 13.5)}
"""Times of a Renault Zoe R240 (65 kW, 220 N m) in advertisements and registers [s]."""
STEPS = (0.00025, 0.0005, 0.001, 0.002)
"""Physics steps [s]."""
SPEEDS = (3.0, 5.0, 15.0, 25.0, 35.0)
"""Speeds at which a constant torque acts [m/s]."""


def run(car: CarUnderTest) -> StudyResult:
    """Study straight driving."""
    result = StudyResult("straight", METHOD)
    _coasting(result, car)
    _top_speed(result, car)
    launch = _acceleration(result, car)
    gains = _torque(result, car)
    result.find(
        "lag of force against motion", lag_of_forces(car), "steps", Limit.near(0.0, 0.05),
        "a force belongs to the state it is computed from; 1 is one step late",
    )
    result.pictures.append(
        Picture(
            "acceleration",
            "Left: full acceleration, simulated and integrated; bars, if any: published times of a "
            "real Zoe. Right: acceleration under a constant torque less the expected 1 m/s2.",
            _draw_acceleration(launch, gains, car),
        )
    )
    braking.judge(result, car)
    return result


# --- coasting and top speed ---


def coast_down(plant: Plant, start: float = 36.0, end: float = 3.0) -> tuple[Array, Array]:
    """Time [s] and speed [m/s] of a car that rolls out, the drive's lag left out."""
    speed = plant.reset(vx=start).vx
    speeds = [speed]
    while speed > end:
        speed = plant.step(Command(0.0, 0.0)).vx
        speeds.append(speed)
    skip = round(1.0 / plant.Ts)
    v = np.array(speeds[skip:])
    times: Array = plant.Ts * np.arange(float(len(v)))
    return times, v


def road_load(times: Array, speeds: Array, mass: float, interval: float = 0.5) -> Any:
    """Resistance from a coast-down.

    Args:
        times: [s], shape (n,), evenly spaced.
        speeds: [m/s], shape (n,).
        mass: mass with spin [kg].
        interval: over which the deceleration is taken [s].

    Returns:
        Speeds and forces of the intervals, and the coefficients f0, f1, f2 of the fit.
    """
    stride = max(round(interval / (times[1] - times[0])), 1)
    v, t = speeds[::stride], times[::stride]
    middle = 0.5 * (v[1:] + v[:-1])
    force = -mass * np.diff(v) / np.diff(t)
    powers = np.stack([np.ones_like(middle), middle, middle**2], axis=1)
    return middle, force, np.linalg.lstsq(powers, force, rcond=None)[0]


def _coasting(result: StudyResult, car: CarUnderTest) -> None:
    p = car.params
    times, speeds = coast_down(car.plant(Ts=0.01))
    v, force, (f0, f1, f2) = road_load(times, speeds, p.m_eff)
    rolling, drag = p.c_roll * p.m * GRAVITY, 0.5 * p.rho_air * p.CdA
    why = "documented resistance; 2 % is the accuracy that EU 70/220 asks of a coast-down"
    result.find("rolling resistance f0", f0, "N", Limit.percent(rolling, 2.0), why)
    result.find("drag area, 2 f2 / air density", 2.0 * f2 / p.rho_air, "m2",
                Limit.percent(p.CdA, 2.0), why)
    result.find(
        "linear term f1 at 25 m/s, over force", f1 * 25.0 / (rolling + drag * 625.0), "",
        Limit.near(0.0, 0.02), why,
    )
    result.series.append(Series("coast-down", {"v_mps": v, "force_N": force}))
    result.pictures.append(
        Picture(
            "coast-down",
            "Coast-down. Left: speed, simulated and by the closed form. Right: the resistance that "
            "follows from it, and the documented one with the tolerance of 2 %.",
            _draw_coasting(times, speeds, v, force, car),
        )
    )


def rolling_out(times: Array, start: float, car: CarUnderTest) -> Array:
    """Speed of a body with rolling resistance and drag: v = a tan(atan(v0 / a) - b t) [m/s]."""
    p = car.params
    rolling, drag = p.c_roll * p.m * GRAVITY, 0.5 * p.rho_air * p.CdA
    a, b = math.sqrt(rolling / drag), math.sqrt(rolling * drag) / p.m_eff
    speeds: Array = a * np.tan(np.arctan(start / a) - b * times)
    return speeds


def _top_speed(result: StudyResult, car: CarUnderTest) -> None:
    p = car.params
    rolling, drag = p.c_roll * p.m * GRAVITY, 0.5 * p.rho_air * p.CdA
    (expected,) = (
        root.real for root in np.roots([drag, 0.0, rolling, -p.P_drive_max])
        if abs(root.imag) < 1e-9
    )
    plant = car.plant()
    plant.reset(vx=0.97 * expected)
    for _ in range(round(150.0 / plant.Ts)):  # the last per cent takes five time constants
        speed = plant.step(Command(0.0, 5.0)).vx
    result.find(
        "top speed", speed, "m/s", Limit.percent(expected, 1.0),
        "power = (f0 + f2 v^2) v; 1 % for the slip of the driven wheels",
    )


# --- acceleration ---


def launch_command(car: CarUnderTest) -> float:
    """Acceleration that uses 90 % of the driven tires' grip from rest [m/s2]."""
    p = car.params
    front = p.mu * GRAVITY * p.lr / (p.wheelbase + p.mu * p.h)
    rear = p.mu * GRAVITY * p.lf / (p.wheelbase - p.mu * p.h)
    return 0.9 * min(
        limit / share for limit, share in ((front, p.drive_front), (rear, 1.0 - p.drive_front))
        if share > 0.0
    )


def launch(plant: Plant, command: float, end: float) -> tuple[Array, Array]:
    """Time [s] and speed [m/s] from rest to a speed."""
    speed = plant.reset(vx=0.0).vx
    speeds = [speed]
    while speed < end and len(speeds) < 60.0 / plant.Ts:
        speed = plant.step(Command(0.0, command)).vx
        speeds.append(speed)
    times: Array = plant.Ts * np.arange(float(len(speeds)))
    return times, np.array(speeds)


def ideal_launch(car: CarUnderTest, command: float, end: float) -> tuple[Array, Array]:
    """The same by integration of force over mass, with linear slip of the driven wheels."""
    p, (front, rear) = car.params, car.coefficients
    static = 0.5 * p.m * GRAVITY / p.wheelbase
    soft = 0.5 * p.drive_front**2 / mf.slip_stiffness(front, static * p.lr)
    soft += 0.5 * (1.0 - p.drive_front) ** 2 / mf.slip_stiffness(rear, static * p.lf)
    drive = 0.0
    dt, t, v = 1e-3, 0.0, 0.0
    times, speeds = [t], [v]
    while v < end:
        asked = p.m_eff * command * (1.0 - math.exp(-t / p.tau_ax))
        drive = min(asked, p.F_drive_max, p.P_drive_max / max(v * (1.0 + soft * drive), 0.1))
        load = p.c_roll * p.m * GRAVITY + 0.5 * p.rho_air * p.CdA * v * v
        v += dt * max(drive - load, 0.0) / p.m_eff
        t += dt
        times.append(t)
        speeds.append(v)
    return np.array(times), np.array(speeds)


def _acceleration(result: StudyResult, car: CarUnderTest) -> dict[str, tuple[Array, Array]]:
    command = launch_command(car)
    end = 110.0 * KMH
    curves = {
        "simulated": launch(car.plant(Ts=0.01), command, end),
        "integrated": ideal_launch(car, command, end),
    }
    shown = current() is None
    rows = []
    for name, (low, high) in PUBLISHED.items():
        goal = float(name.split("-")[1].split()[0]) * KMH
        took, ideal = (float(np.interp(goal, v, t)) for t, v in curves.values())
        result.find(
            f"{name}, full acceleration", took, "s", Limit.percent(ideal, 2.0),
            "integral of force over mass; 2 % for what slip has beyond its linear part",
        )
        rows.append((name, took, ideal, *[f"{low:g} to {high:g}"] * shown))
    header = ("from rest", "simulated [s]", "integrated [s]",
              *["real Zoe R240, published [s]"] * shown)
    result.tables.append(Table("launch", "Full acceleration (no verdict)", header, rows))
    times, speeds = curves["simulated"]
    result.series.append(Series("launch", {"t_s": times, "v_mps": speeds}))
    return curves


def gained(car: CarUnderTest, speed: float, timestep: float) -> float:
    """Mean acceleration in the second second under the torque for 1 m/s2 [m/s2].

    Args:
        car: car under test; its plant gets no resistances and no power limit.
        speed: at the beginning [m/s].
        timestep: physics step [s].
    """
    plant = car.plant(Ts=0.01, timestep=timestep)
    for name in ("tire_f", "tire_r"):
        plant.model.numeric(name).data[mf.QSY1] = 0.0
    plant.model.numeric("aero").data[1:3] = 0.0
    plant.model.numeric("powertrain").data[2] = 1e9
    plant.reset(vx=speed, trim=False)
    speeds = [plant.step(Command(0.0, 1.0)).vx for _ in range(200)]
    return speeds[-1] - speeds[99]


def _torque(result: StudyResult, car: CarUnderTest) -> Array:
    gains = np.array([[gained(car, v, dt) for v in SPEEDS] for dt in STEPS])
    why = "force over mass knows neither; 0.1 % is ten times what slip does to the wheels' spin"
    spread = 100.0 * float(np.ptp(gains, axis=1).max())
    result.find("constant torque: spread over speed", spread, "%", Limit.at_most(0.1), why)
    spread = 100.0 * float(np.ptp(gains, axis=0).max())
    result.find("constant torque: spread over steps", spread, "%", Limit.at_most(0.1), why)
    result.find(
        "acceleration for the torque of 1 m/s2", float(gains.mean()), "m/s2",
        Limit.near(1.0, 1e-3), "T = R_w m_eff a; 0.1 % for slip",
    )
    rows = [(f"{1e3 * dt:g} ms", *row) for dt, row in zip(STEPS, gains, strict=True)]
    header = ("physics step", *(f"{v:g} m/s" for v in SPEEDS))
    caption = "Acceleration under a constant torque [m/s2]"
    result.tables.append(
        Table("torque", caption, header, [(row[0], *(f"{x:.6f}" for x in row[1:])) for row in rows])
    )
    return gains


def lag_of_forces(car: CarUnderTest, frequency: float = 5.0) -> float:
    """By how many physics steps the motion lags the tires' forces [-].

    m a[k] = (1 - lag) F[k] + lag F[k-1], F the forces of all tires and the drag, fitted to two
    seconds of a drive that sways.
    """
    p = car.params
    dt = car.documented.opt.timestep
    plant = car.plant(Ts=dt)
    speed = plant.reset(vx=15.0).vx
    speeds, forces = [speed], []
    for k in range(round(2.0 / dt)):
        drive = 3.0 * math.sin(2.0 * math.pi * frequency * k * dt)
        speed = plant.step(Command(0.0, drive)).vx
        forces.append(plant.wheels.Fx.sum() - 0.5 * p.rho_air * p.CdA * speeds[-1] ** 2)
        speeds.append(speed)
    F = np.array(forces)
    missing = (p.m * np.diff(speeds) / dt - F)[1:]
    change = F[:-1] - F[1:]
    return float((missing @ change) / (change @ change))


# --- pictures ---


@style.styled
def _draw_coasting(
    times: Array, speeds: Array, v: Array, force: Array, car: CarUnderTest
) -> Any:
    p = car.params
    figure, (left, right) = style.axes(1, 2, height=2.6)
    left.plot(times, speeds, color=style.BLUE, lw=1.8, label="simulated")
    left.plot(times, rolling_out(times, float(speeds[0]), car), color="black", lw=0.9,
              ls=(0, (4, 2)), label="closed form")
    style.label(left, "time [s]", "speed [m/s]", "Coasting")
    left.legend()
    expected = p.c_roll * p.m * GRAVITY + 0.5 * p.rho_air * p.CdA * v**2
    right.plot(v[::8], force[::8], "o", ms=2.2, color=style.BLUE, label="from coasting")
    right.plot(v, expected, color="black", lw=0.9, ls=(0, (4, 2)), label="documented")
    style.limit_band(right, v, 0.98 * expected, 1.02 * expected, "2 %")
    style.label(right, "speed [m/s]", "resistance [N]", "Road load")
    right.legend()
    return figure


@style.styled
def _draw_acceleration(
    curves: dict[str, tuple[Array, Array]], gains: Array, car: CarUnderTest
) -> Any:
    figure, (left, right) = style.axes(1, 2, height=2.6)
    for (name, (t, v)), look in zip(
        curves.items(),
        ({"color": style.BLUE, "lw": 1.8}, {"color": "black", "lw": 0.9, "ls": (0, (4, 2))}),
        strict=True,
    ):
        left.plot(t, v / KMH, label=name, **look)
    for name, (low, high) in (PUBLISHED if current() is None else {}).items():
        goal = float(name.split("-")[1].split()[0])
        first = name.startswith("0-50")
        left.errorbar(
            0.5 * (low + high), goal, xerr=0.5 * (high - low), fmt="none", ecolor=style.RED,
            elinewidth=2.0, capsize=3.5, label="real Zoe, published" if first else None, zorder=4,
        )
    style.label(left, "time [s]", "speed [km/h]", "Full acceleration")
    left.legend(loc="lower right")
    looks = (("o", style.SKY), ("s", style.BLUE), ("^", style.GREEN), ("x", style.ORANGE))
    for dt, row, (mark, colour) in zip(STEPS, gains, looks, strict=True):
        right.plot(SPEEDS, 1e3 * (row - 1.0), marker=mark, ms=4.0, lw=0.8, mfc="none",
                   color=colour, label=f"{1e3 * dt:g} ms")
    style.limit_line(right, -1.0)
    style.limit_line(right, 1.0, "_")
    right.set_xlim(0.0, 36.0)
    right.set_ylim(-1.4, 1.9)
    style.label(right, "speed [m/s]", "deviation [mm/s²]", "Torque of 1 m/s², by physics step")
    right.legend(loc="upper right", ncols=3)
    return figure


