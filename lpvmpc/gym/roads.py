"""The roads of many cars in one table, so that one compiled call sees all of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from lpvmpc.road.scenario import Scenario
from lpvmpc.sim.names import load_scenario
from lpvmpc.units import Array

SPEED, WIDTHS = 4, 5
"""Columns of the table behind x, y, psi, kappa: reference speed, and widths right and left."""


class Roads:
    """Scenarios by name; random ones are made when they are first driven.

    `table` holds x, y, psi [m, rad], kappa [1/m], vx_ref [m/s] and the widths right and left [m] of
    all roads, one under the other; `index` has first row, last row + 1, and whether it is closed;
    `spacing` the distance of the rows [m].
    """

    def __init__(self, names: tuple[str, ...], options: Mapping[str, Any]) -> None:
        """Read those that may not be there.

        Args:
            names: Scenarios or CSV files.
            options: Of `load_scenario`, for all of them.

        Raises:
            UnknownNameError, OptionError, PathError: There is no such road.
        """
        self.names, self.options = names, options
        self.scenarios: list[Scenario] = []
        self._number: dict[str, int] = {}
        self.table: Array = np.zeros((0, 7))
        self.index = np.zeros((0, 3), dtype=np.int64)
        self.spacing: Array = np.zeros(0)
        for name in names:  # the first one tells of options that there are not
            if name == names[0] or not name.startswith("random-"):
                self.number(name)

    def number(self, name: str) -> int:
        """Row of a road in `index`.

        Raises:
            UnknownNameError, OptionError, PathError: There is no such road.
        """
        if name in self._number:
            return self._number[name]
        scenario = load_scenario(name, **self.options)
        path, speed = scenario.path, scenario.speed
        vx = np.interp(path.s, np.linspace(0.0, path.length, len(speed.vx)), speed.vx)
        sides = [side if path.has_widths else np.zeros(len(path.s))
                 for side in (path.width_right, path.width_left)]
        rows = np.column_stack([path.x, path.y, path.psi, path.kappa, vx, *sides])
        first = len(self.table)
        self.table = np.ascontiguousarray(np.vstack([self.table, rows]))
        ends = [[first, first + len(rows), int(path.closed)]]
        self.index = np.vstack([self.index, np.array(ends, dtype=np.int64)])
        self.spacing = np.append(self.spacing, path.spacing)
        self.scenarios.append(scenario)
        self._number[name] = len(self.scenarios) - 1
        return self._number[name]
