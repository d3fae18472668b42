"""What the numerical integration does to the car: convergence, chatter, energy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.params import VehicleParams
from lpvmpc.interface import Command
from lpvmpc.kit.findings import Limit, Table
from lpvmpc.picture import style
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import Snapshot
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.names import load_controller, load_scenario
from lpvmpc.studies.parts import chatter, energy
from lpvmpc.studies.parts.chatter import CHATTER, DEFAULT
from lpvmpc.studies.reference.circle_formulas import Linear
from lpvmpc.studies.study import CarUnderTest, Picture, Series, StudyResult
from lpvmpc.units import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Ts = 0.032
"""Control period of the convergence study [s]: all of its time steps divide it."""
STEPS = (0.002, 0.001, 0.0005, 0.00025, 0.000125)
"""Time steps [s], each half of the one before."""
INTEGRATORS = {
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
    "Euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicit": mujoco.mjtIntegrator.mjINT_IMPLICIT,
    "RK4": mujoco.mjtIntegrator.mjINT_RK4,
}
"""MuJoCo's integrators; the first is the model's own."""
GRIP = 0.8
"""Share of the grip used on the lap of the energy balance."""

METHOD = f"""\
**Convergence.** The same commands from the same state, integrated with time steps from
{1e3 * STEPS[0]:g} ms down to {1e3 * STEPS[-1]:g} ms: a lane change (one sine of steering, 20 m/s,
0.06 rad, or less for a car that this would bring beyond 0.77 of its lateral limit),
braking with 5 m/s2, and braking with 4 m/s2 out of a turn of 5 m/s2. The distance `d(h)` is how far
two cars with steps `h` and `h/2` are apart: root mean square over 2 s of position and velocity of
the centre of mass, the latter times 1 s. Order: `p(h) = log2(d(h)/d(h/2))`, so that no reference
run is needed. It is a limit, from which `p(h)` is off by what halves with the step: judged is
`2 p(h/2) - p(h)` of the four finest steps. Position error: against the limit `2 y(h/2) - y(h)` of
the two finest steps. Tire relaxation, servo and drive advance exactly for constant input, and
forces are held over a step, so all integrators are of first order here, RK4 included.

**Chatter.** The wheel accelerations of two successive steps differ by twice what alternates; its
root mean square over the second half of a second, after a small step of the drive, is *chatter*
above {CHATTER:g} m/s2. The onset is found by bisection of the time step. The closed form is the
linear map of slip speed and tire deflection over one step, for one wheel and a quarter of the car:
a root outside the unit circle is chatter. Below 2.5 m/s the tire is damped, which limits the step;
above, the relaxation length does.

**Energy.** A lap of `circuit` at {100 * GRIP:.0f} % of the grip, driven by the LPV-MPC; its
commands are then repeated and every physics step is written down. Forces are the engine's, the
velocities on which they act are computed anew from the coordinates, as means over the step. *Tire
slip* is the power of slip of all tires, aligning moment included, less what deforms their *carcass*
(force times rate of deflection, given back later). *Residual*: change of the stored energy less the
work of all powers since the start, largest magnitude over the lap, in percent of the throughput,
which is the work of the motor.

**Resolution.** The ideal world's closed loops, `lpv-mpc` as shipped, are driven again with a half
and a quarter of the physics step. What then changes is what the step does not resolve, and no
digit of an error below it is known: a tenth of a millimetre on the circuit.
"""


def run(car: CarUnderTest) -> StudyResult:
    """Order of convergence, onset of chatter, energy balance."""
    result = StudyResult("numerics", METHOD)
    _convergence(car, result)
    chatter.judge(car, result)
    _energy(car, result)
    _resolution(car, result)
    return result


# --- convergence ---


@dataclass(frozen=True)
class Manoeuvre:
    """Commands from a trimmed start."""

    name: str
    """What it is."""
    vx: float
    """Speed at the start [m/s]."""
    kappa: float
    """Curvature at the start [1/m]."""
    command: Callable[[float, Command], Command]
    """Command at a time [s], given the one that holds the start."""
    seconds: float = 2.048
    """How long."""


def manoeuvres(p: VehicleParams) -> tuple[Manoeuvre, ...]:
    """What is driven; no car is steered beyond 0.77 of its lateral limit, by the linear formula."""
    gain = float(Linear.of(p).yaw_gain(20.0))
    steer = min(0.06, 0.77 * p.ay_limit / (20.0 * gain))
    return (
        Manoeuvre(
            "lane change", 20.0, 0.0,
            lambda t, held: Command(steer * math.sin(2.0 * math.pi * t / 2.048), held.ax),
        ),
        Manoeuvre("braking", 20.0, 0.0, lambda t, held: Command(0.0, -5.0)),
        Manoeuvre(
            "braking in a turn", 15.0, 5.0 / 15.0**2, lambda t, held: Command(held.delta, -4.0)
        ),
    )


def orders(distances: Array) -> Array:
    """Observed orders log2(d(h)/d(h/2)) of successive distances, shape (n,) to (n - 1,)."""
    order: Array = np.log2(distances[:-1] / distances[1:])
    return order


def drive(
    plant: Plant, manoeuvre: Manoeuvre, start: Snapshot, held: Command, integrator: Any
) -> Array:
    """Position [m] and velocity [m/s] of the centre of mass after each control period, (n, 4)."""
    plant.model.opt.integrator = integrator
    plant.restore(start)
    rows = []
    for k in range(round(manoeuvre.seconds / Ts)):
        s = plant.step(manoeuvre.command(k * Ts, held))
        cos, sin = math.cos(s.psi), math.sin(s.psi)
        rows.append((s.x, s.y, cos * s.vx - sin * s.vy, sin * s.vx + cos * s.vy))
    return np.array(rows)


def apart(a: Array, b: Array) -> float:
    """Root mean square distance of two drives, their velocities times 1 s [m], each (n, 4)."""
    return math.sqrt(np.mean(np.sum((a - b) ** 2, axis=1)))


def _convergence(car: CarUnderTest, result: StudyResult) -> None:
    starter = car.plant(Ts=Ts)
    rows, curves = [], {}
    limits, largest_error, disagreement = [], 0.0, 0.0
    driven = manoeuvres(car.params)
    for manoeuvre in driven:
        starter.reset(vx=manoeuvre.vx, kappa=manoeuvre.kappa)
        start, held = starter.save(), Command(*map(float, starter.data.ctrl[:2]))
        limit: Array | None = None
        for name, integrator in INTEGRATORS.items():
            drives = [
                drive(car.plant(Ts=Ts, timestep=h), manoeuvre, start, held, integrator)
                for h in STEPS
            ]
            distances = np.array([apart(a, b) for a, b in zip(drives, drives[1:], strict=False)])
            tracks = [one[:, :2] for one in drives]
            extrapolated = 2.0 * tracks[-1] - tracks[-2]
            if limit is None:  # of the model's own integrator
                limit = extrapolated
            disagreement = max(disagreement, float(np.abs(extrapolated - limit).max()))
            errors = np.array([np.hypot(*(one - limit).T).max() for one in tracks])
            curves[manoeuvre.name, name] = errors
            order = orders(distances)
            limits.append(2.0 * float(order[-1]) - float(order[-2]))
            if name == "implicitfast":
                largest_error = max(largest_error, float(errors[STEPS.index(DEFAULT)]))
            rows.append((manoeuvre.name, name, *(1e3 * errors), float(order[0]), float(order[-1])))
    result.find(
        "order as the step goes to 0, worst", max(limits, key=lambda p: abs(p - 1.0)), "",
        Limit.near(1.0, 0.1),
        "first order by construction, see the method; 0.1 leaves room for the square of the step",
    )
    result.find(
        "position error at 1 ms", 1e3 * largest_error, "mm", Limit.at_most(10.0),
        "half the lateral RMSE that the paper reports, 21.7 mm: the step decides no comparison",
    )
    result.find(
        "integrators' limits apart", 1e3 * disagreement, "mm", Limit.at_most(0.1),
        "they integrate the same equations; extrapolation leaves a tenth of the error of the "
        "finest step, at most 1 mm",
    )
    header = ("manoeuvre", "integrator", *(f"{1e3 * h:g} ms" for h in STEPS), "coarse", "fine")
    caption = "Largest position error [mm] in 2 s; order of the three coarsest and finest steps"
    result.tables.append(Table("convergence", caption, header, rows))
    result.pictures.append(
        Picture(
            "convergence",
            "Largest position error over the time step, by manoeuvre and integrator (Euler and "
            "implicit lie on implicitfast), with the slope of first order and the limit at 1 ms.",
            _convergence_picture(curves, driven),
        )
    )


@style.styled
def _convergence_picture(
    curves: dict[tuple[str, str], Array], driven: tuple[Manoeuvre, ...]
) -> Figure:
    figure, axes = style.axes(1, len(driven), height=2.5, sharey=True)
    h = 1e3 * np.array(STEPS)
    looks = {
        "implicitfast": (style.BLUE, "o-"), "Euler": (style.SKY, "+-"),
        "implicit": (style.GREEN, "x-"), "RK4": (style.ORANGE, "s-"),
    }
    for axis, manoeuvre in zip(axes, driven, strict=True):
        for name, (color, dashes) in looks.items():
            errors = 1e3 * curves[manoeuvre.name, name]
            axis.loglog(h, errors, dashes, color=color, ms=3.5, lw=0.8, label=name)
        axis.loglog(h, 2.0 * h, color="black", lw=0.8, ls=":", label="first order")
        style.limit_line(axis, 10.0, "limit at 1 ms")
        style.label(axis, "time step [ms]", "", manoeuvre.name)
        axis.set_xticks(h, [f"{x:g}" for x in h], minor=False)
        axis.minorticks_off()
    axes[0].set_ylim(2e-3, 20.0)
    axes[0].set_ylabel("largest position error [mm]")
    axes[0].set_yticks((0.01, 0.1, 1.0, 10.0), ("0.01", "0.1", "1", "10"))
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=6)
    return figure


# --- energy ---


def _energy(car: CarUnderTest, result: StudyResult) -> None:
    scenario = load_scenario("circuit", grip=GRIP, params=car.params)
    controller = load_controller("lpv-mpc", stiffness="constant", car=car.params)
    log = simulate(car.plant(), controller, scenario)
    commands = np.stack([log.columns["delta_cmd_rad"], log.columns["ax_cmd_mps2"]], axis=1)
    plant = car.plant(Ts=DEFAULT)
    x, y, psi, kappa = (float(value) for value in scenario.path.at(0.0))
    plant.reset(x, y, psi, float(scenario.speed.at(0.0)), kappa=kappa, align="course")
    recording = energy.record(plant, commands, round(log.meta["Ts"] / DEFAULT))
    books = energy.ledger(plant, recording)
    throughput = books.work("drive")
    residual = books.residual()
    sigma = mf.relaxation_lengths(car.coefficients[0], car.coefficients[0][mf.FNOMIN])[0]
    stiffness = mf.slip_stiffness(car.coefficients[0], car.coefficients[0][mf.FNOMIN]) / sigma
    omega = car.params.R_w * math.sqrt(stiffness / car.params.J_w)
    result.find("lap driven", float(log.meta["completed"]), "", Limit.at_least(1.0),
                "a balance over a lap needs the lap")
    result.find(
        "energy residual over throughput", 100.0 * float(np.abs(residual).max()) / throughput, "%",
        Limit.at_most(100.0 * (DEFAULT * omega) ** 2 / 24.0),
        f"midpoint rule on the fastest mode, a wheel's spin at {omega:.0f} rad/s: (h omega)^2/24; "
        "1 % is what we promise",
    )
    result.find(
        "largest power of tire slip", float(books.flows[energy.SLIP].max()), "W",
        Limit.at_most(0.0), "sliding tires dissipate, at every instant",
    )
    result.find(
        "carcass, net over throughput", 100.0 * abs(books.work(energy.CARCASS)) / throughput, "%",
        Limit.at_most(0.1), "what the carcass takes up it gives back",
    )
    rows = [
        *((name, "power", books.work(name) / 1e3) for name in energy.FLOWS),
        *((name, "stored", books.change(name) / 1e3) for name in energy.STORES),
        ("residual at the end", "", float(residual[-1]) / 1e3),
    ]
    caption = "Energy over a lap of `circuit` [kJ]: work of each power, change of each store"
    result.tables.append(Table("energy", caption, ("what", "kind", "kJ"), rows))
    every = slice(None, None, 100)
    result.series.append(
        Series(
            "energy",
            {
                "t_s": books.t[every],
                "stored_J": books.stored()[every],
                "residual_J": residual[every],
                **{
                    f"{name.replace(' ', '_')}_J": _work_so_far(books, name)[every]
                    for name in energy.FLOWS
                },
            },
        )
    )
    result.pictures.append(
        Picture(
            "energy",
            "Energy of a lap: left, what the motor has put in and where it has gone; right, what "
            "the balance leaves unexplained, over the throughput, with the limit.",
            _energy_picture(books, result.findings[-3].limit.high),
        )
    )


def _work_so_far(books: energy.Ledger, name: str) -> Array:
    """Work of one power since the start [J], shape (n,)."""
    work: Array = np.concatenate([[0.0], np.cumsum(books.flows[name] * np.diff(books.t))])
    return work


@style.styled
def _energy_picture(books: energy.Ledger, limit: float) -> Figure:
    figure, (flow, rest) = style.axes(1, 2, height=2.7, width=style.DOUBLE)
    every = slice(None, None, 50)
    t = books.t[every]
    motor = _work_so_far(books, "drive")
    stored = books.stored() - books.stored().min()
    layers = {
        "brakes": ("brakes", style.RED),
        "rolling": ("rolling resistance", style.ORANGE),
        energy.SLIP: ("tire slip", style.BLUE),
        "air": ("air", style.SKY),
    }
    base = stored[every] / 1e3
    flow.fill_between(t, 0.0, base, color=style.GREY, alpha=0.4, lw=0, label="kinetic, above least")
    for name, (text, color) in layers.items():
        top = base - _work_so_far(books, name)[every] / 1e3
        flow.fill_between(t, base, top, color=color, alpha=0.75, lw=0, label=text)
        base = top
    flow.plot(t, (stored[0] + motor[every]) / 1e3, color="black", label="motor and start")
    style.label(flow, "time [s]", "energy [kJ]", "In and out")
    flow.set_xlim(0.0, t[-1])
    flow.set_ylim(0.0, None)
    flow.legend(loc="upper left")
    share = 100.0 * np.abs(books.residual()[every]) / motor[-1]
    rest.semilogy(t[1:], np.maximum(share[1:], 1e-9), color=style.BLUE, label="residual")
    style.limit_line(rest, limit)
    rest.axhline(1.0, color=style.GREY, lw=0.9, ls=":", label="1 %")
    style.label(rest, "time [s]", "residual over throughput [%]", "What is left over")
    rest.set_ylim(1e-8, 10.0)
    rest.set_yticks([10.0**k for k in range(-8, 2, 2)])
    rest.legend(loc="center", bbox_to_anchor=(0.7, 0.58))
    return figure


# --- resolution ---


def _resolution(car: CarUnderTest, result: StudyResult) -> None:
    """What is left of the ideal world's errors at a finer step; a table without a limit."""
    rows = []
    for title, name, grip in (("paper", "paper", None), ("circuit 65 %", "circuit", 0.65)):
        scenario = load_scenario(name, grip=grip)
        cells: list[float | str] = []
        for step in (0.001, 0.0005, 0.00025):
            controller = load_controller("lpv-mpc", car=car.params)
            log = simulate(car.plant(timestep=step), controller, scenario)
            ey = log.columns["ey_m"]
            lost = not log.meta["completed"]
            cells.append("lost" if lost else 1e3 * math.sqrt(float(np.mean(ey**2))))
            cells.append("lost" if lost else 1e3 * float(np.abs(ey).max()))
        rows.append((title, *cells))
    header = ("road", "RMSE at 1 ms", "largest", "at 0.5 ms", "largest", "at 0.25 ms", "largest")
    caption = "Lateral error of `lpv-mpc` in the ideal world by physics step [mm]"
    result.tables.append(Table("resolution", caption, header, rows))
