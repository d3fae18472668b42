"""Aerodynamic force and moment of the relative wind on the body."""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True)
def aero_wrench(u_rel, v_rel, rho_air, CdA, CyA, x_cy):
    """Drag, side force and yaw moment of the relative air flow.

    |V| = hypot(u, v),  Fx = -rho/2 CdA |V| u,  Fy = -rho/2 CyA |V| v,  Mz = x_cy Fy

    Quasi-steady, with areas that do not depend on the angle of the flow; the side force acts `x_cy`
    ahead of the centre of mass. No lift, pitch or roll moment of the air.

    Args:
        u_rel: Forward speed of the car through the air, body frame [m/s].
        v_rel: Leftward speed of the car through the air, body frame [m/s].
        rho_air: Air density [kg/m3].
        CdA: Drag area [m2].
        CyA: Side-wind area [m2].
        x_cy: Lever of the side force ahead of the centre of mass [m].

    Returns:
        Fx [N], Fy [N], Mz [Nm] at the centre of mass, body frame.
    """
    q = 0.5 * rho_air * math.sqrt(u_rel * u_rel + v_rel * v_rel)
    Fy = -q * CyA * v_rel
    return -q * CdA * u_rel, Fy, x_cy * Fy
