"""The standard's default body: joints, segments and feature points of a level of articulation, without a surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Humanoid, Joint, Segment, Site


def default_body(loa: int = 1, version: str = "2.0", *, name: str = "default") -> Humanoid:
    """The figure of the standard's tables at a level of articulation, in the default pose, metres.

    `loa` 0..4 (0..3 in 1.x), `version` "2.0", "200x", "1.1" or "1.0". Joints have the default centres, mirror
    symmetric; the parent of each is its nearest ancestor of that level. Each joint has its Segment, and every feature
    point with a default position hangs as a Site on the segment that stands for its own at this level. Raises
    VitruvianError for levels that the version lacks. Source: ISO/IEC 19774-1:2019, annexes A to C; note hanim.md, 2.
    """
    if version not in ("2.0", "200x", "1.1", "1.0"):
        raise VitruvianError(f"H-Anim version: expected one of 2.0, 200x, 1.1, 1.0, found {version!r}")
    table, centers = tables.joints(version), tables.default_centers(version)
    joints: dict[str, Joint] = {}
    for known in tables.joints_at(loa, version):
        joint = Joint(tables.name_in(known, version) or known, center=centers[known].copy())
        joint.segments.append(Segment(table[known].segment))
        joints[known] = joint
        parent = tables.parent_at(known, loa, version)
        if parent is not None:
            joints[parent].joints.append(joint)
    holder = tables.segments(version)
    for point, place in default_places().items():
        called = tables.name_in(point, version, "site")
        segment = tables.name_in(tables.feature_points()[point].segment, version, "segment")
        if called is None:
            continue
        at = holder[segment] if segment else _standing_for(point, joints)
        while at not in joints:
            at = table[at].parent or tables.ROOT
        joints[at].segments[0].sites.append(Site(f"{called}_pt", translation=place.copy()))
    level = loa if tables.family(version) == "2.0" else -1
    return Humanoid(name, version, level, skeleton=[joints[tables.ROOT]])


def _standing_for(point: str, joints: dict[str, Joint]) -> str:
    """The nearest joint of 1.x above a feature point whose own segment exists in 2.0 only."""
    table = tables.joints()
    at = tables.segments()[tables.feature_points()[point].segment]
    while (old := tables.name_in(at, "1.0")) not in joints:
        at = table[at].parent or tables.ROOT
    return old or tables.ROOT


def default_places() -> dict[str, NDArray[np.float64]]:
    """Feature point (2.0 name) -> (3,) default position, metres: left is master, the right mirrored, midline at x = 0.

    Points that the standard gives no position for are absent.
    """
    points = tables.feature_points()
    out: dict[str, NDArray[np.float64]] = {}
    for name, point in points.items():
        mate = points.get({"l_": "r_", "r_": "l_"}.get(name[:2], "") + name[2:])
        left, right = (point, mate) if name.startswith("l_") else (mate, point)
        master = left if left is not None and left.position is not None else right
        if master is not None and master.position is not None:
            x, y, z = master.position
            out[name] = np.array([0.0 if mate is None else x if master is point else -x, y, z])
    return out
