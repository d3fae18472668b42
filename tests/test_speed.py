import csv
import json
import os
from pathlib import Path

import pytest

from lpvmpc.bench import speed, speed_processes, speed_together
from lpvmpc.bench.speed import Figure
from lpvmpc.commands import speed as speed_command
from lpvmpc.commands.parts import search_time
from lpvmpc.errors import RenderError
from lpvmpc.kit.cli import cores
from lpvmpc.plant import callbacks
from lpvmpc.plant.plant import Plant

COMMAND = "speed"


@pytest.fixture
def short(monkeypatch):
    """Invented start-up times and no picture: those measurements take seconds, and are tested."""
    start = [Figure(key="help_s", text="help", unit="s", rounds=(2.0,), limit=1.5)]
    monkeypatch.setattr(speed_processes, "measure_start", lambda *a: start)
    monkeypatch.setattr(speed_processes, "measure_rollouts", lambda *a, **k: [])
    monkeypatch.setattr(speed_together, "measure_together", lambda *a, **k: [])

    def no_picture(*arguments):
        raise RenderError("no OpenGL")

    monkeypatch.setattr(speed, "measure_frame", no_picture)


def figure(rounds, pick="least", limit=None):
    return Figure(key="k", text="t", unit="us", rounds=rounds, pick=pick, limit=limit)


def test_a_time_is_the_best_round_and_a_ratio_the_middle_one():
    assert figure((3.0, 1.0, 2.0)).value == 1.0
    assert figure((3.0, 1.0, 2.0), "most").value == 3.0
    assert figure((9.0, 1.0, 2.0), "middle").value == 2.0


def test_a_bar_is_from_above_for_times_and_from_below_for_speeds():
    assert figure((3.0, 1.0)).ok is None
    assert figure((3.0, 1.0), limit=1.0).ok is True
    assert figure((3.0, 1.0), limit=0.9).ok is False
    assert figure((3.0, 1.0), "most", limit=3.0).ok is True
    assert figure((3.0, 1.0), "most", limit=3.1).ok is False


def test_the_script_writes_what_it_prints(run, short, tmp_path):
    code, out, err = run("--quick", "--json", tmp_path / "copy" / "speed.json")
    assert code == 0
    assert err == "Warning: no frame measured: no OpenGL\n"
    folder = tmp_path / "docs" / "results"
    assert out == (folder / "speed.md").read_text() + "Saved docs/results/ " + (
        "(speed.md, speed.csv, speed.json)\n"
    )
    values = json.loads((folder / "speed.json").read_text())
    assert values == json.loads((tmp_path / "copy" / "speed.json").read_text())
    for key in ("plant_step_ratio", "plant_realtime_factor", "control_step_p50_us",
                "control_step_p99_us", "lap_realtime_factor", "adaptation_ratio"):
        assert values[key] > 0.0, key
    # Ours against theirs, in the same process: never below 1, and beyond 3 something is broken,
    # however busy the machine.
    assert 1.0 < values["plant_step_ratio"] < 3.0
    assert values["control_step_p50_us"] <= values["control_step_p99_us"]
    assert values["build_solve_check_p50_us"] < values["control_step_p50_us"]
    assert values["bars"]["help_s"] == {"limit": 1.5, "ok": False}
    rows = list(csv.DictReader((folder / "speed.csv").read_text().splitlines()))
    assert {row["key"]: float(row["value"]) for row in rows} == pytest.approx(
        {key: values[key] for key in values if key not in ("bars", "record")}, rel=1e-5
    )
    head, _, tables = out.partition("**Plant, one core**")
    assert "Machine: " in head and "mujoco 4" in head and "Definitions: " in head
    assert "| help " in tables and "MISSED" in tables
    assert tables.partition("Bars not met: ")[2].partition("\n")[0].endswith("help (Start-up).")


def test_the_callbacks_are_back_after_the_bare_steps():
    speed.measure_plant(rounds=1, blocks=1, periods=1)
    plant = Plant()
    assert plant.wheels.Fz.sum() > 1e4
    callbacks.install()  # refuses when someone else's are there


def test_start_up_is_measured_on_the_real_command(monkeypatch):
    times = speed_processes.measure_start(rounds=1)
    named = {f.key: f.value for f in times}
    # Ten times the bars: this machine may be busy, but nothing may hang or compile.
    assert 0.02 < named["help_s"] < 15.0
    assert 0.02 < named["first_step_s"] < 40.0
    assert 0.02 < named["first_step_cpu_s"]


def test_the_calibration_runs_two_processes(monkeypatch):
    named = {f.key: f.value for f in speed_processes.measure_rollouts(1, 2, 1)}
    assert named["rollout_1_realtime_factor"] > 1.0
    # Between far less than one core (others are busy) and somewhat more than two (noise).
    assert 0.02 < named["two_process_scaling"] < 4.0


@pytest.mark.slow
def test_many_closed_loops_are_driven_both_ways():
    figures = speed_together.measure_together(180.0, rounds=1, cars=(1, 2), laps=2)
    named = {f.key: f.value for f in figures}
    assert named["laps_2_threads"] == pytest.approx(2.0 * named["laps_2_threads_per_core"])
    ratio = named["laps_2_threads"] / named["laps_2_processes"]
    assert named["side_by_side_ratio"] == pytest.approx(ratio)
    # Physics is a part of a lap, so one more thread for it alone gains less than a core; how long a
    # lap takes on a busy machine is no matter of this test, its CPU time is not 10 s.
    assert 0.1 < named["physics_share"] < 0.9
    assert named["side_by_side_bound"] == pytest.approx(1.0 / (1.0 - named["physics_share"] / 2))
    assert named["side_by_side_bound"] < named["overlap_bound"] <= 2.0
    assert named["laps_1_cars_per_cpu_min"] > 6.0 and named["laps_2_cars_per_cpu_min"] > 6.0


def test_a_search_is_timed_where_it_is_asked_for(run, short, monkeypatch):
    monkeypatch.setattr(speed_together, "measure_together", lambda *a, **k: [])
    asked = []

    def searched(jobs, *size):
        asked.append((jobs, *size))
        return [Figure(key="search_s", text="a search", unit="s", rounds=(400.0,), limit=360.0)]

    monkeypatch.setattr(search_time, "measure_search", searched)
    monkeypatch.setattr(speed_command, "measure", lambda *a: [])
    code, out, _ = run("--quick", "--search")
    assert code == 0 and asked == [(cores(), 1, 4)]
    assert "Bars not met: a search (Search of weights)." in out
    assert "Made by `python eval/speed.py --search`" in out


@pytest.mark.skipif(not Path("/proc/stat").exists(), reason="only Linux tells others' work")
def test_others_work_is_counted_without_our_own():
    load = speed_processes.Load()
    assert load.all is not None
    before = load._own()
    while load._own() - before < 0.2:
        pass
    text = load.describe()
    assert text.startswith(f"load average {os.getloadavg()[0]:.1f}")
    cores = float(text.split(", ")[1].split()[0])
    assert 0.0 <= cores <= os.cpu_count()


@pytest.mark.parametrize("rounds", [0, 101, -1])
def test_a_number_of_rounds_that_measures_nothing_is_refused(run, rounds):
    code, out, err = run("--rounds", rounds)
    assert (code, out) == (2, "")
    assert err == f"Error: --rounds is {rounds}, but must be from 1 to 100.\n"


def test_a_folder_that_cannot_be_written_is_one_sentence(run, tmp_path):
    (tmp_path / "file").write_text("")
    code, _, err = run("--quick", "--out", tmp_path / "file" / "below")
    assert code == 2
    assert err.startswith("Error: Cannot write into") and err.count("\n") == 1
