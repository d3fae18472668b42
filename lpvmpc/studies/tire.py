"""The tire on a bench: slip characteristics, combined slip, relaxation, golden values."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import SPIN_QVEL
from lpvmpc.studies import plots
from lpvmpc.studies.reference import golden_tire
from lpvmpc.studies.study import TARGET, CarUnderTest, Picture, Series, StudyResult
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

LOADS = golden_tire.LOADS
"""Loads of the sweeps over FNOMIN."""
AXLES = ("front", "rear")
TABLE_2_MU = 0.82
"""Friction in the paper's Table 2."""


def run(car: CarUnderTest) -> StudyResult:
    """Study the tire."""
    result = StudyResult("tire", METHOD)
    under_test = dict(zip(AXLES, car.plant_tires(), strict=True))
    documented = dict(zip(AXLES, car.tires, strict=True))
    bench = Bench(car.plant())
    _symmetry(result, under_test)
    _slopes(result, under_test, documented, car)
    _peaks(result, under_test)
    _combined(result, under_test)
    _trail(result, under_test, documented)
    steps, lengths = _relaxation(result, bench, documented)
    _extremes(result, under_test, bench)
    _golden(result, under_test)
    _engine(result, bench, documented)
    result.tables.append(_overview(under_test))
    result.series += _curves(under_test)
    result.pictures += [
        Picture(
            "slip",
            "Pure slip at three loads (Fz0: nominal load), front tire solid and rear tire dashed. "
            "Dots: golden values of CommonRoad's tire functions with the same coefficients.",
            _draw_slip(under_test),
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


class Bench:
    """The engine's own tires at given load and slip: the car is held, its forces are read."""

    def __init__(self, plant: Plant) -> None:
        """Take a plant; its state is used freely."""
        self.plant = plant
        model, data = plant.model, plant.data
        self._reference = model.qpos0.copy()
        data.qpos[:] = self._reference
        mujoco.mj_forward(model, data)
        wheels = ("fl", "fr", "rl", "rr")
        self._height = np.array([data.xpos[model.body(f"wheel_{w}").id][2] for w in wheels])
        self._travel = [int(model.joint(f"susp_{w}").qposadr[0]) for w in wheels]
        self._coefficients = [
            np.array(model.numeric(f"tire_{axle}").data) for axle in ("f", "f", "r", "r")
        ]

    def hold(self, Fz: float, slip_ratio: float, tan_alpha: float, speed: float) -> None:
        """Put the car where all four tires have this load and slide like this.

        Args:
            Fz: load [N]; with 0 the tires are off the road.
            slip_ratio: of all wheels [-].
            tan_alpha: tangent of the slip angle [-].
            speed: along the car's axis [m/s].
        """
        plant, data = self.plant, self.plant.data
        data.qpos[:] = self._reference
        for i, c in enumerate(self._coefficients):
            height = c[mf.R0] - Fz / c[mf.KZ] if Fz > 0.0 else c[mf.R0] + 1e-3
            data.qpos[self._travel[i]] = height - self._height[i]
        data.qvel[:] = 0.0
        data.qvel[:2] = speed, -tan_alpha * speed
        data.qvel[list(SPIN_QVEL)] = speed * (1.0 + slip_ratio) / plant.params.R_w
        data.ctrl[:] = 0.0
        data.act[:2] = 0.0

    def forces(self, Fz: float, slip_ratio: float, tan_alpha: float, speed: float = 20.0) -> Array:
        """Steady Fx, Fy [N] of the wheels fl, fr, rl, rr, shape (4, 2)."""
        self.hold(Fz, slip_ratio, tan_alpha, speed)
        act = self.plant.data.act
        for i, c in enumerate(self._coefficients):
            sigma_x, sigma_y = mf.relaxation_lengths(c, Fz)
            act[2 + 2 * i : 4 + 2 * i] = slip_ratio * sigma_x, tan_alpha * sigma_y
        mujoco.mj_forward(self.plant.model, self.plant.data)
        wheels = self.plant.wheels
        return np.stack([wheels.Fx, wheels.Fy], axis=1)

    def step_response(
        self, Fz: float, slip_ratio: float, tan_alpha: float, *, speed: float = 5.0, time: float
    ) -> tuple[Array, Array]:
        """Slip that makes force after the patch begins to slide.

        Args:
            Fz: load [N].
            slip_ratio: switched on at the beginning.
            tan_alpha: the same.
            speed: along the car's axis [m/s].
            time: how long to watch [s].

        Returns:
            Rolled distance [m], shape (n,), and slip ratio and tan_alpha of the four wheels,
            shape (n, 4, 2).
        """
        model, data = self.plant.model, self.plant.data
        data.act[:] = 0.0
        count = round(time / model.opt.timestep)
        slips = np.empty((count, 4, 2))
        for k in range(count):
            self.hold(Fz, slip_ratio, tan_alpha, speed)
            mujoco.mj_step(model, data)
            wheels = self.plant.wheels
            slips[k] = np.stack([wheels.slip_ratio, np.tan(wheels.slip_angle)], axis=1)
        return speed * model.opt.timestep * np.arange(1, count + 1), slips


def sweep(c: Array, slips: Array, Fz: float, *, lateral: bool, other: float = 0.0) -> Array:
    """Fx, Fy, Mz over one slip, the other held.

    Args:
        c: coefficients.
        slips: slip ratios, or tangents of the slip angle where `lateral`, shape (n,).
        Fz: load [N].
        lateral: which slip is swept.
        other: the other slip.

    Returns:
        Forces [N] and moment [N m], shape (n, 3).
    """
    pairs = [(other, s) if lateral else (s, other) for s in slips]
    return np.array([mf.forces(c, kappa, alpha, Fz, 1.0) for kappa, alpha in pairs])


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
    )  # fmt: skip


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
        )  # fmt: skip
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
        )  # fmt: skip


def _cornering(c: Array, Fz: float) -> float:
    """Cornering stiffness of MF5.2 [N/rad]."""
    return float(
        c[mf.PKY1]
        * c[mf.FNOMIN]
        * math.sin(2.0 * math.atan(Fz / (c[mf.PKY2] * c[mf.FNOMIN])))
    )


def peak(c: Array, Fz: float, *, lateral: bool, friction: float = 1.0) -> float:
    """Largest pure force over load, found by a sweep of the slip up to 1."""
    slips = np.linspace(0.0, 1.0, 2001)
    column = 1 if lateral else 0
    pairs = [(0.0, s) if lateral else (s, 0.0) for s in slips]
    return max(mf.forces(c, *pair, Fz, friction)[column] for pair in pairs) / Fz


def _peaks(result: StudyResult, tires: dict[str, Array]) -> None:
    for name, lateral in (("longitudinal", False), ("lateral", True)):
        mu = [peak(c, c[mf.FNOMIN], lateral=lateral) for c in tires.values()]
        worst = max(mu, key=lambda value: abs(value - TABLE_2_MU))
        result.find(
            f"{name} peak friction", worst, "",
            Limit.near(TABLE_2_MU, 0.004),
            "at nominal load, the paper's Table 2; 0.5 % for the grid of the sweep", target=True,
        )  # fmt: skip
    loads = np.linspace(0.3, 2.0, 8)
    fall = [
        np.diff([peak(c, load * c[mf.FNOMIN], lateral=lateral) for load in loads]).max()
        for c in tires.values()
        for lateral in (False, True)
    ]
    result.find(
        "rise of peak friction with load, worst", max(fall), "", Limit.at_most(0.0),
        "friction of rubber falls with load",
    )  # fmt: skip
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
    )  # fmt: skip


def _combined(result: StudyResult, tires: dict[str, Array]) -> None:
    slips = np.concatenate([-np.linspace(0.005, 0.5, 50)[::-1], np.linspace(0.0, 0.5, 51), [1.0]])
    filling, power = 0.0, math.inf
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
        "combined force over the ellipse, worst", filling, "", Limit.at_most(1.01),
        "the friction ellipse; cosine weights are no ellipse, 1 % is left to them",
    )  # fmt: skip
    result.find(
        "least slip power over load and speed", power, "", Limit.at_least(0.0),
        "a sliding tire takes energy out, whatever the slips",
    )  # fmt: skip


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
        )  # fmt: skip


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
            )  # fmt: skip
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
    )  # fmt: skip
    result.find(
        "forces not finite, also at rest", odd, "", Limit.at_most(0.0),
        "slip is never divided by speed, so standstill is no exception",
    )  # fmt: skip


def _golden(result: StudyResult, tires: dict[str, Array]) -> None:
    stored = golden_tire.read()
    other = mf.coefficients(stored["coefficients"]["adams"])
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
        )  # fmt: skip


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
    )  # fmt: skip


# --- what is shown ---


def _overview(tires: dict[str, Array]) -> Table:
    rows = []
    for axle, c in tires.items():
        for load in LOADS:
            Fz = load * c[mf.FNOMIN]
            sigma_x, sigma_y = mf.relaxation_lengths(c, Fz)
            rows.append(
                (
                    axle, Fz, peak(c, Fz, lateral=False), peak(c, Fz, lateral=True),
                    1e-3 * mf.slip_stiffness(c, Fz), 1e-3 * mf.cornering_stiffness(c, Fz),
                    1e3 * mf.pneumatic_trail(c, 0.0, Fz), sigma_x, sigma_y,
                )
            )  # fmt: skip
    header = (
        "tire", "load [N]", "mu x", "mu y", "Kx [kN]", "Ky [kN/rad]", "trail [mm]",
        "sigma x [m]", "sigma y [m]",
    )  # fmt: skip
    return Table("loads", "One tire at the loads of the sweeps", header, rows)


RATIOS = np.linspace(-0.3, 0.3, 121)
ANGLES = np.radians(np.linspace(-15.0, 15.0, 121))


def _curves(tires: dict[str, Array]) -> list[Series]:
    along: dict[str, Any] = {"slip_ratio": RATIOS}
    across: dict[str, Any] = {"slip_angle_deg": np.degrees(ANGLES)}
    for axle, c in tires.items():
        for load in LOADS:
            Fz = load * c[mf.FNOMIN]
            along[f"Fx_{axle}_{load:g}_N"] = sweep(c, RATIOS, Fz, lateral=False)[:, 0]
            forces = sweep(c, np.tan(ANGLES), Fz, lateral=True)
            across[f"Fy_{axle}_{load:g}_N"] = forces[:, 1]
            across[f"Mz_{axle}_{load:g}_Nm"] = forces[:, 2]
    return [Series("longitudinal", along), Series("lateral", across)]


@plots.styled
def _draw_slip(tires: dict[str, Array]) -> Any:
    figure, axes = plots.axes(2, 2, height=4.6)
    colours = (plots.SKY, plots.BLUE, plots.ORANGE)
    for axle, style in (("front", "-"), ("rear", (0, (4, 2)))):
        c = tires[axle]
        for load, colour in zip(LOADS, colours, strict=True):
            Fz = load * c[mf.FNOMIN]
            look = {"color": colour, "ls": style, "lw": 1.1 if axle == "front" else 0.8}
            name = {"label": f"{load:g} Fz0"} if axle == "front" else {}
            axes[0, 0].plot(
                100.0 * RATIOS, 1e-3 * sweep(c, RATIOS, Fz, lateral=False)[:, 0], **look, **name
            )
            forces = sweep(c, np.tan(ANGLES), Fz, lateral=True)
            axes[0, 1].plot(np.degrees(ANGLES), 1e-3 * forces[:, 1], **look)
            axes[1, 0].plot(np.degrees(ANGLES), forces[:, 2], **look)
        loads = np.linspace(0.2, 2.0, 40)
        for lateral, colour in ((False, plots.RED), (True, plots.GREEN)):
            mu = [mf.peak_friction(c, load * c[mf.FNOMIN])[int(lateral)] for load in loads]
            way = "lateral" if lateral else "longitudinal"
            axes[1, 1].plot(
                1e-3 * loads * c[mf.FNOMIN], mu, color=colour, ls=style, label=f"{way}, {axle}"
            )
    axes[1, 1].axhline(TABLE_2_MU, color=plots.GREY, lw=0.8, ls=":", label="Table 2")
    for name, _, kappa, alpha, Fx, Fy in golden_tire.read()["rows"]:
        if name != "front":
            continue
        if alpha == 0.0 and abs(kappa) <= 0.3:
            axes[0, 0].plot(100.0 * kappa, 1e-3 * Fx, "o", color="black", ms=2.2, zorder=5)
        if kappa == 0.0 and abs(alpha) <= 0.27:
            at = math.degrees(math.atan(alpha))
            axes[0, 1].plot(at, 1e-3 * Fy, "o", color="black", ms=2.2, zorder=5)
    plots.label(axes[0, 0], "slip ratio [%]", "Fx [kN]", "Longitudinal force")
    plots.label(axes[0, 1], "slip angle [deg]", "Fy [kN]", "Lateral force")
    plots.label(axes[1, 0], "slip angle [deg]", "Mz [N m]", "Aligning moment")
    plots.label(axes[1, 1], "load [kN]", "peak friction", "Load sensitivity")
    axes[0, 0].legend(loc="upper left")
    axes[1, 1].legend(loc="upper right", ncols=2)
    axes[1, 1].set_ylim(0.68, 0.96)
    return figure


@plots.styled
def _draw_combined(
    tires: dict[str, Array], steps: dict[str, tuple[Array, Array]], documented: dict[str, float]
) -> Any:
    figure, (left, right) = plots.axes(1, 2, height=3.0)
    c = tires["front"]
    Fz = c[mf.FNOMIN]
    mux, muy = mf.peak_friction(c, Fz)
    turn = np.linspace(0.0, math.pi, 181)
    left.plot(
        mux * np.cos(turn), muy * np.sin(turn), color=plots.RED, ls=(0, (4, 2)), lw=0.9,
        label="friction ellipse",
    )  # fmt: skip
    ratios = np.linspace(-0.5, 0.5, 401)
    colours = (plots.SKY, plots.GREEN, plots.BLUE, plots.ORANGE, plots.PINK)
    for angle, colour in zip((1.0, 2.0, 4.0, 8.0, 14.0), colours, strict=True):
        alpha = math.tan(math.radians(angle))
        forces = sweep(c, ratios, Fz, lateral=False, other=alpha) / Fz
        left.plot(forces[:, 0], forces[:, 1], color=colour, label=f"{angle:g} deg")
    plots.label(left, "Fx / Fz", "Fy / Fz", "Front tire, combined slip")
    left.set_aspect("equal")
    left.set_ylim(-0.02, 1.12)
    left.legend(loc="upper center", ncols=3)
    after_one = 1.0 - math.exp(-1.0)
    for (name, (distance, rise)), colour in zip(steps.items(), colours, strict=False):
        style = "-" if "lateral" in name else (0, (4, 2))
        right.plot(distance, 100.0 * rise, color=colour, ls=style, label=name)
        length = documented[name]
        right.plot(length, 100.0 * after_one, "o", color=colour, ms=3.5, mec="black", mew=0.5)
    plots.limit_line(right, 100.0 * after_one, "63 %; dots: after one length")
    right.set_xlim(0.0, 2.5)
    plots.label(right, "rolled distance [m]", "slip built up [%]", "Relaxation at 4 kN")
    right.legend(loc="lower right")
    return figure
