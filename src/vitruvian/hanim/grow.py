"""Objects added to a loaded humanoid, or taken from it, put into or taken out of its own scene graph.

So that a new Site or Displacer doesn't cost what the file holds beside us. Joints, Segments, Sites and Displacers of
native X3D; everything else makes `grown` answer False, and the caller builds a new scene.
"""

from __future__ import annotations

from dataclasses import dataclass

from vitruvian.hanim.build import Builder
from vitruvian.hanim.build_pieces import Lists
from vitruvian.hanim.graph import Comment, Node, Route, Scene, Use
from vitruvian.hanim.humanoid import Displacer, Humanoid, Joint, Segment, Site

Part = Joint | Segment | Site | Displacer
# Typed list -> field of the node, per kind of owner.
_LISTS: dict[type, dict[str, str]] = {
    Humanoid: {"skeleton": "skeleton", "sites": "skeleton", "skin_displacers": "displacers"},
    Joint: {"joints": "children", "segments": "children", "sites": "children", "displacers": "displacers"},
    Segment: {"sites": "children", "displacers": "displacers"},
}


@dataclass(slots=True)
class _Change:
    owner: Humanoid | Joint | Segment
    field: str
    gone: list[Node]
    came: list[Part]


def grown(scene: Scene, old: Humanoid, new: Humanoid) -> bool:
    """Bring the graph of `new` to its objects; False when it can't be done here (the graph is as it was then)."""
    changes = _changes(old, new)
    if changes is None:
        return False
    points = _new_coords(old, new)
    if not changes and not points:
        return True
    root = new.node
    if root is None or not root.type.startswith("HAnim"):
        return False
    version = "2.0" if scene.version >= "4" else "1.0"
    builder = Builder(version, scene.encoding, draft=scene.version > "4.0" and version == "2.0")
    builder.names.taken |= set(scene.defs())
    for segment, coord in points:
        coord.name = coord.name or builder.names.free(f"{_prefix(new)}{segment.name}_coords")
        assert segment.node is not None
        segment.node.fields["coord"] = Use(coord.name, coord, type=coord.type)
        segment.node.order = []
    lists = Lists()
    stay = {id(n) for n in _nodes(new)}
    removed = {id(n) for n in _nodes(old)} - stay
    for change in changes:
        _take_out(change.owner.node, {id(n) for n in change.gone})
    for change in changes:
        _put_in(builder, new, change, lists)
    _update_lists(root, builder, lists, removed)
    names = {n.name for n in _nodes(old) if id(n) in removed and n.name}
    scene.body = [s for s in scene.body if not (isinstance(s, Route) and (s.to_node in names or s.from_node in names))]
    return True


def _parts(h: Humanoid) -> list[Humanoid | Joint | Segment]:
    return [h, *h.joints(), *h.segments()]


def _nodes(h: Humanoid) -> list[Node]:
    things: list[Part] = [*h.joints(), *h.segments(), *h.all_sites(), *h.displacers()]
    return [t.node for t in things if t.node is not None]


def _changes(old: Humanoid, new: Humanoid) -> list[_Change] | None:
    """What lists differ; None when an object has no node of its own here."""
    before = {id(p.node): p for p in _parts(old)}
    known = {id(n) for n in _nodes(old)}
    if any(p.node is None for p in _parts(old)):
        return None
    out = []
    for part in _parts(new):
        was = before.get(id(part.node)) if part.node is not None else None
        if was is None:
            continue  # new itself: built with all it holds
        for attribute, field in _LISTS[type(part)].items():
            had: list[Part] = getattr(was, attribute)
            has: list[Part] = getattr(part, attribute)
            here, there = {id(t.node) for t in has if t.node is not None}, {id(t.node) for t in had}
            if any(t.node is not None and id(t.node) not in known for t in has):
                return None  # from another file
            gone = [t.node for t in had if t.node is not None and id(t.node) not in here]
            came = [t for t in has if t.node is None or id(t.node) not in there]
            if gone or came:
                out.append(_Change(part, field, gone, came))
    return out


def _new_coords(old: Humanoid, new: Humanoid) -> list[tuple[Segment, Node]]:
    """Segments that got a `coord`, with the Coordinate of the shape that it is."""
    before = {id(s.node): s for s in old.segments()}
    out = []
    for segment in new.segments():
        was = before.get(id(segment.node))
        if was is None or was.coord is not None or segment.coord is None:
            continue
        for shape in segment.shapes:
            geometry = shape.node.children("geometry") if shape.node is not None else []
            found = geometry[0].children("coord") if geometry else []
            if found and shape.points is segment.coord:
                out.append((segment, found[0]))
                break
    return out


def _prefix(h: Humanoid) -> str:
    """What stands before the names in this humanoid's DEFs."""
    for joint in h.joints():
        if joint.node is not None and joint.node.name.endswith(joint.name):
            return joint.node.name[: -len(joint.name)]
    return "hanim_"


def _entries(value: object) -> list:
    if isinstance(value, list):
        return value
    return [value] if isinstance(value, Node | Use) else []


def _target(entry: object) -> object:
    return entry.node if isinstance(entry, Use) else entry


def _take_out(owner: Node | None, gone: set[int]) -> None:
    """Remove nodes from below `owner`, also from plain groups there."""
    stack = [owner] if owner is not None and gone else []
    seen: set[int] = set()
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        for field in [f for f, v in node.fields.items() if any(id(_target(e)) in gone for e in _entries(v))]:
            node.fields[field] = [e for e in _entries(node.fields[field]) if id(_target(e)) not in gone]
            node.order = []
        stack.extend(c for _, c in node.entries() if isinstance(c, Node) and not c.type.startswith("HAnim"))


def _put_in(builder: Builder, h: Humanoid, change: _Change, lists: Lists) -> None:
    owner = change.owner.node
    assert owner is not None
    prefix = _prefix(h)
    made = []
    for part in change.came:
        if part.node is None:
            segment = change.owner if isinstance(change.owner, Segment) else None
            _adopt(part, builder.part(part, prefix, lists, h, segment))
        node = part.node
        assert node is not None
        if change.field != "children":
            node.container = change.field
        made.append(node)
    if made:
        owner.fields[change.field] = [*_entries(owner.fields.get(change.field)), *made]
        owner.order = []


def _adopt(part: Part, node: Node) -> None:
    """Give a new object, and what hangs in it, the nodes that were built for it."""
    stack: list[tuple[Part, Node]] = [(part, node)]
    while stack:
        thing, own = stack.pop()
        thing.node = own
        below = [n for _, e in own.entries() if isinstance(n := _target(e), Node)]
        for attribute in _LISTS.get(type(thing), {}):
            kind = {"joints": "Joint", "segments": "Segment", "sites": "Site", "displacers": "Displacer"}[attribute]
            nodes = [n for n in below if n.type == f"HAnim{kind}"]
            stack += list(zip(getattr(thing, attribute), nodes))


def _update_lists(root: Node, builder: Builder, lists: Lists, removed: set[int]) -> None:
    """joints, segments, sites: without what is gone, with what came."""
    for field, nodes in (("joints", lists.joints), ("segments", lists.segments), ("sites", lists.sites)):
        entries = _entries(root.fields.get(field))
        kept = [e for e in entries if isinstance(e, Comment) or id(_target(e)) not in removed]
        added = [Use(n.name, n, container=field, type=n.type) for n in nodes]
        if added or len(kept) < len(entries):
            root.fields[field] = kept + added
            root.order = []
    viewpoints = _entries(root.fields.get("viewpoints"))
    if any(id(_target(e)) in removed for e in viewpoints):
        root.fields["viewpoints"] = [e for e in viewpoints if id(_target(e)) not in removed]
