"""Other road users: who they are, how near they come, the detour, and what a run says of them."""

import json
import math
from contextlib import nullcontext
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate
from lpvmpc.errors import DataError, OptionError, PathError, UnknownNameError
from lpvmpc.export.stored import read_run
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.traffic.boxes import Box, footprint, gap
from lpvmpc.traffic.detour import AY, CLEARANCE, detour
from lpvmpc.traffic.users import PRESETS, RoadUser, Traffic, load_traffic
from lpvmpc.traffic.watch import encounters

COMMAND = "track"


@pytest.fixture(scope="module")
def slalom():
    return load_scenario("slalom")


# Boxes --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("b", "expected"),
    [
        (Box(10.0, 0.0, 0.0, 4.0, 2.0), 6.0),
        (Box(0.0, 5.0, 0.0, 4.0, 2.0), 3.0),
        (Box(7.0, 6.0, 0.0, 4.0, 2.0), 5.0),  # corner to corner, 3 and 4 m
        (Box(3.9, 0.0, 0.0, 4.0, 2.0), 0.0),
        (Box(0.0, 0.0, 0.7, 0.5, 0.5), 0.0),  # one within the other
        (Box(0.0, 4.0, math.pi / 2.0, 4.0, 2.0), 1.0),
        (Box(0.0, 1.0 + math.sqrt(2.0) + 0.5, math.pi / 4.0, 2.0, 2.0), 0.5),  # a corner ahead
    ],
)
def test_the_gap_of_two_boxes_is_that_of_geometry(b, expected):
    a = Box(0.0, 0.0, 0.0, 4.0, 2.0)
    assert gap(a, b) == pytest.approx(expected, abs=1e-12)
    assert gap(b, a) == pytest.approx(expected, abs=1e-12)


def test_the_gap_is_the_smallest_distance_of_all_points_of_the_sides():
    rng = np.random.default_rng(0)
    for _ in range(40):
        a, b = (Box(*rng.uniform(-4.0, 4.0, 2), rng.uniform(-3.0, 3.0), *rng.uniform(1.0, 5.0, 2))
                for _ in range(2))
        sides = []
        for box in (a, b):
            ends = zip(box.corners(), np.roll(box.corners(), -1, axis=0), strict=True)
            sides.append(np.concatenate([np.linspace(p, q, 200) for p, q in ends]))
        closest = np.sqrt(((sides[0][:, None] - sides[1][None]) ** 2).sum(axis=2)).min()
        found = gap(a, b)
        assert found <= closest + 1e-12
        assert found == 0.0 or found == pytest.approx(closest, abs=0.03)


# Users --------------------------------------------------------------------------------------------


def test_a_user_goes_as_far_as_its_speed_says():
    user = RoadUser(name="a", s=5.0, speed=((2.0, 10.0), (4.0, 0.0)))
    assert [user.gone(t) for t in (0.0, 2.0, 3.0, 4.0, 9.0)] == pytest.approx(
        [0.0, 20.0, 27.5, 30.0, 30.0]
    )


def test_a_user_stands_where_the_path_is_at_its_offset(slalom):
    user = RoadUser(name="a", s=100.0, ey=-1.5, speed=((0.0, 8.0),))
    box = Traffic(slalom.path, (user,)).box(user, 2.0)
    x, y, psi = map(float, slalom.path.at(116.0)[:3])
    assert (box.x, box.y, box.psi) == pytest.approx(
        (x + 1.5 * math.sin(psi), y - 1.5 * math.cos(psi), psi)
    )
    assert Traffic(slalom.path, (user,)).place(user, 1e3) == slalom.path.length


def test_traffic_from_a_file(slalom, tmp_path):
    file = tmp_path / "own.toml"
    file.write_text('[[user]]\nname = "van"\ns = 90\ney = 0.5\nspeed = [[0, 3], [4, 6]]\n'
                    'length = 5.2\nwidth = 2\nheight = 2.1\nside = "right"\n'
                    '[[user]]\nname = "tractor"\ns = 150\nspeed = 4\n')
    van, tractor = load_traffic(file, slalom).users
    assert van.speed == ((0, 3), (4, 6)) and van.side == "right" and tractor.gone(3.0) == 12.0


@pytest.mark.parametrize(
    ("text", "error", "sentence"),
    [
        ("[[user]]\nname = 'a'\n", OptionError, "s of a road user is None, but must be given"),
        ("[[user]]\nname = 'a'\ns = 2000\n", OptionError, "must be at most the length of the road"),
        ("[[user]]\nname = 'a'\ns = 3\n", OptionError, "away from the start, where the car stands"),
        ("[[user]]\nname = 'a'\ns = nan\n", OptionError, "s of road user 'a' is nan"),
        ("[[user]]\nname = 'a'\ns = 90\nwidth = -1\n", OptionError, "width of road user 'a' is -1"),
        ("[[user]]\nname = 'a'\ns = 90\nspeed = [[2, 1], [1, 2]]\n", OptionError, "which rises"),
        ("[[user]]\nname = 'a'\ns = 90\nspeed = 'fast'\n", OptionError, "speed of road user 'a'"),
        ("[[user]]\nname = 'a'\ns = 90\nside = 'up'\n", OptionError, "must be left, right"),
        ("[[user]]\nname = 'a'\ns = 90\nmass = 1\n", UnknownNameError, "field of a road user"),
        ("[[user]]\nname = 'a'\ns = 90\n" * 2, OptionError, "a different one for each"),
        ("", DataError, "must hold 1 to 100 tables"),
        ("user = 3", DataError, "must hold 1 to 100 tables"),
        ("[[user", DataError, "is no TOML file"),
        ('[[user]]\nname = "a"\ns = ' + "9" * 5000, DataError, "is no TOML file"),
        ("a = " + "[" * 3000, DataError, "is no TOML file"),
    ],
)
def test_what_is_no_traffic_is_one_sentence(slalom, tmp_path, text, error, sentence):
    file = tmp_path / "own.toml"
    file.write_text(text)
    with pytest.raises(error) as found:
        load_traffic(file, slalom)
    assert sentence in str(found.value) and "\n" not in str(found.value)


def test_unknown_traffic_is_told_with_the_choices(slalom):
    with pytest.raises(UnknownNameError, match="FILE.toml, braking-lead, parked-car, slow-car"):
        load_traffic("tram", slalom)
    with pytest.raises(DataError, match="cannot be read: No such file"):
        load_traffic("nowhere.toml", slalom)


# The detour ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["paper", "circuit", "slalom"])
def test_a_detour_is_the_path_at_an_offset(name):
    """The new path lies within the clearance of the old one, ends where it ends, and is smooth."""
    scenario = load_scenario(name)
    car, path = packaged_car(), scenario.path
    user = RoadUser(name="a", s=0.5 * path.length, ey=0.3, side="right")
    new = detour(scenario, Traffic(path, (user,)), car)
    offsets = [path.project(x, y, s)[1] for x, y, s in
               zip(new.path.x[::20], new.path.y[::20], new.path.s[::20], strict=True)]
    beside = 0.3 - 0.5 * (car.width + user.width) - CLEARANCE
    assert min(offsets) == pytest.approx(beside, abs=0.02)
    assert max(offsets) == pytest.approx(0.0, abs=0.02)
    end = path.at(path.length)
    np.testing.assert_allclose(new.path.at(new.path.length)[:3], end[:3], atol=0.05)
    assert (new.speed.vx <= scenario.speed.vx.max() + 1e-12).all()


def test_a_change_on_a_straight_road_takes_no_more_than_its_acceleration():
    scenario = load_scenario("slalom")
    straight = scenario.path.kappa == 0.0
    assert straight[:200].all()
    user = RoadUser(name="a", s=60.0, side="left")
    traffic = Traffic(scenario.path, (user,))
    new = detour(load_scenario("double-lane-change"), traffic, packaged_car())
    early = new.path.s < 40.0
    ay = new.speed.at(new.path.s) ** 2 * np.abs(new.path.kappa)
    # the shifted path is a little longer than the old one, and its speed that of the old one's s
    assert 0.5 * AY < ay[early].max() <= 1.05 * AY


def test_wind_friction_and_edges_stay_where_they_are_on_the_road(slalom):
    friction = lambda s: 0.8 if s < 150.0 else 0.5  # noqa: E731
    wind = replace(slalom.wind, knots=[0.0, 150.0, 151.0], speeds=[0.0, 0.0, 9.0], over="distance")
    user = RoadUser(name="a", s=90.0, side="left", ey=-1.0)
    new = detour(replace(slalom, wind=wind, friction=friction),
                 Traffic(slalom.path, (user,)), packaged_car())
    x, y = map(float, slalom.path.at(150.0)[:2])
    at = new.path.project(x, y, 150.0)[0]
    assert abs(at - 150.0) > 0.1  # the new way is longer, so the test can fail
    assert new.friction(at - 0.05) == 0.8 and new.friction(at + 0.05) == 0.5
    assert new.wind.speed(0.0, at - 0.05) == 0.0
    assert new.wind.speed(0.0, at + 0.5) == pytest.approx(4.5, abs=0.5)
    beside = new.path.project(*map(float, slalom.path.at(90.0)[:2]), 90.0)
    assert new.path.width_at(beside[0], 1.0) == pytest.approx(3.5 + beside[1], abs=0.05)


def test_a_reference_that_comes_too_near_elsewhere_is_refused():
    """The skidpad goes round its circle twice, so whoever stands there is passed again."""
    pad = load_scenario("skidpad")
    with pytest.raises(PathError, match="would come within 0.00 m of it"):
        detour(pad, load_traffic("parked-car", pad), packaged_car())


def test_nobody_in_the_way_leaves_the_scenario_as_it_is(slalom):
    user = RoadUser(name="a", s=100.0, ey=4.0)
    assert detour(slalom, Traffic(slalom.path, (user,)), packaged_car()) is slalom


@pytest.mark.parametrize(
    ("users", "sentence"),
    [
        ([RoadUser(name="a", s=100.0, ey=-2.0, width=3.0, side="right")], "no room to pass 'a'"),
        ([RoadUser(name="a", s=100.0, side="left"), RoadUser(name="b", s=140.0, side="right")],
         "one on the left and the other on the right"),
        ([RoadUser(name="a", s=22.0)], "too near an end of the road"),
    ],
)
def test_a_detour_that_cannot_be_is_one_sentence(slalom, users, sentence):
    with pytest.raises(PathError) as error:
        detour(slalom, Traffic(slalom.path, tuple(users)), packaged_car())
    assert sentence in str(error.value)


# Driven -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PRESETS)
def test_a_controller_meets_whom_it_does_not_see_and_passes_on_the_detour(slalom, name):
    traffic, car = load_traffic(name, slalom), packaged_car()
    user = traffic.users[0]
    log = simulate(Plant(), load_controller("stanley"), slalom, traffic=traffic)
    result, (met,) = metrics(log), encounters(log)
    assert not result["completed"] and result["reason"] == f"contact with {user.name}"
    assert met.contact and met.gap_min_m == 0.0
    c = log.columns
    own = footprint(car, c["x_m"][5], c["y_m"][5], c["psi_rad"][5])
    assert c["user0_gap_m"][5] == gap(own, traffic.box(user, float(c["t_s"][5])))
    round_it = detour(slalom, traffic, car)
    log = simulate(Plant(), load_controller("lpv-mpc"), round_it, traffic=traffic)
    result, (met,) = metrics(log), encounters(log)
    assert result["completed"] and result["lateral_max_m"] < 0.005
    assert not met.contact and 0.75 * CLEARANCE < met.gap_min_m < 1.05 * CLEARANCE


def test_a_run_without_traffic_has_nothing_of_it(slalom):
    log = simulate(Plant(), load_controller("stanley"), slalom)
    assert not any(name.startswith("user") for name in log.columns) and log.road is None
    assert encounters(log) == []


def test_the_command_says_how_near_it_was(run, tmp_path):
    drive = ("--scenario", "slalom", "--controller", "stanley", "--traffic", "parked-car")
    code, out, err = run(*drive, "--out", "hit")
    assert (code, err) == (3, "") and "Traffic: contact with parked car at" in out
    kept = json.loads((tmp_path / "hit" / "metrics.json").read_text())
    assert kept["traffic"][0]["contact"] and kept["reason"] == "contact with parked car"
    code, out, err = run(*drive, "--detour", "--out", "past")
    assert (code, err) == (0, "") and "m from parked car at" in out
    log, _ = read_run(tmp_path / "past")
    assert log.meta["traffic"][0]["name"] == "parked car"
    assert log.road.length == load_scenario("slalom").path.length != log.scenario.path.length
    code, _, err = run("--scenario", "slalom", "--detour")
    assert code == 2 and "--detour is 'given', but must be left out without --traffic" in err


# Windows ------------------------------------------------------------------------------------------


class Handle:
    """MuJoCo's passive viewer without its window: the scene in which others are drawn besides."""

    def __init__(self, model, data, **options):
        self.user_scn = mujoco.MjvScene(model, maxgeom=100)
        self.user_scn.ngeom = 0
        self.cam = mujoco.MjvCamera()
        self.shown = []

    def lock(self):
        return nullcontext()

    def is_running(self):
        return len(self.shown) < 40

    def sync(self):
        geoms = self.user_scn.geoms[: self.user_scn.ngeom]
        self.shown.append(np.array([geom.pos.copy() for geom in geoms]).reshape(-1, 3))

    def close(self):
        self.user_scn = None


@pytest.fixture
def window(monkeypatch):
    """The handles that were opened in place of windows."""
    pytest.importorskip("glfw")
    from mujoco import viewer

    from lpvmpc.picture.video import viewer as ours

    opened = []

    def launch(*arguments, **options):
        opened.append(Handle(*arguments, **options))
        return opened[-1]

    monkeypatch.setattr(viewer, "launch_passive", launch)
    monkeypatch.setattr(ours.glfw, "init", lambda: True)
    monkeypatch.setattr(ours.time, "sleep", lambda seconds: None)
    monkeypatch.setenv("DISPLAY", ":7")
    return opened


def middles(handle):
    """Where the only user is in each picture; all its boxes, and no more each time."""
    assert {len(picture) for picture in handle.shown} == {len(handle.shown[0])}
    assert len(handle.shown[0]) > 3
    return np.array([picture[0, :2] for picture in handle.shown])


def test_windows_show_the_other_road_users_where_they_are(run, window, tmp_path):
    """Live and again, in the lane that was there and not on the way round."""
    words = ("--scenario", "slalom", "--controller", "stanley", "--traffic", "slow-car")
    code, _, err = run(*words, "--view", "--out", "hit")
    assert (code, err) == (3, "")
    log, _ = read_run(tmp_path / "hit")
    (live,) = window
    live, c = middles(live), log.columns
    seen = np.column_stack([c["user0_x_m"], c["user0_y_m"]])[: len(live)]
    assert len(live) == 40  # then it was closed, and the run went on
    assert np.allclose(live, seen, rtol=0.0, atol=1e-4)  # pictures are in single precision
    assert np.hypot(*(live[-1] - live[0])) > 1.0
    from lpvmpc.picture.video.viewer import replay

    replay(log)
    replayed = middles(window[-1])
    assert len(replayed) == 40 and np.allclose(replayed[0], seen[0], rtol=0.0, atol=1e-4)
    apart = np.hypot(*(replayed[:, None] - np.stack([c["user0_x_m"], c["user0_y_m"]], axis=1)
                       ).transpose(2, 0, 1)).min(axis=1)
    assert apart.max() < 0.2  # between two instants 0.033 s apart


def test_the_window_of_an_environment_shows_them(window):
    pytest.importorskip("gymnasium")
    from lpvmpc.gym.track import TrackEnv

    env = TrackEnv("human", roads=("slalom",), traffic="parked-car", random_start=False)
    env.reset(seed=0)
    env.render()
    (handle,) = window
    traffic = load_traffic("parked-car", load_scenario("slalom"))
    box = traffic.box(traffic.users[0], 0.0)
    place = middles(handle)[-1]
    assert np.allclose(place, (box.x, box.y), rtol=0.0, atol=1e-3)
    env.close()


def test_a_run_without_traffic_draws_nobody(slalom, window):
    log = simulate(Plant(), load_controller("stanley"), slalom)
    from lpvmpc.picture.video.viewer import replay

    replay(log)
    assert all(len(picture) == 0 for picture in window[0].shown)
