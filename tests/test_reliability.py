import json

import numpy as np
import pytest

from lpvmpc.commands.reliability import PARTS, Options, main
from lpvmpc.kit import cli
from lpvmpc.reliability import damage, loops, report
from lpvmpc.reliability.causes import causes
from lpvmpc.reliability.damage import Subject
from lpvmpc.sim.world import children, load_world


@pytest.mark.parametrize("subject", damage.subjects(), ids=lambda s: s.name)
def test_no_damaged_file_is_taken_for_a_whole_one(subject):
    found = damage.fuzz(subject, 150)
    assert sum(found.outcomes.values()) == 150 and found.examples == ()
    assert found.outcomes["refused"] > 100, found.outcomes


def test_a_reader_that_checks_nothing_would_be_found():
    careless = Subject(
        name="x", write=lambda file: file.write_text("1.5 2.5 3.5 4.5"),
        read=lambda file: [float(word) for word in file.read_bytes().decode("latin-1").split()],
    )
    found = damage.fuzz(careless, 150)
    assert found.outcomes["silent"] > 10 and found.outcomes["raised"] > 10
    assert len(found.examples) == found.outcomes["silent"] + found.outcomes["raised"]


def test_damage_never_leaves_the_same_bytes():
    raw = bytes(60) + b"abc"
    for i in range(300):
        assert damage.damaged(raw, np.random.default_rng(i)) != raw


def test_a_random_run_is_the_same_for_its_number():
    runs = [loops.random_run(i) for i in range(25)]
    assert runs[7] == loops.random_run(7) and len({run.world for run in runs}) == 5
    for run in runs:
        grip = run.scenario_options["grip"] / loops.held(run.world, run.seed)
        assert 0.399 < grip < 0.801 and 0.0 <= run.latency <= 0.04
        assert abs(run.start_offset[0]) <= 1.0 and run.scenario == f"random-{run.seed}"
    assert loops.random_run(loops.WHOLE).scenario == f"hairpin-{loops.WHOLE}"


def test_the_plan_knows_the_friction_that_the_world_draws():
    assert loops.held("ideal", 3) == 1.0
    shares = [loops.held("fleet", seed) for seed in range(40)]
    assert 0.7 < min(shares) < 0.85 and max(shares) <= 1.0


def result(**more):
    whole = {
        "completed": True, "reason": "", "s_end_m": 100.0, "step_time_us": {"max": 900.0},
        "lateral_rmse_m": 0.01, "wall_s": 1.0, "qp": {"solved": 9, "fallback": 1},
        "left_road_s": 0.0, "lateral_acc_max_mps2": 4.0, "duration_s": 12.0,
    }
    return whole | more


def test_every_kind_of_failure_is_counted_and_named():
    runs = [loops.random_run(i) for i in range(5)]
    lost = {"completed": False, "reason": "spun: |epsi| > pi/2"}
    raised = dict.fromkeys(result(), None) | {"completed": False, "reason": "ValueError"}
    driven = loops.summed(runs, [
        result(), result(lateral_rmse_m=float("nan")), result(step_time_us={"max": 34_000.0}),
        result(**lost), raised,
    ])
    assert (driven.completed, driven.exceptions, driven.not_finite, driven.late) == (3, 1, 1, 1)
    section = report.loops_section(driven)
    assert [f.ok for f in section.findings] == [False, False, False]
    assert len(section.faults) == 2 and "spun" in section.faults[0]
    assert "raised: ValueError" in section.faults[1] and "random-4" in section.faults[1]
    assert "Not tried" not in report.report([section], quick=True, jobs=1)
    text = report.report([section], quick=True, jobs=1, left_out=["kills", "qps"])
    assert "Not tried in this report: kills, qps." in text
    assert "0 of 3 are met" in text and "random-3 in fleet" in text
    assert "2 of 5 random runs did not complete (1 spun, 1 raised)" in text
    assert "all together for 0.0 h" in text and driven.seconds == (12.0, 48.0)


def test_a_lost_run_is_driven_again_with_one_hardship_less():
    lost = [loops.random_run(i) for i in (3, 0)]  # in fleet and ideal
    asked = []

    def drive(runs):
        asked.extend(runs)
        return [{"completed": run.latency == 0.0 or "exact" in str(run.world)} for run in runs]

    assert causes(lost, drive) == [
        "completes without the latency, with exact sensors; not started on the line, with the "
        "nominal car on a level road, with a tenth less grip asked for",
        "completes without the latency; not started on the line, with a tenth less grip asked for",
    ]
    assert len(asked) == 8 and {run.seed for run in asked} == {3, 0}
    for run in asked:  # nothing but the one is different, the world's other draws included
        before = lost[0] if run.seed == 3 else lost[1]
        assert run != before and run.scenario == before.scenario
        draws = [load_world(one.world).sample(next(children(3))) for one in (before, run)]
        assert draws[0].surface.friction == draws[1].surface.friction
        if "nominal" not in str(run.world):
            assert draws[0].deviations == draws[1].deviations
    assert causes(lost, lambda runs: [{"completed": False}] * len(runs)) == [
        "one hardship less does not help"] * 2
    assert causes([], lambda runs: []) == []


def test_the_command_writes_its_report(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["--quick", "--parts", "files", "--out", "out", "--json", "all.json"]
    assert cli.run(Options, main, words) == 0
    assert "All 2 promises that were measured are met" in capsys.readouterr().out
    text = (tmp_path / "out" / "reliability.md").read_text()
    assert "## Damaged files" in text and "checkpoint of a tuning" in text
    values = json.loads((tmp_path / "all.json").read_text())
    assert values == json.loads((tmp_path / "out" / "reliability.json").read_text())
    assert values["sections"][0]["rows"][0]["damaged"] == 150
    assert (tmp_path / "out" / "reliability.csv").read_text().count("\n") > 7


def test_what_the_solver_got_wrong_is_a_missed_promise():
    kind = dict.fromkeys(("solvable", "refused", "wrong", "answered", "slow", "second"), 0)
    kind |= {"count": 9, "solvable": 9, "worst_ms": 0.1}
    times = {"seed": 0, "p50_us": 20.0, "p99_us": 90.0, "kinds": {"convex": kind}}
    assert all(f.ok for f in report.qps_section({**kind, **times}).findings)
    bad = {**kind, **times, "refused": 1, "wrong": 1, "answered": 1, "slow": 1}
    assert not any(f.ok for f in report.qps_section(bad).findings)


@pytest.mark.slow
def test_a_look_at_everything(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert cli.run(Options, main, ["--quick", "--runs", "10", "--out", "out"]) == 0
    values = json.loads((tmp_path / "out" / "reliability.json").read_text())
    assert [s["key"] for s in values["sections"]] == list(PARTS)
    assert all(f["ok"] for s in values["sections"] for f in s["findings"])


# Controllers that do wrong ------------------------------------------------------------------------


def test_what_a_controller_does_wrong_in_this_process_is_told():
    from lpvmpc.reliability import misbehaving

    found = misbehaving.controllers(3, here=36, isolated=0)
    assert found.faults == [] and sum(found.told.values()) == 36
    table = report.controllers_section(found)
    assert len(table.rows) == 26 and table.findings[0].ok


@pytest.mark.slow
def test_what_a_controller_does_wrong_in_its_own_process_is_told():
    from lpvmpc.reliability import misbehaving

    found = misbehaving.controllers(4, here=0, isolated=52)
    assert found.faults == [] and sum(found.told.values()) == 52
    assert misbehaving.left_behind() == []


def test_a_controller_that_gets_away_is_a_fault(monkeypatch):
    from lpvmpc.reliability import misbehaving

    monkeypatch.setattr(misbehaving, "RAISES", {"behaves": lambda: None})
    monkeypatch.setattr(misbehaving, "ANSWERS", {"steers": (0.1, 0.0)})
    monkeypatch.setattr(misbehaving, "TOLD", {})
    found = misbehaving.controllers(0, here=2, isolated=0)
    assert len(found.faults) == 2 and not report.controllers_section(found).findings[0].ok
    assert all("it completed" in fault or "no sentence" in fault for fault in found.faults)


def test_a_section_that_was_kept_at_this_commit_is_not_tried_again(tmp_path, monkeypatch):
    from lpvmpc.commands import reliability

    tried = []
    section = report.inputs_section([])

    def once(part, *_):
        tried.append(part)
        return section

    monkeypatch.setattr(reliability, "tried", once)
    options = Options(resume=True, cache=tmp_path)
    for at, count in (("abc", 1), ("abc", 1), ("abd", 2), ("abd-dirty", 3), (None, 4)):
        monkeypatch.setattr(reliability, "commit", lambda at=at: at)
        assert reliability.kept("inputs", options, 5, 1) == section
        assert len(tried) == count
    (tmp_path / "inputs.section.json").write_text("{")
    monkeypatch.setattr(reliability, "commit", lambda: "abc")
    assert reliability.kept("inputs", options, 5, 1) == section and len(tried) == 5
