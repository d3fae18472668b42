"""Stiffness models of the adaptive controller."""

import numpy as np
import pytest

from lpvmpc.bicycle import AF, AR, NX, VX
from lpvmpc.errors import OptionError
from lpvmpc.plant import Plant
from lpvmpc.stiffness import (
    C_MIN,
    ConstantStiffness,
    OracleStiffness,
    SecantOracle,
    secant,
)
from lpvmpc.vehicle import Command, VehicleParams


@pytest.fixture(scope="module")
def car():
    return VehicleParams.load()


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
    oracle, tires = OracleStiffness(car), np.empty((5, 4))
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
