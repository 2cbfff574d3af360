"""The typed view on a scene graph: native H-Anim nodes (X3D 3.x, 4.0) and PROTO humanoids (1.1, 200x, robot dialect).

Defects that browsers live with are read with the browsers' meaning and reported once per kind as a warning; non-finite
numbers, indices outside their array and counts that do not fit are refused (`FileError`) unless `repair` is given.
Semantics: ISO/IEC 19774-1 and what X3D browsers do with it.
"""

from __future__ import annotations

import numpy as np

from vitruvian.hanim import animation, surface
from vitruvian.hanim.fields import container_of
from vitruvian.hanim.graph import Node, Scene, Use
from vitruvian.hanim.humanoid import Humanoid, Shape
from vitruvian.hanim.members import read_members
from vitruvian.hanim.reading import Reading
from vitruvian.hanim.view_parts import (
    BODY_FIELDS,
    Figure,
    displacer_of,
    joint_tree,
    pose_of,
    site_of,
    stray,
)
from vitruvian.hanim.view_parts import name_of as name_of
from vitruvian.hanim.view_parts import walk_groups as walk_groups


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


def body_nodes(reading: Reading, node: Node) -> tuple[list[Node], list[Node]]:
    """Joint nodes that root the skeleton, each once, and Site nodes beside them.

    Of `skeleton` and `humanoidBody` the filled one counts. Joints that landed in `children` for want of a
    containerField count as skeleton when they are not USEs.
    """
    roots: list[Node] = []
    known: set[int] = set()
    sites: list[Node] = []
    entries: list[tuple[Node, bool]] = []
    for field in BODY_FIELDS:
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


def _humanoid(reading: Reading, node: Node) -> Humanoid:
    figure = Figure(reading, node)
    _check_containers(reading, node)
    default = {"2.0": "200x"}.get(reading.scene.version, "2.0" if reading.scene.version >= "4" else "1.0")
    h = Humanoid(
        name=reading.text(node, "name").strip() or _plain_name(node),
        version=reading.text(node, "version", default).strip() or default,
        loa=int(reading.number(node, "loa", -1)),
        info_given=tuple(reading.texts(node, "info")),
        scene=reading.scene,
        node=node,
    )
    h.info = info_of(h.info_given)
    read_members(reading, node, h, "Humanoid")
    h.skeletal_configuration = h.skeletal_configuration.strip() or "BASIC"
    _read_skin(figure, h)
    roots, sites = body_nodes(reading, node)
    h.skeleton = [j for n in roots if (j := joint_tree(figure, n)) is not None]
    h.sites = [site_of(figure, n) for n in sites]
    h.viewpoints = [site_of(figure, n) for n in node.children("viewpoints") if reading.kind(n) == "Site"]
    _check_lists(figure)
    _binding(figure, h)
    h.motions = animation.motions(reading, node, figure.prefixes)
    h.skin_displacers = [displacer_of(figure, n, len(figure.points), "the skin") for n in node.children("displacers")]
    posed = [n for f in ("poses", "children") for n in node.children(f) if reading.kind(n) == "Pose"]
    h.poses = [pose_of(figure, n, k) for k, n in enumerate(posed)]
    drawn = {id(s.node) for s in h.skin} | {id(figure.skin_coord)}
    other = [n for n in node.children("children") if not reading.kind(n) and id(n) not in drawn]
    h.children = [n for n in other if n.type not in {"Shape", "Group", "Transform"} or node.children("skin")]
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


def info_of(entries: tuple[str, ...] | list[str]) -> dict[str, str]:
    """`key=value` strings as a dictionary; an entry without `=` is a key with an empty value."""
    info: dict[str, str] = {}
    for entry in entries:
        key, _, value = entry.partition("=")
        if entry.strip():
            info[key.strip()] = value.strip()
    return info


def _read_skin(figure: Figure, h: Humanoid) -> None:
    reading, node = figure.reading, figure.node
    parts = node.children("skin")
    if not parts:
        parts = stray(reading, node, {"Shape", "Group", "Transform"})
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
    for name, attribute, field in (
        ("skinBindingCoords", "skin_binding_coords", "point"),
        ("skinBindingNormals", "skin_binding_normals", "vector"),
    ):
        found = node.children(name)
        if found:
            array = np.array(reading.softly(found[0], field, "MFVec3f", np.zeros((0, 3))), dtype=np.float64)
            setattr(h, attribute, array.reshape(-1, 3))


def _coord(shape: Shape) -> Node | None:
    geometry = shape.node.children("geometry") if shape.node is not None else []
    return surface.coordinate(geometry[0]) if geometry else None


def _check_lists(figure: Figure) -> None:
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


def _binding(figure: Figure, h: Humanoid) -> None:
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
        r = rotations[k] if k < len(rotations) else np.array([0.0, 0.0, 1.0, 0.0])
        s = scales[k] if k < len(scales) else np.ones(3)
        if t.any() or r[3] != 0 or (s != 1).any():
            given = True
            h.binding[joint.name] = (t.copy(), r.copy(), s.copy())
    if given:
        what = "binding matrices are applied on the right of the joint matrices, as browsers do it"
        reading.defect("binding", f"{reading.who(node)}: {what}", node)
