"""The paper's numbers beside ours; what was not measured is None."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from lpvmpc.paper.measurements import Evidence
from lpvmpc.paper.records import Training
from lpvmpc.paper.runs import LMPC, OURS, PAPERS, PLAIN
from lpvmpc.published import BASELINE, HEADING_MAX_DEG, LOSSES, SOLVE_MEAN_MS, TRACKING
from lpvmpc.tune import sphere

DEGREE = 180.0 / math.pi
Value = float | str | None


@dataclass(frozen=True, kw_only=True)
class Number:
    """One number of the paper beside ours."""

    key: str
    """Name in the files."""
    group: str
    """Table that it belongs to, a key of `TABLES`."""
    text: str
    """What it is."""
    unit: str = ""
    """Unit of all values."""
    paper: Value = None
    """What the paper prints; None where it prints nothing."""
    ours: Value = None
    """Ours; None where it was not measured."""
    third: Value = None
    """Ours at a third of the wind speed, as in the authors' code; None elsewhere."""
    remark: str = ""
    """What has to be known to compare them."""
    digits: int = 3
    """Digits that are shown."""


TABLES = {
    "tracking": "Tracking on the paper's road",
    "baseline": "The baseline: LMPC with PSO-PID on the paper's road",
    "computation": "Computation",
    "network": "The network",
    "search": "The genetic algorithm",
    "conditions": "Conditions",
}
"""Tables of numbers and their titles."""
PAPER_RATIO = {key: BASELINE[key] / TRACKING[key] for key in BASELINE}
"""How many times larger the baseline's errors are in the paper."""
IMPOSSIBLE = "impossible: below its own RMSE"


def numbers(e: Evidence) -> list[Number]:
    """Every number of the paper, with ours."""
    return [*_tracking(e), *_baseline(e), *_computation(e), *_network(e), *_search(e),
            *_conditions(e)]


def _tracking(e: Evidence) -> Iterable[Number]:
    for key, text, unit, paper, scale, remark in (
        ("lateral_rmse_m", "lateral error, RMSE", "m", TRACKING["lateral_rmse_m"], 1.0, ""),
        ("lateral_max_m", "lateral error, largest", "m", TRACKING["lateral_max_m"], 1.0, ""),
        ("heading_rmse_rad", "heading error, RMSE", "rad", TRACKING["heading_rmse_rad"], 1.0,
         "contains the angle that a car in side wind must have"),
        ("heading_max_rad", "heading error, largest", "deg", HEADING_MAX_DEG, DEGREE, "the same"),
        ("course_rmse_rad", "course error, RMSE", "rad", None, 1.0,
         "heading plus sideslip: the direction of motion"),
        ("speed_rmse_mps", "speed error, RMSE", "m/s", TRACKING["speed_rmse_mps"], 1.0, ""),
        ("speed_max_mps", "speed error, largest", "m/s", TRACKING["speed_max_mps"], 1.0,
         f"paper's {IMPOSSIBLE}"),
    ):
        ours, third = (_scaled(_get(e, OURS, case, key), scale)
                       for case in ("paper", "paper-third"))
        yield Number(key=key, group="tracking", text=text, unit=unit, paper=paper, ours=ours,
                     third=third, remark=remark)


def _baseline(e: Evidence) -> Iterable[Number]:
    names = {"lateral_rmse_m": ("lateral error, RMSE", "m"),
             "speed_rmse_mps": ("speed error, RMSE", "m/s")}
    for key, (text, unit) in names.items():
        ours, third = (_get(e, LMPC, case, key) for case in ("paper", "paper-third"))
        yield Number(key=f"lmpc_{key}", group="baseline", text=text, unit=unit,
                     paper=BASELINE[key], ours=ours, third=third)
    for other, than, remark in (
        (OURS, "ours", ""), (PAPERS, PAPERS, "the comparison that the paper makes"),
        (PLAIN, PLAIN, "the same without the network"),
    ):
        for key, (text, _) in names.items():
            ours, third = (ratio(e, key, other=other, case=case)
                           for case in ("paper", "paper-third"))
            what = text.partition(" ")[0]
            yield Number(key=f"{other}_ratio_{key}", group="baseline", unit="times",
                         text=f"{what} RMSE over that of {than}", paper=PAPER_RATIO[key],
                         ours=ours, third=third, remark=remark)
    yield _aggressive(e)


def _aggressive(e: Evidence) -> Number:
    """The paper says of the PSO-PID that it is more aggressive, and gives no number."""
    jerk = {}
    for name in (LMPC, OURS):
        change = np.diff(e.logs[name].columns["ax_cmd_mps2"]) / float(e.logs[name].meta["Ts"])
        jerk[name] = float(np.sqrt(np.mean(np.square(change))))
    value = jerk[LMPC] / jerk[OURS] if jerk[OURS] > 0.0 else None
    return Number(key="jerk_ratio", group="baseline", unit="times", paper="larger", ours=value,
                  text="RMS of the commanded jerk over ours",
                  remark='"more aggressive, as it cannot handle constraints"')


def _computation(e: Evidence) -> Iterable[Number]:
    times = e.logs[OURS].timing
    solve, step = (1e-3 * np.asarray(times[name], dtype=float) for name in ("solve_us", "step_us"))
    mean = float(step.mean())
    for key, text, unit, paper, ours, remark in (
        ("solve_mean_ms", "mean time to solve", "ms", SOLVE_MEAN_MS, float(solve.mean()),
         "paper: Gurobi through Yalmip, Ryzen 7 5800H; ours: ProxQP, this machine"),
        ("step_mean_ms", "mean time of a control step", "ms", None, mean,
         "adaptation, model, QP, solve, check"),
        ("step_p99_ms", "99th percentile of a control step", "ms", None,
         float(np.percentile(step, 99.0)), "of a period of 33 ms"),
        ("rate_hz", "rate that the mean allows", "Hz", 95.0, 1e3 / mean,
         "paper: 1 / 11.3 ms is 88 Hz, not 95"),
    ):
        yield Number(key=key, group="computation", text=text, unit=unit, paper=paper, ours=ours,
                     remark=remark)


def _network(e: Evidence) -> Iterable[Number]:
    theirs, ours = e.trainings.get("network-secant"), e.trainings.get("network")
    last = theirs.curve[-1] if theirs else (None, None, None)

    def score(training: Training | None, split: str, part: str) -> float | None:
        return training.median(split, part) if training else None

    def spread(training: Training | None, split: str, part: str) -> str:
        return training.spread(split, part) if training else ""

    for key, text, paper, value, remark in (
        ("r2_train", "R2, training, random split", 0.88, score(theirs, "random", "train"),
         spread(theirs, "random", "train")),
        ("r2_test", "R2, test, random split", 0.78, score(theirs, "random", "test"),
         f"{spread(theirs, 'random', 'test')}; leaks: neighbouring samples are almost equal"),
        ("r2_runs_train", "R2, training, runs held out", None, score(theirs, "runs", "train"),
         spread(theirs, "runs", "train")),
        ("r2_runs_test", "R2, test, runs held out", None, score(theirs, "runs", "test"),
         f"{spread(theirs, 'runs', 'test')}; whole runs are new to the network"),
        ("loss_train", "loss, training", LOSSES["training"], last[1],
         "ours: runs held out; paper's is not 1 - R2, 0.12, as it should be"),
        ("loss_test", "loss, validation", LOSSES["validation"], last[2], "ours: runs held out"),
        ("samples", "samples", 10752.0, float(theirs.samples) if theirs else None,
         "paper: CarSim; ours: the MuJoCo car"),
        ("r2_ours_test", "R2 of our network, runs held out", None, score(ours, "runs", "test"),
         f"{spread(ours, 'runs', 'test')}; another network, given slip, load, forces, friction"),
    ):
        yield Number(key=key, group="network", text=text, paper=paper, ours=value, remark=remark)
    for kind, name in (("network-secant", "paper's network"), ("network", "our network")):
        for axle, value in zip(("front", "rear"), e.stiffness.r2(kind), strict=True):
            yield Number(key=f"r2_driven_{kind}_{axle}", group="network", ours=value,
                         text=f"R2 along {e.stiffness.title}, {name}, {axle}",
                         remark="a driven lap that is in no data (Fig. 5); true state, dry road"
                         + (", true slip and drive force" if kind == "network" else ""))


def _search(e: Evidence) -> Iterable[Number]:
    for variant in (e.sphere.printed, e.sphere.ours):
        seeds = len(variant.selections[0].seeds)
        for runs in variant.selections:
            yield Number(
                key=f"sphere_{variant.key}_{runs.selection}", group="search", digits=5,
                text=f"sphere, {variant.text}, {runs.selection}",
                paper=sphere.PAPER[runs.selection],
                ours=sphere.OPTIMUM + float(np.median(runs.final)),
                remark=f"optimum {sphere.OPTIMUM:g}; paper: one run, ours: median of {seeds}",
            )
    tuned = e.tunings.get(OURS)
    for key, text, unit, paper in (
        ("lateral_rmse_m", "tuned: lateral RMSE", "m", TRACKING["lateral_rmse_m"]),
        ("heading_rmse_rad", "tuned: heading RMSE", "rad", TRACKING["heading_rmse_rad"]),
        ("speed_rmse_mps", "tuned: speed RMSE", "m/s", TRACKING["speed_rmse_mps"]),
    ):
        worst = None
        if tuned is not None and all(result["completed"] for result in tuned.after):
            worst = max(float(result[key]) for result in tuned.after)
        yield Number(key=f"tuned_{key}", group="search", text=text, unit=unit, paper=paper,
                     ours=worst, remark="paper: the test itself tunes; ours: worst tuning road")


def _conditions(e: Evidence) -> Iterable[Number]:
    c = e.logs[OURS].columns
    for key, text, unit, paper, column, remark in (
        ("wind", "side wind", "m/s", "25 to 50", "wind_mps",
         "the authors' code divides it by 3 and puts it 0.4 m behind the centre of mass"),
        ("speed", "reference speed", "m/s", "5 to 21", "vx_ref_mps",
         "the loop of Fig. 8 would ask for 60 m/s2; the authors' signals do not"),
    ):
        span = f"{c[column].min():.3g} to {c[column].max():.3g}"
        yield Number(key=key, group="conditions", text=text, unit=unit, paper=paper, ours=span,
                     remark=remark)
    yield Number(key="friction", group="conditions", text="friction 0.82",
                 paper="a drag of 12.7 kN", ours="the tires' peak",
                 remark="as printed it would brake with 8 m/s2")
    yield Number(key="weights", group="conditions", text="entries of Q for five states",
                 paper=6.0, ours=5.0, remark="unusable as printed")


def ratio(
    e: Evidence, key: str, *, other: str = OURS, case: str = "paper", lmpc: str = "tuned",
    ours: str = "tuned",
) -> float | None:
    """How many times larger an error of the baseline is than another controller's.

    Args:
        e: The evidence.
        key: Which error.
        other: The other controller.
        case: The road.
        lmpc: Weights of the baseline: `tuned` or `by hand`.
        ours: Weights of the other.
    """
    a, b = (_get(e, name, case, key, group) for name, group in ((LMPC, lmpc), (other, ours)))
    return None if a is None or b is None else a / b


def _get(e: Evidence, name: str, case: str, key: str, group: str = "tuned") -> float | None:
    """A metric of a controller; None where it was not driven, or lost the car."""
    row = e.get(group, name, case)
    return None if row is None else row.get(key)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
