"""Fewer points for what lies between contours: head, hands, feet and clothes of a body that must be quick to draw.

Surfaces are reduced by quadric edge collapse; a new point takes weights, colours and texture coordinates of the point
that it grew out of. Source of the method: Garland and Heckbert, Surface simplification using quadric error metrics, 1997.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.pack import pack
from vitruvian.body.rotations import unit
from vitruvian.body.types import Floats, Ints
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid, Joint, Material, Shape
from vitruvian.modeling.flesh_rays import Flesh, everywhere
from vitruvian.motion.names import joint_index

_SMALL = 0.12  # an influence below this part of the largest is left to the others
_LEAST = 12  # triangles that every shape keeps
_FAR = 10.0  # metres: how far skirts hang from seams while a surface is reduced; their weight holds the seam
_INSIDE = ("teeth", "tongue")  # what a shut mouth hides
_STIFF = ("hair", "brows", "lashes", "eyes")
_CARD = 64  # loose pieces of a surface under so many triangles are dropped whole, the smallest first
_SEEN = {"eyes": 3.0}  # what is looked at keeps more
_INWARD = 0.03  # of the ways from the inner side of a surface out into the open: fewer, and nobody sees that side
_LOOKS, _WAYS = 400, 26  # triangles of a surface from which that is tried, and directions
_OFF = 1e-4  # metres: where such a way begins
_ENDS = ("l_radiocarpal", "r_radiocarpal", "l_talocrural", "r_talocrural")


def lightened(humanoid: Humanoid, points: int, *, fingers: bool = False) -> Humanoid:
    """A copy whose skin has about `points` points in one shape; contour surfaces, and what is sewn to them, stay as they
    are.

    Skin points are metres in humanoid space, in `skin_coord`. Small influences are dropped; hair, brows, lashes and eyes
    follow one joint each, and without `fingers` hands and feet follow the wrists and ankles, so that most of the skin is
    rigid. Displacers of the skin are lost. Shapes with a texture stay apart; the others become one with a colour per
    point, or two, where the inner side of some can be seen (hair) and that of others cannot. A skin with fewer points
    keeps them. Raises VitruvianError for fewer than 100 points.
    """
    if points < 100:
        raise VitruvianError(f"points of the skin: expected at least 100, found {points}")
    shapes = [s for s in humanoid.skin if s.points is None and s.name not in _INSIDE and len(s.triangles)]
    out = humanoid.copied()
    if not shapes:
        return out
    body = pack(humanoid)
    sewn = np.concatenate([np.zeros(0, np.int32), *(s.tied[:, 0] for s in body.contours)])
    flesh = Flesh.of(body)
    joints = out.joints()
    table = _weights(humanoid, joints, fingers)
    share = np.array([_importance(humanoid.skin_coord, s) for s in shapes])
    budgets = 2 * points * share / share.sum()
    whole = sum(len(np.unique(s.triangles)) for s in shapes) <= points
    made = [
        _reduced(humanoid.skin_coord, s, len(s.triangles) if whole else int(budget), sewn)
        for s, budget in zip(shapes, budgets, strict=True)
    ]
    first = np.cumsum([0, *(len(place) for place, _, _ in made)])
    rows = np.concatenate([
        _of_one(table[born]) if s.name in _STIFF else table[born] for s, (_, _, born) in zip(shapes, made, strict=True)
    ])  # fmt: skip
    rows[rows < _SMALL * rows.max(axis=1, keepdims=True)] = 0
    rows /= rows.sum(axis=1, keepdims=True)
    out.skin_coord, out.skin_normal = np.concatenate([place for place, _, _ in made]), None
    colors = np.concatenate([_color(s)(born) for s, (_, _, born) in zip(shapes, made, strict=True)])
    out.skin = []
    plain: dict[bool, list[Ints]] = {False: [], True: []}
    for s, (_, faces, born), start in zip(shapes, made, first[:-1], strict=True):
        triangles = (faces + start).astype(np.int32)
        if s.material.node is None:
            plain[s.material.double_sided and _seen_inside(flesh, s.triangles)].append(triangles)
            continue
        uv = np.zeros((len(colors), 2))
        uv[start : start + len(born)] = _texture(humanoid.skin_coord, s)[born]
        mine = colors if s.colors is not None else None
        out.skin.append(_bare(s, triangles, mine, None if s.uv is None else uv))
    for both, pieces in plain.items():
        if pieces:
            # no highlights, as contours have none
            look = Material("hair" if both else "skin", roughness=1.0, double_sided=both)
            one = _bare(replace(shapes[0], name=look.name, material=look), np.concatenate(pieces), colors, None)
            out.skin.insert(int(both and len(plain[False]) > 0), one)
    for number, joint in enumerate(joints):
        here = np.flatnonzero(rows[:, number] > 0)
        joint.skin_coord_index, joint.skin_coord_weight = here.astype(np.int32), rows[here, number]
        joint.displacers = []
    return out.settled()


def _seen_inside(flesh: Flesh, triangles: Ints) -> bool:
    """Whether the inner side of a surface (t,3) can be seen at rest: whether ways from there lead out between the body's
    other surfaces. The loose sheets of hair show it, clothes that a body fills do not."""
    some = triangles[np.unique(np.linspace(0, len(triangles) - 1, _LOOKS).astype(int))]
    a, b, c = np.moveaxis(flesh.points[some], 1, 0)
    inward = unit(np.cross(c - a, b - a))
    ways = everywhere(_WAYS)
    face, way = np.nonzero(inward @ ways.T > 0.1)
    eyes = ((a + b + c) / 3 + _OFF * inward)[face]
    return len(face) > 0 and float(np.isinf(flesh.look(eyes, ways[way])[0]).mean()) > _INWARD


def _bare(shape: Shape, triangles: Ints, colors: Floats | None, uv: Floats | None) -> Shape:
    return replace(
        shape, triangles=triangles, colors=colors, uv=uv, uv_triangles=None, normals=None, normal_triangles=None,
        faces=None, skin_index=None, node=None,
    )  # fmt: skip


def _weights(humanoid: Humanoid, joints: list[Joint], fingers: bool) -> Floats:
    """(V,J), what has none with the first joint."""
    table = np.zeros((len(humanoid.skin_coord), len(joints)))
    for number, joint in enumerate(joints):
        np.add.at(table[:, number], joint.skin_coord_index, joint.skin_coord_weight)
    table[table.sum(axis=1) <= 0, 0] = 1
    index = joint_index([j.name for j in joints])
    number_of = {id(j): n for n, j in enumerate(joints)}
    for name in () if fingers else _ENDS:
        if name in index:
            below = [number_of[id(j)] for j in joints[index[name]].walk()][1:]
            table[:, index[name]] += table[:, below].sum(axis=1)
            table[:, below] = 0
    return table


def _of_one(weights: Floats) -> Floats:
    """All points with the joint that holds the most of them."""
    out = np.zeros_like(weights)
    out[:, np.argmax(weights.sum(axis=0))] = 1
    return out


def _importance(points: Floats, shape: Shape) -> float:
    a, b, c = np.moveaxis(points[shape.triangles], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    return float(np.sqrt(area * len(shape.triangles))) * _SEEN.get(shape.name, 1.0)


def _reduced(points: Floats, shape: Shape, budget: int, sewn: Ints) -> tuple[Floats, Ints, Ints]:
    """Points (n,3), triangles (t,3) and (n,) the skin point that each grew out of; points that are `sewn` stay."""
    import igl

    used, first, triangles = _welded(points, shape.triangles, 6)
    if _crossed(triangles).any():  # what only lies close was made one
        used, first, triangles = _welded(points, shape.triangles, 15)
        while (crossed := _crossed(triangles)).any():
            triangles = triangles[~crossed]
    goal = max(_LEAST, min(budget, len(triangles)))
    triangles = _thinned(triangles, goal, len(first))
    first, triangles = _fanned(first, triangles)
    held = np.isin(used[first], sewn)
    order = np.argsort(~held, kind="stable")  # of two points that become one, the first stays
    number = np.empty(len(order), np.int32)
    number[order] = np.arange(len(order))
    triangles, first, fixed = number[triangles], first[order], int(held.sum())
    start = points[used][first]
    rim = _rim(triangles, fixed)
    hung, skirt = _skirts(start, rim)
    place, faces, _, born = igl.qslim(
        np.concatenate([start, hung]), np.concatenate([triangles, skirt]).astype(np.int32),
        min(goal, len(triangles)) + len(skirt),
    )  # fmt: skip
    faces = faces[(born[faces] < len(start)).all(axis=1)]
    kept = np.unique(faces)
    born, faces = born[kept], np.searchsorted(kept, faces)
    place = np.where((born < fixed)[:, None], start[born], place[kept])
    lost = np.setdiff1d(rim, born)
    faces = _resewn(faces, born, lost, rim)
    return np.concatenate([place, start[lost]]), faces.astype(np.int32), used[first[np.concatenate([born, lost])]]


def _resewn(faces: NDArray[np.int64], born: Ints, lost: Ints, rim: Ints) -> NDArray[np.int64]:
    """Triangles with points of a seam that fell together put back between their neighbours on it: `lost` (n,), which
    get the numbers after those of `born`."""
    number = {int(v): n for n, v in enumerate(np.concatenate([born, lost]))}
    ahead, back = dict(rim.tolist()), dict(rim[:, ::-1].tolist())
    left, out = set(lost.tolist()), faces.tolist()

    def beside(v: int, way: dict[int, int]) -> int:
        """The number of the next point of the seam that is there."""
        for _ in range(len(way)):
            v = way.get(v, -1)
            if v not in left:
                break
        return number.get(v, -1)

    for v in sorted(left):
        ends = (beside(v, back), beside(v, ahead))
        for t, face in enumerate(out):
            corner = next((i for i in range(3) if (face[i], face[(i + 1) % 3]) == ends), None)
            if corner is not None:
                tip = face[(corner + 2) % 3]
                out[t] = [ends[0], number[v], tip]
                out.append([number[v], ends[1], tip])
                break
        left.discard(v)
    return np.array(out, np.int64).reshape(-1, 3)


def _welded(points: Floats, triangles: Ints, digits: int) -> tuple[Ints, Ints, Ints]:
    """Points in use, which of them stand for all that are equal to so many digits, and triangles of those."""
    used, local = np.unique(triangles, return_inverse=True)
    _, first, same = np.unique(np.round(points[used], digits), axis=0, return_index=True, return_inverse=True)
    triangles = same.reshape(-1)[local.reshape(-1, 3)].astype(np.int32)
    a, b, c = triangles.T
    return used, first.astype(np.int32), triangles[(a != b) & (b != c) & (c != a)]


def _edges(triangles: Ints) -> Ints:
    """(3t,2) first edges of all triangles, then second, then third."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def _crossed(triangles: Ints) -> np.ndarray:
    """(t,) which triangles come later to the side of an edge that another has: no collapse can go on there."""
    edges = _edges(triangles)
    _, first = np.unique(edges, axis=0, return_index=True)
    out = np.ones(len(edges), bool)
    out[first] = False
    return np.logical_or.reduce(out.reshape(3, -1))


def _fanned(first: Ints, triangles: Ints) -> tuple[Ints, Ints]:
    """Points and triangles where a point in which several fans of triangles meet is there once for each: no collapse can go
    on there either."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges, count = _edges(triangles).astype(np.int64), len(triangles)
    key, back = (a * len(first) + b for a, b in (edges.T, edges.T[::-1]))
    order = np.argsort(key)
    place = np.minimum(np.searchsorted(key, back, sorter=order), len(key) - 1)
    mate = order[place]
    inner = np.flatnonzero(key[mate] == back)
    # edge n begins at corner n and ends at the next corner of its triangle; corners as in `_edges`
    ends = (np.arange(3 * count) + count) % (3 * count)
    pairs = np.stack([np.concatenate([inner, ends[inner]]), np.concatenate([ends[mate[inner]], mate[inner]])])
    graph = coo_array((np.ones(pairs.shape[1]), pairs), shape=(3 * count,) * 2)
    fans, label = connected_components(graph, directed=False)
    if fans == len(np.unique(triangles)):
        return first, triangles
    point = np.empty(fans, np.int64)
    point[label] = triangles.T.reshape(-1)
    return first[point], label.reshape(3, count).T.astype(np.int32)


def _rim(triangles: Ints, fixed: int) -> Ints:
    """(n,2) edges of one triangle alone between the first `fixed` points, in the direction of its corners."""
    edges = _edges(triangles)
    count = int(triangles.max(initial=0)) + 1
    key = edges.astype(np.int64) @ np.array([count, 1])
    back = edges[:, ::-1].astype(np.int64) @ np.array([count, 1])
    return edges[~np.isin(key, back) & (edges < fixed).all(axis=1)]


def _skirts(points: Floats, rim: Ints) -> tuple[Floats, Ints]:
    """Points and triangles that hang from rims: planes so large, three or more at each point, that it moves little."""
    if not len(rim):
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    count = len(points)
    ends, place = np.unique(rim, return_inverse=True)
    a, b = rim.T
    far_a, far_b = place.reshape(-1, 2).T + count
    ways = np.random.default_rng(0).normal(size=(len(ends), 3))  # any, but no two alike
    hung = points[ends] + _FAR * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    return hung, np.concatenate([np.stack([b, a, far_a], 1), np.stack([b, far_a, far_b], 1)]).astype(np.int32)


def _thinned(triangles: Ints, goal: int, points: int) -> Ints:
    """Without some of the smallest loose pieces (strands of hair), which no collapse of edges makes fewer."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(points, points))
    label = connected_components(graph, directed=False)[1][triangles[:, 0]]
    sizes = np.bincount(label)
    loose = np.flatnonzero((sizes > 0) & (sizes < _CARD))
    if 4 * len(loose) <= goal:
        return triangles
    spare = max(1, round(goal / 4))  # evenly over the surface, as pieces are numbered along it
    kept = loose[np.unique(np.linspace(0, len(loose) - 1, spare).round().astype(int))]
    return triangles[~np.isin(label, np.setdiff1d(loose, kept))]


def _color(shape: Shape):  # noqa: ANN202
    """Colours of skin points by their numbers: the shape's, or its material's."""
    if shape.colors is not None:
        return lambda born: shape.colors[born]
    return lambda born: np.tile(np.array(shape.material.color[:3], np.float64), (len(born), 1))


def _texture(points: Floats, shape: Shape) -> Floats:
    """(n,2) texture coordinates of the skin's points as the shape has them; zero where it has none."""
    out = np.zeros((len(points), 2))
    if shape.uv is not None:
        corners = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
        out[shape.triangles.reshape(-1)] = shape.uv[corners.reshape(-1)]
    return out
