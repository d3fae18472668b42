"""The Magic Formula: the tire law of the packaged car, see `tire` for what a law is.

A subset of MF5.2 (the form of Adams PAC2002 files): load-dependent friction and stiffness, combined
slip by cosine weighting, pneumatic trail, first-order relaxation. Left out, because one symmetric
tire on a dry flat road is meant: camber, turn slip, inflation pressure, and every shift (ply steer,
conicity), so that all forces are exactly odd in their slip.

Signs (ISO 8855 axes of the wheel: x forward, y left, z up): a positive slip ratio drives, a
positive tan_alpha gives a positive (left) force, that is tan_alpha = -V_y / |V|, opposite to
ISO 8855. Each function takes the coefficients `c` of one tire as an array in the order of
`COEFFICIENTS`.
"""

import math

import numpy as np
from numba import njit

from lpvmpc.units import Array

NAME = "magic-formula"
"""Name of the law in a model file; a file that names no law has this one."""

COEFFICIENTS: tuple[str, ...] = (
    "FNOMIN",  # nominal load [N]
    "R0",  # unloaded radius [m]
    "KZ",  # vertical stiffness [N/m]
    "CZ",  # vertical damping [N s/m]
    "PCX1",  # longitudinal shape
    "PDX1",  # longitudinal friction at nominal load
    "PDX2",  # its change with load
    "PEX1",  # longitudinal curvature
    "PEX2",  # its change with load
    "PKX1",  # slip stiffness over load at nominal load
    "PKX2",  # its change with load
    "PKX3",  # exponent of its change with load
    "PCY1",  # lateral shape
    "PDY1",  # lateral friction at nominal load
    "PDY2",  # its change with load
    "PEY1",  # lateral curvature
    "PEY2",  # its change with load
    "PKY1",  # largest cornering stiffness over FNOMIN
    "PKY2",  # load over FNOMIN at which it is reached
    "RBX1",  # reduction of Fx by tan_alpha: slope
    "RBX2",  # its change with slip ratio
    "RCX1",  # shape
    "REX1",  # curvature
    "RBY1",  # reduction of Fy by slip ratio: slope
    "RBY2",  # its change with tan_alpha
    "RCY1",  # shape
    "REY1",  # curvature
    "PTX1",  # longitudinal relaxation length over R0 at nominal load
    "PTX2",  # its change with load
    "PTY1",  # largest lateral relaxation length over R0
    "PTY2",  # load over FNOMIN at which it is reached
    "QBZ1",  # pneumatic trail: slope
    "QCZ1",  # shape
    "QDZ1",  # trail over R0 at nominal load
    "QSY1",  # rolling resistance
)
"""Names and order of the coefficients; the meanings are those of MF5.2 files."""

POSITIVE: tuple[str, ...] = ("FNOMIN", "R0", "KZ")
"""Coefficients that must be positive."""

N_COEFFICIENTS = len(COEFFICIENTS)

(FNOMIN, R0, KZ, CZ, PCX1, PDX1, PDX2, PEX1, PEX2, PKX1, PKX2, PKX3, PCY1, PDY1, PDY2, PEY1, PEY2,
 PKY1, PKY2, RBX1, RBX2, RCX1, REX1, RBY1, RBY2, RCY1, REY1, PTX1, PTX2, PTY1, PTY2, QBZ1, QCZ1,
 QDZ1, QSY1) = range(N_COEFFICIENTS)

SIGMA_MIN = 0.05
"""Shortest relaxation length [m]: a tire leaving the road forgets its deflection within 5 cm."""

MU_MIN = 0.1
"""Floor of the load-dependent friction, which a linear law would send below zero [-]."""


def coefficients(values: dict[str, float]) -> Array:
    """Coefficient array in the order of `COEFFICIENTS`.

    Args:
        values: coefficient by name; all names must be there, and no others.

    Returns:
        Read-only array, shape (N_COEFFICIENTS,).

    Raises:
        KeyError: a name is missing or unknown.
    """
    odd = set(values) ^ set(COEFFICIENTS)
    if odd:
        raise KeyError(f"missing or unknown tire coefficients: {', '.join(sorted(odd))}")
    array = np.array([values[name] for name in COEFFICIENTS], dtype=np.float64)
    array.flags.writeable = False
    return array


@njit(cache=True)
def _magic(K, C, D, E, x):
    """Magic Formula D sin(C atan(B x - E (B x - atan(B x)))) with slope K = B C D at zero."""
    bx = K / (C * D) * x
    return D * math.sin(C * math.atan(bx - E * (bx - math.atan(bx))))


@njit(cache=True)
def _weight(B, C, E, x):
    """Cosine weight of combined slip: 1 at x = 0, even, falling with |x|."""
    bx = B * x
    return math.cos(C * math.atan(bx - E * (bx - math.atan(bx))))


@njit(cache=True)
def cornering_stiffness(c, Fz):
    """Slope dFy/d tan_alpha at zero slip [N/rad].

    Ky = PKY1 FNOMIN sin(2 atan(Fz / (PKY2 FNOMIN))), with sin(2 atan x) = 2 x / (1 + x^2).
    """
    x = Fz / (c[PKY2] * c[FNOMIN])
    return c[PKY1] * c[FNOMIN] * 2.0 * x / (1.0 + x * x)


@njit(cache=True)
def slip_stiffness(c, Fz):
    """Slope dFx/d slip_ratio at zero slip [N]: Fz (PKX1 + PKX2 dfz) exp(PKX3 dfz)."""
    dfz = Fz / c[FNOMIN] - 1.0
    return Fz * (c[PKX1] + c[PKX2] * dfz) * math.exp(c[PKX3] * dfz)


@njit(cache=True)
def peak_friction(c, Fz):
    """Longitudinal and lateral peak friction at a load, friction scale 1 [-]."""
    dfz = Fz / c[FNOMIN] - 1.0
    return max(c[PDX1] + c[PDX2] * dfz, MU_MIN), max(c[PDY1] + c[PDY2] * dfz, MU_MIN)


@njit(cache=True)
def pneumatic_trail(c, tan_alpha, Fz):
    """Distance of the lateral force behind the wheel centre, friction scale 1 [m].

    t = R0 QDZ1 (Fz / FNOMIN) cos(QCZ1 atan(QBZ1 tan_alpha))
    """
    return c[R0] * c[QDZ1] * Fz / c[FNOMIN] * math.cos(c[QCZ1] * math.atan(c[QBZ1] * tan_alpha))


@njit(cache=True)
def forces(c, slip_ratio, tan_alpha, Fz, friction):
    """Tire forces and aligning moment at given slip and load.

    Pure slip: F0 = D sin(C atan(B x - E (B x - atan(B x)))), D = mu Fz, B = K / (C D).
    Combined: Fx = Fx0 Gx(tan_alpha), Fy = Fy0 Gy(slip_ratio), G a cosine weight.
    Aligning moment: Mz = -t Fy.
    Road friction by similarity: F(slip; friction) = friction F(slip / friction; 1), which scales
    the peak, keeps the slope, and keeps the shape of the friction ellipse.

    Args:
        c: coefficients, shape (N_COEFFICIENTS,).
        slip_ratio: longitudinal slip -V_sx/|V| [-], positive drives.
        tan_alpha: tangent of the slip angle -V_y/|V| [-], positive gives a force to the left.
        Fz: load [N].
        friction: scale of the road's friction [-], positive.

    Returns:
        Fx, Fy [N] along the wheel's heading and to its left, Mz [N m].

    Source: Pacejka, Tire and Vehicle Dynamics (3rd ed.), section 4.3.2, without shifts and camber;
    similarity: section 4.2.
    """
    if Fz <= 0.0:
        return 0.0, 0.0, 0.0
    kappa = slip_ratio / friction
    alpha = tan_alpha / friction
    dfz = Fz / c[FNOMIN] - 1.0
    mux, muy = peak_friction(c, Fz)
    # A curvature above 1 would turn the characteristic back through zero.
    Ex = min(c[PEX1] + c[PEX2] * dfz, 1.0)
    Ey = min(c[PEY1] + c[PEY2] * dfz, 1.0)
    Fx = _magic(slip_stiffness(c, Fz), c[PCX1], mux * Fz, Ex, kappa)
    Fy = _magic(cornering_stiffness(c, Fz), c[PCY1], muy * Fz, Ey, alpha)
    # cos(atan(x)) = 1 / sqrt(1 + x^2)
    Bx = c[RBX1] / math.sqrt(1.0 + (c[RBX2] * kappa) ** 2)
    By = c[RBY1] / math.sqrt(1.0 + (c[RBY2] * alpha) ** 2)
    Fx *= friction * _weight(Bx, c[RCX1], c[REX1], alpha)
    Fy *= friction * _weight(By, c[RCY1], c[REY1], kappa)
    return Fx, Fy, -pneumatic_trail(c, alpha, Fz) * Fy


@njit(cache=True)
def relaxation_lengths(c, Fz):
    """Longitudinal and lateral relaxation length at a load [m].

    sigma_x = R0 (Fz / FNOMIN) (PTX1 + PTX2 dfz),
    sigma_y = R0 PTY1 sin(2 atan(Fz / (PTY2 FNOMIN))).
    """
    load = Fz / c[FNOMIN]
    x = load / c[PTY2]
    sigma_x = c[R0] * load * (c[PTX1] + c[PTX2] * (load - 1.0))
    sigma_y = c[R0] * c[PTY1] * 2.0 * x / (1.0 + x * x)
    return max(sigma_x, SIGMA_MIN), max(sigma_y, SIGMA_MIN)


def scale(c, stiffness, friction, relaxation):
    """Change a tire in place by factors of cornering stiffness, friction and relaxation lengths.

    Friction by similarity, as that of the road: F(slip) = friction F0(slip / friction), Mz alike.
    """
    c[PKY1] *= stiffness
    for i in (PDX1, PDX2, PDY1, PDY2):
        c[i] *= friction
    for i in (RBX1, RBX2, RBY1, RBY2, QBZ1):
        c[i] /= friction
    for i in (PTX1, PTX2, PTY1):
        c[i] *= relaxation


@njit(cache=True)
def rolling_resistance(c):
    """Rolling resistance over load: QSY1 [-]."""
    return c[QSY1]
