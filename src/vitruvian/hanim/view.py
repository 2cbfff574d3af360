"""The typed view on a scene graph: native H-Anim nodes (X3D 3.x, 4.0) and PROTO humanoids (1.1, 200x, robot dialect).

Defects that browsers live with are read with the browsers' meaning and reported once per kind as a warning; non-finite
numbers, indices outside their array and counts that do not fit are refused (`FileError`) unless `repair` is given.
Semantics: ISO/IEC 19774-1 and what X3D browsers do with it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vitruvian.hanim import animation, surface, tables
from vitruvian.hanim.fields import container_of
from vitruvian.hanim.graph import Node, Scene, Use, walk_all
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Shape, Site
from vitruvian.hanim.reading import Reading

_ZERO, _ONE, _NO_TURN = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 1.0, 0.0)
_BODY_FIELDS = ("skeleton", "humanoidBody")


def humanoids(scene: Scene, path: object = None, *, repair: bool = False) -> list[Humanoid]:
    """Every humanoid of a scene, in source order, each with its nodes (`.node`) and its scene (`.scene`).

    `path` is what messages call the file (default `scene.path`). With `repair` whatever would be refused is dropped or
    zeroed and reported as a warning. Raises `FileError` naming file, line and object.
    """
    reading = Reading(scene, path, repair)
    found = [_humanoid(reading, node) for node in scene.walk() if reading.kind(node) == "Humanoid"]
    taken: dict[str, int] = {}
    for h in found:
        taken[h.name] = taken.get(h.name, 0) + 1
        if taken[h.name] > 1:
            reading.defect("N08", f"humanoid {h.name}: the name is given twice, the later is called {h.name}_2", h.node)
            h.name = f"{h.name}_{taken[h.name]}"
    animation.attach_tracks(reading, found)
    reading.say()
    return found


def walk_groups(reading: Reading, nodes: list[Node]) -> Iterator[Node]:
    """`nodes` and what hangs in plain groups below them; H-Anim nodes are answered, not entered."""
    stack = list(reversed(nodes))
    seen: set[int] = set()
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        yield node
        if not reading.kind(node) and node.type != "Shape":
            stack.extend(reversed(node.children("children")))


def body_nodes(reading: Reading, node: Node) -> tuple[list[Node], list[Node]]:
    """Joint nodes that root the skeleton, each once, and Site nodes beside them.

    Of `skeleton` and `humanoidBody` the filled one counts. Joints that landed in `children` for want of a
    containerField count as skeleton when they are not USEs.
    """
    roots: list[Node] = []
    known: set[int] = set()
    sites: list[Node] = []
    entries: list[tuple[Node, bool]] = []
    for field in _BODY_FIELDS:
        value = node.fields.get(field)
        if isinstance(value, Node | Use):
            value = [value]
        if isinstance(value, list):
            for v in value:
                target = v.node if isinstance(v, Use) else v
                if isinstance(target, Node):
                    entries.append((target, isinstance(v, Use)))
        if entries:
            break
    if not any(reading.kind(n) in {"Joint", ""} for n, _ in entries):
        value = node.fields.get("children")
        stray = (
            [v for v in value if isinstance(v, Node) and reading.kind(v) == "Joint"] if isinstance(value, list) else []
        )
        if stray:
            reading.defect(
                "F06", f"{reading.who(node)}: joints without containerField='skeleton' read as skeleton", node
            )
            entries += [(v, False) for v in stray]
    for entry, _ in entries:
        for n in walk_groups(reading, [entry]):
            kind = reading.kind(n)
            if kind == "Joint" and id(n) not in known:
                known.add(id(n))
                roots.append(n)
            elif kind == "Joint":
                what = f"{reading.who(n)} stands twice in skeleton: read once"
                reading.defect("T04", f"{reading.who(node)}: {what}", n)
            elif kind == "Site":
                sites.append(n)
    return roots, sites


def name_of(reading: Reading, node: Node, prefixes: tuple[str, ...] = ("hanim_",)) -> str:
    """The object's name; without one, its DEF less the humanoid's prefix."""
    name = reading.text(node, "name").strip()
    if name or not node.name:
        return name
    for prefix in prefixes:
        if prefix and node.name.startswith(prefix) and len(node.name) > len(prefix):
            return node.name[len(prefix) :]
    head, _, tail = node.name.partition("_")
    kind = {"Joint": "joint", "Segment": "segment", "Site": "site"}.get(reading.kind(node))
    if kind and head and tail and tables.canonical(tail, kind) and not tables.canonical(node.name, kind):
        return tail
    return node.name


class _Figure:
    """What is known while one humanoid is read."""

    def __init__(self, reading: Reading, node: Node):
        self.reading, self.node = reading, node
        self.seen: set[int] = set()
        self.joints: dict[int, Joint] = {}  # by node identity
        self.sites: dict[int, Site] = {}
        self.names: set[str] = set()
        self.numbers: dict[str, int] = {}
        name = reading.text(node, "name").strip()
        self.prefixes = ("hanim_", f"{name}_" if name else "", f"{node.name}_" if node.name else "")
        coords = node.children("skinCoord") or _stray(reading, node, {"Coordinate", "CoordinateDouble"})
        self.skin_coord = coords[0] if coords else None
        self.points = np.zeros((0, 3))
        below = [n for f in (*_BODY_FIELDS, "children") for n in node.children(f)]
        named = (n for n in walk_all(below) if reading.kind(n) == "Joint")
        self.given = {reading.text(n, "name").strip() for n in named}  # a given name beats one taken from a DEF

    def name(self, node: Node, fallback: str) -> str:
        given = self.reading.text(node, "name").strip()
        name = given or name_of(self.reading, node, self.prefixes) or fallback
        if not given:
            kind = self.reading.kind(node).lower()
            self.reading.defect(f"N01 {kind}", f"{kind} without a name is called {name}", node)
        return name


def _stray(reading: Reading, node: Node, types: set[str]) -> list[Node]:
    """Nodes of these types that landed in `children` of a Humanoid, reported."""
    found = [n for n in node.children("children") if n.type in types]
    if found:
        reading.defect(
            "F06", f"{reading.who(node)}: {found[0].type} without its containerField is read by its type", node
        )
    return found


def _humanoid(reading: Reading, node: Node) -> Humanoid:
    figure = _Figure(reading, node)
    _check_containers(reading, node)
    default = {"2.0": "200x"}.get(reading.scene.version, "2.0" if reading.scene.version >= "4" else "1.0")
    h = Humanoid(
        name=reading.text(node, "name").strip() or _plain_name(node),
        version=reading.text(node, "version", default).strip() or default,
        loa=int(reading.number(node, "loa", -1)),
        info=_info(reading.texts(node, "info")),
        skeletal_configuration=reading.text(node, "skeletalConfiguration", "BASIC").strip() or "BASIC",
        scene=reading.scene,
        node=node,
    )
    _place(reading, node, h)
    _read_skin(figure, h)
    roots, sites = body_nodes(reading, node)
    h.skeleton = [j for n in roots if (j := _joint(figure, n)) is not None]
    h.sites = [_site(figure, n) for n in sites]
    h.viewpoints = [_site(figure, n) for n in node.children("viewpoints") if reading.kind(n) == "Site"]
    _check_lists(figure)
    _binding(figure, h)
    h.motions = animation.motions(reading, node)
    return h


def _check_containers(reading: Reading, node: Node) -> None:
    """Say that children without containerField were placed by their type (the reader of XML does it)."""
    if reading.scene.encoding != "x3d":
        return
    for field, entry in node.entries():
        target = entry.node if isinstance(entry, Use) else entry
        if target is None or not entry.line or entry.container or container_of(target.type) == field:
            continue
        what = f"{target.type} {entry.name} without containerField is read as {field}"
        reading.defect("F06", f"{reading.who(node)}: {what}", target)


def _plain_name(node: Node) -> str:
    return node.name.removeprefix("hanim_") or "humanoid"


def _info(entries: list[str]) -> dict[str, str]:
    """`key=value` strings as a dictionary; an entry without `=` is a key with an empty value."""
    info: dict[str, str] = {}
    for entry in entries:
        key, _, value = entry.partition("=")
        if entry.strip():
            info[key.strip()] = value.strip()
    return info


def _place(reading: Reading, node: Node, thing: Humanoid | Joint | Site) -> None:
    """The five transform fields that Humanoid, Joint and Site share."""
    thing.center = reading.vector(node, "center", _ZERO)
    thing.translation = reading.vector(node, "translation", _ZERO)
    thing.rotation = reading.vector(node, "rotation", _NO_TURN)
    thing.scale = reading.vector(node, "scale", _ONE)
    thing.scale_orientation = reading.vector(node, "scaleOrientation", _NO_TURN)


def _read_skin(figure: _Figure, h: Humanoid) -> None:
    reading, node = figure.reading, figure.node
    parts = node.children("skin")
    if not parts:
        parts = _stray(reading, node, {"Shape", "Group", "Transform"})
    shapes = surface.shapes(reading, parts, figure.skin_coord)
    if figure.skin_coord is None:
        figure.skin_coord = next((c for s in shapes if (c := _coord(s)) is not None), None)
        if figure.skin_coord is not None:
            what = "skinCoord is missing: the Coordinate of the skin geometry is taken"
            reading.defect("M04", f"{reading.who(node)}: {what}", figure.skin_coord)
            for s in shapes:
                if _coord(s) is figure.skin_coord:
                    s.points = None
    if figure.skin_coord is not None:
        figure.points = reading.numbers(figure.skin_coord, "point", "MFVec3f", 3)
    for s in shapes:
        if s.points is not None and len(figure.points) and np.array_equal(s.points, figure.points):
            what = "skinCoord is a copy of the skin geometry's Coordinate instead of a USE: read as one"
            reading.defect("M04 copy", f"{reading.who(node)}: {what}", s.node)
            s.points = None
    h.skin, h.skin_coord = shapes, figure.points
    normals = node.children("skinNormal")
    if normals:
        h.skin_normal = reading.numbers(normals[0], "vector", "MFVec3f", 3)


def _coord(shape: Shape) -> Node | None:
    geometry = shape.node.children("geometry") if shape.node is not None else []
    return surface.coordinate(geometry[0]) if geometry else None


def _joint(figure: _Figure, root: Node) -> Joint | None:
    """A joint and all below it; no recursion, so that no file is too deep."""
    reading = figure.reading
    top: Joint | None = None
    stack: list[tuple[Node, Joint | None]] = [(root, None)]
    while stack:
        node, parent = stack.pop()
        if id(node) in figure.seen:
            reading.defect("T04", f"{reading.who(node)} is reached twice in the skeleton: read once", node)
            continue
        figure.seen.add(id(node))
        joint = _one_joint(figure, node)
        if parent is None:
            top = joint
        else:
            parent.joints.append(joint)
        below = _fill(figure, node, joint)
        stack.extend((n, joint) for n in reversed(below))
    return top


def _one_joint(figure: _Figure, node: Node) -> Joint:
    reading = figure.reading
    name = figure.name(node, f"joint_{len(figure.joints) + 1}")
    if name in figure.names or (name in figure.given and not reading.text(node, "name").strip()):
        number = figure.numbers.get(name, 1) + 1
        while f"{name}_{number}" in figure.names or f"{name}_{number}" in figure.given:
            number += 1
        figure.numbers[name] = number
        reading.defect("N04", f"joint {name}: the name is given twice, one is called {name}_{number}", node)
        name = f"{name}_{number}"
    figure.names.add(name)
    joint = Joint(name=name, node=node)
    figure.joints[id(node)] = joint
    _place(reading, node, joint)
    joint.llimit = reading.numbers(node, "llimit")[:3] * reading.angle
    joint.ulimit = reading.numbers(node, "ulimit")[:3] * reading.angle
    joint.limit_orientation = reading.vector(node, "limitOrientation", _NO_TURN)
    stiffness = reading.numbers(node, "stiffness")
    if len(stiffness):
        joint.stiffness = np.resize(stiffness[:3], 3) if len(stiffness) < 3 else stiffness[:3].copy()
    _weights(figure, node, joint)
    return joint


def _weights(figure: _Figure, node: Node, joint: Joint) -> None:
    reading = figure.reading
    index = reading.indices(node, "skinCoordIndex")
    weight = reading.numbers(node, "skinCoordWeight")
    if len(index) != len(weight) and len(index) + len(weight):
        what = f"joint {joint.name}: {len(weight)} weights for {len(index)} indices"
        if len(weight) == 0:
            reading.defect("S01", f"{what}: the joint moves no skin", node)
            index = index[:0]
        elif len(weight) < len(index):
            reading.defect("S01", f"{what}: the last weight is used for the rest", node)
            weight = np.concatenate([weight, np.full(len(index) - len(weight), weight[-1])])
        else:
            reading.defect("S01", f"{what}: weights beyond the indices are ignored", node)
            weight = weight[: len(index)]
    if figure.skin_coord is None and len(index):
        reading.defect("M05", f"joint {joint.name}: weights without skinCoord have no effect", node)
        index, weight = index[:0], weight[:0]
    keep = (index >= 0) & (index < len(figure.points))
    if not keep.all():
        bad = index[~keep][0]
        what = f"expected indices in 0..{len(figure.points) - 1}, found {bad} at entry {int(np.argmin(keep))}"
        reading.broken(f"joint {joint.name} skinCoordIndex: {what}; drop the pair or check skinCoord", node)
        index, weight = index[keep], weight[keep]
        reading.mend(node, "skinCoordIndex", index)
        reading.mend(node, "skinCoordWeight", weight)
    if (weight < 0).any():
        first = int(np.argmax(weight < 0))
        what = f"expected weights of 0 or more, found {weight[first]:g} at entry {first}"
        reading.broken(f"joint {joint.name} skinCoordWeight: {what}", node)
        weight = np.maximum(weight, 0.0)
        reading.mend(node, "skinCoordWeight", weight)
    joint.skin_coord_index, joint.skin_coord_weight = index, weight


def _fill(figure: _Figure, node: Node, joint: Joint) -> list[Node]:
    """Sort a joint's children into segments, sites and displacers; answers the joints among them."""
    reading = figure.reading
    below: list[Node] = []
    loose: list[Node] = []
    for child in node.children("children"):
        kind = reading.kind(child)
        if kind == "":
            inner = [n for n in walk_groups(reading, [child]) if reading.kind(n)]
            if inner and child.type == "Transform":
                what = f"joint {joint.name}: H-Anim objects inside a Transform are read without it"
                reading.defect("transform", what, child)
            loose.append(child)
        else:
            inner = [child]
        for n in inner:
            kind = reading.kind(n)
            if kind == "Joint":
                below.append(n)
            elif kind == "Segment":
                segment, joints = _segment(figure, n, joint)
                joint.segments.append(segment)
                below += joints
            elif kind == "Site":
                joint.sites.append(_site(figure, n))
            elif kind == "Displacer":
                reading.defect("F06 displacer", f"{reading.who(n)} is read as displacer of joint {joint.name}", n)
                joint.displacers.append(_displacer(figure, n, len(figure.points), joint.name))
    for n in node.children("displacers"):
        joint.displacers.append(_displacer(figure, n, len(figure.points), joint.name))
    drawn = surface.shapes(reading, loose)
    if drawn:
        reading.defect("M21", f"joint {joint.name}: geometry outside a Segment is read as its segment's", loose[0])
        if not joint.segments:
            known = tables.canonical(joint.name)
            joint.segments.append(Segment(name=tables.joints()[known].segment if known else f"{joint.name}_segment"))
        joint.segments[0].shapes += drawn
    return below


def _segment(figure: _Figure, node: Node, joint: Joint) -> tuple[Segment, list[Node]]:
    reading = figure.reading
    name = figure.name(node, f"{joint.name}_segment")
    segment = Segment(name=name, node=node, mass=reading.number(node, "mass", 0.0))
    segment.center_of_mass = reading.vector(node, "centerOfMass", _ZERO)
    if (segment.center_of_mass == -1).all():  # an old default that means "not given"
        segment.center_of_mass = np.zeros(3)
    inertia = reading.numbers(node, "momentsOfInertia")
    if len(inertia) == 9:
        segment.moments_of_inertia = inertia
    elif len(inertia):
        reading.broken(f"segment {name} momentsOfInertia: expected 9 numbers, found {len(inertia)}", node)
        reading.mend(node, "momentsOfInertia", np.zeros(9))
    children = node.children("children")
    segment.shapes = surface.shapes(reading, children)
    joints: list[Node] = []
    for n in walk_groups(reading, children):
        kind = reading.kind(n)
        if kind == "Site":
            segment.sites.append(_site(figure, n))
        elif kind == "Joint":
            reading.defect("T02", f"{reading.who(n)} hangs in segment {name}: read as child of {joint.name}", n)
            joints.append(n)
        elif kind == "Segment" and n is not node:
            reading.defect("T02", f"{reading.who(n)} hangs in segment {name}: its geometry is read with it", n)
            segment.shapes += surface.shapes(reading, n.children("children"))
    displacers = node.children("displacers")
    if displacers:
        coord = node.children("coord")
        limit = max((len(s.points) for s in segment.shapes if s.points is not None), default=0)
        if coord:
            limit = len(reading.numbers(coord[0], "point", "MFVec3f", 3))
        segment.displacers = [_displacer(figure, n, limit, name) for n in displacers]
    return segment, joints


def _site(figure: _Figure, node: Node) -> Site:
    """A site; one that is USEd again (a viewpoint in the tree) stays the same object."""
    if id(node) in figure.sites:
        return figure.sites[id(node)]
    site = Site(name=figure.name(node, "site"), node=node)
    _place(figure.reading, node, site)
    site.shapes = surface.shapes(figure.reading, node.children("children"))
    figure.sites[id(node)] = site
    return site


def _displacer(figure: _Figure, node: Node, limit: int, owner: str) -> Displacer:
    """A displacer of joint or segment `owner` over `limit` points."""
    reading = figure.reading
    index = reading.indices(node, "coordIndex")
    moves = reading.numbers(node, "displacements", "MFVec3f", 3)
    name = figure.name(node, "displacer")
    if len(index) != len(moves) and len(moves):
        what = f"expected {len(index)} displacements, one per coordIndex, found {len(moves)}"
        reading.broken(f"displacer {name} of {owner}: {what}; cut both to the shorter", node)
        n = min(len(index), len(moves))
        index, moves = index[:n], moves[:n]
        reading.mend(node, "coordIndex", index)
        reading.mend(node, "displacements", moves)
    elif not len(moves):
        moves = np.zeros((len(index), 3))
    keep = (index >= 0) & (index < limit)
    if not keep.all():
        bad = index[~keep][0]
        where = f"displacer {name} of {owner} coordIndex"
        reading.broken(f"{where}: expected indices in 0..{limit - 1}, found {bad}; drop the entry", node)
        index, moves = index[keep], moves[keep]
        reading.mend(node, "coordIndex", index)
        reading.mend(node, "displacements", moves)
    return Displacer(name, index, moves, reading.number(node, "weight", 0.0), node)


def _check_lists(figure: _Figure) -> None:
    """What stands in `joints` against what stands in the skeleton: the skeleton decides, differences are reported."""
    reading, node = figure.reading, figure.node
    listed = [n for n in node.children("joints") if reading.kind(n) == "Joint"]
    if not figure.joints:
        return
    who = reading.who(node)
    ids = [id(n) for n in listed]
    absent = [j for i, j in figure.joints.items() if i not in set(ids)]
    if len(set(ids)) < len(ids):
        what = f"{len(ids) - len(set(ids))} joints are listed twice in joints: each counts once"
        reading.defect("M02", f"{who}: {what}", node)
    if absent and (listed or reading.kind(node) and node.type.startswith("HAnim")):
        some = ", ".join(j.name for j in absent[:3]) + (", ..." if len(absent) > 3 else "")
        reading.defect(
            "M01", f"{who}: {len(absent)} joints of the skeleton are not in joints ({some}): read as listed", node
        )
    copies = [n for n in listed if id(n) not in figure.joints]
    if copies:
        what = f"{len(copies)} entries of joints are not in the skeleton ({reading.who(copies[0])}): ignored"
        reading.defect("M03", f"{who}: {what}", copies[0])


def _binding(figure: _Figure, h: Humanoid) -> None:
    """Binding arrays, in order of `joints`, as joint -> translation, rotation, scale; identity is left out."""
    reading, node = figure.reading, figure.node
    if not any(f in node.fields for f in ("jointBindingPositions", "jointBindingRotations", "jointBindingScales")):
        return
    positions = reading.numbers(node, "jointBindingPositions", "MFVec3f", 3)
    rotations = reading.numbers(node, "jointBindingRotations", "MFRotation", 4)
    scales = reading.numbers(node, "jointBindingScales", "MFVec3f", 3)
    if len(scales) <= 1 and not scales.any():
        scales = scales[:0]  # the schema's default of 0 0 0 is a defect: it means 1 1 1
    given = False
    for k, n in enumerate(node.children("joints")):
        joint = figure.joints.get(id(n))
        if joint is None:
            continue
        t = positions[k] if k < len(positions) else np.zeros(3)
        r = rotations[k] if k < len(rotations) else np.array(_NO_TURN)
        s = scales[k] if k < len(scales) else np.ones(3)
        if t.any() or r[3] != 0 or (s != 1).any():
            given = True
            h.binding[joint.name] = (t.copy(), r.copy(), s.copy())
    if given:
        what = "binding matrices are applied on the right of the joint matrices, as browsers do it"
        reading.defect("binding", f"{reading.who(node)}: {what}", node)
