"""Limbs and trunk of a figure in segments made one surface: closed pieces that overlap become what shows of them.

Where an upper arm or a thigh stands in the trunk or lies against it, the part of each that is within a little of the other
is cut out, and the two holes are sewn to each other. So the crease between them is filled by a narrow strip, all else keeps
its shape and looks, and nothing can open. Points near the strip then follow both, evenly.

Source: cross-section deformation of H-Anim bodies asks for one surface of all segments; this way of making it is ours. New
points on edges are rounded as in T. Boubekeur, M. Alexa, "Phong tessellation" (2008).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.modeling.cuts import FOLLOW, Cuts, unit
from vitruvian.modeling.loops import directed_loops
from vitruvian.modeling.slicing import Whole, cotangents
from vitruvian.modeling.stitching import Cloth

_GAP = 0.012  # metres of a person: what is nearer to the other surface than this is cut out
_FINE = 0.012  # metres of a person: edges at a seam are no longer
_DEEP = {
    "shoulder": 0.11,
    "hip": 0.12,
}  # metres of a person that a seam reaches down the bone at most: armpit and crotch
_MIDDLE = 0.008  # metres of a person beside the middle of the body that stay the pelvis's between the thighs
_ROUNDS = 16  # edges are halved so often at most
_NEAR = 0.15  # of the length of edges: a corner this near a seam is on it
_SMOOTH = 2  # times that the line of a seam is smoothed
_ROUND = 0.75  # how far new points go to the smooth surface that normals tell of
_SHARP = 0.75  # cosine between a face and the mean of those at its corner below which that is an edge
_LEAST = 8  # points of a seam at least

Mask = NDArray[np.bool_]
Field = Callable[[Floats], Floats]  # (n,) values at points (n,3)


@dataclass(frozen=True, eq=False)
class Solid:
    """Closed triangles (T,3) of points (V,3), which may overlap each other."""

    rest: Floats
    triangles: Ints

    def distance(self, points: Floats) -> Floats:
        """(n,) how far points (n,3) are from it, m; less than 0 inside."""
        import igl

        p, t = np.ascontiguousarray(points), self.triangles.astype(np.int64)
        far = np.sqrt(np.maximum(igl.point_mesh_squared_distance(p, self.rest, t)[0], 0))
        used = self.rest[np.unique(t)]
        within = ((p >= used.min(axis=0)) & (p <= used.max(axis=0))).all(axis=1)
        if within.any():
            inside = igl.winding_number(self.rest, t, np.ascontiguousarray(p[within])) > 0.5
            far[within] = np.where(inside, -far[within], far[within])
        return far


def united(cuts: Cuts) -> Cuts:
    """The figure with the upper arms and thighs that meet its trunk made one surface with it, and where: `Cuts.seams`.

    A limb that does not meet it, or only so that no single seam lies between, stays as it is."""
    cloth = Cloth(cuts.skin, cuts.sliced, cuts.corners)
    seams: dict[str, Floats] = {}
    owner = cuts.skin.weights.top(1)[0][:, 0]
    for n, side in enumerate("lr"):
        for joint, code, end in (("shoulder", 2, "elbow"), ("hip", 6, "knee")):
            name = f"{side}_{joint}"
            own = cuts.triangles(code + n)
            own = own[owner[cuts.skin.triangles[own, 0]] == cuts.index[name]]
            trunk = _trunk(cuts, name)
            if not len(own) or not len(trunk):
                continue
            bone = unit(cuts.at(f"{side}_{end}") - cuts.at(name))
            away = np.sign(cuts.at(name)[0] - cuts.hips[0])
            line = _joined(cloth, cuts, name, own, trunk, bone, float(away))
            if line is not None:
                seams[name] = line
    if not seams:
        return cuts
    weights = cuts.skin.weights
    table = np.zeros((len(weights), len(cuts.body.skeleton)))
    table[weights.vertex, weights.joint] = weights.weight
    skin = cloth.finished(cloth.carried(table))
    return Cuts(replace(cuts.body, skin=skin), seams)


def _trunk(cuts: Cuts, name: str) -> Whole:
    """The triangles that a limb hangs on: legs on the pelvis, where there is one."""
    pelvis = cuts.triangles(10)
    return pelvis if name.endswith("hip") and len(pelvis) else cuts.triangles(0)


def followed(cloth: Cloth, cuts: Cuts, table: Floats, rings: Whole) -> Floats:
    """Weights (V,J) that go over evenly from what is left of a limb above its contours to the trunk.

    On the limb they depend on the place alone, so that a sleeve goes with the arm in it: all of the limb's at its first
    contour, half on the seam. From there they fade on the trunk, as a harmonic function, until `FOLLOW` away. `rings`:
    vertices of contours, which keep theirs."""
    from scipy.sparse import csr_array, diags_array
    from scipy.sparse.linalg import splu
    from scipy.spatial import cKDTree

    t = cloth.triangles.astype(np.int64)
    used = np.zeros(len(cloth.rest), bool)
    used[t] = True
    used[rings] = False
    free = np.zeros(len(cloth.rest), bool)
    out, weights = table.copy(), cuts.skin.weights
    for name, seam in cuts.seams.items():
        limb, (first, bone) = cuts.index[name], cuts.planes[name]
        away = cKDTree(seam).query(cloth.rest)[0]
        trunk = np.isin(weights.vertex, cuts.skin.triangles[_trunk(cuts, name)])
        beside = used & (table[:, np.unique(weights.joint[trunk])].sum(axis=1) > 0.5)
        free |= beside & (away < FOLLOW[name[2:]] * cuts.scale)
        own = np.flatnonzero(used & (table[:, limb] > 0.5))
        holds = np.flatnonzero(beside & (away == 0))
        if not len(holds):
            continue
        mate = holds[cKDTree(cloth.rest[holds]).query(cloth.rest[own])[1]]
        ahead = np.maximum((first - cloth.rest[own]) @ bone, 0)
        share = 0.5 + 0.5 * away[own] / np.maximum(away[own] + ahead, 1e-12)
        out[own] = (1 - share[:, None]) * table[mate]
        out[own, limb] += share
    rows = np.flatnonzero(free)
    if not len(rows):
        return table
    w = cotangents(cloth.rest, t, 1e-3, 1e3)
    matrix = csr_array(diags_array(np.asarray(w.sum(axis=1)).ravel()) - w)[rows]
    joints = np.flatnonzero(table.any(axis=0))
    known = np.where(free[:, None], 0.0, out[:, joints])
    out[np.ix_(rows, joints)] = np.clip(splu(matrix[:, rows].tocsc()).solve(-(matrix @ known)), 0, 1)
    out[rows] /= out[rows].sum(axis=1, keepdims=True)
    return out


def _joined(cloth: Cloth, cuts: Cuts, name: str, own: Whole, trunk: Whole, bone: Floats, away: float) -> Floats | None:
    """Cut a limb and the trunk where they are near each other and sew them together; the points (n,3) of the seam on both
    sides. None when they don't meet in one loop each: then the surfaces are as they were."""
    scale, start, joint = cuts.scale, cuts.at(name), name[2:]
    rest, triangles = cuts.skin.rest, cuts.skin.triangles
    before = dict(cloth.__dict__, on=list(cloth.on), blend=list(cloth.blend))
    lid = _lid(rest, triangles[own], start, bone)
    cloth.close(lid, own[0])
    limb, body = Solid(rest, np.concatenate([triangles[own], lid])), Solid(rest, triangles[trunk])

    def field(other: Solid, middle: bool) -> Field:
        def value(p: Floats) -> Floats:
            out = np.maximum(other.distance(p) - _GAP * scale, (p - start) @ bone - _DEEP[joint] * scale)
            if middle and joint == "hip":
                out = np.maximum(out, _MIDDLE * scale - away * (p[:, 0] - cuts.hips[0]))
            return out

        return value

    lines = []
    place: Floats | None = None
    for faces, value in ((own, field(body, False)), (trunk, field(limb, True))):
        mine = lambda faces=faces: np.flatnonzero(np.isin(cloth.origin, faces))  # noqa: E731
        line = _hole(cloth, mine, value, _FINE * scale, place)
        if line is None:
            cloth.__dict__.update(before)
            return None
        lines.append(line)
        place = cloth.rest[line].mean(axis=0)
    cloth.bridge(lines[0], lines[1])
    return cloth.rest[np.concatenate(lines)]


def _lid(rest: Floats, triangles: Ints, start: Floats, bone: Floats) -> Ints:
    """(n,3) triangles over the open ends of a limb on its joint's side of its middle."""
    out: list[list[int]] = []
    middle = np.median((rest[np.unique(triangles)] - start) @ bone)
    for line in directed_loops(triangles.astype(np.int64)):
        if len(line) > 2 and (rest[line] - start).mean(axis=0) @ bone < middle:
            out += [[line[0], b, a] for a, b in zip(line[1:-1].tolist(), line[2:].tolist(), strict=True)]
    return np.array(out, np.int32).reshape(-1, 3)


def _hole(cloth: Cloth, mine: Callable[[], Whole], value: Field, fine: float, place: Floats | None) -> Whole | None:
    """Cut out of some triangles where a field is below 0: the loop of vertices round the hole, in the direction of the
    faces beside it. Of several such places the widest, or that nearest `place`. None when there is not one loop."""
    normals = _normals(cloth, mine())
    for _ in range(_ROUNDS):  # finer where the field is 0
        faces = mine()
        t = cloth.triangles[faces].astype(np.int64)
        corners = cloth.rest[t]
        middle = corners.mean(axis=1)
        reach = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
        length = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        near = np.flatnonzero(length.max(axis=1) > fine)
        near = near[np.abs(value(middle[near])) <= reach[near]] if len(near) else near
        if not len(near):
            break
        k = np.argmax(length[near], axis=1)
        pairs = np.unique(np.sort(np.stack([t[near, k], t[near, (k + 1) % 3]], axis=1), axis=1), axis=0)
        new = len(cloth.rest)
        cloth.split(pairs, np.full(len(pairs), 0.5))
        a, b = pairs.T
        middle = cloth.rest[new:]
        for end in (a, b):
            off = np.einsum("nk,nk->n", cloth.rest[end] - (cloth.rest[a] + cloth.rest[b]) / 2, normals[end])
            middle += _ROUND / 2 * off[:, None] * normals[end]
        both = normals[a].any(axis=1) & normals[b].any(axis=1)
        normals = np.concatenate([normals, _unit(normals[a] + normals[b]) * both[:, None]])
    faces = mine()
    d = _values(cloth, faces, value)
    inner = _patch(cloth, faces, d, place)
    if inner is None:
        return None
    d = np.where(inner, d, np.maximum(d, fine))
    d[np.abs(d) < _NEAR * fine] = 0.0  # no slivers
    on = cloth._divide(d, faces)
    cloth.on.append(on)
    faces = mine()
    piece = cloth.pieces()
    d = np.concatenate([d, np.zeros(len(cloth.rest) - len(d))])
    inside = d[cloth.triangles[faces]].mean(axis=1) < 0
    beside = on[cloth.triangles[faces]].any(axis=1)
    corners = cloth.rest[cloth.triangles[faces]]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    size = np.bincount(piece[faces], area * ~inside, minlength=piece.max() + 1)
    gone = np.zeros(len(cloth.triangles), bool)
    gone[faces] = inside | (np.isin(piece[faces], piece[faces][beside]) & (piece[faces] != np.argmax(size)))
    cloth.without(gone)
    loops = cloth.lines(on)
    if len(loops) != 1 or len(loops[0]) < _LEAST:
        return None
    cloth.rest = cloth.rest.copy()
    for _ in range(_SMOOTH):
        p = cloth.rest[loops[0]]
        cloth.rest[loops[0]] = (np.roll(p, 1, axis=0) + 2 * p + np.roll(p, -1, axis=0)) / 4
    return loops[0]


def _normals(cloth: Cloth, faces: Whole) -> Floats:
    """(V,3) unit normals of a smooth surface through some triangles, 0 where it has an edge."""
    t = cloth.triangles[faces]
    a, b, c = np.moveaxis(cloth.rest[t], 1, 0)
    flat = np.cross(b - a, c - a)
    out = np.zeros_like(cloth.rest)
    for k in range(3):
        np.add.at(out, t[:, k], flat)
    out = _unit(out)
    least = np.ones(len(out))
    np.minimum.at(least, t, np.einsum("tkc,tc->tk", out[t], _unit(flat)))
    return out * (least > _SHARP)[:, None]


def _unit(v: Floats) -> Floats:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-300)


def _values(cloth: Cloth, faces: Whole, value: Field) -> Floats:
    """(V,) a field at the corners of some triangles, elsewhere far above 0."""
    out = np.full(len(cloth.rest), np.inf)
    used = np.unique(cloth.triangles[faces])
    out[used] = value(cloth.rest[used])
    return out


def _patch(cloth: Cloth, faces: Whole, d: Floats, place: Floats | None) -> Mask | None:
    """(V,) the vertices of the widest connected place, or that nearest `place`, where a field is below 0."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    t = cloth.triangles[faces].astype(np.int64)
    sides = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    sides = sides[(d[sides] < 0).all(axis=1)]
    if not len(sides):
        return None
    label = connected_components(coo_array((np.ones(len(sides)), sides.T), shape=(len(d),) * 2), directed=False)[1]
    numbers, count = np.unique(label[np.unique(sides)], return_counts=True)
    if place is None:
        best = numbers[np.argmax(count)]
    else:
        best = numbers[np.argmin([np.linalg.norm(cloth.rest[label == n] - place, axis=1).min() for n in numbers])]
    return np.asarray(label == best)
