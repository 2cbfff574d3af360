"""Half-edge collapses: a surface with fewer of its own points.

A collapse moves one point into a neighbour and takes away the triangles between them; no point ever gets a new place. Many
that do not touch each other are made at once, the cheapest first, so that arrays do the work. Source of the error:
Garland and Heckbert, Surface simplification using quadric error metrics, 1997; of the condition under which a surface stays
a surface: Dey, Edelsbrunner, Guha and Nekhayev, Topology preserving edge contraction, 1999.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from vitruvian.body.types import Floats

Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]

_RIM = 2.0  # what leaving the line of a border or seam counts against leaving a face
_EVEN = 2e-4  # what the square of a collapse's length counts against that of its error: on flat ground short ones first
_TURN = 0.3  # cosine by which a face may turn in one collapse
_THIN = 0.05  # height over longest side of a face that is not thinner than it was
_SHARE = 0.35  # of the points that could go, the cheapest of which some go in one round
_UPPER = np.triu_indices(4)


class Surface:
    """A surface that gets coarser. `place` (C,3): where its vertices are, metres.

    faces (T,3): vertices of each face. wedges (T,3): what a face has at each corner (point, look, texture coordinate), by
    numbers below `wedge_count`; a wedge belongs to one vertex. A collapse takes every wedge of the vertex that goes to one
    of the other's across the faces between them, or is not made: seams stay seams and looks keep their borders.
    source (T,): which of the given faces each was. importance (T,): factors of their errors. features (C,K): what
    else should not change (weights, colours), scaled to metres. held (C,): vertices that stay.
    """

    def __init__(
        self,
        place: Floats,
        faces: Whole,
        wedges: Whole,
        *,
        importance: Floats,
        features: csr_array,
        held: Flags,
    ):
        sound = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        self.place = place - place.mean(axis=0) if len(place) else place
        self.faces, self.wedges, self.source = faces[sound], wedges[sound], np.flatnonzero(sound)
        self.features, self.held = features.tocsr(), held
        self.norms = np.asarray(self.features.multiply(self.features).sum(axis=1)).ravel()
        self.quadrics, self.size = self._planes(importance[sound])

    def _planes(self, importance: Floats) -> tuple[Floats, Floats]:
        """(C,10) sums of squared distances to the planes of faces, by their areas, and of borders and seams; (C,) areas."""
        a, b, c = np.moveaxis(self.place[self.faces], 1, 0)
        normal = np.cross(b - a, c - a)
        self.outward = np.zeros_like(self.place)  # of vertices, as the full surface has it
        for k in range(3):
            np.add.at(self.outward, self.faces[:, k], normal)
        self.outward /= np.maximum(np.linalg.norm(self.outward, axis=1, keepdims=True), np.finfo(float).tiny)
        length = np.linalg.norm(normal, axis=1)
        normal /= np.where(length > 0, length, 1)[:, None]
        area = length / 2 * importance
        quadrics, size = np.zeros((len(self.place), 10)), np.zeros(len(self.place))
        flat = _quadric(normal, a, area)
        for k in range(3):
            np.add.at(quadrics, self.faces[:, k], flat / 3)
            np.add.at(size, self.faces[:, k], area / 3)
        edges = Edges(self.faces, self.wedges, len(self.place))
        some = np.flatnonzero(
            (edges.count == 1) | (edges.lows[:, 0] != edges.lows[:, 1]) | (edges.highs[:, 0] != edges.highs[:, 1])
        )
        low, high = edges.ends[some].T
        along = self.place[high] - self.place[low]
        for side in (0, 1):
            face = edges.face[some, side]
            across = np.cross(along, normal[face])
            span = np.linalg.norm(across, axis=1)
            across /= np.where(span > 0, span, 1)[:, None]
            upright = _quadric(across, self.place[low], _RIM * span**2 * importance[face] / 2)
            np.add.at(quadrics, low, upright)
            np.add.at(quadrics, high, upright)
        return quadrics, size

    def collapsed(self, most: int) -> int:
        """One round of at most `most` collapses, and how many there were; none is left when that is 0."""
        if not len(self.faces):
            return 0
        edges = Edges(self.faces, self.wedges, len(self.place))
        u, v, from_, to = self._allowed(edges)
        if not len(u):
            return 0
        cost = self._cost(u, v)
        order = np.argsort(cost, kind="stable")
        u, v, from_, to, cost = u[order], v[order], from_[order], to[order], cost[order]
        chosen = self._upright(u, v, _SHARE)
        if not len(chosen):
            chosen = self._upright(u, v, 1.0)
        if not len(chosen):
            return 0
        key = np.full(len(self.place), np.inf)
        key[u[chosen]] = np.arange(len(chosen))
        taken = _apart(key, edges.ends)
        best = chosen[np.sort(key[taken]).astype(np.int64)][: max(most, 1)]
        self._apply(u[best], v[best], from_[best], to[best])
        return len(best)

    def _allowed(self, edges: Edges) -> tuple[Whole, Whole, Whole, Whole]:
        """Collapses from u (N,) into v (N,) that keep the surface a surface, and wedges (N,2) of u and what they become."""
        count = len(self.place)
        ends, number = edges.ends, edges.count
        degree = np.bincount(ends.ravel(), minlength=count)
        around = np.bincount(self.faces.ravel(), minlength=count)
        border, odd = np.zeros(count, bool), degree > around + 1
        border[ends[number == 1]] = True
        odd[ends[number > 2]] = True
        span = int(self.wedges.max()) + 1
        many = np.bincount(np.unique(self.faces.ravel() * span + self.wedges.ravel()) // span, minlength=count)
        near = coo_array((np.ones(2 * len(ends)), (ends.ravel(), ends[:, ::-1].ravel())), shape=(count, count)).tocsr()
        both = (near @ near).multiply(near).tocsr()
        shared = np.asarray(both[ends[:, 0], ends[:, 1]]).ravel()
        good = (number <= 2) & (np.round(shared).astype(np.int64) == number)
        for side in (0, 1):
            tip = edges.tips[:, side]
            good &= degree[tip] >= 4 - border[tip]
        good &= (number == 1) | (edges.tips[:, 0] != edges.tips[:, 1])
        out = []
        for u, v, mine, other in (
            (ends[:, 0], ends[:, 1], edges.lows, edges.highs),
            (ends[:, 1], ends[:, 0], edges.highs, edges.lows),
        ):
            same = mine[:, 0] == mine[:, 1]
            carried = np.where(same, (many[u] == 1) & (other[:, 0] == other[:, 1]), many[u] == 2)
            fit = np.flatnonzero(good & carried & ~self.held[u] & ~odd[u] & (~border[u] | (number == 1)))
            out.append((u[fit], v[fit], mine[fit], other[fit]))
        u, v, from_, to = (np.concatenate(parts) for parts in zip(*out))
        return u, v, from_, to

    def _cost(self, u: Whole, v: Whole) -> Floats:
        """(N,) errors of collapses, by area."""
        error = _at(self.quadrics[u] + self.quadrics[v], self.place[v])
        change = (
            self.norms[u]
            + self.norms[v]
            - 2 * np.asarray(self.features[u].multiply(self.features[v]).sum(axis=1)).ravel()
        )
        length = ((self.place[u] - self.place[v]) ** 2).sum(axis=1)
        return np.asarray(np.maximum(error, 0) + self.size[u] * (np.maximum(change, 0) + _EVEN * length))

    def _upright(self, u: Whole, v: Whole, share: float) -> Whole:
        """Which collapses, of those sorted by cost: for each of a share of the points the first that turns no face over."""
        corner = np.argsort(self.faces.ravel(), kind="stable")
        number = np.bincount(self.faces.ravel(), minlength=len(self.place))
        first = np.cumsum(number) - number
        _, best = np.unique(u, return_index=True)
        limit = np.sort(best)[min(len(best) - 1, max(64, int(share * len(best))))]
        found, left = [np.zeros(0, np.int64)], np.arange(limit + 1)
        while len(left):
            _, where = np.unique(u[left], return_index=True)
            tried = left[where]
            many = number[u[tried]]
            row = np.repeat(np.arange(len(tried)), many)
            at = corner[np.repeat(first[u[tried]] - np.cumsum(many) + many, many) + np.arange(len(row))]
            face, k = at // 3, at % 3
            p, q = self.faces[face, (k + 1) % 3], self.faces[face, (k + 2) % 3]
            goal = v[tried][row]
            stays = (p != goal) & (q != goal)
            row, p, q, goal = row[stays], p[stays], q[stays], goal[stays]
            outward = self.outward[goal] + self.outward[p] + self.outward[q]
            bad = _spoiled(self.place[u[tried][row]], self.place[goal], self.place[p], self.place[q], outward)
            fails = np.bincount(row[bad], minlength=len(tried)) > 0
            found.append(tried[~fails])
            done = np.zeros(len(self.place), bool)
            done[u[tried[~fails]]] = True
            gone = np.zeros(limit + 1, bool)
            gone[tried] = True
            left = left[~gone[left] & ~done[u[left]]]
        return np.sort(np.concatenate(found))

    def _apply(self, u: Whole, v: Whole, from_: Whole, to: Whole) -> None:
        target = np.arange(len(self.place))
        target[u] = v
        np.add.at(self.quadrics, v, self.quadrics[u])
        np.add.at(self.size, v, self.size[u])
        became = np.arange(int(self.wedges.max()) + 1)
        became[from_] = to
        faces = target[self.faces]
        keep = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        self.faces, self.wedges, self.source = faces[keep], became[self.wedges[keep]], self.source[keep]

    def without(self, gone: Flags) -> None:
        """Take faces (T,) away."""
        self.faces, self.wedges, self.source = self.faces[~gone], self.wedges[~gone], self.source[~gone]

    def pieces(self) -> Whole:
        """(T,) numbers of connected pieces, by their first faces."""
        from scipy.sparse.csgraph import connected_components

        ends = np.concatenate([self.faces[:, :2], self.faces[:, 1:]])
        graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(len(self.place), len(self.place)))
        label = connected_components(graph, directed=False)[1][self.faces[:, 0]]
        _, first, number = np.unique(label, return_index=True, return_inverse=True)
        return np.argsort(np.argsort(first))[number.reshape(-1)]


class Edges:
    """Edges (E,2) of faces, lower vertex first; `count` (E,) faces at each, and of the first two of those `face` (E,2), the
    third vertices `tips` (E,2), and wedges at the lower and higher end, `lows` and `highs` (E,2). One face counts twice."""

    def __init__(self, faces: Whole, wedges: Whole, vertices: int):
        start, stop, tip = (np.concatenate([np.roll(faces, -n, axis=1)[:, k] for k in range(3)]) for n in range(3))
        first, second = (np.concatenate([np.roll(wedges, -n, axis=1)[:, k] for k in range(3)]) for n in range(2))
        back = start > stop
        key = np.where(back, stop, start) * vertices + np.where(back, start, stop)
        found, number, self.count = np.unique(key, return_inverse=True, return_counts=True)
        order = np.argsort(number.reshape(-1), kind="stable")
        begin = np.cumsum(self.count) - self.count
        sides = order[np.stack([begin, begin + (self.count > 1)], axis=1)]
        self.ends = np.stack([found // vertices, found % vertices], axis=1)
        self.face, self.tips = sides % len(faces), tip[sides]
        self.lows = np.where(back, second, first)[sides]
        self.highs = np.where(back, first, second)[sides]


def _quadric(normal: Floats, point: Floats, weight: Floats) -> Floats:
    """(N,10) upper halves of weight times the square of the plane through a point."""
    plane = np.concatenate([normal, -(normal * point).sum(axis=1, keepdims=True)], axis=1)
    return np.asarray(weight[:, None] * plane[:, _UPPER[0]] * plane[:, _UPPER[1]])


def _at(quadric: Floats, point: Floats) -> Floats:
    """(N,) values of quadrics (N,10) at points (N,3)."""
    one = np.concatenate([point, np.ones((len(point), 1))], axis=1)
    twice = np.where(_UPPER[0] == _UPPER[1], 1.0, 2.0)
    return np.asarray((quadric * twice * one[:, _UPPER[0]] * one[:, _UPPER[1]]).sum(axis=1))


def _spoiled(old: Floats, new: Floats, p: Floats, q: Floats, outward: Floats) -> Flags:
    """(N,) whether faces (old, p, q) turn too far, or away from `outward`, or get too thin, as (new, p, q)."""
    before, after = np.cross(p - old, q - old), np.cross(p - new, q - new)
    a, b = np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)
    turned = (before * after).sum(axis=1) < _TURN * a * b
    side = lambda o: np.maximum(np.maximum(((p - o) ** 2).sum(1), ((q - o) ** 2).sum(1)), ((p - q) ** 2).sum(1))  # noqa: E731
    tiny = np.finfo(float).tiny
    flat, flat_before = b / np.maximum(side(new), tiny), a / np.maximum(side(old), tiny)
    turned |= ((after * outward).sum(axis=1) < 0) & ((before * outward).sum(axis=1) > 0)
    return (turned & (a > 0)) | (b <= 0) | ((flat < _THIN) & (flat < flat_before))


def _apart(key: Floats, ends: Whole) -> Whole:
    """Vertices with finite keys (C,), no two of which have a neighbour in common, those with low keys first."""
    key = key.copy()
    low, high = ends.T
    out = []
    for _ in range(4):
        best = _least(_least(key, low, high), low, high)
        taken = np.flatnonzero((key == best) & np.isfinite(key))
        if not len(taken):
            break
        out.append(taken)
        mark = np.ones(len(key))
        mark[taken] = 0
        key[_least(_least(mark, low, high), low, high) == 0] = np.inf
    return np.concatenate(out) if out else np.zeros(0, np.int64)


def _least(value: Floats, low: Whole, high: Whole) -> Floats:
    """(C,) least values of vertices and their neighbours."""
    out = value.copy()
    np.minimum.at(out, low, value[high])
    np.minimum.at(out, high, value[low])
    return out
