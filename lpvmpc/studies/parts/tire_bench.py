"""The engine's own tires at given load and slip, while the car is held."""

from __future__ import annotations

import mujoco
import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.plant.plant import Plant
from lpvmpc.plant.rollout import SPIN_QVEL
from lpvmpc.units import Array


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
