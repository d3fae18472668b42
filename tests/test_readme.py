"""The README's table says what the stored results say."""

import csv

import numpy as np

from lpvmpc.control.registry import CORE
from lpvmpc.published import TRACKING

COLUMNS = (("ideal", "paper"), ("ideal", "circuit-65"), ("rtk", "circuit-65"),
           ("fleet", "circuit-65"), ("production", "circuit-65"))


def short(value):
    """Two digits, no exponent."""
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


def cell(runs):
    """Median RMSE and worst largest error [mm] over the seeds; how many arrived, if not all."""
    done = [run for run in runs if run["completed"] == "True"]
    if not done:
        return f"0 of {len(runs)} arrive"
    rmse = 1e3 * np.median([float(run["lateral_rmse_m"]) for run in done])
    largest = 1e3 * max(float(run["lateral_max_m"]) for run in done)
    text = f"{short(rmse)} / {short(largest)}"
    return text if len(done) == len(runs) else f"{text}, {len(done)} of {len(runs)} arrive"


def lines(root):
    with open(root / "docs" / "results" / "worlds.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["part"] == "worlds"]
    for name in CORE:
        cells = [
            cell([r for r in rows
                  if (r["case"], r["road"], r["controller"]) == (world, road, name)])
            for world, road in COLUMNS
        ]
        yield f"| {name} | " + " | ".join(cells) + " |"


def test_the_table_is_that_of_the_report(root):
    text = (root / "README.md").read_text()
    for line in lines(root):
        assert line in text
    printed = TRACKING["lateral_rmse_m"], TRACKING["lateral_max_m"]
    assert f"{1e3 * printed[0]:g} / {1e3 * printed[1]:g} mm" in text  # as the paper prints them
