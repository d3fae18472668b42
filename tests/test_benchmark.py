import dataclasses
import json
import math
import re
import shutil
import subprocess
import sys
import time
from html.parser import HTMLParser

import numpy as np
import pyarrow.parquet as pq
import pytest

from lpvmpc.commands import benchmark
from lpvmpc.leaderboard import grid, own_process, page, pictures, report, tables
from lpvmpc.leaderboard.grid import COURSES, Plan, is_slow, planned, rows_of, run_of
from lpvmpc.leaderboard.profiles import profiles
from lpvmpc.leaderboard.score import Board, effort, ranking, score
from lpvmpc.leaderboard.significance import holm, nemenyi, pairs, ranks, wilcoxon
from lpvmpc.leaderboard.verdict import sentences
from lpvmpc.sim import batch
from lpvmpc.sim.batch import KEPT, Run

COMMAND = "benchmark"
FILES = ["benchmark-heat.png", "benchmark-pareto.png", "benchmark-profiles.png",
         "benchmark-rows.parquet", "benchmark-times.parquet", "benchmark.csv", "benchmark.html",
         "benchmark.json", "benchmark.md"]


def result(mm=1.0, *, lost="", late=0, step=90.0):
    """Made-up result of a run with this RMSE [mm]; lost for a reason, so many steps late."""
    return {
        **dict.fromkeys(KEPT, 0.1), "completed": not lost, "reason": lost, "s_end_m": 100.0,
        "lateral_rmse_m": 1e-3 * mm, "lateral_max_m": 5e-3 * mm, "qp": None, "steps": 1000,
        "late_steps": late, "trace_sha256": "00", "wall_s": 1.0,
        "step_time_us": {"mean": step, "p50": step, "p99": 2 * step, "max": 3 * step},
    }


def made_up(changes, **more):
    """A board: RMSE [mm] or a result by controller, or a function of the cell that gives either."""
    plan = Plan(controllers=tuple(changes), **{"seeds": 4, "wind_seeds": 1, **more})
    cells = planned(plan)

    def told(cell, name):
        value = changes[name](cell) if callable(changes[name]) else changes[name]
        return value if isinstance(value, dict) else result(value)

    return Board(rows_of(cells, [told(*pair) for pair in cells])), plan


@pytest.fixture
def slow(monkeypatch):
    """`nmpc` counts as slow, whoever is installed."""
    for module in ("grid", "score", "page"):
        monkeypatch.setattr(f"lpvmpc.leaderboard.{module}.is_slow", lambda name: name == "nmpc")


# What is driven ---------------------------------------------------------------------------------


def test_everybody_drives_the_same_cells_and_no_two_courses_the_same_seeds():
    plan = Plan(controllers=("lpv-mpc", "stanley"))
    assert plan.cells("lpv-mpc") == plan.cells("stanley")
    seeds = {}
    for cell in plan.cells("lpv-mpc"):
        seeds.setdefault((cell.part, cell.course, cell.world), set()).add(cell.seed)
    every = [seed for found in seeds.values() for seed in found]
    assert len(every) == len(set(every)) and min(every) >= grid.FIRST_SEED
    assert len({run_of(cell, "lpv-mpc") for cell in plan.cells("lpv-mpc")}) == len(
        plan.cells("lpv-mpc"))


def test_the_default_grid_is_as_large_as_promised():
    fast = [name for name in grid.CONTROLLERS if not is_slow(name)]
    plan = Plan(controllers=tuple(fast))
    assert len(planned(plan)) >= 2000 and len(COURSES) >= 5 and len(plan.worlds) == 4


def test_a_quick_look_drives_a_tenth_of_the_grid_in_every_world():
    """345 s of CPU with 14 controllers, which is less than 4 minutes of two cores."""
    whole = Plan(controllers=tuple(grid.CONTROLLERS))
    quick = dataclasses.replace(whole, **grid.QUICK)
    assert len(planned(quick)) < 0.1 * len(planned(whole))
    for name in quick.controllers:
        assert {cell.world for cell in quick.cells(name)} == set(quick.worlds)


def test_slow_controllers_drive_a_part_of_what_all_others_do(slow):
    plan = Plan(controllers=("lpv-mpc", "nmpc"))
    part, whole = plan.cells("nmpc"), plan.cells("lpv-mpc")
    assert set(part) < set(whole) and len(part) < len(whole) / 4
    assert {cell.world for cell in part} == set(plan.worlds)


def test_calm_and_windy_cells_are_different_runs():
    plan = Plan(controllers=("stanley",))
    winds = {cell.wind: run_of(cell, "stanley").scenario_options.get("wind_scale")
             for cell in plan.cells("stanley") if cell.course == "paper"}
    assert winds == {1.0: None, 0.0: 0.0, 2.0: 2.0}


# Scores -----------------------------------------------------------------------------------------


def test_who_finishes_more_is_before_who_errs_less():
    board, _ = made_up({"stanley": 50.0,
                        "lpv-mpc": lambda c: result(1.0, lost="hit" if c.seed % 4 == 0 else "")})
    order = ranking(board, board.cells("worlds", "rtk"), board.controllers)
    assert [s.controller for s in order] == ["stanley", "lpv-mpc"]
    assert order[1].p95 == math.inf and order[1].median == pytest.approx(1e-3)


def test_a_controller_that_is_too_late_is_charged_though_its_car_arrives():
    board, _ = made_up({"lpv-mpc": lambda c: result(late=11), "stanley": lambda c: result(late=10)})
    cells = board.cells("worlds", "rtk")
    late, in_time = (score(board.of(name, cells)) for name in ("lpv-mpc", "stanley"))
    assert (late.completed, late.finished) == (late.n, 0) and late.p95 == math.inf
    assert in_time.finished == in_time.n and in_time.late_share == pytest.approx(0.01)


def test_effort_is_compared_on_the_runs_that_all_have_completed():
    board, _ = made_up({
        "lpv-mpc": lambda c: {**result(), "jerk_rms_mps3": 1.0 if c.seed % 2 else 9.0},
        "stanley": lambda c: result(lost="" if c.seed % 2 else "hit"),
        "pure-pursuit": lambda c: result(lost="always"),
    })
    cells = board.cells("worlds", "rtk")
    found = effort(board, cells, board.controllers)
    assert found.n == len(cells) // 2 and set(found.table) == {"lpv-mpc", "stanley"}
    assert found.table["lpv-mpc"]["jerk_rms_mps3"] == 1.0


# Profiles and tests -----------------------------------------------------------------------------


def test_a_profile_is_the_share_within_a_factor_of_the_best():
    board, _ = made_up({"lpv-mpc": lambda c: 1.0 if c.seed % 2 else 3.0,
                        "stanley": lambda c: 2.0 if c.seed % 2 else result(lost="hit")})
    ours, theirs = profiles(board, board.cells("worlds", "rtk"), board.controllers)
    assert ours.within(1.0) == 1.0
    assert (theirs.within(1.9), theirs.within(2.1), theirs.within(1e300)) == (0.0, 0.5, 0.5)
    assert theirs.steps() == [(pytest.approx(2.0), 0.5)]


def test_nobody_is_near_the_best_where_nobody_finishes():
    board, _ = made_up({"lpv-mpc": result(lost="hit"), "stanley": result(lost="hit")})
    for profile in profiles(board, board.cells("worlds"), board.controllers):
        assert profile.within(1e300) == 0.0 and profile.steps() == []


@pytest.mark.parametrize("k, q", [(2, 1.960), (5, 2.728), (10, 3.164)])
def test_critical_differences_are_those_of_demsars_table_5(k, q):
    assert nemenyi(k, 30) == pytest.approx(q * math.sqrt(k * (k + 1) / 180.0), rel=1e-3)


def test_alike_controllers_are_not_told_apart_and_different_ones_are():
    def noisy(scale):
        key = int(1e4 * scale)
        return lambda c: scale * np.exp(0.1 * np.random.default_rng((c.seed, key)).normal())

    board, _ = made_up({"lpv-mpc": noisy(1.0), "lmpc-pso-pid": noisy(1.0001),
                        "stanley": noisy(5.0)})
    cells = [c for c in board.cells("worlds") if c.world != "ideal"]
    found = ranks(board, cells, board.controllers)
    assert found.p < 0.001 and list(found.mean)[-1] == "stanley"
    assert found.groups == [tuple(list(found.mean)[:2]), ("stanley",)]
    near, far = pairs(board, cells, "lpv-mpc", ("lmpc-pso-pid", "stanley"))
    assert near.verdict == 0 and far.verdict == 1 and far.ratio == pytest.approx(5.0, rel=0.2)
    assert far.wins == far.n == len(cells)
    (back,) = pairs(board, cells, "stanley", ("lpv-mpc",))
    assert back.verdict == -1


def test_wilcoxon_agrees_with_the_exact_distribution_and_tests_no_handful():
    assert wilcoxon(np.arange(1.0, 8.0)) == pytest.approx(2 / 2**7)
    assert math.isnan(wilcoxon(np.ones(5))) and wilcoxon(np.zeros(9)) == 1.0


def test_holm_multiplies_the_smallest_p_by_their_number_and_keeps_the_order():
    board, _ = made_up({"lpv-mpc": 1.0, "stanley": 2.0, "pure-pursuit": 3.0})
    found = pairs(board, board.cells("worlds", "ideal"), "lpv-mpc", ("stanley", "pure-pursuit"))

    def corrected(*values):
        given = [dataclasses.replace(pair, p=p) for pair, p in zip(found, values, strict=True)]
        return [pair.p for pair in holm(given)]

    assert corrected(0.04, 0.01) == [0.04, 0.02]
    assert corrected(0.02, 0.015) == [0.03, 0.03]


# Sentences --------------------------------------------------------------------------------------


def test_a_rivals_win_is_told_first_and_follows_from_the_numbers(slow):
    board, _ = made_up({"lpv-mpc": 2.0, "stanley": 9.0,
                        "nmpc": lambda c: 1.0 if c.world == "rtk" else 3.0}, slow_seeds=2)
    told = sentences(board)
    assert told[0].startswith("In `rtk`, `nmpc` is better than `lpv-mpc`: its lateral RMSE is 2 "
                              "times smaller (median of 14 paired runs, smaller in 14")
    lead = [i for i, text in enumerate(told) if "`nmpc` leads" in text]
    ours = next(i for i, text in enumerate(told) if "`lpv-mpc` leads" in text)
    assert lead and max(lead) < ours
    assert "`lpv-mpc` has a significantly smaller RMSE than `stanley` (4.5 times)" in " ".join(told)
    board, _ = made_up({"lpv-mpc": 1.0, "stanley": 9.0})
    assert sentences(board)[0].startswith("Nobody is significantly better than `lpv-mpc`")


def test_a_rival_that_finishes_more_is_named_before_our_lead():
    board, _ = made_up({"stanley": 9.0,
                        "lpv-mpc": lambda c: result(lost="hit" if c.seed == 112_001 else "")})
    told = " ".join(sentences(board))
    assert "`stanley` finishes more runs than `lpv-mpc`: 28 against 27 of 28" in told
    assert "`lpv-mpc` is charged 1 of" in told


@pytest.mark.parametrize("names", [("lpv-mpc",), ("stanley", "pure-pursuit"), ("nmpc",)])
def test_a_board_of_few_has_a_report_and_a_page(slow, names):
    board, plan = made_up({name: 2.0 + i for i, name in enumerate(names)}, seeds=1)
    values = tables.as_json(board, plan, jobs=1, lacking={}, rows_sha256="ab")
    json.dumps(values, allow_nan=False)
    text = report.report(board, plan, jobs=1, lacking={}, rows_sha256="ab", pictures=[])
    assert "| `" + names[0] + "`" in text and "nan" not in text
    assert names[0] in page.page(board, values)


def test_an_interval_that_too_few_runs_leave_open_is_not_called_charged():
    board, _ = made_up({"lpv-mpc": 1.0, "stanley": lambda c: result(lost="hit" if c.seed % 4 == 0
                        else "")})
    clean, bad = (score(board.of(name, board.cells("worlds", "rtk")))
                  for name in board.controllers)
    assert report.interval_text(clean) == "from 1.00 mm"
    assert report.interval_text(bad) == "charged"


def test_no_two_controllers_have_the_same_colour():
    board, _ = made_up({**dict.fromkeys(grid.CONTROLLERS, 1.0), "mine:Mine": 1.0}, seeds=1)
    assert len({pictures.colour(board, name) for name in board.controllers}) == len(
        board.controllers)


def test_every_charged_run_is_listed():
    board, plan = made_up({"lpv-mpc": 1.0, "stanley": lambda c: result(lost="a|b", late=0)
                           if c.world == "fleet" else result(late=500)})
    text = report.report(board, plan, jobs=2, lacking={"x": "y"}, rows_sha256="ab", pictures=[])
    assert "a\\|b" in text and "| late " in text and "the package y is not installed" in text


# The page ---------------------------------------------------------------------------------------


def test_the_page_holds_everything_and_asks_the_network_for_nothing():
    board, plan = made_up({"lpv-mpc": 1.0, "</script><b>:X": 2.0}, seeds=1)
    values = tables.as_json(board, plan, jobs=1, lacking={}, rows_sha256="ab")
    text = page.page(board, values)
    found = []

    class Reader(HTMLParser):
        def handle_starttag(self, tag, attributes):
            found.extend(v for k, v in attributes if k in ("src", "href"))

    Reader().feed(text)
    assert found == ["data:,"] and "@DATA@" not in text and "import(" not in text
    assert text.count("</script>") == 2  # a name cannot end the data


def test_the_page_shows_the_first_sentences_and_folds_the_rest():
    board, plan = made_up({"lpv-mpc": 1.0, "stanley": 2.0, "pure-pursuit": 3.0})
    values = tables.as_json(board, plan, jobs=1, lacking={}, rows_sha256="ab")
    text, n = page.page(board, values), len(values["sentences"])
    assert n > page.OPEN
    shown, folded = text.split("<details>")
    assert shown.count("<li>") == page.OPEN and folded.count("<li>") == n - page.OPEN
    assert f"<summary>{n - page.OPEN} more sentences</summary>" in folded
    assert "<details>" not in page.page(board, {**values, "sentences": ["One."]})


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="needs chromium")
@pytest.mark.parametrize("width", [1280, 400])
def test_a_browser_shows_the_page_without_errors(slow, tmp_path, width):
    """Every filter, every column; nothing is wider than the window."""
    board, plan = made_up({"lpv-mpc": 1.0, "stanley": lambda c: result(lost="hit" if c.seed % 2
                           else ""), "nmpc": 0.9}, seeds=2)
    values = tables.as_json(board, plan, jobs=1, lacking={}, rows_sha256="ab")
    (tmp_path / "page.html").write_text(page.page(board, values))
    (tmp_path / "check.html").write_text(
        f"<iframe id=f style='border:0;width:{width}px;height:900px' src=page.html></iframe>"
        "<pre id=o></pre><script>f.onload = () => { const w = f.contentWindow,"
        " d = f.contentDocument, said = []; w.onerror = m => said.push('error ' + m);"
        " w.console.error = m => said.push('error ' + m); let n = 0;"
        " for (const id of ['world', 'course', 'cells', 'over'])"
        " for (const x of d.getElementById(id).options) { d.getElementById(id).value = x.value;"
        " d.getElementById(id).dispatchEvent(new w.Event('change')); n++; }"
        " for (const id of ['scores', 'pairs', 'charged'])"
        " d.querySelectorAll(`#${id} thead button`).forEach((_, i) =>"
        " d.querySelectorAll(`#${id} thead button`)[i].click());"
        " if (/NaN|undefined/.test(d.body.innerHTML.replace(/<script[^]*<\\/script>/g, '')))"
        " said.push('error: NaN'); if (d.documentElement.scrollWidth > f.clientWidth)"
        " said.push('error: too wide'); o.textContent = said.join('\\n') + 'seen ' + n; };"
        "</script>")
    shown = subprocess.run(
        ["chromium", "--headless=new", "--no-sandbox", "--disable-gpu", "--dump-dom",
         "--allow-file-access-from-files", f"--user-data-dir={tmp_path / 'profile'}",
         "--virtual-time-budget=20000", f"file://{tmp_path / 'check.html'}"],
        capture_output=True, text=True, timeout=300, check=True).stdout
    said = shown.partition('<pre id="o">')[2].partition("<")[0]
    choices = len(board.worlds()) + 1 + len(board.courses()) + 1 + 2 + len(values["ranks"])
    assert said == f"seen {choices}"


# The command ------------------------------------------------------------------------------------


@pytest.fixture
def short(tmp_path, monkeypatch):
    """Two courses on a short bend, one world of noise."""
    x = np.arange(0.0, 61.0, 3.0)
    lines = [f"{a:g},{0.004 * a * a:g},4,4" for a in x]
    file = tmp_path / "bend.csv"
    file.write_text("\n".join(["# x_m,y_m,w_tr_right_m,w_tr_left_m", *lines]) + "\n")
    bend = grid.Course(key="bend", scenario=str(file), grip=0.5, stream=0)
    monkeypatch.setattr(grid, "COURSES", {"bend": bend})
    monkeypatch.setattr(grid, "LIMITS", grid.Course(key="circuit", scenario=str(file), stream=7))
    monkeypatch.setattr(grid, "QUICK", {
        "courses": ("bend",), "worlds": ("ideal", "rtk"), "seeds": 2, "grips": (0.5,),
        "frictions": (1.0,), "winds": (), "quick": True})
    empty = type("Figure", (), {"savefig": lambda self, file, **_: file.write_bytes(b"")})
    drawn = {name: empty() for name in FILES if name.endswith(".png")}
    monkeypatch.setattr(pictures, "pictures", lambda board: drawn)
    return str(file)


ANGRY = """
class Angry:
    def reset(self, rng): pass
    def command(self, state, preview): raise ValueError("no")
"""


def test_a_users_class_stands_in_the_tables_and_what_it_raises_is_a_result(
    run, short, user_module, tmp_path
):
    user_module(ANGRY)
    who = ("--controllers", "mine:Angry", "stanley")
    code, out, err = run("--quick", "--jobs", 1, *who)
    assert (code, err) == (0, "") and "Saved runs/benchmark-quick/" in out
    folder = tmp_path / "runs" / "benchmark-quick"
    assert sorted(f.name for f in folder.iterdir() if not f.name.startswith(".")) == FILES
    rows = pq.read_table(folder / "benchmark-rows.parquet").to_pylist()
    assert [row["controller"] for row in rows] == ["mine:Angry"] * 4 + ["stanley"] * 4
    assert [row["completed"] for row in rows] == [False] * 4 + [True] * 4
    assert all("raised in command" in row["reason"] for row in rows[:4])
    assert re.search(r"^\| `mine:Angry` \| +0 of 2 ", (folder / "benchmark.md").read_text(), re.M)
    assert max(len(line) for line in out.splitlines()[:-1]) <= 80
    first = (folder / "benchmark-rows.parquet").read_bytes()
    for file in list((tmp_path / "runs" / "benchmark").glob("*.json"))[1:]:
        file.unlink()  # as if it had been killed
    assert run("--quick", "--jobs", 2, "--resume", *who)[0] == 0
    assert (folder / "benchmark-rows.parquet").read_bytes() == first

    rows = folder / "benchmark-rows.parquet"
    code, out, err = run("--verify", rows, "--sample", 0, "--jobs", 1)
    assert (code, err) == (0, "")
    assert "8 of 8 rows driven again: 8 with the same" in " ".join(out.split())


def test_a_row_that_was_changed_is_found(run, short, tmp_path):
    run("--quick", "--jobs", 1, "--controllers", "stanley")
    file = tmp_path / "runs" / "benchmark-quick" / "benchmark-rows.parquet"
    table = pq.read_table(file)
    column = table.column("lateral_rmse_m").to_pylist()
    column[0] *= 0.9
    at = table.column_names.index("lateral_rmse_m")
    pq.write_table(table.set_column(at, "lateral_rmse_m", [column]), tmp_path / "better.parquet")
    code, out, _ = run("--verify", "better.parquet", "--sample", 0, "--jobs", 1)
    assert code == 3 and "DIFFERS: stanley" in out and "1 different" in " ".join(out.split())


def test_runs_are_interleaved_and_their_results_are_not():
    from lpvmpc.commands.parts.batches import interleaved

    driven = []

    def drive(runs):
        driven.extend(run.seed for run in runs)
        return [{"seed": run.seed} for run in runs]

    runs = [Run(seed=i) for i in range(6)]
    results = interleaved(drive, runs, ["a", "a", "a", "a", "b", "b"])
    assert [one["seed"] for one in results] == list(range(6))
    assert driven == [0, 4, 1, 2, 5, 3]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--controllers", "lpv"], "Unknown controller 'lpv'; the choices are"),
        (["--controllers", "json:"], "Unknown controller 'json:'"),
        (["--controllers", "mine:Mine"], "Unknown controller 'mine:Mine'"),
        (["--controllers", "stanley", "stanley"], "each name once"),
        (["--seeds", "0"], "--seeds is 0, but must be from 1 to 900"),
        (["--verify", "x", "--json", "y"], "--json is 'y', but must be left out with"),
        (["--verify", "x", "--quick"], "--quick is True, but must be left out with --verify."),
        (["--verify", "none.parquet"], "Rows 'none.parquet' cannot be read"),
        (["--verify", "other.parquet"], "are not those of a benchmark: no column 'run'"),
        (["--address", "here"], "address is 'here', but must be left out unless"),
    ],
)
def test_bad_options_are_one_sentence(run, short, tmp_path, arguments, sentence):
    import pyarrow as pa

    pq.write_table(pa.table({"x": [1]}), tmp_path / "other.parquet")
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert err.startswith("Error: ") and err.count("\n") == 1 and sentence in err


def test_an_interrupted_benchmark_says_how_to_go_on(run, short, monkeypatch):
    def stop(one):
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "drive", stop)
    code, _, err = run("--quick", "--jobs", 1, "--controllers", "stanley")
    assert (code, err) == (130, "Interrupted; --resume goes on from here.\n")


@pytest.mark.parametrize("slow_us", [186.0, 15_000.0])
def test_step_times_in_the_picture_are_few_and_plain(slow_us):
    board, _ = made_up({"lpv-mpc": 1.0, "stanley": 2.0}, seeds=1, courses=("paper",))
    for row in board.rows:
        step = 22.0 if row.controller == "stanley" else slow_us
        row.result["step_time_us"].update(mean=step, p50=step, p99=step, max=step)
    figure = pictures.pareto(board)
    figure.canvas.draw()
    axis = figure.axes[0].xaxis
    shown = [t.get_text() for t in axis.get_ticklabels() if t.get_text()]
    assert {"100"} < set(shown) and len(shown) <= 9 and all(map(float, shown))
    assert not any(t.get_text() for t in axis.get_ticklabels(minor=True))


def test_pictures_can_be_drawn():
    board, _ = made_up({"lpv-mpc": 1.0, "stanley": lambda c: result(lost="hit" if c.seed % 2
                        else "")}, seeds=1, courses=("paper",))
    assert sorted(pictures.pictures(board)) == [f for f in FILES if f.endswith(".png")]


BAD = """
import os, time
import numpy as np
from lpvmpc import Command

class Base:
    def reset(self, rng): self.n = 0
    def command(self, state, preview):
        self.n += 1
        return self.bad() if self.n == 5 else Command(0.0, 0.0)

class Raises(Base):
    def bad(self): raise ValueError("no")
class Nan(Base):
    def bad(self): return Command(float("nan"), 0.0)
class Nothing(Base):
    def bad(self): return None
class Shape(Base):
    def bad(self): return np.zeros(3)
class Sleeps(Base):
    def bad(self):
        while True:
            try: time.sleep(100)
            except: pass
class Exits(Base):
    def bad(self): os._exit(0)
class Loops(Base):  # compiled, and never back in Python
    def bad(self): return sum(range(10**15))
class Memory(Base):
    def bad(self): self.x = np.ones(2 * 1024**3 // 8 + 1); return Command(0.0, 0.0)
"""
TOLD = {
    "Raises": "raised in command", "Nan": "returned Command(delta=nan", "Nothing": "returned None",
    "Shape": "returned array", "Sleeps": "did not return", "Exits": "ended its process",
    "Loops": "did not return", "Memory": "MemoryError",
}


@pytest.mark.slow
def test_whatever_a_users_class_does_is_its_result_and_the_rest_goes_on(
    run, short, user_module, tmp_path
):
    user_module(BAD)
    names = [f"mine:{name}" for name in TOLD]
    command = ("--quick", "--seeds", 1, "--jobs", 1, "--controllers", *names, "stanley")
    assert run(*command)[0] == 0
    folder = tmp_path / "runs" / "benchmark-quick"
    rows = pq.read_table(folder / "benchmark-rows.parquet").to_pylist()
    assert len(rows) == 3 * 9
    for row in rows:
        _, _, name = row["controller"].partition(":")
        assert row["completed"] is (not name)
        if name:
            assert TOLD[name] in row["reason"], (name, row["reason"])
    first = (folder / "benchmark-rows.parquet").read_bytes()
    text = (folder / "benchmark.md").read_text()
    assert all(re.search(rf"^\| `{name}` +\| .*0 of 1", text, re.M) for name in names)
    begin = time.monotonic()  # what failed is kept as well
    assert run(*command, "--resume")[0] == 0
    assert time.monotonic() - begin < 10.0
    assert (folder / "benchmark-rows.parquet").read_bytes() == first


KILLED = """
import sys
from lpvmpc.commands import benchmark
from lpvmpc.kit import cli
from lpvmpc.leaderboard import grid, pictures
bend = grid.Course(key="bend", scenario={file!r}, grip=0.5, stream=0)
grid.COURSES.clear()
grid.COURSES["bend"] = bend
grid.LIMITS = bend
grid.QUICK = dict(courses=("bend",), seeds=4, grips=(0.5,), frictions=(1.0,), winds=(), quick=True)
pictures.pictures = lambda board: {{}}
sys.exit(cli.run(benchmark.Options, benchmark.main))
"""


@pytest.mark.slow
def test_a_benchmark_that_was_killed_goes_on_to_the_same_bytes(short, tmp_path):
    (tmp_path / "drive.py").write_text(KILLED.format(file=short))

    def command(name, *more):
        return [sys.executable, "drive.py", "--quick", "--controllers", "stanley", "pure-pursuit",
                "--out", name, "--cache", f"{name}-kept", *more]

    subprocess.run(command("whole", "--jobs", "2"), check=True, timeout=300, cwd=tmp_path)
    kept = tmp_path / "killed-kept"
    with subprocess.Popen(command("killed", "--jobs", "1"), cwd=tmp_path) as process:
        while len(list(kept.glob("*.json"))) < 5:
            assert process.poll() is None
            time.sleep(0.02)
        process.kill()
    assert 5 <= len(list(kept.glob("*.json"))) < 2 * 14
    subprocess.run(command("killed", "--resume"), check=True, timeout=300, cwd=tmp_path)
    whole, killed = (tmp_path / name / "benchmark-rows.parquet" for name in ("whole", "killed"))
    assert killed.read_bytes() == whole.read_bytes()


def test_a_class_that_hangs_at_every_start_does_not_cost_two_minutes_a_run(
    short, monkeypatch, tmp_path
):
    late = "Controller 'mine:A' did not return from command within 120 s at t = 0.000 s"
    driven = []

    def outcome(item):
        driven.append(item[1].controller)
        hangs = item[1].controller == "mine:A" or item[1].seed < 2
        reason = f"{late} (first_timeout)." if hangs else "end"
        return item[0], batch.charged(item[1], reason)

    monkeypatch.setattr(own_process, "outcome", outcome)
    always = [Run(scenario=short, controller="mine:A", seed=i) for i in range(5)]
    results = own_process.drive_all(always, jobs=1, cache=tmp_path)
    assert driven == ["mine:A"] * 2 and results == [
        batch.charged(run, f"{late} (first_timeout).") for run in always]
    assert own_process.drive_all(always, jobs=1, cache=tmp_path) == results
    (again,) = own_process.drive_all([Run(scenario=short, controller="mine:A", seed=9)],
                                     jobs=1)  # what is not known is tried
    assert len(driven) == 3 and not again["completed"]
    driven.clear()  # who has started once is driven to the end
    sometimes = [Run(scenario=short, controller="mine:B", seed=i) for i in (5, 0, 1, 6)]
    own_process.drive_all(sometimes, jobs=1)
    assert len(driven) == 4


assert benchmark.NAME == COMMAND
