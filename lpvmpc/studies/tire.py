"""The tire on a bench: slip characteristics, combined slip, relaxation, golden values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.current import current
from lpvmpc.kit.findings import Limit
from lpvmpc.picture import style
from lpvmpc.studies.parts.tire_bench import Bench
from lpvmpc.studies.parts.tire_curves import (
    LOADS,
    TABLE_2_MU,
    curve_series,
    draw_slip,
    loads_table,
    peak,
    sweep,
)
from lpvmpc.studies.reference import ellipse, golden_tire
from lpvmpc.studies.study import TARGET, CarUnderTest, Picture, StudyResult
from lpvmpc.units import GRAVITY, Array

METHOD = """\
Two benches. The *law* is `lpvmpc.car.tire` called at given slip and load. The *engine* is the plant
itself: its car is held at 20 m/s over the road, suspension travel sets the load, drift and wheel
spin set the slip, and the forces that MuJoCo would apply are read. Sweeps are at 0.5, 1 and 1.6
times nominal load (FNOMIN: the static wheel load), and at none.

- Slip ratio -V_sx/|V|, positive drives; slip angle with tan(alpha) = -V_y/|V|, so that a positive
  one gives a force to the left (sign opposite to ISO 8855). Forces in the wheel's axes.
- Expected slopes, trail and relaxation length are the formulas of MF5.2 (Pacejka, *Tire and
  Vehicle Dynamics*, section 4.3.2) with the documented coefficients, written out anew.
- Golden values: pure and combined forces by the tire functions of CommonRoad's vehicle models with
  the same coefficients, for our two tires and for a 245/40 R18 tire that is not ours. Shifts are
  zero, which also avoids an error there (a vertical shift inside the sine).
- Relaxation: the slip is switched on at once; the force has built up to 63 % after one relaxation
  length.
- Valid for a symmetric tire upright on a dry flat road, below some 8 Hz (first-order relaxation).
"""

AXLES = ("front", "rear")


def run(car: CarUnderTest) -> StudyResult:
    """Study the tire."""
    result = StudyResult("tire", METHOD)
    under_test = dict(zip(AXLES, car.plant_coefficients(), strict=True))
    documented = dict(zip(AXLES, car.coefficients, strict=True))
    bench = Bench(car.plant())
    _symmetry(result, under_test)
    _slopes(result, under_test, documented, car)
    _peaks(result, under_test)
    _combined(result, under_test, documented)
    _trail(result, under_test, documented)
    steps, lengths = _relaxation(result, bench, documented)
    _extremes(result, under_test, bench)
    _golden(result, under_test)
    _engine(result, bench, documented)
    result.tables.append(loads_table(under_test))
    result.series += curve_series(under_test)
    result.pictures += [
        Picture(
            "slip",
            "Pure slip at three loads (Fz0: nominal load), front tire solid and rear tire dashed. "
            "Dots: golden values of CommonRoad's tire functions with the same coefficients.",
            draw_slip(under_test),
        ),
        Picture(
            "combined",
            "Combined slip at nominal load. Left: forces at constant slip angle while the slip "
            "ratio sweeps from -0.5 to 0.5, inside the friction ellipse. Right: build-up of the "
            "force in the engine over the rolled distance.",
            _draw_combined(under_test, steps, lengths),
        ),
    ]
    return result


# --- verdicts ---


def _symmetry(result: StudyResult, tires: dict[str, Array]) -> None:
    slips = np.concatenate([np.linspace(0.0, 0.5, 101), [1.0, 3.0]])
    worst = 0.0
    for c in tires.values():
        for load in LOADS:
            Fz = load * c[mf.FNOMIN]
            for lateral in (False, True):
                column = 1 if lateral else 0
                right = sweep(c, slips, Fz, lateral=lateral)[:, column]
                left = sweep(c, -slips, Fz, lateral=lateral)[:, column]
                worst = max(worst, float(np.max(np.abs(right + left))) / Fz)
    result.find(
        "asymmetry (F(s)+F(-s))/Fz, worst", worst, "", Limit.at_most(1e-12),
        "a symmetric tire has no shift; 1e-12 is rounding",
    )


def _slopes(
    result: StudyResult, tires: dict[str, Array], documented: dict[str, Array], car: CarUnderTest
) -> None:
    errors: dict[str, list[float]] = {"Fx over slip ratio": [], "Fy over slip angle": []}
    h = 1e-6
    for axle, c in tires.items():
        d = documented[axle]
        for load in LOADS:
            Fz = load * d[mf.FNOMIN]
            dfz = load - 1.0
            Kx = Fz * (d[mf.PKX1] + d[mf.PKX2] * dfz) * math.exp(d[mf.PKX3] * dfz)
            errors["Fx over slip ratio"].append(mf.forces(c, h, 0.0, Fz, 1.0)[0] / h / Kx - 1.0)
            Ky = _cornering(d, Fz)
            errors["Fy over slip angle"].append(mf.forces(c, 0.0, h, Fz, 1.0)[1] / h / Ky - 1.0)
    for name, error in errors.items():
        result.find(
            f"slope of {name}, error", 100.0 * float(np.max(np.abs(error))), "%",
            Limit.at_most(0.01),
            "slope B C D of the formula; a difference quotient at a slip of 1e-6",
        )
    p = car.params
    for axle, share, target, tolerance in (
        ("front", p.lr, 131.0, 5.0),
        ("rear", p.lf, 215.0, 10.0),
    ):
        Fz = 0.5 * p.m * GRAVITY * share / p.wheelbase
        stiffness = 2.0 * mf.forces(tires[axle], 0.0, h, Fz, 1.0)[1] / h
        result.find(
            f"{axle} axle stiffness, static load", 1e-3 * stiffness, "kN/rad",
            Limit.near(target, tolerance), TARGET, target=True,
        )


def _cornering(c: Array, Fz: float) -> float:
    """Cornering stiffness of MF5.2 [N/rad]."""
    return float(
        c[mf.PKY1]
        * c[mf.FNOMIN]
        * math.sin(2.0 * math.atan(Fz / (c[mf.PKY2] * c[mf.FNOMIN])))
    )


def _peaks(result: StudyResult, tires: dict[str, Array]) -> None:
    for name, lateral in (("longitudinal", False), ("lateral", True)):
        mu = [peak(c, c[mf.FNOMIN], lateral=lateral) for c in tires.values()]
        worst = max(mu, key=lambda value: abs(value - TABLE_2_MU))
        result.find(
            f"{name} peak friction", worst, "",
            Limit.near(TABLE_2_MU, 0.004),
            "at nominal load, the paper's Table 2; 0.5 % for the grid of the sweep", target=True,
        )
    loads = np.linspace(0.3, 2.0, 8)
    fall = [
        np.diff([peak(c, load * c[mf.FNOMIN], lateral=lateral) for load in loads]).max()
        for c in tires.values()
        for lateral in (False, True)
    ]
    result.find(
        "rise of peak friction with load, worst", max(fall), "", Limit.at_most(0.0),
        "friction of rubber falls with load",
    )
    half = [
        peak(c, c[mf.FNOMIN], lateral=lateral, friction=0.5)
        / peak(c, c[mf.FNOMIN], lateral=lateral)
        for c in tires.values()
        for lateral in (False, True)
    ]
    result.find(
        "peak on a road of half the friction", max(half, key=lambda value: abs(value - 0.5)),
        "of full", Limit.near(0.5, 0.0025),
        "the road scales the peak; 0.5 % for the grid of the sweep",
    )


def _combined(
    result: StudyResult, tires: dict[str, Array], documented: dict[str, Array]
) -> None:
    slips = np.concatenate([-np.linspace(0.005, 0.5, 50)[::-1], np.linspace(0.0, 0.5, 51), [1.0]])
    filling, power = 0.0, math.inf
    published = max(ellipse.filling(c, slips, LOADS) for c in documented.values())
    for c in tires.values():
        for load in LOADS:
            Fz = load * c[mf.FNOMIN]
            mux, muy = (peak(c, Fz, lateral=lateral) for lateral in (False, True))
            for kappa in slips:
                for alpha in slips:
                    Fx, Fy, _ = mf.forces(c, kappa, alpha, Fz, 1.0)
                    filling = max(filling, math.hypot(Fx / (mux * Fz), Fy / (muy * Fz)))
                    power = min(power, (Fx * kappa + Fy * alpha) / Fz)
    result.find(
        "combined force over the ellipse, worst", filling, "",
        Limit.at_most(max(1.01, (1.0 + 1e-9) * published)),
        "the friction ellipse; cosine weights are no ellipse, 1 % is left to them" if published
        <= 1.01 else f"what the documented weights of combined slip give, written out anew: they "
        f"leave the friction ellipse by {100.0 * (published - 1.0):.0f} %",
    )
    result.find(
        "least slip power over load and speed", power, "", Limit.at_least(0.0),
        "a sliding tire takes energy out, whatever the slips",
    )


def _trail(
    result: StudyResult, tires: dict[str, Array], documented: dict[str, Array]
) -> None:
    for axle, c in tires.items():
        d = documented[axle]
        _, Fy, Mz = mf.forces(c, 0.0, 1e-4, d[mf.FNOMIN], 1.0)
        result.find(
            f"pneumatic trail of the {axle} tire", -1e3 * Mz / Fy, "mm",
            Limit.percent(1e3 * d[mf.R0] * d[mf.QDZ1], 0.1),
            "R0 QDZ1 at nominal load and small slip; the moment turns the wheel back",
        )


def _relaxation(
    result: StudyResult, bench: Bench, documented: dict[str, Array]
) -> tuple[dict[str, tuple[Array, Array]], dict[str, float]]:
    Fz = 4000.0
    slip = 0.01
    distance, slips = bench.step_response(Fz, slip, slip, time=0.6)
    steps, expected = {}, {}
    for axle, wheel in (("front", 0), ("rear", 2)):
        d = documented[axle]
        load = Fz / d[mf.FNOMIN]
        lengths = (
            d[mf.R0] * load * (d[mf.PTX1] + d[mf.PTX2] * (load - 1.0)),
            d[mf.R0] * d[mf.PTY1] * math.sin(2.0 * math.atan(load / d[mf.PTY2])),
        )
        for way, name in enumerate(("longitudinal", "lateral")):
            rise = slips[:, wheel, way] / slip
            length = float(np.interp(1.0 - math.exp(-1.0), rise, distance))
            result.find(
                f"{axle} {name} relaxation length", length, "m",
                Limit.percent(lengths[way], 1.0),
                "relaxation length of MF5.2 at 4 kN; half a millimetre per step of time",
            )
            steps[f"{name}, {axle}"] = distance, rise
            expected[f"{name}, {axle}"] = lengths[way]
    return steps, expected


def _extremes(result: StudyResult, tires: dict[str, Array], bench: Bench) -> None:
    slips = (-1e3, -1.0, -1e-9, 0.0, 0.02, 3.0)
    loaded, odd = 0.0, 0
    for c in tires.values():
        for Fz in (0.0, 1e-9, 4000.0, 2e4):
            for kappa in slips:
                for alpha in slips:
                    forces = mf.forces(c, kappa, alpha, Fz, 1.0)
                    odd += sum(not math.isfinite(force) for force in forces)
                    if Fz == 0.0:
                        loaded = max(loaded, *(abs(force) for force in forces))
    with np.errstate(all="ignore"):
        for Fz in (0.0, 4000.0):
            for kappa in (-1.0, 0.0, 0.5):
                forces = bench.forces(Fz, kappa, 0.3, speed=0.0)
                odd += int((~np.isfinite(forces)).sum())
                if Fz == 0.0:
                    loaded = max(loaded, float(np.abs(forces).max()))
    result.find(
        "force without load, largest", loaded, "N", Limit.at_most(0.0),
        "a tire off the road makes no force",
    )
    result.find(
        "forces not finite, also at rest", odd, "", Limit.at_most(0.0),
        "slip is never divided by speed, so standstill is no exception",
    )


def _golden(result: StudyResult, tires: dict[str, Array]) -> None:
    stored = golden_tire.read()
    other = mf.coefficients(stored["coefficients"]["adams"])
    if current() is not None:  # the stored ones are of the packaged car's tires
        tires = {}
    for name, c in {**tires, "adams": other}.items():
        error = 0.0
        for which, Fz, kappa, alpha, Fx, Fy in stored["rows"]:
            if which == name:
                ours = mf.forces(c, kappa, alpha, Fz, 1.0)
                for mine, theirs in ((ours[0], Fx), (ours[1], Fy)):
                    error = max(error, abs(mine - theirs) / max(abs(theirs), 1.0))
        label = "245/40 R18" if name == "adams" else f"{name} tire"
        result.find(
            f"golden forces, {label}, error", error, "", Limit.at_most(1e-6),
            "CommonRoad's tire functions, same formula and coefficients: rounding",
        )


def _engine(result: StudyResult, bench: Bench, documented: dict[str, Array]) -> None:
    error = 0.0
    for Fz in (1500.0, 4000.0, 7000.0):
        for kappa in (-0.2, -0.03, 0.0, 0.05):
            for alpha in (-0.1, 0.0, 0.02, 0.3):
                forces = bench.forces(Fz, kappa, alpha)
                for wheel in range(4):
                    c = documented[AXLES[wheel // 2]]
                    law = mf.forces(c, kappa, alpha, Fz, 1.0)
                    error = max(error, abs(forces[wheel, 0] - law[0]) / Fz)
                    error = max(error, abs(forces[wheel, 1] - law[1]) / Fz)
    result.find(
        "engine against law, error over Fz", error, "", Limit.at_most(1e-9),
        "the same functions; the load comes out of coordinates of a metre: 1e-16 m x 200 kN/m",
    )


# --- what is shown ---


@style.styled
def _draw_combined(
    tires: dict[str, Array], steps: dict[str, tuple[Array, Array]], documented: dict[str, float]
) -> Any:
    figure, (left, right) = style.axes(1, 2, height=3.0)
    c = tires["front"]
    Fz = c[mf.FNOMIN]
    mux, muy = mf.peak_friction(c, Fz)
    turn = np.linspace(0.0, math.pi, 181)
    left.plot(
        mux * np.cos(turn), muy * np.sin(turn), color=style.RED, ls=(0, (4, 2)), lw=0.9,
        label="friction ellipse",
    )
    ratios = np.linspace(-0.5, 0.5, 401)
    colours = (style.SKY, style.GREEN, style.BLUE, style.ORANGE, style.PINK)
    for angle, colour in zip((1.0, 2.0, 4.0, 8.0, 14.0), colours, strict=True):
        alpha = math.tan(math.radians(angle))
        forces = sweep(c, ratios, Fz, lateral=False, other=alpha) / Fz
        left.plot(forces[:, 0], forces[:, 1], color=colour, label=f"{angle:g} deg")
    style.label(left, "Fx / Fz", "Fy / Fz", "Front tire, combined slip")
    left.set_aspect("equal")
    left.set_ylim(-0.02, 1.12)
    left.legend(loc="upper center", ncols=3)
    after_one = 1.0 - math.exp(-1.0)
    for (name, (distance, rise)), colour in zip(steps.items(), colours, strict=False):
        dashes = "-" if "lateral" in name else (0, (4, 2))
        right.plot(distance, 100.0 * rise, color=colour, ls=dashes, label=name)
        length = documented[name]
        right.plot(length, 100.0 * after_one, "o", color=colour, ms=3.5, mec="black", mew=0.5)
    style.limit_line(right, 100.0 * after_one, "63 %; dots: after one length")
    right.set_xlim(0.0, 2.5)
    style.label(right, "rolled distance [m]", "slip built up [%]", "Relaxation at 4 kN")
    right.legend(loc="lower right")
    return figure
