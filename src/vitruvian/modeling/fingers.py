"""Hands of a fit: bones of palms and fingers brought onto the scan, from the wrist outward, when the rest is in place.

A finger is as thick as the gap to the next one is wide: closest points name the wrong finger unless its root lies right.
So each phalanx is heard only when the one before it has settled, and only what is near answers. Turns of neighbouring
fingers and the hand's proportions are held by the same priors as in the whole fit: where a scan shows little, a hand keeps
the template's proportions.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.modeling import bones as bo
from vitruvian.modeling import shrink
from vitruvian.modeling.likeness import Likeness, on_scan
from vitruvian.modeling.template import Template

PHALANGES = ("metacarpophalangeal", "carpal_proximal", "carpal_distal", "carpal_interphalangeal")
PALM = ("radiocarpal", "midcarpal", "carpometacarpal")
# metres within which the scan answers, round by round, and how many joints of a finger are heard
STEPS = (
    (0.020, 0), (0.014, 0), (0.012, 1), (0.010, 1), (0.010, 2), (0.008, 2), (0.010, 3), (0.008, 3), (0.006, 3), (0.006, 3),
)  # fmt: skip
LAST = 3  # joints of a finger
SEEN = 0.25  # share of the points of a hand that must be answered for it to be brought anywhere
TRUST = 3.0  # of a point against a landmark
BACK = 3.0  # of what the scan's points want, all together against the hand's own
MARK = 3.0  # of a landmark of the hand
NEAR = 0.04  # metres: what else of the scan may be of a hand
MIXED = 0.3  # how much of the next phalanx a point may be


def ranks(names: tuple[str, ...]) -> Floats:
    """(J,) of joints: 0 for those of the palm and 1, 2, 3 for the phalanges outward; NaN for all others."""
    out = np.full(len(names), np.nan)
    for j, name in enumerate(names):
        stem = name[2:] if name[:2] in ("l_", "r_") else ""
        if stem.startswith(PALM):
            out[j] = 0
        elif stem.startswith("metacarpophalangeal"):
            out[j] = 1
        elif stem.startswith(("carpal_proximal", "carpal_interphalangeal")):
            out[j] = 2
        elif stem.startswith("carpal_distal"):
            out[j] = 3
    return out


def depth(template: Template) -> Floats:
    """(V,) how many joints of a finger each point of a skin lies beyond; 0 off the fingers, between where joints blend."""
    return np.asarray(template.weights @ np.nan_to_num(ranks(template.names)))


def settled(
    found: Likeness, scan: shrink.Scan, where: Any, goal: Floats, held: Floats, usual: Floats, *, fading: bool = False
) -> Likeness:
    """The likeness with palms and fingers on the scan; as it was for hands that the scan does not show.

    where (n,V) sparse and goal (n,3): landmarks, held (n,): how much, and less and less when `fading`; usual (8J,): what
    joint parameters are pulled to.
    """
    t = found.template
    rank = ranks(t.names)
    kept = []
    for side in ("l_", "r_"):
        mine = np.array([n.startswith(side) for n in t.names]) & np.isfinite(rank)
        skin = np.flatnonzero((t.weights @ mine > 0.6) & t.heard)
        if len(skin) and _answered(found, scan, skin) > SEEN:
            kept.append((side, skin))
    if not kept:
        return found
    sides = tuple(s for s, _ in kept)
    skin = np.concatenate([s for _, s in kept])
    far = depth(t)
    titles = [n.split()[1] for n in t.knobs.names]
    hands = [x.startswith(sides) and (x[2:] == "hand" or x[2:].startswith((*PALM, *PHALANGES))) for x in titles]
    knobs = t.knobs.only(hands)
    share = np.asarray(where @ (t.weights @ np.isfinite(rank).astype(np.float64)))
    marks = np.flatnonzero(share > 0.5)
    bones = found.bones
    near = _close(found, scan, skin)
    for reach, most in STEPS:
        some = skin[far[skin] <= most + MIXED]
        points = on_scan(replace(found, bones=bones))
        normals = shrink.vertex_normals(points, t.triangles)
        match = shrink.matches(points[some], normals[some], scan, distance=reach, angle=np.radians(50))
        good = np.flatnonzero(match.good)
        weight = TRUST / (1 + (match.distance[good] / (0.5 * reach)) ** 2)
        rows = bo.wanted(t.chosen(some[good]), t.points, t.weights, match.normal[good], match.goal[good], weight)
        rows = rows.joined(_wanted_back(t, points, near, scan, some, reach))
        if len(marks):
            hold = MARK * held[marks] * (1 - most / LAST if fading else 1)
            rows = rows.joined(bo.everywhere(where[marks], t.points, t.weights, goal[marks], hold))
        bones = bo.settle(t.parents, t.centers, t.axes, bones, rows, knobs, rounds=2, usual=usual)
    return replace(found, bones=bones)


def _close(found: Likeness, scan: shrink.Scan, skin: Any) -> Any:
    """(n,) the scan's points that may be of the hands."""
    from scipy.spatial import cKDTree

    return np.flatnonzero(cKDTree(on_scan(found)[skin]).query(scan.vertices, distance_upper_bound=NEAR)[0] < NEAR)


def _wanted_back(t: Template, points: Floats, near: Any, scan: shrink.Scan, some: Any, reach: float) -> bo.Rows:
    """What points of the scan want of the hands: that tells a finger that lies on its neighbour."""
    own = shrink.surface(points, t.triangles)
    match = shrink.matches(scan.vertices[near], scan.normals[near], own, distance=reach, angle=np.radians(60))
    heard = np.zeros(len(points), bool)
    heard[some] = True
    good = np.flatnonzero(match.good & heard[t.triangles[match.face]].all(axis=1))
    blend = shrink.blend(t.triangles[match.face[good]], match.share[good], len(points))
    weight = BACK * min(len(some) / max(len(good), 1), 2.0) / (1 + (match.distance[good] / (0.5 * reach)) ** 2)
    return bo.wanted(blend, t.points, t.weights, match.normal[good], scan.vertices[near[good]], weight)


def _answered(found: Likeness, scan: shrink.Scan, skin: Any) -> float:
    """The share of some of the skin's points that something of the scan is near to."""
    points = on_scan(found)
    return float((shrink.closest(points[skin], scan)[0] < 0.02).mean())
