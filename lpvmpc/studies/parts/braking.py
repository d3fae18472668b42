"""Braking to standstill: stops, and what friction and brake balance let one expect."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.parts.rollover import Springs
from lpvmpc.studies.parts.transfer import longitudinal_transfer
from lpvmpc.studies.study import CarUnderTest, Picture, Series, StudyResult
from lpvmpc.units import GRAVITY, Array

KMH = 1.0 / 3.6
"""One km/h [m/s]."""
V0 = 100.0 * KMH
"""Speed from which the car brakes [m/s]."""
SLOW = 5.0
"""Speed at which wheels lock most easily [m/s]: hardly any drag helps."""


@dataclass(frozen=True)
class Stop:
    """Braking from V0 to standstill."""

    speed: Array
    """[m/s], shape (n,)."""
    distance: Array
    """Since the brakes were touched [m], shape (n,)."""
    locked: bool
    """Whether a wheel locked above the speed SLOW."""
    turn: float
    """Largest change of heading [rad]."""

    @property
    def mfdd(self) -> float:
        """Mean fully developed deceleration [m/s2]: (v_b^2 - v_e^2) / (2 (s_e - s_b))."""
        begin, end = 0.8 * V0, 0.1 * V0
        places = np.interp([-begin, -end], -self.speed, self.distance)
        return float((begin**2 - end**2) / (2.0 * (places[1] - places[0])))


def stop(plant: Plant, command: float, ramp: float = 1.0) -> Stop:
    """Brake from V0.

    Args:
        plant: plant.
        command: deceleration commanded at the end of the ramp [m/s2], positive.
        ramp: time over which it rises [s].
    """
    state = plant.reset(vx=V0)
    begin = state.x
    speeds, places, slip, turn = [state.vx], [0.0], 0.0, 0.0
    while state.vx > 0.2 and len(speeds) * plant.Ts < 60.0:
        state = plant.step(Command(0.0, -command * min(len(speeds) * plant.Ts / ramp, 1.0)))
        speeds.append(state.vx)
        places.append(state.x - begin)
        turn = max(turn, abs(state.psi))
        if state.vx > SLOW:
            slip = min(slip, float(plant.wheels.slip_ratio.min()))
    return Stop(np.array(speeds), np.array(places), slip < -0.5, turn)


def locking_command(car: CarUnderTest, axle: int) -> tuple[float, float]:
    """Command at which an axle locks at the speed SLOW while no other does, and the deceleration.

    Its tires: share of the brake torque plus rolling resistance, less what stops their spin; their
    load: the static one and `longitudinal_transfer`; their limit: peak friction at that load.

    Args:
        car: Car under test.
        axle: 0 in front, 1 behind.

    Returns:
        Command and deceleration [m/s2], both positive.
    """
    p, springs = car.params, Springs.of(car.documented)
    drag = 0.5 * p.rho_air * p.CdA * SLOW**2
    share = (p.brake_front, 1.0 - p.brake_front)[axle]
    low, high = 0.0, 40.0
    for _ in range(60):
        command = 0.5 * (low + high)
        a = command + (p.c_roll * p.m * GRAVITY + drag) / p.m_eff
        moved = longitudinal_transfer(p, springs, drag - p.m * a, -4.0 * a / p.R_w)
        Fz = max(p.m * GRAVITY * (p.lr, p.lf)[axle] / p.wheelbase + (moved, -moved)[axle], 0.0)
        Fx = share * p.m_eff * command + p.c_roll * Fz - 2.0 * p.J_w / p.R_w**2 * a
        limit = mf.peak_friction(car.coefficients[axle], 0.5 * Fz)[0] * Fz
        low, high = (command, high) if Fx < limit else (low, command)
    return command, a


def sliding_deceleration(car: CarUnderTest) -> float:
    """Deceleration on four locked wheels, without drag [m/s2]."""
    p = car.params
    a = 0.7 * GRAVITY
    for _ in range(50):
        front = (p.m * GRAVITY * p.lr + p.m * a * p.h) / p.wheelbase
        forces = [
            2.0 * mf.forces(c, -1.0, 0.0, 0.5 * load, 1.0)[0]
            for c, load in zip(car.coefficients, (front, p.m * GRAVITY - front), strict=True)
        ]
        a = -sum(forces) / p.m
    return a


def judge(result: StudyResult, car: CarUnderTest) -> None:
    """Find the command that locks an axle, and compare stops with the closed forms."""
    p = car.params
    plant = car.plant(Ts=0.01)
    locks = [locking_command(car, axle) for axle in (0, 1)]
    expected, best = min(locks)
    axle = ("front", "rear")[locks.index((expected, best))]
    low, high = 0.5 * expected, 1.5 * expected
    while high - low > 0.005 * expected:
        command = 0.5 * (low + high)
        low, high = (low, command) if stop(plant, command).locked else (command, high)
    result.find(
        f"brake command that locks the {axle}", high, "m/s2", Limit.percent(expected, 3.0),
        "load, friction and brake balance at 5 m/s; 3 % for pitching",
    )
    hard, able = max(14.0, 1.5 * max(locks)[0]), plant
    if -p.ax_min < 1.2 * max(locks)[0]:
        able = car.plant(Ts=0.01)
        able.model.numeric("powertrain").data[3] = hard * p.m_eff * p.R_w
    stops = {"just not locked": stop(plant, low), "all wheels locked": stop(able, hard)}
    slide, optimum = stops["all wheels locked"], stops["just not locked"]
    # The mean of drag over distance between 0.8 and 0.1 of the speed: half the sum of squares.
    drag = 0.5 * p.rho_air * p.CdA * V0**2 * 0.5 * (0.8**2 + 0.1**2)
    result.find(
        "MFDD just not locked", optimum.mfdd, "m/s2",
        Limit.percent(low * best / expected + drag / p.m_eff, 2.0),
        "command plus resistances; 2 % for pitching",
    )
    result.find(
        "MFDD, all wheels locked", slide.mfdd, "m/s2",
        Limit.percent(sliding_deceleration(car) + drag / p.m, 2.0),
        "Magic Formula at a slip ratio of -1 and the load transferred; 2 % for pitching",
    )
    grip = p.mu * GRAVITY
    result.find(
        "best MFDD over mu g", optimum.mfdd / grip, "", Limit.at_most(1.0),
        "friction bounds it",
    )
    result.find(
        "turn while braking, worst", math.degrees(max(s.turn for s in stops.values())), "deg",
        Limit.at_most(1e-3), "a symmetric car brakes straight",
    )
    rows: list[tuple[object, ...]] = [
        (name, float(s.distance[-1]), s.mfdd, s.mfdd / grip) for name, s in stops.items()
    ]
    ideal = V0**2 / (2.0 * grip)
    rows.append(("mu g from the first instant", ideal, grip, 1.0))
    header = ("braking from 100 km/h", "distance [m]", "MFDD [m/s2]", "over mu g")
    result.tables.append(Table("braking", "Braking distance (no verdict)", header, rows))
    commands = np.linspace(2.0, 14.0, 25)
    sweep = np.array([stop(plant, a).mfdd for a in commands])
    result.series.append(Series("braking", {"command_mps2": commands, "mfdd_mps2": sweep}))
    result.pictures.append(
        Picture(
            "braking",
            "Braking from 100 km/h. Left: speed over distance. Right: mean fully developed "
            "deceleration over the commanded one; beyond the line an axle locks.",
            draw_stops(stops, commands, sweep, expected, axle, car),
        )
    )


@style.styled
def draw_stops(
    stops: dict[str, Stop], commands: Array, sweep: Array, expected: float, axle: str,
    car: CarUnderTest,
) -> Any:
    """Speed over distance, and the deceleration reached over the commanded one."""
    grip = car.params.mu * GRAVITY
    figure, (left, right) = style.axes(1, 2, height=2.6)
    for (name, s), colour in zip(stops.items(), (style.BLUE, style.ORANGE), strict=True):
        left.plot(s.distance, s.speed / KMH, color=colour, label=name)
    way = np.linspace(0.0, V0**2 / (2.0 * grip), 100)
    left.plot(way, np.sqrt(np.maximum(V0**2 - 2.0 * grip * way, 0.0)) / KMH, color=style.RED,
              lw=0.9, ls=(0, (4, 2)), label="mu g")
    style.label(left, "distance [m]", "speed [km/h]", "Braking from 100 km/h, ramp of 1 s")
    left.set_ylim(0.0, 105.0)
    left.legend(loc="lower left")
    right.plot(commands, sweep, "o-", ms=2.5, color=style.BLUE, label="simulated")
    style.limit_line(right, grip, "mu g")
    right.axvline(expected, color="black", lw=0.9, ls=(0, (1, 1.5)),
                  label=f"{axle} locks, computed")
    right.axhline(
        sliding_deceleration(car), color=style.ORANGE, lw=0.9, ls=(0, (4, 2)),
        label="all sliding, computed",
    )
    right.set_ylim(0.0, max(9.0, 1.05 * float(sweep.max())))
    style.label(right, "commanded deceleration [m/s²]", "MFDD [m/s²]", "Use of friction")
    right.legend(loc="lower right")
    return figure
