"""Where a surface runs through itself: pairs of triangles that cross, without those that share a point.

Each edge of one triangle against the other triangle: T. Möller, B. Trumbore, "Fast, minimum storage ray-triangle
intersection" (1997).
"""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Floats, Ints


def crossings(points: Floats, triangles: Ints) -> Ints:
    """(n,2) pairs of triangles (t,3) of points (v,3) that cross each other."""
    from scipy.spatial import cKDTree

    corners = points[triangles]
    middle = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    # triangles of like size against each other: one radius for all would find far too many pairs of small ones
    edges = np.quantile(reach, [0.3, 0.6, 0.85, 0.97, 1.0])
    kind = np.searchsorted(edges[:-1], reach, side="left")
    some = [np.flatnonzero(kind == k) for k in range(len(edges))]
    trees = [cKDTree(middle[i]) if len(i) else None for i in some]
    found = [np.zeros((0, 2), np.int64)]
    for j, upper in enumerate(trees):
        for i in range(j + 1 if upper is not None else 0):
            lower = trees[i]
            if lower is None or upper is None:
                continue
            if i == j:
                found.append(some[i][upper.query_pairs(2 * edges[i], output_type="ndarray")])
                continue
            near = lower.sparse_distance_matrix(upper, edges[i] + edges[j], output_type="ndarray")
            found.append(np.stack([some[i][near["i"]], some[j][near["j"]]], axis=1))
    pairs = np.concatenate(found)
    close = np.linalg.norm(middle[pairs[:, 0]] - middle[pairs[:, 1]], axis=1) < reach[pairs].sum(axis=1)
    pairs = pairs[close]
    low, high = corners.min(axis=1), corners.max(axis=1)
    a, b = pairs.T
    pairs = pairs[((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)]
    shared = (triangles[pairs[:, 0], :, None] == triangles[pairs[:, 1], None, :]).any(axis=(1, 2))
    pairs = pairs[~shared]
    one, two = corners[pairs[:, 0]], corners[pairs[:, 1]]
    hit = np.zeros(len(pairs), bool)
    for k in range(3):
        hit |= _pierces(one[:, k], one[:, (k + 1) % 3], two) | _pierces(two[:, k], two[:, (k + 1) % 3], one)
    return pairs[hit].astype(np.int32)


def _pierces(start: Floats, stop: Floats, corners: Floats) -> np.ndarray:
    """(n,) whether segments (n,3) to (n,3) go through triangles (n,3,3)."""
    way, a = stop - start, corners[:, 0]
    u, v = corners[:, 1] - a, corners[:, 2] - a
    across = np.cross(way, v)
    det = (u * across).sum(axis=1)
    flat = np.abs(det) < 1e-18
    scale = 1 / np.where(flat, 1.0, det)
    away = start - a
    s = (away * across).sum(axis=1) * scale
    turned = np.cross(away, u)
    t = (way * turned).sum(axis=1) * scale
    at = (v * turned).sum(axis=1) * scale
    return ~flat & (s >= 0) & (t >= 0) & (s + t <= 1) & (at >= 0) & (at <= 1)
