"""The car: a MuJoCo multibody model with Pacejka tires, driven by commands."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from pathlib import Path as FilePath

import mujoco
import numpy as np
import numpy.typing as npt

from lpvmpc.car.params import VehicleParams
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.interface import AxleForces, Command, State
from lpvmpc.plant import callbacks
from lpvmpc.plant.actuation import MAX_LATENCY, Actuation
from lpvmpc.plant.deviations import NOMINAL, Deviations, deviated
from lpvmpc.plant.mjcf import check_model, compile_model, parameters
from lpvmpc.plant.motion import PSI, ROLL, VX, VY, R, X, Y, mass_layout, planar_motion
from lpvmpc.plant.outputs import Wheels, axles_of, wheels_of
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
from lpvmpc.plant.trim import INTEGRATION_STATE, Steady, gravity, place, settled
from lpvmpc.units import Array


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
            model: MJCF file or compiled model (default: the car of `--car`, or the packaged
                models/vehicle.xml).
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
        """The nominal car, which a controller may know; `deviations` do not change it."""
        self.nominal_model = self.model
        self._deviations, self._actual = NOMINAL, self.params
        self._latency = 0
        self._actuation: Actuation | None = None
        self._tilt = 0.0, 0.0
        self.held = Command(0.0, 0.0)
        """The command that holds the state in which the car was reset."""
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

    @property
    def deviations(self) -> Deviations:
        """How the car differs from the nominal one, `params`; set it before `reset`.

        Raises:
            OptionError: The car could not be driven.
        """
        return self._deviations

    @deviations.setter
    def deviations(self, deviations: Deviations) -> None:
        nominal = deviations == NOMINAL
        self.model = self.nominal_model if nominal else deviated(self.nominal_model, deviations)
        self._actual = self.params if nominal else parameters(self.model)
        self._deviations, self._layout = deviations, mass_layout(self.model)
        self._connect()

    @property
    def latency(self) -> float:
        """Time after which a command reaches the car [s], 0 to `MAX_LATENCY`; set before `reset`.

        Raises:
            OptionError: No such time, or none that is a whole number of physics steps.
        """
        return round(self._latency * float(self.model.opt.timestep), 9)

    @latency.setter
    def latency(self, seconds: float) -> None:
        dt = self.model.opt.timestep
        number = isinstance(seconds, int | float) and 0.0 <= seconds <= MAX_LATENCY
        if not number or abs(seconds / dt - round(seconds / dt)) > 1e-6:
            raise OptionError(
                "latency", seconds, f"0 to {MAX_LATENCY:g} s in whole physics steps of {dt:g} s"
            )
        self._latency = round(seconds / dt)
        self._connect()

    @property
    def latency_step(self) -> float:
        """Unit of a latency, the physics step [s]."""
        return float(self.model.opt.timestep)

    def _connect(self) -> None:
        """Put between command and car what belongs there; nothing where the car is nominal."""
        if self._deviations == NOMINAL and not self._latency:
            self._actuation = None
            return
        told, real = self.params, self._actual  # the drive turns acceleration into torque
        gain = told.R_w * told.m_eff / (real.R_w * real.m_eff)
        self._actuation = Actuation(self._deviations, gain, self._latency)

    def tilt(self, grade: float = 0.0, bank: float = 0.0, psi: float = 0.0) -> None:
        """Tilt the road under the car: part of gravity then acts along it.

        g (-grade, bank, -1) / sqrt(1 + grade^2 + bank^2) in the road's axes

        The road stays the plane z = 0, and gravity turns instead. Neglected: where the slope
        changes, crests and dips change the loads, and the car turns with the plane of the road.

        Args:
            grade: Rise per length in the direction psi [-].
            bank: Fall per length to its left [-].
            psi: Direction of the road [rad].

        Raises:
            OptionError: A slope beyond +-0.5.
        """
        for name, value in (("grade", grade), ("bank", bank)):
            if not abs(value) <= 0.5:
                raise OptionError(name, value, "a slope from -0.5 to 0.5")
        self._tilt = grade, bank
        along, left, down = gravity(grade, bank)
        c, s = math.cos(psi), math.sin(psi)
        self.model.opt.gravity[:] = c * along - s * left, s * along + c * left, down

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
            wanted = Steady(vx, kappa, relative, self._tilt, course)
            settled(self.model, d, self._actual, self._layout, wanted)
        self._psi = place(d, self._layout, x, y, psi, course)
        d.qpos[list(SPIN_QPOS)] = 0.0  # where the spokes are does not matter
        d.ctrl[WIND_X], d.ctrl[WIND_Y] = wind
        d.qacc_warmstart[:] = 0.0
        d.time = 0.0
        if self._tilt != (0.0, 0.0):
            self.tilt(*self._tilt, psi)
        delta, ax = float(d.ctrl[STEER]), float(d.ctrl[DRIVE])
        wired = self._actuation
        self.held = Command(delta, ax) if wired is None else wired.start(delta, ax)
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
        for steps in self.segments(command, wind):
            mujoco.mj_step(self.model, self.data, nstep=steps)
        return self.state

    def segments(self, command: Command, wind: tuple[float, float] = (0.0, 0.0)) -> Iterator[int]:
        """Give the car what `step` gives it, with its errors; the caller does the physics.

        Yields:
            Physics steps to take before the next piece of the period; `nstep` in all.
        """
        ctrl = self.data.ctrl
        ctrl[STEER], ctrl[DRIVE] = command
        ctrl[WIND_X], ctrl[WIND_Y] = wind
        if not np.isfinite(ctrl).all():
            raise LPVMPCError(f"A command or wind is not finite: {command}, wind {tuple(wind)}.")
        if self._actuation is None:
            yield self.nstep
            return
        for steps, ctrl[STEER], ctrl[DRIVE] in self._actuation.segments(command, self.nstep):
            yield steps

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
        return wheels_of(self.data.userdata)

    @property
    def axles(self) -> AxleForces:
        """Forces and slip angles of the two axles."""
        return axles_of(self.data.userdata)

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
        pending = None if self._actuation is None else self._actuation.save()
        return Snapshot(state, self._psi, pending)

    def restore(self, snapshot: Snapshot) -> State:
        """Go back to a saved state, exactly."""
        mujoco.mj_setState(self.model, self.data, snapshot.state, INTEGRATION_STATE)
        self._psi = snapshot.psi
        if self._actuation is not None and snapshot.actuation is not None:
            self._actuation.restore(snapshot.actuation)
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
            LPVMPCError: a simulation has diverged, or the plant has a latency or deviations.
        """
        if self._actuation is not None:
            raise LPVMPCError(
                "Plant.rollout gives commands straight to servo and drive, but this plant has a "
                "latency or deviations between them; step it instead."
            )
        return rollout(
            self.model, self.nstep, self._layout, snapshots, commands, wind, friction, threads
        )


def _finite(**values: float) -> None:
    for name, value in values.items():
        if not math.isfinite(value):
            raise OptionError(name, value, "a finite number")
