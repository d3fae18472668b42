import math

import numpy as np
import pytest

from lpvmpc.car import magic_formula as mf
from lpvmpc.car import tire
from lpvmpc.car.tire import Tire
from lpvmpc.plant.mjcf import compile_model, numeric

SLIPS = [0.002, 0.01, 0.05, 0.1, 0.2, 0.5, 1.0, 3.0]
LOADS = [500.0, 2000.0, 3500.0, 5000.0, 8000.0]


@pytest.fixture(scope="module", params=["tire_f", "tire_r"])
def c(request):
    return numeric(compile_model(), request.param)


def test_forces_are_odd_in_their_own_slip_and_even_in_the_other(c):
    for kappa in SLIPS:
        for alpha in SLIPS:
            Fx, Fy, Mz = mf.forces(c, kappa, alpha, 4000.0, 1.0)
            # exactly: a mirrored manoeuvre must give mirrored motion
            assert mf.forces(c, -kappa, alpha, 4000.0, 1.0) == (-Fx, Fy, Mz)
            assert mf.forces(c, kappa, -alpha, 4000.0, 1.0) == (Fx, -Fy, -Mz)
    assert mf.forces(c, 0.0, 0.0, 4000.0, 1.0) == (0.0, 0.0, 0.0)


def test_slopes_at_zero_are_the_stiffnesses(c):
    h = 1e-6  # the third-order term of the characteristic is 1e-8 of the slope here
    for Fz in LOADS:
        assert mf.forces(c, h, 0, Fz, 1.0)[0] / h == pytest.approx(
            mf.slip_stiffness(c, Fz), rel=1e-6
        )
        assert mf.forces(c, 0, h, Fz, 1.0)[1] / h == pytest.approx(
            mf.cornering_stiffness(c, Fz), rel=1e-6
        )


def test_peaks_are_friction_times_load(c):
    slips = np.linspace(0.0, 1.0, 5001)
    for Fz in LOADS:
        mux, muy = mf.peak_friction(c, Fz)
        # the grid of 2e-4 misses the flat peak by far less than 1e-4
        assert max(mf.forces(c, s, 0, Fz, 1.0)[0] for s in slips) == pytest.approx(
            mux * Fz, rel=1e-4
        )
        assert max(mf.forces(c, 0, s, Fz, 1.0)[1] for s in slips) == pytest.approx(
            muy * Fz, rel=1e-4
        )


def test_peak_friction_at_nominal_load_is_that_of_table_2(c):
    assert mf.peak_friction(c, c[mf.FNOMIN]) == (0.82, 0.82)


def test_friction_falls_with_load(c):
    mu = np.array([mf.peak_friction(c, Fz) for Fz in LOADS])
    assert (np.diff(mu, axis=0) < 0).all()


def test_combined_force_stays_in_the_friction_ellipse(c):
    slips = np.concatenate([np.linspace(0.0, 0.5, 101), [1.0, 3.0]])
    for Fz in LOADS:
        mux, muy = mf.peak_friction(c, Fz)
        for kappa in slips:
            for alpha in slips:
                Fx, Fy, _ = mf.forces(c, kappa, alpha, Fz, 1.0)
                # a cosine weight cannot follow an ellipse exactly: 0.5 % was allowed in the fit
                assert math.hypot(Fx / (mux * Fz), Fy / (muy * Fz)) < 1.005


def test_braking_reduces_lateral_grip(c):
    Fy = [mf.forces(c, -kappa, 0.08, 4000.0, 1.0)[1] for kappa in [0.0, *SLIPS]]
    assert (np.diff(Fy) < 0).all()
    assert Fy[-1] > 0


def test_less_friction_scales_the_peak_and_keeps_the_slope(c):
    slips = np.linspace(0.0, 1.0, 2001)
    full = max(mf.forces(c, 0, s, 4000.0, 1.0)[1] for s in slips)
    half = max(mf.forces(c, 0, s, 4000.0, 0.5)[1] for s in slips)
    assert half == pytest.approx(0.5 * full, rel=1e-4)  # grid, see above
    assert mf.forces(c, 0, 1e-6, 4000.0, 0.5)[1] == pytest.approx(
        mf.forces(c, 0, 1e-6, 4000.0, 1.0)[1], rel=1e-6
    )


def test_no_load_makes_no_force_and_no_nan(c):
    assert mf.forces(c, 0.3, 0.3, 0.0, 1.0) == (0.0, 0.0, 0.0)
    assert all(math.isfinite(f) for f in mf.forces(c, 0.3, 0.3, 1e-6, 1.0))


def test_vertical_force_pushes_only(c):
    one = Tire(tire.MAGIC_FORMULA, c)
    assert tire.vertical_force(one, 0.02, 0.0) == pytest.approx(4000.0)  # 200 kN/m
    assert tire.vertical_force(one, -0.001, 100.0) == 0.0
    assert tire.vertical_force(one, 0.001, -100.0) == 0.0


def test_aligning_moment_turns_the_wheel_back_with_the_trail(c):
    Fz, alpha = 4000.0, 1e-4
    _, Fy, Mz = mf.forces(c, 0, alpha, Fz, 1.0)
    assert Fy > 0 > Mz
    assert -Mz / Fy == pytest.approx(mf.pneumatic_trail(c, 0.0, Fz), rel=1e-5)  # even in alpha


def textbook(c, kappa, alpha, Fz):
    """The same law written from the book, with none of the code's shortcuts."""
    k = dict(zip(mf.COEFFICIENTS, c, strict=True))
    dfz = (Fz - k["FNOMIN"]) / k["FNOMIN"]

    def shape(B, C, E, x):
        return C * np.arctan(B * x - E * (B * x - np.arctan(B * x)))

    Dx = Fz * (k["PDX1"] + k["PDX2"] * dfz)
    Kx = Fz * (k["PKX1"] + k["PKX2"] * dfz) * np.exp(k["PKX3"] * dfz)
    Fx0 = Dx * np.sin(shape(Kx / (k["PCX1"] * Dx), k["PCX1"], k["PEX1"] + k["PEX2"] * dfz, kappa))
    Dy = Fz * (k["PDY1"] + k["PDY2"] * dfz)
    Ky = k["PKY1"] * k["FNOMIN"] * np.sin(2 * np.arctan(Fz / (k["PKY2"] * k["FNOMIN"])))
    Fy0 = Dy * np.sin(shape(Ky / (k["PCY1"] * Dy), k["PCY1"], k["PEY1"] + k["PEY2"] * dfz, alpha))
    Bxa = k["RBX1"] * np.cos(np.arctan(k["RBX2"] * kappa))
    Byk = k["RBY1"] * np.cos(np.arctan(k["RBY2"] * alpha))
    Fx = Fx0 * np.cos(shape(Bxa, k["RCX1"], k["REX1"], alpha))
    Fy = Fy0 * np.cos(shape(Byk, k["RCY1"], k["REY1"], kappa))
    trail = k["R0"] * k["QDZ1"] * (1 + dfz) * np.cos(k["QCZ1"] * np.arctan(k["QBZ1"] * alpha))
    return Fx, Fy, -trail * Fy


def test_forces_agree_with_the_formulas_of_the_book(c):
    for Fz in LOADS:
        for kappa in (-0.3, -0.02, 0.0, 0.07):
            for alpha in (-0.2, 0.0, 0.03, 0.12):
                # the same numbers up to the rounding of a dozen operations
                assert mf.forces(c, kappa, alpha, Fz, 1.0) == pytest.approx(
                    textbook(c, kappa, alpha, Fz), rel=1e-12, abs=1e-9
                )


def test_friction_is_a_similarity(c):
    for friction in (0.2, 0.5, 1.3):
        whole = mf.forces(c, 0.05 / friction, 0.04 / friction, 4000.0, 1.0)
        scaled = mf.forces(c, 0.05, 0.04, 4000.0, friction)
        assert scaled == pytest.approx([friction * f for f in whole], rel=1e-12)  # rounding


def test_golden_numbers_of_a_simple_tire():
    values = dict.fromkeys(mf.COEFFICIENTS, 0.0)
    values |= {"FNOMIN": 4000, "R0": 0.3, "PCX1": 1.5, "PDX1": 1, "PKX1": 20, "PCY1": 1.3}
    values |= {"PDY1": 1, "PKY1": 12, "PKY2": 1, "PTY2": 1, "RCX1": 1, "RCY1": 1, "QDZ1": 0.1}
    c = mf.coefficients(values)
    # by hand: Ky = 12 * 4000 * sin(2 atan 1) = 48000, B = 48000 / (1.3 * 4000) = 9.230769,
    # 4000 sin(1.3 atan(0.9230769)) = 4000 sin(0.969057) = 3297.2; trail 0.3 * 0.1 = 0.03
    Fx, Fy, Mz = mf.forces(c, 0.0, 0.1, 4000.0, 1.0)
    assert (Fx, Fy, Mz) == pytest.approx((0.0, 3297.2, -98.92), abs=0.5)  # four digits by hand
    # B = 20 / 1.5 = 13.3333, 4000 sin(1.5 atan(0.666667)) = 4000 sin(0.882004) = 3088.1
    assert mf.forces(c, 0.05, 0.0, 4000.0, 1.0)[0] == pytest.approx(3088.1, abs=0.5)


def test_relaxation_reaches_63_percent_after_one_length():
    sigma, speed, V_slip = 0.5, 10.0, -0.2
    u = 0.0
    for _ in range(50):  # 0.5 m in steps of 1 ms
        u = tire.relax(u, V_slip, speed, sigma, 1e-3)
    steady = -V_slip * sigma / speed
    assert u / steady == pytest.approx(1.0 - math.exp(-1.0), rel=1e-12)  # exact in any step


def test_a_standing_tire_is_a_spring():
    u = tire.relax(0.01, 0.3, 0.0, 0.5, 1e-3)
    assert u == pytest.approx(0.01 - 0.3e-3, rel=1e-12)
    # and the limit is smooth
    assert tire.relax(0.01, 0.3, 1e-9, 0.5, 1e-3) == pytest.approx(u, rel=1e-9)


def test_relaxation_lengths_stay_positive(c):
    assert mf.relaxation_lengths(c, 0.0) == (mf.SIGMA_MIN, mf.SIGMA_MIN)


def test_coefficients_name_what_is_missing():
    with pytest.raises(KeyError, match="PDX1"):
        mf.coefficients({name: 1.0 for name in mf.COEFFICIENTS if name != "PDX1"})
