"""Driving in a circle (ISO 4138): understeer, yaw gain, sideslip, roll, the limit."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import OptionError
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.plant.plant import Plant
from lpvmpc.studies import plots
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
- Sideslip angle beta = vy / vx; rear slip gradient d(beta - lr r / vx) / d ay, in the linear
  formula -m (lf - t_f) / (L' Cr). Roll gradient m h / K_phi: both roll centres lie on the road.
- Effective axle stiffness: the single track's lateral force over its slip angle, from the motion
  alone, m ay lr / L over delta - (vy + lf r) / vx, and so behind.
- Handling diagram: ay over the difference of front and rear slip angle, delta - L r / vx.
- Where they are valid: the linear formulas below some 0.2 g; the limit on a level road of the
  friction in Table 2.
"""

RADIUS = 100.0
"""Radius of the circle [m]; ISO 4138's standard one."""
SPEED = 100.0 / 3.6
"""Speed of the constant-speed test [m/s]."""
STEP = 0.5
"""Largest step of lateral acceleration in ISO 4138 [m/s2]."""
SMALL = (0.25, 0.5, 0.75, 1.0)
"""Lateral accelerations from which the gradients at zero are taken [m/s2]."""
SPEEDS = (10.0, 15.0, 20.0, 25.0, 30.0)
"""Speeds at which the understeer gradient is taken [m/s]."""


@dataclass(frozen=True)
class Steady:
    """A car that drives steadily in a circle; left turns are positive."""

    vx: float
    """Longitudinal speed [m/s]."""
    vy: float
    """Lateral speed [m/s]."""
    r: float
    """Yaw rate [rad/s]."""
    delta: float
    """Steer [rad]."""
    roll: float
    """Roll angle [rad]."""
    loads: tuple[float, ...]
    """Wheel loads fl, fr, rl, rr [N]."""

    @property
    def ay(self) -> float:
        """Lateral acceleration [m/s2]."""
        return self.vx * self.r

    def understeer(self, wheelbase: float) -> float:
        """Steer less that of the geometry, delta - L r / vx [rad]."""
        return self.delta - wheelbase * self.r / self.vx

    def rear_slip(self, lr: float) -> float:
        """Sideslip angle of the rear axle, (vy - lr r) / vx [rad]."""
        return (self.vy - lr * self.r) / self.vx


@dataclass(frozen=True)
class Linear:
    """What the linear single track with the tires' slopes says of a car."""

    understeer: float
    """Understeer gradient U [rad s2/m]."""
    rear_slip: float
    """Rear slip gradient [rad s2/m]."""
    roll: float
    """Roll gradient [rad s2/m]."""
    wheelbase: float
    """Wheelbase [m]."""

    @classmethod
    def of(cls, p: VehicleParams) -> Linear:
        """The linear formulas of a car."""
        front, rear = p.lf - p.trail_f, p.lr + p.trail_r
        share = p.m / (front + rear)
        return cls(
            understeer=share * (rear / p.Cf - front / p.Cr),
            rear_slip=-share * front / p.Cr,
            roll=p.m * p.h / p.K_phi,
            wheelbase=p.wheelbase,
        )

    def yaw_gain(self, vx: Any) -> Any:
        """Yaw rate over steer [1/s]: vx / (L + U vx^2)."""
        return vx / (self.wheelbase + self.understeer * vx**2)


def run(car: CarUnderTest) -> StudyResult:
    """Study steady circular driving."""
    result = StudyResult("steady-state", METHOD)
    plant, p = car.plant(), car.params
    linear = Linear.of(p)
    limit = largest_lateral_acceleration(plant)
    circle = both_ways(plant, [(math.sqrt(ay * RADIUS), ay) for ay in levels(limit)])
    fast = both_ways(plant, [(SPEED, ay) for ay in drivable(plant, limit)])
    _understeer(result, plant, car, linear)
    gains = _yaw_gain(result, plant, linear)
    _sideslip_and_roll(result, plant, circle, car, linear)
    _limit(result, circle, limit, car)
    tests = {"100 m": circle, "100 km/h": fast}
    for name, points in tests.items():
        result.series.append(Series(f"points-{name.replace(' ', '-').replace('/', 'p')}", {
            "vx_mps": [s.vx for s in points], "ay_mps2": [s.ay for s in points],
            "delta_rad": [s.delta for s in points], "vy_mps": [s.vy for s in points],
            "r_radps": [s.r for s in points], "roll_rad": [s.roll for s in points],
        }))  # fmt: skip
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


# --- what is measured ---


def steady(plant: Plant, vx: float, ay: float) -> Steady:
    """Let a car settle in a circle.

    Args:
        plant: plant.
        vx: speed [m/s].
        ay: lateral acceleration [m/s2], positive to the left.

    Raises:
        OptionError: the car cannot hold that.
    """
    s = plant.reset(vx=vx, kappa=ay / vx**2)
    return Steady(s.vx, s.vy, s.r, s.delta, plant.roll, tuple(plant.wheels.Fz))


def levels(limit: float) -> Array:
    """Lateral accelerations up to a limit, in steps of ISO 4138 [m/s2]."""
    return np.append(np.arange(STEP, limit - 0.1, STEP), 0.995 * limit)


def drivable(plant: Plant, limit: float) -> list[float]:
    """Levels that the car can hold at the constant speed [m/s2]."""
    found = []
    for ay in levels(limit):
        try:
            steady(plant, SPEED, ay)
        except OptionError:
            break
        found.append(float(ay))
    return found


def both_ways(plant: Plant, points: Iterable[tuple[float, float]]) -> list[Steady]:
    """Steady states (vx, ay) to the right and to the left, by rising ay."""
    points = list(points)
    turns = [(vx, -ay) for vx, ay in reversed(points)] + points
    return [steady(plant, vx, ay) for vx, ay in turns]


def largest_lateral_acceleration(plant: Plant, precision: float = 0.01) -> float:
    """Largest lateral acceleration that the car can hold on the circle [m/s2], by bisection."""
    low, high = 3.0, 2.5 * GRAVITY
    while high - low > precision:
        ay = 0.5 * (low + high)
        try:
            steady(plant, math.sqrt(ay * RADIUS), ay)
        except OptionError:
            high = ay
        else:
            low = ay
    return low


def slope_at_zero(x: Sequence[float], y: Sequence[float]) -> float:
    """Slope at zero of the odd cubic a x + b x^3 through points."""
    at = np.array(x)
    return float(np.linalg.lstsq(np.stack([at, at**3], axis=1), np.array(y), rcond=None)[0][0])


def deg_per_g(gradient: float) -> float:
    """A gradient of rad s2/m in deg/g."""
    return math.degrees(gradient) * GRAVITY


def fastest_turning_speed(plant: Plant, ay: float = 0.5) -> float:
    """Speed of the highest yaw gain [m/s]: vertex of the parabola through the best three."""
    speeds = np.arange(20.0, 33.0)
    gain = np.array([s.r / s.delta for s in (steady(plant, vx, ay) for vx in speeds)])
    best = int(np.clip(np.argmax(gain), 1, len(speeds) - 2))
    a, b, _ = np.polyfit(speeds[best - 1 : best + 2], gain[best - 1 : best + 2], 2)
    return float(-b / (2.0 * a))


def sideslip_free_speed(plant: Plant, ay: float = 1.0) -> float:
    """Speed at which the sideslip of the centre of mass changes its sign [m/s]."""
    speeds = np.arange(15.0, 32.0, 2.0)
    vy = [steady(plant, vx, ay).vy for vx in speeds]
    return float(np.interp(0.0, -np.array(vy), speeds))


def effective_stiffness(s: Steady, p: VehicleParams) -> tuple[float, float]:
    """Front and rear lateral force over slip angle of the single track [N/rad]."""
    share = p.m * s.ay / p.wheelbase
    front = s.delta - (s.vy + p.lf * s.r) / s.vx
    return share * p.lr / front, share * p.lf / -s.rear_slip(p.lr)


# --- verdicts ---


def _understeer(result: StudyResult, plant: Plant, car: CarUnderTest, linear: Linear) -> None:
    p = car.params
    why = "linear formula with the tires' own slopes and trail, as ay goes to 0; 3 % for roll"
    expected = deg_per_g(linear.understeer)
    rows = []
    ways = [("on 100 m", [(math.sqrt(ay * RADIUS), ay) for ay in SMALL])]
    ways += [(f"at {vx:g} m/s", [(vx, ay) for ay in SMALL]) for vx in SPEEDS]
    for name, points in ways:
        states = both_ways(plant, points)
        understeer = [s.understeer(p.wheelbase) for s in states]
        gradient = deg_per_g(slope_at_zero([s.ay for s in states], understeer))
        last = deg_per_g(understeer[-1] / states[-1].ay)
        result.find(f"understeer gradient {name}", gradient, "deg/g",
                    Limit.percent(expected, 3.0), why)  # fmt: skip
        rows.append((name, gradient, last, expected))
    header = ("method", "at 0 [deg/g]", "over 1 m/s2 [deg/g]", "formula [deg/g]")
    result.tables.append(Table("understeer", "Understeer gradient by method", header, rows))
    for vx in (10.0, 20.0, 30.0):
        s = steady(plant, vx, 1.0)
        gradient = deg_per_g(s.understeer(p.wheelbase) / s.ay)
        result.find(
            f"understeer over 1 m/s2, {vx:g} m/s", gradient, "deg/g", Limit.near(2.45, 0.25),
            TARGET, target=True,
        )  # fmt: skip


def _yaw_gain(result: StudyResult, plant: Plant, linear: Linear) -> Array:
    error = 0.0
    for vx in np.arange(5.0, 25.1, 2.5):
        for ay in (0.5, 1.0, 1.5, 2.0):
            s = steady(plant, float(vx), ay)
            error = max(error, abs(s.r / s.delta / linear.yaw_gain(s.vx) - 1.0))
    result.find(
        "yaw gain against formula, worst error", 100.0 * error, "%", Limit.at_most(3.0),
        "vx / (L + U vx^2) to 2 m/s2 and 25 m/s; 3 % since tires soften and load moves",
    )  # fmt: skip
    for vx, target in ((10.0, 3.09), (15.0, 3.96), (20.0, 4.39)):
        s = steady(plant, vx, 1.0)
        result.find(f"yaw gain at {vx:g} m/s", s.r / s.delta, "1/s", Limit.percent(target, 4.0),
                    TARGET, target=True)  # fmt: skip
    result.find("speed of the highest yaw gain", fastest_turning_speed(plant), "m/s",
                Limit.near(25.0, 1.5), TARGET, target=True)  # fmt: skip
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
    result.find(
        "rear slip gradient on 100 m", deg_per_g(gradient), "deg/g",
        Limit.percent(deg_per_g(linear.rear_slip), 3.0), "linear formula, as ay goes to 0",
    )  # fmt: skip
    roll = slope_at_zero(ay, [s.roll for s in small])
    result.find(
        "roll gradient on 100 m", deg_per_g(roll), "deg/g",
        Limit.percent(deg_per_g(linear.roll), 3.0),
        "m h / K_phi with springs, bars and tires in series, less gravity",
    )  # fmt: skip
    s = steady(plant, 20.0, 1.0)
    result.find(
        "rear slip gradient at 20 m/s", deg_per_g(s.rear_slip(p.lr) / s.ay), "deg/g",
        Limit.near(-1.7, 0.1), TARGET, target=True,
    )  # fmt: skip
    front, rear = effective_stiffness(s, p)
    result.find("effective front stiffness, 20 m/s", 1e-3 * front, "kN/rad",
                Limit.near(122.0, 6.0), TARGET, target=True)  # fmt: skip
    result.find("effective rear stiffness, 20 m/s", 1e-3 * rear, "kN/rad",
                Limit.near(229.0, 12.0), TARGET, target=True)  # fmt: skip
    result.find("sideslip changes its sign at", sideslip_free_speed(plant), "m/s",
                Limit.near(23.0, 1.0), TARGET, target=True)  # fmt: skip


def _limit(
    result: StudyResult, circle: list[Steady], limit: float, car: CarUnderTest
) -> None:
    p = car.params
    result.find(
        "largest lateral acceleration, 100 m", limit, "m/s2", Limit.percent(p.ay_limit, 1.0),
        "the documented limit, by which speed profiles are planned",
    )  # fmt: skip
    result.find(
        "largest lateral acceleration over mu g", limit / (p.mu * GRAVITY), "", Limit.at_most(1.0),
        "friction bounds it; load transfer and drive take some",
    )  # fmt: skip
    left = [s for s in circle if s.ay > 0.0]
    angle = np.array([s.understeer(p.wheelbase) for s in left])
    ay = np.array([s.ay for s in left])
    least = float((np.diff(angle) / np.diff(ay)).min())
    result.find(
        "least understeer gradient to the limit", deg_per_g(least), "deg/g", Limit.at_least(0.0),
        "a passenger car loses its front axle first",
    )  # fmt: skip
    asymmetry = max(
        max(abs(a.delta + b.delta), abs(a.roll + b.roll), abs(a.vy + b.vy))
        for a, b in zip(circle, reversed(circle), strict=True)
    )
    result.find(
        "left against right, worst difference", asymmetry, "rad, m/s", Limit.at_most(1e-9),
        "a symmetric car: the arithmetic itself is mirrored, 1e-9 leaves room for rounding",
    )  # fmt: skip
    rows = [
        (
            f"{s.vx:.1f}", s.ay, math.degrees(s.delta), math.degrees(math.atan2(s.vy, s.vx)),
            math.degrees(s.roll), *(f"{load:.0f}" for load in s.loads),
        )
        for s in (*left[1:-1:2], left[-1])
    ]  # fmt: skip
    header = (
        "vx [m/s]", "ay [m/s2]", "steer [deg]", "sideslip [deg]", "roll [deg]",
        "Fz fl [N]", "fr", "rl", "rr",
    )  # fmt: skip
    result.tables.append(Table("circle", "Left turns on 100 m", header, rows))


# --- pictures ---


@plots.styled
def _draw_handling(
    tests: dict[str, list[Steady]], car: CarUnderTest, linear: Linear, limit: float
) -> Any:
    figure, (left, right) = plots.axes(1, 2, height=2.9)
    L, U = linear.wheelbase, linear.understeer
    colours = (plots.BLUE, plots.ORANGE)
    for (name, points), colour in zip(tests.items(), colours, strict=True):
        for sign in (-1.0, 1.0):
            half = [s for s in points if s.ay * sign > 0.0]
            at = np.array([s.ay for s in half])
            first = sign > 0.0
            left.plot(at, [math.degrees(s.delta) for s in half], "o-", ms=2.2, color=colour,
                      label=name if first else None)  # fmt: skip
            geometry = L / RADIUS * sign if name == "100 m" else L * at / SPEED**2
            left.plot(at, np.degrees(geometry + U * at), color="black", lw=0.8, ls=(0, (4, 2)),
                      label="linear formula" if first and name == "100 m" else None)  # fmt: skip
            turn = "left" if first else "right"
            mark = {("100 m", "left"): "o", ("100 m", "right"): "s", ("100 km/h", "left"): "+",
                    ("100 km/h", "right"): "x"}[name, turn]  # fmt: skip
            right.plot(
                [sign * math.degrees(s.understeer(L)) for s in half], sign * at, mark, ms=4.5,
                mfc="none", mec=colour, mew=0.8, label=f"{name}, {turn}",
            )  # fmt: skip
    plots.label(left, "lateral acceleration, left positive [m/s²]", "steer [deg]", "Steer")
    left.legend(loc="upper left")
    ay = np.linspace(0.0, limit, 50)
    right.plot(np.degrees(U * ay), ay, color="black", lw=0.8, ls=(0, (4, 2)),
               label="linear formula")  # fmt: skip
    near = np.linspace(0.0, 2.0, 20)
    right.fill_betweenx(near, 2.2 * near / GRAVITY, 2.7 * near / GRAVITY, color=plots.RED,
                        alpha=0.35, lw=0.0, label="target, 2.45 ± 0.25 deg/g")  # fmt: skip
    plots.limit_line(right, car.params.ay_limit, "documented limit")
    right.set_xlim(left=0.0)
    right.set_ylim(0.0, 7.6)
    plots.label(right, "front less rear slip angle [deg]", "lateral acceleration [m/s²]",
                "Handling diagram")  # fmt: skip
    right.legend(loc="lower right")
    return figure


@plots.styled
def _draw_gains(gains: Array, circle: list[Steady], car: CarUnderTest, linear: Linear) -> Any:
    figure, (left, right) = plots.axes(1, 2, height=2.9)
    speeds, gain = gains
    v = np.linspace(1.0, 41.0, 100)
    line = linear.yaw_gain(v)
    left.plot(v, line, color="black", lw=0.8, ls=(0, (4, 2)), label="linear formula")
    inside = v <= 25.0
    plots.limit_band(left, v[inside], 0.97 * line[inside], 1.03 * line[inside], "3 % to 25 m/s")
    left.plot(speeds, gain, "o", ms=2.5, color=plots.BLUE, label="simulated")
    left.errorbar(
        [10.0, 15.0, 20.0], [3.09, 3.96, 4.39], yerr=[0.04 * g for g in (3.09, 3.96, 4.39)],
        fmt="none", ecolor=plots.RED, elinewidth=1.2, capsize=3.0, label="targets", zorder=4,
    )  # fmt: skip
    left.axvspan(23.5, 26.5, color=plots.GREEN, alpha=0.15, lw=0.0, label="target of the peak")
    plots.label(left, "speed [m/s]", "yaw gain r / steer [1/s]", "Yaw gain")
    left.set_ylim(0.0, 5.2)
    left.legend(loc="lower right")
    ay = np.array([s.ay for s in circle])
    for values, slope, colour, name in (
        ([s.rear_slip(car.params.lr) for s in circle], linear.rear_slip, plots.BLUE, "rear slip"),
        ([s.roll for s in circle], linear.roll, plots.GREEN, "roll"),
    ):
        right.plot(ay, np.degrees(values), "o-", ms=2.2, color=colour, label=name)
        right.plot(ay, np.degrees(slope * ay), color="black", lw=0.8, ls=(0, (4, 2)),
                   label="linear formula" if name == "roll" else None)  # fmt: skip
    plots.label(right, "lateral acceleration [m/s²]", "angle [deg]", "Rear sideslip and roll")
    right.legend()
    return figure
