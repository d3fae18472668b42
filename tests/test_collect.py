import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from lpvmpc.errors import DataError, LPVMPCError, OptionError, OutputError
from lpvmpc.learn import collect as collection
from lpvmpc.learn import coverage, dataset
from lpvmpc.learn.collect import Plan, collect

COMMAND = "collect"


@pytest.fixture
def small_shards(monkeypatch):
    """A shard per slot, so that short collections have several."""
    monkeypatch.setattr(collection, "SLOTS_PER_SHARD", 1)


# What is collected ------------------------------------------------------------------------------


def test_a_collection_has_the_samples_asked_for_and_says_what_it_is(run, tmp_path):
    code, out, err = run("--samples", 300, "--jobs", 1, "--out", "d/s.parquet", "--seed", 4)
    assert (code, err) == (0, "")
    data = dataset.read(tmp_path / "d" / "s.parquet")
    assert len(data) == 300 and data.kinds == ["ramp-steer", "sine-sweep", "step-steer"]
    assert data.meta["seed"] == 4 and data.meta["friction"] == [1.0, 1.0]
    assert len(data.meta["car_sha256"]) == 64 and data.meta["versions"]["mujoco"]
    assert set(data["friction"]) == {1.0} and set(data["mass_kg"]) == {1575.0}
    assert "samples/s" in out and "step-steer" in out
    assert max(len(line) for line in out.splitlines()) <= 80
    assert (tmp_path / "d" / "s-coverage.png").stat().st_size > 10_000
    assert sorted(f.name for f in (tmp_path / "d").iterdir()) == ["s-coverage.png", "s.parquet"]


def test_friction_and_mass_vary_by_run_within_their_ranges(run, tmp_path):
    args = ("--friction", 0.4, 1.0, "--mass", 1500, 1800)
    assert run("--samples", 300, "--jobs", 1, "--out", "s.parquet", *args)[0] == 0
    data = dataset.read(tmp_path / "s.parquet")
    for name, low, high in (("friction", 0.4, 1.0), ("mass_kg", 1500.0, 1800.0)):
        values = set(data[name])
        assert len(values) == len(set(data["run"])) and min(values) >= low and max(values) <= high
    # 10 %: braking, roll and wind move load for moments
    weight = data["Fzf_N"] + data["Fzr_N"]
    np.testing.assert_allclose(weight, 9.81 * data["mass_kg"], rtol=0.1)


# The same bytes ---------------------------------------------------------------------------------


def test_one_and_two_jobs_give_the_same_bytes(tmp_path):
    plan = Plan(samples=1700, seed=1)
    for jobs in (1, 2):
        collect(plan, tmp_path / f"{jobs}.parquet", jobs=jobs)
    assert (tmp_path / "1.parquet").read_bytes() == (tmp_path / "2.parquet").read_bytes()


def test_an_interrupted_collection_resumes_to_the_same_bytes(tmp_path, small_shards):
    plan = Plan(samples=500, seed=2)
    collect(plan, tmp_path / "whole.parquet")
    out = tmp_path / "s.parquet"

    def stop(rows):
        if rows >= 256:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(plan, out, progress=stop)
    assert not out.exists()
    assert collect(plan, out, resume=True) == 256
    assert out.read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    assert collect(plan, out, resume=True) == 500, "a finished collection is left alone"
    assert not (tmp_path / "s.parquet.parts").exists()


def test_shards_that_are_damaged_or_of_another_plan_are_driven_again(tmp_path, small_shards):
    plan, out = Plan(samples=380, seed=2), tmp_path / "s.parquet"

    def stop(rows):
        if rows >= 256:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(plan, out, progress=stop)
    parts = tmp_path / "s.parquet.parts"
    first, second = sorted(parts.glob("shard-*.parquet"))
    second.write_bytes(second.read_bytes()[:-200])
    foreign = tmp_path / "foreign.parquet"
    with pytest.raises(KeyboardInterrupt):
        collect(Plan(samples=380, seed=3), foreign, progress=stop)
    shutil.copy(tmp_path / "foreign.parquet.parts" / first.name, first)
    assert collect(plan, out, resume=True) == 0
    collect(plan, tmp_path / "whole.parquet")
    assert out.read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def test_a_killed_collection_resumes_to_the_same_bytes(tmp_path):
    command = [sys.executable, "-m", "lpvmpc", "collect", "--samples", "2400", "--jobs", "2"]
    process = subprocess.Popen(
        [*command, "--out", "s.parquet"], cwd=tmp_path,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )
    parts = tmp_path / "s.parquet.parts"
    deadline = time.monotonic() + 240.0
    while not list(parts.glob("shard-*.parquet")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert not (tmp_path / "s.parquet").exists()
    collect(Plan(samples=2400), tmp_path / "s.parquet", resume=True)
    collect(Plan(samples=2400), tmp_path / "whole.parquet")
    assert (tmp_path / "s.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()


def test_ctrl_c_says_how_to_go_on(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "lpvmpc", "collect", "--samples", "50000", "--jobs", "2",
         "--out", "s.parquet"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    deadline = time.monotonic() + 240.0
    while not (tmp_path / "s.parquet.parts" / "plan.json").exists():
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.02)
    time.sleep(0.2)
    os.kill(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out) == (130, "")
    assert err == "Interrupted; --resume goes on from here.\n"


def test_memory_does_not_grow_with_the_samples(tmp_path, small_shards, monkeypatch):
    # what is held at once while merging: fewer rows than ROW_GROUP and a shard
    monkeypatch.setattr(collection, "ROW_GROUP", 256)
    import pyarrow.parquet as pq

    collect(Plan(samples=700), tmp_path / "s.parquet")
    groups = pq.ParquetFile(tmp_path / "s.parquet").metadata
    sizes = [groups.row_group(i).num_rows for i in range(groups.num_row_groups)]
    assert sizes == [256, 256, 188]
    pieces = [len(rows["run"]) for rows in dataset.batches(tmp_path / "s.parquet", 100)]
    assert max(pieces) <= 100 and sum(pieces) == 700


# Coverage ---------------------------------------------------------------------------------------


def test_coverage_counts_alike_in_one_piece_and_in_many(tmp_path):
    collect(Plan(samples=700), tmp_path / "s.parquet")
    one, many = coverage.Coverage(), coverage.Coverage()
    for found, rows in ((one, 10_000), (many, 37)):
        for piece in dataset.batches(tmp_path / "s.parquet", rows):
            found.add(piece)
    assert one.kinds == many.kinds
    assert np.array_equal(one.histograms, many.histograms)
    data = dataset.read(tmp_path / "s.parquet")
    assert sum(kind.runs for kind in one.kinds.values()) == len(set(data["run"]))


# Bad input --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, sentence",
    [
        (("--samples", 0), "samples is 0, but must be a whole number from 1"),
        (("--samples", "many"), "--samples"),
        (("--seed", -1), "seed is -1"),
        (("--jobs", -2), "--jobs is -2"),
        (("--friction", 0.1), "friction is (0.1, 0.1)"),
        (("--friction", 1.0, 0.5), "friction is (1.0, 0.5)"),
        (("--friction", "nan"), "friction is (nan, nan)"),
        (("--friction", 0.5, 0.6, 0.7), "--friction is (0.5, 0.6, 0.7)"),
        (("--mass", 100), "mass is (100.0, 100.0)"),
        (("--out", "data.csv"), "--out is 'data.csv', but must be a file name ending in .parquet"),
    ],
)
def test_bad_options_are_one_sentence(run, arguments, sentence):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("Error: ") and err.count("\n") == 1 and sentence in err


def test_an_unwritable_place_is_one_sentence(run, tmp_path):
    (tmp_path / "file").write_text("")
    code, out, err = run("--out", "file/s.parquet")
    assert (code, out) == (2, "")
    assert err.startswith("Error: Cannot write into 'file'") and err.count("\n") == 1
    with pytest.raises(OutputError, match="Cannot write"):
        collect(Plan(samples=10), Path("/proc/none/s.parquet"))


def test_resuming_with_other_options_is_refused(run, tmp_path, small_shards):
    def stop(rows):
        if rows >= 128:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        collect(Plan(samples=300), tmp_path / "s.parquet", progress=stop)
    code, _, err = run("--samples", 300, "--seed", 5, "--out", "s.parquet", "--resume")
    assert code == 2 and "was begun with seed 0, but now it is 5" in err
    (tmp_path / "s.parquet.parts" / "plan.json").write_text("{")
    with pytest.raises(DataError, match="damaged; start without --resume"):
        collect(Plan(samples=300), tmp_path / "s.parquet", resume=True)


def die(*arguments):
    """A worker that the system kills, for want of memory perhaps."""
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_worker_that_dies_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(collection, "_work", die)
    with pytest.raises(LPVMPCError, match="A worker process died.*--resume"):
        collect(Plan(samples=1700), tmp_path / "s.parquet", jobs=2)


def test_jobs_have_bounds(tmp_path):
    with pytest.raises(OptionError, match="jobs is 0"):
        collect(Plan(samples=10), tmp_path / "s.parquet", jobs=0)
