"""A tire: what the plant, the controllers and the data ask of it, whichever law it follows.

A tire law is a module with a `NAME`, the names of its `COEFFICIENTS` and which of them must be
`POSITIVE`, and seven functions of the coefficients: `forces`, `peak_friction`, `slip_stiffness`,
`cornering_stiffness`, `pneumatic_trail`, `relaxation_lengths` and `rolling_resistance`; an eighth,
`scale`, makes the coefficients those of a stiffer or a worn tire. What every law shares stands
here: the vertical spring and damper, and the build-up of slip over the relaxation length.

Add a tire law: write the module `lpvmpc/car/<law>.py`, with `linear_tire` as the example. Its
coefficients begin with those of `WHEEL`; the others are its own. Give it the next number below, add
it to `LAWS`, and add its branch to the eight short functions from `size` to `rolling_resistance`.
A car has it where its model file says `<custom><text name="tire_law" data="NAME"/>` and gives its
coefficients as the numerics `tire_f` and `tire_r`; plant, oracle stiffness, parameters and data
then follow. tests/test_tire_law.py runs over `LAWS`: it finds a forgotten branch, and it demands
the properties that the rest relies on (slopes, symmetry, friction limit). Say in models/README.md
what the coefficients mean.

The branches are written out, instead of passing functions about, because the plant runs them inside
`mj_step` at every wheel: numba compiles them to one comparison, and keeps the code between
processes, which it does not for functions given as arguments.

Signs (ISO 8855 axes of the wheel: x forward, y left, z up): a positive slip ratio drives, a
positive tan_alpha gives a positive (left) force, that is tan_alpha = -V_y / |V|, opposite to
ISO 8855.
"""

import math
from typing import Any, NamedTuple, Protocol

from numba import njit

from lpvmpc.car import linear_tire, magic_formula
from lpvmpc.units import Array

WHEEL = ("FNOMIN", "R0", "KZ", "CZ")
"""First coefficients of every law: nominal load [N], unloaded radius [m], vertical stiffness [N/m]
and damping [N s/m]."""
FNOMIN, R0, KZ, CZ = range(len(WHEEL))

MAGIC_FORMULA, LINEAR = range(2)
"""Numbers of the laws in compiled code."""


class TireLaw(Protocol):
    """What a module of a tire law holds; the functions are compiled and take coefficients first."""

    NAME: str
    COEFFICIENTS: tuple[str, ...]
    POSITIVE: tuple[str, ...]
    forces: Any
    peak_friction: Any
    slip_stiffness: Any
    cornering_stiffness: Any
    pneumatic_trail: Any
    relaxation_lengths: Any
    rolling_resistance: Any
    scale: Any


LAWS: tuple[TireLaw, ...] = (magic_formula, linear_tire)
"""The laws by their numbers. The first is that of a model file that names none."""

_N_MAGIC_FORMULA, _N_LINEAR = (len(law.COEFFICIENTS) for law in LAWS)


class Tire(NamedTuple):
    """A tire's law and its coefficients, as plain numbers for compiled code."""

    law: int
    """Number of the law, an index of `LAWS`."""
    c: Array
    """Coefficients in the order of the law's `COEFFICIENTS`, shape (n,)."""


@njit(cache=True)
def size(law):
    """Number of coefficients of a law."""
    if law == LINEAR:
        return _N_LINEAR
    return _N_MAGIC_FORMULA


@njit(cache=True)
def forces(tire, slip_ratio, tan_alpha, Fz, friction):
    """Tire forces and aligning moment at given slip and load.

    Args:
        tire: `Tire`.
        slip_ratio: longitudinal slip -V_sx/|V| [-], positive drives.
        tan_alpha: tangent of the slip angle -V_y/|V| [-], positive gives a force to the left.
        Fz: load [N].
        friction: scale of the road's friction [-], positive. It scales the peak and keeps the
            slope: F(slip; friction) = friction F(slip / friction; 1).

    Returns:
        Fx, Fy [N] along the wheel's heading and to its left, Mz [N m].
    """
    if tire.law == LINEAR:
        return linear_tire.forces(tire.c, slip_ratio, tan_alpha, Fz, friction)
    return magic_formula.forces(tire.c, slip_ratio, tan_alpha, Fz, friction)


@njit(cache=True)
def peak_friction(tire, Fz):
    """Longitudinal and lateral peak friction at a load, friction scale 1 [-]."""
    if tire.law == LINEAR:
        return linear_tire.peak_friction(tire.c, Fz)
    return magic_formula.peak_friction(tire.c, Fz)


@njit(cache=True)
def slip_stiffness(tire, Fz):
    """Slope dFx/d slip_ratio at zero slip [N]."""
    if tire.law == LINEAR:
        return linear_tire.slip_stiffness(tire.c, Fz)
    return magic_formula.slip_stiffness(tire.c, Fz)


@njit(cache=True)
def cornering_stiffness(tire, Fz):
    """Slope dFy/d tan_alpha at zero slip [N/rad]."""
    if tire.law == LINEAR:
        return linear_tire.cornering_stiffness(tire.c, Fz)
    return magic_formula.cornering_stiffness(tire.c, Fz)


@njit(cache=True)
def pneumatic_trail(tire, tan_alpha, Fz):
    """Distance of the lateral force behind the wheel centre, friction scale 1 [m]."""
    if tire.law == LINEAR:
        return linear_tire.pneumatic_trail(tire.c, tan_alpha, Fz)
    return magic_formula.pneumatic_trail(tire.c, tan_alpha, Fz)


@njit(cache=True)
def relaxation_lengths(tire, Fz):
    """Longitudinal and lateral relaxation length at a load [m]."""
    if tire.law == LINEAR:
        return linear_tire.relaxation_lengths(tire.c, Fz)
    return magic_formula.relaxation_lengths(tire.c, Fz)


@njit(cache=True)
def rolling_resistance(tire):
    """Rolling resistance over load [-]."""
    if tire.law == LINEAR:
        return linear_tire.rolling_resistance(tire.c)
    return magic_formula.rolling_resistance(tire.c)


@njit(cache=True)
def vertical_force(tire, compression, rate):
    """Normal force of a spring and a damper in parallel [N]; a tire pushes, but never pulls.

    Fz = max(KZ compression + CZ rate, 0) while compressed, else 0.

    Args:
        tire: `Tire`.
        compression: R0 minus the height of the wheel centre over the road [m].
        rate: its time derivative [m/s].
    """
    if compression <= 0.0:
        return 0.0
    return max(tire.c[KZ] * compression + tire.c[CZ] * rate, 0.0)


@njit(cache=True)
def relax(u, V_slip, speed, sigma, dt):
    """Deflection of the contact patch after dt: u' = -(speed / sigma) u - V_slip, exactly.

    The slip that makes force is u / sigma; it tends to -V_slip / speed over the rolled distance
    sigma and is never divided by the speed, so a standing wheel is an elastic spring.

    Args:
        u: deflection [m].
        V_slip: slip velocity of the patch [m/s], held over dt.
        speed: speed of the wheel over the road [m/s], not negative.
        sigma: relaxation length [m].
        dt: time step [s].
    """
    x = speed * dt / sigma
    phi = -math.expm1(-x) / x if x > 1e-12 else 1.0  # (1 - exp(-x)) / x
    return u - x * phi * u - V_slip * dt * phi
