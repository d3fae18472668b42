"""The report of the worlds: what is driven, what its numbers are, what its sentences say."""

import csv
import json
import math

import numpy as np
import pytest

from lpvmpc.bench import margins as margin_search
from lpvmpc.bench import worlds, worlds_pictures, worlds_report, worlds_verdict
from lpvmpc.bench.margins import KINDS, Margin, failure, margins
from lpvmpc.bench.worlds import (
    CELLS,
    FIRST_SEED,
    MODELS,
    SHIPPED,
    Cell,
    DrivenCell,
    GridPlan,
    run_of,
)
from lpvmpc.bench.worlds_bars import MARGINS, bars
from lpvmpc.bench.worlds_stats import summary
from lpvmpc.bench.worlds_verdict import Found, sentences
from lpvmpc.control.registry import STIFFNESS_MODELS
from lpvmpc.kit.statistics import percentile, wilson
from lpvmpc.sim.batch import KEPT
from lpvmpc.sim.world import WORLDS

OFF_PATH = "off the path: |ey| > 5 m"


def result(mm, *, lost=None, **more):
    """Made-up result of a run with this RMSE [mm]; the largest error is five times as large."""
    return {
        **dict.fromkeys(KEPT),
        "completed": lost is None, "reason": lost or "", "s_end_m": 100.0,
        "lateral_rmse_m": 1e-3 * mm, "lateral_max_m": 5e-3 * mm,
        "steer_rate_rms_radps": 0.1, "jerk_rms_mps3": 2.0, "estimate_ey_rmse_m": 0.5e-3 * mm,
        **more,
    }


def row(mm, **cell):
    lost = cell.pop("lost", None)
    cell = {"part": "worlds", "case": "rtk", "road": "paper", "controller": "lpv-mpc", **cell}
    return DrivenCell(cell=Cell(**cell), result=result(mm, lost=lost))


def made_up(part, mm, plan=None):
    """Rows of a part, `mm` giving the RMSE of a cell [mm], infinite for a lost car."""
    rows = []
    for cell in CELLS[part](plan or GridPlan(seeds=3)):
        value = mm(cell)
        lost = OFF_PATH if math.isinf(value) else None
        rows.append(DrivenCell(cell=cell, result=result(700.0 if lost else value, lost=lost)))
    return rows


# What is driven -----------------------------------------------------------------------------------


@pytest.mark.parametrize("part", sorted(CELLS))
def test_every_cell_is_a_run_of_its_own(part):
    cells = CELLS[part](GridPlan(seeds=2))
    runs = [run_of(cell) for cell in cells]
    assert len({run.key() for run in runs}) == len(runs)
    assert min(run.seed for run in runs) == FIRST_SEED > worlds.TUNING_SEEDS


def test_deviations_are_what_their_titles_say():
    by_key = {
        cell.case: run_of(cell)
        for cell in CELLS["deviations"](GridPlan(controllers=("lpv-mpc",), roads=("circuit-87",)))
    }
    assert len(by_key) == len(worlds.DEVIATIONS) >= 21
    assert by_key["Cr-30"].deviations == {"Cr": 0.7} and by_key["Cr-30"].world == "ideal"
    assert by_key["Cr-30"].scenario_options == {"grip": 0.87}
    assert by_key["latency-33"].latency == pytest.approx(0.033)
    assert by_key["latency-33"].controller_options == {}  # untold
    told = by_key["delay-3"]
    assert (told.delay, told.controller_options) == (3, {"delay": 3})
    assert by_key["raw-noise"].estimator == "none"
    assert by_key["nominal"].latency is None and by_key["nominal"].deviations == {}


def test_a_stiffness_model_drives_with_all_its_options(monkeypatch):
    softer = worlds.DrivenModel(
        about="a softer one", options={"stiffness": "constant", "stiffness_scale": 0.9}
    )
    monkeypatch.setitem(worlds.MODELS, "constant-best", softer)
    asked = [run_of(cell) for cell in CELLS["adaptation"](GridPlan(seeds=1))
             if cell.model == "constant-best"]
    assert {run.world for run in asked} == {"ideal", "rtk", "fleet", "fleet-production"}
    assert all(run.controller_options == softer.options for run in asked)


def test_models_drive_the_first_of_the_seeds():
    plan = GridPlan(seeds=100, model_seeds=20)
    cells = [c for c in CELLS["adaptation"](plan) if c.case == "fleet" and c.road == "paper"]
    for model in worlds.MODELS:
        seeds = [cell.seed for cell in cells if cell.model == model]
        assert seeds == list(range(FIRST_SEED, FIRST_SEED + 20))
    assert len(CELLS["worlds"](plan)) > 8000


def test_all_worlds_and_shipped_controllers_are_driven_with_the_same_seeds():
    cells = CELLS["worlds"](GridPlan(seeds=20))
    assert {cell.case for cell in cells} == {*WORLDS, "combined"}
    assert {cell.controller for cell in cells} == set(SHIPPED)
    fleet = [cell for cell in cells if cell.case == "fleet" and cell.road == "circuit-80"]
    assert all(
        [cell.seed for cell in fleet if cell.controller == name]
        == list(range(FIRST_SEED, FIRST_SEED + 20))
        for name in SHIPPED
    )


def test_the_stiffness_models_are_the_package_s():
    assert {model.options["stiffness"] for model in MODELS.values()} <= set(STIFFNESS_MODELS)
    assert {name for pair in worlds_verdict.COMPARED for name in pair[:2]} <= set(MODELS)


# Numbers ------------------------------------------------------------------------------------------


def test_wilson_s_interval_solves_its_equation():
    """Its ends p are where (p_measured - p)^2 = z^2 p (1 - p) / n."""
    for successes, n in ((7, 20), (99, 100), (50, 100)):
        for p in wilson(successes, n):
            assert (successes / n - p) ** 2 == pytest.approx(1.959964**2 * p * (1.0 - p) / n)
    assert wilson(0, 5)[0] == 0.0 and wilson(5, 5)[1] == 1.0
    assert wilson(100, 100)[0] == pytest.approx(100 / (100 + 1.959964**2))


def test_a_percentile_is_one_of_the_values_and_a_lost_run_the_worst():
    values = list(range(1, 101))
    assert percentile(values, 0.95) == 95 and percentile(values, 1.0) == 100
    assert percentile([5.0, 1.0], 0.95) == 5.0
    rows = [row(1.0 + i) for i in range(18)] + [row(2.0, lost=OFF_PATH)] * 2
    found = summary(rows)
    assert (found.n, found.completed) == (20, 18)
    assert math.isinf(found.rmse[1]) and math.isinf(found.largest[2])
    assert found.rmse[0] == pytest.approx(0.011)
    assert found.share == pytest.approx(0.5)  # over completed runs alone


# Margins ------------------------------------------------------------------------------------------


def bearing(limits):
    """Drives runs that hold while the latency [ms] is below the limit of their controller."""

    def drive(runs):
        return [result(10.0 if 1e3 * (run.latency or 0.0) < limits[run.controller] else 100.0)
                for run in runs]

    return drive


def test_a_margin_is_found_to_its_resolution(monkeypatch):
    monkeypatch.setattr(margin_search, "KINDS", KINDS[:1])
    plan = GridPlan(controllers=("stanley", "lpv-mpc", "pure-pursuit"))
    found = margins(plan, bearing({"stanley": 71.5, "lpv-mpc": 1e9, "pure-pursuit": 0.0}))
    middle, endless, nothing = found
    assert middle.held < 71.5 <= middle.failed and middle.failed - middle.held <= 2.0
    assert middle.held == int(middle.held)  # whole physics steps
    assert middle.why == "more than 0.3 m off"
    assert (endless.held, endless.failed) == (200.0, None)
    assert (nothing.held, nothing.failed) == (None, 0.0)
    assert [worlds_verdict.reach(m) for m in (endless, nothing)] == [1.0, -1.0]


def test_a_car_that_holds_again_further_out_has_the_margin_of_the_first_failure(monkeypatch):
    def drive(runs):
        return [result(100.0 if 60.0 <= 1e3 * (run.latency or 0.0) <= 80.0 else 10.0)
                for run in runs]

    monkeypatch.setattr(margin_search, "KINDS", KINDS[:1])
    (found,) = margins(GridPlan(controllers=("stanley",)), drive)
    assert found.held < 60.0 <= found.failed


def test_noise_must_hold_with_every_seed(monkeypatch):
    noise = next(kind for kind in KINDS if kind.key == "noise")

    def drive(runs):
        unlucky = FIRST_SEED + noise.seeds - 1
        return [result(100.0 if run.seed == unlucky and run.world["sensing"]["scale"] > 4.0
                       else 1.0) for run in runs]

    monkeypatch.setattr(margin_search, "KINDS", (noise,))
    (found,) = margins(GridPlan(controllers=("stanley",)), drive)
    assert 3.5 < found.held <= 4.0 < found.failed < 4.6


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.key)
def test_nothing_is_wrong_at_the_beginning_of_a_range_and_much_at_its_end(kind):
    from lpvmpc.sim.batch import Run

    start, end = (kind.run(Run(), kind.at(share)) for share in (0.0, 1.0))
    if kind.key == "noise":
        assert start.world["sensing"] == {"scale": 1.0}
    else:
        assert all(value in (0.0, 1.0) for value in start.deviations.values())
        assert start.road == 1.0 and not start.latency
    assert start.key() != end.key()
    limit = MARGINS[kind.key].bound  # the promise lies inside what is tried
    assert min(kind.none, kind.end) < limit < max(kind.none, kind.end)


def test_why_a_run_does_not_hold():
    assert failure(result(60.0)) == ""
    assert failure(result(60.1)) == "more than 0.3 m off"
    assert failure(result(1.0, lost="spun: |epsi| > pi/2")) == "spun"
    refused = result(1.0, lost="Option deviations is wrong", s_end_m=None)
    assert failure(refused).startswith("refused: ")


# Sentences ----------------------------------------------------------------------------------------


def found_with(mm, **more):
    return Found(plan=GridPlan(seeds=3), rows={"worlds": made_up("worlds", mm)}, **more)


def test_a_rival_with_a_better_95th_percentile_is_named_first():
    def mm(cell):
        if (cell.case, cell.road, cell.controller) == ("fleet", "paper", "stanley"):
            return 4.0
        return {"lpv-mpc": 5.0}.get(cell.controller, 50.0)

    first = sentences(found_with(mm))[0]
    assert first == (
        "A rival has a better 95th percentile of the RMSE than `lpv-mpc`: in `fleet` on paper "
        "(lpv-mpc 5.0 mm) `stanley` 4.0 mm."
    )


def test_where_none_has_that_is_said_first():
    first, second, *_ = sentences(found_with(lambda c: 5.0 if c.controller == "lpv-mpc" else 6.0))
    assert first.startswith("None of those driven here (`lpv-mpc-paper`, ")
    assert "has a better 95th percentile than `lpv-mpc`, neither" in first
    assert second.startswith("`lpv-mpc` completes all")


def test_a_lost_run_makes_a_rival_better_and_is_listed():
    def mm(cell):
        unlucky = cell.case == "rtk" and cell.road == "paper" and cell.seed == FIRST_SEED + 1
        return math.inf if cell.controller == "lpv-mpc" and unlucky else 5.0

    found = found_with(mm)
    told = sentences(found)
    assert "`rtk` on paper 1 of 3" in told[0]
    assert "in `rtk` on paper (lpv-mpc lost)" in told[1] and "`stanley` 5.0 mm" in told[1]
    assert told[3].startswith("A rival completes more runs than `lpv-mpc`: in `rtk` on paper")
    assert "(lpv-mpc 2 of 3)" in told[3] and "`stanley` 3" in told[3]
    text = worlds_report.report(found, jobs=1, pictures=["worlds.png"])
    assert r"| off the path: \|ey\| > 5 m |" in text and str(FIRST_SEED + 1) in text
    assert "2 of 3" in text and "21 to 94 %" in text
    assert "Not driven yet: deviations, margins, adaptation." in text


@pytest.mark.parametrize(
    "secant, said",
    [
        (2.0, "pays: of 12 worlds and roads 12 times it helps, 0 times it hurts; by the 95th "
              "percentile of the RMSE: in `ideal` it helps on paper (2.0 mm against 5.0 mm),"),
        (9.0, "costs: of 12 worlds and roads 0 times it helps, 12 times it hurts;"),
        (5.1, "makes no difference in any of 12 worlds and roads;"),
        (math.inf, "costs: of 12 worlds and roads 0 times it helps, 12 times it hurts;"),
    ],
)
def test_the_paper_s_claim_follows_from_the_numbers(secant, said):
    mm = {"constant": 5.0, "network-secant": secant, "network-dry": 3.0, "network": 3.0}
    rows = made_up("adaptation", lambda cell: mm[cell.model])
    told = sentences(Found(plan=GridPlan(seeds=3), rows={"adaptation": rows}))
    assert len(told) == len(worlds_verdict.COMPARED)
    assert told[0].startswith(
        f"`network-secant` in place of `constant` (the paper's claim) {said}")
    assert "(online learning) makes no difference" in told[-1]


def test_what_neither_bears_helps_nobody_and_what_is_not_resolved_is_alike():
    compared = worlds_verdict.compared
    assert compared(math.inf, math.inf) == worlds_verdict.BOTH_LOST
    assert compared(0.00015, 0.00024) == worlds_verdict.ALIKE  # 0.09 mm
    assert compared(0.0010, 0.0012) == worlds_verdict.HELPS
    assert compared(math.inf, 1.0) == worlds_verdict.HURTS
    rows = made_up("adaptation", lambda cell: math.inf if cell.case == "fleet" else 5.0)
    found = Found(plan=GridPlan(seeds=3), rows={"adaptation": rows})
    assert "in `fleet` it loses the car too on paper (lost against lost)" in sentences(found)[0]
    text = " ".join(worlds_report.report(found, jobs=1, pictures=[]).split())
    assert "| `network-secant` for `constant` " in text and "| 0 / 0 of 3 |" in text


def test_deviations_that_lose_the_car_and_rivals_that_keep_closer_are_told():
    def mm(cell):
        if cell.case == "steer-lag-3" and cell.road != "circuit-65":
            return math.inf if cell.controller == "lpv-mpc" else 40.0
        return {"lpv-mpc": 1.0}.get(cell.controller, 50.0)

    plan = GridPlan(controllers=("lpv-mpc", "stanley"), roads=("paper", "circuit-65", "circuit-87"))
    lost, closer = sentences(
        Found(plan=plan, rows={"deviations": made_up("deviations", mm, plan)})
    )
    assert lost.endswith("lose `lpv-mpc`: steering lag x3 (paper, circuit 87 %).")
    assert closer.endswith("steering lag x3 (paper: `stanley`; circuit 87 %: `stanley`).")


def margin(held, failed, who="lpv-mpc", kind=KINDS[0], why="spun"):
    return Margin(kind=kind, controller=who, held=held, failed=failed, why=why, rows=())


def test_margins_are_told_and_a_rival_that_bears_more_is_named():
    both = [margin(60.0, 61.0), margin(120.0, 122.0, who="stanley")]
    found = Found(plan=GridPlan(), margins=both)
    told = sentences(found)
    assert told[0] == "How far `lpv-mpc` holds on circuit 65 %: latency, untold to 60 ms."
    assert "`stanley` of latency, untold (to 120 ms against to 60 ms)" in told[1]
    table = worlds_report.margins_table(both, GridPlan())
    assert "60 (spun)" in table and "1.6 ms" in table
    assert "at least 200" in worlds_report.margins_table(
        [margin(200.0, None, why="")], GridPlan())
    assert "none (0.3 m)" in worlds_report.margins_table(
        [margin(None, 0.0, why="more than 0.3 m off")], GridPlan())


def test_promises_are_met_or_missed_by_the_numbers():
    rows = {"worlds": made_up("worlds", lambda cell: 3.0),
            "deviations": made_up("deviations", lambda c: math.inf if c.case == "mass" else 0.5)}
    driven = Found(plan=GridPlan(), rows=rows, margins=[margin(59.0, 61.0)])
    found = {f.key: f for f in bars(driven)}
    assert found["rtk_paper_rmse"].ok and found["rtk_paper_rmse"].value == pytest.approx(3.0)
    assert found["ideal_paper_rmse"].ok and found["ideal_paper_largest"].ok
    assert found["alone_paper_rmse"].ok is False and math.isinf(found["alone_paper_rmse"].value)
    assert found["margin_latency"].ok is False and found["margin_noise"].ok is None
    assert found["rtk_paper_steering"].limit.bound == pytest.approx(1.5 * 0.1 + 0.05)
    assert found["fleet_circuit-80_completed"].value == 100.0
    values = worlds_report.as_json(Found(plan=GridPlan(), rows=rows), jobs=1)
    assert values["bars"]["alone_paper_rmse"]["value"] is None  # JSON has no infinity
    json.dumps(values, allow_nan=False)


def test_a_rival_s_places_a_latency_that_is_survived_and_the_price_of_learning_are_promises():
    def mm(cell):
        better = cell.controller == "stanley" and cell.case == "fleet"
        return 2.0 if better else {"network": 3.35, "network-dry": 3.0}.get(cell.model, 3.0)

    def alone(cell):
        return math.inf if cell.case == "latency-40" and cell.road == "paper" else 1.0

    rows = {"worlds": made_up("worlds", mm), "adaptation": made_up("adaptation", mm),
            "deviations": made_up("deviations", alone)}
    found = {f.key: f for f in bars(Found(plan=GridPlan(), rows=rows))}
    assert (found["rivals"].value, found["rivals"].ok) == (3.0, False)  # fleet's three roads
    assert (found["latency-40"].value, found["latency-40"].ok) == (1.0, False)
    assert found["alone_paper_rmse"].ok  # 40 ms is to be survived, no more
    assert found["learning"].value == pytest.approx(3.35 - 3.3) and found["learning"].ok


def test_the_csv_has_every_run_and_nothing_that_depends_on_the_machine():
    found = found_with(lambda cell: 5.0)
    lines = list(csv.DictReader(worlds_report.as_csv(found).splitlines()))
    assert len(lines) == len(found.every_row())
    assert not {"wall_s", "step_time_us", "realtime_factor"} & set(lines[0])
    assert lines[-1]["case"] == "combined" and float(lines[-1]["lateral_rmse_m"]) == 0.005


def test_curves_of_the_picture_end_at_the_share_of_completed_runs():
    rows = [row(1.0, seed=1), row(4.0, seed=2), row(2.0, seed=3), row(9.0, seed=4, lost=OFF_PATH)]
    figure = worlds_pictures.shares(rows, lambda cell: cell.controller, ("lpv-mpc", "stanley"))
    (axes,) = figure.axes
    assert not axes.texts
    assert axes.get_xlim() == (1.0, 10.0) and list(axes.get_xticks()) == [1.0, 10.0]
    x, y = axes.lines[0].get_data()
    assert np.allclose(x, [1.0, 1.0, 2.0, 4.0]) and np.allclose(y, [0.0, 0.25, 0.5, 0.75])


def test_who_lost_every_run_has_no_curve_but_a_cross_where_no_curve_comes():
    rows = [row(1.0, controller="stanley"), row(4.0, lost=OFF_PATH)]
    figure = worlds_pictures.shares(rows, lambda cell: cell.controller, ("lpv-mpc", "stanley"))
    (axes,) = figure.axes
    assert [text.get_text() for text in axes.texts] == ["all lost"]
    (cross,) = [line for line in axes.lines if line.get_marker() == "x"]
    assert cross.get_color() == worlds_pictures._colour(0)  # lpv-mpc, the first of the names
    curves = [line for line in axes.lines if line is not cross and len(line.get_ydata())]
    assert cross.get_ydata()[0] < 0.0 == min(min(line.get_ydata()) for line in curves)


def test_bars_of_the_picture_are_shares_of_the_range():
    figure = worlds_pictures.bars([margin(50.0, 51.0), margin(200.0, None, who="stanley")])
    axes = figure.axes[0]
    assert [bar.get_width() for bar in axes.patches] == [0.25, 1.0]
    assert [t.get_text() for t in axes.get_xticklabels()] == ["0", "100", "200"]


def test_the_report_says_where_each_controllers_weights_come_from():
    from lpvmpc.bench.report import origins

    said = origins(["lpv-mpc", "stanley", "absent"])
    assert said.startswith("Weights were set by the search over worlds, rounded, but for ")
    assert said.endswith("for `lpv-mpc`; tuned in ideal, rtk, fleet for `stanley`; set by hand for "
                         "`absent`.")


def test_a_lost_car_is_told_before_anything_else():
    def lose(cell):
        return math.inf if cell.controller == "lpv-mpc" and cell.seed == FIRST_SEED else 5.0

    first, second = sentences(found_with(lose))[:2]
    assert first.startswith("`lpv-mpc` loses the car in") and "95th percentile" in second
    assert "95th percentile" in sentences(found_with(lambda cell: 5.0))[0]
