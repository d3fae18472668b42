import math

import numpy as np
import pytest

from lpvmpc.errors import OptionError
from lpvmpc.interface import Command
from lpvmpc.learn import manoeuvres
from lpvmpc.learn.manoeuvres import ALPHA_MAX, KINDS, ROWS, VX_HIGH, VX_LOW, drive, steer_for
from lpvmpc.plant import callbacks


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_can_be_driven_and_repeated(plant, kind):
    runs = []
    for _ in range(2):
        runs.append(drive(plant, kind, np.random.default_rng([3, 4]), friction=1.0))
    first, again = runs
    assert 0 < len(first) <= ROWS
    assert len(first) == len(again)
    for a, b in zip(first, again, strict=True):
        assert np.array_equal(a.outputs, b.outputs)
        assert a.state[:9] == b.state[:9]


@pytest.mark.parametrize("kind", KINDS)
def test_recorded_rows_stay_in_the_domain(plant, kind):
    for seed in range(3):
        for row in drive(plant, kind, np.random.default_rng([seed, 9]), friction=0.6):
            assert VX_LOW <= row.state.vx <= VX_HIGH + 1.0
            slips = row.outputs[[callbacks.ALPHA_F, callbacks.ALPHA_R]]
            assert np.abs(slips).max() <= ALPHA_MAX
            ratios = row.outputs[callbacks.SLIP_RATIO : callbacks.SLIP_RATIO + 4]
            assert np.abs(ratios).max() <= manoeuvres.SLIP_RATIO_MAX * 0.6


def test_friction_reaches_the_tires(plant):
    row = drive(plant, "ramp-steer", np.random.default_rng(1), friction=0.5)[0]
    mu = row.outputs[callbacks.MU : callbacks.MU + 4]
    assert np.all((mu > 0.4 * plant.params.mu) & (mu < 0.6 * plant.params.mu))


def test_steady_steering_gives_the_lateral_acceleration_it_was_made_for(plant):
    # 4 %: the linear understeer gradient is that of ay = 0
    vx, share = 15.0, 0.3
    delta = steer_for(share, vx, plant.params, 1.0)
    plant.friction = 1.0
    state = plant.reset(vx=vx, trim=False)
    for _ in range(90):
        state = plant.step(Command(delta, 1.5 * (vx - state.vx)))
    assert state.ay == pytest.approx(share * plant.params.ay_limit, rel=0.04)


def test_more_steering_is_asked_for_more_lateral_acceleration(plant):
    shares = np.linspace(0.1, 1.2, 23)
    angles = [steer_for(share, 20.0, plant.params, 1.0) for share in shares]
    assert np.all(np.diff(angles) > 0.0)


def test_laps_never_use_a_road_that_results_are_told_of():
    assert all(name.startswith("tuning") for name in manoeuvres.LAP_TRACKS)


def test_braking_and_accelerating_reach_the_tires(plant):
    least, most = 0.0, 0.0
    for seed in range(4):
        rng = np.random.default_rng([seed, 5])
        for row in drive(plant, "brake-in-turn", rng, friction=1.0):
            least = min(least, row.state.ax)
        for row in drive(plant, "accelerate-in-turn", rng, friction=1.0):
            most = max(most, row.state.ax)
    assert least < -2.0 and most > 0.5


def test_wind_blows_from_left_to_right(plant):
    # wind from the left pushes a car that steers straight to the right
    for seed in range(20):
        rows = drive(plant, "ramp-steer", np.random.default_rng([seed, 6]), friction=1.0)
        if abs(rows[0].wind) > 10.0:
            assert rows[0].wind * rows[0].outputs[callbacks.AERO_FY] < 0.0
            return
    pytest.fail("no run with wind among 20")


def test_unknown_kinds_and_severities_are_refused(plant):
    rng = np.random.default_rng(0)
    with pytest.raises(OptionError, match="'fly'.*step-steer"):
        drive(plant, "fly", rng, friction=1.0)
    with pytest.raises(OptionError, match="severity is 7"):
        drive(plant, "lap", rng, friction=1.0, severity=7)


def test_a_car_that_spins_or_stops_leaves_the_domain(plant):
    state = plant.reset(vx=10.0, trim=False)
    quiet = np.zeros(56)
    assert not manoeuvres.leaves_domain(state, quiet, 1.0)
    assert manoeuvres.leaves_domain(state._replace(vx=1.0), quiet, 1.0)
    spinning = quiet.copy()
    spinning[callbacks.SLIP_RATIO + 1] = 0.2
    assert manoeuvres.leaves_domain(state, spinning, 1.0)
    sliding = quiet.copy()
    sliding[callbacks.ALPHA_R] = -0.3
    assert manoeuvres.leaves_domain(state, sliding, 1.0)
    assert math.isfinite(state.ay)
