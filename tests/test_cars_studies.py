"""Fidelity studies of another car than the packaged one."""

from pathlib import Path

import pytest

from lpvmpc.plant.car_folder import driving
from lpvmpc.studies.study import CarUnderTest, load_study

CARS = Path(__file__).parent.parent / "cars"


@pytest.mark.parametrize("name", ["bmw-320i", "vw-vanagon"])
def test_another_car_is_measured_by_its_own_numbers_and_no_handling_targets(name):
    with driving(CARS / name):
        car = CarUnderTest.packaged()
        results = [load_study(study)(car) for study in ("static", "tire")]
    assert all(result.findings for result in results)
    missed = {f.figure for r in results for f in r.findings if not f.ok}
    # both cars' published weights of combined slip leave the friction ellipse (by 16 and 9 %)
    assert missed <= {"combined force over the ellipse, worst"}
    assert not any(f.target for r in results for f in r.findings)
