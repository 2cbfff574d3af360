"""Where skin comes to face skin, as behind a bent knee: the cloth between both gives way.

Which skin each vertex may come to face is found once, in poses that fold the body, so that there is nothing to search for
from frame to frame. Source: note cloth.md, section 7 (fixed partners); seed 003, section 5.3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.cloth.moving import Skin
from vitruvian.native import kernels

Single = NDArray[np.float32]
CLOSE = 0.03  # metres from cloth to the skin that it may come to face, in a pose in which both are near
TURN = 0.05  # metres that the difference of two unit normals counts as where the nearest is looked for
FACING = -0.2  # product of their normals at most
PATCH = 0.08  # metres, of skin in which a vertex has one partner at most
KEPT, FAR = (
    0.002,
    0.08,
)  # metres that cloth keeps from skin that faces it; from its partner beyond which nothing pinches


@dataclass(frozen=True, eq=False)
class Pinched:
    """Vertices (k,) of a garment, in order and some of them several times, and the triangles (k,) of the skin that they may
    come to face."""

    vertices: Ints
    partners: Ints


NOTHING = Pinched(np.zeros(0, np.int32), np.zeros(0, np.int32))


def pinched(
    skin: Skin, regions: Ints, corner: Ints, share: Floats, poses: Sequence[tuple[Floats, Floats, Floats]]
) -> Pinched:
    """What may be pinched of a garment with feet of shares (n,3) of the skin's corners (n,3): its vertices (n,3) and points
    and normals (V,3) of the skin in some poses. regions (V,) of the skin: of each, a vertex has a partner in every patch
    at most."""
    from scipy.spatial import cKDTree

    rest = np.floor(skin.points[skin.triangles].mean(axis=1) / PATCH).astype(np.int64)
    part = np.unique(np.column_stack([regions[skin.triangles[:, 0]], rest]), axis=0, return_inverse=True)[1].reshape(-1)
    vertex, face, depth = [], [], []
    for x, points, normals in poses:
        middle = points[skin.triangles].mean(axis=1)
        across = normals[skin.triangles].sum(axis=1)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        up = np.einsum("nk,nkx->nx", share, normals[corner])
        up /= np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-30)
        near = cKDTree(np.hstack([middle, TURN * across])).query(np.hstack([x, -TURN * up]))[1]
        way, m = x - middle[near], across[near]
        high = np.einsum("nx,nx->n", way, m)
        some = np.flatnonzero(
            (np.einsum("nx,nx->n", m, up) < FACING) & (high < CLOSE) & (np.linalg.norm(way, axis=1) < 2 * CLOSE)
        )
        vertex.append(some)
        face.append(near[some])
        depth.append(high[some])
    v, f, d = (np.concatenate(q) for q in (vertex, face, depth))
    order = np.lexsort((d, part[f], v))
    v, f = v[order], f[order]
    first = np.ones(len(v), bool)
    first[1:] = (v[1:] != v[:-1]) | (part[f[1:]] != part[f[:-1]])
    return Pinched(v[first].astype(np.int32), f[first].astype(np.int32))


def given_way(some: Pinched, x: Single, part: Single, foot: Single, up: Single, skin: Skin, back: float = 1.0) -> None:
    """Draws cloth at x (n,3) that skin closes in on towards its feet (n,3), normals there up (n,3). part (n,): the shares
    of the way from there that it had, and has afterwards; they grow by `back` at most."""
    native = kernels()
    if native is None:
        from vitruvian.cloth.layers_numpy import cloth_pinch
    else:
        cloth_pinch = native.cloth_pinch
    cloth_pinch(
        x, part, foot, up, some.vertices, some.partners, skin.triangles, skin.neighbours, skin.both, KEPT, FAR, back
    )  # fmt: skip
