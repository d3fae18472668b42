"""What is in tire property files: names, sections, units, and what each entry does."""

from __future__ import annotations

import math
import re

KEYS = {"R0": "UNLOADED_RADIUS", "KZ": "VERTICAL_STIFFNESS", "CZ": "VERTICAL_DAMPING"}
"""Names in the file where they are not the formula's."""
FORMATS = {
    "PAC2002": "PAC2002", "MF_05": "MF5.2", "MF-TYRE": "MF5.2", "MF_TYRE": "MF5.2",
    "MF5.2": "MF5.2", "MF52": "MF5.2", "MF6.1": "MF6.1", "MF61": "MF6.1",
}
"""What PROPERTY_FILE_FORMAT may be, and which formula it means."""
FITTYP = {
    5: "MF5.2", 6: "MF5.2", 21: "MF5.2", 51: "MF5.2", 52: "MF5.2", 60: "MF6.1", 61: "MF6.1",
    62: "MF6.1",
}
"""The same of FITTYP."""
SECTIONS = {
    "", "MDI_HEADER", "MODEL", "DIMENSION", "OPERATING_CONDITIONS", "INERTIA", "VERTICAL",
    "STRUCTURAL", "CONTACT_PATCH", "INFLATION_PRESSURE_RANGE", "VERTICAL_FORCE_RANGE",
    "LONG_SLIP_RANGE", "SLIP_ANGLE_RANGE", "INCLINATION_ANGLE_RANGE", "SCALING_COEFFICIENTS",
    "LONGITUDINAL_COEFFICIENTS", "OVERTURNING_COEFFICIENTS", "LATERAL_COEFFICIENTS",
    "ROLLING_COEFFICIENTS", "ALIGNING_COEFFICIENTS", "TURNSLIP_COEFFICIENTS", "SHAPE", "PARAMETER",
    "PARAMETERS",
}
"""Sections of the formats; all others are vendors'."""
OPTIONAL = (
    "CZ", "PDX2", "PEX2", "PKX2", "PKX3", "PDY2", "PEY2", "RBX2", "REX1", "RBY2", "REY1", "PTX2",
    "QSY1",
)
"""Coefficients that count as zero where they are not given: changes of others. Those that decide
what the tire holds are not guessed."""
SCALED_BY = {
    "FNOMIN": ("LFZO",),
    "KZ": ("LCZ",),
    **{name: ("LMUX",) for name in ("PDX1", "PDX2")},
    **{name: ("LMUY",) for name in ("PDY1", "PDY2")},
    **{name: ("LEX",) for name in ("PEX1", "PEX2")},
    **{name: ("LEY",) for name in ("PEY1", "PEY2")},
    **{name: ("LKX",) for name in ("PKX1", "PKX2")},
    "PCX1": ("LCX",),
    "PCY1": ("LCY",),
    "PKY1": ("LKY",),
    "RBX1": ("LXAL",),
    "RBY1": ("LYKA",),
    **{name: ("LSGKP",) for name in ("PTX1", "PTX2")},
    "PTY1": ("LSGAL",),
    "QDZ1": ("LTR",),
    "QSY1": ("LMY",),
}
"""User scaling factors; those not in the file are 1."""
PRESSURE = ("PPX1", "PPX2", "PPX3", "PPX4", "PPY1", "PPY2", "PPY3", "PPY4", "PPZ1", "PFZ1")
"""Pressure terms of MF6.1 that are honoured."""

SI = {"LENGTH": "meter", "FORCE": "newton", "ANGLE": "radian", "MASS": "kg", "TIME": "second"}
"""Unit of each quantity where a file does not say."""
_POUND, _FOOT, _G = 0.45359237, 0.3048, 9.80665
UNITS: dict[str, dict[str, float]] = {
    "LENGTH": {
        "meter": 1.0, "metre": 1.0, "m": 1.0, "mm": 1e-3, "millimeter": 1e-3, "cm": 1e-2,
        "centimeter": 1e-2, "km": 1e3, "kilometer": 1e3, "inch": _FOOT / 12.0, "in": _FOOT / 12.0,
        "foot": _FOOT, "feet": _FOOT, "ft": _FOOT, "mile": 1609.344,
    },
    "FORCE": {
        "newton": 1.0, "n": 1.0, "kn": 1e3, "kilonewton": 1e3, "knewton": 1e3, "mn": 1e6,
        "kgf": _G, "kilogram_force": _G, "kg_force": _G, "lbf": _POUND * _G,
        "pound_force": _POUND * _G, "ounce_force": _POUND * _G / 16.0, "dyne": 1e-5,
    },
    "ANGLE": {
        "radian": 1.0, "rad": 1.0, "degree": math.radians(1.0), "deg": math.radians(1.0),
    },
    "MASS": {
        "kg": 1.0, "kilogram": 1.0, "gram": 1e-3, "g": 1e-3, "tonne": 1e3, "lbm": _POUND,
        "lb": _POUND, "pound_mass": _POUND, "ounce_mass": _POUND / 16.0,
        "slug": _POUND * _G / _FOOT, "kpound_mass": 1e3 * _POUND,
    },
    "TIME": {
        "second": 1.0, "sec": 1.0, "s": 1.0, "millisecond": 1e-3, "ms": 1e-3, "minute": 60.0,
        "min": 60.0, "hour": 3600.0,
    },
}
"""Units by quantity: factor to the SI unit."""
DIMENSION: dict[str, dict[str, int]] = {
    "FNOMIN": {"FORCE": 1},
    "R0": {"LENGTH": 1},
    "KZ": {"FORCE": 1, "LENGTH": -1},
    "CZ": {"FORCE": 1, "TIME": 1, "LENGTH": -1},
    **{name: {"ANGLE": -1} for name in ("PKY1", "RBX1", "RBY2", "QBZ1")},
}
"""Powers of the units in each coefficient that has any; all others are pure numbers."""

RANGES = {
    "FNOMIN": (100.0, 1e5), "R0": (0.05, 1.5), "KZ": (1e4, 1e7), "CZ": (0.0, 1e5),
    "PCX1": (0.5, 3.0), "PDX1": (0.05, 3.0), "PDX2": (-2.0, 2.0), "PEX1": (-50.0, 2.0),
    "PEX2": (-50.0, 50.0), "PKX1": (1.0, 300.0), "PKX2": (-200.0, 200.0), "PKX3": (-5.0, 5.0),
    "PCY1": (0.5, 3.0), "PDY1": (0.05, 3.0), "PDY2": (-2.0, 2.0), "PEY1": (-50.0, 2.0),
    "PEY2": (-50.0, 50.0), "PKY1": (1.0, 200.0), "PKY2": (0.1, 50.0),
    "RBX1": (0.0, 500.0), "RBX2": (-500.0, 500.0), "RCX1": (0.0, 3.0), "REX1": (-50.0, 50.0),
    "RBY1": (0.0, 500.0), "RBY2": (-500.0, 500.0), "RCY1": (0.0, 3.0), "REY1": (-50.0, 50.0),
    "PTX1": (0.0, 50.0), "PTX2": (-50.0, 50.0), "PTY1": (0.0, 50.0), "PTY2": (0.1, 100.0),
    "QBZ1": (0.0, 200.0), "QCZ1": (0.0, 3.0), "QDZ1": (-1.0, 1.0), "QSY1": (0.0, 0.5),
}
"""What a tire may have: lowest and highest value of each coefficient, in SI units and scaled."""

WRITTEN = {
    "DIMENSION": ("R0",),
    "VERTICAL": ("FNOMIN", "KZ", "CZ"),
    "LONGITUDINAL_COEFFICIENTS": (
        "PCX1", "PDX1", "PDX2", "PEX1", "PEX2", "PKX1", "PKX2", "PKX3", "RBX1", "RBX2", "RCX1",
        "REX1", "PTX1", "PTX2",
    ),
    "LATERAL_COEFFICIENTS": (
        "PCY1", "PDY1", "PDY2", "PEY1", "PEY2", "PKY1", "PKY2", "RBY1", "RBY2", "RCY1", "REY1",
        "PTY1", "PTY2",
    ),
    "ROLLING_COEFFICIENTS": ("QSY1",),
    "ALIGNING_COEFFICIENTS": ("QBZ1", "QCZ1", "QDZ1"),
}
"""Where each coefficient is written."""

EFFECTS = (
    (r"P[HV]X\d|LHX|LVX", "would shift Fx: a force at zero slip ratio"),
    (r"P[HV]Y[12]|LHY|LVY|LVYKA", "would shift Fy: ply steer and conicity, so that the car pulls "
                                  "to a side"),
    (r"PHY3|PVY[34]|LGAY|LKYG|PPY5|PKY[67]", "would add side force by camber (thrust)"),
    (r"PDX3|PDY3|PEY[34]|PKY[35]|PEY5|LGAX|PDXP\d", "would change friction, stiffness or curvature "
                                                    "with camber"),
    (r"PEX3|REX2|REY2|RHY2|PTX3", "would change a curvature or a relaxation length a little more "
                                  "with load"),
    (r"PEX4", "would make driving and braking differ"),
    (r"RHX1|RHY1|RB[XY][345]", "would shift or tilt the weights of combined slip"),
    (r"RVY\d", "would add a side force by drive and brakes at zero slip angle"),
    (r"QBZ[2-5]|QEZ\d|QDZ[2-5]|QHZ\d|LGAZ|LKZG|PPZ2|SSZ\d|LS", "would change the pneumatic trail "
     "with load, slip, camber or drive force"),
    (r"QBZ(9|10)|QDZ([6-9]|10|11)|LRES|LMR", "would add a residual aligning moment"),
    (r"QSX\d+|LMX|LVMX|PPMX1", "would add an overturning moment"),
    (r"QSY[2-8]", "would change the rolling resistance with speed, drive force, load or camber"),
    (r"[BDF]REFF|Q_RE0|Q_V1", "would make the rolling radius follow the load"),
    (r"Q_V2|Q_F[CZ]\w*|Q_A\d+|Q_CAM\d?|BOTTOM_\w+", "would make the vertical spring progressive"),
    (r"LMUV|LAMU", "would lower the friction with sliding speed"),
    (r"P(E?CP|KYP|HYP|DYP|DRP|BRP|CRP|DXP)\w*|Q[CDB]RP\d|Q_?DTP\d|Q(DR|CR|BR)P\d", "would be turn "
     "slip"),
    (r"QTZ1|LGYR|MBELT|MASS|I[XY][XYZ]|BELT_\w+|GRAVITY", "would give the belt its own mass and "
                                                          "gyroscopic moment"),
    (r"PCF[XYM]\w*|LONGITUDINAL_STIFFNESS|LATERAL_STIFFNESS|YAW_STIFFNESS|(FREQ|DAMP)_\w+|"
     r"DAMP_\w+", "would be the carcass' own motion"),
    (r"PP[XYZ]\d|PFZ1|INFLPRES|NOMPRES|Q_RA\d|Q_RB\d", "would follow the inflation pressure"),
)
"""What entries would do that are not honoured: pattern of the names, and words."""
SILENT = re.compile(
    r"(ALP|KPU|CAM|FZ|PRES)(MIN|MAX)|WIDTH|RIM_\w+|ASPECT_RATIO|LONGVL|VXLOW|USE_MODE|TYRESIDE|"
    r"FILE_\w+|MESSAGES|N_TIRE_STATES|USER_SUB_ID|CONTACT_MODEL|ROAD_\w+|ELLIPS_\w+"
)
"""Entries of description alone."""


def effect(key: str) -> str | None:
    """What an entry would do that is not honoured; None for one that only describes."""
    if SILENT.fullmatch(key):
        return None
    for pattern, words in EFFECTS:
        if re.fullmatch(pattern, key):
            return words
    return "is unknown here"
