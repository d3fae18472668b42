"""Speed measurements that need processes of their own: start-up, and many simulations at once."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from lpvmpc.bench.speed import Figure
from lpvmpc.errors import LPVMPCError
from lpvmpc.plant.plant import Plant

# --- start-up ---

PROBE = """
import os, time
from lpvmpc import LPVMPC

class Probe(LPVMPC):
    calls = 0
    def command(self, state, preview):
        self.calls += 1
        if self.calls == 2:  # the car has been driven for one period
            print(time.monotonic(), flush=True)
            os._exit(0)
        return super().command(state, preview)
"""
"""A user's controller that says when it is called for the second time."""


def measure_start(rounds: int = 5) -> list[Figure]:
    """Wall time of `lpvmpc track --help`, and from a start to the end of the first period.

    Compiled code is cached: one start that is not counted sees to that.

    Args:
        rounds: Number of rounds.
    """
    script = [sys.executable, "-m", "lpvmpc", "track"]
    help_s, help_cpu, first_s, first_cpu = [], [], [], []
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "probe.py").write_text(PROBE)
        drive = [*script, "--controller", "probe:Probe", "--out", folder]
        for i in range(rounds + 1):
            begin, cpu = time.monotonic(), children_cpu()
            subprocess.run([*script, "--help"], stdout=subprocess.DEVNULL, check=True)
            helped, cpu_helped = time.monotonic(), children_cpu()
            answer = subprocess.run(drive, cwd=folder, capture_output=True, text=True, check=True)
            if i:
                help_s.append(helped - begin)
                help_cpu.append(cpu_helped - cpu)
                first_s.append(float(answer.stdout.split()[-1]) - helped)
                first_cpu.append(children_cpu() - cpu_helped)
    return [
        Figure(key="help_s", text="lpvmpc track --help", unit="s", rounds=tuple(help_s), limit=1.5),
        Figure(key="help_cpu_s", text="the same, CPU time", unit="s", rounds=tuple(help_cpu)),
        Figure(key="first_step_s", text="lpvmpc track, start to first physics step", unit="s",
               rounds=tuple(first_s), limit=4.0),
        Figure(key="first_step_cpu_s", text="the same, CPU time", unit="s",
               rounds=tuple(first_cpu)),
    ]


def children_cpu() -> float:
    """CPU time of all processes that this one started and that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


# --- many simulations at once ---

WORKER = """
import sys
from lpvmpc.bench.speed_processes import time_rollouts
threads, seconds = 1, int(sys.argv[1])
time_rollouts(threads, 2, 1)
print("ready", flush=True)
for line in sys.stdin:
    print(time_rollouts(threads, int(line), seconds), flush=True)
"""


def time_rollouts(threads: int, simulations: int, seconds: int) -> float:
    """Wall time of rollouts from a car at 15 m/s, steered at random [s]."""
    plant = Plant()
    plant.reset(vx=15.0)
    periods = round(seconds / plant.Ts)
    commands = np.random.default_rng(0).standard_normal((simulations, periods, 2)) * [0.03, 0.5]
    begin = time.perf_counter()
    plant.rollout(plant.save(), commands, threads=threads)
    return time.perf_counter() - begin


def measure_rollouts(rounds: int = 5, simulations: int = 16, seconds: int = 2) -> list[Figure]:
    """Plant.rollout with one and two threads, and what two busy processes do to each other.

    The calibration runs the one-threaded rollouts in one process alone, then in two at once: two
    undisturbed cores would do twice the work in the same time. What two threads gain is to be
    compared with that.

    Args:
        rounds: Number of rounds.
        simulations: Simulations per rollout.
        seconds: Simulated time of each [s].
    """
    command = [sys.executable, "-c", WORKER, str(seconds)]
    pipe = subprocess.PIPE
    workers = [subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) for _ in range(2)]
    rows = []
    try:
        for worker in workers:
            _ask(worker, None)
        for _ in range(rounds):
            one, two = (time_rollouts(threads, simulations, seconds) for threads in (1, 2))
            alone = _ask(workers[0], simulations)
            for worker in workers:
                _tell(worker, simulations)
            both = max(_ask(worker, None) for worker in workers)
            rows.append((one, two, alone, both))
    finally:
        for worker in workers:
            worker.communicate()  # closes its input, at which it ends
    one, two, alone, both = np.array(rows).T
    work = simulations * seconds
    return [
        Figure(key="rollout_1_realtime_factor", text="Plant.rollout, 1 thread", unit="x",
               rounds=tuple(work / one), pick="most"),
        Figure(key="rollout_2_realtime_factor", text="Plant.rollout, 2 threads", unit="x",
               rounds=tuple(work / two), pick="most"),
        Figure(key="rollout_scaling", text="gain of the second thread", unit="x",
               rounds=tuple(one / two), pick="middle"),
        Figure(key="two_process_scaling", text="calibration: gain of a second process", unit="x",
               rounds=tuple(2.0 * alone / both), pick="middle"),
    ]


def _tell(worker: subprocess.Popen[str], simulations: int) -> None:
    """Let a worker begin."""
    assert worker.stdin is not None
    worker.stdin.write(f"{simulations}\n")
    worker.stdin.flush()


def _ask(worker: subprocess.Popen[str], simulations: int | None) -> float:
    """Wait for a worker's answer, after telling it to begin where a number is given."""
    if simulations is not None:
        _tell(worker, simulations)
    assert worker.stdout is not None
    answer = worker.stdout.readline().strip()
    if not answer:
        raise LPVMPCError("A process of the two-process calibration ended before it answered.")
    return 0.0 if answer == "ready" else float(answer)


# --- the machine meanwhile ---


class Load:
    """How busy the machine is with other work between two moments."""

    def __init__(self) -> None:
        """Begin now."""
        self.wall, self.own, self.all = time.monotonic(), self._own(), self._all()

    def describe(self) -> str:
        """Load average now, and the cores kept busy by others since the beginning."""
        text = f"load average {os.getloadavg()[0]:.1f}"
        wall = time.monotonic() - self.wall
        if self.all is not None and wall > 0.0:
            others = (self._all() or 0.0) - self.all - (self._own() - self.own)
            text += f", {max(others, 0.0) / wall:.1f} cores busy with other work"
        return text

    @staticmethod
    def _own() -> float:
        """CPU time of this process and of its ended children [s]."""
        return sum(os.times()[:4])

    @staticmethod
    def _all() -> float | None:
        """CPU time of all processes since the machine started, with what a host stole [s]."""
        stat = Path("/proc/stat")
        if not stat.exists():
            return None
        user, nice, system, _idle, _iowait, irq, softirq, steal = (
            int(word) for word in stat.read_text().split()[1:9]
        )
        ticks = os.sysconf("SC_CLK_TCK")
        return (user + nice + system + irq + softirq + steal) / ticks
