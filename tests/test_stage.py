import sys

import numpy as np
import pytest
from fake_log import fake_log
from opengl import needs_opengl

from lpvmpc.errors import RenderError
from lpvmpc.picture.video.render import Motion
from lpvmpc.picture.video.stage import Chase, Stage, gl_context

WIDTH, HEIGHT = 320, 180


@pytest.fixture(scope="module")
def log():
    return fake_log(2.0)


@pytest.fixture(scope="module")
def stage(log):
    stage = Stage(log, WIDTH, HEIGHT, 1 / 30)
    yield stage
    stage.close()


class Straight:
    def __init__(self, psi=0.0):
        self.psi = psi

    def at(self, s):
        return 0.0, 0.0, self.psi, 0.0


def test_the_camera_swings_to_a_new_heading_without_overshoot():
    road = Straight()
    chase = Chase(road, 1 / 30)
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
    frame = stage.picture(Motion(log, 30).at(0))
    place = stage.project(np.array([stage.chase.camera.lookat]), frame.shape)[0]
    assert place == pytest.approx((WIDTH / 2, HEIGHT / 2), abs=1e-3)  # the camera looks at it
    behind = stage.project(np.array([[-1e3, 0.0, 0.0]]), frame.shape)
    assert np.isnan(behind).all()


@needs_opengl
def test_the_picture_shows_the_car_on_a_road_and_moves(stage, log):
    motion = Motion(log, 30)
    first, later = stage.picture(motion.at(0)), stage.picture(motion.at(45))
    assert first.shape == (HEIGHT, WIDTH, 3) and first.dtype == np.uint8
    middle = first[HEIGHT // 3 : 2 * HEIGHT // 3, WIDTH // 3 : 2 * WIDTH // 3].astype(int)
    blue = (middle[..., 2] > 1.8 * middle[..., 0]) & (middle[..., 2] > middle[..., 1] + 20)
    assert blue.mean() > 0.1  # the car's paint
    top = first[:10].astype(int)
    assert (top[..., 2] >= top[..., 0]).mean() > 0.3  # sky between the trees
    assert np.abs(first.astype(int) - later).mean() > 2.0  # gray levels: the world passes by


def test_missing_egl_is_one_sentence_naming_the_packages(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "")
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)  # its import fails
    with pytest.raises(RenderError, match="libegl1 libgl1-mesa-dri libegl-mesa0"):
        gl_context(64, 64)


def test_a_disabled_opengl_is_respected(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "disable")
    with pytest.raises(RenderError, match="MUJOCO_GL is 'disable'"):
        gl_context(64, 64)


@needs_opengl
def test_another_road_user_is_in_the_picture(log, stage):
    now = Motion(log, 30).at(10)
    stage.chase.heading, stage.chase.rate = None, 0.0  # the camera begins anew for both
    before = stage.picture(now).astype(int)
    stage.chase.heading, stage.chase.rate = None, 0.0
    stage.users = [{"name": "van", "length_m": 4.0, "width_m": 1.8, "height_m": 1.6}]
    c, s = np.cos(now["psi_rad"]), np.sin(now["psi_rad"])
    try:
        place = {"user0_x_m": now["x_m"] + 8.0 * c, "user0_y_m": now["y_m"] + 8.0 * s}
        after = stage.picture({**now, **place, "user0_psi_rad": now["psi_rad"]}).astype(int)
    finally:
        stage.users = []
    rows, columns = np.nonzero(np.abs(after - before).max(axis=2) > 40)
    assert len(rows) > 200
    # above the middle, where the road ahead is, and not all over the picture
    assert np.median(rows) < 0.6 * HEIGHT and np.ptp(columns) < 0.5 * WIDTH
