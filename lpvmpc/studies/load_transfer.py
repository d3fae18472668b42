"""Where the weight goes: lateral and longitudinal load transfer, roll, wheel lift, rollover."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.studies.parts import rollover
from lpvmpc.studies.parts.rollover import Springs
from lpvmpc.studies.parts.transfer import lateral_transfer, longitudinal_transfer
from lpvmpc.studies.study import CarUnderTest, Picture, StudyResult
from lpvmpc.units import GRAVITY, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RADIUS = 100.0
"""Radius of the circles [m]."""
LATERAL = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 6.5)
"""Lateral accelerations on the circles [m/s2]."""
STRAIGHT = (-6.0, -4.0, -2.0, -1.0, 1.0, 1.5)
"""Commanded longitudinal accelerations [m/s2]."""

METHOD = """\
**Definitions.** *Load* is the vertical force of a tire. The *transfer* of an axle is half the
difference of its right and left load in a left turn; the longitudinal transfer is what the front
axle has gained over its static load. *Wheel lift* is the first instant at which a load is zero.
The *static stability factor* is t/2h; NHTSA gives 1.41 as the average of passenger cars of model
year 2003 (report HS 809 868).

**Closed form, lateral.** The wheels slide along the body's vertical axis, so both roll centres lie
on the road and all transfer is elastic: with the moment
`M = ay (m h + 4 J_w/R_w)` (the second term is the gyroscopic moment of the wheels, whose spin axis
turns with the car: v r = ay), the roll angle is `phi = M/K_phi` and an axle's transfer its share of
the roll stiffness times `(K_phi + m g h) phi / t`.

**Closed form, longitudinal.** `dFz = -(F h + J_w sum(omega'))/L` for the tires' total longitudinal
force `F` (mass times acceleration plus drag), divided by `1 - m g (h - z_w)(1/K_f + 1/K_r)/L^2`:
the body pitches on its springs `K` and carries the centre of mass forward, `h - z_w` above the
wheels.

**Wheel lift and rollover.** The standing, braked car is pulled sideways at its centre of mass by a
slowly growing force (the horizontal part of gravity) on a road to which the tires stick, until it
falls over: on the real road it would slide. The closed form has three terms beyond `t/2h`: roll
moves the centre of mass out by `h phi`; on the tilted slides the side force `m a` lifts the body by
`m a phi/K` and takes `a phi/g` of an axle's transfer from its springs. An axle lifts where its
transfer is half its weight; the last axle to lift is the rollover threshold.

**Valid** to second order in the roll angle, which is 0.06 rad at the limit of grip and 0.1 rad at
wheel lift; a softer car that rolls beyond 0.12 rad there is shown and not judged.
"""


def run(car: CarUnderTest) -> StudyResult:
    """Lateral and longitudinal transfer, wheel lift and rollover."""
    result = StudyResult("load-transfer", METHOD)
    springs = Springs.of(car.documented)
    circles = _circles(car, result)
    straight = _straight(car, springs, result)
    ramp = rollover.pull_over(car)
    rollover.judge(car.params, springs, ramp, result)
    result.pictures += [
        Picture(
            "transfer",
            "Load transfer on a circle of 100 m radius (left) and in straight driving (right): "
            "simulation (dots) and closed form (lines, shaded 2 %).",
            _transfer_picture(car.params, circles, straight),
        ),
        Picture(
            "rollover",
            "Loads while the car is pulled sideways; dashed lines: closed form of the lift of each "
            "axle and, dotted, the static stability factor t/2h of a rigid car.",
            rollover.picture(car.params, springs, ramp),
        ),
    ]
    return result


# --- circles ---


def _circles(car: CarUnderTest, result: StudyResult) -> Array:
    """Steady circles to both sides; rows of ay, front and rear transfer, roll, sum of loads."""
    p, plant = car.params, car.plant()
    rows, held = [], [ay for ay in LATERAL if ay < p.ay_limit - 0.3]
    for ay in held:
        for side in (1.0, -1.0):
            s = plant.reset(vx=math.sqrt(ay * RADIUS), kappa=side / RADIUS)
            fl, fr, rl, rr = plant.wheels.Fz
            half = side / 2.0
            loads = (half * (fr - fl), half * (rr - rl), side * plant.roll, fl + fr + rl + rr)
            rows.append((side * s.ay, *loads))
    table = np.array(rows)
    form = np.array([lateral_transfer(p, ay) for ay in table[:, 0]])
    off = table[:, 1:4] / form - 1.0
    gentle = table[:, 0] < 4.5
    why = "linear in roll: at 4 m/s2 the side force on the tilted slides lifts the body 0.5 % of h"
    for i, name in enumerate(("front transfer", "rear transfer")):
        worst = 100.0 * float(np.abs(off[gentle, i]).max())
        result.find(f"{name} off, to 4 m/s2", worst, "%", Limit.at_most(1.0), why)
    taken = 100.0 * float((table[gentle, 0] * form[gentle, 2]).max()) / GRAVITY
    result.find(
        "roll angle off, to 4 m/s2", 100.0 * float(np.abs(off[gentle, 2]).max()), "%",
        Limit.at_most(taken + 0.5),
        f"linear in roll: on tilted slides the side force takes ay phi/g, {taken:.2g} %, off the "
        "springs; 0.5 % as above",
    )
    result.find(
        f"transfers off, at {held[-1]:g} m/s2", 100.0 * float(np.abs(off[-2:, :2]).max()), "%",
        Limit.at_most(2.0), "as to 4 m/s2; the body is then lifted by 1.2 % of h",
    )
    shares = table[:, 1] / (table[:, 1] + table[:, 2])
    front, rear, _ = form[0]
    result.find(
        "front axle's share of the transfer", float(shares[gentle].mean()), "",
        Limit.percent(front / (front + rear), 0.5),
        "share of the springs, bars and tires in series, each over its track",
    )
    weight = p.m * GRAVITY
    result.find(
        "sum of loads off the weight", float(np.abs(table[:, 4] / weight - 1.0).max()), "",
        Limit.at_most(1e-6), "equilibrium, which the steady state meets to 1e-7",
    )
    mirrored = float(np.abs(table[::2] - table[1::2])[:, 1:3].max())
    result.find("left against right turn, transfer", mirrored, "N", Limit.at_most(0.01),
                "a symmetric car; the steady state itself is found to 1e-6")
    header = ("ay m/s2", "front N", "closed form", "rear N", "closed form", "roll deg",
              "closed form")
    left = [
        (row[0], row[1], f[0], row[2], f[1], math.degrees(row[3]), math.degrees(f[2]))
        for row, f in zip(table[::2], form[::2], strict=True)
    ]
    caption = "Steady left turns of 100 m radius: transfer and roll"
    result.tables.append(Table("circles", caption, header, left))
    return table


# --- straight ---


def _straight(car: CarUnderTest, springs: Springs, result: StudyResult) -> Array:
    """Steady braking and acceleration; rows of force, transfer, closed form."""
    p, Ts = car.params, 0.01
    static = p.m * GRAVITY * p.lr / p.wheelbase
    rows = []
    for ax in STRAIGHT:
        plant = car.plant(Ts=Ts)
        state = plant.reset(vx=30.0 if ax < 0.0 else 10.0)
        settled: list[tuple[float, float, float]] = []
        for k in range(round(2.5 / Ts)):
            before = state.wheel_speed
            state = plant.step(Command(0.0, ax))
            if k * Ts < 1.5:  # lags of drive and pitch
                continue
            drag = 0.5 * p.rho_air * p.CdA * state.vx**2
            spin_up = float(np.sum(state.wheel_speed - before)) / Ts
            force = p.m * state.ax + drag
            gained = float(plant.wheels.Fz[:2].sum()) - static
            settled.append((force, gained, longitudinal_transfer(p, springs, force, spin_up)))
        rows.append(np.mean(settled, axis=0))
    table = np.array(rows)
    off = 100.0 * float(np.abs(table[:, 1] / table[:, 2] - 1.0).max())
    result.find("longitudinal transfer off", off, "%", Limit.at_most(2.0),
                "linear in the pitch angle, whose whole effect is 2 %")
    caption = "Straight driving: load that the front axle gains, mean over a second"
    header = ("command m/s2", "tire force N", "front gains N", "closed form")
    cells = [(f"{ax:g}", *row) for ax, row in zip(STRAIGHT, table, strict=True)]
    result.tables.append(Table("straight", caption, header, cells))
    return table


# --- picture ---


@style.styled
def _transfer_picture(p: VehicleParams, circles: Array, straight: Array) -> Figure:
    figure, (side, along) = style.axes(1, 2, height=2.5)
    ay = np.linspace(0.0, 7.0, 50)
    form = np.array([lateral_transfer(p, a) for a in ay])
    for i, (name, color) in enumerate((("front axle", style.BLUE), ("rear axle", style.ORANGE))):
        side.plot(ay, form[:, i], color=color, lw=0.8)
        side.fill_between(ay, 0.98 * form[:, i], 1.02 * form[:, i], color=color, alpha=0.25, lw=0)
        side.plot(circles[:, 0], circles[:, 1 + i], "o", ms=3.5, color=color, label=name)
    side.axvline(p.ay_limit, color=style.GREY, lw=0.8, ls=":", label="limit of grip")
    style.label(side, "lateral acceleration [m/s²]", "transfer, outer wheel gains [N]",
                "Circles of 100 m, left and right")
    side.set_xlim(0.0, None)
    side.set_ylim(0.0, None)
    side.legend(loc="upper left")
    order = np.argsort(straight[:, 0])
    force, gained, line = straight[order].T
    along.plot(force / 1e3, line, color=style.BLUE, lw=0.8, label="closed form")
    along.fill_between(force / 1e3, 0.98 * line, 1.02 * line, color=style.BLUE, alpha=0.25, lw=0)
    along.plot(force / 1e3, gained, "o", ms=3.5, color=style.BLUE, label="simulation")
    along.axhline(0.0, color=style.GREY, lw=0.5)
    along.axvline(0.0, color=style.GREY, lw=0.5)
    style.label(along, "longitudinal force of all tires [kN]", "front axle gains [N]",
                "Braking and acceleration")
    along.legend(loc="upper right")
    return figure
