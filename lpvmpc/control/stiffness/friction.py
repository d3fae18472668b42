"""Road friction, estimated online from what the tire model mispredicts.

Friction cannot be measured, but by similarity, Fy(alpha; mu) = mu F(alpha / mu; 1), its effect on
an axle's force is the offset of the force's tangent: dFy/dmu = (Fy - C alpha) / mu = F0 / mu. Where
the tires are used little, F0 is near zero and nothing is learned; near the limit it is the whole
force. A Kalman filter tells a change of friction from side wind by the yaw moment.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.units import GRAVITY, Array

FRICTION_MIN, FRICTION_MAX = 0.2, 1.2
"""Range of the estimated friction scale [-]."""
DRIFT_FRICTION = 0.5
"""How fast friction may change, standard deviation after one second [-]."""
SURE = 0.9
"""Share of the friction in use that is taken as certain: accelerations also come from wind."""
MEMORY = 20.0
"""Time after which an estimate that nothing confirms is forgotten [s]."""
DRIFT_FORCE = 800.0
"""The same for a side force [N]: a gust of 10 m/s within one second."""
NOISE_FORCE, NOISE_MOMENT = 1000.0, 1000.0
"""Standard deviation of the model's own error: force [N], moment [N m]. The tangent model misses
100 N per axle, but always the same way in a bend; with 300 the estimate drifts to `FRICTION_MIN`
in side wind, where little slip says little about friction."""


@njit(cache=True)
def _update(estimate, covariance, unmodelled, offsets, a, ay, constants, Ts):
    """One step of the Kalman filter on (friction scale, side force), in place.

    Measured are the missing lateral force and yaw moment,
    (m d_vy, Iz d_r) = H (mu - mu_hat, W),
    H = [[Sf + Sr, 1], [lever_f Sf - lever_r Sr, x_cy]],   S = F0 / mu_hat.
    """
    m, Iz, lever_f, lever_r, x_cy, lr, h, wheelbase, m_eff, brake_front, mu = constants
    Sf, Sr = offsets[0] / estimate[0], offsets[1] / estimate[0]
    H = np.empty((2, 2))
    H[0, 0], H[0, 1] = Sf + Sr, 1.0
    H[1, 0], H[1, 1] = lever_f * Sf - lever_r * Sr, x_cy
    # where nothing is learned the estimate returns to a dry road
    estimate[0] += (1.0 - estimate[0]) * Ts / MEMORY
    covariance[0, 0] += DRIFT_FRICTION**2 * Ts
    covariance[1, 1] += DRIFT_FORCE**2 * Ts
    error0 = m * unmodelled[0] - estimate[1]
    error1 = Iz * unmodelled[1] - x_cy * estimate[1]
    # S = H P H' + R and its inverse, 2 by 2
    PH = np.zeros((2, 2))
    for i in range(2):
        for j in range(2):
            PH[i, j] = covariance[i, 0] * H[j, 0] + covariance[i, 1] * H[j, 1]
    s00 = H[0, 0] * PH[0, 0] + H[0, 1] * PH[1, 0] + NOISE_FORCE**2
    s01 = H[0, 0] * PH[0, 1] + H[0, 1] * PH[1, 1]
    s11 = H[1, 0] * PH[0, 1] + H[1, 1] * PH[1, 1] + NOISE_MOMENT**2
    det = s00 * s11 - s01 * s01
    for i in range(2):
        k0 = (PH[i, 0] * s11 - PH[i, 1] * s01) / det
        k1 = (PH[i, 1] * s00 - PH[i, 0] * s01) / det
        estimate[i] += k0 * error0 + k1 * error1
    new = np.empty((2, 2))
    for i in range(2):
        k0 = (PH[i, 0] * s11 - PH[i, 1] * s01) / det
        k1 = (PH[i, 1] * s00 - PH[i, 0] * s01) / det
        for j in range(2):
            new[i, j] = covariance[i, j] - k0 * PH[j, 0] - k1 * PH[j, 1]
    for i in range(2):
        for j in range(2):
            covariance[i, j] = 0.5 * (new[i, j] + new[j, i])
    covariance[0, 0] = min(covariance[0, 0], 0.25)  # unseen for long, it is still not arbitrary
    # What the car uses is there: a front axle that drives hard leaves its tangent little slope, and
    # an estimate that is too low would confirm itself.
    load = m * (GRAVITY * lr - a * h) / wheelbase
    Fx = m_eff * a * (1.0 if a > 0.0 else brake_front)
    used = math.hypot(Fx / load, ay / GRAVITY) / mu
    estimate[0] = min(max(estimate[0], FRICTION_MIN, SURE * used), FRICTION_MAX)


class FrictionObserver:
    """Kalman filter on the road's friction and an unknown side force."""

    def __init__(self, car: VehicleParams, Ts: float) -> None:
        """Args: the car, and the control period [s]."""
        levers = car.lf - car.trail_f, car.lr + car.trail_r, car.x_cy
        use = car.lr, car.h, car.wheelbase, car.m_eff, car.brake_front, car.mu
        self._constants = (float(car.m), float(car.Iz), *map(float, levers), *map(float, use))
        self._Ts = Ts
        self.reset()

    def reset(self) -> None:
        """Believe in a dry road without wind."""
        self._estimate: Array = np.array([1.0, 0.0])
        self._covariance: Array = np.diag([0.01, 1000.0**2])

    @property
    def friction(self) -> float:
        """Estimated scale of the road's friction [-]."""
        return float(self._estimate[0])

    @property
    def side_force(self) -> float:
        """Estimated force that no tire explains [N], left positive."""
        return float(self._estimate[1])

    def update(self, unmodelled: Array, offsets: Array, a: float = 0.0, ay: float = 0.0) -> None:
        """Learn from one period.

        Args:
            unmodelled: Acceleration of (vy, r) that the tire model without observer left
                unexplained [m/s2, rad/s2], shape (2,).
            offsets: Offsets F0 of the tangents at the front and rear axle [N], shape (2,).
            a: Drive or brake acceleration [m/s2]; with `ay`, what the car is known to use.
            ay: Lateral acceleration [m/s2].
        """
        _update(
            self._estimate, self._covariance, unmodelled, offsets, a, ay, self._constants,
            self._Ts,
        )  # fmt: skip
