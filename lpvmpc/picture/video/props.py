"""Shapes of trees, posts and cones: vertices, faces and colours, nothing of MuJoCo."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from lpvmpc.picture.video.textures import BLACK, ORANGE, TRUNK, WHITE
from lpvmpc.units import Array

Part = tuple[Array, npt.NDArray[np.int64], Array]
"""Vertices [m] (n, 3), faces (m, 3), places on the palette (n, 2)."""

def _ring(radius: float, z: float, count: int, phase: float = 0.0) -> Array:
    """Points on a horizontal circle, shape (count, 3)."""
    angle = 2.0 * np.pi * np.arange(count) / count + phase
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(count, z)], axis=1)


def _lathe(profile: list[tuple[float, float]], count: int, colours: list[float],
           shade: list[float]) -> Part:
    """Surface of revolution through rings (radius, z), with a palette place for each ring."""
    vertices = np.concatenate([_ring(r, z, count, 0.4 * i) for i, (r, z) in enumerate(profile)])
    faces = []
    for i in range(len(profile) - 1):
        for j in range(count):
            a, b = i * count + j, i * count + (j + 1) % count
            faces += [(a, b, b + count), (a, b + count, a + count)]
    uv = np.stack([np.repeat(colours, count), np.repeat(shade, count)], axis=1)
    return vertices, np.array(faces), uv


def post() -> Part:
    """White delineator post with a black band."""
    profile = [(0.07, 0.0), (0.07, 0.70), (0.072, 0.70), (0.072, 0.88), (0.06, 0.88), (0.06, 1.0),
               (0.001, 1.02)]
    colours = [WHITE, WHITE, BLACK, BLACK, WHITE, WHITE, WHITE]
    return _lathe(profile, 5, colours, [0.5] * 7)


def cone() -> Part:
    """Traffic cone of 0.5 m with a white band, on its square foot."""
    foot = _lathe([(0.21, 0.0), (0.21, 0.03), (0.14, 0.03)], 4, [ORANGE] * 3, [0.35] * 3)
    profile = [(0.135, 0.03), (0.10, 0.20), (0.10, 0.20), (0.065, 0.35), (0.065, 0.35),
               (0.03, 0.5), (0.001, 0.5)]
    body = _lathe(profile, 10, [ORANGE] * 2 + [WHITE] * 2 + [ORANGE] * 3, [0.8] * 7)
    return merge([foot, body])


def _green(rng: np.random.Generator, autumn: bool = False) -> float:
    """Place of a leaf colour on the palette."""
    return 0.95 if autumn else float(rng.uniform(0.27, 0.88))


def conifer(rng: np.random.Generator) -> Part:
    """Spruce of three stacked cones."""
    g = _green(rng)
    trunk = _lathe([(0.22, -0.1), (0.16, 1.4)], 5, [TRUNK] * 2, [0.3, 0.3])
    cones = [_lathe([(r, z), (0.02, z + h)], 8, [g, g], [0.10 + 0.2 * i, 0.75])
             for i, (r, z, h) in enumerate([(1.9, 1.0, 3.2), (1.5, 2.9, 2.7), (1.05, 4.6, 2.5)])]
    return merge([trunk, *cones])


def broadleaf(rng: np.random.Generator, autumn: bool) -> Part:
    """Round tree: a trunk and a lumpy crown, darker below."""
    g = _green(rng, autumn)
    trunk = _lathe([(0.24, -0.1), (0.17, 2.4)], 5, [TRUNK] * 2, [0.3, 0.5])
    profile = [(0.5, 1.9), (1.7, 2.5), (2.15, 3.6), (1.85, 4.8), (1.05, 5.7), (0.05, 6.0)]
    crown, faces, uv = _lathe(profile, 8, [g] * 6, [0.05, 0.2, 0.42, 0.65, 0.85, 0.95])
    crown[:-8] += rng.normal(0.0, 0.16, (len(crown) - 8, 3))
    return merge([trunk, (crown, faces, uv)])


def at(part: Part, place: Array, angle: float, size: float) -> Part:
    """A part turned, scaled and put at a place on the ground."""
    vertices, faces, uv = part
    c, s = size * np.cos(angle), size * np.sin(angle)
    x = c * vertices[:, 0] - s * vertices[:, 1] + place[0]
    y = s * vertices[:, 0] + c * vertices[:, 1] + place[1]
    return np.stack([x, y, size * vertices[:, 2]], axis=1), faces, uv


def merge(parts: list[Part]) -> Part:
    """Several parts as one."""
    first = np.cumsum([0] + [len(v) for v, _, _ in parts[:-1]])
    return (np.concatenate([v for v, _, _ in parts]),
            np.concatenate([f + k for (_, f, _), k in zip(parts, first, strict=True)]),
            np.concatenate([t for _, _, t in parts]))
