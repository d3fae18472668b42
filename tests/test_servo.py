"""What is learned of the steering, on a servo that is integrated millisecond by millisecond."""

import numpy as np
import pytest

from lpvmpc.control.servo import ServoBank, drive_of, steering_of
from lpvmpc.plant.mjcf import packaged_car

TS = 0.033


@pytest.fixture(scope="module")
def car():
    return packaged_car()


def learn(car, *, lag=1.0, latency=0, gain=1.0, offset=0.0, noise=0.0, size=0.05, time=20.0):
    """A bank that has watched a servo of another lag [factor], latency [ms], gain and offset."""
    bank, rng = ServoBank(steering_of(car), TS), np.random.default_rng(0)
    delta, asked = 0.0, []
    for k in range(int(time / TS)):
        t = k * TS
        wanted = size * (np.sin(0.3 * np.pi * t) + 0.3 * np.sin(1.8 * np.pi * t + 1.0))
        asked.append(bank.ask(wanted))
        for i in range(33):
            at = 33 * k + i - latency
            command = asked[at // 33] if at >= 0 else 0.0
            rate = (gain * command + offset - delta) / (lag * car.tau_delta)
            delta += 1e-3 * np.clip(rate, -car.delta_rate_max, car.delta_rate_max)
        bank.update(delta + noise * rng.standard_normal())
    return bank


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("size", [0.005, 0.05])
def test_the_data_sheets_servo_is_recognised(car, noise, size):
    bank = learn(car, noise=noise, size=size)
    assert bank.latency == 0 and bank.gain == pytest.approx(1.0, abs=0.01)
    # a servo that hardly moves, seen through noise, leaves its lag uncertain by a tenth
    assert bank.lag == pytest.approx(car.tau_delta, rel=0.15 if noise and size < 0.01 else 0.02)
    assert abs(bank.offset) < 1e-4


@pytest.mark.parametrize("lag", [0.7, 2.0, 3.0])
def test_another_lag_is_found_within_seconds(car, lag):
    for time in (3.0, 20.0):
        bank = learn(car, lag=lag, noise=1e-3, time=time)
        total = bank.lag + TS * bank.latency
        assert total == pytest.approx(lag * car.tau_delta, rel=0.15)


@pytest.mark.parametrize("latency", [20, 33, 40, 66, 99])
def test_lag_and_latency_add_up(car, latency):
    bank = learn(car, latency=latency, noise=1e-3)
    # a fraction of a period is met by the lag
    assert bank.lag + TS * bank.latency == pytest.approx(car.tau_delta + 1e-3 * latency, abs=0.012)


def test_gain_and_offset_are_found_and_undone(car):
    bank = learn(car, gain=0.95, offset=np.radians(0.5), noise=1e-3)
    assert bank.gain == pytest.approx(0.95, abs=0.005)
    assert np.degrees(bank.offset) == pytest.approx(0.5, abs=0.02)
    bank.reset(0.0)
    assert bank.ask(0.02) == 0.02  # forgotten


def test_what_is_asked_for_keeps_the_servos_rate(car):
    bank = learn(car, gain=0.8, offset=0.05)
    step = car.delta_rate_max * TS
    asked = [bank.ask(delta) for delta in (0.3, -0.3, 0.3)]
    assert np.abs(np.diff(asked)).max() <= step + 1e-12


@pytest.mark.parametrize("latency", [0, 1])
@pytest.mark.parametrize("lag", [1.0, 2.0, 4.0])
def test_the_drives_lag_is_found_in_an_acceleration_that_says_more(car, lag, latency):
    bank, rng = ServoBank(drive_of(car), TS), np.random.default_rng(1)
    tau, a, asked = lag * car.tau_ax, 0.0, [0.0]
    for k in range(900):
        t = k * TS
        asked.append(bank.asked(3.0 * np.sin(0.5 * t) + 1.5 * np.sin(1.7 * t)))
        command = asked[-1 - latency]
        a += (1.0 - np.exp(-TS / tau)) * (0.9 * command - a)
        found, _ = bank.update(a + 0.3 + 0.1 * rng.standard_normal(), latency)
    assert found == pytest.approx(tau, rel=0.15)
    assert bank.gain == pytest.approx(0.9, abs=0.03) and bank.latency == latency


def test_what_something_else_decided_teaches_nothing(car):
    banks = [ServoBank(drive_of(car), TS) for _ in range(2)]
    for k in range(300):
        for bank in banks:
            bank.asked(-3.0 + np.sin(0.5 * k * TS))
        banks[0].update(0.9 * banks[0]._outputs[0, 2])
        # brakes that lock the wheels: the road decides, in every third second
        locked = (k // 30) % 3 == 0
        given = -1.0 if locked else 0.9 * banks[1]._outputs[0, 2]
        banks[1].update(given, trust=float(not locked))
    assert banks[0].gain == pytest.approx(0.9, abs=0.05)
    assert banks[1].gain == pytest.approx(banks[0].gain, abs=0.05)
