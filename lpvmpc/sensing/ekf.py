"""Extended Kalman filter between the sensors and a controller.

Prediction is strapdown integration (`strapdown.py`), so neither tires nor wind nor the road's
friction can mislead it; pose and speeds correct it. A pose that is old corrects the state of the
instant when it was taken, and the states since then are computed again. The offset of the steering
sensor is found by a second, scalar filter from the front axle: where it carries little side force,
the wheels point where the axle goes,

    delta = atan2(vy + lf r, vx) + Fyf / Cf + offset,
    Fyf = (Iz r' + (lr + x_cy) Fyr - x_cy m ay) / (lf - x_cy),   Fyr = -Cr atan2(vy - lr r, vx)

which is the yaw moment with the side force of the wind, acting at x_cy, eliminated. The tires enter
there alone: a wrong stiffness can bend the offset but never the pose and the velocities.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from lpvmpc.car.params import VehicleParams
from lpvmpc.interface import Command, Measurement, State
from lpvmpc.sensing import strapdown
from lpvmpc.sensing.channels import DEG, Channel, Sensing
from lpvmpc.sensing.strapdown import (
    BAX,
    BAY,
    BR,
    C_T,
    C_WALK_A,
    C_WALK_R,
    CORRELATED,
    GATE,
    MEMORY,
    PSI,
    SCALE,
    VX,
    VY,
    W0,
    W1,
    WPSI,
    X,
    Y,
    correct_pose,
    correct_speed,
    drift,
    predict,
)
from lpvmpc.units import GRAVITY, Array

# What the filter believes in any case, however good the sensors are said to be.
YAW_BIAS, YAW_WALK = 0.2 * DEG, 0.0005 * DEG
"""Bias of the yaw rate [rad/s] and its change within a second."""
ACC_BIAS, ACC_WALK = 0.05, 0.001
"""Bias of an acceleration [m/s2] and its change within a second."""
TRUSTED = 4.0
"""A mean innovation of up to this many standard deviations is still chance."""
SLOPE_WALK = 0.1
"""What each further one adds to the walk of the accelerations' biases [m/s2]: gravity on a bank or
a slope that changes while the car drives over it is no bias of a sensor, and much faster."""
SLOPE_TIME = 20.0
"""How long a road that was found uneven still counts as uneven [s]."""
OFFSET, OFFSET_WALK = 0.5 * DEG, 0.01 * DEG
"""Offset of the steering [rad] and its change within a second."""
SCALE_WALK = 1e-5
"""Change of the wheels' radius within a second [-]."""
SLIP_STIFFNESS = 20.0
"""Longitudinal stiffness of a tire per load [-]; assumed, passenger tires have 15 to 30."""
ALONG = 0.5
"""A lane camera does not see how far along the lane it is: how well that counts as known [m]."""
FRONT_AXLE = 0.1 * DEG
"""Error of the front axle's angle that is always there: gusts, toe, roll steer [rad]."""
TIRE = 0.3
"""Relative error of the front axle's slip angle: the stiffness of both axles [-]."""
BENT = 0.04
"""Slip angle at which the curve of a tire has left its tangent by as much again [rad]."""
OFFSET_SPEED = 3.0
"""Below this speed nothing is learned of the steering [m/s]."""
GIVE_UP = 10
"""This many poses in a row with an innovation beyond `GATE` count as divergence."""

COUNT, SLOT, OFF, OFF_VAR, BAD, NIS, DOF, FAILED, ROUGH = range(9)
"""Columns of the memory: valid slots, newest slot, steering offset and its variance, bad poses in a
row, NIS and its degrees of freedom of the last update, whether that diverged, and the variance that
an uneven road adds to the walk of the accelerations' biases a period [m2/s4]."""
S_LF, S_REAR, S_MOMENT, S_SIDE, S_NOISE, S_WALK, S_LR, S_RADIUS, S_SLOW = range(9)
"""Columns of the car: lf [m]; front slip angle per that of the rear axle [-], per r' [s2] and per
ay [rad s2/m]; variance of the steering sensor and of the offset's walk a period [rad2]; lr [m];
wheel radius [m]; how long an error of vy lasts [s]."""
_MEASURED = 14


@njit(cache=True)
def advance(m, memory, xs, Ps, us, zs, c, car, start, means, h, gain, out):
    """One control period of the filter; all arrays are changed in place.

    Args:
        m: x, y, psi, age, vx, vy, r, ax, ay, delta and four wheel speeds, shape (14,).
        memory: Columns as above, shape (9,).
        xs: States of the last K instants, a ring, shape (K, 12).
        Ps: Their covariances, shape (K, 12, 12).
        us: Measured r, ax, ay of the same instants, shape (K, 3).
        zs: Measured speeds, columns as in `correct_speed`, shape (K, 4).
        c: Constants of `strapdown`.
        car: Constants of the car, columns as above.
        start: Standard deviations of the states at a start, shape (12,).
        means: Running means of the innovations, see `drift`, shape (2,).
        h: Workspace, shape (12,).
        gain: Workspace, shape (12,).
        out: Receives x, y, psi, vx, vy, r, delta, ax, ay, shape (9,).
    """
    K = xs.shape[0]
    T = c[C_T]
    count, before = int(memory[COUNT]), int(memory[SLOT])
    new = (before + 1) % K
    us[new] = m[6:9]
    zs[new, 0], zs[new, 1] = m[4], m[5]
    zs[new, 2] = car[S_RADIUS] * 0.5 * (m[12] + m[13])
    zs[new, 3] = m[7]
    fresh = math.isfinite(m[0]) and math.isfinite(m[1]) and math.isfinite(m[3])
    nis, dof = 0.0, 0
    back = 0
    if fresh:
        back = min(int(m[3] / T + 0.5), count)
        if back > 0:  # correct the past, then compute the present again
            then = (new - back) % K
            dt = back * T - m[3]
            if dt < -T:  # older than anything kept
                fresh = False
                back = 0
            else:
                drift(xs[then], Ps[then], m[:3], dt, c, h, means)
                nis, dof = correct_pose(xs[then], Ps[then], m[:3], dt, us[then], c, h, gain)
    mean = max(abs(means[0]), abs(means[1])) / math.sqrt(MEMORY / (2.0 - MEMORY))
    seen = (SLOPE_WALK * max(mean - TRUSTED, 0.0)) ** 2 * T
    memory[ROUGH] = max(memory[ROUGH] * (1.0 - T / SLOPE_TIME), seen)
    walk = c[C_WALK_A] + memory[ROUGH]
    for age in range(max(back, 1), 0, -1):
        old, now = (new - age) % K, (new - age + 1) % K
        predict(xs[old], Ps[old], us[old], us[now], c, walk, xs[now], Ps[now])
        speed_nis, speed_dof = correct_speed(xs[now], Ps[now], zs[now], c, h, gain)
    x, P = xs[new], Ps[new]
    if fresh and back == 0:
        drift(x, P, m[:3], -m[3], c, h, means)
        nis, dof = correct_pose(x, P, m[:3], -m[3], us[new], c, h, gain)
    memory[COUNT], memory[SLOT] = min(count + 1, K - 1), new
    memory[NIS], memory[DOF] = nis + speed_nis, dof + speed_dof
    if fresh:
        memory[BAD] = memory[BAD] + 1.0 if nis > GATE else 0.0
    failed = memory[BAD] >= GIVE_UP
    for i in range(12):
        if not (math.isfinite(x[i]) and P[i, i] >= 0.0 and math.isfinite(P[i, i])):
            failed = True
    memory[FAILED] = 1.0 if failed else 0.0
    if failed:
        means[:] = 0.0
        restart(m, memory, xs, Ps, c, car, start, out)
        x = xs[new]

    learn_offset(m, memory, x, Ps[new], us[before], c, car)
    out[0], out[1], out[2], out[3], out[4] = x[X], x[Y], x[PSI], x[VX], x[VY]
    out[5] = m[6] - x[BR]
    out[6] = m[9] - memory[OFF]
    out[7], out[8] = m[7] - x[BAX], m[8] - x[BAY]


@njit(cache=True)
def restart(m, memory, xs, Ps, c, car, start, last):
    """Begin again from what was measured last or, where that says nothing, the last output."""
    new = int(memory[SLOT])
    x, P = xs[new], Ps[new]
    x[:] = 0.0
    speed = m[4] if math.isfinite(m[4]) else car[S_RADIUS] * 0.5 * (m[12] + m[13])
    x[VX] = speed if math.isfinite(speed) else last[3]
    x[VY] = m[5] if math.isfinite(m[5]) else car[S_LR] * m[6]
    age = 0.0
    if math.isfinite(m[0]) and math.isfinite(m[1]) and math.isfinite(m[3]):
        x[X], x[Y], age = m[0], m[1], m[3]
    else:
        x[X], x[Y], age = last[0], last[1], c[C_T]
    x[PSI] = last[2] + m[6] * c[C_T]
    if age == m[3] and math.isfinite(m[2]):  # unwrapped next to the last output
        error = m[2] + m[6] * age - x[PSI]
        x[PSI] += error - 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
    co, si = math.cos(x[PSI]), math.sin(x[PSI])
    x[X] += age * (co * x[VX] - si * x[VY])
    x[Y] += age * (si * x[VX] + co * x[VY])
    P[:] = 0.0
    for i in range(12):
        P[i, i] = start[i] * start[i]
    for i in (X, Y, PSI, VX, VY):  # nothing good is known after a divergence
        P[i, i] *= 9.0
    memory[COUNT], memory[BAD] = 0.0, 0.0


@njit(cache=True)
def learn_offset(m, memory, x, P, u0, c, car):
    """Scalar Kalman filter on the offset of the steering sensor, in place; see the module."""
    memory[OFF_VAR] += car[S_WALK]
    if not x[VX] > OFFSET_SPEED:
        return
    r, ay = m[6] - x[BR], m[8] - x[BAY]
    rear = -math.atan2(x[VY] - car[S_LR] * r, x[VX])
    slip = car[S_REAR] * rear + car[S_MOMENT] * (m[6] - u0[0]) / c[C_T] - car[S_SIDE] * ay
    course = math.atan2(x[VY] + car[S_LF] * r, x[VX])
    used = max(abs(slip), abs(m[9] - memory[OFF] - course))  # the axles do not always agree
    bent = TIRE * used * (1.0 + (used / BENT) ** 2)
    turn = (1.0 - car[S_REAR]) / x[VX]  # what vy changes in the expected angle
    slow = (FRONT_AXLE**2 + bent * bent) * CORRELATED + P[VY, VY] * turn * turn * car[S_SLOW]
    variance = car[S_NOISE] + slow * 2.0 / c[C_T]
    share = memory[OFF_VAR] / (memory[OFF_VAR] + variance)
    memory[OFF] += share * (m[9] - course - slip - memory[OFF])
    memory[OFF_VAR] *= 1.0 - share


class EKF:
    """Estimator from position, heading, speeds, yaw rate, accelerations and steering to `State`.

    Attributes:
        events: How often it diverged and was reset, or was given values that are no numbers, in
            this run. Either way the state that it returns is finite.
        nis: Normalised innovation squared of the last update [-].
        nis_dof: Number of measurements in it; 0: none.

    Source: Bar-Shalom, Li, Kirubarajan, Estimation with applications to tracking and navigation,
    sections 5.4 (consistency) and 10.3.
    """

    def __init__(self, car: VehicleParams, sensing: Sensing, Ts: float) -> None:
        """Make the filter for a car and its sensors.

        Args:
            car: Parameters of the car, as the controller knows them.
            sensing: What the makers of the sensors say of them; nothing of what was drawn.
            Ts: Control period [s].
        """
        self._Ts = Ts
        self._constants = _constants(car, sensing, Ts)
        self._start = _start(sensing)
        lever = (car.lf - car.x_cy) * car.Cf
        offset = sensing.delta.constant, OFFSET
        self._offset_std = max(math.hypot(sensing.delta.wander_std, offset[0]), offset[1])
        walk = math.hypot(OFFSET_WALK, _stir(sensing.delta))
        self._car = np.array([
            car.lf, (car.lr + car.x_cy) * car.Cr / lever, car.Iz / lever, car.x_cy * car.m / lever,
            sensing.delta.noise**2, walk**2 * Ts, car.lr, car.R_w,
            max(CORRELATED, sensing.psi.wander_time if sensing.psi.wander_std else 0.0),
        ])
        pose = sensing.position
        oldest = pose.latency[1] + (1.0 / pose.rate if pose.rate else 0.0)
        K = math.ceil(oldest / Ts) + 3
        n = strapdown.N
        self._states, self._covariances = np.zeros((K, n)), np.zeros((K, n, n))
        self._inertial, self._speeds = np.zeros((K, 3)), np.zeros((K, 4))
        self._memory = np.zeros(9)
        self._means = np.zeros(2)
        self._h, self._gain, self._out = np.zeros(n), np.zeros(n), np.zeros(9)
        self._m, self._good = np.zeros(_MEASURED), np.zeros(_MEASURED)
        self.events = 0
        self._first: State | None = None

    def reset(self, first: State, rng: np.random.Generator) -> None:
        """See `Estimator.reset`."""
        self.events, self._blind = 0, False
        self._first = first
        self._memory[:] = self._means[:] = 0.0
        self._memory[OFF_VAR] = self._offset_std**2
        state = self._states[0]
        state[:] = 0.0
        state[:5] = first.x, first.y, first.psi, first.vx, first.vy
        self._covariances[0] = np.diag(self._start**2)
        self._out[:] = first[:9]
        self._good[6:9] = first.r, first.ax, first.ay
        self._good[9] = first.delta

    def update(self, measured: Measurement, command: Command) -> State:
        """See `Estimator.update`; the command is not used, the steering is measured."""
        m, good = self._m, self._good
        m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], wheel_speed = measured
        m[10:] = wheel_speed
        if not math.isfinite(m[6] + m[7] + m[8] + m[9]):
            self.events += not self._blind
            self._blind = True
            np.copyto(m[6:10], good[6:10], where=~np.isfinite(m[6:10]))
        else:
            self._blind = False
        good[:] = m
        if self._first is not None:  # no time has passed since `reset`
            self._first = None
            self._inertial[0] = m[6:9]
            self._speeds[0] = m[4], m[5], math.nan, m[7]
            self._out[5:] = m[6], m[9] - self._memory[OFF], m[7], m[8]
        else:
            advance(
                m, self._memory, self._states, self._covariances, self._inertial, self._speeds,
                self._constants, self._car, self._start,
                self._means, self._h, self._gain, self._out,
            )
            if self._memory[FAILED]:
                self.events += 1
        x, y, psi, vx, vy, r, delta, ax, ay = self._out.tolist()
        return State(x, y, psi, vx, vy, r, delta, ax, ay, wheel_speed)

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last update [-]."""
        return float(self._memory[NIS])

    @property
    def nis_dof(self) -> int:
        """Number of measurements in `nis`."""
        return int(self._memory[DOF])

    @property
    def covariance(self) -> Array:
        """Covariance of (x, y, psi, vx, vy) [m, m, rad, m/s, m/s], shape (5, 5)."""
        return self._covariances[int(self._memory[SLOT]), :5, :5].copy()

    @property
    def unknowns(self) -> dict[str, float]:
        """Slow unknowns and their standard deviations, units in the names."""
        slot = int(self._memory[SLOT])
        x, std = self._states[slot], np.sqrt(np.diag(self._covariances[slot]))
        return {
            "steering_offset_rad": float(self._memory[OFF]),
            "steering_offset_std_rad": math.sqrt(self._memory[OFF_VAR]),
            "yaw_rate_bias_radps": float(x[BR]),
            "yaw_rate_bias_std_radps": float(std[BR]),
            "ax_bias_mps2": float(x[BAX]),
            "ax_bias_std_mps2": float(std[BAX]),
            "ay_bias_mps2": float(x[BAY]),
            "ay_bias_std_mps2": float(std[BAY]),
            "speed_scale": float(x[SCALE]),
            "speed_scale_std": float(std[SCALE]),
        }


def _stir(channel: Channel) -> float:
    """Random walk within a second that a wander amounts to while it is short [unit / sqrt(s)]."""
    return channel.wander_std * math.sqrt(2.0 / channel.wander_time)


def _speed_channel(sensing: Sensing) -> Channel:
    return sensing.vx if sensing.vx.measured else sensing.wheel_speed


def _start(sensing: Sensing) -> Array:
    """Standard deviations of the states at a start, shape (12,)."""
    start = np.zeros(strapdown.N)
    start[X] = start[Y] = max(0.02, sensing.position.noise)
    start[PSI] = max(0.2 * DEG, sensing.psi.noise)
    start[VX] = start[VY] = 0.1
    for state, channel, least in (
        (BR, sensing.r, YAW_BIAS), (BAX, sensing.ax, ACC_BIAS), (BAY, sensing.ay, ACC_BIAS),
        (W0, sensing.position, 0.0), (WPSI, sensing.psi, 0.0),
    ):
        start[state] = max(math.hypot(channel.constant, channel.wander_std), least)
    start[W1] = 0.0 if sensing.lane else start[W0]
    # two rear wheels, each uniform
    speed = _speed_channel(sensing)
    start[SCALE] = speed.scale_range / math.sqrt(3.0 if sensing.vx.measured else 6.0)
    return start


def _constants(car: VehicleParams, sensing: Sensing, Ts: float) -> Array:
    """Constants of `strapdown`, from what the sensors are said to be."""
    T = Ts

    def markov(channel: Channel) -> tuple[float, float]:
        if channel.wander_std == 0.0:  # what is constant does not fade
            return 1.0, 0.0
        keep = math.exp(-T / channel.wander_time)
        return keep, channel.wander_std**2 * (1.0 - keep**2)

    # What is exact is still given a little noise: the filter must be able to divide.
    def variance(channel: Channel, least: float) -> float:
        return max(channel.noise, least) ** 2

    braking = (1.0 - car.brake_front) * car.m_eff * car.wheelbase
    stiffness = SLIP_STIFFNESS * car.m * GRAVITY * car.lf
    slip = braking / stiffness
    driven = (1.0 - car.drive_front) * car.m_eff * car.wheelbase / stiffness
    wheel = max(car.R_w * sensing.wheel_speed.noise / math.sqrt(2.0), 0.005)
    values = [
        T, variance(sensing.r, 1e-4), max(variance(sensing.ax, 0.01), variance(sensing.ay, 0.01)),
        math.hypot(YAW_WALK, _stir(sensing.r)) ** 2 * T,
        max(math.hypot(ACC_WALK, _stir(c)) ** 2 * T for c in (sensing.ax, sensing.ay)),
        (SCALE_WALK**2 * T if _speed_channel(sensing).scale_range else 0.0),
        *markov(sensing.position), *markov(sensing.psi), float(sensing.lane),
        variance(sensing.position, 1e-3), variance(sensing.psi, 1e-4),
        variance(sensing.vx, 1e-3), variance(sensing.vy, 1e-3), wheel**2, slip, ALONG**2, driven,
    ]
    assert C_WALK_R == 3 and C_WALK_A == 4  # the order of `strapdown`
    return np.array(values)
