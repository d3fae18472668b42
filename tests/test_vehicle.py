import dataclasses
import math
import shutil

import pytest

from lpvmpc.car import magic_formula as mf
from lpvmpc.errors import ModelError, OptionError, UnknownNameError
from lpvmpc.plant import mjcf
from lpvmpc.plant.mjcf import compile_model, model_path, models_dir, numeric, packaged_car
from lpvmpc.units import GRAVITY


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def test_mass_and_geometry_are_those_of_table_2(car):
    # 1e-6 relative: the digits typed in the file
    assert car.m == pytest.approx(1575.0, rel=1e-6)
    assert car.Iz == pytest.approx(2875.0, rel=1e-6)
    assert car.lf == pytest.approx(1.2, rel=1e-6)
    assert car.lr == pytest.approx(1.6, rel=1e-6)
    assert car.wheelbase == pytest.approx(2.8, rel=1e-6)
    assert car.CdA == pytest.approx(0.29 * 1.6)
    assert (car.rho_air, car.mu) == (1.225, 0.82)


def test_drive_is_that_of_the_motor(car):
    assert car.F_drive_max * car.R_w == pytest.approx(220.0 * 9.3)
    assert car.P_drive_max == 65e3
    assert car.ax_max(1.0) == pytest.approx(car.F_drive_max / car.m_eff)
    assert car.ax_max(30.0) == pytest.approx(65e3 / 30.0 / car.m_eff)
    assert car.ax_min == -car.F_brake_max / car.m_eff


def test_servo_is_that_of_the_design(car):
    assert (car.tau_delta, car.delta_rate_max) == (0.033, 1.0)
    assert car.delta_max == pytest.approx(math.pi / 6)


def test_axle_stiffness_is_twice_the_tires_slope_at_static_load(car):
    c = numeric(compile_model(), "tire_f")
    Fz = car.m * GRAVITY * car.lr / car.wheelbase / 2
    slope = mf.forces(c, 0.0, 1e-6, Fz, 1.0)[1] / 1e-6
    assert car.Cf == pytest.approx(2 * slope, rel=1e-6)


def test_axle_stiffness_meets_the_handling_target(car):
    assert pytest.approx(131e3, abs=5e3) == car.Cf
    assert pytest.approx(215e3, abs=10e3) == car.Cr


def test_parameters_no_car_can_have_are_refused(car):
    for name, value in {
        "m": -1.0,
        "lf": 0.0,
        "mu": math.nan,
        "c_roll": -0.1,
        "brake_front": 1.0,
    }.items():
        with pytest.raises(OptionError, match=name):
            dataclasses.replace(car, **{name: value})


def test_a_missing_or_broken_file_is_one_sentence(tmp_path):
    with pytest.raises(ModelError, match="no MJCF file"):
        compile_model(tmp_path / "none.xml")
    broken = tmp_path / "broken.xml"
    broken.write_text("<mujoco><worldbody>")
    with pytest.raises(ModelError, match="no valid MJCF") as error:
        compile_model(broken)
    assert "\n" not in str(error.value)


def test_models_are_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (models_dir() / "vehicle.xml").is_file()
    assert model_path("vehicle").name == "vehicle.xml"


def test_models_are_found_inside_an_installed_package(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "lpvmpc"
    shutil.copytree(models_dir(), package / "models")
    monkeypatch.setattr(mjcf, "PACKAGE", package)
    assert models_dir() == package / "models"


def test_an_installation_without_models_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(mjcf, "PACKAGE", tmp_path / "lpvmpc")
    with pytest.raises(ModelError, match="installation is damaged"):
        models_dir()


def test_an_unknown_model_lists_those_there_are():
    with pytest.raises(UnknownNameError, match=r"'tank'.*vehicle"):
        model_path("tank")
