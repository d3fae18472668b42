import json
import math
import pickle
import random
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict, replace
from multiprocessing import get_context

import numpy as np
import pytest

from lpvmpc.errors import DataError, OptionError
from lpvmpc.tune import genetic, pso
from lpvmpc.tune.checkpoint import FORMAT, Generation, SearchState
from lpvmpc.tune.search import Guarded, summary

LOWER, UPPER = np.array([-3.0, 0.0, 1e-3]), np.array([5.0, 1e6, 2e-3])
OPTIMUM = np.array([1.0, 4e5, 1e-3])  # the last one lies on its bound
SCALE = UPPER - LOWER

SEARCHES = {
    "genetic": (genetic, genetic.GeneticSettings(generations=6, population=8)),
    "pso": (pso, pso.SwarmSettings(generations=6, population=8)),
}


@pytest.fixture(params=SEARCHES)
def search(request):
    """Minimises with small settings of either search, seed 5."""
    module, settings = SEARCHES[request.param]

    def minimise(cost, lower=LOWER, upper=UPPER, **options):
        return module.minimise(cost, lower, upper, **{"seed": 5, "settings": settings, **options})

    minimise.module, minimise.settings = module, settings
    return minimise


def bowl(x):
    return float((((x - OPTIMUM) / SCALE) ** 2).sum())


def sometimes_broken(x):
    """A third of the individuals raise."""
    if x[1] < 3.3e5:
        raise RuntimeError(f"no\nroad at {x[1]:.0f}")
    return bowl(x)


def same(one, other):
    """Whether two results are equal to the last bit."""
    def bits(result):
        return (
            result.best.tobytes(), result.cost, result.evaluations, result.failures,
            [(g.best, g.mean, g.worst, g.individual.tobytes()) for g in result.history],
        )

    return bits(one) == bits(other)


def states(search, cost=bowl, **options):
    """Every state of a search, and its result."""
    found = []
    return search(cost, after=found.append, **options), found


def sent(state):
    """A state that was written to a file and read again."""
    return SearchState.from_json(json.loads(json.dumps(state.to_json(), indent=2, allow_nan=False)))


def test_the_optimum_of_a_bowl_is_found(search):
    result = search(bowl, settings=replace(search.settings, generations=60))
    # 60 generations of a few individuals: a hundredth of the range in each variable is little.
    assert (np.abs(result.best - OPTIMUM) < 0.03 * SCALE).all()
    assert result.cost == bowl(result.best)


def test_no_individual_leaves_the_bounds(search):
    seen = []

    def cost(x):
        seen.append(x)
        return -float(((x - OPTIMUM) / SCALE) @ [1.0, 2.0, -3.0])  # best in a corner

    search(cost)
    seen = np.array(seen)
    assert (seen >= LOWER).all() and (seen <= UPPER).all()
    assert (seen == LOWER).any() and (seen == UPPER).any()


def test_a_variable_without_room_stays_where_it_is(search):
    seen = []
    search(lambda x: seen.append(x) or float(x[0]), [1.0, 0.1], [2.0, 0.1])
    assert {x[1] for x in seen} == {0.1}


@pytest.mark.parametrize("seed", range(5))
def test_the_best_never_worsens(search, seed):
    rng = np.random.default_rng(seed)
    result = search(lambda x: rng.normal(), seed=seed)  # not even a function
    best = [generation.best for generation in result.history]
    assert best == sorted(best, reverse=True)
    assert result.cost == best[-1]
    assert all(g.best <= g.mean <= g.worst for g in result.history)


def test_the_history_has_the_first_population_and_every_generation(search):
    result, found = states(search)
    assert len(result.history) == search.settings.generations + 1
    assert [state.generation for state in found] == list(range(search.settings.generations + 1))
    for generation in result.history:
        assert generation.best == bowl(generation.individual)


def test_the_evaluations_are_those_that_the_settings_promise(search):
    calls = []
    result = search(lambda x: calls.append(x) or bowl(x))
    assert len(calls) == result.evaluations == search.settings.evaluations
    # Parents are not evaluated again, and no one draws the same numbers twice.
    assert len({x.tobytes() for x in calls}) > 0.9 * len(calls)


def test_both_defaults_have_the_same_budget():
    assert genetic.GeneticSettings().evaluations == pso.SwarmSettings().evaluations == 260


def test_the_seed_decides_everything(search):
    assert same(search(bowl), search(bowl))
    assert not same(search(bowl), search(bowl, seed=6))


def test_the_order_of_evaluation_decides_nothing(search):
    order = random.Random(1)

    def shuffled(function, individuals):
        places = list(range(len(individuals)))
        order.shuffle(places)
        outcomes = {place: function(individuals[place]) for place in places}
        return [outcomes[place] for place in range(len(individuals))]

    expected = search(sometimes_broken)
    assert same(expected, search(sometimes_broken, map=shuffled))
    with ThreadPoolExecutor(3) as pool:
        assert same(expected, search(sometimes_broken, map=pool.map))


def test_other_processes_give_the_same_result(search):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        result = search(sometimes_broken, map=pool.map)
    assert same(result, search(sometimes_broken))
    assert result.failures


def test_a_map_that_loses_an_individual_is_not_believed(search):
    with pytest.raises(ValueError, match="zip"):
        search(bowl, map=lambda function, individuals: [function(x) for x in individuals[1:]])


def test_a_cost_that_writes_into_its_argument_changes_nothing(search):
    def cost(x):
        value = bowl(x)
        x[:] = np.nan
        return value

    assert same(search(cost), search(bowl))


@pytest.mark.parametrize(
    "value", [0.0, -7.5, 1.7e308, -1.7e308, 5e-324, math.inf, math.nan, -math.inf]
)
def test_a_constant_cost_does_not_break_it(search, value):
    result = search(lambda x: value)
    expected = value if math.isfinite(value) else math.inf
    assert result.cost == expected
    assert result.evaluations == search.settings.evaluations
    # Infinity is an answer; NaN and minus infinity are mistakes, and named.
    named = 0 if value == math.inf or math.isfinite(value) else result.evaluations
    assert len(result.failures) == named


@pytest.mark.parametrize("bad", [math.inf, math.nan, -math.inf])
def test_a_cost_that_is_not_finite_counts_as_infinitely_bad(search, bad):
    result = search(lambda x: bad if x[0] < 0.5 else bowl(x))
    assert result.best[0] >= 0.5 and math.isfinite(result.cost)
    assert all(math.isfinite(g.mean) for g in result.history)


def test_costs_of_every_size_do_not_overflow(search):
    result = search(lambda x: (x[0] - 1.0) / 4.0 * 1.79e308)
    assert result.cost < -1e308


def test_a_cost_that_raises_is_charged_and_named(search):
    result = search(sometimes_broken)
    assert result.best[1] >= 3.3e5
    first = [failure for failure in result.failures if failure.generation == 0]
    population = states(search)[1][0].arrays["individuals"]
    assert [f.individual for f in first] == np.flatnonzero(population[:, 1] < 3.3e5).tolist()
    assert first[0].text.startswith("RuntimeError: no road at ")


def test_a_cost_that_is_no_number_is_named():
    assert Guarded(lambda x: "much")(LOWER)[1].startswith("ValueError: could not convert")
    assert Guarded(lambda x: None)(LOWER) == (
        math.inf, "TypeError: float() argument must be a string or a real number, not 'NoneType'"
    )

    def silent(x):
        raise KeyError

    assert Guarded(silent)(LOWER) == (math.inf, "KeyError")


def test_an_interrupt_is_not_a_failure(search):
    def cost(x):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        search(cost)


def test_the_guard_can_be_sent_to_another_process():
    assert pickle.loads(pickle.dumps(Guarded(bowl)))(OPTIMUM) == (0.0, None)


def test_the_individuals_to_start_with_are_in_the_first_population(search):
    given = [OPTIMUM, UPPER]
    result, found = states(search, start=given)
    assert found[0].arrays["individuals"][:2].tolist() == [list(x) for x in given]
    assert result.cost == 0.0
    assert same(result, search(bowl, start=given))


def test_resumed_after_any_generation_it_ends_in_the_same_bits(search):
    undisturbed, found = states(search, sometimes_broken)
    assert undisturbed.failures
    for state in found:
        result, rest = states(search, sometimes_broken, state=sent(state))
        assert same(result, undisturbed)
        assert [s.generation for s in rest] == [s.generation for s in found[state.generation + 1 :]]
        assert all(
            one.to_json() == other.to_json()
            for one, other in zip(rest, found[state.generation + 1 :], strict=True)
        )


def test_a_finished_state_costs_nothing(search):
    undisturbed, found = states(search)

    def never(x):
        raise AssertionError

    assert same(search(never, state=sent(found[-1])), undisturbed)


def test_a_state_goes_through_json_without_loss(search):
    _, found = states(search, lambda x: math.inf if x[0] < 1.0 else bowl(x))
    for state in found:
        again = sent(state)
        assert again.to_json() == state.to_json()
        for name, array in state.arrays.items():
            assert again.arrays[name].tobytes() == array.tobytes()
            assert again.arrays[name].shape == array.shape
            assert not again.arrays[name].flags.writeable
        assert again.result().failures == state.failures
    assert any(np.isinf(state.arrays["costs"]).any() for state in found)


def test_numbers_from_numpy_are_settings_like_others(search):
    settings = replace(search.settings, population=np.int64(8), generations=np.int32(6))
    result, found = states(search, settings=settings, seed=np.int64(5))
    assert same(result, search(bowl))
    assert same(search(bowl, state=sent(found[2])), result)


def test_a_state_of_other_settings_is_refused_with_what_differs(search):
    state = states(search)[1][2]
    with pytest.raises(DataError, match=r"^The saved state was made with seed 5, not 6\.$"):
        search(bowl, seed=6, state=state)
    larger = replace(search.settings, population=9, generations=7)
    with pytest.raises(DataError, match=r"made with generations 6, not 7; population 8, not 9\.$"):
        search(bowl, settings=larger, state=state)
    with pytest.raises(DataError, match=r"made with 3 variables, not 2\.$"):
        search(bowl, LOWER[:2], UPPER[:2], state=state)
    with pytest.raises(DataError, match=r"made with other bounds\.$"):
        search(bowl, LOWER - 1.0, UPPER, state=state)


def test_a_state_of_the_other_search_is_refused():
    state = states(lambda cost, **o: pso.minimise(cost, LOWER, UPPER, seed=5, **o))[1][0]
    with pytest.raises(DataError, match="is of the search 'pso', not 'genetic'"):
        genetic.minimise(bowl, LOWER, UPPER, seed=5, state=state)


@pytest.mark.parametrize("value", [None, 3, "state", [], {}, {"format": FORMAT, "state": {}}])
def test_something_else_is_no_state(value):
    with pytest.raises(DataError, match=r"^This is no saved state of a search\.$"):
        SearchState.from_json(value)


def test_a_state_of_another_version_is_refused(search):
    value = {**states(search)[1][1].to_json(), "format": FORMAT + 1}
    with pytest.raises(DataError, match=f"has format {FORMAT + 1}; this version reads {FORMAT}"):
        SearchState.from_json(value)


def test_a_damaged_state_is_refused(search):
    text = json.dumps(states(search)[1][1].to_json())
    value = json.loads(text)
    paths = [
        ("method", "other"), ("settings", {}), ("lower", [0.0]), ("generator", {}),
        ("arrays", {}), ("history", []), ("evaluations", 1e9), ("failures", [[1, 2, "x"]]),
    ]
    for name, other in paths:
        body = {**value["state"], name: other}
        with pytest.raises(DataError, match=r"is damaged: its checksum is another\.$"):
            SearchState.from_json({**value, "state": body})
    body = dict(value["state"])
    del body["generator"]
    for broken in (body, [], None, 4, {**value["state"], "evaluations": math.nan}):
        with pytest.raises(DataError, match="is damaged"):
            SearchState.from_json({**value, "state": broken})
    with pytest.raises(DataError, match="is damaged"):
        SearchState.from_json({**value, "sha256": None})


def test_every_changed_digit_of_a_state_is_noticed(search):
    text = json.dumps(states(search)[1][1].to_json())
    digits = [i for i, letter in enumerate(text) if letter.isdigit()]
    for i in random.Random(0).sample(digits, 60):
        changed = f"{text[:i]}{(int(text[i]) + 1) % 10}{text[i + 1 :]}"
        if json.loads(changed) == json.loads(text):
            continue  # the last digit of a float that rounds to the same
        with pytest.raises((DataError, json.JSONDecodeError)):
            SearchState.from_json(json.loads(changed))


@pytest.mark.parametrize(
    ("lower", "upper", "words"),
    [
        ([0.0, math.nan], [1.0, 1.0], "lower is [0.0, nan], but must be one list of finite"),
        ([0.0], [math.inf], "upper is [inf], but must be one list of finite numbers below 1e+100."),
        ([], [], "lower is [], but must be one list"),
        ([[0.0]], [[1.0]], "lower is [[0.0]], but must be one list"),
        (["a"], [1.0], "lower is ['a'], but must be numbers."),
        ([0.0], [1.0, 2.0], "upper is [1.0, 2.0], but must be of 1 numbers, like lower."),
        ([0.0, 2.0], [1.0, 1.0], "upper is [1.0, 1.0], but must be from [0.0, 2.0] on."),
    ],
)
def test_bad_bounds_are_one_sentence(search, lower, upper, words):
    with pytest.raises(OptionError) as error:
        search(bowl, lower, upper)
    assert str(error.value).startswith(words)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ([[1.0, 2.0]], "must be at most 8 individuals of 3 numbers"),
        ([OPTIMUM] * 9, "must be at most 8 individuals"),
        ([[9.0, 1.0, 1e-3]], "must be from [-3.0, 0.0, 0.001] to [5.0, 1000000.0, 0.002]"),
        ([[math.nan, 1.0, 1e-3]], "must be from [-3.0"),
    ],
)
def test_individuals_to_start_with_that_do_not_fit_are_refused(search, start, words):
    with pytest.raises(OptionError) as error:
        search(bowl, start=start)
    assert words in str(error.value)


@pytest.mark.parametrize("seed", [-1, 1.5, "1", True, None])
def test_a_seed_that_is_none_is_refused(search, seed):
    with pytest.raises(OptionError, match="^seed is .* whole number from 0"):
        search(bowl, seed=seed)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("generations", -1), ("generations", 1.5), ("generations", "3"),
        ("population", 0), ("population", math.nan), ("population", True),
    ],
)
def test_settings_that_cannot_be_run_are_refused(search, name, value):
    with pytest.raises(OptionError, match=f"^{name} is {value!r}, but must be a whole number from"):
        replace(search.settings, **{name: value})


def test_the_summary_of_a_population_counts_its_infinite_costs():
    found = summary(np.array([[1.0], [2.0], [3.0]]), np.array([4.0, 2.0, math.inf]))
    assert asdict(found) | {"individual": 0} == asdict(Generation(2.0, 3.0, math.inf, 0))
    assert found.individual == [2.0]
    hopeless = summary(np.zeros((2, 1)), np.full(2, math.inf))
    assert (hopeless.best, hopeless.mean, hopeless.worst) == (math.inf,) * 3
