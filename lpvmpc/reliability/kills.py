"""Commands killed at random moments and resumed: is anything lost, left behind or changed?

A command of the package is run to its end once, and then again and again in a folder of its own,
each time killed after a random part of that time, by SIGKILL or SIGTERM in turn. Each start goes on
from what the kill before has left, so a kill may well strike a run that is itself resumed. When one
reaches its end, its files are compared with those of the uninterrupted run, byte by byte; where
they hold times (JSON), these are left out. `eval/reliability.py` reports it.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lpvmpc.errors import LPVMPCError
from lpvmpc.kit.cli import BAD_INPUT

MARK = "LPVMPC_KILLED"
"""Environment variable by which all processes of a run are found."""
TIMES = frozenset({"step_time_us", "wall_s", "realtime_factor", "record", "seconds"})
"""Keys in JSON files that hold times, or where and when the file was made."""
NOTHING = ("no tuning to resume", "needs the results of an earlier")
"""What --resume says where the kill came before anything was begun."""
PATIENCE = 600.0
"""Longest time of a run [s]."""
LEFT = 10.0
"""Time after the end of a command within which its workers must have ended [s]."""
ROAD = "# x_m,y_m\n" + "".join(f"{x},0\n" for x in range(0, 62, 2))


@dataclass(frozen=True, kw_only=True)
class Job:
    """A command, small enough to be killed often."""

    name: str
    """What to call it."""
    words: tuple[str, ...]
    """The command and its options; it writes into the current folder."""
    resume: tuple[str, ...] = ("--resume",)
    """Options with which it goes on; none where the same command does, over its own results."""
    results: tuple[str, ...]
    """Files that must be the same, as patterns."""
    first: tuple[tuple[str, ...], ...] = ()
    """Commands that make what it needs."""


_QUICK = ("--quick", "--controllers", "stanley", "--jobs", "2", "--out", "out", "--cache", "kept")
JOBS = {job.name: job for job in (
    Job(
        name="collect",
        words=("collect", "--samples", "2400", "--jobs", "2", "--out", "data.parquet"),
        results=("data.parquet", "data-coverage.png"),
    ),
    Job(
        name="tune",
        words=("tune", "--controller", "stanley", "--scenario", "road.csv", "--worlds", "ideal",
               "--generations", "4", "--population", "4", "--jobs", "2", "--out", "out"),
        results=("out/weights.toml", "out/history.csv", "out/tuning.json", "out/convergence.png"),
    ),
    Job(
        name="train",
        words=("train", "--data", "data.parquet", "--out", "net.safetensors", "--epochs", "40",
               "--seeds", "1"),
        results=("net.safetensors", "net-fit/*"),
        first=(("collect", "--samples", "2400", "--jobs", "2", "--out", "data.parquet"),),
    ),
    Job(
        name="worlds",
        words=("worlds", "--seeds", "1", "--parts", "worlds", *_QUICK),
        results=("out/worlds.csv", "out/worlds.png", "kept/*.json"),
    ),
    Job(
        name="benchmark",
        words=("benchmark", *_QUICK),
        results=("out/benchmark.csv", "kept/*.json"),
    ),
    Job(
        name="track --render",
        words=("track", "--scenario", "road.csv", "--controller", "stanley", "--v-max", "10",
               "--render", "--out", "out"),
        resume=(),
        results=("out/metrics.json", "out/trace.parquet", "out/figures/[!c]*.png",
                 "out/figures/commands.png", "videos/*"),
    ),
)}
"""Jobs by name."""


@dataclass(frozen=True, kw_only=True)
class Kill:
    """One kill."""

    signal: str
    """Name of the signal."""
    after_s: float
    """When it struck, from the start of the process [s]."""
    code: int
    """How the process ended: minus the signal's number, or its exit code."""
    resumed: bool
    """Whether what it struck had been resumed, or driven over earlier results."""
    done: bool
    """Whether the process was through before it."""
    nothing: bool = False
    """Whether it refused to go on, since nothing had been begun."""
    wrong: tuple[str, ...] = ()
    """What it must not have done, in sentences."""


@dataclass(frozen=True, kw_only=True)
class Killed:
    """What came of a job."""

    job: str
    """Its name."""
    seed: int
    """Seed of moments and signals."""
    kills: tuple[Kill, ...]
    """All kills."""
    compared: int
    """Runs that were resumed to their end and compared with the uninterrupted one."""
    anew: int
    """Starts that were told that nothing had been begun, and began anew."""
    differing: tuple[str, ...]
    """Files that differed, of which run."""

    @property
    def wrong(self) -> list[str]:
        """Everything that is wrong; empty where nothing is."""
        found = [f"kill {i + 1} ({kill.signal} after {kill.after_s:.1f} s): {what}"
                 for i, kill in enumerate(self.kills) for what in kill.wrong]
        return found + list(self.differing)


def kill_often(
    job: Job,
    count: int,
    seed: int,
    folder: Path,
    say: Callable[[str], None] = lambda _: None,
) -> Killed:
    """Kill a job so many times, resuming it in between.

    Args:
        job: What to kill.
        count: Number of kills that strike a running process.
        seed: Seed of the moments and of the signals.
        folder: An empty folder to work in.
        say: Told about each kill.

    Raises:
        LPVMPCError: The job does not even run uninterrupted.
    """
    rng = random.Random(seed)
    whole, place = folder / "whole", folder / "killed"
    _prepare(job, whole)
    begin = time.monotonic()
    _to_end(job.words, whole)
    length = time.monotonic() - begin
    kills: list[Kill] = []
    struck, compared, anew, differing = 0, 0, 0, list[str]()
    fresh, full = True, False  # nothing is there; whole results of an earlier run are
    while struck < count:
        if fresh:
            shutil.rmtree(place, ignore_errors=True)
            shutil.copytree(whole, place, ignore=shutil.ignore_patterns(*_made(job, whole)))
        words = job.words if fresh else (*job.words, *job.resume)
        number = (signal.SIGKILL, signal.SIGTERM)[len(kills) % 2]
        kill = _kill(words, place, rng.uniform(0.0, length), number, resumed=not fresh)
        if not fresh and job.resume and kill.code == BAD_INPUT and kill.nothing:
            anew, fresh = anew + 1, True
            continue
        if full and number == signal.SIGKILL and (lost := differences(job, whole, place)):
            sentence = f"the earlier results are gone: {', '.join(lost)}"
            kill = replace(kill, wrong=(*kill.wrong, sentence))
        kills.append(kill)
        say(f"{job.name}: {kill.signal} after {kill.after_s:.1f} s, code {kill.code}"
            + "".join(f"; WRONG: {what}" for what in kill.wrong))
        struck += not kill.done
        fresh = False
        full &= number == signal.SIGKILL or kill.done  # what SIGTERM stopped has been saved
        if kill.done or struck == count or rng.random() < 0.3:
            anew += _go_on(job, place)
            compared += 1
            full = not job.resume
            differing += [f"run {compared} after kill {len(kills)}: {file}"
                          for file in differences(job, whole, place)]
            fresh = bool(job.resume)
    return Killed(
        job=job.name, seed=seed, kills=tuple(kills), compared=compared, anew=anew,
        differing=tuple(differing),
    )


def differences(job: Job, whole: Path, place: Path) -> list[str]:
    """Results that are not the same in two folders."""
    found = []
    for pattern in job.results:
        names = sorted({
            str(file.relative_to(folder)) for folder in (whole, place)
            for file in folder.glob(pattern)
        })
        if not names:
            found.append(f"{pattern}, of which there is none")
        found += [name for name in names if content(whole / name) != content(place / name)]
    return found


def content(file: Path) -> Any:
    """What is compared of a file: its bytes; None without it.

    Of JSON it is a value without `TIMES`; of a video, which shows how long each step took, the
    number of its pictures.
    """
    try:
        data = file.read_bytes()
        if file.suffix == ".mp4":
            return _pictures(file)
        return _timeless(json.loads(data)) if file.suffix == ".json" else data
    except FileNotFoundError:
        return None
    except ValueError:
        return data


def _pictures(file: Path) -> int:
    """Number of pictures in a video; fails where it cannot be played."""
    import av

    with av.open(str(file)) as video:
        return sum(1 for _ in video.decode(video=0))


def _timeless(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _timeless(v) for k, v in value.items() if k not in TIMES}
    return [_timeless(item) for item in value] if isinstance(value, list) else value


def _prepare(job: Job, folder: Path) -> None:
    """Make a folder with all that the job needs."""
    folder.mkdir(parents=True)
    (folder / "road.csv").write_text(ROAD)
    for words in job.first:
        _to_end(words, folder)


def _made(job: Job, folder: Path) -> list[str]:
    """What the job itself has made in its folder: nothing of it is to be there at the start."""
    needs = {"road.csv", *(words[words.index("--out") + 1] for words in job.first)}
    return [entry.name for entry in folder.iterdir() if entry.name not in needs]


def _start(words: tuple[str, ...], folder: Path, mark: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "lpvmpc", *words],
        cwd=folder, env={**os.environ, MARK: mark}, start_new_session=True, text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL,
    )


def _to_end(words: tuple[str, ...], folder: Path) -> None:
    """Run a command to its end.

    Raises:
        LPVMPCError: It fails.
    """
    process = _start(words, folder, "")
    _, said = process.communicate(timeout=PATIENCE)
    if process.returncode != 0:
        raise LPVMPCError(f"lpvmpc {' '.join(words)} ended with {process.returncode}: {said}")


def _go_on(job: Job, folder: Path) -> bool:
    """Resume to the end; True where there was nothing to resume, and all was done anew."""
    try:
        _to_end((*job.words, *job.resume), folder)
    except LPVMPCError as error:
        if not any(sentence in str(error) for sentence in NOTHING):
            raise
        _to_end(job.words, folder)
        return True
    return False


def _kill(
    words: tuple[str, ...], folder: Path, after: float, number: signal.Signals, *, resumed: bool
) -> Kill:
    """Start a command, kill it, and see how it ends."""
    mark = f"{os.getpid()}-{time.monotonic_ns()}"
    process = _start(words, folder, mark)
    wrong = []
    try:
        _, said = process.communicate(timeout=after)
        done = True
    except subprocess.TimeoutExpired:
        done = False
        process.send_signal(number)
        _, said = process.communicate(timeout=PATIENCE)
    code = process.returncode
    # before its first instant it ends as every process does
    expected = {0} if done else {0, -number, 130} if number == signal.SIGTERM else {0, -number}
    nothing = code == BAD_INPUT and any(sentence in said for sentence in NOTHING)
    if code not in expected and not nothing:
        wrong.append(f"it ended with {code}, saying {said!r}")
    if said.count("\n") > 1 or "Traceback" in said or "Warning" in said:
        wrong.append(f"it said {said!r}")
    deadline = time.monotonic() + LEFT
    while left := list(_marked(mark)):
        if time.monotonic() > deadline:
            wrong.append(f"{len(left)} of its processes stayed")
            break
        time.sleep(0.05)
    return Kill(
        signal=number.name, after_s=after, code=code, resumed=resumed,
        done=done or code == 0, nothing=nothing, wrong=tuple(wrong),
    )


def _marked(mark: str) -> Iterator[int]:
    """Processes of a run that still live; none are seen where there is no /proc."""
    text = f"{MARK}={mark}".encode()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if text in (folder / "environ").read_bytes().split(b"\0"):
                yield int(folder.name)
        except OSError:  # it has ended, or is another user's
            continue
