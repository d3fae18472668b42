import os
import signal
import sys

import av
import mujoco
import numpy as np
import pytest
from fake_log import TS, fake_log, fake_path

from lpvmpc import render, scenery
from lpvmpc.errors import OptionError, OutputError, RenderError
from lpvmpc.hud import Hud, _number
from lpvmpc.path import Path

WIDTH, HEIGHT = 320, 180


def has_opengl():
    try:
        context = render.gl_context(16, 16)
    except RenderError:
        return False
    context.free()
    return True


needs_opengl = pytest.mark.skipif(not has_opengl(), reason="no OpenGL on this machine")


@pytest.fixture(scope="module")
def log():
    return fake_log(2.0)


@pytest.fixture(scope="module")
def stage(log):
    stage = render.Stage(log, WIDTH, HEIGHT, 1 / 30)
    yield stage
    stage.close()


def frames(file):
    """All pictures of a video as one array, and the codec's name."""
    with av.open(str(file)) as video:
        stream = video.streams.video[0]
        assert stream.codec_context.pix_fmt == "yuv420p"  # what browsers decode
        return (np.stack([f.to_ndarray(format="rgb24") for f in video.decode(stream)]),
                stream.codec_context.name)


# Motion

def test_a_second_of_driving_gives_thirty_frames(log):
    span = log.columns["t_s"][-1]
    assert len(render.Motion(log, 30)) == int(np.floor(span * 30 + 1e-6)) + 1


def test_positions_lie_between_the_rows_in_proportion_to_time(log):
    motion = render.Motion(log, 30)
    now = motion.at(17)
    expected = np.interp(17 / 30, log.columns["t_s"], log.columns["qpos_0"])
    assert now["qpos"][0] == pytest.approx(expected, abs=1e-12)  # the same interpolation
    assert now["horizon"].shape == (11, 2)


def test_slerp_turns_at_constant_rate_the_short_way():
    angle = 0.8
    a = np.array([[1.0, 0.0, 0.0, 0.0]])
    b = np.array([[np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]])
    for sign in (1.0, -1.0):  # q and -q are the same attitude
        q = render.slerp(a, sign * b, np.array([0.25]))[0]
        assert 2.0 * np.arctan2(q[3], q[0]) == pytest.approx(0.25 * angle, abs=1e-12)
    assert render.slerp(a, a, np.array([0.5]))[0] == pytest.approx(a[0])


def test_a_log_without_two_rows_makes_no_video(tmp_path):
    log = fake_log(2.0)
    log.columns = {name: column[:1] for name, column in log.columns.items()}
    with pytest.raises(RenderError, match="two rows"):
        render.render_video(log, tmp_path / "x.mp4")


# Camera

class Straight:
    def __init__(self, psi=0.0):
        self.psi = psi

    def at(self, s):
        return 0.0, 0.0, self.psi, 0.0


def test_the_camera_swings_to_a_new_heading_without_overshoot():
    road = Straight()
    chase = render.Chase(road, 1 / 30)
    now = {"s_m": 0.0, "vx_mps": 10.0, "x_m": 0.0, "y_m": 0.0}
    chase.follow(now)
    road.psi = 1.0
    heading = [chase.follow(now) and chase.heading for _ in range(200)]
    assert np.all(np.diff(heading) > -1e-12)  # monotonic but for rounding
    assert heading[-1] == pytest.approx(1.0, abs=1e-4)
    # the closed form of a critically damped step: 1 - (1 + w t) exp(-w t)
    wt = chase.W * 10 / 30
    assert heading[9] == pytest.approx(1.0 - (1.0 + wt) * np.exp(-wt), abs=1e-12)


@needs_opengl
def test_a_point_projects_to_where_opengl_draws_it(stage, log):
    frame = stage.picture(render.Motion(log, 30).at(0))
    place = stage.project(np.array([stage.chase.camera.lookat]), frame.shape)[0]
    assert place == pytest.approx((WIDTH / 2, HEIGHT / 2), abs=1e-3)  # the camera looks at it
    behind = stage.project(np.array([[-1e3, 0.0, 0.0]]), frame.shape)
    assert np.isnan(behind).all()


# Scenery

def test_the_scene_keeps_the_vehicles_coordinates():
    scene = scenery.build(fake_path(100.0), width=64, height=36)
    car = mujoco.MjModel.from_xml_path(str(scenery.scene_file().with_name("vehicle.xml")))
    assert scene.model.nq == car.nq
    names = [scene.model.joint(j).name for j in range(scene.model.njnt)]
    assert names == [car.joint(j).name for j in range(car.njnt)]


def test_only_near_tiles_are_drawn():
    scene = scenery.build(fake_path(600.0), width=64, height=36)
    scene.place(mujoco.MjData(scene.model), 0.0, 0.0, 0.0, 100.0)
    shown = scene.model.geom_group[scene.tiles] != scenery.HIDDEN
    distance = np.hypot(*scene.centres.T)
    assert shown[distance < 100.0].all() and not shown[distance > 200.0].any()


def test_second_laps_do_not_lay_the_road_twice():
    s = np.arange(0.0, 400.0)  # twice around a circle of 200 m
    x, y = 200 / (2 * np.pi) * np.array((np.cos(s * 2 * np.pi / 200), np.sin(s * 2 * np.pi / 200)))
    fresh = scenery._not_repeated(x, y, s * 2 * np.pi / 200 + np.pi / 2, s)
    assert fresh[:199].all() and not fresh[201:].any()


def test_a_crossing_road_is_laid_twice():
    s = np.arange(0.0, 200.0)
    x = np.where(s < 100, s - 50, 0.0)
    y = np.where(s < 100, 0.0, s - 150)
    psi = np.where(s < 100, 0.0, np.pi / 2)
    assert scenery._not_repeated(x, y, psi, s).all()


def test_trees_stand_clear_of_a_winding_road():
    path = fake_path(400.0, closed=True)
    spec = mujoco.MjSpec()
    spec.add_material(name="plants")
    scenery._roadside(spec, path, np.random.default_rng(0))
    road = np.stack(path.at(np.arange(0.0, 400.0, 0.5))[:2], axis=1)
    for mesh in spec.meshes:
        points = np.reshape(mesh.uservert, (-1, 3))
        low = points[points[:, 2] < 0.5]  # trunks and posts
        gap = np.sqrt(((low[:, None, :2] - road[None]) ** 2).sum(-1)).min(axis=1)
        assert gap.min() > path.width_left.max() + 0.4  # posts stand 1.1 m beyond the edge


# Pictures and video

@needs_opengl
def test_the_picture_shows_the_car_on_a_road_and_moves(stage, log):
    motion = render.Motion(log, 30)
    first, later = stage.picture(motion.at(0)), stage.picture(motion.at(45))
    assert first.shape == (HEIGHT, WIDTH, 3) and first.dtype == np.uint8
    middle = first[HEIGHT // 3 : 2 * HEIGHT // 3, WIDTH // 3 : 2 * WIDTH // 3].astype(int)
    blue = (middle[..., 2] > 1.8 * middle[..., 0]) & (middle[..., 2] > middle[..., 1] + 20)
    assert blue.mean() > 0.1  # the car's paint
    top = first[:10].astype(int)
    assert (top[..., 2] >= top[..., 0]).mean() > 0.3  # sky between the trees
    assert np.abs(first.astype(int) - later).mean() > 2.0  # gray levels: the world passes by


@needs_opengl
def test_the_video_plays_from_its_start_in_a_codec_of_browsers(log, tmp_path):
    told = []
    file = render.render_video(log, tmp_path / "deep" / "run.mp4", width=WIDTH, height=HEIGHT,
                               progress=told.append)
    pictures, codec = frames(file)
    assert codec in ("h264", "vp9")
    assert pictures.shape == (len(render.Motion(log, 30)), HEIGHT, WIDTH, 3)
    assert told[-1] == 1.0 and np.all(np.diff(told) > 0.0)
    data = file.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # the index comes first: it streams
    assert os.listdir(file.parent) == ["run.mp4"]


def stop_by_signal(fraction):
    if fraction > 0.3:
        os.kill(os.getpid(), signal.SIGINT)


def stop_by_exception(fraction):
    if fraction > 0.3:
        raise KeyboardInterrupt


@needs_opengl
@pytest.mark.parametrize("stop", [stop_by_signal, stop_by_exception])
def test_an_interrupted_video_is_kept_and_plays(stop, log, tmp_path):
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        render.render_video(log, tmp_path / "run.mp4", width=64, height=64, progress=stop)
    assert signal.getsignal(signal.SIGINT) is before
    assert os.listdir(tmp_path) == ["run.mp4"]
    pictures, _ = frames(tmp_path / "run.mp4")
    assert 0.3 * 2.0 * 30 <= len(pictures) < 0.5 * 2.0 * 30


@needs_opengl
def test_a_failure_leaves_the_old_video_and_nothing_else(log, tmp_path):
    old = tmp_path / "run.mp4"
    old.write_bytes(b"old")

    def fail(fraction):
        raise RuntimeError("the disk is on fire")

    with pytest.raises(RuntimeError):
        render.render_video(log, old, width=64, height=64, progress=fail)
    assert os.listdir(tmp_path) == ["run.mp4"] and old.read_bytes() == b"old"


@needs_opengl
def test_a_closed_track_and_a_run_without_prediction_are_filmed(tmp_path):
    log = fake_log(0.5)
    for name in list(log.columns):
        if name.startswith("pred_"):
            log.columns[name][:] = np.nan
    log.columns["wind_mps"][:] = 0.0
    log.scenario.path = fake_path(300.0, closed=True)
    file = render.render_video(log, tmp_path / "run.mp4", width=64, height=64)
    assert len(frames(file)[0]) == len(render.Motion(log, 30))


def test_missing_egl_is_one_sentence_naming_the_packages(log, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "")
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)  # its import fails
    with pytest.raises(RenderError, match="libegl1 libgl1-mesa-dri libegl-mesa0"):
        render.render_video(log, tmp_path / "run.mp4")
    assert not list(tmp_path.iterdir())


def test_a_disabled_opengl_is_respected(log, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    with pytest.raises(RenderError, match="MUJOCO_GL is 'disable'"):
        render.render_video(log, tmp_path / "run.mp4")


@pytest.mark.parametrize("option, value", [("width", 321), ("height", 0), ("fps", 0)])
def test_sizes_that_cannot_be_encoded_are_refused(option, value, log, tmp_path):
    with pytest.raises(OptionError, match=f"{option} is {value}"):
        render.render_video(log, tmp_path / "run.mp4", **{option: value})


@needs_opengl
def test_a_place_that_cannot_be_written_is_named(log, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="run.mp4"):
        render.render_video(log, tmp_path / "file" / "run.mp4", width=64, height=64)


# Instruments

@pytest.fixture
def hud():
    road = np.stack(fake_path().at(np.linspace(0, 600, 50))[:2], axis=1)
    return Hud(1280, 720, title="paper", subtitle="lpv-mpc", road=road,
               scales={"ey_mm": 5, "steer_deg": 10, "acc_mps2": 8, "wind_mps": 60})


def values(**changes):
    names = ("t_s", "vx_mps", "vx_ref_mps", "ey_mm", "steer_deg", "ax_mps2", "ay_mps2", "wind_mps",
             "step_ms", "x_m", "y_m", "psi_rad")
    return dict.fromkeys(names, 0.0) | changes


def test_an_error_to_the_left_moves_the_gauge_to_the_left(hud):
    def marker(ey_mm):
        frame = np.zeros((720, 1280, 3), np.uint8)
        hud.draw(frame, values(ey_mm=ey_mm))
        left, right, y = hud._bar("error")
        return left + int(np.argmax(frame[y, left:right].sum(axis=1)))

    assert marker(4.0) < marker(0.0) < marker(-4.0)


def test_numbers_that_are_not_finite_are_dashes(hud):
    frame = np.zeros((720, 1280, 3), np.uint8)
    hud.draw(frame, dict.fromkeys(values(), np.nan) | {"t_s": 1.0})
    assert _number(np.nan, 2) == "–"


def test_a_rounded_zero_has_no_sign():
    assert _number(-0.004, 2, sign=True) == "0.00"
    assert _number(-0.4, 1, sign=True) == "−0.4"


def test_instruments_darken_their_panels_only(hud):
    frame = np.full((720, 1280, 3), 200, np.uint8)
    hud.draw(frame, values())
    assert np.all(frame[300:500, 200:1000] == 200)
    assert np.median(frame[640:]) < 100


def test_the_map_car_stands_on_the_path(hud):
    path = fake_path()
    frame = np.zeros((720, 1280, 3), np.uint8)
    x, y, psi, _ = (float(v) for v in path.at(300.0))
    hud.draw(frame, values(x_m=x, y_m=y, psi_rad=psi))
    u, v = hud._pixel(x, y)
    assert tuple(frame[round(float(v)), round(float(u))]) == (255, 176, 60)


def test_the_text_fits_its_cells(hud):
    """The widest numbers end before the next instrument starts."""
    width = hud._wide("88.8 ref", 15, 500)
    assert hud.cells["speed"] + 96 + width < hud.cells["error"] - 14


def test_the_clock_stands_clear_of_the_longest_title():
    road = np.stack(fake_path().at(np.linspace(0, 600, 50))[:2], axis=1)
    hud = Hud(1280, 720, title="double-lane-change", subtitle="my_module:MyController", road=road,
              scales={"ey_mm": 5, "steer_deg": 10, "acc_mps2": 8, "wind_mps": 60})
    title = 30 + hud._wide("double-lane-change", 22, 700)
    assert title < hud.clock - hud._wide("999.9 s", 22, 600)


def test_frames_keep_time_with_the_log(log):
    motion = render.Motion(log, 30)
    assert motion.t[1] - motion.t[0] == pytest.approx(1 / 30)
    assert motion.t[-1] <= log.columns["t_s"][-1] + 1e-9 < motion.t[-1] + 1 / 30 + TS


def test_a_skidpad_of_many_laps_builds():
    path = Path(np.full(2001, 1 / 30.0), 400.0)  # two laps of a circle of 30 m
    scene = scenery.build(path, width=64, height=36)
    assert sum("road_" in scene.model.geom(g).name for g in scene.tiles) <= 8
