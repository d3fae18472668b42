import json
import os
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
    small = SMALL[: SMALL.index("--worlds")]
    code, out, err = run(*small, *own, "--scenario", road, "--json", tmp_path / "copy.json")
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
        (["--controller", "nowhere:Mine"],
         "Controller 'nowhere:Mine' cannot be imported: there is no"),
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


def test_searches_of_several_seeds_are_laid_side_by_side(run, road, tmp_path):
    for seed in (0, 1):
        assert run(*SMALL, "--scenario", road, "--seed", seed, "--out", f"s{seed}")[0] == 0
    code, out, err = run("--spread", "s0", "s1", "--jobs", 1, "--json", "copy.json")
    assert (code, err) == (0, "")
    found = json.loads((tmp_path / "copy.json").read_text())
    kept = [json.loads((tmp_path / f"s{seed}" / "tuning.json").read_text()) for seed in (0, 1)]
    assert found["seeds"] == [0, 1]
    assert found["costs"] == [one["cost"] for one in kept]
    assert found["weights"] == [one["weights"] for one in kept]
    shipped = weights_file.read_weights(weights_file.shipped_file("pure-pursuit"))
    assert shipped.items() <= found["shipped"].items() and found["shipped_cost"] > 0.0
    text = (tmp_path / "runs" / "tune-spread" / "spread.md").read_text()
    assert out.startswith(text) and f"{max(found['costs']):.3f}" in text


@pytest.mark.parametrize(
    ("folders", "sentence"),
    [
        (["s0"], "--spread is 1, but must be at least two folders of searches"),
        (["s0", "s0"], "seeds is '0, 0', but must be a different one for each search"),
        (["s0", "other"], "population of other is 5, but must be that of s0, 4"),
        (["s0", "nowhere"], "nowhere/tuning.json cannot be read (No such file or directory)"),
        (["s0", "damaged"], "damaged/tuning.json is no JSON"),
        (["s0", "deep"], "deep/tuning.json is no JSON"),
        (["s0", "pipe"], "pipe/tuning.json cannot be read (it is a pipe, not a file)"),
        (["s0", "empty"], "empty/tuning.json holds no tuning: task, weights"),
    ],
)
def test_what_is_no_spread_is_one_sentence(run, tmp_path, folders, sentence):
    task = {"population": 4, "seed": 0}
    texts = {"s0": task, "other": {**task, "population": 5, "seed": 1}}
    for name, value in texts.items():
        (tmp_path / name).mkdir()
        whole = {"weights": {}, "cost": 1.0, "evaluations": 9, "on_bounds": [], "record": {}}
        (tmp_path / name / "tuning.json").write_text(json.dumps({**whole, "task": value}))
    for name, text in (("damaged", "{"), ("empty", "{}"), ("deep", "[" * 9000)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "tuning.json").write_text(text)
    (tmp_path / "pipe").mkdir()
    os.mkfifo(tmp_path / "pipe" / "tuning.json")  # reading it would wait without end
    code, _, err = run("--spread", *folders)
    assert code == 2 and sentence in err and err.count("\n") == 1


# A user's class -----------------------------------------------------------------------------------

MINE = """
from lpvmpc import Command


class Mine:
    RANGES = {"look": (1.0, 30.0), "kp": (0.0, 4.0)}

    def __init__(self, car, weights=None):
        self.weights = {"look": 20.0, "kp": 1.0, "kept": 7.0, **(weights or {})}
        self.wheelbase = car.wheelbase

    def reset(self, rng):
        pass

    def command(self, state, preview):
        w = self.weights
        steer = self.wheelbase * preview.kappa[2] - preview.epsi - preview.ey / w["look"]
        return Command(float(steer), float(w["kp"] * (preview.vx_ref[2] - state.vx)))
"""


def test_a_users_class_is_tuned_over_the_ranges_it_states(run, road, tmp_path):
    (tmp_path / "mine.py").write_text(MINE)
    mine = (*SMALL[:-4], "--controller", "mine:Mine", "--worlds", "rtk", "--scenario", road)
    code, _, err = run(*mine)
    assert (code, err) == (0, "")
    file = tmp_path / "runs" / "tune-mine-Mine" / "weights.toml"
    weights = weights_file.read_weights(file, "mine:Mine")
    assert weights["kept"] == 7.0 and 1.0 <= weights["look"] <= 30.0 and 0.0 <= weights["kp"] <= 4.0
    assert weights["look"] != 20.0  # it was searched, and by hand is not the best
    found = json.loads((file.parent / "tuning.json").read_text())
    assert found["by_hand"] == {"look": 20.0, "kp": 1.0, "kept": 7.0}
    assert found["evaluations"] <= found["budget"]
    assert run(*mine, "--resume")[1].startswith("This tuning is done already")
    (tmp_path / "mine.py").write_text(MINE.replace("kappa[2]", "kappa[3]"))
    assert run(*mine, "--resume")[0] == 2  # another class: there is nothing of it to go on from


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("class Mine", "class Yours", "module 'mine' has no class 'Mine'; it has Command, Yours"),
        ("car, weights=None", "car", "its constructor does not ask for 'weights'"),
        ("self.weights =", "self.w =", "its attribute 'weights' must be a dataclass or a dict"),
        ('"kept": 7.0', '"kept": "a lot"', "its weight 'kept' must be a finite number, but is 'a"),
        ('"kept": 7.0', '"kept": float("nan")', "its weight 'kept' must be a finite"),
        ("RANGES =", "REACH =", "its 'RANGES' must be a dictionary with the lowest and highest"),
        ('"kp": (0.0, 4.0)', '"ki": (0.0, 4.0)', "its 'RANGES' name 'ki', which is none of its w"),
        ("(0.0, 4.0)", "(4.0, 0.0)", "its range of kp must be two numbers in their order, but is"),
        ("(0.0, 4.0)", "4.0", "its range of kp must be two numbers in their order, but is 4.0"),
        ("**(weights or {})", '"look": 20.0', "given weights with look = 5.47723 it drives"),
        ("weights or {}", "weights or 1 / 0", "cannot be made from what controllers are given"),
    ],
)
def test_a_users_class_that_cannot_be_tuned_is_one_sentence(
    run, road, tmp_path, old, new, sentence
):
    assert old in MINE
    (tmp_path / "mine.py").write_text(MINE.replace(old, new, 1))
    code, _, err = run(*SMALL, "--scenario", road, "--controller", "mine:Mine")
    assert code == 2
    assert sentence in err and err.count("\n") == 1
