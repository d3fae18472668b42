"""The same steering into other models of the same car: single tracks, CommonRoad's multibody."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import CubicSpline

from lpvmpc.car.axle import axles
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.mjcf import tires
from lpvmpc.plant.plant import Plant
from lpvmpc.studies.reference import multibody
from lpvmpc.studies.reference.circle_formulas import Linear, steady_track
from lpvmpc.studies.reference.multibody import SPEED
from lpvmpc.studies.reference.single_track import SingleTrack
from lpvmpc.studies.study import CarUnderTest, Picture, Series, StudyResult
from lpvmpc.units import GRAVITY, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAIN_SPEEDS = (10.0, 15.0, 20.0, 25.0)
"""Speeds at which the yaw gain is compared [m/s]."""
GENTLE = (0.5, 1.0, 1.5, 2.0)
"""Lateral accelerations at which it is [m/s2]."""
LATERAL = (0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0, 6.5)
"""Lateral accelerations of the steady states at 20 m/s [m/s2]."""
PARTED = 0.05
"""Relative difference of the axles' slips, opposite ones, at which two models have parted."""
SOFTENED = 2.5
"""What load transfer and slip at 2 m/s2 may take of an axle's stiffness [%]."""
PARTED_SIDESLIP = math.radians(0.1)
"""Difference of sideslip angles at which they have [rad]."""
Ts = 0.001
"""Control period of the transient [s]."""

LINEAR, AXLES, MULTIBODY = "linear single track", "single track, tire law", "CommonRoad multibody"
MODELS = (LINEAR, AXLES, MULTIBODY)

METHOD = f"""\
**Models.** All get the documented car's parameters, the same road wheel angle and a speed of
{SPEED:g} m/s, which each holds by its own drive. *Linear single track*: `lpvmpc.car.bicycle` with
constant axle stiffness; in steady states only the tires are linear, angles are not. *Single track,
tire law*: the same with the Magic Formula at the wheel loads that follow from roll
(`lpvmpc.car.axle`); it shares the tire with the simulation and nothing else.
*CommonRoad multibody*:
`vehicle_dynamics_mb` of the package commonroad-vehicle-models (TU Munich, BSD-3), 29 states, other
people's code; its parameters are ours as far as it has them
(`lpvmpc/studies/reference/multibody.py`), axle stiffness being the effective one, trail included.
It has no load dependence of its tires, so that
it must part from ours as load moves, and no relaxation. Its results are stored with the package
and computed anew by a test.

**Steady states** over lateral acceleration at equal steering angle: yaw rate and sideslip of the
centre of mass. No model has drag or rolling resistance, the simulation has: what these make of
the linear yaw gain (`studies/reference/circle_formulas.py`) is given to all models first. Two
models have *parted* where the yaw rates differ by what {100 * PARTED:g} % more front slip and less
rear slip make of the linear yaw gain (a car close to neutral shows more of it), or the
sideslip by {math.degrees(PARTED_SIDESLIP):g} degrees; the crossover is the first such lateral
acceleration. **Transient**: one sine of steering of {multibody.SINE:g} rad and 0.5 Hz.

**Valid** as far as the models agree: linear single tracks are taught for up to 0.3 to 0.4 g.
"""


def run(car: CarUnderTest) -> StudyResult:
    """Yaw gain, steady states and a transient of all models; symmetry."""
    result = StudyResult("cross-model", METHOD)
    _yaw_gain(car, result)
    steady = _steady(car, result)
    transient = _transient(car, result)
    _symmetry(car, result)
    result.pictures += [
        Picture(
            "steady",
            "Yaw gain and sideslip over lateral acceleration at 20 m/s and equal steering; shaded: "
            "parted yaw rates and 0.1 degrees around the simulation, vertical: where each parts.",
            _steady_picture(*steady),
        ),
        Picture(
            "transient",
            "One sine of steering at 20 m/s: yaw rate and sideslip of all models, and their "
            "differences from the simulation.",
            _transient_picture(*transient),
        ),
    ]
    return result


def single_tracks(car: CarUnderTest) -> dict[str, SingleTrack]:
    """Both single tracks of the documented car."""
    p = car.params
    return {LINEAR: SingleTrack(p, None), AXLES: SingleTrack(p, axles(p, *tires(car.documented)))}


# --- steady states ---


def resisted(car: CarUnderTest, vx: float) -> float:
    """Yaw gain with drag and rolling resistance, which no model here has, over that without [-]."""
    ay = 1e-3
    steer = steady_track(car.params, tires(car.documented), vx, ay).delta
    return float(ay / vx / steer / Linear.of(car.params).yaw_gain(vx))


def _yaw_gain(car: CarUnderTest, result: StudyResult) -> None:
    """Yaw rate of the plant against the linear single track at equal steering."""
    plant, model = car.plant(), single_tracks(car)[LINEAR]
    rows, worst, linear = [], 0.0, Linear.of(car.params)
    for vx in GAIN_SPEEDS:
        known = resisted(car, vx)
        off = []
        for ay in GENTLE:
            s = plant.reset(vx=vx, kappa=ay / vx**2)
            off.append(s.r / (known * model.steady(vx, s.delta)[0]) - 1.0)
        worst = max(worst, max(map(abs, off)))
        gain = s.r / s.delta
        rows.append((f"{vx:g}", gain, *(100.0 * x for x in off)))
    result.find(
        "yaw gain off linear model, to 2 m/s2", 100.0 * worst, "%",
        Limit.at_most(SOFTENED * linear.yaw_gain_per_slip(GAIN_SPEEDS[-1])),
        f"what the gain shows of {SOFTENED:g} % more front slip and less rear slip: at 2 m/s2 load "
        "transfer and slip soften tires",
    )
    header = ("speed m/s", "gain 1/s at 2 m/s2", *(f"% off at {ay:g}" for ay in GENTLE))
    caption = "Yaw gain of the simulation, and how far it is off the linear single track"
    result.tables.append(Table("yaw-gain", caption, header, rows))


def crossover(ay: Array, difference: Array, parted: float) -> float:
    """Lateral acceleration at which a difference first reaches a bound, else the last one [m/s2].

    Args:
        ay: Increasing lateral acceleration [m/s2], shape (n,).
        difference: Of two models, any sign, shape (n,).
        parted: The bound.
    """
    beyond = np.flatnonzero(np.abs(difference) >= parted)
    if not len(beyond):
        return float(ay[-1])
    i = int(beyond[0])
    if i == 0:
        return float(ay[0])
    a, b = np.abs(difference[i - 1]), np.abs(difference[i])
    return float(ay[i - 1] + (ay[i] - ay[i - 1]) * (parted - a) / (b - a))


def _steady(car: CarUnderTest, result: StudyResult) -> tuple[Array, dict[str, Array], float]:
    """Steady states at SPEED: rows (ay, delta, r, beta) of the plant; (r, beta) of the models.

    And the relative difference of yaw rates at which two have parted.
    """
    plant = car.plant()
    rows = []
    for ay in LATERAL:
        s = plant.reset(vx=SPEED, kappa=ay / SPEED**2)
        rows.append((s.ay, s.delta, s.r, math.atan2(s.vy, s.vx)))
    ours = np.array(rows)
    models = {
        name: np.array([model.steady(SPEED, delta) for delta in ours[:, 1]])
        for name, model in single_tracks(car).items()
    }
    stored = np.array(multibody.read()["steady"])
    stored = np.vstack([(0.0, SPEED, 0.0, 0.0, 0.0), stored])
    theirs = np.stack([stored[:, 3], np.arctan2(stored[:, 2], stored[:, 1])], axis=1)
    models[MULTIBODY] = CubicSpline(stored[:, 0], theirs)(ours[:, 1])

    for model in models.values():
        model[:, 0] *= resisted(car, SPEED)
    gentle = ours[:, 0] < 2.1
    parted = PARTED * Linear.of(car.params).yaw_gain_per_slip(SPEED)
    least = {LINEAR: 0.3, AXLES: 0.6, MULTIBODY: 0.4}
    why = {
        LINEAR: "linear tires are taught to hold to 0.3 g",
        AXLES: "it has our tires and loads: only the limit of grip, "
        f"{car.params.ay_limit / GRAVITY:.2f} g, may tear it off",
        MULTIBODY: "it saturates as ours does but knows no load transfer, which takes 6 % of an "
        "axle's stiffness at 0.5 g",
    }
    table = []
    for name in MODELS:
        yaw = models[name][:, 0] / ours[:, 2] - 1.0
        sideslip = models[name][:, 1] - ours[:, 3]
        parts = crossover(ours[:, 0], yaw, parted), crossover(ours[:, 0], sideslip, PARTED_SIDESLIP)
        result.find(f"yaw holds to, {name}", parts[0] / 9.81, "g",
                    Limit.at_least(least[name]), why[name])
        table.append(
            (
                name,
                100.0 * float(np.abs(yaw[gentle]).max()),
                math.degrees(np.abs(sideslip[gentle]).max()),
                *parts,
            )
        )
    result.find(
        "yaw rate off CommonRoad's, to 2 m/s2", table[-1][1], "%", Limit.at_most(3.0),
        "as for the linear single track: at 2 m/s2 load transfer is worth 1 %",
    )
    result.find(
        "sideslip off CommonRoad's, to 2 m/s2", table[-1][2], "deg", Limit.at_most(0.1),
        "about what an optical sensor resolves",
    )
    header = ("model", "yaw % off to 2", "sideslip deg off to 2", "yaw parts at", "sideslip at")
    caption = (
        f"Steady states at 20 m/s: differences to 2 m/s2, and where the models part [m/s2] "
        f"({ours[-1, 0]:.3g}: not by then)"
    )
    result.tables.append(Table("steady", caption, header, table))
    columns = dict(zip(("ay_mps2", "delta_rad", "r_radps", "beta_rad"), ours.T, strict=True))
    for name, short in zip(MODELS, ("linear", "tire_law", "multibody"), strict=True):
        columns |= {f"r_{short}_radps": models[name][:, 0], f"beta_{short}_rad": models[name][:, 1]}
    result.series.append(Series("steady", columns))
    return ours, models, parted


# --- transient ---


def drive(plant: Plant, lag: float, side: float, seconds: float) -> Array:
    """One sine of steering, `multibody.sine`, at constant speed.

    Args:
        plant: With a control period of Ts.
        lag: Time constant of its steering servo [s], which the command makes up for.
        side: -1 steers to the other side.
        seconds: How long.

    Returns:
        t [s], delta [rad], r [rad/s], sideslip [rad], ay [m/s2] at each period, shape (n + 1, 5).
    """
    s = plant.reset(vx=SPEED)
    held, integral = float(plant.data.ctrl[1]), 0.0
    rows = [(0.0, s.delta, s.r, 0.0, s.ay)]
    for k in range(round(seconds / Ts)):
        t = (k + 1) * Ts  # the wheel gets there at the end of the period
        delta = side * (multibody.sine(t) + lag * multibody.sine_rate(t))
        missing = SPEED - s.vx
        integral += Ts * missing
        s = plant.step(Command(delta, held + 6.0 * missing + 4.0 * integral))
        rows.append((t, s.delta, s.r, math.atan2(s.vy, s.vx), s.ay))
    return np.array(rows)


def _transient(car: CarUnderTest, result: StudyResult) -> tuple[Array, dict[str, Array]]:
    """The sine: rows of `drive`, and (r, beta) of the models at the same instants."""
    plant = car.plant(Ts=Ts)
    every = round(multibody.SAMPLE / Ts)
    ours = drive(plant, car.params.tau_delta, 1.0, multibody.SINE_TIME)[::every]
    times = ours[:, 0]
    models = {
        name: model.transient(SPEED, multibody.sine, times)
        for name, model in single_tracks(car).items()
    }
    stored = np.array(multibody.read()["transient"])
    models[MULTIBODY] = np.stack([stored[:, 3], np.arctan2(stored[:, 2], stored[:, 1])], axis=1)
    limits = {LINEAR: 10.0, AXLES: 5.0, MULTIBODY: 10.0}
    why = {
        LINEAR: "at 0.45 g linear tires are beyond what they are taught for",
        AXLES: "it has our tires, relaxation and roll; left out: pitch, inner and outer steer",
        MULTIBODY: "0.45 g without load dependence, and its tires have no relaxation, a delay of "
        "25 ms: 8 % of the peak at 0.5 Hz",
    }
    table = []
    for name in MODELS:
        off = math.sqrt(np.mean((models[name][:, 0] - ours[:, 2]) ** 2)) / np.abs(ours[:, 2]).max()
        slip = math.degrees(np.abs(models[name][:, 1] - ours[:, 3]).max())
        result.find(f"sine: rms off, {name}", 100.0 * off, "%", Limit.at_most(limits[name]),
                    why[name])
        table.append((name, 100.0 * off, slip))
    header = ("model", "yaw rate rms over peak %", "sideslip, largest deg")
    caption = f"One sine of steering, ay to {np.abs(ours[:, 4]).max():.1f} m/s2: differences"
    result.tables.append(Table("transient", caption, header, table))
    columns = {"t_s": times, "delta_rad": ours[:, 1], "r_radps": ours[:, 2], "beta_rad": ours[:, 3]}
    for name, short in zip(MODELS, ("linear", "tire_law", "multibody"), strict=True):
        columns |= {f"r_{short}_radps": models[name][:, 0], f"beta_{short}_rad": models[name][:, 1]}
    result.series.append(Series("transient", columns))
    return ours, models


def _symmetry(car: CarUnderTest, result: StudyResult) -> None:
    """Left against right."""
    plant, lag = car.plant(Ts=Ts), car.params.tau_delta
    left, right = (drive(plant, lag, side, 1.5) for side in (1.0, -1.0))
    result.find(
        "left against right, simulation", float(np.abs(left[:, 1:] + right[:, 1:]).max()), "",
        Limit.at_most(1e-9), "a symmetric car; rounding alone may differ",
    )
    result.find(
        "left against right, CommonRoad", multibody.read()["left_against_right"], "",
        Limit.at_most(1e-6), "its integrator's tolerance",
    )


# --- pictures ---

LOOKS = {
    LINEAR: (style.ORANGE, (0, (4, 2))),
    AXLES: (style.GREEN, (0, (1, 1.5))),
    MULTIBODY: (style.RED, "-"),
}


@style.styled
def _steady_picture(ours: Array, models: dict[str, Array], parted: float) -> Figure:
    figure, (yaw, sideslip) = style.axes(1, 2, height=2.8)
    ay, delta, r, beta = ours.T
    gain, slip = r / delta, np.degrees(beta)
    low, high = gain * (1.0 - parted), gain * (1.0 + parted)
    yaw.fill_between(ay, low, high, color=style.BLUE, alpha=0.2, lw=0)
    off = math.degrees(PARTED_SIDESLIP)
    sideslip.fill_between(ay, slip - off, slip + off, color=style.BLUE, alpha=0.2, lw=0)
    for name in MODELS:
        color, dashes = LOOKS[name]
        yaw.plot(ay, models[name][:, 0] / delta, color=color, ls=dashes, label=name)
        sideslip.plot(ay, np.degrees(models[name][:, 1]), color=color, ls=dashes)
        for axis, difference, bound in (
            (yaw, models[name][:, 0] / r - 1.0, parted),
            (sideslip, models[name][:, 1] - beta, PARTED_SIDESLIP),
        ):
            where = crossover(ay, difference, bound)
            if where < ay[-1]:
                axis.axvline(where, color=color, lw=0.8, ls=":")
    yaw.plot(ay, gain, "o-", ms=3, color=style.BLUE, label="simulation", zorder=1.9)
    sideslip.plot(ay, slip, "o-", ms=3, color=style.BLUE, zorder=1.9)
    style.label(yaw, "lateral acceleration [m/s²]", "yaw rate over steer [1/s]", "Yaw gain")
    style.label(sideslip, "lateral acceleration [m/s²]", "sideslip [deg]", "Sideslip")
    figure.legend(*yaw.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


@style.styled
def _transient_picture(ours: Array, models: dict[str, Array]) -> Figure:
    figure, axes = style.axes(2, 2, height=3.6, sharex=True, height_ratios=(1.5, 1.0))
    t = ours[:, 0]
    for column, (i, title) in enumerate(((2, "Yaw rate"), (3, "Sideslip"))):
        curve, rest = axes[:, column]
        own = np.degrees(ours[:, i])
        curve.plot(t, own, color=style.BLUE, lw=1.6, label="simulation")
        for name in MODELS:
            color, dashes = LOOKS[name]
            line = np.degrees(models[name][:, i - 2])
            curve.plot(t, line, color=color, ls=dashes, label=name)
            rest.plot(t, line - own, color=color, ls=dashes)
        unit = "deg/s" if i == 2 else "deg"
        style.label(curve, "", f"{title.lower()} [{unit}]", title)
        style.label(rest, "time [s]", f"difference [{unit}]")
        rest.axhline(0.0, color=style.GREY, lw=0.5, zorder=1)
    figure.align_ylabels(axes[:, 0])
    figure.align_ylabels(axes[:, 1])
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure
