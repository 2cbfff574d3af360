"""Feature points of the standard: the 118 of H-Anim 2.0, the 76 of 1.x; as Sites and as Displacers, both ways.

As a Site a point hangs in the Segment that the standard gives it, under its name with `_pt`. As a Displacer it is the
nearest vertex, under its name with `_feature`. Source: ISO/IEC 19774-1, feature points; naming rules of Site, Displacer.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.types import Floats, floats
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Site

FORMS = ("sites", "displacers")
_FEATURE = "_feature"


def feature_name(name: str) -> str | None:
    """The standard's name of the point that a Site or Displacer stands for: 2.0's, else 1.x's, else None."""
    if name.endswith("_view"):
        return None
    plain = name.removesuffix(_FEATURE).removesuffix("_pt").replace(".", "")
    known = tables.canonical(plain, "site")
    if known is None and plain in tables.feature_points("1.x"):
        known = plain
    return known


def feature_points(humanoid: Humanoid) -> dict[str, Floats]:
    """The feature points that a humanoid has: name (2.0's where it has one) -> place (3,), humanoid space at rest.

    Sites count before Displacers named `_feature`, whose place is the middle of their vertices; end effectors
    (`_tip`) stand in for the feature point of their name when nothing else does.
    """
    found: dict[str, Floats] = {}
    tips: dict[str, Floats] = {}
    for site in humanoid.all_sites():
        name = feature_name(site.name)
        if name is not None:
            (tips if site.name.endswith("_tip") else found).setdefault(name, site.center + site.translation)
    for displacer, points in _feature_displacers(humanoid):
        name = feature_name(displacer.name)
        index = displacer.coord_index
        if name is not None and len(index) and int(index.max()) < len(points):
            found.setdefault(name, points[index].mean(axis=0))
    return {**{n: p for n, p in tips.items() if n not in found}, **found}


def _feature_displacers(humanoid: Humanoid) -> list[tuple[Displacer, Floats]]:
    own = [*humanoid.skin_displacers, *(d for j in humanoid.joints() for d in j.displacers)]
    out = [(d, humanoid.skin_coord) for d in own]
    for segment in humanoid.segments():
        points, placement = _segment_points(segment)
        out += [(d, points @ placement[:3, :3].T + placement[:3, 3]) for d in segment.displacers]
    return [(d, p) for d, p in out if d.name.endswith(_FEATURE)]


def _segment_points(segment: Segment) -> tuple[Floats, Floats]:
    """The points that a Segment's displacers index, as they stand in the file, and where they are placed (4,4)."""
    shapes = [s for s in segment.shapes if s.points is not None]
    model = next((s for s in shapes if s.points is segment.coord), shapes[0] if shapes else None)
    points = segment.coord if segment.coord is not None else model.points if model is not None else np.zeros((0, 3))
    placement = np.eye(4) if model is None or model.transform is None else model.transform
    return np.asarray(points, dtype=np.float64), placement


def add_feature_points(
    humanoid: Humanoid, points: Mapping[str, ArrayLike] | None = None, *, form: str = "sites"
) -> list[str]:
    """Write feature points into a humanoid; answers the names that found a place.

    `points`: name (of either version) -> place (3,), humanoid space at rest; None: those it has already, in the other
    form. `form` "sites" hangs them in their Segments (what is there under that name moves), "displacers" makes each the
    nearest vertex of the skin, else of the geometry of its Segment. Names are written in the humanoid's own version;
    points that a figure has no joint for hang at the nearest one above.
    Raises `VitruvianError` for names the standard does not have.
    """
    if form not in FORMS:
        raise VitruvianError(f"form: expected one of {', '.join(FORMS)}, found {form!r}")
    given = feature_points(humanoid) if points is None else points
    joints = {tables.canonical(j.name) or j.name: j for j in humanoid.joints()}
    if not joints:
        raise VitruvianError(f"humanoid {humanoid.name!r}: expected joints to hang feature points on, found none")
    written = []
    for name, place in given.items():
        known = feature_name(name)
        if known is None:
            raise VitruvianError(f"feature points: {name!r} is not one of the standard's (118 in 2.0, 76 in 1.x)")
        where = floats(place, f"points[{name!r}]", 3)
        joint = _holder(known, joints)
        plain = tables.name_in(known, humanoid.version, "site") or known
        done = _as_site if form == "sites" else _as_displacer
        if done(humanoid, joint, known, plain, where):
            written.append(known)
    return written


def _holder(name: str, joints: dict[str, Joint]) -> Joint:
    """The joint whose Segment a point belongs to, or the nearest above it that the figure has."""
    entry = tables.feature_points().get(name)
    at = tables.segments().get(entry.segment) if entry is not None else None
    table = tables.joints()
    while at is not None and at not in joints:
        at = table[at].parent
    return joints[at] if at is not None else next(iter(joints.values()))


def _segment(joint: Joint) -> Segment:
    if not joint.segments:
        known = tables.canonical(joint.name)
        joint.segments.append(Segment(tables.joints()[known].segment if known else f"{joint.name}_segment"))
    return joint.segments[0]


def _as_site(humanoid: Humanoid, joint: Joint, known: str, plain: str, where: Floats) -> bool:
    for site in humanoid.all_sites():
        if feature_name(site.name) == known and not site.name.endswith("_tip"):
            site.translation = where - site.center
            return True
    _segment(joint).sites.append(Site(f"{plain}_pt", translation=where.copy()))
    return True


def _as_displacer(humanoid: Humanoid, joint: Joint, known: str, plain: str, where: Floats) -> bool:
    skinned = len(humanoid.skin_coord) > 0
    if skinned:
        owner, points = joint.displacers, humanoid.skin_coord
    else:
        segment = _segment(joint)
        owner = segment.displacers
        own, placement = _segment_points(segment)
        points = own @ placement[:3, :3].T + placement[:3, 3]
        if len(points) and segment.coord is None:
            segment.coord = next(s.points for s in segment.shapes if s.points is not None)
    if not len(points):
        return False
    nearest = np.array([int(np.argmin(((points - where) ** 2).sum(axis=1)))], np.int32)
    for d in owner:
        if d.name.endswith(_FEATURE) and feature_name(d.name) == known:
            d.coord_index, d.displacements = nearest, np.zeros((1, 3))
            return True
    owner.append(Displacer(f"{plain}{_FEATURE}", nearest, np.zeros((1, 3))))
    return True
