"""What is behind and below the subject: a roll of paper without a horizon, and the shadow that falls on it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from vitruvian.show.camera import Camera
from vitruvian.show.shade import Studio, to_linear
from vitruvian.show.trace import Single, Tracer, tile

CELLS = 144  # of the floor's shadow, along each side


def shadow(
    solid: Tracer, vertices: Single, camera: Camera, size: tuple[int, int], studio: Studio, heading: float,
    level: float, reach: float,
) -> Single:  # fmt: skip
    """How much light is left on the floor at each pixel, (height * width,) in 0..1: contact and key shadow.

    Traced on a grid round the subject and read between its cells. level: the height of the floor; reach:
    size of the subject.
    """
    width, height = size
    dark = np.ones(height * width, np.float32)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    tall = high[1] - low[1]
    eye = np.asarray(camera.eye, np.float32)
    if eye[1] < level + 1e-4 * reach or low[1] > level + 0.5 * tall + 0.3 * reach:
        return dark
    rays = camera.through(None, (0.5, 0.5), size)
    seen = np.flatnonzero(rays[:, 1] < -1e-5)
    t = (level - eye[1]) / rays[seen, 1]
    middle = (low[[0, 2]] + high[[0, 2]]) / 2
    half = 0.5 * max(float(high[0] - low[0]), float(high[2] - low[2])) + 0.75 * tall
    where = np.stack([eye[0] + rays[seen, 0] * t, eye[2] + rays[seen, 2] * t]) - middle[:, None]
    inside = np.flatnonzero((np.abs(where) < half).all(axis=0))
    if not inside.size:
        return dark
    grid = (np.arange(CELLS, dtype=np.float32) + 0.5) / CELLS * 2 - 1
    gx, gz = np.meshgrid(grid * half + middle[0], grid * half + middle[1])
    points = np.stack([gx, np.full_like(gx, level + 2e-4 * reach), gz], -1).reshape(-1, 3)
    up = np.broadcast_to(np.array([0, 1, 0], np.float32), points.shape)
    row = tile(np.arange(len(points)), CELLS)
    sky = solid.ambient(points, up, row, 6).reshape(CELLS, CELLS)
    lit = solid.light(points, studio.key.towards(heading), studio.key.radius, row, 6).reshape(CELLS, CELLS)
    from scipy.ndimage import gaussian_filter, map_coordinates, uniform_filter

    sky, lit = uniform_filter(sky, 4, mode="nearest"), uniform_filter(lit, 4, mode="nearest")
    # what is far from any contact is faint and noisy: read it from a much smoother map
    wide = gaussian_filter(sky, 4.0, mode="nearest")
    near = np.clip((0.9 - wide) / 0.15, 0, 1)
    sky = wide + (sky - wide) * near
    lit = gaussian_filter(lit, 1.2, mode="nearest")
    fade = np.clip((0.98 - np.hypot(*np.meshgrid(grid, grid))) / 0.5, 0, 1)
    fade = fade * fade * (3 - 2 * fade)
    left = 1 - fade * (1 - (0.30 + 0.70 * sky**1.6) * (0.66 + 0.34 * lit))
    at = (where[:, inside] / half + 1) / 2 * CELLS - 0.5
    dark[seen[inside]] = map_coordinates(left, at[::-1], order=1, mode="nearest")
    return dark


@lru_cache(4)
def paper(size: tuple[int, int], studio: Studio) -> Single:
    """The roll of paper: bright behind the subject, darker towards the edges, linear (height * width, 3)."""
    width, height = size
    x = (np.arange(width, dtype=np.float32) + 0.5) / width * 2 - 1
    y = (np.arange(height, dtype=np.float32) + 0.5) / height * 2 - 1
    r = np.sqrt((x * 0.75) ** 2 + ((y[:, None] + 0.15) * 0.8) ** 2)
    t = np.clip(r / 1.15, 0, 1)
    t = (t * t * (3 - 2 * t)).reshape(-1, 1)
    center, edge = np.asarray(studio.center, np.float32), np.asarray(studio.edge, np.float32)
    return to_linear(center + (edge - center) * t)


@lru_cache(4)
def dither(width: int, height: int) -> Single:
    """Noise of half a level, the same every time, that keeps the soft backdrop from banding."""
    x, y = np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32)[:, None]
    noise = (52.9829189 * ((0.06711056 * x + 0.00583715 * y) % 1)) % 1  # Jimenez's interleaved gradient noise
    return (noise - 0.5).reshape(-1)
