"""Vertices as drawing programs want them: one per pair of point and texture coordinate, and normals with creases."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from vitruvian.body.types import Floats, Ints, Part, Skin


def split_seams(skin: Skin) -> tuple[Ints, Ints, Floats | None]:
    """Duplicate the points that have several texture coordinates.

    Returns `source` (N,) the skin vertex of each drawn vertex, `triangles` (T,3) into the drawn vertices, `uv` (N,2) or
    None. Without texture coordinates nothing is duplicated. Drawn vertices are ordered by skin vertex.
    """
    if skin.uv is None or skin.uv_triangles is None:
        return np.arange(len(skin.rest), dtype=np.int32), skin.triangles, None
    key = (skin.triangles.astype(np.int64) << 32) | skin.uv_triangles
    pairs, where = np.unique(key, return_inverse=True)
    source = (pairs >> 32).astype(np.int32)
    return source, where.reshape(-1, 3).astype(np.int32), skin.uv[pairs & 0xFFFFFFFF]


def face_normals(vertices: NDArray, triangles: Ints) -> Floats:
    """(T,3) normals of the faces, twice their area long."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def creases(rest: Floats, triangles: Ints, parts: tuple[Part, ...]) -> csr_array | None:
    """Sparse (3T,T): row 3t + k adds up the faces that shade corner k of triangle t together, or None if all is smooth.

    `creases(...) @ face_normals(...)` are corner normals (3T,3), not normalised, of any pose: which faces belong
    together is decided at rest, so that nothing flickers in motion: those round a point whose normals are within
    `Part.crease` of each other (X3D's creaseAngle, ISO/IEC 19775-1, 11.2.3).
    """
    limit = np.repeat([p.crease for p in parts], [p.stop - p.start for p in parts])
    if not len(limit) or limit.min() > np.pi - 1e-6:
        return None
    normal = face_normals(rest, triangles)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, 1)
    points = triangles.reshape(-1)
    order = np.argsort(points, kind="stable")  # corners by point
    counts = np.bincount(points, minlength=len(rest))
    start = np.cumsum(counts) - counts
    many = counts[points[order]]
    one = np.repeat(order, many)
    within = np.arange(len(one)) - np.repeat(np.cumsum(many) - many, many)
    other = order[np.repeat(start[points[order]], many) + within]
    f, g = one // 3, other // 3
    near = (normal[f] * normal[g]).sum(axis=1) >= np.cos(np.minimum(limit[f], np.pi)) - 1e-9
    near &= (limit[f] > 1e-6) | (f == g)
    near |= f == g
    shape = (len(points), len(triangles))
    return csr_array((np.ones(int(near.sum())), (one[near], g[near])), shape=shape)
