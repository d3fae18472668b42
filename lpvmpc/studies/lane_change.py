"""Lane changes between cones: how fast the car can enter without touching one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.road import cones
from lpvmpc.road.cones import Course
from lpvmpc.road.path import Path
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.speed_profile import SpeedProfile
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.names import load_controller
from lpvmpc.studies.parts import gates
from lpvmpc.studies.parts.gates import FlatPath, Outline
from lpvmpc.studies.study import CarUnderTest, Picture, Series, StudyResult
from lpvmpc.units import GRAVITY, Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STIFFNESS = ("network", "constant")
"""Stiffness models of the LPV-MPC that are compared; the first one's result is judged."""
MARGIN = 0.1
"""Distance of the reference path's car from the lanes' edges [m]."""
SLOWEST, FASTEST = 10.0, 37.5
"""Entry speeds tried [m/s]; the fastest is that of the real car, 135 km/h."""
STRIDE, CLOSE = 3.0, 0.1
"""Steps of the search upwards, and the width to which it closes in [m/s]."""
STRETCH = 2.0
"""Scale of y over that of x in the view from above."""
SYMBOL = 0.22
"""Radius of a cone's symbol there, across the lanes [m]."""
CUSTOMARY = 80.0 / 3.6
"""Speed at which the double lane change is customarily driven [m/s]."""

METHOD = f"""\
**Tracks.** ISO 3888-1: lanes of 15, 25 and 30 m, gaps of 30 and 25 m, offset 3.5 m between the
lanes' middles. ISO 3888-2: lanes of 12, 11 and 12 m, gaps of 13.5 and 12.5 m, 1 m between the
lanes' edges. With the vehicle's width b = 1.73 m without mirrors the lanes are 1.1 b + 0.25,
1.2 b + 0.25 and 1.3 b + 0.25 m wide, in part 2 the second b + 1 and the third 3 m at least.
Dimensions are those of public implementations (Project Chrono, MathWorks), which read the offset of
part 1 in different ways. Cones stand at the ends of the lanes and at most
{cones.CONE_SPACING:g} m apart; their bases touch the lane's edge from outside.

**Driving.** The LPV-MPC follows the path with the least peak of curvature that keeps the car's
sides {MARGIN:g} m from the lanes' edges (a linear programme). Part 1: at the entry speed
throughout. Part 2 is driven coasting, as is customary: there the throttle is released 2 m behind
the first cones; here the car has neither drive nor brakes from {gates.LEAD:g} m before them on,
which costs the same speed a little earlier. *Entry speed*: where the centre of mass passes the
first cones. A cone is touched when the car's rectangle comes over the point where its base touches
the lane's edge; poses between control instants are interpolated. The highest entry speed is found
in steps of {STRIDE:g} m/s up to the first touch and by bisection to {CLOSE:g} m/s.

**Bounds.** On a path of curvature `kappa` a car that does not slide sideways needs `v^2 kappa`.
*Upper bound*: the flattest path that touches all cones, at the documented peak friction. *Lower
limit* of part 2: three quarters of the steady limit on the path that is followed.

**Valid** for this driver and for the documented friction: another driver may find a faster
line.
"""


@dataclass(frozen=True)
class Passage:
    """One drive through the lanes."""

    entry: float
    """Speed at the first cones [m/s]."""
    clearance: float
    """Distance to the closest cone [m]; negative where one was touched."""
    completed: bool
    """Whether the car came to the end."""
    t: Array
    """Fine instants [s], shape (n,)."""
    poses: Array
    """x along the lanes, y [m], psi [rad] of the centre of mass, shape (n, 3)."""
    ay: float
    """Largest lateral acceleration [m/s2]."""
    sideslip: float
    """Largest sideslip angle [rad]."""
    steer_rate: float
    """Largest rate of the road wheel angle [rad/s]."""
    leaving: float
    """Speed at the end [m/s]."""

    @property
    def clean(self) -> bool:
        """Whether no cone was touched and the car came to the end."""
        return self.completed and self.clearance > 0.0


def run(car: CarUnderTest) -> StudyResult:
    """Both tracks with both stiffness models."""
    result = StudyResult("lane-change", METHOD)
    p, outline = car.params, car_outline(car)
    courses = cones.double_lane_change(p.width), cones.obstacle_avoidance(p.width)
    drives: dict[tuple[str, str], list[Passage]] = {}
    best: dict[tuple[str, str], Passage | None] = {}
    paths = {}
    for course in courses:
        followed = gates.flattest_path(course, outline, MARGIN)
        paths[course.name] = followed
        bound = math.sqrt(
            p.mu * GRAVITY / gates.flattest_path(course, outline, 0.0, 0.0).curvature
        )
        for stiffness in STIFFNESS:
            passages = _search(car, course, followed, outline, stiffness)
            drives[course.name, stiffness] = passages
            best[course.name, stiffness] = _best(passages)
        _judge(p, course, followed, bound, best, result)
    peak = max(one.ay for passages in drives.values() for one in passages if one.clean)
    result.find(
        "peak lateral acceleration", peak, "m/s2", Limit.at_most(p.mu * GRAVITY),
        "documented peak friction at nominal load, which load transfer only lowers",
    )
    result.tables.append(_table(best))
    for (name, stiffness), passages in drives.items():
        columns = {
            "entry_mps": [one.entry for one in passages],
            "clearance_m": [one.clearance for one in passages],
            "ay_peak_mps2": [one.ay for one in passages],
        }
        result.series.append(Series(f"{_short(name)}-{stiffness}", columns))
    result.pictures += [
        Picture(
            "top-view",
            "The fastest clean drives from above, adaptive LPV-MPC, the outline of the car every "
            f"half second; y is stretched {STRETCH:g} times.",
            _top_view(courses, paths, best, outline),
        ),
        Picture(
            "clearance",
            "Distance to the closest cone over the entry speed, with the limits; below zero a cone "
            "is touched (-300 mm stands for more).",
            _clearance_picture(courses, drives, result),
        ),
    ]
    return result


def car_outline(car: CarUnderTest) -> Outline:
    """Outline of the car around its centre of mass, from the collision box of its body."""
    box = car.model.geom("lower_body")
    half_length, middle = float(box.size[0]), float(box.pos[0])
    return Outline(middle + half_length, half_length - middle, car.params.width / 2.0)


def highest(clean: Callable[[float], bool]) -> float:
    """Highest speed below the first failure: upwards in strides, then bisection [m/s].

    Args:
        clean: Whether a drive at a speed [m/s] touches nothing.

    Returns:
        To CLOSE; 0 if even the slowest fails, FASTEST if all pass.
    """
    passed, speed = 0.0, SLOWEST
    while clean(speed):
        passed = speed
        if speed == FASTEST:
            return passed
        speed = min(speed + STRIDE, FASTEST)
    failed = speed
    while passed > 0.0 and failed - passed > CLOSE:
        middle = 0.5 * (passed + failed)
        passed, failed = (middle, failed) if clean(middle) else (passed, middle)
    return passed


def coast_down(p: VehicleParams, vx: float, path: Path) -> Array:
    """Speed of a car that rolls along a path against drag and rolling resistance [m/s].

    Args:
        p: Parameters of the car.
        vx: Speed at the start [m/s].
        path: Gives the points, shape (n,).
    """
    # v dv/ds = -(f0 + f2 v^2)/m: v^2 decays exponentially towards -f0/f2
    f0, f2 = p.c_roll * GRAVITY, 0.5 * p.rho_air * p.CdA / p.m
    squared = (vx**2 + f0 / f2) * np.exp(-2.0 * f2 * path.s) - f0 / f2
    speed: Array = np.sqrt(np.maximum(squared, 1.0))
    return speed


def _search(
    car: CarUnderTest, course: Course, flat: FlatPath, outline: Outline, stiffness: str
) -> list[Passage]:
    """All drives of the search for the highest entry speed, slowest first."""
    passages: list[Passage] = []

    def clean(speed: float) -> bool:
        passages.append(_drive(car, course, flat, outline, stiffness, speed))
        return passages[-1].clean

    highest(clean)
    return sorted(passages, key=lambda one: one.entry)


def _drive(
    car: CarUnderTest, course: Course, flat: FlatPath, outline: Outline, stiffness: str,
    speed: float,
) -> Passage:
    """Drive through a course, starting at a speed [m/s]."""
    p, path = car.params, flat.path()
    profile = SpeedProfile.constant(speed, path)
    driver = p
    if course.coasting:
        profile = SpeedProfile(coast_down(p, speed, path), path.length)
        driver = replace(p, F_drive_max=1.0, F_brake_max=1.0)  # 1 N: as good as none
    scenario = Scenario(name="lane-change", path=path, speed=profile)
    controller = load_controller("lpv-mpc", stiffness=stiffness, car=driver)
    log = simulate(car.plant(), controller, scenario)
    c = log.columns
    t = np.linspace(c["t_s"][0], c["t_s"][-1], 20 * len(c["t_s"]))  # 3 cm at 20 m/s
    poses = np.stack([np.interp(t, c["t_s"], c[name]) for name in ("x_m", "y_m", "psi_rad")], 1)
    poses[:, 0] -= gates.LEAD
    completed = bool(log.meta["completed"])
    return Passage(
        entry=float(np.interp(gates.LEAD, c["x_m"], c["vx_mps"])),
        clearance=float(gates.clearance(outline, course.cones, poses).min()),
        completed=completed,
        t=t,
        poses=poses,
        ay=float(np.abs(c["ay_mps2"]).max()),
        sideslip=float(np.abs(np.arctan2(c["vy_mps"], c["vx_mps"])).max()),
        steer_rate=float(np.abs(np.diff(c["delta_rad"])).max() / log.meta["Ts"]),
        leaving=float(c["vx_mps"][-1]),
    )


def _best(passages: list[Passage]) -> Passage | None:
    """The fastest drive without a touch, None if there is none."""
    return max((one for one in passages if one.clean), key=lambda one: one.entry, default=None)


def _judge(
    p: VehicleParams, course: Course, followed: FlatPath, bound: float,
    best: dict[tuple[str, str], Passage | None], result: StudyResult,
) -> None:
    """Compare the highest entry speed of the adaptive controller with its bounds."""
    name = course.name.split(",")[0]
    fastest = best[course.name, STIFFNESS[0]]
    entry = 3.6 * fastest.entry if fastest else 0.0
    if course.coasting:
        low = 3.6 * math.sqrt(0.75 * p.ay_limit / followed.curvature)
        why = "three quarters of the steady limit in the sharpest bend of the path it follows"
    else:
        low, why = 3.6 * CUSTOMARY, "the speed at which the track is customarily driven"
    result.find(f"{name}, entry speed at least", entry, "km/h", Limit.at_least(low), why)
    result.find(
        f"{name}, entry speed at most", entry, "km/h", Limit.at_most(3.6 * bound),
        "peak friction on the flattest path that the cones allow a car that points along it",
    )


def _short(name: str) -> str:
    """Name of a track for files: iso-3888-1."""
    return name.split(",")[0].lower().replace(" ", "-")


def _table(best: dict[tuple[str, str], Passage | None]) -> Table:
    header = ("track, stiffness model", "entry km/h", "leaves km/h", "closest cone mm",
              "ay peak m/s2", "sideslip deg", "steer rate deg/s")
    rows: list[tuple[object, ...]] = []
    for (name, stiffness), one in best.items():
        what = f"{name.split(',')[0]}, {stiffness}"
        if one is None:
            rows.append((what, "none", *[""] * 5))
            continue
        rows.append(
            (
                what,
                3.6 * one.entry,
                3.6 * one.leaving,
                1e3 * one.clearance,
                one.ay,
                math.degrees(one.sideslip),
                math.degrees(one.steer_rate),
            )
        )
    return Table("fastest", "Highest entry speed without touching a cone", header, rows)


# --- pictures ---


@style.styled
def _top_view(
    courses: tuple[Course, ...], paths: dict[str, FlatPath],
    best: dict[tuple[str, str], Passage | None], outline: Outline,
) -> Figure:
    figure, axes = style.axes(len(courses), 1, height=2.7, sharex=True)
    for axis, course in zip(axes, courses, strict=True):
        for lane in course.lanes:
            low = lane.middle - lane.width / 2.0
            axis.fill_between([lane.start, lane.end], low, low + lane.width, color="#EEEEEE", lw=0)
        x, y, side = course.cones.T
        y = y + side * SYMBOL  # the base touches the lane's edge from outside
        axis.plot(x, y, "o", ms=3.0, color=style.RED, lw=0, label="cones")
        flat = paths[course.name]
        axis.plot(flat.x, flat.y, color="black", lw=0.8, ls=(0, (3, 2)), label="reference path",
                  zorder=4)
        one = best[course.name, STIFFNESS[0]]
        title = course.name
        if one is not None:
            title += f": entered at {3.6 * one.entry:.0f} km/h"
            x, y, _ = one.poses.T
            axis.plot(x, y, color=style.SKY, lw=2.0, label="centre of mass")
            for t in np.arange(one.t[0], one.t[-1], 0.5):
                _draw_car(axis, one.poses[np.searchsorted(one.t, t)], outline)
        style.label(axis, "", "y [m]", title)
        axis.set_aspect(STRETCH)
        axis.grid(False)
        axis.set_xlim(-12.0, 135.0)
        axis.set_ylim(-2.2, 5.8)
    axes[-1].set_xlabel("distance from the first cones [m]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _draw_car(axis: Axes, pose: Array, outline: Outline) -> None:
    """Outline of the car at x, y, psi."""
    front, rear, half = outline.front, outline.rear, outline.half_width
    corners = [(front, half), (front, -half), (-rear, -half), (-rear, half), (front, half)]
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    turned = np.array(corners) @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    axis.plot(*turned.T, color=style.BLUE, lw=0.6)


@style.styled
def _clearance_picture(
    courses: tuple[Course, ...], drives: dict[tuple[str, str], list[Passage]], result: StudyResult
) -> Figure:
    figure, axes = style.axes(1, len(courses), height=2.5, sharey=True)
    for axis, course in zip(axes, courses, strict=True):
        for stiffness, color in zip(STIFFNESS, (style.BLUE, style.ORANGE), strict=True):
            passages = drives[course.name, stiffness]
            speeds = [3.6 * one.entry for one in passages]
            gaps = [1e3 * max(one.clearance, -0.3) for one in passages]
            axis.plot(speeds, gaps, "o-", ms=3, color=color, label=f"LPV-MPC, {stiffness}")
        axis.axhline(0.0, color="black", lw=0.8, ls=":", label="touch")
        for finding in result.findings:
            if finding.figure.startswith(course.name.split(",")[0]):
                for bound in (finding.limit.low, finding.limit.high):
                    if math.isfinite(bound):
                        axis.axvline(bound, color=style.RED, lw=0.9, ls=(0, (4, 2)))
        style.label(axis, "entry speed [km/h]", "", course.name)
    axes[0].set_ylabel("closest cone [mm]")
    axes[0].plot([], [], color=style.RED, lw=0.9, ls=(0, (4, 2)), label="limits")
    axes[0].legend(loc="lower left")
    return figure
