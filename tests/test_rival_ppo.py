from importlib.util import find_spec

import numpy as np
import pytest

from lpvmpc.control.rivals import observation, ppo
from lpvmpc.errors import DataError, LPVMPCError
from lpvmpc.gym.learn import Recipe, learn, save
from lpvmpc.kit import safetensors
from lpvmpc.plant.mjcf import packaged_car

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
