"""The built-in person's skeleton: centres, ends, levels of articulation, joint limits, Sites and Segment masses."""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.sparse import csr_matrix

from vitruvian.body.types import Floats, Ints
from vitruvian.hanim import tables
from vitruvian.hanim.folding import stand_in
from vitruvian.hanim.humanoid import Joint, Segment, Site
from vitruvian.modeling import mass
from vitruvian.modeling.source import BODY, POINTS, array, manifest, tied

FINGERS = {1: "thumb", 2: "index", 3: "middle", 4: "ring", 5: "pinky"}

# Limits in degrees about X, Y, Z of the rest pose, left side; None is free. Ranges of motion of healthy adults, rounded
# (American Academy of Orthopaedic Surgeons, Joint Motion, 1965). Flexion of hip and shoulder is negative about X.
LIMITS: dict[str, tuple[tuple[float, float], tuple[float, float], tuple[float, float]]] = {
    "l_hip": ((-120, 30), (-45, 45), (-30, 45)),
    "l_knee": ((0, 140), (-10, 10), (-5, 5)),
    "l_talocrural": ((-20, 50), (-15, 15), (-25, 25)),
    "l_metatarsophalangeal_1": ((-70, 45), (-5, 5), (-10, 10)),
    "l_metatarsophalangeal_2": ((-60, 40), (-5, 5), (-10, 10)),
    "l_shoulder": ((-180, 60), (-90, 90), (-30, 180)),
    "l_elbow": ((-150, 0), (-90, 90), (-5, 5)),
    "l_radiocarpal": ((-30, 20), (-10, 10), (-80, 70)),
    "l_eyeball_joint": ((-35, 35), (-45, 45), (0, 0.001)),
    "temporomandibular": ((0, 30), (-8, 8), (-2, 2)),
    "skullbase": ((-30, 30), (-45, 45), (-15, 15)),
    "vl5": ((-15, 20), (-5, 5), (-10, 10)),
}
for _ray in (2, 3, 4, 5):
    LIMITS[f"l_metacarpophalangeal_{_ray}"] = ((-20, 20), (-5, 5), (-90, 30))
    LIMITS[f"l_carpal_proximal_interphalangeal_{_ray}"] = ((-3, 3), (-3, 3), (-110, 0))
    LIMITS[f"l_carpal_distal_interphalangeal_{_ray}"] = ((-3, 3), (-3, 3), (-80, 5))


@cache
def names() -> tuple[str, ...]:
    """The 146 joints in the order of the table."""
    return tuple(tables.joints())


@cache
def parents() -> Ints:
    """(146,) parent of each joint at LOA 4, -1 for the root."""
    table = tables.joints()
    place = {n: i for i, n in enumerate(table)}
    return np.array([place.get(entry.parent or "", -1) for entry in table.values()], np.int32)


def centers(points: Floats) -> Floats:
    """(146,3) joint centres of a shaped person (19158 + 326, 3): linear in the ends of the source's bones, which are the
    `points` beyond 19158, and for knees, elbows and fingers in the skin round them, so that they lie where it bends.
    """
    out = array("centres").astype(np.float64) @ points[POINTS:]
    joints, shares = _tied()
    out[joints] = shares @ points[:BODY]
    return out


@cache
def _tied() -> tuple[Ints, csr_matrix]:
    """Joints (k,) that lie in the skin round them, and the shares (k,13380), each of sum one, of its vertices."""
    joints, row = np.unique(tied("joint"), return_inverse=True)
    shares = csr_matrix((tied("share").astype(np.float64), (row, tied("vertex"))), (len(joints), BODY))
    return joints, shares


def ends(points: Floats) -> dict[str, Floats]:
    """Far ends of fingers, toes and skull by the joint of the last phalanx, and `skullbase`."""
    bones = manifest()["bones"]
    tails = points[POINTS + len(bones) :]
    out = {"skullbase": tails[bones.index("head")]}
    for side, dot in (("l_", ".L"), ("r_", ".R")):
        out[side + "carpal_interphalangeal_1"] = tails[bones.index("finger1-3" + dot)]
        out[side + "tarsal_interphalangeal_1"] = tails[bones.index("toe1-2" + dot)]
        for ray in (2, 3, 4, 5):
            out[f"{side}carpal_distal_interphalangeal_{ray}"] = tails[bones.index(f"finger{ray}-3{dot}")]
            out[f"{side}tarsal_distal_interphalangeal_{ray}"] = tails[bones.index(f"toe{ray}-3{dot}")]
    return out


@cache
def folded(loa: int) -> dict[str, str]:
    """Joint of LOA 4 -> the joint that stands for it at a lower level, as `vitruvian.hanim.convert` folds them."""
    kept = set(tables.joints_at(loa))
    table = tables.joints()
    out = {}
    for name in table:
        at: str | None = name if name in kept else stand_in(name, kept) or name
        while at is not None and at not in kept:
            at = table[at].parent
        out[name] = at or "humanoid_root"
    return out


def skeleton(loa: int, where: Floats) -> dict[str, Joint]:
    """The joints of that level, linked into a tree, each with its Segment; `where` (146,3) are the centres at rest."""
    place = {n: i for i, n in enumerate(names())}
    segments = {entry.name: entry.segment for entry in tables.joints().values()}
    found: dict[str, Joint] = {}
    for name in names():
        if folded(loa)[name] != name:
            continue
        joint = Joint(name, center=where[place[name]].copy())
        joint.segments.append(Segment(segments[name]))
        found[name] = joint
        parent = tables.parent_at(name, loa)
        if parent is not None:
            found[parent].joints.append(joint)
        mirrored = "l_" + name[2:] if name.startswith("r_") else name
        if mirrored in LIMITS:
            low, high = np.radians(np.array(LIMITS[mirrored], dtype=np.float64)).T
            if name.startswith("r_"):  # the mirror image turns the other way about Y and Z
                low, high = low * [1, 0, 0] - high * [0, 1, 1], high * [1, 0, 0] - low * [0, 1, 1]
            joint.llimit, joint.ulimit = low, high
    return found


def add_masses(joints: dict[str, Joint], points: Floats, pieces: mass.Wedges) -> float:
    """Set mass, centre of mass and inertia of every Segment from the bare body (its `points` and how it is cut, one
    piece per joint) and answer the whole mass, kg: the volume of the body times its density.
    """
    single = mass.bones(list(joints.values())).astype(np.float32)
    volume, first, second = mass.filled(points.astype(np.float32), pieces, single)
    whole = mass.enclosed(points, pieces)
    density = whole * mass.DENSITY / volume[volume > 0].sum()
    for joint, m in zip(
        joints.values(), mass.pieces_of(volume, first, second, np.full(len(volume), density)), strict=True
    ):
        if m is not None:
            mass.put(joint.segments[0], m)
    return whole * mass.DENSITY


def add_sites(joints: dict[str, Joint], loa: int, places: dict[str, Floats], tips: dict[str, Floats]) -> None:
    """Hang feature points (`places`: name -> position) and end effectors (`tips`: joint -> position) on Segments."""
    at = folded(loa)
    holder = {entry.segment: entry.name for entry in tables.joints().values()}
    for name, point in tables.feature_points().items():
        if name in places and point.segment in holder:
            joint = joints[at[holder[point.segment]]]
            joint.segments[0].sites.append(Site(f"{name}_pt", translation=places[name]))
    for name, position in tips.items():
        joint = joints[at[name]]
        title = "skull_tip" if name == "skullbase" else tables.joints()[name].segment + "_tip"
        joint.segments[0].sites.append(Site(title, translation=position))
