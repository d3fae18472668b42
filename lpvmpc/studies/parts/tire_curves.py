"""A tire's forces over slip: sweeps, peaks, tables and what is drawn of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lpvmpc.car import magic_formula as mf
from lpvmpc.kit.findings import Table
from lpvmpc.picture import style
from lpvmpc.studies.reference import golden_tire
from lpvmpc.studies.study import Series
from lpvmpc.units import Array

LOADS = golden_tire.LOADS
"""Loads of the sweeps over FNOMIN."""
TABLE_2_MU = 0.82
"""Friction in the paper's Table 2."""


def sweep(c: Array, slips: Array, Fz: float, *, lateral: bool, other: float = 0.0) -> Array:
    """Fx, Fy, Mz over one slip, the other held.

    Args:
        c: coefficients.
        slips: slip ratios, or tangents of the slip angle where `lateral`, shape (n,).
        Fz: load [N].
        lateral: which slip is swept.
        other: the other slip.

    Returns:
        Forces [N] and moment [N m], shape (n, 3).
    """
    pairs = [(other, s) if lateral else (s, other) for s in slips]
    return np.array([mf.forces(c, kappa, alpha, Fz, 1.0) for kappa, alpha in pairs])


def peak(c: Array, Fz: float, *, lateral: bool, friction: float = 1.0) -> float:
    """Largest pure force over load, found by a sweep of the slip up to 1."""
    slips = np.linspace(0.0, 1.0, 2001)
    column = 1 if lateral else 0
    pairs = [(0.0, s) if lateral else (s, 0.0) for s in slips]
    return max(mf.forces(c, *pair, Fz, friction)[column] for pair in pairs) / Fz


def loads_table(tires: dict[str, Array]) -> Table:
    """What the tires can do at the loads of the sweeps."""
    rows = []
    for axle, c in tires.items():
        for load in LOADS:
            Fz = load * c[mf.FNOMIN]
            sigma_x, sigma_y = mf.relaxation_lengths(c, Fz)
            rows.append(
                (
                    axle, Fz, peak(c, Fz, lateral=False), peak(c, Fz, lateral=True),
                    1e-3 * mf.slip_stiffness(c, Fz), 1e-3 * mf.cornering_stiffness(c, Fz),
                    1e3 * mf.pneumatic_trail(c, 0.0, Fz), sigma_x, sigma_y,
                )
            )
    header = (
        "tire", "load [N]", "mu x", "mu y", "Kx [kN]", "Ky [kN/rad]", "trail [mm]",
        "sigma x [m]", "sigma y [m]",
    )
    return Table("loads", "One tire at the loads of the sweeps", header, rows)


RATIOS = np.linspace(-0.3, 0.3, 121)
ANGLES = np.radians(np.linspace(-15.0, 15.0, 121))


def curve_series(tires: dict[str, Array]) -> list[Series]:
    """Pure slip at the loads of the sweeps, for the CSV files."""
    along: dict[str, Any] = {"slip_ratio": RATIOS}
    across: dict[str, Any] = {"slip_angle_deg": np.degrees(ANGLES)}
    for axle, c in tires.items():
        for load in LOADS:
            Fz = load * c[mf.FNOMIN]
            along[f"Fx_{axle}_{load:g}_N"] = sweep(c, RATIOS, Fz, lateral=False)[:, 0]
            forces = sweep(c, np.tan(ANGLES), Fz, lateral=True)
            across[f"Fy_{axle}_{load:g}_N"] = forces[:, 1]
            across[f"Mz_{axle}_{load:g}_Nm"] = forces[:, 2]
    return [Series("longitudinal", along), Series("lateral", across)]


@style.styled
def draw_slip(tires: dict[str, Array]) -> Any:
    """Pure slip, aligning moment and load sensitivity of both tires."""
    figure, axes = style.axes(2, 2, height=4.6)
    colours = (style.SKY, style.BLUE, style.ORANGE)
    for axle, dashes in (("front", "-"), ("rear", (0, (4, 2)))):
        c = tires[axle]
        for load, colour in zip(LOADS, colours, strict=True):
            Fz = load * c[mf.FNOMIN]
            look = {"color": colour, "ls": dashes, "lw": 1.1 if axle == "front" else 0.8}
            name = {"label": f"{load:g} Fz0"} if axle == "front" else {}
            axes[0, 0].plot(
                100.0 * RATIOS, 1e-3 * sweep(c, RATIOS, Fz, lateral=False)[:, 0], **look, **name
            )
            forces = sweep(c, np.tan(ANGLES), Fz, lateral=True)
            axes[0, 1].plot(np.degrees(ANGLES), 1e-3 * forces[:, 1], **look)
            axes[1, 0].plot(np.degrees(ANGLES), forces[:, 2], **look)
        loads = np.linspace(0.2, 2.0, 40)
        for lateral, colour in ((False, style.RED), (True, style.GREEN)):
            mu = [mf.peak_friction(c, load * c[mf.FNOMIN])[int(lateral)] for load in loads]
            way = "lateral" if lateral else "longitudinal"
            axes[1, 1].plot(
                1e-3 * loads * c[mf.FNOMIN], mu, color=colour, ls=dashes, label=f"{way}, {axle}"
            )
    axes[1, 1].axhline(TABLE_2_MU, color=style.GREY, lw=0.8, ls=":", label="Table 2")
    for name, _, kappa, alpha, Fx, Fy in golden_tire.read()["rows"]:
        if name != "front":
            continue
        if alpha == 0.0 and abs(kappa) <= 0.3:
            axes[0, 0].plot(100.0 * kappa, 1e-3 * Fx, "o", color="black", ms=2.2, zorder=5)
        if kappa == 0.0 and abs(alpha) <= 0.27:
            at = math.degrees(math.atan(alpha))
            axes[0, 1].plot(at, 1e-3 * Fy, "o", color="black", ms=2.2, zorder=5)
    style.label(axes[0, 0], "slip ratio [%]", "Fx [kN]", "Longitudinal force")
    style.label(axes[0, 1], "slip angle [deg]", "Fy [kN]", "Lateral force")
    style.label(axes[1, 0], "slip angle [deg]", "Mz [N m]", "Aligning moment")
    style.label(axes[1, 1], "load [kN]", "peak friction", "Load sensitivity")
    axes[0, 0].legend(loc="upper left")
    axes[1, 1].legend(loc="upper right", ncols=2)
    axes[1, 1].set_ylim(0.68, 0.96)
    return figure
