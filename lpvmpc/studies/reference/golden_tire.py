"""Golden values of somebody else's Magic Formula, for the tire study.

    python -m lpvmpc.studies.reference.golden_tire

computes them anew with the tire functions of CommonRoad's vehicle models (TU Munich, BSD-3,
`pip install ".[fidelity]"`) and writes lpvmpc/data/tire_golden.json, which the study reads; so the
study itself does not need that package, and a test repeats the computation where it is installed.

CommonRoad's tire has no load dependence, so that its coefficients are computed here for each load,
by the formulas of MF5.2 written out once more and not taken from `car.magic_formula`. Its functions
know shifts and camber, which are set to zero since our tire has none. That also steps around an
error: `formula_longitudinal` adds the vertical shift inside the sine (a misplaced bracket), which
makes 154 N at worst for its own coefficients. The input slip ratio is negated inside that function.
"""

from __future__ import annotations

import json
import math
from importlib import resources
from pathlib import Path
from typing import Any

from lpvmpc.car.magic_formula import COEFFICIENTS
from lpvmpc.plant.mjcf import compile_model, tires

FILE = Path(str(resources.files("lpvmpc.studies") / "data" / "tire_golden.json"))

LOADS = (0.5, 1.0, 1.6)
"""Loads over FNOMIN."""
SLIPS = (-0.3, -0.05, -0.01, 0.0, 0.02, 0.08, 0.5)
"""Slip ratios, and tangents of the slip angle."""

ADAMS = {
    "FNOMIN": 4850.0, "R0": 0.344, "KZ": 280835.2941, "CZ": 2000.0,
    "PCX1": 1.6411, "PDX1": 1.1739, "PDX2": -0.16395, "PEX1": 0.46403, "PEX2": 0.25022,
    "PKX1": 22.303, "PKX2": 0.48896, "PKX3": 0.21253,
    "PCY1": 1.3507, "PDY1": 1.0489, "PDY2": -0.18033, "PEY1": -0.0074722, "PEY2": -0.0063208,
    "PKY1": 21.92, "PKY2": 2.0012,
    "RBX1": 13.276, "RBX2": -13.778, "RCX1": 1.2568, "REX1": 0.65225,
    "RBY1": 7.1433, "RBY2": 9.1916, "RCY1": 1.0719, "REY1": -0.27572,
    "PTX1": 2.3657, "PTX2": 1.4112, "PTY1": 2.1439, "PTY2": 1.9829,
    "QBZ1": 10.904, "QCZ1": 1.2136, "QDZ1": 0.093509, "QSY1": 0.01,
}
"""A 245/40 R18 tire, known from the Adams handbook, as Project Chrono publishes it
(data/vehicle/sedan/tire/Sedan_Pac02Tire.tir, BSD-3), its shifts and camber terms left out: a tire
that is not ours, so that the comparison does not hang on our coefficients."""


def sets() -> dict[str, dict[str, float]]:
    """Coefficients by name: the car's front and rear tires and the Adams handbook's."""
    front, rear = (
        dict(zip(COEFFICIENTS, map(float, one.c), strict=True)) for one in tires(_model())
    )
    return {"front": front, "rear": rear, "adams": ADAMS}


def _model() -> Any:
    return compile_model(visual=False)


def compute() -> dict[str, Any]:
    """Forces of CommonRoad's functions with our coefficients.

    Returns:
        `coefficients` by set and name, and `rows` of (set, Fz [N], slip ratio, tan_alpha, Fx [N],
        Fy [N]) in the signs of `lpvmpc.car.magic_formula`.

    Raises:
        ImportError: commonroad-vehicle-models is not installed.
    """
    from vehiclemodels.utils import tire_model as theirs
    from vehiclemodels.utils.tireParameters import TireParameters

    coefficients = sets()
    rows = []
    for name, c in coefficients.items():
        for load in LOADS:
            Fz = load * c["FNOMIN"]
            dfz = load - 1.0
            slope_y = c["PKY1"] * c["FNOMIN"] * math.sin(2.0 * math.atan(load / c["PKY2"]))
            zero = {field: 0.0 for field in TireParameters.__dataclass_fields__}
            p = TireParameters(**zero | dict(
                p_cx1=c["PCX1"],
                p_dx1=c["PDX1"] + c["PDX2"] * dfz,
                p_ex1=c["PEX1"] + c["PEX2"] * dfz,
                p_kx1=(c["PKX1"] + c["PKX2"] * dfz) * math.exp(c["PKX3"] * dfz),
                p_cy1=c["PCY1"],
                p_dy1=c["PDY1"] + c["PDY2"] * dfz,
                p_ey1=c["PEY1"] + c["PEY2"] * dfz,
                p_ky1=slope_y / Fz,
                r_bx1=c["RBX1"], r_bx2=c["RBX2"], r_cx1=c["RCX1"], r_ex1=c["REX1"],
                r_by1=c["RBY1"], r_by2=c["RBY2"], r_cy1=c["RCY1"], r_ey1=c["REY1"],
            ))
            for kappa in SLIPS:
                for alpha in SLIPS:
                    Fx = theirs.formula_longitudinal(-kappa, 0.0, Fz, p)
                    Fy, mu = theirs.formula_lateral(alpha, 0.0, Fz, p)
                    Fx = theirs.formula_longitudinal_comb(kappa, alpha, Fx, p)
                    Fy = theirs.formula_lateral_comb(kappa, alpha, 0.0, mu, Fz, Fy, p)
                    rows.append([name, Fz, kappa, alpha, Fx, Fy])
    return {"coefficients": coefficients, "rows": rows}


def read() -> dict[str, Any]:
    """The stored values, as `compute` returns them, with their `source`."""
    stored: dict[str, Any] = json.loads(FILE.read_text())
    return stored


def main() -> None:
    """Compute and store the values."""
    from importlib.metadata import version

    source = f"tire functions of commonroad-vehicle-models {version('commonroad-vehicle-models')}"
    content = {"source": source, **compute()}
    rows = ",\n  ".join(json.dumps(row) for row in content.pop("rows"))
    head = json.dumps(content, indent=1)[:-2]
    FILE.write_text(f'{head},\n "rows": [\n  {rows}\n ]\n}}\n')


if __name__ == "__main__":
    main()
