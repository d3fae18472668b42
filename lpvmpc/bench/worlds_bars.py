"""What `lpv-mpc` was promised to do outside the perfect world: figures with limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from lpvmpc.bench.margins import Margin
from lpvmpc.bench.worlds import DEVIATIONS, OURS, ROADS, DrivenCell
from lpvmpc.bench.worlds_stats import Summary
from lpvmpc.bench.worlds_verdict import Found
from lpvmpc.kit.findings import Finding, Limit

IDEAL = {"paper": (0.8, 3.0), "circuit-65": (1.0, 5.0), "circuit-87": (1.6, 8.0)}
"""RMSE and largest error in the ideal world [mm]."""
ALONE = {"paper": (2.0, 15.0), "circuit-65": (2.0, 15.0), "circuit-87": (3.0, 25.0)}
"""The same with any one deviation."""
TOLD = {"delay-3": (2.0, 12.0), "delay-6": (4.0, 40.0)}
"""The same with a delay that is told."""
SURVIVED = "latency-40"
"""A deviation that need only be survived."""
APART = ("nominal", "raw-noise", SURVIVED, *TOLD)
"""Deviations that are none of the above, or have limits of their own."""
SENSED = {
    ("rtk", "paper"): (4.0, 20.0),
    ("rtk", "circuit-65"): (5.0, 25.0),
    ("rtk", "circuit-87"): (6.0, 40.0),
    ("rtk", "circuit-92"): (9.0, 70.0),
    ("combined", "paper"): (6.0, 25.0),
    ("combined", "circuit-65"): (7.0, 35.0),
    ("combined", "circuit-87"): (7.0, 35.0),
}
"""Median RMSE and worst largest error with sensors and filter [mm]."""
FLEET = {"paper": 10.0, "circuit-65": 12.0}
"""95th percentile of the RMSE in `fleet` [mm]."""
FLEET_LARGEST = 100.0
"""Worst largest error there [mm]."""
FLEET_80 = 99.0
"""Completed runs in `fleet` on circuit 80 % [%]."""
MARGINS = {
    "latency": Limit.at_least(60.0), "noise": Limit.at_least(5.0), "Cf-less": Limit.at_most(50.0),
    "Cf-more": Limit.at_least(160.0), "Cr-less": Limit.at_most(50.0),
    "Cr-more": Limit.at_least(160.0), "offset": Limit.at_least(2.0),
    "friction": Limit.at_most(0.65 * 1.05),
}
"""How far `lpv-mpc` is to hold on circuit 65 %, in each kind's own unit."""
STEERING = (1.5, 0.05)
"""Steering rate in `rtk`: so many times that of the ideal run, and so much more [rad/s]."""


def bars(found: Found) -> list[Finding]:
    """Every promise with what was measured; None where it was not driven."""
    return [
        *_alone(found.rows.get("deviations", ())),
        *_worlds(found.worlds),
        _rivals(found.worlds),
        _learning(found.adaptation),
        *_margins(found.margins or ()),
    ]


def _alone(rows: Sequence[DrivenCell]) -> Iterator[Finding]:
    own = [row for row in rows if row.cell.controller == OURS]
    for road, limits in IDEAL.items():
        here = [row for row in own if row.cell.case == "nominal" and row.cell.road == road]
        yield from _worst(f"ideal_{road}", f"ideal, {ROADS[road].title}", here, limits)
    keys = [one.key for one in DEVIATIONS if one.key not in APART]
    for road, limits in ALONE.items():
        here = [row for row in own if row.cell.case in keys and row.cell.road == road]
        title = f"any one deviation, {ROADS[road].title}"
        yield from _worst(f"alone_{road}", title, here, limits)
    for key, limits in TOLD.items():
        here = [row for row in own if row.cell.case == key and row.cell.road in ALONE]
        (title,) = (one.title for one in DEVIATIONS if one.key == key)
        yield from _worst(key, title, here, limits)


    here = [row for row in own if row.cell.case == SURVIVED]
    (title,) = (one.title for one in DEVIATIONS if one.key == SURVIVED)
    yield Finding(
        key=SURVIVED, figure=f"{title}: lost runs", unit="runs", limit=Limit.at_most(0.0),
        value=float(sum(not row.completed for row in here)) if here else None,
    )


def _worst(
    key: str, title: str, rows: Sequence[DrivenCell], limits: tuple[float, float]
) -> Iterator[Finding]:
    metrics = (("RMSE", "lateral_rmse_m"), ("largest", "lateral_max_m"))
    for (name, metric), limit in zip(metrics, limits, strict=True):
        value = max((row.ranked(metric) for row in rows), default=None)
        yield _in_mm(f"{key}_{name.lower()}", f"{title}: worst {name}", value, limit)


def _worlds(found: Sequence[Summary]) -> Iterator[Finding]:
    own = {(s.cell.case, s.cell.road): s for s in found if s.cell.controller == OURS}
    for (case, road), limits in SENSED.items():
        s, title = own.get((case, road)), f"{case}, {ROADS[road].title}"
        rmse = None if s is None else s.rmse[0]
        largest = None if s is None else s.largest[2]
        yield _in_mm(f"{case}_{road}_rmse", f"{title}: median RMSE", rmse, limits[0])
        yield _in_mm(f"{case}_{road}_largest", f"{title}: worst largest", largest, limits[1])
    factor, more = STEERING
    for road in [road for case, road in SENSED if case == "rtk"]:
        ideal, sensed = own.get(("ideal", road)), own.get(("rtk", road))
        calm = None if ideal is None else ideal.steering
        yield Finding(
            key=f"rtk_{road}_steering", figure=f"rtk, {ROADS[road].title}: steering rate",
            value=None if sensed is None else sensed.steering, unit="rad/s",
            limit=None if calm is None else Limit.at_most(factor * calm + more),
        )
    for road, limit in FLEET.items():
        s, title = own.get(("fleet", road)), f"fleet, {ROADS[road].title}"
        rmse = None if s is None else s.rmse[1]
        largest = None if s is None else s.largest[2]
        yield _completed(road, s, 100.0)
        yield _in_mm(f"fleet_{road}_rmse95", f"{title}: 95th percentile of the RMSE", rmse, limit)
        yield _in_mm(f"fleet_{road}_largest", f"{title}: worst largest", largest, FLEET_LARGEST)
    yield _completed("circuit-80", own.get(("fleet", "circuit-80")), FLEET_80)


def _in_mm(key: str, figure: str, value: float | None, limit: float) -> Finding:
    return Finding(key=key, figure=figure, value=None if value is None else 1e3 * value, unit="mm",
                   limit=Limit.at_most(limit))


def _completed(road: str, s: Summary | None, least: float) -> Finding:
    return Finding(
        key=f"fleet_{road}_completed", figure=f"fleet, {ROADS[road].title}: completed",
        value=None if s is None else 100.0 * s.completed / s.n, unit="%",
        limit=Limit.at_least(least),
    )


def _rivals(found: Sequence[Summary]) -> Finding:
    """In how many worlds and roads another has a better 95th percentile of the RMSE."""
    own = {(s.cell.case, s.cell.road): s for s in found if s.cell.controller == OURS}
    pairs = [
        (s, own[s.cell.case, s.cell.road]) for s in found
        if s.cell.controller != OURS and (s.cell.case, s.cell.road) in own
    ]
    better = {(s.cell.case, s.cell.road) for s, ours in pairs if s.rmse[1] < ours.rmse[1]}
    return Finding(
        key="rivals", figure="worlds and roads where a rival's 95th percentile is better",
        value=float(len(better)) if pairs else None, limit=Limit.at_most(0.0),
    )


def _learning(found: Sequence[Summary]) -> Finding:
    """What online learning costs at the worst on a dry road with the nominal car."""
    table = {(s.cell.case, s.cell.road, s.cell.model): s for s in found}
    costs = []
    for (case, road, model), s in table.items():
        dry = table.get((case, road, "network-dry"))
        if model == "network" and case in ("ideal", "rtk") and dry is not None:
            lost = math.isinf(s.rmse[0])  # never met, also where both are
            costs.append(math.inf if lost else 1e3 * (s.rmse[0] - 1.1 * dry.rmse[0]))
    return Finding(
        key="learning", figure="online learning, nominal car: median RMSE over 1.1 of that without",
        value=max(costs, default=None), unit="mm", limit=Limit.at_most(0.1),
    )


def _margins(found: Sequence[Margin]) -> Iterator[Finding]:
    own = {m.kind.key: m for m in found if m.controller == OURS}
    for key, limit in MARGINS.items():
        m = own.get(key)
        nothing = -math.inf if limit.is_lower else math.inf  # never passes
        value = None if m is None else nothing if m.held is None else m.held
        yield Finding(
            key=f"margin_{key}", figure=f"margin: {key if m is None else m.kind.title}",
            value=value, unit="" if m is None else m.kind.unit, limit=limit,
        )
