"""Hands: every point keeps its place along its link and its distance from it, in frames that bend with the joints.

A point is given by its place R along its link, and by how it stands off the link in a frame whose y axis is the normal
towards the back of the hand. At a joint that normal is the mean of its direction on both links, so both agree there;
between, it is interpolated. Outside of a bent joint the surface is pushed out (the knuckle), on the palm side the muscle
swells. Between two metacarpals the frame's x axis is the line from one to the other, and what folds gets thicker.

Source: joint-dependent local operators for hands, "Simulation of object and human skin deformations in a grasping task"
(1989), section 2. Repaired: normals and side axes are averaged in the world, so that both links of a joint agree in any
pose, and the thickness factor F is the present distance of two links over the initial one, as the text has it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.hands import Hand
from vitruvian.body.rotations import unit
from vitruvian.body.types import Floats, Ints, Skin
from vitruvian.deform.operators import Operator
from vitruvian.native import kernels

Single = NDArray[np.float32]
SHARPNESS = 6.0  # power with which the nearer of two links wins
MOST = np.radians(120.0)  # flexion beyond which a knuckle grows no more


@dataclass(frozen=True, eq=False)
class HandProgram:
    """Terms, flat: each adds `share` times one way to place `vertex`. Link terms first by L links, then gap terms.

    normal_near, normal_far (L,3): directions towards the back of the hand at the two ends, at rest.
    link (n,), along (n,) R, blend (n,) where between the two ends' frames, local (n,3), swell (n,3): factors of the
    knuckle at the near end, at the far end, and of the muscle. links (g,2), alongs (g,2), blends (g,2), across (g,),
    gap_local (g,3), fold (g,) factor of thickness, width (g,) rest distance.
    """

    hand: Hand
    normal_near: Floats
    normal_far: Floats
    vertex: Ints
    share: Floats
    link: Ints
    along: Floats
    blend: Floats
    local: Floats
    swell: Floats
    gap_vertex: Ints
    gap_share: Floats
    links: Ints
    alongs: Floats
    blends: Floats
    across: Floats
    gap_local: Floats
    fold: Floats
    width: Floats


def hand_program(hand: Hand, skin: Skin) -> HandProgram:
    """Everything about a hand that does not change with its pose."""
    direction = unit(hand.end - hand.start)
    ends = {int(j): i for i, j in enumerate(hand.far) if j >= 0}  # joint -> the link that ends there
    starts = {int(j): i for i, j in enumerate(hand.near)}
    before = np.array([direction[ends[j]] if j in ends else direction[i] for i, j in enumerate(hand.near.tolist())])
    after = np.array([direction[starts[j]] if j in starts else direction[i] for i, j in enumerate(hand.far.tolist())])
    normal_near = unit(np.cross(unit(before + direction), hand.axis_near))
    normal_far = unit(np.cross(unit(direction + after), hand.axis_far))

    points = skin.rest[hand.vertices]
    length = np.linalg.norm(hand.end - hand.start, axis=1)
    place = np.einsum("nld,ld->nl", points[:, None] - hand.start, direction) / length  # R on every link
    foot = hand.start + np.clip(place, 0, 1)[..., None] * (hand.end - hand.start)
    distance = np.linalg.norm(points[:, None] - foot, axis=2)
    # Ties at a joint go to the link beyond it.
    order = np.argsort(distance - 1e-9 * np.arange(len(length)), axis=1, kind="stable")
    best = order[:, 0]
    terms: list[tuple[NDArray, NDArray, NDArray]] = []  # which points, link, share
    gaps: list[tuple[NDArray, NDArray, NDArray, NDArray]] = []
    left = np.ones(len(points))
    palm = hand.beside.max(axis=1) >= 0
    in_palm = np.take(palm, best)
    other, across = _neighbours(hand, points, place, best)
    some = in_palm & (other >= 0)
    rows = np.flatnonzero(some)
    near, gap, far = _partition(across[rows])
    terms.append((rows, best[rows], near))
    terms.append((rows, other[rows], far))
    gaps.append((rows, best[rows], other[rows], gap))
    rows = np.flatnonzero(~some)
    first = best[rows]
    if order.shape[1] > 1:
        second = order[rows, 1]
        a = np.maximum(distance[rows, first], 1e-9) ** SHARPNESS
        b = np.maximum(distance[rows, second], 1e-9) ** SHARPNESS
        chained = (hand.far[first] == hand.near[second]) | (hand.near[first] == hand.far[second])
        share = np.where(chained, 1.0, b / (a + b))  # along a finger both links agree at the joint: no blend is needed
        terms.append((rows, first, share))
        terms.append((rows, second, 1 - share))
    else:
        terms.append((rows, first, left[rows]))
    row = np.concatenate([t[0] for t in terms])
    link = np.concatenate([t[1] for t in terms])
    share = np.concatenate([t[2] for t in terms])
    keep = share > 0
    row, link, share = row[keep], link[keep], share[keep]
    along = place[row, link]
    outside, blend = _zones(hand, normal_near, normal_far, points[row], link, along)
    at = hand.start[link] + along[:, None] * (hand.end - hand.start)[link]
    frame = _frames(normal_near[link], normal_far[link], -hand.axis_near[link], -hand.axis_far[link], blend)
    local = np.einsum("nba,nb->na", frame, points[row] - at)
    swell = _swell(hand, link, along, outside)
    grow = np.concatenate([g[0] for g in gaps])
    one, two = np.concatenate([g[1] for g in gaps]), np.concatenate([g[2] for g in gaps])
    gap_share = np.concatenate([g[3] for g in gaps])
    keep = gap_share > 0
    grow, one, two, gap_share = grow[keep], one[keep], two[keep], gap_share[keep]
    links = np.stack([one, two], axis=1).astype(np.int32)
    alongs = np.stack([place[grow, one], place[grow, two]], axis=1)
    _, blend_one = _zones(hand, normal_near, normal_far, points[grow], one, alongs[:, 0])
    outside, blend_two = _zones(hand, normal_near, normal_far, points[grow], two, alongs[:, 1])
    blends = np.stack([blend_one, blend_two], axis=1)
    feet = [hand.start[k] + alongs[:, i, None] * (hand.end - hand.start)[k] for i, k in enumerate((one, two))]
    bridge = feet[1] - feet[0]
    width = np.linalg.norm(bridge, axis=1)
    part = np.sum((points[grow] - feet[0]) * bridge, axis=1) / np.maximum(width, 1e-9) ** 2
    ys = [
        _frames(normal_near[k], normal_far[k], -hand.axis_near[k], -hand.axis_far[k], blends[:, i])[..., 1]
        for i, k in enumerate((one, two))
    ]
    basis = _bridge(bridge, ys[0], ys[1], part)
    gap_local = np.einsum("nba,nb->na", basis, points[grow] - feet[0] - part[:, None] * bridge)
    muscle = np.array([r.muscle for r in hand.roundings])
    fold = np.where(outside, (muscle[one] + muscle[two]) / 2, 0.0)
    return HandProgram(
        hand, normal_near, normal_far,
        hand.vertices[row], share * hand.share[row], link.astype(np.int32), along, blend, local, swell,
        hand.vertices[grow], gap_share * hand.share[grow], links, alongs, blends, part, gap_local, fold, width,
    )  # fmt: skip


def _neighbours(hand: Hand, points: Floats, place: Floats, best: NDArray) -> tuple[NDArray, Floats]:
    """For points of the palm: the metacarpal on whose side they lie (-1: none), and how far along the way to it."""
    out = np.full(len(points), -1)
    across = np.zeros(len(points))
    for side in (0, 1):
        beside = hand.beside[best, side]
        rows = np.flatnonzero(beside >= 0)
        one, two = best[rows], beside[rows]
        feet = [hand.start[k] + place[rows, k][:, None] * (hand.end[k] - hand.start[k]) for k in (one, two)]
        bridge = feet[1] - feet[0]
        part = np.sum((points[rows] - feet[0]) * bridge, axis=1) / np.maximum(np.sum(bridge * bridge, axis=1), 1e-12)
        better = (part > across[rows]) & (part > 0)
        out[rows[better]], across[rows[better]] = two[better], part[better]
    return out, np.clip(across, 0, 1)


def _partition(across: Floats) -> tuple[Floats, Floats, Floats]:
    """Shares of the near link, of the gap and of the far link: smooth, and one together."""
    smooth = lambda x: np.clip(x, 0, 1) ** 2 * (3 - 2 * np.clip(x, 0, 1))  # noqa: E731
    near = 1 - smooth((across - 0.05) / 0.4)
    far = smooth((across - 0.55) / 0.4)
    return near, 1 - near - far, far


def _zones(
    hand: Hand, normal_near: Floats, normal_far: Floats, points: Floats, link: NDArray, along: Floats
) -> tuple[NDArray[np.bool_], Floats]:
    """Whether points lie on the back's side of their link, and where between the frames of its two ends.

    On the back the frame of a joint holds over the portion next to it, and they are interpolated between; on the palm's
    side they are interpolated from end to end.
    """
    inner: Floats = np.clip(along, 0, 1)
    normal = (1 - inner)[:, None] * normal_near[link] + inner[:, None] * normal_far[link]
    at = hand.start[link] + along[:, None] * (hand.end - hand.start)[link]
    outside = np.sum((points - at) * normal, axis=1) >= 0
    near = np.array([r.near for r in hand.roundings])[link]
    far = np.array([r.far for r in hand.roundings])[link]
    outer = np.clip((along - near) / np.maximum(1 - near - far, 1e-9), 0, 1)
    return outside, np.where(outside, outer, inner)


def _swell(hand: Hand, link: NDArray, along: Floats, outside: NDArray[np.bool_]) -> Floats:
    """(n,3): how much each point is pushed out by the knuckle at the near end, at the far end, and by the muscle."""
    get = lambda name: np.array([getattr(r, name) for r in hand.roundings])[link]  # noqa: E731
    bump = lambda u: np.where(np.abs(u) < 1, np.cos(np.pi * np.clip(u, -1, 1) / 2) ** 2, 0.0)  # noqa: E731
    near, far = np.maximum(get("near"), 1e-9), np.maximum(get("far"), 1e-9)
    power = np.log(0.5) / np.log(get("belly"))
    muscle = get("muscle") * np.sin(np.pi * np.clip(along, 0, 1) ** power) ** 2
    return np.stack([
        np.where(outside, get("joint") * bump(along / near), 0.0),
        np.where(outside, get("joint") * bump((1 - along) / far), 0.0),
        np.where(outside, 0.0, muscle),
    ], axis=1)  # fmt: skip


def _frames(y_near: Floats, y_far: Floats, z_near: Floats, z_far: Floats, blend: Floats) -> Floats:
    """(n,3,3) with columns x, y, z: y the interpolated normal exactly, z as near as can be to the interpolated one."""
    t = blend[:, None]
    y = unit((1 - t) * y_near + t * y_far)
    z = (1 - t) * z_near + t * z_far
    z = unit(z - np.sum(z * y, axis=1, keepdims=True) * y)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _bridge(bridge: Floats, y_one: Floats, y_two: Floats, part: Floats) -> Floats:
    """(n,3,3): x along the way between two links, y their interpolated normal made square to it."""
    x = unit(bridge)
    y = (1 - part)[:, None] * y_one + part[:, None] * y_two
    y = unit(y - np.sum(y * x, axis=1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=-1)


@dataclass(frozen=True, eq=False)
class Bent:
    """Links in one pose: ends (L,3), normals and side axes at both ends (L,3), bend (L,3): knuckles and muscle."""

    start: Floats
    end: Floats
    y_near: Floats
    y_far: Floats
    z_near: Floats
    z_far: Floats
    bend: Floats


def bent(program: HandProgram, matrices: Floats) -> Bent:
    """The links of a hand for joint matrices (J,4,4)."""
    hand = program.hand
    rotation = matrices[:, :3, :3]
    own = rotation[hand.near]
    before = np.where((hand.before >= 0)[:, None, None], rotation[hand.before], own)
    after = np.where((hand.far >= 0)[:, None, None], rotation[hand.far], own)
    turn = lambda r, v: np.einsum("lab,lb->la", r, v)  # noqa: E731
    put = lambda m, p: np.einsum("lab,lb->la", m[:, :3, :3], p) + m[:, :3, 3]  # noqa: E731
    far = np.where((hand.far >= 0)[:, None, None], matrices[hand.far], matrices[hand.near])
    y_near = unit(turn(before, program.normal_near) + turn(own, program.normal_near))
    y_far = unit(turn(own, program.normal_far) + turn(after, program.normal_far))
    square = lambda z, y: unit(z - np.sum(z * y, axis=1, keepdims=True) * y)  # noqa: E731
    z_near = square(-turn(before, hand.axis_near) - turn(own, hand.axis_near), y_near)
    z_far = square(-turn(own, hand.axis_far) - turn(after, hand.axis_far), y_far)
    flex_near = _flexion(before, own, hand.axis_near)
    flex_far = _flexion(own, after, hand.axis_far)
    knuckle = lambda a: 1 / np.cos(np.clip(a, 0, MOST) / 2) - 1  # noqa: E731
    muscle = 1 - np.cos(np.maximum(0, (flex_near + flex_far) / 2))
    bend = np.stack([knuckle(flex_near), knuckle(flex_far), muscle], axis=1)
    return Bent(put(matrices[hand.near], hand.start), put(far, hand.end), y_near, y_far, z_near, z_far, bend)


def _flexion(one: Floats, two: Floats, axis: Floats) -> Floats:
    """(L,) signed angle about `axis` of the rotation from `one` to `two`."""
    from vitruvian.body.rotations import from_matrix

    q = from_matrix(np.swapaxes(one, 1, 2) @ two)
    q = np.where(q[:, 3:] < 0, -q, q)
    return 2 * np.arctan2(np.sum(q[:, :3] * axis, axis=1), q[:, 3])


def place(program: HandProgram, matrices: Floats, out: Single) -> None:
    """Move the hand's vertices of `out` (F,V,3) by their share to where joint matrices (F,J,4,4) put them."""
    native = kernels()
    p, hand = program, program.hand
    if native is not None:
        native.hand(
            np.ascontiguousarray(matrices), hand.before, hand.near, hand.far, hand.start, hand.end, hand.axis_near,
            hand.axis_far, p.normal_near, p.normal_far, hand.vertices, hand.share, p.vertex, p.link, p.share, p.along,
            p.blend, p.local, p.swell, p.gap_vertex, p.links, p.gap_share, p.alongs, p.blends, p.across, p.gap_local,
            p.fold, p.width, out,
        )  # fmt: skip
        return
    for f, frame in enumerate(matrices):
        moved = np.zeros((out.shape[1], 3))
        _add(program, bent(program, frame), moved)
        rest = out[f, hand.vertices].astype(np.float64)
        out[f, hand.vertices] = (1 - hand.share)[:, None] * rest + moved[hand.vertices]


def _add(program: HandProgram, pose: Bent, moved: Floats) -> None:
    p, k = program, program.link
    foot = pose.start[k] + p.along[:, None] * (pose.end - pose.start)[k]
    frame = _frames(pose.y_near[k], pose.y_far[k], pose.z_near[k], pose.z_far[k], p.blend)
    local = p.local.copy()
    local[:, 1] *= 1 + np.sum(p.swell * pose.bend[k], axis=1)
    np.add.at(moved, p.vertex, p.share[:, None] * (foot + np.einsum("nab,nb->na", frame, local)))
    if not len(p.gap_vertex):
        return
    feet, ys = [], []
    for i in (0, 1):
        k = p.links[:, i]
        feet.append(pose.start[k] + p.alongs[:, i, None] * (pose.end - pose.start)[k])
        ys.append(_frames(pose.y_near[k], pose.y_far[k], pose.z_near[k], pose.z_far[k], p.blends[:, i])[..., 1])
    bridge = feet[1] - feet[0]
    ratio = np.where(p.width < 1e-6, 1.0, np.linalg.norm(bridge, axis=1) / np.maximum(p.width, 1e-6))
    local = p.gap_local.copy()
    thicker = np.minimum(1 + p.fold * (1 / np.maximum(ratio, 1e-6) - 1), 2.0)
    local[:, 1] *= np.where(ratio < 1, thicker, 1.0)
    frame = _bridge(bridge, ys[0], ys[1], p.across)
    where = feet[0] + p.across[:, None] * bridge + np.einsum("nab,nb->na", frame, local)
    np.add.at(moved, p.gap_vertex, p.gap_share[:, None] * where)


@dataclass(frozen=True, eq=False)
class HandOperator:
    """Another operator, with hands placed over it."""

    base: Operator
    skin: Skin
    hands: tuple[Hand, ...]

    @cached_property
    def programs(self) -> tuple[HandProgram, ...]:
        return tuple(hand_program(hand, self.skin) for hand in self.hands)

    def points(self, matrices: Floats, out: Single, rest: Floats | None = None) -> None:
        self.base.points(matrices, out, rest)
        programs = self.programs
        if rest is not None:  # displaced: the hand's points stand elsewhere on their links
            programs = tuple(hand_program(hand, replace(self.skin, rest=rest, morphs=())) for hand in self.hands)
        for program in programs:
            place(program, matrices, out)

    def frames(self, matrices: Floats, out: Single) -> None:
        """The base operator's, moved to where the hand's points are."""
        self.base.frames(matrices, out)
        for program in self.programs:
            own = program.hand.vertices
            rest = self.skin.rest[own]
            points = np.zeros((len(out), len(self.skin.rest), 3), np.float32)
            part = out[:, own]
            turned = np.einsum("fvab,vb->fva", part[..., :3].astype(np.float64), rest)
            points[:, own] = turned + part[..., 3]
            place(program, matrices, points)
            part[..., 3] = points[:, own] - turned
            out[:, own] = part
