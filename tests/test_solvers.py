"""The study of solvers: what it records, what it asks, and that no wrong answer passes."""

import json
import os
import re
from dataclasses import replace

import numpy as np
import pytest

from lpvmpc.control.solver.checked import SOLVERS, QPSolver
from lpvmpc.errors import DataError, OptionError, UnknownNameError
from lpvmpc.plant.plant import Plant
from lpvmpc.reliability.damage import damaged
from lpvmpc.sim.loop import simulate
from lpvmpc.sim.names import load_controller, load_scenario
from lpvmpc.solvers import report, study
from lpvmpc.solvers.adapter import TOLERANCE, Adapter, Answer
from lpvmpc.solvers.adapters import ADAPTERS, available
from lpvmpc.solvers.stream import Lap, Stream, load, record, save

COMMAND = "solvers"
CONDENSED = ("P", "q", "A", "l", "u")


@pytest.fixture(scope="module")
def stream():
    """Programs of a lane change, half of them with an active row."""
    lap = Lap(key="lane", scenario="double-lane-change", grip=None, world="rtk")
    return record(lap, 6)


def tightened(stream):
    """The same programs with bounds so near that many rows are active."""
    arrays = dict(stream.arrays)
    u = np.stack([QPSolver(21, 41).solve(*stream.qp(k)).z[:-1] for k in range(len(stream))])
    lower, upper = arrays["l"].copy(), arrays["u"].copy()
    n = u.shape[1]
    low, high = np.minimum(u, 0.5 * u), np.maximum(u, 0.5 * u)
    room = 0.25 * (high - low)
    lower[:, :n], upper[:, :n] = low + room, high - room
    # the increments are left free, so that a plan exists
    lower[:, n : n + n // 2], upper[:, n : n + n // 2] = -50.0, 50.0
    return Stream(name="tight", about={}, arrays={**arrays, "l": lower, "u": upper})


def test_the_file_gives_back_what_was_recorded(stream, tmp_path):
    save(tmp_path / "lane.npz", stream)
    again = load(tmp_path / "lane.npz")
    assert (again.name, again.about) == ("lane", stream.about)
    assert again.arrays.keys() == stream.arrays.keys()
    for name, values in stream.arrays.items():
        np.testing.assert_array_equal(again.arrays[name], values)
    with np.load(tmp_path / "lane.npz") as file:  # what others need to read it
        shapes = [file[name].shape[1:] for name in CONDENSED]
    assert shapes == [(21, 21), (21,), (41, 21), (41,), (41,)]


def test_a_file_that_holds_no_programs_is_one_sentence(tmp_path):
    (tmp_path / "text.npz").write_text("no programs")
    np.savez(tmp_path / "other.npz", about=np.array("{}"), P=np.eye(2))
    for name, sentence in (("none", "No such file"), ("text", "holds no programs"),
                           ("other", "no array 'q'")):
        with pytest.raises(DataError, match=sentence):
            load(tmp_path / f"{name}.npz")


def test_a_damaged_or_odd_file_is_refused_or_the_same(stream, tmp_path):
    file = tmp_path / "lane.npz"
    save(file, stream)
    raw = file.read_bytes()
    for i in range(60):
        file.write_bytes(damaged(raw, np.random.default_rng(i)))
        try:
            again = load(file)
        except DataError:
            continue
        for name, values in stream.arrays.items():  # each array of a zip has a checksum
            np.testing.assert_array_equal(again.arrays[name], values)
    os.mkfifo(tmp_path / "pipe.npz")
    for odd in (tmp_path / "pipe.npz", "/dev/zero", tmp_path):
        with pytest.raises(DataError, match="it is a|no file|directory"):
            load(odd)
    for name, value in (("P", np.eye(2)), ("P", stream.arrays["P"] * np.nan), ("soft", np.eye(2)),
                        ("l", stream.arrays["l"][:2]), ("x0", np.array(["x"])),
                        ("Bd", stream.arrays["Bd"][:, :3])):
        save(file, replace(stream, arrays={**stream.arrays, name: value}))
        with pytest.raises(DataError, match="is damaged"):
            load(file)


@pytest.mark.parametrize("tight", [False, True])
def test_the_program_in_stages_has_the_solution_of_the_condensed_one(stream, tight):
    stream = tightened(stream) if tight else stream
    for k in range(0, len(stream), 3):
        z, y, _ = study.solution(stream.qp(k))
        s = stream.staged(k)
        # the stages' optimality with the condensed multipliers, and free ones of the dynamics
        N, nx, nu = stream.arrays["Bd"].shape[1:]
        inputs = np.concatenate([np.r_[i * (nx + nu) : i * (nx + nu) + nu] for i in range(N)])
        v = np.zeros(len(s.q))
        v[inputs], v[-1] = z[:-1], z[-1]
        states = np.setdiff1d(np.arange(len(v) - 1), inputs)
        v[states] = np.linalg.solve(s.E[:, states], s.b - s.E[:, inputs] @ v[inputs])
        np.testing.assert_allclose(stream.condensed(v), z)
        pull = s.P @ v + s.q + s.F.T @ y
        forces = np.linalg.lstsq(s.E.T, -pull, rcond=None)[0]
        assert np.abs(pull + s.E.T @ forces).max() < 1e-7 * (1.0 + np.abs(pull).max())
        qp = stream.qp(k)
        np.testing.assert_allclose(s.F @ v - s.shift, qp.C @ z, atol=1e-9)
        assert not tight or np.count_nonzero(y) > 3


@pytest.mark.parametrize("name", ADAPTERS)
@pytest.mark.parametrize("tight", [False, True])
def test_every_solver_finds_the_solution_and_is_asked_the_right_thing(stream, name, tight):
    if name not in available()[0]:
        pytest.skip(f"{name} is not installed: {available()[1][name]}")
    o = study.measure(tightened(stream) if tight else stream, [name])
    (found,) = o.found
    assert found.claimed == len(o.active) == len(stream) and o.uncertain == 0
    # our check may refuse an answer that is near enough for the solver itself
    assert len(stream) - 1 <= found.accepted <= len(stream)
    assert found.wrong == found.spoiled_accepted == found.spoiled["infeasible"] == 0
    assert found.furthest < 1e-5 and (not tight or o.active.all())
    assert min(found.times) > 0.0


class Liar(Adapter):
    """Calls everything solved, and is a little off."""

    off = 3.0 * study.FAR_OFF

    def run(self, prepared):
        sure = study.solution(prepared)
        return sure if sure is not None else (np.zeros(self.n), np.zeros(self.m))

    def answer(self, prepared, raw):
        return Answer(True, raw[0] + self.off, raw[1])


def test_no_wrong_answer_is_accepted(stream, monkeypatch):
    monkeypatch.setitem(ADAPTERS, "liar", (Liar, "", "condensed"))
    o = study.measure(tightened(stream), ["lpvmpc", "liar"])
    liar = o.found[1]
    assert liar.claimed == liar.wrong_claims == len(stream)
    assert liar.accepted == liar.wrong == liar.spoiled_accepted == 0
    assert liar.spoiled == {"infeasible": o.spoiled, "unbounded": o.spoiled}
    told = " ".join(report.sentences([o]))
    assert f"liar called {len(stream)} of {len(stream)} programs solved whose answer" in told
    assert "No wrong answer was accepted" in told


def test_a_wrong_answer_that_passed_would_be_said_first(stream):
    o = study.measure(stream, ["lpvmpc"])
    o.found[0].wrong = 1
    assert report.sentences([o])[0] == "WRONG answers were accepted, of lpvmpc (1)."


def test_who_is_faster_follows_from_the_times(stream):
    o = study.measure(stream, ["lpvmpc", "active-set", "proxqp-dense"])
    for one, us in zip(o.found, (20.0, 10.0, 19.0), strict=True):
        one.times = [us] * len(one.times)
    told = report.sentences([replace(o, check_us=4.0)])[-1]
    assert told.endswith("worst lap): active-set (0.50).")  # 19 + 4 us are more than 20
    o.found[1].accepted -= 1
    assert report.sentences([replace(o, check_us=4.0)])[-1].startswith("None that solves all")


def test_the_command_solves_and_reports(run, stream, tmp_path):
    save(tmp_path / "lane.npz", stream)
    code, out, err = run("--programs", "lane.npz", "--solvers", "lpvmpc", "active-set",
                         "proxqp-dense", "--out", "o", "--json", "copy.json")
    assert (code, err) == (0, "")
    assert {file.name for file in (tmp_path / "o").iterdir()} >= {
        "solvers.md", "solvers.csv", "solvers.json"}
    values = json.loads((tmp_path / "copy.json").read_text())
    assert [row["solver"] for row in values["solvers"]] == ["lpvmpc", "active-set", "proxqp-dense"]
    assert all(row["accepted"] == len(stream) for row in values["solvers"])
    text = (tmp_path / "o" / "solvers.md").read_text()
    assert text in out and re.search(r"lane: \d+ programs \(double-lane-change", text)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--solvers", "gurobi"], "Unknown solver 'gurobi'; the choices are"),
        (["--solvers", "lpvmpc", "lpvmpc"], "--solvers is 'lpvmpc lpvmpc', but must be each name"),
        (["--count", "0"], "--count is 0, but must be from 1"),
        (["--programs", "none.npz"], "The file 'none.npz' holds no programs that can be read"),
        (["--out", "/proc/nowhere"], "Cannot write into '/proc/nowhere'"),
    ],
)
def test_bad_options_are_one_sentence(run, arguments, sentence):
    code, _, err = run(*arguments)
    assert code == 2
    assert sentence in err and err.count("\n") == 1


def test_the_check_wants_what_the_loop_wants():
    assert QPSolver(2, 1).tolerance == TOLERANCE


@pytest.mark.parametrize("name", ["lpv-mpc", "lpv-mpc-paper"])
def test_another_solver_in_the_loop_drives_the_same(name):
    plant, scenario = Plant(), load_scenario("double-lane-change")
    first, second = (
        simulate(plant, load_controller(name, solver=solver), scenario).columns["ey_m"]
        for solver in SOLVERS
    )
    # each is within 10 urad of the same plan in every period
    np.testing.assert_allclose(first, second, atol=1e-5)
    assert (first != second).any()


def test_a_solver_that_does_not_exist_or_does_not_fit_is_one_sentence():
    with pytest.raises(UnknownNameError, match="Unknown solver 'gurobi'; the choices are active-s"):
        load_controller("lpv-mpc", solver="gurobi")
    with pytest.raises(OptionError, match="option solver is 'active-set', but must be left out"):
        load_controller("stanley", solver="active-set")
