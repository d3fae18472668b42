"""What the callbacks leave in `userdata` for others to read."""

from __future__ import annotations

from typing import NamedTuple

from lpvmpc.interface import AxleForces
from lpvmpc.plant import callbacks
from lpvmpc.units import Array


class Wheels(NamedTuple):
    """What the tires do, wheels fl, fr, rl, rr; each an array of shape (4,).

    It belongs to the beginning of the last physics step, one time step ago.
    """

    Fx: Array
    """Force along the wheel's heading [N]."""
    Fy: Array
    """Force to the wheel's left [N]."""
    Fz: Array
    """Load [N]."""
    slip_ratio: Array
    """Longitudinal slip after relaxation [-], positive drives."""
    slip_angle: Array
    """Slip angle after relaxation [rad], positive gives a force to the left."""
    mu: Array
    """Peak friction of tire and road at the load [-]."""


def wheels_of(userdata: Array) -> Wheels:
    """Forces, slips and friction of the four tires out of `userdata`, shape (NUSERDATA,)."""
    c = callbacks
    starts = (c.FX, c.FY, c.FZ, c.SLIP_RATIO, c.SLIP_ANGLE, c.MU)
    return Wheels(*(userdata[i : i + 4].copy() for i in starts))


def axles_of(userdata: Array) -> AxleForces:
    """Forces and slip angles of the two axles out of `userdata`, shape (NUSERDATA,)."""
    Fx, Fy, Fz, _, _, mu = wheels_of(userdata)
    load = Fz.sum()
    return AxleForces(
        Fyf=float(Fy[0] + Fy[1]),
        Fyr=float(Fy[2] + Fy[3]),
        Fzf=float(Fz[0] + Fz[1]),
        Fzr=float(Fz[2] + Fz[3]),
        alpha_f=float(userdata[callbacks.ALPHA_F]),
        alpha_r=float(userdata[callbacks.ALPHA_R]),
        Fxf=float(Fx[0] + Fx[1]),
        Fxr=float(Fx[2] + Fx[3]),
        mu=float(mu @ Fz / load if load > 0.0 else mu.mean()),
    )
