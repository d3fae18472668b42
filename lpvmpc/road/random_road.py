"""Roads drawn at random, each the same for the same number: for runs that nobody has tuned for.

Open roads of 170 to 900 m: straights, bends, S-bends, chicanes, bends that tighten, and at least
one hairpin of 9.5 to 14 m radius; or, of 60 to 400 m, a hairpin with one other piece or none. A
road may cross itself; what is driven is where the car is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np

from lpvmpc.road import segments
from lpvmpc.road.catalogue import Road
from lpvmpc.road.segments import Segment, bend, line

KINDS = ("random", "hairpin")
"""What such roads are called, the short ones by their hairpin."""
NAME = re.compile(rf"({'|'.join(KINDS)})-(0|[1-9]\d{{0,8}})")
"""Name of one; the number is the seed."""
SHARPEST = (9.5, 14.0)
"""Radii of hairpins [m]: a car of this package turns no tighter than about 5 m."""
HALF_WIDTH = (3.0, 5.0)
"""Range of the half width [m]: a car 1 m beside the line is on the road."""
PIECES = (1, 4)
"""Pieces besides the hairpin, at least and at most."""


def by_name(name: str) -> Road | None:
    """A random road by its name; None where the name is another's."""
    found = NAME.fullmatch(name)
    if found is None:
        return None
    return (random_road if found[1] == "random" else hairpin_road)(int(found[2]))


def random_road(number: int) -> Road:
    """A road by its number, 0 to 999,999,999."""
    rng = np.random.default_rng([number, 0x70AD])
    kinds: list[Callable[[np.random.Generator], list[Segment]]] = [hairpin]
    for _ in range(int(rng.integers(PIECES[0], PIECES[1] + 1))):
        kinds.append(OTHERS[int(rng.integers(len(OTHERS)))])
    pieces = line(float(rng.uniform(30.0, 60.0)))
    for i in rng.permutation(len(kinds)):
        pieces += kinds[i](rng)
        if rng.random() < 0.7:
            pieces += line(float(rng.uniform(5.0, 60.0)))
    pieces += line(30.0)
    path = segments.from_segments(pieces, width=float(rng.uniform(*HALF_WIDTH)))
    return Road(path=path, source=f"Random road number {number}.")


def hairpin_road(number: int) -> Road:
    """A short one by its number: a hairpin, in one of four before or behind another piece."""
    rng = np.random.default_rng([number, 0x4A12])
    kinds: list[Callable[[np.random.Generator], list[Segment]]] = [hairpin]
    if rng.random() < 0.25:
        kinds.insert(int(rng.integers(2)), OTHERS[int(rng.integers(len(OTHERS)))])
    pieces = line(float(rng.uniform(15.0, 45.0)))
    for kind in kinds:
        pieces += kind(rng)
    pieces += line(15.0)
    path = segments.from_segments(pieces, width=float(rng.uniform(*HALF_WIDTH)))
    return Road(path=path, source=f"Random hairpin number {number}.")


def hairpin(rng: np.random.Generator) -> list[Segment]:
    """A turn of 150 to 200 degrees."""
    radius = float(rng.uniform(*SHARPEST))
    return _bend(rng, float(rng.uniform(150.0, 200.0)), [radius], (1.0, 1.6))


def single(rng: np.random.Generator) -> list[Segment]:
    """A bend of 20 to 120 degrees and 15 to 80 m."""
    return _bend(rng, float(rng.uniform(20.0, 120.0)), [_radius(rng, 15.0, 80.0)], (0.3, 0.8))


def sweeper(rng: np.random.Generator) -> list[Segment]:
    """A fast bend of 15 to 60 degrees and 80 to 250 m."""
    return _bend(rng, float(rng.uniform(15.0, 60.0)), [_radius(rng, 80.0, 250.0)], (0.1, 0.4))


def tightening(rng: np.random.Generator) -> list[Segment]:
    """A bend whose second half is tighter, or wider."""
    radii = [_radius(rng, 15.0, 40.0), _radius(rng, 30.0, 60.0)]
    if rng.random() < 0.5:
        radii.reverse()
    return _bend(rng, float(rng.uniform(80.0, 150.0)), radii, (0.3, 0.5))


def esses(rng: np.random.Generator) -> list[Segment]:
    """Two bends that follow each other, one to each side."""
    sign = _sign(rng)
    return [
        *_bend(rng, float(rng.uniform(30.0, 90.0)), [_radius(rng, 18.0, 60.0)], (0.3, 0.5), sign),
        *_bend(rng, float(rng.uniform(30.0, 90.0)), [_radius(rng, 18.0, 60.0)], (0.3, 0.5), -sign),
    ]


def chicane(rng: np.random.Generator) -> list[Segment]:
    """To one side, twice as far to the other, and back."""
    sign, radius = _sign(rng), _radius(rng, 15.0, 30.0)
    degrees, part = float(rng.uniform(25.0, 50.0)), (0.25, 0.4)
    return [
        *_bend(rng, degrees, [radius], part, sign),
        *_bend(rng, 2.0 * degrees, [radius], part, -sign),
        *_bend(rng, degrees, [radius], part, sign),
    ]


OTHERS = (single, single, esses, chicane, tightening, sweeper)
"""What a road may have besides, the plain bend twice as often."""


def _bend(
    rng: np.random.Generator, degrees: float, radii: list[float], share: tuple[float, float],
    sign: float | None = None,
) -> list[Segment]:
    """A bend whose transitions are as long as a share of their radius, if it turns as far."""
    share_drawn = float(rng.uniform(*share))
    ends = [radii[0], *(0.5 * (a + b) for a, b in zip(radii[:-1], radii[1:], strict=True)),
            radii[-1]]
    curvatures = [0.0, *(1.0 / radius for radius in radii), 0.0]
    turns = sum(
        0.5 * share_drawn * end * (a + b)
        for end, a, b in zip(ends, curvatures[:-1], curvatures[1:], strict=True)
    )
    most = 0.9 * math.radians(degrees) / turns
    transitions = [min(most, 1.0) * share_drawn * end for end in ends]
    side = _sign(rng) if sign is None else sign
    return bend(side * degrees, radii, transitions, [1.0] * len(radii))


def _radius(rng: np.random.Generator, low: float, high: float) -> float:
    """A radius [m] whose logarithm is uniform: tight ones are as frequent as wide ones."""
    return float(math.exp(rng.uniform(math.log(low), math.log(high))))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0
