"""Aerodynamic wrench on the car, as a function of numbers."""

import math

from numba import njit


@njit(cache=True)
def aero_wrench(u_rel, v_rel, rho_air, CdA, CyA, x_cy):
    """Force and yaw moment of the air about the centre of mass, body axes.

    Fx = 0.5 rho_air CdA |V| u_rel,  Fy = 0.5 rho_air CyA |V| v_rel,  Mz = x_cy Fy

    The air acts in the direction in which it moves past the car: u_rel is negative when driving
    forward in still air, so Fx is the drag. Roll and pitch moments and lift are left out.

    Args:
        u_rel: velocity of the air minus that of the car, forward axis of the car [m/s].
        v_rel: the same, left axis [m/s].
        rho_air: air density [kg/m3].
        CdA: drag area [m2].
        CyA: side-wind area, per tangent of the flow angle [m2].
        x_cy: lever of the side force ahead of the centre of mass [m].

    Returns:
        Fx, Fy [N] and Mz [N m].
    """
    q = 0.5 * rho_air * math.sqrt(u_rel * u_rel + v_rel * v_rel)
    Fy = q * CyA * v_rel
    return q * CdA * u_rel, Fy, x_cy * Fy
