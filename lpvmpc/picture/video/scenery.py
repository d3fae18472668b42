"""The world around the car in a video: road, meadow, trees, posts and sky, built from a path.

The scene of models/scene.xml is compiled once more with the road of the scenario, for pictures
only: the plant never sees it. Its make is chosen for llvmpipe, OpenGL without a GPU. The road is a
textured strip that stays sharp at any length, since its texture repeats; mipmaps smooth its lines,
so that multi-sampling (2.5 times the time) can stay off. A dome is the sky and four triangles are
the meadow: a sky box and MuJoCo's endless plane took 18 and 9 ms more of a frame. Soft rings stand
in for a shadow map, which doubles the time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from lpvmpc.errors import ModelError
from lpvmpc.picture.video import props
from lpvmpc.picture.video.textures import (
    PERIOD,
    VERGE,
    meadow_image,
    palette_image,
    road_image,
    sky_elevation,
    sky_image,
)
from lpvmpc.plant.mjcf import model_path
from lpvmpc.units import Array

Image = npt.NDArray[np.uint8]

TILE = 60.0
"""Length of road per mesh [m]; far tiles are not drawn."""
HIDDEN = 5
"""Geom group of what is out of sight."""

MEADOW = 48.0
"""Period of the meadow's texture [m]."""
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


def build(path: Any, *, width: int, height: int, samples: int = 0,
          cones: Array | None = None) -> Scenery:
    """Compile the scene with the road of a path.

    Args:
        path: Path with grid arrays s, x, y, psi and the road's half widths.
        width: Width of the pictures [px].
        height: Height of the pictures [px].
        samples: Multi-samples per pixel; costly without a GPU.
        cones: Where cones stand [m], shape (n, 2).

    Returns:
        The model and its tiles. `nq` and the order of qpos are those of the vehicle.

    Raises:
        ModelError: The scene cannot be read or compiled.
    """
    try:
        spec = mujoco.MjSpec.from_file(str(model_path("scene.xml")))
        spec.visual.global_.offwidth = width
        spec.visual.global_.offheight = height
        spec.visual.quality.offsamples = samples
        rng = np.random.default_rng(0)
        _material(spec, "paved", road_image(rng))
        _material(spec, "plants", palette_image())
        spec.geom("ground").group = HIDDEN
        tiles = _road(spec, path) + _roadside(spec, path, rng)
        if cones is not None and len(cones):
            parts = [props.at(props.cone(), place, 0.0, 1.0) for place in cones]
            _mesh_geom(spec, "cones", *props.merge(parts), "plants")
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
        parts: list[props.Part] = []
        for s in np.arange(start, min(start + TILE, path.length + 2 * TILE), POST_SPACING):
            for side in (-1.0, 1.0):
                place = _beside(path, float(s), side * (half + VERGE + 0.5))
                if _distance(road, place) > half + 0.5:
                    parts.append(props.at(props.post(), place, 0.0, 1.0))
        for _ in range(int(2 * TILE / TREE_SPACING)):
            offset = (half + 5.0 + 45.0 * rng.random() ** 1.6) * rng.choice((-1.0, 1.0))
            place = _beside(path, start + TILE * rng.random(), offset)
            angle, size, kind = rng.uniform(0, 6.28), rng.uniform(0.75, 1.35), rng.random()
            tree = props.conifer(rng) if kind < 0.35 else props.broadleaf(rng, kind > 0.85)
            if _distance(road, place) > half + 3.5:
                parts.append(props.at(tree, place, angle, size))
        if not parts:
            continue
        name = f"roadside_{number}"
        vertices, faces, uv = props.merge(parts)
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


def _material(spec: mujoco.MjSpec, name: str, image: Image) -> None:
    """Add a matt material that shows an image, shape (height, width, 3)."""
    texture = spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, nchannel=3,
                               height=image.shape[0], width=image.shape[1])
    texture.data = image.tobytes()
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, reflectance=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


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
    e, turn = sky_elevation(v), 2.0 * np.pi * u
    vertices = SKY_RADIUS * np.stack(
        [np.cos(e) * np.cos(turn), np.cos(e) * np.sin(turn), np.sin(e)], axis=-1)
    corner = (49 * np.arange(12)[:, None] + np.arange(48)).ravel()
    faces = np.concatenate([np.stack([corner, corner + 49, corner + 1], 1),
                            np.stack([corner + 1, corner + 49, corner + 50], 1)])
    uv = np.stack([u, v], axis=-1)
    normals = np.tile((0.0, 0.0, -1.0), (vertices.size // 3, 1))
    _mesh_geom(spec, "dome", vertices.reshape(-1, 3), faces, uv.reshape(-1, 2), "dome", normals,
               spec.worldbody.add_body(name="sky", mocap=True))
