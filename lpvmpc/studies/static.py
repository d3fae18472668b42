"""The standing car: mass, inertia, loads, rest on flat and sloping roads, suspension modes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpvmpc.car.current import current
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.reference import suspension
from lpvmpc.studies.study import CarUnderTest, Picture, Series, StudyResult, relative_error
from lpvmpc.units import GRAVITY, Array

METHOD = """\
- Mass and yaw inertia are measured, not read: the car floats without gravity, is pushed by 1 kN
  and turned by 1 kN m, and answers with the motion of its centre of mass and its yaw rate.
- The place of the centre of mass follows from the wheel loads on the flat, its height from the
  loads uphill (as on a tilting platform, after ISO 10392), less what the car's pitching moves.
- Slopes of 10 % are made by turning gravity; the brakes hold, commanded 3 m/s2. Drift is counted
  after 3 s of settling. Across the slope the body leans by m g h sin / K_phi, which moves the
  centre of mass and adds to the load transfer m g sin h / t.
- Suspension: each coordinate of the standing car (heave, roll, pitch, four wheels) is displaced by
  0.1 mm or 0.1 mrad on a road without grip; a linear map from step to step, fitted to the free
  motion alone, has the poles. They are compared with a linear model of seven degrees of freedom
  written out in `studies/suspension.py`; f = |p| / 2 pi is the undamped frequency.
- Valid for small motion; bump stops (90 mm) and lifting wheels are not reached.
"""

TABLE_2 = {"m": 1575.0, "Iz": 2875.0, "lf": 1.2, "lr": 1.6}
"""Mass [kg], yaw inertia [kg m2] and distances [m] in the paper's Table 2."""
SOURCE, OWN = "Table 2 of the paper", "the car's own file"
GRADE = 0.1
"""Slope of the road [-]."""
BRAKE = Command(0.0, -3.0)
DIRECTIONS = {"uphill": (-1.0, 0.0), "downhill": (1.0, 0.0), "across": (0.0, -1.0)}
"""Where gravity pulls on a slope, in the car's axes; across: to the right."""
MODES = ("heave", "pitch", "roll")


@dataclass(frozen=True)
class Standing:
    """A car left alone on its brakes."""

    time: Array
    """Time since it settled [s], shape (n,)."""
    drift: Array
    """Distance from where it was then [m], shape (n,)."""
    turn: float
    """Change of heading [rad]."""
    loads: Array
    """Wheel loads at the end [N], shape (4,)."""


def run(car: CarUnderTest) -> StudyResult:
    """Study the standing car."""
    result = StudyResult("static", METHOD)
    _inertia(result, car)
    _loads(result, car)
    rests = _slopes(result, car)
    modes = _suspension(result, car)
    result.pictures += [
        Picture(
            "rest",
            "Left: drift of the car on its brakes. Right: wheel loads on the flat and on slopes of "
            "10 %, bars as simulated, lines as computed.",
            _draw_rest(rests, car),
        ),
        Picture(
            "modes",
            "Left: poles of the suspension, identified from the plant at its physics step of 1 ms "
            "and at 0.1 ms, and computed. Right: free motion of the body lifted by 1 mm and of a "
            "front wheel pressed by 1 mm, plant at 1 ms and linear model.",
            _draw_modes(modes, car),
        ),
    ]
    drifts = {f"drift_{name}_m": stand.drift for name, stand in rests.items()}
    result.series.append(Series("rest", {"t_s": rests["flat"].time, **drifts}))
    return result


# --- what is measured ---


def floating(car: CarUnderTest, force: float, torque: float) -> tuple[float, float]:
    """Speed [m/s] and yaw rate [rad/s] of the floating car after a push and a turn of 0.1 s.

    Args:
        car: car under test.
        force: forward [N], at the centre of mass of the chassis.
        torque: about the vertical axis [N m].
    """
    plant = car.plant(Ts=0.1)
    plant.reset(trim=False)
    plant.model.opt.gravity[:] = 0.0
    plant.data.qpos[2] += 5.0  # off the road
    body = plant.model.body("chassis").id
    plant.data.xfrc_applied[body] = force, 0.0, 0.0, 0.0, 0.0, torque
    state = plant.step(Command(0.0, 0.0))
    return state.vx, state.r


def on_slope(plant: Plant, direction: tuple[float, float], grade: float = GRADE) -> Plant:
    """Put a plant on a slope, by turning gravity.

    Args:
        plant: changed in place.
        direction: of the pull, in the world.
        grade: rise over run [-].
    """
    angle = math.atan(grade)
    down = GRAVITY * math.sin(angle)
    plant.model.opt.gravity[:] = (
        down * direction[0], down * direction[1], -GRAVITY * math.cos(angle)
    )
    return plant


def drive(plant: Plant, seconds: float, command: Command = BRAKE) -> Any:
    """Hold a command; returns the last state."""
    state = plant.state
    for _ in range(round(seconds / plant.Ts)):
        state = plant.step(command)
    return state


def rest(plant: Plant, command: Command, seconds: float = 20.0) -> Standing:
    """Let a car stand: 3 s to settle, then `seconds` that count."""
    plant.reset(trim=False)
    start = drive(plant, 3.0, command)
    count = round(seconds / plant.Ts)
    drift = np.empty(count)
    end = start
    for k in range(count):
        end = plant.step(command)
        drift[k] = math.hypot(end.x - start.x, end.y - start.y)
    times: Array = plant.Ts * np.arange(1.0, count + 1.0)
    return Standing(times, drift, end.psi - start.psi, plant.wheels.Fz)


# --- verdicts ---


def documented(car: CarUnderTest) -> dict[str, float]:
    """Table 2; of another car than the packaged one, what its own file says."""
    return TABLE_2 if current() is None else {key: getattr(car.params, key) for key in TABLE_2}


def _inertia(result: StudyResult, car: CarUnderTest) -> None:
    time, force, torque = 0.1, 1e3, 1e3
    speed, rate = floating(car, force, torque)
    # The car also turns by 1.7 mrad meanwhile, so that the push is measured alone.
    speed, _ = floating(car, force, 0.0)
    _, rate = floating(car, 0.0, torque)
    result.find(
        "mass, by a push", force * time / speed, "kg", Limit.percent(documented(car)["m"], 0.01),
        f"{SOURCE if current() is None else OWN}; momentum is exact",
    )
    result.find(
        "yaw inertia, by a torque", torque * time / rate, "kg m2",
        Limit.percent(documented(car)["Iz"], 0.1),
        f"{SOURCE if current() is None else OWN}; the springs' rebound in the air is small",
    )


def _loads(result: StudyResult, car: CarUnderTest) -> None:
    p, table = car.params, documented(car)
    plant = car.plant()
    plant.reset()
    Fz = plant.wheels.Fz
    wheelbase = table["lf"] + table["lr"]
    weight = table["m"] * GRAVITY
    front, rear = (weight * table[share] / wheelbase / 2.0 for share in ("lr", "lf"))
    expected = np.array([front, front, rear, rear])
    result.find(
        "wheel loads on the flat, worst error", 100.0 * relative_error(Fz, expected), "%",
        Limit.at_most(0.1), "m g lr / 2L and m g lf / 2L",
    )
    result.find(
        "sum of the wheel loads over weight", Fz.sum() / weight, "", Limit.near(1.0, 1e-3),
        "the road carries the car",
    )
    model, data = plant.model, plant.data
    for axle, track in (("front", p.track_f), ("rear", p.track_r)):
        left, right = (data.xpos[model.body(f"wheel_{axle[0]}{side}").id] for side in "lr")
        result.find(
            f"{axle} track, between wheel centres", left[1] - right[1], "m",
            Limit.near(track, 1e-3), "the documented car, settled",
        )


def _slopes(result: StudyResult, car: CarUnderTest) -> dict[str, Standing]:
    p = car.params
    rests = {"flat": rest(car.plant(), Command(0.0, 0.0))}
    for name, direction in DIRECTIONS.items():
        rests[name] = rest(on_slope(car.plant(), direction), BRAKE)
    for name, stand in rests.items():
        where = "flat, no brakes" if name == "flat" else f"10 % slope, {name}"
        result.find(
            f"drift in 20 s, {where}", 1e3 * float(stand.drift.max()), "mm", Limit.at_most(1.0),
            "a parked car stands; 1 mm is invisible",
        )
    result.find(
        "turn in 20 s, worst", math.degrees(max(abs(s.turn) for s in rests.values())), "deg",
        Limit.at_most(0.01), "a parked car stands; 0.01 deg is 0.2 mm at its corners",
    )
    sin = math.sin(math.atan(GRADE))
    up = rests["uphill"].loads
    cos = math.cos(math.atan(GRADE))
    moved = cos * rests["flat"].loads[:2].sum() - up[:2].sum()
    M, C, K = suspension.linear_model(car.documented)
    lean = p.m * GRAVITY * p.h * sin / suspension.stiffness(K, suspension.PITCH)
    moved_by_leaning = lean * (p.h - p.R_w) * cos * p.m * GRAVITY / p.wheelbase
    height = (moved - moved_by_leaning) * p.wheelbase / (p.m * GRAVITY * sin)
    result.find(
        "height of mass, from loads uphill", height, "m", Limit.percent(p.h, 2.0),
        "documented height; 2 %, since leaning is taken out by a linear formula",
    )
    across = rests["across"].loads
    result.find(
        "load moved across the slope", across[[1, 3]].sum() - across[[0, 2]].sum(), "N",
        Limit.percent(2.0 * transfer_across(car), 2.0),
        "2 m g (h sin + h lean cos) / t; 2 % for small angles",
    )
    plant = on_slope(car.plant(), DIRECTIONS["downhill"])
    plant.reset(trim=False)
    free = Command(0.0, 0.0)
    before = drive(plant, 2.0, free).vx
    gained = (drive(plant, 1.0, free).vx - before) / (round(1.0 / plant.Ts) * plant.Ts)
    expected = (sin - p.c_roll * cos) * GRAVITY * p.m / p.m_eff
    result.find(
        "acceleration rolling down 10 %", gained, "m/s2", Limit.percent(expected, 0.5),
        "(sin - c_roll cos) g m / m_eff; 0.5 % for the drag at 3 m/s",
    )
    return rests


def transfer_across(car: CarUnderTest, grade: float = GRADE) -> float:
    """Load that moves from the upper to the lower wheels across a slope, lean included [N]."""
    p = car.params
    angle = math.atan(grade)
    lean = p.m * GRAVITY * p.h * math.sin(angle) / p.K_phi
    track = 0.5 * (p.track_f + p.track_r)
    height = p.h * math.sin(angle) + p.h * lean * math.cos(angle)
    return p.m * GRAVITY * height / track


def _suspension(result: StudyResult, car: CarUnderTest) -> dict[str, Array]:
    step = car.documented.opt.timestep
    fine = 1e-4
    expected = suspension.poles(*suspension.linear_model(car.documented))
    found = {
        dt: suspension.identify(suspension.without_grip(car.plant(Ts=dt, timestep=dt)))
        for dt in (step, fine)
    }
    f, zeta = frequency_and_damping(found[fine])
    f0, zeta0 = frequency_and_damping(expected)
    why = "linear model of 7 degrees of freedom; 0.5 % for a step of 0.1 ms"
    for i, name in enumerate(MODES):
        result.find(f"{name} frequency", f[i], "Hz", Limit.percent(f0[i], 0.5), why)
        result.find(f"{name} damping ratio", zeta[i], "", Limit.percent(zeta0[i], 0.5), why)
    hop = slice(len(MODES), None)
    error = max(relative_error(f[hop], f0[hop]), relative_error(zeta[hop], zeta0[hop]))
    result.find("wheel hop, worst error at 0.1 ms", 100.0 * error, "%", Limit.at_most(0.5), why)
    f, zeta = frequency_and_damping(found[step])
    error = max(relative_error(f, f0), relative_error(zeta, zeta0))
    allowed = 100.0 * math.pi * f0[-1] * step
    result.find(
        "all modes, worst error at 1 ms", 100.0 * error, "%", Limit.at_most(allowed),
        "a first-order step errs by half a step times the fastest mode, omega dt / 2",
    )
    names = [*MODES, *(f"wheel hop {i}" for i in (1, 2, 3, 4))]
    rows = [
        (name, *(value for values in columns for value in values))
        for name, *columns in zip(
            names,
            *(zip(*frequency_and_damping(p), strict=True) for p in (expected, *found.values())),
            strict=True,
        )
    ]
    header = (
        "mode", "f [Hz]", "damping", "f at 1 ms [Hz]", "damping at 1 ms", "f at 0.1 ms [Hz]",
        "damping at 0.1 ms",
    )
    result.tables.append(Table("modes", "Suspension, computed and identified", header, rows))
    return {"computed": expected, "1 ms": found[step], "0.1 ms": found[fine]}


def frequency_and_damping(poles: Array) -> tuple[Array, Array]:
    """Undamped frequency [Hz] and damping ratio of complex poles [1/s]."""
    return np.abs(poles) / (2.0 * math.pi), -poles.real / np.abs(poles)


# --- what is shown ---


@style.styled
def _draw_rest(rests: dict[str, Standing], car: CarUnderTest) -> Any:
    figure, (left, right) = style.axes(1, 2, height=2.7)
    colours = (style.BLUE, style.ORANGE, style.GREEN, style.PINK)
    for (name, stand), colour in zip(rests.items(), colours, strict=True):
        unseen = 1e3 * stand.drift.max() < 1e-6
        left.semilogy(
            stand.time, np.maximum(1e3 * stand.drift, 1e-6), color=colour,
            label=f"{name}, below 1e-6 mm" if unseen else name,
        )
    style.limit_line(left, 1.0, "limit 1 mm")
    style.label(left, "time [s]", "drift [mm]", "Standing on the brakes")
    left.set_ylim(8e-7, 1e2)
    left.legend(loc="upper right", ncols=2)
    p = car.params
    cos, sin = math.cos(math.atan(GRADE)), math.sin(math.atan(GRADE))
    along = p.m * GRAVITY * sin * p.h / p.wheelbase / 2.0
    side = transfer_across(car)
    f, r = (p.m * GRAVITY * cos * x / p.wheelbase / 2.0 for x in (p.lr, p.lf))
    computed = {
        "flat": [f / cos, f / cos, r / cos, r / cos],
        "uphill": [f - along, f - along, r + along, r + along],
        "downhill": [f + along, f + along, r - along, r - along],
    }
    share = p.roll_share_front
    for k, wheel in enumerate(("front left", "front right", "rear left", "rear right")):
        at = np.arange(len(rests)) + 0.2 * (k - 1.5)
        right.bar(at, [1e-3 * s.loads[k] for s in rests.values()], 0.17, color=colours[k],
                  label=wheel)
        sign = 1.0 if k % 2 else -1.0
        part = share if k < 2 else 1.0 - share
        across = (f if k < 2 else r) + sign * part * side
        for place, load in zip(at, [*(c[k] for c in computed.values()), across], strict=True):
            right.plot(place + np.array([-0.1, 0.1]), [1e-3 * load] * 2, color="black", lw=1.0)
    right.set_xticks(range(len(rests)), list(rests))
    right.set_ylim(0.0, 7.0)
    style.label(right, "", "wheel load [kN]", "Loads, computed: black lines")
    right.legend(loc="upper left", ncols=4, columnspacing=0.8)
    return figure


@style.styled
def _draw_modes(modes: dict[str, Array], car: CarUnderTest) -> Any:
    figure, (left, right) = style.axes(1, 2, height=2.7)
    marks = {"computed": ("o", "none", 6.0), "1 ms": ("x", style.ORANGE, 4.0),
             "0.1 ms": ("+", style.BLUE, 5.0)}
    for name, poles in modes.items():
        mark, colour, size = marks[name]
        edge = "black" if name == "computed" else colour
        left.plot(poles.real, poles.imag / (2 * math.pi), mark, ms=size, mfc="none", mec=edge,
                  label=name, lw=0.0)
    for (name, side), pole in zip(
        {"heave": (7, -3), "pitch": (-7, -3), "roll": (7, -3), "wheel hop": (12, -3)}.items(),
        modes["computed"],
        strict=False,
    ):
        left.annotate(
            name, (pole.real, pole.imag / (2 * math.pi)), xytext=side, fontsize=6.5,
            textcoords="offset points", ha="right" if side[0] < 0 else "left",
        )
    left.set_xlim(-60.0, 9.0)
    left.set_ylim(0.0, 14.0)
    style.label(left, "real part [1/s]", "damped frequency [Hz]", "Poles of the suspension")
    left.legend(loc="center")
    step = car.documented.opt.timestep
    plant = suspension.without_grip(car.plant(Ts=step, timestep=step))
    M, C, K = suspension.linear_model(car.documented)
    for start, row, name, colour in (
        ([1e-3, 0, 0, 0, 0, 0, 0], 0, "body", style.BLUE),
        ([0, 0, 0, 1e-3, 0, 0, 0], 3, "front wheel in the body", style.ORANGE),
    ):
        states = suspension.record(plant, np.array(start, dtype=float), 1.5)
        times = step * np.arange(len(states))
        right.plot(times, 1e3 * states[:, row], color=colour, lw=1.6, label=name)
        solution = suspension.free_motion(M, C, K, np.array(start, dtype=float), times)
        right.plot(times, 1e3 * solution[:, row], color="black", lw=0.8, ls=(0, (4, 2)),
                   label="linear model" if row else None)
    style.label(right, "time [s]", "displacement [mm]", "Free motion")
    right.legend(loc="upper right")
    return figure
