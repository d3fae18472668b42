"""Roads from points: reading track files, and smoothing noisy centre lines.

Raw centre lines (from maps, images, GPS) are noisy by decimetres; their curvature, which holds the
noise divided by the square of the spacing, is useless as it is. They are fitted by the curve that
balances the distance to the points against the change of curvature along it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np
import numpy.typing as npt

from lpvmpc.errors import OptionError, PathError
from lpvmpc.path import GRID, MAX_POINTS, Path

Array = npt.NDArray[np.float64]

SMOOTHING = 25.0
"""Default cut-off wavelength of the smoothing [m]. A circle of 10 m radius shrinks by 4 cm."""
MIN_POINTS = 5
MIN_LENGTH = 10.0
"""Shorter roads than this [m] are over before the car has settled."""
COLUMNS = ("x_m", "y_m", "w_tr_right_m", "w_tr_left_m", "vx_mps", "wind_mps")
WIDTH = 3.5
"""Half width where a file gives none [m]."""


@dataclass(frozen=True, kw_only=True)
class Track:
    """What a track file says, point by point."""

    xy: Array
    """Points of the centre line [m], shape (k, 2)."""
    width_right: Array | None = None
    """Distance to the right road edge [m], shape (k,)."""
    width_left: Array | None = None
    """Distance to the left road edge [m], shape (k,)."""
    vx: Array | None = None
    """Reference speed [m/s], shape (k,)."""
    wind: Array | None = None
    """Wind speed from left to right [m/s], shape (k,)."""


def read_csv(file: str | FilePath) -> Track:
    """Read a track file: `# x_m,y_m,w_tr_right_m,w_tr_left_m[,vx_mps][,wind_mps]`.

    The header names the columns, in any order; without a header the first columns are those of the
    format, in its order. Widths may be missing.

    Raises:
        PathError: With one sentence that names the file, the line and what is wrong.
    """
    file = FilePath(file)
    if file.is_dir():
        raise PathError(f"The track file {file} is a directory.")
    if not file.exists():
        raise PathError(f"The track file {file} does not exist.")
    try:
        lines = file.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise PathError(f"The track file {file} is not a text file.") from None
    except OSError as error:
        raise PathError(f"The track file {file} cannot be read: {error.strerror}.") from None
    names: list[str] | None = None
    rows: list[list[float]] = []
    for number, text in enumerate((line.strip() for line in lines), start=1):
        words = [word.strip() for word in text.lstrip("#").split(",")]
        if text.startswith("#") or (not rows and names is None and "x_m" in words):
            names = words if names is None and "x_m" in words else names
        elif text:
            rows.append(_numbers(words, f"Line {number} of {file}"))
            if len(rows[-1]) != len(rows[0]):
                raise PathError(
                    f"Line {number} of {file} has {len(rows[-1])} columns, but the first row of "
                    f"numbers has {len(rows[0])}."
                )
    if not rows:
        raise PathError(f"The track file {file} holds no points.")
    width = len(rows[0])
    if width < 2:
        raise PathError(f"The track file {file} has one column, but needs x_m and y_m.")
    if names is None:
        names = list(COLUMNS[:width])
    if len(names) != width or "y_m" not in names or len(set(names)) != width:
        raise PathError(
            f"The track file {file} has {width} columns of numbers, but its header says "
            f"{','.join(names)!r}; it must name each column once, x_m and y_m among them."
        )
    table = dict(zip(names, np.array(rows).T, strict=True))
    _check_track(table, file)
    return Track(
        xy=np.column_stack([table["x_m"], table["y_m"]]),
        width_right=table.get("w_tr_right_m"),
        width_left=table.get("w_tr_left_m"),
        vx=table.get("vx_mps"),
        wind=table.get("wind_mps"),
    )


def _numbers(words: list[str], where: str) -> list[float]:
    """The numbers of one line, all finite."""
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        bad = str(error).rpartition(": ")[2]
        raise PathError(f"{where} holds {bad}, which is not a number.") from None
    if not all(math.isfinite(value) for value in values):
        raise PathError(f"{where} holds NaN or infinity, but all numbers must be finite.")
    return values


def _check_track(table: dict[str, Array], file: FilePath) -> None:
    """Refuse widths, speeds and winds that no road has."""
    for name, low, high in (
        ("w_tr_right_m", 0.0, 100.0),
        ("w_tr_left_m", 0.0, 100.0),
        ("vx_mps", 1.0, 60.0),
        ("wind_mps", -100.0, 100.0),
    ):
        column = table.get(name)
        if column is not None and not (low <= column.min() and column.max() <= high):
            raise PathError(
                f"Column {name} of {file} goes from {column.min():g} to {column.max():g}, but must "
                f"stay within {low:g} and {high:g}."
            )


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A path fitted to points, and where each point lies along it."""

    path: Path
    """The smooth path."""
    s: Array
    """Arc length of the points' feet [m], shape (k,), increasing."""
    keep: int
    """How many of the given points were used: a repeated first point at the end is dropped."""


def ends_meet(xy: Array) -> bool:
    """Whether points (k, 2) go round: their ends are at most two of the largest steps apart."""
    steps = np.hypot(*np.diff(xy, axis=0).T)
    gap = math.hypot(*(xy[0] - xy[-1]))
    return bool(gap <= 2.0 * steps.max() and gap < 0.2 * steps.sum())


def fit(
    xy: npt.ArrayLike,
    *,
    closed: bool | None = None,
    smoothing: float = SMOOTHING,
    widths: tuple[Array | None, Array | None] = (None, None),
    grid: float = GRID,
) -> Fit:
    """Smooth path through points, of continuous curvature.

    Minimises sum_i w_i |p(u_i) - p_i|^2 + (l / 2 pi)^6 int |p'''(u)|^2 du over quintic splines p,
    where w_i is the spacing of the points and l the cut-off wavelength: a wave of length l is
    halved, one of 2 l kept to 98 %. The parameter u is the arc length, found by fitting again.

    Args:
        xy: Points [m], shape (k, 2).
        closed: Whether they go round; None: if their ends meet.
        smoothing: Cut-off wavelength l [m]; 0 passes (almost) through the points.
        widths: Road widths to the right and left at the points [m], shape (k,).
        grid: Largest spacing of the path's fine grid [m].

    Raises:
        PathError: Too few, repeated or non-finite points, or ends that do not meet.
        OptionError: A smoothing that is no length.
    """
    if not (math.isfinite(smoothing) and 0.0 <= smoothing <= 200.0):
        raise OptionError("smoothing", smoothing, "a wavelength from 0 to 200 m")
    xy = np.array(xy, dtype=float)
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
    if steps.sum() < MIN_LENGTH or steps.sum() > MAX_POINTS * grid:
        raise PathError(
            f"The road is {steps.sum():.6g} m long, but must be from {MIN_LENGTH:g} m to "
            f"{MAX_POINTS * grid:g} m."
        )
    meet = ends_meet(xy)
    if closed and not meet:
        raise PathError(
            "A closed road must end where it starts, but its ends are "
            f"{math.hypot(*(xy[0] - xy[-1])):.3g} m apart."
        )
    closed = meet if closed is None else closed
    u = np.concatenate([[0.0], np.cumsum(steps)])
    period = float(u[-1]) + (math.hypot(*(xy[0] - xy[-1])) if closed else 0.0)
    for _ in range(20):
        curve = _spline(u, xy, period, closed, smoothing)
        dense = np.linspace(0.0, period, math.ceil(period / 0.05) + 1)
        speed = np.hypot(*curve(dense, 1).T)
        arc = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(dense))])
        change = abs(arc[-1] - period)
        if change < 1e-6 * period:
            break
        u, period = np.interp(u, dense, arc), float(arc[-1])
    (dx, dy), (ddx, ddy) = curve(dense, 1).T, curve(dense, 2).T
    cells = math.ceil(period / grid - 1e-9)
    kappa = np.interp(np.linspace(0.0, arc[-1], cells + 1), arc, (dx * ddy - dy * ddx) / speed**3)
    start = curve(0.0)

    def path_with(right: npt.ArrayLike, left: npt.ArrayLike, shift: float) -> Path:
        return Path(
            kappa,
            float(arc[-1]),
            x0=float(start[0]),
            y0=float(start[1]),
            psi0=math.atan2(dy[0], dx[0]),
            closed=bool(closed),
            width=(right, left),
            largest_shift=shift,
        )

    path = path_with(WIDTH, WIDTH, 0.0)
    feet = np.array([path.project(x, y, near) for (x, y), near in zip(xy, u, strict=True)])
    right, left = (
        WIDTH
        if width is None
        else np.interp(path.s, feet[:, 0], width[: len(xy)], period=path.length if closed else None)
        for width in widths
    )
    path = path_with(right, left, float(np.abs(feet[:, 1]).max()))
    return Fit(path=path, s=feet[:, 0], keep=len(xy))


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
