"""Bezier patches: smooth surfaces over nets of control points, subdivided evenly or as flatness asks, without cracks.

Patches name their control points by number, so neighbours share those of an edge. What is computed is a sparse matrix from
control points to vertices: positions, weights of a skin and whatever else control points carry go through the same matrix.

Sources: the Spline Surface plug-in of the modelling pipeline (bicubic patches of quads); control points of a mesh after
Loop and Schaefer, "Approximating Catmull-Clark subdivision surfaces with bicubic patches", 2008.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, vstack

from vitruvian.body.types import Floats, Ints, require

Whole = NDArray[np.int64]

DEEPEST = 6  # halvings: 65 x 65 vertices a patch
# Control points along the sides, in the direction in which a face goes round: u up, v up, u down, v down.
_SIDES = np.array([[[0, 0], [1, 0], [2, 0], [3, 0]], [[3, 0], [3, 1], [3, 2], [3, 3]],
                   [[3, 3], [2, 3], [1, 3], [0, 3]], [[0, 3], [0, 2], [0, 1], [0, 0]]])  # fmt: skip
_INNER = ((1, 1), (2, 1), (2, 2), (1, 2))
_CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
_HALF = np.array([[8, 0, 0, 0], [4, 4, 0, 0], [2, 4, 2, 0], [1, 3, 3, 1], [0, 2, 4, 2], [0, 0, 4, 4], [0, 0, 0, 8]]) / 8


@dataclass(frozen=True, eq=False)
class Patches:
    """nets (N,4,4): numbers of control points; [i, j] belongs to u = i/3 and v = j/3, and u x v points outwards.
    points (P,3), in metres."""

    points: Floats
    nets: Ints

    def __post_init__(self) -> None:
        nets = np.asarray(self.nets)
        require(nets.ndim == 3 and nets.shape[1:] == (4, 4), "nets", "(N,4,4) numbers of control points", nets.shape)
        inside = not nets.size or (nets.min() >= 0 and nets.max() < len(self.points))
        require(inside, "nets", f"numbers below {len(self.points)}", nets.max() if nets.size else 0)
        require(bool(np.isfinite(self.points).all()), "points", "finite numbers", "others")


@dataclass(frozen=True, eq=False)
class Refined:
    """A mesh of patches: matrix (V,P) times the control points: its vertices. faces (F,4), counterclockwise from outside;
    a triangle repeats its last vertex. patch (F,) and at (F,4,2): where on which patch (u, v) corners of faces lie.
    normals (V,3), unit, zero where nothing says where outside is."""

    matrix: csr_array
    faces: Ints
    patch: Ints
    at: Floats
    normals: Floats

    @property
    def triangles(self) -> Ints:
        """(T,3): faces cut along their diagonals."""
        f = self.faces
        both = np.stack([f[:, [0, 1, 2]], f[:, [0, 2, 3]]], axis=1).reshape(-1, 3)
        return np.ascontiguousarray(both[(both != np.roll(both, -1, axis=1)).all(axis=1)], np.int32)

    def corners(self, values: Floats) -> Floats:
        """(F,4,K) at corners of faces, of values (N,4,K) at corners of patches, a face's way round: texture coordinates
        may differ on both sides of an edge."""
        u, v = self.at[..., :1], self.at[..., 1:]
        a, b, c, d = np.moveaxis(values[self.patch], 1, 0)[:, :, None]
        return np.asarray((1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c))


def bernstein(t: Floats) -> Floats:
    """(n,4) cubic Bernstein polynomials at t (n,)."""
    s = 1 - t
    return np.stack([s**3, 3 * s * s * t, 3 * s * t * t, t**3], axis=-1)


def _slopes(t: Floats) -> Floats:
    s = 1 - t
    return np.stack([-3 * s * s, 3 * s * s - 6 * s * t, 6 * s * t - 3 * t * t, 3 * t * t], axis=-1)


def evaluate(patches: Patches, patch: Ints, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Points (n,3) and unit normals (n,3; zero where the patch is degenerate) at (u, v) (n,) of patches (n,)."""
    net = patches.points[patches.nets[patch]]
    along = lambda a, b: np.einsum("ni,nj,nijc->nc", a, b, net)  # noqa: E731
    place = along(bernstein(u), bernstein(v))
    normal = np.cross(along(_slopes(u), bernstein(v)), along(bernstein(u), _slopes(v)))
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    scale = np.ptp(net.reshape(len(net), 16, 3), axis=1).max(axis=1, initial=0)[:, None] ** 2
    return place, np.where(size > 1e-9 * scale, normal / np.where(size > 0, size, 1), 0.0)


def halved(net: Floats) -> Floats:
    """(N,2,2,4,4,C): the four quarters [u, v] of nets (N,4,4,C), by de Casteljau's rule."""
    both = np.einsum("ai,bj,nijc->nabc", _HALF, _HALF, net)
    return np.stack([np.stack([both[:, a : a + 4, b : b + 4] for b in (0, 3)], axis=1) for a in (0, 3)], axis=1)


def flatness(net: Floats) -> Floats:
    """(N,) the largest distance of the control points of nets (N,4,4,3) from the bilinear surface of their corners."""
    t = np.arange(4) / 3
    u = np.stack([1 - t, t], axis=1)
    flat = np.einsum("ia,jb,nabc->nijc", u, u, net[:, ::3, ::3])
    return np.asarray(np.linalg.norm(net - flat, axis=-1).max(axis=(1, 2), initial=0))


def levels(patches: Patches, tolerance: float, most: int = DEEPEST) -> Whole:
    """(N,) how often each patch is halved until all its parts are flat to `tolerance` (m), `most` times at most."""
    require(tolerance > 0, "tolerance", "metres above 0", tolerance)
    out = np.zeros(len(patches.nets), np.int64)
    net, owner = patches.points[patches.nets], np.arange(len(out))
    for _ in range(most):
        bent = flatness(net) > tolerance
        out[np.unique(owner[bent])] += 1
        net, owner = halved(net[bent]).reshape(-1, 4, 4, 3), np.repeat(owner[bent], 4)
    return out


def subdivided(patches: Patches, *, level: int | None = None, tolerance: float = 0.0005) -> Refined:
    """The mesh of patches, each halved `level` times in both directions, or as often as flatness to `tolerance` (m) asks.

    Neighbours that are halved differently meet in the vertices of the finer one: common edges have one set of vertices, so
    there are no cracks. Raises VitruvianError for a level that is not 0 to 6, or a tolerance of 0.
    """
    if level is not None:
        require(0 <= level <= DEEPEST, "level", f"0 to {DEEPEST}", level)
    deep = levels(patches, tolerance) if level is None else np.full(len(patches.nets), level)
    ends = patches.nets[:, _SIDES[..., 0], _SIDES[..., 1]].astype(np.int64)  # (N,4,4): control points along each side
    edge, back, edges, edge_deep = _edges(ends, deep)
    asked = np.concatenate([deep[:, None], edge_deep[edge]], axis=1)
    asked[:, 0] = np.where((asked[:, 1:] > asked[:, :1]).any(axis=1), np.maximum(asked[:, 0], 1), asked[:, 0])
    # Vertices: corners by their control points, then those within edges, then those within patches.
    used = np.unique(ends[:, :, [0, 3]])
    inner = 2**edge_deep - 1
    inner[(edges == edges[:, :1]).all(axis=1)] = 0  # an edge without length is its corner
    first = len(used) + np.concatenate([[0], np.cumsum(inner)])
    count = int(first[-1])
    cells, owners, places, values, faces, patch, at = [], [], [], [], [], [], []
    for signature in np.unique(asked, axis=0):
        shape = _shape(*signature.tolist())
        some = np.flatnonzero((asked == signature).all(axis=1))
        ids = np.empty((len(some), len(shape.at)), np.int64)
        ids[:, :4] = np.searchsorted(used, ends[some, :, 0])
        for s in range(4):
            here, k = shape.sides[s], np.arange(1, len(shape.sides[s]) + 1)
            e = edge[some, s]
            along = np.where(back[some, s, None], len(k) + 1 - k, k) - 1
            ids[:, here] = np.where(inner[e, None] > 0, first[e, None] + along, ids[:, s : s + 1])
        within = shape.at.shape[0] - shape.inner
        ids[:, shape.inner :] = count + np.arange(len(some) * within).reshape(len(some), within)
        count += len(some) * within
        weight = np.einsum("ti,tj->tij", bernstein(shape.at[:, 0]), bernstein(shape.at[:, 1])).reshape(-1, 16)
        cells.append(ids.ravel())
        owners.append(np.repeat(some, len(shape.at)))
        places.append(np.tile(shape.at, (len(some), 1)))
        values.append(np.tile(weight, (len(some), 1)))
        faces.append(ids[:, shape.faces].reshape(-1, 4))
        patch.append(np.repeat(some, len(shape.faces)))
        at.append(np.tile(shape.at[shape.faces], (len(some), 1, 1)))
    if not len(asked):
        none = np.zeros((0, 4), np.int32)
        return Refined(csr_array((0, len(patches.points))), none, none[:, 0], np.zeros((0, 4, 2)), np.zeros((0, 3)))
    cell, owner, place, value = (np.concatenate(x) for x in (cells, owners, places, values))
    vertex, chosen = np.unique(cell, return_index=True)  # one patch computes what several share
    rows, columns = np.repeat(np.arange(len(vertex)), 16), patches.nets[owner[chosen]].reshape(-1)
    matrix = csr_array(coo_array((value[chosen].ravel(), (rows, columns)), shape=(len(vertex), len(patches.points))))
    matrix.sum_duplicates()
    matrix.eliminate_zeros()
    lean = np.zeros((count, 3))
    np.add.at(lean, cell, evaluate(patches, owner, place[:, 0], place[:, 1])[1])
    number = np.zeros(count, np.int64)
    number[vertex] = np.arange(len(vertex))
    whole, kept = _sound(number[np.concatenate(faces)])
    corners = np.take_along_axis(np.concatenate(at), kept[1][..., None], axis=1)[kept[0]]
    normals = _normals(lean[vertex], matrix @ patches.points, whole)
    return Refined(matrix, whole.astype(np.int32), np.concatenate(patch)[kept[0]].astype(np.int32), corners, normals)


def _edges(ends: Whole, deep: Whole) -> tuple[Whole, NDArray[np.bool_], Whole, Whole]:
    """Which edge each side (N,4) is, whether it goes against it, the edges (E,4), and how often each is halved: as often as
    the patch beside it that is halved most."""
    back = ends[..., 0] > ends[..., 3]
    same = ends[..., 0] == ends[..., 3]
    back |= same & (ends[..., 1] > ends[..., 2])
    forward = np.where(back[..., None], ends[..., ::-1], ends)
    edges, edge = np.unique(forward.reshape(-1, 4), axis=0, return_inverse=True)
    edge = edge.reshape(back.shape)
    out = np.zeros(len(edges), np.int64)
    np.maximum.at(out, edge, deep[:, None])
    return edge, back, edges, out


@dataclass(frozen=True, eq=False)
class _Shape:
    """Vertices (T,2) of a patch as (u, v): four corners, those within its sides, those inside from `inner` on; faces."""

    at: Floats
    sides: list[Ints]
    inner: int
    faces: Ints


@lru_cache(maxsize=256)
def _shape(n: int, *sides: int) -> _Shape:
    """A patch halved n times whose sides are halved as often or more."""
    m = 2**n
    at, rows, first = [*_CORNERS], [], 4
    for s, e in enumerate(sides):
        t = np.arange(1, 2**e)[:, None] / 2**e
        at.extend((1 - t) * _CORNERS[s] + t * _CORNERS[(s + 1) % 4])
        rows.append(np.arange(first, first + 2**e - 1))
        first += 2**e - 1
    grid = np.arange((m - 1) ** 2).reshape(m - 1, m - 1) + first  # [i - 1, j - 1]
    at.extend(np.array([i, j]) / m for i in range(1, m) for j in range(1, m))
    whole = np.empty((m + 1, m + 1), np.int64)
    whole[1:-1, 1:-1] = grid
    even = all(e == n for e in sides)
    if even:
        whole[[0, m, m, 0], [0, 0, m, m]] = range(4)
        whole[1:-1, 0], whole[m, 1:-1], whole[1:-1, m], whole[0, 1:-1] = rows[0], rows[1], rows[2][::-1], rows[3][::-1]
    quads = whole if even else grid
    faces = np.stack([quads[:-1, :-1], quads[1:, :-1], quads[1:, 1:], quads[:-1, 1:]], axis=-1).reshape(-1, 4).tolist()
    if even:
        return _Shape(np.array(at), rows, first, np.array(faces))
    near = (grid[:, 0], grid[-1, :], grid[::-1, -1], grid[0, ::-1])  # the innermost row beside each side
    for s, e in enumerate(sides):
        faces += _strip([s, *rows[s].tolist(), (s + 1) % 4], near[s].tolist(), 2 ** (e - n))
    return _Shape(np.array(at), rows, first, np.array(faces))


def _strip(outer: list[int], inner: list[int], ratio: int) -> list[list[int]]:
    """Faces between a side of a patch and the row within it, without its ends and with one vertex for `ratio` outside."""
    out = []
    last = len(inner) - 1
    for k in range(len(outer) - 1):
        i = min(max((2 * k + ratio) // (2 * ratio) - 1, 0), last)  # the nearest one at the start and at the end
        j = min(max((2 * k + 2 + ratio) // (2 * ratio) - 1, 0), last)
        out.append([outer[k], outer[k + 1], inner[j], inner[i]])
    return out


def _sound(faces: Whole) -> tuple[Whole, tuple[Whole, Whole]]:
    """Faces with three or four different corners, triangles with the last one twice; which faces these are, and
    which of the given corners (of all faces, (F,4)) theirs are."""
    keep = faces != np.roll(faces, -1, axis=1)  # of corners that follow each other and are one, the last stays
    order = np.argsort(~keep, axis=1, kind="stable")
    number = keep.sum(axis=1)
    order[number == 3, 3] = order[number == 3, 2]
    some = np.flatnonzero(number >= 3)
    return np.take_along_axis(faces, order, axis=1)[some], (some, order)


def _normals(sums: Floats, points: Floats, faces: Whole) -> Floats:
    """Unit normals of `sums`, and where they are zero those of the faces around."""
    size = np.linalg.norm(sums, axis=1)
    bare = size < 1e-6
    if bare.any():
        a, b, c, d = (points[faces[:, k]] for k in range(4))
        area, out = np.cross(c - a, d - b), np.zeros_like(points)
        for k in range(4):
            np.add.at(out, faces[:, k], area)
        sums = np.where(bare[:, None], out, sums)
        size = np.linalg.norm(sums, axis=1)
    return np.asarray(sums / np.where(size > 0, size, 1)[:, None])


def patches_of(points: Floats, quads: Ints) -> tuple[Patches, csr_array]:
    """One patch for each quad (F,4) of a mesh with points (V,3), near its Catmull-Clark limit surface; and the matrix (P,V)
    that makes control points from the mesh's own, with which its weights become theirs.

    Smooth across edges, and smooth but for tangents at vertices with other than four quads; borders are cubic B-splines.
    Raises VitruvianError for faces that are no quads and for edges of more than two of them.
    """
    quads = np.asarray(quads, np.int64)
    require(quads.ndim == 2 and quads.shape[1] == 4, "quads", "(F,4)", quads.shape)
    inside = not quads.size or bool(quads.min() >= 0 and quads.max() < len(points))
    require(inside, "quads", f"indices below {len(points)}", quads.max() if quads.size else 0)
    ordered = np.sort(quads, axis=1)
    bad = np.flatnonzero((ordered[:, 1:] == ordered[:, :-1]).any(axis=1))
    require(not len(bad), "quads", "four different corners each", f"quad {bad[0] if len(bad) else 0} repeats one")
    count = len(points)
    start, stop = quads, np.roll(quads, -1, axis=1)
    sides = np.stack([np.minimum(start, stop), np.maximum(start, stop)], axis=-1).reshape(-1, 2)
    edges, edge, shared = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(quads.shape)
    crowded = np.flatnonzero(shared > 2)
    place = edges[crowded[0]].tolist() if len(crowded) else []
    require(not len(crowded), "quads", "edges with one or two quads", f"{shared.max(initial=0)} at edge {place}")
    border = shared == 1
    around = np.bincount(quads.ravel(), minlength=count)
    rim = np.bincount(edges[border].ravel(), minlength=count)
    whole = np.where(rim > 0, 2 * around, around)  # as if a border were mirrored

    eye = lambda at: coo_array((np.ones(len(at)), (np.arange(len(at)), at)), shape=(len(at), count)).tocsr()  # noqa: E731
    times = lambda by, m: csr_array(m.multiply(np.reshape(np.asarray(by, float), (-1, 1))))  # noqa: E731
    corner = [eye(quads[:, k]) for k in range(4)]
    inner = []  # beside each corner of each face
    for k in range(4):
        n = whole[quads[:, k]]
        nearby = corner[(k + 1) % 4] * 2 + corner[(k + 3) % 4] * 2 + corner[(k + 2) % 4]
        inner.append(times(1 / (n + 5), times(n, corner[k]) + nearby))
    # Two points on each edge, from its smaller end on; inside the mesh the middle of the inner ones on both sides.
    ends: list[csr_array] = []
    for side in (0, 1):
        total = csr_array((len(edges), count))
        for k in range(4):
            for at, m in ((start[:, k], inner[k]), (stop[:, k], inner[(k + 1) % 4])):
                some = np.flatnonzero(at == edges[edge[:, k], side])
                ones = coo_array((np.full(len(some), 0.5), (edge[some, k], some)), shape=(len(edges), len(quads)))
                total = total + ones.tocsr() @ m
        free = times(1 / 3, eye(edges[:, side]) * 2 + eye(edges[:, 1 - side]))
        ends.append(csr_array(times(~border, total) + times(border, free)))
    mean = csr_array((count, count))
    for k in range(4):
        mean = (
            mean
            + coo_array((np.ones(len(quads)), (quads[:, k], np.arange(len(quads)))), shape=(count, len(quads)))
            @ inner[k]
        )
    line = csr_array((count, count))
    for side in (0, 1):
        rows = edges[border]
        ones = coo_array((np.ones(len(rows)), (rows[:, side], rows[:, 1 - side])), shape=(count, count))
        line = line + ones
    own = eye(np.arange(count))
    smooth, curve = rim == 0, (rim == 2) & (around > 1)
    tops = (
        times(smooth / np.maximum(around, 1), mean)
        + times(curve / 6, own * 4 + line)
        + times(~smooth & ~curve | (around == 0), own)
    )
    matrix = csr_array(vstack([tops, *ends, *inner], format="csr"))
    first = count + 2 * len(edges)
    nets = np.empty((len(quads), 4, 4), np.int64)
    for k in range(4):
        (a, b, c, _), (i, j) = _SIDES[k], _INNER[k]
        turned = start[:, k] > stop[:, k]
        nets[:, a[0], a[1]] = quads[:, k]
        nets[:, b[0], b[1]] = count + edge[:, k] + turned * len(edges)
        nets[:, c[0], c[1]] = count + edge[:, k] + ~turned * len(edges)
        nets[:, i, j] = first + k * len(quads) + np.arange(len(quads))
    return Patches(matrix @ np.asarray(points, np.float64), nets.astype(np.int32)), matrix
