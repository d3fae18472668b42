"""Many closed loops side by side: each run has the bytes that it has alone."""

import signal

import numpy as np
import pytest
from mujoco.batch import Batch, SimulationError
from test_batch import write_road

from lpvmpc.bench.together import drive_together
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.sim.batch import Run, drive
from lpvmpc.sim.log import Log


@pytest.fixture(scope="module")
def road(tmp_path_factory):
    return write_road(tmp_path_factory.mktemp("road") / "bend.csv")


def at(track, **more):
    return Run(scenario=track, scenario_options={"v_max": 12.0}, **more)


def outcome(end, folder):
    """All that a run determines: the bytes of its trace, or its error."""
    if not isinstance(end, Log):
        return f"{type(end).__name__}: {end}"
    folder.mkdir(exist_ok=True)
    end.write(folder)
    return (folder / "trace.parquet").read_bytes()


def alone(run, folder):
    try:
        return outcome(drive(run), folder)
    except LPVMPCError as error:
        return outcome(error, folder)


def together(runs, folder, **options):
    found = {i: outcome(end, folder) for i, end in drive_together(runs, **options)}
    return [found[i] for i in range(len(runs))]


def test_each_run_has_the_bytes_that_it_has_alone(road, tmp_path, user_module):
    """With latency, another car, a sloping road, sensors, a lost car and failures among them."""
    user_module("""
class Tired:
    def reset(self, rng): self.left = 9
    def command(self, state, preview):
        self.left -= 1
        return 1 / self.left and (0.0, 0.0)
""")
    runs = [
        at(road), at(road, world="fleet", seed=3), at(road, controller="stanley", world="rtk"),
        at(road, world="production", seed=1, delay=2), Run(scenario="nowhere"),
        at(road, world="fleet-production", seed=5),
        at(road, controller="mine:Tired"), at(road, start_offset=(4.0, 1.2), road=0.3),
        at(road, deviations={"mass": 1.2}, latency=0.05),
    ]
    expected = [alone(run, tmp_path / "one") for run in runs]
    assert expected[4].startswith("UnknownNameError: Unknown scenario 'nowhere'")
    assert len(set(expected)) == len(runs)
    # fewer cars than runs, so that cars go from one run to the next; then one at a time
    assert together(runs, tmp_path / "two", cars=4, threads=2) == expected
    assert together(runs, tmp_path / "two", cars=1, threads=1) == expected


def test_a_car_that_cannot_be_moved_takes_no_other_with_it(road, tmp_path, monkeypatch):
    step, calls = Batch.step, []

    def fails_once(self, ids, nstep):
        calls.append(ids)
        step(self, ids, nstep=nstep)
        if len(calls) == 5:
            raise SimulationError(np.array([1]), "the solver gave up", 2)

    monkeypatch.setattr(Batch, "step", fails_once)
    monkeypatch.setattr(Batch, "error", lambda self, i: f"the solver gave up on {i}")
    runs = [at(road), at(road, controller="stanley")]
    ends = dict(drive_together(runs, cars=2, threads=1))
    assert sorted(isinstance(end, Log) for end in ends.values()) == [False, True]
    (error,) = (end for end in ends.values() if not isinstance(end, Log))
    assert str(error) == "the solver gave up on 1"
    (good,) = (i for i, end in ends.items() if isinstance(end, Log))
    assert outcome(ends[good], tmp_path / "two") == alone(runs[good], tmp_path / "one")


def test_ctrl_c_ends_them_all(road, user_module):
    user_module("""
import os, signal
class Impatient:
    def reset(self, rng): self.left = 9
    def command(self, state, preview):
        self.left -= 1
        if not self.left:
            os.kill(os.getpid(), signal.SIGINT)
        return 0.0, 0.0
""")
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        list(drive_together([at(road), at(road, controller="mine:Impatient")], cars=2))
    assert signal.getsignal(signal.SIGINT) == before


@pytest.mark.parametrize("options", [{"cars": 0}, {"cars": 5000}, {"cars": 2.0}, {"threads": -1}])
def test_impossible_numbers_are_refused(road, options):
    (name,) = options
    with pytest.raises(OptionError, match=f"{name} is {options[name]}, but must be a whole number"):
        list(drive_together([at(road)], **options))
