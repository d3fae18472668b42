import json
import tomllib

import numpy as np
import pytest

from lpvmpc.control import weights_file
from lpvmpc.tune import driving

COMMAND = "tune"
SMALL = ("--generations", 2, "--population", 4, "--jobs", 1, "--controller", "pure-pursuit",
         "--worlds", "ideal")


@pytest.fixture
def road(tmp_path):
    """A straight road of 40 m, driven at 10 m/s."""
    rows = "".join(f"{x},0,3,3,10\n" for x in range(0, 42, 2))
    (tmp_path / "road.csv").write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n" + rows)
    return "road.csv"  # the script runs in that folder


def test_a_tuning_leaves_weights_that_can_be_driven(run, road, tmp_path):
    own = ("--worlds", "ideal", "rtk", "--seeds", 2)
    code, out, err = run(*SMALL, *own, "--scenario", road, "--json", tmp_path / "copy.json")
    assert (code, err) == (0, "")
    folder = tmp_path / "runs" / "tune-pure-pursuit"
    kept = {file.name for file in folder.iterdir()}
    assert kept == {"weights.toml", "tuning.md", "tuning.json", "history.csv", "convergence.png"}
    weights = weights_file.read_weights(folder / "weights.toml", "pure-pursuit")
    assert json.loads((tmp_path / "copy.json").read_text())["weights"] == weights
    record = tomllib.loads((folder / "weights.toml").read_text())["record"]
    assert record["worlds"] == ["ideal", "rtk"] and record["draws"] == [1000, 1001, 1002]
    table = out[: out.index("Saved")]
    assert "road" in out and max(map(len, table.splitlines())) <= 80


def test_a_tuning_that_was_interrupted_goes_on(run, road, tmp_path, monkeypatch):
    assert run(*SMALL, "--scenario", road, "--out", "whole")[0] == 0
    cost, calls = driving.cost, []

    def stop(log, scale):
        calls.append(log)
        if len(calls) == 7:
            raise KeyboardInterrupt
        return cost(log, scale)

    monkeypatch.setattr(driving, "cost", stop)
    code, _, err = run(*SMALL, "--scenario", road, "--out", "two")
    assert (code, err) == (130, "Interrupted; --resume goes on from here.\n")
    assert run(*SMALL, "--scenario", road, "--out", "two", "--resume")[0] == 0
    whole, two = ((tmp_path / name / "weights.toml").read_text() for name in ("whole", "two"))
    assert whole == two


def test_an_individual_that_fails_is_told(run, road, monkeypatch):
    cost, calls = driving.cost, []

    def fail_once(log, scale):
        calls.append(log)
        return np.nan if len(calls) == 2 else cost(log, scale)

    monkeypatch.setattr(driving, "cost", fail_once)
    code, _, err = run(*SMALL, "--scenario", road)
    assert code == 0
    assert err == "Warning: generation 0, individual 1 is charged: the cost is nan\n"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--controller", "mpc"], "Unknown controller 'mpc'; the choices are"),
        (["--controller", "mine:Mine"], "Unknown controller 'mine:Mine'"),
        (["--scenario", "papers"], "Unknown scenario 'papers'"),
        (["--worlds", "dry"], "Unknown world 'dry'"),
        (["--seeds", "0"], "--seeds is 0, but must be from 1"),
        (["--generations", "0"], "--generations is 0, but must be from 1"),
        (["--population", "3"], "population is 3, but must be a whole number from 4"),
        (["--jobs", "0"], "--jobs is 0, but must be from 1"),
        (["--seed", "-1"], "--seed is -1, but must be from 0"),
        (["--resume"], "There is no tuning to resume in"),
        (["--address", "nowhere:1"], "address is 'nowhere:1', but must be left out"),
        (["--out", "/proc/nowhere"], "Cannot write into '/proc/nowhere'"),
    ],
)
def test_bad_options_are_one_sentence(run, arguments, sentence):
    code, _, err = run(*arguments)
    assert code == 2
    assert sentence in err and err.count("\n") == 1
