import json
import math
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.control import weights_file
from lpvmpc.control.cost import Weights
from lpvmpc.control.registry import TUNABLE
from lpvmpc.errors import DataError, LPVMPCError, OptionError, UnknownNameError
from lpvmpc.kit.workers import workers
from lpvmpc.sim import batch
from lpvmpc.sim.world import WORLDS
from lpvmpc.tune import driving, tuning, tuning_report
from lpvmpc.tune.tuning import Space, Task, stages, tune

TASK = Task(
    controller="stanley", generations=4, population=6, scenarios=("tuning-b",), worlds=("ideal",)
)


@pytest.fixture
def bowl(monkeypatch):
    """A cost without driving: the distance of the weights from a point inside the ranges."""

    def cost(self, coordinates):
        low, high = self.space.bounds
        others = self.runs[0].controller_options["weights"]
        assert set(others) == set(tuning.stated(self.controller).weights)
        return float(np.sum(np.square((coordinates - low) / (high - low) - 0.4)))

    monkeypatch.setattr(driving.DrivingCost, "__call__", cost)


# What is driven ---------------------------------------------------------------------------------


def test_every_run_has_its_own_draw_apart_from_those_of_reports():
    few, more = (tuning.runs(Task(seeds=seeds), {}) for seeds in (1, 3))
    assert len(few) == 2 * 4 and few == more[:8]  # the same draws, and further ones
    assert len(more) == 8 + 2 * 2 * 3  # the ideal world has nothing to draw
    seeds = [run.seed for run in more]
    assert len(set(seeds)) == len(seeds) and min(seeds) == tuning.FIRST_SEED
    assert tuning.FIRST_SEED + tuning.MAX_RUNS < 100_000
    assert {run.world for run in more} == {"ideal", "rtk", "fleet"}


def test_where_friction_is_taken_away_the_plan_leaves_some():
    grips = {run.world: run.scenario_options.get("grip") for run in tuning.runs(Task(), {})
             if run.scenario == "tuning-a"}
    fleet = WORLDS["fleet"]
    left = fleet.road["friction"].low * fleet.car["mu_f"].low
    assert grips["ideal"] == grips["rtk"] == 0.8 and grips["fleet"] < left


# What is searched -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", TUNABLE)
def test_no_controller_gets_more_than_the_budget(name):
    task = Task(controller=name)
    searches = stages(task)
    total = sum(stage.settings.evaluations for stage in searches)
    # the swarm moves by whole generations of 13 particles
    assert task.budget - 13 < total <= task.budget == 260
    found = [weight for stage in searches for weight in stage.space.ranges]
    assert len(found) == len(set(found)) > 0


def test_pid_gains_are_found_by_the_swarm_once_the_car_stays_on_the_road():
    first, second = stages(Task(controller="lmpc-pso-pid"))
    assert (first.method, second.method) == ("genetic", "pso")
    assert list(second.space.ranges) == ["kp", "ki", "kd"]
    assert not set(first.space.ranges) & set(second.space.ranges)


def test_weights_of_absent_parts_are_not_searched():
    (stage,) = stages(Task(controller="lpv-mpc-paper"))
    assert not {"observer_gain", "slip_cap", "terminal"} & set(stage.space.ranges)


def test_weights_and_coordinates_are_each_others_inverse():
    space = Space(Weights.RANGES)
    low, high = space.bounds
    for share in (0.0, 0.3, 1.0):
        point = low + share * (high - low)
        # log10 and its inverse, to rounding
        assert np.allclose(space.coordinates(space.weights(point)), point, rtol=0.0, atol=1e-12)
    weights = space.weights(high)
    assert all(value <= Weights.RANGES[name][1] for name, value in weights.items())


def test_values_outside_the_ranges_begin_on_their_bounds():
    space = Space({"q_vy": (0.01, 10.0)})
    assert space.weights(space.coordinates({"q_vy": 0.0})) == {"q_vy": pytest.approx(0.01)}


# Tuning -----------------------------------------------------------------------------------------


def test_tuning_improves_and_keeps_the_weights_that_are_not_searched(bowl):
    tuned = tune(Task(controller="lpv-mpc-paper", generations=8, population=10))
    (result,) = tuned.results
    assert result.cost < result.history[0].best
    for name in ("terminal", "observer_gain", "slip_cap"):
        assert tuned.weights[name] == tuned.by_hand[name]
    assert tuned.weights["q_ey"] != tuned.by_hand["q_ey"]


@pytest.mark.parametrize("stop", range(1, 5))
def test_resumed_tuning_ends_in_the_same_weights(bowl, tmp_path, stop):
    undisturbed = tune(TASK)
    calls = []

    def interrupt(stage, state):
        calls.append(state)
        if len(calls) == stop:
            raise KeyboardInterrupt

    file = tmp_path / "checkpoint.json"
    with pytest.raises(KeyboardInterrupt):
        tune(TASK, checkpoint=file, after=interrupt)
    resumed = tune(TASK, checkpoint=file, resume=True)
    assert resumed.weights == undisturbed.weights  # bit for bit
    assert resumed.evaluations == undisturbed.evaluations


def test_a_tuning_stopped_before_its_first_generation_can_be_resumed(bowl, tmp_path):
    def stop(function, things):
        raise KeyboardInterrupt

    file = tmp_path / "checkpoint.json"
    with pytest.raises(KeyboardInterrupt):
        tune(TASK, checkpoint=file, map=stop)
    assert tune(TASK, checkpoint=file, resume=True).weights == tune(TASK).weights


def test_the_seed_decides(bowl):
    other = Task(controller="stanley", generations=4, population=6, seed=1)
    assert tune(TASK).weights == tune(TASK).weights != tune(other).weights


def test_an_individual_that_raises_is_charged_and_named(bowl, monkeypatch):
    kind = driving.DrivingCost
    cost, calls = kind.__call__, []

    def brittle(self, coordinates):
        calls.append(coordinates)
        if len(calls) == 3:
            raise RuntimeError("the worker caught fire")
        return cost(self, coordinates)

    monkeypatch.setattr(kind, "__call__", brittle)
    tuned = tune(Task(generations=2, population=6))
    (failure,) = tuned.results[0].failures
    assert (failure.generation, failure.individual) == (0, 2)
    assert failure.text == "RuntimeError: the worker caught fire"
    results = [batch.charged(run, "spun") for run in tuning.runs(tuned.task, {})]
    text = tuning_report.report(tuned, results, results)
    assert "Generation 0, individual 2: RuntimeError" in text


def test_a_controller_that_never_drives_is_one_sentence(monkeypatch):
    def broken(self, coordinates):
        raise ValueError("no road")

    monkeypatch.setattr(driving.DrivingCost, "__call__", broken)
    with pytest.raises(LPVMPCError, match="No weights of lpv-mpc could be driven: ValueError"):
        tune(Task(generations=1, population=4))


def test_one_worker_and_two_find_the_same(tmp_path):
    (tmp_path / "road.csv").write_text(
        "# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n"
        + "".join(f"{x},{0.02 * math.sin(x / 8.0)},3,3,10\n" for x in range(0, 62, 2))
    )
    task = Task(
        controller="pure-pursuit",
        scenarios=(str(tmp_path / "road.csv"),),
        worlds=("ideal", "fleet"),
        generations=1,
        population=4,
    )
    with workers(2) as two:
        assert tune(task, map=two.map).weights == tune(task).weights


def test_weights_that_ended_on_a_bound_are_named(bowl):
    tuned = tune(TASK)
    low, high = tuning.stated("stanley").ranges["k_e"]
    inside = {name: math.sqrt(a * b) for name, (a, b) in tuning.stated("stanley").ranges.items()}
    for value, named in ((low, True), (0.99 * high, True), (0.8 * high, False)):
        there = replace(tuned, weights={**inside, "k_e": value})
        assert there.on_bounds == (("k_e",) if named else ())
        assert ("k_e" in tuning_report.bounds_sentence(there)) == named


# Bad input --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "error", "sentence"),
    [
        ({"controller": "lpv"}, UnknownNameError, "Unknown controller 'lpv'"),
        ({"scenarios": ()}, OptionError, "scenarios is"),
        ({"worlds": ()}, OptionError, "worlds is"),
        ({"worlds": ("dry",)}, UnknownNameError, "Unknown world 'dry'"),
        ({"seeds": 0}, OptionError, "seeds is 0, but must be a whole number from 1 to 1250"),
        ({"generations": 0}, OptionError, "generations is 0, but must be"),
        ({"population": 3}, OptionError, "population is 3, but must be"),
    ],
)
def test_tasks_without_meaning_are_refused(options, error, sentence):
    with pytest.raises(error) as raised:
        Task(**options)
    assert sentence in str(raised.value)


@pytest.fixture
def checkpoint(bowl, tmp_path):
    file = tmp_path / "checkpoint.json"
    tune(TASK, checkpoint=file)
    return file


def test_another_task_is_not_resumed(checkpoint, monkeypatch):
    with pytest.raises(DataError, match="was made with generations 4, not 5"):
        tune(replace(TASK, generations=5), checkpoint=checkpoint, resume=True)
    with pytest.raises(DataError, match=r"was made with worlds \['ideal'\], not \['rtk'\]"):
        tune(replace(TASK, worlds=("rtk",)), checkpoint=checkpoint, resume=True)
    monkeypatch.setattr(driving, "SPEED", 0.1)
    with pytest.raises(DataError, match="was made with prices"):
        tune(TASK, checkpoint=checkpoint, resume=True)


def test_another_version_of_the_package_is_not_resumed(checkpoint, monkeypatch):
    monkeypatch.setattr(batch, "foundation", lambda rival: "another")
    with pytest.raises(DataError, match="with another version of the package"):
        tune(TASK, checkpoint=checkpoint, resume=True)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda text: text[:-40], "is damaged"),
        (lambda text: "[]", "is no checkpoint of a tuning"),
        (lambda text: text.replace('"format": 1', '"format": 99', 1), "has format 99"),
        (lambda text: text.replace('"evaluations": ', '"evaluations": 1', 1), "is damaged"),
    ],
)
def test_a_damaged_checkpoint_is_one_sentence(checkpoint, spoil, sentence):
    checkpoint.write_text(spoil(checkpoint.read_text()))
    with pytest.raises(DataError) as error:
        tune(TASK, checkpoint=checkpoint, resume=True)
    assert sentence in str(error.value) and "checkpoint.json" in str(error.value)


def test_nothing_to_resume_is_one_sentence(tmp_path):
    with pytest.raises(DataError, match="There is no tuning to resume in"):
        tune(TASK, checkpoint=tmp_path / "none.json", resume=True)


# What it leaves behind --------------------------------------------------------------------------


def test_the_weights_it_saves_are_those_it_found(bowl, tmp_path):
    tuned = tune(TASK)
    result = {
        "scenario": "tuning-b", "lateral_rmse_m": 0.1, "lateral_max_m": None,
        "course_rmse_rad": 0.2, "speed_rmse_mps": 0.3, "completed": False, "reason": "spun",
    }
    files = tuning_report.save(tuned, [result], [result], tmp_path)
    assert weights_file.read_weights(tmp_path / "weights.toml", "stanley") == tuned.weights
    values = json.loads((tmp_path / "tuning.json").read_text())
    assert values["weights"] == tuned.weights and values["draws"] == [tuning.FIRST_SEED]
    assert values["task"]["worlds"] == ["ideal"] and values["cost_is"] == driving.RISK
    text = (tmp_path / "tuning.md").read_text()
    assert "lost: spun" in text and "100.00 / -" in text and "tuning-b, ideal 1000" in text
    record = tomllib.loads((tmp_path / "weights.toml").read_text())["record"]
    assert record["worlds"] == ["ideal"] and record["draws"] == [tuning.FIRST_SEED]
    rows = (tmp_path / "history.csv").read_text().splitlines()
    assert len(rows) == 1 + sum(len(r.history) for r in tuned.results)
    assert all(file.stat().st_size > 100 for file in files)
