import math

import numpy as np
import pytest
from references import ay_peak

from lpvmpc.errors import PathError
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.road import segments
from lpvmpc.road.path import Path
from lpvmpc.road.speed_profile import SpeedProfile, plan
from lpvmpc.sim.names import load_scenario

PLANNED = ["paper-loop", "circuit", "tuning-a", "tuning-b"]


@pytest.fixture(scope="module")
def params():
    return packaged_car()


def mid(values):
    return 0.5 * (values[1:] + values[:-1])


def test_speed_is_linear_between_knots_and_held_beyond():
    path = Path.from_curvature([0.0, 0.0], 100.0)
    speed = SpeedProfile.from_knots([0.0, 50.0, 100.0], [10.0, 20.0, 5.0], path)
    np.testing.assert_allclose(speed.at([-5.0, 25.0, 50.0, 120.0]), [10.0, 15.0, 20.0, 5.0])


def test_duration_is_the_integral_of_one_over_speed():
    path = Path.from_curvature([0.0, 0.0], 100.0)
    assert SpeedProfile.constant(10.0, path).duration == pytest.approx(10.0)
    ramp = SpeedProfile.from_knots([0.0, 100.0], [5.0, 15.0], path)
    assert ramp.duration == pytest.approx(100.0 / 10.0 * math.log(3.0), rel=1e-12)  # closed form


def test_a_closed_profile_repeats_every_lap():
    scenario = load_scenario("tuning-a")
    speed = scenario.speed
    assert speed.vx[0] == speed.vx[-1]
    s = np.array([10.0, 333.0])
    np.testing.assert_allclose(speed.at(s + 2 * speed.length), speed.at(s))


def test_a_speed_from_rest_to_a_stop_has_the_time_of_its_acceleration():
    path = Path.from_curvature([0.0, 0.0], 100.0)
    s = np.linspace(0.0, 100.0, 51)
    speed = SpeedProfile.from_knots(s, np.sqrt(4.0 * np.minimum(s, 100.0 - s)), path)
    assert speed.rest == (True, True) and speed.start == 0.0 and speed.vx.min() > 0.0
    assert speed.at(0.4) == pytest.approx(math.sqrt(4.0 * 0.4))  # within the first two knots
    # 2 m/s2 over 50 m and back; the first and last cell of 0.2 m are passed a little too early
    assert speed.duration == pytest.approx(2.0 * math.sqrt(50.0), rel=0.02)
    slow = speed.capped(5.0)
    assert slow.rest == (True, True) and slow.vx.max() == 5.0


def test_the_moving_point_of_a_reference_from_rest_gets_going():
    path = Path.from_curvature([0.0, 0.0], 100.0)
    speed = SpeedProfile.from_knots([0.0, 2.0, 100.0], [0.0, 2.0, 14.0], path)
    preview = path.preview(0.0, 0.0, 0.0, 0.0, speed.vx, speed.spacing, 60, 0.033)
    # 1 m/s2 for 2 s: 2 m, and what the first cell of 0.2 m gains: 0.2 s
    assert 2.0 < preview.x[-1] < 2.5
    assert preview.vx_ref[-1] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(
    "vx",
    [[10.0, 0.0], [9.0, 0.0, 9.0], [0.0, 0.0, 9.0], [10.0, -1.0], [10.0, math.nan], [10.0]],
)
def test_a_speed_that_is_none_is_refused(vx):
    with pytest.raises(PathError, match="reference speed"):
        SpeedProfile(np.array(vx), 10.0)


@pytest.mark.parametrize("name", PLANNED)
@pytest.mark.parametrize("ay_max", [2.0, 4.0, 6.0])
def test_a_plan_stays_within_its_limits(params, name, ay_max):
    scenario = load_scenario(name, ay_max=ay_max, params=params)
    path, speed = scenario.path, scenario.speed
    vx, ax = mid(speed.vx), speed.ax
    assert speed.vx.max() <= 21.0 + 1e-12
    assert ay_peak(scenario) <= ay_max * (1.0 + 1e-12)  # rounding of sqrt and square
    drive = np.minimum(params.F_drive_max, params.P_drive_max / vx) / params.m_eff
    resistance = params.c_roll * 9.81 + 0.5 * params.rho_air * params.CdA * vx**2 / params.m_eff
    # 0.85 of the drive is planned for; smoothing in time moves it by a part of a per cent.
    assert np.max((ax + resistance) / drive) < 0.86
    along = np.where(ax > 0.0, ax / (ay_max * params.lr / params.wheelbase), ax / ay_max)
    across = mid(speed.vx**2 * path.kappa) / ay_max
    # The passes leave room for the smoothing where curvature changes; 3 % is what remains.
    assert np.hypot(along, across).max() < 1.03


@pytest.mark.parametrize("name", PLANNED)
def test_a_plan_uses_its_lateral_limit(params, name):
    scenario = load_scenario(name, params=params)
    assert ay_peak(scenario) == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("name", PLANNED)
def test_a_planned_acceleration_is_continuous_enough_to_follow(params, name):
    scenario = load_scenario(name, params=params)
    speed = scenario.speed
    ax = speed.ax
    if scenario.path.closed:
        ax = np.append(ax, ax[0])
    # A change from full drive to full braking (6 m/s2) over 0.6 s has a slope of up to 20 m/s3 in
    # the time of the unsmoothed speed; the tightest corners add their own.
    jerk = np.diff(ax) / speed.spacing * speed.vx[1 : len(ax)]
    assert np.abs(jerk).max() < 45.0


def test_a_plan_on_a_circle_is_the_speed_of_the_limit(params):
    path = Path.from_curvature([0.02, 0.02], 200.0)
    speed = plan(path, params, ay_max=3.0, v_max=30.0)
    np.testing.assert_allclose(speed.vx, math.sqrt(3.0 * 50.0), rtol=1e-12)


def test_a_plan_brakes_before_a_bend_and_mirrors_with_it(params):
    line = segments.line(200.0)

    def planned(sign):
        path = segments.from_segments(
            [*line, *segments.bend(sign * 90.0, [15.0], [10.0, 10.0]), *line]
        )
        return plan(path, params, ay_max=4.0, v_max=21.0)

    left, right = planned(1.0), planned(-1.0)
    np.testing.assert_array_equal(left.vx, right.vx)
    assert left.vx[0] == pytest.approx(21.0)
    assert left.vx.min() == pytest.approx(math.sqrt(4.0 * 15.0), rel=1e-6)
    assert left.at(190.0) < 21.0


def test_a_plan_cannot_be_faster_than_the_drive(params):
    path = Path.from_curvature([0.0, 0.0], 5000.0)
    v = plan(path, params, ay_max=4.0, v_max=60.0).vx.max()
    resistance = params.c_roll * params.m * 9.81 + 0.5 * params.rho_air * params.CdA * v**2
    assert resistance * v <= params.P_drive_max
