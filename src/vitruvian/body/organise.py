"""Editable contour surfaces to packed ones: which joints turn which contour, from DefBody's parameters and the names.

Surfaces on the spine are a torso: the bend of each vertebra grows across its zone, its twist is spread from the bottom.
Surfaces on the neck bend the same way and go with the skull where they meet it, for the face is bone. All others are limbs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vitruvian.body.contours import Contours, limb, spine_shares, spine_wound, steps
from vitruvian.body.types import Floats, Ints, Skeleton
from vitruvian.errors import warn
from vitruvian.hanim.humanoid import ContourSurface
from vitruvian.hanim.tables import canonical

SPINE = (*(f"vl{i}" for i in range(5, 0, -1)), *(f"vt{i}" for i in range(12, 0, -1)))
SAME = 1e-6  # metres within which points of neighbouring surfaces are one
_NOD = 0.75  # radians that a neck can be nodded by without folding
NECK = tuple(f"vc{i}" for i in range(7, 0, -1))


def organised(surfaces: Sequence[tuple[int, ContourSurface, Ints]], skeleton: Skeleton) -> tuple[Contours, ...]:
    """Packed contours of (joint, surface, vertex numbers (C,P)) triples."""
    index: dict[str, int] = {}
    for i, name in enumerate(skeleton.names):
        index.setdefault(canonical(name) or name, i)
    kind = {i: name for name, i in index.items()}
    spread = {joint for joint, surface, _ in surfaces if surface.spread}
    out = []
    for joint, surface, numbers in surfaces:
        name = kind.get(joint, "")
        if name in SPINE:
            out.append(_torso(joint, surface, numbers, skeleton, [index[n] for n in SPINE if n in index]))
        elif name in NECK or (name == "skullbase" and not any(n in index for n in NECK)):
            chain = [index[n] for n in NECK if n in index]
            out.append(_neck(joint, surface, numbers, skeleton, chain, index.get("skullbase")))
        else:
            made = _limb(joint, surface, numbers, skeleton, {j for j, _, _ in surfaces}, spread)
            out.append(_met(made, surface, _above(surface, joint, surfaces, skeleton)))
    return tuple(out)


def _above(
    s: ContourSurface, joint: int, surfaces: Sequence[tuple[int, ContourSurface, Ints]], skeleton: Skeleton
) -> ContourSurface | None:
    """The surface on the parent joint that ends with a ramp where this one begins."""
    above = int(skeleton.parents[joint])
    for other, q, _ in surfaces:
        meets = other == above and q.lower and q.points.shape[1] == s.points.shape[1]
        if meets and np.abs(q.points[-1] - s.points[0]).max() < SAME:
            return q
    return None


def _met(made: Contours, s: ContourSurface, above: ContourSurface | None) -> Contours:
    """A limb whose first contour does as the last of the surface above it, so that the seam stays closed where the two
    have other parameters. Warns where it takes none of the half that the one above takes. Where nothing is above, the
    ramp begins on another part, whose bone the contours cannot keep to."""
    recentre, mitre = made.recentre.copy(), made.mitre.copy()
    if above is None:
        recentre[made.swing[:, 0] < 1] = 0
    else:
        if not (s.upper or s.fixed_upper):
            warn(f"contours {s.name}: UpperDef is 0 but {above.name} has a ramp that ends at its seam, which will tear")
        if made.swing[0, 0] == 0.5:
            recentre[0], mitre[0] = float(above.recentre), above.mitre
    belly = s.bulge * np.sin(np.pi * np.linspace(0, 1, len(made))) ** 2
    belly[[0, -1]] = 0
    return replace(made, recentre=recentre, mitre=mitre, bulge=belly, muscle=len(made.joints) - 1 if s.bulge else -1)


def joined(points: Floats, contours: Sequence[Contours]) -> tuple[Floats, tuple[Contours, ...]]:
    """Rest points (V,3) with those within a micrometre of a contour's end or side moved onto it, and contours that know
    the vertices so tied to their ends. Files round: so what was one point stays one, to the bit.
    """
    from scipy.spatial import cKDTree

    edge = [s.vertices[[0, -1]].ravel() for s in contours]
    edge += [s.vertices[:, [0, -1]].ravel() for s in contours if not s.closed]
    edges = np.unique(np.concatenate(edge))
    out = points.copy()
    pairs = cKDTree(points[edges]).query_pairs(SAME, output_type="ndarray")
    for a, b in pairs[np.argsort(pairs[:, 0], kind="stable")].tolist() if len(pairs) else []:
        out[edges[b]] = out[edges[a]]
    outside = np.ones(len(points), bool)
    for s in contours:
        outside[s.vertices] = False
    others, free, made = np.flatnonzero(outside), outside.copy(), []
    tree = cKDTree(points[others]) if len(others) else None
    for s in contours:
        tied = []
        for k in (0, len(s) - 1):
            ring = s.vertices[k]
            for v, near in zip(ring, tree.query_ball_point(points[ring], SAME) if tree else [], strict=False):
                for w in others[near]:
                    out[w] = out[v]
                    if free[w]:
                        tied.append((int(w), k))
                        free[w] = False
        made.append(replace(s, tied=np.array(tied, np.int32).reshape(-1, 2)))
    sewn = {s.joint for s in made if (s.tied[:, 1] == 0).any()}  # the front of a torso winds as its back does
    return out, tuple(s if s.wound is None or s.joint in sewn else s.settled for s in made)


def _limb(
    joint: int, s: ContourSurface, numbers: Ints, skeleton: Skeleton, surfaces: set[int], spread: set[int]
) -> Contours:
    children = np.flatnonzero(skeleton.parents == joint)
    last = s.points[-1].mean(axis=0)
    distal = None
    if s.lower and len(children):
        distal = int(children[np.argmin(np.linalg.norm(skeleton.centers[children] - last, axis=1))])
    own = _bone(skeleton, joint, last)
    below = distal is not None and distal in spread
    # a joint without contours of its own (wrist, ankle) winds those above it
    winds = None if distal is None else False if below else True if s.spread and distal not in surfaces else None
    axes = np.stack([own, _bone(skeleton, distal, None) if below and distal is not None else own])
    return limb(
        s.name, numbers, joint, distal, fixed=s.fixed_upper, upper=s.upper, lower=s.lower, extra=s.extra, ramp=s.ramp,
        diversion=s.diversion, mitre=s.mitre, recentre=s.recentre, axes=axes, spread=(s.spread, winds), closed=s.closed,
        at=steps(s.points),
    )  # fmt: skip


def _bone(skeleton: Skeleton, joint: int, end: Floats | None) -> Floats:
    """Unit direction of the bone below a joint: to its nearest child, else to `end`, else on as its parent's."""
    start = skeleton.centers[joint]
    children = skeleton.centers[skeleton.parents == joint]
    if end is None and len(children):
        end = children[np.argmin(np.linalg.norm(children - start, axis=1))]
    if end is None:
        end = 2 * start - skeleton.centers[max(int(skeleton.parents[joint]), 0)]
    way = end - start
    length = float(np.linalg.norm(way))
    return way / length if length > 1e-9 else np.array([0.0, -1.0, 0.0])


def _torso(joint: int, s: ContourSurface, numbers: Ints, skeleton: Skeleton, chain: list[int]) -> Contours:
    """`lower`: over so many of the lowest contours the spine's turns are brought to nothing."""
    ends = s.points[:, [0, -1]] if not s.closed else s.points  # those that the front shares with the back
    heights = ends[:, :, 1].mean(axis=1)
    centers, stand = _rising(skeleton.centers[chain][:, 1]), s.lower > 0
    swing, twist = spine_shares(heights, centers, extra=s.extra, stand=stand)
    below = swing[s.extra :]
    if s.extra and len(below) and (below[0] < 1).any():
        warn(
            f"contours {s.name}: ramps of the spine should end below its first {s.extra} contours, which turn as a whole"
        )
    if s.lower:
        near = np.clip(np.arange(len(heights))[::-1] / s.lower, 0, 1)[:, None]
        swing, twist = swing * near, twist * near
    made = Contours(s.name, joint, numbers, np.array(chain, np.int32), swing, twist, closed=s.closed)
    if s.extra:
        return made
    wound = spine_wound(heights, centers, stand=stand)
    return made.settled if wound is None else replace(made, wound=wound)


def _rising(heights: Floats) -> Floats:
    """Heights of a chain's joints, each at least a trifle above the one before: files have vertebrae out of order."""
    step = 1e-4 * max(float(np.ptp(heights)), 1e-6)
    return np.maximum.accumulate(heights - np.arange(len(heights)) * step) + np.arange(len(heights)) * step


def _neck(
    joint: int, s: ContourSurface, numbers: Ints, skeleton: Skeleton, chain: list[int], skull: int | None
) -> Contours:
    count = len(s.points)
    along = np.linspace(1, 0, count)  # 0 where it stands on the torso, 1 at the skull
    joints = [*chain, *([skull] if skull is not None else [])]
    swing, twist = np.ones((count, len(joints))), np.full((count, len(joints)), np.nan)
    if chain:
        heights = s.points[:, :, 1].mean(axis=1)
        bend, wind = spine_shares(heights, _rising(skeleton.centers[chain][:, 1]))
        near = np.clip(3 * along, 0, 1)[:, None]
        swing[:, : len(chain)], twist[:, : len(chain)] = bend * near, wind * near
        swing[0, : len(chain)] = twist[0, : len(chain)] = 1  # at the skull all of the neck is bent
    if skull is not None:
        swing[:, -1] = along ** (2.0 if chain else _growth(s.points))
    return Contours(s.name, joint, numbers, np.array(joints, np.int32), swing, twist, closed=s.closed)


def _growth(points: Floats) -> float:
    """The power of the way up a neck without joints, contours (C,P,3), that the skull's turn grows with: 2, so that it
    stands firmly, less where it is so short that a nod would fold its upper contours through each other."""
    middle = points.mean(axis=1)
    radius = float(np.linalg.norm(points[0] - middle[0], axis=1).mean())
    return float(np.clip(np.linalg.norm(middle[0] - middle[-1]) / max(_NOD * radius, 1e-12), 1.0, 2.0))


def equivalent(surface: Contours, root: int = 0) -> tuple[Ints, Floats]:
    """Joints (n+1,) and weights (C,n+1) of skinning that moves contours alike: each joint of what is left to it."""
    parent = root
    left = np.ones(len(surface))
    values = np.zeros((len(surface), len(surface.joints) + 1))
    for i in range(len(surface.joints) - 1, -1, -1):
        values[:, i + 1] = left * surface.swing[:, i]
        left = left * (1 - surface.swing[:, i])
    values[:, 0] = left
    return np.array([parent, *surface.joints], np.int32), values
