"""Panels as triangles, so that what is sewn together has the same number of vertices along both sides.

Source: note cloth.md, section 3. Interior vertices stand on a hexagonal lattice along the grain, where bending is the same
in every direction; the triangulation is Delaunay's (SciPy), edges of the outline that it lacks are put in after Anglada
(1997, "An improved incremental algorithm for constructing restricted Delaunay triangulations").
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, require
from vitruvian.cloth.pattern import Panel, Pattern, Seam, Span, along, area, length, loops
from vitruvian.errors import VitruvianError

SIZES = (0.003, 0.04)  # metres: the edge lengths that make sense
SAME = 1e-7  # of an edge's length: two cuts nearer than that are one
CLOSE = 0.65  # mesh sizes that interior vertices keep from the outline
ROUNDS = 3  # of smoothing
MOST = 400_000  # vertices: of a garment, not of a mistake in units

Key = tuple[int, int]  # panel, edge


@dataclass(frozen=True, eq=False)
class PanelMesh:
    """Flat panels as triangles; panels do not share vertices.

    material (n,2): metres in each panel's own plane; grain (n,2): the same turned so that the warp is +v; triangles
    (m,3) wind as the outlines do, so that they face away from the body; panel (n,): of the pattern's; edges: (panel,
    edge) -> vertices along it, both ends included; pairs (p,2): vertices that seams join; seam (p,): which one.
    """

    material: Floats
    grain: Floats
    triangles: Ints
    panel: Ints
    edges: Mapping[Key, Ints]
    pairs: Ints
    seam: Ints


def tessellate(pattern: Pattern, size: float = 0.010) -> PanelMesh:
    """Triangles with edges of about `size` metres.

    Raises VitruvianError for a size out of bounds, outlines that do not close or cross themselves, and seams that name
    edges which are not there.
    """
    require(SIZES[0] <= size <= SIZES[1], "size", f"{SIZES[0]:g} to {SIZES[1]:g} m", f"{size:g}")
    number = {p.name: k for k, p in enumerate(pattern.panels)}
    lengths = {(k, e): length(p, e) for k, p in enumerate(pattern.panels) for e in range(len(p.edges))}
    total = sum(abs(area(p)) for p in pattern.panels) / (0.85 * size * size)
    if total > MOST or sum(lengths.values()) / size > MOST:
        raise VitruvianError(f"pattern {pattern.name}: it would have {total:.2g} vertices; is its unit right?")
    seams = [_Sides(s, number, lengths, 0.4 * size) for s in pattern.seams if not s.open]
    cuts = _cuts(seams, lengths, size)
    parts, first = [], 0
    edges: dict[Key, Ints] = {}
    sides = [side for b in pattern.buttons for side in (b.a, b.b)]
    for k, panel in enumerate(pattern.panels):
        places = np.array([at for name, at in sides if name == panel.name]).reshape(-1, 2)
        points, triangles, own = _panel(panel, [cuts[k, e] for e in range(len(panel.edges))], size, places)
        parts.append((points, triangles + first))
        edges |= {(k, e): (v + first).astype(np.int32) for e, v in enumerate(own)}
        first += len(points)
    material = np.concatenate([p for p, _ in parts])
    panel_of = np.repeat(np.arange(len(parts), dtype=np.int32), [len(p) for p, _ in parts])
    pairs = [s.pairs(edges, cuts) for s in seams]
    which = np.flatnonzero([not s.open for s in pattern.seams])
    return PanelMesh(
        material,
        _with_the_grain(pattern, material, panel_of),
        np.concatenate([t for _, t in parts]).astype(np.int32),
        panel_of,
        edges,
        np.concatenate([np.zeros((0, 2), np.int32), *pairs]),
        np.repeat(which, [len(p) for p in pairs]).astype(np.int32),
    )


def _with_the_grain(pattern: Pattern, material: Floats, panel: Ints) -> Floats:
    grain = np.array([p.grain / np.hypot(*p.grain) for p in pattern.panels])[panel]
    return np.stack(
        [grain[:, 1] * material[:, 0] - grain[:, 0] * material[:, 1], np.sum(grain * material, axis=1)], axis=1
    )


class _Sides:
    """A seam's two sides, and how far along each its spans reach (0..1).

    Where a span of one side ends less than `near` metres from an end of the other's, they meet, so that no sliver of cloth
    is between them.
    """

    def __init__(self, seam: Seam, number: Mapping[str, int], lengths: Mapping[Key, float], near: float) -> None:
        self.seam, self.rows = seam, []
        keyed, ends, total = [], [], 0.0
        for side in (seam.a, seam.b):
            for s in side:
                if s.panel not in number or (number[s.panel], s.edge) not in lengths:
                    raise VitruvianError(f"seam: expected an edge of the pattern, found {s.panel!r:.60} edge {s.edge}")
            keys = [(number[s.panel], s.edge) for s in side]
            reach = np.cumsum([0.0, *(lengths[k] * (s.t1 - s.t0) for k, s in zip(keys, side))])
            total = max(total, float(reach[-1]))
            keyed.append(keys)
            ends.append(reach / max(reach[-1], 1e-12))
        flip = (lambda r: 1 - r[::-1]) if seam.reversed else (lambda r: r)
        one, two = ends[0], flip(ends[1])
        for i in range(1, len(one) - 1):
            j = int(np.abs(two - one[i]).argmin())
            if 0 < j < len(two) - 1 and abs(two[j] - one[i]) * total < near and np.abs(one - two[j]).argmin() == i:
                one[i] = two[j] = 0.5 * (one[i] + two[j])
        for keys, side, reach in zip(keyed, (seam.a, seam.b), (one, flip(two))):
            self.rows.append([(k, s, reach[i], reach[i + 1]) for i, (k, s) in enumerate(zip(keys, side))])

    def across(self, side: int, row: int, t: Floats) -> Iterable[tuple[Key, float]]:
        """Places on the other side, (key, t), opposite to t of one span."""
        _, span, low, high = self.rows[side][row]
        s = low + (t - span.t0) / (span.t1 - span.t0) * (high - low)
        s = 1 - s if self.seam.reversed else s
        for key, other, start, stop in self.rows[1 - side]:
            inside = (s >= start - SAME) & (s <= stop + SAME)
            share = np.clip((s[inside] - start) / (stop - start), 0, 1)
            for value in other.t0 + share * (other.t1 - other.t0):
                yield key, float(value)

    def pairs(self, edges: Mapping[Key, Ints], cuts: Mapping[Key, Floats]) -> Ints:
        """(p,2) vertices that it joins."""
        both = []
        for rows in self.rows:
            pieces = [_within(edges[key], cuts[key], span) for key, span, _, _ in rows]
            both.append(_chain(pieces))
        a, b = both
        if self.seam.reversed:
            b = b[::-1]
        if len(a) != len(b):  # sides that share part of themselves
            raise VitruvianError(
                f"seam of {self.seam.a[0].panel} edge {self.seam.a[0].edge}: its sides cannot be matched"
            )
        return np.stack([a, b], axis=1).astype(np.int32)


def _within(vertices: Ints, t: Floats, span: Span) -> Ints:
    keep = (t >= span.t0 - SAME) & (t <= span.t1 + SAME)
    return vertices[keep]


def _chain(pieces: Sequence[Ints]) -> NDArray[np.int64]:
    """One after the other; where one ends on the vertex that the next begins with, it counts once. Sides that go on at
    another panel have two vertices there: the later one is dropped too, as their corners are sewn elsewhere."""
    out = [pieces[0]]
    out += [p[1:] for p in pieces[1:]]
    return np.concatenate(out).astype(np.int64)


def _cuts(seams: Sequence[_Sides], lengths: Mapping[Key, float], size: float) -> dict[Key, Floats]:
    """(key) -> parameters t of the vertices along each edge: ends of spans on either side of a seam, and between them
    equal steps, as many as the longest of those that are sewn to each other needs."""
    ends: dict[Key, list[float]] = {key: [0.0, 1.0] for key in lengths}

    def put(key: Key, t: float) -> bool:
        if min(abs(t - other) for other in ends[key]) > SAME:
            ends[key].append(t)
            return True
        return False

    for s in seams:
        for rows in s.rows:
            for key, span, _, _ in rows:
                put(key, span.t0), put(key, span.t1)
    for _ in range(100):
        more = False
        for s in seams:
            for side in (0, 1):
                for i, (key, span, _, _) in enumerate(s.rows[side]):
                    t = np.array([x for x in ends[key] if span.t0 - SAME <= x <= span.t1 + SAME])
                    for other, value in s.across(side, i, t):
                        more |= put(other, value)
        if not more:
            break
        if sum(map(len, ends.values())) > MOST:
            raise VitruvianError("seams: they cut each other's edges into ever smaller pieces")
    sorted_ends = {key: np.sort(np.array(values)) for key, values in ends.items()}
    index = {
        (key, i): n for n, (key, i) in enumerate((k, i) for k, v in sorted_ends.items() for i in range(len(v) - 1))
    }
    parent = list(range(len(index)))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for s in seams:
        for i, (key, span, _, _) in enumerate(s.rows[0]):
            knots = sorted_ends[key]
            middle = 0.5 * (knots[:-1] + knots[1:])
            mine = np.flatnonzero((middle > span.t0) & (middle < span.t1))
            for j in mine:
                for other, value in s.across(0, i, middle[j : j + 1]):
                    there = int(np.searchsorted(sorted_ends[other], value)) - 1
                    parent[root(index[key, int(j)])] = root(index[other, there])
    need: dict[int, int] = {}
    for (key, i), n in index.items():
        gap = (sorted_ends[key][i + 1] - sorted_ends[key][i]) * lengths[key]
        need[root(n)] = max(need.get(root(n), 1), int(np.ceil(gap / size - 1e-9)))
    out = {}
    for key, knots in sorted_ends.items():
        pieces = [
            np.linspace(knots[i], knots[i + 1], need[root(index[key, i])], endpoint=False)
            for i in range(len(knots) - 1)
        ]
        out[key] = np.concatenate([*pieces, [1.0]])
    return out


def _panel(panel: Panel, cuts: Sequence[Floats], size: float, places: Floats) -> tuple[Floats, Ints, list[Ints]]:
    """Vertices (k,2), triangles and the vertices along each edge of one panel. At its places (p,2) there are vertices, if
    they are inside and not nearer to each other or the outline than a mesh of this size has them."""
    corner: dict[int, int] = {}
    points: list[Floats] = []
    own: list[Ints] = []
    count = 0

    def corner_of(vertex: int) -> int:
        nonlocal count
        if vertex not in corner:
            corner[vertex] = count
            points.append(panel.vertices[vertex][None])
            count += 1
        return corner[vertex]

    for e, edge in enumerate(panel.edges):
        start = corner_of(edge.start)
        inner = along(panel, e, cuts[e][1:-1])
        points.append(inner)
        middle = np.arange(count, count + len(inner))
        count += len(inner)
        own.append(np.concatenate([[start], middle, [corner_of(edge.end)]]).astype(np.int32))
    border = np.concatenate(points)
    segments = []
    for loop in loops(panel):
        if panel.edges[loop[-1]].end != panel.edges[loop[0]].start:
            raise VitruvianError(f"panel {panel.name}: its outline does not close at edge {loop[-1]}")
        for e in loop:
            segments.append(np.stack([own[e][:-1], own[e][1:]], axis=1))
    outline = np.concatenate(segments) if segments else np.zeros((0, 2), int)
    if len(outline) < 3:
        raise VitruvianError(f"panel {panel.name}: expected an outline, found {len(outline)} edges")
    fixed = _apart(border, outline, places, size)
    inside = _lattice(panel, border, outline, size)
    border = np.concatenate([border, fixed])
    if len(fixed):
        near = np.linalg.norm(inside[:, None] - fixed, axis=2).min(axis=1) < CLOSE * size
        inside = inside[~near]
    triangles: Ints = np.zeros((0, 3), np.int32)
    for turn in range(ROUNDS + 1):
        every = np.concatenate([border, inside])
        triangles = _triangulated(panel.name, every, outline, size)
        if turn < ROUNDS and len(inside):
            inside = _smoothed(every, triangles, len(border))
    if area(panel) < 0:
        triangles = triangles[:, [0, 2, 1]]
    return every, triangles, own


def _apart(border: Floats, outline: Ints, places: Floats, size: float) -> Floats:
    """(k,2) those of some places (p,2) that are inside an outline and keep apart from it and from each other."""
    a, b = border[outline[:, 0]], border[outline[:, 1]]
    kept = np.zeros((0, 2))
    taken = np.concatenate([a + k / 4 * (b - a) for k in range(4)])
    for place, inside in zip(places, _inside(places, a, b)):
        if inside and np.linalg.norm(taken - place, axis=1).min() > CLOSE * size:
            kept, taken = (np.concatenate([some, place[None]]) for some in (kept, taken))
    return kept


def _lattice(panel: Panel, border: Floats, outline: Ints, size: float) -> Floats:
    """(k,2) points of a hexagonal lattice along the grain, inside the outline and not too near to it."""
    from scipy.spatial import cKDTree

    warp = panel.grain / np.hypot(*panel.grain)
    axes = np.array([[warp[1], -warp[0]], warp])  # rows: weft, warp
    local = border @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    rise = size * np.sqrt(3) / 2
    columns, rows = (int(np.ceil(n)) + 2 for n in ((high - low) / [size, rise]))
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    grid[..., 0] += 0.5 * (grid[..., 1] % 2)
    grid = grid.reshape(-1, 2) * [size, rise]
    middle = 0.5 * (low + high) - 0.5 * grid.max(axis=0)
    places = (grid + middle) @ axes
    a, b = border[outline[:, 0]], border[outline[:, 1]]
    dense = np.concatenate([a + k / 4 * (b - a) for k in range(4)])
    far = cKDTree(dense).query(places, distance_upper_bound=CLOSE * size)[0] >= CLOSE * size
    places = places[far]
    return places[_inside(places, a, b)]


def _inside(points: Floats, a: Floats, b: Floats) -> NDArray[np.bool_]:
    """(k,) whether a ray from each point crosses the segments a to b an odd number of times."""
    out = np.zeros(len(points), bool)
    order = np.argsort(points[:, 1], kind="stable")
    y = points[order, 1]
    for (ax, ay), (bx, by) in zip(a, b):
        if ay == by:
            continue
        first, last = np.searchsorted(y, sorted((ay, by)))
        some = order[first:last]
        x = ax + (points[some, 1] - ay) * (bx - ax) / (by - ay)
        out[some] ^= points[some, 0] < x
    return out


def _smoothed(points: Floats, triangles: Ints, fixed: int) -> Floats:
    """(k,2) points behind the first `fixed`, each moved to the middle of its neighbours."""
    a, b = triangles[:, [0, 1, 2]].ravel(), triangles[:, [1, 2, 0]].ravel()
    total = np.zeros_like(points)
    for k in range(2):
        total[:, k] = np.bincount(a, points[b, k], len(points)) + np.bincount(b, points[a, k], len(points))
    count = np.bincount(a, minlength=len(points)) + np.bincount(b, minlength=len(points))
    return np.where(count[fixed:, None] > 0, total[fixed:] / np.maximum(count[fixed:, None], 1), points[fixed:])


def _triangulated(name: str, points: Floats, outline: Ints, size: float) -> Ints:
    """(t,3) counter-clockwise triangles of the inside, with every segment of the outline among their edges."""
    from scipy.spatial import Delaunay, QhullError

    middle = points.mean(axis=0)
    try:
        triangles = Delaunay((points - middle) / size).simplices.astype(np.int32)
    except (QhullError, ValueError):
        raise VitruvianError(f"panel {name}: expected an outline with an area, found none") from None
    p = points[triangles]
    double = _cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    triangles[double < 0] = triangles[double < 0][:, [0, 2, 1]]
    triangles = triangles[np.abs(double) > 2e-5 * size * size]
    triangles = _with_edges(name, points, triangles, outline)
    a, b = points[outline[:, 0]], points[outline[:, 1]]
    triangles = triangles[_inside(points[triangles].mean(axis=1), a, b)]
    have = _keys(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), len(points))
    lost = outline[~np.isin(_keys(outline, len(points)), have)]
    if len(lost):
        x, y = points[lost[0]].mean(axis=0)
        raise VitruvianError(f"panel {name}: its outline touches or crosses itself near ({x:.3f}, {y:.3f}) m")
    return triangles


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _keys(edges: Ints, count: int) -> NDArray[np.int64]:
    low, high = np.minimum(edges[:, 0], edges[:, 1]).astype(np.int64), np.maximum(edges[:, 0], edges[:, 1])
    return low * count + high


def _with_edges(name: str, points: Floats, triangles: Ints, outline: Ints) -> Ints:
    """The triangulation with those segments of the outline put in that it lacks."""
    n = len(points)
    while True:
        every = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        missing = outline[~np.isin(_keys(outline, n), _keys(every, n))]
        if not len(missing):
            return triangles
        before = len(missing)
        for a, b in missing:
            triangles = _put_in(points, triangles, int(a), int(b))
        every = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        left = outline[~np.isin(_keys(outline, n), _keys(every, n))]
        if len(left) >= before:
            x, y = points[left[0]].mean(axis=0)
            raise VitruvianError(f"panel {name}: its outline touches or crosses itself near ({x:.3f}, {y:.3f}) m")


def _put_in(points: Floats, triangles: Ints, a: int, b: int) -> Ints:
    """With edge a b: the triangles that it crosses give way to those of the two polygons beside it."""
    way = points[b] - points[a]
    side = _cross(way, points - points[a])
    corner = side[triangles]
    hit = np.zeros(len(triangles), bool)
    for k in range(3):  # an edge whose ends lie on both sides, crossed between a and b
        i, j = triangles[:, k], triangles[:, (k + 1) % 3]
        si, sj = corner[:, k], corner[:, (k + 1) % 3]
        share = si / np.where(si == sj, 1, si - sj)
        where = points[i] + share[:, None] * (points[j] - points[i])
        t = (where - points[a]) @ way / (way @ way)
        hit |= (si * sj < 0) & (t > 1e-12) & (t < 1 - 1e-12)
    some = triangles[hit]
    edges = {(int(t[k]), int(t[(k + 1) % 3])) for t in some for k in range(3)}
    follow = {i: j for i, j in edges if (j, i) not in edges}
    chains = []
    for start, stop in ((a, b), (b, a)):
        chain = [start]
        while chain[-1] != stop and len(chain) <= len(follow) and chain[-1] in follow:
            chain.append(follow[chain[-1]])
        if chain[-1] != stop:
            return triangles
        chains.append(chain)
    fresh: list[tuple[int, int, int]] = []
    for chain in chains:
        _fill(points, chain, fresh)
    return np.concatenate([triangles[~hit], np.array(fresh, np.int32).reshape(-1, 3)])


def _fill(points: Floats, chain: list[int], out: list[tuple[int, int, int]]) -> None:
    """Triangles of the polygon of a chain that its last vertex closes to its first, on the left of it."""
    todo = [chain]
    while todo:
        c = todo.pop()
        if len(c) < 3:
            continue
        a, b = points[c[-1]], points[c[0]]
        best = 1
        for k in range(2, len(c) - 1):
            if _in_circle(a, b, points[c[best]], points[c[k]]):
                best = k
        out.append((c[-1], c[0], c[best]))
        todo += [c[: best + 1], c[best:]]


def _in_circle(a: Floats, b: Floats, c: Floats, d: Floats) -> bool:
    m = np.stack([a - d, b - d, c - d])
    return bool(np.linalg.det(np.column_stack([m, np.sum(m * m, axis=1)])) * np.sign(_cross(b - a, c - a)) > 0)


def welded(mesh: PanelMesh, pairs: Ints | None = None) -> Ints:
    """(n,) the vertex of the garment that each vertex of the panels becomes when `pairs` (all) are sewn: 0..w-1, in order
    of first appearance."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    sewn, n = mesh.pairs if pairs is None else pairs, len(mesh.material)
    joined = connected_components(coo_array((np.ones(len(sewn)), (sewn[:, 0], sewn[:, 1])), (n, n)), directed=False)[1]
    _, first, place = np.unique(joined, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[place]


def boundary(triangles: Ints) -> Ints:
    """(b,2) edges of one triangle only, in its direction. Vertices without one are in none."""
    directed = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    keys = _keys(directed, int(triangles.max(initial=0)) + 1)
    _, inverse, count = np.unique(keys, return_inverse=True, return_counts=True)
    return directed[count[inverse] == 1]


def topology(triangles: Ints) -> tuple[int, int, int]:
    """How many pieces a surface (m,3) has, its Euler characteristic, and its boundary loops."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = int(triangles.max(initial=-1)) + 1
    used = np.unique(triangles)
    every = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    edges = len(np.unique(_keys(every, n)))

    def pieces(links: Ints) -> NDArray:
        return connected_components(coo_array((np.ones(len(links)), links.T), (n, n)), directed=False)[1]

    rim = boundary(triangles)
    return (
        len(np.unique(pieces(every)[used])),
        len(used) - edges + len(triangles),
        len(np.unique(pieces(rim)[np.unique(rim)])) if len(rim) else 0,
    )


def angles(mesh: PanelMesh) -> Floats:
    """(m,) smallest angle of each triangle, radians: the quality of a mesh."""
    p = mesh.material[mesh.triangles]
    out = np.full(len(p), np.pi)
    for k in range(3):
        u, v = p[:, (k + 1) % 3] - p[:, k], p[:, (k + 2) % 3] - p[:, k]
        out = np.minimum(out, np.abs(np.arctan2(_cross(u, v), np.sum(u * v, axis=1))))
    return out
