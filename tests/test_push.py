"""A push that no column records: found on one recording, applied to another, never on its own."""

import numpy as np
import pytest

from lpvmpc.errors import DataError
from lpvmpc.identify import push as pushes
from lpvmpc.identify.candidate import Candidate
from lpvmpc.identify.conduct import conduct
from lpvmpc.identify.follow import Push, replay
from lpvmpc.identify.recording import Recording
from lpvmpc.kit import cli
from lpvmpc.plant.mjcf import compile_model


def in_the_wind(wind: Push, phase: float, name: str) -> Recording:
    """8 s of the packaged car at 15 m/s, steered by a sine, in a wind that is not recorded."""
    t = 0.02 * np.arange(400)
    delta, flat = 0.02 * np.sin(1.5 * t + phase), 0.0 * t
    steered = Recording(name=name, t=t, delta=delta, vx=flat + 15.0, r=flat, vy=flat)
    motion = replay([compile_model(visual=False)], steered, push=wind)
    return Recording(name=name, t=t, delta=delta, vx=flat + 15.0, r=motion.r[0], vy=motion.vy[0])


@pytest.fixture(scope="module")
def wind():
    t = np.linspace(0.0, 8.0, 81)
    gust = np.exp(-(((t - 4.0) / 1.5) ** 2))
    return Push(t=t, force=900.0 * gust, moment=400.0 * gust)


@pytest.fixture(scope="module")
def first(wind):
    return in_the_wind(wind, 0.0, "one.csv")


def test_a_push_is_found_on_one_recording_and_explains_another(wind, first, tmp_path):
    car = Candidate.of(compile_model(visual=False))
    pushes.write(tmp_path / "push.csv", pushes.identify(car, first))
    found = pushes.read(tmp_path / "push.csv")
    inside = (found.t > 1.0) & (found.t < 7.0)
    for name, most in (("force", 90.0), ("moment", 40.0)):  # a tenth of the gust
        true = np.interp(found.t, wind.t, getattr(wind, name))
        assert getattr(found, name)[inside] == pytest.approx(true[inside], abs=most)
    other = conduct(car, in_the_wind(wind, 2.0, "two.csv"), push=found)
    assert other.unpushed is not None
    for name, without in other.unpushed.items():
        left = 1.0 - other.scores["plant"].whole[name].r2
        assert left < 0.1 * (1.0 - without)
    with pytest.raises(DataError, match="identified on one.csv itself"):
        conduct(car, first, push=found)


def test_a_push_of_another_time_or_shape_is_refused(wind, first, tmp_path):
    late = Push(t=wind.t + 5.0, force=wind.force, moment=wind.moment)
    with pytest.raises(DataError, match="acts from 5.0 to 13.0 s, but one.csv"):
        pushes.check(late, first)
    file = tmp_path / "push.csv"
    file.write_text("t_s,force\n0,1\n")
    with pytest.raises(DataError, match="must have the columns t_s, side_force_N"):
        pushes.read(file)
    file.write_text("t_s,side_force_N,yaw_moment_Nm\n1,0,0\n0,0,0\n")
    with pytest.raises(DataError, match="t_s growing"):
        pushes.read(file)
    with pytest.raises(DataError, match="There is no push"):
        pushes.read(tmp_path / "none.csv")


@pytest.mark.slow
def test_the_command_takes_a_push_and_other_tires(wind, first, tmp_path, monkeypatch, capsys):
    from lpvmpc.car.tir import write_tir
    from lpvmpc.commands.recordings.replay import Options, main

    monkeypatch.chdir(tmp_path)
    table = np.column_stack([first.t, first.delta, first.vx, first.r, first.vy])
    for name in ("one.csv", "two.csv"):
        np.savetxt(name, table, delimiter=",", comments="",
                   header="t_s,delta_rad,vx_mps,r_radps,vy_mps")
    words = ["--out", "out"]
    assert cli.run(Options, main, ["--recording", "one.csv", *words, "--save-push", "p.csv"]) == 0
    assert cli.run(Options, main, ["--recording", "one.csv", *words, "--push", "p.csv"]) == 2
    assert "identified on one.csv itself" in capsys.readouterr().err
    tire = compile_model(visual=False).numeric("tire_f").data.copy()
    write_tir(tmp_path / "worn.tir", tire)
    words = ["--recording", "two.csv", "--out", "out"]
    assert cli.run(Options, main, [*words, "--push", "p.csv", "--tire", "worn.tir"]) == 0
    assert "without them its R2 is: yaw rate" in capsys.readouterr().out
    assert cli.run(Options, main, [*words, "--tire", "none.tir"]) == 2
