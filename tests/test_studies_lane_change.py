import math
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.road import cones
from lpvmpc.road.cones import Course, Lane
from lpvmpc.road.path import Path
from lpvmpc.studies import lane_change
from lpvmpc.studies.parts import gates
from lpvmpc.studies.parts.gates import Outline
from lpvmpc.studies.study import CarUnderTest

OUTLINE = Outline(front=1.9, rear=2.2, half_width=0.85)
WIDTH = 1.73


@pytest.fixture(scope="module")
def car():
    return CarUnderTest.packaged()


@pytest.fixture(scope="module")
def flat():
    course = cones.obstacle_avoidance(WIDTH)
    return course, gates.flattest_path(course, OUTLINE, 0.1)


def test_lanes_have_the_published_sizes():
    a, b, c = cones.double_lane_change(WIDTH).lanes
    assert [round(lane.width, 3) for lane in (a, b, c)] == [2.153, 2.326, 2.499]
    assert (a.end, b.start - a.end, b.end - b.start, c.start - b.end) == (15.0, 30.0, 25.0, 25.0)
    assert b.middle - a.middle == 3.5
    course = cones.obstacle_avoidance(WIDTH)
    a, b, c = course.lanes
    assert course.length == 61.0
    assert [round(lane.width, 3) for lane in (a, b, c)] == [2.153, 2.73, 3.0]
    assert (b.middle - b.width / 2) - (a.middle + a.width / 2) == pytest.approx(1.0)


def test_cones_stand_on_both_edges_from_end_to_end():
    course = Course("one lane", (Lane(0.0, 10.0, 1.0, 2.0),), coasting=False)
    x, y, side = course.cones.T
    assert x.min() == 0.0 and x.max() == 10.0
    assert np.diff(np.unique(x)).max() <= cones.CONE_SPACING
    assert np.all(y == 1.0 + side)


def test_clearance_is_the_distance_to_a_rectangle():
    points = np.array([(3.0, 0.0), (0.0, 1.5), (4.9, 4.85), (-2.4, 0.0), (0.0, 0.0)])
    straight = np.zeros((1, 3))
    found = gates.clearance(OUTLINE, points, straight)
    assert found[:4] == pytest.approx([1.1, 0.65, 5.0, 0.2])
    assert found[4] == pytest.approx(-0.85)  # inside, that deep
    turned = np.array([[0.0, 0.0, math.pi / 2]])
    assert gates.clearance(OUTLINE, points[:1], turned) == pytest.approx([2.15])


def test_clearance_keeps_the_closest_of_all_poses():
    poses = np.array([[x, 0.0, 0.0] for x in np.linspace(-10.0, 10.0, 201)])
    found = gates.clearance(OUTLINE, np.array([(0.0, 1.0), (0.0, -0.8)]), poses)
    assert found == pytest.approx([0.15, -0.05])


def test_the_flattest_path_keeps_its_distance_from_the_cones(flat):
    course, path = flat
    poses = np.stack([path.x, path.y, np.arctan(path.slope)], axis=1)
    found = gates.clearance(OUTLINE, course.cones, poses)
    # the sides keep 0.1 m; a corner may cut in by the bend within the 0.5 m between points
    assert found.min() > 0.05
    assert found.min() < 0.15  # and needs all the room there is
    assert (path.y[-1], path.slope[-1]) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_less_margin_and_a_sudden_bend_make_the_path_flatter(flat):
    course, path = flat
    free = gates.flattest_path(course, OUTLINE, 0.0, 0.0)
    assert free.curvature < path.curvature
    smoother = gates.flattest_path(course, OUTLINE, 0.1, 20.0)
    assert smoother.curvature > path.curvature
    assert np.abs(np.diff(smoother.bending)).max() < np.abs(np.diff(path.bending)).max()


def test_the_road_follows_the_flattest_path(flat):
    _, path = flat
    road = path.path()
    x, y = road.x - gates.LEAD, road.y
    assert y == pytest.approx(np.interp(x, path.x, path.y), abs=0.01)  # between its points
    assert np.abs(road.kappa).max() == pytest.approx(path.curvature, rel=0.02)


def test_the_search_finds_the_highest_speed_below_the_first_failure():
    tried = []

    def clean(speed):
        tried.append(speed)
        return speed < 17.3 or speed > 30.0

    assert lane_change.highest(clean) == pytest.approx(17.3, abs=lane_change.CLOSE)
    assert max(tried) < 20.0
    assert lane_change.highest(lambda speed: False) == 0.0
    assert lane_change.highest(lambda speed: True) == lane_change.FASTEST


def test_coasting_loses_what_drag_and_rolling_take(car):
    path = Path(np.zeros(201), 100.0)
    speed = lane_change.coast_down(car.params, 20.0, path)
    p = car.params
    drag = p.c_roll * 9.81 + 0.5 * p.rho_air * p.CdA * 20.0**2 / p.m
    assert speed[0] == pytest.approx(20.0)
    lost = (speed[0] - speed[10]) / path.s[10]
    assert lost == pytest.approx(drag / 20.0, rel=2e-3)
    still = replace(p, c_roll=1e-9, CdA=1e-9)
    assert lane_change.coast_down(still, 20.0, path)[-1] == pytest.approx(20.0)


def test_the_outline_has_the_cars_length_and_width(car):
    outline = lane_change.car_outline(car)
    assert outline.front + outline.rear == pytest.approx(car.params.length)
    assert 2.0 * outline.half_width == car.params.width


def test_a_slow_drive_touches_nothing_and_coasts(car, flat):
    course, path = flat
    one = lane_change._drive(car, course, path, OUTLINE, "constant", 10.0)
    assert one.clean
    # the reference keeps 0.1 m from the edges; the tail swings out a little at walking speed
    assert 0.03 < one.clearance < 0.11
    assert one.leaving < one.entry < 10.0
    assert one.ay == pytest.approx(10.0**2 * path.curvature, rel=0.1)
