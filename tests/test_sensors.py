from dataclasses import fields, replace

import numpy as np
import pytest

from lpvmpc.errors import OptionError
from lpvmpc.interface import State
from lpvmpc.sensing.channels import DEG, EXACT, LARGEST, PRODUCTION, RTK, Channel, Sensing
from lpvmpc.sensing.sensors import Sensors

TS = 0.033


def circle(t, vx=15.0, r=0.3):
    """A car on a circle, to the left, at constant speed."""
    psi = r * t
    return State(
        vx / r * np.sin(psi), -vx / r * np.cos(psi), psi, vx, 0.0, r, 0.05, 0.0, vx * r,
        np.full(4, vx / 0.303),
    )


def readings(sensing, n, seed=0, psi_path=None):
    sensors = Sensors(sensing, TS, np.random.default_rng(seed))
    states = [circle(k * TS) for k in range(n)]
    return states, [
        sensors.measure(s, s.psi if psi_path is None else psi_path, k * TS)
        for k, s in enumerate(states)
    ], sensors


def errors(name, n=4000, sensing=RTK, seed=0):
    states, read, _ = readings(sensing, n, seed)
    pairs = zip(states, read, strict=True)
    return np.array([getattr(m, name) - getattr(s, name) for s, m in pairs])


def test_exact_sensors_say_the_truth_bit_for_bit():
    state = circle(1.234)
    sensors = Sensors(EXACT, TS, np.random.default_rng(0))
    m = sensors.measure(state, 0.0, 0.0)
    for name in State._fields:
        assert getattr(m, name) is getattr(state, name)
    assert m.pose_age == 0.0 and sensors.drawn == {}


def test_signals_without_error_are_exact_beside_noisy_ones():
    sensing = Sensing(position=Channel(std=0.01))
    states, read, _ = readings(sensing, 20)
    for s, m in zip(states, read, strict=True):
        assert (m.psi, m.vx, m.vy, m.r, m.ay) == (s.psi, s.vx, s.vy, s.r, s.ay)
        assert m.x != s.x


@pytest.mark.parametrize(
    ("name", "std"),
    [("x", 0.01), ("psi", 0.1 * DEG), ("vx", 0.03), ("r", 0.1 * DEG), ("delta", 0.05 * DEG)],
)
def test_white_noise_has_its_standard_deviation(name, std):
    e = errors(name)
    # 4000 samples: the standard deviation is known to 1.1 %, the mean to 1.6 %, a lag-one
    # correlation to 1.6 %; four times each
    assert e.std() == pytest.approx(std, rel=0.045)
    assert abs(e.mean()) < 0.064 * std
    assert abs(np.corrcoef(e[1:], e[:-1])[0, 1]) < 0.064


def test_a_bias_is_constant_in_a_run_told_and_spread_over_runs():
    drawn = []
    for seed in range(300):
        _, read, sensors = readings(PRODUCTION, 1, seed)
        drawn.append(sensors.drawn["r_bias_radps"])
    assert np.std(drawn) == pytest.approx(0.2 * DEG, rel=0.17)  # 4 times 1 / sqrt(2 * 300)
    e = errors("r", sensing=PRODUCTION, seed=299)
    assert e.mean() == pytest.approx(sensors.drawn["r_bias_radps"], abs=0.01 * DEG)


def test_wander_has_its_spread_and_its_time_constant():
    sensing = Sensing(position=Channel(wander_std=0.05, wander_time=2.0))
    e = errors("x", n=60_000, sensing=sensing)
    # 2000 s hold about 500 independent values: the deviation is known to 3 %
    assert e.std() == pytest.approx(0.05, rel=0.12)
    lag = round(2.0 / TS)
    assert np.corrcoef(e[lag:], e[:-lag])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.12)


def test_quanta_round_and_scales_multiply():
    _, read, sensors = readings(PRODUCTION, 50)
    steps = np.array([m.delta for m in read]) / (0.1 * DEG)
    assert np.allclose(steps, np.round(steps), atol=1e-9)
    scale = sensors.drawn["wheel_rl_scale"]
    assert 0.0 < abs(scale) <= 0.01
    true = circle(0.0).wheel_speed[2]
    assert abs(read[0].wheel_speed[2] - (1.0 + scale) * true) <= 0.05 + 1e-9


def test_a_lane_camera_errs_across_the_path_alone():
    sensing = replace(PRODUCTION, position=Channel(std=0.03))
    states, read, _ = readings(sensing, 3000, psi_path=0.4)
    dx = np.array([m.x - s.x for s, m in zip(states, read, strict=True)])
    dy = np.array([m.y - s.y for s, m in zip(states, read, strict=True)])
    along = np.cos(0.4) * dx + np.sin(0.4) * dy
    across = -np.sin(0.4) * dx + np.cos(0.4) * dy
    assert np.abs(along).max() < 1e-12
    assert across.std() == pytest.approx(0.03, rel=0.06)


def test_a_camera_picture_is_as_old_as_it_says():
    exact_camera = Channel(rate=30.0, latency=(0.060, 0.100))
    states, read, _ = readings(Sensing(position=exact_camera), 600)
    ages, new = [], 0
    for k, m in enumerate(read):
        if not np.isfinite(m.x):
            assert np.isnan(m.y) and np.isnan(m.psi) and np.isnan(m.pose_age)
            continue
        new += 1
        ages.append(m.pose_age)
        then = circle(k * TS - m.pose_age)
        # the cubic between two instants is good to (r Ts)^4 / 384 of the radius of 50 m
        assert np.hypot(m.x - then.x, m.y - then.y) < 1e-8
        assert m.psi == pytest.approx(then.psi, abs=1e-12)
    # a picture arrives 60 to 100 ms after it was taken and waits up to one instant more
    assert 0.060 <= min(ages) and max(ages) <= 0.100 + TS + 1e-9
    assert 450 < new < 600  # pictures that overtake each other are dropped
    assert np.isnan(read[0].x)


def test_slow_and_late_signals_stand_until_the_next_sample():
    sensing = Sensing(r=Channel(rate=10.0), vx=Channel(latency=(0.1, 0.1)))
    ramp = [circle(k * TS)._replace(r=k * TS, vx=k * TS) for k in range(100)]
    sensors = Sensors(sensing, TS, np.random.default_rng(0))
    read = [sensors.measure(s, 0.0, k * TS) for k, s in enumerate(ramp)]
    r = np.array([m.r for m in read])
    assert 30 <= len(set(r)) <= 36  # 3.3 s at 10 Hz
    assert np.all(np.arange(100) * TS - r < 0.1 + TS) and np.all(r <= np.arange(100) * TS + 1e-12)
    assert read[50].vx == pytest.approx(50 * TS - 0.1, abs=1e-12)
    assert sensors.drawn["vx_latency_s"] == 0.1


def test_lost_samples_are_held_and_lost_poses_are_told():
    lossy = Channel(dropout=0.3)
    states, read, _ = readings(Sensing(position=lossy, r=Channel(std=0.01, dropout=0.3)), 3000)
    lost = np.mean([np.isnan(m.x) for m in read])
    assert lost == pytest.approx(0.3, abs=0.035)  # 4 times sqrt(0.21 / 3000)
    r = np.array([m.r for m in read])
    assert np.mean(r[1:] == r[:-1]) == pytest.approx(0.3, abs=0.035)
    assert np.isfinite(r).all()


def test_a_seed_decides_everything():
    for sensing in (RTK, PRODUCTION):
        first, again, other = (readings(sensing, 40, seed)[1] for seed in (1, 1, 2))
        assert repr(first) == repr(again)
        assert repr(first) != repr(other)


def test_scaled_sensors_err_that_much_more():
    double = RTK.scaled(2.0)
    assert double.position.std == 0.02 and double.ax.bias_std == 0.1
    assert PRODUCTION.scaled(0.0).delta.quantum == PRODUCTION.delta.quantum
    assert RTK.scaled(1.0) == RTK


def test_every_channel_has_a_largest_error():
    assert [f.name for f in fields(Sensing) if f.name != "lane"] == list(LARGEST)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"position": Channel(measured=False)}, "ey cannot be observed"),
        ({"r": Channel(measured=False)}, "state r cannot be observed"),
        ({"vx": Channel(measured=False), "wheel_speed": Channel(measured=False)}, "state vx"),
        ({"delta": Channel(measured=False)}, "state delta"),
        ({"ay": Channel(std=-1.0)}, "ay.std is -1.0"),
        ({"ay": Channel(std=float("nan"))}, "ay.std is nan"),
        ({"position": Channel(std=1e9)}, "position.std"),
        ({"position": Channel(rate=0.1)}, "at least 1 Hz"),
        ({"position": Channel(latency=(0.2, 0.1))}, "shortest <= longest"),
        ({"position": Channel(latency=0.1)}, "position.latency"),
        ({"position": Channel(dropout=1.0)}, "below 1"),
        ({"psi": Channel(rate=10.0)}, "see position.rate"),
        ({"r": Channel(wander_time=0.0)}, "r.wander_time"),
        ({"r": 0.1}, "a Channel"),
        ({"lane": 1}, "true or false"),
    ],
)
def test_sensors_that_cannot_be_are_refused_in_one_sentence(change, says):
    with pytest.raises(OptionError, match=says) as error:
        Sensing(**change)
    assert "\n" not in str(error.value)
