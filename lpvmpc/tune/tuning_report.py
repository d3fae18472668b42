"""What a tuning leaves behind: weights, report, history, picture."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.car.current import current
from lpvmpc.control.weights_file import write_weights
from lpvmpc.kit.files import replacing, write_json, write_picture, write_text
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import commit, machine, versions
from lpvmpc.kit.report import csv_text, record
from lpvmpc.tune import driving, tuning
from lpvmpc.tune.checkpoint import Result
from lpvmpc.tune.tuning import SearchStage, Tuned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEARCHES = {"genetic": "genetic algorithm", "pso": "particle swarm"}
"""Names of the searches, as people call them."""

DEFINITIONS = """\
A weight set drives {runs} runs: each road in each world, every run with its own draw (seeds \
{first} to {last}), the same for all weight sets. The cost c of a run is the sum of the RMSEs of \
lateral error [m], course error [rad] times {course:g} m and speed error [m/s] times {speed:g} s, \
of the commanded steering rate's root mean square [rad/s] times {steering:g} m s and of its change \
from period to period times {nervous:g} m s, over the lateral error of a good run in that world \
({scales}). It saturates, c / (1 + c / {lost:g}); a car that is lost costs {lost:g} to {lost2:g} \
instead, more the earlier it is. The cost of a weight set is the mean of the worst {worst:.0%} of \
its runs plus {plain:g} times the mean of all. A weight set that is certain to be worse than the \
whole population is not driven to its end, which changes no outcome. Weights set by hand are among \
the first population. No result of this project is reported on the roads and draws that tune.
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
        definitions(task),
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
        f"{bounds_sentence(tuned)}\n",
        markdown_table(
            "Driven on the roads and in the worlds that tuned them",
            ("run", "weights", "lateral RMSE / largest [mm]", "course RMSE [rad]",
             "speed RMSE [m/s]", ""),
            driven_rows(task, before, after),
        ),
    ]
    for result in tuned.results:
        lines += [
            f"- Generation {f.generation}, individual {f.individual}: {f.text}"
            for f in result.failures
        ]
    scenarios, worlds = " ".join(task.scenarios), " ".join(task.worlds)
    lines.append(
        f"Made by `python eval/tune.py --controller {task.controller} --scenario {scenarios} "
        f"--worlds {worlds} --seeds {task.seeds} --generations {task.generations} "
        f"--population {task.population} --seed {task.seed}`."
    )
    return "\n".join(lines) + "\n"


def definitions(task: tuning.Task) -> str:
    """What is driven and what it costs, as one paragraph."""
    runs = tuning.runs(task, {})
    scales = {str(run.world): f"{1e3 * driving.scale(run):g} mm in {run.world}" for run in runs}
    return DEFINITIONS.format(
        runs=len(runs), first=runs[0].seed, last=runs[-1].seed, course=driving.COURSE,
        speed=driving.SPEED, steering=driving.STEERING, nervous=driving.NERVOUS,
        scales=", ".join(scales.values()), lost=driving.LOST, lost2=2.0 * driving.LOST,
        worst=driving.WORST, plain=driving.PLAIN,
    )


def bounds_sentence(tuned: Tuned) -> str:
    """Which weights lie on a bound of the search."""
    if not tuned.on_bounds:
        return f"No weight ended within {tuning.NEAR:.0%} of its range from a bound."
    names = ", ".join(tuned.on_bounds)
    return f"Within {tuning.NEAR:.0%} of its range from a bound: {names}."


def save(
    tuned: Tuned,
    before: Sequence[dict[str, Any]],
    after: Sequence[dict[str, Any]],
    folder: Path,
) -> list[Path]:
    """Write weights.toml, tuning.md, tuning.json, history.csv and convergence.png, all together.

    Raises:
        OutputError: One of them cannot be written.
    """
    from lpvmpc.picture.figures import DPI

    names = ("weights.toml", "tuning.md", "tuning.json", "history.csv", "convergence.png")
    task = tuned.task
    record = {
        "tuned_on": list(task.scenarios),
        "worlds": list(task.worlds),
        "draws": [run.seed for run in tuning.runs(task, {})],
        "generations": task.generations,
        "population": task.population,
        "seed": task.seed,
        "evaluations": tuned.evaluations,
        "cost": tuned.results[-1].cost,
        "cost_is": driving.RISK,
        "lpvmpc": versions()["lpvmpc"],
    }
    if (car := current()) is not None:
        record["car_sha256"] = car.sha256
    with replacing(folder, names) as new:
        weights, md, values, table, picture = (new / name for name in names)
        write_weights(weights, task.controller, tuned.weights, record)
        write_text(md, report(tuned, before, after))
        write_text(table, as_csv(tuned))
        write_picture(picture, draw(tuned), DPI)
        write_json(values, as_json(tuned, before, after))
    return [folder / name for name in names]


def as_json(
    tuned: Tuned, before: Sequence[dict[str, Any]], after: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """One object: what was found, and under which conditions."""
    return {
        "controller": tuned.task.controller,
        "weights": tuned.weights,
        "by_hand": tuned.by_hand,
        "cost": tuned.results[-1].cost,
        "cost_is": driving.RISK,
        "on_bounds": list(tuned.on_bounds),
        "draws": [run.seed for run in tuning.runs(tuned.task, {})],
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


def _searches(tuned: Tuned) -> list[tuple[SearchStage, Result]]:
    return list(zip(tuning.stages(tuned.task), tuned.results, strict=True))


def _evaluations(stage: SearchStage) -> tuple[int, int]:
    """Evaluations of the first population and of each further generation."""
    total, first = stage.settings.evaluations, stage.settings.population
    return first, (total - first) // max(stage.settings.generations, 1)


def _search_row(stage: SearchStage, result: Result) -> tuple[object, ...]:
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


def driven_rows(
    task: tuning.Task, before: Sequence[dict[str, Any]], after: Sequence[dict[str, Any]]
) -> list[tuple[str, ...]]:
    """Each run of a task with the weights set by hand and with the tuned ones."""
    rows: list[tuple[str, ...]] = []
    for run, *pair in zip(tuning.runs(task, {}), before, after, strict=True):
        for label, result in zip(("by hand", "tuned"), pair, strict=True):
            rows.append((f"{run.label} {run.seed}", label, *numbers(result)))
    return rows


def numbers(result: dict[str, Any]) -> tuple[str, str, str, str]:
    """Errors of a run as text, and why it ended, if it did not complete."""
    def text(key: str, form: str, scale: float = 1.0) -> str:
        value = result[key]
        return "-" if value is None else format(scale * value, form)

    lateral = f"{text('lateral_rmse_m', '.2f', 1e3)} / {text('lateral_max_m', '.1f', 1e3)}"
    reason = "" if result["completed"] else f"lost: {result['reason']}"
    return lateral, text("course_rmse_rad", ".4f"), text("speed_rmse_mps", ".4f"), reason
