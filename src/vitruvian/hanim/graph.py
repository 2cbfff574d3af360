"""The scene graph as it stands in a file: every node, known or not, in source order.

Readers of all encodings (X3D XML, Classic X3D, X3D JSON, VRML97) build this; writers print it. Field values stay source
text (`Literal`) until somebody asks for them by type, so that what nobody touches is written back as it was read.
The typed H-Anim objects of `vitruvian.hanim.humanoid` are a view on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field


@dataclass(slots=True, frozen=True)
class Literal:
    """Source text of a field's value, not yet interpreted.

    `text` is the inside of the XML attribute after unescaping ("xml") or the tokens with their quotes, brackets kept,
    as they stood ("vrml": VRML97 and Classic X3D; "json").
    """

    text: str
    syntax: str  # "xml" | "vrml" | "json"
    line: int = 0


@dataclass(slots=True, eq=False)
class Node:
    """One node: `type`, DEF name, fields in source order.

    A field's value is a `Literal`, a typed value (bool, int, float, str, list of str, NumPy array), a `Node`, a `Use`,
    or a list of `Node | Use | Comment`. `container` is the containerField as written ("" when the default was meant).
    `connects` holds IS pairs (node field, prototype field) inside a prototype body.
    `interface` holds fields that the node declares itself (Script, shaders); their values are in the `ProtoField`s.
    `comments` are those outside of node lists: (name of the field before which it stands or "" at the end, comment).
    `instance` says that `type` names a prototype of the file (a ProtoInstance in XML).
    `order` is set only where an XML file mixes the children of several fields: the field of each child in turn.
    """

    type: str
    name: str = ""
    fields: dict[str, object] = field(default_factory=dict)
    line: int = 0
    container: str = ""
    connects: list[tuple[str, str]] = field(default_factory=list)
    text: str = ""  # character data: CDATA of a Script or shader
    interface: list[ProtoField] = field(default_factory=list)
    comments: list[tuple[str, Comment]] = field(default_factory=list)
    instance: bool = False
    order: list[str] = field(default_factory=list)

    def children(self, name: str) -> list[Node]:
        """The nodes in a node-valued field, USEs resolved, comments skipped; [] when absent or NULL."""
        value = self.fields.get(name)
        if value is None:
            return []
        if isinstance(value, Node | Use):
            value = [value]
        if not isinstance(value, list):
            return []
        nodes = (v.node if isinstance(v, Use) else v for v in value)
        return [n for n in nodes if isinstance(n, Node)]

    def entries(self) -> Iterator[tuple[str, Node | Use]]:
        """(field name, node or USE) pairs of all node-valued fields, in source order, a Script's own ones last."""
        pairs = list(self.fields.items())
        if self.interface:
            pairs += [(f.name, f.value) for f in self.interface]
        for name, value in pairs:
            if isinstance(value, Node | Use):
                yield name, value
            elif isinstance(value, list):
                for v in value:
                    if isinstance(v, Node | Use):
                        yield name, v


@dataclass(slots=True, eq=False)
class Use:
    """A USE: another place for a node. `node` is None when no earlier DEF of that name exists (dangling)."""

    name: str
    node: Node | None = None
    line: int = 0
    container: str = ""
    type: str = ""  # the element's name in XML, where a USE names its type


@dataclass(slots=True, frozen=True)
class Comment:
    text: str
    line: int = 0


@dataclass(slots=True, eq=False)
class Route:
    from_node: str
    from_field: str
    to_node: str
    to_field: str
    line: int = 0


@dataclass(slots=True, eq=False)
class ProtoField:
    """One line of an interface. `access`: inputOnly, outputOnly, initializeOnly, inputOutput.

    `value` is the default as in `Node.fields`, None when none is given. `extra` keeps other XML attributes (appinfo).
    """

    access: str
    type: str
    name: str
    value: object = None
    line: int = 0
    extra: dict[str, str] = field(default_factory=dict)
    comments: list[Comment] = field(default_factory=list)  # inside an XML field element


@dataclass(slots=True, eq=False)
class Proto:
    """PROTO (or, with `url`, EXTERNPROTO, whose body is never fetched). `body` has its own DEF scope.

    `comments` are those of the interface: (name of the field before which it stands or "" at the end, comment).
    """

    name: str
    interface: list[ProtoField] = field(default_factory=list)
    body: list[Statement] = field(default_factory=list)
    url: Literal | list[str] | None = None
    line: int = 0
    extra: dict[str, str] = field(default_factory=dict)
    comments: list[tuple[str, Comment]] = field(default_factory=list)

    @property
    def external(self) -> bool:
        return self.url is not None


@dataclass(slots=True, eq=False)
class Import:
    inline: str
    name: str
    alias: str = ""
    line: int = 0


@dataclass(slots=True, eq=False)
class Export:
    name: str
    alias: str = ""
    line: int = 0


Statement = Node | Use | Comment | Route | Proto | Import | Export


@dataclass(slots=True, eq=False)
class Scene:
    """A whole file: header facts and the statements in source order.

    `encoding` is "x3d" (XML), "x3dv" (Classic), "x3dj" (JSON) or "wrl" (VRML97); `version` that of the header ("4.0",
    "3.3", "2.0").
    """

    path: str = ""
    encoding: str = "x3d"
    version: str = "4.0"
    profile: str = ""
    components: list[tuple[str, int]] = field(default_factory=list)
    metas: list[tuple[str, str]] = field(default_factory=list)
    units: list[tuple[str, str, float]] = field(default_factory=list)  # category, name, conversion factor
    body: list[Statement] = field(default_factory=list)
    header_comments: list[Comment] = field(default_factory=list)

    def routes(self) -> list[Route]:
        """All ROUTEs of the scene (those inside prototype bodies belong to the prototype)."""
        return [s for s in self.body if isinstance(s, Route)]

    def protos(self) -> dict[str, Proto]:
        return {s.name: s for s in self.body if isinstance(s, Proto)}

    def walk(self) -> Iterator[Node]:
        """Every node once, depth first, in source order, without entering prototype bodies. No recursion."""
        return walk_all([s for s in self.body if isinstance(s, Node)])

    def defs(self) -> dict[str, Node]:
        """DEF name -> node; a name given twice answers the later one."""
        return {n.name: n for n in self.walk() if n.name}


def walk_all(nodes: list[Node]) -> Iterator[Node]:
    """Every node in and below `nodes` once, depth first; USEs are not entered."""
    stack = list(reversed(nodes))
    seen: set[int] = set()
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        yield node
        if node.interface:
            stack.extend(child for _, child in reversed(list(node.entries())) if isinstance(child, Node))
            continue
        for value in reversed(node.fields.values()):
            if value.__class__ is Literal:  # most of them
                continue
            if isinstance(value, Node):
                stack.append(value)
            elif isinstance(value, list):
                stack += [child for child in reversed(value) if isinstance(child, Node)]
