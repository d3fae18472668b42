import struct
import warnings

import numpy as np
import pytest
from fake_log import fake_log

from lpvmpc import published
from lpvmpc.errors import OutputError
from lpvmpc.picture import figures
from lpvmpc.picture.path_figure import zooms

NAMES = ["speed_wind", "path", "commands", "errors", "computation_time", "tires", "gg"]


@pytest.fixture(scope="module")
def log():
    return fake_log(8.0, qpos=False)


@pytest.fixture
def coarse(monkeypatch):
    """Coarse pictures, where only the drawing is tested."""
    monkeypatch.setattr(figures, "DPI", 40)


def chunks(data):
    """Names of the chunks of a PNG file."""
    names, at = [], 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        names.append(data[at + 4 : at + 8].decode())
        at += length + 12
    return names


def shorter(log, rows):
    """The same log, cut to its first rows."""
    for table in (log.columns, log.timing):
        for name in table:
            table[name] = table[name][:rows]
    return log


def test_every_figure_is_written_at_column_width_without_metadata(log, tmp_path):
    files = figures.save_all(log, tmp_path / "new" / "figures")
    assert [f.stem for f in files] == NAMES
    for file in files:
        data = file.read_bytes()
        assert data.startswith(b"\x89PNG")
        width = struct.unpack(">I", data[16:20])[0]
        inches = figures.DOUBLE if file.stem in ("errors", "tires") else figures.COLUMN
        assert width == pytest.approx(300 * inches, abs=1.0)  # 300 dpi, rounded to pixels
        assert not {"tEXt", "iTXt", "zTXt", "tIME"} & set(chunks(data))


def test_the_same_log_gives_the_same_bytes(log, tmp_path, coarse):
    first = figures.save_all(log, tmp_path / "a")
    second = figures.save_all(log, tmp_path / "b")
    for a, b in zip(first, second, strict=True):
        assert a.read_bytes() == b.read_bytes()


@pytest.mark.parametrize("name, compared", [("paper", True), ("circuit", False)])
def test_the_papers_errors_are_shown_on_the_papers_road_only(name, compared):
    figure = figures.errors(fake_log(2.0, name=name, qpos=False))
    labels = [line.get_label() for axis in figure.axes for line in axis.get_lines()]
    assert any("paper" in label for label in labels) is compared


def test_the_papers_values_are_those_of_its_text():
    assert published.TRACKING["lateral_rmse_m"] == 0.0217
    assert published.TRACKING["heading_max_rad"] == pytest.approx(0.19199, abs=1e-5)  # 11 degrees


def test_the_zooms_hold_the_largest_error_and_the_strongest_wind(log):
    rows = zooms(log.columns)
    assert abs(log.columns["ey_m"][rows["largest error"]]) == np.abs(log.columns["ey_m"]).max()
    assert log.columns["wind_mps"][rows["peak wind"]] == log.columns["wind_mps"].max()


def test_the_zooms_show_different_places_and_no_wind_where_there_is_none():
    """The bend lies within 50 m of the largest error and is passed over."""
    s = np.arange(500.0)
    columns = {"s_m": s, "kappa_radpm": 0.1 * (s == 130), "wind_mps": 20.0 * (s == 450),
               "ey_m": 0.3 * (s == 100) - 0.2 * (s == 300) + 0.1 * (s == 400)}
    assert zooms(columns) == {"largest error": 100, "peak wind": 450, "second error": 300}
    columns["wind_mps"][:] = 0.0
    assert zooms(columns) == {"largest error": 100, "second error": 300, "third error": 400}
    short = {name: column[95:140] for name, column in columns.items()}  # no room for three
    assert len(zooms(short)) == 3


def test_the_used_friction_is_the_share_of_the_peak():
    log = fake_log(2.0, qpos=False)
    c = log.columns
    c["Fz_rr_N"][:10] = 0.0  # in the air
    curves = {line.get_label(): line.get_ydata() for line in figures.tires(log).axes[3].get_lines()}
    used = np.hypot(c["Fx_fl_N"], c["Fy_fl_N"]) / (0.82 * c["Fz_fl_N"])
    np.testing.assert_allclose(curves["fl"], used, rtol=1e-12)
    assert np.isnan(curves["rr"][:10]).all() and np.isfinite(curves["rr"][10:]).all()


def test_the_friction_circle_has_the_radius_of_the_plants_friction():
    log = fake_log(2.0, qpos=False)
    for wheel in ("fl", "fr", "rl", "rr"):
        log.columns[f"mu_{wheel}"][:] = 0.41
    circle = figures.gg(log).axes[0].get_lines()[0]
    assert np.hypot(*circle.get_data()) == pytest.approx(0.41 * 9.81)


def test_a_run_cut_short_is_named_in_the_title():
    log = fake_log(1.0, qpos=False)
    log.meta["completed"] = False
    assert "not completed" in figures.speed_wind(log).axes[0].get_title(loc="left")


@pytest.mark.parametrize("rows", [1, 2])
def test_the_shortest_runs_are_drawn_without_warnings(rows, tmp_path, coarse):
    log = shorter(fake_log(1.0, qpos=False), rows)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(figures.save_all(log, tmp_path)) == len(NAMES)


def test_values_that_are_not_finite_do_not_spoil_a_figure(tmp_path, coarse):
    log = fake_log(1.0, qpos=False)
    for name in ("ey_m", "ax_mps2", "vx_mps"):
        log.columns[name][-3:] = np.nan  # a plant that blew up
    assert len(figures.save_all(log, tmp_path)) == len(NAMES)


def test_a_run_without_any_error_or_wind_is_drawn(tmp_path, coarse):
    log = fake_log(1.0, qpos=False)
    for name in ("ey_m", "epsi_rad", "wind_mps", "kappa_radpm"):
        log.columns[name][:] = 0.0
    assert len(figures.save_all(log, tmp_path)) == len(NAMES)


def test_a_folder_that_cannot_be_made_is_named(log, tmp_path):
    blocker = tmp_path / "file"
    blocker.write_text("")
    with pytest.raises(OutputError, match="file"):
        figures.save_all(log, blocker)
