"""What networks tell along a driven lap: what is overheard, and the report on it."""

import numpy as np
import pytest

from lpvmpc.control.registry import make_stiffness
from lpvmpc.learn import driven, driven_report
from lpvmpc.learn.driven import GIVEN, GIVEN_SECANT, Overheard, Row
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.names import load_controller

COMMAND = "parts.stiffness"


@pytest.fixture(scope="module")
def overheard(plant):
    """A short run that was overheard, and the same run that was not."""
    from lpvmpc import load_scenario

    car = packaged_car()
    model = Overheard(make_stiffness("network", car, lambda: None))
    scenario = load_scenario("double-lane-change")
    log = simulate(plant, load_controller("lpv-mpc", stiffness=model), scenario)
    return log, model, simulate(plant, load_controller("lpv-mpc"), scenario)


def test_listening_changes_nothing(overheard):
    heard, _, plain = overheard
    for name in ("ey_m", "delta_cmd_rad", "ax_cmd_mps2"):
        assert (heard.columns[name] == plain.columns[name]).all()


def test_what_is_overheard_is_what_the_tires_do(overheard):
    log, model, _ = overheard
    table = model.table(len(log.columns["t_s"]))
    alpha, Fy, _ = driven.axle_truth(log)
    slip, force = table[:, :2], table[:, [2, 4]] * table[:, :2] + table[:, [3, 5]]
    much = np.abs(alpha) > 0.012
    assert much.sum() > 50
    # The true state is known and the road is dry: 5 % of the largest is what a period's lag costs.
    assert np.abs(slip - alpha)[much].max() < 0.05 * np.abs(alpha).max()
    assert np.abs(force - Fy)[much].max() < 0.05 * np.abs(Fy).max()
    assert (0.5 < table[:, 6]).all() and (table[:, 6] < 1.5).all()


def test_the_true_friction_makes_a_network_right_and_a_wrong_one_does_not(overheard):
    log, _, _ = overheard
    from lpvmpc.control.stiffness.network_file import load_weights

    _, true = driven.labels(log)
    weights = load_weights("network")
    # The R2 of one run is that of its own spread: 0.98 at the least, as on held-out runs.
    assert driven.r2(true[:, 0], driven.said(log, weights)[:, 0]) > 0.98
    half = driven.said(log, weights, 0.5)[:, 0]
    assert driven.r2(true[:, 0], half) < driven.r2(true[:, 0], driven.said(log, weights)[:, 0])


def test_there_are_three_trainings_of_each_network(root):
    for kind in ("network", "network-secant"):
        found = driven.networks(root / "docs" / "results", kind)
        assert list(found) == [0, 1, 2] and found[0] is None


def result(mm, completed=True):
    return {"completed": completed, "lateral_rmse_m": 1e-3 * mm, "lateral_max_m": 5e-3 * mm}


def test_the_report_tells_every_row_and_the_spread(tmp_path):
    rows = [
        Row(kind=kind, given=given, road=road, seed=0, C=(0.9, 0.8), Fy=(0.99, 0.98))
        for kind, words in (("network", GIVEN), ("network-secant", GIVEN_SECANT))
        for given in words for road in (1.0, 0.75)
        if not (given == "dry" and road == 1.0)
    ]
    trained = [
        driven_report.Trained(kind="network", seed=seed, r2=(0.9, 0.8),
                              results=(*(result(1.0 + seed) for _ in range(3)),
                                       result(1.0, completed=seed != 1)))
        for seed in range(3)
    ]
    text = driven_report.report(rows, trained, 0.76)
    for words in (GIVEN, GIVEN_SECANT):
        assert all(sentence in text for sentence in words.values())
    assert "worst over best RMSE of the trainings 3.00 (circuit 76 %)" in text
    assert "one is lost (76 %, friction 0.75)" in text
    assert driven_report.spread(trained, "network", 0) == (1e-3, 3e-3)
    files = driven_report.save(tmp_path, rows, trained, 0.76)
    assert [file.name for file in files] == ["stiffness.md", "stiffness.csv", "stiffness.json"]


@pytest.mark.parametrize(("arguments", "sentence"), [
    (["--seeds", "0"], "--seeds is 0, but must be from 1 to 1000."),
    (["--jobs", "0"], "--jobs is 0, but must be from 1 to 10000."),
])
def test_bad_options_are_one_sentence(run, arguments, sentence):
    assert run(*arguments) == (2, "", f"Error: {sentence}\n")
