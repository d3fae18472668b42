"""What is driven to learn the tires: manoeuvres by kind, drawn at random, on the MuJoCo car.

A manoeuvre is drawn from a generator and driven for `ROWS` control periods, or until the car leaves
the domain in which an axle's lateral force is a function of slip, drive force and load: slip angles
up to `ALPHA_MAX`, no wheel past the slip ratio of its grip peak, at least `VX_LOW`. All kinds reach
the grip limit, turn both ways, and feel wind in every second run.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from lpvmpc.car.current import per_car
from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import OptionError
from lpvmpc.interface import Command, State, declared
from lpvmpc.learn.dataset import Instant
from lpvmpc.plant import callbacks
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.plant.plant import Plant
from lpvmpc.units import GRAVITY, Array

if TYPE_CHECKING:
    from lpvmpc.interface import Controller
    from lpvmpc.road.path import Path
    from lpvmpc.road.speed_profile import SpeedProfile

ROWS = 128
"""Control periods recorded per run at most (4.2 s)."""
LEAD_IN = 30
"""Control periods of straight driving before them: suspension and wind settle (1 s)."""
VX_LOW, VX_HIGH = 3.0, 30.0
"""Speeds of the data [m/s]."""
ALPHA_MAX = 0.25
"""Largest slip angle of an axle [rad]; beyond it a run ends."""
SLIP_RATIO_MAX = 0.15
"""Slip ratio of the tires' peak at friction 1; a wheel beyond it spins or locks, and a run ends."""
WIND_MAX = 40.0
"""Strongest side wind [m/s]."""
RESOLUTION = 2.0**-20
"""Resolution of the commands on driven laps [rad, m/s2]: a millionth."""
LAP_TRACKS = ("tuning-a", "tuning-b")
"""Tracks of the driven laps: never the ones that results are reported on."""
LAP_FORMULATIONS = ("full", "paper")
"""Controllers of the driven laps: the LPV-MPC in full, and in the paper's plain formulation."""


class Driver(Protocol):
    """Commands of a running manoeuvre."""

    def __call__(self, k: int, state: State) -> Command:
        """Command of period k (negative in the lead-in) at a state."""


@dataclass(frozen=True)
class Start:
    """Where a manoeuvre begins."""

    vx: float
    """Speed [m/s]."""
    x: float = 0.0
    """Position [m]."""
    y: float = 0.0
    """Position [m]."""
    psi: float = 0.0
    """Heading [rad]."""


Draw = Callable[[np.random.Generator, VehicleParams, float, float, float], tuple[Start, Driver]]
"""Draws a manoeuvre from (rng, car, friction scale, severity 0..1, control period)."""


# Open loop: steering over time, speed held or changed ---------------------------------------------


class OpenLoop:
    """Steering and acceleration as functions of time, with a speed controller beneath."""

    def __init__(self, vx: float, delta: Array, ax: Array, hold: Array):
        """Args: speed to hold [m/s], commands [rad, m/s2], where it is held, all (ROWS,)."""
        self.vx, self.delta, self.ax, self.hold = vx, delta, ax, hold

    def __call__(self, k: int, state: State) -> Command:
        """See `Driver`."""
        keep = 1.5 * (self.vx - state.vx)
        keep = min(max(keep, -3.0), 3.0)
        if k < 0:
            return Command(0.0, keep)
        return Command(float(self.delta[k]), float(self.ax[k]) + (keep if self.hold[k] else 0.0))


def steer_for(ay_share: float, vx: float, car: VehicleParams, friction: float) -> float:
    """Steering angle that brings about a share of the largest lateral acceleration [rad].

    delta = L kappa + K ay + e: kinematic and linear understeer, and from 60 % of the limit on the
    growing slip of the saturating front tires (0.13 rad at 120 %).
    """
    ay = ay_share * car.ay_limit * friction
    K = car.m / car.wheelbase * (car.lr / car.Cf - car.lf / car.Cr)
    slip = 0.22 * max(ay_share - 0.6, 0.0) * friction
    return min(ay / vx**2 * car.wheelbase + K * ay + slip, 0.9 * car.delta_max)


def _speed(rng: np.random.Generator, low: float = VX_LOW + 0.5, high: float = VX_HIGH) -> float:
    return float(rng.uniform(low, high))


def _share(rng: np.random.Generator, severity: float, low: float = 0.1) -> float:
    """Share of the lateral grip, up to 1.2 at full severity."""
    return float(rng.uniform(low, max(1.2 * severity, low + 0.1)))


def _times(Ts: float) -> Array:
    return np.arange(ROWS, dtype=np.float64) * Ts


def _open(vx: float, delta: Array, ax: Array | None = None, hold: Array | None = None):
    ax = np.zeros(ROWS) if ax is None else ax
    hold = np.ones(ROWS, dtype=bool) if hold is None else hold
    return Start(vx), OpenLoop(vx, delta, ax, hold)


def _side(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def step_steer(rng, car, friction, severity, Ts):
    """Steps of the steering to two levels, one after the other."""
    vx, t = _speed(rng), _times(Ts)
    first, second = (_side(rng) * steer_for(_share(rng, severity), vx, car, friction)
                     for _ in range(2))
    switch = rng.uniform(1.5, 2.6)
    return _open(vx, np.where(t < 0.3, 0.0, np.where(t < switch, first, second)))


def ramp_steer(rng, car, friction, severity, Ts):
    """A slow ramp of the steering up to and past the grip limit."""
    vx, t = _speed(rng), _times(Ts)
    end = steer_for(max(_share(rng, severity), 0.5 * severity), vx, car, friction)
    return _open(vx, _side(rng) * end * t / t[-1])


def sine_sweep(rng, car, friction, severity, Ts):
    """A sine of constant amplitude whose frequency rises to 1-3 Hz."""
    vx, t = _speed(rng), _times(Ts)
    low, high = rng.uniform(0.2, 0.5), rng.uniform(1.0, 3.0)
    phase = 2.0 * math.pi * (low * t + 0.5 * (high - low) * t * t / t[-1])
    amplitude = steer_for(_share(rng, severity), vx, car, friction)
    return _open(vx, _side(rng) * amplitude * np.sin(phase))


def sine_dwell(rng, car, friction, severity, Ts):
    """FMVSS 126: a sine of 0.7 Hz that dwells for 0.5 s at its second peak."""
    vx, t = _speed(rng, 8.0), _times(Ts)
    frequency = rng.uniform(0.5, 0.9)
    pause = 0.75 / frequency  # of the second peak
    shifted = np.where(t < pause, t, np.maximum(t - 0.5, pause))
    wave = np.where(shifted < 1.0 / frequency, np.sin(2.0 * math.pi * frequency * shifted), 0.0)
    amplitude = steer_for(_share(rng, severity), vx, car, friction)
    return _open(vx, _side(rng) * amplitude * wave)


def multi_sine(rng, car, friction, severity, Ts):
    """Steering, drive and brake as sums of sines of random phase."""
    vx, t = _speed(rng, 5.0, 27.0), _times(Ts)
    amplitude = steer_for(_share(rng, severity), vx, car, friction)
    delta = amplitude * _waves(rng, t, 0.15, 1.8)
    ax = rng.uniform(0.5, 0.4 * GRAVITY * friction * severity) * _waves(rng, t, 0.15, 0.8)
    return _open(vx, delta, ax)


def _waves(rng: np.random.Generator, t: Array, low: float, high: float) -> Array:
    """Sum of six sines with a largest value of one."""
    f = np.geomspace(low, high, 6)[:, None]
    wave = np.sin(2.0 * math.pi * (f * t + rng.uniform(0.0, 1.0, (6, 1)))).sum(axis=0)
    return wave / np.abs(wave).max()


def lane_change(rng, car, friction, severity, Ts):
    """One or two periods of a sine, back into the old lane or not."""
    vx, t = _speed(rng, 6.0), _times(Ts)
    period, pause = rng.uniform(1.2, 2.2), rng.uniform(0.0, 0.6)
    amplitude = _side(rng) * steer_for(_share(rng, severity), vx, car, friction)
    back = -1.0 if rng.random() < 0.6 else 0.0
    first, second = t - 0.2, t - 0.2 - period - pause
    wave = np.where((first > 0) & (first < period), np.sin(2.0 * math.pi * first / period), 0.0)
    wave += back * np.where(
        (second > 0) & (second < period), np.sin(2.0 * math.pi * second / period), 0.0
    )
    return _open(vx, amplitude * wave)


def brake_in_turn(rng, car, friction, severity, Ts):
    """Into a turn at constant speed, then braking, suddenly or slowly, up to the grip limit."""
    vx, t = _speed(rng, 8.0), _times(Ts)
    share = min(_share(rng, severity), 1.05)
    brake = rng.uniform(0.2, 1.1) * _left_over(share) * severity * car.mu * GRAVITY * friction
    return _turn_then(rng, t, vx, share, -brake, car, friction)


def accelerate_in_turn(rng, car, friction, severity, Ts):
    """Into a turn at constant speed, then accelerating up to what motor or grip allow."""
    vx, t = _speed(rng, 4.0, 25.0), _times(Ts)
    share = min(_share(rng, severity), 1.05)
    drive = rng.uniform(0.2, 1.1) * _left_over(share) * severity * 0.5 * car.mu * GRAVITY * friction
    return _turn_then(rng, t, vx, share, min(drive, car.ax_max(vx)), car, friction)


def _left_over(share: float) -> float:
    """Longitudinal grip that a share of the lateral one leaves, by the friction circle."""
    return math.sqrt(max(1.0 - (share / 1.1) ** 2, 0.1))


def _turn_then(rng, t, vx, share, ax, car, friction):
    """Into a turn within 0.7 s, then an acceleration that builds up over 0.1 to 2 s."""
    begin, rise = rng.uniform(0.9, 1.8), rng.uniform(0.1, 2.0)
    steer = np.clip(t / 0.7, 0.0, 1.0) * _side(rng) * steer_for(share, vx, car, friction)
    return _open(vx, steer, ax * np.clip((t - begin) / rise, 0.0, 1.0), t < begin)


# Closed loop: laps -------------------------------------------------------------------------------


class Lap:
    """A controller on a road."""

    def __init__(
        self, controller: Controller, path: Path, speed: SpeedProfile, s: float, Ts: float
    ):
        """Args: who drives, where, how fast, from which arc length [m], control period [s]."""
        self.controller, self.path, self.speed, self.s, self.Ts = controller, path, speed, s, Ts
        self.steps = declared(controller).preview_steps
        self.lost = False
        controller.reset(np.random.default_rng(0))

    def __call__(self, k: int, state: State) -> Command:
        """See `Driver`."""
        vx, spacing = self.speed.vx, self.speed.spacing
        p = self.path.preview(
            state.x, state.y, state.psi, self.s, vx, spacing, self.steps, self.Ts
        )
        self.s = p.s
        self.lost = abs(p.ey) > 3.0 or abs(p.epsi) > 1.0
        delta, ax = self.controller.command(state, p)
        # a QP solver's last bits depend on where its memory lies: they must not reach the data
        return Command(round(delta / RESOLUTION) * RESOLUTION, round(ax / RESOLUTION) * RESOLUTION)


def lap(rng, car, friction, severity, Ts):
    """A piece of a lap of a tuning track by one of the controllers, at 40-105 % of the grip."""
    from lpvmpc.road.speed_profile import SpeedProfile

    path, s, vx, straight = _track(LAP_TRACKS[int(rng.integers(len(LAP_TRACKS)))])
    driver = _controller(LAP_FORMULATIONS[int(rng.integers(len(LAP_FORMULATIONS)))])
    share = rng.uniform(0.4, max(1.05 * severity, 0.5))
    speed = SpeedProfile.from_knots(s, np.minimum(vx * math.sqrt(share * friction), 28.0), path)
    begin = float(straight[int(rng.integers(len(straight)))])
    x, y, psi, _ = (float(value) for value in path.at(begin))
    return Start(float(speed.at(begin)), x, y, psi), Lap(driver, path, speed, begin, Ts)


@per_car
def _track(name: str) -> tuple[Path, Array, Array, Array]:
    """Path, knots and speeds at the full lateral grip, and arc lengths of straight places."""
    from lpvmpc.sim.names import load_scenario

    scenario = load_scenario(name, grip=0.75, v_max=28.0)
    path = scenario.path
    s = np.arange(0.0, path.length, 2.0)
    kappa = np.asarray(path.at(s)[3])
    straight = s[(np.abs(kappa) < 1e-3) & (s < path.length - 120.0)]
    return path, s, np.asarray(scenario.speed.at(s)) / math.sqrt(0.75), straight


@per_car
def _controller(name: str) -> Controller:
    """One of `LAP_FORMULATIONS`, with weights set by hand and constant stiffness.

    So the data change neither when the controllers are tuned nor when a network is trained.
    """
    from lpvmpc.control.cost import NERVOUS_WEIGHTS, PAPER_WEIGHTS
    from lpvmpc.control.formulation import PAPER, Formulation
    from lpvmpc.control.lpv_mpc import LPVMPC
    from lpvmpc.control.stiffness.models import ConstantStiffness

    car = packaged_car()
    stiffness = ConstantStiffness(car)
    if name == "paper":
        return LPVMPC(car, stiffness=stiffness, formulation=PAPER, weights=PAPER_WEIGHTS)
    # As the networks' data were driven: these parts came later. And without traction control, since
    # the data shall hold spinning wheels as well.
    full = Formulation(
        decoupled=False, approach=False, steering=False, noise=False, drive_on=False,
        traction=False, damped=False,
    )
    return LPVMPC(car, stiffness=stiffness, formulation=full, weights=NERVOUS_WEIGHTS)


KINDS: dict[str, Draw] = {
    "step-steer": step_steer,
    "ramp-steer": ramp_steer,
    "sine-sweep": sine_sweep,
    "sine-dwell": sine_dwell,
    "multi-sine": multi_sine,
    "lane-change": lane_change,
    "brake-in-turn": brake_in_turn,
    "accelerate-in-turn": accelerate_in_turn,
    "lap": lap,
}
"""Kinds of manoeuvres by name."""


# Driving -----------------------------------------------------------------------------------------


def drive(
    plant: Plant, kind: str, rng: np.random.Generator, *, friction: float, severity: float = 1.0
) -> list[Instant]:
    """Draw a manoeuvre and drive it until its end, or until the car leaves the domain.

    Args:
        plant: The car; reset here.
        kind: A name of `KINDS`.
        rng: Where all that is random comes from.
        friction: Scale of the road's peak friction.
        severity: Up to which share of the grip amplitudes are drawn, 0 to 1.

    Returns:
        The rows after the lead-in, at most `ROWS`.

    Raises:
        OptionError: No such kind, or a severity outside its domain.
    """
    if kind not in KINDS:
        raise OptionError("kind", kind, f"one of {', '.join(KINDS)}")
    if not 0.1 <= severity <= 1.0:
        raise OptionError("severity", severity, "a number from 0.1 to 1")
    start, driver = KINDS[kind](rng, plant.params, friction, severity, plant.Ts)
    wind = _gusts(rng, plant.Ts)
    plant.friction = friction
    state = plant.reset(start.x, start.y, start.psi, start.vx, trim=False)
    rows: list[Instant] = []
    for k in range(-LEAD_IN, ROWS):
        blow = wind[k + LEAD_IN]
        air = blow * math.sin(state.psi), -blow * math.cos(state.psi)
        state = plant.step(driver(k, state), air)
        outputs = plant.data.userdata.copy()
        if leaves_domain(state, outputs, friction) or getattr(driver, "lost", False):
            break
        if k >= 0:
            rate, drive_ax = float(plant.data.qvel[3]), float(plant.data.act[1])
            rows.append(Instant(state, outputs, blow, plant.roll, rate, drive_ax))
    return rows


def _gusts(rng: np.random.Generator, Ts: float) -> Array:
    """Side wind over a run with its lead-in [m/s]: none, or a mean and a slow wave."""
    t = np.arange(LEAD_IN + ROWS) * Ts
    strength, frequency, phase = rng.uniform(-1.0, 1.0), rng.uniform(0.1, 0.5), rng.uniform()
    if rng.random() < 0.5:
        return np.zeros(len(t))
    rise = np.minimum(t / (LEAD_IN * Ts), 1.0)
    wave = 0.7 + 0.3 * np.sin(2.0 * math.pi * (frequency * t + phase))
    return strength * WIND_MAX * rise * wave


def leaves_domain(state: State, outputs: Array, friction: float) -> bool:
    """Whether the car is where a force is no longer a function of slip, drive force and load."""
    if state.vx < VX_LOW or state.vx > VX_HIGH + 1.0:
        return True
    slip = max(abs(outputs[callbacks.ALPHA_F]), abs(outputs[callbacks.ALPHA_R]))
    ratio = np.abs(outputs[callbacks.SLIP_RATIO : callbacks.SLIP_RATIO + 4]).max()
    return slip > ALPHA_MAX or ratio > SLIP_RATIO_MAX * friction
