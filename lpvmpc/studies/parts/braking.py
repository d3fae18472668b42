"""Braking to standstill: stops, and what friction and brake balance let one expect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.interface import Command
from lpvmpc.picture import style
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.study import CarUnderTest
from lpvmpc.units import GRAVITY, Array

KMH = 1.0 / 3.6
"""One km/h [m/s]."""
V0 = 100.0 * KMH
"""Speed from which the car brakes [m/s]."""
SLOW = 5.0
"""Speed at which the front wheels lock most easily [m/s]: hardly any drag helps."""


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


def locking_command(car: CarUnderTest) -> tuple[float, float]:
    """Command at which the front wheels lock at the speed SLOW, and the deceleration then.

    Front tires: share of the brake torque plus rolling resistance, less what stops their spin;
    their load: m g lr / L + m a h / L; their limit: peak friction at that load.

    Returns:
        Command and deceleration [m/s2], both positive.
    """
    p = car.params
    drag = 0.5 * p.rho_air * p.CdA * SLOW**2
    low, high = 0.0, 20.0
    for _ in range(60):
        command = 0.5 * (low + high)
        a = command + (p.c_roll * p.m * GRAVITY + drag) / p.m_eff
        Fz = (p.m * GRAVITY * p.lr + p.m * a * p.h) / p.wheelbase
        Fx = p.brake_front * p.m_eff * command + p.c_roll * Fz - 2.0 * p.J_w / p.R_w**2 * a
        limit = mf.peak_friction(car.coefficients[0], 0.5 * Fz)[0] * Fz
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


@style.styled
def draw_stops(
    stops: dict[str, Stop], commands: Array, sweep: Array, expected: float, car: CarUnderTest
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
    right.axvline(expected, color="black", lw=0.9, ls=(0, (1, 1.5)), label="front locks, computed")
    right.axhline(
        sliding_deceleration(car), color=style.ORANGE, lw=0.9, ls=(0, (4, 2)),
        label="all sliding, computed",
    )
    right.set_ylim(0.0, 9.0)
    style.label(right, "commanded deceleration [m/s²]", "MFDD [m/s²]", "Use of friction")
    right.legend(loc="lower right")
    return figure
