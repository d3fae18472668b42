"""What was measured: closed loops, gusts, stiffness along a lap, the sphere, tunings, trainings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lpvmpc.bench.cases import Measured
from lpvmpc.control.stiffness.network_file import load_weights
from lpvmpc.learn import driven
from lpvmpc.learn.scores import r2
from lpvmpc.paper import records, runs, steering_at_rest
from lpvmpc.paper.runs import Entry, Equipment, RoadCase
from lpvmpc.sim import batch
from lpvmpc.tune import sphere
from lpvmpc.units import Array

if TYPE_CHECKING:
    from lpvmpc.sim.log import Log

Say = Callable[[str, int, int], None]
"""Told what is being done, and how much of how much is."""
QUICK_SPEEDS = (2.0, 10.0, 30.0)
"""Speeds at which a quick look sends a gust [m/s]."""
QUICK_SEEDS = 10
"""Seeds of the sphere in a quick look."""
STIFFNESS_CASE = "circuit-0.87"
"""Road along which the stiffness is compared: near the limit of grip, and in no data."""


@dataclass(frozen=True, kw_only=True)
class DrivenEntry(Measured):
    """One cell of the tables: an entry on a road."""

    entry: Entry
    """Who drove."""
    case: RoadCase
    """What was driven."""

    def get(self, key: str) -> float | None:
        """Another metric; None where the car was lost."""
        value = self.result[key]
        return float(value) if self.completed and value is not None else None


@dataclass(frozen=True, kw_only=True, eq=False)
class Stiffness:
    """Secant stiffness of both axles along a run: the plant's, and what the networks say."""

    title: str
    """What was driven."""
    t: Array
    """Time [s], shape (n,)."""
    alpha: Array
    """Slip angles front and rear [rad], shape (n, 2)."""
    true: Array
    """The plant's secant stiffness [N/rad], shape (n, 2)."""
    said: Mapping[str, Array]
    """The networks' by kind, shape (n, 2) each."""

    def r2(self, kind: str) -> tuple[float, float]:
        """R2 of a network over the run, front and rear."""
        front, rear = (r2(self.true[:, i], self.said[kind][:, i]) for i in range(2))
        return front, rear


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Everything that the report stands on."""

    quick: bool
    """Whether this is a quick look."""
    jobs: int
    """Processes that drove."""
    anew: tuple[str, ...] = ()
    """What was made anew: weights, networks."""
    equipment: Equipment
    """Weights and networks."""
    rows: Sequence[DrivenEntry]
    """All closed loops."""
    driven: int
    """How many of them are different."""
    kept: int
    """How many of those an earlier call had kept."""
    rests: Sequence[steering_at_rest.GustAnswer]
    """What the steering did after gusts."""
    logs: Mapping[str, Log]
    """The paper's road, full wind, by controller: ours and the baseline."""
    stiffness: Stiffness
    """Fig. 5."""
    sphere: sphere.Study
    """Fig. 6."""
    tunings: Mapping[str, records.Tuning]
    """Tunings by controller, where there are some."""
    tuned_on: Sequence[str]
    """Scenarios that any weights were tuned on."""
    trainings: Mapping[str, records.Training]
    """Trainings by kind of network, where there are some."""
    missing: Sequence[str] = ()
    """Sentences about what is not there."""
    seconds: float = 0.0
    """Time that all of it took [s]."""
    _index: dict[tuple[str, str, str], DrivenEntry] = field(
        default_factory=dict, init=False, repr=False
    )

    def __post_init__(self) -> None:
        self._index.update({(r.entry.group, r.entry.key, r.case.key): r for r in self.rows})

    def get(self, group: str, key: str, case: str) -> DrivenEntry | None:
        """A row; None where it was not driven."""
        return self._index.get((group, key, case))

    def cases(self, group: str) -> list[RoadCase]:
        """The roads of a group, in their order."""
        return list({r.case.key: r.case for r in self.rows if r.entry.group == group}.values())

    def entries(self, group: str) -> list[Entry]:
        """The entries of a group, in their order."""
        return list({r.entry.key: r.entry for r in self.rows if r.entry.group == group}.values())


# Driving ------------------------------------------------------------------------------------------


def drive(
    entries: Sequence[Entry], cases: Sequence[RoadCase], *, jobs: int, cache: Path, say: Say
) -> tuple[list[DrivenEntry], int, int]:
    """Drive every entry on its roads.

    Returns:
        The rows, how many different runs they stand on, and how many of those were kept from
        before.
    """
    planned = [(entry, case) for entry in entries for case in runs.cases_of(entry, cases)]
    planned_runs = [
        runs.run_of(case, entry.controller, entry.options, entry.key) for entry, case in planned
    ]
    unique = list({run.key(): run for run in planned_runs}.values())  # groups share runs
    kept: list[int] = []

    def progress(done: int, total: int) -> None:
        kept.append(done)
        say("closed loops", done, total)

    found = batch.drive_all(unique, jobs=jobs, cache=cache, progress=progress)
    results = {run.key(): result for run, result in zip(unique, found, strict=True)}
    rows = [
        DrivenEntry(entry=entry, case=case, result=results[run.key()])
        for (entry, case), run in zip(planned, planned_runs, strict=True)
    ]
    return rows, len(unique), kept[0]


def on_the_papers_road(equipment: Equipment) -> dict[str, Log]:
    """Logs of the paper's road in full wind, of ours and of the baseline."""
    case = runs.CASES[0]
    return {
        name: batch.drive(runs.run_of(case, name, equipment.options(name)))
        for name in (runs.OURS, runs.LMPC)
    }


def gusts(
    equipment: Equipment, speeds: Sequence[float], say: Say
) -> list[steering_at_rest.GustAnswer]:
    """Send a gust at every speed, straight on and on a circle."""
    from lpvmpc.plant.plant import Plant
    from lpvmpc.sim.loop import simulate
    from lpvmpc.sim.names import load_controller

    car, found = Plant(), []
    planned = [(vx, turning) for turning in (False, True) for vx in speeds]
    for done, (vx, turning) in enumerate(planned):
        say("gusts", done, len(planned))
        ours = load_controller(runs.OURS, **equipment.options(runs.OURS))
        log = simulate(car, ours, steering_at_rest.scenario(vx, turning))
        found.append(steering_at_rest.of(log, vx, turning))
    return found


# Stiffness ----------------------------------------------------------------------------------------


def stiffness(equipment: Equipment, case: RoadCase) -> Stiffness:
    """The axles' secant stiffness along a run of ours, and what both networks say of it."""
    log = batch.drive(runs.run_of(case, runs.OURS, equipment.options(runs.OURS)))
    alpha, true = driven.labels(log)
    return Stiffness(
        title=case.title,
        t=log.columns["t_s"],
        alpha=alpha,
        true=true,
        said={kind: said(kind, log, equipment) for kind in ("network-secant", "network")},
    )


def said(kind: str, log: Log, equipment: Equipment) -> Array:
    """Secant stiffness that a network gives along a log on a dry road [N/rad], shape (n, 2)."""
    return driven.said(log, load_weights(kind, equipment.networks.get(kind)))


# All of it ----------------------------------------------------------------------------------------


def equip(
    tunings: Mapping[str, records.Tuning] | None, networks: Mapping[str, Path] | None
) -> Equipment:
    """Weights and networks: the shipped ones, but for those that were made anew."""
    by_hand = records.weights_by_hand()
    tuned = records.shipped_weights(by_hand)
    tuned |= {name: dict(one.weights) for name, one in (tunings or {}).items()}
    files = {kind: str(file) for kind, file in (networks or {}).items()}
    return Equipment(by_hand=by_hand, tuned=tuned, networks=files)


def gather(
    *,
    quick: bool,
    jobs: int,
    cache: Path,
    say: Say,
    tunings: Mapping[str, records.Tuning] | None = None,
    networks: Mapping[str, Path] | None = None,
) -> Evidence:
    """Measure everything.

    Args:
        quick: Whether a part of it is enough.
        jobs: Processes that drive.
        cache: Folder where results of closed loops are kept.
        say: Told what is being done.
        tunings: Tunings made anew (default: the shipped ones).
        networks: Files of networks trained anew, by kind, their fits beside them.
    """
    equipment = equip(tunings, networks)
    cases = [case for case in runs.CASES if not quick or case.key in runs.QUICK]
    entries = runs.entries(equipment)
    rows, driven, kept = drive(
        runs.quick(entries) if quick else entries, cases, jobs=jobs, cache=cache, say=say
    )
    rests = gusts(equipment, QUICK_SPEEDS if quick else steering_at_rest.SPEEDS, say)
    say("figures' runs", 0, 3)
    logs = on_the_papers_road(equipment)
    say("figures' runs", 2, 3)
    along = stiffness(equipment, next(c for c in runs.CASES if c.key == STIFFNESS_CASE))
    seeds = QUICK_SEEDS if quick else sphere.SEEDS
    study = sphere.run(seeds=seeds, say=lambda what: say(f"sphere: {what}", 0, 1))
    missing: list[str] = []
    known, trainings = _records(tunings, networks, missing)
    names = {name for one in known.values() for name in one.task["scenarios"]}
    for name in equipment.tuned:
        if tunings is None or name not in tunings:
            names.update(records.tuned_on(name))
    made = (("weights", tunings), ("networks", networks))
    return Evidence(
        quick=quick,
        jobs=jobs,
        anew=tuple(what for what, new in made if new),
        equipment=equipment,
        rows=rows,
        driven=driven,
        kept=kept,
        rests=rests,
        logs=logs,
        stiffness=along,
        sphere=study,
        tunings=known,
        tuned_on=sorted(names),
        trainings=trainings,
        missing=missing,
    )


def _records(
    tunings: Mapping[str, records.Tuning] | None,
    networks: Mapping[str, Path] | None,
    missing: list[str],
) -> tuple[dict[str, records.Tuning], dict[str, records.Training]]:
    """Records of tunings and trainings: those made anew, or the published ones."""
    folder = records.published()
    if folder is None and (tunings is None or networks is None):
        missing.append(
            "The package was installed without its source tree, so the published records of "
            "tuning and training (docs/results) are not here: what stands on them is left out."
        )
    known = dict(tunings or {})
    if tunings is None and folder is not None:
        for name in runs.DRIVEN:
            if (one := records.read_tuning(folder / "tuning" / name)) is not None:
                known[name] = one
        lacking = [name for name in runs.DRIVEN if name not in known]
        if lacking:
            missing.append(f"No record of a tuning is published for {', '.join(lacking)}.")
    trainings = {}
    for kind in ("network-secant", "network"):
        where = folder / kind if folder is not None else None
        if networks is not None:
            where = networks[kind].with_suffix("")
        if where is None:
            continue
        if (training := records.read_training(kind, where)) is not None:
            trainings[kind] = training
        else:
            missing.append(f"No record of the training of {kind} is in {where}.")
    return known, trainings
