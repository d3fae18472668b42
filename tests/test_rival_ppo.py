import json
from importlib.util import find_spec

import numpy as np
import pytest

from lpvmpc import Plant, load_controller, load_scenario, metrics, simulate
from lpvmpc.control.rivals import observation, ppo
from lpvmpc.errors import ControllerError, DataError, LPVMPCError
from lpvmpc.gym import card
from lpvmpc.gym.learn import Options, Recipe, learn, main, save
from lpvmpc.kit import cli, safetensors
from lpvmpc.plant.mjcf import packaged_car
from lpvmpc.tune.stated import stated

LACKS_RL = find_spec("stable_baselines3") is None


def policy(file, **changed):
    sizes = {"w0": (4, observation.SIZE), "b0": (4,), "w1": (4, 4), "b1": (4,), "w2": (2, 4),
             "b2": (2,)}
    rng = np.random.default_rng(0)
    arrays = {name: rng.standard_normal(shape).astype(np.float32) for name, shape in sizes.items()}
    arrays.update(changed)
    safetensors.write(file, arrays, {"observation": ppo.names()})
    return arrays


def test_the_action_is_that_of_the_equation(tmp_path):
    file = tmp_path / "p.safetensors"
    a = policy(file)
    controller = ppo.PPO(packaged_car(), file=file)
    seen = np.linspace(-1.0, 1.0, observation.SIZE)
    x = seen / observation.SCALES
    for i in "01":
        x = np.tanh(a[f"w{i}"].astype(float) @ x + a[f"b{i}"])
    expected = np.clip(a["w2"].astype(float) @ x + a["b2"], -1.0, 1.0)
    assert np.allclose(controller.act(seen), expected, atol=1e-14)


def test_a_policy_of_other_observations_is_refused(tmp_path):
    file = tmp_path / "p.safetensors"
    policy(file, w0=np.zeros((4, 7), dtype=np.float32))
    with pytest.raises(DataError, match="other observations"):
        ppo.PPO(packaged_car(), file=file)


def test_the_shipped_policy_drives():
    log = simulate(Plant(), load_controller("ppo"), load_scenario("double-lane-change"))
    assert metrics(log)["completed"]


@pytest.mark.slow
@pytest.mark.parametrize("world", ["ideal", "rtk"])
def test_the_shipped_policy_completes_the_circuit_at_half_its_grip(world):
    scenario = load_scenario("circuit", grip=0.5)
    log = simulate(Plant(), load_controller("ppo"), scenario, world=world, seed=100_000)
    assert metrics(log)["completed"]


def test_it_cannot_be_tuned():
    with pytest.raises(ControllerError, match="'ppo' cannot be tuned: it was trained"):
        stated("ppo")


def test_the_card_says_first_where_the_car_is_lost(tmp_path):
    def result(completed, rmse):
        return {"completed": completed, "lateral_rmse_m": rmse, "lateral_max_m": 2.0 * rmse,
                "steer_rate_rms_radps": 0.1}

    cases = [
        card.Case(road="paper", world="ideal", results=(result(True, 0.02),)),
        card.Case(road="circuit 92 %", world="fleet",
                  results=(result(True, 0.1), result(False, 3.0), result(True, 0.3))),
    ]
    assert card.sentences(cases) == [
        "It loses the car: 1 of 3 on circuit 92 % in `fleet`.",
        "It completes every run of: paper in `ideal`.",
    ]
    assert cases[1].row() == ("circuit 92 %", "fleet", 3, 2, 0.1, 0.6, 0.1)
    file = tmp_path / "p.safetensors"
    policy(file, curve=np.array([[2048.0, 0.1], [4096.0, 0.9]]))
    card.save(file, cases, tmp_path)
    text = (tmp_path / "ppo.md").read_text()
    assert "2 of 3" in text and "4,096 control periods" in text
    assert json.loads((tmp_path / "ppo.json").read_text())["cases"][1]["completed"] == 2


@pytest.mark.skipif(LACKS_RL, reason="the extra rl is not installed")
@pytest.mark.slow
def test_training_repeats_from_its_seed(tmp_path):
    recipe = Recipe(steps=1024, cars=8, horizon=32, minibatch=64, seed=3)
    for name, threads in (("a", 1), ("b", 2)):
        save(tmp_path / name, learn(recipe, threads=threads), recipe)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.skipif(not LACKS_RL, reason="the extra rl is installed")
def test_what_is_missing_is_named():
    with pytest.raises(LPVMPCError, match="lpvmpc\\[rl\\]"):
        learn(Recipe())


def test_two_that_learn_into_one_file_are_told_apart(tmp_path, monkeypatch, capsys):
    fcntl = pytest.importorskip("fcntl")
    monkeypatch.setattr("lpvmpc.gym.learn.learn", lambda *_: pytest.fail("it learned"))
    with open(tmp_path / ".p.safetensors.lock", "w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        code = cli.run(Options, main, ["--out", str(tmp_path / "p.safetensors")])
    assert code == 2 and capsys.readouterr().err.startswith("Error: Another run")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--policy", "p.safetensors"], "--policy is 'p.safetensors', but must be left out"),
        (["--card", "--policy", "none.safetensors"], "There is no file 'none.safetensors'"),
        (["--card", "--policy", "p.safetensors"], "p.safetensors holds no curve of a training"),
    ],
)
def test_what_has_no_card_is_one_sentence(tmp_path, monkeypatch, capsys, arguments, sentence):
    monkeypatch.chdir(tmp_path)
    policy(tmp_path / "p.safetensors")
    assert cli.run(Options, main, arguments) == 2
    err = capsys.readouterr().err
    assert sentence in err and err.count("\n") == 1
