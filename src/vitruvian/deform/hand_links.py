"""The hands of a body: links from the wrist to the fingertips by the names of the standard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vitruvian.body.hands import Hand, Rounding
from vitruvian.body.rotations import unit
from vitruvian.body.types import Body, Floats, Ints, Skeleton
from vitruvian.errors import VitruvianError
from vitruvian.hanim.tables import canonical

SMALL = 0.8  # of the median link: a rigid piece that is shorter is no part of a finger
FOREIGN = 4.0  # times the weight on other limbs: by so much less is a point wholly the hand's
FADE = 0.35  # of the palm, over which the hand sets in beyond the wrist
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
# Joints of each ray from the wrist on; the thumb has one less.
RAYS = {
    1: ("carpometacarpal_1", "metacarpophalangeal_1", "carpal_interphalangeal_1"),
    **{
        k: (f"carpometacarpal_{k}", f"metacarpophalangeal_{k}", f"carpal_proximal_interphalangeal_{k}",
            f"carpal_distal_interphalangeal_{k}")
        for k in range(2, 6)
    },
}  # fmt: skip


def hands_of(
    body: Body, roundings: Mapping[str, Rounding] | None = None, *, like: tuple[Hand, ...] = ()
) -> tuple[Hand, ...]:
    """Left and right hand of a body, those that have a wrist and at least two fingers.

    `roundings`: by the name of a link's first joint ("l_metacarpophalangeal_2"), by a ray ("index", "l_index"), or ""
    for all; they come before those stored with the body. `like`: hands of the same body whose vertices are kept.
    Raises VitruvianError for a name that no link has.
    """
    given = dict(roundings or {})
    index: dict[str, int] = {}
    for i, name in enumerate(body.skeleton.names):
        known = canonical(name)
        if known:
            index.setdefault(known, i)
    before = {hand.name[0]: (hand.vertices, hand.share) for hand in like}
    made = [hand for side in "lr" if (hand := _hand(body, index, side, given, before.get(side))) is not None]
    used = {key for hand in made for key in _keys(body.skeleton, hand)}
    unknown = sorted(set(given) - used - {""})
    if unknown:
        raise VitruvianError(f"roundings: expected joints or rays of a hand, found {', '.join(unknown[:4])}")
    return tuple(made)


def _keys(skeleton: Skeleton, hand: Hand) -> set[str]:
    out = {*FINGERS, *(f"{hand.name[0]}_{finger}" for finger in FINGERS)}
    for j in hand.near.tolist():
        out |= {skeleton.names[j], canonical(skeleton.names[j]) or ""}
    return out


def _hand(
    body: Body,
    index: Mapping[str, int],
    side: str,
    given: Mapping[str, Rounding],
    skin: tuple[Ints, Floats] | None,
) -> Hand | None:
    skeleton = body.skeleton
    wrist = index.get(f"{side}_radiocarpal")
    knuckles = {k: index[name] for k in range(2, 6) if (name := f"{side}_metacarpophalangeal_{k}") in index}
    if wrist is None or len(knuckles) < 2:
        return None
    first, last = skeleton.centers[knuckles[min(knuckles)]], skeleton.centers[knuckles[max(knuckles)]]
    center = skeleton.centers[wrist]
    back = unit(np.cross(first - center, last - center)) * (1 if side == "l" else -1)
    radial = unit(first - last)  # towards the thumb
    before: list[int] = []
    near: list[int] = []
    far: list[int] = []
    start, end, axes, rays = [], [], [], []
    beside: list[list[int]] = []
    palm: dict[int, int] = {}
    for ray, names in RAYS.items():
        joints = [index[f"{side}_{name}"] for name in names if f"{side}_{name}" in index]
        if not joints:
            continue
        if ray > 1 and f"{side}_carpometacarpal_{ray}" not in index:
            joints = [wrist, *joints]
        normal = back if ray > 1 else unit(0.5 * back + 0.87 * radial)
        tip = _tip(skeleton, side, ray, joints)
        ends = [*(skeleton.centers[j] for j in joints[1:]), tip]
        for n, joint in enumerate(joints):
            here = skeleton.centers[joint]
            if np.linalg.norm(ends[n] - here) < 1e-6:
                continue
            if n == 0:
                palm[ray] = len(near)
            before.append(int(skeleton.parents[joint]))
            near.append(joint)
            far.append(joints[n + 1] if n + 1 < len(joints) else -1)
            start.append(here)
            end.append(ends[n])
            direction = unit(ends[n] - here)
            axes.append(unit(np.cross(normal, direction)))
            rays.append(ray)
            beside.append([-1, -1])
    for ray, link in palm.items():
        if ray > 1:
            beside[link] = [palm[k] if k > 1 and k in palm else -1 for k in (ray - 1, ray + 1)]
    start_, end_ = np.array(start), np.array(end)
    axis_near = np.array(axes)
    axis_far = axis_near.copy()
    for i, joint in enumerate(far):
        if joint >= 0 and joint in near:
            axis_far[i] = axis_near[near.index(joint)]
    vertices, share = _skin(body, wrist, start_, end_) if skin is None else skin
    names = skeleton.names
    chosen = tuple(
        _rounding((given, body.roundings), names[joint], side, FINGERS[ray - 1])
        for joint, ray in zip(near, rays, strict=True)
    )
    return Hand(
        f"{side}_hand", np.array(before), np.array(near), np.array(far), start_, end_, axis_near, axis_far,
        np.array(beside), vertices, share, chosen, FADE,
    ).rounded(chosen)  # fmt: skip


def _rounding(tables: Sequence[Mapping[str, Rounding]], joint: str, side: str, finger: str) -> Rounding:
    for table in tables:
        for key in (joint, canonical(joint) or joint, f"{side}_{finger}", finger, ""):
            if key in table:
                return table[key]
    return Rounding()


def _tip(skeleton: Skeleton, side: str, ray: int, joints: list[int]) -> Floats:
    """The end of the last phalanx: its `_tip` Site, else as long as four fifths of the one before."""
    for name in (f"{side}_{FINGERS[ray - 1]}_distal_tip", f"{side}_carpal_distal_phalanx_{ray}_tip"):
        if name in skeleton.site_index:
            return skeleton.site_points[skeleton.site_index[name]]
    last = skeleton.centers[joints[-1]]
    return last + 0.8 * (last - skeleton.centers[joints[-2]]) if len(joints) > 1 else last


def _skin(body: Body, wrist: int, start: Floats, end: Floats) -> tuple[Ints, Floats]:
    """Vertices that move with the hand, beyond the beginning of its bones, and how much of its deformation each takes.

    All of it, but where other limbs pull as well (thighs that files hang on the fingers next to them): then only as much
    as the weights give to the hand.
    """
    parents = body.skeleton.parents
    below, arm = np.zeros(len(parents), bool), np.zeros(len(parents), bool)
    for j, parent in enumerate(parents):
        below[j] = j == wrist or (parent >= 0 and below[parent])
    above = int(parents[wrist])
    while above >= 0:
        arm[above] = True
        above = int(parents[above])
    weights = body.skin.weights
    held = np.bincount(weights.vertex, weights.weight * below[weights.joint], minlength=len(weights))
    other = np.bincount(weights.vertex, weights.weight * ~(below | arm)[weights.joint], minlength=len(weights))
    whole = np.clip(1 - FOREIGN * other, 0, 1)
    share = whole + (1 - whole) * np.clip(held, 0, 1)
    vertices = np.flatnonzero(held > 0.1).astype(np.int32)
    bone = end - start
    place = np.einsum("nld,ld->nl", body.skin.rest[vertices][:, None] - start, bone) / np.sum(bone * bone, axis=1)
    vertices = vertices[(place > 0).any(axis=1)]
    vertices = vertices[~_marks(body, vertices, float(np.median(np.linalg.norm(bone, axis=1))))]
    return vertices, share[vertices]


def _marks(body: Body, vertices: Ints, length: float) -> np.ndarray:
    """(N,) which vertices are of pieces that one joint holds and that are much smaller than a link: balls that mark joints,
    nails, rings. They have nothing to deform."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    skin = body.skin
    place = np.full(len(skin.rest), -1)
    place[vertices] = np.arange(len(vertices))
    corner = place[skin.triangles]
    corner = corner[(corner >= 0).all(axis=1)]
    edges = np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]]])
    _, same = np.unique(skin.rest[vertices], axis=0, return_inverse=True)
    count = int(same.max(initial=-1)) + 1
    links = csr_array((np.ones(len(edges)), (same[edges[:, 0]], same[edges[:, 1]])), shape=(count, count))
    piece = connected_components(links, directed=False)[1][same]
    joint, weight = (a[:, 0] for a in skin.weights.top(1))
    joint, alone = joint[vertices], weight[vertices] > 0.999
    number = int(piece.max(initial=-1)) + 1
    low, high = np.full((number, 3), np.inf), np.full((number, 3), -np.inf)
    np.minimum.at(low, piece, skin.rest[vertices])
    np.maximum.at(high, piece, skin.rest[vertices])
    first, last = np.full(number, len(body.skeleton)), np.full(number, -1)
    np.minimum.at(first, piece, joint)
    np.maximum.at(last, piece, joint)
    held = np.ones(number, bool)
    np.logical_and.at(held, piece, alone)
    small = (high - low).max(axis=1) < SMALL * length
    return np.asarray((small & held & (first == last))[piece])
