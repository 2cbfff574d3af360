"""What the page's explorer says about a figure beyond its arrays: levels, names, kinds of Sites, groups of displacers.

Levels of articulation, the names in the other version and feature points come from the standard's tables
(ISO/IEC 19774-1:2019 and :2006); everything else from the file. Strings are the file's own: the page shows them as text.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from vitruvian.body.kinematics import transform_matrix
from vitruvian.body.types import Body, Floats
from vitruvian.hanim import tables
from vitruvian.hanim.graph import Literal, Node
from vitruvian.hanim.humanoid import Humanoid, Site
from vitruvian.hanim.reading import leniently
from vitruvian.show.figure import looking

SITE_KINDS = ("feature point", "end effector", "viewpoint", "other place")
# Groups of displacers: the first whose pattern is found in the name takes it.
GROUPS = (
    ("Brows", re.compile(r"brow|forehead", re.I)),
    ("Cheeks and nose", re.compile(r"cheek|nose|nostril|sneer", re.I)),
    ("Mouth and jaw", re.compile(r"mouth|(?<![cfls])lip|jaw|chin|smile|frown|tongue|teeth|viseme|dimple|pucker", re.I)),
    ("Eyes", re.compile(r"(?<![a-z])eye|blink|(?<!so)lid|pupil|iris|gaze", re.I)),
    ("Other parts of the face", re.compile(r"face|facial|(?<![a-z])(?:head|skull|ear)", re.I)),
    ("Expressions", re.compile(r"_config$")),
)
OTHER = "Other shapes"
DEEPEST = 64  # levels below a Site that are searched for its Viewpoint
MAX_CAMERAS = 100
MAX_NODES = 2000  # nodes below one Site that are looked at


def levels(names: Sequence[str], parents: Sequence[int]) -> list[int]:
    """The level of articulation (0..4) from which on a complete figure has each joint; 0: always there.

    Joints that the standard does not know stay at every level, as `convert` keeps them, and so do roots.
    """
    known = [tables.canonical(n, "joint") for n in names]
    return [0 if p < 0 or k is None else tables.joints()[k].loa for k, p in zip(known, parents)]


def other_name(name: str) -> tuple[str, str | None] | None:
    """(version, what that version calls the joint, None when it has no such joint); None for a custom joint."""
    known = tables.canonical(name, "joint")
    if known is None:
        return None
    return ("1.x", tables.name_in(known, "1.x")) if known == name else ("2.0", known)


def site_kind(name: str, *, camera: bool = False) -> str:
    """One of `SITE_KINDS`, by the suffix that the standard gives Sites, else by its table of feature points."""
    if camera or name.endswith("_view"):
        return "viewpoint"
    if name.endswith("_tip"):
        return "end effector"
    return "feature point" if name.endswith("_pt") or tables.canonical(name, "site") else "other place"


def group(name: str) -> str:
    """Which part of the face a displacer moves, by its name; `OTHER` for the rest."""
    return next((title for title, pattern in GROUPS if pattern.search(name)), OTHER)


def details(body: Body, humanoid: Humanoid | None) -> dict[str, Any]:
    """JSON fields of the mesh message: `loa`, `names`, `segments` per joint, `sites`, `displacers`, `cameras`."""
    s = body.skeleton
    eyes = cameras(body, humanoid)
    seeing = {c["name"] for c in eyes}
    morphs = body.skin.morphs
    return {
        "loa": levels(s.names, s.parents.tolist()),
        "names": [other_name(n) for n in s.names],
        "segments": _segments(body, humanoid),
        "sites": [
            {"name": n, "joint": int(j), "kind": site_kind(n, camera=n in seeing)}
            for n, j in zip(s.site_names, s.site_joints)
        ],
        "displacers": [
            {"name": m.name, "joint": int(m.joint), "before": m.before, "group": group(m.name)} for m in morphs
        ],
        "cameras": eyes,
    }


def _segments(body: Body, humanoid: Humanoid | None) -> list[list[str]]:
    names = body.skeleton.names
    if humanoid is not None:
        held = {j.name: [g.name for g in j.segments] for j in humanoid.joints()}
        if any(n in held for n in names):
            return [held.get(n, []) for n in names]
    known = [tables.canonical(n, "joint") for n in names]
    return [[tables.joints()[k].segment] if k else [] for k in known]


def cameras(body: Body, humanoid: Humanoid | None) -> list[dict[str, Any]]:
    """Where the `_view` Sites and the Humanoid's viewpoints look from and to, at rest, at most `MAX_CAMERAS`.

    `{name, joint, eye, look, fov}`: eye (3,) metres and look (3,) unit vector in humanoid space, fov radians; joint -1
    for viewpoints, which follow the Humanoid alone. A Site looks along -Z of its Viewpoint, as in browsers, or of its
    own frame when it has a rotation and no Viewpoint; with neither, ahead from inside the body and from outside to it.
    """
    s = body.skeleton
    sites = {site.name: site for site in humanoid.all_sites()} if humanoid is not None else {}
    named = zip(s.site_names, s.site_joints, s.site_points)
    places = [(int(j), sites.get(n) or Site(n, translation=p)) for n, j, p in named]
    seen = {id(site) for _, site in places}
    if humanoid is not None:
        places += [(-1, site) for site in humanoid.viewpoints if id(site) not in seen]
    points = body.skin.rest if len(body.skin.rest) else s.centers
    out: list[dict[str, Any]] = []
    for joint, site in places:
        if len(out) == MAX_CAMERAS:
            break
        found = _viewpoint(site.node) if site.node is not None else None
        if found is None and not (site.name.endswith("_view") or joint < 0):
            continue
        frame = transform_matrix(site.translation, site.rotation, site.scale, site.scale_orientation, site.center)
        eye, fov = site.center + site.translation, np.pi / 4
        if found is not None:
            inner, fov = found
            frame = _rigid(frame @ inner)
            eye = frame[:3, 3]
        aimed = found is not None or bool(site.viewpoints) or abs(float(site.rotation[3])) > 1e-6
        look = -_rigid(frame)[:3, 2] if aimed else _ahead(eye, points)
        if np.isfinite([*eye, *look]).all() and np.abs(eye).max() < 1e6 and np.linalg.norm(look) > 0.5:
            at = {"eye": [float(x) for x in eye], "look": [float(x) for x in look]}
            out.append({"name": site.name, "joint": joint, **at, "fov": float(np.clip(fov, 0.1, 2.6))})
    return out


def _ahead(eye: Floats, points: Floats) -> Floats:
    """Where a camera looks that does not say so: +Z from inside the body, from outside to it as in pictures."""
    if ((eye >= points.min(axis=0) - 0.02) & (eye <= points.max(axis=0) + 0.02)).all():
        return np.array([0.0, 0.0, 1.0])
    frame = np.eye(4)
    frame[:3, 3] = eye
    return -looking(frame, points)[:3, 2]


def _viewpoint(node: Node) -> tuple[Floats, float] | None:
    """Frame (4,4) in its Site and opening (radians) of the first Viewpoint below a Site's node."""
    looked = 0
    stack: list[tuple[Node, Floats, int]] = [(node, np.eye(4), 0)]
    while stack and looked < MAX_NODES:
        at, frame, depth = stack.pop()
        looked += 1
        for child in _children(at):
            if child.type == "Viewpoint":
                fov = _numbers(child, "fieldOfView", 1)
                place = _or(_numbers(child, "position", 3), [0, 0, 0])
                own = transform_matrix(place, _or(_numbers(child, "orientation", 4), [0, 0, 1, 0]))
                return frame @ own, float(fov[0]) if fov is not None else np.pi / 4
            if child.type == "Transform" and depth < DEEPEST:
                stack.append((child, frame @ _transform(child), depth + 1))
            elif child.type in ("Group", "Anchor", "Collision") and depth < DEEPEST:
                stack.append((child, frame, depth + 1))
    return None


def _children(node: Node) -> Iterator[Node]:
    for field, child in node.entries():
        if field == "children" and isinstance(child, Node):
            yield child


def _transform(node: Node) -> Floats:
    pick = lambda name, default: _or(_numbers(node, name, len(default)), default)  # noqa: E731
    turns = pick("rotation", [0, 0, 1, 0]), pick("scale", [1, 1, 1]), pick("scaleOrientation", [0, 0, 1, 0])
    return transform_matrix(pick("translation", [0, 0, 0]), *turns, pick("center", [0, 0, 0]))


def _rigid(frame: Floats) -> Floats:
    """The frame with axes of length one."""
    length = np.linalg.norm(frame[:3, :3], axis=0)
    out = frame.copy()
    out[:3, :3] /= np.where(length > 1e-12, length, 1.0)
    return out


def _or(value: Floats | None, default: list[float]) -> Floats:
    return np.asarray(default, np.float64) if value is None else value


def _numbers(node: Node, field: str, count: int) -> Floats | None:
    """(count,) finite numbers of a field, or None: absent or not such numbers."""
    raw = node.fields.get(field)
    try:
        array = leniently(raw.text) if isinstance(raw, Literal) else np.asarray(raw, np.float64).reshape(-1)
    except (TypeError, ValueError):
        return None
    return array if raw is not None and array.shape == (count,) and np.isfinite(array).all() else None
