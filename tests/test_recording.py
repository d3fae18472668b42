"""Recordings: what is read, what is refused, where they are cut."""

from pathlib import Path

import numpy as np
import pytest

from lpvmpc.errors import DataError
from lpvmpc.identify import signals
from lpvmpc.identify.recording import read_recording


def columns(n=200, step=0.05):
    """A car of 2.7 m wheelbase on a sine."""
    t = step * np.arange(n)
    delta = 0.03 * np.sin(t)
    return {"t_s": t, "delta_rad": delta, "vx_mps": np.full(n, 12.0), "r_radps": 3.0 * delta}


def write(folder: Path, table: dict, header: str = "") -> Path:
    file = folder / "drive.csv"
    rows = np.column_stack(list(table.values()))
    text = "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows)
    file.write_text(f"{header}{','.join(table)}\n{text}\n")
    return file


def test_columns_are_read_by_name_and_others_ignored(tmp_path):
    table = columns()
    table = {"odd": np.zeros(200), "vy_mps": 0.1 * table["r_radps"], **table}
    recording = read_recording(write(tmp_path, table, header="# a comment\n# "))
    assert recording.vy == pytest.approx(table["vy_mps"], abs=1e-8)
    assert recording.ay is None and recording.name == "drive.csv"


def broken(name, change):
    table = columns()
    table[name] = change(table[name])
    return table


def at(i, value):
    def change(values):
        values = values.copy()
        values[i] = value
        return values

    return change


BAD = {
    "no column": ({k: v for k, v in columns().items() if k != "vx_mps"}, "no column vx_mps"),
    "degrees": (broken("delta_rad", lambda d: 1000.0 * d), "are these degrees"),
    "yaw in degrees": (broken("r_radps", lambda r: 57.3 * r), "degrees per second"),
    "hand wheel": (broken("delta_rad", lambda d: 16.0 * d), "hand wheel"),
    "km/h": (broken("vx_mps", lambda v: 10.0 * v), "kilometres per hour"),
    "nan": (broken("r_radps", at(7, np.nan)), "sample 7"),
    "repeated": (broken("t_s", at(5, 0.2)), "Time repeats"),
    "unsorted": (broken("t_s", at(5, 0.1)), "Time goes back"),
    "milliseconds": (broken("t_s", lambda t: 1000.0 * t), "milliseconds"),
    "few": ({k: v[:10] for k, v in columns().items()}, "10 samples"),
    "short": (broken("t_s", lambda t: 0.1 * t), "at least 2 s"),
    "standing": (broken("vx_mps", lambda v: 0.05 * v), "never faster than 0.6 m/s"),
    "backwards": (broken("vx_mps", lambda v: -v), "backwards"),
    "wrong sign": (broken("delta_rad", lambda d: -d), "opposite signs"),
    "straight": (broken("r_radps", lambda r: 0.0 * r), "straight on"),
    "wheel held": (broken("delta_rad", lambda d: 0.0 * d), "deviation of delta_rad is 0 rad"),
    "hand wheel, far": (broken("delta_rad", lambda d: 40.0 * d), "not the hand wheel's"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_a_recording_is_refused_in_one_sentence(tmp_path, what):
    table, words = BAD[what]
    with pytest.raises(DataError, match=words) as caught:
        read_recording(write(tmp_path, table))
    assert "\n" not in str(caught.value) and str(caught.value).endswith(".")


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(DataError, match="There is no recording"):
        read_recording(tmp_path / "none.csv")
    file = tmp_path / "text.csv"
    file.write_text("t_s,delta_rad,vx_mps,r_radps\n0,a,1,2\n")
    with pytest.raises(DataError, match="must hold numbers"):
        read_recording(file)
    file.write_text("t_s,delta_rad,vx_mps,r_radps\n0,1\n")
    with pytest.raises(DataError, match="has 2 columns"):
        read_recording(file)
    file.write_text("")
    with pytest.raises(DataError, match="is empty"):
        read_recording(file)


def test_gaps_jumps_and_standstill_cut_a_recording(tmp_path):
    table = columns(n=400)
    table["t_s"][100:] += 1.0  # a gap
    table["vx_mps"][200:] += 6.0  # a jump
    table["vx_mps"][300:310] = 0.0  # a stop
    parts = read_recording(write(tmp_path, table)).segments()
    assert [len(one.t) for one in parts] == [100, 100, 100, 90]


def test_nothing_that_can_be_replayed_is_said(tmp_path):
    table = columns()
    table["vx_mps"][::20] = 1.0
    with pytest.raises(DataError, match="no 2 s in one piece"):
        read_recording(write(tmp_path, table)).segments()


def test_a_held_command_is_told_from_a_sampled_angle(tmp_path):
    table = columns()
    assert not read_recording(write(tmp_path, table)).held
    table["delta_rad"] = np.repeat(table["delta_rad"][::4], 4)
    recording = read_recording(write(tmp_path, table))
    assert recording.held
    times = np.arange(0.0, 9.0, 0.001)
    angle = recording.steering(times)
    late = times + 0.025  # jumps are seen half a sample after they happened, in the middle
    inside = np.abs((late / 0.2) % 1.0 - 0.5) < 0.4  # away from the jumps
    expected = table["delta_rad"][np.floor(late / 0.05).astype(int)]
    assert angle[inside] == pytest.approx(expected[inside], abs=1e-8)


def test_the_period_of_held_commands_is_found_between_the_samples():
    t = 0.033 * np.arange(900)
    when = 0.1 * np.arange(1, 300) + 0.004
    values = np.searchsorted(when, t, "right").astype(float)
    found = signals.changes(t, values)[np.diff(values) != 0.0]
    assert found == pytest.approx(when[: len(found)], abs=0.002)  # half a sample is 0.016
    values = np.repeat(np.arange(100.0), 9)[:900]
    values[500:] = np.roll(values, 4)[500:]  # no period: the middle
    seen = np.diff(values) != 0.0
    assert signals.changes(t, values)[seen] == pytest.approx(0.5 * (t[1:] + t[:-1])[seen])


def test_noise_of_the_speed_is_not_followed():
    from lpvmpc.identify.recording import Recording

    rng = np.random.default_rng(0)
    t = 0.03 * np.arange(1000)
    vx = 15.0 + 3.0 * np.sin(0.5 * t)
    clean = Recording(name="a", t=t, delta=0.0 * t, vx=vx, r=0.0 * t)
    noisy = Recording(name="b", t=t, delta=0.0 * t, vx=vx + 0.15 * rng.normal(size=1000), r=0.0 * t)
    assert clean.speed(t)[0] == pytest.approx(vx, abs=1e-3)
    # unsmoothed differences would be 0.15 sqrt(2) / 0.03 = 7 m/s2 wrong
    assert noisy.speed(t)[1][20:-20] == pytest.approx(1.5 * np.cos(0.5 * t)[20:-20], abs=0.6)


@pytest.mark.parametrize("place", ["folder", "", "file/below.csv"])
def test_a_recording_that_cannot_be_written_is_told_before_it_is_made(tmp_path, monkeypatch, capsys,
                                                                       place):
    from lpvmpc.identify.evidence import multibody

    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    monkeypatch.setattr(multibody, "record", lambda *_, **__: 1 / 0)
    assert multibody.main([place]) == 2
    assert capsys.readouterr().err.startswith("Error: Cannot write")
