"""The cars that come with the package, each a folder in cars/."""

from pathlib import Path

import pytest

from lpvmpc import load_controller, load_scenario, simulate
from lpvmpc.car.numbers import GRADES, NAMES, read_car_file
from lpvmpc.control.stiffness.network_file import load_weights
from lpvmpc.plant import garage
from lpvmpc.plant.car_folder import driving, read_car
from lpvmpc.plant.plant import Plant
from lpvmpc.sim.metrics import metrics

ROOT = Path(__file__).parent.parent / "cars"
CARS = sorted(folder.parent.name for folder in ROOT.glob("*/vehicle.xml"))

pytestmark = pytest.mark.filterwarnings("ignore:No weights of:UserWarning")


def test_there_are_two_cars_beside_the_packaged_one():
    assert {"bmw-320i", "vw-vanagon"} <= set(CARS)


@pytest.mark.parametrize("name", CARS)
def test_a_shipped_car_is_whole_and_its_network_its_own(name):
    with driving(ROOT / name) as car:
        assert load_weights("network").metadata["car_sha256"] == car.sha256


@pytest.mark.parametrize("name", ["bmw-320i", "vw-vanagon"])
def test_every_number_of_a_written_car_has_grade_and_source(name):
    file = read_car_file(ROOT / name / "car.toml")
    assert set(file.sources) == set(file.numbers) <= set(NAMES)
    text = (ROOT / name / "README.md").read_text()
    car = read_car(ROOT / name)
    assert text == garage.card(file, car.params, ["tau_ax", "rho_air"])
    assert all(grade in GRADES for grade, _ in file.sources.values())


def test_the_numbers_of_commonroads_cars_are_theirs():
    """As parameters_vehicle2 and 3 of commonroad-vehicle-models 3.0.2 have them."""
    bmw, van = (read_car(ROOT / name).params for name in ("bmw-320i", "vw-vanagon"))
    published = {
        "m": (1093.2952, 1478.8980), "Iz": (1791.5995, 2473.1177), "lf": (1.1561957, 1.1507916),
        "lr": (1.4227171, 1.3211364), "h": (0.574869, 0.7478167), "track_f": (1.38684, 1.574292),
        "track_r": (1.36398, 1.543812), "brake_front": (0.66, 0.64), "drive_front": (0.0, 0.0),
        "delta_max": (1.066, 1.023), "delta_rate_max": (0.4, 0.4), "length": (4.508, 4.569),
        "width": (1.61, 1.844),
    }
    for key, values in published.items():
        assert (getattr(bmw, key), getattr(van, key)) == pytest.approx(values, rel=2e-6), key


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bmw-320i", "vw-vanagon"])
def test_a_car_written_again_from_its_toml_is_the_same(name, tmp_path):
    for file in ("car.toml", "tire.tir"):
        (tmp_path / file).write_text((ROOT / name / file).read_text())
    assert garage.main([str(tmp_path)]) == 0
    assert read_car(tmp_path).sha256 == read_car(ROOT / name).sha256


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bmw-320i", "vw-vanagon"])
def test_each_car_drives_the_circuit_at_65_per_cent_within_a_millimetre(name):
    with driving(ROOT / name):
        road = load_scenario("circuit", grip=0.65)
        result = metrics(simulate(Plant(), load_controller("lpv-mpc"), road))
    assert result["completed"]
    # the bars of the cars: 1 mm and 8 mm; measured 0.4 and 1.8
    assert result["lateral_rmse_m"] <= 0.001 and result["lateral_max_m"] <= 0.008


def test_a_folder_that_is_no_car_is_told_in_a_sentence(tmp_path, capsys):
    assert garage.main([str(tmp_path)]) == 2
    assert "has no vehicle.xml" in capsys.readouterr().err
