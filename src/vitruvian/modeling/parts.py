"""A figure taken apart into body, head, hands and feet, and put together again, with parts of others if wanted.

Every part is a whole figure: all joints, and the skin of some. Parts that were not changed join to the figure they came
from, to the bit; where a part is another one, points at the same place become one and what is left of the gap is closed
with triangles. Source: separation of head, hands and feet (seed 003, table 1; note body.md, section 6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Material, Shape
from vitruvian.hanim.segmenting import triangle_joints
from vitruvian.modeling.grafting import brought, met, taken_over
from vitruvian.modeling.rows import chosen

Whole = NDArray[np.int64]

PARTS = {
    "head": "skullbase",
    "l_hand": "l_radiocarpal",
    "r_hand": "r_radiocarpal",
    "l_foot": "l_talocrural",
    "r_foot": "r_talocrural",
}  # joints by H-Anim 2.0 names
BODY = "body"  # what is left
_SAME = 1e-6  # metres between points of a cut that are one
_LOOSE = 64  # triangles of a piece that is not cut
_REACH = 0.05  # metres from a cut within which open edges of another part belong to it


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a figure. `rows` (n,): which of the figure's skin points its own are.
    `shapes`: which of its skin shapes; `triangles`: which of their triangles. `rim` (e,2): edges that the cut laid open, of
    its own points."""

    humanoid: Humanoid
    origin: Humanoid
    rows: Ints
    shapes: tuple[int, ...]
    triangles: tuple[Ints, ...]
    rim: Ints


def split(humanoid: Humanoid, parts: Sequence[str] = tuple(PARTS)) -> dict[str, Piece]:
    """The parts of these names, and the rest as "body".

    Names are those of `PARTS` or of joints: the part is the skin that follows the joint or those below it, each triangle as
    its weights say. Raises VitruvianError for a name that is neither, for a joint that the figure lacks, and for a figure
    without a skin.
    """
    moving = [n for n, s in enumerate(humanoid.skin) if s.points is None and len(s.triangles)]
    if not moving:
        raise VitruvianError(f"humanoid {humanoid.name!r}: expected a skin to split, found none; `vt.weld` makes one")
    roots = {name: _root(humanoid, name) for name in parts}
    joints = humanoid.joints()
    triangles = np.concatenate([humanoid.skin[n].triangles for n in moving])
    tops = {j.name for j in humanoid.skeleton}
    owner = triangle_joints(humanoid, triangles, {*roots.values(), *tops})
    part_of = {root: name for name, root in roots.items()}
    names = [BODY, *roots]
    label = np.array([names.index(part_of.get(j.name, BODY)) for j in joints])[owner]
    place = np.unique(humanoid.skin_coord + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    _gathered(label, place[triangles])
    shut = _open(place[triangles], len(place))
    first = np.cumsum([0, *(len(humanoid.skin[n].triangles) for n in moving)])
    taken = np.zeros(len(humanoid.skin_coord), bool)
    taken[triangles] = True
    out = {}
    for number, name in enumerate(names):
        mine = label == number
        rows = np.unique(triangles[mine])
        if name == BODY:  # points that no face has stay with the body
            rows = np.union1d(rows, np.flatnonzero(~taken))
        some = [np.flatnonzero(mine[a:b]).astype(np.int32) for a, b in zip(first, first[1:])]
        kept = [(n, t) for n, t in zip(moving, some, strict=True) if len(t)]
        skin = [_some(humanoid.skin[n], t) for n, t in kept]
        if name == BODY:
            skin += [s for n, s in enumerate(humanoid.skin) if n not in moving]
        made = chosen(replace(humanoid.copied(), skin=skin), rows.astype(np.int32))
        here = triangles[mine]
        edges = _sides(here)
        laid = ~np.isin(_key(_sides(place[here]), len(place)), shut) & _alone(place[here], len(place))
        rim = np.searchsorted(rows, edges[laid]).astype(np.int32)
        piece = Piece(made, humanoid, rows.astype(np.int32), tuple(n for n, _ in kept), tuple(t for _, t in kept), rim)
        out[name] = piece
    return out


def join(pieces: Mapping[str, Piece | Humanoid]) -> Humanoid:
    """One figure of parts. "body" gives the skeleton and all that is not skin.

    Pieces of the body's own figure go back to their places, to the bit (indices of weights and displacers come out rising).
    Another figure's piece, or any Humanoid with a skin (a decimated piece), comes with its points, weights by the names of
    joints, and looks; where its open edges meet those of the cut, points at the same place become one and gaps are closed.
    Its joint (that of `PARTS`, or called as the part) is brought to the body's, its edge to the cut, and the body's joints
    and Sites from there on move to the part's. Raises VitruvianError without a "body" that `split` made, and for edges that
    are nowhere near the cut.
    """
    body = pieces.get(BODY)
    if not isinstance(body, Piece):
        raise VitruvianError('join: expected a piece "body", as split gives it')
    own = {n: p for n, p in pieces.items() if isinstance(p, Piece) and p.origin is body.origin}
    joined = _own(body, list(own.values()))
    rows = np.unique(np.concatenate([p.rows for p in own.values()]))
    if len(rows) < len(joined.skin_coord):
        joined = chosen(joined, rows.astype(np.int32))
    cuts = np.concatenate([np.searchsorted(rows, p.rows[p.rim]) for p in own.values()])
    for name, piece in pieces.items():
        if name not in own:
            root = PARTS.get(name, name)
            figure = brought(piece.humanoid if isinstance(piece, Piece) else piece, joined, root)
            joined, cuts = _with(joined, cuts, figure, piece.rim if isinstance(piece, Piece) else None)
            taken_over(joined, figure, root)
    return joined.settled()


def _gathered(label: Whole, triangles: Whole) -> None:
    """Give loose pieces (strands of hair) whole to the part that has most of each."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    count = int(triangles.max()) + 1
    graph = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    piece = connected_components(graph, directed=False)[1][triangles[:, 0]]
    votes = np.zeros((int(piece.max()) + 1, int(label.max()) + 1), np.int64)
    np.add.at(votes, (piece, label), 1)
    loose = (votes.sum(axis=1) < _LOOSE)[piece]
    label[loose] = votes.argmax(axis=1)[piece[loose]]


def _root(humanoid: Humanoid, name: str) -> str:
    wanted = PARTS.get(name, name)
    known = tables.canonical(wanted) or wanted
    for joint in humanoid.joints():
        if joint.name == wanted or tables.canonical(joint.name) == known:
            return joint.name
    what = f"has no joint {wanted}" if name in PARTS or tables.canonical(name) else "has no joint of that name"
    raise VitruvianError(
        f"part {name}: expected one of {', '.join(PARTS)} or a joint; {humanoid.name or 'the figure'} {what}"
    )


def _some(shape: Shape, triangles: Ints) -> Shape:
    take = lambda a: None if a is None else a[triangles]  # noqa: E731
    return replace(
        shape, triangles=shape.triangles[triangles], uv_triangles=take(shape.uv_triangles),
        normal_triangles=take(shape.normal_triangles), faces=take(shape.faces), node=None,
    )  # fmt: skip


def _sides(triangles: Ints | Whole) -> Whole:
    """(3t,2) edges as faces go round."""
    t = np.asarray(triangles, np.int64)
    return np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])


def _key(edges: Whole, count: int) -> Whole:
    return np.minimum(edges[:, 0], edges[:, 1]) * count + np.maximum(edges[:, 0], edges[:, 1])


def _alone(triangles: Whole, count: int) -> NDArray[np.bool_]:
    """(3t,) whether each side is an edge of one face alone."""
    _, number, many = np.unique(_key(_sides(triangles), count), return_inverse=True, return_counts=True)
    return np.asarray(many[number.reshape(-1)] == 1)


def _open(triangles: Whole, count: int) -> Whole:
    """Keys of edges of one face alone."""
    key, many = np.unique(_key(_sides(triangles), count), return_counts=True)
    return key[many == 1]


def _own(body: Piece, pieces: list[Piece]) -> Humanoid:
    """The figure that pieces were split from, with what they have; points that none has are zero."""
    count = len(body.origin.skin_coord)
    out = body.humanoid.copied()
    out.skin_coord = _scattered([(p.rows, p.humanoid.skin_coord) for p in pieces], count)
    for name in ("skin_normal", "skin_binding_coords", "skin_binding_normals"):
        values = [(p.rows, v) for p in pieces if (v := getattr(p.humanoid, name)) is not None]
        setattr(out, name, _scattered(values, count) if len(values) == len(pieces) else None)
    skin: dict[int, list[tuple[Ints, Shape, Ints]]] = {}
    for piece in pieces:
        moving = [s for s in piece.humanoid.skin if s.points is None]
        if len(moving) != len(piece.shapes):
            raise VitruvianError("join: a piece has other shapes than when it was split; give its humanoid instead")
        for number, triangles, shape in zip(piece.shapes, piece.triangles, moving, strict=True):
            skin.setdefault(number, []).append((triangles, shape, piece.rows))
    still = [s for s in body.humanoid.skin if s.points is not None]
    shapes = []
    for number, old in enumerate(body.origin.skin):
        if old.points is not None:
            shapes.append(still.pop(0))
        elif number in skin:
            shapes.append(_whole(old, skin[number], count))
        elif not len(old.triangles):
            shapes.append(replace(old, node=None))
    out.skin = shapes
    sources = [(p.humanoid, p.rows) for p in pieces]
    _influences(out, sources)
    tracks = []
    for n, track in enumerate(body.humanoid.tracks):
        if not track.target and track.field == "point" and track.values.shape[-1] == 3 * len(body.rows):
            keys = np.zeros((len(track.values), count, 3))
            for piece in pieces:
                keys[:, piece.rows] = piece.humanoid.tracks[n].values.reshape(len(keys), -1, 3)
            track = replace(track, values=keys.reshape(len(keys), -1))
        tracks.append(track)
    out.tracks = tracks
    return out


def _scattered(parts: list[tuple[Ints, Floats]], count: int, fill: float | Floats = 0.0) -> Floats:
    """(count,n) values in their rows; elsewhere a number, or rows of an array that is long enough."""
    out = np.empty((count, parts[0][1].shape[1] if parts else 3))
    out[:] = fill if isinstance(fill, float) or len(fill) == count else 0.8
    for rows, values in parts:
        out[rows] = values
    return out


def _whole(old: Shape, parts: list[tuple[Ints, Shape, Ints]], count: int) -> Shape:
    """A skin shape of its triangles in several pieces, in their old order."""
    order = np.argsort(np.concatenate([t for t, _, _ in parts]), kind="stable")
    gather = lambda values: np.concatenate(values)[order]  # noqa: E731
    first = parts[0][1]
    take = lambda name: None if getattr(first, name) is None else gather([getattr(s, name) for _, s, _ in parts])  # noqa: E731
    per_point = lambda name: _scattered([(r, getattr(s, name)) for _, s, r in parts], count, getattr(old, name))  # noqa: E731
    uv = first.uv
    if uv is not None and first.uv_triangles is None:
        uv = per_point("uv")
    normals = first.normals
    if normals is not None and first.normal_triangles is None:
        normals = per_point("normals")
    return replace(
        first,
        triangles=gather([r[s.triangles] for _, s, r in parts]).astype(np.int32),
        uv=uv,
        uv_triangles=take("uv_triangles"),
        colors=per_point("colors") if all(s.colors is not None for _, s, _ in parts) else None,
        normals=normals,
        normal_triangles=take("normal_triangles"),
        faces=take("faces"),
    )


def _influences(out: Humanoid, sources: list[tuple[Humanoid, Ints]]) -> None:
    """Weights and displacers of joints from figures and what their points are called now; a point's first figure counts."""
    home = {j.name: j for j in out.joints()}
    weights: dict[str, list[tuple[Ints, Floats]]] = {n: [] for n in home}
    moves: dict[str, dict[str, list[Displacer]]] = {n: {} for n in ["", *home]}
    claimed = np.zeros(len(out.skin_coord), bool)
    for figure, rows in sources:
        fresh = ~claimed[rows]
        claimed[rows] = True
        for name, joint in _homes(figure, home):
            mine = fresh[joint.skin_coord_index]
            weights[name].append((rows[joint.skin_coord_index[mine]], joint.skin_coord_weight[mine]))
            for d in joint.displacers:
                moves[name].setdefault(d.name, []).append(_moved(d, rows, fresh))
        for d in figure.skin_displacers:
            moves[""].setdefault(d.name, []).append(_moved(d, rows, fresh))
    for name, joint in home.items():
        index = np.concatenate([np.zeros(0, np.int32), *(i for i, _ in weights[name])])
        value = np.concatenate([np.zeros(0), *(v for _, v in weights[name])])
        order = np.argsort(index, kind="stable")
        joint.skin_coord_index, joint.skin_coord_weight = index[order].astype(np.int32), value[order]
        joint.displacers = [_one(parts) for parts in _ranked(moves[name], sources, name)]
    out.skin_displacers = [_one(parts) for parts in _ranked(moves[""], sources, "")]


def _ranked(
    moves: dict[str, list[Displacer]], sources: list[tuple[Humanoid, Ints]], joint: str
) -> list[list[Displacer]]:
    """Displacers in the order of the pieces that have most of them."""
    lists = []
    for figure, _ in sources:
        found = [j for j in figure.joints() if j.name == joint]
        lists.append([d.name for d in (found[0].displacers if found else [] if joint else figure.skin_displacers)])
    order = [n for names in sorted(lists, key=len, reverse=True) for n in names]
    return [moves[n] for n in sorted(moves, key=lambda n: order.index(n) if n in order else len(order))]


def _homes(figure: Humanoid, home: Mapping[str, Joint]) -> list[tuple[str, Joint]]:
    """For each joint of a figure the joint of another that stands for it: of the same name, or its nearest ancestor's."""
    known = {tables.canonical(n) or n: n for n in home}
    out: list[tuple[str, Joint]] = []
    above: dict[int, str] = {}
    top = next(iter(home))
    for joint in figure.joints():
        name = joint.name if joint.name in home else known.get(tables.canonical(joint.name) or joint.name, "")
        name = name or above.get(id(joint), top)
        out.append((name, joint))
        for child in joint.joints:
            above[id(child)] = name
    return out


def _moved(d: Displacer, rows: Ints, fresh: NDArray[np.bool_]) -> Displacer:
    mine = fresh[d.coord_index]
    return replace(d, coord_index=rows[d.coord_index[mine]], displacements=d.displacements[mine])


def _one(parts: list[Displacer]) -> Displacer:
    index = np.concatenate([d.coord_index for d in parts])
    order = np.argsort(index, kind="stable")
    moves = np.concatenate([d.displacements for d in parts])[order]
    return replace(parts[0], coord_index=index[order].astype(np.int32), displacements=moves)


def _with(base: Humanoid, cuts: Whole, figure: Humanoid, rim: Ints | None) -> tuple[Humanoid, Whole]:
    """A figure and a part of another with open edges `rim` (e,2), closed along `cuts` (e,2), open edges of the figure; and
    the cuts that are left."""
    from scipy.spatial import cKDTree

    moving = [s for s in figure.skin if s.points is None and len(s.triangles)]
    faces = np.concatenate([np.zeros((0, 3), np.int32), *(s.triangles for s in moving)])
    count, more = len(base.skin_coord), len(figure.skin_coord)
    ends = np.unique(cuts)
    if not len(cuts) or not len(faces):
        raise VitruvianError("join: expected a part with a skin, and a body with a cut for it")
    tree = cKDTree(base.skin_coord[ends])
    if rim is None:
        place = np.unique(figure.skin_coord + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
        edges = _sides(faces)[_alone(place[faces].astype(np.int64), len(place))]
        edge = edges[(tree.query(figure.skin_coord)[0] < _REACH)[edges].all(axis=1)].astype(np.int64)
    else:
        edge = rim.astype(np.int64)
    figure = replace(figure, skin_coord=met(figure.skin_coord, edge, base.skin_coord[cuts]))
    far, near = tree.query(figure.skin_coord)
    on_rim = np.isin(np.arange(more), edge) & (far < _SAME)
    rows = np.where(on_rim, ends[near], 0)
    rows[~on_rim] = count + np.arange(int((~on_rim).sum()))
    rows = rows.astype(np.int32)
    out = base.copied()
    fresh = figure.skin_coord[~on_rim]
    out.skin_coord = np.concatenate([base.skin_coord, fresh])
    total = len(out.skin_coord)
    out.skin_normal = out.skin_binding_coords = out.skin_binding_normals = None
    out.tracks = [t for t in base.tracks if t.target or t.field != "point"]
    out.skin = [_longer(s, total) for s in base.skin]
    for s in moving:
        per_point = s.uv is not None and s.uv_triangles is None
        colors = None if s.colors is None else _scattered([(rows[: len(s.colors)], s.colors)], total, 0.8)
        out.skin.append(
            replace(
                s,
                triangles=rows[s.triangles],
                uv_triangles=s.triangles if per_point else s.uv_triangles,
                colors=colors,
                normals=None,
                normal_triangles=None,
                node=None,
            )  # fmt: skip
        )
    _influences(out, [(base, np.arange(count, dtype=np.int32)), (figure, rows)])
    theirs = rows[edge].astype(np.int64)
    near_part = cKDTree(out.skin_coord[np.unique(theirs)]) if len(theirs) else None
    close = np.zeros(len(cuts), bool)
    if near_part is not None:
        close = (near_part.query(out.skin_coord[cuts])[0] < _REACH).all(axis=1)
    if not close.any() or not len(theirs):
        gap = float(near_part.query(out.skin_coord[ends])[0].min()) if near_part is not None else np.inf
        raise VitruvianError(
            f"join: expected a part within {_REACH} m of a cut of the body, found {gap:.3f} m; move it there"
        )
    triangles = _filled(out.skin_coord, _unpaired(cuts[close], theirs), _unpaired(theirs, cuts[close]))
    if len(triangles):
        model = next((s for s in base.skin if s.points is None and np.isin(s.triangles, cuts).any()), moving[0])
        look = (
            replace(model.material, picture=None, node=None) if model.material.picture is not None else model.material
        )
        out.skin.append(_seam(triangles, look, [s for s in out.skin if s.points is None], total))
    return out, cuts[~close]


def _longer(shape: Shape, count: int) -> Shape:
    """A shape of the skin after points were added."""
    if shape.points is not None:
        return shape

    def pad(a: Floats | None, fill: float) -> Floats | None:
        return None if a is None else np.concatenate([a, np.full((max(0, count - len(a)), a.shape[1]), fill)])

    return replace(
        shape,
        colors=pad(shape.colors, 0.8),
        uv=pad(shape.uv, 0.0) if shape.uv_triangles is None else shape.uv,
        normals=shape.normals if shape.normal_triangles is not None else None,
        node=None,
    )


def _seam(triangles: Ints, look: Material, shapes: list[Shape], count: int) -> Shape:
    colors = None
    if any(s.colors is not None for s in shapes):
        colors = np.full((count, 3), 0.8)
        for s in shapes:
            used = np.unique(s.triangles)
            colors[used] = look.color[:3] if s.colors is None else s.colors[used]
    return Shape("seam", triangles, colors=colors, material=look)


def _unpaired(edges: Whole, others: Whole) -> Whole:
    """Directed edges whose opposite is neither among them nor among others."""
    have = set(map(tuple, np.concatenate([edges, others]).tolist()))
    return np.array([e for e in edges.tolist() if (e[1], e[0]) not in have], np.int64).reshape(-1, 2)


def _filled(points: Floats, mine: Whole, theirs: Whole) -> Ints:
    """(t,3) triangles that close the loops of open edges of two sides: polygons of both by themselves, loops of one side
    with the nearest of the other."""
    ahead: dict[int, list[tuple[int, bool]]] = {}
    for edges, far in ((mine, False), (theirs, True)):
        for one, two in edges.tolist():  # a face that closes an edge goes the other way
            ahead.setdefault(two, []).append((one, far))
    loops: list[tuple[list[int], set[bool]]] = []
    while ahead:
        loop, sides_of, side = [next(iter(ahead))], [False], False
        while loop[-1] in ahead:
            ways = ahead[loop[-1]]
            best = next((k for k, (_, far) in enumerate(ways) if far != side), 0)  # where sides meet, back on the other
            at, side = ways.pop(best)
            if not ways:
                del ahead[loop[-1]]
            if at in loop:
                first = loop.index(at)
                loops.append((loop[first:], {*sides_of[first + 1 :], side}))
                loop, sides_of = loop[: first + 1], sides_of[: first + 1]
            else:
                loop.append(at)
                sides_of.append(side)
    sides: tuple[list[list[int]], list[list[int]]] = ([], [])
    out: list[list[int]] = []
    for loop, kinds in loops:
        if len(kinds) == 2:
            out += _ears(points, loop)
        else:
            sides[kinds.pop()].append(loop)
    for other in sides[1]:
        if not sides[0]:
            break
        middle = points[other].mean(axis=0)
        mate = min(sides[0], key=lambda x: float(np.linalg.norm(points[x].mean(axis=0) - middle)))
        sides[0].remove(mate)
        out += _zipped(points, mate, other)
    return np.array(out, np.int32).reshape(-1, 3)


def _ears(points: Floats, loop: list[int]) -> list[list[int]]:
    """Triangles of a polygon, cut off one by one where the new edge is shortest."""
    loop, out = list(loop), []
    while len(loop) >= 3:
        p = points[loop]
        k = int(np.argmin(np.linalg.norm(np.roll(p, -1, axis=0) - np.roll(p, 1, axis=0), axis=1)))
        out.append([loop[k - 1], loop[k], loop[(k + 1) % len(loop)]])
        loop.pop(k)
        if len(loop) == 2:
            break
    return out


def _zipped(points: Floats, one: list[int], two: list[int]) -> list[list[int]]:
    """Triangles between two loops that go round in opposite ways."""
    apart = np.linalg.norm(points[one][:, None] - points[two][None], axis=2)
    i, j = (int(k) for k in np.unravel_index(int(np.argmin(apart)), apart.shape))
    one = one[i:] + one[: i + 1]
    back = two[::-1]
    j = len(two) - 1 - j
    back = back[j:] + back[: j + 1]
    out, a, b = [], 0, 0
    while a < len(one) - 1 or b < len(back) - 1:
        far = [np.inf, np.inf]
        if a < len(one) - 1:
            far[0] = float(np.linalg.norm(points[one[a + 1]] - points[back[b]]))
        if b < len(back) - 1:
            far[1] = float(np.linalg.norm(points[back[b + 1]] - points[one[a]]))
        if far[0] <= far[1]:
            out.append([one[a], one[a + 1], back[b]])
            a += 1
        else:
            out.append([one[a], back[b + 1], back[b]])
            b += 1
    return out
