"""Driving in a circle (ISO 4138): understeer, yaw gain, sideslip, roll, the limit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lpvmpc.car.current import current
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.limit import RADIUS, largest_lateral_acceleration
from lpvmpc.plant.mjcf import tires
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.parts.circle import (
    SPEED,
    Steady,
    both_ways,
    deg_per_g,
    drivable,
    effective_stiffness,
    fastest_turning_speed,
    levels,
    sideslip_free_speed,
    slope_at_zero,
    steady,
)
from lpvmpc.studies.reference.circle_formulas import Linear, SteadyTrack, steady_track
from lpvmpc.studies.study import TARGET, CarUnderTest, Picture, Series, StudyResult
from lpvmpc.units import GRAVITY, Array

METHOD = """\
Steady-state circular driving after ISO 4138: on a *constant radius* of 100 m (path of the centre
of mass), and at a *constant speed* of 100 km/h, in both directions, in steps of 0.5 m/s2 up to the
limit. Each point is a car that two slow integral controllers, on speed and yaw rate, have settled
until nothing changes any more; nothing is averaged and no transient is left.

- Understeer gradient U = d(delta - L r / vx) / d ay at the road wheel (SAE J670), from an odd cubic
  through eight points up to 1 m/s2, both directions; its slope at zero is compared.
- Linear formula with the tires' own slopes at static load. The lateral forces act behind the wheel
  centres by the pneumatic trail, so that the levers are lf - t_f and lr + t_r, their sum L':
  U = m / L' ((lr + t_r) / Cf - (lf - t_f) / Cr), and the yaw gain is vx / (L + U vx^2).
- What is expected has the terms of first order beyond it: the load that drag moves to the rear,
  rolling resistance, larger on the outer side, and the drive's direction
  (`studies/reference/circle_formulas.py`). They are a per cent or two of an axle's slip, and U is
  the difference of two such slips: of a car close to neutral they are a third of U.
- Sideslip angle beta = vy / vx; rear slip gradient d(beta - lr r / vx) / d ay, in the linear
  formula -m (lf - t_f) / (L' Cr). Roll gradient (m h + 4 J_w / R_w) / K_phi: both roll centres lie
  on the road, and the wheels' spin axis turns with the car.
- Effective axle stiffness: the single track's lateral force over its slip angle, from the motion
  alone, m ay lr / L over delta - (vy + lf r) / vx, and so behind.
- Handling diagram: ay over the difference of front and rear slip angle, delta - L r / vx.
- Where they are valid: the linear formulas below some 0.2 g; the limit on a level road of the
  documented friction.
"""

SMALL = (0.25, 0.5, 0.75, 1.0)
"""Lateral accelerations from which the gradients at zero are taken [m/s2]."""
SPEEDS = (10.0, 15.0, 20.0, 25.0, 30.0)
"""Speeds at which the understeer gradient is taken [m/s]."""
SOFTENED = 2.5
"""What load transfer and slip at 2 m/s2 may take of an axle's stiffness [%]."""


def run(car: CarUnderTest) -> StudyResult:
    """Study steady circular driving."""
    result = StudyResult("steady-state", METHOD)
    plant, p = car.plant(), car.params
    linear = Linear.of(p)
    limit = largest_lateral_acceleration(plant)
    circle = both_ways(plant, [(math.sqrt(ay * RADIUS), ay) for ay in levels(limit)])
    fast = both_ways(plant, [(SPEED, ay) for ay in drivable(plant, limit)])
    _understeer(result, plant, car, linear)
    gains = _yaw_gain(result, plant, car, linear)
    _sideslip_and_roll(result, plant, circle, car, linear)
    _limit(result, circle, limit, car)
    tests = {"100 m": circle, "100 km/h": fast}
    for name, points in tests.items():
        result.series.append(Series(f"points-{name.replace(' ', '-').replace('/', 'p')}", {
            "vx_mps": [s.vx for s in points], "ay_mps2": [s.ay for s in points],
            "delta_rad": [s.delta for s in points], "vy_mps": [s.vy for s in points],
            "r_radps": [s.r for s in points], "roll_rad": [s.roll for s in points],
        }))
    result.pictures += [
        Picture(
            "handling",
            "Left: steer over lateral acceleration on the circle and at constant speed, with "
            "the linear formula. Right: handling diagram up to the limit, with the target of the "
            "understeer gradient.",
            _draw_handling(tests, car, linear, limit),
        ),
        Picture(
            "gains",
            "Left: yaw gain at 0.5 m/s2 over speed, linear formula with its band of 3 %, and "
            "targets. Right: sideslip of the rear axle and roll on the 100 m circle.",
            _draw_gains(gains, circle, car, linear),
        ),
    ]
    return result


# --- verdicts ---


def expected(car: CarUnderTest, vx: float, ay: float) -> SteadyTrack:
    """The documented car's linear steady state."""
    return steady_track(car.params, tires(car.documented), vx, ay)


def _understeer(result: StudyResult, plant: Plant, car: CarUnderTest, linear: Linear) -> None:
    p = car.params
    why = "linear formula with drag and rolling resistance, as ay goes to 0; 3 % for roll"
    textbook = deg_per_g(linear.understeer)
    rows = []
    ways = [("on 100 m", [(math.sqrt(ay * RADIUS), ay) for ay in SMALL])]
    ways += [(f"at {vx:g} m/s", [(vx, ay) for ay in SMALL]) for vx in SPEEDS]
    for name, points in ways:
        states = both_ways(plant, points)
        understeer = [s.understeer(p.wheelbase) for s in states]
        gradient = deg_per_g(slope_at_zero([s.ay for s in states], understeer))
        last = deg_per_g(understeer[-1] / states[-1].ay)
        formula = deg_per_g(slope_at_zero(SMALL, [
            expected(car, vx, ay).delta - p.wheelbase * ay / vx**2 for vx, ay in points
        ]))
        result.find(f"understeer gradient {name}", gradient, "deg/g",
                    Limit.percent(formula, 3.0), why)
        rows.append((name, gradient, last, formula, textbook))
    header = ("method", "at 0 [deg/g]", "over 1 m/s2 [deg/g]", "formula [deg/g]",
              "textbook's [deg/g]")
    result.tables.append(Table("understeer", "Understeer gradient by method", header, rows))
    for vx in (10.0, 20.0, 30.0):
        s = steady(plant, vx, 1.0)
        gradient = deg_per_g(s.understeer(p.wheelbase) / s.ay)
        result.find(
            f"understeer over 1 m/s2, {vx:g} m/s", gradient, "deg/g", Limit.near(2.45, 0.25),
            TARGET, target=True,
        )


def _yaw_gain(result: StudyResult, plant: Plant, car: CarUnderTest, linear: Linear) -> Array:
    error, fastest = 0.0, 25.0
    for vx in map(float, np.arange(5.0, fastest + 0.1, 2.5)):
        for ay in (0.5, 1.0, 1.5, 2.0):
            s = steady(plant, vx, ay)
            formula = ay / vx / expected(car, vx, ay).delta
            error = max(error, abs(s.r / s.delta / formula - 1.0))
    result.find(
        "yaw gain against formula, worst error", 100.0 * error, "%",
        Limit.at_most(SOFTENED * linear.yaw_gain_per_slip(fastest)),
        f"to 2 m/s2 and {fastest:g} m/s; what the gain shows of {SOFTENED:g} % more front slip and "
        "less rear slip, since tires soften and load moves",
    )
    for vx, target in ((10.0, 3.09), (15.0, 3.96), (20.0, 4.39)):
        s = steady(plant, vx, 1.0)
        result.find(f"yaw gain at {vx:g} m/s", s.r / s.delta, "1/s", Limit.percent(target, 4.0),
                    TARGET, target=True)
    result.find("speed of the highest yaw gain", fastest_turning_speed(plant), "m/s",
                Limit.near(25.0, 1.5), TARGET, target=True)
    speeds = np.arange(4.0, 41.0, 2.0)
    gain = [s.r / s.delta for s in (steady(plant, vx, 0.5) for vx in speeds)]
    result.series.append(Series("yaw-gain", {"vx_mps": speeds, "yaw_gain_1ps": gain}))
    return np.stack([speeds, gain])


def _sideslip_and_roll(
    result: StudyResult, plant: Plant, circle: list[Steady], car: CarUnderTest, linear: Linear
) -> None:
    p = car.params
    small = [s for s in circle if abs(s.ay) < 2.1]
    ay = [s.ay for s in small]
    gradient = slope_at_zero(ay, [s.rear_slip(p.lr) for s in small])
    slips = [expected(car, s.vx, s.ay).sideslip - p.lr * s.ay / s.vx**2 for s in small]
    result.find(
        "rear slip gradient on 100 m", deg_per_g(gradient), "deg/g",
        Limit.percent(deg_per_g(slope_at_zero(ay, slips)), 3.0),
        "linear formula with rolling resistance, as ay goes to 0",
    )
    roll = slope_at_zero(ay, [s.roll for s in small])
    result.find(
        "roll gradient on 100 m", deg_per_g(roll), "deg/g",
        Limit.percent(deg_per_g(linear.roll), 3.0),
        "(m h + 4 J_w / R_w) / K_phi: springs, bars, tires in series, less gravity",
    )
    s = steady(plant, 20.0, 1.0)
    result.find(
        "rear slip gradient at 20 m/s", deg_per_g(s.rear_slip(p.lr) / s.ay), "deg/g",
        Limit.near(-1.7, 0.1), TARGET, target=True,
    )
    front, rear = effective_stiffness(s, p)
    result.find("effective front stiffness, 20 m/s", 1e-3 * front, "kN/rad",
                Limit.near(122.0, 6.0), TARGET, target=True)
    result.find("effective rear stiffness, 20 m/s", 1e-3 * rear, "kN/rad",
                Limit.near(229.0, 12.0), TARGET, target=True)
    result.find("sideslip changes its sign at", sideslip_free_speed(plant), "m/s",
                Limit.near(23.0, 1.0), TARGET, target=True)


def _limit(
    result: StudyResult, circle: list[Steady], limit: float, car: CarUnderTest
) -> None:
    p = car.params
    result.find(
        "largest lateral acceleration, 100 m", limit, "m/s2", Limit.percent(p.ay_limit, 1.0),
        "the documented limit, by which speed profiles are planned",
    )
    result.find(
        "largest lateral acceleration over mu g", limit / (p.mu * GRAVITY), "", Limit.at_most(1.0),
        "friction bounds it; load transfer and drive take some",
    )
    left = [s for s in circle if s.ay > 0.0]
    angle = np.array([s.understeer(p.wheelbase) for s in left])
    ay = np.array([s.ay for s in left])
    least = float((np.diff(angle) / np.diff(ay)).min())
    result.find(
        "least understeer gradient to the limit", deg_per_g(least), "deg/g", Limit.at_least(0.0),
        "a passenger car loses its front axle first",
    )
    asymmetry = max(
        max(abs(a.delta + b.delta), abs(a.roll + b.roll), abs(a.vy + b.vy))
        for a, b in zip(circle, reversed(circle), strict=True)
    )
    result.find(
        "left against right, worst difference", asymmetry, "rad, m/s", Limit.at_most(1e-9),
        "a symmetric car: the arithmetic itself is mirrored, 1e-9 leaves room for rounding",
    )
    rows = [
        (
            f"{s.vx:.1f}", s.ay, math.degrees(s.delta), math.degrees(math.atan2(s.vy, s.vx)),
            math.degrees(s.roll), *(f"{load:.0f}" for load in s.loads),
        )
        for s in (*left[1:-1:2], left[-1])
    ]
    header = (
        "vx [m/s]", "ay [m/s2]", "steer [deg]", "sideslip [deg]", "roll [deg]",
        "Fz fl [N]", "fr", "rl", "rr",
    )
    result.tables.append(Table("circle", "Left turns on 100 m", header, rows))


# --- pictures ---


@style.styled
def _draw_handling(
    tests: dict[str, list[Steady]], car: CarUnderTest, linear: Linear, limit: float
) -> Any:
    figure, (left, right) = style.axes(1, 2, height=2.9)
    L, U = linear.wheelbase, linear.understeer
    colours = (style.BLUE, style.ORANGE)
    for (name, points), colour in zip(tests.items(), colours, strict=True):
        for sign in (-1.0, 1.0):
            half = [s for s in points if s.ay * sign > 0.0]
            at = np.array([s.ay for s in half])
            first = sign > 0.0
            left.plot(at, [math.degrees(s.delta) for s in half], "o-", ms=2.2, color=colour,
                      label=name if first else None)
            geometry = L / RADIUS * sign if name == "100 m" else L * at / SPEED**2
            left.plot(at, np.degrees(geometry + U * at), color="black", lw=0.8, ls=(0, (4, 2)),
                      label="linear formula" if first and name == "100 m" else None)
            turn = "left" if first else "right"
            mark = {("100 m", "left"): "o", ("100 m", "right"): "s", ("100 km/h", "left"): "+",
                    ("100 km/h", "right"): "x"}[name, turn]
            right.plot(
                [sign * math.degrees(s.understeer(L)) for s in half], sign * at, mark, ms=4.5,
                mfc="none", mec=colour, mew=0.8, label=f"{name}, {turn}",
            )
    style.label(left, "lateral acceleration, left positive [m/s²]", "steer [deg]", "Steer")
    left.legend(loc="upper left")
    ay = np.linspace(0.0, limit, 50)
    right.plot(np.degrees(U * ay), ay, color="black", lw=0.8, ls=(0, (4, 2)),
               label="linear formula")
    if current() is None:  # the targets are the packaged car's
        near = np.linspace(0.0, 2.0, 20)
        right.fill_betweenx(near, 2.2 * near / GRAVITY, 2.7 * near / GRAVITY, color=style.RED,
                            alpha=0.35, lw=0.0, label="target, 2.45 ± 0.25 deg/g")
    style.limit_line(right, car.params.ay_limit, "documented limit")
    right.set_xlim(left=0.0)
    right.set_ylim(0.0, max(7.6, 1.05 * limit))
    style.label(right, "front less rear slip angle [deg]", "lateral acceleration [m/s²]",
                "Handling diagram")
    right.legend(loc="lower right")
    return figure


@style.styled
def _draw_gains(gains: Array, circle: list[Steady], car: CarUnderTest, linear: Linear) -> Any:
    figure, (left, right) = style.axes(1, 2, height=2.9)
    speeds, gain = gains
    v = np.linspace(1.0, 41.0, 100)
    line = linear.yaw_gain(v)
    left.plot(v, line, color="black", lw=0.8, ls=(0, (4, 2)), label="linear formula")
    inside = v <= 25.0
    style.limit_band(left, v[inside], 0.97 * line[inside], 1.03 * line[inside], "3 % to 25 m/s")
    left.plot(speeds, gain, "o", ms=2.5, color=style.BLUE, label="simulated")
    if current() is None:
        left.errorbar(
            [10.0, 15.0, 20.0], [3.09, 3.96, 4.39], yerr=[0.04 * g for g in (3.09, 3.96, 4.39)],
            fmt="none", ecolor=style.RED, elinewidth=1.2, capsize=3.0, label="targets", zorder=4,
        )
        left.axvspan(23.5, 26.5, color=style.GREEN, alpha=0.15, lw=0.0, label="target of the peak")
    style.label(left, "speed [m/s]", "yaw gain r / steer [1/s]", "Yaw gain")
    left.set_ylim(0.0, max(5.2, 1.1 * float(gain.max())))
    left.legend(loc="lower right")
    ay = np.array([s.ay for s in circle])
    for values, slope, colour, name in (
        ([s.rear_slip(car.params.lr) for s in circle], linear.rear_slip, style.BLUE, "rear slip"),
        ([s.roll for s in circle], linear.roll, style.GREEN, "roll"),
    ):
        right.plot(ay, np.degrees(values), "o-", ms=2.2, color=colour, label=name)
        right.plot(ay, np.degrees(slope * ay), color="black", lw=0.8, ls=(0, (4, 2)),
                   label="linear formula" if name == "roll" else None)
    style.label(right, "lateral acceleration [m/s²]", "angle [deg]", "Rear sideslip and roll")
    right.legend()
    return figure
