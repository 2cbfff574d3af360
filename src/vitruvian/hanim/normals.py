"""Normals of a surface at rest, for files: where faces meet softly they share one, at creases each has its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim.humanoid import Shape

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
_SOFT = np.pi - 1e-3


def corner_normals(points: Floats, triangles: Ints, crease: Floats) -> tuple[Floats, Ints | None]:
    """Unit normals of a mesh: (n,3) with None, one per point, where nothing is creased; else (m,3) and (t,3) into them.

    points (n,3), triangles (t,3), `crease` (t,) the crease angle of each face (radians): faces round a point shade
    together where their normals are within it, weighted by area (ISO/IEC 19775-1, 11.2.3). Points without area get +Y.
    """
    a, b, c = (points[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    if not len(triangles) or crease.min() >= _SOFT:
        return _unit(_summed(triangles.reshape(-1), np.repeat(face, 3, axis=0), len(points))), None
    corner = triangles.reshape(-1)
    order = np.argsort(corner, kind="stable")
    counts = np.bincount(corner, minlength=len(points))
    start = np.cumsum(counts) - counts
    many = counts[corner[order]]
    one = np.repeat(order, many)  # every pair of corners that share a point
    within = np.arange(len(one)) - np.repeat(np.cumsum(many) - many, many)
    other = order[np.repeat(start[corner[order]], many) + within]
    flat = _unit(face)
    near = (flat[one // 3] * flat[other // 3]).sum(axis=1) >= np.cos(np.minimum(crease[one // 3], np.pi)) - 1e-9
    near = (near & (crease[one // 3] > 1e-6)) | (one // 3 == other // 3)
    found = _unit(_summed(one[near], face[other[near] // 3], len(corner)))
    kept, index = np.unique(found, axis=0, return_inverse=True)
    return kept, index.reshape(-1, 3).astype(np.int32)


def _summed(where: NDArray, vectors: Floats, length: int) -> Floats:
    return np.stack([np.bincount(where, v, minlength=length) for v in vectors.T], axis=1).astype(np.float64)


def _unit(vectors: Floats) -> Floats:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(size > 1e-30, vectors / np.where(size > 1e-30, size, 1.0), [0.0, 1.0, 0.0])


def turned(shape: Shape, matrix: Floats | None = None) -> Shape:
    """The shape with its transform (and then `matrix` (4,4)) baked into points, normals and winding."""
    whole = shape.transform if matrix is None else matrix if shape.transform is None else matrix @ shape.transform
    if whole is None or shape.points is None:
        return shape
    linear = whole[:3, :3]
    flip = bool(np.linalg.det(linear) < 0)
    side = slice(None, None, -1) if flip else slice(None)
    reverse = lambda t: None if t is None else np.ascontiguousarray(t[:, side])  # noqa: E731
    normals = None
    if shape.normals is not None:
        a, b, c = linear.T
        carried = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)  # cofactors
        normals = _unit(shape.normals @ carried.T * (-1.0 if flip else 1.0))
    uv_triangles = shape.uv_triangles
    if shape.uv is not None and uv_triangles is None:
        uv_triangles = shape.triangles
    return replace(
        shape,
        points=shape.points @ linear.T + whole[:3, 3],
        triangles=np.ascontiguousarray(shape.triangles[:, side]),
        uv_triangles=reverse(uv_triangles),
        normals=normals,
        normal_triangles=reverse(shape.normal_triangles),
        transform=None,
    )
