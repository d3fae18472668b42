"""Wheel lift and rollover: the car is pulled sideways until it falls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.params import VehicleParams
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.studies.study import CarUnderTest, Series, StudyResult
from lpvmpc.units import GRAVITY, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RAMP = 0.5
"""Growth of the sideways pull [m/s2 per second]: slow against the roll mode of about 1.5 Hz."""


SECOND_ORDER = 0.12
"""Roll angle to which the closed form of wheel lift, of second order in it, is judged [rad]."""


@dataclass(frozen=True)
class Springs:
    """Vertical stiffness of one wheel: spring in series with the tire [N/m]."""

    front: float
    """At the front axle, without the anti-roll bar."""
    rear: float
    """At the rear axle."""
    wheel_height: float
    """Height of the wheel centres over the road, mean of the axles [m]."""

    @classmethod
    def of(cls, model: mujoco.MjModel) -> Springs:
        """Those of a compiled car."""
        stiffness, heights = [], []
        for axle, coefficients in zip("fr", ("tire_f", "tire_r"), strict=True):
            KZ = float(model.numeric(coefficients).data[mf.KZ])
            joint = model.joint(f"susp_{axle}l").id
            spring = float(np.ravel(model.jnt_stiffness[joint])[0])
            stiffness.append(spring * KZ / (spring + KZ))
            knuckle = model.body(f"knuckle_{axle}l").id
            heights.append(float(model.qpos0[2] + model.body_pos[knuckle][2]))
        return cls(stiffness[0], stiffness[1], sum(heights) / 2.0)


def lift_thresholds(p: VehicleParams, springs: Springs) -> dict[str, tuple[float, float]]:
    """Sideways pull at which the inner wheels lift, by axle, the first one first.

    With a in g: roll phi from the springs of the axle that lifts, K phi = (1 - a phi) W t/2; body
    raised to h' = h + m g a phi/K_heave; then balance of moments,
    K_springs phi/(1 - a phi) = m g h' (a + phi) with both axles on the road, and
    t/2 = h' (a + phi) when the last one lifts.

    Args:
        p: Parameters of the car.
        springs: Its springs.

    Returns:
        Acceleration over gravity [-] and roll angle [rad] at the first and at the last lift, by
        "front" and "rear".
    """
    alone = {axle: _lift(p, springs, axle, last=False) for axle in ("front", "rear")}
    first, last = sorted(alone, key=lambda axle: alone[axle][0])
    return {first: alone[first], last: _lift(p, springs, last, last=True)}


def _lift(p: VehicleParams, springs: Springs, axle: str, last: bool) -> tuple[float, float]:
    """Pull and roll at which an axle lifts: the last one, or with the other one on the road."""
    weight, total = p.m * GRAVITY, p.K_phi + p.m * GRAVITY * p.h
    heave = 2.0 * (springs.front + springs.rear)
    share = p.roll_share_front if axle == "front" else 1.0 - p.roll_share_front
    track = p.track_f if axle == "front" else p.track_r
    load = weight * (p.lr if axle == "front" else p.lf) / p.wheelbase
    a, phi = track / (2.0 * p.h), 0.0
    for _ in range(100):  # contracts by a factor of ten each time
        phi = (1.0 - a * phi) * load * track / 2.0 / (share * total)
        height = p.h + weight * a * phi / heave
        if last:
            a = track / (2.0 * height) - phi
        else:
            a = total * phi / (1.0 - a * phi) / (weight * height) - phi
    return a, phi


def pull_over(car: CarUnderTest) -> Array:
    """Pull the standing, braked car sideways until it falls.

    Returns:
        Rows of pull [g], loads fl, fr, rl, rr [N], roll [rad] and how far the car was moved [m],
        shape (n, 7).
    """
    p, plant = car.params, car.plant()
    for name in ("tire_f", "tire_r"):  # a road to which tires stick, at any load
        coefficients = plant.model.numeric(name).data
        coefficients[[mf.PDX1, mf.PDY1]] = 5.0
        coefficients[[mf.PDX2, mf.PDY2]] = 0.0
        coefficients[mf.PKY1] *= 5.0
    plant.model.numeric("low_speed").data[2] = 1.0  # the cap on the deflection would let it slide
    plant.reset(trim=False)
    braked = Command(0.0, p.ax_min)
    start = plant.state
    for _ in range(60):
        start = plant.step(braked)
    rows = []
    for k in range(round(1.7 * GRAVITY / RAMP / plant.Ts)):
        pull = k * plant.Ts * RAMP
        plant.model.opt.gravity[1] = -pull
        state = plant.step(braked)
        slid = abs(state.y - start.y)
        rows.append((pull / GRAVITY, *plant.wheels.Fz, plant.roll, slid))
        if abs(plant.roll) > 0.3:
            break
    return np.array(rows)


def judge(p: VehicleParams, springs: Springs, ramp: Array, result: StudyResult) -> None:
    """Compare the lifts of the wheels in `pull_over` with the closed form."""
    why = "second order in the roll angle of 0.1 rad; the third is 1 %"
    names = ("{} wheel lifts at", "{} wheel lifts, car tips, at")
    rows: list[tuple[object, ...]] = []
    for name, (axle, (form, phi)) in zip(names, lift_thresholds(p, springs).items(), strict=True):
        column = {"front": 1, "rear": 3}[axle]
        pull = lift_pull(ramp[:, 0], ramp[:, column])
        rows.append((axle, pull, form, math.degrees(phi)))
        if phi <= SECOND_ORDER:
            result.find(name.format(axle), pull, "g", Limit.percent(form, 2.0), why)
    header = ("inner wheel", "lifts at g", "closed form", "roll deg, closed form")
    caption = (
        "Wheel lift; judged where the closed form rolls by less than "
        f"{math.degrees(SECOND_ORDER):.2g} degrees"
    )
    result.tables.append(Table("lift", caption, header, rows))
    result.find(
        "tips at, over the limit of grip", pull * GRAVITY / p.ay_limit, "", Limit.at_least(1.0),
        "a passenger car on a flat road slides before it tips",
    )
    columns = ("pull_g", "Fz_fl_N", "Fz_fr_N", "Fz_rl_N", "Fz_rr_N", "roll_rad", "moved_m")
    result.series.append(
        Series("rollover", {name: ramp[::5, i] for i, name in enumerate(columns)})
    )


def lift_pull(pull: Array, load: Array) -> float:
    """Pull at which a load first comes down to zero, between samples; NaN if it never does.

    Args:
        pull: Growing sideways pull, shape (n,).
        load: Load of the wheel, shape (n,).
    """
    lifted = np.flatnonzero(load <= 0.0)
    if not len(lifted) or lifted[0] == 0:
        return math.nan
    i = int(lifted[0])
    # a tire does not pull, so the load's own slope before that tells where it met zero
    slope = (load[i - 1] - load[i - 2]) / (pull[i - 1] - pull[i - 2]) if i > 1 else 0.0
    if slope >= 0.0:
        return float(pull[i])
    return float(min(pull[i - 1] - load[i - 1] / slope, pull[i]))


@style.styled
def picture(p: VehicleParams, springs: Springs, ramp: Array) -> Figure:
    """Loads and roll while the car is pulled."""
    figure, (load, roll) = style.axes(1, 2, height=2.5)
    for column, name in enumerate(("front inner", "front outer", "rear inner", "rear outer"), 1):
        color = style.BLUE if column < 3 else style.ORANGE
        dashes = "-" if column % 2 else "--"
        load.plot(ramp[:, 0], ramp[:, column] / 1e3, color=color, ls=dashes, label=name)
    style.label(load, "sideways pull [g]", "load [kN]", "Loads")
    load.set_ylim(0.0, 14.0)
    roll.plot(ramp[:, 0], np.degrees(ramp[:, 5]), color=style.BLUE, label="simulation")
    pull = np.linspace(0.0, 1.2, 30)
    # no wheels spin here, so the linear form without their gyroscopic moment
    line = np.degrees(pull * GRAVITY * p.m * p.h / p.K_phi)
    roll.plot(pull, line, color="black", lw=0.8, ls=(0, (4, 2)), label="m a h / K_phi")
    style.label(roll, "sideways pull [g]", "roll angle [deg]", "Roll")
    roll.set_ylim(0.0, 15.0)
    for axis in (load, roll):
        for threshold, _ in lift_thresholds(p, springs).values():
            axis.axvline(threshold, color=style.RED, lw=0.9, ls=(0, (4, 2)))
        axis.axvline(p.track_f / (2.0 * p.h), color=style.GREY, lw=0.9, ls=":")
        axis.set_xlim(0.0, 1.5)
        axis.legend(loc="upper left")
    return figure
