"""The seam for tires: any law through one interface, and the linear law as the proof."""

import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from lpvmpc.car import axle, linear_tire, tire
from lpvmpc.car.bicycle import AF, AR, NX, PHI, A
from lpvmpc.car.tire import LAWS, Tire
from lpvmpc.control.stiffness.models import OracleStiffness
from lpvmpc.errors import ModelError
from lpvmpc.interface import Command
from lpvmpc.learn import dataset, manoeuvres
from lpvmpc.plant.mjcf import (
    car_sha256,
    compile_model,
    model_path,
    numeric,
    packaged_car,
    tire_law,
    tires,
)
from lpvmpc.plant.plant import Plant

README = Path(__file__).parents[1] / "models" / "README.md"
FUNCTIONS = {
    "forces": (0.01, 0.02, 3000.0, 0.9), "peak_friction": (3000.0,), "slip_stiffness": (3000.0,),
    "cornering_stiffness": (3000.0,), "pneumatic_trail": (0.02, 3000.0),
    "relaxation_lengths": (3000.0,), "rolling_resistance": (),
}


def car_text(lines):
    """The packaged car with these lines in place of its tires."""
    text, n = re.subn(
        r'<numeric name="tire_f".*?/>\s*<numeric name="tire_r".*?/>',
        lambda found: lines,
        model_path("vehicle").read_text(),
        flags=re.DOTALL,
    )
    assert n == 1
    return text


def linear_lines():
    """What models/README.md tells one to write."""
    (block,) = re.findall(r"```xml\n(.*?)```", README.read_text(), flags=re.DOTALL)
    return block


def compiled(folder, lines):
    file = folder / "car.xml"
    file.write_text(car_text(lines))
    return compile_model(file, visual=False)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """The car on linear tires."""
    return compiled(tmp_path_factory.mktemp("linear"), linear_lines())


@pytest.fixture(scope="module")
def plant(model):
    return Plant(model)


@pytest.fixture(params=range(len(LAWS)), ids=[law.NAME for law in LAWS])
def one(request, model):
    """A tire of each law. A new law adds its model here."""
    of_law = {tire.MAGIC_FORMULA: compile_model(visual=False), tire.LINEAR: model}
    return tires(of_law[request.param])[0]


# Every law ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_interface_asks_the_module_of_the_law(one, name):
    asked = getattr(tire, name)(one, *FUNCTIONS[name])
    assert asked == getattr(LAWS[one.law], name)(one.c, *FUNCTIONS[name])


def test_every_law_begins_with_the_wheel_and_knows_its_size(one):
    coefficients = LAWS[one.law].COEFFICIENTS
    assert coefficients[: len(tire.WHEEL)] == tire.WHEEL
    assert tire.size(one.law) == len(coefficients) == len(one.c)


def test_every_law_is_odd_in_its_slip_and_has_its_stiffnesses_as_slopes(one):
    h = 1e-6
    for Fz in (1000.0, 4000.0, 7000.0):
        Fx, Fy, Mz = tire.forces(one, 0.02, 0.03, Fz, 0.7)
        assert tire.forces(one, -0.02, -0.03, Fz, 0.7) == (-Fx, -Fy, -Mz)
        slopes = tire.slip_stiffness(one, Fz), tire.cornering_stiffness(one, Fz)
        # the curvature of the Magic Formula is 1e-8 of the slope here
        assert tire.forces(one, h, 0.0, Fz, 0.7)[0] / h == pytest.approx(slopes[0], rel=1e-6)
        assert tire.forces(one, 0.0, h, Fz, 0.7)[1] / h == pytest.approx(slopes[1], rel=1e-6)
        assert tire.forces(one, 0.02, 0.03, 0.0, 0.7) == (0.0, 0.0, 0.0)


def test_every_law_scales_stiffness_friction_and_relaxation(one):
    law, changed = LAWS[one.law], Tire(one.law, one.c.copy())
    law.scale(changed.c, 1.3, 1.0, 1.5)
    assert tire.cornering_stiffness(changed, 3000.0) == pytest.approx(
        1.3 * tire.cornering_stiffness(one, 3000.0)
    )
    assert tire.relaxation_lengths(changed, 3000.0) == pytest.approx(
        [1.5 * sigma for sigma in tire.relaxation_lengths(one, 3000.0)]
    )
    worn = Tire(one.law, one.c.copy())
    law.scale(worn.c, 1.0, 0.8, 1.0)
    for slip, alpha in ((0.0, 0.02), (0.03, 0.05), (-0.2, 0.3), (0.1, 0.0)):
        road = tire.forces(one, slip, alpha, 4000.0, 0.8)  # as the road's friction does
        assert tire.forces(worn, slip, alpha, 4000.0, 1.0) == pytest.approx(road, rel=1e-12)


def test_no_law_leaves_its_friction_ellipse(one):
    for Fz in (500.0, 4000.0, 8000.0):
        mux, muy = tire.peak_friction(one, Fz)
        for kappa in np.linspace(-1.5, 1.5, 31):
            for alpha in np.linspace(-1.5, 1.5, 31):
                Fx, Fy, _ = tire.forces(one, kappa, alpha, Fz, 0.6)
                used = math.hypot(Fx / (0.6 * mux * Fz), Fy / (0.6 * muy * Fz))
                assert used <= 1.006  # the Magic Formula's cosine weights: models/README.md


# The linear law ----------------------------------------------------------------------------------


def test_linear_forces_are_linear_up_to_the_friction_circle():
    c = np.array([4000.0, 0.3, 2e5, 500.0, 0.8, 20.0, 15.0, 0.04, 0.3, 0.5, 0.01])
    Fx, Fy, Mz = linear_tire.forces(c, 0.01, 0.02, 3000.0, 1.0)
    assert (Fx, Fy, Mz) == pytest.approx((600.0, 900.0, -36.0), rel=1e-12)
    Fx, Fy, _ = linear_tire.forces(c, 0.3, -0.4, 3000.0, 0.5)  # elastic forces equal
    assert (Fx, Fy) == pytest.approx((1200.0 / math.sqrt(2), -1200.0 / math.sqrt(2)), rel=1e-12)


def test_a_car_on_linear_tires_turns_like_the_linear_single_track(plant):
    car = plant.params
    f, r = car.lf - car.trail_f, car.lr + car.trail_r  # levers of the lateral forces
    K = car.m / (f + r) * (r / car.Cf - f / car.Cr)
    for vx in (10.0, 15.0, 20.0, 25.0):
        for ay in (-1.0, 1.0, 3.0):
            state = plant.reset(vx=vx, kappa=ay / vx**2)
            gain = vx / (car.wheelbase + K * vx**2)
            # 1.2 %: against the air at 25 m/s the drive moves 0.7 % of the front load to the rear,
            # and both stiffnesses with it, which takes 0.9 % of the gain
            assert state.r / state.delta == pytest.approx(gain, rel=0.012)


def test_a_car_on_linear_tires_holds_a_straight_line(plant):
    plant.friction = 1.0
    state = plant.reset(vx=20.0)
    for _ in range(90):
        state = plant.step(Command(0.0, 0.3))
    assert abs(state.y) < 1e-9 and abs(state.psi) < 1e-9
    assert state.x > 59.0


def test_the_plants_force_never_leaves_the_friction_circle(plant):
    plant.friction = np.array([1.0, 0.8, 0.9, 0.5])
    plant.reset(vx=20.0, trim=False)
    used = []
    for k in range(120):
        plant.step(Command(0.3 * math.sin(0.2 * k), -6.0 if k > 60 else 2.0))
        w = plant.wheels
        load = np.maximum(w.Fz, 1e-9)
        used.append(np.hypot(w.Fx, w.Fy) / (plant.friction * 0.82 * load))
    plant.friction = 1.0
    assert np.max(used) <= 1.0 + 1e-9  # rounding
    assert np.max(used) > 0.999  # it slides


def test_the_plants_forces_are_those_of_the_law(plant, model):
    plant.reset(vx=18.0, kappa=0.01)
    w = plant.wheels
    for i in range(4):
        rubber = tires(model)[i // 2]
        slip = w.slip_ratio[i], math.tan(w.slip_angle[i])
        Fx, Fy, _ = tire.forces(rubber, *slip, w.Fz[i], 1.0)
        # tan(atan(x)) differs from x by rounding
        assert (w.Fx[i], w.Fy[i]) == pytest.approx((Fx, Fy), rel=1e-12)
        assert w.mu[i] == 0.82


def test_the_parameters_are_those_of_the_law(plant):
    car, mf = plant.params, packaged_car()
    assert (car.mu, car.c_roll, car.trail_r, car.sigma_f) == (0.82, 0.01, 0.033, 0.48)
    # three digits of CY
    assert (car.Cf, car.Cr) == pytest.approx((mf.Cf, mf.Cr), rel=0.005)


def test_the_oracle_gives_the_tangent_of_the_law(plant, model):
    car = plant.params
    oracle, rows, said = OracleStiffness(car, tires(model)), np.zeros((2, NX)), np.empty((1, 4))
    oracle.friction = 0.8
    axles = axle.axles(car, *tires(model))
    for alpha, a in ((0.01, 0.0), (0.03, -3.0), (-0.012, 2.0)):
        rows[:, AF], rows[:, AR], rows[:, PHI], rows[:, A] = alpha, alpha, 0.02, a
        oracle.horizon(None, rows, said)
        for k, (one, column) in enumerate(zip(axles, (0, 2), strict=True)):
            h = 1e-5
            high, low = (axle.lateral_force(one, alpha + d, 0.02, a, 0.8) for d in (h, -h))
            slope = max((high - low) / (2.0 * h), 0.05 * (car.Cf, car.Cr)[k])
            # beside the bends at each wheel's limit; sliding with brake force is curved
            assert said[0, column] == pytest.approx(slope, rel=2e-3)
            force = axle.lateral_force(one, alpha, 0.02, a, 0.8)
            assert said[0, column] * alpha + said[0, column + 1] == pytest.approx(force, rel=1e-9)


def test_data_are_collected_on_the_law(plant, model):
    rows = manoeuvres.drive(plant, "sine-sweep", np.random.default_rng(3), friction=1.0)
    table = dataset.table_of(
        rows, 0, "sine-sweep", model=model, friction=1.0, mass=plant.params.m, Ts=plant.Ts
    )
    assert len(rows) > 20
    load = table["Fzf_N"]
    # the slope over the angle is that over its tangent within 1e-5 at zero
    np.testing.assert_allclose(table["slope_zero_f_Nprad"], 14.5 * load, rtol=1e-5)
    used = np.hypot(table["Fxf_N"], table["Fyf_N"]) / (0.82 * load)
    elastic = used < 0.5
    assert elastic.sum() > 20 and np.ptp(table["Fyf_N"][elastic]) > 100.0
    # 2 %: forces are proportional to the tangent of the slip angle, and loads to each wheel's own
    np.testing.assert_allclose(table["Cf_Nprad"][elastic], (14.5 * load)[elastic], rtol=0.02)


# Names and numbers -------------------------------------------------------------------------------


def test_a_file_may_name_the_magic_formula_and_drives_the_same(tmp_path, model):
    packaged = compile_model(visual=False)
    lines = ""
    for name in ("tire_f", "tire_r"):
        values = " ".join(repr(value) for value in numeric(packaged, name).tolist())
        lines += f'<numeric name="{name}" data="{values}"/>'
    author = '<text name="author" data="linear"/>'  # another text is no law
    law = '<text name="tire_law" data="magic-formula"/>'
    named = compiled(tmp_path, author + law + lines)
    assert tire_law(named) == tire_law(packaged) == tire.MAGIC_FORMULA
    ends = []
    for car in (packaged, named):
        plant = Plant(car)
        plant.reset(vx=15.0, kappa=0.01)
        for _ in range(20):
            plant.step(Command(0.03, 1.0))
        ends.append(plant.qpos)
    assert (ends[0] == ends[1]).all()
    assert car_sha256(named) == car_sha256(packaged) != car_sha256(model)


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('data="linear"', 'data="lugre"', "unknown tire law 'lugre'; the choices are linear, m"),
        (" 0.48 0.01", " 0.48", "10 coefficients in tire_f, but the tire law 'linear' has 11: FN"),
        ("0.54", "nan", "gives nan for the tire coefficient SIGMA_Y in tire_r, which is not a fin"),
        ("0.82 20 32.4", "0 20 32.4", "gives 0 for the tire coefficient MU in tire_r, which must"),
        ("0.48", "-1", "gives -1 for the tire coefficient SIGMA_Y in tire_f, which must"),
        ('"tire_r"', '"rear"', "custom numerics after ay_limit must be tire_f, tire_r, not tire_"),
    ],
)
def test_a_wrong_law_is_one_sentence(tmp_path, monkeypatch, old, new, message):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log where it meets the nan
    lines = linear_lines()
    assert old in lines
    with pytest.raises(ModelError, match=re.escape(message)) as error:
        compiled(tmp_path, lines.replace(old, new))
    assert str(error.value).count(". ") == 0 and str(error.value).endswith(".")


def test_the_magic_formulas_coefficients_are_too_many_for_the_linear_law(tmp_path):
    text = model_path("vehicle").read_text()
    file = tmp_path / "car.xml"
    file.write_text(text.replace("<custom>", '<custom><text name="tire_law" data="linear"/>'))
    with pytest.raises(ModelError, match="gives 35 coefficients in tire_f"):
        compile_model(file)


def test_the_callbacks_leave_a_car_of_an_unknown_law_alone(model, tmp_path):
    file = tmp_path / "car.xml"
    file.write_text(car_text(linear_lines().replace('data="linear"', 'data="lugre"')))
    Plant(model)  # installs the callbacks
    unknown = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(unknown)
    mujoco.mj_forward(unknown, data)
    assert not data.userdata.any() and not data.qfrc_passive[:3].any()


def test_a_tire_is_its_law_and_its_coefficients(model):
    front, rear = tires(model)
    assert isinstance(front, Tire) and front.law == rear.law == tire.LINEAR
    assert rear.c[linear_tire.CY] == 32.4
