import warnings

import av
import numpy as np
import pytest
from fake_log import fake_log
from opengl import needs_opengl

from lpvmpc.errors import LPVMPCError, OptionError, OutputError
from lpvmpc.picture import comparison
from lpvmpc.picture.video import comparison as comparison_video

WIDTH, HEIGHT = 96, 64


def finished(log, **meta):
    """A made-up log with what metrics asks for."""
    log.meta |= {"s_end_m": float(log.columns["s_m"][-1]), "reason": "", "has_qp": True,
                 "stiffness": None, "duration_s": float(log.columns["t_s"][-1]),
                 "reference_duration_s": 8.0, "wall_s": 1.0, "realtime_factor": 1.0,
                 "versions": {}, "model_sha256": ""}
    log.meta |= meta
    return log


def lost(seconds=1.0):
    log = finished(fake_log(seconds), completed=False, reason="off the path: |ey| > 5 m")
    log.columns["ey_m"][-1] = 5.1
    return log


@pytest.fixture(scope="module")
def runs():
    rough = finished(fake_log(3.0), controller="stanley")
    for name in ("ey_m", "delta_cmd_rad"):
        rough.columns[name] = 10.0 * rough.columns[name]
    return {"lpv-mpc": finished(fake_log(3.0)), "stanley": rough, "mine": lost()}


@pytest.fixture
def coarse(monkeypatch):
    monkeypatch.setattr(comparison, "DPI", 40)


def test_every_picture_and_the_table_are_written(runs, tmp_path, coarse):
    files = comparison.save_all(runs, tmp_path / "new" / "folder")
    names = ["errors.png", "signals.png", "path.png", "comparison.md"]
    assert [file.name for file in files] == names
    assert all(file.stat().st_size > 0 for file in files)


def test_the_table_holds_each_runs_own_numbers(runs):
    header, rows = comparison.table(runs)
    cells = {row[0]: row[1:] for row in rows}
    assert header == ("quantity", "lpv-mpc", "stanley", "mine")
    rmse = [float(cell) for cell in cells["lateral error, RMSE [mm]"]]
    assert rmse[1] == pytest.approx(10.0 * rmse[0], abs=0.06)  # two digits are printed
    rate = [float(cell) for cell in cells["steering rate, RMS [deg/s]"]]
    assert rate[1] == pytest.approx(10.0 * rate[0], abs=0.06)
    assert cells["completed"][:2] == ("yes", "yes") and cells["completed"][2].startswith("no, ")
    text = comparison.markdown(runs)
    assert "`mine` did not complete: off the path: |ey| > 5 m, after" in text


def test_the_terminal_gets_one_row_per_run(runs):
    header, rows = comparison.summary(runs)
    assert [row[0] for row in rows] == list(runs)
    assert all(len(row) == len(header) for row in rows)


def test_a_lost_car_does_not_set_the_scale(runs):
    lateral = comparison.errors(runs).axes[0]
    # the largest error of the completed runs and a margin of 8 % of the span, in mm
    assert lateral.get_ylim()[1] < 1.5e3 * np.abs(runs["stanley"].columns["ey_m"]).max()
    alone = comparison.errors({"a": lost(), "b": lost()}).axes[0]
    assert alone.get_ylim()[1] > 5100.0


def test_the_paths_are_zoomed_where_the_less_exact_run_is_worst(runs):
    labels = [axis.get_title(loc="left") for axis in comparison.path(runs).axes]
    assert labels[0] == "Paths (paper)" and labels[1] == "A  largest error"
    row = int(np.argmax(np.abs(runs["stanley"].columns["ey_m"])))
    zoom = comparison.path(runs).axes[1]
    assert zoom.get_xlabel() == f"s − {runs['stanley'].columns['s_m'][row]:.0f} [m]"


def test_the_shortest_runs_are_drawn_without_warnings(tmp_path, coarse):
    pair = {name: finished(fake_log(0.05, qpos=False)) for name in "ab"}
    for log in pair.values():
        for table in (log.columns, log.timing):
            for name in table:
                table[name] = table[name][:1]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(comparison.save_all(pair, tmp_path)) == 4


def test_runs_that_cannot_be_compared_are_named(runs, tmp_path):
    one = {"lpv-mpc": runs["lpv-mpc"]}
    with pytest.raises(LPVMPCError, match="needs 2 to 6 runs, but got 1"):
        comparison.save_all(one, tmp_path)
    other = one | {"b": finished(fake_log(1.0, name="circuit", qpos=False))}
    with pytest.raises(LPVMPCError, match="'lpv-mpc' and 'b' drove different roads: paper of"):
        comparison.save_all(other, tmp_path)
    empty = finished(fake_log(1.0, qpos=False))
    empty.columns = {name: column[:0] for name, column in empty.columns.items()}
    with pytest.raises(LPVMPCError, match="run 'b' is empty"):
        comparison.save_all(one | {"b": empty}, tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        comparison.save_all(runs, tmp_path / "file")


# The video --------------------------------------------------------------------------------------


def colourfulness(picture):
    """Mean spread of the colour channels: nothing for grey."""
    return float(np.ptp(picture.astype(int), axis=-1).mean())


@needs_opengl
def test_the_video_holds_all_runs_until_the_last_ends(runs, tmp_path):
    same = runs["lpv-mpc"]
    film = {"a": same, "b": same, "mine": runs["mine"]}  # 3 s, 3 s, and lost after 1 s
    file = comparison_video.compare_video(film, tmp_path / "run.mp4", width=WIDTH, height=HEIGHT,
                                          fps=4)
    with av.open(str(file)) as video:
        pictures = np.stack([f.to_ndarray(format="rgb24") for f in video.decode(video=0)])
    frames = int(np.floor(same.columns["t_s"][-1] * 4 + 1e-6)) + 1
    strip = 2 * round(comparison_video.STRIP * HEIGHT / 2.0)
    assert pictures.shape == (frames, 2 * HEIGHT + strip, 2 * WIDTH, 3)
    left, right = pictures[-1, :HEIGHT, :WIDTH], pictures[-1, :HEIGHT, WIDTH:]
    below = pictures[:, HEIGHT : 2 * HEIGHT, :WIDTH]
    # its last picture stays, grey but for what the codec adds
    assert colourfulness(left) > 15.0 and colourfulness(right) > 15.0
    assert colourfulness(below[0]) > 15.0 and colourfulness(below[-1]) < 3.0
    assert np.abs(below[-1].astype(int) - below[-2].astype(int)).mean() < 2.0
    # each is followed by a camera of its own: the same run gives the same picture, but for the
    # line between them and the codec
    world = slice(HEIGHT // 3, 4 * HEIGHT // 5), slice(4, WIDTH - 4)
    assert np.abs(left[world].astype(int) - right[world]).mean() < 6.0


def test_the_end_of_a_run_is_written_over_its_picture():
    picture = np.full((360, 640, 3), (40, 120, 200), dtype=np.uint8)
    done = comparison_video.ended(picture, "spun: |epsi| > pi/2", "after 12 m and 3.4 s")
    assert np.ptp(done.astype(int), axis=-1).max() <= 22  # grey; one ink is bluish
    rows = np.nonzero((done > 160).any(axis=(1, 2)))[0]
    columns = np.nonzero((done > 160).any(axis=(0, 2)))[0]
    assert 120 < rows.min() < rows.max() < 190
    assert abs(0.5 * (columns.min() + columns.max()) - 320) < 12  # in the middle


def test_why_a_run_ended_is_told_with_its_place(runs):
    log = runs["mine"]
    side = comparison_video.Side("mine", log, 640, 360, 30, {
        "ey_mm": 5.0, "steer_deg": 5.0, "acc_mps2": 4.0, "wind_mps": 10.0})
    what, where = side.reason()
    assert what == "off the path: |ey| > 5 m"
    assert where == f"after {log.columns['s_m'][-1]:.0f} m and {log.columns['t_s'][-1]:.1f} s"


def test_too_many_runs_and_odd_sizes_are_refused(runs, tmp_path):
    log = runs["lpv-mpc"]
    with pytest.raises(LPVMPCError, match="holds up to 4 runs, but got 5"):
        comparison_video.compare_video({str(n): log for n in range(5)}, tmp_path / "x.mp4")
    with pytest.raises(OptionError, match="width is 321"):
        comparison_video.compare_video(runs, tmp_path / "x.mp4", width=321)
