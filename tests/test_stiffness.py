"""Stiffness models of the adaptive controller."""

import numpy as np
import pytest

from lpvmpc.car.bicycle import AF, AR, NX, VX
from lpvmpc.control.lpv_mpc import LPVMPC
from lpvmpc.control.stiffness.models import (
    C_MIN,
    ConstantStiffness,
    DryNetwork,
    NetworkStiffness,
    OracleStiffness,
    SecantOracle,
    secant,
)
from lpvmpc.errors import OptionError
from lpvmpc.interface import Command
from lpvmpc.plant.mjcf import compile_model, packaged_car
from lpvmpc.plant.mjcf import tires as coefficients
from lpvmpc.plant.plant import Plant


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def prediction(alpha_f=0.0, alpha_r=0.0, n=5):
    rows = np.zeros((n + 1, NX))
    rows[:, VX], rows[:, AF], rows[:, AR] = 15.0, alpha_f, alpha_r
    return rows


def test_constant_stiffness_is_the_same_everywhere(car):
    rows = np.full((5, 4), np.nan)
    ConstantStiffness(car, 0.8).horizon(None, prediction(0.1, 0.1), rows)
    np.testing.assert_array_equal(rows, np.tile([0.8 * car.Cf, 0.0, 0.8 * car.Cr, 0.0], (5, 1)))


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, 100.0])
def test_an_absurd_scale_is_named(car, scale):
    with pytest.raises(OptionError, match="stiffness scale"):
        ConstantStiffness(car, scale)


def test_the_secant_is_continuous_and_nominal_at_rest(car):
    alphas = np.linspace(-0.1, 0.1, 2001)
    values = [secant(car.Cf * 0.9 * a, a, car.Cf) for a in alphas]
    assert secant(0.0, 0.0, car.Cf) == car.Cf
    # it moves by 10 % of Cf over about 0.02 rad: 0.5 % of Cf per mrad at the most
    assert np.abs(np.diff(values)).max() < 1e-3 * car.Cf
    assert values[0] == pytest.approx(0.9 * car.Cf, rel=0.01)


def test_the_secant_stays_physical_when_the_force_has_the_wrong_sign(car):
    assert secant(-5000.0, 0.05, car.Cf) == C_MIN * car.Cf
    assert secant(50000.0, 0.05, car.Cf) == 1.5 * car.Cf


@pytest.mark.parametrize("kappa", [0.0, 0.02])
def test_the_oracle_gives_the_forces_of_the_plant(car, kappa):
    """In a steady bend its tangent, at the plant's slip, is the plant's axle force."""
    plant = Plant()
    plant.reset(vx=15.0, kappa=kappa)
    for _ in range(5):
        plant.step(Command(*plant.data.ctrl[:2]))
    forces, wheels = plant.axles, plant.wheels
    rows = prediction(np.mean(wheels.slip_angle[:2]), np.mean(wheels.slip_angle[2:]))
    rows[:, 9] = plant.roll
    oracle, tires = OracleStiffness(car, coefficients(compile_model())), np.empty((5, 4))
    oracle.observe(forces)
    oracle.horizon(None, rows, tires)
    front = tires[0, 0] * rows[0, AF] + tires[0, 1]
    rear = tires[0, 2] * rows[0, AR] + tires[0, 3]
    # loads come from the roll angle, not from the wheels: within 1 % of the axle's weight
    assert front == pytest.approx(forces.Fyf, abs=90.0)
    assert rear == pytest.approx(forces.Fyr, abs=70.0)


def test_the_secant_oracle_reproduces_the_force_it_is_told(car):
    plant = Plant()
    plant.reset(vx=15.0, kappa=0.02)
    oracle, tires, forces = SecantOracle(car), np.empty((5, 4)), plant.axles
    oracle.observe(forces)
    rows = prediction(forces.alpha_f, forces.alpha_r)
    oracle.horizon(None, rows, tires)
    assert tires[0, 0] * forces.alpha_f == pytest.approx(forces.Fyf, rel=0.1)
    assert (tires[:, [1, 3]] == 0.0).all()
    oracle.reset()
    oracle.horizon(None, prediction(), tires)
    np.testing.assert_allclose(tires[0], [car.Cf, 0.0, car.Cr, 0.0])


def test_the_network_learns_the_road_and_forgets_it(car):
    model = NetworkStiffness(car)
    assert model.friction == 1.0
    for _ in range(15):  # both axles give less than the dry tires would, at a large slip
        moment = 1.2 * -1200.0 - 1.6 * -500.0
        unmodelled = np.array([-1700.0 / car.m, moment / car.Iz])
        forces = np.array([1e4, 5500.0, 1e4, 2500.0])
        model.learn(unmodelled, forces, np.array([0.08, 0.04]), 0.0, 6.0)
    assert model.friction < 0.95
    model.reset()
    assert model.friction == 1.0


def test_the_dry_network_is_told_nothing_of_the_road(car):
    controller = LPVMPC(car, stiffness=DryNetwork(car))
    assert controller._learn is None and controller.stiffness.friction == 1.0


def test_friction_in_use_bounds_the_estimate_from_below(car):
    """A front axle that drives with 2.5 m/s2 is not on ice, whatever its tangent says."""
    model = NetworkStiffness(car)
    for _ in range(200):
        forces = np.array([1e4, 3000.0, 1e4, 500.0])
        model.learn(np.array([-5.0, -5.0]), forces, np.array([0.08, 0.04]), 2.5, 2.0)
    load = car.m * (9.81 * car.lr - 2.5 * car.h) / car.wheelbase
    used = np.hypot(car.m_eff * 2.5 / load, 2.0 / 9.81) / car.mu
    assert 0.9 * used <= model.friction < 0.75


def test_the_network_is_near_the_oracle_in_a_bend(car):
    rows = prediction(0.04, 0.02)
    rows[:, 2] = 0.25
    rows[:, 9] = car.m * car.h * 15.0 * 0.25 / car.K_phi
    learned, true = np.empty((5, 4)), np.empty((5, 4))
    NetworkStiffness(car).horizon(None, rows, learned)
    OracleStiffness(car, coefficients(compile_model())).horizon(None, rows, true)
    for C, F0, alpha in ((0, 1, 0.04), (2, 3, 0.02)):
        force = true[2, C] * alpha + true[2, F0]
        assert learned[2, C] * alpha + learned[2, F0] == pytest.approx(force, rel=0.05)
        assert learned[2, C] == pytest.approx(true[2, C], rel=0.15)
