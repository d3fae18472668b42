import math

import numpy as np
import pytest

from lpvmpc.errors import PathError
from lpvmpc.road import segments


def test_a_bend_turns_by_its_angle_and_ends_straight():
    pieces = segments.bend(-120.0, [40.0, 25.0], [20.0, 15.0, 18.0], [0.3, 0.7])
    path = segments.from_segments([*segments.line(10.0), *pieces, *segments.line(10.0)])
    # Ends of segments fall between grid points: half a cell at the full curvature, twice.
    assert math.degrees(path.turn) == pytest.approx(-120.0, abs=0.05)
    assert path.kappa[-1] == 0.0
    assert path.kappa.min() == pytest.approx(-1.0 / 25.0)


def test_a_bend_shorter_than_its_clothoids_is_refused():
    with pytest.raises(PathError, match="shorter than its transitions"):
        segments.bend(10.0, [20.0], [20.0, 20.0])


def test_two_straights_close_a_road():
    corner = segments.bend(90.0, [20.0], [10.0, 10.0])
    pieces = [(50.0, 0.0), *corner, (30.0, 0.0), *corner, (None, 0.0), *corner, (None, 0.0)]
    closed = segments.close_with_lines([*pieces, *corner])
    assert [closed[i][0] for i in (8, 12)] == pytest.approx([50.0, 30.0])  # a rectangle
    path = segments.from_segments([*pieces, *corner], closed=True)
    assert math.hypot(path.x[-1], path.y[-1]) < 1e-9
    assert path.closure_correction < 1e-3 * 0.05  # of the curvature of the corners


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        ([(None, 0.0), (10.0, 0.1), (10.0, 0.0)], "not 1"),
        ([(None, 0.0), (None, 0.0), (10.0, 0.1), (10.0, 0.0)], "parallel"),
        (
            [(50.0, 0.0), (None, 0.0), (10.0, 0.1), (6.0, 0.1), (10.0, 0.0), (None, 0.0)],
            "straights",
        ),
        ([], "positive length"),
        ([(-5.0, 0.0)], "positive length"),
    ],
)
def test_roads_that_do_not_work_out_are_refused(pieces, message):
    with pytest.raises(PathError, match=message):
        segments.from_segments(pieces, closed=True)


def test_a_graph_is_followed():
    def derivatives(x):
        _, d, dd = segments.smooth_step(x, 10.0, 40.0)
        return 3.5 * d, 3.5 * dd

    path = segments.from_graph(derivatives, 60.0)
    # Curvature between grid points is interpolated: h^2 kappa''/8 = 2e-6 1/m at the most.
    assert path.y[-1] == pytest.approx(3.5, abs=1e-3)
    assert path.x[-1] == pytest.approx(60.0, abs=1e-3)
    assert path.psi[-1] == pytest.approx(0.0, abs=1e-4)
    expected = 3.5 * segments.smooth_step(path.x, 10.0, 40.0)[0]
    np.testing.assert_allclose(path.y, expected, atol=1e-3)
