"""The neck of a figure in segments: where it comes out of the trunk and goes into the head.

Such a neck is a tube, of segments of its own or of the trunk's, that ends inside a closed head and often inside a closed
trunk. What shows of it becomes contours; round its ends holes are bored into head and trunk, which are sewn to it. It is
the head's where it meets the head and the trunk's where it meets that, so neither moves against it.

Source: cross-section deformation of H-Anim bodies, segments joined at contours that both have; the boring is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.modeling.cuts import FRONT, Cuts, unit
from vitruvian.modeling.slicing import Rings, Whole, frames, rings, section

HEAD, NECK = 1, 11  # regions, see `Cuts`
_SLICES = 64  # along the neck: so finely its ends are looked for
_LEAST = 0.004  # metres of a person that must show of a neck
_THIN = 0.02  # metres of a person: the radius that a neck has at least, and marks of joints do not
_WIDE = 1.35  # a trunk's own neck is where it is at most this much wider than just below the head
_REST = 0.008  # metres of a person that are left of a trunk's own neck below its contours
_ABOVE, _BELOW = 0.06, 0.16  # metres of a person over and under the skull's joint between which the neck is


@dataclass(frozen=True, eq=False)
class Throat:
    """The part of a neck that shows: from `top`, where it goes into the head, to `base` (3,), unit `down`; `chosen`: its
    triangles. apart: whether it comes out of the trunk's surface, which is otherwise its own going on."""

    top: Floats
    base: Floats
    down: Floats
    chosen: Whole
    apart: bool

    def sliced(self, cuts: Cuts, s: Floats, angles: Floats) -> tuple[Rings, Floats, Floats]:
        """Its contours at `s` (C,), 0 at the top and 1 at the base, with their centres (C,3) and axes (C,3)."""
        centers = self.top + s[:, None] * (self.base - self.top)
        axis = np.tile(self.down, (len(s), 1))
        made = rings(
            cuts.skin.rest, cuts.skin.triangles, self.chosen, centers, axis, forward=FRONT, angles=angles, name="neck"
        )
        return made, centers, axis


def throat(cuts: Cuts) -> Throat | None:
    """The neck of a figure in segments; None when it has no head, or when no neck shows that goes into it
    below the skull's joint."""
    head = cuts.triangles(HEAD)
    if "skullbase" not in cuts.planes or not len(head):
        return None
    skull, scale = cuts.at("skullbase"), cuts.scale
    start = cuts.centers[cuts.neck[0]] if cuts.neck else cuts.shoulders
    up = unit(skull - start)
    apart = len(cuts.triangles(NECK)) > 0
    chosen = cuts.triangles(NECK) if apart else _tube(cuts, skull, up)
    if not len(chosen):
        return None
    used = cuts.skin.rest[np.unique(cuts.skin.triangles[chosen])]
    low, high = np.clip(np.quantile((used - skull) @ up, [0, 1]), -_BELOW * scale, _ABOVE * scale)
    edge = 0.02 * (high - low)
    places = np.linspace(low + edge, high - edge, _SLICES)
    angles = np.arange(24) * 2 * np.pi / 24
    centers = skull + places[:, None] * up
    tube = rings(
        cuts.skin.rest, cuts.skin.triangles, chosen, centers, np.tile(-up, (_SLICES, 1)), forward=FRONT, angles=angles,
        name="neck", loose=True,
    )  # fmt: skip
    trunk = cuts.triangles(0) if apart else np.zeros(0, np.int64)
    in_head, in_trunk = (_inside(cuts, faces, centers, -up, tube) for faces in (head, trunk))
    shown = ~(in_head | in_trunk)
    if not apart:  # as far down as it goes all round, and a little less: there is to be something to sew it to
        alone = _alone(cuts, centers, -up, _WIDE * tube.radius)
        shown &= alone & (np.interp(places - _REST * scale, places, alone.astype(np.float64), left=0) > 0.99)
    first, last = _longest(shown)
    if last < first or places[last] - places[first] < _LEAST * scale or places[last] > 0 or tube.radius < _THIN * scale:
        return None
    if not in_head[last + 1 :].any():
        return None
    return Throat(centers[last], centers[first], -up, chosen, bool(in_trunk[:first].any()))


def _tube(cuts: Cuts, skull: Floats, up: Floats) -> Whole:
    """The triangles of a trunk's own neck: as near its axis as it is just below the head."""
    chosen = cuts.triangles(0)
    faces = cuts.skin.triangles[chosen]
    used = cuts.skin.rest[np.unique(faces)]
    top = min(float(((used - skull) @ up).max()), 0.0)
    cut = section(cuts.skin.rest, faces, skull + (top - 0.01 * cuts.scale) * up, -up, FRONT)
    if not len(cut.round):
        return chosen[:0]
    most = _WIDE * float(np.linalg.norm(cut.segments[np.isin(cut.loop, cut.round)], axis=2).max())
    off = cuts.skin.rest - skull
    along = off @ up
    near = (np.linalg.norm(off - along[:, None] * up, axis=1) < most) & (along > -_BELOW * cuts.scale)
    return chosen[near[faces].all(axis=1)]


def _alone(cuts: Cuts, centers: Floats, axis: Floats, most: float) -> NDArray[np.bool_]:
    """(C,) whether the innermost loop of the trunk round each centre is no wider than `most` on average."""
    faces = cuts.skin.triangles[cuts.triangles(0)]
    out = np.zeros(len(centers), bool)
    for k, center in enumerate(centers):
        cut = section(cuts.skin.rest, faces, center, axis, FRONT)
        out[k] = len(cut.round) > 0 and float(cut.size[cut.round].min()) < most
    return out


def _inside(cuts: Cuts, chosen: Whole, centers: Floats, axis: Floats, tube: Rings) -> NDArray[np.bool_]:
    """(C,) whether any point of each contour lies inside one of the closed surfaces of some triangles."""
    first, second = (d[0] for d in frames(axis[None], FRONT))
    faces = cuts.skin.triangles[chosen]
    out = np.zeros(len(centers), bool)
    for k, center in enumerate(centers):
        cut = section(cuts.skin.rest, faces, center, axis, FRONT)
        for p in tube.points[k] - center if len(cut.size) else ():
            if cut.around(np.array([p @ first, p @ second])).any():
                out[k] = True
                break
    return out


def _longest(shown: NDArray[np.bool_]) -> tuple[int, int]:
    """The first and last of the longest run of true; the last before the first when there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], shown, [False]]).astype(np.int8)))
    if not len(edges):
        return 0, -1
    starts, stops = edges[0::2], edges[1::2]
    best = int(np.argmax(stops - starts))
    return int(starts[best]), int(stops[best]) - 1
