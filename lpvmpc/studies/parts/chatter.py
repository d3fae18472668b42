"""Chatter: from which time step on the wheels shake, and the closed form of that."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.params import VehicleParams
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.rollout import DRIVE, SPIN_QVEL, Snapshot
from lpvmpc.studies.study import CarUnderTest, Picture, StudyResult
from lpvmpc.units import GRAVITY, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT = 0.001
"""The model's own time step [s]."""
LARGEST = 0.002
"""Largest time step that `Plant` accepts [s]."""
CRAWL = (0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0)
"""Speeds at which the onset of chatter is sought [m/s]."""
CHATTER = 1.0
"""Wheel acceleration that alternates from step to step and counts as chatter [m/s2]."""


def spin_growth(p: VehicleParams, c: Array, low_speed: Array, vx: float, h: float) -> float:
    """Largest growth per step of one front wheel's slip against a quarter of the car.

    u+ = phi u - h phi1 V,  V+ = V + h (1/m_q + R^2/J)(K/sigma u+ - d V): deflection u, slip speed
    V, slip stiffness K, relaxation length sigma, phi = exp(-vx h/sigma), low-speed damping d.

    Args:
        p: Parameters of the car.
        c: Coefficients of the front tires.
        low_speed: Speed [m/s] below which the tire is damped, damping at standstill [N s/m], ...
        vx: Speed [m/s].
        h: Time step [s].

    Returns:
        Spectral radius; above 1 the slip alternates and grows.
    """
    Fz = p.m * GRAVITY * p.lr / (2.0 * p.wheelbase)
    sigma = mf.relaxation_lengths(c, Fz)[0]
    stiffness = mf.slip_stiffness(c, Fz) / sigma
    mobility = p.R_w**2 / p.J_w + 4.0 / p.m
    damping = low_speed[1] * max(1.0 - vx / low_speed[0], 0.0) ** 2
    x = vx * h / sigma
    kept, mean = math.exp(-x), -math.expm1(-x) / x if x > 1e-12 else 1.0
    push = h * mobility
    step = np.array(
        [
            [kept, -h * mean],
            [push * stiffness * kept, 1.0 - push * (stiffness * h * mean + damping)],
        ]
    )
    return float(np.abs(np.linalg.eigvals(step)).max())


def onset(
    measure: Callable[[float], float], threshold: float, low: float, high: float, close: float
) -> float:
    """Time step at which a measure rises above its threshold [s]; inf if not at `high`.

    Args:
        measure: What to watch, as a function of the time step [s].
        threshold: Above it is chatter.
        low: A time step that does not chatter.
        high: The largest one tried.
        close: How close to come, as a ratio above 1.
    """
    if measure(high) <= threshold:
        return math.inf
    while high > close * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if measure(middle) > threshold else (middle, high)
    return math.sqrt(low * high)


def alternating(wheel_speeds: Array, radius: float, h: float) -> float:
    """What alternates from step to step in the accelerations of the wheels [m/s2].

    Half the root mean square difference of successive accelerations, largest wheel.

    Args:
        wheel_speeds: Shape (n, 4) [rad/s], one row a step.
        radius: Of the wheels [m].
        h: Time step [s].
    """
    jumps = 0.5 * np.diff(wheel_speeds, n=2, axis=0) * radius / h
    return float(np.sqrt(np.mean(jumps**2, axis=0)).max())


def crawl(car: CarUnderTest, start: Snapshot, h: float) -> float:
    """`alternating` in the second half of a second with a step of 0.05 m/s2 in the drive."""
    plant = car.plant(Ts=DEFAULT)
    plant.restore(start)
    plant.model.opt.timestep = h  # above what Plant allows
    d = plant.data
    d.ctrl[DRIVE] += 0.05
    speeds = np.empty((round(1.0 / h), 4))
    for k in range(len(speeds)):
        mujoco.mj_step(plant.model, d)
        speeds[k] = d.qvel[list(SPIN_QVEL)]
    found = alternating(speeds[len(speeds) // 2 :], car.params.R_w, h)
    return found if math.isfinite(found) else math.inf


def stop(car: CarUnderTest, h: float) -> float:
    """`alternating` in the second after a stop with 4 m/s2 from 5 m/s."""
    plant = car.plant(Ts=h, timestep=h)
    plant.reset(vx=5.0)
    speeds = []
    for k in range(round(4.0 / h)):
        state = plant.step(Command(0.0, -4.0))
        if k * h > 3.0:
            speeds.append(state.wheel_speed)
    return alternating(np.array(speeds), car.params.R_w, h)


def judge(car: CarUnderTest, result: StudyResult) -> None:
    """Seek the onset at all speeds and compare it with the closed form."""
    p, c = car.params, car.coefficients[0]
    low_speed = np.array(car.documented.numeric("low_speed").data)
    starter = car.plant(Ts=DEFAULT)
    onsets, forms = [], []
    for vx in CRAWL:
        starter.reset(vx=vx)
        start = starter.save()
        form = onset(partial(spin_growth, p, c, low_speed, vx), 1.0, 1e-4, 0.05, 1.0001)
        highest = 0.02 if form < 0.017 else 1.3 * min(form, 0.05)
        onsets.append(onset(partial(crawl, car, start), CHATTER, DEFAULT, highest, 1.01))
        forms.append(form)
    off = np.array(onsets) / forms - 1.0
    result.find(
        "onset of chatter off the closed form", 100.0 * float(np.abs(off).max()), "%",
        Limit.at_most(10.0), "one wheel and a quarter of the car, which does not pitch or heave",
    )
    result.find(
        "smallest step that chatters", 1e3 * min(onsets), "ms", Limit.at_least(1e3 * LARGEST),
        "the largest step that Plant accepts",
    )
    stops = {h: stop(car, h) for h in (DEFAULT, LARGEST)}
    result.find(
        "chatter after a stop, 1 and 2 ms", max(stops.values()), "m/s2", Limit.at_most(0.01),
        "a thousandth of g: a standing car stands",
    )
    header = ("speed m/s", "onset ms", "closed form ms", "off %")
    rows = [
        (f"{vx:g}", 1e3 * onset, 1e3 * form, 100.0 * (onset / form - 1.0))
        for vx, onset, form in zip(CRAWL, onsets, forms, strict=True)
    ]
    result.tables.append(Table("chatter", "Time step at which chatter starts", header, rows))
    result.pictures.append(
        Picture(
            "chatter",
            "Time step at which the wheels begin to chatter, over the speed: simulation (dots), "
            "closed form, the model's step and the largest that is accepted.",
            _picture(p, c, low_speed, np.array(onsets)),
        )
    )


@style.styled
def _picture(p: VehicleParams, c: Array, low_speed: Array, onsets: Array) -> Figure:
    figure, axis = style.axes(width=style.COLUMN, height=2.6)
    speeds = np.geomspace(0.1, 15.0, 60)
    form = [
        onset(partial(spin_growth, p, c, low_speed, vx), 1.0, 1e-4, 0.05, 1.001) for vx in speeds
    ]
    axis.loglog(speeds, 1e3 * np.array(form), color="black", lw=0.8, label="closed form")
    axis.loglog(CRAWL, 1e3 * onsets, "o", ms=3.5, color=style.BLUE, label="simulation")
    style.limit_line(axis, 1e3 * LARGEST, "largest accepted step")
    axis.axhline(1e3 * DEFAULT, color=style.GREEN, lw=0.9, label="the model's step")
    ticks, times = (0.1, 0.3, 1, 3, 10), (0.5, 1, 2, 5, 10, 20)
    axis.set_xticks(ticks, [f"{x:g}" for x in ticks])
    axis.set_yticks(times, [f"{x:g}" for x in times])
    axis.minorticks_off()
    axis.set_ylim(0.5, 30.0)
    style.label(axis, "speed [m/s]", "time step [ms]", "Onset of chatter")
    axis.legend(loc="lower right")
    return figure
