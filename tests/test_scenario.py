import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from references import ay_peak

from lpvmpc.errors import OptionError, PathError, UnknownNameError
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.road import random_road
from lpvmpc.road.names import SCENARIOS
from lpvmpc.road.scenario import RoadFriction, list_scenarios, turning_radius
from lpvmpc.sim.names import load_scenario

NAMES = list_scenarios()
CLOSED = {"paper-loop", "circuit", "tuning-a"}


@pytest.fixture(scope="module")
def params():
    return packaged_car()


def write(folder, rows, header="# x_m,y_m"):
    file = folder / "own.csv"
    file.write_text(
        "\n".join([header, *(",".join(f"{v:.4f}" for v in row) for row in rows)]) + "\n"
    )
    return file


def oval(*columns):
    angle = np.arange(0.0, 2 * math.pi, 0.05)
    rows = [80.0 * np.cos(angle), 50.0 * np.sin(angle), *(np.full_like(angle, c) for c in columns)]
    return np.column_stack(rows)


@pytest.mark.parametrize("name", NAMES)
def test_every_named_road_can_be_driven(name, params):
    scenario = load_scenario(name, params=params)
    path, speed = scenario.path, scenario.speed
    assert scenario.name == name and scenario.source and SCENARIOS[name]
    assert path.closed == (name in CLOSED)
    assert len(speed.vx) == len(path.s) and speed.vx.min() > params.vx_min
    assert ay_peak(scenario) < 0.8 * params.ay_limit
    rate = np.abs(np.diff(path.kappa)) / path.spacing * params.wheelbase * speed.vx[1:]
    assert rate.max() < 0.5 * params.delta_rate_max  # half is left to the controller
    assert 0.1 <= path.spacing <= 0.25
    if path.closed:
        assert math.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0]) < 1e-6
        assert math.cos(path.turn) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_scenarios_travel_to_other_processes(name, params):
    scenario = load_scenario(name, wind_scale=0.5, friction=0.8, params=params)
    copy = pickle.loads(pickle.dumps(scenario))
    assert copy.reference_duration == scenario.reference_duration
    assert copy.path.project(1.0, 1.0, 0.0) == scenario.path.project(1.0, 1.0, 0.0)
    assert copy.wind.speed(10.0, 50.0) == scenario.wind.speed(10.0, 50.0)
    assert copy.friction(3.0) == 0.8


def test_the_paper_scenario_is_the_paper_signals(params):
    scenario = load_scenario("paper", params=params)
    assert scenario.path.length == 1280.0
    assert scenario.reference_duration == pytest.approx(83.8, abs=0.1)  # the signals' 2537 samples
    assert scenario.path.at(380.0)[3] == pytest.approx(0.011138)
    assert (scenario.speed.at(0.0), scenario.speed.at(880.0)) == pytest.approx((4.73, 20.47))
    assert (scenario.wind.speed(0.0, 0.0), scenario.wind.speed(21.0, 0.0)) == (25.1, 54.7)
    assert scenario.ay_max is None


def test_the_loop_passes_near_the_points_of_the_figure(params):
    path = load_scenario("paper-loop", params=params).path
    assert path.length == pytest.approx(554.0, abs=4.0)
    assert path.largest_shift < 0.1  # the points are read to 0.1 m from a figure
    assert 1.0 / np.abs(path.kappa).max() > 7.0


def test_the_circuit_has_its_hairpin_and_never_meets_itself(params):
    path = load_scenario("circuit", params=params).path
    assert 1500.0 < path.length < 2500.0
    assert 1.0 / np.abs(path.kappa).max() == pytest.approx(10.0, rel=1e-6)
    tight = path.s[np.abs(path.kappa) > 0.0999]
    straight = path.s[(np.abs(path.kappa) < 1e-4) & (path.s < tight[0])]
    assert tight[0] - straight[-1] < 15.5  # 15 m and the cells at both ends
    points, s = np.column_stack([path.x, path.y])[::10], path.s[::10]
    apart = np.abs(s[:, None] - s)
    apart = np.minimum(apart, path.length - apart)
    gaps = np.linalg.norm(points[:, None] - points, axis=2)
    assert gaps[apart > 60.0].min() > 2.0 * 4.0 + 4.0  # both half widths and a verge


@pytest.mark.parametrize("ay_max", [3.0, 4.5])
def test_double_lane_change_passes_the_middle_of_the_iso_lanes(params, ay_max):
    path = load_scenario("double-lane-change", params=params).path
    # Lanes: 30-45 m at y 0, 75-100 m at y 3.5 m, 125-155 m at y 0; 3 m inside, 3 cm off.
    for start, end, y in ((30.0, 45.0, 0.0), (75.0, 100.0, 3.5), (125.0, 155.0, 0.0)):
        inside = (path.x >= start) & (path.x <= end)
        assert np.abs(path.y[inside] - y).max() < 0.04
    slow = load_scenario("double-lane-change", ay_max=ay_max, params=params)
    assert ay_peak(slow) <= ay_max * (1.0 + 1e-12)
    assert np.ptp(slow.speed.vx) == 0.0


def test_slalom_passes_its_cones_on_alternate_sides(params):
    path = load_scenario("slalom", params=params).path
    cones = 76.0 + 18.0 * np.arange(8)
    y = np.interp(cones, path.x, path.y)
    np.testing.assert_allclose(y, 1.3 * (-1.0) ** np.arange(8), atol=2e-3)  # grid of the curvature


def test_skidpad_is_driven_at_its_share_of_the_grip(params):
    for friction in (1.0, 0.6):
        scenario = load_scenario("skidpad", friction=friction, params=params)
        assert ay_peak(scenario) == pytest.approx(0.75 * params.ay_limit * friction)
    kappa = scenario.path.kappa
    assert kappa.max() == pytest.approx(1 / 30) and kappa.min() == pytest.approx(-1 / 30)


def test_grip_is_a_share_of_limit_and_friction_but_ay_max_is_not(params):
    by_grip = load_scenario("circuit", grip=0.5, friction=0.8, params=params)
    assert by_grip.ay_max == pytest.approx(0.5 * params.ay_limit * 0.8)
    assert ay_peak(by_grip) == pytest.approx(by_grip.ay_max, rel=1e-3)
    by_ay = load_scenario("circuit", ay_max=3.0, friction=0.8, params=params)
    assert by_ay.ay_max == 3.0


def test_v_max_caps_a_given_speed_and_bounds_a_planned_one(params):
    capped = load_scenario("paper", v_max=12.0, params=params)
    free = load_scenario("paper", params=params)
    np.testing.assert_array_equal(capped.speed.vx, np.minimum(free.speed.vx, 12.0))
    assert load_scenario("circuit", v_max=12.0, params=params).speed.vx.max() == pytest.approx(12.0)
    assert load_scenario("double-lane-change", v_max=18.0, params=params).speed.vx[0] == 18.0


def test_ay_max_replaces_a_given_speed_by_a_planned_one(params):
    scenario = load_scenario("paper", ay_max=2.0, params=params)
    assert scenario.ay_max == 2.0
    assert ay_peak(scenario) == pytest.approx(2.0, rel=1e-3)


def test_wind_scale_and_friction_reach_the_scenario(params):
    scenario = load_scenario("paper", wind_scale=0.5, friction=0.7, params=params)
    assert scenario.wind.speed(0.0, 0.0) == pytest.approx(12.55)
    assert scenario.friction(100.0) == 0.7
    assert load_scenario("paper", wind_scale=0.0, params=params).wind.calm
    assert load_scenario("paper", params=params).friction is None
    assert scenario.options["wind_scale"] == 0.5


def test_friction_may_change_along_the_road():
    patch = RoadFriction(scale=0.5, knots=(0.0, 10.0), values=(1.0, 0.6), period=20.0)
    assert [patch(s) for s in (0.0, 5.0, 15.0, 25.0)] == pytest.approx([0.5, 0.4, 0.4, 0.4])


def test_a_closed_road_can_be_driven_once_as_an_open_one(params):
    lap = load_scenario("circuit", params=params)
    once = load_scenario("circuit", closed=False, params=params)
    assert not once.path.closed
    np.testing.assert_allclose(once.path.x, lap.path.x, atol=1e-9)
    with pytest.raises(PathError, match=r"paper cannot be closed: its ends are .* m apart"):
        load_scenario("paper", closed=True, params=params)


def test_a_csv_with_all_columns_becomes_a_scenario(tmp_path, params):
    file = write(
        tmp_path, oval(4.0, 5.0, 9.0, 20.0), "# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps,wind_mps"
    )
    scenario = load_scenario(str(file), params=params)
    assert scenario.name == "own" and scenario.path.closed
    assert (scenario.path.width_right[7], scenario.path.width_left[7]) == (4.0, 5.0)
    np.testing.assert_allclose(scenario.speed.vx, 9.0)
    assert scenario.wind.speed(0.0, 1e4) == pytest.approx(20.0)
    assert "moved its points by up to 0.0" in scenario.source
    assert ay_peak(load_scenario(file, grip=0.4, params=params)) == pytest.approx(
        0.4 * params.ay_limit, rel=1e-3
    )


def test_a_csv_without_speed_is_planned_at_4_mps2(tmp_path, params):
    scenario = load_scenario(write(tmp_path, oval()), params=params)
    assert scenario.ay_max == 4.0 and ay_peak(scenario) == pytest.approx(4.0, rel=1e-3)
    assert not load_scenario(write(tmp_path, oval()), closed=False, params=params).path.closed


def test_an_unknown_name_is_answered_with_the_names(params):
    with pytest.raises(UnknownNameError, match="Unknown scenario 'monza'.*circuit.*slalom"):
        load_scenario("monza", params=params)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"v_max": -1.0}, "v_max is -1.0"),
        ({"v_max": math.nan}, "v_max is nan"),
        ({"v_max": 500.0}, "v_max is 500.0, but must be a number from 1 to 60 m/s"),
        ({"ay_max": 0.0}, "ay_max"),
        ({"ay_max": math.inf}, "ay_max"),
        ({"grip": -0.5}, "grip"),
        ({"grip": 3.0}, "grip"),
        ({"ay_max": 4.0, "grip": 0.5}, "left out where ay_max is given"),
        ({"wind_scale": -0.1}, "wind_scale"),
        ({"wind_scale": math.nan}, "wind_scale"),
        ({"friction": 0.0}, "friction"),
        ({"friction": "wet"}, "friction is 'wet'"),
    ],
)
def test_absurd_options_are_refused(options, message, params):
    with pytest.raises(OptionError, match=message):
        load_scenario("paper", params=params, **options)


def test_a_road_tighter_than_the_turning_circle_is_refused(tmp_path, params):
    angle = np.arange(0.0, 2 * math.pi, 0.1)
    small = np.column_stack([4.0 * np.cos(angle), 4.0 * np.sin(angle)])
    with pytest.raises(PathError, match=r"own has a radius of 4\.0\d m at .* cannot turn tighter"):
        load_scenario(write(tmp_path, small), params=params)
    wide = replace(params, delta_max=0.05)
    with pytest.raises(PathError, match="cannot turn tighter than 55.98 m"):
        load_scenario("circuit", params=wide)


def test_a_bad_file_names_itself(tmp_path, params):
    with pytest.raises(PathError, match="nowhere.csv does not exist"):
        load_scenario("nowhere.csv", params=params)
    with pytest.raises(PathError, match="own.csv: Points 3 and 4"):
        load_scenario(write(tmp_path, oval()[[0, 1, 2, 2, 3, 4, 5, 6]]), params=params)
    with pytest.raises(PathError, match=r"own.csv: A closed road must end .* m apart"):
        load_scenario(write(tmp_path, oval()[:60]), closed=True, params=params)


def test_the_manoeuvres_have_their_cones_and_the_path_keeps_between_them(params):
    course = load_scenario("double-lane-change", params=params)
    for x, y in course.cones:  # no cone within half the car's width of the path
        s, offset = course.path.s, np.hypot(course.path.x - x, course.path.y - y)
        assert offset.min() > 0.5 * params.width
        assert 0.0 < s[offset.argmin()] < course.path.length
    slalom = load_scenario("slalom", params=params)
    side = [np.interp(x, slalom.path.x, slalom.path.y) - y for x, y in slalom.cones]
    assert len(side) == 8 and np.allclose(np.abs(side), 1.3, atol=0.02)
    assert (np.diff(np.sign(side)) != 0.0).all(), "passed on alternate sides"
    assert load_scenario("circuit", params=params).cones.shape == (0, 2)


# Random roads -----------------------------------------------------------------------------------


def test_a_random_road_is_the_same_for_the_same_number(params):
    one, again, other = (load_scenario(f"random-{i}", params=params) for i in (7, 7, 8))
    np.testing.assert_array_equal(one.path.kappa, again.path.kappa)
    assert one.path.length != other.path.length and not one.path.closed


def test_random_roads_have_hairpins_that_the_car_can_turn(params):
    lengths = []
    for i in range(40):
        road = random_road.random_road(i).path
        turned = np.abs(road.psi[:, None] - road.psi[None, ::50]).max()
        assert turned > np.radians(140.0), i
        assert 1.0 / 15.0 < np.abs(road.kappa).max() < 1.0 / turning_radius(params)
        assert abs(road.kappa[0]) == 0.0 and road.has_widths
        lengths.append(road.length)
    assert 150.0 < min(lengths) and max(lengths) < 900.0


def test_short_random_roads_are_a_hairpin_and_little_else(params):
    roads = [random_road.hairpin_road(i).path for i in range(40)]
    for road in roads:
        turned = np.abs(road.psi[:, None] - road.psi[None, ::50]).max()
        assert turned > np.radians(140.0) and road.has_widths
        assert 1.0 / 15.0 < np.abs(road.kappa).max() < 1.0 / turning_radius(params)
    lengths = [road.length for road in roads]
    assert 55.0 < min(lengths) and np.median(lengths) < 120.0 and max(lengths) < 400.0
    again = load_scenario("hairpin-7", params=params).path
    np.testing.assert_array_equal(again.kappa, roads[7].kappa)
    with pytest.raises(UnknownNameError, match="hairpin-NUMBER"):
        load_scenario("hairpin-x", params=params)


@pytest.mark.parametrize(
    "name", ["random-", "random--1", "random-01", "random-1e3", "random-9999999999"]
)
def test_a_random_road_needs_a_number(params, name):
    with pytest.raises(UnknownNameError, match="random-NUMBER"):
        load_scenario(name, params=params)
