import numpy as np
import pytest

from lpvmpc.car import magic_formula as mf
from lpvmpc.car.tir import read_tir
from lpvmpc.errors import DataError

TEXT = """$ a comment
[UNITS]
LENGTH = 'meter'
FORCE  = 'newton'
ANGLE  = 'radians'
[DIMENSION]
UNLOADED_RADIUS = 0.376   $ free radius
[VERTICAL]
FNOMIN = 3800
VERTICAL_STIFFNESS = 1.75e5
[SCALING_COEFFICIENTS]
LMUY = 0.5 $ user
[LATERAL_COEFFICIENTS]
"""


def write(path, text=TEXT, without=(), **changes):
    given = ("FNOMIN", "R0", "KZ", "CZ", "QSY1")
    values = {name: 1.0 for name in mf.COEFFICIENTS if name not in given} | changes
    lines = (f"{k} = {v}  ! text" for k, v in values.items() if k not in without)
    path.write_text(text + "\n".join(lines))
    return path


def test_a_file_is_read_with_its_scaling_factors(tmp_path):
    c = read_tir(write(tmp_path / "a.tir", PKY1=-12.5, PDY1=0.9, PCX1=1.55))
    assert c[mf.R0] == 0.376
    assert c[mf.FNOMIN] == 3800
    assert c[mf.KZ] == 175000
    assert c[mf.PKY1] == 12.5  # positive in this package's sign of the slip angle
    assert c[mf.PDY1] == 0.45  # times LMUY
    assert c[mf.PCX1] == 1.55
    assert c[mf.QSY1] == 0.0  # optional


def test_a_missing_coefficient_is_named(tmp_path):
    with pytest.raises(DataError, match="lacks the tire coefficients PKY1, RBX1"):
        read_tir(write(tmp_path / "a.tir", without=("PKY1", "RBX1")))


def test_units_that_are_none_are_refused(tmp_path):
    with pytest.raises(DataError, match="LENGTH in 'parsec', but must give it in one of meter"):
        read_tir(write(tmp_path / "a.tir", text=TEXT.replace("meter", "parsec")))


@pytest.mark.parametrize("value", ["many", "nan", "inf", ""])
def test_what_is_no_finite_number_is_named(tmp_path, value):
    with pytest.raises(DataError, match=f"PCY1 as '{value}', but must give a finite number"):
        read_tir(write(tmp_path / "a.tir", PCY1=value))


def test_the_mass_of_the_tire_is_not_the_unit_of_mass(tmp_path):
    inertia = "[INERTIA]\nMASS = 9.3 $ of the tire\n"
    plain = read_tir(write(tmp_path / "a.tir"))
    np.testing.assert_array_equal(read_tir(write(tmp_path / "b.tir", text=inertia + TEXT)), plain)
    pounds = TEXT.replace("[UNITS]", "[UNITS]\nMASS = 'talent'")
    with pytest.raises(DataError, match="MASS in 'talent', but must give it in one of kg"):
        read_tir(write(tmp_path / "c.tir", text=inertia + pounds))


def test_a_missing_file_is_one_sentence(tmp_path):
    with pytest.raises(DataError, match="none.tir cannot be read"):
        read_tir(tmp_path / "none.tir")
