"""How far a tire's combined force fills its friction ellipse, by MF5.2 written out once more."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.units import Array


def filling(c: Array, slips: Array, loads: Sequence[float]) -> float:
    """Largest hypot(Fx / mu_x Fz, Fy / mu_y Fz) over all pairs of slips.

    F = mu Fz sin(C atan(B s - E (B s - atan(B s)))) cos(C' atan(B' s' - E' (B' s' - atan(B' s'))))
    with s the force's own slip and s' the other one; mu_x, mu_y are the peaks of pure slip.

    Args:
        c: Coefficients, in the order of `magic_formula.COEFFICIENTS`.
        slips: Slip ratios, and tangents of the slip angle, shape (n,).
        loads: Over FNOMIN.

    Source: Pacejka, Tire and Vehicle Dynamics, section 4.3.2.
    """
    q = dict(zip(mf.COEFFICIENTS, map(float, c), strict=True))
    kappa, alpha = np.meshgrid(slips, slips, indexing="ij")
    fullest = 0.0
    for load in loads:
        Fz, dfz = load * q["FNOMIN"], load - 1.0
        Kx = Fz * (q["PKX1"] + q["PKX2"] * dfz) * np.exp(q["PKX3"] * dfz)
        Ky = q["PKY1"] * q["FNOMIN"] * np.sin(2.0 * np.arctan(load / q["PKY2"]))
        squares = np.zeros_like(kappa)
        for way, K, own, other in (("X", Kx, kappa, alpha), ("Y", Ky, alpha, kappa)):
            mu = q[f"PD{way}1"] + q[f"PD{way}2"] * dfz
            C, E = q[f"PC{way}1"], min(q[f"PE{way}1"] + q[f"PE{way}2"] * dfz, 1.0)
            pure = np.sin(C * _angle(K / (C * mu * Fz) * own, E))
            B = q[f"RB{way}1"] * np.cos(np.arctan(q[f"RB{way}2"] * own))
            weight = np.cos(q[f"RC{way}1"] * _angle(B * other, q[f"RE{way}1"]))
            sweep = np.linspace(0.0, 1.0, 2001)
            peak = np.max(np.sin(C * _angle(K / (C * mu * Fz) * sweep, E)))
            squares += (pure * weight / peak) ** 2
        fullest = max(fullest, float(np.sqrt(squares.max())))
    return fullest


def _angle(x: Array, E: float) -> Array:
    """atan(x - E (x - atan x))."""
    return np.arctan(x - E * (x - np.arctan(x)))
