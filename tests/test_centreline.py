import math

import numpy as np
import pytest

from lpvmpc.errors import OptionError, PathError
from lpvmpc.road import centreline

ANGLE = np.arange(0.0, 2 * math.pi, 0.05)
OVAL = np.column_stack([80.0 * np.cos(ANGLE), 50.0 * np.sin(ANGLE)])
WAVE = np.column_stack(
    [np.arange(0.0, 200.0, 3.0), 6.0 * np.sin(np.arange(0.0, 200.0, 3.0) / 30.0)]
)


def test_clean_points_are_hardly_moved():
    path = centreline.fit(OVAL).path
    assert path.closed and path.turn == pytest.approx(2 * math.pi)
    assert path.largest_shift < 0.01  # smoothing 25 m against waves of 150 m and more: (25/150)^6
    assert math.hypot(path.x[-1] - path.x[0], path.y[-1] - path.y[0]) < 1e-9


def test_curvature_of_an_ellipse_is_recovered():
    fit = centreline.fit(OVAL)
    kappa = fit.path.at(fit.s)[3]
    a, b = 80.0, 50.0
    exact = a * b / ((a * np.sin(ANGLE)) ** 2 + (b * np.cos(ANGLE)) ** 2) ** 1.5
    # The sharp ends hold the short waves that smoothing weakens.
    np.testing.assert_allclose(kappa, exact, atol=1e-4)


def test_an_open_road_keeps_its_ends():
    fit = centreline.fit(WAVE)
    path = fit.path
    assert not path.closed
    assert math.hypot(path.x[0] - WAVE[0, 0], path.y[0] - WAVE[0, 1]) < 0.05
    assert math.hypot(path.x[-1] - WAVE[-1, 0], path.y[-1] - WAVE[-1, 1]) < 0.05
    assert np.all(np.diff(fit.s) > 0.0)


@pytest.mark.parametrize("noise", [0.1, 0.3])
def test_noise_is_smoothed_and_the_largest_shift_reported(noise):
    rng = np.random.default_rng(3)
    dense = np.arange(0.0, 2 * math.pi, 0.02)  # about 1.3 m apart
    true = np.column_stack([80.0 * np.cos(dense), 50.0 * np.sin(dense)])
    path = centreline.fit(true + noise * rng.standard_normal(true.shape)).path
    assert noise < path.largest_shift < 5.0 * noise  # the largest of 315 draws
    near = [path.s[np.argmin(np.hypot(path.x - x, path.y - y))] for x, y in true]
    off = [path.project(*p, s)[1] for p, s in zip(true, near, strict=True)]
    assert np.sqrt(np.mean(np.square(off))) < 0.6 * noise  # nearer to the road than the data
    raw = np.diff(np.unwrap(np.arctan2(*np.diff(true, axis=0).T[::-1]))) / 1.3
    assert np.abs(path.kappa).max() < np.abs(raw).max() + 0.25 * noise


def test_zigzag_points_do_not_lengthen_the_road():
    rng = np.random.default_rng(4)
    x = np.arange(0.0, 200.0, 0.2)
    xy = np.column_stack([x, np.zeros_like(x)]) + 0.15 * rng.standard_normal((len(x), 2))
    path = centreline.fit(xy).path
    assert path.length == pytest.approx(200.0, abs=1.0)  # the points' own chain is twice as long


def test_a_repeated_first_point_is_dropped():
    fit = centreline.fit(np.vstack([OVAL, OVAL[:1]]))
    assert fit.path.closed and fit.keep == len(OVAL)


def test_closing_is_decided_by_the_ends_or_by_the_caller():
    assert centreline.fit(OVAL).path.closed
    assert not centreline.fit(OVAL, closed=False).path.closed
    assert not centreline.fit(OVAL[:60]).path.closed
    with pytest.raises(PathError, match="must end where it starts"):
        centreline.fit(OVAL[:60], closed=True)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 2)), "two finite numbers|at least"),
        (WAVE[:4], "at least 5 points"),
        (WAVE[:5] * 0.1, "m long"),
        (WAVE * 1e5, "m long"),
        (np.vstack([WAVE[:7], WAVE[6:]]), "Points 7 and 8"),
        (np.where(WAVE > 100.0, math.nan, WAVE), "finite"),
        (WAVE[:, :1], "two finite numbers"),
    ],
)
def test_points_that_make_no_road_are_refused(points, message):
    with pytest.raises(PathError, match=message):
        centreline.fit(points)


@pytest.mark.parametrize("smoothing", [-1.0, math.nan, 1e6])
def test_an_absurd_smoothing_is_refused(smoothing):
    with pytest.raises(OptionError, match="smoothing"):
        centreline.fit(OVAL, smoothing=smoothing)


@pytest.mark.parametrize("radius", [3.0, 4.0, 6.0])
def test_tight_bends_of_clean_points_are_kept(radius):
    half = np.arange(0.0, math.pi, 0.2)
    bend = np.column_stack([radius * np.sin(half), radius * (1.0 - np.cos(half))])
    there = np.column_stack([np.arange(-60.0, 0.0, 1.0), np.zeros(60)])
    back = np.column_stack([-np.arange(0.5, 60.0, 1.0), np.full(60, 2.0 * radius)])
    path = centreline.fit(np.vstack([there, bend, back])).path
    # An arc between straights has no continuous curvature; its middle is met to a quarter.
    assert 1.0 / np.abs(path.kappa).max() == pytest.approx(radius, rel=0.25)
    assert path.largest_shift <= 0.25


def test_a_small_circle_does_not_collapse():
    angle = np.arange(0.0, 2 * math.pi, 0.1)
    path = centreline.fit(np.column_stack([4.0 * np.cos(angle), 4.0 * np.sin(angle)])).path
    assert path.length == pytest.approx(8.0 * math.pi, rel=0.02)  # its wave is four cut-offs long


def test_random_points_raise_or_make_a_path_but_never_crash():
    for seed in range(5):
        points = 50.0 * np.random.default_rng(seed).standard_normal((40, 2))
        try:
            assert np.all(np.isfinite(centreline.fit(points).path.kappa))
        except PathError as error:
            assert str(error).count(".") >= 1
