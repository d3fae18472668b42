"""A linear tire with a friction limit: a tire law for teaching and for tests.

Forces grow in proportion to slip and load until together they reach the friction circle, and stay
on it. On such tires the car is the linear single-track model of the textbooks until it slides:
moving load from the inner to the outer wheel changes nothing, since what one gains the other loses.
Its number of coefficients is small enough to set by hand. See `tire` for what a law is.

Each function takes the coefficients `c` of one tire as an array in the order of `COEFFICIENTS`.
"""

import math

from numba import njit

NAME = "linear"
"""Name of the law in a model file."""

COEFFICIENTS: tuple[str, ...] = (
    "FNOMIN",  # nominal load [N]
    "R0",  # unloaded radius [m]
    "KZ",  # vertical stiffness [N/m]
    "CZ",  # vertical damping [N s/m]
    "MU",  # friction [-]
    "CX",  # slip stiffness over load [-]
    "CY",  # cornering stiffness over load [1/rad]
    "TRAIL",  # pneumatic trail [m]
    "SIGMA_X",  # longitudinal relaxation length [m]
    "SIGMA_Y",  # lateral relaxation length [m]
    "C_ROLL",  # rolling resistance [-]
)
"""Names and order of the coefficients."""

POSITIVE: tuple[str, ...] = ("FNOMIN", "R0", "KZ", "MU", "CX", "CY", "SIGMA_X", "SIGMA_Y")
"""Coefficients that must be positive."""

MU, CX, CY, TRAIL, SIGMA_X, SIGMA_Y, C_ROLL = range(4, len(COEFFICIENTS))

TINY = 1e-3
"""Put in place of a friction [-] or length [m] of zero: MuJoCo calls the law once while it compiles
a model, before anybody can refuse it, and these are divided by."""


@njit(cache=True)
def forces(c, slip_ratio, tan_alpha, Fz, friction):
    """Tire forces and aligning moment at given slip and load.

    (Fx, Fy) = Fz (CX slip_ratio, CY tan_alpha) min(1, friction MU / |that vector / Fz|),
    Mz = -TRAIL Fy

    A sliding tire keeps the direction of its elastic force, so a locked wheel that also slips
    sideways pulls less to the side than one of equal stiffness in x and y would.

    Args:
        c: coefficients, shape (11,).
        slip_ratio: longitudinal slip [-], positive drives.
        tan_alpha: tangent of the slip angle [-], positive gives a force to the left.
        Fz: load [N].
        friction: scale of the road's friction [-], positive.

    Returns:
        Fx, Fy [N] along the wheel's heading and to its left, Mz [N m].

    Source: Rajamani, Vehicle Dynamics and Control, section 2.3 (linear tire), here with a limit.
    """
    if Fz <= 0.0:
        return 0.0, 0.0, 0.0
    fx, fy = c[CX] * slip_ratio, c[CY] * tan_alpha
    size, limit = math.sqrt(fx * fx + fy * fy), friction * max(c[MU], TINY)
    if size > limit:
        fx *= limit / size
        fy *= limit / size
    return Fz * fx, Fz * fy, -c[TRAIL] * Fz * fy


@njit(cache=True)
def peak_friction(c, Fz):
    """Longitudinal and lateral peak friction, friction scale 1 [-]: MU at every load."""
    mu = max(c[MU], TINY)
    return mu, mu


@njit(cache=True)
def slip_stiffness(c, Fz):
    """Slope dFx/d slip_ratio at zero slip [N]: CX Fz."""
    return c[CX] * Fz


@njit(cache=True)
def cornering_stiffness(c, Fz):
    """Slope dFy/d tan_alpha at zero slip [N/rad]: CY Fz."""
    return c[CY] * Fz


@njit(cache=True)
def pneumatic_trail(c, tan_alpha, Fz):
    """Distance of the lateral force behind the wheel centre [m]: TRAIL, also when sliding."""
    return c[TRAIL]


@njit(cache=True)
def relaxation_lengths(c, Fz):
    """Longitudinal and lateral relaxation length [m]: SIGMA_X, SIGMA_Y at every load."""
    return max(c[SIGMA_X], TINY), max(c[SIGMA_Y], TINY)


def scale(c, stiffness, friction, relaxation):
    """Change a tire in place by factors of cornering stiffness, friction and relaxation lengths."""
    c[CY] *= stiffness
    c[MU] *= friction
    for i in (SIGMA_X, SIGMA_Y):
        c[i] *= relaxation


@njit(cache=True)
def rolling_resistance(c):
    """Rolling resistance over load: C_ROLL [-]."""
    return c[C_ROLL]
