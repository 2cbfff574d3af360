"""The NumPy twin of the ray tracer: depth buffers, for the picture and for each direction that light comes from.

Slower and a little coarser in its shadows, no dependency. Same interface as `trace.Embree`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.show.camera import Camera
from vitruvian.show.trace import ROWS, Hits, Ints, Single, _turn, cosine, disc

MAP = 512  # pixels along each side of a light's depth buffer
_CHUNK = 1_500_000  # candidate pixels handled at once


def rasterise(
    xy: NDArray[np.float64],
    near: NDArray[np.float64],
    triangles: Ints,
    size: tuple[int, int],
    below: Single | None = None,
) -> tuple[NDArray[np.int64], Ints, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Which triangle is nearest at each pixel centre.

    xy (V,2) pixel positions (NaN: the triangles of that vertex are left out), near (V,) a value that is affine in the
    picture and largest for the nearest (1/depth, or the height along a light); `below` (pixels,): only smaller ones of it
    count. Returns, for the covered pixels, their
    row-major index, triangle, screen barycentrics of its second and third vertex, and the value of `near`.
    """
    width, height = size
    corner = xy[triangles]  # (T,3,2)
    with np.errstate(invalid="ignore"):
        low = np.ceil(np.nan_to_num(corner.min(axis=1), nan=1e9) - 0.5)
        high = np.floor(np.nan_to_num(corner.max(axis=1), nan=-1e9) - 0.5)
    low = np.clip(low, 0, [width, height]).astype(np.int64)
    high = np.clip(high, -1, [width - 1, height - 1]).astype(np.int64)
    span = np.maximum(high - low + 1, 0)
    counts = span[:, 0] * span[:, 1]
    edge1, edge2 = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    area = edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0]
    alive = np.flatnonzero((counts > 0) & np.isfinite(area) & (np.abs(area) > 1e-12))
    best = np.full(width * height, -np.inf)
    found: list[tuple[np.ndarray, ...]] = []
    ends = np.cumsum(counts[alive])
    start = 0
    while start < len(alive):
        stop = max(int(np.searchsorted(ends, (ends[start - 1] if start else 0) + _CHUNK)), start + 1)
        some = alive[start:stop]
        start = stop
        triangle = np.repeat(some, counts[some])
        within = np.arange(len(triangle)) - np.repeat(np.cumsum(counts[some]) - counts[some], counts[some])
        x = low[triangle, 0] + within % span[triangle, 0]
        y = low[triangle, 1] + within // span[triangle, 0]
        dx, dy = x + 0.5 - corner[triangle, 0, 0], y + 0.5 - corner[triangle, 0, 1]
        u = (dx * edge2[triangle, 1] - dy * edge2[triangle, 0]) / area[triangle]
        v = (dy * edge1[triangle, 0] - dx * edge1[triangle, 1]) / area[triangle]
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        triangle, u, v = triangle[inside], u[inside], v[inside]
        pixel = y[inside] * width + x[inside]
        n = near[triangles[triangle]]
        value = (1 - u - v) * n[:, 0] + u * n[:, 1] + v * n[:, 2]
        if below is not None:
            on = value < below[pixel]
            triangle, u, v, pixel, value = triangle[on], u[on], v[on], pixel[on], value[on]
        np.maximum.at(best, pixel, value)
        found.append((pixel, triangle, u, v, value))
    if not found:
        none = np.zeros(0)
        return np.zeros(0, np.int64), np.zeros(0, np.int32), none, none, none
    pixel, triangle, u, v, value = (np.concatenate(c) for c in zip(*found))
    won = np.flatnonzero(value == best[pixel])
    _, first = np.unique(pixel[won], return_index=True)
    won = won[first]
    return pixel[won], triangle[won].astype(np.int32), u[won], v[won], value[won]


class Raster:
    """Depth buffers in place of rays."""

    def __init__(self, vertices: Single, triangles: Ints):
        self.vertices = np.asarray(vertices, np.float64)
        self.triangles = np.asarray(triangles, np.int32)
        if len(self.vertices):
            low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
            self.middle, self.radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-6)

    def visible(
        self, camera: Camera, size: tuple[int, int], offset: tuple[float, float], beyond: Single | None = None
    ) -> Hits:
        xy, depth = camera.project(self.vertices, size)
        near = 1 / np.where(depth > 1e-9, depth, np.nan)
        shift = np.array([0.5, 0.5]) - offset
        below = None if beyond is None else 1 / (beyond * (1 + 2e-5))
        pixel, triangle, u, v, value = rasterise(xy + shift, near, self.triangles, size, below)
        n = near[self.triangles[triangle]].reshape(-1, 3)  # screen barycentrics to those of the surface
        single = [(a).astype(np.float32) for a in (u * n[:, 1] / value, v * n[:, 2] / value, 1 / value)]
        return Hits(pixel, triangle, *single)

    def ambient(self, points: Single, normals: Single, row: Ints, count: int) -> Single:
        # one map per direction, so the directions are the same for all points: the whole sphere, cosine-weighted
        sphere = cosine(2 * count)[0]
        total, open_ = np.zeros(len(points)), np.zeros(len(points))
        for side in (1.0, -1.0):
            for d in sphere * [1, 1, side]:
                d = d[[0, 2, 1]]  # about the vertical
                weight = np.maximum(normals @ d, 0) / max(abs(float(d[1])), 0.1)
                if not (weight > 0).any():
                    continue
                total += weight
                open_ += weight * self._open(points, d, MAP // 2)
        return np.where(total > 0, open_ / np.maximum(total, 1e-9), 1).astype(np.float32)

    def light(self, points: Single, direction: Single, radius: float, row: Ints, count: int) -> Single:
        local = disc(max(count // 2, 1))[::4].reshape(1, -1, 2) * radius
        towards = np.concatenate([local, np.ones_like(local[..., :1])], -1)
        axis = np.asarray(direction, np.float32)[None]
        directions = _turn(towards.astype(np.float32), axis)[0]
        return np.mean([self._open(points, d, MAP) for d in directions], axis=0).astype(np.float32)

    def _open(self, points: Single, direction: Single, size: int) -> NDArray[np.bool_]:
        """Whether nothing lies from each point towards `direction`, (n,)."""
        if not len(self.triangles):
            return np.ones(len(points), bool)
        d = np.asarray(direction, np.float64)
        d = d / np.linalg.norm(d)
        basis = _turn(np.eye(3, dtype=np.float32)[None], d[None].astype(np.float32))[0].astype(np.float64)
        scale = size / (2.02 * self.radius)
        local = (self.vertices - self.middle) @ basis.T
        pixel, _, _, _, height = rasterise(local[:, :2] * scale + size / 2, local[:, 2], self.triangles, (size, size))
        top = np.full(size * size, -np.inf)
        top[pixel] = height
        p = (np.asarray(points, np.float64) - self.middle) @ basis.T
        at = np.floor(p[:, :2] * scale + size / 2).astype(np.int64)
        inside = ((at >= 0) & (at < size)).all(axis=1)
        at = np.clip(at, 0, size - 1)
        bias = 1.5 / scale
        return ~inside | (top[at[:, 1] * size + at[:, 0]] <= p[:, 2] + bias)


__all__ = ["ROWS", "Raster", "rasterise"]
