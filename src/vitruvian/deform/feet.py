"""Points on the faces of a skin, moved as the skin's own points are: what cloth is hung on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.types import Body, Skin, Weights, floats, indices, require


def on_faces(body: Body, face: ArrayLike, barycentric: ArrayLike) -> Body:
    """The body with other skin: the points (n,) of its triangles `face` (n,) at `barycentric` (n,3), and no faces.

    Their weights are the blends of the corners' weights, not of their motions; so a deformer of this body that blends by
    weights ("linear" to "hybrid") gives points and frames of the surface in one call. Displacers are left out.
    Source: the requirement of local frames for clothes (seed 003, 4.1), done for places between vertices.
    Raises VitruvianError for faces out of range and for barycentric coordinates that do not sum to one.
    """
    skin = body.skin
    some = indices(face, "face", len(skin.triangles), None)
    share = floats(barycentric, "barycentric", len(some), 3)
    off = np.flatnonzero(np.abs(share.sum(axis=1) - 1) > 1e-6)
    require(not off.size, "barycentric", "rows that sum to 1", f"{share.sum(axis=1)[off[:1]]} at {off[:1]}")
    low = np.flatnonzero((share < -1e-9).any(axis=1))
    require(not low.size, "barycentric", "shares from 0 to 1", f"{share[low[:1]]} at {low[:1]}")
    corner = skin.triangles[some].reshape(-1)
    point, part = np.repeat(np.arange(len(some)), 3), np.maximum(share, 0).reshape(-1)
    counts = skin.weights.counts[corner]
    entry = np.repeat(skin.weights.row[corner] - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
    weight = np.repeat(part, counts) * skin.weights.weight[entry]
    rows = Weights.from_pairs(len(some), np.repeat(point, counts), skin.weights.joint[entry], weight)
    rest = np.einsum("nk,nkc->nc", share, skin.rest[skin.triangles[some]])
    return replace(body, skin=Skin(rest, np.zeros((0, 3), np.int32), rows), contours=())
