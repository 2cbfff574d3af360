"""What the scene readers share: DEF scopes, prototypes in sight, and the counting that stops hostile files."""

from __future__ import annotations

from collections.abc import Mapping

from vitruvian.errors import FileError, warn
from vitruvian.formats.source import Limits
from vitruvian.hanim.fields import fields_of
from vitruvian.hanim.graph import Node, Proto, Use


class Scopes:
    """DEF names and prototypes in sight while a file is read; one scope for the scene and one per prototype body."""

    def __init__(self, path: object, limits: Limits):
        self.path, self.limits = path, limits
        self.names: list[dict[str, Node]] = [{}]
        self.protos: list[dict[str, Proto]] = [{}]
        self.bodies: list[tuple[str, int]] = []  # prototypes whose bodies are open
        self.open: set[int] = set()  # named nodes that are being read: a USE of one inside itself dangles
        self.sizes: dict[int, int] = {}  # named node -> nodes below it with USEs expanded
        self.nodes = self.entries = 0
        self.calls: dict[str, dict[str, int]] = {}  # prototype of the scene -> what its body instantiates -> line
        self.dangling, self.first = 0, (0, "")  # USEs without a DEF before them, the first one
        self.early = False  # something was instantiated before its declaration

    def count(self, line: int, nodes: int = 0, entries: int = 1) -> None:
        """Count what was read; FileError beyond the limits."""
        self.nodes += nodes
        self.entries += entries
        if self.nodes > self.limits.nodes:
            raise FileError(self.path, line, f"more than {self.limits.nodes} nodes")
        if self.entries > self.limits.entries:
            raise FileError(self.path, line, f"more than {self.limits.entries} nodes, fields and comments")

    def begin(self, node: Node) -> None:
        """A node opens; its name can be used after it."""
        if node.name:
            self.names[-1][node.name] = node
            self.open.add(id(node))

    def end(self, node: Node, size: int) -> None:
        """A node closes; `size` counts it and all below it, USEs expanded."""
        if size > self.limits.expansion:
            raise FileError(self.path, node.line, f"USEs expand to more than {self.limits.expansion} nodes")
        if node.name:
            self.open.discard(id(node))
            self.sizes[id(node)] = size

    def use(self, name: str, line: int) -> tuple[Node | None, int]:
        """(the node that a USE means, its size): the latest earlier DEF in scope, None when it is missing or open."""
        node = self.names[-1].get(name)
        if node is None or id(node) in self.open:
            self.dangling += 1
            if self.dangling == 1:
                self.first = (line, name)
            return None, 1
        return node, self.sizes.get(id(node), 1)

    def enter(self, name: str, line: int) -> None:
        """A prototype's body begins."""
        if len(self.bodies) >= self.limits.protos:
            raise FileError(self.path, line, f"more than {self.limits.protos} prototypes inside each other")
        self.bodies.append((name, line))
        self.names.append({})
        self.protos.append({})

    def leave(self) -> None:
        self.bodies.pop()
        self.names.pop()
        self.protos.pop()

    def declare(self, proto: Proto) -> None:
        self.protos[-1][proto.name] = proto

    def proto(self, name: str) -> Proto | None:
        """The prototype of that name that is in sight."""
        for scope in reversed(self.protos):
            if name in scope:
                return scope[name]
        return None

    def instance(self, name: str, line: int, *, builtin: bool = False) -> Proto | None:
        """The prototype that an instance means, None when it isn't declared (yet). FileError inside its own body.

        `builtin`: the name is also that of a node of the standard, which it means where no prototype is in sight.
        """
        found = self.proto(name)
        if found is None and builtin:
            return None
        if found is None and any(name == body for body, _ in self.bodies):
            raise FileError(self.path, line, f"prototype {name} contains itself")
        if self.bodies and (found is None or found is self.protos[0].get(name)):
            self.calls.setdefault(self.bodies[0][0], {}).setdefault(name, line)
            self.early = self.early or found is None
        return found

    def finish(self) -> None:
        """At the end of the file: a warning about USEs of nothing; FileError for prototypes that contain each other."""
        if self.dangling:
            line, name = self.first
            more = f" ({self.dangling - 1} more like it)" if self.dangling > 1 else ""
            warn(f"{self.path}:{line}: USE {name} names no node before it{more}; it stands for nothing")
        if not self.early:
            return
        done: set[str] = set()
        for start in self.calls:
            chain, stack = [start], [iter(self.calls[start].items())]
            while stack:
                name, line = next(stack[-1], ("", 0))
                if not line:
                    stack.pop()
                    done.add(chain.pop())
                elif name in chain:
                    raise FileError(self.path, line, f"prototypes {chain[-1]} and {name} contain each other")
                elif name not in done and name in self.calls:
                    chain.append(name)
                    stack.append(iter(self.calls[name].items()))

    def node_type(self, parent: Node, field: str) -> str:
        """SFNode, MFNode or "" for a field of a node, by prototype or table."""
        if parent.instance:
            proto = self.proto(parent.type)
            if proto is not None:
                return next((f.type for f in proto.interface if f.name == field), "")
        found = fields_of(parent.type).get(field)
        return found.type if found is not None else ""


def put(fields: dict[str, object], name: str, item: Node | Use, type: str) -> list | None:
    """Add a node to a node-valued field; a list when the type is MFNode or there are several. Returns that list."""
    value = fields.get(name)
    if isinstance(value, list):
        value.append(item)
        return value
    if isinstance(value, Node | Use):
        fields[name] = several = [value, item]
        return several
    if type == "MFNode":
        fields[name] = several = [item]
        return several
    fields[name] = item
    return None


def cut_early(path: object, tops: list[Node], limits: Limits) -> list[Use]:
    """Make USEs that stand before or inside their DEF stand for nothing; answers them. `tops`: nodes that no node holds.

    For encodings in which fields were put into another order than they were read in. FileError when the USEs expand to
    more nodes than `limits` allow.
    """
    cut: list[Use] = []
    sizes: dict[int, int] = {}  # of nodes that are closed, USEs expanded
    begun: set[int] = set()
    for top in tops:
        if id(top) in begun:
            continue
        begun.add(id(top))
        stack = [(top, top.entries(), [1])]
        while stack:
            node, entries, size = stack[-1]
            _, entry = next(entries, ("", None))
            if entry is None:
                stack.pop()
                if size[0] > limits.expansion:
                    raise FileError(path, node.line, f"USEs expand to more than {limits.expansion} nodes")
                sizes[id(node)] = size[0]
                if stack:
                    stack[-1][2][0] += size[0]
            elif isinstance(entry, Node):
                if id(entry) not in begun:
                    begun.add(id(entry))
                    stack.append((entry, entry.entries(), [1]))
            elif id(entry.node) in sizes:
                size[0] += sizes[id(entry.node)]
            elif entry.node is not None:
                entry.node = None
                cut.append(entry)
    return cut


def in_sight(outer: Mapping[str, Proto], body: list) -> dict[str, Proto]:
    """Prototypes in sight inside a body: those of the scopes around it and its own."""
    return {**outer, **{s.name: s for s in body if isinstance(s, Proto)}}
