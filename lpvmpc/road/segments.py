"""Building blocks of roads: straights, bends with clothoids, and curves given as y(x).

A road is a list of segments (length, kappa_end): the curvature changes linearly from that of the
segment before to `kappa_end`. A straight, an arc and a clothoid are all of this form, and a road
that starts straight is continuous in curvature by construction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lpvmpc.errors import PathError
from lpvmpc.road.path import GRID, Path
from lpvmpc.units import Array

Segment = tuple[float, float]
"""Length [m] and the curvature at its end [1/m]."""


def line(length: float) -> list[Segment]:
    """A straight of a given length [m]; it follows a bend whose curvature has come back to 0."""
    return [(length, 0.0)]


def bend(
    degrees: float,
    radii: Sequence[float],
    transitions: Sequence[float],
    shares: Sequence[float] = (1.0,),
) -> list[Segment]:
    """A bend from straight to straight: clothoid, arc, clothoid [, arc, clothoid, ...].

    Args:
        degrees: Change of heading over the whole bend [deg], left positive.
        radii: Radius of each arc [m], shape (k,).
        transitions: Lengths of the clothoids before, between and after the arcs [m], (k + 1,).
        shares: How the heading that the clothoids leave is divided between the arcs, shape (k,).

    Raises:
        PathError: The clothoids alone turn further than the whole bend.
    """
    sign = math.copysign(1.0, degrees)
    kappas = [0.0, *(1.0 / radius for radius in radii), 0.0]
    by_clothoids = sum(
        0.5 * length * (k0 + k1)
        for length, k0, k1 in zip(transitions, kappas[:-1], kappas[1:], strict=True)
    )
    by_arcs = math.radians(abs(degrees)) - by_clothoids
    if by_arcs < 0.0:
        raise PathError(
            f"A bend of {degrees:g} degrees is shorter than its transitions, which turn "
            f"{math.degrees(by_clothoids):.1f} degrees."
        )
    segments: list[Segment] = []
    for i, radius in enumerate(radii):
        segments.append((transitions[i], sign / radius))
        segments.append((by_arcs * shares[i] / sum(shares) * radius, sign / radius))
    segments.append((transitions[-1], 0.0))
    return segments


def read_segments(description: Sequence[Sequence[Any]]) -> list[tuple[float | None, float]]:
    """Segments from their description in a data file.

    Args:
        description: Items ["line", length or null] and ["bend", degrees, radii, transitions,
            shares (optional)]; a null length is left to `close_with_lines`.
    """
    segments: list[tuple[float | None, float]] = []
    for kind, *values in description:
        segments += line(*values) if kind == "line" else bend(*values)
    return segments


def close_with_lines(segments: Sequence[tuple[float | None, float]]) -> list[Segment]:
    """Choose the lengths of the two straights that are None so that the road closes.

    The gap is linear in the two lengths:
    gap + L1 (cos psi1, sin psi1) + L2 (cos psi2, sin psi2) = 0.

    Raises:
        PathError: Not two unknown straights, parallel ones, or a length that would be negative.
    """
    unknown = [i for i, (length, _) in enumerate(segments) if length is None]
    if len(unknown) != 2:
        raise PathError(f"A road closes with two straights of unknown length, not {len(unknown)}.")
    known = [(length or 0.0, kappa) for length, kappa in segments]
    x, y, psi, kappa = 0.0, 0.0, 0.0, 0.0
    headings = []
    for i, (length, kappa_end) in enumerate(known):
        if i in unknown:
            headings.append(psi)
        if length > 0.0:
            cells = math.ceil(length / 0.5)
            piece = Path(np.linspace(kappa, kappa_end, cells + 1), length, x0=x, y0=y, psi0=psi)
            x, y, psi = float(piece.x[-1]), float(piece.y[-1]), float(piece.psi[-1])
        kappa = kappa_end
    directions = np.array([[math.cos(a), math.sin(a)] for a in headings]).T  # (2, 2)
    if abs(np.linalg.det(directions)) < 0.05:
        raise PathError("The two straights of unknown length are parallel and cannot close a road.")
    lengths = np.linalg.solve(directions, [-x, -y])
    if lengths.min() < 0.0:
        raise PathError(
            f"Closing the road would need straights of {lengths[0]:.1f} and {lengths[1]:.1f} m."
        )
    for i, length in zip(unknown, lengths, strict=True):
        known[i] = (float(length), known[i][1])
    return known


def from_segments(
    segments: Sequence[tuple[float | None, float]],
    *,
    closed: bool = False,
    width: float | None = None,
    grid: float = GRID,
) -> Path:
    """Path along segments, starting straight at the origin along x.

    Args:
        segments: Lengths [m] and end curvatures [1/m]; on a closed road two straights may have
            length None.
        closed: Whether the road is a circuit.
        width: Half width of the road [m]; None where it states none.
        grid: Largest spacing of the fine grid [m]; ends of segments are met within half a cell.

    Raises:
        PathError: Segments without length, or a circuit that does not close.
    """
    if any(length is None for length, _ in segments):
        segments = close_with_lines(segments)
    lengths = np.array([length for length, _ in segments], dtype=float)
    if not len(lengths) or not np.all(np.isfinite(lengths)) or lengths.min() < 0.0:
        raise PathError("A road needs segments of positive length.")
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    kappas = np.concatenate([[0.0], [kappa for _, kappa in segments]])
    length = float(ends[-1])
    cells = math.ceil(length / grid - 1e-9)
    kappa = np.interp(np.linspace(0.0, length, cells + 1), ends, kappas)
    return Path(kappa, length, closed=closed, width=width)


def from_graph(
    derivatives: Callable[[Array], tuple[Array, Array]],
    x_end: float,
    *,
    width: float | None = None,
    grid: float = GRID,
) -> Path:
    """Path along a curve y(x) that starts straight at the origin along x.

    kappa = y'' / (1 + y'^2)^(3/2),  ds = sqrt(1 + y'^2) dx

    Args:
        derivatives: First and second derivative of y at x, each of the shape of x.
        x_end: Where it ends [m].
        width: Half width of the road [m]; None where it states none.
        grid: Largest spacing of the fine grid [m].
    """
    x = np.linspace(0.0, x_end, 20 * math.ceil(x_end / grid) + 1)
    slope, bending = derivatives(x)
    stretch = np.sqrt(1.0 + slope**2)
    steps = 0.5 * (stretch[1:] + stretch[:-1]) * np.diff(x)
    s = np.concatenate([[0.0], np.cumsum(steps)])
    length = float(s[-1])
    cells = math.ceil(length / grid - 1e-9)
    kappa = np.interp(np.linspace(0.0, length, cells + 1), s, bending / stretch**3)
    return Path(kappa, length, width=width)


def smooth_step(x: Array, start: float, end: float) -> tuple[Array, Array, Array]:
    """Quintic step from 0 to 1 with continuous curvature, and its two derivatives in x.

    q^3 (10 - 15 q + 6 q^2),  q = (x - start)/(end - start); its second derivative peaks at 5.77
    over the length squared.
    """
    length = end - start
    q = np.clip((x - start) / length, 0.0, 1.0)
    return (
        q**3 * (10.0 - 15.0 * q + 6.0 * q**2),
        30.0 * q**2 * (1.0 - q) ** 2 / length,
        60.0 * q * (1.0 - q) * (1.0 - 2.0 * q) / length**2,
    )
