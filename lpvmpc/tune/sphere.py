"""The genetic algorithm on a function whose optimum is known, as in the paper's Fig. 6.

The sphere function, the sum of five squares, within the bounds of the authors' published code
(github.com/yassinekebbati/GA-optimized-MLP-based-LPV_MPC, MIT licence): the fifth variable is kept
from 5 to 8, so the optimum lies on a bound and costs exactly 25. The paper prints one cost for each
selection, without saying of how many runs; a search with random numbers is told by many, so each is
run from many seeds and the selections are compared by ranks.

Our genetic algorithm is not the paper's Algorithm 1 (see `genetic`). So both run, as it is printed
and as ours, and ours with each departure taken back: a verdict on ours says nothing of the paper's.
What the paper leaves open was chosen on other seeds than those reported here.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, get_args

import numpy as np

from lpvmpc.tune import genetic
from lpvmpc.tune.genetic import PARTS, Crossover, Selection
from lpvmpc.units import Array

LOWER = (-10.0, -10.0, -5.0, -1.0, 5.0)
UPPER = (10.0, 10.0, 5.0, 1.0, 8.0)
"""Bounds of the authors' code."""
SETTINGS = genetic.GeneticSettings(generations=100, population=10)
"""Those of Fig. 6; the rest is Table 1."""
SEEDS = 30
"""Runs of each selection."""
SELECTIONS: tuple[Selection, ...] = get_args(Selection)
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "ours": ("our version", PARTS["ours"]),
    "printed": ("Algorithm 1 as printed", PARTS["printed"]),
    "ours, offspring survive": ("the children alone survive", {"survival": "offspring"}),
    "ours, wheel by cost": ("wheel turned by the mean cost", {"scale": "cost"}),
    "ours, sigma as it is": ("sigma in the variables' own units", {"step": "own"}),
}
"""What is run: the two algorithms, and ours with one departure taken back; words, and settings."""
CROSSOVERS: tuple[Crossover, ...] = get_args(Crossover)
PAPER = {"mixed": 25.029, "roulette": 27.725, "tournament": 28.722}
"""Costs printed in the paper."""
BAR = 0.004
"""Largest median distance to the optimum that we accept from our version's mixed selection: twice
the result, set after it was seen; before, 0.01 was asked for, the paper's own being 0.029."""
CHOICE = 1000
"""What is added to the seeds for the choice of the crossover, which must not see the others."""
LEVEL = 0.05
"""Chance of seeing a difference where there is none."""


def sphere(x: Array) -> float:
    """Sum of squares of x, shape (n,)."""
    return float(x @ x)


OPTIMUM = sphere(np.clip(0.0, LOWER, UPPER))
"""Lowest cost within the bounds: 25."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Runs:
    """Searches from several seeds that are otherwise alike."""

    selection: Selection
    """How parents are drawn."""
    crossover: Crossover
    """How they are crossed."""
    seeds: tuple[int, ...]
    """One run each, shape (k,)."""
    distances: Array
    """Best cost of each population, above the optimum, shape (k, generations + 1)."""

    @property
    def final(self) -> Array:
        """Distances at the end, shape (k,): of the best of the last population."""
        return self.distances[:, -1]

    @property
    def nearest(self) -> Array:
        """Distances of the best that was ever seen, shape (k,)."""
        return self.distances.min(axis=1)

    def reaches(self, distance: float) -> int | None:
        """First generation at which the median run is as near as this; None: it never is."""
        near = np.flatnonzero(np.median(self.distances, axis=0) <= distance)
        return int(near[0]) if near.size else None


@dataclass(frozen=True, kw_only=True, eq=False)
class Variant:
    """One algorithm with each of the selections."""

    key: str
    """Name in the files, a key of `VARIANTS`."""
    settings: genetic.GeneticSettings
    """What its runs have in common."""
    selections: tuple[Runs, ...]
    """One for each selection."""

    def of(self, selection: Selection) -> Runs:
        """The runs of a selection."""
        return next(runs for runs in self.selections if runs.selection == selection)

    @property
    def text(self) -> str:
        """What it is, in words."""
        return VARIANTS[self.key][0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Study:
    """All runs of the study."""

    variants: tuple[Variant, ...]
    """In the order of `VARIANTS`."""
    crossovers: tuple[Runs, ...]
    """One for each crossover, our version, mixed selection, other seeds."""

    def variant(self, key: str) -> Variant:
        """A variant by its name."""
        return next(v for v in self.variants if v.key == key)

    @property
    def ours(self) -> Variant:
        """Our version."""
        return self.variant("ours")

    @property
    def printed(self) -> Variant:
        """Algorithm 1 as it is printed."""
        return self.variant("printed")


@dataclass(frozen=True)
class Comparison:
    """Two selections, by rank."""

    one: Selection
    other: Selection
    nearer: float
    """Share of all pairs of runs in which `one` ended nearer to the optimum; ties count half."""
    p: float
    """Two-sided p of Mann and Whitney, after Holm for all comparisons made."""


def run(
    seed: int = 0,
    seeds: int = SEEDS,
    settings: genetic.GeneticSettings = SETTINGS,
    say: Callable[[str], None] = lambda text: None,
) -> Study:
    """Run the study.

    Args:
        seed: First seed.
        seeds: Number of seeds.
        settings: Of the genetic algorithm.
        say: Told what is being run.
    """
    numbers = tuple(range(seed, seed + seeds))
    variants = []
    for key, (text, parts) in VARIANTS.items():
        own, found = replace(settings, **parts), []
        for selection in SELECTIONS:
            say(f"{seeds} runs, {text}, {selection} selection")
            found.append(search(selection, own, numbers))
        variants.append(Variant(key=key, settings=own, selections=tuple(found)))
    others = tuple(number + CHOICE for number in numbers)
    crossovers = []
    for crossover in CROSSOVERS:
        say(f"{seeds} runs, crossover by {crossover}")
        crossovers.append(search("mixed", replace(settings, crossover=crossover), others))
    return Study(variants=tuple(variants), crossovers=tuple(crossovers))


def search(selection: Selection, settings: genetic.GeneticSettings, seeds: tuple[int, ...]) -> Runs:
    """Minimise the sphere function from each seed."""
    rows = []
    for seed in seeds:
        result = genetic.minimise(
            sphere, LOWER, UPPER, seed=seed, settings=settings, selection=selection
        )
        rows.append([generation.best - OPTIMUM for generation in result.history])
    return Runs(
        selection=selection,
        crossover=settings.crossover,
        seeds=seeds,
        distances=np.array(rows),
    )


def difference(study: Variant) -> float:
    """The p of Kruskal and Wallis that the three selections end equally far from the optimum."""
    from scipy.stats import kruskal

    samples = [runs.final for runs in study.selections]
    if len(np.unique(samples)) == 1:
        return 1.0  # all ranks tie, for which scipy has no p
    return float(kruskal(*samples).pvalue)


def compare(study: Variant) -> list[Comparison]:
    """Every two selections, with p adjusted for the number of comparisons (Holm)."""
    from scipy.stats import mannwhitneyu

    pairs = list(itertools.combinations(study.selections, 2))
    tests = [mannwhitneyu(one.final, other.final) for one, other in pairs]
    adjusted, largest = np.ones(len(pairs)), 0.0
    for place, index in enumerate(np.argsort([test.pvalue for test in tests], kind="stable")):
        largest = max(largest, min(1.0, (len(pairs) - place) * float(tests[index].pvalue)))
        adjusted[index] = largest
    return [
        Comparison(
            one.selection,
            other.selection,
            1.0 - float(test.statistic) / (one.final.size * other.final.size),
            float(p),
        )
        for (one, other), test, p in zip(pairs, tests, adjusted, strict=True)
    ]


def share_text(share: float) -> str:
    """A share in percent; "100%" and "0%" are told of all and none alone."""
    digits = 0 if share in (0.0, 1.0) or 0.005 <= share < 0.995 else 2
    return f"{share:.{digits}%}"


def verdict(study: Study) -> str:
    """What the tests say of both algorithms, in words."""
    ours, printed = (verdict_on(variant) for variant in (study.ours, study.printed))
    return f"{printed} {ours}"


def verdict_on(variant: Variant) -> str:
    """What the tests say of one algorithm, in words."""
    p, ahead, found = difference(variant), set(), []
    for c in compare(variant):
        if c.p < LEVEL:
            first, second = (c.one, c.other) if c.nearer > 0.5 else (c.other, c.one)
            share = max(c.nearer, 1.0 - c.nearer)
            ahead.add((first, second))
            pairs = f"{share_text(share)} of the pairs of runs"
            found.append(f"{first} ends nearer than {second} in {pairs}")
    seeds = len(variant.selections[0].seeds)
    text = f"{variant.text[0].upper()}{variant.text[1:]}, {seeds} seeds: "
    if p >= LEVEL:
        ahead.clear()
        text += (
            "no difference between the three selections can be told "
            f"(Kruskal-Wallis {p_text(p)})"
        )
    else:
        text += f"the three selections differ (Kruskal-Wallis {p_text(p)}): " + (
            "; ".join(found) or "but no two of them do by themselves"
        )
    won = [name for name in ("roulette", "tournament") if ("mixed", name) in ahead]
    lost = [name for name in ("roulette", "tournament") if (name, "mixed") in ahead]
    how = (
        "confirmed" if len(won) == 2
        else f"confirmed over {won[0]} alone" if won
        else "not confirmed"
    )
    if lost:
        how += f", and {' and '.join(lost)} {'are' if len(lost) == 2 else 'is'} ahead of it"
    return f"{text}. The paper's advantage of the mixed selection over both others is {how}."


def p_text(p: float) -> str:
    """A p value as text: `p = 0.5`, or `p < 0.0001`."""
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.2g}"
