"""How fast the environments are: beside the bare physics, on two cores, and beside others.

    python eval/environments.py --out docs/results

Exit codes: 0 measured, bars met or not; 2 bad input; 130 interrupted.
"""

from __future__ import annotations

import copy
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np

from lpvmpc.gym.one import Starts
from lpvmpc.gym.track import TrackEnv
from lpvmpc.gym.track_vec import TrackVecEnv
from lpvmpc.kit import cli
from lpvmpc.kit.markdown import markdown_table
from lpvmpc.kit.provenance import machine
from lpvmpc.kit.report import csv_text, record, versions_line, write_report
from lpvmpc.plant import callbacks
from lpvmpc.plant.plant import Plant

CARS = 64
"""Cars of the vector environment."""
BARE, TWO_CORES = 0.85, 0.9
"""Bars: share of the bare physics' rate, and share of the two-process calibration's gain."""
BLOCK = 10
"""Control periods after which the environment and the bare models take turns."""
DEFINITIONS = """\
Definitions: CPU times are those of the whole process with one thread, rates are control \
periods of 33 ms a second of it; a round does all measurements in turn, environment and bare \
models in blocks of {block} periods, a rate is the best round's, a ratio the middle round's. \
"Bare" is 64 MjData of one model, each stepped 33 times by `mj_step`, nothing read and nothing \
written: with our tire callbacks (a car on its tires; the same physics as the environment's), and \
without (the same multibody car afloat, no gravity, no tires); their ratio is the most that the \
share of the latter could be. The environment adds actions, road, observation, reward, ends and \
new episodes, which begin in steady states that a process settles once; here before anything is \
timed, which took {settling:.0f} s of CPU. The gain of two threads is wall time; the calibration \
is two processes with one thread each against one alone.

What each simulates in a step: `TrackVec-v0` 33 physics steps of a 16-dof multibody car with \
four Pacejka tires, servo and drive; in `rtk` sensors and a Kalman filter besides. \
CarRacing-v3: a step of 20 ms of a planar Box2D car, and draws its 96 x 96 picture, which is \
its observation.
"""


@dataclass(frozen=True, kw_only=True)
class Options:
    """Measure how fast the environments are."""

    rounds: int = 5
    """Rounds of every measurement."""
    periods: int = 100
    """Control periods of a round."""
    out: Path = Path("runs/environments")
    """Folder for environments.md, .csv and .json."""


def main(options: Options) -> int:
    """Measure, print, save; returns the exit code."""
    cli.check_number("--rounds", options.rounds, 1, 100)
    cli.check_number("--periods", options.periods, 10, 100_000)
    out = cli.results_folder(options.out, "environments")
    rows, settling = measure(options.rounds, options.periods)
    text = report(rows, options.rounds, settling)
    table = csv_text(("quantity", "value", "unit", "bar", "ok", "rounds"), [
        (name, value, unit, None if bar is None else str(bar),
         None if bar is None else value >= bar, " ".join(f"{v:.6g}" for v in each))
        for name, value, unit, bar, each in rows
    ])
    values = {"values": {name: value for name, value, *_ in rows},
              "record": record(rounds=options.rounds, periods=options.periods)}
    files = write_report(out, "environments", text=text, table=table, values=values)
    print(text, end="")
    print(f"Saved {out}/ ({', '.join(file.name for file in files)})")
    return cli.DONE


Row = tuple[str, float, str, float | None, list[float]]
"""Quantity, value, unit, bar, rounds."""


def measure(rounds: int, periods: int) -> tuple[list[Row], float]:
    """All figures, and the CPU time in which the steady states were settled [s]."""
    settling, _ = spent(Starts(Plant()).settle_all)
    one, two = (TrackVecEnv(CARS, threads=threads) for threads in (1, 2))
    rtk = TrackVecEnv(CARS, threads=1, worlds=("rtk",))
    alone = TrackEnv()
    for env in (one, two, rtk, alone):
        env.reset(seed=0)  # type: ignore[attr-defined]
    plant, datas = Plant(), []
    for _ in range(CARS):
        plant.reset(vx=12.0)
        datas.append(mujoco.MjData(plant.model))
        mujoco.mj_copyData(datas[-1], plant.model, plant.data)
    afloat, floating = _afloat(plant)
    racing = _racing()
    rng = np.random.default_rng(0)
    lists: dict[str, list[float]] = {}

    def keep(name: str, value: float) -> None:
        lists.setdefault(name, []).append(value)

    workers = [_worker(periods) for _ in range(2)]
    try:
        for worker in workers:
            _ask(worker, False)
        for _ in range(rounds):
            actions = rng.uniform(-1.0, 1.0, (periods, CARS, 2)).astype(np.float32)
            cpu_one = wall_one = cpu_bare = cpu_afloat = 0.0
            for k in range(0, periods, BLOCK):
                block = actions[k : k + BLOCK]
                pace = len(block), plant.nstep
                cpu, wall = spent(lambda a=block: [one.step(x) for x in a])  # type: ignore[misc]
                cpu_one, wall_one = cpu_one + cpu, wall_one + wall
                cpu_bare += spent(partial(_all, plant.model, datas, *pace))[0]
                callbacks.uninstall()
                try:
                    cpu_afloat += spent(partial(_all, afloat, floating, *pace))[0]
                finally:
                    callbacks.install()
            _, wall_two = spent(lambda a=actions: [two.step(x) for x in a])  # type: ignore[misc]
            cpu_rtk, _ = spent(lambda a=actions: [rtk.step(x) for x in a])  # type: ignore[misc]
            cpu_alone, _ = spent(lambda a=actions: _drive(alone, a[:, 0]))  # type: ignore[misc]
            single = _ask(workers[0], True)
            for worker in workers:
                _tell(worker)
            both = max(_ask(worker, False) for worker in workers)
            count = CARS * periods
            keep("TrackVec-v0, 64 cars, ideal", count / cpu_one)
            keep("TrackVec-v0, 64 cars, rtk", count / cpu_rtk)
            keep("Track-v0, ideal", periods / cpu_alone)
            keep("64 bare models with tires", count / cpu_bare)
            keep("64 bare models afloat", count / cpu_afloat)
            keep("share of the bare models with tires", cpu_bare / cpu_one)
            keep("share of the bare models afloat", cpu_afloat / cpu_one)
            keep("ratio of the bare models, with tires to afloat", cpu_afloat / cpu_bare)
            keep("gain of two threads", wall_one / wall_two)
            keep("gain of two processes", 2.0 * single / both)
            keep("gain, threads against processes", (wall_one / wall_two) / (2.0 * single / both))
            if racing is not None:
                cpu_racing, _ = spent(lambda: _drive_racing(racing, periods))
                keep("CarRacing-v3", periods / cpu_racing)
    finally:
        for worker in workers:
            worker.communicate()
    bars = {"share of the bare models with tires": BARE, "share of the bare models afloat": BARE,
            "gain, threads against processes": TWO_CORES}
    rows: list[Row] = []
    for name, values in lists.items():
        ratio = name.startswith(("share", "gain", "ratio"))
        value = statistics.median(values) if ratio else max(values)
        rows.append((name, value, "" if ratio else "1/s of CPU", bars.get(name), values))
    return rows, settling


def report(rows: list[Row], rounds: int, settling: float) -> str:
    """The report in Markdown; what does not hold comes first."""
    missed = [f"{name} is {value:.2f}, the bar {bar:g}" for name, value, _, bar, _ in rows
              if bar is not None and value < bar]
    others = [] if any(name.startswith("CarRacing") for name, *_ in rows) else ["CarRacing-v3"]
    lacking = ", ".join([*others, "f1tenth_gym"])
    lines = [
        "# Speed of the gymnasium environments", "",
        f"Bars not met: {'; '.join(missed)}." if missed else "All bars are met.",
        f"Not measured, since not installed: {lacking}.", "",
        f"Machine: {machine()}.", versions_line(), "",
        DEFINITIONS.format(block=BLOCK, settling=settling),
    ]
    header = ("quantity", "value", "rounds", "unit", "bar")
    body = [
        (name, _number(value), f"{_number(min(each))} to {_number(max(each))}", unit,
         "" if bar is None else f">= {bar:g}") for name, value, unit, bar, each in rows
    ]
    lines += [markdown_table(f"{rounds} rounds", header, body),
              "Made by `python eval/environments.py`; the rounds are in environments.csv."]
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def spent(call: Callable[[], Any]) -> tuple[float, float]:
    """CPU time of this process and wall time of a call [s]."""
    cpu, wall = time.process_time(), time.perf_counter()
    call()
    return time.process_time() - cpu, time.perf_counter() - wall


def _all(model: mujoco.MjModel, datas: list[mujoco.MjData], periods: int, nstep: int) -> None:
    for _ in range(periods):
        for data in datas:
            mujoco.mj_step(model, data, nstep=nstep)


def _afloat(plant: Plant) -> tuple[mujoco.MjModel, list[mujoco.MjData]]:
    """The car without gravity and loads, rolling at its usual height."""
    model = copy.copy(plant.model)
    model.opt.gravity[:] = 0.0
    model.qpos_spring[:] = model.qpos0
    found = []
    for _ in range(CARS):
        data = mujoco.MjData(model)
        data.qpos[2] = plant.data.qpos[2]
        data.qvel[0] = 12.0
        found.append(data)
    return model, found


def _drive(env: TrackEnv, actions: Any) -> None:
    for action in actions:
        *_, lost, over, _ = env.step(action)
        if lost or over:
            env.reset()


def _racing() -> Any:
    try:
        env = gymnasium.make("CarRacing-v3")
        env.reset(seed=0)
    except (gymnasium.error.Error, ImportError):
        return None
    return env


def _drive_racing(env: Any, periods: int) -> None:
    for _ in range(periods):
        *_, lost, over, _ = env.step(env.action_space.sample())
        if lost or over:
            env.reset()


WORKER = """
import sys, time
import numpy as np
from lpvmpc.gym.one import Starts
from lpvmpc.gym.track_vec import TrackVecEnv
from lpvmpc.plant.plant import Plant
Starts(Plant()).settle_all()
periods = int(sys.argv[1])
env = TrackVecEnv(64, threads=1)
env.reset(seed=0)
actions = np.random.default_rng(0).uniform(-1.0, 1.0, (periods, 64, 2)).astype(np.float32)
[env.step(action) for action in actions]
print("ready", flush=True)
for line in sys.stdin:
    begin = time.perf_counter()
    [env.step(action) for action in actions]
    print(time.perf_counter() - begin, flush=True)
"""
"""One process of the calibration: drives when told to, and says how long it took."""


def _worker(periods: int) -> subprocess.Popen[str]:
    pipe = subprocess.PIPE
    return subprocess.Popen([sys.executable, "-c", WORKER, str(periods)], stdin=pipe, stdout=pipe,
                            text=True)


def _tell(worker: subprocess.Popen[str]) -> None:
    assert worker.stdin is not None
    worker.stdin.write("\n")
    worker.stdin.flush()


def _ask(worker: subprocess.Popen[str], first: bool) -> float:
    """A worker's answer; `first`: after telling it to begin."""
    if first:
        _tell(worker)
    assert worker.stdout is not None
    answer = worker.stdout.readline().strip()
    return 0.0 if answer == "ready" else float(answer)
