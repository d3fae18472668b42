"""Random quadratic programs: none refused that has a solution, none answered wrong."""

import pytest

from lpvmpc.bench import fuzz


@pytest.mark.parametrize("count", [400, pytest.param(20_000, marks=pytest.mark.slow)])
def test_random_qps_are_answered_rightly_or_refused(count):
    found = fuzz.qps(count, seed=0)
    assert found["solvable"] > 0.8 * count
    assert (found["refused"], found["wrong"], found["answered"]) == (0, 0, 0), found
    assert set(found["kinds"]) == set(fuzz.KINDS)
