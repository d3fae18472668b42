import math
import pickle

import numpy as np
import pytest

from lpvmpc.car.aero import aero_wrench
from lpvmpc.errors import OptionError
from lpvmpc.road.wind import Wind

AIR = (1.225, 0.464, 1.5, 0.15)  # density, drag area, side area, lever: the car of the paper


def test_positive_wind_blows_from_left_to_right():
    wind = Wind(speeds=[10.0])
    assert wind.velocity(0.0, 0.0, 0.0) == pytest.approx((0.0, -10.0))  # driving east: to the south
    assert wind.velocity(0.0, 0.0, math.pi / 2) == pytest.approx((10.0, 0.0))  # north: to the east


def test_wind_is_linear_between_knots_and_held_beyond():
    wind = Wind(knots=[0.0, 2.0], speeds=[10.0, 20.0])
    assert [wind.speed(t, 99.0) for t in (-1.0, 0.5, 2.0, 50.0)] == [10.0, 12.5, 20.0, 20.0]
    np.testing.assert_allclose(wind.speed(np.array([0.5, 3.0]), 0.0), [12.5, 20.0])


def test_wind_repeats_with_its_period():
    wind = Wind(knots=[0.0, 100.0], speeds=[0.0, 10.0], over="distance", period=200.0)
    assert wind.speed(0.0, 50.0) == pytest.approx(wind.speed(7.0, 650.0))
    assert wind.speed(0.0, 150.0) == pytest.approx(5.0)  # back to the first knot


def test_scale_multiplies_the_speed():
    assert Wind(speeds=[30.0], scale=0.5).speed(0.0, 0.0) == 15.0
    assert Wind().calm and Wind(speeds=[30.0], scale=0.0).calm and not Wind(speeds=[1.0]).calm


def test_wind_goes_to_other_processes():
    wind = pickle.loads(pickle.dumps(Wind(knots=[0.0, 2.0], speeds=[10.0, 20.0], scale=2.0)))
    assert wind.speed(1.0, 0.0) == 30.0


def test_wrench_follows_its_equation():
    Fx, Fy, Mz = aero_wrench(15.0, 20.0, *AIR)
    q = 0.5 * 1.225 * 25.0  # |V| of 15 and 20 m/s
    assert Fx == pytest.approx(-q * 0.464 * 15.0)
    assert Fy == pytest.approx(-q * 1.5 * 20.0)
    assert Mz == pytest.approx(0.15 * Fy)


def test_force_of_the_air_mirrors_and_opposes_the_motion():
    Fx, Fy, Mz = aero_wrench(15.0, 20.0, *AIR)
    assert aero_wrench(15.0, -20.0, *AIR) == (Fx, -Fy, -Mz)  # bit for bit
    assert Fx < 0.0 and Fy < 0.0
    assert aero_wrench(0.0, 0.0, *AIR) == (0.0, 0.0, 0.0)


def test_doubled_flow_quadruples_the_force():
    once, twice = aero_wrench(3.0, 4.0, *AIR), aero_wrench(6.0, 8.0, *AIR)
    assert twice == pytest.approx([4.0 * force for force in once])


@pytest.mark.parametrize(
    "bad",
    [
        {"scale": -1.0},
        {"scale": math.nan},
        {"knots": [1.0, 0.0], "speeds": [0.0, 0.0]},
        {"knots": [0.0, 1.0], "speeds": [0.0]},
        {"speeds": [math.inf]},
        {"knots": [0.0, 5.0], "speeds": [0.0, 1.0], "period": 3.0},
    ],
)
def test_wind_that_cannot_blow_is_refused(bad):
    with pytest.raises(OptionError):
        Wind(**bad)
