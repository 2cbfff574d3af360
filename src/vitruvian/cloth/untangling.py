"""Cloth that cuts itself pulled apart again, without simulating it anew.

Source: note cloth.md, section 4.5; Volino and Magnenat-Thalmann (2006), "Resolving surface collisions through
intersection contour minimization". Two surfaces that cut each other do so along a contour; moving them against each
other so that it gets shorter ends with no contour at all. Which side is right need not be known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.types import Floats, Ints, floats, indices, require
from vitruvian.cloth.intersections import cut_points, edges_of, intersections
from vitruvian.cloth.obstacle import Obstacle
from vitruvian.cloth.touch_numpy import shares

ROUNDS = 50
STEP = 0.4  # mean edges that a round moves one side of a contour at most
SPREAD = 4  # rounds of smoothing that carry a move to the vertices around

Keep = Callable[[Floats], Floats]


@dataclass(frozen=True, eq=False)
class Untangled:
    """positions (n,3) metres; how many cuts there were before each round, the last entry: what is left; moved: metres that
    the vertex moved farthest has moved."""

    positions: Floats
    counts: tuple[int, ...]
    moved: float

    @property
    def rounds(self) -> int:
        """That it took."""
        return len(self.counts) - 1

    @property
    def left(self) -> int:
        """Edges that still go through a triangle."""
        return min(self.counts)


def untangle(
    positions: ArrayLike,
    triangles: ArrayLike,
    *,
    rounds: int = ROUNDS,
    held: ArrayLike | None = None,
    obstacle: Obstacle | None = None,
    keep: Keep | None = None,
) -> Untangled:
    """Moves positions (n,3) of triangles (m,3) until none cuts another, at most `rounds` times.

    held (k,): vertices that stay. obstacle: what the cloth stays out of, by its offset. keep: called with the positions
    after each round, gives them back as they may be. Where cuts are left, the positions are those with the fewest.
    Triangles without an area and meshes without cuts are fine. Raises VitruvianError for what is not finite.
    """
    x = first = floats(positions, "positions", None, 3)
    faces = indices(triangles, "triangles", len(x), None, 3)
    require(rounds >= 0, "rounds", "zero or more", rounds)
    stay = np.zeros(len(x), bool)
    if held is not None:
        stay[indices(held, "held", len(x), None)] = True
    if not len(faces):
        return Untangled(x.copy(), (0,), 0.0)
    edges = edges_of(faces)
    mesh = _Mesh(faces, edges, *_sides(faces, edges))
    size = float(np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1).mean())
    counts: list[int] = []
    cuts, best = intersections(x, faces, edges=edges), x
    for _ in range(rounds):
        if not len(cuts):
            break
        if not counts or len(cuts) < min(counts):
            best = x
        counts.append(len(cuts))
        move = _spread(_moves(x, mesh, cuts, STEP * size), edges, stay)
        x = x + move
        if obstacle is not None:
            x = np.where(stay[:, None], x, outside(obstacle, x))
        if keep is not None:
            x = floats(keep(x), "what keep gives back", len(x), 3)
        cuts = intersections(x, faces, edges=edges)
    if not counts or len(cuts) < min(counts):
        best = x
    counts.append(len(cuts))
    return Untangled(best.copy(), tuple(counts), float(np.linalg.norm(best - first, axis=1).max(initial=0)))


def outside(obstacle: Obstacle, x: Floats) -> Floats:
    """Points (n,3) with those nearer to the obstacle than its offset, or inside, brought out to it."""
    apart = obstacle.distances(x)
    some = np.flatnonzero(apart < obstacle.offset - 1e-6)
    if not len(some):
        return x
    corner = obstacle.before[obstacle.triangles[obstacle.nearest(x[some])[1]]]
    foot = np.einsum("kc,kcx->kx", shares(x[some], corner), corner)
    plain = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    way = (x[some] - foot) * np.sign(apart[some])[:, None]
    way = np.where(np.abs(apart[some])[:, None] > 1e-7, way, plain)
    out = x.copy()
    out[some] = foot + obstacle.offset * way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-30)
    return out


@dataclass(frozen=True, eq=False)
class _Mesh:
    faces: Ints
    edges: Ints
    beside: Ints  # (e,2) triangles at an edge, -1: none
    third: Ints  # (e,2) their corners off the edge


def _sides(faces: Ints, edges: Ints) -> tuple[Ints, Ints]:
    """Of each edge the first two triangles at it, and their third corners."""
    count = np.int64(faces.max(initial=0)) + 1
    every = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    row = np.searchsorted(edges[:, 0] * count + edges[:, 1], every[:, 0] * count + every[:, 1])
    order = np.argsort(row, kind="stable")
    rank = np.arange(len(order)) - np.searchsorted(row[order], row[order])
    take = rank < 2
    beside, third = np.full((len(edges), 2), -1, np.int32), np.full((len(edges), 2), -1, np.int32)
    where = row[order][take], rank[take]
    beside[where] = order[take] // 3
    third[where] = faces[:, [2, 0, 1]].reshape(-1)[order[take]]
    return beside, third


def _gradients(x: Floats, mesh: _Mesh, cuts: Ints) -> Floats:
    """(k,3) how the edge of each cut has to move against its triangle for the contour to get shorter."""
    line, face = mesh.edges[cuts[:, 0]], mesh.faces[cuts[:, 1]]
    along = _unit(x[line[:, 1]] - x[line[:, 0]])
    normal = _unit(np.cross(x[face[:, 1]] - x[face[:, 0]], x[face[:, 2]] - x[face[:, 0]]))
    steep = np.sum(along * normal, axis=1)
    steep = np.where(np.abs(steep) < 0.1, np.where(steep < 0, -0.1, 0.1), steep)
    out = np.zeros((len(cuts), 3))
    for j in range(2):
        there = mesh.beside[cuts[:, 0], j] >= 0
        inward = x[mesh.third[cuts[:, 0], j]] - x[line[:, 0]]
        inward -= np.sum(inward * along, axis=1, keepdims=True) * along
        way = _unit(np.cross(normal, np.cross(along, inward)))  # of the contour, in both triangles
        way *= np.where(np.sum(way * inward, axis=1, keepdims=True) < 0, -1, 1)
        lean = (np.sum(along * way, axis=1) / steep)[:, None]
        out += np.where(there[:, None], way - lean * normal, 0)
    return out


def _contours(mesh: _Mesh, cuts: Ints) -> tuple[Ints, Floats]:
    """(k,) which contour each cut is on, and (k,) 1 or -1: cuts whose edges are on the same surface have the same sign."""
    ends: dict[tuple[int, int], list[tuple[int, int]]] = {}
    links: list[list[tuple[int, int]]] = [[] for _ in cuts]
    for k, (e, t) in enumerate(cuts.tolist()):
        for own in mesh.beside[e].tolist():
            if own >= 0:
                ends.setdefault((min(own, t), max(own, t)), []).append((k, own))
    for group in ends.values():
        for (k, own), (m, other) in zip(group, group[1:]):
            alike = 1 if own == other else -1
            links[k].append((m, alike))
            links[m].append((k, alike))
    which, sign = np.full(len(cuts), -1, np.int32), np.ones(len(cuts))
    found = 0
    for k in range(len(cuts)):
        if which[k] >= 0:
            continue
        which[k] = found
        stack = [k]
        while stack:
            here = stack.pop()
            for m, s in links[here]:
                if which[m] < 0:
                    which[m], sign[m] = found, s * sign[here]
                    stack.append(m)
        found += 1
    return which, sign


def _moves(x: Floats, mesh: _Mesh, cuts: Ints, step: float) -> Floats:
    """(n,3) what a round moves vertices at cuts, and those that have to come through; NaN where nothing does.

    Where a contour parts one of its surfaces in two, the smaller part is drawn back through the other surface. Else all
    cuts of a contour move by the sum of their gradients, and each a little by its own.
    """
    own = _gradients(x, mesh, cuts)
    which, sign = _contours(mesh, cuts)
    whole = np.stack([np.bincount(which, sign * own[:, j]) for j in range(3)], axis=1)
    long = np.linalg.norm(whole, axis=1, keepdims=True)
    whole = whole / np.sqrt(long**2 + 0.25)
    each = 0.5 * own / np.sqrt(np.sum(own**2, axis=1, keepdims=True) + 1)
    line, face = mesh.edges[cuts[:, 0]], mesh.faces[cuts[:, 1]]
    along, corner = cut_points(x, line, face)
    share = np.column_stack([1 - along, along, corner])
    drawn = np.full((len(x), 3), np.nan)
    for contour, side, way, region in _parted(x, mesh, cuts, which, sign):
        whole[contour] = side * way
        each[which == contour] = 0
        drawn[region] = step * way
    way = step * (whole[which] * sign[:, None] + each)
    vertex, against = np.column_stack([line, face]), np.array([1.0, 1.0, -1.0, -1.0, -1.0])
    part = (0.25 + share).ravel()  # the far end of an edge cut near its begin moves too
    move = (against[None, :, None] * way[:, None, :]).reshape(-1, 3) * 0.5
    total = np.bincount(vertex.ravel(), part, len(x))
    out = np.stack([np.bincount(vertex.ravel(), part * move[:, j], len(x)) for j in range(3)], axis=1)
    out = np.where(total[:, None] > 0, out / np.where(total == 0, 1, total)[:, None], np.nan)
    return np.where(np.isnan(drawn), out, drawn)


def _parted(
    x: Floats, mesh: _Mesh, cuts: Ints, which: Ints, sign: Floats
) -> list[tuple[int, float, Floats, np.ndarray]]:
    """Contours that part one of their surfaces: which, that surface's sign, the direction (3,) in which the smaller of its
    two parts gets back, and the vertices (n,) of that part (the flood of Baraff et al. 2003, "Untangling cloth")."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    open_ = np.ones(len(mesh.edges), bool)
    open_[cuts[:, 0]] = False
    a, b = mesh.edges[open_].T
    part = connected_components(coo_matrix((np.ones(len(a)), (a, b)), (len(x), len(x))), directed=False)[1]
    size = np.bincount(part)
    line, face = mesh.edges[cuts[:, 0]], mesh.faces[cuts[:, 1]]
    normal = _unit(np.cross(x[face[:, 1]] - x[face[:, 0]], x[face[:, 2]] - x[face[:, 0]]))
    forward = np.sum((x[line[:, 1]] - x[line[:, 0]]) * normal, axis=1) > 0
    front = part[np.where(forward, line[:, 1], line[:, 0])]
    back = part[np.where(forward, line[:, 0], line[:, 1])]
    out = []
    for contour in range(int(which.max(initial=-1)) + 1):
        best: tuple[int, float, Floats, np.ndarray] | None = None
        for side in (1.0, -1.0):
            here = (which == contour) & (sign == side)
            ahead, behind = np.unique(front[here]), np.unique(back[here])
            if not here.any() or np.isin(ahead, behind).any():
                continue
            mean = _unit(normal[here].sum(axis=0))
            for parts, way in ((ahead, -mean), (behind, mean)):
                count = int(size[parts].sum())
                if best is None or count < best[0]:
                    best = count, side, way, parts
        if best is not None:
            out.append((contour, best[1], best[2], np.isin(part, best[3])))
    return out


def _spread(move: Floats, edges: Ints, stay: np.ndarray) -> Floats:
    """Moves of all vertices: those given, and around them what fades out."""
    fixed = ~np.isnan(move[:, 0])
    out = np.nan_to_num(move)
    a, b = edges.T
    degree = np.maximum(np.bincount(edges.ravel(), minlength=len(move)), 1)[:, None]
    given = out.copy()
    for _ in range(SPREAD):
        mean = np.stack(
            [np.bincount(a, out[b, j], len(out)) + np.bincount(b, out[a, j], len(out)) for j in range(3)], axis=1
        )
        out = np.where(fixed[:, None], given, mean / degree)
    out[stay] = 0
    return out


def _unit(v: Floats) -> Floats:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-30)
