"""Runs read back, replayed as a page, and written for other tools."""

import csv
import json
import re
import shutil
import warnings
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lpvmpc.commands import main
from lpvmpc.errors import DataError
from lpvmpc.export.stored import read_run
from lpvmpc.export.topics import places_of
from lpvmpc.kit.cli import one_line
from lpvmpc.picture import figures
from lpvmpc.reliability.damage import damaged

ROAD = "# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n"


@pytest.fixture(scope="module")
def driven(tmp_path_factory):
    """A folder with a run on a short road in the world rtk, its trace exported as MCAP."""
    folder = tmp_path_factory.mktemp("driven")
    (folder / "bend.csv").write_text(
        ROAD + "".join(f"{x},{0.004 * x * x},3,3,10\n" for x in range(0, 41, 2)))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(figures, "save_all", lambda log, folder: None)
        words = ("--scenario", "bend.csv", "--world", "rtk", "--report", "--export", "mcap")
        assert main(["track", *words]) == 0
    return folder


@pytest.fixture
def here(driven, tmp_path, monkeypatch):
    """A copy of it, as the current folder."""
    shutil.copytree(driven, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy" / "runs" / "bend-lpv-mpc"


def rows_of(file):
    """Every column that the file's messages make again, by the names of the trace."""
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        topics = {channel.topic for channel in summary.channels.values()}
        assert {summary.schemas[c.schema_id].encoding for c in summary.channels.values()} == {
            "jsonschema"}
        messages = {topic: [] for topic in topics}
        for _, channel, message in reader.iter_messages():
            messages[channel.topic].append((message.log_time, json.loads(message.data)))
        attached = [a for a in reader.iter_attachments()]
    return messages, attached


# Damage -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["trace.parquet", "timing.parquet", "metrics.json"])
def test_a_damaged_run_is_never_taken_for_a_whole_one(here, name):
    raw = (here / name).read_bytes()
    _, whole = read_run(here)
    for i in range(40):
        (here / name).write_bytes(damaged(raw, np.random.default_rng(i)))
        try:
            _, content = read_run(here)
        except DataError as error:
            assert one_line(str(error)).endswith(".")
        else:
            assert content == whole  # a blank between two values of metrics.json


@pytest.mark.parametrize("wrong", [
    "[]", "null", "{}", '{"record": 3}', {"duration_s": "long"}, {"lap_times_s": 3},
    {"completed": None}, {"qp": [1]}, {"world": "rtk"}, {"reason": 5}, {"estimator": {}},
    {"lateral_rmse_m": float("inf")}, {"record": {}}, {"versions": "1"},
])
def test_without_checksums_it_is_told_and_what_is_no_run_refused(here, wrong):
    content = json.loads((here / "metrics.json").read_text())
    del content["record"]["sha256"]
    (here / "metrics.json").write_text(json.dumps(content))
    with pytest.warns(UserWarning, match="no checksums"):
        read_run(here)
    text = wrong if isinstance(wrong, str) else json.dumps(content | wrong)
    (here / "metrics.json").write_text(text)
    with pytest.raises(DataError, match="no whole run"), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read_run(here)


def test_tables_that_are_none_are_refused_without_checksums_too(here):
    content = json.loads((here / "metrics.json").read_text())
    del content["record"]["sha256"]
    (here / "metrics.json").write_text(json.dumps(content))
    table = pq.read_table(here / "trace.parquet")
    s_m = table.column_names.index("s_m")
    nothing = pa.array([np.nan] * len(table))
    for wrong in (
        table.append_column("s_m", table["s_m"]), table.drop_columns(["vx_mps"]),
        table.set_column(s_m, "s_m", nothing), table.replace_schema_metadata({}),
        table.set_column(s_m, "s_m", pa.array(["x"] * len(table))), pa.table({"a": [1]}),
    ):
        pq.write_table(wrong, here / "trace.parquet")
        with pytest.raises(DataError), pytest.warns(UserWarning, match="no checksums"):
            read_run(here)


# MCAP ---------------------------------------------------------------------------------------------


def test_the_mcap_has_every_channel_of_the_trace_to_the_last_digit(here):
    trace = pq.read_table(here / "trace.parquet")
    messages, _ = rows_of(here / "trace.mcap")
    places = places_of(trace.column_names)
    assert len(set(places.values())) == trace.num_columns > 100
    times = np.round(1e9 * trace["t_s"].to_numpy()).astype(np.int64)
    for name, place in places.items():
        found = messages[place.topic]
        values = [message[place.field] for _, message in found]
        if place.index is not None:
            values = [value[place.index] for value in values]
        known = np.array([np.nan if value is None else value for value in values], float)
        np.testing.assert_array_equal(known, trace[name].to_numpy().astype(float), err_msg=name)
        assert [time for time, _ in found] == times.tolist()
    assert {place.topic for place in places.values()} >= {"/car", "/tire/rr", "/estimate"}


def test_the_mcap_has_times_scene_and_metrics(here):
    messages, (attachment,) = rows_of(here / "trace.mcap")
    timing = pq.read_table(here / "timing.parquet")
    assert len(messages["/timing"]) == timing.num_rows
    assert messages["/timing"][3][1]["step_us"] == timing["step_us"][3].as_py()
    first = messages["/scene"][0][1]["entities"]
    assert [entity["id"] for entity in first] == ["prediction", "left", "right", "car"]
    edge = first[1]["lines"][0]["points"]
    assert edge[0]["y"] == pytest.approx(3.0, abs=0.02)  # the road is 3 m wide to the left
    turn = messages["/tf"][-1][1]["rotation"]
    psi = pq.read_table(here / "trace.parquet")["psi_rad"][-1].as_py()
    assert 2.0 * np.arctan2(turn["z"], turn["w"]) == pytest.approx(psi, abs=1e-12)
    assert json.loads(attachment.data) == json.loads((here / "metrics.json").read_text())


def test_the_layouts_name_what_there_is(here):
    messages, _ = rows_of(here / "trace.mcap")
    layout = json.loads((here / "foxglove.json").read_text())
    values = [path["value"] for panel in layout["configById"].values()
              for path in panel.get("paths", [])]
    assert len(values) > 10 and "/error.ey_m" in values and "/estimate.ey_m" in values
    for value in values:
        topic, _, field = value.partition(".")
        assert field in messages[topic][0][1], value
    curves = [curve.get("name") for curve in
              ElementTree.parse(here / "plotjuggler.xml").iter("curve")]
    assert sorted(curves) == sorted(value.replace(".", "/") for value in values)
    panels = re.findall(r'"((?:Plot|3D)![^"]+)"', json.dumps(layout["layout"]))
    assert sorted(panels) == sorted(layout["configById"])


# CSV, and the run read back -----------------------------------------------------------------------


def test_the_csv_has_every_column_to_the_last_digit(here, capsys):
    assert main(["export", str(here), "--to", "csv"]) == 0
    assert capsys.readouterr().out.count("Saved ") == 2
    trace = pq.read_table(here / "trace.parquet")
    with open(here / "trace.csv", newline="") as file:
        header, *rows = csv.reader(file)
    assert header == [*trace.column_names, "step_us"] and len(rows) == trace.num_rows
    for k, name in enumerate(trace.column_names):
        values = np.array([float(row[k]) for row in rows])
        np.testing.assert_array_equal(values, trace[name].to_numpy().astype(float), err_msg=name)
    curves = [curve.get("name") for curve in
              ElementTree.parse(here / "plotjuggler.xml").iter("curve")]
    assert set(curves) <= set(header)


def test_a_run_read_back_is_the_log_that_it_was(here):
    log, content = read_run(here)
    assert content["record"]["options"]["world"] == "rtk"
    assert log.scenario.path.has_widths and log.meta["controller"] == "lpv-mpc"
    assert len(log) == len(log.timing["t_s"]) and log.weights["q_ey"] > 0.0
    log.write(here)  # as simulate's log wrote it
    again = pq.read_table(here / "trace.parquet")
    assert again["ey_m"].to_numpy().tolist() == log.columns["ey_m"].tolist()


def test_the_page_is_made_again_from_the_trace(here, capsys):
    first = (here / "report.html").read_text()
    (here / "report.html").unlink()
    assert main(["view", str(here), "--html"]) == 0
    assert capsys.readouterr().out == f"Saved {here / 'report.html'}\n"
    assert (here / "report.html").read_text() == first


def test_a_new_run_takes_the_pages_of_the_last_away(here, monkeypatch):
    monkeypatch.setattr(figures, "save_all", lambda log, folder: None)
    assert main(["track", "--scenario", "bend.csv", "--controller", "stanley", "--out",
                 str(here)]) == 0
    assert {file.name for file in here.iterdir() if file.is_file()} - {".lock"} == {
        "metrics.json", "timing.parquet", "trace.parquet"}


def test_the_viewer_is_shown_every_instant(here, monkeypatch):
    pytest.importorskip("glfw")
    from lpvmpc.picture.video import viewer

    shown = []

    class Window:
        def __init__(self, road, instead, cones):
            assert road.length > 30.0 and len(cones) == 0

        def is_open(self):
            return len(shown) < 100

        def show(self, qpos, x, y, psi, others):
            assert others == []
            shown.append((qpos[0], x, y))

        def close(self):
            shown.append("closed")

    monkeypatch.setattr(viewer, "Window", Window)
    monkeypatch.setattr(viewer.time, "sleep", lambda seconds: None)
    monkeypatch.setenv("DISPLAY", ":7")
    assert main(["view", str(here), "--speed", "2"]) == 0
    assert len(shown) == 101 and shown[-1] == "closed"
    places = np.array([x for _, x, _ in shown[:100]])
    assert np.all(np.diff(places) > 0.0)  # 4 s at 30 pictures a second, once


# What is refused ----------------------------------------------------------------------------------


def refused(capsys, *words):
    code = main(list(map(str, words)))
    err = capsys.readouterr().err
    assert code == 2 and err.count("\n") == 1, err
    return err


def test_what_is_no_run_is_one_sentence(here, capsys, monkeypatch):
    assert "Name one run's folder" in refused(capsys, "view", "--html")
    assert "2 were given" in refused(capsys, "export", here, here)
    assert "holds no run of `lpvmpc track`" in refused(capsys, "export", "nowhere")
    assert "one of csv, mcap" in refused(capsys, "export", here, "--to", "bag")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert "--html makes a page" in refused(capsys, "view", here)


@pytest.mark.parametrize("file", ["metrics.json", "trace.parquet", "timing.parquet"])
@pytest.mark.parametrize("text", [b"", b"{}", b"PAR1PAR1", b"[1, 2]"])
def test_a_damaged_file_is_one_sentence(here, capsys, file, text):
    (here / file).write_bytes(text)
    assert "run" in refused(capsys, "export", here)


def test_a_road_that_is_gone_or_changed_is_said(here, capsys):
    bend = here.parents[1] / "bend.csv"
    bend.write_text(ROAD + "".join(f"{x},{0.005 * x * x},3,3,10\n" for x in range(0, 41, 2)))
    assert "is another one than the run's" in refused(capsys, "view", here, "--html")
    bend.unlink()
    assert "The road of this run cannot be made again." in refused(capsys, "view", here, "--html")


def test_a_missing_mcap_is_said_before_anything_is_driven(here, capsys, monkeypatch):
    monkeypatch.setattr("lpvmpc.export.names.find_spec", lambda name: None)
    for words in (("export", here), ("track", "--export", "mcap")):
        assert "pip install 'lpvmpc[mcap]'" in refused(capsys, *words)
