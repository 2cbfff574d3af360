"""Vertices as drawing programs want them: one per pair of point and texture coordinate."""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Floats, Ints, Skin


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
