"""What a ray meets: Intel Embree (PyPI `embreex`), with the NumPy twin of `raster.py` when it is missing.

A tracer is built from float32 vertices (V,3) near the origin and int32 triangles (T,3). Both kinds answer:
`visible(camera, size, offset)`: the nearest surface at every pixel, seen through one sub-pixel place;
`ambient(points, normals, row, count)` and `light(points, direction, radius, row, count)`: shares of open sky and of a
round light, each (n,) in 0..1. `row` (n,) in 0..15 picks one of sixteen fixed, complementary sets of directions, so
that the mean of a 4 x 4 block of neighbours has sixteen times as many.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import warn
from vitruvian.show.camera import Camera

Single = NDArray[np.floating]  # float32 where it is large
Ints = NDArray[np.int32]
Pixels = NDArray[np.int64]
ROWS = 16


@dataclass(frozen=True, eq=False)
class Hits:
    """Pixels that see something: pixel (n,) row-major index, triangle (n,), barycentric u, v (n,), depth (n,).

    A point of triangle (a, b, c) is (1-u-v) a + u b + v c; depth is measured along the viewing axis.
    """

    pixel: NDArray[np.int64]
    triangle: Ints
    u: Single
    v: Single
    depth: Single

    def __getitem__(self, some: object) -> Hits:
        return Hits(*(getattr(self, n)[some] for n in Hits.__dataclass_fields__))

    @staticmethod
    def join(parts: list[Hits]) -> Hits:
        return Hits(*(np.concatenate([getattr(p, n) for p in parts]) for n in Hits.__dataclass_fields__))


class Tracer(Protocol):
    def visible(
        self, camera: Camera, size: tuple[int, int], offset: tuple[float, float], beyond: Single | None = None
    ) -> Hits:
        """What each pixel sees first; `beyond` (pixels,): farther than that depth, nothing where it is infinite."""
        ...

    def ambient(self, points: Single, normals: Single, row: Ints, count: int) -> Single: ...

    def light(self, points: Single, direction: Single, radius: float, row: Ints, count: int) -> Single: ...


_warned = False


def tracer(vertices: Single, triangles: Ints, kind: str = "auto") -> Tracer:
    """A tracer of these triangles. kind: "auto", "embree" or "numpy"."""
    global _warned
    if kind != "numpy":
        try:
            return Embree(vertices, triangles)
        except ImportError:
            if kind == "embree":
                raise
            if not _warned:
                warn("embreex is not installed, pictures are drawn by the slower NumPy renderer: pip install embreex")
                _warned = True
    from vitruvian.show.raster import Raster

    return Raster(vertices, triangles)


def covered(camera: Camera, size: tuple[int, int], vertices: Single, triangles: Ints) -> Pixels:
    """The pixels (row-major, increasing) that lie in the bounding rectangle of any triangle: no other can see one."""
    width, height = size
    xy, depth = camera.project(vertices, size)
    if not (depth > 1e-6).all():
        return np.arange(width * height)
    a, b, c = (xy[triangles[:, i]] for i in range(3))
    low = np.floor(np.minimum(np.minimum(a, b), c) - 0.01)
    high = np.floor(np.maximum(np.maximum(a, b), c) + 0.01) + 1
    x0, x1 = (np.clip(v[:, 0], 0, width).astype(np.int64) for v in (low, high))
    y0, y1 = (np.clip(v[:, 1], 0, height).astype(np.int64) for v in (low, high))
    # each rectangle adds one inside, by the differences at its corners
    steps = np.zeros((height + 1) * (width + 1), np.int32)
    for y, x, by in ((y0, x0, 1), (y0, x1, -1), (y1, x0, -1), (y1, x1, 1)):
        steps += (by * np.bincount(y * (width + 1) + x, minlength=len(steps))).astype(np.int32)
    inside = (
        steps.reshape(height + 1, width + 1)
        .cumsum(axis=0, dtype=np.int32)
        .cumsum(axis=1, dtype=np.int32)[:height, :width]
    )
    return np.flatnonzero(inside > 0)


class Embree:
    """Ray queries by Intel Embree."""

    def __init__(self, vertices: Single, triangles: Ints):
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self.scene = EmbreeScene()
        self.vertices = np.ascontiguousarray(vertices, np.float32)
        self.triangles = np.ascontiguousarray(triangles, np.int32)
        self.known: tuple[Camera, tuple[int, int], Pixels] | None = None  # which pixels a camera may see something in
        self.empty = not len(triangles)
        if not self.empty:
            self.mesh = TriangleMesh(self.scene, self.vertices, self.triangles)

    def visible(
        self, camera: Camera, size: tuple[int, int], offset: tuple[float, float], beyond: Single | None = None
    ) -> Hits:
        if self.known is None or self.known[:2] != (camera, size):
            self.known = camera, size, covered(camera, size, self.vertices, self.triangles)
        pixel = self.known[2]
        if beyond is not None:
            pixel = pixel[np.isfinite(beyond[pixel])]
        none = np.zeros(0, np.float32)
        if not pixel.size:
            return Hits(pixel, np.zeros(0, np.int32), none, none, none)
        rays = camera.through(pixel, offset, size)
        eye = np.empty_like(rays)
        eye[:] = camera.eye
        if beyond is not None:
            start = beyond[pixel] * np.float32(1 + 2e-5)
            eye += rays * start[:, None]
        found = self.scene.run(eye, rays, output=1)
        hit = np.flatnonzero(found["primID"] >= 0)
        if beyond is not None:
            found["tfar"] = found["tfar"] + start
        return Hits(pixel[hit], *(found[k][hit] for k in ("primID", "u", "v", "tfar")))

    def open(self, points: Single, directions: Single) -> Single:
        """Share of the directions (n,k,3) that leave the points (n,3) unhindered, (n,)."""
        n, k, _ = directions.shape
        if self.empty or not n:
            return np.ones(n, np.float32)
        origins = np.repeat(points.astype(np.float32, copy=False), k, axis=0)
        hit = self.scene.run(origins, np.ascontiguousarray(directions.reshape(-1, 3), np.float32), query="OCCLUDED")
        free = np.zeros(n, np.float32)
        for i in range(k):  # faster than a mean over so short an axis
            free += hit[i::k] < 0
        return free / np.float32(k)

    def ambient(self, points: Single, normals: Single, row: Ints, count: int) -> Single:
        return _by_chunks(points, row, lambda p, r, s: self.open(p, _turn(cosine(count)[r], normals[s])))

    def light(self, points: Single, direction: Single, radius: float, row: Ints, count: int) -> Single:
        local = disc(count) * np.float32(radius)
        axis = np.asarray(direction, np.float32)[None]
        towards = _turn(np.concatenate([local, np.ones_like(local[..., :1])], -1).reshape(1, -1, 3), axis)
        towards = towards.reshape(ROWS, count, 3)
        return _by_chunks(points, row, lambda p, r, s: self.open(p, towards[r]))


def _by_chunks(points: Single, row: Ints, work: Callable[[Single, Ints, slice], Single]) -> Single:
    out = np.ones(len(points), np.float32)
    for start in range(0, len(points), 65536):
        s = slice(start, start + 65536)
        out[s] = work(points[s], row[s], s)
    return out


def _turn(directions: Single, axis: Single) -> Single:
    """Directions (n|1,k,3) given about +Z, turned so that +Z becomes axis (n,3)."""
    # orthonormal basis without branches: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 2017
    x, y, z = (axis[:, i] for i in range(3))
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    tangent = np.stack([1 + sign * x * x * a, sign * b, -sign * x], -1)
    bitangent = np.stack([b, sign + y * y * a, -y], -1)
    basis = np.stack([tangent, bitangent, axis], 1)
    return np.matmul(directions, basis)


@cache
def disc(count: int) -> Single:
    """(16, count, 2) points of the unit disc; each row covers it evenly, all rows together too."""
    i = np.arange(count * ROWS)
    radius = np.sqrt((i + 0.5) / len(i))
    angle = i * np.pi * (3 - np.sqrt(5))  # Vogel's sunflower
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1).astype(np.float32)
    # row r takes every 16th point, rotated in the order of a 4 x 4 Bayer matrix so that neighbours differ most
    order = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])
    return np.ascontiguousarray(points.reshape(count, ROWS, 2).transpose(1, 0, 2)[order])


@cache
def cosine(count: int) -> Single:
    """(16, count, 3) cosine-distributed directions about +Z (points of the disc, lifted: Malley's method)."""
    points = disc(count)
    up = np.sqrt(np.maximum(0, 1 - (points**2).sum(-1, keepdims=True)))
    return np.concatenate([points, up], -1)


def tile(pixel: NDArray[np.int64], width: int) -> Ints:
    """Row of the direction tables for each pixel: its place in a 4 x 4 block."""
    return ((pixel % width) % 4 + 4 * ((pixel // width) % 4)).astype(np.int32)
