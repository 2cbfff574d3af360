"""More points for a body: its skin on smooth patches, evenly finer or as flatness asks.

Source: the Spline Surface plug-in (seed 003, table 1; note body.md, section 6); surfaces are those of `patches_of`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from vitruvian.body.types import Floats, require
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Displacer, Humanoid, Shape
from vitruvian.modeling.patches import Refined, patches_of, subdivided

Whole = NDArray[np.int64]

_MOST = 3_000_000  # faces
_LEAST_MOVE = 1e-9  # metres


def smoother(humanoid: Humanoid, *, level: int | None = 1, tolerance: float | None = None) -> Humanoid:
    """A copy whose skin lies on one smooth patch per quad of the skin, or three per triangle.

    Every edge is halved `level` times, or patches until they are flat to `tolerance` (m). Neighbours meet without cracks;
    points at one place are one, so seams stay closed. Weights, displacers and animated points go through the matrix of the
    patches, weights are made to sum to what they did; texture coordinates and colours are bilinear on each face. As with
    Catmull and Clark's surfaces, bumps get a little flatter. Metres, humanoid space. Raises VitruvianError for a figure
    without a skin, an edge of more than two faces, and for more than 3 million faces.
    """
    require((level is None) != (tolerance is None), "level, tolerance", "one of them", (level, tolerance))
    shapes = [s for s in humanoid.skin if s.points is None and len(s.triangles)]
    if not shapes:
        raise VitruvianError(
            f"humanoid {humanoid.name!r}: expected a skin to make smoother, found none; `vt.weld` makes one"
        )
    require(level is None or level >= 0, "level", "0 or more", level)
    if level == 0:
        return humanoid.copied()
    places, first, vertex = np.unique(humanoid.skin_coord + 0.0, axis=0, return_index=True, return_inverse=True)
    vertex = vertex.reshape(-1)
    net = _Net(shapes, vertex, len(places))
    _check(net, vertex, first, shapes)
    depth = None if level is None else level - (not net.plain)
    if depth is not None and len(net.quads) * 4.0**depth > _MOST:
        raise VitruvianError(f"level {level}: expected at most {_MOST} faces, found {len(net.quads) * 4**depth}")
    patches, control = patches_of(net.matrix @ places, net.quads)
    fine = subdivided(patches, level=depth) if tolerance is None else subdivided(patches, tolerance=tolerance)
    if len(fine.faces) > _MOST:
        raise VitruvianError(
            f"flatness: expected at most {_MOST} faces, found {len(fine.faces)}; allow more millimetres"
        )
    matrix = csr_array(fine.matrix @ control @ net.matrix)
    return _carried(humanoid, shapes, net, fine, matrix, (first, vertex))


class _Net:
    """Quads (N,4) that patches are made of, `owner` (N,) their shapes, and `matrix` that makes their points from the skin's
    places. With triangles among the faces (not `plain`) every face is cut into quads about its middle."""

    def __init__(self, shapes: list[Shape], vertex: Whole, places: int):
        triangles = np.concatenate([vertex[s.triangles] for s in shapes])
        owner = np.repeat(np.arange(len(shapes)), [len(s.triangles) for s in shapes])
        threes, fours = _polygons(shapes, triangles)
        self.plain = not len(threes)
        self.loops = [fours] if self.plain else [threes, fours]
        flat = triangles.ravel()
        self.owner = np.concatenate([owner[x[:, 0] // 3].repeat(1 if self.plain else x.shape[1]) for x in self.loops])
        if self.plain:
            self.quads, self.matrix = flat[fours], csr_array(coo_array((np.ones(places), (np.arange(places),) * 2)))
            return
        faces = [flat[x] for x in self.loops]
        sides = [np.stack([f, np.roll(f, -1, axis=1)], axis=-1) for f in faces]
        ends = np.sort(np.concatenate([x.reshape(-1, 2) for x in sides]), axis=1)
        edges, number = np.unique(ends, axis=0, return_inverse=True)
        number, quads, done, middle = number.reshape(-1), [], 0, places + len(edges)
        rows, columns, values = [np.arange(places)], [np.arange(places)], [np.ones(places)]
        rows.append(places + np.repeat(np.arange(len(edges)), 2))
        columns.append(edges.ravel())
        values.append(np.full(edges.size, 0.5))
        for f in faces:
            mids = places + number[done : done + f.size].reshape(f.shape)
            center = middle + np.arange(len(f))
            done, middle = done + f.size, middle + len(f)
            whole = np.broadcast_to(center[:, None], f.shape)
            quads.append(np.stack([f, mids, whole, np.roll(mids, 1, axis=1)], axis=-1).reshape(-1, 4))
            rows.append(np.repeat(center, f.shape[1]))
            columns.append(f.ravel())
            values.append(np.full(f.size, 1 / f.shape[1]))
        self.quads = np.concatenate(quads)
        ones = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        self.matrix = csr_array(coo_array(ones, shape=(middle, places)))

    def values(self, corner: Floats) -> Floats:
        """(N,4,K) at the corners of quads, of values (3T,K) at the corners of all triangles."""
        if self.plain:
            return np.asarray(corner[self.loops[0]])
        out = []
        for loop in self.loops:
            a = corner[loop]
            mids = (a + np.roll(a, -1, axis=1)) / 2
            center = np.broadcast_to(a.mean(axis=1, keepdims=True), a.shape)
            quads = np.stack([a, mids, center, np.roll(mids, 1, axis=1)], axis=2)
            out.append(quads.reshape(-1, 4, corner.shape[1]))
        return np.concatenate(out)


def _check(net: _Net, vertex: Whole, first: Whole, shapes: list[Shape]) -> None:
    """VitruvianError for an edge of more than two faces, by points of the skin."""
    flat = np.concatenate([vertex[s.triangles] for s in shapes]).ravel()
    sides = [np.stack([flat[x], np.roll(flat[x], -1, axis=1)], axis=-1).reshape(-1, 2) for x in net.loops]
    edges, many = np.unique(np.sort(np.concatenate(sides), axis=1), axis=0, return_counts=True)
    if (many > 2).any():
        worst = int(np.argmax(many))
        a, b = first[edges[worst]].tolist()
        raise VitruvianError(
            f"skin: expected edges of one or two faces, found {many[worst]} at points {a} and {b}; take double faces away"
        )


def _polygons(shapes: list[Shape], triangles: Whole) -> tuple[Whole, Whole]:
    """(n,3) triangles and (m,4) quads, put together again from two triangles, as numbers of corners: 3 t + k."""
    sound = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    polygon, start = [], 0
    for s in shapes:
        own = np.arange(len(s.triangles)) if s.faces is None else np.asarray(s.faces, np.int64)
        polygon.append(own + start)
        start += int(own.max(initial=-1)) + 1
    number = np.concatenate(polygon)
    _, group, size = np.unique(number, return_inverse=True, return_counts=True)
    group = group.reshape(-1)
    order = np.argsort(group, kind="stable")
    begin = np.cumsum(size) - size
    two = np.flatnonzero(size == 2)
    a, b = order[begin[two]], order[begin[two] + 1]
    fours, paired = [np.zeros((0, 4), np.int64)], np.zeros(len(triangles), bool)
    for k in range(3):
        for m in range(3):
            meet = (triangles[a, k] == triangles[b, (m + 1) % 3]) & (triangles[a, (k + 1) % 3] == triangles[b, m])
            meet &= (triangles[a, (k + 2) % 3] != triangles[b, (m + 2) % 3]) & sound[a] & sound[b] & ~paired[a]
            p, q = a[meet], b[meet]
            fours.append(np.stack([3 * p + k, 3 * q + (m + 2) % 3, 3 * p + (k + 1) % 3, 3 * p + (k + 2) % 3], axis=1))
            paired[p] = paired[q] = True
    alone = np.flatnonzero(sound & ~paired)
    return 3 * alone[:, None] + np.arange(3), np.concatenate(fours)


def _carried(
    humanoid: Humanoid, shapes: list[Shape], net: _Net, fine: Refined, matrix: csr_array, welded: tuple[Whole, Whole]
) -> Humanoid:
    first, vertex = welded
    count = len(humanoid.skin_coord)
    out = humanoid.copied()
    out.skin_coord = matrix @ (humanoid.skin_coord + 0.0)[first]
    out.skin_normal = out.skin_binding_normals = None
    given = humanoid.skin_binding_coords
    out.skin_binding_coords = matrix @ given[first] if given is not None and len(given) == count else None
    owner = net.owner[fine.patch]
    made = {id(s): _finer(s, n, shapes, net, fine, owner) for n, s in enumerate(shapes)}
    out.skin = [made.get(id(s), s) for s in humanoid.skin if s.points is not None or id(s) in made]
    for joint in out.joints():
        n = min(len(joint.skin_coord_index), len(joint.skin_coord_weight))
        full = np.zeros(count)
        np.add.at(full, joint.skin_coord_index[:n], joint.skin_coord_weight[:n])
        new = matrix @ full[first]
        joint.skin_coord_index = np.flatnonzero(new > 1e-6).astype(np.int32)
        joint.skin_coord_weight = new[joint.skin_coord_index]
        joint.displacers = [m for d in joint.displacers if (m := _displaced(d, matrix, first, count)) is not None]
    out.skin_displacers = [
        m for d in humanoid.skin_displacers if (m := _displaced(d, matrix, first, count)) is not None
    ]
    tracks = []
    for t in humanoid.tracks:
        if not t.target and t.field == "point" and t.values.shape[-1] == 3 * count:
            keys = [(matrix @ v.reshape(-1, 3)[first]).ravel() for v in t.values]
            t = replace(t, values=np.array(keys).reshape(len(t.values), -1))
        tracks.append(t)
    out.tracks = tracks
    return out.settled()


def _displaced(d: Displacer, matrix: csr_array, first: Whole, count: int) -> Displacer | None:
    full = np.zeros((count, 3))
    if d.marks:
        full[d.coord_index] = 1.0
        some = np.flatnonzero((matrix @ full[first])[:, 0] > 0.5).astype(np.int32)
        return replace(d, coord_index=some, displacements=np.zeros((len(some), 3)), node=None) if len(some) else None
    full[d.coord_index] = d.displacements
    moves = matrix @ full[first]
    some = np.flatnonzero(np.abs(moves).max(axis=1, initial=0) > _LEAST_MOVE).astype(np.int32)
    return replace(d, coord_index=some, displacements=moves[some], node=None) if len(some) else None


def _finer(shape: Shape, number: int, shapes: list[Shape], net: _Net, fine: Refined, owner: Whole) -> Shape:
    """A shape of the faces of its own patches."""
    mine = owner == number
    faces = fine.faces[mine]
    cut = np.array([[0, 1, 2], [0, 2, 3]])
    triangles = faces[:, cut].reshape(-1, 3)
    sound = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    polygons = np.repeat(np.arange(len(faces)), 2)[sound].astype(np.int32)
    before = 3 * sum(len(s.triangles) for s in shapes[:number])
    corners = 3 * sum(len(s.triangles) for s in shapes)

    def at(values: Floats) -> Floats:
        """(F,4,K) at corners of faces, of values at the corners of the shape's triangles."""
        full = np.zeros((corners, values.shape[1]))
        full[before : before + len(values)] = values
        return np.asarray(fine.corners(net.values(full))[mine])

    uv, uv_triangles, colors = None, None, None
    if shape.uv is not None:
        known = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
        places = at(shape.uv[known.ravel()])
        uv, where = np.unique(places.reshape(-1, 2), axis=0, return_inverse=True)
        uv_triangles = where.reshape(-1, 4)[:, cut].reshape(-1, 3)[sound].astype(np.int32)
    if shape.colors is not None:
        colors = np.full((fine.matrix.shape[0], 3), 0.8)
        colors[faces.ravel()] = np.clip(at(shape.colors[shape.triangles.ravel()]).reshape(-1, 3), 0, 1)
    return replace(
        shape, triangles=triangles[sound].astype(np.int32), uv=uv, uv_triangles=uv_triangles, colors=colors, normals=None,
        normal_triangles=None, faces=polygons, node=None,
    )  # fmt: skip
