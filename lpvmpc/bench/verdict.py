"""What follows from the ablation: each promise with its figure and limit, and sentences.

Everything here is computed from the rows, whichever way it falls; a figure that was not measured
(a quick run) has no verdict.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable

from lpvmpc.bench.cases import (
    DRY,
    GRIPS,
    MODELS,
    PLAIN,
    STEPS,
    DrivenCase,
    FactorSearch,
    geometric_mean,
)
from lpvmpc.kit.findings import Finding, Limit

MATTERS = 1.1
"""Two errors count as different where their ratio is at least this."""
DIGITS = 3
"""Of a limit as it is printed."""


class Results:
    """The rows by case, model and observer."""

    def __init__(self, rows: Iterable[DrivenCase]) -> None:
        self.rows = list(rows)
        self._by_key = {(r.case.key, r.model.key, r.observer): r for r in self.rows}

    def get(self, case: str, model: str, observer: bool = True) -> DrivenCase | None:
        """A row; None where it was not driven."""
        return self._by_key.get((case, model, observer))

    def rmse(self, case: str, model: str, observer: bool = True) -> float | None:
        """Lateral RMSE [m], charged where the car was lost; None where it was not driven."""
        row = self.get(case, model, observer)
        return None if row is None else row.rmse

    def largest(self, case: str, model: str, observer: bool = True) -> float | None:
        """Largest lateral error [m], likewise."""
        row = self.get(case, model, observer)
        return None if row is None else row.largest

    def constant(self, case: str, observer: bool = True) -> DrivenCase | None:
        """The better of the two constants in a case: the nominal one may suit an easy road."""
        rows = [self.get(case, key, observer) for key in ("constant", "constant-best")]
        known = [row for row in rows if row is not None]
        return min(known, key=lambda row: row.rmse) if known else None

    def gain(self, case: str, model: str, observer: bool = True) -> float | None:
        """How many times smaller the RMSE of a model is than the better constant's."""
        constant, row = self.constant(case, observer), self.get(case, model, observer)
        return None if constant is None or row is None else constant.rmse / row.rmse

    def of(self, model: str, observer: bool) -> list[DrivenCase]:
        """All rows of a model in which it was not made wrong, in their order."""
        return [
            r for r in self.rows
            if r.model.key == model and r.observer == observer and not r.case.wrong
        ]


def bars(table: Results) -> list[Finding]:
    """The promises about the network, each with its figure; errors in mm, lost runs charged."""
    return [
        *_accuracy(table),
        Finding(
            key="gain_over_constant",
            figure="76 %: best constant, no observer / ours",
            value=_gain_over_constant(table),
            unit="times",
            limit=Limit.at_least(1.5, DIGITS),
        ),
        *_friction(table),
        *_wrong(table),
        *_beside_the_oracle(table),
    ]


def _gain_over_constant(table: Results) -> float | None:
    constant, ours = table.constant("circuit-0.76", False), table.get("circuit-0.76", "network")
    return None if constant is None or ours is None else constant.rmse / ours.rmse


def _accuracy(table: Results) -> Iterable[Finding]:
    for grip, rmse, largest in ((0.76, 3.0, 20.0), (0.87, 5.0, 40.0), (0.92, 8.0, 60.0),
                                (0.96, None, 100.0)):
        case, title = f"circuit-{grip:g}", f"{100 * grip:.0f} %"
        if rmse is not None:
            yield _in_mm(f"{case}_rmse", f"{title}: RMSE", table.rmse(case, "network"), rmse)
        value = table.largest(case, "network")
        yield _in_mm(f"{case}_largest", f"{title}: largest", value, largest)
        row = table.get(case, "network")
        off = None
        if row is not None:
            off = 100.0 * abs(float(row.result["duration_s"] or 0.0)
                              / float(row.result["reference_duration_s"] or 1.0) - 1.0)
        yield Finding(
            key=f"{case}_duration_percent",
            figure=f"{title}: duration off",
            value=off,
            unit="%",
            limit=Limit.at_most(2.0, DIGITS),
        )


def _in_mm(key: str, figure: str, value: float | None, limit: float | None) -> Finding:
    """A length [m] that may be so many millimetres; a limit of None is not known."""
    return Finding(
        key=f"{key}_mm",
        figure=figure,
        value=_mm(value),
        unit="mm",
        limit=None if limit is None else Limit.at_most(limit, DIGITS),
    )


def _friction(table: Results) -> Iterable[Finding]:
    for case, figure, limit in (
        ("slippery-0.8", "friction 0.5, 80 %: largest", 20.0),
        ("slippery-0.92", "friction 0.5, 92 %: largest", 60.0),
        ("drop", "drop to 0.75 at 76 %: largest", 150.0),
    ):
        yield _in_mm(f"{case}_largest", figure, table.largest(case, "network"), limit)
    steps = [table.largest(f"step-{s:.0f}", "network") for s in STEPS]
    worst = None if None in steps else max(value for value in steps if value is not None)
    figure = f"step to 0.5, worst of {len(steps)} bends: largest"
    yield _in_mm("step_largest", figure, worst, 300.0)


def _wrong(table: Results) -> Iterable[Finding]:
    for model in ("network", "network-secant"):
        rows = [r for r in table.rows if r.case.wrong and r.model.key == model and r.observer]
        yield Finding(
            key=f"{model}_wrong_lost",
            figure=f"{model} made wrong: lost runs",
            value=float(sum(not r.completed for r in rows)) if rows else None,
            unit=f"of {len(rows)}",
            limit=Limit.at_most(0.0),
        )


def _beside_the_oracle(table: Results) -> Iterable[Finding]:
    """Up to 87 % at most 1.3 times the oracle's error and 1 mm, at 92 % twice the oracle's."""
    for what, measure in (("rmse", table.rmse), ("largest", table.largest)):
        for grip in (grip for grip in GRIPS if grip <= 0.92):
            case = f"circuit-{grip:g}"
            own, oracle = measure(case, "network"), measure(case, "oracle")
            factor, more = (1.3, 1.0) if grip <= 0.87 else (2.0, 0.0)
            name = "RMSE" if what == "rmse" else what
            yield _in_mm(
                f"{case}_{what}_beside_oracle",
                f"{100 * grip:.0f} %: {name} beside the oracle",
                None if oracle is None else own,
                None if oracle is None else factor * (1e3 * oracle) + more,
            )


# Sentences ----------------------------------------------------------------------------------------


def sentences(table: Results, searches: dict[bool, FactorSearch]) -> list[str]:
    """What the numbers say, one statement each."""
    told: list[Callable[[], str | None]] = [
        lambda: _best_constant(searches),
        lambda: _on_paper(table),
        lambda: _over_grip(table, "network"),
        lambda: _over_grip(table, "network-secant"),
        lambda: _two_networks(table),
        lambda: _survival(table),
        lambda: _observer(table),
        lambda: _friction_sentence(table),
        lambda: _estimate(table),
        lambda: _robustness(table),
        lambda: _claim(table),
    ]
    return [sentence for tell in told if (sentence := tell()) is not None]


def _best_constant(searches: dict[bool, FactorSearch]) -> str:
    parts = []
    for observer, found in sorted(searches.items(), reverse=True):
        at_end = ", at the end of what was tried," if found.at_an_end else ""
        parts.append(f"x{found.best:g}{at_end} {_with(observer)}")
    softer = all(found.best < 1.0 for found in searches.values())
    stiffer = all(found.best > 1.0 for found in searches.values())
    kind = "softer than" if softer else "stiffer than" if stiffer else "not always softer than"
    return f"The best constant stiffness is {kind} the nominal one: {' and '.join(parts)}."


def _on_paper(table: Results) -> str | None:
    parts = []
    for observer in (True, False):
        constant, ours = table.constant("paper", observer), table.get("paper", "network", observer)
        if constant is None or ours is None:
            return None
        parts.append(f"{_with(observer)} {judged(constant.rmse / ours.rmse)} "
                     f"({1e3 * constant.rmse:.2f} and {1e3 * ours.rmse:.2f} mm)")
    return (
        "On the paper's road in its wind, the network in place of the better constant "
        f"{' and '.join(parts)}."
    )


def _over_grip(table: Results, model: str) -> str | None:
    parts = []
    for observer in (True, False):
        gains = {g: table.gain(f"circuit-{g:g}", model, observer) for g in GRIPS}
        known = {g: gain for g, gain in gains.items() if gain is not None}
        if not known:
            return None
        low, high = min(known, key=known.__getitem__), max(known, key=known.__getitem__)
        parts.append(f"{_with(observer)} {known[low]:.2g} times (at {100 * low:.0f} %) to "
                     f"{known[high]:.2g} times (at {100 * high:.0f} %)")
    return (
        f"On circuit without wind, the RMSE of {model} is smaller than the better constant's "
        f"{' and '.join(parts)}."
    )


def _two_networks(table: Results) -> str | None:
    parts = []
    for observer in (True, False):
        pairs = [
            theirs.rmse / ours.rmse
            for ours in table.of("network", observer)
            if (theirs := table.get(ours.case.key, "network-secant", observer)) is not None
        ]
        if not pairs:
            return None
        better = sum(ratio >= MATTERS for ratio in pairs)
        worse = sum(ratio <= 1.0 / MATTERS for ratio in pairs)
        parts.append(f"{_with(observer)} better in {better}, worse in {worse}, alike in "
                     f"{len(pairs) - better - worse} of {len(pairs)} cases, median factor "
                     f"{statistics.median(pairs):.2g}")
    return f"Our network against the paper's: {'; '.join(parts)}."


def _survival(table: Results) -> str | None:
    parts = []
    for model in (*MODELS, DRY, PLAIN):
        for observer in (True, False):
            lost = [row for row in table.of(model.key, observer) if not row.completed]
            if lost:
                where = ", ".join(
                    f"circuit at {row.case.title}" if row.case.group == "grip" else row.case.title
                    for row in lost
                )
                how = "" if model is PLAIN else f" {_with(observer)}"
                parts.append(f"{model.key}{how} ({where})")
    if not table.rows:
        return None
    return f"The car was lost by {', '.join(parts)}." if parts else "No model lost the car."


def _observer(table: Results) -> str | None:
    parts, lost = [], []
    for key in ("constant", "constant-best", "network-secant", "network"):
        pairs = [
            (without, with_it)
            for without in table.of(key, False)
            if (with_it := table.get(without.case.key, key, True)) is not None
        ]
        if not pairs:
            continue
        both = [(a.rmse, b.rmse) for a, b in pairs if a.completed and b.completed]
        if both:
            factor = geometric_mean(without / with_it for without, with_it in both)
            parts.append(f"{factor:.2g} times for {key}")
        more = sum(not b.completed for _, b in pairs) - sum(not a.completed for a, _ in pairs)
        if more:
            runs = "run" if abs(more) == 1 else "runs"
            lost.append(f"{abs(more)} {runs} {'more' if more > 0 else 'fewer'} by {key}")
    if not parts:
        return None
    price = f"; with it are lost {', '.join(lost)}" if lost else "; it costs and saves no run"
    return (
        "The observer makes the RMSE smaller, where the car is lost neither with it nor without "
        f"it, by (geometric mean) {', '.join(parts)}{price}."
    )


def _friction_sentence(table: Results) -> str | None:
    cases = ["drop", *(f"step-{s:.0f}" for s in STEPS)]
    ours = [row for key in cases if (row := table.get(key, "network")) is not None]
    known = [row for key in cases if (row := table.get(key, "oracle")) is not None]
    if not ours or len(ours) != len(known):
        return None
    factor = geometric_mean(a.rmse / b.rmse for a, b in zip(ours, known, strict=True))
    lost = sum(not row.completed for row in ours)
    return (
        f"Friction that nobody announced: the network, which estimates it, lost {lost} of "
        f"{len(ours)} runs; its RMSE is {factor:.2g} times that of the oracle, which is told."
    )


def _estimate(table: Results) -> str | None:
    """What estimating friction is worth, beside leaving it to the observer."""
    pairs = [
        (known, dry)
        for dry in table.of("network-dry", True)
        if (known := table.get(dry.case.key, "network", True)) is not None
    ]
    if not pairs:
        return None
    factor = geometric_mean(dry.rmse / known.rmse for known, dry in pairs)
    kept = "is kept" if factor >= 1.0 else "is kept although it does worse"
    lost = [sum(not pair[i].completed for pair in pairs) for i in range(2)]
    return (
        f"On slippery roads the network that estimates friction {kept}: one that takes the road to "
        f"be dry, and leaves the rest to the observer, has {factor:.2g} times its RMSE (geometric "
        f"mean of {len(pairs)} cases) and loses {lost[1]} of them against {lost[0]}."
    )


def _robustness(table: Results) -> str | None:
    """How bad the worst of the models made wrong is."""
    parts = []
    for key in ("constant", "network-secant", "network"):
        right = table.get("circuit-0.87", key)
        rows = [r for r in table.rows if r.case.wrong and r.model.key == key and r.observer]
        if right is None or not rows:
            return None
        worst = max(rows, key=lambda row: row.rmse)
        parts.append(f"{key} from {1e3 * right.rmse:.2g} to {1e3 * worst.rmse:.2g} mm "
                     f"({worst.case.title})")
    return (
        "Made wrong by x0.7, x1.3 or 10 % noise, at 87 % of the grip and with the observer, the "
        f"RMSE grows at the worst for {', for '.join(parts)}."
    )


def _claim(table: Results) -> str | None:
    parts = []
    for observer in (True, False):
        ratios = [
            constant.rmse / secant.rmse
            for secant in table.of("network-secant", observer)
            if (constant := table.constant(secant.case.key, observer)) is not None
        ]
        if not ratios:
            return None
        better = sum(ratio >= MATTERS for ratio in ratios)
        worse = sum(ratio <= 1.0 / MATTERS for ratio in ratios)
        holds = "holds" if better > worse else "does not hold"
        parts.append(
            f"{_with(observer)} it is better in {better}, worse in {worse} and alike in "
            f"{len(ratios) - better - worse} of {len(ratios)} cases, so the claim {holds} there"
        )
    return (
        "The paper's claim is that stiffness predicted by its network makes the LPV-MPC better. In "
        f"our controller, against the better constant: {'; '.join(parts)}."
    )


def judged(ratio: float) -> str:
    """A ratio of errors, before over after, in words."""
    if ratio >= MATTERS:
        return f"helps {ratio:.2g} times"
    if ratio <= 1.0 / MATTERS:
        return f"hurts {1.0 / ratio:.2g} times"
    return "changes nothing that matters"


def _with(observer: bool) -> str:
    return "with the observer" if observer else "without it"


def _mm(value: float | None) -> float | None:
    return None if value is None else 1e3 * value
