"""Performance profiles: the share of problems a controller drives within a factor of the best.

Source: E. D. Dolan and J. J. More, Benchmarking optimization software with performance profiles,
Mathematical Programming 91 (2002).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lpvmpc.leaderboard.grid import Cell
from lpvmpc.leaderboard.score import Board
from lpvmpc.leaderboard.significance import errors
from lpvmpc.units import Array


@dataclass(frozen=True, kw_only=True)
class Profile:
    """A controller's curve: rho(tau), the share of problems with a ratio of at most tau."""

    controller: str
    """Who drove."""
    ratios: Array
    """Error over the best error of the same problem, ascending, shape (n,); infinite where the
    run is charged, or nobody's is not."""

    def within(self, factor: float) -> float:
        """Share of the problems that are driven within this factor of the best."""
        return float(np.count_nonzero(self.ratios <= factor) / len(self.ratios))

    def steps(self) -> list[tuple[float, float]]:
        """Corners of the curve: factor, and the share that is reached there."""
        finite = self.ratios[np.isfinite(self.ratios)]
        factors = np.unique(finite)
        shares = np.searchsorted(finite, factors, side="right") / len(self.ratios)
        return list(zip(map(float, factors), map(float, shares), strict=True))


def profiles(board: Board, cells: Sequence[Cell], controllers: Sequence[str]) -> list[Profile]:
    """Profiles over the cells, all driven by all the controllers.

    Args:
        board: The rows.
        cells: Problems, at least one.
        controllers: Who is compared, and whose best counts.
    """
    table = errors(board, cells, controllers)
    best = table.min(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):  # inf / inf: nobody has driven it
        ratios = np.where(np.isfinite(table), table / np.maximum(best, 1e-12), math.inf)
    return [
        Profile(controller=name, ratios=np.sort(ratios[:, i])) for i, name in enumerate(controllers)
    ]
