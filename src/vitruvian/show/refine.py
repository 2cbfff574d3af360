"""Rounder outlines for close views: triangles that are large in the picture are split along their smooth normals.

Source: Boubekeur and Alexa, Phong Tessellation, SIGGRAPH Asia 2008: the midpoint of each edge is moved towards the
tangent planes of its ends; by half, which is exact where the edge spans an arc of a circle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.show.camera import Camera
from vitruvian.show.surfaces import Surface, deep_normals, unit, vertex_normals

EDGE = 7.0  # pixels: what is shorter in the middle is left as it is
LIMIT = 400_000  # triangles


def refined(surface: Surface, camera: Camera, size: tuple[int, int], rounds: int = 3) -> Surface:
    """The surface with those triangles split, up to `rounds` times, that are in the picture and coarse there.

    Surfaces with normals at their corners (creases) stay as they are. Normals are blended, not made anew: the shading
    stays as smooth as it was.
    """
    if surface.normals is not None and surface.normals.ndim == 3:
        return surface
    for _ in range(rounds):
        some = _coarse(surface, camera, size)
        if not some.any() or len(surface.triangles) + 3 * some.sum() > LIMIT:
            break
        surface = split(surface, some)
    return surface


def _coarse(surface: Surface, camera: Camera, size: tuple[int, int]) -> NDArray[np.bool_]:
    """(T,) the triangles near the picture, when the usual edge among them is long enough to show."""
    xy, depth = camera.project(surface.vertices, size)
    a, b, c = (xy[surface.triangles[:, i]] for i in range(3))
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    border = 0.05 * max(size)
    with np.errstate(invalid="ignore"):  # NaN, behind the camera, is not near
        near = np.asarray((high > -border).all(axis=1) & (low < np.array(size) + border).all(axis=1))
    near &= (depth > 0)[surface.triangles].all(axis=1)
    if not near.any():
        return near
    edge = np.sqrt(((b - a)[near] ** 2).sum(axis=1).mean())
    return near if edge > EDGE else np.zeros_like(near)


def split(surface: Surface, some: NDArray[np.bool_]) -> Surface:
    """The triangles of `some` (T,) in four each; new vertices come after the old ones."""
    v, t = np.asarray(surface.vertices, np.float64), surface.triangles
    normal = vertex_normals(v, t) if surface.normals is None else surface.normals
    soft = deep_normals(surface, normal.astype(np.float32))
    old = t[some]
    ends = np.sort(np.concatenate([old[:, [0, 1]], old[:, [1, 2]], old[:, [2, 0]]]), axis=1)
    key, which = np.unique(ends[:, 0].astype(np.int64) * len(v) + ends[:, 1], return_inverse=True)
    a, b = key // len(v), key % len(v)
    middle = (v[a] + v[b]) / 2
    lift = np.zeros_like(middle)
    for end in (a, b):
        lift -= 0.5 * ((middle - v[end]) * normal[end]).sum(axis=1, keepdims=True) * normal[end]
    # a normal that leans far away from its neighbour's means an edge, not a curve
    lift *= np.clip(2 * (normal[a] * normal[b]).sum(axis=1, keepdims=True), 0, 1)
    fresh = middle + 0.5 * lift
    ab, bc, ca = which.reshape(3, -1) + len(v)
    one, two, three = old.T
    four = np.stack([one, ab, ca, ab, two, bc, ca, bc, three, ab, bc, ca], -1).reshape(-1, 3)
    counts = np.where(some, 4, 1)
    stops = np.concatenate([[0], np.cumsum(counts)])
    triangles = np.empty((stops[-1], 3), np.int32)
    triangles[np.repeat(some, counts)] = four
    triangles[stops[:-1][~some]] = t[~some]
    parts = tuple(replace(p, start=int(stops[p.start]), stop=int(stops[p.stop])) for p in surface.parts)

    def both(values: NDArray) -> NDArray:
        return np.concatenate([values, (values[a] + values[b]) / 2])

    uv = surface.uv
    if uv is not None:  # of each corner: they may differ where faces meet
        a0, b0, c0 = (uv[some, i] for i in range(3))
        halves = [(a0 + b0) / 2, (b0 + c0) / 2, (c0 + a0) / 2]
        corners = [a0, halves[0], halves[2], halves[0], b0, halves[1], halves[2], halves[1], c0, *halves]
        fine = np.empty((stops[-1], 3, 2))
        fine[np.repeat(some, counts)] = np.stack(corners, 1).reshape(-1, 3, 2)
        fine[stops[:-1][~some]] = uv[~some]
        uv = fine
    colors = None if surface.colors is None else both(surface.colors)
    rest = both(surface.vertices if surface.rest is None else surface.rest)
    return Surface(np.concatenate([v, fresh]), triangles, unit(both(normal)), colors, parts, rest, unit(both(soft)), uv)
