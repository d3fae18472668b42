import math

import numpy as np
import pytest

from lpvmpc.plant.mjcf import compile_model
from lpvmpc.studies import cross_model
from lpvmpc.studies.reference import multibody
from lpvmpc.studies.study import CarUnderTest


@pytest.fixture(scope="module")
def car():
    return CarUnderTest.packaged()


def understeer(p, Cf, Cr, a, b):
    """K of r = v delta / (L + K v^2) with moment arms a, b of the lateral forces [rad s2/m]."""
    return p.m / (a + b) * (b / Cf - a / Cr)


def test_models_part_where_their_difference_crosses_the_bound():
    ay = np.array([1.0, 2.0, 3.0, 4.0])
    difference = np.array([0.0, -0.01, -0.03, -0.2])
    assert cross_model.crossover(ay, difference, 0.02) == pytest.approx(2.5)
    assert cross_model.crossover(ay, difference, 0.5) == 4.0  # not by then
    assert cross_model.crossover(ay, difference + 1.0, 0.5) == 1.0


def test_the_linear_single_track_has_the_textbooks_yaw_gain(car):
    p = car.params
    model = cross_model.single_tracks(car)[cross_model.LINEAR]
    K = understeer(p, p.Cf, p.Cr, p.lf - p.trail_f, p.lr + p.trail_r)
    for vx in (10.0, 25.0):
        r, beta = model.steady(vx, 1e-3)
        assert r == pytest.approx(vx * 1e-3 / (p.wheelbase + K * vx**2), rel=1e-4)
        alpha_r = p.m * vx * r * (p.lf - p.trail_f) / (p.wheelbase - p.trail_f + p.trail_r) / p.Cr
        assert beta == pytest.approx(p.lr * r / vx - alpha_r, rel=1e-3)


def test_tire_law_and_linear_tires_agree_at_small_slip(car):
    models = cross_model.single_tracks(car)
    linear, law = (models[name].steady(20.0, 1e-4) for name in cross_model.MODELS[:2])
    assert law == pytest.approx(linear, rel=1e-3)


def test_the_transient_ends_in_the_steady_state(car):
    for model in cross_model.single_tracks(car).values():
        end = model.transient(20.0, lambda t: 0.03, np.linspace(0.0, 4.0, 5))[-1]
        assert end == pytest.approx(model.steady(20.0, 0.03), rel=1e-3)


def test_the_sine_begins_and_ends_at_rest_and_has_the_given_rate():
    t = np.linspace(0.0, multibody.SINE_TIME, 3001)
    steer = np.array([multibody.sine(x) for x in t])
    rate = np.array([multibody.sine_rate(x) for x in t])
    assert steer.max() == pytest.approx(multibody.SINE) and steer[0] == steer[-1] == 0.0
    inside = (t > 0.21) & (t < 2.19)
    assert np.gradient(steer, t)[inside] == pytest.approx(rate[inside], abs=1e-5)


def test_effective_stiffness_gives_the_same_understeer_without_trails(car):
    p = car.params
    Cf, Cr = multibody.effective_stiffness(p)
    with_trails = understeer(p, p.Cf, p.Cr, p.lf - p.trail_f, p.lr + p.trail_r)
    # the textbook's L is that of the moment arms, the geometry's that of the axles
    K = p.m / p.wheelbase * (p.lr / Cf - p.lf / Cr)
    assert K == pytest.approx(with_trails, rel=1e-12)


def test_the_tire_sets_are_handed_out_wheel_by_wheel():
    p = multibody.translate(compile_model(visual=False))
    front, rear = p.tire_sets
    assert [p.tire for _ in range(8)] == [front, front, rear, rear] * 2


def test_their_car_weighs_and_rolls_as_ours(car):
    p = multibody.translate(compile_model(visual=False))
    assert p.m_s + p.m_uf + p.m_ur == pytest.approx(car.params.m)
    springs = 0.5 * (p.K_sf * p.T_f**2 + p.K_sr * p.T_r**2) - p.K_tsf - p.K_tsr
    tires = 0.5 * p.K_zt * p.T_f**2
    front, rear = 0.5 * p.K_sf * p.T_f**2 - p.K_tsf, 0.5 * p.K_sr * p.T_r**2 - p.K_tsr
    series = front * tires / (front + tires) + rear * tires / (rear + tires)
    assert springs == pytest.approx(front + rear)
    assert series == pytest.approx(car.params.K_phi + car.params.m * 9.81 * car.params.h, rel=1e-6)


def test_stored_transient_is_what_commonroads_model_gives():
    pytest.importorskip("vehiclemodels")
    rows = multibody.drive(multibody.sine_rate, 1.0, multibody.SAMPLE)
    stored = np.array(multibody.read()["transient"])[: len(rows)]
    # tolerances of the integrator, over another grid of samples
    assert np.abs(rows - stored).max() < 1e-5


@pytest.mark.slow
def test_all_stored_values_are_what_commonroads_model_gives():
    pytest.importorskip("vehiclemodels")
    stored, computed = multibody.read(), multibody.compute()
    for name in ("steady", "transient"):
        assert np.abs(np.array(stored[name]) - computed[name]).max() < 1e-5
    assert math.isclose(stored["speed_mps"], multibody.SPEED)


def test_the_plant_is_driven_along_the_sine(car):
    rows = cross_model.drive(car.plant(Ts=cross_model.Ts), car.params.tau_delta, 1.0, 0.6)
    asked = np.array([multibody.sine(t) for t in rows[:, 0]])
    assert rows[:, 1] == pytest.approx(asked, abs=1e-4)  # a thousandth of the sine's rate
    assert rows[-1, 2] > 0.0
