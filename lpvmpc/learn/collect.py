"""Collecting the stiffness data with many processes, so that it can be killed and resumed.

The data are cut into slots of `manoeuvres.ROWS` rows, each filled from its own random generator,
and the slots into shards of fixed size. A worker writes whole shards, each under its name only when
complete; the shards are then merged in order. So the file depends on the plan alone: neither on the
number of processes, nor on which of them finished first, nor on how often they were killed.
"""

from __future__ import annotations

import copy
import json
import math
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import mujoco
import numpy as np

from lpvmpc.car.current import per_car
from lpvmpc.errors import DataError, LPVMPCError, OptionError
from lpvmpc.kit.files import read_json, whole, write_json, writing
from lpvmpc.kit.provenance import model_sha256, versions
from lpvmpc.kit.workers import check, workers
from lpvmpc.learn import dataset, manoeuvres
from lpvmpc.learn.columns import SHA256, Digest
from lpvmpc.learn.manoeuvres import KINDS, ROWS
from lpvmpc.plant.mjcf import car_sha256, compile_model
from lpvmpc.plant.plant import Plant

SLOTS_PER_SHARD = 6
"""Slots that a worker fills before it writes: about half a second of work."""
ATTEMPTS = 100
"""Runs that may be needed to fill a slot; run numbers are slot * ATTEMPTS + attempt."""
SHORTEST = 16
"""A run of fewer rows left the domain at once and is not kept."""
ROW_GROUP = 16384
"""Rows that are in memory when shards are merged."""

DIED = "A worker process died (killed, or out of memory?); --resume goes on from here."

Progress = Callable[[int], None]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All that decides the data."""

    samples: int = 10752
    """Number of rows."""
    seed: int = 0
    """Seed."""
    friction: tuple[float, float] = (1.0, 1.0)
    """Lowest and highest scale of the road's peak friction; each run draws its own."""
    mass: tuple[float, float] | None = None
    """Lowest and highest mass [kg]; None: the car's own."""

    def __post_init__(self) -> None:
        """Refuse what cannot be driven."""
        if not 1 <= self.samples <= 100_000_000:
            raise OptionError("samples", self.samples, "a whole number from 1 to 100000000")
        if not 0 <= self.seed < 2**63:
            raise OptionError("seed", self.seed, "a whole number from 0")
        limits = [("friction", self.friction, 0.3, 1.2)]
        if self.mass is not None:
            limits.append(("mass", self.mass, 1200.0, 2400.0))
        for name, pair, low, high in limits:
            if not (all(map(math.isfinite, pair)) and low <= pair[0] <= pair[1] <= high):
                raise OptionError(name, pair, f"one number, or two in order, {low:g} to {high:g}")

    @property
    def slots(self) -> int:
        """Number of slots."""
        return -(-self.samples // ROWS)

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.slots // SLOTS_PER_SHARD)

    def rows_of(self, shard: int) -> int:
        """Number of rows of a shard; the last may be shorter."""
        return min(self.samples - shard * SLOTS_PER_SHARD * ROWS, SLOTS_PER_SHARD * ROWS)

    def facts(self, model: mujoco.MjModel) -> dict[str, Any]:
        """What a file of these data says about itself."""
        return {
            "samples": self.samples,
            "seed": self.seed,
            "friction": self.friction,
            "mass_kg": self.mass,
            "kinds": list(KINDS),
            "rows_per_run": ROWS,
            "versions": versions(),
            "model_sha256": model_sha256(model),
            "car_sha256": car_sha256(model),
        }


def collect(
    plan: Plan,
    out: Path,
    *,
    jobs: int = 1,
    resume: bool = False,
    backend: str = "local",
    address: str | None = None,
    progress: Progress | None = None,
) -> int:
    """Collect data into a file.

    Args:
        plan: What to collect.
        out: The Parquet file; unfinished work lies beside it in a folder named *.parts.
        jobs: Number of processes; on Ray, 0 is one for each CPU of the cluster.
        resume: Go on with what an interrupted collection has left.
        backend: One of `kit.workers.BACKENDS`; on Ray the shards are sent here, so that no folder
            need be shared.
        address: Address of the Ray cluster.
        progress: Called with the number of rows done after each shard.

    Returns:
        Number of rows that were already there.

    Raises:
        DataError: What there is to resume belongs to another plan.
        OutputError: Something cannot be written.
        LPVMPCError: A worker process died.
    """
    check(jobs, backend, address)
    if jobs > 1024:
        raise OptionError("jobs", jobs, "a whole number from 1 to 1024")
    facts = json.loads(json.dumps(plan.facts(compile_model(visual=False))))
    folder = out.with_name(out.name + ".parts")
    with writing(out):
        if not resume:
            shutil.rmtree(folder, ignore_errors=True)
        elif out.is_file() and not folder.is_dir():
            _check_plan(dataset.read_metadata(out), facts, out)
            return plan.samples
        _prepare(folder, facts)
        missing = [i for i in range(plan.shards) if not _whole(folder, i, plan, facts)]
    done = plan.samples - sum(plan.rows_of(i) for i in missing)
    found = done
    if progress is not None:
        progress(done)
    with workers(min(jobs, max(len(missing), 1)), backend, address, DIED) as pool:
        shards: Iterator[int]
        if backend == "ray":
            sent = pool.each(partial(_sent, plan, facts), missing)
            shards = map(partial(_received, folder), sent)
        else:
            shards = pool.each(partial(_work, plan, folder, facts), missing)
        for shard in shards:
            done += plan.rows_of(shard)
            if progress is not None:
                progress(done)
    with writing(out):
        merge(plan, folder, out, facts)
        shutil.rmtree(folder)
    return found


def _prepare(folder: Path, facts: dict[str, Any]) -> None:
    """Make the folder of the shards, or check that it belongs to the same plan."""
    plan_file = folder / "plan.json"
    folder.mkdir(parents=True, exist_ok=True)
    if plan_file.is_file():
        try:
            left = read_json(plan_file)
            if not isinstance(left, dict):
                raise ValueError("it is no table")
        except (OSError, ValueError) as error:
            raise DataError(f"{str(plan_file)!r} is damaged; start without --resume.") from error
        _check_plan(left, facts, folder)
        return
    write_json(plan_file, facts)


def _check_plan(left: dict[str, Any], facts: dict[str, Any], where: Path) -> None:
    """Refuse to resume what was begun with other options, versions, or another car."""
    for key, value in facts.items():
        if left.get(key) != value:
            raise DataError(
                f"{str(where)!r} was begun with {key} {left.get(key)!r}, but now it is {value!r}; "
                "give the same, or start without --resume."
            )


# One shard ---------------------------------------------------------------------------------------


class SlotFiller:
    """Fills slots; keeps the plant from one to the next."""

    def __init__(self, plan: Plan):
        self.plan = plan
        self.plant = Plant()
        self.model = self.plant.model

    def slot(self, slot: int) -> dict[str, np.ndarray]:
        """Columns of one slot: as many runs of its kind as it takes to fill it.

        Raises:
            LPVMPCError: Run after run leaves the domain at once.
        """
        plan, kind = self.plan, list(KINDS)[slot % len(KINDS)]
        tables, rows = [], 0
        for attempt in range(ATTEMPTS):
            rng = np.random.default_rng([plan.seed, slot, attempt])
            friction = float(rng.uniform(*plan.friction))
            mass = self._load(rng)
            run = manoeuvres.drive(
                self.plant, kind, rng, friction=friction, severity=max(0.9**attempt, 0.3)
            )
            if len(run) < SHORTEST:
                continue
            run = run[: ROWS - rows]
            number = slot * ATTEMPTS + attempt
            tables.append(
                dataset.table_of(
                    run, number, kind, model=self.model, friction=friction, mass=mass,
                    Ts=self.plant.Ts,
                )
            )
            rows += len(run)
            if rows == ROWS:
                return {name: np.concatenate([t[name] for t in tables]) for name in tables[0]}
        raise LPVMPCError(f"Slot {slot} ({kind}) could not be filled in {ATTEMPTS} runs.")

    def _load(self, rng: np.random.Generator) -> float:
        """Draw the mass of the next run, and change the car to it."""
        if self.plan.mass is None:
            return self.plant.params.m
        mass = float(rng.uniform(*self.plan.mass))
        self.plant = Plant(with_mass(self.model, mass))
        return mass


def with_mass(model: mujoco.MjModel, mass: float) -> mujoco.MjModel:
    """A copy of the car whose body weighs more or less; springs and wheels stay the same.

    Args:
        model: The car.
        mass: Mass of the whole car [kg].
    """
    changed = copy.copy(model)
    chassis = changed.body("chassis").id
    body = float(changed.body_mass[chassis])
    factor = 1.0 + (mass - float(changed.body_subtreemass[chassis])) / body
    changed.body_mass[chassis] *= factor
    changed.body_inertia[chassis] *= factor
    mujoco.mj_setConst(changed, mujoco.MjData(changed))
    return changed


def _shard_file(folder: Path, shard: int) -> Path:
    return folder / f"shard-{shard:06d}.parquet"


def _work(plan: Plan, folder: Path, facts: dict[str, Any], shard: int) -> int:
    """Make a shard, in this process or in a worker; gives its number."""
    write_shard(_filler(plan), folder, shard, facts)
    return shard


def _sent(plan: Plan, facts: dict[str, Any], shard: int) -> tuple[int, bytes]:
    """Make a shard on a machine that shares no folder with ours; gives its number and its file."""
    with TemporaryDirectory() as folder:
        write_shard(_filler(plan), Path(folder), shard, facts)
        return shard, _shard_file(Path(folder), shard).read_bytes()


def _received(folder: Path, sent: tuple[int, bytes]) -> int:
    """Keep a shard that was made elsewhere; gives its number."""
    shard, content = sent
    with whole(_shard_file(folder, shard)) as part:
        part.write_bytes(content)
    return shard


@per_car  # compiling and loading take as long as a shard
def _filler(plan: Plan) -> SlotFiller:
    """The filler of this process."""
    return SlotFiller(plan)


def write_shard(filler: SlotFiller, folder: Path, shard: int, facts: dict[str, Any]) -> None:
    """Fill the slots of a shard and write it, whole or not at all."""
    plan = filler.plan
    first = shard * SLOTS_PER_SHARD
    slots = [filler.slot(i) for i in range(first, min(first + SLOTS_PER_SHARD, plan.slots))]
    rows = plan.rows_of(shard)
    columns = {name: np.concatenate([s[name] for s in slots])[:rows] for name in dataset.COLUMNS}
    dataset.write(_shard_file(folder, shard), columns, {**facts, "shard": shard})


def _whole(folder: Path, shard: int, plan: Plan, facts: dict[str, Any]) -> bool:
    """Whether a shard is there, undamaged, and belongs to the plan."""
    path = _shard_file(folder, shard)
    if not path.is_file():
        return False
    try:
        data = dataset.read(path)
    except DataError:  # cut off by a full disk, perhaps: it is driven again
        return False
    same = all(data.meta.get(key) == value for key, value in {**facts, "shard": shard}.items())
    return same and data.checked and len(data) == plan.rows_of(shard)


def merge(plan: Plan, folder: Path, out: Path, facts: dict[str, Any]) -> None:
    """Join the shards in order into one file, with flat memory."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    texts = dataset.metadata(facts)
    fields = dataset.schema().with_metadata(texts)
    digest = Digest()
    with (
        whole(out) as part,
        pq.ParquetWriter(part, fields, compression="zstd", write_statistics=False) as writer,
    ):
        waiting, rows = [], 0
        for shard in range(plan.shards):
            table = pq.ParquetFile(_shard_file(folder, shard)).read()
            digest.add({n: table[n].to_numpy() for n in dataset.COLUMNS})
            waiting.append(table.replace_schema_metadata(fields.metadata))
            rows += table.num_rows
            if rows >= ROW_GROUP or shard == plan.shards - 1:
                writer.write_table(pa.concat_tables(waiting), row_group_size=rows)
                waiting, rows = [], 0
        told = {key: json.loads(text) for key, text in texts.items()}
        writer.add_key_value_metadata({SHA256: json.dumps(digest.hexdigest(told))})
