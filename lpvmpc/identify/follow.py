"""The plant driven by a recording: its steering at the knuckle, its speed followed.

The steering servo is bypassed: in a copy of the compiled model its time constant is set to nothing
and its rate limit is lifted, so that the knuckles stand at the recorded angle at the end of each
physics step. Between samples the angle is linear in time, or moves as a servo does (`Steering`), or
is held where the recording holds it.
The speed is followed by the car's own driven wheels and brakes, without lag and with limits lifted
("wheels"), or by a force on the whole car at the height of the road ("force"), which leaves the
tires to the side forces.

Many cars are driven by the same recording at once, each by a model of its own (`mujoco.rollout`):
that gives a fit its differences.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout
from scipy.signal import lfilter

from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.identify.recording import Recording
from lpvmpc.kit.cli import cores
from lpvmpc.plant import callbacks
from lpvmpc.plant.mjcf import numeric, parameters
from lpvmpc.plant.motion import PSI, VX, VY, R, X, Y, mass_layout, planar_motion
from lpvmpc.plant.rollout import DRIVE, SPIN_QVEL, STEER
from lpvmpc.units import Array

FOLLOW = ("wheels", "force")
"""What follows the speed."""
CHUNK = 20
"""Physics steps between two looks at the speed."""
HOLD = 1.5
"""Time for which the car is held at the recording's first speed and yaw rate [s], so that springs
and tires are settled when it is let go."""
INSTANT = 1e-9
"""Time constant of a lag that is none [s]."""
GAIN, RESET = 5.0, 6.0
"""Of the control of the speed: proportional [1/s] and integral [1/s2]."""
GRIP, GRIP_RESET = 20.0, 100.0
"""Of the hold before the start, on side speed and yaw rate."""
CONTROL = int(mujoco.mjtState.mjSTATE_CTRL.value | mujoco.mjtState.mjSTATE_QFRC_APPLIED.value)
"""What is given at each step: controls and applied forces."""


@dataclass(frozen=True, kw_only=True)
class Steering:
    """What lies between the recorded angle and the knuckle."""

    ratio: float = 1.0
    """Angle at the knuckle per recorded one [-]."""
    offset: float = 0.0
    """Angle at the knuckle where zero is recorded [rad]."""
    lag: float = 0.0
    """Time constant of a first-order lag [s]."""
    latency: float = 0.0
    """Time by which the knuckle is late [s]; negative where the recording is."""
    servo: float = 0.0
    """Time constant with which the knuckle goes from sample to sample [s], as that of a servo whose
    command is held meanwhile; 0: straight lines."""

    def angle(self, recording: Recording, times: Array) -> Array:
        """Angle at the knuckle at times [s] that are equally spaced, shape (k,)."""
        wanted = recording.steering(times - self.latency, self.servo)
        if self.lag > 0.0 and len(times) > 1:
            keep = float(np.exp(-(times[1] - times[0]) / self.lag))
            wanted = lfilter([1.0 - keep], [1.0, -keep], wanted, zi=[keep * wanted[0]])[0]
        return self.ratio * wanted + self.offset


@dataclass(frozen=True, kw_only=True)
class Push:
    """A side force and a yaw moment over time that no column records, wind say."""

    t: Array
    """Times from the start of the recording [s], shape (n,)."""
    force: Array
    """Side force at the centre of mass, left positive [N], shape (n,)."""
    moment: Array
    """Yaw moment [N m], shape (n,)."""
    source: str = ""
    """Name of the recording that it was identified on."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """What the plants did, at the recording's times; shapes (N, n)."""

    vx: Array
    """Longitudinal speed [m/s]."""
    vy: Array
    """Lateral speed of the centre of mass [m/s]."""
    r: Array
    """Yaw rate [rad/s]."""
    ax: Array
    """Longitudinal acceleration [m/s2]."""
    ay: Array
    """Lateral acceleration [m/s2]."""
    x: Array
    """Position along the first heading [m], from the start."""
    y: Array
    """Position to the left of it [m]."""
    psi: Array
    """Heading from the start [rad]."""


def prepared(model: mujoco.MjModel, follow: str = "wheels") -> mujoco.MjModel:
    """A copy of a compiled car whose servo and drive do at once what they are told.

    Raises:
        OptionError: `follow` is none of `FOLLOW`.
    """
    if follow not in FOLLOW:
        raise OptionError("follow", follow, " or ".join(FOLLOW))
    out = copy.copy(model)
    out.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    out.numeric("steering").data[:] = INSTANT, 1e9, 1.5
    power = out.numeric("powertrain").data
    power[0] = INSTANT
    power[1:4] *= 1e3
    return out


@dataclass(frozen=True, kw_only=True)
class _Wish:
    """What is asked of N cars at each physics step; times run from the hold on."""

    times: Array
    """Ends of the steps [s], shape (steps,)."""
    held: int
    """Steps of the hold."""
    delta: Array
    """Knuckle angle [rad], shape (N, steps)."""
    vx: Array
    """Speed [m/s], shape (steps,)."""
    ax: Array
    """Its derivative [m/s2], shape (steps,)."""
    force: Array
    """Side force [N], shape (N, steps)."""
    moment: Array
    """Yaw moment [N m], shape (N, steps)."""

    def held_at(self, recording: Recording, k: int, vy: Array) -> Array:
        """Side speed and yaw rate at which N cars of side speeds vy are held, shape (N, 2).

        Those recorded, smoothed before the start; a side speed that was not recorded is let be.
        """
        out = np.empty((len(vy), 2))
        for j, values in enumerate((recording.vy, recording.r)):
            if values is None:
                out[:, j] = vy
            elif k < self.held:
                out[:, j] = recording.first(values)
            else:  # what was looked at is the end of the step before
                out[:, j] = np.interp(self.times[k - 1], recording.t, values)
        return out


class _Cars:
    """N cars of one kind and what is needed to look at their motion."""

    def __init__(self, models: Sequence[mujoco.MjModel], follow: str, vx: float) -> None:
        self.models = [prepared(model, follow) for model in models]
        first = self.models[0]
        self.N, self.nq, self.nv, self.nu = len(self.models), first.nq, first.nv, first.nu
        self.layouts = [mass_layout(model) for model in self.models]
        self.com = np.stack([com for _, com in self.layouts])  # (N, 3)
        chassis = first.body("chassis").id
        self.mass = np.array([model.body_subtreemass[chassis] for model in self.models])
        self.inertia = np.array([_yaw_inertia(model) for model in self.models])
        self.state = np.stack([_rolling(model, vx) for model in self.models])

    def look(self, states: Array, out: Array) -> None:
        """Planar motion of full physics states, shapes (N, size) and (N, 8)."""
        for i in range(self.N):
            row = states[i]
            qpos, qvel = row[1 : 1 + self.nq], row[1 + self.nq : 1 + self.nq + self.nv]
            planar_motion(qpos, qvel, *self.layouts[i], out[i])


def replay(
    models: Sequence[mujoco.MjModel],
    recording: Recording,
    steering: Sequence[Steering] | None = None,
    *,
    follow: str = "wheels",
    push: Push | Sequence[Push] | None = None,
    turning: bool = False,
    threads: int = 0,
    pulls: list[Array] | None = None,
) -> Motion:
    """Drive cars by one segment of a recording.

    Each is held at the first speed, yaw rate and (if it was measured) side speed for `HOLD` before
    it is let go, so that springs and tires are settled.

    Args:
        models: N compiled cars.
        recording: A segment, without gaps.
        steering: Between recorded angle and knuckle, of each car (default: nothing).
        follow: "wheels" or "force".
        push: Side force and yaw moment besides, of all cars or of each; held at its ends.
        turning: Whether the knuckle, while the car is held, stands at the angle of the steady turn
            at its yaw rate, instead of the first recorded one: for a recording that begins as the
            wheel is turned.
        threads: Number of threads, 0 for one per core.
        pulls: Where given, the cars are held at the recorded side speed and yaw rate all along, and
            the pulls that it took are appended, chunk by chunk: side force over mass, moment over
            inertia, shape (N, 2).

    Raises:
        LPVMPCError: A car cannot follow: it spins, falls over, or diverges.
    """
    callbacks.install()
    N = len(models)
    dt = float(models[0].opt.timestep)
    wish = _wish(recording, dt, list(steering or [Steering()] * N), push)
    cars = _Cars(models, follow, wish.vx[0])
    if turning:
        wish.delta[:, : wish.held] = _steady_angles(models, recording)[:, None]
    # samples lie between two steps, whose ends are both kept
    at = (recording.t - recording.t[0]) / dt + wish.held
    before = np.floor(at + 1e-9).astype(int)
    needed = np.unique(np.concatenate([before - 1, before]))  # rows of results
    kept = np.empty((len(needed), N, 8))
    origin, now = np.empty((N, 8)), np.zeros((N, 8))
    control = np.zeros((N, CHUNK, cars.nu + cars.nv))
    out = np.empty((N, CHUNK, cars.state.shape[1]))
    sensors = np.empty((N, CHUNK, models[0].nsensordata))
    sums = np.zeros((N, 3))
    count = min(threads or cores(), N)
    datas = [mujoco.MjData(cars.models[0]) for _ in range(count)]
    with rollout.Rollout(nthread=count if count > 1 else 0) as engine:
        for k in range(0, len(wish.times), CHUNK):
            cars.look(cars.state, now)
            if not (np.abs(now[:, VY]) < 2.0 * now[:, VX] + 5.0).all():  # NaN fails too
                raise LPVMPCError(
                    f"A car does not follow {recording.name}: it has spun, fallen over or diverged "
                    f"at {wish.times[k]:.2f} s."
                )
            if k == wish.held:
                origin[:] = now
            pull = _control(
                control, wish, k, cars, now, sums, recording, dt, follow, pulls is not None
            )
            if pulls is not None and k >= wish.held:
                pulls.append(pull)
            engine.rollout(
                cars.models, datas, cars.state, control, control_spec=CONTROL, nstep=CHUNK,
                state=out, sensordata=sensors, skip_checks=True, chunk_size=1,
            )
            for j in range(*np.searchsorted(needed, (k, k + CHUNK))):
                cars.look(out[:, needed[j] - k], kept[j])
            cars.state = out[:, -1].copy()
    return _sampled(kept.swapaxes(0, 1), needed, before, at, dt, origin)


def first_of(recording: Recording, seconds: float) -> Recording:
    """The beginning of a recording."""
    return recording.rows(0, int(np.searchsorted(recording.t, recording.t[0] + seconds)))


def _steady_angles(models: Sequence[mujoco.MjModel], recording: Recording) -> Array:
    """Angles [rad] at which each car turns steadily at the first speed and yaw rate, shape (N,).

    delta = r (L + K vx^2) / vx,   K = m (lr / Cf - lf / Cr) / L
    """
    vx, r = max(float(recording.speed(recording.t[:1])[0][0]), 1.0), recording.first(recording.r)
    angles = []
    for p in map(parameters, models):
        K = p.m / p.wheelbase * (p.lr / p.Cf - p.lf / p.Cr)
        angles.append(r * (p.wheelbase + K * vx * vx) / vx)
    return np.array(angles)


def _wish(
    recording: Recording, dt: float, laws: Sequence[Steering], push: Push | Sequence[Push] | None
) -> _Wish:
    held = round(HOLD / dt / CHUNK) * CHUNK
    last = int(np.ceil((recording.t[-1] - recording.t[0]) / dt - 1e-9)) + 1
    steps = held + -(-last // CHUNK) * CHUNK
    times = recording.t[0] + dt * (np.arange(1, steps + 1) - held)
    vx, ax = recording.speed(times)
    each = [push] * len(laws) if isinstance(push, Push) or push is None else list(push)
    side = [
        np.zeros((2, steps)) if one is None
        else np.stack([np.interp(times, one.t, one.force), np.interp(times, one.t, one.moment)])
        for one in each
    ]
    return _Wish(
        times=times, held=held, delta=np.stack([law.angle(recording, times) for law in laws]),
        vx=vx, ax=ax, force=np.stack([one[0] for one in side]),
        moment=np.stack([one[1] for one in side]),
    )


def _control(
    control: Array, wish: _Wish, k: int, cars: _Cars, now: Array, sums: Array,
    recording: Recording, dt: float, follow: str, always: bool,
) -> Array:
    """Controls and applied forces of the steps from k on, in place, shape (N, CHUNK, nu + nv).

    Returns the accelerations (N, 2) by which the cars are held, sideways and in yaw.
    """
    pull = np.zeros((cars.N, 2))
    part = slice(k, k + CHUNK)
    missing = wish.vx[k] - now[:, VX]
    sums[:, 0] += RESET * dt * CHUNK * missing
    ax = wish.ax[part] + (GAIN * missing + sums[:, 0] - now[:, R] * now[:, VY])[:, None]
    Fy, Mz = wish.force[:, part].copy(), wish.moment[:, part].copy()
    if k < wish.held or always:
        wrong = wish.held_at(recording, k, now[:, VY]) - now[:, [VY, R]]
        sums[:, 1:] += GRIP_RESET * dt * CHUNK * wrong
        pull = GRIP * wrong + sums[:, 1:]
        Fy += (cars.mass * pull[:, 0])[:, None]
        Mz += (cars.inertia * pull[:, 1])[:, None]
    control[:] = 0.0
    control[:, :, STEER] = wish.delta[:, part]
    if follow == "wheels":
        control[:, :, DRIVE] = ax
        ax = np.zeros_like(ax)
    _wrench(control[:, :, cars.nu :], now, cars.com, cars.mass[:, None] * ax, Fy, Mz, dt,
            cars.state[:, 3])
    return pull


def _rolling(model: mujoco.MjModel, vx: float) -> Array:
    """Full physics state of a car that rolls straight ahead, shape (size,)."""
    spec = int(mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    data = mujoco.MjData(model)
    data.qvel[0] = vx
    data.qvel[list(SPIN_QVEL)] = vx / float(numeric(model, "wheel")[0])
    state = np.empty(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, data, state, spec)
    return state


def _yaw_inertia(model: mujoco.MjModel) -> float:
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    return float(inertia[5, 5])


def _wrench(
    qfrc: Array, now: Array, com: Array, Fx: Array, Fy: Array, Mz: Array, dt: float, z: Array
) -> None:
    """Forces along and to the left of each car, and a yaw moment, as generalised forces in place.

    The side force acts at the centre of mass, Fx below it on the road. The heading goes on turning
    within the chunk.
    """
    steps = np.arange(qfrc.shape[1])
    psi = now[:, PSI, None] + now[:, R, None] * dt * steps
    c, s = np.cos(psi), np.sin(psi)
    qfrc[:, :, 0] = c * Fx - s * Fy
    qfrc[:, :, 1] = s * Fx + c * Fy
    # lever x force about the chassis origin, in axes that only yaw
    qfrc[:, :, 3] = -com[:, 2, None] * Fy
    qfrc[:, :, 4] = -z[:, None] * Fx
    qfrc[:, :, 5] = com[:, 0, None] * Fy - com[:, 1, None] * Fx + Mz


def _sampled(
    kept: Array, needed: Array, before: Array, wanted: Array, dt: float, origin: Array
) -> Motion:
    """Motion at the samples, linear between the two steps around each."""
    at = np.searchsorted(needed, before - 1)
    one, two = kept[:, at], kept[:, at + 1]  # after steps before and before + 1
    share = (wanted - before)[None, :]
    rate = (two - one) / dt
    rate[:, :, PSI] = np.remainder(two[:, :, PSI] - one[:, :, PSI] + np.pi, 2 * np.pi) - np.pi
    mid = one + share[:, :, None] * (two - one)
    psi = np.unwrap(np.concatenate([origin[:, PSI, None], one[:, :, PSI]], axis=1), axis=1)
    psi = psi[:, 1:] - psi[:, :1] + share * rate[:, :, PSI]
    dx, dy = mid[:, :, X] - origin[:, X, None], mid[:, :, Y] - origin[:, Y, None]
    c, s = np.cos(origin[:, PSI, None]), np.sin(origin[:, PSI, None])
    vx, vy, r = mid[:, :, VX], mid[:, :, VY], mid[:, :, R]
    return Motion(
        vx=vx, vy=vy, r=r,
        ax=rate[:, :, VX] - r * vy, ay=rate[:, :, VY] + r * vx,
        x=c * dx + s * dy, y=c * dy - s * dx, psi=psi,
    )
