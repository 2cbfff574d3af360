"""Nodes that the typed objects keep as they are (lights, sensors, metadata), copied into a new scene."""

from __future__ import annotations

from dataclasses import replace

from vitruvian.hanim.build_shape import Names
from vitruvian.hanim.fields import native
from vitruvian.hanim.graph import Comment, Node, Use

_MOST = 10_000  # nodes of one copy


def copies(nodes: list[Node], names: Names, taken: set[int]) -> list[Node]:
    """Copies of those nodes that can stand in another X3D scene, with DEFs that are free there.

    USEs inside become the node itself once, then USEs of it. What needs its own scene (prototype instances, Scripts,
    dangling USEs, nodes that X3D does not have) is left out whole. `taken` collects the ids of what was copied.
    """
    out = []
    for node in nodes:
        made = _copy(node, names, taken)
        if made is not None:
            out.append(made)
    return out


def _whole(top: Node) -> list[Node] | None:
    """All nodes below, each once, or None when one of them can't leave its scene."""
    found: dict[int, Node] = {}
    stack = [top]
    while stack:
        node = stack.pop()
        if id(node) in found:
            continue
        if node.instance or node.interface or node.connects or not native(node.type) or node.type.startswith("HAnim"):
            return None
        found[id(node)] = node
        if len(found) > _MOST:
            return None
        for _, entry in node.entries():
            below = entry.node if isinstance(entry, Use) else entry
            if below is None:
                return None
            stack.append(below)
    return list(found.values())


def _copy(top: Node, names: Names, taken: set[int]) -> Node | None:
    nodes = _whole(top)
    if nodes is None:
        return None
    twice: dict[int, int] = {}
    for node in nodes:
        for _, entry in node.entries():
            below = entry.node if isinstance(entry, Use) else entry
            twice[id(below)] = twice.get(id(below), 0) + 1
    made = {}
    for node in nodes:
        wanted = node.name or (node.type if twice.get(id(node), 0) > 1 else "")
        made[id(node)] = replace(node, name=names.free(wanted) if wanted else "", line=0, fields={}, comments=[])
    placed = {id(top)}
    stack = [top]
    while stack:
        node = stack.pop()
        fields = made[id(node)].fields
        for field, value in node.fields.items():
            many = value if isinstance(value, list) else [value]
            if not any(isinstance(v, Node | Use) for v in many):
                fields[field] = value
                continue
            entries: list[Node | Use] = []
            for v in many:
                inner = v.node if isinstance(v, Use) else v
                if isinstance(v, Comment) or not isinstance(inner, Node):
                    continue
                there = made[id(inner)]
                if id(inner) in placed:
                    entries.append(Use(there.name, there, container=there.container, type=there.type))
                else:
                    placed.add(id(inner))
                    entries.append(there)
                    stack.append(inner)
            fields[field] = entries if isinstance(value, list) else entries[0]
    taken |= set(made)
    return made[id(top)]
