"""A loaded humanoid back into its own scene graph: only what was changed is touched.

The typed objects are compared with a fresh reading of the graph; fields that differ are replaced. Motions and tracks
may be added, changed and removed. What the graph cannot take (other joints, other surfaces) makes `updated` answer
None, and the caller builds a new scene.
"""

from __future__ import annotations

import warnings
from dataclasses import fields, replace

import numpy as np

from vitruvian.hanim.animation import event, own_coordinate
from vitruvian.hanim.build_motion import motion_node, track_nodes
from vitruvian.hanim.build_pieces import info_strings
from vitruvian.hanim.fields import container_of
from vitruvian.hanim.graph import Node, Route, Scene, Use
from vitruvian.hanim.grow import grown
from vitruvian.hanim.humanoid import (
    Displacer,
    Humanoid,
    Joint,
    MotionData,
    Pose,
    Segment,
    Shape,
    Site,
    Track,
    Viewpoint,
)
from vitruvian.hanim.members import MEMBERS, plain
from vitruvian.hanim.view import humanoids as view

# Fields with code of their own in the reader that are stored as they are: typed attribute -> field of the node.
_APART: dict[str, dict[str, str]] = {
    "Humanoid": {"name": "name", "version": "version", "loa": "loa"},
    "Joint": {
        "name": "name",
        "skin_coord_index": "skinCoordIndex",
        "skin_coord_weight": "skinCoordWeight",
        "llimit": "llimit",
        "ulimit": "ulimit",
        "stiffness": "stiffness",
    },
    "Segment": {"name": "name", "moments_of_inertia": "momentsOfInertia"},
    "Site": {"name": "name"},
    "Displacer": {"name": "name", "coord_index": "coordIndex", "displacements": "displacements"},
    "Motion": {"frame_duration": "frameDuration", "enabled": "enabled", "loop": "loop", "end_frame": "endFrame"},
    "Pose": {"name": "name"},
    "Viewpoint": {
        "description": "description",
        "position": "position",
        "orientation": "orientation",
        "field_of_view": "fieldOfView",
    },
}
_KINDS: dict[type, str] = {MotionData: "Motion"}
_TARGETS = {"rotation", "translation", "scale", "center", "weight", "point"}


def updated(humanoids: list[Humanoid], encoding: str) -> tuple[Scene, list[str]] | None:
    """The scene that these humanoids came from, brought up to date, and what could not be said; None if it can't be.

    `encoding` must be the scene's own, or another of X3D's three. The scene is changed in place (what comes back for
    another encoding is another `Scene` around the same nodes).
    """
    scene = humanoids[0].scene
    if scene is None or any(h.scene is not scene for h in humanoids):
        return None
    if encoding != scene.encoding and "wrl" in (encoding, scene.encoding):
        return None
    if any(factor != 1 for category, _, factor in scene.units if category in {"length", "angle"}):
        return None
    pairs = _pairs(scene, humanoids)
    known = [(old, new) for old, new in pairs if old is not None]
    if len(known) == len(pairs) and _parts_differ(pairs) and all(grown(scene, old, new) for old, new in known):
        pairs = _pairs(scene, humanoids)
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


def _pairs(scene: Scene, humanoids: list[Humanoid]) -> list[tuple[Humanoid | None, Humanoid]]:
    """Each humanoid with a fresh reading of its node."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        before = {id(h.node): h for h in view(scene, repair=True)}
    return [(before.get(id(h.node)), h) for h in humanoids]


def _parts_differ(pairs: list[tuple[Humanoid | None, Humanoid]]) -> bool:
    """Whether objects were added, moved or removed."""
    ids = lambda h: [id(t.node) for t in _things(h)] + [[id(c.node) for c in j.joints] for j in h.joints()]  # noqa: E731
    coords = lambda h: [g.coord is None for g in h.segments()]  # noqa: E731
    return any(old is not None and (ids(old) != ids(new) or coords(old) != coords(new)) for old, new in pairs)


def _things(h: Humanoid) -> list[Humanoid | Joint | Segment | Site | Displacer | Pose | Viewpoint]:
    sites = [*h.all_sites(), *h.viewpoints]
    cameras = [v for s in sites for v in s.viewpoints]
    posed = [j for pose in h.poses for j in pose.joints]
    return [h, *h.joints(), *h.segments(), *sites, *h.displacers(), *cameras, *h.poses, *posed]


def _say_places(scene: Scene) -> None:
    """containerField for what Classic X3D has in a field that isn't the usual one of its kind in XML."""
    for node in scene.walk():
        for name, item in node.entries():
            kind = item.type or (item.node.type if isinstance(item, Use) and item.node is not None else "")
            if not item.container and container_of(kind) != name:
                item.container = name


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
    if old.skin_coord.shape != new.skin_coord.shape:
        return False
    for name in ("skin_normal", "skin_binding_coords", "skin_binding_normals"):
        if (getattr(old, name) is None) != (getattr(new, name) is None):
            return False
    if any((g.coord is None) != (k.coord is None) for g, k in zip(old.segments(), new.segments())):
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
        elif f.name == "points" and x is not None and y is not None and _coordinate(b) is not None:
            same = x.shape == y.shape  # moved points go into the Coordinate
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
        root.fields["info"] = info_strings(new)
    if not _equal(old.binding, new.binding):
        _store_binding(root, new)
    _store_points(root, "skinCoord", "point", old.skin_coord, new.skin_coord)
    _store_points(root, "skinNormal", "vector", old.skin_normal, new.skin_normal)
    _store_points(root, "skinBindingCoords", "point", old.skin_binding_coords, new.skin_binding_coords)
    _store_points(root, "skinBindingNormals", "vector", old.skin_binding_normals, new.skin_binding_normals)
    for before, after in zip(old.segments(), new.segments()):
        if after.node is not None:
            _store_points(after.node, "coord", "point", before.coord, after.coord)
    for a, b in zip(_shapes(old), _shapes(new)):
        coord = _coordinate(b)
        if coord is not None and not _equal(a.points, b.points):
            coord.fields["point"] = b.points
    _update_motions(scene, root, old, new)
    if not _equal([_track_key(t) for t in old.tracks], [_track_key(t) for t in new.tracks]):
        _update_tracks(scene, new)


def _coordinate(shape: Shape) -> Node | None:
    """The Coordinate that a shape's own points are in."""
    geometry = shape.node.children("geometry") if shape.node is not None else []
    found = geometry[0].children("coord") if geometry else []
    return found[0] if found and shape.points is not None else None


def _store_points(node: Node, field: str, inner: str, old: object, new: object) -> None:
    found = node.children(field)
    if found and not _equal(old, new):
        found[0].fields[inner] = new


def _store_binding(root: Node, h: Humanoid) -> None:
    """jointBinding* in the order of `joints`; what is not named is the identity."""
    names = {id(j.node): j.name for j in h.joints()}
    identity = (np.zeros(3), np.array([0.0, 0.0, 1.0, 0.0]), np.ones(3))
    rows = [h.binding.get(names.get(id(n), ""), identity) for n in root.children("joints")]
    for k, field in enumerate(("jointBindingPositions", "jointBindingRotations", "jointBindingScales")):
        if h.binding:
            root.fields[field] = np.array([r[k] for r in rows])
        else:
            root.fields.pop(field, None)


def _store(old: object, new: object) -> None:
    node = new.node  # type: ignore[attr-defined]
    kind = _KINDS.get(type(new)) or type(new).__name__
    pairs = list(_APART[kind].items()) + [(m.attribute, m.field) for m in MEMBERS.get(kind, ())]
    for attribute, field in pairs:
        value = getattr(new, attribute)
        if _equal(getattr(old, attribute), value) or attribute == "name" and not value:
            continue
        node.fields[field] = plain(value)
    if kind == "Viewpoint":
        return
    if old.metadata is not new.metadata:  # type: ignore[attr-defined]
        _set(node, "metadata", new.metadata)  # type: ignore[attr-defined]
    before, after = old.extras, new.extras  # type: ignore[attr-defined]
    for field in {**before, **after}:
        if field not in after:
            node.fields.pop(field, None)
        elif field not in before or not _equal(before[field], after[field]):
            node.fields[field] = after[field]


def _set(node: Node, field: str, child: Node | None) -> None:
    """Put a node into a field that is looked for by its name; nothing takes it out."""
    node.order = []
    if child is None:
        node.fields.pop(field, None)
    else:
        child.container = field
        node.fields[field] = child


def _update_motions(scene: Scene, root: Node, old: Humanoid, new: Humanoid) -> None:
    known = {id(m.node): m for m in old.motions}
    for m in new.motions:
        if m.node is None or id(m.node) not in known:
            continue
        _store(known[id(m.node)], m)
        if not _equal(known[id(m.node)].values, m.values):
            m.node.fields["values"] = m.values.reshape(-1)
            if "endFrame" in m.node.fields:
                m.node.fields["endFrame"] = int(m.end_frame) or max(len(m.values) - 1, 0)
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
    points: dict[str, Node | Use] = {}
    for owner, field, name in [(new.node, "skinCoord", ""), *((g.node, "coord", g.name) for g in new.segments())]:
        for coord in owner.children(field) if owner is not None else []:
            if not coord.name and any(t.field == "point" and t.target == name for t in new.tracks):
                coord.name = _free(taken, f"hanim_{name or 'skin'}_coords")
            points[name] = coord
    for shape in new.skin:
        own = own_coordinate(shape) if shape.points is not None else None
        if own is not None and own.name:
            points.setdefault(shape.name, own)
    driven |= {n.name for n in points.values() if n.name}
    scene.body = [
        s for s in scene.body if not (isinstance(s, Route) and s.to_node in driven and event(s.to_field) in _TARGETS)
    ]
    nodes, routes, _ = track_nodes(new.tracks, targets, lambda wanted: _free(taken, wanted), "", points)
    scene.body += [*nodes, *routes]
