"""Roads as people bring them: files, references and starts that once failed."""

import math

import numpy as np
import pytest

from lpvmpc import Plant, load_controller, metrics, simulate
from lpvmpc.errors import OptionError, PathError
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.road import centreline
from lpvmpc.road.demand import shortfalls, top_speed
from lpvmpc.road.path import WIDTH, Path
from lpvmpc.road.scenario import Scenario
from lpvmpc.road.speed_profile import SpeedProfile
from lpvmpc.sim.names import load_scenario

ANGLE = np.arange(0.0, 2.0 * math.pi, 0.02)
OVAL = np.column_stack([80.0 * np.cos(ANGLE), 50.0 * np.sin(ANGLE)])  # about 1.3 m apart
STRAIGHT = np.column_stack([np.arange(0.0, 200.0, 2.0), np.zeros(100)])


@pytest.fixture(scope="module")
def params():
    return packaged_car()


@pytest.fixture
def road(tmp_path):
    """Makes a scenario of columns."""

    def make(*columns, header="# x_m,y_m,vx_mps", name="own.csv", **options):
        file = tmp_path / name
        header = ",".join(header.split(",")[: sum(np.ndim(c) or 1 for c in columns)])
        np.savetxt(file, np.column_stack(columns), "%.4f", ",", header=header.lstrip("# "))
        return load_scenario(file, **options)

    return make


def corners(leg=50):
    """Legs of 50 m with corners of 90 degrees, a point per metre, nothing rounded."""
    steps = [(1, 0)] * leg + [(0, 1)] * leg + [(1, 0)] * leg + [(0, -1)] * leg
    return np.vstack([(0.0, 0.0), np.cumsum(steps, axis=0)])


# Points -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("where", [1, 100, 313])  # beside the start of a closed road too
def test_one_bad_point_is_named_and_put_back(road, where):
    points = OVAL.copy()
    points[where] += 1.5 * OVAL[where] / np.hypot(*OVAL[where])
    scenario = road(points)
    clean = road(OVAL)
    assert len(scenario.warnings) == 1 and not clean.warnings
    assert f"Row {where + 1} (line {where + 2})" in scenario.warnings[0]
    assert "bad measurement" in scenario.warnings[0]
    # the road is that of the clean points to a centimetre
    off = [clean.path.project(x, y, s)[1] for x, y, s in
           zip(scenario.path.x[::50], scenario.path.y[::50], clean.path.s[::50], strict=False)]
    assert np.abs(off).max() < 0.01


def test_two_bad_points_are_both_named(road):
    points = OVAL.copy()
    points[[60, 200]] += (1.0, -2.0)
    assert len(road(points).warnings) == 2


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_no_point_of_noise_or_of_a_corner_is_called_bad(noise):
    rng = np.random.default_rng(8)
    assert centreline.fit(OVAL + noise * rng.standard_normal(OVAL.shape)).bad == ()
    assert centreline.fit(corners()).bad == ()
    half = np.arange(0.0, math.pi, 0.2)
    bend = np.column_stack([4.0 * np.sin(half), 4.0 * (1.0 - np.cos(half))])
    there = np.column_stack([np.arange(-60.0, 0.0, 1.0), np.zeros(60)])
    assert centreline.fit(np.vstack([there, bend])).bad == ()


def test_corners_are_rounded_as_far_as_the_car_needs_and_that_is_said(road, params):
    scenario = road(corners())
    radius = math.hypot(params.wheelbase / math.tan(params.delta_max), params.lr)
    assert radius < 1.0 / np.abs(scenario.path.kappa).max() < 1.5 * radius
    assert f"by {scenario.path.largest_shift:.2f} m" in scenario.warnings[0]
    assert scenario.path.largest_shift < WIDTH


def test_the_smoothing_can_be_set(road):
    corner = road(corners(), smoothing=25.0)
    assert 1.0 / np.abs(corner.path.kappa).max() > 7.0
    assert corner.options["smoothing"] == 25.0 and "over 25 m" in corner.source
    with pytest.raises(PathError, match="cannot turn tighter"):
        road(corners(), smoothing=4.0)
    with pytest.raises(OptionError, match="smoothing is -1.0"):
        road(corners(), smoothing=-1.0)
    with pytest.raises(OptionError, match="circuit is made of no points"):
        load_scenario("circuit", smoothing=10.0)


def test_a_race_line_becomes_a_road_with_its_speed(tmp_path):
    s = np.linspace(0.0, 410.0, len(OVAL))
    columns = np.column_stack([s, OVAL, ANGLE, np.full_like(s, 0.02), np.full_like(s, 12.0), s * 0])
    names = "s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2"
    np.savetxt(tmp_path / "line.csv", columns, "%.7f", "; ", header="made by a tool\n" + names)
    scenario = load_scenario(tmp_path / "line.csv")
    assert scenario.path.closed and scenario.ay_max is None
    np.testing.assert_allclose(scenario.speed.vx, 12.0)


# References -------------------------------------------------------------------------------------


def test_the_named_roads_ask_for_no_more_than_the_car_has():
    for name in ("paper", "paper-loop", "double-lane-change", "skidpad", "slalom", "circuit"):
        assert load_scenario(name).warnings == ()


def test_a_reference_that_jumps_is_a_warning_with_place_and_numbers(road):
    jump = np.where(STRAIGHT[:, 0] < 100.0, 10.0, 20.0)
    up = road(STRAIGHT, jump).warnings
    # from 10 to 20 m/s within 2 m: v dv/ds = 20 * 5 = 100 m/s2 at its end, less in the last cell's
    # middle; 65 kW there drive 1614 kg with 2.06 m/s2
    assert len(up) == 1 and "m/s2 of drive at 100 m, where there are 2.06" in up[0]
    assert 90.0 < float(up[0].partition("asks for more than the car has: ")[2].split()[0]) <= 100.5
    down = road(STRAIGHT, jump[::-1]).warnings
    assert "of braking at 98 m" in down[0]
    assert road(STRAIGHT, np.full(100, 10.0)).warnings == ()


def test_a_bend_that_is_too_fast_is_a_warning(road, params):
    points = np.roll(OVAL, len(OVAL) // 4, axis=0)  # starts in the flat middle
    warning, = road(points, np.full(len(points), 19.0)).warnings
    scenario = road(points, np.full(len(points), 19.0), v_max=12.0)
    # the sharp end of the oval has a radius of 50^2/80 m; smoothing takes a part of it
    assert "11.5 m/s2 sideways at" in warning and "where there are 7.02" in warning
    assert scenario.warnings == ()


def test_the_limits_are_the_cars(params):
    path = Path.from_curvature([0.01, 0.01], 100.0)
    v = math.sqrt(params.ay_limit / 0.01)
    assert shortfalls(path, SpeedProfile.constant(v, path), params) == []
    found, = shortfalls(path, SpeedProfile.constant(v, path), params, lambda s: 0.5)
    assert (found.kind, found.asked) == ("sideways", pytest.approx(7.02))
    assert found.has == pytest.approx(3.51) and found.length == pytest.approx(100.0, abs=0.3)
    # At the top speed power equals resistance: P = (c_roll m g + rho CdA v^2/2) v
    top = top_speed(params)
    force = params.c_roll * params.m * 9.81 + 0.5 * params.rho_air * params.CdA * top**2
    assert force * top == pytest.approx(params.P_drive_max, rel=1e-3)


def test_a_speed_that_the_car_cannot_start_at_names_its_column_and_row(road):
    with pytest.raises(PathError, match=r"vx_mps of row 1 is 60 m/s, but .* at most 58.19 m/s"):
        road(STRAIGHT, np.full(100, 60.0))
    warning, = road(STRAIGHT, np.linspace(30.0, 60.0, 100)).warnings  # reached nowhere, but driven
    assert "of drive" in warning


def test_a_plan_beyond_the_announced_friction_is_a_warning():
    warning, = load_scenario("circuit", friction=0.5).warnings
    assert "at a friction of 0.5: 4 m/s2 sideways" in warning and "where there are 3.51" in warning
    assert "with the option grip" in warning
    assert load_scenario("circuit", friction=0.5, grip=0.57).warnings == ()
    assert load_scenario("circuit", friction=0.6).warnings == ()


# Starts and stops -------------------------------------------------------------------------------


@pytest.mark.parametrize("controller", ["stanley", "lpv-mpc"])
def test_a_car_starts_from_rest_and_stops(road, controller):
    x = np.arange(0.0, 62.0, 2.0)
    vx = np.minimum(8.0, np.sqrt(3.0 * np.minimum(x, 60.0 - x)))
    scenario = road(x, np.zeros_like(x), vx)
    assert scenario.warnings == ()
    log = simulate(Plant(), load_controller(controller), scenario)
    assert metrics(log)["completed"]
    assert log.columns["vx_mps"][0] < 1e-6 and log.columns["vx_mps"][-1] < 0.6
    assert log.meta["duration_s"] == pytest.approx(scenario.reference_duration, rel=0.05)


def test_a_closed_road_has_no_stop(road):
    with pytest.raises(PathError, match="vx_mps is 0 at an end, but a closed road"):
        road(OVAL, np.where(np.arange(len(OVAL)) == 0, 0.0, 9.0))


# Widths -----------------------------------------------------------------------------------------


def offset_road(half_width=None):
    """300 m straight on at 10 m/s."""
    path = Path.from_curvature(np.zeros(2), 300.0)
    if half_width is not None:
        path = Path(np.zeros(2), 300.0, width=half_width)
    return Scenario(name="straight", path=path, speed=SpeedProfile.constant(10.0, path))


class Beside:
    """Moves to a line beside the path and stays there."""

    def __init__(self, offset):
        self.offset = offset

    def reset(self, rng): ...

    def command(self, state, preview):
        return 0.4 * math.atan(0.3 * (self.offset - preview.ey)) - preview.epsi, 0.0


def test_a_car_beside_a_narrow_road_has_left_it(point_plant):
    """The car is 1.8 m wide, the road 1.2 m on either side: 0.3 m of room."""
    inside = metrics(simulate(point_plant, Beside(0.25), offset_road(1.2)))
    outside = metrics(simulate(point_plant, Beside(3.0), offset_road(1.2)))
    assert inside["completed"] and inside["left_road_s"] == 0.0
    assert outside["completed"] and outside["left_road_s"] > 0.9 * outside["duration_s"]
    wide = metrics(simulate(point_plant, Beside(3.0), offset_road(6.0)))
    assert wide["left_road_s"] == 0.0


def test_a_corner_of_a_turned_car_may_leave_the_road_first(point_plant):
    log = simulate(point_plant, Beside(0.0), offset_road(1.2))
    assert metrics(log)["left_road_s"] == 0.0
    # the corners of the rear axle swing out: 1.6 sin 0.25 + 0.9 cos 0.25 = 1.27 m
    log.columns["epsi_rad"][7:9] = 0.25, -0.25
    assert metrics(log)["left_road_s"] == pytest.approx(2 * 0.033)
    log.columns["epsi_rad"][7:9] = 0.1, -0.19  # the rear's again: 1.06 and 1.19 m
    assert metrics(log)["left_road_s"] == 0.0


@pytest.mark.parametrize(
    ("half_width", "offset", "lost"),
    [(None, 6.0, 5.0), (1.2, 6.0, 5.0), (6.0, 6.0, None), (6.0, 9.0, 8.0)],
)
def test_a_car_is_lost_beyond_the_verge_of_its_road(point_plant, half_width, offset, lost):
    log = simulate(point_plant, Beside(offset), offset_road(half_width))
    assert log.meta["reason"] == (f"off the path: |ey| > {lost:g} m" if lost else "")


# Laps and starts beside the road ----------------------------------------------------------------


class OnCircle:
    """Steers the point car along a circle of 20 m radius."""

    def reset(self, rng): ...

    def command(self, state, preview):
        return math.atan(2.8 * (0.05 - 0.02 * preview.ey - 0.2 * preview.epsi)), 0.0


@pytest.fixture
def circle():
    path = Path(np.full(629, 0.05), 40.0 * math.pi, closed=True)
    return Scenario(name="circle", path=path, speed=SpeedProfile.constant(10.0, path))


def test_several_laps_are_driven_and_timed(point_plant, circle):
    log = simulate(point_plant, OnCircle(), circle, laps=3)
    result = metrics(log)
    lap = circle.reference_duration
    assert result["completed"] and result["s_end_m"] == pytest.approx(3 * circle.path.length)
    assert result["reference_duration_s"] == pytest.approx(3 * lap)
    assert len(result["lap_times_s"]) == 3
    assert sum(result["lap_times_s"]) == pytest.approx(result["duration_s"], abs=1e-12)
    np.testing.assert_allclose(result["lap_times_s"], lap, rtol=0.01)  # steps of 0.33 m cut a chord
    assert log.meta["options"] == {"delay": 0, "laps": 3}
    once = simulate(point_plant, OnCircle(), circle)
    assert metrics(once)["lap_times_s"] == [once.meta["duration_s"]]
    assert "laps" not in once.meta["options"]
    open_road = offset_road()
    assert metrics(simulate(point_plant, OnCircle(), open_road))["lap_times_s"] == []


def test_laps_that_are_none_are_refused(point_plant, circle):
    for laps in (0, -1, 1.5, True, 101):
        with pytest.raises(OptionError, match="laps is"):
            simulate(point_plant, OnCircle(), circle, laps=laps)
    with pytest.raises(OptionError, match="straight is not closed"):
        simulate(point_plant, OnCircle(), offset_road(), laps=2)


@pytest.mark.parametrize("start", [(1.0, 0.0), (-0.5, 0.2), (0.0, -0.1)])
def test_a_start_beside_the_road_is_where_it_was_asked_for(plant, start):
    log = simulate(plant, load_controller("stanley"), load_scenario("circuit"), start_offset=start,
                   progress=stop_after(3))
    c = log.columns
    course = c["epsi_rad"][0] + math.atan2(c["vy_mps"][0], c["vx_mps"][0])
    assert (c["ey_m"][0], course) == pytest.approx(start, abs=1e-9)
    assert c["s_m"][0] == pytest.approx(0.0, abs=1e-9)
    assert log.meta["options"]["start_offset"] == list(start)


def stop_after(calls):
    """A progress callback that ends a run as Ctrl-C does."""
    left = iter(range(calls))

    def progress(fraction):
        if next(left, None) is None:
            raise KeyboardInterrupt

    return progress


@pytest.mark.parametrize("start", [(6.0, 0.0), (0.0, 1.6), (math.nan, 0.0), (1.0,), "ab"])
def test_a_start_that_is_lost_at_once_is_refused(point_plant, circle, start):
    with pytest.raises(OptionError, match="start_offset is"):
        simulate(point_plant, OnCircle(), circle, start_offset=start)
