import os
import signal
import socket
import subprocess
import sys
import textwrap
import time
from types import SimpleNamespace

import pytest

from lpvmpc.errors import LPVMPCError, OptionError, UnknownNameError
from lpvmpc.kit.workers import workers


def square(x):
    return x * x


def slow_first(x):
    time.sleep(1.0 if x == 0 else 0.0)
    return x


def process_of(_):
    time.sleep(0.05)
    return os.getpid()


def refuse(x):
    errors = {1: OptionError("x", x, "2"), 2: UnknownNameError("thing", "x", ["b", "a"])}
    raise errors[x]


def die(x):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.parametrize("jobs", [1, 2])
def test_answers_come_in_order_or_as_they_are_ready(jobs):
    with workers(jobs) as pool:
        assert pool.map(square, range(20)) == [x * x for x in range(20)]
        assert sorted(pool.each(square, range(20))) == [x * x for x in range(20)]


def test_one_worker_is_this_process_and_more_are_others():
    with workers(1) as pool:
        assert pool.map(process_of, range(3)) == [os.getpid()] * 3
    with workers(2) as pool:
        first, second = set(pool.map(process_of, range(20))), set(pool.map(process_of, range(20)))
    assert os.getpid() not in first | second
    assert len(first | second) <= 2, "workers stay from one call to the next"


def test_what_is_ready_does_not_wait_for_what_is_slow():
    with workers(2) as pool:
        pool.map(square, range(8))  # both are up
        assert list(pool.each(slow_first, range(5)))[-1] == 0


def test_things_are_taken_as_there_is_room():
    taken = []

    def things():
        for x in range(200):
            taken.append(x)
            yield x

    with workers(2) as pool:
        next(pool.each(square, things()))
        assert len(taken) < 20


def test_what_nobody_waits_for_is_ended_at_once_without_a_word():
    begin = time.monotonic()
    with pytest.raises(KeyboardInterrupt), workers(2) as pool:
        for _ in pool.each(time.sleep, [0.0, 300.0, 300.0]):
            raise KeyboardInterrupt
    assert time.monotonic() - begin < 60.0


@pytest.mark.parametrize("x, error, sentence", [
    (1, OptionError, "x is 1, but must be 2."),
    (2, UnknownNameError, "Unknown thing 'x'; the choices are a, b."),
])
def test_an_error_comes_out_of_a_worker_as_it_is(x, error, sentence):
    with pytest.raises(error) as caught, workers(2) as pool:
        pool.map(refuse, [x])
    assert str(caught.value) == sentence


def test_ctrl_c_while_workers_start_is_not_lost():
    def things():
        os.kill(os.getpid(), signal.SIGINT)
        yield from range(50)

    with pytest.raises(KeyboardInterrupt), workers(2) as pool:
        pool.map(slow_first, things())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_worker_that_dies_is_one_sentence_and_the_next_pool_works():
    with pytest.raises(LPVMPCError, match="^It is gone$"), workers(2, died="It is gone") as pool:
        list(pool.each(die, [1]))
    with workers(2) as pool:
        assert pool.map(square, [3]) == [9]


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    (tmp_path / "endless.py").write_text(textwrap.dedent("""
        import pathlib, os, time
        def work(folder):
            pathlib.Path(folder, str(os.getpid())).touch()
            time.sleep(600.0)
    """))
    script = textwrap.dedent("""
        import endless
        from lpvmpc.kit.workers import workers
        with workers(2) as pool:
            pool.map(endless.work, ["pids"] * 2)
    """)
    (tmp_path / "pids").mkdir()
    path = os.pathsep.join([str(tmp_path), *sys.path])
    process = subprocess.Popen([sys.executable, "-c", script], cwd=tmp_path,
                               env={**os.environ, "PYTHONPATH": path})
    deadline = time.monotonic() + 60.0
    while len(pids := [int(file.name) for file in (tmp_path / "pids").iterdir()]) < 2:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    process.kill()
    process.wait()
    while any(map(_runs, pids)):
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("address", ["127.0.0.1:{}", "ray://127.0.0.1:{}"])
def test_a_cluster_where_nobody_listens_is_told_at_once(monkeypatch, address):
    """Ray itself looks for minutes; it is asked only where somebody answers."""
    asked, at_home = [], "127.0.0.2"
    ray = SimpleNamespace(is_initialized=lambda: False, init=lambda **more: asked.append(more),
                          shutdown=lambda: None, cluster_resources=dict,
                          remote=lambda **_: lambda function: function,
                          util=SimpleNamespace(get_node_ip_address=lambda: at_home))
    monkeypatch.setitem(sys.modules, "ray", ray)
    with socket.create_server(("127.0.0.1", 0)) as server:
        here = address.format(server.getsockname()[1])
        with workers(1, "ray", here):
            assert [more["address"] for more in asked] == [here]
    with (
        pytest.raises(LPVMPCError, match=rf"^Ray at '{here}' cannot be reached: .*refused"),
        workers(1, "ray", here),
    ):
        pass
    with workers(1, "ray", "auto"):  # Ray's to find
        assert len(asked) == 2
    with socket.create_server((at_home, 0)) as server:  # Ray takes this machine by its own name
        with workers(1, "ray", address.format(server.getsockname()[1])):
            assert len(asked) == 3


def _runs(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return stat.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
