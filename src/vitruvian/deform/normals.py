"""Vertex normals of a moving mesh.

Mesh normals: sums of face normals weighted by area over the welded mesh (points at the same rest position are one),
gathered in a fixed order, so that copies get equal bits. Operator normals: cofactors of each vertex's own transform.
H-Anim normals: blends of what each joint makes of the normal, as browsers move a file's skinNormal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, require
from vitruvian.deform.bind import Influences
from vitruvian.deform.twins import linear as linear_twin
from vitruvian.native import kernels

Single = NDArray[np.float32]

RUN = 2048  # vertices that a thread takes at once


@dataclass(frozen=True, eq=False)
class Incidence:
    """Which faces meet at each welded point: rows `row` (W+1,) of `face`; `point` (V,) the welded point of a vertex.

    `order` (V,): all vertices, within each `RUN` of them those at which fewer faces meet first.
    """

    triangles: Ints
    row: Ints
    face: Ints
    point: Ints
    order: Ints


def incidence(rest: Floats, triangles: Ints) -> Incidence:
    """Welds by exactly equal rest position."""
    _, first, same = np.unique(rest, axis=0, return_index=True, return_inverse=True)
    number = np.empty(len(first), np.int32)  # as they come, so that neighbours are near in memory
    number[np.argsort(first)] = np.arange(len(first))
    point = number[same.reshape(-1)]
    corner = point[triangles].reshape(-1)
    face = (np.argsort(corner, kind="stable") // 3).astype(np.int32)
    row = np.zeros(len(first) + 1, np.int32)
    np.cumsum(np.bincount(corner, minlength=len(first)), out=row[1:])
    order = np.lexsort((np.diff(row)[point], np.arange(len(point)) // RUN)).astype(np.int32)
    return Incidence(np.ascontiguousarray(triangles), row, face, point, order)


def mesh_normals(faces: Incidence, vertices: Single, threads: int = 0) -> Single:
    """(F,V,3) unit normals of vertices (F,V,3); zero where a point has no area around it."""
    out = np.empty_like(vertices)
    native = kernels()
    if native is not None:
        native.normals(vertices, faces.triangles, faces.row, faces.face, faces.point, faces.order, out, threads)
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


def hanim_normals(rows: Influences, matrices: Floats, rest_normals: Floats, names: Sequence[str]) -> Floats:
    """(F,V,3): unit(n + sum w (N n - n)) for rest normals n (V,3) and N the inverse transpose of the 3x3 of each joint's
    matrix (F,J,4,4). What is missing to a sum of one stays as it was at rest, as it does for points.

    Source: ISO/IEC 19774-1, skinNormal: moved as skinCoord is, by the matrices that move normals.
    Raises VitruvianError naming a joint that is scaled to nothing and moves something.
    """
    linear = matrices[..., :3, :3]
    flat = np.abs(np.linalg.det(linear)) < 1e-12
    used = np.unique(rows.joint)
    bad = np.argwhere(flat[:, used])
    require(not bad.size, "matrices", "joints that are not scaled to nothing", [names[used[j]] for _, j in bad[:1]])
    turned = np.zeros((*matrices.shape[:2], 4, 4))
    turned[..., 3, 3] = 1
    turned[..., :3, :3] = np.linalg.inv(np.where(flat[..., None, None], np.eye(3), linear)).swapaxes(-1, -2)
    return normalized(np.stack([np.einsum("vab,vb->va", linear_twin(rows, t)[..., :3], rest_normals) for t in turned]))


def surface_frames(frames: NDArray, vertices: Single, normals: Single, rest_normals: Floats) -> Floats:
    """(F,V,3,4): columns tangent, bitangent and normal of a surface, right-handed and of unit length, and the vertex.

    The tangent is that at rest, `tangents` of the rest normals (V,3), carried by the operator's frames (F,V,3,4) and made
    perpendicular to the normals (F,V,3) of the vertices (F,V,3). Where there is no area, or the tangent is carried into
    the normal, frames take what the operator makes of the normal, and any tangent.
    """
    linear = frames[..., :3].astype(np.float64)
    n = normals.astype(np.float64)
    none = ~n.any(axis=-1, keepdims=True)
    if none.any():
        n = np.where(none, operator_normals(frames, rest_normals), n)
        n = np.where(n.any(axis=-1, keepdims=True), n, [0.0, 1.0, 0.0])
    t = normalized(np.einsum("fvab,vb->fva", linear, tangents(rest_normals)))
    t -= np.sum(t * n, axis=-1, keepdims=True) * n
    lost = np.linalg.norm(t, axis=-1, keepdims=True) < 1e-6
    t = normalized(np.where(lost, tangents(n), t))
    return np.stack([t, np.cross(n, t), n, vertices.astype(np.float64)], axis=-1)


def tangents(normals: Floats) -> Floats:
    """(...,3) unit and perpendicular to unit normals (...,3): the axis that lies least along each, made perpendicular."""
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=-1)]
    return normalized(axis - np.sum(axis * normals, axis=-1, keepdims=True) * normals)


def normalized(vectors: Floats) -> Floats:
    """Unit vectors; zero stays zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1.0)
