import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from lpvmpc.control.rivals import Rival
from lpvmpc.errors import LPVMPCError, OptionError
from lpvmpc.sim import batch
from lpvmpc.sim.batch import KEPT, Run, drive_all
from lpvmpc.sim.metrics import KEYS

NUMBERS = [key for key in KEYS if key not in ("step_time_us", "wall_s", "realtime_factor")]


def write_road(file, y=0.002):
    """A gentle bend of 60 m."""
    x = np.arange(0.0, 61.0, 3.0)
    lines = [f"{a:g},{b:g},4,4" for a, b in zip(x, y * x * x, strict=True)]
    file.write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *lines]) + "\n")
    return str(file)


@pytest.fixture
def road(tmp_path):
    return write_road(tmp_path / "bend.csv")


@pytest.fixture
def cache(tmp_path):
    folder = tmp_path / "cache"
    folder.mkdir()
    return folder


def at(track, v_max, **more):
    return Run(scenario=track, scenario_options={"v_max": v_max}, **more)


def numbers(results):
    return [{key: result[key] for key in NUMBERS} for result in results]


def test_one_process_and_two_give_the_same_numbers_in_order(road):
    """Also for the run that fails, which is charged and does not take the others with it."""
    runs = [at(road, 12.0), at(road, 8.0, controller_options={"stiffness": "network"}),
            Run(scenario="nowhere"), at(road, 10.0, road=0.7)]
    alone = drive_all(runs, jobs=1)
    assert numbers(alone) == numbers(drive_all(runs, jobs=2))
    assert [result["completed"] for result in alone] == [True, True, False, True]
    assert alone[0]["duration_s"] < alone[1]["duration_s"]
    assert alone[1]["stiffness"] == "network"
    assert alone[2]["reason"].startswith("Unknown scenario 'nowhere'")
    assert alone[2]["lateral_rmse_m"] is None and set(alone[2]) == set(KEPT)


def test_a_controller_that_raises_is_charged_and_named(road, user_module):
    user_module(textwrap.dedent("""
        class Nervous:
            def reset(self, rng): pass
            def command(self, state, preview): return 1 / 0
    """))
    nervous, good = drive_all([at(road, 10.0, controller="mine:Nervous"), at(road, 10.0)])
    assert not nervous["completed"] and good["completed"]
    assert nervous["reason"].startswith("Controller 'mine:Nervous' raised in command")
    assert nervous["controller"] == "mine:Nervous"


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Some log."""
    return batch.drive(at(write_road(tmp_path_factory.mktemp("road") / "bend.csv"), 10.0))


@pytest.fixture
def driven(log, monkeypatch):
    """The runs that are driven, each of which pretends to give that log, at its own speed."""
    runs = []

    def drive(run):
        runs.append(run)
        batch.load_scenario(run.scenario)
        speed = run.scenario_options["v_max"]
        return dataclasses.replace(log, meta={**log.meta, "duration_s": 60.0 / speed})

    monkeypatch.setattr(batch, "drive", drive)
    return runs


def test_what_was_driven_is_not_driven_again(road, cache, driven):
    told = []
    first = drive_all([at(road, 8.0), at(road, 10.0)], cache=cache)
    runs = [at(road, 12.0), at(road, 10.0, label="again"), at(road, 8.0), at(road, 12.0)]
    again = drive_all(runs, cache=cache, progress=lambda *done: told.append(done))
    assert [again[2], again[1]] == first  # the times too: it is the same run
    assert again[0] == again[3]
    assert len(driven) == 3  # two at first, then the new one, once though it is asked for twice
    assert told == [(2, 4), (4, 4)]
    assert [result["duration_s"] for result in again] == [5.0, 6.0, 7.5, 5.0]


def test_a_run_that_failed_is_driven_again(cache, driven):
    for _ in range(2):
        drive_all([Run(scenario="nowhere")], cache=cache)
    assert len(driven) == 2 and not list(cache.iterdir())


@pytest.mark.parametrize(
    "damage", ["", "{", "[]", '{"completed": true}', "\udcff", "[" * 10**5, '{"result": {}}']
)
def test_a_damaged_result_is_driven_again(road, cache, driven, damage):
    run = at(road, 10.0)
    (whole,) = drive_all([run], cache=cache)
    (file,) = cache.iterdir()
    assert file.name == f"{run.key()}.json"
    file.write_bytes(damage.encode("utf-8", "surrogateescape"))
    (again,) = drive_all([run], cache=cache)
    assert again == whole and len(driven) == 2
    assert json.loads(file.read_text())["result"] == again


def test_a_changed_result_is_driven_again(road, cache, driven):
    (whole,) = drive_all([at(road, 10.0)], cache=cache)
    (file,) = cache.iterdir()
    text = file.read_text()
    digit = str(whole["lateral_rmse_m"])[-1]
    at_ = text.index(str(whole["lateral_rmse_m"])) + len(str(whole["lateral_rmse_m"])) - 1
    file.write_text(text[:at_] + str((int(digit) + 1) % 10) + text[at_ + 1 :])
    assert drive_all([at(road, 10.0)], cache=cache) == [whole] and len(driven) == 2


def test_the_key_is_that_of_all_a_run_depends_on(road, tmp_path, monkeypatch, user_module):
    run = at(road, 10.0)
    key = run.key()
    assert at(road, 10.0, label="another name").key() == key
    others = [at(road, 10.5), at(road, 10.0, road=0.9), at(road, 10.0, seed=1),
              at(road, 10.0, delay=1), at(road, 10.0, controller="stanley"),
              at(road, 10.0, controller_options={"stiffness": "constant"})]
    assert len({key, *(other.key() for other in others)}) == 1 + len(others)
    write_road(tmp_path / "bend.csv", y=0.001)
    assert run.key() != key
    user_module("x = 1\n")
    own = at(road, 10.0, controller="mine:Own").key()
    user_module("x = 2\n")
    assert at(road, 10.0, controller="mine:Own").key() != own
    monkeypatch.setattr(batch, "foundation", lambda rival: "edited")
    assert at(road, 10.0, controller="mine:Own").key() != own


def test_a_run_comes_back_out_of_its_text(road):
    runs = [at(road, 10.0, label="x"), at(road, 10.0, road=((0.0, 1.0), (5.0, 0.5)), seed=3),
            Run(world={"base": "rtk"}, deviations={"mass": 1.1}, start_offset=(0.1, 0.0))]
    for run in runs:
        assert Run.of_text(run.text()) == dataclasses.replace(run, label="")
    for wrong in ("", "[]", "{}", '{"road": 1}', runs[0].text().replace("seed", "sed")):
        with pytest.raises(OptionError):
            Run.of_text(wrong)


def test_a_rival_voids_no_results_but_those_of_rivals(tmp_path, monkeypatch):
    """So that the slow ones of the others are driven once."""
    package = tmp_path / "lpvmpc"
    left_out = shutil.ignore_patterns("__pycache__", "_numba_cache*")
    shutil.copytree(Path(batch.__file__).parents[1], package, ignore=left_out)
    monkeypatch.setattr(batch.resources, "files", lambda _: package)
    monkeypatch.setattr(batch, "_foundation", batch._foundation.__wrapped__)  # not kept
    monkeypatch.setitem(batch.RIVALS, "stanley", Rival(module="none", maker="None"))
    names = ("lpv-mpc", "stanley")

    def keys():
        return [Run(controller=name).key() for name in names]

    first = keys()
    (package / "control" / "rivals" / "another.py").write_text("x = 1\n")
    second = keys()
    assert second[0] == first[0] and second[1] != first[1]
    (package / "control" / "qp.py").write_text("x = 1\n")
    third = keys()
    assert third[0] != first[0] and third[1] != second[1]


def test_a_run_is_plain_and_hashable(road):
    run = at(road, 10.0)
    assert len({run, at(road, 10.0), at(road, 11.0)}) == 2
    with pytest.raises(OptionError, match="plain names and numbers"):
        Run(controller_options={"stiffness": object()})
    with pytest.raises(OptionError, match="plain names and numbers"):
        Run(scenario_options={"grip": float("nan")})
    for bad in (0.0, float("nan"), 9.0, (), ((0.0, 1.0), (5.0, -1.0))):
        with pytest.raises(OptionError, match="friction factors"):
            Run(road=bad)


def test_unannounced_friction_multiplies_what_is_announced(road):
    announced = {"v_max": 10.0, "friction": 0.5}
    steps = ((0.0, 2.0), (20.0, 2.0), (21.0, 1.0))
    run = Run(scenario=road, scenario_options=announced, road=steps)
    friction = batch.scenario_of(run).friction
    assert [friction(s) for s in (0.0, 19.0, 20.5, 30.0)] == [1.0, 1.0, 0.75, 0.5]
    assert batch.scenario_of(at(road, 10.0, road=0.75)).friction(3.0) == 0.75
    assert batch.scenario_of(at(road, 10.0)).friction is None


def test_an_edited_track_is_read_again(road, tmp_path):
    before = batch.scenario_of(at(road, 10.0)).path.length
    write_road(tmp_path / "bend.csv", y=0.01)
    assert batch.scenario_of(at(road, 10.0)).path.length > before + 1.0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"jobs": 0}, "jobs is 0, but must be a whole number from 1"),
        ({"jobs": True}, "jobs is True"),
        ({"backend": "dask"}, "backend is 'dask', but must be local or ray"),
        ({"address": "here:1"}, "address is 'here:1', but must be left out"),
    ],
)
def test_wrong_options_are_refused(road, options, sentence):
    with pytest.raises(OptionError, match=sentence):
        drive_all([at(road, 10.0)], **options)


def test_without_ray_one_sentence_says_how_to_get_it(road, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)  # import ray now raises ImportError
    with pytest.raises(LPVMPCError, match=r"pip install 'lpvmpc\[cluster\]'"):
        drive_all([at(road, 10.0)], backend="ray")


LONG = """
import sys
from lpvmpc.sim.batch import Run, drive_all
if __name__ == "__main__":
    runs = [Run(scenario=sys.argv[1], scenario_options={"v_max": v}) for v in (20.0, 2.0)]
    runs += [Run(scenario="circuit", seed=seed) for seed in range(9)]
    try:
        drive_all(runs, jobs=int(sys.argv[3]), cache=sys.argv[2],
                  progress=lambda done, of: print(done, flush=True))
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_ctrl_c_ends_at_once_and_keeps_what_was_done(road, cache, jobs):
    # its own group of processes, as a terminal has: Ctrl-C reaches the workers too
    process = subprocess.Popen(
        [sys.executable, "-c", LONG, road, str(cache), jobs], stdout=subprocess.PIPE, text=True,
        start_new_session=True,
    )
    for line in process.stdout:
        if line == "1\n":
            break
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=20)  # a lap takes longer than that on a busy machine only
    assert process.returncode == 130
    assert 1 <= len(list(cache.glob("*.json"))) < 11


def test_what_nobody_is_told_is_part_of_the_key_and_of_the_run(road):
    runs = [at(road, 10.0), at(road, 10.0, latency=0.02), at(road, 10.0, deviations={"Cr": 0.8})]
    assert len({run.key() for run in runs}) == 3
    results = drive_all(runs)
    assert len({result["lateral_rmse_m"] for result in results}) == 3
    # the plant of this process is the nominal one again
    assert numbers(drive_all(runs[:1])) == numbers(results[:1])
    with pytest.raises(LPVMPCError, match="Unknown deviation 'weight'"):
        at(road, 10.0, deviations={"weight": 1.0})
