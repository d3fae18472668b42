"""Work on a Ray cluster of two nodes on this machine: the same answers, also when a node dies."""

import signal
import sys
import time

import numpy as np
import pyarrow.parquet as pq
import pytest

from lpvmpc.kit.workers import workers
from lpvmpc.sim.batch import Run, drive_all
from lpvmpc.sim.metrics import KEYS

pytestmark = [
    pytest.mark.slow,
    # Ray's own: files and sockets that it leaves to the collector, and what it says of the future
    pytest.mark.filterwarnings("ignore"),
]
NUMBERS = [key for key in KEYS if key not in ("step_time_us", "wall_s", "realtime_factor")]


@pytest.fixture
def cluster(monkeypatch):
    """A head and a second node, one CPU each; all gone afterwards."""
    ray = pytest.importorskip("ray", reason="needs lpvmpc[cluster]")
    from ray.cluster_utils import Cluster

    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])  # nodes do not have the tests
    monkeypatch.setenv("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")
    told = signal.getsignal(signal.SIGTERM)
    small = {"num_cpus": 1, "object_store_memory": 80 * 1024**2}
    cluster = Cluster(initialize_head=True, head_node_args={**small, "include_dashboard": False})
    try:
        cluster.second = cluster.add_node(**small)
        cluster.wait_for_nodes()
        yield cluster
    finally:
        ray.shutdown()
        cluster.shutdown()
        signal.signal(signal.SIGTERM, told)


@pytest.fixture
def runs(tmp_path):
    """Short runs, one of a controller that does not exist."""
    x = np.arange(0.0, 61.0, 3.0)
    lines = [f"{a:g},{0.002 * a * a:g},4,4" for a in x]
    file = tmp_path / "bend.csv"
    file.write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *lines]) + "\n")
    return [
        *(Run(scenario=str(file), controller=name, world=world, seed=seed)
          for name in ("stanley", "lpv-mpc") for world in ("ideal", "fleet") for seed in (1, 2)),
        Run(controller="nobody"),
    ]


def numbers(results):
    return [{key: result[key] for key in NUMBERS} for result in results]


def slow_square(x):
    time.sleep(1.0)
    return x * x


def test_rows_are_those_of_this_machine(cluster, runs):
    here = drive_all(runs, jobs=1)
    there = drive_all(runs, jobs=0, backend="ray", address=cluster.address)
    assert numbers(there) == numbers(here)
    assert [one["trace_sha256"] for one in there] == [one["trace_sha256"] for one in here]


def test_a_node_that_dies_in_the_middle_is_survived(cluster):
    with workers(2, "ray", cluster.address) as pool:
        answers = pool.each(slow_square, range(12))
        found = [next(answers), next(answers)]
        cluster.remove_node(cluster.second, allow_graceful=False)
        found += answers
    assert sorted(found) == [x * x for x in range(12)]


def test_data_collected_there_have_the_same_bytes(cluster, tmp_path):
    from lpvmpc.learn.collect import Plan, collect

    plan = Plan(samples=600)
    collect(plan, tmp_path / "here.parquet", jobs=1)
    collect(plan, tmp_path / "there.parquet", jobs=2, backend="ray", address=cluster.address)
    assert (tmp_path / "here.parquet").read_bytes() == (tmp_path / "there.parquet").read_bytes()
    assert pq.read_metadata(tmp_path / "there.parquet").num_rows == 600
