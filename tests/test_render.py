import os
import signal
import sys

import av
import numpy as np
import pytest
from fake_log import TS, fake_log, fake_path
from opengl import needs_opengl

from lpvmpc.errors import OptionError, OutputError, RenderError
from lpvmpc.picture.video import render

WIDTH, HEIGHT = 320, 180


@pytest.fixture(scope="module")
def log():
    return fake_log(2.0)


def frames(file):
    """All pictures of a video as one array, and the codec's name."""
    with av.open(str(file)) as video:
        stream = video.streams.video[0]
        assert stream.codec_context.pix_fmt == "yuv420p"  # what browsers decode
        return (np.stack([f.to_ndarray(format="rgb24") for f in video.decode(stream)]),
                stream.codec_context.name)


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


def test_the_film_ends_before_the_first_row_that_is_not_finite():
    log = fake_log(2.0)
    log.columns["qpos_1"][40:] = np.nan  # a plant that blew up
    motion = render.Motion(log, 30)
    assert motion.t[-1] <= log.columns["t_s"][39] < motion.t[-1] + 1 / 30
    assert np.isfinite(motion.qpos).all()


def test_a_log_without_two_rows_makes_no_video(tmp_path):
    log = fake_log(2.0)
    log.columns = {name: column[:1] for name, column in log.columns.items()}
    with pytest.raises(RenderError, match="two rows"):
        render.render_video(log, tmp_path / "x.mp4")


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


@pytest.mark.parametrize("option, value", [("width", 321), ("height", 0), ("fps", 0)])
def test_sizes_that_cannot_be_encoded_are_refused(option, value, log, tmp_path):
    with pytest.raises(OptionError, match=f"{option} is {value}"):
        render.render_video(log, tmp_path / "run.mp4", **{option: value})


@needs_opengl
def test_a_place_that_cannot_be_written_is_named(log, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="run.mp4"):
        render.render_video(log, tmp_path / "file" / "run.mp4", width=64, height=64)


def test_frames_keep_time_with_the_log(log):
    motion = render.Motion(log, 30)
    assert motion.t[1] - motion.t[0] == pytest.approx(1 / 30)
    assert motion.t[-1] <= log.columns["t_s"][-1] + 1e-9 < motion.t[-1] + 1 / 30 + TS


def test_a_machine_without_egl_leaves_no_file(log, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "")
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)  # its import fails
    with pytest.raises(RenderError, match="libegl1"):
        render.render_video(log, tmp_path / "run.mp4")
    assert not list(tmp_path.iterdir())
