"""Tire property files against forces that other formulas and other software give.

Two published sets, quoted from Project Chrono's data (BSD-3): Sedan_Pac02Tire.tir (245/40 R18, the
Adams handbook's; its file has no combined slip, which CommonRoad publishes for the same tire in
parameters_tire.yaml) and mf_185_80R14.tir (VW microbus). The formula below is written from Pacejka,
Tire and Vehicle Dynamics (3rd ed. 2012), eqs. 4.E9-4.E30 (pure slip) and 4.E50-4.E67 (combined),
without shifts and camber, in the book's own signs; it shares no code with the package.
"""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.tir import read_tir, read_tir_file, write_tir
from lpvmpc.errors import DataError
from lpvmpc.studies.reference import golden_tire

SEDAN = dict(
    FNOMIN=4850, UNLOADED_RADIUS=0.344, VERTICAL_STIFFNESS=280835.2941, VERTICAL_DAMPING=2000,
    LFZO=0.81, PCX1=1.6411, PDX1=1.1739, PDX2=-0.16395, PEX1=0.46403, PEX2=0.25022, PEX3=0.067842,
    PEX4=-3.7604e-5, PKX1=22.303, PKX2=0.48896, PKX3=0.21253, PHX1=0.0012297, PHX2=0.0004318,
    PVX1=-8.8098e-6, PVX2=1.862e-5, PTX1=2.3657, PTX2=1.4112, PTX3=0.56626, PCY1=1.3507,
    PDY1=1.0489, PDY2=-0.18033, PDY3=-2.8821, PEY1=-0.0074722, PEY2=-0.0063208, PEY3=-9.9935,
    PEY4=-760.14, PKY1=-21.92, PKY2=2.0012, PKY3=-0.024778, PHY1=0.0026747, PVY1=0.037318,
    PTY1=2.1439, PTY2=1.9829, QBZ1=10.904, QBZ2=-1.8412, QCZ1=1.2136, QDZ1=0.093509,
    QDZ2=-0.0092183, QDZ6=-0.0067783, QEZ1=-1.5697, QHZ1=0.0047326, QTZ1=0.2, MBELT=5.4,
    RBX1=13.276, RBX2=-13.778, RCX1=1.2568, REX1=0.65225, RBY1=7.1433, RBY2=9.1916,
    RBY3=-0.027856, RCY1=1.0719, REY1=-0.27572, RHY1=5.7448e-6, RVY1=-0.027825, RVY5=1.9,
)
MICROBUS = dict(
    FNOMIN=3800, UNLOADED_RADIUS=0.376, VERTICAL_STIFFNESS=1.75e5, VERTICAL_DAMPING=50, LFZO=1,
    PCX1=1.5587, PDX1=1.09, PDX2=-0.079328, PEX1=0.27403, PEX2=0.10232, PEX3=0.074903, PKX1=19.733,
    PKX2=0.093405, PKX3=0.12433, PHX1=-0.001779, PVX1=-9.9052e-6, PTX1=1.9021, PTX2=-0.0014739,
    PTX3=0.03631, PCY1=1.4675, PDY1=0.94002, PDY2=-0.17669, PDY3=-0.69602, PEY1=0.0040023,
    PEY2=0.00085719, PEY3=41.465, PKY1=-12.536, PKY2=1.3856, PKY3=-0.93342, PHY1=0.0024749,
    PVY1=0.031255, PTY1=1.8473, PTY2=1.9465, RBX1=14.927, RBX2=-10.534, RCX1=1.1288, REX1=0.62334,
    REX2=-0.0039079, RHX1=0.001683, RBY1=5.5228, RBY2=2.7966, RBY3=0.08688, RCY1=1.0783,
    REY1=0.055543, RHY1=-0.0027141, RVY1=0.0076305, QSY1=0.01, QBZ1=9.2824, QBZ2=-2.6095,
    QCZ1=1.1119, QDZ1=0.14332, QDZ2=-0.0062385, QDZ6=-0.0073867, QEZ1=-2.9203,
)
UNITS = dict(LENGTH="meter", FORCE="newton", ANGLE="radian", MASS="kg", TIME="second")


def text_of(values, units=UNITS, head="PROPERTY_FILE_FORMAT = 'PAC2002'"):
    lines = ["[UNITS]", *(f"{k} ='{v}'  $ of {k}" for k, v in units.items())]
    lines += ["[MODEL]", head, "[SHAPE]", "{radial width}", " 1.0  0.4", "[PARAMETER]"]
    return "\n".join([*lines, *(f"{k:24} = {v!r}   $ text = 3" for k, v in values.items())])


def save(path: Path, values, **how) -> Path:
    path.write_text(text_of(values, **how))
    return path


def book(p, kappa, alpha_star, Fz):
    """Fx, Fy of Pacejka's book, ISO signs: alpha* = tan(alpha) sgn(Vcx), Fy = -stiffness alpha*."""
    Fz0 = p["FNOMIN"] * p["LFZO"]
    dfz = (Fz - Fz0) / Fz0

    def sine(B, C, D, E, x):
        return D * math.sin(C * math.atan(B * x - E * (B * x - math.atan(B * x))))

    def cosine(B, C, E, x):
        return math.cos(C * math.atan(B * x - E * (B * x - math.atan(B * x))))

    Kx = Fz * (p["PKX1"] + p["PKX2"] * dfz) * math.exp(p["PKX3"] * dfz)  # 4.E15
    Dx = (p["PDX1"] + p["PDX2"] * dfz) * Fz  # 4.E12, 4.E13
    Ex = p["PEX1"] + p["PEX2"] * dfz  # 4.E14 without the square, which is listed as ignored
    Fx0 = sine(Kx / (p["PCX1"] * Dx), p["PCX1"], Dx, Ex, kappa)  # 4.E9
    Ky = p["PKY1"] * Fz0 * math.sin(2.0 * math.atan(Fz / (p["PKY2"] * Fz0)))  # 4.E25
    Dy = (p["PDY1"] + p["PDY2"] * dfz) * Fz  # 4.E22, 4.E23
    Ey = p["PEY1"] + p["PEY2"] * dfz  # 4.E24
    Fy0 = sine(Ky / (p["PCY1"] * Dy), p["PCY1"], Dy, Ey, alpha_star)  # 4.E19
    Bx = p["RBX1"] * math.cos(math.atan(p["RBX2"] * kappa))  # 4.E54
    By = p["RBY1"] * math.cos(math.atan(p["RBY2"] * alpha_star))  # 4.E62
    Gx = cosine(Bx, p["RCX1"], p["REX1"], alpha_star)  # 4.E51
    Gy = cosine(By, p["RCY1"], p["REY1"], kappa)  # 4.E59
    return Gx * Fx0, Gy * Fy0


@pytest.mark.parametrize("p", [SEDAN, MICROBUS], ids=["245/40R18", "185/80R14"])
def test_a_published_set_gives_the_forces_of_the_book(tmp_path, p):
    c = read_tir(save(tmp_path / "a.tir", p))
    for load in (0.4, 0.75, 1.0, 1.7):
        for kappa in (-0.4, -0.08, -0.01, 0.0, 0.03, 0.15, 0.7):
            for alpha in (-0.3, -0.06, -0.005, 0.0, 0.02, 0.12, 0.5):
                Fz = load * p["FNOMIN"] * p["LFZO"]
                Fx, Fy, _ = mf.forces(c, kappa, alpha, Fz, 1.0)
                theirs = book(p, kappa, -alpha, Fz)  # this package's slip angle is the other way
                assert (Fx, Fy) == pytest.approx(theirs, rel=1e-12, abs=1e-9)


def test_a_published_set_gives_the_forces_of_commonroads_software(tmp_path):
    """Stored forces of commonroad-vehicle-models 3.0.2; golden_tire computed them, LFZO 1."""
    stored = json.loads(golden_tire.FILE.read_text())
    c = read_tir(save(tmp_path / "a.tir", {**SEDAN, "LFZO": 1}))
    rows = [row[1:] for row in stored["rows"] if row[0] == "adams"]
    assert len(rows) > 100
    for Fz, kappa, tan_alpha, Fx, Fy in rows:
        # they are stored to a thousandth of a newton
        assert mf.forces(c, kappa, tan_alpha, Fz, 1.0)[:2] == pytest.approx((Fx, Fy), abs=2e-3)


def test_numbers_of_the_published_sets_worked_out_by_hand(tmp_path):
    """185/80 R14 at its nominal load of 3800 N, with a pocket calculator."""
    c = read_tir(save(tmp_path / "a.tir", MICROBUS))
    assert mf.slip_stiffness(c, 3800.0) == pytest.approx(74985.4)  # 3800 x 19.733
    # 12.536 x 3800 x 2 x 1.3856 / (1 + 1.3856^2): sin(2 atan(1/x)) = 2 x / (1 + x^2)
    assert mf.cornering_stiffness(c, 3800.0) == pytest.approx(45211.0, rel=1e-5)
    assert mf.peak_friction(c, 3800.0) == pytest.approx((1.09, 0.94002))
    # 0.376 x 0.14332 and 0.376 x 1.9021
    assert mf.pneumatic_trail(c, 0.0, 3800.0) == pytest.approx(0.053888, rel=1e-4)
    assert mf.relaxation_lengths(c, 3800.0)[0] == pytest.approx(0.71519, rel=1e-4)


def test_what_is_ignored_is_listed_with_what_it_would_do(tmp_path):
    file = read_tir_file(save(tmp_path / "a.tir", MICROBUS | {"ODD1": 3, "FZMAX": 8550}))
    assert file.format == "PAC2002" and file.zero == ()
    assert file.ignored["PHY1"].startswith("would shift Fy: ply steer")
    assert file.ignored["PDY3"] == "would change friction, stiffness or curvature with camber"
    assert file.ignored["QDZ6"] == "would add a residual aligning moment"
    assert file.ignored["ODD1"] == "is unknown here"
    assert not {"FZMAX", "PKY1", "LFZO", "PROPERTY_FILE_FORMAT"} & set(file.ignored)
    assert any(s.startswith("PHY1, PVY1: would shift Fy") for s in file.sentences())


IMPERIAL = dict(LENGTH="inch", FORCE="pound_force", ANGLE="deg", MASS="slug", TIME="millisecond")


def test_units_of_every_kind_give_the_same_tire(tmp_path):
    si = read_tir(save(tmp_path / "a.tir", SEDAN))
    pound, inch, deg = 4.4482216152605, 0.0254, math.degrees(1.0)
    other = SEDAN | {
        "FNOMIN": SEDAN["FNOMIN"] / pound, "UNLOADED_RADIUS": SEDAN["UNLOADED_RADIUS"] / inch,
        "VERTICAL_STIFFNESS": SEDAN["VERTICAL_STIFFNESS"] / pound * inch,
        "VERTICAL_DAMPING": SEDAN["VERTICAL_DAMPING"] / pound * inch * 1000.0,
        **{name: SEDAN[name] / deg for name in ("PKY1", "RBX1", "RBY2", "QBZ1")},
    }
    np.testing.assert_allclose(read_tir(save(tmp_path / "b.tir", other, units=IMPERIAL)), si,
                               rtol=1e-12)


def test_degrees_beside_coefficients_in_radians_are_noticed(tmp_path):
    with pytest.raises(DataError, match="PKY1 as '-21.92', which is 1255.92 .* from 1 to 200; the "
                                        "file says that its angles are no radians"):
        read_tir(save(tmp_path / "a.tir", SEDAN, units=UNITS | {"ANGLE": "degree"}))


MF61 = {k: v for k, v in MICROBUS.items() if not k.startswith("PT")} | dict(
    FITTYP=61, LONGITUDINAL_STIFFNESS=105000.0, LATERAL_STIFFNESS=79000.0, NOMPRES=190000.0,
    INFLPRES=209000.0, PPX1=-0.35, PPX2=0.2, PPX3=0.06, PPY1=0.6, PPY2=0.7, PPY3=-0.1, PFZ1=0.7,
    PPZ1=0.3, PKY4=2, PPY5=0.1,
)


def test_an_mf61_tire_is_read_at_its_pressure_and_relaxes_by_its_carcass(tmp_path):
    file = read_tir_file(save(tmp_path / "a.tir", MF61, head="[OPERATING_CONDITIONS]"))
    c, plain = file.coefficients, read_tir(save(tmp_path / "b.tir", MICROBUS))
    assert file.format == "MF6.1" and "PPY5" in file.ignored and "PPY1" not in file.ignored
    dpi = 0.1  # 209 / 190 kPa
    assert c[mf.PKY1] == pytest.approx(plain[mf.PKY1] * (1 + 0.6 * dpi))  # 4.E25
    assert c[mf.PKY2] == pytest.approx(plain[mf.PKY2] * (1 + 0.7 * dpi))
    assert c[mf.PKX1] == pytest.approx(plain[mf.PKX1] * (1 - 0.35 * dpi + 0.2 * dpi**2))  # 4.E15
    assert c[mf.PDX1] == pytest.approx(plain[mf.PDX1] * (1 + 0.06 * dpi))  # 4.E13
    assert c[mf.PDY2] == pytest.approx(plain[mf.PDY2] * (1 - 0.1 * dpi))  # 4.E23
    assert c[mf.KZ] == pytest.approx(plain[mf.KZ] * (1 + 0.7 * dpi))
    assert c[mf.QDZ1] == pytest.approx(plain[mf.QDZ1] * (1 - 0.3 * dpi))
    # sigma = slip stiffness over carcass stiffness, at the nominal pressure
    sigma_x, sigma_y = mf.relaxation_lengths(c, 3800.0)
    assert sigma_x == pytest.approx(74985.4 / 105000.0)
    assert sigma_y == pytest.approx(45211.0 / 79000.0, rel=1e-5)


def test_the_load_exponent_of_mf61_holds_at_the_nominal_load(tmp_path):
    file = read_tir_file(save(tmp_path / "a.tir", MF61 | {"PKY4": 1.6, "INFLPRES": 190000.0}))
    turn = math.atan(1.0 / MICROBUS["PKY2"])
    stiffness = 12.536 * 3800.0 * math.sin(1.6 * turn)
    assert mf.cornering_stiffness(file.coefficients, 3800.0) == pytest.approx(stiffness)
    assert "at the nominal load alone" in file.ignored["PKY4"]


@pytest.mark.parametrize("p", [SEDAN, MICROBUS, MF61])
def test_what_is_written_is_read_to_the_last_bit(tmp_path, p):
    c = read_tir(save(tmp_path / "a.tir", p))
    write_tir(tmp_path / "b.tir", c, comment="from a test\nof two lines")
    file = read_tir_file(tmp_path / "b.tir")
    np.testing.assert_array_equal(file.coefficients, c)
    assert not file.ignored and not file.zero


def test_changes_that_are_not_given_are_zero_and_said(tmp_path):
    some = {k: v for k, v in SEDAN.items() if k not in ("PDY2", "VERTICAL_DAMPING")}
    file = read_tir_file(save(tmp_path / "a.tir", some))
    assert file.zero == ("VERTICAL_DAMPING", "PDY2", "QSY1")
    assert file.coefficients[mf.PDY2] == 0.0


def test_a_vendors_section_says_nothing_of_the_formula(tmp_path):
    path = save(tmp_path / "a.tir", SEDAN)
    path.write_text(path.read_text() + "\n[ACME_TIRE_EXTENSION]\nPKY1 = 3\nGLUE = 'yes'\n")
    file = read_tir_file(path)
    assert file.coefficients[mf.PKY1] == 21.92
    assert file.ignored["[ACME_TIRE_EXTENSION]"] == "a vendor's section, which is not read"


def test_numbers_as_fortran_writes_them_are_read(tmp_path):
    text = text_of(SEDAN).replace("280835.2941", "2.808352941D+05")
    (tmp_path / "a.tir").write_text(text)
    assert read_tir(tmp_path / "a.tir")[mf.KZ] == pytest.approx(280835.2941)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"PDY1": 94.0}, "PDY1 as '94.0', which is 94, scaled, but must be from 0.05 to 3"),
        ({"PKY1": 0.0}, "PKY1 as '0.0', which is 0 in SI units, scaled, but must be from 1 to 200"),
        ({"UNLOADED_RADIUS": 344.0}, "UNLOADED_RADIUS as '344.0', which is 344 in SI units"),
        ({"FNOMIN": -4850}, "FNOMIN as '-4850'"),
        ({"LMUY": -1}, "PDY1 as '1.0489', which is -1.0489, scaled"),
        ({"PCY1": 0.0}, "PCY1 as '0.0'"),
        ({"PEY1": 30.0}, "PEY1 as '30.0'"),
        ({"VERTICAL_STIFFNESS": 1.0}, "VERTICAL_STIFFNESS as '1.0'"),
        ({"PROPERTY_FILE_FORMAT": "FIALA"}, "PROPERTY_FILE_FORMAT 'FIALA', whose coefficients"),
        ({"FITTYP": 94}, "FITTYP 94, which is another formula's"),
        ({"FITTYP": 61, "NOMPRES": 2e5, "INFLPRES": 2.0}, "INFLPRES 2, but must give it within"),
    ],
)
def test_what_no_tire_has_is_refused_in_a_sentence(tmp_path, change, message):
    with pytest.raises(DataError, match=message):
        read_tir(save(tmp_path / "a.tir", SEDAN | change))


def test_a_file_without_combined_slip_is_refused_by_the_names_it_lacks(tmp_path):
    chrono = {k: v for k, v in SEDAN.items() if not k.startswith("R")}
    with pytest.raises(DataError, match="lacks the tire coefficients RBX1, RCX1, RBY1, RCY1"):
        read_tir(save(tmp_path / "a.tir", chrono))
