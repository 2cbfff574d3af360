"""Cloth bound to skin: each vertex in the frame of the point of the skin that is nearest to it.

Source: note cloth.md, sections 6 (1) and 7 (layer 1); seed 003, section 5.3.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.cloth.obstacle import pseudo_normals


@dataclass(frozen=True, eq=False)
class Binding:
    """Feet of n vertices on a skin with triangles (t,3): face (n,), which of them; share (n,3) of its corners; offset (n,3)
    metres, in the frame of the foot: along its triangle's first edge, across it, along the normal; facing (n,): whether
    cloth and skin face the same way there."""

    triangles: Ints
    face: Ints
    share: Floats
    offset: Floats
    facing: NDArray[np.bool_]

    @property
    def distance(self) -> Floats:
        """(n,) metres along the normals."""
        return self.offset[:, 2]

    def at(self, skin: Floats, normals: Floats | None = None) -> Floats:
        """(n,3) metres: where the vertices come to be with the skin at (V,3); normals (V,3) as for `bind`."""
        foot, frame = frames(skin, self.triangles, self.face, self.share, normals)
        return foot + np.einsum("nij,nj->ni", frame, self.offset)


def bind(skin: Floats, triangles: Ints, x: Floats, faces: Ints | None = None, normals: Floats | None = None) -> Binding:
    """Vertices (n,3) of a cloth bound to a skin, vertices (V,3) and triangles (t,3), metres; faces (m,3) of the cloth say
    which way it faces. normals (V,3): of the skin; None: weighted by angles."""
    x, skin = floats(x, "positions", None, 3), floats(skin, "skin", None, 3)
    triangles = indices(triangles, "triangles of the skin", len(skin), None, 3)
    require(len(triangles) > 0, "triangles of the skin", "a surface", "none")
    face, share, _ = feet(skin, triangles, x)
    foot, frame = frames(skin, triangles, face, share, normals)
    facing = np.ones(len(x), bool)
    if faces is not None:
        facing = np.einsum("nk,nk->n", pseudo_normals(x, faces), frame[:, :, 2]) > 0
    return Binding(triangles, face, share, np.einsum("nij,ni->nj", frame, x - foot), facing)


def feet(skin: Floats, triangles: Ints, x: Floats) -> tuple[Ints, Floats, Floats]:
    """Of points (n,3): the nearest triangle (n,), the shares of its corners (n,3) and the distance (n,) metres."""
    import igl

    squared, face, foot = igl.point_mesh_squared_distance(
        np.ascontiguousarray(x, np.float64), np.ascontiguousarray(skin, np.float64), triangles.astype(np.int64)
    )[:3]
    face = np.asarray(face, np.int32).reshape(-1)
    a, b, c = (skin[triangles[face, k]] for k in range(3))
    u, v, w = b - a, c - a, np.asarray(foot, np.float64).reshape(-1, 3) - a
    uu, uv, vv = (np.einsum("ni,ni->n", p, q) for p, q in ((u, u), (u, v), (v, v)))
    wu, wv = np.einsum("ni,ni->n", w, u), np.einsum("ni,ni->n", w, v)
    size = np.maximum(uu * vv - uv * uv, 1e-30)
    s, t = np.clip((vv * wu - uv * wv) / size, 0, 1), np.clip((uu * wv - uv * wu) / size, 0, 1)
    share = np.maximum(np.stack([1 - s - t, s, t], axis=1), 0)
    return face, share / share.sum(axis=1, keepdims=True), np.sqrt(np.asarray(squared, np.float64).reshape(-1))


def frames(
    skin: Floats, triangles: Ints, face: Ints, share: Floats, normals: Floats | None = None
) -> tuple[Floats, Floats]:
    """Feet (n,3) and their frames (n,3,3), columns along the first edge, across it, along the normal."""
    corners = triangles[face]
    foot = np.einsum("nk,nkx->nx", share, skin[corners])
    normals = pseudo_normals(skin, triangles) if normals is None else normals
    normal = np.einsum("nk,nkx->nx", share, normals[corners])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
    edge = skin[corners[:, 1]] - skin[corners[:, 0]]
    along = edge - np.sum(edge * normal, axis=1, keepdims=True) * normal
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    return foot, np.stack([along, np.cross(normal, along), normal], axis=2)
