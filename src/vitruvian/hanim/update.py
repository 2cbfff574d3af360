"""A loaded humanoid back into its own scene graph: only what was changed is touched.

The typed objects are compared with a fresh reading of the graph; fields that differ are replaced. Motions and tracks
may be added, changed and removed. What the graph cannot take (other joints, other surfaces) makes `updated` answer
None, and the caller builds a new scene.
"""

from __future__ import annotations

import warnings
from dataclasses import fields, replace

import numpy as np

from vitruvian.hanim.animation import event
from vitruvian.hanim.build_motion import motion_node, track_nodes
from vitruvian.hanim.fields import container_of
from vitruvian.hanim.graph import Node, Route, Scene, Use
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, MotionData, Segment, Shape, Site, Track
from vitruvian.hanim.view import humanoids as view

# Typed attribute -> field of the node, per kind of object.
_PLACE = {
    "center": "center",
    "translation": "translation",
    "rotation": "rotation",
    "scale": "scale",
    "scale_orientation": "scaleOrientation",
}
_FIELDS: dict[type, dict[str, str]] = {
    Humanoid: {
        "name": "name",
        "version": "version",
        "loa": "loa",
        "skeletal_configuration": "skeletalConfiguration",
        **_PLACE,
    },
    Joint: {
        "name": "name",
        **_PLACE,
        "skin_coord_index": "skinCoordIndex",
        "skin_coord_weight": "skinCoordWeight",
        "llimit": "llimit",
        "ulimit": "ulimit",
        "limit_orientation": "limitOrientation",
        "stiffness": "stiffness",
    },
    Segment: {
        "name": "name",
        "mass": "mass",
        "center_of_mass": "centerOfMass",
        "moments_of_inertia": "momentsOfInertia",
    },
    Site: {"name": "name", **_PLACE},
    Displacer: {
        "name": "name",
        "coord_index": "coordIndex",
        "displacements": "displacements",
        "weight": "weight",
    },
    MotionData: {"frame_duration": "frameDuration", "enabled": "enabled", "loop": "loop", "description": "description"},
}
_TARGETS = {"rotation", "translation", "scale", "weight"}


def updated(humanoids: list[Humanoid], encoding: str) -> tuple[Scene, list[str]] | None:
    """The scene that these humanoids came from, brought up to date, and what could not be said; None if it can't be.

    `encoding` must be the scene's own, or the other of X3D's two. The scene is changed in place
    (what comes back for the other encoding is another `Scene` around the same nodes).
    """
    scene = humanoids[0].scene
    if scene is None or any(h.scene is not scene for h in humanoids):
        return None
    if encoding != scene.encoding and "wrl" in (encoding, scene.encoding):
        return None
    if any(factor != 1 for category, _, factor in scene.units if category in {"length", "angle"}):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        before = {id(h.node): h for h in view(scene, repair=True)}
    pairs = [(before.get(id(h.node)), h) for h in humanoids]
    if any(old is None or not _same_build(old, new) for old, new in pairs):
        return None
    native = humanoids[0].node is not None and humanoids[0].node.type.startswith("HAnim")
    if any(new.motions and not (native and scene.version >= "4") for old, new in pairs if _motions_differ(old, new)):
        return None
    for old, new in pairs:
        if old is not None:
            _update(scene, old, new)
    if encoding != scene.encoding:
        scene = replace(scene, encoding=encoding)
        if encoding == "x3d":
            _say_places(scene)
    return scene, []


def _say_places(scene: Scene) -> None:
    """containerField for what Classic X3D has in a field that isn't the usual one of its kind in XML."""
    for node in scene.walk():
        for name, item in node.entries():
            kind = item.type or (item.node.type if isinstance(item, Use) and item.node is not None else "")
            if not item.container and container_of(kind) != name:
                item.container = name


def _things(h: Humanoid) -> list[Humanoid | Joint | Segment | Site | Displacer]:
    return [h, *h.joints(), *h.segments(), *h.all_sites(), *h.viewpoints, *h.displacers()]


def _shapes(h: Humanoid) -> list[Shape]:
    sites = [*h.all_sites(), *h.viewpoints]
    return [*h.skin, *(s for g in h.segments() for s in g.shapes), *(s for t in sites for s in t.shapes)]


def _same_build(old: Humanoid | None, new: Humanoid) -> bool:
    """Whether both have the same objects in the same places and the same surfaces."""
    if old is None:
        return False
    a, b = _things(old), _things(new)
    if [id(x.node) for x in a] != [id(y.node) for y in b] or any(x.node is None for x in a):
        return False
    if [[id(c.node) for c in j.joints] for j in old.joints()] != [[id(c.node) for c in j.joints] for j in new.joints()]:
        return False
    if old.skin_coord.shape != new.skin_coord.shape or not _equal(old.binding, new.binding):
        return False
    if not _equal(old.skin_normal, new.skin_normal):
        return False
    s, t = _shapes(old), _shapes(new)
    return len(s) == len(t) and all(_same_shape(x, y) for x, y in zip(s, t))


def _same_shape(a: Shape, b: Shape) -> bool:
    for f in fields(Shape):
        x, y = getattr(a, f.name), getattr(b, f.name)
        if f.name == "material":
            same = all(getattr(x, m.name) == getattr(y, m.name) for m in fields(type(x)) if m.name != "node")
        elif f.name == "node":
            same = x is y
        else:
            same = _equal(x, y)
        if not same:
            return False
    return True


def _equal(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return a is not None and b is not None and np.array_equal(a, b)  # type: ignore[arg-type]
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_equal(a[k], b[k]) for k in a)
    if isinstance(a, tuple | list) and isinstance(b, tuple | list):
        return len(a) == len(b) and all(_equal(x, y) for x, y in zip(a, b))
    return bool(a == b)


def _motions_differ(old: Humanoid | None, new: Humanoid) -> bool:
    return old is None or [id(m.node) for m in old.motions] != [id(m.node) for m in new.motions]


def _update(scene: Scene, old: Humanoid, new: Humanoid) -> None:
    root = new.node
    if root is None:
        return
    for x, y in zip(_things(old), _things(new)):
        _store(x, y)
    if old.info != new.info:
        root.fields["info"] = [f"{k}={v}" if v else k for k, v in new.info.items()]
    if not np.array_equal(old.skin_coord, new.skin_coord):
        coord = root.children("skinCoord")
        if coord:
            coord[0].fields["point"] = new.skin_coord
    _update_motions(scene, root, old, new)
    if not _equal([_track_key(t) for t in old.tracks], [_track_key(t) for t in new.tracks]):
        _update_tracks(scene, new)


def _store(old: object, new: object) -> None:
    node = new.node  # type: ignore[attr-defined]
    for attribute, field in _FIELDS[type(new)].items():
        value = getattr(new, attribute)
        if _equal(getattr(old, attribute), value):
            continue
        if attribute == "name" and not value:
            continue
        node.fields[field] = value


def _update_motions(scene: Scene, root: Node, old: Humanoid, new: Humanoid) -> None:
    known = {id(m.node): m for m in old.motions}
    for m in new.motions:
        if m.node is None or id(m.node) not in known:
            continue
        _store(known[id(m.node)], m)
        if not _equal(known[id(m.node)].values, m.values):
            m.node.fields["values"] = m.values.reshape(-1)
        if not _equal([known[id(m.node)].joints, known[id(m.node)].channels], [m.joints, m.channels]):
            m.node.fields["joints"] = " ".join(m.joints)
            m.node.fields["channels"] = " ".join(f"{len(g)} {' '.join(g)}" for g in m.channels)
    if not _motions_differ(old, new):
        return
    taken = set(scene.defs())
    kept = {id(m.node) for m in new.motions}
    for field in ("motions", "children"):
        value = root.fields.get(field)
        if isinstance(value, list):
            root.fields[field] = [v for v in value if id(_target(v)) not in known or id(_target(v)) in kept]
    added = []
    for m in new.motions:
        if id(m.node) not in known:
            m.node = motion_node(m, _free(taken, f"{root.name or 'hanim'}_{m.name}"), enabled=m.enabled)
            m.node.container = "motions"
            added.append(m.node)
    if added:
        present = root.fields.get("motions")
        root.fields["motions"] = [*(present if isinstance(present, list) else []), *added]
        root.order = []
        names = [name for name, _ in scene.components]
        level = max([3, *(v for n, v in scene.components if n in {"HAnim", "H-Anim"})])
        scene.components = [c for c in scene.components if c[0] not in {"HAnim", "H-Anim"}]
        scene.components.append(("HAnim" if "H-Anim" not in names else "H-Anim", level))


def _target(entry: object) -> object:
    return entry.node if isinstance(entry, Use) else entry


def _free(taken: set[str], wanted: str) -> str:
    name, n = wanted, 2
    while name in taken:
        name, n = f"{wanted}_{n}", n + 1
    taken.add(name)
    return name


def _track_key(t: Track) -> tuple:
    return (t.target, t.field, t.keys, t.values, t.interval, t.loop, t.timer)


def _update_tracks(scene: Scene, new: Humanoid) -> None:
    """Take out the ROUTEs into the humanoid and drive it by interpolators of its tracks instead."""
    taken = set(scene.defs())
    targets: dict[str, Node] = {"": new.node} if new.node is not None else {}
    things: list[Joint | Site | Displacer] = [*new.joints(), *new.all_sites(), *new.viewpoints, *new.displacers()]
    for thing in things:
        if thing.node is None:
            continue
        if not thing.node.name:
            thing.node.name = _free(taken, f"hanim_{thing.name}")
        targets.setdefault(thing.name, thing.node)
    if new.node is not None and not new.node.name:
        new.node.name = _free(taken, "hanim_humanoid")
    driven = {n.name for n in targets.values()}
    scene.body = [
        s for s in scene.body if not (isinstance(s, Route) and s.to_node in driven and event(s.to_field) in _TARGETS)
    ]
    nodes, routes, _ = track_nodes(new.tracks, targets, lambda wanted: _free(taken, wanted), "")
    scene.body += [*nodes, *routes]
