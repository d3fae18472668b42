"""The car: a MuJoCo multibody model with Pacejka tires, driven by commands."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt
from numba import njit

from lpvmpc import native
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.model import WHEELS, check_model, compile_model, parameters
from lpvmpc.vehicle import Array, AxleForces, Command, State, VehicleParams

_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
STEER, DRIVE, WIND_X, WIND_Y = range(4)  # columns of ctrl

TRIM_PERIOD = 0.01
"""Time between two corrections while the car settles into its trimmed state [s]."""
TRIM_TIME_MAX = 25.0
"""Simulated time after which a state that has not settled is called impossible [s]."""
TRIM_TOLERANCE = 1e-8
"""Largest change per second of a settled speed [m/s2] or yaw rate [rad/s2]."""


class Wheels(NamedTuple):
    """What the tires do, wheels fl, fr, rl, rr; each an array of shape (4,).

    It belongs to the beginning of the last physics step, one time step ago.
    """

    Fx: Array
    """Force along the wheel's heading [N]."""
    Fy: Array
    """Force to the wheel's left [N]."""
    Fz: Array
    """Load [N]."""
    slip_ratio: Array
    """Longitudinal slip after relaxation [-], positive drives."""
    slip_angle: Array
    """Slip angle after relaxation [rad], positive gives a force to the left."""
    mu: Array
    """Peak friction of tire and road at the load [-]."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that decides the plant's future; for Plant.restore and Plant.rollout."""

    state: Array
    """MuJoCo's integration state (with ctrl, userdata, warm start), read-only."""
    psi: float
    """Unwrapped heading [rad]."""


class Rollouts(NamedTuple):
    """States of many simulations at the end of each control period; time second, N first."""

    x: Array
    """Position [m], shape (N, T); likewise the following."""
    y: Array
    psi: Array
    vx: Array
    vy: Array
    r: Array
    delta: Array
    ax: Array
    ay: Array
    wheel_speed: Array
    """Spin [rad/s], shape (N, T, 4)."""
    qpos: Array
    """Shape (N, T, 17)."""
    outputs: Array
    """Userdata as native.py lays it out, shape (N, T, NUSERDATA)."""
    snapshots: list[Snapshot]
    """The N states at the end."""


@njit(cache=True)
def _motion(qpos, qvel, shares, com, out):
    """Planar motion of the whole car's centre of mass from generalised coordinates.

    The centre of mass moves in the chassis by the suspension travels, weighted by the wheels'
    share of the mass: p = x + R (com + z sum(share q)).

    Args:
        qpos: shape (17,).
        qvel: shape (16,).
        shares: mass of each knuckle with its wheel over the whole mass, shape (4,).
        com: centre of mass in the chassis frame at zero travel [m], shape (3,).
        out: x, y, psi (wrapped), vx, vy, r, roll, pitch, shape (8,).
    """
    w, a, b, c = qpos[3], qpos[4], qpos[5], qpos[6]
    n = 1.0 / math.sqrt(w * w + a * a + b * b + c * c)
    w, a, b, c = w * n, a * n, b * n, c * n
    x0, x1, x2 = 1.0 - 2.0 * (b * b + c * c), 2.0 * (a * b + w * c), 2.0 * (a * c - w * b)
    y0, y1, y2 = 2.0 * (a * b - w * c), 1.0 - 2.0 * (a * a + c * c), 2.0 * (b * c + w * a)
    z0, z1, z2 = 2.0 * (a * c + w * b), 2.0 * (b * c - w * a), 1.0 - 2.0 * (a * a + b * b)
    lift = (shares[0] * qpos[7] + shares[1] * qpos[10]) + (
        shares[2] * qpos[13] + shares[3] * qpos[15]
    )
    lift_rate = (shares[0] * qvel[6] + shares[1] * qvel[9]) + (
        shares[2] * qvel[12] + shares[3] * qvel[14]
    )
    h = com[2] + lift
    p0 = x0 * com[0] + y0 * com[1] + z0 * h
    p1 = x1 * com[0] + y1 * com[1] + z1 * h
    p2 = x2 * com[0] + y2 * com[1] + z2 * h
    w0 = x0 * qvel[3] + y0 * qvel[4] + z0 * qvel[5]
    w1 = x1 * qvel[3] + y1 * qvel[4] + z1 * qvel[5]
    w2 = x2 * qvel[3] + y2 * qvel[4] + z2 * qvel[5]
    v0 = qvel[0] + (w1 * p2 - w2 * p1) + z0 * lift_rate
    v1 = qvel[1] + (w2 * p0 - w0 * p2) + z1 * lift_rate
    s2 = x0 * x0 + x1 * x1
    s = math.sqrt(s2)
    out[0], out[1], out[2] = qpos[0] + p0, qpos[1] + p1, math.atan2(x1, x0)
    out[3] = (v0 * x0 + v1 * x1) / s
    out[4] = (v1 * x0 - v0 * x1) / s
    # psi' = (x0 x1' - x1 x0') / (x0^2 + x1^2) with x' = w cross x
    out[5] = (x0 * (w2 * x0 - w0 * x2) - x1 * (w1 * x2 - w2 * x1)) / s2
    out[6] = math.atan2(y2, z2)
    out[7] = math.asin(min(max(-x2, -1.0), 1.0))


class Plant:
    """The car on a plane road, advanced by one control period at a time.

    Example:
        plant = Plant()
        state = plant.reset(vx=15.0)
        state = plant.step(Command(delta=0.02, ax=0.0), wind=(0.0, -5.0))
    """

    def __init__(
        self,
        model: str | FilePath | mujoco.MjModel | None = None,
        *,
        friction: float | npt.ArrayLike = 1.0,
        Ts: float = 0.033,
        timestep: float | None = None,
    ) -> None:
        """Load the car.

        Args:
            model: MJCF file or compiled model (default: the packaged models/vehicle.xml).
            friction: scale of the road's peak friction, one number or one per wheel.
            Ts: control period [s].
            timestep: physics step [s] (default: the model's); it must divide Ts.

        Raises:
            ModelError: the model is broken or not our car.
            OptionError: an argument lies outside its domain.
        """
        if isinstance(model, mujoco.MjModel):
            check_model(model)
            self.model = copy.copy(model)
        else:
            self.model = compile_model(model, visual=False)
        native.install()
        if timestep is not None:
            if not (math.isfinite(timestep) and 0.0 < timestep <= 0.002):
                raise OptionError("timestep", timestep, "positive, at most 0.002 s")
            self.model.opt.timestep = timestep
        ratio = Ts / self.model.opt.timestep
        self.nstep = round(ratio) if math.isfinite(ratio) else 0
        if self.nstep < 1 or abs(ratio - self.nstep) > 1e-6 * ratio:
            raise OptionError(
                "Ts", Ts, f"a positive multiple of the physics step {self.model.opt.timestep:g} s"
            )
        self.Ts = Ts
        self.params: VehicleParams = parameters(self.model)
        self.data = mujoco.MjData(self.model)
        self._shares, self._com = _mass_layout(self.model)
        self._motion: Array = np.zeros(8)
        self._psi = 0.0
        self.friction = friction  # type: ignore[assignment]
        self.reset()

    # --- inputs ---

    @property
    def friction(self) -> Array:
        """Scale of the road's peak friction under each wheel, shape (4,)."""
        return 1.0 + self.data.userdata[native.FRICTION : native.FRICTION + 4]

    @friction.setter
    def friction(self, scale: float | npt.ArrayLike) -> None:
        self.data.userdata[native.FRICTION : native.FRICTION + 4] = _friction(scale) - 1.0

    def reset(
        self,
        x: float = 0.0,
        y: float = 0.0,
        psi: float = 0.0,
        vx: float = 0.0,
        *,
        kappa: float = 0.0,
        wind: tuple[float, float] = (0.0, 0.0),
        trim: bool = True,
        align: str = "heading",
    ) -> State:
        """Put the car on the road, by default in the steady state of its speed and curvature.

        The trimmed state is simulated: the car drives with two integral controllers, on speed and
        yaw rate, until nothing changes any more; then it is moved to x, y, psi. Suspension, tires,
        servo, drive and wheel spins are all settled, and the commands that hold them are kept as
        the first ones. The wind turns with the car meanwhile.

        Args:
            x, y: position of the centre of mass [m].
            psi: direction [rad].
            vx: longitudinal speed [m/s], not negative.
            kappa: curvature of the path of the centre of mass [1/m].
            wind: velocity of the air in the world [m/s].
            trim: False leaves suspension and tires unloaded by speed and curvature: straight ahead,
                wheels rolling, no slip.
            align: "heading": psi is the direction of the car's axis; "course": of its motion.

        Returns:
            The state at time 0.

        Raises:
            OptionError: an argument lies outside its domain, or no such steady state exists.
        """
        _finite(x=x, y=y, psi=psi, kappa=kappa, wind_x=wind[0], wind_y=wind[1])
        if not (math.isfinite(vx) and 0.0 <= vx <= 100.0):
            raise OptionError("vx", vx, "between 0 and 100 m/s")
        if align not in ("heading", "course"):
            raise OptionError("align", align, "'heading' or 'course'")
        d = self.data
        friction = d.userdata[native.FRICTION : native.FRICTION + 4].copy()
        mujoco.mj_resetData(self.model, d)
        d.userdata[native.FRICTION : native.FRICTION + 4] = friction
        d.qvel[0] = vx
        d.qvel[[8, 11, 13, 15]] = vx / self.params.R_w
        if trim:
            self._settle(vx, kappa, psi, wind, align)
        self._place(x, y, psi, align)
        d.ctrl[WIND_X], d.ctrl[WIND_Y] = wind
        d.time = 0.0
        mujoco.mj_forward(self.model, d)
        self._psi = psi
        return self.state

    def step(self, command: Command, wind: tuple[float, float] = (0.0, 0.0)) -> State:
        """Hold the command and the wind for one control period.

        Args:
            command: steering angle and acceleration.
            wind: velocity of the air in the world [m/s].

        Returns:
            The state at the end of the period.

        Raises:
            LPVMPCError: the command is not finite, or the simulation has diverged.
        """
        ctrl = self.data.ctrl
        ctrl[STEER], ctrl[DRIVE] = command
        ctrl[WIND_X], ctrl[WIND_Y] = wind
        if not np.isfinite(ctrl).all():
            raise LPVMPCError(f"A command or wind is not finite: {command}, wind {tuple(wind)}.")
        mujoco.mj_step(self.model, self.data, nstep=self.nstep)
        return self.state

    # --- outputs ---

    @property
    def time(self) -> float:
        """Time since reset [s]."""
        return float(self.data.time)

    @property
    def state(self) -> State:
        """True state of the car now; its accelerations are those of the last physics step."""
        d, m = self.data, self._motion
        _motion(d.qpos, d.qvel, self._shares, self._com, m)
        if not math.isfinite(m[0]):
            raise LPVMPCError(f"The simulation has diverged at {d.time:.3f} s.")
        # heading without jumps: a period is far too short for half a turn
        self._psi += math.remainder(m[2] - self._psi, 2.0 * math.pi)
        return State(
            x=float(m[0]),
            y=float(m[1]),
            psi=self._psi,
            vx=float(m[3]),
            vy=float(m[4]),
            r=float(m[5]),
            delta=float(d.act[0]),
            ax=float(d.userdata[native.AX]),
            ay=float(d.userdata[native.AY]),
            wheel_speed=d.qvel[[8, 11, 13, 15]],
        )

    @property
    def wheels(self) -> Wheels:
        """Forces, slips and friction of the four tires."""
        u = self.data.userdata
        starts = (native.FX, native.FY, native.FZ, native.SLIP_RATIO, native.SLIP_ANGLE, native.MU)
        return Wheels(*(u[i : i + 4].copy() for i in starts))

    @property
    def axles(self) -> AxleForces:
        """Forces and slip angles of the two axles."""
        Fx, Fy, Fz, _, _, mu = self.wheels
        u = self.data.userdata
        load = Fz.sum()
        return AxleForces(
            Fyf=float(Fy[0] + Fy[1]),
            Fyr=float(Fy[2] + Fy[3]),
            Fzf=float(Fz[0] + Fz[1]),
            Fzr=float(Fz[2] + Fz[3]),
            alpha_f=float(u[native.ALPHA_F]),
            alpha_r=float(u[native.ALPHA_R]),
            Fxf=float(Fx[0] + Fx[1]),
            Fxr=float(Fx[2] + Fx[3]),
            mu=float(mu @ Fz / load if load > 0.0 else mu.mean()),
        )

    @property
    def qpos(self) -> Array:
        """Copy of the generalised coordinates, for a renderer, shape (17,)."""
        return self.data.qpos.copy()

    @property
    def roll(self) -> float:
        """Roll angle of the body [rad], positive to the right side down."""
        _motion(self.data.qpos, self.data.qvel, self._shares, self._com, self._motion)
        return float(self._motion[6])

    @property
    def rolled_over(self) -> bool:
        """Whether the body lies on its side or roof."""
        return abs(self.roll) > math.radians(60.0)

    # --- saving, many at once ---

    def save(self) -> Snapshot:
        """Everything that decides the future of this plant."""
        state = np.empty(mujoco.mj_stateSize(self.model, _STATE))
        mujoco.mj_getState(self.model, self.data, state, _STATE)
        state.flags.writeable = False
        return Snapshot(state, self._psi)

    def restore(self, snapshot: Snapshot) -> State:
        """Go back to a saved state, exactly."""
        mujoco.mj_setState(self.model, self.data, snapshot.state, _STATE)
        self._psi = snapshot.psi
        return self.state

    # --- settling ---

    def _settle(
        self, vx: float, kappa: float, psi: float, wind: tuple[float, float], align: str
    ) -> None:
        """Simulate until the car drives steadily at vx on a circle of curvature kappa."""
        d, car = self.data, self.params
        nstep = max(round(TRIM_PERIOD / self.model.opt.timestep), 1)
        dt = nstep * self.model.opt.timestep
        L, K = car.wheelbase, car.m / car.wheelbase * (car.lr / car.Cf - car.lf / car.Cr)
        yaw_gain = max(vx, 0.5) / (L + K * vx * vx)
        bandwidth = min(4.0, max(vx, 0.5))  # [1/s]; relaxation makes the slow car slow to answer
        delta = math.atan(kappa * (L + K * vx * vx))
        ax = 0.0
        if vx < 0.1:
            ax = -1.0  # brakes on
        d.act[0], d.act[1] = delta, ax
        d.qvel[5] = vx * kappa
        d.qvel[1] = kappa * vx * (car.lr - car.lf * car.m * vx * vx / (L * car.Cr))
        m, old = self._motion, np.zeros(8)
        _motion(d.qpos, d.qvel, self._shares, self._com, m)
        calm = 0
        for _ in range(round(TRIM_TIME_MAX / dt)):
            old[:] = m
            # The wind keeps its direction relative to the car.
            turn = m[2] - psi
            if align == "course":
                turn += math.atan2(m[4], max(m[3], 0.1))
            c, s = math.cos(turn), math.sin(turn)
            d.ctrl[:4] = delta, ax, c * wind[0] - s * wind[1], s * wind[0] + c * wind[1]
            mujoco.mj_step(self.model, d, nstep=nstep)
            _motion(d.qpos, d.qvel, self._shares, self._com, m)
            if vx >= 0.1:
                speed = math.hypot(m[3], m[4])
                delta += dt * bandwidth * (kappa * speed - m[5]) / yaw_gain
                delta = min(max(delta, -car.delta_max), car.delta_max)
                acceleration = (m[3] - old[3]) / dt
                ax += dt * (4.0 * (vx - m[3]) - 4.0 * acceleration)
                ax = min(max(ax, -3.0), 3.0)
                error = max(abs(vx - m[3]), abs(kappa * speed - m[5]))
            else:
                error = abs(m[3])
            change = max(abs(m[i] - old[i]) for i in (3, 4, 5, 6, 7)) / dt
            calm = calm + 1 if max(error, change) < TRIM_TOLERANCE else 0
            if calm >= 10:
                return
        if max(error, change) > 1e-4:
            raise OptionError(
                "kappa", kappa, f"a curvature that the car can hold at {vx:g} m/s in this wind"
            )

    def _place(self, x: float, y: float, psi: float, align: str) -> None:
        """Turn and move the car as a whole; only pose and world-frame velocity change."""
        d, m = self.data, self._motion
        _motion(d.qpos, d.qvel, self._shares, self._com, m)
        turn = psi - m[2]
        if align == "course" and m[3] > 0.1:
            turn -= math.atan2(m[4], m[3])
        q = np.array([math.cos(turn / 2.0), 0.0, 0.0, math.sin(turn / 2.0)])
        mujoco.mju_mulQuat(d.qpos[3:7], q, d.qpos[3:7].copy())
        mujoco.mju_rotVecQuat(d.qvel[:3], d.qvel[:3].copy(), q)
        _motion(d.qpos, d.qvel, self._shares, self._com, m)
        d.qpos[0] += x - m[0]
        d.qpos[1] += y - m[1]
        d.qpos[[9, 12, 14, 16]] = 0.0  # wheels: where the spokes are does not matter
        d.qacc_warmstart[:] = 0.0


def _mass_layout(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Mass shares of the wheels with knuckles, and the centre of mass at zero travel."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    chassis = model.body("chassis").id
    mass = model.body_subtreemass
    shares = np.array([mass[model.body(f"knuckle_{w}").id] for w in WHEELS]) / mass[chassis]
    return shares, data.subtree_com[chassis] - data.xpos[chassis]


def _friction(scale: float | npt.ArrayLike) -> Array:
    """Check a friction scale and spread it over the wheels, shape (4,)."""
    values = np.asarray(scale, dtype=np.float64)
    if values.shape not in ((), (4,)) or not ((values >= 0.01) & (values <= 2.0)).all():
        raise OptionError("friction", scale, "one number or four, each between 0.01 and 2")
    return np.broadcast_to(values, (4,))


def _finite(**values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise OptionError(name, value, "a finite number")
