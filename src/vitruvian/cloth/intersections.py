"""Where surfaces cut themselves or each other: edges that go through triangles.

Source: note cloth.md, section 4.5. Two triangles without a common vertex cut each other only where an edge of one goes
through the other, so edges against triangles tell all. Positions are rounded to float32 first, as the solver has them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.types import Floats, Ints, floats, indices
from vitruvian.native import kernels


def edges_of(triangles: Ints) -> Ints:
    """(e,2) edges of triangles (m,3), each once, smaller vertex first, sorted."""
    every = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(every, axis=0).astype(np.int32)


def intersections(
    positions: ArrayLike, triangles: ArrayLike, *, edges: Ints | None = None, same: ArrayLike | None = None
) -> Ints:
    """(k,2) rows of edges and of triangles that cut each other in a mesh of positions (n,3) and triangles (m,3), sorted.

    What has a common vertex does not count, nor what has vertices with one number in `same` (n,). edges (e,2): those of
    `edges_of` when None. Raises VitruvianError where positions are not finite or triangles leave their range.
    """
    x = floats(positions, "positions", None, 3)
    faces = indices(triangles, "triangles", len(x), None, 3)
    lines = edges_of(faces) if edges is None else indices(edges, "edges", len(x), None, 2)
    own = np.arange(len(x), dtype=np.int32) if same is None else indices(same, "same", max(len(x), 1), len(x))
    if not len(faces):
        return np.zeros((0, 2), np.int32)
    rows = np.zeros((len(x), 4), np.float32)
    rows[:, :3] = x
    native = kernels()
    if native is None:
        from vitruvian.cloth.touch_numpy import cloth_cuts

        return cloth_cuts(rows, faces, lines, own)
    return native.cloth_cuts(rows, faces, lines, own)


def intersections_between(
    positions: ArrayLike, triangles: ArrayLike, others: ArrayLike, other_triangles: ArrayLike
) -> tuple[Ints, Ints]:
    """Where one mesh cuts another, cloth and body say: (k,2) edges of the first and triangles of the second, and (l,2)
    edges of the second and triangles of the first. Edges in the order of `edges_of`."""
    x, y = floats(positions, "positions", None, 3), floats(others, "others", None, 3)
    faces = indices(triangles, "triangles", len(x), None, 3)
    rest = indices(other_triangles, "other_triangles", len(y), None, 3)
    one, two = edges_of(faces), edges_of(rest) + np.int32(len(x))
    both = np.concatenate([faces, rest + np.int32(len(x))])
    found = intersections(np.concatenate([x, y]), both, edges=np.concatenate([one, two]))
    first, face = found[:, 0] < len(one), found[:, 1] < len(faces)
    there = found[first & ~face] - np.array([0, len(faces)], np.int32)
    back = found[~first & face] - np.array([len(one), 0], np.int32)
    return there.astype(np.int32), back.astype(np.int32)


def cut_points(positions: Floats, edges: Ints, triangles: Ints) -> tuple[Floats, Floats]:
    """Where edges (k,2) meet triangles (k,3): (k,) share of the second end, (k,3) shares of the corners."""
    a, b = positions[edges[:, 0]], positions[edges[:, 1]]
    u, v, w = (positions[triangles[:, j]] for j in range(3))
    way = b - a
    volume = [np.sum(way * np.cross(p - a, q - a), axis=1) for p, q in ((v, w), (w, u), (u, v))]
    whole = np.stack(volume, axis=1)
    total = whole.sum(axis=1, keepdims=True)
    corner = np.where(np.abs(total) > 0, whole / np.where(total == 0, 1, total), 1 / 3)
    normal = np.cross(v - u, w - u)
    begin, end = np.sum(normal * (a - u), axis=1), np.sum(normal * (b - u), axis=1)
    along = np.where(begin == end, 0.5, begin / np.where(begin == end, 1, begin - end))
    return np.clip(along, 0, 1), np.clip(corner, 0, 1)
