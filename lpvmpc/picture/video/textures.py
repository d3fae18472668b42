"""Pictures that the scenery is covered with: road, meadow, sky, and a palette for small things."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from lpvmpc.units import Array

Image = npt.NDArray[np.uint8]

PERIOD = 12.0
"""Length of road that the road texture shows [m]: a dash of 4 m, a gap of 8 m."""
VERGE = 0.6
"""Gravel beside the paved width [m]."""
SKY_LOW = -0.06
"""Elevation of the lower edge of the sky [rad]; the meadow hides it."""
ASPHALT, LINE, GRAVEL = (92, 94, 97), (232, 232, 226), (126, 122, 100)
HAZE = np.array((214, 229, 240))
TRUNK, WHITE, BLACK, ORANGE = 0.02, 0.07, 0.12, 0.18
"""Places of plain colours on the palette; the greens follow."""


def noise(rng: np.random.Generator, size: tuple[int, int], slope: float) -> Array:
    """Noise that repeats without a seam, amplitude falling as frequency^-slope, unit variance."""
    fy = np.fft.fftfreq(size[0])[:, None] * size[0]
    fx = np.fft.rfftfreq(size[1])[None, :] * size[1]
    amplitude = 1.0 / np.maximum(np.hypot(fx, fy), 1.0) ** slope
    phase = np.exp(2j * np.pi * rng.random(amplitude.shape))
    field = np.fft.irfft2(amplitude * phase, s=size)
    field -= field.mean()
    return field / field.std()


def meadow_image(rng: np.random.Generator, size: int = 1024) -> Image:
    """Grass: broad patches, fine blades, shape (size, size, 3)."""
    patches, blades = noise(rng, (size, size), 1.4), noise(rng, (size, size), 0.35)
    mix = np.clip(0.5 + 0.20 * patches, 0.0, 1.0)[..., None]
    colour = (1.0 - mix) * np.array((88, 122, 60)) + mix * np.array((124, 150, 78))
    return np.clip(colour * (1.0 + 0.10 * blades[..., None]), 0, 255).astype(np.uint8)


def road_image(rng: np.random.Generator, across: int = 1024, along: int = 256) -> Image:
    """One period of road, gravel to gravel over 8 m by `PERIOD`, shape (along, across, 3).

    Fewer pixels along than across, so that lines stay sharp when the road is seen at a flat angle.
    """
    u = (np.arange(across) + 0.5) / across * 8.0  # m from the right verge
    v = (np.arange(along) + 0.5) / along * PERIOD
    grain = noise(rng, (along, across), 0.3)[..., None]
    patch = noise(rng, (along, across), 1.2)[..., None]
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
                         (ORANGE, (255, 92, 12))):
        colour[np.abs(u - place) < 0.026] = plain
    colour[u > 0.91] = (186, 146, 66)  # autumn
    image = np.clip(colour[None] * shade, 0, 255)
    return image.astype(np.uint8)


def sky_image(rng: np.random.Generator, width: int = 4096, height: int = 384) -> Image:
    """Panorama of sky, clouds and hills; row 0 is `SKY_LOW`, the last is the zenith.

    Rows are spaced by the square root of the elevation, so that the horizon is the sharpest.
    """
    layer = noise(rng, (512, 512), 1.35).astype(np.float32)
    hill = noise(rng, (1, width), 1.3)[0]
    elevation = sky_elevation((np.arange(height) + 0.5) / height)[:, None]
    turn = 2.0 * np.pi * (np.arange(width) + 0.5) / width
    z = np.sin(elevation) * np.ones(width)
    blue = np.clip(z, 0.0, 1.0)[..., None] ** 0.55
    colour = (1.0 - blue) * HAZE + blue * np.array((78, 134, 204))
    reach = 130.0 / np.tan(np.maximum(elevation, 0.03))  # a flat layer of clouds
    cloud = cv2.remap(layer, (reach * np.cos(turn) % 512.0).astype(np.float32),
                      (reach * np.sin(turn) % 512.0).astype(np.float32), cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_WRAP)
    cover = np.clip(0.9 * (cloud - 0.2), 0.0, 0.85) * np.clip((z - 0.04) / 0.16, 0.0, 1.0)
    colour += cover[..., None] * (np.array((250, 251, 252)) - colour)
    for top, roll, green in ((0.040, 0, (166, 189, 196)), (0.022, width // 3, (134, 163, 146))):
        edge = top * (1.0 + 0.33 * np.roll(hill, roll))
        colour += np.clip((edge - z) * 400.0 + 0.5, 0.0, 1.0)[..., None] * (green - colour)
    return np.clip(colour, 0, 255).astype(np.uint8)


def sky_elevation(v: Any) -> Any:
    """Elevation [rad] at height v = 0..1 of the sky's picture."""
    return SKY_LOW + (0.5 * np.pi - SKY_LOW) * np.square(v)
