"""The car: a MuJoCo multibody model with Pacejka tires, driven by commands."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from pathlib import Path as FilePath
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.interface import AxleForces, Command, State
from lpvmpc.plant import callbacks
from lpvmpc.plant.mjcf import check_model, compile_model, parameters
from lpvmpc.plant.motion import PSI, ROLL, VX, VY, R, X, Y, mass_layout, planar_motion
from lpvmpc.plant.rollout import (
    DRIVE,
    FRICTION,
    SPIN_QPOS,
    SPIN_QVEL,
    STEER,
    WIND_X,
    WIND_Y,
    Rollouts,
    Snapshot,
    friction_scale,
    rollout,
)
from lpvmpc.plant.trim import place, settle
from lpvmpc.units import Array

INTEGRATION_STATE = mujoco.mjtState.mjSTATE_INTEGRATION


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
        # 13 % of a step; the state is computed from coordinates instead, once per period.
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
        callbacks.install()
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
        self._layout = mass_layout(self.model)
        self._motion: Array = np.zeros(8)
        self._psi = 0.0
        self.friction = friction  # type: ignore[assignment]
        self.reset()

    # --- inputs ---

    @property
    def friction(self) -> Array:
        """Scale of the road's peak friction under each wheel, shape (4,); one number sets all."""
        return 1.0 + self.data.userdata[FRICTION]

    @friction.setter
    def friction(self, scale: float | npt.ArrayLike) -> None:
        self.data.userdata[FRICTION] = friction_scale(scale, (4,)) - 1.0

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
            x: position of the centre of mass [m].
            y: the same [m].
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
        friction = d.userdata[FRICTION].copy()
        mujoco.mj_resetData(self.model, d)
        d.userdata[FRICTION] = friction
        d.qvel[0] = vx
        d.qvel[list(SPIN_QVEL)] = vx / self.params.R_w
        course = align == "course"
        if trim:
            c, s = math.cos(psi), math.sin(psi)
            relative = c * wind[0] + s * wind[1], c * wind[1] - s * wind[0]
            settle(self.model, d, self.params, self._layout, vx, kappa, relative, course=course)
        self._psi = place(d, self._layout, x, y, psi, course)
        d.qpos[list(SPIN_QPOS)] = 0.0  # where the spokes are does not matter
        d.ctrl[WIND_X], d.ctrl[WIND_Y] = wind
        d.qacc_warmstart[:] = 0.0
        d.time = 0.0
        mujoco.mj_forward(self.model, d)
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
        planar_motion(d.qpos, d.qvel, *self._layout, m)
        if not math.isfinite(m[X]):
            raise LPVMPCError(f"The simulation has diverged at {d.time:.3f} s.")
        # heading without jumps: a period is far too short for half a turn
        self._psi += math.remainder(m[PSI] - self._psi, 2.0 * math.pi)
        return State(
            x=float(m[X]),
            y=float(m[Y]),
            psi=self._psi,
            vx=float(m[VX]),
            vy=float(m[VY]),
            r=float(m[R]),
            delta=float(d.act[0]),
            ax=float(d.userdata[callbacks.AX]),
            ay=float(d.userdata[callbacks.AY]),
            wheel_speed=d.qvel[list(SPIN_QVEL)],
        )

    @property
    def wheels(self) -> Wheels:
        """Forces, slips and friction of the four tires."""
        u = self.data.userdata
        c = callbacks
        starts = (c.FX, c.FY, c.FZ, c.SLIP_RATIO, c.SLIP_ANGLE, c.MU)
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
            alpha_f=float(u[callbacks.ALPHA_F]),
            alpha_r=float(u[callbacks.ALPHA_R]),
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
        planar_motion(self.data.qpos, self.data.qvel, *self._layout, self._motion)
        return float(self._motion[ROLL])

    @property
    def rolled_over(self) -> bool:
        """Whether the body lies on its side or roof."""
        return abs(self.roll) > math.radians(60.0)

    # --- saving, many at once ---

    def save(self) -> Snapshot:
        """Everything that decides the future of this plant."""
        state = np.empty(mujoco.mj_stateSize(self.model, INTEGRATION_STATE))
        mujoco.mj_getState(self.model, self.data, state, INTEGRATION_STATE)
        state.flags.writeable = False
        return Snapshot(state, self._psi)

    def restore(self, snapshot: Snapshot) -> State:
        """Go back to a saved state, exactly."""
        mujoco.mj_setState(self.model, self.data, snapshot.state, INTEGRATION_STATE)
        self._psi = snapshot.psi
        return self.state

    def rollout(
        self,
        snapshots: Snapshot | Sequence[Snapshot],
        commands: npt.ArrayLike,
        wind: npt.ArrayLike | None = None,
        friction: npt.ArrayLike | None = None,
        threads: int = 0,
    ) -> Rollouts:
        """Run many simulations at once, bit-identical to restoring and stepping one by one.

        Args:
            snapshots: initial states, one for all or N.
            commands: (delta, ax) of each control period, shape (N, T, 2).
            wind: velocity of the air in the world [m/s], shape (N, T, 2) (default: still air).
            friction: scale for each simulation, shape (N,), or for each of its wheels, (N, 4)
                (default: that of the snapshots).
            threads: number of threads, 0 for all cores.

        Raises:
            OptionError: a shape does not fit or a value is not finite.
            LPVMPCError: a simulation has diverged.
        """
        return rollout(
            self.model, self.nstep, self._layout, snapshots, commands, wind, friction, threads
        )


def _finite(**values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise OptionError(name, value, "a finite number")
