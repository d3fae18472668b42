import numpy as np
import pytest

from lpvmpc.errors import EstimatorError, UnknownNameError
from lpvmpc.interface import Command, Measurement, State
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.sensing.exact import Exact
from lpvmpc.sensing.sensors import EXACT, PRODUCTION, RTK, Sensors
from lpvmpc.sim.names import load_estimator

TS = 0.033
STAY = Command(0.0, 0.0)


def driving(t):
    """Straight on along x at 15 m/s."""
    return State(15.0 * t, 0.0, 0.0, 15.0, 0.0, 0.0, 0.01, 0.0, 0.0, np.full(4, 15.0 / 0.303))


def test_without_an_estimator_exact_sensors_give_the_true_state_bit_for_bit():
    estimator = load_estimator("none", car=packaged_car(), sensing=EXACT, Ts=TS)
    state = driving(1.0)
    estimator.reset(state, np.random.default_rng(0))
    m = Sensors(EXACT, TS, np.random.default_rng(0)).measure(state, 0.0, 0.0)
    assert estimator.update(m, STAY) == state


def test_without_an_estimator_vy_is_that_of_a_rear_axle_without_slip():
    car = packaged_car()
    m = Measurement(0.0, 0.0, 0.0, 0.0, 10.0, np.nan, 0.2, 0.0, 2.0, 0.1, np.full(4, 33.0))
    estimator = Exact(car, TS)
    assert estimator.update(m, STAY).vy == pytest.approx(0.2 * car.lr)
    no_vx = estimator.update(m._replace(vx=np.nan), STAY)
    assert no_vx.vx == pytest.approx(33.0 * car.R_w)


def test_without_an_estimator_old_poses_are_moved_on_to_now():
    estimator = Exact(packaged_car(), TS)
    sensors = Sensors(PRODUCTION.scaled(0.0), TS, np.random.default_rng(3))
    estimator.reset(driving(0.0), np.random.default_rng(0))
    for k in range(100):
        state = estimator.update(sensors.measure(driving(k * TS), 0.0, k * TS), STAY)
        # wheel speeds come in steps of 0.1 rad/s, so 100 ms at 15 mm/s off; the sum of all
        # instants without a picture stays below three times that
        assert state.x == pytest.approx(15.0 * k * TS, abs=0.005)


def test_an_unknown_estimator_is_named_with_the_choices():
    with pytest.raises(UnknownNameError, match="Unknown estimator 'ukf'; the choices are .*none"):
        load_estimator("ukf", car=packaged_car(), sensing=RTK, Ts=TS)


def test_a_users_estimator_is_given_what_it_asks_for(user_module):
    user_module(
        "class Mine:\n"
        "    def __init__(self, sensing, Ts): self.got = sensing, Ts\n"
        "    def reset(self, first, rng): pass\n"
        "    def update(self, measured, command): return None\n"
    )
    assert load_estimator("mine:Mine", car=None, sensing=RTK, Ts=TS).got == (RTK, TS)


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ("", "has no class 'Mine'; it has none"),
        ("class Mine:\n    def reset(self, first, rng): pass\n", "has no method 'update'"),
        ("class Mine:\n    def __init__(self, wheels): pass\n", r"\(car, sensing, Ts, each"),
        ("1 / 0", "cannot be imported: ZeroDivisionError"),
    ],
)
def test_what_is_no_estimator_is_refused_in_one_sentence(user_module, source, says):
    user_module(source)
    with pytest.raises(EstimatorError, match=says) as error:
        load_estimator("mine:Mine", car=packaged_car(), sensing=RTK, Ts=TS)
    assert "\n" not in str(error.value)
    with pytest.raises(EstimatorError, match="there is no such module"):
        load_estimator("absent_module:Mine", car=packaged_car(), sensing=RTK, Ts=TS)
