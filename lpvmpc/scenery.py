"""The world around the car in a video: road, meadow, trees, posts and sky, built from a path.

The scene of models/scene.xml is compiled once more with the road of the scenario, for pictures
only: the plant never sees it. Its make is chosen for llvmpipe, OpenGL without a GPU. The road is a
textured strip that stays sharp at any length, since its texture repeats; mipmaps smooth its lines,
so that multi-sampling (2.5 times the time) can stay off. A dome is the sky and four triangles are
the meadow: a sky box and MuJoCo's endless plane took 18 and 9 ms more of a frame. Soft rings stand
in for a shadow map, which doubles the time.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any

import cv2
import mujoco
import numpy as np
import numpy.typing as npt

from lpvmpc.errors import ModelError

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

TILE = 60.0
"""Length of road per mesh [m]; far tiles are not drawn."""
PERIOD = 12.0
"""Length of road that the road texture shows [m]: a dash of 4 m, a gap of 8 m."""
VERGE = 0.6
"""Gravel beside the paved width [m]."""
HIDDEN = 5
"""Geom group of what is out of sight."""

ASPHALT, LINE, GRAVEL = (92, 94, 97), (232, 232, 226), (126, 122, 100)
HAZE = np.array((214, 229, 240))
MEADOW = 48.0
"""Period of the meadow's texture [m]."""
SKY_LOW = -0.06
"""Elevation of the lower edge of the sky [rad]; the meadow hides it."""
SKY_RADIUS = 1000.0
POST_SPACING = 25.0
TREE_SPACING = 7.0


@dataclass(frozen=True)
class Scenery:
    """A model for rendering, and where its tiles are."""

    model: mujoco.MjModel
    tiles: list[int]
    """Geoms of the tiles: road, and what stands beside it."""
    centres: Array
    """Centre of each tile [m], shape (tiles, 2)."""

    def place(self, data: mujoco.MjData, x: float, y: float, psi: float, sight: float) -> None:
        """Take sky, meadow and shadow to the car, and show the tiles within `sight` [m] of it."""
        data.mocap_pos[:, :2] = x, y  # bodies "shadow", "meadow" and "sky"
        data.mocap_pos[1, :2] = MEADOW * np.round((x / MEADOW, y / MEADOW))  # its texture stays
        data.mocap_quat[0] = np.cos(0.5 * psi), 0.0, 0.0, np.sin(0.5 * psi)
        near = np.hypot(self.centres[:, 0] - x, self.centres[:, 1] - y) < sight + TILE
        self.model.geom_group[self.tiles] = np.where(near, 0, HIDDEN)


def scene_file() -> FilePath:
    """The packaged models/scene.xml, in the wheel or beside the package in a checkout."""
    spec = importlib.util.find_spec("lpvmpc")
    if spec is None or not spec.submodule_search_locations:
        raise ModelError("The package lpvmpc is not installed.")
    package = FilePath(next(iter(spec.submodule_search_locations)))
    for folder in (package / "models", package.parent / "models"):
        if (folder / "scene.xml").is_file():
            return folder / "scene.xml"
    raise ModelError(f"models/scene.xml is missing beside {str(package)!r}.")


def build(path: Any, *, width: int, height: int, samples: int = 0) -> Scenery:
    """Compile the scene with the road of a path.

    Args:
        path: Path with grid arrays s, x, y, psi and the road's half widths.
        width: Width of the pictures [px].
        height: Height of the pictures [px].
        samples: Multi-samples per pixel; costly without a GPU.

    Returns:
        The model and its tiles. `nq` and the order of qpos are those of the vehicle.

    Raises:
        ModelError: The scene cannot be read or compiled.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(scene_file()))
        spec.visual.global_.offwidth = width
        spec.visual.global_.offheight = height
        spec.visual.quality.offsamples = samples
        rng = np.random.default_rng(0)
        _material(spec, "paved", road_image(rng))
        _material(spec, "plants", palette_image())
        spec.geom("ground").group = HIDDEN
        tiles = _road(spec, path) + _roadside(spec, path, rng)
        _shadow(spec)
        # What fills the picture comes last: where something stands before it, it costs nothing.
        _meadow(spec, rng)
        _sky(spec, rng)
        model = spec.compile()
    except (ValueError, KeyError) as error:
        raise ModelError(f"The scene cannot be compiled: {error}.") from error
    numbers = [int(model.geom(name).id) for name, _ in tiles]
    return Scenery(model, numbers, np.array([centre for _, centre in tiles]))


def _road(spec: mujoco.MjSpec, path: Any) -> list[tuple[str, Array]]:
    """Strips of road that follow the path, as (geom name, centre)."""
    n = max(int(np.ceil(path.length)), 2)
    s = np.linspace(0.0, path.length, n + 1)
    if not path.closed:  # some road before the start and beyond the end
        s = np.concatenate([np.arange(-60.0, 0.0), s, path.length + np.arange(1.0, 121.0)])
    x, y, psi, _ = path.at(s)
    inside = np.clip(s, 0.0, path.length)
    left = np.interp(inside, path.s, path.width_left)
    right = np.interp(inside, path.s, path.width_right)
    scale = round(path.length / PERIOD) / path.length if path.closed else 1.0 / PERIOD
    # across: gravel and edge line keep their width, the asphalt between them is stretched
    edge, centre = VERGE + 0.5, 0.2
    across = np.stack([-right - VERGE, -right + 0.5, 0.0 * s - centre, 0.0 * s + centre,
                       left - 0.5, left + VERGE], axis=1)  # (n, 6)
    u = np.array([0.0, edge / 8.0, 0.5 - centre / 8.0, 0.5 + centre / 8.0, 1.0 - edge / 8.0, 1.0])
    px = x[:, None] - across * np.sin(psi)[:, None]
    py = y[:, None] + across * np.cos(psi)[:, None]
    fresh = _not_repeated(x, y, psi, s)
    step = int(TILE)
    tiles = []
    for number, first in enumerate(range(0, s.size - 1, step)):
        rows = np.arange(first, min(first + step, s.size - 1) + 1)
        keep = fresh[rows[:-1]]
        if not keep.any():
            continue
        # A later stretch lies a little higher, so that crossings do not flicker.
        z = np.full((rows.size, 6), -0.03 + 0.03 * first / s.size)
        vertices = np.stack([px[rows], py[rows], z], axis=-1).reshape(-1, 3)
        uv = np.stack(np.broadcast_arrays(u[None, :], (s[rows] * scale)[:, None]), axis=-1)
        corner = (6 * np.arange(rows.size - 1)[keep][:, None] + np.arange(5)).ravel()
        faces = np.concatenate([np.stack([corner, corner + 1, corner + 6], 1),
                                np.stack([corner + 1, corner + 7, corner + 6], 1)])
        faces = faces[:, ::-1]  # counter-clockwise seen from above
        name = f"road_{number}"
        _mesh_geom(spec, name, vertices, faces, uv.reshape(-1, 2), "paved")
        tiles.append((name, vertices[:, :2].mean(axis=0)))
    return tiles


def _not_repeated(x: Array, y: Array, psi: Array, s: Array) -> npt.NDArray[np.bool_]:
    """Which samples are not on road that was already laid (second laps), shape (n,)."""
    fresh = np.ones(s.size, dtype=bool)
    seen: dict[tuple[int, int], list[int]] = {}
    for i in range(s.size):
        cell = (int(x[i] // 2.0), int(y[i] // 2.0))
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                for j in seen.get((cell[0] + dx, cell[1] + dy), ()):
                    if (s[i] - s[j] > 10.0 and np.hypot(x[i] - x[j], y[i] - y[j]) < 0.8
                            and np.cos(psi[i] - psi[j]) > 0.95):
                        fresh[i] = False
        if fresh[i]:
            seen.setdefault(cell, []).append(i)
    return fresh


def _roadside(spec: mujoco.MjSpec, path: Any, rng: np.random.Generator) -> list[tuple[str, Array]]:
    """Trees and posts along the path, merged into one mesh per tile."""
    every = np.arange(0.0, path.length, 2.0)
    x, y, _, _ = path.at(every)
    road = np.stack([x, y], axis=1)
    half = float(max(path.width_left.max(), path.width_right.max()))
    tiles = []
    for number, start in enumerate(np.arange(-TILE, path.length + 2 * TILE, TILE)):
        if path.closed and not 0.0 <= start < path.length:
            continue
        parts: list[tuple[Array, npt.NDArray[np.int64], Array]] = []
        for s in np.arange(start, min(start + TILE, path.length + 2 * TILE), POST_SPACING):
            for side in (-1.0, 1.0):
                place = _beside(path, float(s), side * (half + VERGE + 0.5))
                if _distance(road, place) > half + 0.5:
                    parts.append(_at(_post(), place, 0.0, 1.0))
        for _ in range(int(2 * TILE / TREE_SPACING)):
            offset = (half + 5.0 + 45.0 * rng.random() ** 1.6) * rng.choice((-1.0, 1.0))
            place = _beside(path, start + TILE * rng.random(), offset)
            angle, size, kind = rng.uniform(0, 6.28), rng.uniform(0.75, 1.35), rng.random()
            tree = _conifer(rng) if kind < 0.35 else _broadleaf(rng, kind > 0.85)
            if _distance(road, place) > half + 3.5:
                parts.append(_at(tree, place, angle, size))
        if not parts:
            continue
        name = f"roadside_{number}"
        vertices, faces, uv = _merge(parts)
        _mesh_geom(spec, name, vertices, faces, uv, "plants")
        tiles.append((name, vertices[:, :2].mean(axis=0)))
    return tiles


def _shadow(spec: mujoco.MjSpec) -> None:
    """Soft shadow under the car: rings of falling darkness around a rounded rectangle.

    A shadow map would double the time of a picture, and textures have no transparency.
    """
    body = spec.worldbody.add_body(name="shadow", mocap=True, pos=(0.0, 0.0, 0.012))
    angle = np.linspace(0.0, 2.0 * np.pi, 41)
    corner = np.stack([np.sign(np.cos(angle)) * 1.75 - 0.2, np.sign(np.sin(angle)) * 0.55], axis=1)
    round_ = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edges = np.linspace(0.0, 0.62, 9)
    rings = [np.column_stack([corner + edge * round_, np.zeros(41)]) for edge in edges]
    rings.insert(0, np.tile((-0.2, 0.0, 0.0), (41, 1)))
    k = np.arange(40)
    faces = np.concatenate([np.stack([k, k + 41, k + 42], 1), np.stack([k, k + 42, k + 1], 1)])
    for number, (inner, outer) in enumerate(zip(rings[:-1], rings[1:], strict=True)):
        dark = 0.62 * (1.0 - number / 9.0) ** 1.5
        outline = np.concatenate([inner, outer])
        part = faces[:40] if number == 0 else faces
        _mesh_geom(spec, f"shadow_{number}", outline, part, np.zeros((82, 2)), "", body=body)
        spec.geom(f"shadow_{number}").rgba = (0.0, 0.0, 0.0, dark)


def _beside(path: Any, s: float, offset: float) -> Array:
    """Point at a signed lateral offset from the path [m], shape (2,)."""
    x, y, psi, _ = path.at(s)
    return np.array([x - offset * np.sin(psi), y + offset * np.cos(psi)])


def _distance(road: Array, place: Array) -> float:
    """Distance of a place from the nearest point of the road [m]."""
    return float(np.sqrt(((road - place) ** 2).sum(axis=1).min()))


Part = tuple[Array, npt.NDArray[np.int64], Array]
"""Vertices (n, 3), faces (m, 3), texture coordinates (n, 2)."""

TRUNK, WHITE, BLACK, RED = 0.02, 0.07, 0.12, 0.17
"""Places of plain colours on the palette; the greens follow."""


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


def _post() -> Part:
    """White delineator post with a black band."""
    profile = [(0.07, 0.0), (0.07, 0.70), (0.072, 0.70), (0.072, 0.88), (0.06, 0.88), (0.06, 1.0),
               (0.001, 1.02)]
    colours = [WHITE, WHITE, BLACK, BLACK, WHITE, WHITE, WHITE]
    return _lathe(profile, 5, colours, [0.5] * 7)


def _green(rng: np.random.Generator, autumn: bool = False) -> float:
    """Place of a leaf colour on the palette."""
    return 0.95 if autumn else float(rng.uniform(0.27, 0.88))


def _conifer(rng: np.random.Generator) -> Part:
    """Spruce of three stacked cones."""
    g = _green(rng)
    trunk = _lathe([(0.22, -0.1), (0.16, 1.4)], 5, [TRUNK] * 2, [0.3, 0.3])
    cones = [_lathe([(r, z), (0.02, z + h)], 8, [g, g], [0.10 + 0.2 * i, 0.75])
             for i, (r, z, h) in enumerate([(1.9, 1.0, 3.2), (1.5, 2.9, 2.7), (1.05, 4.6, 2.5)])]
    return _merge([trunk, *cones])


def _broadleaf(rng: np.random.Generator, autumn: bool) -> Part:
    """Round tree: a trunk and a lumpy crown, darker below."""
    g = _green(rng, autumn)
    trunk = _lathe([(0.24, -0.1), (0.17, 2.4)], 5, [TRUNK] * 2, [0.3, 0.5])
    profile = [(0.5, 1.9), (1.7, 2.5), (2.15, 3.6), (1.85, 4.8), (1.05, 5.7), (0.05, 6.0)]
    crown, faces, uv = _lathe(profile, 8, [g] * 6, [0.05, 0.2, 0.42, 0.65, 0.85, 0.95])
    crown[:-8] += rng.normal(0.0, 0.16, (len(crown) - 8, 3))
    return _merge([trunk, (crown, faces, uv)])


def _at(part: Part, place: Array, angle: float, size: float) -> Part:
    """A part turned, scaled and put at a place on the ground."""
    vertices, faces, uv = part
    c, s = size * np.cos(angle), size * np.sin(angle)
    x = c * vertices[:, 0] - s * vertices[:, 1] + place[0]
    y = s * vertices[:, 0] + c * vertices[:, 1] + place[1]
    return np.stack([x, y, size * vertices[:, 2]], axis=1), faces, uv


def _merge(parts: list[Part]) -> Part:
    """Several parts as one."""
    first = np.cumsum([0] + [len(v) for v, _, _ in parts[:-1]])
    return (np.concatenate([v for v, _, _ in parts]),
            np.concatenate([f + k for (_, f, _), k in zip(parts, first, strict=True)]),
            np.concatenate([t for _, _, t in parts]))


def _mesh_geom(spec: mujoco.MjSpec, name: str, vertices: Array, faces: Any, uv: Array,
               material: str, normals: Array | None = None, body: Any = None) -> None:
    """Add a mesh that is only looked at, to the world or to a body."""
    mesh = spec.add_mesh(name=name, uservert=vertices.ravel(), userface=np.ravel(faces),
                         usertexcoord=uv.ravel(),
                         inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
    if normals is not None:
        mesh.usernormal = normals.ravel()
    (body or spec.worldbody).add_geom(
        name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=material, contype=0,
        conaffinity=0, group=0)


def _texture(spec: mujoco.MjSpec, name: str, image: Image, kind: Any) -> None:
    """Add an image (height, width, 3) as texture."""
    texture = spec.add_texture(name=name, type=kind, width=image.shape[1], height=image.shape[0],
                               nchannel=image.shape[2])
    texture.data = image.tobytes()


def _material(spec: mujoco.MjSpec, name: str, image: Image, repeat: float | None = None) -> None:
    """Add a matt material that shows an image; `repeat` per metre, else once."""
    _texture(spec, name, image, mujoco.mjtTexture.mjTEXTURE_2D)
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, reflectance=0.0)
    if repeat is not None:
        material.texuniform, material.texrepeat = True, (repeat, repeat)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def _noise(rng: np.random.Generator, size: tuple[int, int], slope: float) -> Array:
    """Noise that repeats without a seam, amplitude falling as frequency^-slope, unit variance."""
    fy = np.fft.fftfreq(size[0])[:, None] * size[0]
    fx = np.fft.rfftfreq(size[1])[None, :] * size[1]
    amplitude = 1.0 / np.maximum(np.hypot(fx, fy), 1.0) ** slope
    phase = np.exp(2j * np.pi * rng.random(amplitude.shape))
    noise = np.fft.irfft2(amplitude * phase, s=size)
    noise -= noise.mean()
    return noise / noise.std()


def meadow_image(rng: np.random.Generator, size: int = 1024) -> Image:
    """Grass: broad patches, fine blades, shape (size, size, 3)."""
    patches, blades = _noise(rng, (size, size), 1.4), _noise(rng, (size, size), 0.35)
    mix = np.clip(0.5 + 0.20 * patches, 0.0, 1.0)[..., None]
    colour = (1.0 - mix) * np.array((88, 122, 60)) + mix * np.array((124, 150, 78))
    return np.clip(colour * (1.0 + 0.10 * blades[..., None]), 0, 255).astype(np.uint8)


def road_image(rng: np.random.Generator, across: int = 1024, along: int = 256) -> Image:
    """One period of road, gravel to gravel over 8 m by `PERIOD`, shape (along, across, 3).

    Fewer pixels along than across, so that lines stay sharp when the road is seen at a flat angle.
    """
    u = (np.arange(across) + 0.5) / across * 8.0  # m from the right verge
    v = (np.arange(along) + 0.5) / along * PERIOD
    grain = _noise(rng, (along, across), 0.3)[..., None]
    patch = _noise(rng, (along, across), 1.2)[..., None]
    colour = np.array(ASPHALT) * (1.0 + 0.05 * grain + 0.025 * patch)
    tracks = np.exp(-((np.abs(u - 4.0) - 0.76) / 0.28) ** 2)[None, :, None]
    colour = colour * (1.0 - 0.07 * tracks)  # polished by wheels
    gravel = np.array(GRAVEL) * (1.0 + 0.14 * grain)
    grass = np.clip((0.30 - np.minimum(u, 8.0 - u)) / 0.3, 0.0, 1.0)[None, :, None]
    gravel = (1.0 - grass) * gravel + grass * np.array((104, 134, 68)) * (1.0 + 0.08 * grain)
    beside = np.minimum(u, 8.0 - u)[None, :, None]
    colour = np.where(beside < VERGE + 0.06 * grain * 0.3, gravel, colour)
    wear = 1.0 + 0.03 * grain
    line = np.abs(beside - (VERGE + 0.25)) < 0.075
    dash = (np.abs(u - 4.0)[None, :, None] < 0.07) & (v[:, None, None] < 4.0)
    colour = np.where(line | dash, np.array(LINE) * wear, colour)
    return np.clip(colour, 0, 255).astype(np.uint8)


def palette_image(width: int = 512, height: int = 64) -> Image:
    """Colours of trees and posts: place along the width, darker to lighter along the height."""
    u = (np.arange(width) + 0.5) / width
    shade = np.linspace(0.62, 1.12, height)[:, None, None]
    leaf = np.clip((u - 0.25) / 0.65, 0.0, 1.0)[:, None]
    colour = (1.0 - leaf) * np.array((52, 92, 48)) + leaf * np.array((112, 140, 58))
    for place, plain in ((TRUNK, (96, 74, 54)), (WHITE, (236, 236, 232)), (BLACK, (30, 30, 32)),
                         (RED, (196, 60, 40))):
        colour[np.abs(u - place) < 0.026] = plain
    colour[u > 0.91] = (186, 146, 66)  # autumn
    image = np.clip(colour[None] * shade, 0, 255)
    return image.astype(np.uint8)


def sky_image(rng: np.random.Generator, width: int = 4096, height: int = 384) -> Image:
    """Panorama of sky, clouds and hills; row 0 is `SKY_LOW`, the last is the zenith.

    Rows are spaced by the square root of the elevation, so that the horizon is the sharpest.
    """
    noise = _noise(rng, (512, 512), 1.35).astype(np.float32)
    hill = _noise(rng, (1, width), 1.3)[0]
    elevation = _elevation((np.arange(height) + 0.5) / height)[:, None]
    turn = 2.0 * np.pi * (np.arange(width) + 0.5) / width
    z = np.sin(elevation) * np.ones(width)
    blue = np.clip(z, 0.0, 1.0)[..., None] ** 0.55
    colour = (1.0 - blue) * HAZE + blue * np.array((78, 134, 204))
    reach = 130.0 / np.tan(np.maximum(elevation, 0.03))  # a flat layer of clouds
    cloud = cv2.remap(noise, (reach * np.cos(turn) % 512.0).astype(np.float32),
                      (reach * np.sin(turn) % 512.0).astype(np.float32), cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_WRAP)
    cover = np.clip(0.9 * (cloud - 0.2), 0.0, 0.85) * np.clip((z - 0.04) / 0.16, 0.0, 1.0)
    colour += cover[..., None] * (np.array((250, 251, 252)) - colour)
    for top, roll, green in ((0.040, 0, (166, 189, 196)), (0.022, width // 3, (134, 163, 146))):
        edge = top * (1.0 + 0.33 * np.roll(hill, roll))
        colour += np.clip((edge - z) * 400.0 + 0.5, 0.0, 1.0)[..., None] * (green - colour)
    return np.clip(colour, 0, 255).astype(np.uint8)


def _elevation(v: Any) -> Any:
    """Elevation [rad] at height v = 0..1 of the sky's picture."""
    return SKY_LOW + (0.5 * np.pi - SKY_LOW) * np.square(v)


def _meadow(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Four big triangles around the car; MuJoCo's endless plane takes longer."""
    _material(spec, "meadow", meadow_image(rng))
    reach = 25.0 * MEADOW
    corners = reach * np.array(((0, 0, 0), (-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)), float)
    faces = np.array(((0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 1)))
    uv = corners[:, :2] / MEADOW
    _mesh_geom(spec, "meadow", corners, faces, uv, "meadow",
               body=spec.worldbody.add_body(name="meadow", mocap=True, pos=(0.0, 0.0, -0.06)))


def _sky(spec: mujoco.MjSpec, rng: np.random.Generator) -> None:
    """Dome around the car. A sky box would be drawn behind the ground too."""
    _material(spec, "dome", sky_image(rng))
    # All normals point down, away from sun and camera: what is left is ambient plus emission = 1.
    spec.material("dome").emission = 1.0 - float(np.mean(spec.visual.headlight.ambient))
    v, u = np.meshgrid(np.linspace(0.0, 1.0, 13), np.linspace(0.0, 1.0, 49), indexing="ij")
    e, turn = _elevation(v), 2.0 * np.pi * u
    vertices = SKY_RADIUS * np.stack(
        [np.cos(e) * np.cos(turn), np.cos(e) * np.sin(turn), np.sin(e)], axis=-1)
    corner = (49 * np.arange(12)[:, None] + np.arange(48)).ravel()
    faces = np.concatenate([np.stack([corner, corner + 49, corner + 1], 1),
                            np.stack([corner + 1, corner + 49, corner + 50], 1)])
    uv = np.stack([u, v], axis=-1)
    normals = np.tile((0.0, 0.0, -1.0), (vertices.size // 3, 1))
    _mesh_geom(spec, "dome", vertices.reshape(-1, 3), faces, uv.reshape(-1, 2), "dome", normals,
               spec.worldbody.add_body(name="sky", mocap=True))
