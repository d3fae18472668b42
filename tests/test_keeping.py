"""Nothing that was measured is lost: standard output that fails, signals, locks, kills."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import dataclass

import pytest

from lpvmpc.errors import OutputError
from lpvmpc.kit import cli, locks
from lpvmpc.kit.files import replacing
from lpvmpc.kit.progress import Bar
from lpvmpc.reliability import kills
from lpvmpc.reliability.kills_report import kills_section

# Standard output ----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Options:
    """Nothing."""


def save_after_printing(folder):
    def main(options):
        for _ in range(20_000):
            print("a line that is longer than what a buffer would hold of it in the end")
        (folder / "saved").touch()
        return 0

    return main


def test_a_full_disk_under_stdout_ends_no_run_and_is_told(tmp_path, monkeypatch, capsys):
    with open("/dev/full", "w") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert cli.run(Options, save_after_printing(tmp_path), []) == 2
        assert sys.stdout is full
    assert (tmp_path / "saved").exists()
    said = capsys.readouterr().err
    assert said == "Error: Cannot write to standard output: No space left on device.\n"


def test_a_reader_that_leaves_ends_no_run(tmp_path, monkeypatch, capsys):
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "w") as pipe:
        monkeypatch.setattr(sys, "stdout", pipe)
        assert cli.run(Options, save_after_printing(tmp_path), []) == 0
    assert (tmp_path / "saved").exists() and capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("closed", "code"),
    [(">&-", 0), ("2>&-", 0), (">&- 2>&-", 0), ("> /dev/full", 2), ("| head -c 1", 0)],
)
def test_a_command_without_its_streams_says_no_more_than_that(closed, code):
    line = f"exec 3>&2; ({sys.executable} -m lpvmpc {closed}) ; echo $? >&3"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
    assert done.returncode == 0
    said = done.stderr.splitlines()
    assert said[-1] == str(code) and len(said) == 1 + (code == 2) and "Traceback" not in said[0]


def test_help_of_a_command_that_a_full_disk_has_lost_is_told():
    line = f"{sys.executable} -m lpvmpc track --help > /dev/full"
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == "Error: Cannot write to standard output: No space left on device.\n"


# Signals ------------------------------------------------------------------------------------------

WAITS = """
    import signal, sys, time
    from dataclasses import dataclass
    from lpvmpc.kit import cli
    from lpvmpc.kit.progress import Bar
    from lpvmpc.kit.signals import ctrl_c_waits

    @dataclass(frozen=True, kw_only=True)
    class Options:
        "Nothing."

    def wait(seconds):
        print("ready", flush=True)
        time.sleep(seconds)

    def main(options):
        {body}
        return 0

    {before}
    sys.exit(cli.run(Options, main))
"""


def told(signals, body="wait(30)", before=""):
    """Exit code and what was said when a process that waits gets signals."""
    # as from a terminal, also where the tests themselves were started to ignore it
    script = "import signal\nsignal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
    script += textwrap.dedent(WAITS).format(body=body.replace("\n", "\n    "), before=before)
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "ready\n"
        for number in signals:
            process.send_signal(number)
            time.sleep(0.05)
        out, err = process.communicate(timeout=60)
    return process.returncode, out + err


@pytest.mark.parametrize("signals", [
    [signal.SIGTERM], [signal.SIGHUP], [signal.SIGINT], [signal.SIGHUP, signal.SIGTERM],
])
def test_a_signal_is_ctrl_c_and_twice_is_once(signals):
    body = "try: wait(30)\nfinally: time.sleep(0.3); print('saved')"
    assert told(signals, body) == (130, "saved\nInterrupted.\n")


def test_what_the_process_was_started_to_ignore_stays_ignored():
    before = "signal.signal(signal.SIGHUP, signal.SIG_IGN); signal.signal(2, signal.SIG_IGN)"
    body = "wait(0.5); print('through')"
    assert told([signal.SIGHUP, signal.SIGINT], body, before) == (0, "through\n")
    assert told([signal.SIGTERM], before=before) == (130, "Interrupted.\n")
    waiting = "with ctrl_c_waits(): wait(0.5); print('done')\ntime.sleep(30)"
    assert told([signal.SIGINT, signal.SIGTERM], waiting, before) == (130, "done\nInterrupted.\n")


@pytest.mark.parametrize("body", [
    "class Deaf:\n    def __del__(self): wait(0.3)\nDeaf(); time.sleep(30)",
    "try: wait(30)\nexcept BaseException as e: raise ImportError('failed') from e",
    "try: wait(30)\nexcept BaseException: pass\ntime.sleep(2.5); Bar().at(1); time.sleep(30)",
])
def test_a_signal_that_a_library_swallows_stops_the_run_without_a_traceback(body):
    begin = time.monotonic()
    assert told([signal.SIGTERM], body) == (130, "Interrupted.\n")
    assert time.monotonic() - begin < 25.0


def test_a_bar_stops_nothing_that_was_not_told():
    Bar().at(0.5)


# Locks --------------------------------------------------------------------------------------------

HOLDS = """
import sys, time
from pathlib import Path
from lpvmpc.kit import locks
for name in sys.argv[2:] or [""]:
    locks.claim(Path(sys.argv[1]), name)
print("held", flush=True)
time.sleep(60)
"""


def holder(*words):
    process = subprocess.Popen([sys.executable, "-c", HOLDS, *map(str, words)],
                               stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    return process


def test_a_second_run_in_a_folder_is_told_and_a_dead_one_is_no_obstacle(tmp_path):
    with holder(tmp_path) as first:
        with locks.claims(), pytest.raises(OutputError) as caught:
            cli.results_folder(tmp_path)
        assert f"Another run (process {first.pid}, " in str(caught.value)
        assert f"is writing into {str(tmp_path)!r}; wait for it" in str(caught.value)
        with locks.claims():
            cli.results_folder(tmp_path, "speed")  # another name beside it
        first.kill()
        first.wait()
    assert (tmp_path / ".lock").exists()
    (tmp_path / f".new.{first.pid}.part").mkdir()
    (tmp_path / f"x.csv.{first.pid}.part").touch()
    with locks.claims():
        cli.results_folder(tmp_path)
        cli.results_folder(tmp_path)  # it is ours
        assert [file.name for file in tmp_path.iterdir()] == [".lock"]
    assert not list(tmp_path.iterdir())


def test_a_nested_run_gives_back_its_own_claims_only(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with locks.claims():
        locks.claim(tmp_path / "a")
        with locks.claims():
            locks.claim(tmp_path / "a")
            locks.claim(tmp_path / "b")
        assert (tmp_path / "a" / ".lock").exists() and not (tmp_path / "b" / ".lock").exists()


def test_every_command_claims_the_folder_that_it_writes(tmp_path, monkeypatch, capsys):
    from importlib import import_module

    monkeypatch.chdir(tmp_path)
    out = tmp_path / "out"
    out.mkdir()
    names = {"ablation": ("--out", "out"), "benchmark": ("--out", "out"), "fidelity": ("--out",
             "out"), "reproduce": ("--out", "out"), "speed": ("--out", "out"), "worlds": ("--out",
             "out"), "compare": ("--out", "out"), "track": ("--out", "out"), "tune": ("--out",
             "out"), "collect": ("--out", "out/x.parquet")}
    locked = {"reproduce": "paper", "collect": "x.parquet", "track": "", "compare": "", "tune": ""}
    with holder(out, *{locked.get(name, name) for name in names}) as first:
        for name, words in names.items():
            command = import_module(f"lpvmpc.commands.{name}")
            assert cli.run(command.Options, command.main, list(words)) == 2, name
            said = capsys.readouterr()
            assert said.out == "" and said.err.startswith("Error: Another run"), name
        first.kill()


# Results ------------------------------------------------------------------------------------------


def test_results_are_exchanged_together(tmp_path):
    for name in ("a.md", "a.csv"):
        (tmp_path / name).write_text("old")
    with pytest.raises(ZeroDivisionError), replacing(tmp_path, ["a.md", "a.csv"]) as new:
        (new / "a.md").write_text("new")
        raise ZeroDivisionError
    assert (tmp_path / "a.md").read_text() == "old"


# Kills --------------------------------------------------------------------------------------------


def test_results_are_compared_without_their_times(tmp_path):
    whole, place = tmp_path / "a", tmp_path / "b"
    for folder, took in ((whole, 1.0), (place, 2.0)):
        folder.mkdir()
        (folder / "a.json").write_text(f'[{{"wall_s": {took}, "x": 1}}]')
        (folder / "a.csv").write_text("1")
    job = kills.Job(name="x", words=(), results=("*.json", "*.csv", "*.png"))
    assert kills.differences(job, whole, place) == ["*.png, of which there is none"]
    (place / "a.csv").write_text("2")
    (whole / "c.png").touch()
    (place / "a.json").write_text('[{"wall_s": 1.0, "x": 2}]')
    assert kills.differences(job, whole, place) == ["a.json", "a.csv", "c.png"]


def test_what_a_kill_did_wrong_is_in_the_report():
    kill = {"signal": "SIGTERM", "after_s": 1.0, "code": 130, "resumed": True, "done": False}
    good, bad = kills.Kill(**kill), kills.Kill(**kill, wrong=("2 of its processes stayed",))
    found = kills.Killed(job="tune", seed=0, kills=(good, bad), compared=2, anew=0,
                         differing=("run 2 after kill 2: a.csv",))
    section = kills_section([found], 0)
    assert section.rows == (("tune", 2, 0, 2, 2, 2, 1, 1),)
    assert [finding.ok for finding in section.findings] == [False, False]
    assert section.faults == ("tune, kill 2 (SIGTERM after 1.0 s): 2 of its processes stayed",
                              "tune, run 2 after kill 2: a.csv")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["collect", "tune", "train"])
def test_what_was_killed_and_resumed_is_what_was_never_interrupted(name, tmp_path):
    pytest.importorskip("torch" if name == "train" else "numpy")
    found = kills.kill_often(kills.JOBS[name], 2, 0, tmp_path)
    assert found.compared >= 1 and found.wrong == []
    assert sum(not kill.done for kill in found.kills) == 2
