import math
import time

import numpy as np
import pytest

from lpvmpc.errors import PathError
from lpvmpc.road.path import Path
from lpvmpc.road.speed_profile import SpeedProfile

RNG = np.random.default_rng(1)


def winding(closed: bool = False) -> Path:
    """A lap of six bends, or 500 m of a winding road."""
    s = np.linspace(0.0, 500.0, 2501)
    if closed:
        return Path(2 * np.pi / 500.0 * (1 + 2 * np.cos(6 * np.pi * s / 500.0)), 500.0, closed=True)
    return Path(0.02 * np.sin(s / 20.0) + 0.01 * np.sin(s / 7.0), 500.0, x0=3.0, y0=-2.0, psi0=0.4)


def figure_eight() -> Path:
    """A lemniscate: it closes where the heading swings by the first zero of J0, 2.405 rad."""
    s = np.linspace(0.0, 400.0, 2001)
    return Path(0.0378 * np.sin(2 * np.pi * s / 400.0), 400.0, closed=True)


def beside(path: Path, s: float, ey: float) -> tuple[float, float]:
    """The point at a lateral distance from the path."""
    x, y, psi, _ = (float(value) for value in path.at(s))
    return x - ey * math.sin(psi), y + ey * math.cos(psi)


def test_constant_curvature_is_a_circle():
    path = Path.from_curvature([0.1, 0.1], 2 * math.pi * 10.0)
    x, y, psi, kappa = path.at(np.array([5.0 * math.pi, 10.0 * math.pi]))
    # Closed form of the circle; rounding of 300 added cells.
    np.testing.assert_allclose(x, [10.0, 0.0], atol=1e-11)
    np.testing.assert_allclose(y, [10.0, 20.0], atol=1e-11)
    np.testing.assert_allclose(psi, [math.pi / 2, math.pi], atol=1e-12)
    np.testing.assert_allclose(kappa, 0.1)


def test_linear_curvature_gives_the_fresnel_integrals():
    fresnel = pytest.importorskip("scipy.special").fresnel
    a, length = 0.004, 40.0  # kappa = a s, up to a radius of 6.25 m
    path = Path.from_curvature([0.0, a * length], length)
    scale = math.sqrt(math.pi / a)
    sine, cosine = fresnel(length / scale)
    assert path.x[-1] == pytest.approx(scale * cosine, abs=1e-11)  # quadrature: about 1e-15 a cell
    assert path.y[-1] == pytest.approx(scale * sine, abs=1e-11)


def test_heading_and_position_are_integrals_of_the_curvature_between_grid_points():
    path = winding()
    s, h = RNG.uniform(1.0, 499.0, 200), 1e-4
    before, here, after = path.at(s - h), path.at(s), path.at(s + h)
    # Central differences: error h^2/6 times the third derivative, plus rounding over h.
    np.testing.assert_allclose((after[0] - before[0]) / (2 * h), np.cos(here[2]), atol=1e-8)
    np.testing.assert_allclose((after[1] - before[1]) / (2 * h), np.sin(here[2]), atol=1e-8)
    np.testing.assert_allclose((after[2] - before[2]) / (2 * h), here[3], atol=1e-6)


def test_points_on_a_finer_grid_agree():
    s = np.linspace(0.0, 500.0, 26)
    knots = 0.02 * np.sin(s / 20.0)
    coarse = Path.from_curvature(knots, 20.0, grid=0.25)
    fine = Path.from_curvature(knots, 20.0, grid=0.05)
    # Both integrate the same piecewise-linear curvature: equal to rounding.
    at = RNG.uniform(0.0, 500.0, 100)
    np.testing.assert_allclose(coarse.at(at), fine.at(at), atol=1e-10)


@pytest.mark.parametrize("path", [winding(closed=True), figure_eight()], ids=["lap", "eight"])
def test_a_closed_path_ends_where_it_starts(path):
    assert math.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0]) < 1e-9  # rounding of a lap
    assert path.turn / (2 * math.pi) == pytest.approx(round(path.turn / (2 * math.pi)), abs=1e-12)
    assert path.kappa[0] == path.kappa[-1]


def test_closing_changes_the_curvature_only_as_much_as_needed():
    assert winding(closed=True).closure_correction < 1e-8  # symmetric: closes by itself
    assert 0.0 < figure_eight().closure_correction < 2e-3


def test_a_path_whose_ends_do_not_meet_cannot_be_closed():
    with pytest.raises(PathError, match=r"ends are 100 m"):
        Path(np.zeros(101), 100.0, closed=True)


@pytest.mark.parametrize("closed", [False, True])
def test_projection_finds_where_a_point_was_put(closed):
    path = winding(closed)
    for s, ey, off in zip(
        RNG.uniform(2.0, 498.0, 300), RNG.uniform(-4.0, 4.0, 300), RNG.uniform(-2.0, 2.0, 300),
        strict=True,
    ):
        found = path.project(*beside(path, s, ey), s + off)
        # Newton stops at steps of 1e-10 m; far below what any error bar shows.
        assert found == pytest.approx((s, ey), abs=1e-9)


def test_projection_stays_on_its_branch_of_a_figure_eight():
    path = figure_eight()
    s_prev = 0.0
    for s in np.arange(0.0, 3 * path.length, 0.7):  # 21 m/s for three laps
        s_prev, ey = path.project(*beside(path, s, 0.3), s_prev)
        assert s_prev == pytest.approx(s, abs=1e-9)
        assert ey == pytest.approx(0.3, abs=1e-9)


def test_arc_length_counts_up_over_the_start_line_and_backwards():
    path = winding(closed=True)
    x, y = beside(path, 0.2, 0.1)
    assert path.project(x, y, 2 * path.length - 0.5)[0] == pytest.approx(2 * path.length + 0.2)
    x, y = beside(path, path.length - 0.2, 0.1)
    assert path.project(x, y, 0.3)[0] == pytest.approx(-0.2, abs=1e-9)
    assert path.at(path.length + 1.0)[2] == pytest.approx(path.at(1.0)[2] + path.turn, abs=1e-12)


def test_projection_ends_beyond_the_centre_of_curvature():
    path = Path.from_curvature([0.1, 0.1], 30.0)  # radius 10 m
    s, ey = path.project(*beside(path, 10.0, 11.0), 9.0)
    assert math.isfinite(s) and abs(s - 9.0) < 40.0
    assert abs(ey) <= 11.0 + 1e-9


def test_an_open_path_goes_on_with_the_curvature_of_its_ends():
    path = Path.from_curvature([0.0, 0.05], 50.0)
    x, y, psi, kappa = path.at(np.array([-10.0, 60.0]))
    assert kappa == pytest.approx([0.0, 0.05])
    assert (x[0], y[0]) == pytest.approx((-10.0, 0.0))
    assert psi[1] == pytest.approx(path.psi[-1] + 0.5)
    centre = path.x[-1] - 20.0 * math.sin(path.psi[-1]), path.y[-1] + 20.0 * math.cos(path.psi[-1])
    assert math.hypot(x[1] - centre[0], y[1] - centre[1]) == pytest.approx(20.0)


def test_preview_starts_at_the_car_and_moves_at_the_reference_speed():
    path = winding(closed=True)
    speed = SpeedProfile(12.0 + 4.0 * np.sin(4 * np.pi * path.s / 500.0), 500.0, True)
    x, y = beside(path, 499.0, -0.4)
    psi = float(path.at(499.0)[2]) + 0.1 - 4 * math.pi
    preview = path.preview(x, y, psi, 498.5, speed.vx, speed.spacing, 20, 0.033)
    assert (preview.s, preview.ey, preview.epsi) == pytest.approx((499.0, -0.4, 0.1), abs=1e-9)
    # The same march in steps a hundred times smaller, by Euler with its error of order one.
    s, expected = 499.0, [499.0]
    for i in range(20 * 1000):
        s += 3.3e-5 * float(speed.at(s))
        if (i + 1) % 1000 == 0:
            expected.append(s)
    x, y, psi, kappa = path.at(np.array(expected))
    np.testing.assert_allclose(preview.x, x, atol=1e-3)
    np.testing.assert_allclose(preview.y, y, atol=1e-3)
    np.testing.assert_allclose(preview.psi, psi, atol=1e-4)  # crosses the start line: no jump
    np.testing.assert_allclose(preview.kappa, kappa, atol=1e-5)
    np.testing.assert_allclose(preview.vx_ref, speed.at(expected), atol=1e-3)


@pytest.mark.parametrize("turns", [-3, 0, 2])
def test_the_heading_error_is_wrapped(turns):
    path = Path.from_curvature([0.0, 0.0], 100.0, psi0=1.0)
    speed = SpeedProfile.constant(10.0, path)
    for epsi in (-3.0, 0.2, math.pi):
        psi = 1.0 + epsi + 2.0 * math.pi * turns
        preview = path.preview(0.0, 0.0, psi, 0.0, speed.vx, speed.spacing, 2, 0.033)
        assert abs(preview.epsi) <= math.pi + 1e-12
        assert math.cos(preview.epsi - epsi) == pytest.approx(1.0)


def test_mirrored_points_have_mirrored_errors():
    left = Path.from_curvature([0.0, 0.03, -0.02, 0.04], 30.0)
    right = Path.from_curvature([0.0, -0.03, 0.02, -0.04], 30.0)
    s, ey = left.project(70.0, 3.0, 70.0)
    assert right.project(70.0, -3.0, 70.0) == (s, -ey)  # bit for bit: sine is odd


def test_arrays_of_a_path_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        winding().kappa[0] = 1.0


@pytest.mark.parametrize(
    ("knots", "steps"),
    [([0.0], 1.0), ([0.0, math.nan], 1.0), ([0.0, 0.1], -1.0), ([0.0, 0.1], [1.0, 0.0][1:])],
)
def test_knots_that_make_no_path_are_refused(knots, steps):
    with pytest.raises(PathError):
        Path.from_curvature(knots, steps)


def test_preview_and_projection_take_microseconds():
    path = winding()
    speed = SpeedProfile.constant(15.0, path)
    x, y = beside(path, 200.0, 0.1)
    path.preview(x, y, 0.0, 199.5, speed.vx, speed.spacing, 10, 0.033)
    best = math.inf
    for _ in range(5):
        start = time.thread_time()
        for _ in range(1000):
            path.preview(x, y, 0.0, 199.5, speed.vx, speed.spacing, 10, 0.033)
        best = min(best, (time.thread_time() - start) / 1000)
    assert best < 50e-6  # measured: 5 us; ten times that on a machine under load
