"""A car as a folder, and its MJCF written from numbers."""

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from lpvmpc import Command, Plant
from lpvmpc.car import magic_formula as mf
from lpvmpc.car.numbers import CarFile, CarNumbers, read_car_file
from lpvmpc.errors import DataError, ModelError, OptionError
from lpvmpc.plant.car_folder import adopt, packaged_sha256, read_car, write_car
from lpvmpc.plant.mjcf import compile_model, parameters
from lpvmpc.plant.vehicle_xml import car_of, numbers_of, static_loads, tires_of, written
from lpvmpc.units import GRAVITY

ARRAYS = (
    "body_mass", "body_inertia", "body_pos", "body_ipos", "jnt_stiffness", "qpos_spring",
    "dof_damping", "tendon_stiffness", "numeric_data",
)


@pytest.fixture(scope="module")
def zoe():
    return compile_model(visual=False)


@pytest.fixture(scope="module")
def numbers(zoe) -> CarNumbers:
    return numbers_of(zoe)


def model_of(xml: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(xml)


def test_the_packaged_car_written_from_its_numbers_is_itself(zoe, numbers):
    again = model_of(written(numbers, *tires_of(zoe), ay_limit=7.02))
    for name in ARRAYS:  # vehicle.xml has its preloads and inertias to nine digits
        there, here = np.ravel(getattr(zoe, name)), np.ravel(getattr(again, name))
        np.testing.assert_allclose(here, there, rtol=1e-8, atol=1e-8, err_msg=name)


def short_car(**numbers) -> CarFile:
    return CarFile(name="short", title="", numbers=numbers, sources={}, tires=(None, None))


@pytest.mark.parametrize("seed", range(40))
def test_a_short_car_toml_makes_a_car(zoe, numbers, seed):
    """Mass, axles, track and yaw inertia alone: whatever else there is follows, to scale."""
    draw = np.random.default_rng(seed).uniform
    m, length, front, track = draw(750, 2600), draw(2.3, 3.4), draw(0.42, 0.58), draw(1.35, 1.7)
    short = {"m": m, "lf": length * (1 - front), "lr": length * front, "h": draw(0.35, 0.75),
             "track_f": track, "track_r": track, "Iz": m * (length * draw(0.44, 0.54)) ** 2}
    for given in (short, {k: v for k, v in short.items() if k != "Iz"}):
        whole, taken = short_car(**given).completed(numbers)
        written_down = numbers_of(model_of(written(whole, *tires_of(zoe))))
        for name, value in given.items():
            assert getattr(written_down, name) == pytest.approx(value, rel=1e-6), name
        assert {"Ixx", "Iyy", "spring_f"} <= set(taken) and not set(given) & set(taken)


def test_what_carries_a_car_grows_with_its_mass(numbers):
    twice = short_car(m=2.0 * numbers.m).completed(numbers)[0]
    for name in ("spring_f", "antiroll_r", "damper_f", "brake_torque", "Iz", "Ixx", "Iyy"):
        assert getattr(twice, name) == pytest.approx(2.0 * getattr(numbers, name)), name
    turned = short_car(Iz=1.5 * numbers.Iz).completed(numbers)[0]
    assert turned.Iyy == pytest.approx(1.5 * numbers.Iyy) and turned.Ixx == numbers.Ixx


def test_a_written_car_has_the_numbers_it_was_written_from(zoe, numbers):
    asked = replace(
        numbers, m=1100.0, lf=1.15, lr=1.42, h=0.6, Iz=1800.0, Ixx=400.0, Iyy=1700.0, track_f=1.39,
        track_r=1.36, J_w=1.2, R0=0.33, R_w=0.32, mu_f=0.9, mu_r=0.95, Cf=90e3, Cr=110e3,
        sigma_f=0.4, sigma_r=0.3, trail_f=0.03, trail_r=0.02, drive_front=0.25, damper_f=1800.0,
    )
    front, rear = (c.copy() for c in tires_of(zoe))
    front[mf.R0] = rear[mf.R0] = 0.33
    found = numbers_of(model_of(written(asked, front, rear)))
    for name, value in vars(asked).items():
        if name != "height":  # is drawn, and nothing else
            # the settled pose keeps sizes to a nanometre
            assert getattr(found, name) == pytest.approx(value, rel=1e-7), name


def test_a_written_car_stands_level_on_its_static_loads(zoe, numbers):
    heavy = replace(numbers, m=2100.0, lf=1.5, lr=1.3, h=0.75, Ixx=900.0, Iyy=4000.0, Iz=4200.0)
    plant = Plant(model_of(written(heavy, *tires_of(zoe))))
    for _ in range(30):
        plant.step(Command(0.0, 0.0))
    loads = static_loads(heavy)
    # 1e-4: the wheels' damping has not quite ended the first millimetre's tenth
    np.testing.assert_allclose(plant.wheels.Fz, np.repeat(loads, 2), rtol=1e-4)
    assert sum(plant.wheels.Fz) == pytest.approx(2100.0 * GRAVITY, rel=1e-4)
    assert abs(plant.data.qpos[2] - 0.75) < 1e-4


@pytest.mark.parametrize("share", [1.0, 0.0, 0.4])
def test_the_drive_pulls_on_the_axles_as_its_share_says(zoe, numbers, share):
    car = replace(numbers, drive_front=share)
    plant = Plant(model_of(written(car, *tires_of(zoe))))
    plant.reset(vx=10.0)
    for _ in range(20):
        plant.step(Command(0.0, 1.0))
    Fx = plant.wheels.Fx
    rolled = parameters(plant.model).c_roll * plant.wheels.Fz
    rolled += car.J_w * plant.state.ax / car.R_w**2
    front, rear = (Fx + rolled)[:2].sum(), (Fx + rolled)[2:].sum()
    assert front / (front + rear) == pytest.approx(share, abs=0.01)
    assert plant.state.ax == pytest.approx(0.9, abs=0.06)  # 1 less rolling resistance and air


def test_a_rear_driven_car_has_no_more_power_than_its_motor(zoe, numbers):
    plant = Plant(model_of(written(replace(numbers, drive_front=0.0), *tires_of(zoe))))
    plant.reset(vx=25.0)
    for _ in range(30):
        plant.step(Command(0.0, 5.0))
    power = plant.data.userdata[45] * plant.state.wheel_speed[2:].mean()
    assert power == pytest.approx(65000.0, rel=1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"m": -1.0}, "m is -1.0, but must be a number from 200 to 20000"),
        ({"m": math.nan}, "m is nan"),
        ({"h": 30.0}, "h is 30.0, but must be a number from 0.1 to 2.5"),
        ({"brake_front": 75.0}, "brake_front is 75.0"),
        ({"Ixx": 8000.0}, "each smaller than the other two together"),
        ({"wheel_mass": 190.0, "knuckle_f": 190.0, "knuckle_r": 190.0}, "far more than the wheels"),
        ({"R_w": 0.7}, "near the loaded radius of the tires, 0.288 m"),
    ],
)
def test_numbers_that_no_car_has_are_refused(zoe, numbers, change, message):
    with pytest.raises(OptionError, match=message):
        written(replace(numbers, **change), *tires_of(zoe))


TOML = """
name = "mine"
[numbers]
m = 1200
lf = 1.1
lr = 1.4
drive_front = 0
[sources]
m = "measured: on a scale"
"""


def test_a_short_toml_makes_a_car_and_says_what_it_took_from_the_packaged_one(tmp_path):
    (tmp_path / "car.toml").write_text(TOML)
    file = read_car_file(tmp_path / "car.toml")
    xml, defaults = car_of(file)
    assert file.sources == {"m": ("measured", "on a scale")}
    assert {"h", "track_f", "Iz", "CdA"} <= set(defaults) and "m" not in defaults
    car = write_car(tmp_path / "mine", xml, name=file.name)
    p, zoe = car.params, read_car().params
    assert (car.name, p.m, p.drive_front) == ("mine", pytest.approx(1200.0), 0.0)
    shorter = (p.lf + p.lr) / (zoe.lf + zoe.lr)
    assert p.Iz == pytest.approx(zoe.Iz * 1200.0 / zoe.m * shorter**2)
    # stiffness per load is the tire's, and the loads are this car's
    assert p.Cf / (p.m * p.lr / p.wheelbase) == pytest.approx(
        zoe.Cf / (zoe.m * zoe.lr / zoe.wheelbase)
    )
    assert 6.0 < p.ay_limit < 0.82 * GRAVITY  # measured, on tires of 0.82


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("m = 1", "holds 'm', but may hold only name, title, tire"),
        ("name = 3\n[numbers]\nm = 1200", "name is 3, but must be a text"),
        ("[numbers]\nmass = 1200", "gives 'mass', but the numbers of a car are m, lf"),
        ("[numbers]\nm = '1200'", "m is '1200', but must be a number"),
        ("[numbers]\nm = 1200\n[sources]\nm = 'a scale'", "a grade .measured, published"),
        ("[numbers", "is no TOML"),
        ("name = 'empty'", r"has no table \[numbers\]"),
    ],
)
def test_a_toml_that_is_no_car_is_refused_in_a_sentence(tmp_path, text, message):
    (tmp_path / "car.toml").write_text(text)
    with pytest.raises(DataError, match=message):
        read_car_file(tmp_path / "car.toml")


@pytest.fixture
def folder(tmp_path, zoe, numbers):
    write_car(tmp_path / "one", written(numbers, *tires_of(zoe), ay_limit=7.02), made_by="a test")
    return tmp_path / "one"


def test_a_car_is_a_folder_that_says_whose_it_is(folder):
    car = read_car(folder)
    told = json.loads((folder / "provenance.json").read_text())
    assert (car.name, car.folder, told["made_by"]) == ("one", folder, "a test")
    assert told["car_sha256"] == car.sha256 != packaged_sha256()
    assert read_car().packaged and not car.packaged
    alone = read_car(folder / "vehicle.xml")
    assert alone.folder is None and alone.sha256 == car.sha256


def test_an_edited_or_foreign_vehicle_xml_is_refused_until_it_is_adopted(folder):
    file = folder / "vehicle.xml"
    file.write_text(file.read_text().replace('mass="1449"', 'mass="1549"'))
    with pytest.raises(ModelError, match="was changed since its files were made"):
        read_car(folder)
    assert adopt(folder).params.m == pytest.approx(1675.0)
    assert read_car(folder).params.m == pytest.approx(1675.0)


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda f: (f / "vehicle.xml").unlink(), ModelError, "is no car: it has no vehicle.xml"),
        (lambda f: (f / "vehicle.xml").write_text("<mujoco/>"), ModelError, "is not a car of this"),
        (lambda f: (f / "provenance.json").unlink(), DataError, "cannot be read: No such file"),
        (lambda f: (f / "provenance.json").write_text("[]"), DataError, "must hold 'name' and"),
        (lambda f: (f / "provenance.json").write_text("{"), DataError, "is no JSON"),
    ],
)
def test_a_damaged_folder_is_refused_in_a_sentence(folder, spoil, error, message):
    spoil(folder)
    with pytest.raises(error, match=message):
        read_car(folder)


def test_what_is_no_car_at_all_is_refused(tmp_path):
    with pytest.raises(ModelError, match="There is no car"):
        read_car(tmp_path / "nothing")
    (tmp_path / "x.toml").write_text("")
    with pytest.raises(ModelError, match="ends in .xml"):
        read_car(tmp_path / "x.toml")


def test_a_text_that_is_no_car_leaves_the_folder_as_it_was(folder):
    before = read_car(folder).sha256
    with pytest.raises(ModelError, match="vehicle.xml is not a car of this package"):
        write_car(folder, "<mujoco/>")
    assert read_car(folder).sha256 == before
