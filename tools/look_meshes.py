"""Meshes as linear functions of the source's points: refining, cutting along level lines, hems.

A `Cut` is a triangle mesh whose vertices are weighted means of source points, so that it follows every shape.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, vstack

Array = np.ndarray


@dataclass
class Cut:
    """`means` (n, points) rows sum to 1; `triangles` (t,3); `fields` values carried at the vertices, name -> (n,)."""

    means: csr_matrix
    triangles: Array
    fields: dict[str, Array] = field(default_factory=dict)

    def at(self, points: Array) -> Array:
        return self.means @ points


def selection(rows: Array, columns: int) -> csr_matrix:
    return csr_matrix((np.ones(len(rows)), (np.arange(len(rows)), rows)), (len(rows), columns))


def of_quads(quads: Array, points: int) -> Cut:
    """Each quad of the source made four (at its edge middles and its middle), then triangles."""
    used, local = np.unique(quads, return_inverse=True)
    local = local.reshape(quads.shape)
    n = len(used)
    edges = np.sort(np.stack([local, np.roll(local, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    edges, which = np.unique(edges, axis=0, return_inverse=True)
    which = which.reshape(quads.shape)
    e, q = len(edges), len(quads)
    half = coo_matrix((np.full(2 * e, 0.5), (np.repeat(np.arange(e), 2), edges.ravel())), (e, n))
    middle = coo_matrix((np.full(4 * q, 0.25), (np.repeat(np.arange(q), 4), local.ravel())), (q, n))
    corner = selection(used, points)
    means = vstack([corner, half @ corner, middle @ corner]).tocsr()
    small = []
    for k in range(4):
        a, b, c, d = local[:, k], n + which[:, k], n + e + np.arange(q), n + which[:, k - 1]
        small += [np.stack([a, b, c], 1), np.stack([a, c, d], 1)]
    return Cut(means, np.concatenate(small).astype(np.int32))


def split(cut: Cut, name: str, level: float = 0.0) -> Cut:
    """The same surface with new vertices where the field `name` crosses `level`, so that no triangle straddles it."""
    value = cut.fields[name] - level
    value = np.where(np.abs(value) < 1e-7, 1e-7, value)
    side = value > 0
    t = cut.triangles
    mixed = side[t].any(axis=1) & ~side[t].all(axis=1)
    if not mixed.any():
        return cut
    m = t[mixed]
    alone = np.where(side[m].sum(axis=1) == 1, side[m].argmax(axis=1), (~side[m]).argmax(axis=1))
    m = np.take_along_axis(m, (alone[:, None] + np.arange(3)) % 3, axis=1)
    pairs = np.sort(np.concatenate([m[:, [0, 1]], m[:, [0, 2]]]), axis=1)
    pairs, which = np.unique(pairs, axis=0, return_inverse=True)
    i, j = pairs.T
    share = value[i] / (value[i] - value[j])
    n = len(value)
    k = len(pairs)
    mix = coo_matrix(
        (np.concatenate([1 - share, share]), (np.tile(np.arange(k), 2), np.concatenate([i, j]))), (k, n)
    ).tocsr()
    ab, ac = n + which[: len(m)], n + which[len(m) :]
    new = np.concatenate(
        [np.stack([m[:, 0], ab, ac], 1), np.stack([ab, m[:, 1], m[:, 2]], 1), np.stack([ab, m[:, 2], ac], 1)]
    )
    fields = {f: np.concatenate([v, mix @ v]) for f, v in cut.fields.items()}
    fields[name][n:] = level
    return Cut(vstack([cut.means, mix @ cut.means]).tocsr(), np.concatenate([t[~mixed], new]).astype(np.int32), fields)


def keep(cut: Cut, chosen: Array) -> Cut:
    """Only these triangles (bool), and the vertices they use."""
    t = cut.triangles[chosen]
    used, local = np.unique(t, return_inverse=True)
    return Cut(cut.means[used], local.reshape(-1, 3).astype(np.int32), {f: v[used] for f, v in cut.fields.items()})


def clip(cut: Cut, name: str, level: float = 0.0) -> Cut:
    """The part where the field `name` is above `level`, with a clean edge."""
    cut = split(cut, name, level)
    middle = cut.fields[name][cut.triangles].mean(axis=1)
    return keep(cut, middle > level)


def border(triangles: Array) -> Array:
    """(e,2) edges with one triangle, in its direction."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    key = np.sort(edges, axis=1)
    _, first, count = np.unique(key, axis=0, return_index=True, return_counts=True)
    return edges[first[count == 1]]
