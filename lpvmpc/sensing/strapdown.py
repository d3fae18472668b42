"""Motion of the car from its own inertial sensors, and the algebra of the Kalman filter on it.

The strapdown equations hold for any tire, road friction and wind:

    psi' = r - b_r,   vx' = ax - b_ax + (r - b_r) vy,   vy' = ay - b_ay - (r - b_r) vx,
    x' = vx cos psi - vy sin psi,   y' = vx sin psi + vy cos psi

with the measured r, ax, ay and their biases b. Accelerations are taken as linear between two
instants; a bias walks; errors of the pose that wander are Gauss-Markov states of their own, so that
the filter does not take them for white.

Source: Groves, Principles of GNSS, inertial, and multisensor integrated navigation systems, 2nd
edition, sections 3.2 and 5.3, for the plane.
"""

from __future__ import annotations

import math

from numba import njit

X, Y, PSI, VX, VY, BR, BAX, BAY, SCALE, W0, W1, WPSI = range(12)
"""States: pose, velocity, biases, scale error of the speed [-], wander of the pose: in x and y, or
across the path and (not used) along it, and in heading."""
N = 12

(
    C_T, C_GYRO, C_ACC, C_WALK_R, C_WALK_A, C_WALK_SCALE, C_KEEP_P, C_STIR_P, C_KEEP_PSI,
    C_STIR_PSI, C_LANE, C_POS, C_HEADING, C_SPEED, C_LATERAL, C_WHEEL, C_SLIP, C_ALONG,
    C_DRIVEN,
) = range(19)
"""Columns of the constants: variances, except T [s], KEEP (factors), LANE (0 or 1) and SLIP and
DRIVEN (slip of the rear wheels per m/s2 of braking and of driving)."""
MEMORY = 1.0 / 15.0
"""Share of the newest innovation in the running mean: half a second at 30 Hz."""
OUTLIER = 3.0
"""An innovation beyond that many standard deviations counts as that many in the mean."""
GATE = 40.0
"""Normalised innovation squared that one true measurement in 10^9 exceeds [-]."""
CORRELATED = 1.0
"""How long a systematic error of tires lasts [s]: that much data counts as one measurement."""
ROLLING = 1e-3
"""Relative error of a freely rolling wheel's rim speed: side slip, resistance, load [-]."""
UNSEEN = 0.2
"""Standard deviation of what the trapezoid misses between two instants, as a share of the change: a
command that arrives in mid-period, followed within 50 ms, is missed by up to 23 % of the change."""


@njit(cache=True)
def unseen(change, variance):
    """Variance of what the trapezoid misses, of that part of a change that is more than noise."""
    return UNSEEN * UNSEEN * max(change * change - 4.0 * variance, 0.0)


@njit(cache=True)
def predict(x, P, u0, u1, c, walk, xo, Po):
    """One control period forward: state and covariance from one instant to the next.

    Args:
        x: State, shape (12,).
        P: Its covariance, shape (12, 12).
        u0: Measured r, ax, ay at the beginning [rad/s, m/s2, m/s2], shape (3,).
        u1: The same at the end.
        c: Constants, columns as above.
        walk: Variance by which the biases of ax and ay walk in a period [m2/s4].
        xo: Receives the state at the end.
        Po: Receives its covariance.
    """
    T = c[C_T]
    turn = T * (0.5 * (u0[0] + u1[0]) - x[BR])
    a0, b0 = u0[1] - x[BAX], u0[2] - x[BAY]
    a1, b1 = u1[1] - x[BAX], u1[2] - x[BAY]
    c0, s0 = math.cos(x[PSI]), math.sin(x[PSI])
    c1, s1 = math.cos(x[PSI] + turn), math.sin(x[PSI] + turn)
    third, sixth = T * T / 3.0, T * T / 6.0
    dx = T * (c0 * x[VX] - s0 * x[VY]) + third * (c0 * a0 - s0 * b0) + sixth * (c1 * a1 - s1 * b1)
    dy = T * (s0 * x[VX] + c0 * x[VY]) + third * (s0 * a0 + c0 * b0) + sixth * (s1 * a1 + c1 * b1)
    C, S = math.cos(turn), math.sin(turn)
    wx, wy = x[VX] + 0.5 * T * a0, x[VY] + 0.5 * T * b0
    px, py = C * wx + S * wy, C * wy - S * wx  # the velocity seen from the turned body
    xo[:] = x
    xo[X] += dx
    xo[Y] += dy
    xo[PSI] += turn
    xo[VX] = px + 0.5 * T * a1
    xo[VY] = py + 0.5 * T * b1
    xo[W0] *= c[C_KEEP_P]
    xo[W1] *= c[C_KEEP_P]
    xo[WPSI] *= c[C_KEEP_PSI]

    half = 0.5 * T * T
    near, far = -0.5 * T * (1.0 + C), -0.5 * T * S
    for j in range(N):  # Po = F P
        Po[X, j] = (
            P[X, j] - dy * P[PSI, j] + T * (c0 * P[VX, j] - s0 * P[VY, j])
            - half * (c0 * P[BAX, j] - s0 * P[BAY, j])
        )
        Po[Y, j] = (
            P[Y, j] + dx * P[PSI, j] + T * (s0 * P[VX, j] + c0 * P[VY, j])
            - half * (s0 * P[BAX, j] + c0 * P[BAY, j])
        )
        Po[PSI, j] = P[PSI, j] - T * P[BR, j]
        Po[VX, j] = (
            C * P[VX, j] + S * P[VY, j] - T * py * P[BR, j] + near * P[BAX, j] + far * P[BAY, j]
        )
        Po[VY, j] = (
            C * P[VY, j] - S * P[VX, j] + T * px * P[BR, j] - far * P[BAX, j] + near * P[BAY, j]
        )
        Po[BR, j], Po[BAX, j], Po[BAY, j] = P[BR, j], P[BAX, j], P[BAY, j]
        Po[SCALE, j] = P[SCALE, j]
        Po[W0, j], Po[W1, j] = c[C_KEEP_P] * P[W0, j], c[C_KEEP_P] * P[W1, j]
        Po[WPSI, j] = c[C_KEEP_PSI] * P[WPSI, j]
    for i in range(N):  # Po = (F P) F'
        row = Po[i]
        psi, vx, vy, br, bax, bay = row[PSI], row[VX], row[VY], row[BR], row[BAX], row[BAY]
        row[X] += -dy * psi + T * (c0 * vx - s0 * vy) - half * (c0 * bax - s0 * bay)
        row[Y] += dx * psi + T * (s0 * vx + c0 * vy) - half * (s0 * bax + c0 * bay)
        row[PSI] = psi - T * br
        row[VX] = C * vx + S * vy - T * py * br + near * bax + far * bay
        row[VY] = C * vy - S * vx + T * px * br - far * bax + near * bay
        row[W0] *= c[C_KEEP_P]
        row[W1] *= c[C_KEEP_P]
        row[WPSI] *= c[C_KEEP_PSI]

    # Noise of the rate turns heading and velocity together. Neighbouring trapezoids share a sample,
    # so noise adds up as T^2 sigma^2 a period although one trapezoid alone has half of that.
    q = T * T * (c[C_GYRO] + unseen(u1[0] - u0[0], c[C_GYRO]))
    Po[PSI, PSI] += q
    Po[PSI, VX] += q * py
    Po[VX, PSI] += q * py
    Po[PSI, VY] -= q * px
    Po[VY, PSI] -= q * px
    Po[VX, VX] += q * py * py
    Po[VY, VY] += q * px * px
    Po[VX, VY] -= q * px * py
    Po[VY, VX] -= q * px * py
    qa = T * T * (c[C_ACC] + unseen(u1[1] - u0[1], c[C_ACC]))
    qb = T * T * (c[C_ACC] + unseen(u1[2] - u0[2], c[C_ACC]))
    Po[VX, VX] += qa
    Po[VY, VY] += qb
    for k in range(2):  # the position moves by half of what the velocity is off, T / 2 v
        i = VX + k
        v = qa if k == 0 else qb
        gx = 0.5 * T * (c0 if k == 0 else -s0)
        gy = 0.5 * T * (s0 if k == 0 else c0)
        Po[X, i] += v * gx
        Po[i, X] += v * gx
        Po[Y, i] += v * gy
        Po[i, Y] += v * gy
        Po[X, X] += v * gx * gx
        Po[Y, Y] += v * gy * gy
        Po[X, Y] += v * gx * gy
        Po[Y, X] += v * gx * gy
    Po[BR, BR] += c[C_WALK_R]
    Po[BAX, BAX] += walk
    Po[BAY, BAY] += walk
    Po[SCALE, SCALE] += c[C_WALK_SCALE]
    Po[W0, W0] += c[C_STIR_P]
    if c[C_LANE] == 0.0:
        Po[W1, W1] += c[C_STIR_P]
    Po[WPSI, WPSI] += c[C_STIR_PSI]


@njit(cache=True)
def drift(x, P, pose, dt, c, h, means):
    """Take the innovation of a position into its running mean, along and across the car, in place.

    White innovations, each of unit variance, have a mean of variance m / (2 - m); an acceleration
    that the sensors misread, as on a bank, pushes all of them to one side.

    Args:
        x: State, shape (12,), before the pose corrects it.
        P: Covariance, shape (12, 12).
        pose: Measured x, y, psi, shape (3,).
        dt: Time of the pose less that of the state [s].
        c: Constants.
        h: Workspace, shape (12,).
        means: Running means of the normalised innovations, shape (2,).
    """
    co, si = math.cos(x[PSI]), math.sin(x[PSI])
    ex, ey = pose[0] - x[X] - x[W0] * (1.0 - c[C_LANE]), pose[1] - x[Y] - x[W1]
    for k in range(2):
        h[:] = 0.0
        if k == 0:
            error = co * ex + si * ey - dt * x[VX]
            h[X], h[Y], h[VX] = co, si, dt
            variance = c[C_POS]
            if c[C_LANE] != 0.0:
                variance = c[C_ALONG]
            else:
                h[W0], h[W1] = co, si
        else:
            error = co * ey - si * ex - dt * x[VY]
            h[X], h[Y], h[PSI], h[VY] = -si, co, dt * x[VX], dt
            variance = c[C_POS]
            if c[C_LANE] != 0.0:
                error -= x[W0]
                h[W0] = 1.0
            else:
                h[W0], h[W1] = -si, co
        for i in range(N):
            for j in range(N):
                variance += h[i] * P[i, j] * h[j]
        unit = min(max(error / math.sqrt(variance), -OUTLIER), OUTLIER)
        means[k] += MEMORY * (unit - means[k])


@njit(cache=True)
def correct(x, P, h, error, variance, gain):
    """Kalman update with one number, in place; returns its normalised innovation squared.

    S = h P h' + variance,  k = P h' / S,  x += k error,  P -= k k' S

    A number beyond the gate is an outlier: nothing changes.

    Args:
        x: State, shape (12,).
        P: Covariance, shape (12, 12).
        h: Row of the measurement's Jacobian, shape (12,).
        error: Innovation.
        variance: Of the measurement.
        gain: Workspace, shape (12,).
    """
    S = variance
    for i in range(N):
        total = 0.0
        for j in range(N):
            total += P[i, j] * h[j]
        gain[i] = total
        S += h[i] * total
    nis = error * error / S
    if not nis <= GATE:
        return nis
    for i in range(N):
        k = gain[i] / S
        x[i] += k * error
        for j in range(i + 1):  # both halves from one: rounding cannot make P lopsided
            P[i, j] -= k * gain[j]
            P[j, i] = P[i, j]
    return nis


@njit(cache=True)
def correct_speed(x, P, z, c, h, gain):
    """Update with the speeds of one instant; returns NIS and the count of numbers used.

    Args:
        x: State, changed in place.
        P: Covariance, changed in place.
        z: vx, vy, rim speed of the rear wheels [m/s] and measured ax [m/s2], shape (4,); NaN where
            not measured. The rim speed is used where vx is not measured: it slips.
        c: Constants.
        h: Workspace, shape (12,).
        gain: Workspace, shape (12,).
    """
    nis, dof = 0.0, 0
    if math.isfinite(z[0]):
        speed, variance = z[0], c[C_SPEED]
    else:
        # negative: a braked wheel turns slower
        slip = c[C_SLIP] * min(z[3], 0.0) + c[C_DRIVEN] * max(z[3], 0.0)
        doubt = (0.5 * slip) ** 2 + ROLLING**2
        speed = z[2] * (1.0 - slip)
        variance = c[C_WHEEL] + doubt * x[VX] ** 2 * 2.0 * CORRELATED / c[C_T]
    if math.isfinite(speed):
        h[:] = 0.0
        h[VX], h[SCALE] = 1.0 + x[SCALE], x[VX]
        nis += correct(x, P, h, speed - (1.0 + x[SCALE]) * x[VX], variance, gain)
        dof += 1
    if math.isfinite(z[1]):
        h[:] = 0.0
        h[VY] = 1.0
        nis += correct(x, P, h, z[1] - x[VY], c[C_LATERAL], gain)
        dof += 1
    return nis, dof


@njit(cache=True)
def correct_pose(x, P, pose, dt, u, c, h, gain):
    """Update with a pose taken dt after the instant of the state (|dt| below half a period).

    Args:
        x: State, changed in place.
        P: Covariance, changed in place.
        pose: Measured x, y, psi, shape (3,); psi may be NaN.
        dt: Time of the pose less that of the state [s].
        u: Measured r, ax, ay at the instant of the state, shape (3,).
        c: Constants.
        h: Workspace, shape (12,).
        gain: Workspace, shape (12,).

    Returns:
        NIS and the count of numbers used.
    """
    nis, dof = 0.0, 2
    for k in range(2):
        co, si = math.cos(x[PSI]), math.sin(x[PSI])
        a, b = u[1] - x[BAX], u[2] - x[BAY]
        half = 0.5 * dt * dt
        wx = dt * x[VX] + half * a
        wy = dt * x[VY] + half * b
        ex = pose[0] - x[X] - (co * wx - si * wy)
        ey = pose[1] - x[Y] - (si * wx + co * wy)
        h[:] = 0.0
        if c[C_LANE] == 0.0:
            if k == 0:
                h[X], h[PSI], h[VX], h[VY] = 1.0, -(si * wx + co * wy), dt * co, -dt * si
                h[W0] = 1.0
                nis += correct(x, P, h, ex - x[W0], c[C_POS], gain)
            else:
                h[Y], h[PSI], h[VX], h[VY] = 1.0, co * wx - si * wy, dt * si, dt * co
                h[W1] = 1.0
                nis += correct(x, P, h, ey - x[W1], c[C_POS], gain)
        elif k == 0:  # across the lane, which lies along the car but for a few degrees
            h[X], h[Y], h[PSI], h[VY], h[W0] = -si, co, wx, dt, 1.0
            nis += correct(x, P, h, co * ey - si * ex - x[W0], c[C_POS], gain)
        else:
            h[X], h[Y], h[PSI], h[VX] = co, si, -wy, dt
            correct(x, P, h, co * ex + si * ey, c[C_ALONG], gain)  # no measurement: see ALONG
            dof -= 1
    if math.isfinite(pose[2]):
        h[:] = 0.0
        h[PSI], h[BR], h[WPSI] = 1.0, -dt, 1.0
        error = pose[2] - x[PSI] - dt * (u[0] - x[BR]) - x[WPSI]
        error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
        nis += correct(x, P, h, error, c[C_HEADING], gain)
        dof += 1
    return nis, dof
