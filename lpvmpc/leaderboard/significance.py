"""Whether one controller is better than another, or only was: tests over paired runs.

Blocks are cells: the same road, world and seed, driven by everybody. Friedman's test asks whether
the ranks within the blocks differ at all, Nemenyi's critical difference which mean ranks do, and
Wilcoxon's signed ranks, corrected by Holm, whether one controller differs from each other one.

Source: J. Demsar, Statistical comparisons of classifiers over multiple data sets, JMLR 7 (2006).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from lpvmpc.leaderboard.grid import Cell
from lpvmpc.leaderboard.score import Board, error
from lpvmpc.sim.ending import EY_LOST
from lpvmpc.units import Array

ALPHA = 0.05
"""Level of all tests."""
CHARGE = EY_LOST
"""RMSE of a charged run where a number is needed [m]: where a car counts as lost."""
FEWEST = 6
"""Blocks below which nothing is tested: five pairs cannot reach the level."""


def errors(board: Board, cells: Sequence[Cell], controllers: Sequence[str]) -> Array:
    """Lateral RMSE [m], shape (cells, controllers); infinite for charged runs."""
    return np.array(
        [[error(board.table[cell][name]) for name in controllers] for cell in cells]
    ).reshape(len(cells), len(controllers))


@dataclass(frozen=True, kw_only=True)
class Ranks:
    """Mean ranks over blocks, and by how much they must differ."""

    n: int
    """Number of blocks."""
    mean: Mapping[str, float]
    """Mean rank by controller, the best first; 1 is the best."""
    p: float
    """Friedman's p: how likely such ranks are if all were alike; NaN where it was not tested."""
    difference: float
    """Nemenyi's critical difference; NaN where it was not tested."""

    @property
    def groups(self) -> list[tuple[str, ...]]:
        """Largest groups, in the order of the ranks, within which no two differ significantly.

        None where nothing was tested.
        """
        names: list[str] = list(self.mean)
        found: list[tuple[str, ...]] = []
        for i, first in enumerate(names if math.isfinite(self.difference) else ()):
            near = [k for k in names[i:] if self.mean[k] - self.mean[first] <= self.difference]
            if not found or near[-1] not in found[-1]:
                found.append(tuple(near))
        return found


def ranks(board: Board, cells: Sequence[Cell], controllers: Sequence[str]) -> Ranks:
    """Friedman's test and Nemenyi's difference.

    Args:
        board: The rows.
        cells: Blocks, at least one, driven by all the controllers.
        controllers: Who is compared.
    """
    from scipy import stats

    table = errors(board, cells, controllers)
    n, k = table.shape
    ranked = stats.rankdata(table, axis=1)  # ties, charged runs among them, share their ranks
    mean = ranked.mean(axis=0)
    p = difference = math.nan
    if k >= 3 and n >= FEWEST:
        alike = bool(np.all(ranked == ranked[:, :1]))
        p = 1.0 if alike else float(stats.friedmanchisquare(*ranked.T).pvalue)
        difference = nemenyi(k, n)
    order = sorted(range(k), key=lambda i: (mean[i], controllers[i]))
    return Ranks(n=n, mean={controllers[i]: float(mean[i]) for i in order}, p=p,
                 difference=difference)


def nemenyi(k: int, n: int, alpha: float = ALPHA) -> float:
    """Critical difference of mean ranks: q_alpha sqrt(k (k + 1) / 6 n).

    Args:
        k: Number of controllers.
        n: Number of blocks.
        alpha: Level of the test.
    """
    from scipy import stats

    q = float(stats.studentized_range.ppf(1.0 - alpha, k, np.inf)) / math.sqrt(2.0)
    return q * math.sqrt(k * (k + 1) / (6.0 * n))


@dataclass(frozen=True, kw_only=True)
class Pair:
    """One controller against another over paired runs."""

    first: str
    """The controller that is asked about."""
    second: str
    """The other."""
    n: int
    """Number of pairs."""
    ratio: float
    """Median of the second's error over the first's, charged runs at `CHARGE`: above 1 the first
    is better."""
    wins: int
    """Pairs in which the first is better."""
    losses: int
    """Pairs in which the second is."""
    p: float
    """Wilcoxon's p, corrected by Holm over all its rivals; NaN where it was not tested."""

    @property
    def verdict(self) -> int:
        """1: the first is significantly better; -1: the second is; 0: cannot be told."""
        if not self.p < ALPHA:  # NaN is no
            return 0
        return 1 if self.ratio > 1.0 else -1 if self.ratio < 1.0 else 0


def pairs(board: Board, cells: Sequence[Cell], first: str, others: Sequence[str]) -> list[Pair]:
    """One controller against each other one, on the cells that both have driven."""
    found = []
    for second in others:
        common = [c for c in cells if first in board.table[c] and second in board.table[c]]
        if not common:
            continue
        table = np.minimum(errors(board, common, (first, second)), CHARGE)
        log_ratio = np.log(np.maximum(table[:, 1], 1e-9) / np.maximum(table[:, 0], 1e-9))
        found.append(Pair(
            first=first, second=second, n=len(common),
            ratio=float(np.exp(np.median(log_ratio))),
            wins=int(np.count_nonzero(log_ratio > 0.0)),
            losses=int(np.count_nonzero(log_ratio < 0.0)),
            p=wilcoxon(log_ratio),
        ))
    return holm(found)


def wilcoxon(differences: Array) -> float:
    """Two-sided p of Wilcoxon's signed ranks, zeros split (Pratt); NaN with too few pairs."""
    from scipy import stats

    if len(differences) < FEWEST:
        return math.nan
    if not np.any(differences):
        return 1.0
    exact = len(differences) <= 25 and np.all(differences != 0.0) and (
        len(np.unique(np.abs(differences))) == len(differences)
    )
    method = "exact" if exact else "asymptotic"
    return float(stats.wilcoxon(differences, zero_method="pratt", method=method).pvalue)


def holm(found: Sequence[Pair]) -> list[Pair]:
    """The pairs with their p corrected for how many were tested."""
    tested = sorted((pair for pair in found if not math.isnan(pair.p)), key=lambda pair: pair.p)
    corrected: dict[str, float] = {}
    worst = 0.0
    for i, pair in enumerate(tested):
        worst = max(worst, min(1.0, pair.p * (len(tested) - i)))
        corrected[pair.second] = worst
    return [
        Pair(first=p.first, second=p.second, n=p.n, ratio=p.ratio, wins=p.wins, losses=p.losses,
             p=corrected.get(p.second, math.nan))
        for p in found
    ]
