"""The 87 points of an actor: where they are, whether each is where it should be in the flesh, and putting them there.

"A skeleton point that is badly positioned will cause abnormal deformations." The points are the 71 joints of level of
articulation 2 and 16 ends: fingertips, toe tips, heels, top of the skull, chin. Rules, each with a distance and a move:

- a: a joint of a limb is the centroid of the section through it, across the bisector of its bones;
- b: elbow, knee and finger joints lie on the line between the two sides of the limb (the epicondyles, where given);
- c: every point lies inside the surface, and every bone too;
- d: points of the spine lie two thirds behind the front, in the median plane;
- e: left and right are mirror images, within 1 % of the stature;
- f: bones are as long as a human's of that stature;
- g: at rest joints are not turned, and limbs point as in the standard's default pose.

Source: "Simulation of object and human skin deformations in a grasping task" (1989), section 2.1; its list of points is
lost, the list and rules c to g are ours. Lengths: R. Drillis, R. Contini, Body segment parameters (1966).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from vitruvian.body.pack import pack
from vitruvian.body.rotations import unit
from vitruvian.body.types import Body, Floats, floats
from vitruvian.errors import VitruvianError
from vitruvian.hanim import tables
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling.features import feature_points
from vitruvian.modeling.flesh_rays import Flesh

JOINTS = tables.joints_at(2)
# Ends: name -> the joint that holds it, the feature point that says where it is.
ENDS: dict[str, tuple[str, str]] = {
    "skull_top": ("skullbase", "skull_vertex"),
    "chin": ("skullbase", "menton"),
    **{
        f"{s}_{finger}_tip": (
            f"{s}_carpal_{'' if k == 1 else 'distal_'}interphalangeal_{k}",
            f"{s}_carpal_distal_phalanx_{k}",
        )
        for s in "lr"
        for k, finger in enumerate(("thumb", "index", "middle", "ring", "pinky"), 1)
    },
    **{f"{s}_toe_tip": (f"{s}_tarsal_distal_interphalangeal_2", f"{s}_tarsal_distal_phalanx_2") for s in "lr"},
    **{f"{s}_heel": (f"{s}_talocrural", f"{s}_calcaneus_posterior") for s in "lr"},
}
POINTS = (*JOINTS, *ENDS)
SPINE = tuple(name for name in JOINTS if name[0] == "v")
_PIVOTS = ("elbow", "knee", "interphalangeal")  # rule b
_SECTIONS = (*_PIVOTS, "radiocarpal", "talocrural")  # where a limb has a section of its own
_EPICONDYLES = {"elbow": "humeral", "knee": "femoral"}
# Bone -> length as a share of the stature, and the share of that by which humans differ.
LENGTHS = {
    ("shoulder", "elbow"): (0.186, 0.2), ("elbow", "radiocarpal"): (0.146, 0.2), ("hip", "knee"): (0.245, 0.2),
    ("knee", "talocrural"): (0.246, 0.2), ("radiocarpal", "middle_tip"): (0.108, 0.3), ("heel", "toe_tip"): (0.152, 0.3),
}  # fmt: skip
# From where on a point is misplaced: shares of the limb's radius, of the body's depth, of the stature; an angle.
OFF_CENTER, OFF_LINE, OFF_DEPTH, OFF_MIRROR, OFF_POSE = 0.35, 0.3, 0.12, 0.01, np.radians(20.0)
_OUTSIDE = 0.0012  # of the stature: by how much ends may stand out, which are on the skin
_REACH = 0.25  # of the stature: how far out the surface of a limb is looked for
_APART = 1.2  # of the limb's radius: epicondyles that are nearer to each other are not on both of its sides


@dataclass(frozen=True)
class Misplaced:
    """A point that breaks a rule (a to g): how far off it is, what is wrong, and where to move it (mm), None: unknown."""

    rule: str
    point: str
    distance_mm: float
    message: str
    move_mm: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Actor:
    """The points of a humanoid: name -> place (3,) in humanoid space at rest, those it has; `locked` ones stay.

    `scale`: metres of one unit of humanoid space, by the Humanoid's own scale.
    """

    body: Body
    places: dict[str, Floats]
    features: dict[str, Floats]
    flesh: Flesh | None
    scale: float = 1.0
    locked: frozenset[str] = frozenset()

    @property
    def missing(self) -> tuple[str, ...]:
        """The points that neither a joint, a Site nor the surface gives."""
        return tuple(name for name in POINTS if name not in self.places)

    @property
    def stature(self) -> float:
        """From the soles to the top of the skull, in units of humanoid space."""
        heights = [p[1] for p in self.places.values()]
        if self.flesh is not None:
            heights += [float(self.flesh.points[:, 1].min())]
        top = self.places.get("skull_top")
        return float(max(heights) - min(heights)) if top is None else float(top[1] - min(heights))


def actor(humanoid: Humanoid) -> Actor:
    """The points of a humanoid. Ends come from Sites and feature points, else from the surface that their joint moves."""
    body = pack(humanoid)
    index: dict[str, int] = {}
    for i, name in enumerate(body.skeleton.names):
        index.setdefault(tables.canonical(name) or name, i)
    features = feature_points(humanoid)
    flesh = Flesh.of(body) if len(body.skin.triangles) else None
    places = {name: body.skeleton.centers[index[name]].copy() for name in JOINTS if name in index}
    for name, (holder, feature) in ENDS.items():
        if feature in features:
            places[name] = np.array(features[feature], np.float64)
        elif flesh is not None and holder in index and (found := _end(body, index, name, holder)) is not None:
            places[name] = found
    scale = float(abs(np.linalg.det(body.placement[:3, :3])) ** (1 / 3)) or 1.0
    return Actor(body, places, features, flesh, scale)


def _end(body: Body, index: Mapping[str, int], name: str, holder: str) -> Floats | None:
    """The farthest point of an extremity on the surface that its last joint moves, None when it moves nothing."""
    weights, centers = body.skin.weights, body.skeleton.centers
    j = index[holder]
    points = body.skin.rest[np.unique(weights.vertex[(weights.joint == j) & (weights.weight > 0.5)])]
    if not len(points):
        return None
    if name == "skull_top":
        return points[np.argmax(points[:, 1])]
    if name == "chin":
        front = points[(points[:, 2] > np.median(points[:, 2])) & (np.abs(points[:, 0]) < 0.02)]
        return front[np.argmin(front[:, 1])] if len(front) else None
    if name.endswith("heel"):
        return points[np.argmin(points[:, 2])]
    parent = int(body.skeleton.parents[j])
    way = unit(centers[j] - centers[parent]) if parent >= 0 else np.array([0.0, -1, 0])
    return points[np.argmax((points - centers[j]) @ way)]


def _bones(a: Actor) -> list[tuple[str, str]]:
    """The bones between the points that an actor has: (upper, lower)."""
    out = []
    for name in JOINTS:
        parent = tables.parent_at(name, 2)
        while parent is not None and parent not in a.places:
            parent = tables.parent_at(parent, 2)
        if name in a.places and parent is not None:
            out.append((parent, name))
    return out + [(holder, name) for name, (holder, _) in ENDS.items() if name in a.places and holder in a.places]


def examine(a: Actor) -> list[Misplaced]:
    """All findings about an actor's points, the farthest off first."""
    found = [*_mirror(a), *_lengths(a), *_pose(a)]
    if a.flesh is not None:
        found += [*_sections(a), *_inside(a), *_spine(a)]
    scaled = [_seen(f, 1000 * a.scale) for f in found]  # in millimetres of the figure that is seen
    return sorted(scaled, key=lambda f: -f.distance_mm)


def _seen(f: Misplaced, mm: float) -> Misplaced:
    move = f.move_mm
    if move is not None:
        x, y, z = (round(v * mm, 1) for v in move)
        move = (x, y, z)
    return replace(f, distance_mm=round(f.distance_mm * mm, 1), move_mm=move)


def _finding(rule: str, point: str, move: Floats | None, message: str, distance: float = 0.0) -> Misplaced:
    """A finding in units of humanoid space, as long as its move unless a distance is given."""
    if move is None:
        return Misplaced(rule, point, distance, message)
    x, y, z = move.tolist()
    return Misplaced(rule, point, distance or float(np.linalg.norm(move)), message, (x, y, z))


def _directions(a: Actor) -> dict[str, tuple[Floats, Floats]]:
    """Joints with a section: unit bisector of their bones, and unit axis across the limb in its plane."""
    above = {lower: upper for upper, lower in _bones(a)}
    below: dict[str, list[str]] = {}
    for upper, lower in _bones(a):
        below.setdefault(upper, []).append(lower)
    out = {}
    for name in a.places:
        if name in ENDS or not any(part in name for part in _SECTIONS) or name not in above:
            continue
        here = a.places[name]
        way = here - a.places[above[name]]
        after = [a.places[n] - here for n in below.get(name, []) if not n.endswith(("heel", "chin"))]
        bisector = unit(way) + (unit(np.mean(after, axis=0)) if after else 0)
        if np.linalg.norm(bisector) < 0.2 or np.linalg.norm(way) < 1e-6:
            continue
        bisector = unit(bisector)
        side = np.array([0.0, 0.0, 1.0] if "phalangeal" in name else [1.0, 0.0, 0.0])
        out[name] = (bisector, unit(side - (side @ bisector) * bisector))
    return out


def _centered(a: Actor, name: str, bisector: Floats, axis: Floats) -> tuple[Floats, Floats, float] | None:
    """Moves to the section's centroid (rule a) and to the line between its sides (rule b), and its mean radius."""
    assert a.flesh is not None
    here = a.places[name]
    section = a.flesh.section(here, bisector, _REACH * a.stature)
    if section is None:
        return None
    middle, rim, radius = section
    reach = (rim - here) @ axis
    ends = [rim[np.argmin(reach)], rim[np.argmax(reach)]]
    sides = _sides(a, name)
    if sides is not None and np.linalg.norm(sides[1] - sides[0]) > _APART * radius:
        ends = sides
    line = unit(ends[1] - ends[0])
    aside = ends[0] - here
    return middle - here, aside - (aside @ line) * line, radius


def _sides(a: Actor, name: str) -> list[Floats] | None:
    """The two epicondyles of an elbow or a knee, when feature points give them."""
    for joint, bone in _EPICONDYLES.items():
        both = [f"{name[:2]}{bone}_{side}_epicondyle" for side in ("medial", "lateral")]
        if joint in name and all(p in a.features for p in both):
            return [a.features[p] for p in both]
    return None


def _sections(a: Actor) -> list[Misplaced]:
    out = []
    for name, (bisector, axis) in _directions(a).items():
        found = _centered(a, name, bisector, axis)
        if found is None:
            continue
        to_middle, to_line, radius = found
        sides = _sides(a, name)
        apart = np.inf if sides is None else float(np.linalg.norm(sides[1] - sides[0]))
        if apart <= _APART * radius:
            text = f"its epicondyles are {apart * a.scale * 1000:.0f} mm apart, not on both sides of the limb"
            out.append(_finding("b", name, None, text, 2 * radius - apart))
        if np.linalg.norm(to_middle) > OFF_CENTER * radius:
            share = np.linalg.norm(to_middle) / radius
            out.append(_finding("a", name, to_middle, f"off the middle of the limb by {share:.0%} of its radius"))
        if any(p in name for p in _PIVOTS) and np.linalg.norm(to_line) > OFF_LINE * radius:
            share = np.linalg.norm(to_line) / radius
            out.append(
                _finding("b", name, to_line, f"off the line between the limb's sides by {share:.0%} of its radius")
            )
    return out


def _inside(a: Actor) -> list[Misplaced]:
    assert a.flesh is not None
    names = list(a.places)
    points = np.array([a.places[n] for n in names])
    inside, nearest = a.flesh.holds(points)
    gap = np.linalg.norm(nearest - points, axis=1)
    out = []
    for i, name in enumerate(names):
        if not inside[i] and gap[i] > (_OUTSIDE * a.stature if name in ENDS else 0.3 * _OUTSIDE * a.stature):
            out.append(_finding("c", name, nearest[i] - points[i], "outside the surface"))
    bones = [(upper, lower) for upper, lower in _bones(a) if lower != "chin"]  # that one is not in the flesh
    shares = np.linspace(0.2, 0.8, 4)
    way = np.array([[a.places[u] + s * (a.places[v] - a.places[u]) for s in shares] for u, v in bones])
    within, close = a.flesh.holds(way.reshape(-1, 3))
    off = np.linalg.norm(close - way.reshape(-1, 3), axis=1) * ~within
    off = off.reshape(len(bones), -1)
    good = dict(zip(names, inside, strict=True))
    for (upper, lower), row, points in zip(bones, off, way, strict=True):
        k = int(np.argmax(row))
        if row[k] > _OUTSIDE * a.stature and (good[upper] or upper in ENDS) and (good[lower] or lower in ENDS):
            move = close.reshape(*way.shape)[bones.index((upper, lower)), k] - points[k]
            out.append(_finding("c", lower, move, f"its bone from {upper} leaves the surface"))
    return out


def _spine(a: Actor) -> list[Misplaced]:
    assert a.flesh is not None
    out = []
    for name in SPINE:
        if name not in a.places:
            continue
        here = a.places[name]
        if abs(here[0]) > OFF_MIRROR * a.stature:
            out.append(_finding("d", name, np.array([-here[0], 0, 0]), "off the median plane"))
        depth = a.flesh.span(here, np.array([0.0, 0.0, 1.0]))
        if depth is None:
            continue
        front, back = depth
        share = front / (front + back)
        if abs(share - 2 / 3) > OFF_DEPTH:
            move = np.array([0.0, 0.0, front - 2 / 3 * (front + back)])
            out.append(_finding("d", name, move, f"{share:.0%} of the body's depth behind its front, not two thirds"))
    return out


def _mirror(a: Actor) -> list[Misplaced]:
    out = []
    for name, here in a.places.items():
        other = a.places.get("l_" + name[2:]) if name.startswith("r_") else None
        if other is None:
            continue
        move = other * [-1, 1, 1] - here
        if np.linalg.norm(move) > OFF_MIRROR * a.stature:
            out.append(_finding("e", name, move, f"no mirror image of l_{name[2:]}"))
    return out


def _lengths(a: Actor) -> list[Misplaced]:
    out, mm = [], 1000 * a.scale
    for (upper, lower), (share, band) in LENGTHS.items():
        for side in "lr":
            one, two = a.places.get(f"{side}_{upper}"), a.places.get(f"{side}_{lower}")
            if one is None or two is None:
                continue
            length, wanted = float(np.linalg.norm(two - one)), share * a.stature
            if abs(length / wanted - 1) > band:
                aim = wanted * (1 + band * np.sign(length - wanted))
                move = (aim - length) * unit(two - one)
                text = f"{length * mm:.0f} mm from {side}_{upper}; humans of that stature have {wanted * mm:.0f}"
                out.append(_finding("f", f"{side}_{lower}", move, text))
    return out


def _pose(a: Actor) -> list[Misplaced]:
    out = []
    angles = 2 * np.arccos(np.clip(np.abs(a.body.skeleton.rotation[:, 3]), 0, 1))
    for name, angle in zip(a.body.skeleton.names, angles, strict=True):
        if angle > 1e-3:
            out.append(_finding("g", name, None, f"turned by {np.degrees(angle):.0f} degrees at rest"))
    default = tables.default_centers()
    for upper, lower in _bones(a):
        if lower[:2] not in ("l_", "r_") or upper[:2] != lower[:2] or upper not in default or lower not in default:
            continue
        if not any(part in upper for part in ("shoulder", "elbow", "hip", "knee")):
            continue
        now, want = a.places[lower] - a.places[upper], default[lower] - default[upper]
        off = float(np.arccos(np.clip(unit(now) @ unit(want), -1, 1)))
        if off > OFF_POSE:
            move = unit(want) * np.linalg.norm(now) - now
            text = f"the limb below {upper} is {np.degrees(off):.0f} degrees from the default pose"
            out.append(_finding("g", lower, move, text))
    return out


def place(
    a: Actor, *, lock: Collection[str] = (), edits: Mapping[str, ArrayLike] | None = None, rounds: int = 8
) -> Actor:
    """The actor with its limb joints moved into the flesh by rules a and b, until they rest. Points that are locked, and
    those that `edits` puts somewhere (name -> (3,) metres, humanoid space), stay.

    Raises VitruvianError for names that are no points, and for a humanoid without a surface.
    """
    edits = edits or {}
    unknown = [n for n in [*lock, *edits] if n not in POINTS]
    if unknown:
        raise VitruvianError(f"place: expected names of the 87 points, found {unknown[0]!r}")
    if a.flesh is None:
        raise VitruvianError("place: expected a humanoid with a surface, found joints alone")
    moved = a.places | {n: floats(p, f"edits {n}", 3) for n, p in edits.items()}
    a = replace(a, places=moved, locked=a.locked | set(lock) | set(edits))
    for _ in range(rounds):
        steps = {}
        for name, (bisector, axis) in _directions(a).items():
            found = None if name in a.locked else _centered(a, name, bisector, axis)
            if found is None:
                continue
            to_middle, to_line, radius = found
            # Both rules at once: to the line, and along it to where the middle is.
            pull = to_line + ((to_middle - to_line) @ axis) * axis if any(p in name for p in _PIVOTS) else to_middle
            if np.linalg.norm(to_middle - pull) > OFF_CENTER * radius:
                pull = to_middle
            if np.linalg.norm(pull) > 0.02 * radius:
                steps[name] = pull
        if not steps:
            break
        a = replace(a, places=a.places | {n: a.places[n] + 0.7 * step for n, step in steps.items()})
    return a


def placed(humanoid: Humanoid, a: Actor) -> Humanoid:
    """A copy of a humanoid whose joints have their centres at an actor's points; the surface stays as it is."""
    made = humanoid.copied()
    for joint in made.joints():
        name = tables.canonical(joint.name) or joint.name
        if name in JOINTS and name in a.places:
            joint.center = a.places[name].copy()
    return made
