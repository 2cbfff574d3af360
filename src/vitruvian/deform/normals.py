"""Vertex normals of a moving mesh.

Mesh normals: sums of face normals weighted by area over the welded mesh (points at the same rest position are one),
gathered in a fixed order, so that copies get equal bits. Operator normals: cofactors of each vertex's own transform.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.native import kernels

Single = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Incidence:
    """Which faces meet at each welded point: rows `row` (W+1,) of `face`; `point` (V,) the welded point of a vertex."""

    triangles: Ints
    row: Ints
    face: Ints
    point: Ints


def incidence(rest: Floats, triangles: Ints) -> Incidence:
    """Welds by exactly equal rest position."""
    point = np.unique(rest, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)
    corner = point[triangles].reshape(-1)
    order = np.argsort(corner, kind="stable")
    row = np.zeros(int(point.max(initial=-1)) + 2, np.int32)
    np.cumsum(np.bincount(corner, minlength=len(row) - 1), out=row[1:])
    return Incidence(np.ascontiguousarray(triangles), row, (order // 3).astype(np.int32), point)


def mesh_normals(faces: Incidence, vertices: Single, threads: int = 0) -> Single:
    """(F,V,3) unit normals of vertices (F,V,3); zero where a point has no area around it."""
    out = np.empty_like(vertices)
    native = kernels()
    if native is not None:
        native.normals(vertices, faces.triangles, faces.row, faces.face, faces.point, out, threads)
        return out
    for f, points in enumerate(vertices):
        out[f] = _numpy(faces, points.astype(np.float64))
    return out


def _numpy(faces: Incidence, points: Floats) -> Floats:
    a, b, c = (points[faces.triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    total = np.zeros((len(faces.row) - 1, 3))
    np.add.at(total, np.repeat(np.arange(len(total)), np.diff(faces.row)), normal[faces.face])
    return normalized(total)[faces.point]


def operator_normals(frames: NDArray, rest_normals: Floats) -> Floats:
    """(...,V,3): rest normals (V,3) carried by the cofactors of frames (...,V,3,4), safe when they are singular."""
    c0, c1, c2 = (frames[..., k].astype(np.float64) for k in range(3))
    n = rest_normals
    carried = np.cross(c1, c2) * n[:, :1] + np.cross(c2, c0) * n[:, 1:2] + np.cross(c0, c1) * n[:, 2:]
    return normalized(carried)


def normalized(vectors: Floats) -> Floats:
    """Unit vectors; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)
