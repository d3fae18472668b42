import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.errors import OptionError, UnknownNameError
from lpvmpc.tune import genetic
from lpvmpc.tune.genetic import GeneticSettings, minimise, wheel

LOWER, UPPER = [-2.0, 0.0], [2.0, 8.0]


def slope(x):
    return float(x[0] + x[1])


def children(settings, selection="mixed", seed=0, cost=slope, upper=UPPER):
    """First population and first children of a search."""
    rows = []
    minimise(
        lambda x: rows.append(x) or cost(x), LOWER, upper, seed=seed,
        settings=replace(settings, generations=1), selection=selection,
    )
    return np.array(rows[: settings.population]), np.array(rows[settings.population :])


def test_the_defaults_are_those_of_the_papers_table_1():
    s = GeneticSettings()
    assert (s.generations, s.population, s.offspring) == (15, 20, 0.8)
    assert (s.pressure, s.mutation_rate, s.sigma) == (0.75, 0.3, 0.15)
    assert s.pairs == 8  # 80 % of 20 are 16 children


@pytest.mark.parametrize(
    ("population", "offspring", "pairs"), [(10, 0.8, 4), (20, 1.0, 10), (2, 0.8, 1), (7, 0.0, 1)]
)
def test_children_come_in_pairs_and_there_is_always_one(population, offspring, pairs):
    s = GeneticSettings(population=population, offspring=offspring, generations=3)
    assert s.pairs == pairs
    assert s.evaluations == population + 6 * pairs


def test_the_wheel_prefers_the_better():
    chances = wheel(np.array([3.0, 1.0, 2.0, 5.0]), 0.75)
    assert chances.sum() == pytest.approx(1.0, abs=1e-15)  # rounding of four additions
    assert list(np.argsort(-chances)) == [1, 2, 0, 3]
    # The mean, 2.75, is 1.75 above the best: the chance falls by exp(-0.75) on that way.
    assert chances[2] / chances[1] == pytest.approx(math.exp(-0.75 / 1.75), rel=1e-14)


def test_more_pressure_prefers_the_best_more_and_none_nobody():
    costs = np.array([1.0, 2.0, 3.0])
    best = [wheel(costs, pressure)[0] for pressure in (0.0, 0.5, 1.0, 5.0)]
    assert best[0] == pytest.approx(1 / 3) and best == sorted(best)


def test_scale_and_offset_of_the_cost_do_not_turn_the_wheel():
    costs = np.array([0.25, 0.5, 4.0])
    for other in (costs + 1024.0, costs * 2.0**900, costs * 2.0**-900, costs - 64.0):
        assert wheel(other, 0.75) == pytest.approx(wheel(costs, 0.75), rel=1e-12)


def test_the_wheel_stands_when_all_costs_are_equal_or_infinite():
    for costs in ([2.0] * 4, [math.inf] * 4, [1.7e308] * 4, [5e-324, 0.0, 0.0, 0.0]):
        assert wheel(np.array(costs), 0.75) == pytest.approx(0.25, rel=1e-15)


def test_the_infinitely_bad_is_never_drawn():
    chances = wheel(np.array([1.0, math.inf, 2.0]), 0.75)
    assert chances[1] == 0.0 and chances[0] > chances[2] > 0.0
    assert wheel(np.array([math.inf, 3.0]), 0.75).tolist() == [0.0, 1.0]
    assert np.isfinite(wheel(np.array([-1.7e308, 1.7e308, math.inf]), 0.75)).all()


@pytest.mark.parametrize("crossover", ["exchange", "blend"])
@pytest.mark.parametrize("selection", ["roulette", "tournament", "mixed"])
def test_every_selection_prefers_the_better_parents(selection, crossover):
    s = GeneticSettings(population=1000, offspring=1.0, mutation_rate=0.0, crossover=crossover)
    parents, young = children(s, selection)
    # Without mutation a pair keeps the sum of its parents, so the children's mean is that of the
    # parents drawn. A tournament of two lowers it by 1/sqrt(pi) = 0.56 of a normal's spread, the
    # wheel by about half as much; 1000 draws have a standard error of 0.03.
    spread = parents.sum(axis=1).std()
    assert young.sum(axis=1).mean() < parents.sum(axis=1).mean() - 0.15 * spread


def test_a_larger_tournament_is_harder_to_win():
    s = GeneticSettings(population=100, offspring=1.0, mutation_rate=0.0)
    means = [
        np.mean([children(replace(s, rivals=n), "tournament", seed)[1].sum(axis=1).mean()
                 for seed in range(5)])
        for n in (1, 2, 5, 100)
    ]
    assert means == sorted(means, reverse=True)
    parents, young = children(replace(s, rivals=100), "tournament")
    assert (young == parents[np.argmin(parents.sum(axis=1))]).all()


def test_the_mixed_selection_draws_both_parents_of_a_pair_in_one_way():
    # With this pressure the wheel draws the best alone, here the first, and a tournament of one
    # draws anybody: a pair of parents is two times the best, or two individuals at random.
    s = GeneticSettings(population=50, offspring=1.0, mutation_rate=0.0, crossover="exchange",
                        pressure=100.0, rivals=1)
    both, one = [], []
    for seed in range(10):
        costs = itertools.chain([0.0], itertools.repeat(1.0))
        parents, young = children(s, seed=seed, cost=lambda x, costs=costs: next(costs))
        from_best = (young == parents[0]).reshape(-1, 4)  # one row for each pair
        both += list(from_best.all(axis=1))
        one += list(from_best.any(axis=1) & ~from_best.all(axis=1))
    # 250 pairs: a standard error of 0.032, four of them. Half of the pairs are drawn at random, and
    # one in 25 of these contains the best; if parents were drawn one by one, half of all did.
    assert np.mean(both) == pytest.approx(0.5, abs=0.13)
    assert np.mean(one) < 0.1


def test_an_exchange_only_moves_values_of_the_parents():
    parents, young = children(GeneticSettings(mutation_rate=0.0, crossover="exchange"))
    for column in range(2):
        assert set(young[:, column]) <= set(parents[:, column])


def test_a_blend_stays_within_its_reach_of_the_parents():
    s = GeneticSettings(population=2, offspring=1.0, mutation_rate=0.0, rivals=1)
    beyond = 0.0
    for seed in range(200):
        parents, young = children(s, "tournament", seed)
        low, high = parents.min(axis=0), parents.max(axis=0)
        width = high - low
        # 1e-12: the blend is rounded.
        assert (young >= low - (0.2 + 1e-12) * width).all()
        assert (young <= high + (0.2 + 1e-12) * width).all()
        beyond = max(beyond, float(((young - high) / width).max()))
    assert 0.15 < beyond  # and does use it


def test_parents_that_agree_have_children_that_agree():
    s = GeneticSettings(mutation_rate=0.0, generations=4)
    found = minimise(lambda x: float(x[1]), [0.1, 0.0], [0.1, 1.0], seed=1, settings=s)
    assert {g.individual[0] for g in found.history} == {0.1}


def test_the_rate_is_per_variable():
    s = GeneticSettings(population=4000, offspring=1.0, crossover="exchange")
    parents, young = children(s, "tournament")
    new = np.column_stack([~np.isin(young[:, i], parents[:, i]) for i in range(2)])
    # 4000 children: a standard error of 0.007, four of them.
    assert new.mean(axis=0) == pytest.approx(0.3, abs=0.03)
    assert new.all(axis=1).mean() == pytest.approx(0.09, abs=0.02)


def test_sigma_is_a_fraction_of_each_variables_range_and_bounds_are_kept():
    wide = [2e6, 8.0]
    s = GeneticSettings(population=4000, offspring=1.0, mutation_rate=1.0, rivals=4000, sigma=0.05)
    parents, young = children(s, "tournament", upper=wide)
    best = parents[np.argmin(parents.sum(axis=1))]  # every child is the best, mutated
    for column, low in enumerate(LOWER):
        step = young[:, column] - best[column]
        up = step[step > 0.0]  # downwards, the bound is near
        # The median magnitude of a normal number is 0.6745 sigma; 2000 of them: 2 % of error.
        assert np.median(up) == pytest.approx(0.6745 * 0.05 * (wide[column] - low), rel=0.08)
        assert (young[:, column] == low).any()


def test_a_child_as_good_as_a_parent_replaces_it():
    first, last = [], []
    minimise(
        lambda x: 1.0, LOWER, UPPER, seed=0,
        after=lambda state: (first if state.generation == 0 else last).append(state),
    )
    before = {x.tobytes() for x in first[0].arrays["individuals"]}
    after = {x.tobytes() for x in last[-1].arrays["individuals"]}
    assert not before & after


def test_the_best_of_parents_and_children_survive():
    states, costs = [], []
    minimise(lambda x: costs.append(slope(x)) or costs[-1], LOWER, UPPER, seed=2,
             settings=GeneticSettings(generations=3), after=states.append)
    pool = costs[:20]
    for state, begin in zip(states[1:], range(20, 68, 16), strict=True):
        pool = sorted(pool + costs[begin : begin + 16])[:20]
        assert state.arrays["costs"].tolist() == pool


def test_as_printed_the_children_alone_make_up_the_next_population():
    """Algorithm 1: children until the population is full, and they replace it."""
    states, calls = [], []
    settings = GeneticSettings(generations=3, population=7).of("printed")
    minimise(lambda x: calls.append(slope(x)) or calls[-1], LOWER, UPPER, seed=2,
             settings=settings, after=states.append)
    assert len(calls) == settings.evaluations == 7 * 4
    for k, state in enumerate(states):
        assert state.arrays["costs"].tolist() == sorted(calls[7 * k : 7 * k + 7]) or k == 0
    best = [g.best for g in states[-1].history]
    assert best != sorted(best, reverse=True)  # the best is lost again with this seed


def test_as_printed_a_constant_in_the_cost_takes_the_wheels_pressure_away():
    costs = np.array([1.0, 2.0, 3.0])
    printed = wheel(costs, 0.75, "cost")
    assert printed[1] / printed[0] == pytest.approx(math.exp(-0.75 / 2.0), rel=1e-14)
    assert wheel(costs + 1000.0, 0.75, "cost") == pytest.approx(1 / 3, abs=1e-3)
    assert wheel(costs, 0.75) == pytest.approx(wheel(costs + 1000.0, 0.75), rel=1e-12)


def test_as_printed_sigma_has_the_variables_own_unit():
    s = GeneticSettings(population=4000, mutation_rate=1.0, rivals=4000, sigma=0.05).of("printed")
    parents, young = children(s, "tournament")
    best = parents[np.argmin(parents.sum(axis=1))]
    for column in range(2):
        step = young[:, column] - best[column]
        up = step[step > 0.0]
        # 0.6745 sigma is the median magnitude; 2000 of them: 2 % of error.
        assert np.median(up) == pytest.approx(0.6745 * 0.05, rel=0.08)


def test_ours_is_the_default_and_both_have_names():
    assert GeneticSettings().of("ours") == GeneticSettings()
    assert GeneticSettings().of("printed").of("ours") == GeneticSettings()
    with pytest.raises(UnknownNameError, match="algorithm 'best'; the choices are ours, printed"):
        GeneticSettings().of("best")
    with pytest.raises(UnknownNameError, match="survival 'all'; the choices are best, offspring"):
        GeneticSettings(survival="all")


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("population", 1, "a whole number from 2 to 1000000"),
        ("offspring", 1.5, "a number from 0 to 1"),
        ("pressure", -0.1, "a number from 0 to 100"),
        ("mutation_rate", math.nan, "a number from 0 to 1"),
        ("sigma", "wide", "a number from 0 to 1"),
        ("reach", -1.0, "a number from 0 to 1"),
        ("rivals", 21, "a whole number from 1 to 20"),
    ],
)
def test_bad_settings_are_one_sentence(name, value, allowed):
    with pytest.raises(OptionError) as error:
        GeneticSettings(**{name: value})
    assert str(error.value) == f"{name} is {value!r}, but must be {allowed}."


def test_unknown_names_come_with_the_choices():
    with pytest.raises(UnknownNameError, match="crossover 'two'; the choices are blend, exchange"):
        GeneticSettings(crossover="two")
    with pytest.raises(UnknownNameError, match="choices are mixed, roulette, tournament"):
        minimise(slope, LOWER, UPPER, seed=0, selection="best")


def test_it_knows_nothing_of_cars():
    """The module and what it stands on could be lifted out."""
    import ast
    from pathlib import Path

    for name in ("genetic", "pso", "search", "checkpoint"):
        tree = ast.parse(Path(genetic.__file__).with_name(f"{name}.py").read_text())
        imported = {n.module for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
        ours = {module for module in imported if module and module.startswith("lpvmpc")}
        own = {"lpvmpc.tune.search", "lpvmpc.tune.checkpoint"}
        assert ours <= {"lpvmpc.errors", "lpvmpc.units", "lpvmpc.kit.files"} | own
