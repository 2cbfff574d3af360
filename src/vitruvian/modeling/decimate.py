"""Levels of detail of a body: each a subset of the points of the finer one, with their weights, looks and displacers.

Points never move, so a point of a coarse level is where it is at full detail in every pose, and a level can be changed
while it moves. What has no skin but contours has levels of its own: `vitruvian.modeling.detail`.
Source: levels of detail of bodies as point subsets (seed 000, 4.2; note body.md, section 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, hstack

from vitruvian.body.rotations import unit
from vitruvian.body.types import Floats, Ints
from vitruvian.errors import VitruvianError, warn
from vitruvian.hanim.humanoid import Humanoid, Shape
from vitruvian.modeling.collapse import Surface
from vitruvian.modeling.flesh_rays import Flesh, everywhere
from vitruvian.modeling.rows import chosen
from vitruvian.motion.names import joint_index

_WEIGHTS = 0.03  # metres: how far off the surface counts as much as weights that are all another joint's
_COLORS = 0.01  # metres, for black beside white
_LOOKED_AT = {
    "skullbase": 40.0,
    "l_radiocarpal": 20.0,
    "r_radiocarpal": 20.0,
}  # errors there and below count so much more
_HIDDEN = 0.05  # what errors count where nobody sees them at rest
_WAYS, _OFF = 20, 1e-4  # directions in which faces look for the open, and metres from them where they begin to
_SITE = 1e-3  # metres from a feature point on the skin to the point that stays for it
_LOOSE = 64  # pieces of a surface under so many triangles (strands of hair, lashes) may go whole
_LOOSE_SHARE = 0.3  # of the points of a level that such pieces may have at most
_LEAST = 4  # points


@dataclass(frozen=True, eq=False)
class Level:
    """One level of detail. `humanoid`: its skin points are the first of those of every finer level, to the bit.

    `error` (mean, 95th percentile, largest), metres: distances of the full surface's points, without loose pieces (hair)
    that went whole, from this level's surface. `lost`: what it no longer has.
    """

    humanoid: Humanoid
    points: int
    triangles: int
    error: tuple[float, float, float]
    lost: tuple[str, ...] = ()


def decimate(humanoid: Humanoid, points: int) -> Humanoid:
    """A copy whose skin has at most `points` of its own points, where half-edge collapses can reach that.

    Weights, colours, texture coordinates and displacers are rows of the finer ones; seams of textures, borders of looks and
    what is closed stay so; points of Sites on the skin stay. Figures made of Segments are welded, decimated and cut again.
    Contour surfaces stay as they are. Metres, humanoid space. Raises VitruvianError for fewer than 4 points and for a
    figure without a skin; warns when so few cannot be reached.
    """
    return levels(humanoid, [points])[-1].humanoid


def levels(humanoid: Humanoid, points: Sequence[int]) -> list[Level]:
    """The whole body, its points in the order in which levels have them, then a level for each of `points`, e.g.
    (6300, 1900, 800): level k has the first n_k points of level k - 1. See `decimate`."""
    wanted = list(points)
    if not wanted or min(wanted) < _LEAST or any(b >= a for a, b in zip(wanted, wanted[1:])):
        raise VitruvianError(
            f"levels of detail: expected falling numbers of points, the last {_LEAST} or more, found {wanted}"
        )
    segmented = not any(s.points is None and len(s.triangles) for s in humanoid.skin)
    if segmented:
        from vitruvian.hanim.segmenting import segment
        from vitruvian.hanim.welding import weld

        skinned = weld(humanoid)
        if not any(s.points is None and len(s.triangles) for s in skinned.skin):
            raise VitruvianError(
                f"humanoid {humanoid.name!r}: expected a skin or Segments with surfaces, found neither"
            )
        return [replace(level, humanoid=segment(level.humanoid)) for level in _levels(skinned, wanted)]
    return _levels(humanoid, wanted)


def _levels(humanoid: Humanoid, wanted: list[int]) -> list[Level]:
    shapes = [s for s in humanoid.skin if s.points is None]
    mesh = _Mesh(humanoid, shapes)
    surface = mesh.surface
    found = [mesh.faces(shapes)]
    stays = np.ones(len(surface.place), bool)
    for goal in wanted:
        dropped = _thinned(surface, mesh.point_of, goal)
        stays[dropped] = False
        while (left := mesh.count() - goal) > 0 and surface.collapsed(left):
            pass
        if mesh.count() > goal:
            warn(
                f"{goal} points: expected a surface that can have so few, found {mesh.count()} that keep its pieces apart"
            )
        found.append(mesh.faces(shapes))
    used = [np.unique(np.concatenate([f for f, _ in level])) for level in found]
    times = np.zeros(len(humanoid.skin_coord), np.int64)
    for some in used:
        times[some] += 1
    order = np.argsort(-times, kind="stable")[: len(used[0])]
    out = []
    names = [d.name for d in humanoid.displacers()]
    for some, level in zip(used, found, strict=True):
        skin = [_with(s, f, uv) for s, (f, uv) in zip(shapes, level, strict=True)]
        gone = [
            f"shape {s.name}: too small for this level"
            for s, t in zip(shapes, skin, strict=True)
            if len(s.triangles) > len(t.triangles) == 0
        ]
        body = replace(
            humanoid.copied(),
            skin=[*(s for s in skin if len(s.triangles)), *(s for s in humanoid.skin if s.points is not None)],
        )
        made = chosen(body, order[: len(some)].astype(np.int32)).settled()
        here = {d.name for d in made.displacers()}
        gone += [f"displacer {n}: none of its points is left" for n in names if n not in here]
        faces = np.concatenate([f for f, _ in level])
        error = (0.0, 0.0, 0.0) if level is found[0] else _error(humanoid.skin_coord, mesh, stays, used[0], faces)
        out.append(Level(made, len(some), len(faces), error, tuple(gone)))
    return out


class _Mesh:
    """All moving shapes of a skin as one surface: points at one place are one vertex, whatever their looks."""

    def __init__(self, humanoid: Humanoid, shapes: list[Shape]):
        points = np.asarray(humanoid.skin_coord, np.float64)
        triangles = np.concatenate([np.asarray(s.triangles, np.int64) for s in shapes])
        used = np.unique(triangles)
        place, first, vertex = np.unique(points[used] + 0.0, axis=0, return_index=True, return_inverse=True)
        self.vertex = np.zeros(len(points), np.int64)
        self.vertex[used] = vertex.reshape(-1)
        owner = np.repeat(np.arange(len(shapes)), [len(s.triangles) for s in shapes])
        corners = np.concatenate([_corners(s) for s in shapes])
        key = np.stack([np.repeat(owner, 3), triangles.ravel(), corners.ravel()], axis=1)
        self.wedge, wedges = np.unique(key, axis=0, return_inverse=True)
        self.point_of, self.owner = self.wedge[:, 1], owner
        weights = _weights(humanoid)[used[first]]
        features = csr_array(hstack([weights * _WEIGHTS, csr_array(_colors(shapes, used[first]) * _COLORS)]))
        faces = self.vertex[triangles]
        both = np.repeat([s.material.double_sided for s in shapes], [len(s.triangles) for s in shapes])
        important = _importance(humanoid, weights)[faces].mean(axis=1)
        important *= np.where(_seen(place, faces, both), 1, _HIDDEN)
        held = np.zeros(len(place), bool)
        held[_sites(humanoid, place)] = True
        held[self.vertex[_sewn(humanoid)]] = True
        self.surface = Surface(
            place,
            faces,
            wedges.reshape(-1, 3),
            importance=important,
            features=features,
            held=held,
        )

    def count(self) -> int:
        """How many points of the skin are in use."""
        return len(np.unique(self.point_of[np.unique(self.surface.wedges)]))

    def faces(self, shapes: list[Shape]) -> list[tuple[Ints, Ints]]:
        """For each shape triangles (t,3) of skin points and of texture coordinates, as they are now."""
        owner = self.owner[self.surface.source]
        at = [self.surface.wedges[owner == n] for n in range(len(shapes))]
        return [(self.wedge[w, 1].astype(np.int32), self.wedge[w, 2].astype(np.int32)) for w in at]


def _corners(shape: Shape) -> NDArray[np.int64]:
    """(t,3) texture coordinates of corners that have them apart from their points, else 0."""
    if shape.uv is None or shape.uv_triangles is None:
        return np.zeros((len(shape.triangles), 3), np.int64)
    return np.asarray(shape.uv_triangles, np.int64)


def _with(shape: Shape, triangles: Ints, corners: Ints) -> Shape:
    """A shape with other triangles of the same points; unused texture coordinates go."""
    uv, uv_triangles = shape.uv, None
    if shape.uv is not None and shape.uv_triangles is not None:
        used, flat = np.unique(corners, return_inverse=True)
        uv, uv_triangles = shape.uv[used], flat.reshape(-1, 3).astype(np.int32)
    normals = shape.normals if shape.normal_triangles is None else None
    return replace(
        shape, triangles=triangles, uv=uv, uv_triangles=uv_triangles, normals=normals, normal_triangles=None, faces=None,
        node=None,
    )  # fmt: skip


def _weights(humanoid: Humanoid) -> csr_array:
    """(V,J) weights of the skin's points."""
    rows, columns, values = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    joints = humanoid.joints()
    for number, joint in enumerate(joints):
        n = min(len(joint.skin_coord_index), len(joint.skin_coord_weight))
        rows.append(np.asarray(joint.skin_coord_index[:n], np.int64))
        columns.append(np.full(n, number))
        values.append(np.asarray(joint.skin_coord_weight[:n], np.float64))
    ends = (np.concatenate(rows), np.concatenate(columns))
    shape = (len(humanoid.skin_coord), max(1, len(joints)))
    return csr_array(coo_array((np.concatenate(values), ends), shape=shape))


def _colors(shapes: list[Shape], points: Ints) -> Floats:
    """(n,3) colours of points: of the last shape that paints them, or grey."""
    out = np.full((int(points.max(initial=-1)) + 1, 3), 0.8)
    for shape in shapes:
        if shape.colors is not None:
            used = np.unique(shape.triangles)
            used = used[(used < len(out)) & (used < len(shape.colors))]
            out[used] = shape.colors[used]
    return out[points]


def _importance(humanoid: Humanoid, weights: csr_array) -> Floats:
    """(C,) how much errors count at vertices with weights (C,J): more where people look."""
    joints = humanoid.joints()
    index, number = joint_index([j.name for j in joints]), {id(j): n for n, j in enumerate(joints)}
    more = np.zeros(weights.shape[1])
    for name, factor in _LOOKED_AT.items():
        if name in index:
            more[[number[id(j)] for j in joints[index[name]].walk()]] = factor - 1
    return np.asarray(1 + weights @ more)


def _seen(place: Floats, faces: NDArray[np.int64], both: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(t,) which faces have a way out into the open from their outer side, or, with `both`, from one of them."""
    a, b, c = np.moveaxis(place[faces], 1, 0)
    outward = unit(np.cross(b - a, c - a))
    flesh, ways = Flesh(place, faces.astype(np.int32)), everywhere(_WAYS)
    out = np.zeros(len(faces), bool)
    for side in (1.0, -1.0):
        some = np.flatnonzero(~out & (both | (side > 0)))
        face, way = np.nonzero(side * outward[some] @ ways.T > 0.1)
        face = some[face]
        eyes = ((a + b + c) / 3 + side * _OFF * outward)[face]
        free = np.isinf(flesh.look(eyes, ways[way])[0])
        out[face[free]] = True
    return out


def _sites(humanoid: Humanoid, place: Floats) -> NDArray[np.int64]:
    """Vertices that Sites are on."""
    from scipy.spatial import cKDTree

    where = np.array([s.center + s.translation for s in humanoid.all_sites()]).reshape(-1, 3)
    if not len(where) or not len(place):
        return np.zeros(0, np.int64)
    far, near = cKDTree(place).query(where)
    return np.unique(near[far < _SITE])


def _sewn(humanoid: Humanoid) -> Ints:
    """Points of the skin that hang on contours."""
    if not any(s.contours for s in humanoid.segments()):
        return np.zeros(0, np.int32)
    from vitruvian.body.pack import pack

    return np.concatenate([np.zeros(0, np.int32), *(c.tied[:, 0] for c in pack(humanoid).contours)])


def _thinned(surface: Surface, point_of: Ints, goal: int) -> NDArray[np.int64]:
    """Take some loose pieces away, evenly over the surface, so that the rest of them fits a level; their vertices."""
    piece = surface.pieces() if len(surface.faces) else np.zeros(0, np.int64)
    size = np.bincount(piece)
    loose = np.flatnonzero(size < _LOOSE)
    keep = max(1, int(goal * _LOOSE_SHARE / _LEAST))
    if len(size) == len(loose) or len(loose) <= keep:
        return np.zeros(0, np.int64)
    kept = loose[np.unique(np.linspace(0, len(loose) - 1, keep).round().astype(int))]
    gone = np.isin(piece, np.setdiff1d(loose, kept))
    lost = np.unique(surface.faces[gone])
    surface.without(gone)
    return lost


def _error(
    points: Floats, mesh: _Mesh, stays: NDArray[np.bool_], used: Ints, faces: Ints
) -> tuple[float, float, float]:
    import igl

    some = used[stays[mesh.vertex[used]]]
    rows, flat = np.unique(faces, return_inverse=True)
    there = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points[some]), np.ascontiguousarray(points[rows]), flat.reshape(-1, 3).astype(np.int64)
    )[0]
    far = np.sqrt(np.maximum(there, 0))
    return float(far.mean()), float(np.percentile(far, 95)), float(far.max())
