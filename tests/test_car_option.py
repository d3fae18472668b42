"""`--car`: another car wherever one is meant, and what was made for one refused for another."""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from lpvmpc import Plant, load_controller
from lpvmpc.car.current import current
from lpvmpc.commands import track, train
from lpvmpc.commands.parts.the_car import CarPlace, with_car
from lpvmpc.control.stiffness.network_file import load_weights, shipped
from lpvmpc.control.traction import hold
from lpvmpc.control.weights_file import check_car, write_weights
from lpvmpc.errors import DataError, ModelError
from lpvmpc.kit import cli, safetensors
from lpvmpc.plant.car_folder import driving, packaged_sha256, read_car, write_car
from lpvmpc.plant.mjcf import compile_model, models_dir, packaged_car
from lpvmpc.plant.vehicle_xml import numbers_of, tires_of, written
from lpvmpc.sim import batch
from lpvmpc.sim.names import load_estimator
from lpvmpc.sim.world import load_world


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A rear-driven car that is 100 kg lighter than the packaged one."""
    zoe = compile_model(visual=False)
    numbers = replace(numbers_of(zoe), m=1475.0, drive_front=0.0)
    xml = written(numbers, *tires_of(zoe), ay_limit=7.0)
    return write_car(tmp_path_factory.mktemp("cars") / "light", xml).folder


@pytest.fixture
def car(made, tmp_path):
    """The same, to spoil."""
    return Path(shutil.copytree(made, tmp_path / "light"))


def test_another_car_is_meant_where_none_is_named(car):
    assert current() is None and packaged_car().m == pytest.approx(1575.0)
    key = batch.Run().key()
    with driving(car) as one:
        assert current().sha256 == one.sha256 and read_car().name == "light"
        assert Plant().params == packaged_car() == one.params
        assert one.params.m == pytest.approx(1475.0)
        controller = load_controller("lpv-mpc", stiffness="constant", weights={})
        assert controller.bicycle.m == pytest.approx(1475.0)
        assert batch.Run().key() != key  # kept results are the car's
    assert current() is None and packaged_car().m == pytest.approx(1575.0)
    assert batch.Run().key() == key


def test_the_oracle_knows_the_tires_of_the_car_that_is_meant(car):
    with driving(car) as one:
        model = load_controller("lpv-mpc", stiffness="oracle", weights={}).stiffness
        np.testing.assert_array_equal(model.front.tire.c, one.tires[0].c)


def test_what_was_made_for_a_car_is_part_of_the_key_of_a_run(car):
    with driving(car):
        before = batch._foundation.__wrapped__(False)
        (car / "weights").mkdir()
        write_weights(car / "weights" / "lpv-mpc.toml", "lpv-mpc", {"q_ey": 1.0}, {})
        assert batch._foundation.__wrapped__(False) != before


def test_a_network_of_another_car_is_refused(car):
    with driving(car), pytest.raises(DataError, match=(
        "light has no network of its own: none was trained on it, .* lpvmpc collect and lpvmpc "
        "train with --car .*light make one, and --stiffness constant needs none"
    )):
        load_controller("lpv-mpc", weights={})
    shutil.copy(shipped("network"), car / "network.safetensors")
    with driving(car), pytest.raises(DataError, match="is of a car of hash"):
        load_controller("lpv-mpc", weights={})


def test_a_network_of_the_car_is_found_in_its_folder(car):
    arrays, metadata = safetensors.read(shipped("network"))
    metadata = {k: v for k, v in metadata.items() if k != safetensors.SHA256}
    own = {**metadata, "car_sha256": read_car(car).sha256}
    safetensors.write(car / "network.safetensors", arrays, own)
    with driving(car) as one:
        assert load_weights("network").metadata["car_sha256"] == one.sha256
    assert load_weights("network").metadata["car_sha256"] == packaged_sha256()


def test_the_packaged_car_by_its_file_keeps_all_that_was_made_for_it():
    with driving(models_dir() / "vehicle.xml"):
        assert load_weights("network").metadata["car_sha256"] == packaged_sha256()


def test_weights_are_the_cars_own_or_said_to_be_those_of_the_packaged_one(car):
    with driving(car) as one:
        with pytest.warns(UserWarning, match="No weights of stanley were tuned on .*light"):
            before = load_controller("stanley").weights
        (car / "weights").mkdir()
        record = {"car_sha256": one.sha256}
        write_weights(car / "weights" / "pure-pursuit.toml", "pure-pursuit", {"kp": 0.77}, record)
        assert load_controller("pure-pursuit").weights.kp == 0.77
    assert load_controller("stanley").weights == before
    assert load_controller("pure-pursuit").weights.kp != 0.77


def test_weights_that_were_tuned_on_another_car_are_refused(car, tmp_path):
    (car / "weights").mkdir()
    own = car / "weights" / "stanley.toml"
    write_weights(own, "stanley", {"k_e": 2.0}, {"car_sha256": "0" * 64})
    with driving(car), pytest.raises(DataError, match=(
        "stanley.toml' were tuned on a car of hash 000000000000, but .*light has"
    )):
        load_controller("stanley")
    write_weights(tmp_path / "w.toml", "stanley", {"k_e": 2.0}, {"seed": 0})
    check_car(tmp_path / "w.toml")  # the packaged car's, for which none is named
    with driving(car), pytest.raises(DataError, match="were tuned on the packaged car, but"):
        check_car(tmp_path / "w.toml")


@pytest.mark.slow
def test_workers_drive_the_same_car(car):
    runs = [
        batch.Run(scenario="slalom", controller="pure-pursuit", seed=seed,
                  controller_options={"weights": {}}) for seed in range(2)
    ]
    with driving(car):
        theirs = batch.drive_all(runs, jobs=2)
        mine = batch.drive_all(runs[:1])
    assert theirs[0]["model_sha256"] == mine[0]["model_sha256"]
    assert theirs[0]["lateral_rmse_m"] == mine[0]["lateral_rmse_m"]
    assert mine[0]["model_sha256"] != batch.drive_all(runs[:1])[0]["model_sha256"]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_track_drives_another_car_and_says_in_a_sentence_what_does_not_fit(
    car, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    words = ["--scenario", "slalom", "--car", str(car)]
    assert cli.run(track.Options, track.main, words) == 2
    told = capsys.readouterr().err
    assert told.startswith("Error: ") and "has no network of its own" in told
    assert cli.run(track.Options, track.main, [*words, "--stiffness", "constant"]) == 0
    out = tmp_path / "runs" / "slalom-lpv-mpc-light"
    result = json.loads((out / "metrics.json").read_text())
    assert result["completed"] and result["lateral_rmse_m"] < 0.05
    assert result["record"]["options"]["car"] == str(car)
    assert "No weights of lpv-mpc were tuned on" in capsys.readouterr().err


def test_data_of_another_car_are_not_trained_on(car):
    @dataclass
    class Data:
        checked: bool
        meta: dict

    with driving(car) as one, pytest.raises(DataError, match="lpvmpc collect --car .*light"):
        train.check_car(Data(True, {"car_sha256": packaged_sha256()}))
    with driving(car):
        assert train.check_car(Data(True, {"car_sha256": one.sha256})) == one.params


def test_results_of_another_car_go_elsewhere_unless_told(car):
    @dataclass(frozen=True, kw_only=True)
    class Options:
        out: Path | None = None
        cache: Path = Path("runs/x")
        car: CarPlace = None

    @with_car(out="runs/{car}/x", cache="runs/{car}/kept")
    def main(options):
        return options.out, options.cache

    assert main(Options()) == (None, Path("runs/x"))
    assert main(Options(car=car)) == (Path("runs/light/x"), Path("runs/light/kept"))
    assert main(Options(car=car, out=Path("here")))[0] == Path("here")
    with pytest.raises(ModelError, match="There is no car"):
        main(Options(car=car / "none"))


def test_the_wheels_that_drive_tell_of_slip():
    spin = np.array([30.0, 30.0, 40.0, 30.0])
    given = (10.0, 5.0, 3.0, spin, 9.0, 0.0, 1.0, 0.3, 0.75, 1.0, 0.033)
    assert hold(*given) == 5.0  # the front ones roll
    assert hold(*given, 0.0) < 3.0  # a rear one spins
    assert hold(*given, 0.5) == hold(*given, 0.0)


def test_the_filter_expects_driven_rear_wheels_to_turn_faster(made):
    from lpvmpc.sensing.strapdown import C_DRIVEN

    sensing = load_world("production").sensing
    front = load_estimator("ekf", sensing=sensing, Ts=0.033)
    with driving(made):
        rear = load_estimator("ekf", sensing=sensing, Ts=0.033)
    assert front._constants[C_DRIVEN] == 0.0 and 0.005 < rear._constants[C_DRIVEN] < 0.02


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_a_car_is_put_on_the_tires_of_a_property_file(tmp_path, monkeypatch, capsys):
    from lpvmpc.car import magic_formula as mf
    from lpvmpc.car.tir import write_tir

    tire = compile_model(visual=False).numeric("tire_f").data.copy()
    tire[[mf.PDX1, mf.PDY1]] *= 0.9
    write_tir(tmp_path / "worn.tir", tire)
    with (tmp_path / "worn.tir").open("a") as file:
        file.write("PHY1 = 0.002\n")
    monkeypatch.chdir(tmp_path)
    words = ["--scenario", "slalom", "--tire", "worn.tir", "--controller", "pure-pursuit"]
    assert cli.run(track.Options, track.main, words) == 0
    told = capsys.readouterr().err
    assert "Not honoured of worn.tir:\n  PHY1: would shift Fy" in told
    result = json.loads(Path("runs/slalom-pure-pursuit-worn/metrics.json").read_text())
    assert result["completed"]
    (tmp_path / "worn.tir").write_text("[UNITS]\nPDY1 = many\n")
    assert cli.run(track.Options, track.main, words) == 2
    assert "worn.tir lacks the tire coefficients FNOMIN, UNLOADED_RADIUS" in capsys.readouterr().err
