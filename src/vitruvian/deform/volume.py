"""The "volume" operator: turns as "log" does, and keeps every cross-section centred on its bent bone.

Blending rigid motions lets the outside of a bend bulge, because the sections on both sides of a joint swing about the
joint as they turn. Here the rotation R of "log" is kept, and the section's centre c goes where the bone goes:
p' = R (p - c) + sum v_i M_i c. v_i, which sum to one, are the squares of the weights times how far the centre lies on the
bone of joint i; the centre is the mean, by these, of the vertex's feet on the bones of its joints. An influence divided
between two joints that move alike carries less than before. Where no section is one limb's (armpits) the result fades
to "log".

Weights that differ round a section turn its sides differently, which presses it flat: on limbs that the skin closes round
they are made even, see `sections`.

Related: B. Le and J. Hodgins, "Real-time skeletal skinning with optimized centers of rotation" (2016), whose centres come
from the weights alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.rotations import unit
from vitruvian.body.types import Body, Floats, Ints
from vitruvian.deform.bind import DUAL, WIDTHS, Influences, Laid
from vitruvian.deform.forks import forked
from vitruvian.deform.operators import Linear, Rigid, apply

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Single = NDArray[np.float32]
SHARP = 2  # power of the weights that carry the centres: more follows the bone closer and loses more volume
LEAST = 0.02  # what an influence counts for far from its bone
SOFT = 0.6  # radii on each side of a joint over which centres change bones
SQUARE, STRAIGHT = (0.0, 0.3), (0.34, 0.87)  # cosines between a bone and the next: see `_straightness`
EDGE = 8.0  # how fast a joint counts with its weight
BLUR = 6  # rounds in which neighbouring shares are averaged
SMOOTH = 2  # rounds in which neighbouring centres are averaged: feet jump where a bone forks
SPACING = 0.5  # radii between the stations at which the weights of a section are taken together
STATIONS = 64  # at most, along a bone
ROUND = (
    4  # times that the weights of a station are mixed with its neighbours': limbs bend over a length, not at a place
)
OPEN = (
    0.1,
    0.2,
)  # lengths of the mean direction over all that is seen from a section's centre: closed round it, and not
NEAR = 0.2  # mean radii: skin nearer to its centre is seen as from there
TIE = 1e-5  # of a bone: what lies in the plane of a joint, or of a bone's middle, does so after rounding too
LIGHT = 1 / WIDTHS[-1]  # weights below this are left out where they are made even: no kernel has room for more


@dataclass(frozen=True, eq=False)
class Volume:
    """Fits over `rigid`, a "log" operator; `center` (V,3), `radius` (V,) and its rows are those of `sections`."""

    rigid: Rigid
    center: Floats
    radius: Floats

    @cached_property
    def share(self) -> Floats:
        """(V,) how much of this the vertex gets, the rest of "log": all where sections are clear, see `_straightness`."""
        body, rows = self.rigid.body, self.rigid.rows
        return _clear(body, rows, _straightness(body, square=True))

    @cached_property
    def turned(self) -> Rigid:
        """The rotation of each vertex, at its centre."""
        body = self.rigid.body
        return replace(self.rigid, body=replace(body, skin=replace(body.skin, rest=self.center, morphs=())))

    @cached_property
    def carried(self) -> Linear:
        """The centres on their bones."""
        rows = self.rigid.rows
        moving = rows.joint < rows.joints  # the influence that does not move is what linear weights lack to one
        sharp = np.where(moving, _carrying(self.rigid.body, rows, self.center, self.radius), 0)
        add = lambda values: np.bincount(rows.vertex, values, minlength=len(rows))[rows.vertex]  # noqa: E731
        total = add(sharp)
        weight = sharp * add(np.where(moving, rows.weight, 0)) / np.where(total > 0, total, 1)
        row = np.zeros(len(rows) + 1, np.int32)
        np.cumsum(np.bincount(rows.vertex[moving], minlength=len(rows)), out=row[1:])
        kept = Influences(row, rows.joint[moving], weight[moving], rows.joints)
        return Linear(kept, self.center, self.rigid.threads)

    @cached_property
    def laid(self) -> tuple[Laid, NDArray[np.float32]]:
        """Buckets with centres and the weights that carry them, and the share (1,V) of what turns about them."""
        kept = self.carried.rows
        out = []
        for b in self.rigid.buckets:
            joint = b.joint // DUAL
            joint = np.repeat(joint[:, :, None], b.lanes, axis=2) if b.shared else joint
            vertex = b.vertices.reshape(-1, 1, b.lanes)
            carry = np.where(b.weight > 0, _look_up(kept, vertex, joint), 0)
            out.append(
                {
                    "center": b.lay(self.center),
                    "carry": np.ascontiguousarray(carry, dtype=np.float32),
                    "set": b.vertices.astype(np.int32),
                }
            )
        return Laid(self.rigid.buckets, tuple(out)), self.share[None].astype(np.float32)

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        if self.rigid.centred(matrices, out, rest, *self.laid):
            return
        self.rigid.points(matrices, out, rest)
        moved = self._placed(self.carried, matrices) - self._placed(self.turned, matrices)
        out += self.share.astype(np.float32)[:, None] * moved

    def frames(self, matrices: Floats, out: Single) -> None:
        self.rigid.frames(matrices, out)
        here = np.stack([apply(frame.astype(np.float64), self.center) for frame in out])
        out[..., 3] += self.share[:, None] * (self._placed(self.carried, matrices) - here)

    def _placed(self, operator: Linear | Rigid, matrices: Floats) -> Single:
        out = np.empty((len(matrices), len(self.center), 3), np.float32)
        operator.points(matrices, out)
        return out


def sections(body: Body, rows: Influences) -> tuple[Floats, Floats, Influences]:
    """The centre of each vertex's section at rest (V,3), its radius (V,), and the influences that turn it.

    Sections lie at stations along the bones of limbs, in planes that turn from bone to bone. There weights become means,
    by area, over all vertices whose centres are near, mixed with the stations before and after, so that thick limbs do not
    turn at one place; as far as the skin closes round the bone and the limb goes straight on at its joints: what is left
    keeps its own. The skin closes round a bone when directions from there, each by the angle under which its piece of
    skin is seen, cancel out, wherever in the limb the bone lies.
    """
    from scipy.sparse import csr_array, diags_array

    feet = _feet(body, rows)
    first = rows.sum @ feet
    carry = _carrying(body, rows, first, np.linalg.norm(body.skin.rest - first, axis=1))
    total = np.bincount(rows.vertex, carry, minlength=len(rows))
    mean = [np.bincount(rows.vertex, carry * feet[:, k], minlength=len(rows)) for k in range(3)]
    center = _averaged(np.stack(mean, axis=1) / np.where(total > 0, total, 1)[:, None], body, SMOOTH)

    count, joints = len(rows), rows.joints + 1
    radius = np.linalg.norm(body.skin.rest - center, axis=1)
    fanned, bone = _fanned(body, _bones(body, rows, center, radius), center)
    away, facing = body.skin.rest - fanned, _facing(body)
    radius, area = np.linalg.norm(away, axis=1), np.linalg.norm(facing, axis=1)
    at, links = _stations(body, bone, fanned, radius)
    parts = (at.T @ area)[:, None]
    over = lambda values: at @ ((at.T @ (values * area)) / np.where(parts > 0, parts, 1)[:, 0])  # noqa: E731
    mean = over(radius)
    toward = away / np.maximum(radius, 1e-9)[:, None]
    angle = (facing * toward).sum(axis=1) / np.maximum(radius, NEAR * mean + 1e-9)
    seen, ways = at @ (at.T @ angle), at @ (at.T @ (toward * angle[:, None]))
    direction = np.linalg.norm(ways, axis=1) / np.where(seen > 0, seen, np.inf)
    within = (at.sum(axis=1) > 0) & (seen > 0)
    closed = np.where(within, 1 - _smooth(direction, *OPEN), 0.0)
    share = _averaged(closed[:, None], body, BLUR)[:, 0] * within * _clear(body, rows, _straightness(body))
    center = center + share[:, None] * (fanned - center)
    radius = np.linalg.norm(body.skin.rest - center, axis=1)
    radius += share * (mean - radius)
    if not share.any() or rows.counts.max(initial=0) <= 1:  # pieces that ride on their joints stay as they are
        return center, radius, rows

    own = csr_array((rows.weight, rows.joint, rows.row), shape=(count, joints))
    means = diags_array(1 / np.where(parts > 0, parts, 1)[:, 0]) @ (at.T @ (diags_array(area) @ own))
    spread = _spread(links[(parts[links, 0] > 0).all(axis=1)], len(parts))
    for _ in range(ROUND):
        means = spread @ means
    even = at @ means
    mixed = (diags_array(share) @ even + diags_array(1 - share) @ own).tocoo()
    vertex, joint, weight = mixed.row, mixed.col, mixed.data
    touched = share[vertex] > 0
    largest = np.zeros(count)
    np.maximum.at(largest, vertex, weight)
    keep = np.where(touched, weight >= np.minimum(LIGHT, largest[vertex]), weight > 0)
    vertex, joint, weight, touched = vertex[keep], joint[keep], weight[keep], touched[keep]
    whole = np.bincount(vertex, weight, minlength=count)[vertex]
    weight = np.where(touched, weight / np.where(touched, whole, 1), weight)
    order = np.lexsort((joint, -weight, vertex))
    row = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=count))]).astype(np.int32)
    even = Influences(row, joint[order].astype(np.int32), weight[order], rows.joints)
    return forked(body, even, center, radius, area)


def _stations(body: Body, bone: Ints, center: Floats, radius: Floats) -> tuple[csr_array, Ints]:
    """(V,S) sparse: how much each vertex belongs to the two stations along its bone next to its centre, and which stations
    (n,2) follow each other. No station where a bone does not go on to just one other, or is shorter than the section is
    wide (vertebrae)."""
    from scipy.sparse import csr_array

    skeleton, count = body.skeleton, len(bone)
    stations = len(skeleton)  # a joint is where one bone ends and the next begins
    vertices, places, parts = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], [np.zeros(0)]
    links = [np.zeros((0, 2), np.int64)]
    for j in range(len(skeleton)):
        mine, below = np.flatnonzero(bone == j), np.flatnonzero(skeleton.parents == j)
        if not len(mine) or len(below) != 1:
            continue
        way = skeleton.centers[below[0]] - skeleton.centers[j]
        length, thick = float(np.linalg.norm(way)), float(radius[mine].mean())
        if length <= thick:
            continue
        steps = int(min(round(length / max(SPACING * thick, 1e-6)), STATIONS))
        along = np.clip((center[mine] - skeleton.centers[j]) @ way / length**2, 0, 1) * steps
        before = np.minimum(along.astype(np.int64), steps - 1)
        known = np.concatenate([[j], stations + np.arange(steps - 1), below])
        stations += steps - 1
        links.append(np.stack([known[:-1], known[1:]], axis=1))
        vertices += [mine, mine]
        places += [known[before], known[before + 1]]
        parts += [1 - (along - before), along - before]
    shape = (count, stations)
    at = csr_array((np.concatenate(parts), (np.concatenate(vertices), np.concatenate(places))), shape=shape)
    return at, np.concatenate(links)


def _spread(links: Ints, count: int) -> csr_array:
    """(S,S) sparse: half of each station and a quarter of its two neighbours; where there are not two, it alone."""
    from scipy.sparse import csr_array

    both = np.concatenate([links, links[:, ::-1]])
    inner = np.bincount(both[:, 0], minlength=count) == 2
    both = both[inner[both[:, 0]]]
    values = np.concatenate([np.where(inner, 0.5, 1.0), np.full(len(both), 0.25)])
    own = np.arange(count)
    places = (np.concatenate([own, both[:, 0]]), np.concatenate([own, both[:, 1]]))
    return csr_array((values, places), shape=(count, count))


def _facing(body: Body) -> Floats:
    """(V,3) the third of the areas of the faces at each vertex, along their normals, m2."""
    t, rest = body.skin.triangles, body.skin.rest
    a, b, c = (rest[t[:, k]] for k in range(3))
    third = np.cross(b - a, c - a) / 6
    corner = t.ravel()
    return np.stack([np.bincount(corner, np.repeat(third[:, k], 3), minlength=len(rest)) for k in range(3)], axis=1)


def _bones(body: Body, rows: Influences, center: Floats, radius: Floats) -> Ints:
    """(V,) the joint whose bone carries the centre of each vertex most; one past the last for none."""
    order = np.lexsort((_carrying(body, rows, center, radius), rows.vertex))
    bone = np.full(len(rows), len(body.skeleton))
    bone[rows.vertex[order]] = rows.joint[order]  # the last of each vertex stays
    return bone


def _fanned(body: Body, bone: Ints, center: Floats) -> tuple[Floats, Ints]:
    """The centres (V,3) of sections in planes that turn from one bone to the next between their middles, and the bones
    (V,) that these lie on, for bones and centres by the weights.

    Where a limb is bent at rest, feet on the two bones lie apart, and which of them counts more depends on weights, which
    differ round a section: so its points would get different centres. Planes depend on places alone.
    """
    centers, parents = body.skeleton.centers, body.skeleton.parents
    out, lies = center.copy(), bone.copy()
    only = {j: int(below[0]) for j in range(len(parents)) if len(below := np.flatnonzero(parents == j)) == 1}
    for j, k in only.items():
        mine = np.flatnonzero(bone == j)
        way = centers[k] - centers[j]
        size = float(np.linalg.norm(way))
        if not len(mine) or size < 1e-6:
            continue
        later = (center[mine] - centers[j]) @ way > size * size * (0.5 + TIE)
        for joint, some in ((j, mine[~later]), (k, mine[later])):
            above, after = int(parents[joint]), only.get(joint)
            into = way if only.get(above) != joint else centers[joint] - centers[above]
            on = way if after is None else centers[after] - centers[joint]
            place, ahead = _fan(body.skin.rest[some] - centers[joint], into / 2, on / 2)
            out[some] = place + centers[joint]
            if joint == j and only.get(above) == joint:
                lies[some[~ahead]] = above
            elif joint == k and after is not None:
                lies[some[ahead]] = joint
    return out, lies


def _fan(points: Floats, into: Floats, on: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """(n,3) where the planes through points (n,3) cut the line that comes to the origin by `into` (3,) and goes on by `on`
    (3,), and whether beyond the origin. Planes turn from the one to the other along it, and stay square to its ends."""
    lengths = np.linalg.norm([into, on], axis=1)
    if lengths.min() < 1e-6:
        into = on = into if lengths[0] > lengths[1] else on
        lengths = np.full(2, lengths.max())
    ways = np.stack([into, on]) / lengths[:, None]

    def plane(s: Floats) -> tuple[Floats, Floats]:
        h = _smooth(s, -1, 1)[:, None]
        normal = (1 - h) * ways[0] + h * ways[1]
        ahead = (s >= 0)[:, None]
        return np.where(ahead, s[:, None] * on, s[:, None] * into), normal / np.linalg.norm(normal, axis=1)[:, None]

    low, high = np.full(len(points), -1.0), np.full(len(points), 1.0)
    for _ in range(24):
        middle = (low + high) / 2
        at, normal = plane(middle)
        past = np.einsum("na,na->n", points - at, normal) > 0
        low, high = np.where(past, middle, low), np.where(past, high, middle)
    middle = (low + high) / 2
    at, normal = plane(middle)
    return at + np.einsum("na,na->n", points - at, normal)[:, None] * normal, middle >= -TIE


def _clear(body: Body, rows: Influences, straight: Floats) -> Floats:
    """(V,) 1 where no joint between bones that go on in another direction moves a vertex; `straight` (J,) of joints.

    A joint counts with all that lies past it on the limb, and with it all joints up to the next influence: skin of the
    armpit follows the chest and the upper arm, and the collar bone, which moves little of it, lies square to both.
    """
    above, parents = _above(body, rows), body.skeleton.parents
    has = np.flatnonzero(above >= 0)
    least, past = np.ones(len(rows.joint)), rows.weight.copy()
    on, at, top = has, rows.joint[has], rows.joint[above[has]]
    while len(on):
        least[on] = np.minimum(least[on], straight[at])
        at = parents[at]
        on, at, top = on[at != top], at[at != top], top[at != top]
    on, up = has, above[has]
    while len(on):
        np.add.at(past, up, rows.weight[on])
        on, up = on[above[up] >= 0], above[up]
        up = up[up >= 0]
    part = np.where(above >= 0, np.clip(EDGE * past * (1 - past), 0, 1), 0.0)
    out = np.ones(len(rows))
    np.multiply.at(out, rows.vertex, 1 - part * (1 - least))
    for _ in range(BLUR):  # narrow bands keep what they are: they are the ones that stretch most
        out = np.minimum(out, _averaged(out[:, None], body, 1)[:, 0])
    return np.clip(out, 0, 1)


def _carrying(body: Body, rows: Influences, center: Floats, radius: Floats) -> Floats:
    """(n,) how much each influence carries of the centre of its vertex, which is there; not yet of sum one."""
    return rows.weight**SHARP * (_membership(body, rows, center, radius) + LEAST)


def _membership(body: Body, rows: Influences, center: Floats, radius: Floats) -> Floats:
    """(n,) for each influence: how far the centre of its vertex lies past its joint and before the next ones, 0..1.

    Skin weights say how a section turns; they may be far from one half at the joint, and differ round a section. Where
    its centre belongs is told by the joints alone: bones change over at a joint, within a part of the radius.
    """
    skeleton = body.skeleton
    centers, parents = skeleton.centers, skeleton.parents
    count = len(skeleton)
    way = np.zeros((count + 1, 3))  # along the limb at each joint
    for j in range(count):
        bones = [unit(centers[k] - centers[j]) for k in np.flatnonzero(parents == j)]
        out = np.sum(bones, axis=0) if bones else np.zeros(3)
        if parents[j] >= 0:
            into = unit(centers[j] - centers[parents[j]])
            out = into + (unit(out) if np.linalg.norm(out) > 1e-9 else into)
        way[j] = unit(out) if np.linalg.norm(out) > 1e-9 else 0.0
    above = _above(body, rows)
    soft = np.maximum(radius, 1e-3)[rows.vertex] * SOFT
    past = np.einsum("na,na->n", center[rows.vertex] - np.vstack([centers, centers[:1]])[rows.joint], way[rows.joint])
    s = np.clip((past / soft + 1) / 2, 0.0, 1.0)
    s = s * s * (3 - 2 * s)
    has = np.flatnonzero(above >= 0)
    before = np.ones(len(above))
    np.multiply.at(before, above[has], 1 - s[has])
    return np.where(above >= 0, s, 1.0) * before


def _above(body: Body, rows: Influences) -> NDArray[np.int64]:
    """(n,) for each influence: the influence of the same vertex by the nearest joint up the tree, -1 for none."""
    parents, count = body.skeleton.parents, len(body.skeleton)
    key = rows.vertex.astype(np.int64) * (count + 1) + rows.joint
    order = np.argsort(key)
    above = np.full(len(key), -1, np.int64)  # the entry of the nearest joint up the tree that moves the vertex too
    parent = np.append(parents, -1)
    up = parent[rows.joint]
    for _ in range(count):
        seek = np.flatnonzero((above < 0) & (up >= 0))
        if not len(seek):
            break
        wanted = rows.vertex[seek].astype(np.int64) * (count + 1) + up[seek]
        at = np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)
        hit = key[order[at]] == wanted
        above[seek[hit]] = order[at[hit]]
        up[seek] = parent[up[seek]]
    return above


def _straightness(body: Body, square: bool = False) -> Floats:
    """(J,) how straight the limb goes on at a joint at rest, 0..1: elbow, knee, finger. With `square` also how square it
    goes off (hip): there sections are clear too, but not in between (shoulder), where it lies along what it hangs on."""
    centers, parents = body.skeleton.centers, body.skeleton.parents
    out = np.ones(len(parents))
    for j, parent in enumerate(parents):
        into = unit(centers[j] - centers[parent]) if parent >= 0 else np.zeros(3)
        bones = [float(unit(centers[k] - centers[j]) @ into) for k in np.flatnonzero(parents == j)]
        if parent >= 0 and bones:
            most = np.array(max(bones))
            out[j] = max(_smooth(most, *STRAIGHT), 1 - _smooth(most, *SQUARE) if square else 0)
    return out


def _smooth(x: Floats, low: float, high: float) -> Floats:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def _look_up(rows: Influences, vertex: Ints, joint: Ints) -> Floats:
    """Weights of joints on vertices, arrays of one shape; zero where a joint has none."""
    vertex, joint = np.broadcast_arrays(vertex.astype(np.int64), joint)
    if not len(rows.joint):
        return np.zeros(vertex.shape)
    size = rows.joints + 1
    known = rows.vertex.astype(np.int64) * size + rows.joint
    order = np.argsort(known)
    wanted = (vertex * size + joint).ravel()
    at = np.minimum(np.searchsorted(known, wanted, sorter=order), len(known) - 1)
    found = order[at]
    return np.where(known[found] == wanted, rows.weight[found], 0.0).reshape(vertex.shape)


def _feet(body: Body, rows: Influences) -> Floats:
    """(n,3) for each influence: the point nearest to its vertex on the bones that begin at its joint."""
    skeleton = body.skeleton
    centers, parents = skeleton.centers, skeleton.parents
    points = body.skin.rest[rows.vertex]
    out = points.copy()  # what does not move is its own centre
    order = np.argsort(rows.joint, kind="stable")
    bounds = np.searchsorted(rows.joint[order], np.arange(len(skeleton) + 1))
    for j in range(len(skeleton)):
        which = order[bounds[j] : bounds[j + 1]]
        if not len(which):
            continue
        p, start = points[which], centers[j]
        below = np.flatnonzero(parents == j)
        nearest = np.full(len(which), np.inf)
        for end in centers[below]:
            bone = end - start
            size = float(bone @ bone)
            if size < 1e-12:
                continue
            foot = start + np.clip((p - start) @ bone / size, 0, 1)[:, None] * bone
            if len(below) == 1:  # beyond a joint the bone's line goes on: sections there are cut by the neighbour too
                foot = start + ((p - start) @ bone / size)[:, None] * bone
            distance = np.linalg.norm(p - foot, axis=1)
            closer = distance < nearest
            out[which[closer]], nearest[closer] = foot[closer], distance[closer]
        if not np.isfinite(nearest).any():  # the last joint of a chain goes on as its parent's bone, else along itself
            bone = start - centers[parents[j]] if parents[j] >= 0 else p.mean(axis=0) - start
            size = float(bone @ bone)
            out[which] = start + ((p - start) @ bone / size)[:, None] * bone if size > 1e-12 else start
    return out


def _averaged(values: Floats, body: Body, rounds: int) -> Floats:
    """Each value with the mean of its neighbours on the surface, some times over; points at one place are one, so that
    seams stay shut."""
    from scipy.sparse import csr_array

    if not len(body.skin.triangles):
        return values
    _, where = np.unique(body.skin.rest, axis=0, return_inverse=True)
    where = where.reshape(-1)
    t, n = where[body.skin.triangles], int(where.max()) + 1
    shared = np.maximum(np.bincount(where), 1)
    values = np.stack([np.bincount(where, v, minlength=n) / shared for v in values.T], axis=1)
    a, b = t[:, [0, 1, 2]].ravel(), t[:, [1, 2, 0]].ravel()
    link = csr_array((np.ones(2 * len(a)), (np.concatenate([a, b]), np.concatenate([b, a]))), shape=(n, n))
    link.data[:] = 1
    count = np.asarray(link.sum(axis=1)).ravel()
    for _ in range(rounds):
        mean = (link @ values) / np.maximum(count, 1)[:, None]
        values = np.where(count[:, None] > 0, (values + mean) / 2, values)
    return values[where]
