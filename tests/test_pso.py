import math

import numpy as np
import pytest

from lpvmpc.errors import OptionError
from lpvmpc.tune import pso
from lpvmpc.tune.pso import SwarmSettings, minimise


def bowl(x):
    return float(((x - 1.0) ** 2).sum())


def swarm(cost, lower, upper, **options):
    """Every state of a swarm."""
    found = []
    minimise(cost, lower, upper, after=found.append, **{"seed": 0, **options})
    return found


def test_the_constriction_is_that_of_clerc_and_kennedy():
    assert SwarmSettings().constriction == pytest.approx(0.7298, abs=5e-5)  # as they print it
    c = 5.0
    chi = SwarmSettings(own=3.0, common=2.0).constriction
    assert chi == pytest.approx(2.0 / abs(2.0 - c - math.sqrt(c**2 - 4.0 * c)), rel=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_a_bowl_is_descended_to_its_bottom(seed):
    settings = SwarmSettings(generations=150)
    result = minimise(bowl, [-5.0] * 3, [5.0] * 3, seed=seed, settings=settings)
    # 150 moves shrink the swarm by far more than this; the cost is its square.
    assert result.cost < 1e-10


def test_an_optimum_on_a_bound_is_found_exactly():
    result = minimise(bowl, [1.0, -5.0], [4.0, 1.0], seed=3, settings=SwarmSettings(generations=60))
    assert result.best.tolist() == [1.0, 1.0] and result.cost == 0.0


def test_a_particle_comes_back_from_a_bound_with_half_its_speed():
    states = swarm(lambda x: -float(x[0]), [0.0], [1.0])  # pulls everyone to the upper bound
    bounced = 0
    for before, after in zip(states[:-1], states[1:], strict=True):
        moved = after.arrays["places"] - before.arrays["places"]
        speed = after.arrays["speeds"]
        inside = (after.arrays["places"] < 1.0) & (after.arrays["places"] > 0.0)
        # 1e-15: the place is rounded.
        assert moved[inside] == pytest.approx(speed[inside], abs=1e-15)
        outside = (after.arrays["places"] == 1.0) & (speed < 0.0)
        assert (-2.0 * speed[outside] >= moved[outside] - 1e-15).all()
        bounced += outside.sum()
    assert bounced > 0


def test_no_swarm_is_caught_on_a_bound(monkeypatch):
    def far(seed):
        settings = SwarmSettings(population=10, generations=80)
        lower, upper = [-10.0, -10.0, -1.0, 5.0], [10.0, 10.0, 1.0, 8.0]
        found = minimise(lambda x: float(x @ x), lower, upper, seed=seed, settings=settings)
        return found.cost - 25.0 > 0.5

    assert not any(far(seed) for seed in range(40))
    monkeypatch.setattr(pso, "BOUNCE", 0.0)
    assert any(far(seed) for seed in range(40))  # some rest on -1 or 1 for ever


def test_no_step_is_longer_than_the_range():
    lower, upper = np.array([0.0, -1.0]), np.array([1e-3, 1e6])
    for state in swarm(bowl, lower, upper, settings=SwarmSettings(own=50.0, common=50.0)):
        assert (np.abs(state.arrays["speeds"]) <= upper - lower).all()


def test_a_particle_remembers_its_best_place():
    states = swarm(bowl, [-5.0] * 2, [5.0] * 2)
    costs = np.array([[bowl(x) for x in state.arrays["places"]] for state in states])
    for i, state in enumerate(states):
        assert state.arrays["costs"].tolist() == costs[: i + 1].min(axis=0).tolist()
        assert [bowl(x) for x in state.arrays["individuals"]] == state.arrays["costs"].tolist()


def test_one_particle_is_a_swarm():
    result = minimise(bowl, [-5.0], [5.0], seed=0, settings=SwarmSettings(population=1))
    assert result.evaluations == 20


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"own": 2.0, "common": 2.0}, "own + common is 4.0, but must be above 4."),
        ({"own": -1.0}, "own is -1.0, but must be a number from 0 to 100."),
        ({"common": math.nan}, "common is nan, but must be a number from 0 to 100."),
        ({"population": 0}, "population is 0, but must be a whole number from 1 to 1000000."),
    ],
)
def test_bad_settings_are_one_sentence(options, sentence):
    with pytest.raises(OptionError) as error:
        SwarmSettings(**options)
    assert str(error.value) == sentence

