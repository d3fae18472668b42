"""Roads from points: smoothing noisy centre lines to continuous curvature.

Raw centre lines (from maps, images, GPS) are noisy by decimetres; their curvature, which holds the
noise divided by the square of the spacing, is useless as it is. They are fitted by the curve that
balances the distance to the points against the change of curvature along it. A single point far
beside the line through its neighbours is a bad measurement, which no smoothing should spread: it is
put onto that line first (`bad_points`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import OptionError, PathError
from lpvmpc.road.path import GRID, MAX_POINTS, WIDTH, Path
from lpvmpc.units import Array

SMOOTHING = 25.0
"""Default cut-off wavelength of the smoothing [m]. A circle of 10 m radius shrinks by 4 cm."""
SHORTEST = 4.0
"""Shortest cut-off wavelength that is tried [m]."""
SHIFT = 0.25
"""A shift of this much is no reason to smooth less [m]."""
BAD = 0.5
"""A point closer than this to the line through its neighbours is never called bad [m]."""
BAD_NOISE = 8.0
"""Nor is one closer than this many times the noise of the points."""
BAD_LEFT = 0.25
"""Share of its distance that may be left around a bad point once it is gone; a corner leaves more,
since it is bent without the point as well."""
BAD_MOST = 20
"""More bad points than this are a bad survey, and are smoothed like any other."""
MIN_POINTS = 5
MIN_LENGTH = 10.0
"""Shorter roads than this [m] are over before the car has settled."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A path fitted to points, and where each point lies along it."""

    path: Path
    """The smooth path."""
    s: Array
    """Arc length of the points' feet [m], shape (k,), increasing."""
    keep: int
    """How many of the given points were used: a repeated first point at the end is dropped."""
    cut_off: float
    """Cut-off wavelength of the smoothing [m]."""
    bad: tuple[tuple[int, float], ...] = ()
    """Index of each bad point, and how far it was moved before the fit [m]."""
    moved: tuple[int, float] | None = None
    """Where the smoothing has cut more than noise: index of the point and its shift [m]."""


def ends_meet(xy: Array) -> bool:
    """Whether points (k, 2) go round: their ends are at most two of the largest steps apart."""
    steps = np.hypot(*np.diff(xy, axis=0).T)
    gap = math.hypot(*(xy[0] - xy[-1]))
    return bool(gap <= 2.0 * steps.max() and gap < 0.2 * steps.sum())


def fit(
    xy: npt.ArrayLike,
    *,
    closed: bool | None = None,
    smoothing: float | None = None,
    widths: tuple[Array | None, Array | None] = (None, None),
    radius: float = 0.0,
    grid: float = GRID,
) -> Fit:
    """Smooth path through points, of continuous curvature.

    Minimises sum_i w_i |p(u_i) - p_i|^2 + (l / 2 pi)^6 int |p'''(u)|^2 du over quintic splines p,
    where w_i is the spacing of the points and l the cut-off wavelength: a wave of length l is
    halved, one of 2 l kept to 98 %. The parameter u is the arc length, found by fitting again.

    Unless it is given, the cut-off begins at `SMOOTHING`. Where that moves a point much further
    than the points' own noise it has cut a corner, not noise; it is then shortened step by step,
    down to `SHORTEST`, but not to where the road is tighter than `radius` if a longer one keeps to
    the road's widths.

    Args:
        xy: Points [m], shape (k, 2).
        closed: Whether they go round; None: if their ends meet.
        smoothing: Cut-off wavelength l [m]; 0 passes (almost) through the points.
        widths: Road widths to the right and left at the points [m], shape (k,).
        radius: Smallest radius that the road should have [m].
        grid: Largest spacing of the path's fine grid [m].

    Raises:
        PathError: Too few, repeated or non-finite points, or ends that do not meet.
        OptionError: A smoothing that is not a length.
    """
    given = smoothing is not None
    if smoothing is None:
        smoothing = SMOOTHING
    elif isinstance(smoothing, bool) or not 0.0 <= smoothing <= 200.0:  # NaN fails it too
        raise OptionError("smoothing", smoothing, "a wavelength from 0 to 200 m")
    xy, closed = _checked(np.array(xy, dtype=float), closed, grid)
    noise = _noise(xy)
    xy, bad = bad_points(xy, closed, noise)
    room = np.full(len(xy), math.inf)
    for width in widths:
        room = np.minimum(room, WIDTH if width is None else width[: len(xy)])
    cut_off = smoothing if given else min(smoothing, 0.25 * _chain(xy, closed)[1])
    drivable: tuple[float, _Curve, Array] | None = None
    while True:
        curve = _fit(xy, closed, cut_off, grid)
        path = curve.path()
        feet = np.array(
            [path.project(x, y, near) for (x, y), near in zip(xy, curve.u, strict=True)]
        )
        shifts = np.abs(feet[:, 1])
        tight = radius * float(np.abs(path.kappa).max()) > 1.0
        if tight and drivable is not None:
            cut_off, curve, feet = drivable
            break
        if given or shifts.max() <= max(SHIFT, 5.0 * noise) or cut_off <= SHORTEST:
            break
        if not tight and np.all(shifts <= room):
            drivable = cut_off, curve, feet
        cut_off = max(0.8 * cut_off, SHORTEST)
    right, left = (
        None
        if width is None
        else np.interp(path.s, feet[:, 0], width[: len(xy)], period=path.length if closed else None)
        for width in widths
    )
    i = int(np.argmax(np.abs(feet[:, 1])))
    shift = float(abs(feet[i, 1]))
    return Fit(
        path=curve.path(right, left, shift),
        s=feet[:, 0],
        keep=len(xy),
        cut_off=cut_off,
        bad=bad,
        moved=(i, shift) if shift > max(SHIFT, 5.0 * noise) else None,
    )


def bad_points(
    xy: Array, closed: bool, noise: float
) -> tuple[Array, tuple[tuple[int, float], ...]]:
    """Single points far beside the line through their neighbours, put onto it.

    The line is the cubic through two neighbours on either side. A point is bad where it lies
    further from it than `BAD` and `BAD_NOISE` times the noise, and the road is smooth without it.

    Args:
        xy: Points [m], shape (k, 2).
        closed: Whether they go round.
        noise: Standard deviation of the points across the road [m].

    Returns:
        The points, and index and distance [m] of each that was moved.
    """
    bound = max(BAD, BAD_NOISE * noise)
    found: dict[int, float] = {}
    mended = xy
    while len(found) <= BAD_MOST:
        off, line = _beside_neighbours(mended, closed)
        for i in np.argsort(-off):
            if off[i] <= bound:
                return mended, tuple(sorted(found.items()))
            rest, _ = _beside_neighbours(np.delete(mended, i, axis=0), closed)
            around = np.arange(i - 2, i + 2)  # without point i its neighbours stand here
            around = around % len(rest) if closed else around[(0 <= around) & (around < len(rest))]
            if int(i) not in found and rest[around].max() < BAD_LEFT * off[i]:
                break
        else:
            return mended, tuple(sorted(found.items()))
        found[int(i)] = float(off[i])
        mended = mended.copy()
        mended[i] = line[i]
    return xy, ()


def _beside_neighbours(xy: Array, closed: bool) -> tuple[Array, Array]:
    """Distance of each point from the cubic through its four neighbours [m], and the place on it.

    Returns:
        Distances (k,), 0 for the two points at each open end, and places (k, 2).
    """
    k = len(xy)
    a, b, c, d = (xy[(np.arange(k) + j) % k] for j in (-2, -1, 1, 2))

    def length(vector: Array) -> Array:
        return np.maximum(np.hypot(*vector.T), 1e-9)

    before, after = length(xy - b), length(c - xy)
    chord = length(c - b)
    t = np.stack([-length(b - a), np.zeros(k), chord, chord + length(d - c)])  # (4, k)
    at = chord * before / (before + after)
    line = np.zeros_like(xy)
    for j, point in enumerate((a, b, c, d)):  # Lagrange's form of the cubic
        others = [m for m in range(4) if m != j]
        factor = np.prod([(at - t[m]) / (t[j] - t[m]) for m in others], axis=0)
        line += factor[:, None] * point
    across = (xy - line)[:, 1] * (c - b)[:, 0] - (xy - line)[:, 0] * (c - b)[:, 1]
    off = np.abs(across) / chord
    if not closed:
        off[[0, 1, -2, -1]] = 0.0
    return off, line


def _checked(xy: Array, closed: bool | None, grid: float) -> tuple[Array, bool]:
    """The points that make a road, and whether it goes round; see `fit`."""
    if xy.ndim != 2 or xy.shape[1] != 2 or not np.all(np.isfinite(xy)):
        raise PathError("A road needs points of two finite numbers.")
    if len(xy) < MIN_POINTS:
        raise PathError(f"A road needs at least {MIN_POINTS} points, but there are {len(xy)}.")
    if closed is not False and len(xy) > MIN_POINTS and np.hypot(*(xy[-1] - xy[0])) < 1e-6:
        xy = xy[:-1]  # many files repeat the first point
        closed = True if closed is None else closed
    steps = np.hypot(*np.diff(xy, axis=0).T)
    if steps.min() < 1e-6:
        i = int(np.argmin(steps))
        raise PathError(f"Points {i + 1} and {i + 2} of the road are the same.")
    with np.errstate(over="ignore"):
        length = steps.sum()
    if length < MIN_LENGTH or length > MAX_POINTS * grid:
        raise PathError(
            f"The road is {length:.6g} m long, but must be from {MIN_LENGTH:g} m to "
            f"{MAX_POINTS * grid:g} m."
        )
    meet = ends_meet(xy)
    if closed and not meet:
        raise PathError(
            "A closed road must end where it starts, but its ends are "
            f"{math.hypot(*(xy[0] - xy[-1])):.3g} m apart."
        )
    return xy, meet if closed is None else closed


def _chain(xy: Array, closed: bool) -> tuple[Array, float]:
    """Length of the chain of chords at each point [m], shape (k,), and as a whole."""
    u = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(xy, axis=0).T))])
    return u, float(u[-1]) + (math.hypot(*(xy[0] - xy[-1])) if closed else 0.0)


def _noise(xy: Array) -> float:
    """Standard deviation of the points across the road [m], from their third differences.

    A smooth road has small ones; independent errors of deviation s give sqrt(20) s. The median
    passes over the few points of tight bends.
    """
    third = np.diff(xy, 3, axis=0)
    chord = xy[3:] - xy[:-3]
    length = np.maximum(np.hypot(*chord.T), 1e-9)
    across = (third[:, 1] * chord[:, 0] - third[:, 0] * chord[:, 1]) / length
    return float(1.4826 * np.median(np.abs(across)) / math.sqrt(20.0))


@dataclass(frozen=True, kw_only=True)
class _Curve:
    """A fitted curve: its curvature on the grid, its start, and the arc lengths of the points."""

    kappa: Array
    length: float
    start: tuple[float, float, float]
    closed: bool
    u: Array

    def path(
        self, right: Array | None = None, left: Array | None = None, shift: float = 0.0
    ) -> Path:
        x0, y0, psi0 = self.start
        return Path(
            self.kappa,
            self.length,
            x0=x0,
            y0=y0,
            psi0=psi0,
            closed=self.closed,
            width=(right, left),
            largest_shift=shift,
        )


def _fit(xy: Array, closed: bool, cut_off: float, grid: float) -> _Curve:
    """Fit with one cut-off wavelength [m]; see `fit`."""
    u, chain = _chain(xy, closed)
    length = chain
    for _ in range(20):
        curve = _spline(u, xy, length, closed, cut_off)
        dense = np.linspace(0.0, length, math.ceil(length / 0.05) + 1)
        speed = np.hypot(*curve(dense, 1).T)
        arc = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(dense))])
        if not 0.5 * MIN_LENGTH < arc[-1] < 2.0 * chain:
            raise PathError("The points are a cloud: no smooth road runs along them.")
        change = abs(arc[-1] - length)
        u, length = np.interp(u, dense, arc), float(arc[-1])
        if change < 1e-5 * length:
            break
    (dx, dy), (ddx, ddy) = curve(dense, 1).T, curve(dense, 2).T
    s = np.linspace(0.0, length, math.ceil(length / grid - 1e-9) + 1)
    x0, y0 = curve(0.0)
    return _Curve(
        kappa=np.interp(s, arc, (dx * ddy - dy * ddx) / np.maximum(speed, 1e-3) ** 3),
        length=length,
        start=(float(x0), float(y0), math.atan2(dy[0], dx[0])),
        closed=closed,
        u=u,
    )


def _spline(u, xy, period, closed, smoothing):
    """Penalised quintic spline p(u) of period `period` (closed), or on [0, period] (open).

    Returns:
        Function of parameters (m,) and the order of the derivative, giving (m, 2).
    """
    from scipy.interpolate import BSpline
    from scipy.sparse import csr_array  # type: ignore[import-untyped]
    from scipy.sparse.linalg import spsolve  # type: ignore[import-untyped]

    cells = max(8, math.ceil(period / max(1.0, 0.5 * float(np.median(np.diff(u))))))
    h, k = period / cells, 5
    knots = h * np.arange(-k, cells + k + 1)
    size = cells if closed else cells + k

    column = np.arange(cells + k) % size  # basis functions of a closed curve are wrapped round
    fold = csr_array((np.ones(cells + k), (np.arange(cells + k), column)))
    inside = period * (1.0 - 1e-12)  # the last knot belongs to no cell
    weight = (
        np.gradient(u)
        if not closed
        else 0.5 * (np.diff(u, append=u[0] + period) + np.diff(u, prepend=u[-1] - period))
    )
    penalty = _third_derivative_penalty(h, k, cells, size)
    data = csr_array(BSpline.design_matrix(np.clip(u, 0.0, inside), knots, k) @ fold)
    factor = (max(smoothing, 0.2 * h) / (2.0 * math.pi)) ** 6
    normal = (data.T @ (data * weight[:, None]) + factor * penalty).tocsc()
    coefficients = np.column_stack([spsolve(normal, data.T @ (weight * xy[:, j])) for j in (0, 1)])
    spline = BSpline(knots, coefficients[column], k)
    return lambda at, order=0: spline(np.clip(at, 0.0, inside), order)


def _third_derivative_penalty(h, k, cells, size):
    """Matrix of int p'''^2 for the uniform B-spline basis, folded round on closed curves.

    The third derivative is quadratic in a cell of width h, so three Gauss points are exact.
    """
    from scipy.interpolate import BSpline  # type: ignore[import-untyped]
    from scipy.sparse import coo_array  # type: ignore[import-untyped]

    nodes, weights = np.polynomial.legendre.leggauss(3)
    values = np.zeros((k + 1, 3))  # third derivatives of the k + 1 functions that live on a cell
    for j in range(k + 1):
        unit = np.zeros(k + 1)
        unit[j] = 1.0
        values[j] = BSpline(np.arange(-k, k + 2), unit, k).derivative(3)(0.5 + 0.5 * nodes)
    element = (values * (0.5 * weights)) @ values.T / h**5
    row, column = np.indices((k + 1, k + 1))
    start = np.arange(cells)[:, None]
    return coo_array(
        (
            np.tile(element.ravel(), cells),
            ((start + row.ravel()).ravel() % size, (start + column.ravel()).ravel() % size),
        ),
        shape=(size, size),
    ).tocsr()
