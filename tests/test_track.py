import json
import os
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from lpvmpc import published
from lpvmpc.picture import figures
from lpvmpc.sim.metrics import KEYS

COMMAND = "track"


@pytest.fixture
def sketch(monkeypatch):
    """One empty file in place of the figures, which take seconds."""

    def save_all(log, folder):
        folder.mkdir(exist_ok=True)
        (folder / "sketch.png").touch()

    monkeypatch.setattr(figures, "save_all", save_all)


@pytest.fixture
def road(tmp_path):
    """A straight road of 40 m, driven at 10 m/s."""
    return write_csv(tmp_path / "road.csv", np.column_stack([np.linspace(0, 40, 41), np.zeros(41)]))


def write_csv(path, points, speed=10.0):
    rows = "".join(f"{x},{y},3,3,{speed}\n" for x, y in points)
    path.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n" + rows)
    return path


def test_a_picture_that_fails_does_not_cost_the_run(run, road, tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "save_all", lambda log, folder: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run("--scenario", road, "--controller", "stanley")
    folder = tmp_path / "runs" / "road-stanley"
    assert json.loads((folder / "metrics.json").read_text())["completed"]
    assert (folder / "trace.parquet").exists() and not (folder / "figures").exists()


def test_a_controller_that_goes_elsewhere_takes_no_results_with_it(run, sketch, road, user_module,
                                                                   tmp_path):
    module = user_module(
        "import os\n"
        "class Goes:\n"
        "    def reset(self, rng): os.chdir('/')\n"
        "    def command(self, state, preview): return 0.0, 0.0\n"
    )
    code, _, err = run("--scenario", road, "--controller", f"{module}:Goes", "--out", "here")
    assert (code, err) == (0, "") and Path.cwd() == tmp_path
    assert (tmp_path / "here" / "metrics.json").exists()


# A run that works -------------------------------------------------------------------------------


def test_a_run_leaves_everything_promised(run, road, tmp_path):
    code, out, err = run("--scenario", road, "--json", tmp_path / "copy.json", "--seed", 5)
    assert (code, err) == (0, "")
    folder = tmp_path / "runs" / "road-lpv-mpc"
    result = json.loads((folder / "metrics.json").read_text())
    record = result.pop("record")
    assert tuple(result) == KEYS and result["completed"] and result["seed"] == 5
    assert result == json.loads((tmp_path / "copy.json").read_text())
    assert record["options"]["wind_scale"] == 1.0 and record["weights"]["q_ey"] > 0.0
    for name in ("trace.parquet", "timing.parquet"):
        assert (folder / name).stat().st_size > 1000
    assert list((folder / "figures").glob("*.png"))
    assert not list(folder.rglob("*.part"))
    assert "lateral error, RMSE" in out and "Completed." in out
    assert max(len(line) for line in out.splitlines()) <= 80


def test_the_same_seed_gives_the_same_trace(run, road, sketch, tmp_path):
    traces = []
    for folder in ("a", "b"):
        assert run("--scenario", road, "--out", tmp_path / folder)[0] == 0
        traces.append((tmp_path / folder / "trace.parquet").read_bytes())
    assert traces[0] == traces[1]


def test_a_users_controller_is_driven_and_judged(run, road, sketch, user_module):
    name = user_module(
        "class Left:\n"
        "    def reset(self, rng): pass\n"
        "    def command(self, state, preview): return 0.3, 0.0\n"
    )
    code, out, err = run("--scenario", road, "--controller", f"{name}:Left", "--out", "here")
    assert code == 3 and err == ""
    assert "Not completed: off the path" in out
    result = json.loads(Path("here/metrics.json").read_text())
    assert not result["completed"] and result["qp"]["solved"] == 0


def test_the_paper_is_beside_the_papers_scenario_only():
    assert published.TRACKING["lateral_rmse_m"] == 0.0217


def test_a_weights_file_is_driven_and_recorded(run, road, tmp_path, sketch):
    (tmp_path / "mine.toml").write_text('controller = "lpv-mpc"\n[weights]\nq_ey = 33.0\n')
    code, out, _ = run("--scenario", road, "--weights", tmp_path / "mine.toml")
    record = json.loads((tmp_path / "runs/road-lpv-mpc/metrics.json").read_text())["record"]
    assert code == 0 and record["weights"]["q_ey"] == 33.0
    assert record["clamped_inputs"] == 0 and "outside the trained range" in out


def test_a_network_of_another_car_is_a_warning(run, road, sketch, monkeypatch):
    from lpvmpc.plant import mjcf

    monkeypatch.setattr(mjcf, "car_sha256", lambda model: "another")
    code, _, err = run("--scenario", road)
    assert code == 0 and err.count("\n") == 1
    assert "trained on another car than the one in use" in err
    code, _, err = run("--scenario", road, "--stiffness", "constant")
    assert (code, err) == (0, "")


def test_what_a_road_asks_too_much_is_one_line_and_recorded(run, sketch, tmp_path):
    fast = write_csv(tmp_path / "fast.csv", [(x, 0.0) for x in range(40)], speed=0)
    rows = fast.read_text().splitlines()
    speeds = [10.0 if x < 20 else 25.0 for x in range(40)]
    rows[1:] = [f"{row[:-1]}{v}" for row, v in zip(rows[1:], speeds, strict=True)]
    fast.write_text("\n".join(rows))
    code, _, err = run("--scenario", fast, "--controller", "stanley", "--smoothing", 20)
    assert code == 0 and err.count("\n") == 1
    assert err.startswith("Warning: The reference speed of fast asks for more than the car has: ")
    record = json.loads(Path("runs/fast-stanley/metrics.json").read_text())["record"]
    assert record["warnings"] == [err.removeprefix("Warning: ").strip()]
    assert record["options"]["smoothing"] == 20.0


# Bad input: exit code 2 and one sentence --------------------------------------------------------

PARAMETERS = [
    (["--scenario", "papers"], "Unknown scenario 'papers'; the choices are"),
    (["--controller", "mpc"], "Unknown controller 'mpc'; the choices are lmpc-pso-pid,"),
    (["--controller", "absent:Mine"], "Controller 'absent:Mine' cannot be imported"),
    (["--weights", "absent.toml"], "Weights file 'absent.toml' cannot be read: No such file"),
    (["--controller", "stanley", "--stiffness", "network"], "stiffness is 'network', but must be"),
    (["--controller", "mine:Mine", "--stiffness", "network"], "is your own: it has only what"),
    (["--wind-scale", "-1"], "wind_scale is -1.0, but must be a number from 0 to 10"),
    (["--wind-scale", "nan"], "wind_scale is nan"),
    (["--friction", "0"], "friction is 0.0, but must be a number from 0.05 to 2"),
    (["--friction", "inf"], "friction is inf"),
    (["--seed", "-1"], "--seed is -1"),
    (["--seed", "x"], "--seed is 'x', but must be a whole number"),
    (["--v-max", "-3"], "v_max is -3.0, but must be a number from 1 to 60 m/s"),
    (["--v-max", "1e9"], "v_max is 1000000000.0"),
    (["--ay-max", "0"], "ay_max is 0.0"),
    (["--grip", "2"], "grip is 2.0"),
    (["--grip", "x"], "--grip is 'x', but must be a number"),
    (["--ay-max", "4", "--grip", "0.5"], "both set the same limit"),
    (["--closed", "--no-closed"], "--closed and --no-closed exclude each other"),
    (["--delay", "-1"], "--delay is -1, but must be from 0 to 30 periods"),
    (["--delay", "0.5"], "--delay is '0.5', but must be a whole number"),
    (["--step-timeout", "0"], "--step-timeout is 0.0"),
    (["--stiffness", "oracl"], "--stiffness is 'oracl', but must be one of constant, network"),
    (["--smoothing", "5"], "smoothing is 5.0, but must be left out: paper is made of no points"),
    (["--laps", "0"], "laps is 0, but must be a whole number from 1 to 100"),
    (["--laps", "2"], "laps is 2, but must be 1: the road of paper is not closed"),
    (["--start-offset", "6", "0"], "start_offset is (6.0, 0.0), but must be two numbers, ey from"),
    (["--start-offset", "0", "nan"], "start_offset is (0.0, nan)"),
    (["--start-offset", "1"], "--start-offset"),
    (["--absent"], "Unrecognized options: --absent"),
]


@pytest.mark.parametrize(("arguments", "sentence"), PARAMETERS)
def test_bad_options_are_one_sentence(run, arguments, sentence, tmp_path):
    code, out, err = run(*arguments)
    assert code == 2 and out == ""
    assert sentence in err
    assert err.startswith("Error: ") and err.count("\n") == 1
    assert not list(tmp_path.iterdir())  # nothing was begun


CIRCLE = [(3.0 * np.cos(a), 3.0 * np.sin(a)) for a in np.linspace(0, 6.2, 60)]
FILES = [
    ("absent", None, "absent.csv"),
    ("empty", "", "empty.csv"),
    ("header", "# x_m,y_m\n", "header.csv"),
    ("column", "# x_m\n1\n2\n3\n", "column.csv"),
    ("text", "# x_m,y_m\na,b\nc,d\n", "text.csv"),
    ("nan", "# x_m,y_m\n" + "0,0\n5,0\nnan,0\n15,0\n20,0\n", "nan.csv"),
    ("short", "# x_m,y_m\n0,0\n1,0\n", "short.csv"),
    ("tight", "# x_m,y_m\n" + "".join(f"{x},{y}\n" for x, y in CIRCLE),
     "has a radius of 3.00 m at 0.0 m, but the car cannot turn tighter than"),
    ("slow", "# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n"
     + "".join(f"{x},0,3,3,-1\n" for x in range(60)), "slow.csv"),
]


@pytest.mark.parametrize(("name", "text", "sentence"), FILES, ids=[f[0] for f in FILES])
def test_bad_tracks_are_one_sentence(run, tmp_path, name, text, sentence):
    file = tmp_path / f"{name}.csv"
    if text is not None:
        file.write_text(text)
    code, out, err = run("--scenario", file)
    assert code == 2 and out == ""
    assert sentence in err
    assert err.startswith("Error: ") and err.count("\n") == 1


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_a_place_that_cannot_be_written_is_found_before_driving(run, road, tmp_path, option):
    (tmp_path / "file").write_text("in the way")
    target = tmp_path / "file" / "x" if option == "--out" else tmp_path / "file" / "x.json"
    code, out, err = run("--scenario", road, option, target)
    assert code == 2 and out == ""
    assert "Cannot write into" in err and err.count("\n") == 1


BROKEN = """
import time
class Base:
    def reset(self, rng): pass
class Nan(Base):
    def command(self, state, preview): return float("nan"), 0.0
class Shape(Base):
    def command(self, state, preview): return 1.0, 2.0, 3.0
class Raises(Base):
    def command(self, state, preview): raise ValueError("not today")
class Hangs(Base):
    def command(self, state, preview):
        while True: pass
"""


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("Nan", "returned (nan, 0.0) at t = 0.000 s, but must return two finite numbers"),
        ("Shape", "returned (1.0, 2.0, 3.0)"),
        ("Raises", "raised in command at t = 0.000 s: ValueError: not today"),
        ("Hangs", "did not return from command within 0.5 s at t = 0.000 s"),
        ("Absent", "has no class 'Absent'"),
        ("Base", "has no method 'command'"),
    ],
)
def test_bad_controllers_are_one_sentence(run, road, user_module, name, sentence):
    module = user_module(BROKEN)
    code, out, err = run(
        "--scenario", road, "--controller", f"{module}:{name}", "--step-timeout", 0.5
    )
    assert code == 2 and out == ""
    assert f"'mine:{name}'" in err and sentence in err
    assert err.startswith("Error: ") and err.count("\n") == 1


def test_in_a_process_of_its_own_it_drives_the_same(run, road, sketch, user_module, tmp_path):
    user_module(BROKEN + "class Good(Base):\n    def command(self, *_): return 0.0, 0.0\n"
                "class Exits(Base):\n    calls = 0\n    def command(self, state, preview):\n"
                "        import os\n        self.calls += 1\n"
                "        return (0.0, 0.0) if self.calls < 9 else os._exit(3)\n")
    for words in ((), ("--isolate",)):
        assert run("--scenario", road, "--controller", "mine:Good", "--out", f"x{len(words)}",
                   *words)[0] == 0
    assert Path("x0/trace.parquet").read_bytes() == Path("x1/trace.parquet").read_bytes()
    code, out, err = run("--scenario", road, "--controller", "mine:Exits", "--isolate", "--out",
                         "exits")
    assert code == 3 and err == ""
    assert "ended its process with code 3 in command" in " ".join(out.split())
    assert json.loads(Path("exits/metrics.json").read_text())["lateral_max_m"] is not None


def test_a_run_that_fails_midway_leaves_the_last_results(run, road, sketch, user_module, tmp_path):
    user_module(BROKEN)
    folder = tmp_path / "out"
    assert run("--scenario", road, "--out", folder)[0] == 0
    before = {file: file.read_bytes() for file in folder.rglob("*.*")}
    assert len(before) == 4 and folder / "metrics.json" in before
    assert run("--scenario", road, "--out", folder, "--controller", "mine:Nan")[0] == 2
    assert {file: file.read_bytes() for file in folder.rglob("*.*")} == before


def test_results_are_replaced_together(run, road, sketch, user_module, tmp_path):
    folder = tmp_path / "out"
    assert run("--scenario", road, "--out", folder)[0] == 0
    (folder / "notes.txt").write_text("mine")
    (folder / "figures" / "old.png").touch()
    assert run("--scenario", road, "--out", folder, "--controller", "stanley")[0] == 0
    assert json.loads((folder / "metrics.json").read_text())["controller"] == "stanley"
    names = sorted(file.name for file in folder.rglob("*"))
    assert names == ["figures", "metrics.json", "notes.txt", "sketch.png", "timing.parquet",
                     "trace.parquet"]


def test_a_mistyped_option_leaves_the_last_run_alone(run, road, sketch, tmp_path):
    folder = tmp_path / "out"
    assert run("--scenario", road, "--out", folder)[0] == 0
    assert run("--scenario", road, "--out", folder, "--controller", "mine")[0] == 2
    assert (folder / "metrics.json").exists()


# Pictures, displays, interrupts -----------------------------------------------------------------


def test_a_machine_that_cannot_draw_is_a_warning(run, road, sketch, monkeypatch):
    from lpvmpc.errors import RenderError
    from lpvmpc.picture.video import render

    def cannot(*arguments, **options):
        raise RenderError("No EGL on this machine.")

    monkeypatch.setattr(render, "render_video", cannot)
    code, out, err = run("--scenario", road, "--render", "--out", "here")
    assert code == 0 and "Completed." in out
    assert err == "Warning: no video: No EGL on this machine.\n"


def test_glfw_without_a_display_is_one_warning(run, road, sketch, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        code, _, err = run("--scenario", road, "--render", "--out", "here")
    assert code == 0 and err.count("\n") == 1
    assert err.startswith("Warning: no video: No OpenGL through glfw, which needs a display")
    assert Path("here/metrics.json").exists()


def test_a_file_whose_name_is_no_text_is_driven_and_saved(run, road, tmp_path):
    odd = os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.csv")
    os.rename(road, odd)
    code, out, err = run("--scenario", odd, "--controller", "stanley")
    assert code == 0 and err == "" and "stanley on caf\ufffd" in out
    result = json.loads(Path("runs/caf--stanley/metrics.json").read_text(encoding="utf-8"))
    assert result["scenario"] == "caf\ufffd"
    assert result["record"]["options"]["scenario"].endswith("/caf\ufffd.csv")
    assert list(Path("runs/caf--stanley/figures").glob("*.png"))
    assert run("--scenario", odd[:-5] + "a.csv")[0] == 2


def test_a_road_that_was_left_is_said_beside_the_verdict(run, tmp_path, sketch):
    narrow = tmp_path / "narrow.csv"
    narrow.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n"
                      + "".join(f"{x},0,1.2,1.2\n" for x in range(0, 120, 2)))
    code, out, err = run("--scenario", narrow, "--controller", "stanley",
                         "--start-offset", 1, 0)
    assert (code, err) == (0, "")
    result = json.loads(Path("runs/narrow-stanley/metrics.json").read_text())
    assert result["completed"] and 0.3 < result["left_road_s"] < 0.5 * result["duration_s"]
    assert f"Completed, but {result['left_road_s']:.2f} s off the road." in out


def test_the_viewer_needs_a_display(run, road, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    code, out, err = run("--scenario", road, "--view")
    assert code == 2 and out == ""
    assert "--view needs a display" in err and err.count("\n") == 1


SLOW = """
import time
class Slow:
    def reset(self, rng): open("started", "w").close()
    def command(self, state, preview):
        time.sleep(0.05)
        return 0.0, 0.0
"""


@pytest.mark.parametrize("told", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_saves_what_was_measured(road, user_module, tmp_path, root, told):
    user_module(SLOW)
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "metrics.json").write_text('{"reason": "earlier"}')
    process = subprocess.Popen(
        [sys.executable, str(root / "eval" / "track.py"), "--scenario", str(road),
         "--controller", "mine:Slow", "--out", "here"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )
    deadline = time.monotonic() + 120.0
    while not (tmp_path / "started").exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    time.sleep(0.5)
    assert "earlier" in (tmp_path / "here" / "metrics.json").read_text()
    os.kill(process.pid, told)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err == ""
    assert "Not completed: interrupted." in out
    result = json.loads((tmp_path / "here" / "metrics.json").read_text())
    assert result["reason"] == "interrupted" and not result["completed"]
    assert 0.0 < result["duration_s"] < 4.0
    assert (tmp_path / "here" / "trace.parquet").exists()


def test_a_dead_display_is_one_sentence(run, road, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":987")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    code, out, err = run("--scenario", road, "--view", "--out", "here")
    assert code == 2 and err.count("\n") == 1
    assert "No window can be opened on this display; --render" in err


# Worlds ------------------------------------------------------------------------------------------


def test_a_world_of_ones_own_is_driven_and_recorded(run, road, tmp_path, sketch):
    (tmp_path / "heavy.toml").write_text("base = 'rtk'\n[car]\nmass = 1.1\n")
    code, out, err = run("--scenario", road, "--controller", "stanley", "--world", "heavy.toml",
                         "--estimator", "none", "--latency", 20, "--seed", 3)
    assert (code, err) == (0, "")
    result = json.loads((tmp_path / "runs" / "road-stanley" / "metrics.json").read_text())
    assert result["world"]["name"] == "heavy" and result["estimator"] == "none"
    assert result["world"]["drawn"]["car"] == {"mass": 1.1}
    assert result["world"]["drawn"]["latency"] == 0.02
    assert result["record"]["estimator_events"] == 0
    assert "world heavy, estimator none" in out and "error of the estimated position" in out
    assert max(len(line) for line in out.splitlines()) <= 80


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--world", "moon"), "Unknown world 'moon'"),
        (("--world", "none.toml"), "The world 'none.toml' cannot be read"),
        (("--latency", 20.5), "--latency is 20.5, but must be a whole number of milliseconds"),
        (("--latency", 300), "--latency is 300.0, but must be from 0 to 200 ms"),
        (("--world", "rtk", "--estimator", "guess"), "Unknown estimator 'guess'"),
    ],
)
def test_what_is_wrong_with_a_world_is_one_line(run, road, options, text):
    code, _, err = run("--scenario", road, *options)
    assert code == 2 and text in err and err.count("\n") == 1
