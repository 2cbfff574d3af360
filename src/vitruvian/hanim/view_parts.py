"""The view on what hangs in a humanoid: joints, segments, sites, displacers, poses.

Semantics: ISO/IEC 19774-1 and what X3D browsers do with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np

from vitruvian.hanim import surface, tables
from vitruvian.hanim.defbody import contour_surface, is_defbody
from vitruvian.hanim.graph import Node, walk_all
from vitruvian.hanim.humanoid import Displacer, Joint, Pose, Segment, Site, Viewpoint
from vitruvian.hanim.members import read_members
from vitruvian.hanim.reading import Reading

BODY_FIELDS = ("skeleton", "humanoidBody")


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


class Figure:
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
        coords = node.children("skinCoord") or stray(reading, node, {"Coordinate", "CoordinateDouble"})
        self.skin_coord = coords[0] if coords else None
        self.points = np.zeros((0, 3))

    @cached_property
    def given(self) -> set[str]:
        """The names that joints are given: they beat those taken from a DEF."""
        below = [n for f in (*BODY_FIELDS, "children") for n in self.node.children(f) if self.reading.kind(n) != "Pose"]
        named = (n for n in walk_all(below) if self.reading.kind(n) == "Joint")
        return {self.reading.text(n, "name").strip() for n in named}

    def name(self, node: Node, fallback: str) -> str:
        given = self.reading.text(node, "name").strip()
        name = given or name_of(self.reading, node, self.prefixes) or fallback
        if not given:
            kind = self.reading.kind(node).lower()
            self.reading.defect(f"N01 {kind}", f"{kind} without a name is called {name}", node)
        return name


def stray(reading: Reading, node: Node, types: set[str]) -> list[Node]:
    """Nodes of these types that landed in `children` of a Humanoid, reported."""
    found = [n for n in node.children("children") if n.type in types]
    if found:
        reading.defect(
            "F06", f"{reading.who(node)}: {found[0].type} without its containerField is read by its type", node
        )
    return found


def joint_tree(figure: Figure, root: Node) -> Joint | None:
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
        joint = _onejoint_tree(figure, node)
        if parent is None:
            top = joint
        else:
            parent.joints.append(joint)
        below = _fill(figure, node, joint)
        stack.extend((n, joint) for n in reversed(below))
    return top


def _onejoint_tree(figure: Figure, node: Node) -> Joint:
    reading = figure.reading
    name = figure.name(node, f"joint_{len(figure.joints) + 1}")
    if name in figure.names or (not reading.text(node, "name").strip() and name in figure.given):
        number = figure.numbers.get(name, 1) + 1
        while f"{name}_{number}" in figure.names or f"{name}_{number}" in figure.given:
            number += 1
        figure.numbers[name] = number
        reading.defect("N04", f"joint {name}: the name is given twice, one is called {name}_{number}", node)
        name = f"{name}_{number}"
    figure.names.add(name)
    joint = Joint(name=name, node=node)
    figure.joints[id(node)] = joint
    read_members(reading, node, joint, "Joint")
    joint.llimit = reading.numbers(node, "llimit")[:3] * reading.angle
    joint.ulimit = reading.numbers(node, "ulimit")[:3] * reading.angle
    stiffness = reading.numbers(node, "stiffness")
    if len(stiffness):
        joint.stiffness = np.resize(stiffness[:3], 3) if len(stiffness) < 3 else stiffness[:3].copy()
    _weights(figure, node, joint)
    return joint


def _weights(figure: Figure, node: Node, joint: Joint) -> None:
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


def _fill(figure: Figure, node: Node, joint: Joint) -> list[Node]:
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
                joint.sites.append(site_of(figure, n))
            elif kind == "Displacer":
                reading.defect("F06 displacer", f"{reading.who(n)} is read as displacer of joint {joint.name}", n)
                joint.displacers.append(displacer_of(figure, n, len(figure.points), joint.name))
    for n in node.children("displacers"):
        joint.displacers.append(displacer_of(figure, n, len(figure.points), joint.name))
    drawn = surface.shapes(reading, loose)
    if drawn:
        reading.defect("M21", f"joint {joint.name}: geometry outside a Segment is read as its segment's", loose[0])
        if not joint.segments:
            known = tables.canonical(joint.name)
            joint.segments.append(Segment(name=tables.joints()[known].segment if known else f"{joint.name}_segment"))
        joint.segments[0].shapes += drawn
    return below


def _segment(figure: Figure, node: Node, joint: Joint) -> tuple[Segment, list[Node]]:
    reading = figure.reading
    name = figure.name(node, f"{joint.name}_segment")
    segment = Segment(name=name, node=node)
    read_members(reading, node, segment, "Segment")
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
            segment.sites.append(site_of(figure, n))
        elif kind == "Joint":
            reading.defect("T02", f"{reading.who(n)} hangs in segment {name}: read as child of {joint.name}", n)
            joints.append(n)
        elif kind == "Segment" and n is not node:
            reading.defect("T02", f"{reading.who(n)} hangs in segment {name}: its geometry is read with it", n)
            segment.shapes += surface.shapes(reading, n.children("children"))
    for n in walk_groups(reading, children):
        if is_defbody(reading, n) and (contours := contour_surface(reading, n, joint)) is not None:
            segment.contours.append(contours)
    segment.children = _others(reading, [n for n in children if not is_defbody(reading, n)])
    displacers = node.children("displacers")
    coord = [n for n in node.children("coord") if n.type in {"Coordinate", "CoordinateDouble"}]
    if coord and (displacers or reading.was_read(coord[0], "point")):
        segment.coord = reading.numbers(coord[0], "point", "MFVec3f", 3)
    elif coord:  # nothing draws it, nothing moves it
        points = np.array(reading.softly(coord[0], "point", "MFVec3f", np.zeros((0, 3))), dtype=np.float64)
        segment.coord = points.reshape(-1, 3)
    if displacers:
        limit = max((len(s.points) for s in segment.shapes if s.points is not None), default=0)
        if segment.coord is not None:
            limit = len(segment.coord)
        segment.displacers = [displacer_of(figure, n, limit, name) for n in displacers]
    return segment, joints


def site_of(figure: Figure, node: Node) -> Site:
    """A site; one that is USEd again (a viewpoint in the tree) stays the same object."""
    if id(node) in figure.sites:
        return figure.sites[id(node)]
    site = Site(name=figure.name(node, "site"), node=node)
    reading, children = figure.reading, node.children("children")
    read_members(reading, node, site, "Site")
    site.shapes = surface.shapes(reading, children)
    site.viewpoints = [_viewpoint(reading, n) for n in children if n.type == "Viewpoint"]
    site.children = [n for n in _others(reading, children) if n.type != "Viewpoint"]
    figure.sites[id(node)] = site
    return site


def displacer_of(figure: Figure, node: Node, limit: int, owner: str) -> Displacer:
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
    displacer = Displacer(name, index, moves, node=node)
    read_members(reading, node, displacer, "Displacer")
    return displacer


def _others(reading: Reading, nodes: list[Node]) -> list[Node]:
    """The nodes that are neither H-Anim objects nor surfaces nor groups of them."""
    return [n for n in nodes if not reading.kind(n) and not surface.drawable(n)]


def _viewpoint(reading: Reading, node: Node) -> Viewpoint:
    soft = reading.softly
    view = Viewpoint(str(soft(node, "description", "SFString", "")), node=node)
    view.position = np.array(soft(node, "position", "SFVec3f", view.position), dtype=np.float64)
    view.orientation = np.array(soft(node, "orientation", "SFRotation", view.orientation), dtype=np.float64)
    view.field_of_view = float(soft(node, "fieldOfView", "SFFloat", view.field_of_view)) * reading.angle  # type: ignore[arg-type]
    return view


def pose_of(figure: Figure, node: Node, number: int) -> Pose:
    """An HAnimPose (4.1 draft): its joints are placed only, they are not those of the skeleton."""
    reading = figure.reading
    pose = Pose(name_of(reading, node, figure.prefixes) or f"pose_{number + 1}", node=node)
    read_members(reading, node, pose, "Pose")
    for child in node.children("children"):
        if reading.kind(child) == "Joint":
            joint = Joint(name_of(reading, child, figure.prefixes), node=child)
            read_members(reading, child, joint, "Joint", soft=True)
            pose.joints.append(joint)
    return pose
