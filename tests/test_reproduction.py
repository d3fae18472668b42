import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fake_log import fake_log

from lpvmpc.car import bicycle
from lpvmpc.errors import ControllerError, DataError
from lpvmpc.kit.findings import promises_sentence
from lpvmpc.learn import driven
from lpvmpc.paper import (
    figures,
    findings,
    measurements,
    printed_formulas,
    printed_numbers,
    records,
    report,
    retrain,
    runs,
    sentences,
)
from lpvmpc.paper import steering_at_rest as resting
from lpvmpc.paper.runs import LMPC, OURS, PAPERS, PLAIN
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.sim import batch
from lpvmpc.sim.metrics import KEYS
from lpvmpc.tune import genetic, sphere, tuning

WEIGHTS = {
    OURS: {"q_ey": 80.0, "terminal": 1.0}, PLAIN: {"q_ey": 80.0, "terminal": 0.0},
    LMPC: {"q_ey": 80.0}, "lmpc-pso-pid": {"q_ey": 80.0}, "stanley": {"k": 1.0},
    "pure-pursuit": {"k": 1.0},
}


def result(rmse=0.001, speed=0.01, lost=False):
    """Metrics of a run, as a batch gives them."""
    values = {
        "completed": not lost, "reason": "off the path: |ey| > 5 m" if lost else "",
        "s_end_m": 123.4, "duration_s": 10.0, "reference_duration_s": 10.0,
        "lateral_rmse_m": rmse, "lateral_max_m": 4.0 * rmse, "heading_rmse_rad": 0.02,
        "heading_max_rad": 0.05, "course_rmse_rad": 0.001, "speed_rmse_mps": speed,
        "speed_max_mps": 4.0 * speed, "step_time_us": {"p50": 200.0, "p99": 300.0},
        "qp": {"solved": 300, "fallback": 0},
    }
    return {**dict.fromkeys(KEYS), **values}


def errors(entry, case):
    """Invented errors: the baseline's ten times ours, printed ones lost, parts worth something."""
    if entry.group == "printed" and entry.controller != PLAIN:
        return result(lost=True)
    if entry.group == "alone" and entry.key in ("signs", "drag"):
        return result(lost=True)
    if entry.group == "alone" and entry.key == "curvature":
        return result(0.010)
    if entry.group == "alone" and entry.key == "error":
        return result(0.030)
    if entry.key == "- observer":
        return result(0.004)
    if entry.controller == LMPC:
        return result(0.010, 0.05)
    if entry.controller == PLAIN and "formulation" not in entry.options:
        return result(0.010, 0.01)
    return result()


@pytest.fixture(scope="module")
def study():
    return sphere.run(seeds=3, settings=genetic.GeneticSettings(generations=12, population=10))


@pytest.fixture
def make(study):
    """Makes evidence of invented results, in which some things may differ."""

    def fake(of=errors, *, tuned=True, quick=False, **changes):
        equipment = runs.Equipment(by_hand=WEIGHTS, tuned=WEIGHTS if tuned else {})
        entries = runs.entries(equipment)
        cases = [case for case in runs.CASES if not quick or case.key in runs.QUICK]
        rows = [
            measurements.DrivenEntry(entry=entry, case=case, result=of(entry, case))
            for entry in (runs.quick(entries) if quick else entries)
            for case in runs.cases_of(entry, cases)
        ]
        rests = [
            resting.GustAnswer(vx=vx, turning=False, completed=True, answered=0.01, left=1e-6)
            for vx in resting.SPEEDS
        ]
        t = np.linspace(0.0, 10.0, 50)
        true = 1e5 * (1.0 + 0.1 * np.column_stack([np.sin(t), np.cos(t)]))
        said = {"network-secant": 0.95 * true, "network": 1.01 * true}
        curve = ((100, 0.5, 0.6), (2500, 0.02, 0.04))
        training = records.Training(
            kind="network-secant", curve=curve, samples=10752,
            r2={("random", "train"): (0.98, 0.97), ("random", "test"): (0.97, 0.96),
                ("runs", "train"): (0.98, 0.98), ("runs", "test"): (0.95, 0.96)},
        )
        told = {
            "quick": quick, "jobs": 1, "equipment": equipment, "rows": rows, "driven": len(rows),
            "kept": 7,
            "rests": rests, "logs": {OURS: fake_log(), LMPC: fake_log()},
            "stiffness": measurements.Stiffness(title="circuit 87 %", t=t, alpha=0.01 * true / 1e5,
                                            true=true, said=said),
            "sphere": study, "tunings": {}, "tuned_on": ("tuning-a", "tuning-b"),
            "trainings": {"network-secant": training}, "seconds": 60.0,
        }
        return measurements.Evidence(**{**told, **changes})

    return fake


# The printed formulas -----------------------------------------------------------------------------


def matrices(slips):
    """A and B at some state of a turning car, with some slips."""
    car = bicycle.Bicycle.of(packaged_car()).simplified(
        lags=False, relaxation=False, roll=False, trail=False
    )
    x = np.array([12.0, 0.3, 0.2, 0.1, 0.05, 0.04, 0.0, 0.0, 0.0, 0.0, 0.0])
    A, B, c = np.empty((11, 11)), np.empty((11, 2)), np.empty(11)
    tires = np.array([9e4, 0.0, 1.1e5, 0.0])
    chosen = np.array([name in slips for name in printed_formulas.SLIPS])
    printed_formulas.matrices(x, 0.02, tires, car, chosen, A, B, c)
    return x, car, A, B


@pytest.mark.parametrize("slip", ["signs", "bracket", "drag", "curvature", "error"])
def test_a_printed_slip_changes_the_entries_that_it_names_and_no_others(slip):
    x, car, A, B = matrices(set())
    _, _, A_slip, B_slip = matrices({slip})
    vx, _, _, ey, epsi, delta = x[:6]
    wanted_A, wanted_B = A.copy(), B.copy()
    if slip == "signs":
        wanted_B[1:3, 0] *= -1.0
    elif slip == "bracket":
        wanted_A[2, 1] = -(car.lf * 9e4 * np.cos(delta) + car.lr * 1.1e5) / (car.Iz * vx)
    elif slip == "drag":
        wanted_A[0, 0] = -0.82 * 9.81 / vx - car.k_drag * vx / car.m
    elif slip == "curvature":
        wanted_A[4, 1] = 0.02 * np.cos(epsi) / (1.0 - ey * 0.02)
    else:
        wanted_A[3, 0], wanted_A[3, 4] = np.sin(epsi), 0.0
    assert not np.array_equal(A, wanted_A) or not np.array_equal(B, wanted_B)
    np.testing.assert_allclose(A_slip, wanted_A, rtol=1e-12)  # the same formula, in another order
    np.testing.assert_allclose(B_slip, wanted_B, rtol=1e-12)


def test_without_slips_the_printed_controller_is_the_plain_one_and_signs_lose_the_car():
    case = next(case for case in runs.CASES if case.key == "double-lane-change")
    plain = batch.drive(runs.run_of(case, PLAIN, {"weights": printed_weights()}))
    none = batch.drive(runs.run_of(case, printed_formulas.controller(set()), {}))
    for name in ("ey_m", "delta_cmd_rad", "ax_cmd_mps2"):
        np.testing.assert_array_equal(none.columns[name], plain.columns[name])
    lost = batch.drive(runs.run_of(case, printed_formulas.controller({"signs"}), {}))
    assert not lost.meta["completed"]


def printed_weights():
    from lpvmpc.control.cost import PAPER_WEIGHTS
    from lpvmpc.control.weights_file import as_dict

    return as_dict(PAPER_WEIGHTS)


def test_an_unknown_slip_is_no_controller():
    from lpvmpc import load_controller

    name = "lpvmpc.paper.printed_formulas:Printed_gravity"
    with pytest.raises(ControllerError, match="does not exist"):
        load_controller(name)


# The plan -----------------------------------------------------------------------------------------


def test_each_line_of_the_chains_changes_one_thing():
    equipment = runs.Equipment(by_hand=WEIGHTS, tuned=WEIGHTS)
    entries = [e for e in runs.entries(equipment) if e.group == "printed"]
    left = [set(e.controller.partition(":")[2].split("_")[1:]) for e in entries[:-1]] + [set()]
    assert left[0] == set(printed_formulas.SLIPS) and entries[-1].controller == PLAIN
    assert all(len(a - b) == 1 and not b - a for a, b in zip(left, left[1:], strict=False))
    chain = [e for e in runs.entries(equipment) if e.group == "corrected"]
    for before, after in zip(chain, chain[1:], strict=False):
        a, b = dict(before.options), dict(after.options)
        old, new = a.pop("formulation", {}), b.pop("formulation", {})
        if before.controller != after.controller:  # all parts are there: the weights change
            from lpvmpc.control.formulation import PAPER, Formulation

            assert after.key == "+ weights"
            assert replace(PAPER, **old) == Formulation()
            assert b["stiffness"] == "constant" and b["weights"]["terminal"] == 0.0
            continue
        changed = [k for k in {*old, *new} if old.get(k) != new.get(k)]
        changed += [k for k in {*a, *b} if a.get(k) != b.get(k)]
        assert len(changed) == 1, (after.key, changed)


def test_the_last_line_of_the_chain_is_the_controller_of_the_first_table():
    entries = runs.entries(runs.Equipment(by_hand=WEIGHTS, tuned=WEIGHTS))
    last = [e for e in entries if e.group == "corrected"][-1]
    ours = next(e for e in entries if (e.group, e.key) == ("tuned", OURS))
    assert (last.controller, last.options) == (ours.controller, ours.options)


def test_no_road_of_the_report_tunes_weights():
    assert not {case.scenario for case in runs.CASES} & set(tuning.TRACKS)


def test_a_network_trained_anew_drives_and_its_content_decides_the_key(tmp_path):
    file = tmp_path / "network.safetensors"
    equipment = runs.Equipment(by_hand=WEIGHTS, networks={"network": str(file)})
    run = runs.run_of(runs.CASES[0], OURS, equipment.options(OURS))
    assert run.controller_options["stiffness_file"] == str(file)
    file.write_bytes(b"one")
    key = run.key()
    file.write_bytes(b"two")
    assert run.key() != key
    assert "stiffness_file" not in equipment.options(OURS, stiffness="constant")


# What follows -------------------------------------------------------------------------------------


def test_promises_are_met_or_missed_and_a_lost_car_is_charged(make):
    good = {bar.key: bar for bar in findings.bars(make(lambda *_: result(0.0004, 0.009)))}
    assert all(bar.ok for key, bar in good.items() if key != "sphere_mixed")
    assert good["paper_lateral_rmse_mm"].value == pytest.approx(0.4)

    def bad(entry, case):
        return result(0.0015, 0.011, lost=case.key == "paper-loop")

    missed = {bar.key: bar for bar in findings.bars(make(bad, tuned_on=("circuit", "tuning-b")))}
    assert missed["paper_lateral_rmse_mm"].ok is False
    assert missed["paper_speed_rmse_mps"].ok is False
    assert missed["paper-loop_lateral_rmse_mm"].value == 5000.0
    assert missed["circuit-0.87_lateral_rmse_mm"].ok is True  # 1.5 of 1.8 mm
    assert missed["tuned_on_reported"].ok is False


def test_a_quick_look_has_no_verdict_on_what_it_did_not_drive(make):
    e = make(quick=True)
    found = {bar.key: bar for bar in findings.bars(e)}
    assert found["circuit-0.87_lateral_rmse_mm"].ok is None
    assert found["paper_lateral_rmse_mm"].ok is False  # 1 mm of 0.5
    assert "were not measured" in promises_sentence(list(found.values()))
    text = report.report(e, {})
    assert text.startswith("# The paper's results beside ours (quick look")
    assert "## From the printed formulas" in text and "without one part" not in text


def test_ratios_to_the_baseline_are_told_with_the_influence_of_weights(make):
    def of(entry, case):
        if entry.controller == LMPC:
            return result(0.01 if entry.group == "tuned" else 0.03, 0.05)
        return errors(entry, case)

    e = make(of)
    assert printed_numbers.ratio(e, "lateral_rmse_m") == pytest.approx(10.0)
    assert printed_numbers.ratio(e, "lateral_rmse_m", lmpc="by hand") == pytest.approx(30.0)
    sentence = next(s for s in sentences.sentences(e) if s.startswith("The baseline's RMSE"))
    assert "10 (10 to 30 over the weights; paper 6.3) for the lateral" in sentence
    assert "5.0 (5.0 to 5.0 over the weights; paper 1.4) for the speed" in sentence
    assert f"| {PAPERS}" in report.influence_table(e)


@pytest.mark.parametrize(
    ("hand", "verdict"), [(0.010, "not confirmed"), (0.02, "confirmed with some weights only")]
)
def test_the_papers_claim_is_judged_whichever_way_it_falls(make, hand, verdict):
    def of(entry, case):
        if entry.controller == LMPC and entry.group == "by hand":
            return result(hand, 0.05)
        return errors(entry, case)

    sentence = next(s for s in sentences.sentences(make(of)) if s.startswith("The paper puts"))
    assert f"(tuned and by hand), paper 6.3, {verdict}; speed 5.00 and 5.00" in sentence
    assert sentence.endswith("(tuned and by hand), paper 1.4, confirmed.")


def test_what_the_printed_slips_do_is_told(make):
    text = next(s for s in sentences.sentences(make()) if s.startswith("As printed"))
    assert "lose the car on all roads" in text
    assert "alone it is lost somewhere with signs and drag" in text
    assert "grows with error (3.0 times)" in text
    assert "less than 10 % with dt, bracket, bounds, terminal and curvature" in text


def test_the_parts_are_told_by_what_they_bring(make):
    told = sentences.sentences(make())
    chain = next(s for s in told if s.startswith("From the plain"))
    assert "falls by a factor of 10 " in chain and "exact hold instead of Euler (10.0)" in chain
    alone = next(s for s in told if s.startswith("Each part taken alone"))
    assert "RMSE: observer (4.0)" in alone and "hardly at all hold, span" in alone


def test_a_lost_baseline_leaves_no_ratio(make):
    def of(entry, case):
        return result(lost=entry.controller == LMPC)

    e = make(of)
    assert printed_numbers.ratio(e, "speed_rmse_mps") is None
    assert not any(s.startswith("The baseline's RMSE") for s in sentences.sentences(e))
    number = next(n for n in printed_numbers.numbers(e) if n.key == "lmpc_lateral_rmse_m")
    assert (number.paper, number.ours) == (0.1367, None)


def test_what_the_paper_prints_and_cannot_be_is_remarked(make):
    numbers = {n.key: n for n in printed_numbers.numbers(make())}
    assert "impossible" in numbers["speed_max_mps"].remark
    assert "88 Hz" in numbers["rate_hz"].remark
    assert numbers["r2_test"].ours == pytest.approx(0.965)
    assert numbers["loss_train"].ours == 0.02
    assert numbers["heading_max_rad"].ours == pytest.approx(np.rad2deg(0.05))


# The report ---------------------------------------------------------------------------------------


def test_the_report_holds_every_table_and_says_where_a_car_was_lost(make):
    text = report.report(make(), {"fig8-path": "paper/fig8-path.png"})
    for title in (*printed_numbers.TABLES.values(), *runs.GROUPS.values()):
        assert f"**{title}" in text, title
    assert "off at 123 m" in text
    assert report.cell(SimpleNamespace(completed=False, result={
        "reason": "spun: |epsi| > pi/2", "s_end_m": 12.3})) == "spun at 12 m"
    assert "![Fig. 8](paper/fig8-path.png)" in text
    assert "for `lpv-mpc`" in text and "tuned in ideal, rtk, fleet for `lmpc-pso-pid`" in text
    assert "No record of a tuning is here." in text
    by_hand = report.report(make(tuned=False), {})
    assert "set by hand, not tuned; they drive" in by_hand


def test_csv_and_json_hold_every_run(make):
    e = make()
    lines = report.as_csv(e).splitlines()
    assert len(lines) == 1 + len(e.rows)
    values = json.loads(json.dumps(report.as_json(e), allow_nan=False))
    assert len(values["runs"]) == len(e.rows)
    assert values["bars"]["paper_speed_rmse_mps"] == {
        "text": "paper: speed RMSE", "value": 0.01, "limit": 0.01, "unit": "m/s", "ok": True
    }
    assert values["numbers"]["lmpc_lateral_rmse_m"]["paper"] == 0.1367


def test_every_figure_is_drawn_and_those_without_evidence_are_taken_away(
    make, tmp_path, monkeypatch
):
    monkeypatch.setattr(figures, "DPI", 40)
    e = make(tunings={OURS: a_tuning(OURS)})
    files = figures.save_all(e, tmp_path)
    assert set(files) == set(figures.FIGURES)
    assert all(file.read_bytes().startswith(b"\x89PNG") for file in files.values())
    short = {k: v for k, v in figures.FIGURES.items() if k in ("fig4-learning-curve", "tuning")}
    monkeypatch.setattr(figures, "FIGURES", short)
    assert figures.save_all(make(trainings={}), tmp_path) == {}
    assert not (tmp_path / "tuning.png").exists()


# Records ------------------------------------------------------------------------------------------


def a_tuning(name):
    task = {"controller": name, "scenarios": ["tuning-a"], "generations": 2, "population": 4}
    return records.Tuning(
        controller=name, task=task, evaluations=12, budget=12, cost=0.1, weights={"q_ey": 1.0},
        before=(result(0.002),), after=(result(0.001),),
        history=(("genetic", 4, 0.3), ("genetic", 8, 0.2), ("genetic", 12, 0.1)),
    )


@pytest.fixture
def road(tmp_path):
    """A straight road of 40 m, driven at 10 m/s."""
    rows = "".join(f"{x},0,3,3,10\n" for x in range(0, 42, 2))
    file = tmp_path / "road.csv"
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n" + rows)
    return str(file)


def test_a_tuning_anew_is_kept_and_read_back(tmp_path, road, monkeypatch):
    task = tuning.Task(controller="pure-pursuit", scenarios=(road,), generations=2, population=4)
    told = []
    folder = retrain.tune(task, tmp_path / "tuning", 1, lambda *what: told.append(what))
    assert told[-1][0] == "tuning pure-pursuit" and told[-1][2] == task.budget
    one = records.read_tuning(folder)
    assert one.controller == "pure-pursuit" and one.evaluations <= one.budget
    counts = [count for _, count, _ in one.history]
    assert counts == sorted(counts) and counts[-1] == one.evaluations
    assert {search for search, _, _ in one.history} == {"pso", "genetic"}

    def never(*arguments, **options):
        raise AssertionError("it was done")

    monkeypatch.setattr(tuning, "tune", never)
    assert retrain.tune(task, tmp_path / "tuning", 1, lambda *what: None) == folder
    (folder / "tuning.json").write_text("{}")
    with pytest.raises(DataError, match="are damaged: KeyError"):
        records.read_tuning(folder)
    assert records.read_tuning(tmp_path / "nowhere") is None


def test_a_training_is_read_from_its_files(tmp_path):
    assert records.read_training("network", tmp_path) is None
    (tmp_path / "learning-curve.csv").write_text("epoch,train,test\n1,0.5,0.6\n2,0.4,0.5\n")
    (tmp_path / "r2.csv").write_text(
        "seed,split,set,samples,C_f,C_r\n0,runs,train,75,0.9,0.8\n0,runs,test,25,0.7,0.6\n"
        "0,runs,also,100,0.1,0.1\n1,runs,test,25,0.0,0.0\n"
    )
    one = records.read_training("network", tmp_path)
    assert one.samples == 100 and one.curve[-1] == (2, 0.4, 0.5)
    assert one.median("runs", "test") == pytest.approx(0.325)  # of 0.65 and 0
    assert one.spread("runs", "test") == "median of 2 seeds, 0.000 to 0.650"
    assert one.median("random", "test") is None and one.spread("random", "test") == ""
    (tmp_path / "r2.csv").write_text("seed,split\n0,runs\n")
    with pytest.raises(DataError, match="damaged"):
        records.read_training("network", tmp_path)


@pytest.mark.slow  # 12 s of driving and training; what it uses is tested beside it
def test_a_training_anew_is_kept_and_drives(tmp_path):
    from lpvmpc import load_controller

    told = []
    options = {"samples": 2560, "epochs": 2}  # two runs of each kind of manoeuvre at the least
    files = retrain.train(tmp_path, 1, lambda *what: told.append(what[0]), **options)
    assert {"collecting stiffness", "training network", "training network-secant"} <= set(told)
    made = {kind: file.read_bytes() for kind, file in files.items()}
    told.clear()
    assert retrain.train(tmp_path, 1, lambda *what: told.append(what[0]), **options) == files
    assert not told and made == {kind: file.read_bytes() for kind, file in files.items()}
    for kind, file in files.items():
        assert records.read_training(kind, file.with_suffix("")).samples == 2560
    car = load_controller(OURS, **measurements.equip(None, files).options(OURS))
    assert car.stiffness.name == "network"


def test_what_is_published_is_found_beside_the_package(root):
    assert records.published() == root / "docs" / "results"
    for kind in ("network", "network-secant"):
        assert records.read_training(kind, records.published() / kind).samples == 10752


def test_without_the_source_tree_the_report_says_what_is_left_out(monkeypatch):
    monkeypatch.setattr(records, "published", lambda: None)
    missing = []
    assert measurements._records(None, None, missing) == ({}, {})
    assert len(missing) == 1 and "installed without its source tree" in missing[0]


# Measuring ----------------------------------------------------------------------------------------


def test_the_labels_of_a_log_are_force_over_slip_angle():
    log = fake_log(2.0)
    alpha, C = driven.labels(log)
    c = log.columns
    rear = c["Fy_rl_N"] + c["Fy_rr_N"]
    large = np.abs(alpha[:, 1]) > 0.012  # where the label is the secant alone
    assert large.any()
    np.testing.assert_allclose(C[large, 1], (rear / alpha[:, 1])[large], rtol=1e-9)
    small = np.abs(alpha[:, 1]) < 0.004  # and the tires' slope where it is that
    if small.any():
        assert np.all((C[small, 1] > 5e4) & (C[small, 1] < 3e5))  # N/rad, as any car's axle


def test_a_steering_that_does_not_come_to_rest_is_seen():
    t = np.arange(0.0, 10.0, 0.033)

    def log(left, completed=True):
        delta = np.where(t < 2.0, 0.02 * np.sin(3.0 * t), left * np.sin(9.0 * t))
        return SimpleNamespace(columns={"t_s": t, "delta_cmd_rad": delta},
                               meta={"completed": completed})

    assert resting.of(log(1e-6), 10.0, False).ok
    assert not resting.of(log(1e-5), 10.0, False).ok
    assert not resting.of(log(1e-6, completed=False), 10.0, False).ok
    quiet = resting.of(SimpleNamespace(columns={"t_s": t, "delta_cmd_rad": 0.0 * t},
                                       meta={"completed": True}), 10.0, True)
    assert not quiet.ok  # nothing was answered: no proof of rest
