"""The report on the sphere function: Markdown, CSV, JSON and a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import csv_text, record, versions_line, write_report
from lpvmpc.tune.sphere import (
    BAR,
    LOWER,
    OPTIMUM,
    PAPER,
    SELECTIONS,
    UPPER,
    Study,
    compare,
    difference,
    p_text,
    verdict,
)
from lpvmpc.units import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVERY = 10
"""Generations between two columns of the CSV."""


def report(study: Study) -> str:
    """The report in Markdown."""
    s, seeds = study.settings, study.selections[0].seeds
    mixed = float(np.median(study.of("mixed").final))
    rows = [
        (
            runs.selection,
            *_spread(runs.final),
            f"{PAPER[runs.selection] - OPTIMUM:.3f}",
            "never" if (g := runs.reaches(PAPER[runs.selection] - OPTIMUM)) is None else g,
        )
        for runs in study.selections
    ]
    pairs = [
        (f"{c.one} against {c.other}", f"{c.nearer:.0%}", p_text(c.p)) for c in compare(study)
    ]
    choice = [(runs.crossover, *_spread(runs.final)) for runs in study.crossovers]
    other = study.crossovers[0].seeds
    lines = [
        "# Genetic algorithm on the sphere function",
        "",
        f"Machine: {machine()}.",
        versions_line(),
        f"Seeds {seeds[0]} to {seeds[-1]}, one run each.",
        "",
        "Definitions: the cost is x1^2 + ... + x5^2 within the bounds of the authors' code, "
        f"{_bounds()}, so that the optimum costs exactly {OPTIMUM:g}. The distance is the best "
        f"cost of a run minus that. A run has {s.generations} generations and a population of "
        f"{s.population}: {s.evaluations} calls of the cost. Offspring {s.offspring:g}, pressure "
        f"{s.pressure:g}, mutation rate {s.mutation_rate:g} and sigma {s.sigma:g} of each "
        "variable's range are Table 1's; the authors' script for this figure has pressure 0.8, "
        "rate 0.25 and sigma 0.15 in the variables' own units.",
        "",
        markdown_table(
            "Distance to the optimum after the last generation",
            ("selection", "median", "quartiles", "worst", "paper", "reached"),
            rows,
        ),
        '"Paper" is the cost printed there minus the optimum: one number each, no spread. '
        '"Reached" is the generation at which our median run is as near as that.',
        "",
        f"Bar: median distance of the mixed selection <= {BAR:g}. It is {mixed:.2g}: "
        f"{'met' if mixed <= BAR else 'MISSED'}.",
        "",
        markdown_table(
            "Comparison by ranks", ("selections", "first is nearer", "p (Holm)"), pairs
        ),
        '"First is nearer": share of all pairs of one run of each. p: Mann-Whitney, two-sided, '
        "adjusted for three comparisons. For equal seeds the selections share the first "
        "population, which can only make the tests more cautious.",
        "",
        f"Verdict: {verdict(study)}",
        "",
        "![Convergence](sphere.png)",
        "",
        "The median over the seeds, and the band from the lower to the upper quartile.",
        "",
        markdown_table(
            f"The crossover, chosen on seeds {other[0]} to {other[-1]} (mixed selection)",
            ("crossover", "median", "quartiles", "worst"),
            choice,
        ),
        '"Exchange" swaps single values of the parents; "blend", which we use, draws each '
        f"variable between them or up to {s.reach:g} of their distance beyond, as the authors' "
        "code does. Both are uniform crossovers, and the paper does not say which it means.",
        "",
        "Made by `python eval/tune.py --sphere`; all runs are in sphere.csv beside this file.",
    ]
    return "\n".join(lines) + "\n"


def as_csv(study: Study) -> str:
    """One line per run, with its distance every few generations."""
    last = study.settings.generations
    told = sorted({*range(0, last, EVERY), last})
    header = ("part", "selection", "crossover", "seed", *(f"distance_{g}" for g in told))
    body = []
    for part, several in (("selection", study.selections), ("crossover", study.crossovers)):
        for runs in several:
            for seed, row in zip(runs.seeds, runs.distances[:, told], strict=True):
                body.append((part, runs.selection, runs.crossover, seed, *row))
    return csv_text(header, body)


def as_json(study: Study) -> dict[str, Any]:
    """One object: what was printed, and under which conditions."""
    mixed = float(np.median(study.of("mixed").final))
    return {
        "optimum": OPTIMUM,
        "selections": {
            runs.selection: {**_numbers(runs.final), "paper": PAPER[runs.selection] - OPTIMUM}
            for runs in study.selections
        },
        "crossovers": {runs.crossover: _numbers(runs.final) for runs in study.crossovers},
        "kruskal_p": difference(study),
        "comparisons": [vars(c) for c in compare(study)],
        "verdict": verdict(study),
        "bars": {"mixed_median": {"limit": BAR, "ok": mixed <= BAR}},
        "record": record(
            seeds=list(study.selections[0].seeds), settings=vars(study.settings)
        ),
    }


def draw(study: Study) -> Figure:
    """Convergence of the three selections: median and quartiles (the paper's Fig. 6)."""
    import matplotlib
    from matplotlib.figure import Figure

    from lpvmpc.picture.figures import BLUE, COLUMN, GREEN, ORANGE, STYLE

    colours = dict(zip(SELECTIONS, (BLUE, ORANGE, GREEN), strict=True))
    dashes = dict(zip(SELECTIONS, ("-", (0, (4, 2)), (0, (1, 1.2))), strict=True))
    with matplotlib.rc_context({**matplotlib.rcParamsDefault, **STYLE}):
        figure = Figure(figsize=(COLUMN, 2.6))
        axis = figure.subplots()
        seeds = len(study.selections[0].seeds)
        axis.set_title(f"Genetic algorithm on the sphere function, {seeds} seeds")
        for runs in reversed(study.selections):
            low, middle, high = np.quantile(runs.distances, (0.25, 0.5, 0.75), axis=0)
            generation = np.arange(middle.size)
            colour = colours[runs.selection]
            axis.fill_between(generation, low, high, color=colour, alpha=0.15, lw=0.0)
            axis.plot(generation, middle, color=colour, ls=dashes[runs.selection], lw=1.2,
                      label=runs.selection)
            axis.plot(generation[-1], PAPER[runs.selection] - OPTIMUM, "D", ms=4.0, color=colour,
                      mec="black", mew=0.5, clip_on=False, zorder=5)
        axis.plot([], [], "D", ms=4.0, color="white", mec="black", mew=0.5, label="paper")
        axis.axhline(BAR, color="black", lw=0.7, label=f"bar for mixed, {BAR:g}")
        axis.set_yscale("log")
        axis.set_xlim(0, study.settings.generations)
        axis.set_xlabel("generation")
        axis.set_ylabel(f"best cost − {OPTIMUM:g}")
        handles, labels = axis.get_legend_handles_labels()
        order = [labels.index(name) for name in (*SELECTIONS, *labels[len(SELECTIONS) :])]
        axis.legend([handles[i] for i in order], [labels[i] for i in order], ncols=2)
        figure.canvas.draw()
    return figure


def save(study: Study, folder: Path) -> list[Path]:
    """Write sphere.md, sphere.csv, sphere.json and sphere.png.

    Raises:
        OutputError: One of them cannot be written.
    """
    from lpvmpc.picture.style import DPI

    return write_report(
        folder,
        "sphere",
        text=report(study),
        table=as_csv(study),
        values=as_json(study),
        picture=draw(study),
        dpi=DPI,
    )


def _spread(distances: Array) -> tuple[str, str, str]:
    """Median, quartiles and largest as text."""
    low, middle, high = np.quantile(distances, (0.25, 0.5, 0.75))
    return f"{middle:.2g}", f"{low:.2g} to {high:.2g}", f"{distances.max():.2g}"


def _numbers(distances: Array) -> dict[str, float]:
    """The same as numbers."""
    low, middle, high = np.quantile(distances, (0.25, 0.5, 0.75)).tolist()
    return {
        "median": middle, "lower_quartile": low, "upper_quartile": high,
        "worst": float(distances.max()),
    }


def _bounds() -> str:
    """The bounds as text."""
    pairs = zip(LOWER, UPPER, strict=True)
    return ", ".join(f"[{low:g}, {high:g}]" for low, high in pairs)
