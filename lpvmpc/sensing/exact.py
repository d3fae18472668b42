"""No estimator: the state is what the sensors say."""

from __future__ import annotations

import math

import numpy as np

from lpvmpc.car.params import VehicleParams
from lpvmpc.interface import Command, Measurement, State


class Exact:
    """Passes the measurements on, adding only what is needed to make a state of them.

    A lateral speed that is not measured is that of a car whose rear wheels do not slip, vy = lr r.
    A longitudinal speed that is not measured is the rim speed of the rear wheels, which are not
    driven. Where there is no new pose, or an old one, the car is moved on from the last one with
    its measured speed and yaw rate. Nothing is filtered, no bias is found.
    """

    events = 0
    """It has no state that could diverge."""

    def __init__(self, car: VehicleParams, Ts: float) -> None:
        """Args: the car, and the control period [s]."""
        self._lr, self._R_w, self._Ts = car.lr, car.R_w, Ts
        self._last: State | None = None
        self._moved = False

    def reset(self, first: State, rng: np.random.Generator) -> None:
        """See `Estimator.reset`."""
        self._last, self._moved = first, False

    def update(self, measured: Measurement, command: Command) -> State:
        """See `Estimator.update`.

        Returns:
            The measured state; with exact sensors the true one, bit for bit.
        """
        m = measured
        vx = m.vx if math.isfinite(m.vx) else self._R_w * float(m.wheel_speed[2:].mean())
        vy = m.vy if math.isfinite(m.vy) else self._lr * m.r
        x, y, psi, age = m.x, m.y, m.psi, m.pose_age
        if not math.isfinite(x):
            if self._last is None:
                raise RuntimeError("The estimator was not reset before its first measurement.")
            x, y, psi, age = self._last.x, self._last.y, self._last.psi, self._moved * self._Ts
        elif not math.isfinite(psi):
            last = self._last.psi if self._last is not None else 0.0
            psi = last + m.r * (self._moved * self._Ts - age)  # where it was when the pose was
        if age > 0.0:
            middle = psi + 0.5 * m.r * age
            c, s = math.cos(middle), math.sin(middle)
            x, y = x + age * (c * vx - s * vy), y + age * (s * vx + c * vy)
            psi += m.r * age
        self._moved = True
        self._last = State(x, y, psi, vx, vy, m.r, m.delta, m.ax, m.ay, m.wheel_speed)
        return self._last
