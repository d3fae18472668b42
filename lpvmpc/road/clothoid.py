"""A chain of short clothoids as numbers: integration, evaluation, projection, preview.

What runs every control period of a `Path`, compiled. A path is a table of grid points with the
columns x, y, psi, kappa, shape (n + 1, 4), and their distance h; the curvature is linear in
between. Callers see `Path`, whose methods say what each function does.
"""

import math

import numpy as np
from numba import njit

from lpvmpc.units import Array

# Three-point Gauss-Legendre on [0, 1]. Over one cell the heading turns by at most 0.05 rad, so the
# quadrature error is about 1e-16 m: position is exact to rounding.
C1, C2, C3 = 0.5 - math.sqrt(0.15), 0.5, 0.5 + math.sqrt(0.15)
W1, W2 = 5.0 / 18.0, 4.0 / 9.0


def integrate(
    kappa: Array, h: float, x0: float, y0: float, psi0: float
) -> tuple[Array, Array, Array]:
    """Heading and position on the grid from the curvature: exact integrals, shapes (n + 1,)."""
    k0, dk = kappa[:-1], np.diff(kappa)
    psi = psi0 + np.concatenate([[0.0], np.cumsum(h * (k0 + 0.5 * dk))])
    cos_mean, sin_mean = np.zeros(len(k0)), np.zeros(len(k0))
    for c, w in ((C1, W1), (C2, W2), (C3, W1)):
        angle = psi[:-1] + h * c * (k0 + 0.5 * c * dk)
        cos_mean += w * np.cos(angle)
        sin_mean += w * np.sin(angle)
    x = x0 + np.concatenate([[0.0], np.cumsum(h * cos_mean)])
    y = y0 + np.concatenate([[0.0], np.cumsum(h * sin_mean)])
    return psi, x, y


@njit(cache=True)
def pose(table, h, closed, s):
    """Position, heading and curvature at one arc length [m]; see `Path.at`."""
    n = table.shape[0] - 1
    length = n * h
    extra = 0.0
    if closed:
        laps = math.floor(s / length)
        s -= laps * length
        extra = laps * (table[n, 2] - table[0, 2])
    elif s < 0.0 or s > length:
        # Beyond an end: the circle of the curvature there, through its chord.
        i = 0 if s < 0.0 else n
        u = s if s < 0.0 else s - length
        k = table[i, 3]
        half = 0.5 * k * u
        chord = u if abs(half) < 1e-8 else u * math.sin(half) / half
        psi = table[i, 2] + half
        return (
            table[i, 0] + chord * math.cos(psi),
            table[i, 1] + chord * math.sin(psi),
            psi + half,
            k,
        )
    i = min(int(s / h), n - 1)
    u = s - i * h
    k0 = table[i, 3]
    dk = 0.5 * (table[i + 1, 3] - k0) / h
    psi0 = table[i, 2] + extra
    u1, u2, u3 = C1 * u, C2 * u, C3 * u
    a1 = psi0 + u1 * (k0 + dk * u1)
    a2 = psi0 + u2 * (k0 + dk * u2)
    a3 = psi0 + u3 * (k0 + dk * u3)
    x = table[i, 0] + u * (W1 * (math.cos(a1) + math.cos(a3)) + W2 * math.cos(a2))
    y = table[i, 1] + u * (W1 * (math.sin(a1) + math.sin(a3)) + W2 * math.sin(a2))
    return x, y, psi0 + u * (k0 + dk * u), k0 + 2.0 * dk * u


@njit(cache=True)
def poses(table, h, closed, s):
    """The same at arc lengths of shape (m,)."""
    x, y, psi, kappa = np.empty(s.size), np.empty(s.size), np.empty(s.size), np.empty(s.size)
    for j in range(s.size):
        x[j], y[j], psi[j], kappa[j] = pose(table, h, closed, s[j])
    return x, y, psi, kappa


@njit(cache=True)
def project(table, h, closed, x, y, s):
    """Local descent of the distance; see `Path.project`. Returns s and ey [m]."""
    # Newton on (p - r(s)) . t(s) = 0, whose derivative is -(1 - kappa ey). The floor keeps the
    # step downhill where the point lies beyond the centre of curvature.
    for _ in range(200):
        px, py, psi, kappa = pose(table, h, closed, s)
        c, d = math.cos(psi), math.sin(psi)
        along = (x - px) * c + (y - py) * d
        across = (y - py) * c - (x - px) * d
        step = along / max(1.0 - kappa * across, 0.2)
        step = min(max(step, -1.0), 1.0)
        s += step
        if abs(step) < 1e-10:
            break
    px, py, psi, kappa = pose(table, h, closed, s)
    return s, (y - py) * math.cos(psi) - (x - px) * math.sin(psi)


@njit(cache=True)
def speed(vx, h, closed, s):
    """Reference speed [m/s] at one arc length, linear between grid points, held at open ends."""
    n = vx.size - 1
    q = s / h
    if closed:
        q -= math.floor(q / n) * n
    i = min(max(int(q), 0), n - 1)
    f = min(max(q - i, 0.0), 1.0)
    return vx[i] + f * (vx[i + 1] - vx[i])


@njit(cache=True)
def preview(table, h, closed, vx, h_vx, x, y, psi, s_prev, Np, Ts):
    """See `Path.preview`: s, ey, epsi and rows kappa, vx_ref, x, y, psi, shape (5, Np + 1)."""
    s0, ey = project(table, h, closed, x, y, s_prev)
    rows = np.empty((5, Np + 1))
    s = s0
    for j in range(Np + 1):
        px, py, path_psi, kappa = pose(table, h, closed, s)
        v = speed(vx, h_vx, closed, s)
        rows[0, j], rows[1, j], rows[2, j], rows[3, j], rows[4, j] = kappa, v, px, py, path_psi
        # Classic Runge-Kutta step of ds/dt = vx_ref(s).
        v2 = speed(vx, h_vx, closed, s + 0.5 * Ts * v)
        v3 = speed(vx, h_vx, closed, s + 0.5 * Ts * v2)
        v4 = speed(vx, h_vx, closed, s + Ts * v3)
        s += Ts * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
    epsi = psi - rows[4, 0]
    epsi -= 2.0 * math.pi * math.ceil(epsi / (2.0 * math.pi) - 0.5)
    return s0, ey, epsi, rows
