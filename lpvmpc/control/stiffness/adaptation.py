"""What the tires are really like: road friction and stiffness of each axle, learned online.

The model's axle forces miss a lateral force and a yaw moment in every period. Five unknowns can
explain them, and they are told apart by when they act and how fast they change:

- the friction of the road, mu: sudden, seen only where the tangent's offset is a large share of the
  force. By similarity, Fy(alpha; mu) = mu F(alpha / mu; 1), its effect is dFy/dmu = F0 / mu;
- the stiffness of each axle, as a scale c of the slip angle, Fy = F(c alpha): nearly constant, seen
  wherever the tires work, dFy/dc = C alpha / c;
- a side force and a yaw moment that no tire makes (wind of any lever, a banked road): they change
  within seconds, whatever the slip.

A Kalman filter knows all five. How much noise the measurements have it sees from the differences of
its own errors from one period to the next. Where an error is far larger than it should be while
much grip is used, the road has changed: then friction, and nothing else, may move at once.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.units import GRAVITY, Array

MU, CF, CR, FORCE, MOMENT = range(5)
"""Order of the unknowns: friction scale [-], stiffness scales [-], force [N], moment [N m]."""
FRICTION_MIN, FRICTION_MAX = 0.2, 1.2
"""Range of the estimated friction scale [-]."""
SCALE_MIN, SCALE_MAX = 0.4, 2.0
"""Range of the estimated stiffness scales [-]."""
SURE = 0.9
"""Share of the friction in use that is taken as certain: accelerations also come from wind."""
MEMORY = 20.0
"""Time after which a friction that nothing confirms is forgotten [s]."""
START = np.array([0.05, 0.2, 0.2, 1000.0, 1000.0])
"""How far each unknown is expected from its start, standard deviations."""
DRIFT = np.array([0.1, 0.01, 0.01, 800.0, 1200.0])
"""How far each moves within a second, standard deviations."""
JUMP = 0.3
"""How far friction is believed to move when the road changes, standard deviation [-]."""
GATE = 16.0
"""Squared error over its variance from which on the road has changed [-]: four deviations."""
NOISE = np.array([1000.0, 1000.0])
"""Errors of the model that look like noise: force [N], moment [N m], standard deviations."""
NOISE_MEMORY = 2.0
"""Time over which the noise of the measurements is averaged [s]."""
USE_LOW, USE_HIGH = 0.35, 0.6
"""Shares of the friction in use below which nothing, above which all is learned of friction [-]."""


@njit(cache=True)
def _learn(
    estimate, P, noise, last, unmodelled, tires, alpha, a, ay, constants, tuning, Ts,
):
    """One period of the Kalman filter, in place; see `TireAdaptation.update`."""
    m, Iz, lever_f, lever_r, lr, h, wheelbase, m_eff, brake_front, mu = constants
    start, drift, floor = tuning
    estimate[MU] += (1.0 - estimate[MU]) * Ts / MEMORY
    for i in range(5):
        P[i, i] += drift[i] ** 2 * Ts
    P[MU, MU] = min(P[MU, MU], 0.25)
    for i in (CF, CR):
        P[i, i] = min(P[i, i], start[i] ** 2)

    load = m * (GRAVITY * lr - a * h) / wheelbase
    Fx = m_eff * a * (1.0 if a > 0.0 else brake_front)
    used = math.hypot(Fx / load, ay / GRAVITY) / mu
    share = min(max((used / estimate[MU] - USE_LOW) / (USE_HIGH - USE_LOW), 0.0), 1.0)
    Sf, Sr = share * tires[1] / estimate[MU], share * tires[3] / estimate[MU]
    Lf, Lr = tires[0] * alpha[0] / estimate[CF], tires[2] * alpha[1] / estimate[CR]

    H = np.zeros((2, 5))
    H[0, MU], H[0, CF], H[0, CR], H[0, FORCE] = Sf + Sr, Lf, Lr, 1.0
    H[1, MU], H[1, CF], H[1, CR] = lever_f * Sf - lever_r * Sr, lever_f * Lf, -lever_r * Lr
    H[1, MOMENT] = 1.0
    measured = (m * unmodelled[0], Iz * unmodelled[1])
    error, variance = np.empty(2), np.empty(2)
    change = 0.0
    for n in range(2):
        error[n] = measured[n] - estimate[FORCE + n]
        jump = error[n] - last[n]
        last[n] = error[n]
        noise[n] += (0.5 * jump * jump - noise[n]) * Ts / NOISE_MEMORY
        variance[n] = floor[n] ** 2 + noise[n]
        spread = variance[n]
        for i in range(5):
            for j in range(5):
                spread += H[n, i] * P[i, j] * H[n, j]
        change = max(change, error[n] * error[n] / spread)
    if change > GATE and share >= 1.0:
        P[MU, MU] = max(P[MU, MU], JUMP**2)
    PH, step = np.empty(5), np.zeros(5)
    for n in range(2):  # one measurement after the other: their noises are independent
        spread, expected = variance[n], 0.0
        for i in range(5):
            PH[i] = 0.0
            for j in range(5):
                PH[i] += P[i, j] * H[n, j]
            expected += H[n, i] * step[i]
        for i in range(5):
            spread += H[n, i] * PH[i]
        left = error[n] - expected
        for i in range(5):
            step[i] += PH[i] / spread * left
        for i in range(5):
            for j in range(5):
                P[i, j] -= PH[i] * PH[j] / spread
    for i in range(5):
        estimate[i] += step[i]
    # What the car uses is there: a front axle that drives hard leaves its tangent little slope, and
    # an estimate that is too low would confirm itself.
    estimate[MU] = min(max(estimate[MU], FRICTION_MIN, SURE * used), FRICTION_MAX)
    for i in (CF, CR):
        estimate[i] = min(max(estimate[i], SCALE_MIN), SCALE_MAX)


class TireAdaptation:
    """Kalman filter on friction, stiffness scales, and an unknown force and moment."""

    def __init__(self, car: VehicleParams, Ts: float) -> None:
        """Args: the car, and the control period [s]."""
        levers = car.lf - car.trail_f, car.lr + car.trail_r
        use = car.lr, car.h, car.wheelbase, car.m_eff, car.brake_front, car.mu
        self._constants = (float(car.m), float(car.Iz), *map(float, levers), *map(float, use))
        self._Ts = Ts
        self.reset()

    def reset(self) -> None:
        """Believe in a dry road, the data sheet's tires and no wind."""
        self.estimate: Array = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
        """Friction scale [-], stiffness scales front and rear [-], force [N], moment [N m]."""
        self._P: Array = np.diag(START**2)
        self._noise, self._last = np.zeros(2), np.zeros(2)

    def update(self, unmodelled: Array, tires: Array, alpha: Array, a: float, ay: float) -> None:
        """Learn from one period.

        Args:
            unmodelled: Acceleration of (vy, r) that the tire model without observer left
                unexplained [m/s2, rad/s2], shape (2,).
            tires: Affine axle forces of the period (Cf [N/rad], F0f [N], Cr, F0r), shape (4,).
            alpha: Slip angles of the axles [rad], shape (2,).
            a: Drive or brake acceleration [m/s2].
            ay: Lateral acceleration [m/s2].
        """
        _learn(
            self.estimate, self._P, self._noise, self._last, unmodelled, tires, alpha, a, ay,
            self._constants, (START, DRIFT, NOISE), self._Ts,
        )
