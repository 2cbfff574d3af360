"""The doctor's rules about the file: header, nodes and fields, DEFs and USEs, containerFields, profile, urls."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from vitruvian.hanim.doctor import Chart
from vitruvian.hanim.doctor_words import several, some
from vitruvian.hanim.fields import container_of, fields_of, known, node_types, placement
from vitruvian.hanim.graph import Literal, Node, Proto, Use

VERSIONS = ("3.0", "3.1", "3.2", "3.3", "4.0", "4.1")
_NMTOKEN = re.compile(r"[\w.\-:\u00b7]+")
# Words that every XML element may have, and those that VRML97 has in place of X3D's.
_EVERYWHERE = {"class", "id", "style", "DEF", "USE", "containerField", "name"}
_OLD = {"Switch": {"choice"}, "LOD": {"level"}, "Collision": {"collide", "proxy"}}
# What the two poorest profiles lack; all others have it.
_POOR = {"Core", "CADInterchange"}
_LINKS = {"Anchor"}  # their urls lead elsewhere and are no part of the scene


def examine(chart: Chart) -> None:
    """F01 and F03 to F08."""
    if chart.scene.encoding != "wrl" and chart.scene.version not in VERSIONS:
        message = f"the header gives version {chart.scene.version!r}, expected one of {', '.join(VERSIONS)}"
        chart.add("F01", None, message, f"version='{header_version(chart)}'", 1)
    _unknown(chart)
    _defs(chart)
    _dangling(chart)
    for node in chart.nodes:
        _entries(chart, node)
    _cycles(chart)
    _profile(chart)
    _urls(chart)


def header_version(chart: Chart) -> str:
    """The version that an X3D header should have: what can express the nodes that are there."""
    for node in chart.nodes:
        if node.type == "HAnimMotion" or (node.type == "HAnimHumanoid" and "loa" in node.fields):
            return "4.0"
    return "3.3"


def _unknown(chart: Chart) -> None:
    """F03: node types and fields that nobody knows, each kind once."""
    protos, vrml = chart.reading.protos, chart.scene.encoding == "wrl"
    found: dict[tuple[str, str], list[tuple[Node, int]]] = {}
    for node in chart.nodes:
        proto = protos.get(node.type) if node.instance or node.type in protos else None
        if proto is None and not known(node.type):
            if not node.instance:
                found.setdefault((node.type, ""), []).append((node, node.line))
            continue
        table = {f.name for f in proto.interface} if proto is not None else fields_of(node.type)
        for field, value in node.fields.items():
            if field in table or (proto is None and (field in _EVERYWHERE or ":" in field or field == "xmlns")):
                continue
            if (vrml and field in _OLD.get(node.type, ())) or any(f.name == field for f in node.interface):
                continue
            if chart.scene.encoding == "x3d" and not isinstance(value, Literal):
                continue  # a child in the wrong place is F06
            line = value.line if isinstance(value, Literal) else 0
            found.setdefault((node.type, field), []).append((node, line or node.line))
    for (kind, field), cases in found.items():
        node, line = cases[0]
        more = f" ({len(cases)} times)" if len(cases) > 1 else ""
        if not field:
            near = chart.closest(kind, [*protos, *node_types()])
            chart.add(
                "F03", node, f"nobody knows a node {kind}{more}", f"perhaps {near} is meant" if near else "", line
            )
            continue
        words = [f.name for f in protos[kind].interface] if kind in protos else list(fields_of(kind))
        near = chart.closest(field, words)
        what = "the PROTO" if kind in protos else "browsers"
        message = f"{kind} has no field {field}{more}: {what} ignore{'s' if kind in protos else ''} it"
        chart.add("F03", node, message, f"perhaps {near} is meant" if near else "", line)


def legal(name: str) -> bool:
    """Whether XML allows the name as a DEF (NMTOKEN)."""
    return _NMTOKEN.fullmatch(name) is not None


def _defs(chart: Chart) -> None:
    """F04: DEFs given twice (VRML97 allows it) or with signs that a DEF must not have."""
    scene = chart.scene
    seen: dict[str, Node] = {}
    for node in chart.nodes:
        if not node.name:
            continue
        if node.name in seen and scene.encoding != "wrl":
            message = f"DEF {node.name} is given twice (first in line {seen[node.name].line})"
            chart.add("F04", node, message, "rename the later one")
        seen.setdefault(node.name, node)
        if scene.encoding == "x3d" and not legal(node.name):
            what = "a blank" if re.search(r"\s", node.name) else "a sign that XML does not allow in it"
            chart.add("F04", node, f"DEF {node.name!r} holds {what}", "take it out, in its USEs and ROUTEs too")


def _dangling(chart: Chart) -> None:
    """F05: USEs of nothing, each name once."""
    found: dict[str, list[tuple[Node | None, str, Use]]] = {}
    for statement in chart.scene.body:
        if isinstance(statement, Use) and statement.node is None:
            found.setdefault(statement.name, []).append((None, "scene", statement))
    for node in chart.nodes:
        for field, entry in node.entries():
            if isinstance(entry, Use) and entry.node is None:
                found.setdefault(entry.name, []).append((node, field, entry))
    for name, cases in found.items():
        holder, field, entry = cases[0]
        more = f" ({len(cases)} times)" if len(cases) > 1 else ""
        message = f"{field}: USE {name} has no DEF before it{more}: browsers drop the node"
        fix = f"move the DEF {name} before it" if name in chart.defs() else f"add DEF {name} or drop the USE"
        chart.add("F05", holder, message, fix, entry.line)


def _entries(chart: Chart, node: Node) -> None:
    """F06: children in a field where they have no effect."""
    kind = chart.reading.kind(node)
    for field, entry in node.entries():
        if not kind:
            continue
        right = right_field(chart, node, field, entry)
        target = entry.node if isinstance(entry, Use) else entry
        if target is None:
            continue
        if right != field:
            message = f"{target.type} {entry.name} stands in {field} of {node.type}, where it has no effect"
            chart.add("F06", node, message, f"containerField='{right}'", entry.line)
        elif unsaid(chart, field, entry):
            message = f"{target.type} {entry.name} stands without containerField: browsers put it elsewhere"
            chart.add("F06", node, message, f"containerField='{field}'", entry.line)


def right_field(chart: Chart, node: Node, field: str, entry: Node | Use) -> str:
    """The field of an H-Anim node that a child belongs to: `field` itself unless it has no effect there."""
    target = entry.node if isinstance(entry, Use) else entry
    if target is None or target.type.startswith("Metadata") or not node.type.startswith("HAnim"):
        return field
    kind, child = chart.reading.kind(node), chart.reading.kind(target)
    if kind == "Humanoid" and (child or target.type in {"Coordinate", "CoordinateDouble", "Normal"}):
        allowed = {
            "Joint": {"skeleton", "joints"},
            "Segment": {"segments"},
            "Site": {"skeleton", "sites", "viewpoints"},
            "Motion": {"motions"},
            "Displacer": {"displacers"},
        }.get(child, {"skinNormal", "skinBindingNormals"} if target.type == "Normal" else _COORDS)
        if child == "Humanoid" or field in allowed:
            return field
        if child == "Displacer":
            return "displacers"
        return "motions" if child == "Motion" else placement(node.type, target.type, isinstance(entry, Use))
    if kind == "Humanoid" and target.type == "Shape" and field not in {"skin", "children"}:
        return "skin"
    if kind in {"Joint", "Segment", "Site"} and child:
        if child == "Displacer":
            return "displacers" if kind != "Site" else field
        return "children" if field not in {"children", "metadata"} else field
    if kind == "Segment" and target.type in {"Coordinate", "CoordinateDouble"}:
        return "coord"
    return field


_COORDS = {"skinCoord", "skinBindingCoords"}


def unsaid(chart: Chart, field: str, entry: Node | Use) -> bool:
    """Whether a child in XML lacks the containerField that its place needs."""
    target = entry.node if isinstance(entry, Use) else entry
    if target is None or chart.scene.encoding != "x3d" or entry.container or not entry.line:
        return False
    return container_of(target.type) != field and not target.instance and not target.type.startswith("Metadata")


def _cycles(chart: Chart) -> None:
    """F05: a node that holds itself through a USE."""
    state: dict[int, int] = {}  # 1 on the way down, 2 done
    for root in [s for s in chart.scene.body if isinstance(s, Node)]:
        if id(root) in state:
            continue
        state[id(root)] = 1
        stack: list[tuple[Node, Iterator[tuple[str, Node | Use]]]] = [(root, root.entries())]
        while stack:
            node, below = stack[-1]
            for field, entry in below:
                child = entry.node if isinstance(entry, Use) else entry
                if child is None or state.get(id(child)) == 2:
                    continue
                if state.get(id(child)) == 1:
                    message = f"{field}: USE {entry.name} holds itself: an endless loop"
                    chart.add("F05", node, message, "cut the USE", entry.line)
                    continue
                state[id(child)] = 1
                stack.append((child, child.entries()))
                break
            else:
                state[id(node)] = 2
                stack.pop()


def uncovered(chart: Chart) -> list[tuple[str, Node]]:
    """Components that the nodes need but profile and components do not give, each with the first node in need."""
    scene = chart.scene
    given = {name.replace("H-Anim", "HAnim") for name, _ in scene.components}
    needs: dict[str, Node] = {}
    for node in chart.nodes:
        if node.type.startswith("HAnim") and scene.profile != "Full":
            needs.setdefault("HAnim", node)
        elif scene.profile in _POOR and node.type.endswith("Interpolator"):
            needs.setdefault("Interpolation", node)
        elif scene.profile in _POOR and node.type == "TimeSensor":
            needs.setdefault("Time", node)
    return [(name, node) for name, node in needs.items() if name not in given]


def _profile(chart: Chart) -> None:
    """F07: what the header promises must cover the nodes."""
    scene = chart.scene
    if scene.encoding == "wrl" or not chart.nodes:
        return
    lacking = uncovered(chart)
    if not scene.profile:
        chart.add("F07", None, "the header gives no profile: strict browsers refuse it", "profile='Immersive'", 1)
    for name, node in lacking:
        message = f"profile {scene.profile or '(none)'} without component {name} does not cover {node.type}"
        chart.add("F07", node, message + ": strict browsers refuse it", f"add component {name}")


def _urls(chart: Chart) -> None:
    """F08: what the scene needs from elsewhere. Only the scene's own folder is looked into, nothing is fetched."""
    if chart.path is None:
        return
    folder = Path(str(chart.path)).parent
    lacking: list[tuple[str, Node | Proto]] = []
    for node in chart.nodes:
        for field in [f for f in node.fields if (f == "url" or f.endswith("Url")) and node.type not in _LINKS]:
            urls = chart.words(node, field)
            if urls and not any(_at_hand(folder, url) for url in urls):
                lacking.append((urls[0], node))
    first = lacking[0][1] if lacking else None
    lacking += [(p.name, p) for p in chart.scene.protos().values() if p.external]
    if lacking:
        names = list(dict.fromkeys(" ".join(name.split())[:80] for name, _ in lacking))
        holder = first if isinstance(first, Node) else None
        what = several(len(names), "file is", "files are")
        message = f"{what} not beside the scene ({some(names)}): those parts may be missing"
        chart.add("F08", holder, message, "put them beside the scene", lacking[0][1].line)


def _at_hand(folder: Path, url: str) -> bool:
    """Whether a url needs no fetching: inside the scene, a program text, or a file in the scene's folder or below."""
    url = url.strip()
    if not url or url.startswith("#") or re.match(r"(?:data|javascript|ecmascript|vrmlscript):", url, re.IGNORECASE):
        return True
    path = url.partition("#")[0]
    if "://" in path or path.startswith(("/", "\\", "~", "urn:")) or ".." in Path(path).parts or "\0" in path:
        return False
    try:
        return (folder / path).is_file()
    except OSError:  # a name that no file can have
        return False
