"""The report on how fast the environments are."""

import json

import pytest

pytest.importorskip("gymnasium")

from lpvmpc.gym import one, speed  # noqa: E402
from lpvmpc.kit import cli  # noqa: E402
from lpvmpc.plant.plant import Plant  # noqa: E402


def test_steady_states_that_are_settled_beforehand_are_not_settled_again(monkeypatch):
    monkeypatch.setattr(one, "_KEPT", {})
    monkeypatch.setattr(one, "SLOWEST", 6.0)
    plant = Plant()
    starts = one.Starts(plant)
    # at 6 m/s 0.06 1/m are 2.16 m/s2: straight on, and 2 m/s2 either way
    assert starts.settle_all(fastest=6.9, kappa=0.06) == 3
    ready = starts.state(6.2, -0.06, 1.0, 2.0, 0.5).copy()
    monkeypatch.setattr(plant, "reset", None)  # nothing may settle now
    assert (starts.state(6.2, -0.06, 1.0, 2.0, 0.5) == ready).all()
    assert starts.settle_all(fastest=6.9, kappa=0.06) == 3


def test_what_is_missed_and_what_is_not_there_comes_first():
    rows = [("TrackVec-v0, 64 cars, ideal", 5000.0, "1/s of CPU", None, [4900.0, 5000.0]),
            ("share of the bare models afloat", 0.7, "", 0.85, [0.69, 0.7, 0.71])]
    text = speed.report(rows, rounds=3, settling=6.2)
    head, _, tables = text.partition("Definitions: ")
    assert "Bars not met: share of the bare models afloat is 0.70, the bar 0.85." in head
    assert "Not measured, since not installed: CarRacing-v3, f1tenth_gym." in head
    assert "in blocks of 10 periods" in tables and "took 6 s of CPU" in tables
    assert "| 0.69 to 0.71 |" in tables and ">= 0.85 |" in tables
    text = speed.report([*rows[:1], ("CarRacing-v3", 150.0, "1/s of CPU", None, [150.0])], 1, 6.2)
    assert "All bars are met." in text and "not installed: f1tenth_gym." in text


@pytest.mark.slow
def test_the_report_is_written(capsys, tmp_path):
    words = ["--rounds", "1", "--periods", "10", "--out", str(tmp_path / "out")]
    assert cli.run(speed.Options, speed.main, words) == 0
    out, err = capsys.readouterr()
    assert err == ""
    values = json.loads((tmp_path / "out" / "environments.json").read_text())["values"]
    # the same physics and more: its share is below 1, and the tires cost something
    assert 0.3 < values["share of the bare models with tires"] < 1.1
    assert 0.5 < values["ratio of the bare models, with tires to afloat"] < 1.0
    assert values["TrackVec-v0, 64 cars, ideal"] > 100.0
    assert out.startswith("# Speed of the gymnasium environments")
