"""Which links place which points of a hand, and what that takes that does not change with the pose.

Along a finger a point belongs to the nearest link: at their joint both links place it alike. Between fingers, and from
the fingers to the palm, shares follow the weights of the skin, so that nothing tears; across the palm a point belongs to
a metacarpal, to its neighbour and to the gap between them, by where it lies. The inner side of the palm is not inflated
unless the parameter `palm` says so.

Source: joint-dependent local operators for hands (1989), section 2; the shares are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.hands import Hand
from vitruvian.body.rotations import unit
from vitruvian.body.types import Floats, Ints, Skin
from vitruvian.native import kernels

LANES = 8  # terms of one link that the kernel works on at once
ARC = 1.6  # an arc's share of the link over the portion that is inflated
LEAST = 1e-3  # shares below this go to the others
EITHER = 0.2  # of the ways to both neighbours together: a point that is less far along one is the other's
Whole = NDArray[np.int64]
Term = tuple[Whole, Whole, Floats]  # which points, by which links, with what shares


@dataclass(frozen=True, eq=False)
class Assignment:
    """Which links place which points, whatever the parameters: `row` (n,) numbers of `hand.vertices`, `link` (n,) and
    `share` (n,); for the gaps of the palm `gap_row` (g,), `links` (g,2) and `gap_share` (g,). Shares of a point add up to
    what the hand has of it.
    """

    row: Ints
    link: Ints
    share: Floats
    gap_row: Ints
    links: Ints
    gap_share: Floats


@dataclass(frozen=True, eq=False)
class HandProgram:
    """An assignment with the parameters of the links worked in. L links, n terms, g gap terms.

    normal_near, normal_own, normal_far (L,3): towards the back of the hand at the two ends and between, at rest;
    axis_own (L,3). whole (N,): what the hand has of each of its vertices.
    vertex (n,); along (n,) R; shift (n,2): how far along the link an arc at its ends moves it; coefficients (n,3) of the
    frames at the near end, of the link and at the far end; local (n,3); swell (n,3): factors of the knuckle at the near
    end, at the far end, and of the muscle; press (n,): how far the palm side gives way where it would fold onto itself.
    previous (L,): the link that ends where each begins, -1 for none.
    gap_vertex (g,), alongs (g,2), gap_coefficients (g,2,3), across (g,),
    gap_local (g,3), fold (g,) factor of thickness, width (g,) rest distance.
    """

    hand: Hand
    assignment: Assignment
    normal_near: Floats
    normal_own: Floats
    normal_far: Floats
    axis_own: Floats
    whole: Floats
    vertex: Ints
    along: Floats
    shift: Floats
    coefficients: Floats
    local: Floats
    swell: Floats
    press: Floats
    previous: Ints
    gap_vertex: Ints
    alongs: Floats
    gap_coefficients: Floats
    across: Floats
    gap_local: Floats
    fold: Floats
    width: Floats

    @cached_property
    def bound(self) -> object:
        """As the kernel takes it."""
        hand, native = self.hand, kernels()
        assert native is not None
        arrays = (
            hand.before, hand.near, hand.far, self.previous, hand.start, hand.end, hand.axis_near, hand.axis_far,
            self.normal_near, self.normal_far, hand.vertices, self.whole, *self.blocks, *self.gap_blocks,
        )  # fmt: skip
        return native.bind_hand(*map(np.ascontiguousarray, arrays))

    def __getstate__(self) -> dict[str, object]:
        return {name: value for name, value in self.__dict__.items() if name != "bound"}

    @cached_property
    def blocks(self) -> tuple[Ints, Ints, NDArray[np.float32]]:
        """For the kernel: the link of each block of terms (B,), their vertices (B,8), and values (B,13,8)."""
        a = self.assignment
        values = (a.share, self.along, self.shift, self.coefficients[:, [0, 2]], self.local, self.swell, self.press)
        return _blocks(a.link, len(self.hand.near), self.vertex, values)

    @cached_property
    def gap_blocks(self) -> tuple[Ints, Ints, NDArray[np.float32]]:
        """The same of gaps: the two links of each block (B,2), vertices (B,8), and values (B,13,8)."""
        a = self.assignment
        values = (
            a.gap_share, self.across, self.alongs, self.gap_coefficients[:, 0][:, [0, 2]],
            self.gap_coefficients[:, 1][:, [0, 2]], self.gap_local, self.fold, self.width,
        )  # fmt: skip
        pairs, own = np.unique(a.links, axis=0, return_inverse=True)
        which, vertex, laid = _blocks(own.reshape(-1), len(pairs), self.gap_vertex, values)
        return pairs[which].astype(np.int32), vertex, laid


def _blocks(
    group: NDArray[np.integer], groups: int, vertex: Ints, values: Sequence[Floats]
) -> tuple[Ints, Ints, NDArray[np.float32]]:
    """Terms in blocks of `LANES` of one group (n,) of so many: the group of each block (B,), vertices (B,8), values
    (B,k,8). Blocks are filled up with zeros."""
    order = np.argsort(group, kind="stable")
    counts = np.bincount(group, minlength=groups)
    padded = -(-counts // LANES) * LANES
    first = np.concatenate([[0], np.cumsum(padded)])
    within = np.arange(len(order)) - np.concatenate([[0], np.cumsum(counts)])[group[order]]
    slot = first[group[order]] + within
    columns = np.column_stack(values)
    flat = np.zeros((int(first[-1]), columns.shape[1]), np.float32)
    flat[slot] = columns[order]
    own = np.full(int(first[-1]), int(vertex[0]) if len(vertex) else 0, np.int32)
    own[slot] = vertex[order]
    laid = flat.reshape(-1, LANES, columns.shape[1]).transpose(0, 2, 1)
    owner = np.repeat(np.arange(groups), padded // LANES).astype(np.int32)
    return owner, own.reshape(-1, LANES), np.ascontiguousarray(laid)


def assign(hand: Hand, skin: Skin) -> Assignment:
    """Which links place the points of a hand. Ties at a joint go to the link beyond it."""
    points = skin.rest[hand.vertices]
    count, links = len(points), len(hand.near)
    place = places(hand, points)
    foot = hand.start + np.clip(place, 0, 1)[..., None] * (hand.end - hand.start)
    distance = np.linalg.norm(points[:, None] - foot, axis=2)
    previous = hand.before_links()
    chain = np.zeros(links, np.int64)
    for link in range(links):  # a link comes after the one it hangs on
        chain[link] = link if previous[link] < 0 else chain[previous[link]]
    roots = np.flatnonzero(previous < 0)
    best = np.empty((count, len(roots)), np.int64)  # the nearest link of each finger
    for c, root in enumerate(roots):
        own = np.flatnonzero(chain == root)[::-1]
        best[:, c] = own[np.argmin(distance[:, own], axis=1)]
    weights = _chain_weights(hand, skin, chain, previous)
    palm = np.flatnonzero((hand.beside >= 0).any(axis=1))
    terms: list[Term] = []
    gap_row, pair, gap_part = np.zeros(0, np.int64), np.zeros((0, 2), np.int64), np.zeros(0)
    if len(palm):
        left = _fingers(terms, best, weights, np.isin(roots, palm))
        gap_row, pair, gap_part = _palm(terms, hand, points, place, distance, palm, left)
    else:
        _alone(terms, best, distance, weights)
    row = np.concatenate([t[0] for t in terms])
    owner = np.concatenate([t[1] for t in terms])
    part = np.concatenate([t[2] for t in terms])
    part, gap_part = np.maximum(part - LEAST, 0), np.maximum(gap_part - LEAST, 0)  # without a step
    keep, gap_keep = part > 0, gap_part > 0
    row, owner, part = row[keep], owner[keep], part[keep]
    gap_row, pair, gap_part = gap_row[gap_keep], pair[gap_keep], gap_part[gap_keep]
    held = np.bincount(row, part, minlength=count) + np.bincount(gap_row, gap_part, minlength=count)
    held = np.where(held > 0, held, 1.0)
    setting = _fade(hand, place, previous)
    part = part / held[row] * setting[row, owner] * hand.share[row]
    both = (setting[gap_row, pair[:, 0]] + setting[gap_row, pair[:, 1]]) / 2
    gap_part = gap_part / held[gap_row] * both * hand.share[gap_row]
    some, gap_some = part > 0, gap_part > 0
    return Assignment(
        row[some].astype(np.int32), owner[some].astype(np.int32), part[some], gap_row[gap_some].astype(np.int32),
        pair[gap_some].astype(np.int32), gap_part[gap_some],
    )  # fmt: skip


def _alone(terms: list[Term], best: Whole, distance: Floats, weights: tuple[Floats, Floats, Floats]) -> None:
    """Fingers without a palm: by the skin's weights, points without any by distance."""
    every = np.arange(len(best))
    alone = weights[0] + weights[1]
    amount = alone.sum(axis=1, keepdims=True)
    nearest = np.zeros_like(alone)
    nearest[every, np.argmin(distance[every[:, None], best], axis=1)] = 1
    part = np.where(amount > 1e-9, alone / np.where(amount > 1e-9, amount, 1), nearest)
    terms += [(every, best[:, c], part[:, c]) for c in range(best.shape[1])]


def _fingers(
    terms: list[Term], best: Whole, weights: tuple[Floats, Floats, Floats], in_palm: NDArray[np.bool_]
) -> Floats:
    """The thumb, and fingers beyond the palm, by the skin's weights; (N,) what is left for the palm. in_palm (C,)."""
    fingers, metacarpal, everything = weights
    every = np.arange(len(best))
    both = fingers + metacarpal
    thumb = both[:, ~in_palm] / np.where(everything > 1e-9, everything, 1.0)[:, None]
    terms += [(every, best[:, c], thumb[:, i]) for i, c in enumerate(np.flatnonzero(~in_palm).tolist())]
    left: Floats = 1 - thumb.sum(axis=1)
    beyond = fingers[:, in_palm]
    reach = beyond.sum(axis=1)
    below = np.maximum(everything - reach - both[:, ~in_palm].sum(axis=1), 0.0)
    share: Floats = reach / np.where(reach + below > 1e-9, reach + below, 1.0)
    amount = left * share / np.where(reach > 1e-9, reach, 1.0)
    terms += [(every, best[:, c], amount * beyond[:, i]) for i, c in enumerate(np.flatnonzero(in_palm).tolist())]
    return left * (1 - share)


def places(hand: Hand, points: Floats) -> Floats:
    """(N,L) the place R of points along every link, 0 at its first joint and 1 at its last, beyond them too."""
    bone = hand.end - hand.start
    out: Floats = np.einsum("nld,ld->nl", points[:, None] - hand.start, bone) / np.sum(bone * bone, axis=1)
    return out


def _chain_weights(hand: Hand, skin: Skin, chain: Whole, previous: Ints) -> tuple[Floats, Floats, Floats]:
    """(N,C) weights of the skin on the joints beyond the first link of each finger, on that of the first link when no
    other finger begins there, and (N,) on all joints."""
    weights = skin.weights
    roots = np.flatnonzero(previous < 0).tolist()
    number = {root: c for c, root in enumerate(roots)}
    place = np.full(len(skin.rest), -1, np.int64)
    place[hand.vertices] = np.arange(len(hand.vertices))
    entry = np.flatnonzero(place[weights.vertex] >= 0)
    row, joint, weight = place[weights.vertex[entry]], weights.joint[entry], weights.weight[entry]
    out = np.zeros((2, len(hand.vertices), len(roots)))
    for link, j in enumerate(hand.near.tolist()):
        if np.count_nonzero(hand.near == j) > 1:
            continue  # the wrist, when the metacarpals have no joints of their own
        own = joint == j
        part = np.bincount(row[own], weight[own], minlength=len(hand.vertices))
        out[int(previous[link] < 0), :, number[int(chain[link])]] += part
    return out[0], out[1], np.bincount(row, weight, minlength=len(hand.vertices)).astype(np.float64)


def _fade(hand: Hand, place: Floats, previous: Ints) -> Floats:
    """(N,L) how far the hand's deformation has set in for each point on each link."""
    out = np.ones_like(place)
    if hand.fade > 0:
        first = previous < 0
        out[:, first] = smooth(place[:, first] / hand.fade)
    return out


def smooth(x: Floats) -> Floats:
    """0 to 1 over 0 to 1, level at both ends."""
    t: Floats = np.clip(x, 0, 1)
    return t * t * (3 - 2 * t)


def _palm(
    terms: list[Term], hand: Hand, points: Floats, place: Floats, distance: Floats, palm: Whole, left: Floats
) -> Term:
    """The palm: the nearest metacarpal and its neighbours; gap rows, their links and shares."""
    best = palm[np.argmin(distance[:, palm], axis=1)]
    across = _across(hand, points, place, best)
    # Inside an arched palm the ways to both neighbours may begin: the one that is further along has the point.
    further = across / np.maximum(across.sum(axis=1, keepdims=True), 1e-12)
    side = smooth((further - EITHER) / (1 - 2 * EITHER))
    near, gap, far = _partition(across)
    none = 1 - side.sum(axis=1)  # beside no other metacarpal
    terms.append((np.arange(len(points)), best, left * (np.sum(side * near, axis=1) + none)))
    rows, which = np.nonzero(side > 0)
    other = hand.beside[best[rows], which]
    terms.append((rows, other, left[rows] * (side * far)[rows, which]))
    return rows, np.stack([best[rows], other], axis=1), left[rows] * (side * gap)[rows, which]


def _across(hand: Hand, points: Floats, place: Floats, best: Whole) -> Floats:
    """(N,2) how far points of the palm lie along the ways from their metacarpal to its two neighbours, 0 to 1."""
    across = np.zeros((len(points), 2))
    for side in (0, 1):
        beside = hand.beside[best, side]
        rows = np.flatnonzero(beside >= 0)
        one, two = best[rows], beside[rows]
        feet = [hand.start[k] + place[rows, k][:, None] * (hand.end[k] - hand.start[k]) for k in (one, two)]
        bridge = feet[1] - feet[0]
        part = np.sum((points[rows] - feet[0]) * bridge, axis=1) / np.maximum(np.sum(bridge * bridge, axis=1), 1e-12)
        across[rows, side] = np.clip(part, 0, 1)
    return across


def _partition(across: Floats) -> tuple[Floats, Floats, Floats]:
    """Shares of the near link, of the gap and of the far link: smooth, and one together."""
    near = 1 - smooth((across - 0.05) / 0.4)
    far = smooth((across - 0.55) / 0.4)
    return near, 1 - near - far, far


def hand_program(hand: Hand, skin: Skin, assignment: Assignment | None = None, *, plain: bool = False) -> HandProgram:
    """Everything about a hand that does not change with its pose.

    An `assignment` of the same hand is kept: then only what depends on parameters and on the place of points is worked
    out. `plain`: no second pass, that is no roundings, no arcs and no muscle.
    """
    a = assign(hand, skin) if assignment is None else assignment
    direction = unit(hand.end - hand.start)
    previous = hand.before_links()
    starts = {int(j): i for i, j in enumerate(previous) if j >= 0}
    follows = np.array([starts.get(i, i) for i in range(len(direction))])
    before = direction[np.where(previous >= 0, previous, np.arange(len(previous)))]
    normal_near = unit(np.cross(unit(before + direction), hand.axis_near))
    normal_far = unit(np.cross(unit(direction + direction[follows]), hand.axis_far))
    normal_own = unit(normal_near + normal_far)
    axis_own = unit(hand.axis_near + hand.axis_far)
    normals = np.stack([normal_near, normal_own, normal_far], axis=1)
    axes = -np.stack([hand.axis_near, axis_own, hand.axis_far], axis=1)

    points = skin.rest[hand.vertices]
    bone = hand.end - hand.start
    place = places(hand, points)
    along = place[a.row, a.link]
    outside, coefficients, shift = _zones(hand, normals, points[a.row], a.link, along, plain)
    at = hand.start[a.link] + along[:, None] * bone[a.link]
    local = np.einsum("nba,nb->na", frames(normals[a.link], axes[a.link], coefficients), points[a.row] - at)
    swell = np.zeros((len(along), 3)) if plain else _swell(hand, a.link, along, outside)

    press = np.zeros(len(along)) if plain else np.where(outside, 0.0, _each(hand, "arc", a.link))

    alongs = np.stack([place[a.gap_row, a.links[:, i]] for i in (0, 1)], axis=1)
    zones = [_zones(hand, normals, points[a.gap_row], a.links[:, i], alongs[:, i], plain, gap=True) for i in (0, 1)]
    gap_coefficients = np.stack([z[1] for z in zones], axis=1)
    feet = [hand.start[a.links[:, i]] + alongs[:, i, None] * bone[a.links[:, i]] for i in (0, 1)]
    bridge = feet[1] - feet[0]
    width = np.linalg.norm(bridge, axis=1)
    across = np.sum((points[a.gap_row] - feet[0]) * bridge, axis=1) / np.maximum(width, 1e-9) ** 2
    ys = [mixed(normals[a.links[:, i]], gap_coefficients[:, i]) for i in (0, 1)]
    basis = bridge_frames(bridge, ys[0], ys[1], across)
    gap_local = np.einsum("nba,nb->na", basis, points[a.gap_row] - feet[0] - across[:, None] * bridge)
    both = [(_each(hand, "muscle", k), _each(hand, "muscle", k) * _each(hand, "palm", k)) for k in a.links.T]
    outer, inner = np.mean(both, axis=0)
    fold = 0 * outer if plain else np.where(gap_local[:, 1] >= 0, outer, inner)
    count = len(hand.vertices)
    whole: Floats = np.bincount(a.row, a.share, minlength=count).astype(np.float64)
    whole += np.bincount(a.gap_row, a.gap_share, minlength=count)
    return HandProgram(
        hand, a, normal_near, normal_own, normal_far, axis_own, whole, hand.vertices[a.row], along, shift,
        coefficients, local, swell, press, previous, hand.vertices[a.gap_row], alongs, gap_coefficients, across,
        gap_local, fold, width,
    )  # fmt: skip


def _each(hand: Hand, name: str, link: Ints) -> Floats:
    """(n,) a parameter of the links of terms."""
    return np.array([getattr(r, name) for r in hand.roundings], np.float64)[link]


def _zones(
    hand: Hand, normals: Floats, points: Floats, link: Ints, along: Floats, plain: bool, *, gap: bool = False
) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Whether points lie on the back's side of their link; (n,3) coefficients of the frames at its near end, of its own
    and at its far end; (n,2) how far along the link they move where a bent joint is rounded to an arc.

    On the back the frame of a joint holds over the portion next to it, and they are interpolated between; on the palm's
    side they are interpolated from end to end. With an arc the frame turns from that of the joint to that of the link
    over the portion, and points next to the joint gather over it, so that the bones' corner does not show. In a `gap`,
    whose points stand off the link sideways, back and palm side pass into each other.
    """
    get = partial(_each, hand, link=link)
    inner: Floats = np.clip(along, 0, 1)
    normal = (1 - inner)[:, None] * normals[link, 0] + inner[:, None] * normals[link, 2]
    off = points - (hand.start[link] + along[:, None] * (hand.end - hand.start)[link])
    height = np.sum(off * normal, axis=1)
    outside = height >= 0
    near, far = get("near"), get("far")
    outer = np.clip((along - near) / np.maximum(1 - near - far, 1e-9), 0, 1)
    ends = lambda t: np.stack([1 - t, np.zeros_like(t), t], axis=1)  # noqa: E731
    arc = np.zeros_like(along) if plain else get("arc")
    # How much of the back's side a point is on: the sides of a finger stay where the bones are.
    up = smooth(3 * height / np.maximum(np.linalg.norm(off, axis=1), 1e-12))[:, None]
    near, far = np.minimum(ARC * near, 0.5), np.minimum(ARC * far, 0.5)
    one = np.clip(along / np.maximum(near, 1e-9), 0, 1)
    two = np.clip((1 - along) / np.maximum(far, 1e-9), 0, 1)
    bow = np.stack([(1 - one) ** 2, 1 - (1 - one) ** 2 - (1 - two) ** 2, (1 - two) ** 2], axis=1)
    flat, rounded = ends(outer), (1 - up) * ends(inner) + up * bow
    if gap:
        flat = (1 - up) * ends(inner) + up * flat
    coefficients = np.where(outside[:, None], (1 - arc)[:, None] * flat + arc[:, None] * rounded, ends(inner))
    shift = (
        np.where(outside, arc, 0.0)[:, None]
        * up
        * np.stack([-near * one * (1 - one) ** 2, far * two * (1 - two) ** 2], axis=1)
    )
    return outside, coefficients, shift


def _swell(hand: Hand, link: Ints, along: Floats, outside: NDArray[np.bool_]) -> Floats:
    """(n,3): how much each point is pushed out by the knuckle at the near end, at the far end, and by the muscle."""
    get = partial(_each, hand, link=link)
    bump = lambda u: np.where(np.abs(u) < 1, np.cos(np.pi * np.clip(u, -1, 1) / 2) ** 2, 0.0)  # noqa: E731
    near, far = np.maximum(get("near"), 1e-9), np.maximum(get("far"), 1e-9)
    power = np.log(0.5) / np.log(get("belly"))
    metacarpal = (hand.beside[link] >= 0).any(axis=1)
    muscle = get("muscle") * np.where(metacarpal, get("palm"), 1.0) * np.sin(np.pi * np.clip(along, 0, 1) ** power) ** 2
    return np.stack([
        np.where(outside, get("joint") * bump(along / near), 0.0),
        np.where(outside, get("joint") * bump((1 - along) / far), 0.0),
        np.where(outside, 0.0, muscle),
    ], axis=1)  # fmt: skip


def mixed(vectors: Floats, coefficients: Floats) -> Floats:
    """(n,3) unit sums of three vectors each (n,3,3) with coefficients (n,3)."""
    return unit(np.einsum("nk,nkd->nd", coefficients, vectors))


def frames(ys: Floats, zs: Floats, coefficients: Floats) -> Floats:
    """(n,3,3) with columns x, y, z: y the mixed normal exactly, z as near as can be to the mixed one."""
    y = mixed(ys, coefficients)
    z = np.einsum("nk,nkd->nd", coefficients, zs)
    z = unit(z - np.sum(z * y, axis=1, keepdims=True) * y)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def bridge_frames(bridge: Floats, y_one: Floats, y_two: Floats, part: Floats) -> Floats:
    """(n,3,3): x along the way between two links, y their interpolated normal made square to it."""
    x = unit(bridge)
    y = (1 - part)[:, None] * y_one + part[:, None] * y_two
    y = unit(y - np.sum(y * x, axis=1, keepdims=True) * x)
    return np.stack([x, y, np.cross(x, y)], axis=-1)
