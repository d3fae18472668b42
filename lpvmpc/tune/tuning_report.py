"""What a tuning leaves behind: weights, report, history, picture."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.control.weights_file import write_weights
from lpvmpc.kit.files import write_json, write_picture, write_text
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import commit, machine, versions
from lpvmpc.kit.report import csv_text, record
from lpvmpc.tune import tuning
from lpvmpc.tune.checkpoint import Result
from lpvmpc.tune.tuning import Stage, Tuned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEARCHES = {"genetic": "genetic algorithm", "pso": "particle swarm"}
"""Names of the searches, as people call them."""

DEFINITIONS = """\
The cost is the paper's, the sum of the RMSEs of lateral error [m], heading error [rad] and speed \
error [m/s], summed over the scenarios, plus {nervous:g} s/rad times the root mean square of the \
commanded steering rate's change from period to period. A car that is lost costs {lost:g} to \
{lost2:g} instead. Weights set by hand are among the first population. No result of this project \
is reported on the scenarios that tune.
"""


def report(tuned: Tuned, before: Sequence[dict[str, Any]], after: Sequence[dict[str, Any]]) -> str:
    """The tuning in Markdown.

    Args:
        tuned: What was found.
        before: Metrics of the scenarios with the weights set by hand.
        after: The same with the tuned ones.
    """
    task = tuned.task
    lines = [
        f"# Weights of {task.controller}, tuned",
        "",
        f"{date.today()}, commit {commit()}, {machine()}. "
        + ", ".join(f"{name} {number}" for name, number in versions().items())
        + f". Seed {task.seed}.",
        "",
        DEFINITIONS.format(
            nervous=tuning.NERVOUS, lost=tuning.LOST, lost2=2.0 * tuning.LOST
        ),
        markdown_table(
            f"Searches, {tuned.evaluations} of at most {task.budget} evaluations",
            ("search", "weights", "population", "generations", "evaluations", "first best",
             "last best", "failed"),
            (_search_row(stage, result) for stage, result in _searches(tuned)),
        ),
        markdown_table(
            "Weights",
            ("weight", "by hand", "tuned", "lowest", "highest"),
            _weight_rows(tuned),
        ),
        markdown_table(
            "Driven on the scenarios that tuned them",
            ("scenario", "weights", "lateral RMSE / largest [mm]", "heading RMSE [rad]",
             "speed RMSE [m/s]", ""),
            _driven_rows(before, after),
        ),
    ]
    for result in tuned.results:
        lines += [
            f"- Generation {f.generation}, individual {f.individual}: {f.text}"
            for f in result.failures
        ]
    scenarios = " ".join(task.scenarios)
    lines.append(
        f"Made by `python eval/tune.py --controller {task.controller} --scenario {scenarios} "
        f"--generations {task.generations} --population {task.population} --seed {task.seed}`."
    )
    return "\n".join(lines) + "\n"


def save(
    tuned: Tuned,
    before: Sequence[dict[str, Any]],
    after: Sequence[dict[str, Any]],
    folder: Path,
) -> list[Path]:
    """Write weights.toml, tuning.md, tuning.json, history.csv and convergence.png.

    Raises:
        OutputError: One of them cannot be written.
    """
    from lpvmpc.picture.figures import DPI

    names = ("weights.toml", "tuning.md", "tuning.json", "history.csv", "convergence.png")
    weights, md, values, table, picture = (folder / name for name in names)
    task = tuned.task
    record = {
        "tuned_on": list(task.scenarios),
        "generations": task.generations,
        "population": task.population,
        "seed": task.seed,
        "evaluations": tuned.evaluations,
        "cost": tuned.results[-1].cost,
        "lpvmpc": versions()["lpvmpc"],
    }
    write_weights(weights, task.controller, tuned.weights, record)
    write_text(md, report(tuned, before, after))
    write_text(table, as_csv(tuned))
    write_picture(picture, draw(tuned), DPI)
    write_json(values, as_json(tuned, before, after))
    return [weights, md, values, table, picture]


def as_json(
    tuned: Tuned, before: Sequence[dict[str, Any]], after: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """One object: what was found, and under which conditions."""
    return {
        "controller": tuned.task.controller,
        "weights": tuned.weights,
        "by_hand": tuned.by_hand,
        "cost": tuned.results[-1].cost,
        "evaluations": tuned.evaluations,
        "budget": tuned.task.budget,
        "before": list(before),
        "after": list(after),
        "task": tuned.task.record(),
        "record": record(),
    }


def as_csv(tuned: Tuned) -> str:
    """Each generation with its best weights."""
    header = ("search", "generation", "best", "mean", "worst", *tuned.weights)
    body = []
    for stage, result in _searches(tuned):
        for number, generation in enumerate(result.history):
            best = stage.space.weights(generation.individual)
            cells = (best.get(name) for name in tuned.weights)
            costs = (f"{c:.9g}" for c in (generation.best, generation.mean, generation.worst))
            body.append((stage.method, number, *costs, *cells))
    return csv_text(header, body)


def draw(tuned: Tuned) -> Figure:
    """Best and mean cost over the evaluations; the searches one after the other."""
    import matplotlib
    from matplotlib.figure import Figure

    from lpvmpc.picture.figures import BLUE, COLUMN, GREY, ORANGE, STYLE

    with matplotlib.rc_context({**matplotlib.rcParamsDefault, **STYLE}):
        figure = Figure(figsize=(COLUMN, 2.4))
        axis = figure.subplots()
        axis.set_title(f"Tuning {tuned.task.controller} on {', '.join(tuned.task.scenarios)}")
        begin = 0
        for (stage, result), colour in zip(_searches(tuned), (BLUE, ORANGE), strict=False):
            first, step = _evaluations(stage)
            count = [begin + first + step * k for k in range(len(result.history))]
            label = SEARCHES[stage.method]
            axis.step(count, [g.best for g in result.history], where="post", color=colour, lw=1.3,
                      label=f"{label}, best")
            axis.plot(count, [g.mean for g in result.history], color=colour, lw=0.8, ls=":",
                      label=f"{label}, mean")
            begin += result.evaluations
        axis.axvline(tuned.task.budget, color=GREY, lw=0.7)
        axis.set_yscale("log")
        axis.set_xlim(0, None)
        axis.set_xlabel("evaluations")
        axis.set_ylabel("cost")
        axis.legend()
        figure.canvas.draw()
    return figure


def _searches(tuned: Tuned) -> list[tuple[Stage, Result]]:
    return list(zip(tuning.stages(tuned.task), tuned.results, strict=True))


def _evaluations(stage: Stage) -> tuple[int, int]:
    """Evaluations of the first population and of each further generation."""
    total, first = stage.settings.evaluations, stage.settings.population
    return first, (total - first) // max(stage.settings.generations, 1)


def _search_row(stage: Stage, result: Result) -> tuple[object, ...]:
    settings, history = stage.settings, result.history
    return (
        SEARCHES[stage.method], len(stage.space.ranges), settings.population,
        settings.generations, result.evaluations, f"{history[0].best:.5f}", f"{result.cost:.5f}",
        len(result.failures),
    )


def _weight_rows(tuned: Tuned) -> list[tuple[str, ...]]:
    ranges: dict[str, tuple[float, float]] = {}
    for stage, _ in _searches(tuned):
        ranges.update(stage.space.ranges)
    rows = []
    for name, value in tuned.weights.items():
        bounds = [f"{bound:g}" for bound in ranges[name]] if name in ranges else ["-", "-"]
        rows.append((name, f"{tuned.by_hand[name]:.4g}", f"{value:.4g}", *bounds))
    return rows


def _driven_rows(
    before: Sequence[dict[str, Any]], after: Sequence[dict[str, Any]]
) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for pair in zip(before, after, strict=True):
        for label, result in zip(("by hand", "tuned"), pair, strict=True):
            rows.append((result["scenario"], label, *numbers(result)))
    return rows


def numbers(result: dict[str, Any]) -> tuple[str, str, str, str]:
    """Errors of a run as text, and why it ended, if it did not complete."""
    def text(key: str, form: str, scale: float = 1.0) -> str:
        value = result[key]
        return "-" if value is None else format(scale * value, form)

    lateral = f"{text('lateral_rmse_m', '.2f', 1e3)} / {text('lateral_max_m', '.1f', 1e3)}"
    reason = "" if result["completed"] else f"lost: {result['reason']}"
    return lateral, text("heading_rmse_rad", ".4f"), text("speed_rmse_mps", ".4f"), reason
