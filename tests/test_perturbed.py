import numpy as np
import pytest

from lpvmpc import load_controller
from lpvmpc.control.stiffness.perturbed import PerturbedStiffness
from lpvmpc.errors import OptionError

LAW = np.array([100e3, 500.0, 200e3, -300.0])


class Tires:
    """A model that always says the same, and remembers what it was told."""

    name = "tires"
    friction = 0.7

    def __init__(self):
        self.resets, self.told = 0, None

    def reset(self):
        self.resets += 1

    def observe(self, forces):
        self.told = forces

    def horizon(self, state, prediction, tires):
        tires[:] = LAW


def asked(model, periods=1):
    """What a model says in each of some periods, shape (periods, 5, 4)."""
    said = np.zeros((periods, 5, 4))
    for tires in said:
        model.horizon(None, np.zeros((6, 11)), tires)
    return said


def test_the_whole_force_law_is_scaled():
    model = PerturbedStiffness(Tires(), scale=0.7)
    np.testing.assert_array_equal(asked(model)[0], np.tile(0.7 * LAW, (5, 1)))
    assert model.name == "tires x0.7"


def test_the_noise_is_drawn_anew_each_period_for_each_axle_and_repeats_after_a_reset():
    model = PerturbedStiffness(Tires(), scale=2.0, noise=0.1, seed=4)
    model.reset()
    factor = asked(model, 400) / LAW
    assert (factor == factor[:, :1]).all()  # the same along the horizon
    # slope and offset alike, to rounding
    np.testing.assert_allclose(factor[..., [1, 3]], factor[..., [0, 2]], rtol=1e-14)
    draw = (factor[:, 0, [0, 2]] / 2.0 - 1.0) / 0.1
    # Standard error of the mean of 400 draws is 0.05, of the deviation 0.035, of the correlation
    # 0.05: four of each.
    assert np.abs(draw.mean(axis=0)).max() < 0.2
    assert np.abs(draw.std(axis=0) - 1.0).max() < 0.14
    assert abs(np.corrcoef(draw.T)[0, 1]) < 0.2
    model.reset()
    np.testing.assert_array_equal(asked(model, 400) / LAW, factor)
    other = PerturbedStiffness(Tires(), scale=2.0, noise=0.1, seed=5)
    assert (asked(other) / LAW != factor[0]).all()


def test_a_force_never_turns_round():
    factor = asked(PerturbedStiffness(Tires(), noise=1.0), 500) / LAW
    assert factor.min() == pytest.approx(0.05)


def test_what_the_model_knows_and_is_told_passes_through():
    inner = Tires()
    model = PerturbedStiffness(inner, scale=0.7)
    model.observe("forces")
    model.reset()
    assert (inner.told, inner.resets, model.friction) == ("forces", 1, 0.7)
    # what the controller and the simulation look for is there only where the model has it
    assert not hasattr(model, "learn")


@pytest.mark.parametrize(
    "wrong", [{"scale": 0.0}, {"scale": float("nan")}, {"noise": -0.1}, {"noise": 1.5},
              {"seed": -1}, {"seed": 0.5}])
def test_numbers_without_a_meaning_are_refused(wrong):
    with pytest.raises(OptionError, match="stiffness"):
        PerturbedStiffness(Tires(), **wrong)


def test_a_controller_is_made_wrong_by_options():
    controller = load_controller("lpv-mpc", stiffness="oracle-secant", stiffness_scale=1.3,
                                 stiffness_noise=0.1, stiffness_seed=2)
    assert controller.stiffness.name == "oracle-secant x1.3, 10 % noise"
    assert controller.stiffness.seed == 2
    with pytest.raises(OptionError, match="stiffness_scale is given"):
        load_controller("lpv-mpc-paper", stiffness=Tires(), stiffness_scale=1.3)
