"""Many closed loops at once, each described by names and numbers alone.

A `Run` says what is driven; `drive_all` drives many of them in one process, in several, or on a Ray
cluster, and keeps what each of them gave under the hash of everything it depends on. So the numbers
are the same whatever the number of processes, and what was interrupted goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lpvmpc.car.current import current, per_car
from lpvmpc.control.rivals import RIVALS
from lpvmpc.errors import LPVMPCError, OptionError, described
from lpvmpc.kit.files import checksum, read_json, write_json
from lpvmpc.kit.provenance import versions, versions_of
from lpvmpc.kit.workers import check, workers
from lpvmpc.plant import deviations
from lpvmpc.plant.mjcf import model_path
from lpvmpc.road.scenario import RoadFriction, Scenario
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.metrics import DETAILS, KEYS, details, metrics
from lpvmpc.sim.names import load_controller, load_scenario
from lpvmpc.sim.own import file_of
from lpvmpc.sim.world import load_world

if TYPE_CHECKING:
    from lpvmpc.interface import Controller
    from lpvmpc.plant.plant import Plant
    from lpvmpc.sim.log import Log
    from lpvmpc.sim.process.isolated import Isolated

FOUNDATION = (
    "units.py", "errors.py", "interface.py", "car/**/*", "plant/**/*", "road/**/*", "control/**/*",
    "sensing/**/*", "sim/**/*",
)
"""What a closed loop stands on, by the import contract: a change there makes kept results void."""
APART = "control/rivals"
"""What none but the rivals themselves stand on."""
KEPT = (*KEYS, *DETAILS)
"""What is kept of a run: its `metrics` and `details`."""
DIED = (
    "A worker process died (killed, or out of memory?); what was finished is kept, and fewer jobs "
    "need less memory."
)
Progress = Callable[[int, int], None]
"""Called with the number of runs that are done and of all."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """One closed loop. Everything is a plain name or number, so that it can be sent and hashed."""

    label: str = ""
    """What to call it; no part of its key."""
    scenario: str = "paper"
    """Name of a scenario, or a CSV file."""
    scenario_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `load_scenario`."""
    controller: str = "lpv-mpc"
    """Name of a controller, or module:Class."""
    controller_options: Mapping[str, Any] = field(default_factory=dict)
    """Options of `load_controller`; `weights` and `formulation` as dictionaries."""
    road: float | tuple[tuple[float, float], ...] = 1.0
    """Friction that nobody announces, times what the scenario says: a factor, or pairs of arc
    length [m] and factor, linear between."""
    laps: int = 1
    """Number of laps of a closed track."""
    start_offset: tuple[float, float] = (0.0, 0.0)
    """Where the car starts beside the reference: ey [m] and epsi [rad]."""
    world: str | Mapping[str, Any] = "ideal"
    """What reality does that nobody is told: a name of `WORLDS`, a TOML file, or its contents."""
    estimator: str | None = None
    """Name of an estimator, or module:Class; None: as `simulate` says."""
    delay: int = 0
    """Periods after which a command reaches the car; what the controller is told of it is among
    its options."""
    latency: float | None = None
    """Time that passes besides before a command reaches the car [s], and nobody is told; None: the
    world's."""
    deviations: Mapping[str, float] = field(default_factory=dict)
    """How the car differs from the one that the controller knows; fields of `Deviations`."""
    seed: int = 0
    """Seed of the generator given to the controller."""

    def __post_init__(self) -> None:
        """Refuse what cannot be hashed, and impossible roads."""
        try:
            json.dumps([dict(self.scenario_options), dict(self.controller_options), self.world],
                       allow_nan=False)
        except (TypeError, ValueError) as error:
            raise OptionError("options of a run", str(error), "plain names and numbers") from None
        values = [value for _, value in self.road] if isinstance(self.road, tuple) else [self.road]
        if not values or not all(0.05 <= value <= 4.0 for value in values):
            raise OptionError("road of a run", self.road, "friction factors from 0.05 to 4")
        deviations.named(self.deviations)
        load_world(self.world)

    def __hash__(self) -> int:
        return hash(self.text())

    def text(self) -> str:
        """Everything but the label, in one canonical line of JSON."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "label"}
        values = {k: dict(v) if isinstance(v, Mapping) else v for k, v in values.items()}
        return json.dumps(values, sort_keys=True)

    @classmethod
    def of_text(cls, text: str) -> Run:
        """The run that `text` has described.

        Raises:
            OptionError: It describes none.
        """
        try:
            values = json.loads(text)
            if isinstance(road := values["road"], list):
                values["road"] = tuple((s, value) for s, value in road)
            values["start_offset"] = tuple(values["start_offset"])
            return cls(**values)
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            if isinstance(error, OptionError):
                raise
            raise OptionError("a run", text[:60], "one line of `Run.text`") from error

    def key(self) -> str:
        """Hash of the run and of all it depends on: sources, weights, model, versions, own files.

        Two runs of one key have the same trace; only their times differ.
        """
        digest = hashlib.sha256(self.text().encode())
        digest.update(foundation(self.controller in RIVALS).encode())
        for file in self._own_files():
            digest.update(file.read_bytes())
        return digest.hexdigest()[:32]

    def _own_files(self) -> Iterator[Path]:
        """A user's track, world, network and modules, where they are found."""
        files = [self.scenario] if self.scenario.lower().endswith(".csv") else []
        files += [self.world] if isinstance(self.world, str) else []
        files.append(str(self.controller_options.get("stiffness_file", "")))
        yield from (file for file in map(Path, files) if file.is_file())
        for user in (self.controller, self.estimator or ""):
            if ":" in user and (source := file_of(user.partition(":")[0])) is not None:
                yield source


def foundation(rival: bool = False) -> str:
    """Hash of what every run stands on: sources, weights, data, the model's XML, versions, car.

    Args:
        rival: Whether one of `RIVALS` drives, on whom no other controller's runs depend.
    """
    return _foundation(rival)


@per_car
def _foundation(rival: bool) -> str:
    digest = hashlib.sha256(json.dumps(versions(), sort_keys=True).encode())
    package = Path(str(resources.files("lpvmpc")))
    apart = package / APART
    files = [f for name in FOUNDATION for f in package.glob(name) if f.is_file()]
    assert len(files) > 40 and apart / "__init__.py" in files, (
        "what a closed loop depends on has moved"
    )
    files = [f for f in files if rival or not f.is_relative_to(apart)]
    files += model_path("vehicle.xml").parent.glob("*.xml")
    for file in sorted(files):
        if "__pycache__" not in file.parts:
            digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    if rival:
        used = sorted({package for one in RIVALS.values() for package in one.packages})
        digest.update(json.dumps(versions_of(used), sort_keys=True).encode())
    if (car := current()) is not None:
        for file in (car.file, *made_for(car.folder)):
            digest.update(file.name.encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def made_for(folder: Path | None) -> list[Path]:
    """Networks and weights in a car's folder."""
    if folder is None:
        return []
    return sorted([*folder.glob("*.safetensors"), *folder.glob("weights/*.toml")])


def drive(
    run: Run, controller: Controller | Isolated | None = None, step_timeout: float | None = None
) -> Log:
    """Drive one run in this process.

    Args:
        run: What to drive.
        controller: Who drives, made already; None: as the run says.
        step_timeout: Longest time of a control step [s]; None: without limit.

    Raises:
        LPVMPCError: Something in the run does not exist or is out of its domain, or its controller
            failed.
    """
    if controller is None:
        controller = load_controller(run.controller, **run.controller_options)
    told = arguments(run)
    return simulate(_plant(), controller, scenario_of(run), step_timeout=step_timeout, **told)


def arguments(run: Run) -> dict[str, Any]:
    """What `simulate` is told of a run, besides car, controller and scenario."""
    return {
        "seed": run.seed,
        "laps": run.laps,
        "start_offset": run.start_offset,
        "delay": run.delay,
        "world": run.world,
        "estimator": run.estimator,
        "latency": run.latency,
        "deviations": deviations.named(run.deviations) if run.deviations else None,
        "name": run.controller,
        "options": {"road": run.road},
    }


def scenario_of(run: Run) -> Scenario:
    """What a run drives, its unannounced friction included."""
    track = Path(run.scenario)
    written = track.stat().st_mtime_ns if run.scenario.endswith(".csv") and track.exists() else 0
    options = json.dumps(dict(run.scenario_options), sort_keys=True)
    meant = current()
    scenario = _scenario(run.scenario, options, written, meant.sha256 if meant else None)
    if run.road == 1.0:
        return scenario
    announced = 1.0 if scenario.friction is None else scenario.friction(0.0)
    pairs = run.road if isinstance(run.road, tuple) else ((0.0, run.road),)
    road = RoadFriction(
        scale=announced, knots=tuple(s for s, _ in pairs), values=tuple(value for _, value in pairs)
    )
    return replace(scenario, friction=road)


@lru_cache(maxsize=16)  # planning a speed takes as long as driving a tenth of the road
def _scenario(name: str, options: str, written: int, car: str | None) -> Scenario:
    """A scenario; `written` is the time of the track file, which may be edited meanwhile."""
    return load_scenario(name, **json.loads(options))


@per_car
def _plant() -> Plant:
    """The car of this process; `simulate` resets it."""
    from lpvmpc.plant.plant import Plant

    return Plant()


def charged(run: Run, reason: str) -> dict[str, Any]:
    """The result of a run that has none: not completed, for this reason."""
    stiffness = run.controller_options.get("stiffness")
    known = {"scenario": run.scenario, "controller": run.controller, "stiffness": stiffness}
    return {**dict.fromkeys(KEPT), **known, "seed": run.seed, "completed": False, "reason": reason}


def drive_all(
    runs: Sequence[Run],
    *,
    jobs: int = 1,
    backend: str = "local",
    address: str | None = None,
    cache: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Drive many runs; each gives what `KEPT` names, whatever happens to the others.

    A run that raises counts as not completed, with the error as its reason; it is driven again
    when asked for again. Ctrl-C ends the batch at once, and what has ended until then is kept.

    Args:
        runs: What to drive.
        jobs: Number of processes; with 1, all happens in this one (unless on Ray).
        backend: One of `kit.workers.BACKENDS`.
        address: Address of the Ray cluster (default: Ray decides, and starts one here).
        cache: Folder of results kept by key, read and written; None keeps nothing.
        progress: Called at the start and after each run.

    Returns:
        Results in the order of the runs.

    Raises:
        OptionError: A number of jobs below 1, an unknown backend, an address without Ray.
        LPVMPCError: Ray is not installed or not reachable, or a worker process died.
        OutputError: The folder cannot be written.
        KeyboardInterrupt: Ctrl-C.
    """
    check(jobs, backend, address)
    keys = [run.key() for run in runs]
    kept = None if cache is None else Path(cache)
    found: dict[str, dict[str, Any]] = {}
    if kept is not None:
        found = {k: value for k in keys if (value := read_result(kept, k)) is not None}
    done = sum(key in found for key in keys)
    if progress is not None:
        progress(done, len(runs))
    missing = {key: run for key, run in zip(keys, runs, strict=True) if key not in found}
    if missing:
        with workers(jobs, backend, address, DIED) as pool:
            for key, result, failed in pool.each(_outcome, missing.items()):
                found[key] = result
                if kept is not None and not failed:
                    keep_result(kept, key, result)
                done += keys.count(key)
                if progress is not None:
                    progress(done, len(runs))
    return [found[key] for key in keys]


def read_result(cache: Path, key: str) -> dict[str, Any] | None:
    """A result that was kept; None where it is absent or damaged, and so has to be driven."""
    try:
        kept = read_json(cache / f"{key}.json")
    except (OSError, ValueError):
        return None
    if not isinstance(kept, dict) or set(kept) != {"key", "sha256", "result"}:
        return None
    result = kept["result"]
    if not isinstance(result, dict) or set(result) != set(KEPT):
        return None
    return result if kept["key"] == key and kept["sha256"] == checksum(result) else None


def keep_result(cache: Path, key: str, result: dict[str, Any]) -> None:
    """Keep a result under its key, with a checksum.

    Raises:
        OutputError: It cannot be written.
    """
    plain = json.loads(json.dumps(result))  # as it will be read: tuples are lists there
    kept = {"key": key, "sha256": checksum(plain), "result": plain}
    write_json(cache / f"{key}.json", kept)


Outcome = tuple[str, dict[str, Any], bool]
"""Key, result, and whether the run raised."""


def _outcome(item: tuple[str, Run]) -> Outcome:
    """Drive a run, given with its key, and measure it; an error becomes its result.

    Raises:
        KeyboardInterrupt: Ctrl-C, which `simulate` turns into an unfinished Log.
    """
    key, run = item
    try:
        log = drive(run)
    except LPVMPCError as error:
        return key, charged(run, " ".join(str(error).split())), True
    except Exception as error:  # one broken run must not take the others' results away
        return key, charged(run, described(error)), True
    if log.meta["reason"] == "interrupted":
        raise KeyboardInterrupt
    return key, {**metrics(log), **details(log)}, False
