"""What the scene writers share: deep graphs without recursion, DEF before USE, and the list of what was lost."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping
from typing import Any

from vitruvian.errors import VitruvianError
from vitruvian.hanim.fields import type_of
from vitruvian.hanim.graph import Comment, Literal, Node, Proto, Scene, Use
from vitruvian.hanim.values import text_of, translate

Step = Generator[Any, None, None]

# Fields that VRML97 calls otherwise than X3D.
TO_X3D = {("Switch", "choice"): "children", ("LOD", "level"): "children", ("Collision", "collide"): "enabled"}
TO_VRML97 = {(node, new): old for (node, old), new in TO_X3D.items()}


def run(first: Step) -> None:
    """Run a generator that yields generators to be run in its place, to any depth."""
    stack = [first]
    while stack:
        inner = next(stack[-1], None)
        if inner is None:
            stack.pop()
        else:
            stack.append(inner)


class Printer:
    """Lines of text, the DEF names written so far in each scope, and what the encoding couldn't hold."""

    def __init__(self, scene: Scene, syntax: str, encoding: str):
        self.scene, self.syntax, self.encoding = scene, syntax, encoding
        self.lines: list[str] = []
        self.lost: list[str] = []
        self.scopes: list[tuple[set[int], dict[str, Node]]] = [(set(), {})]
        self.open: set[int] = set()
        self.renamed: dict[tuple[str, str], str] = {}
        if scene.encoding == "wrl" and encoding != "wrl":
            self.renamed = TO_X3D
        elif scene.encoding != "wrl" and encoding == "wrl":
            self.renamed = TO_VRML97

    def lose(self, what: str) -> None:
        if what not in self.lost:
            self.lost.append(what)

    def name(self, node: Node, field: str) -> str:
        """The field's name in this encoding."""
        return self.renamed.get((node.type, field), field) if self.renamed else field

    def resolve(self, item: Node | Use) -> tuple[Node | None, str]:
        """(node to write here in full or None, name to USE instead).

        A node is written where it comes first, whichever of DEF and USE stands there, and used afterwards.
        """
        written, names = self.scopes[-1]
        node = item.node if isinstance(item, Use) else item
        if node is None:
            assert isinstance(item, Use)
            return None, item.name
        if id(node) in self.open and not isinstance(item, Use):
            raise VitruvianError(f"node {node.name or node.type} contains itself; a graph must be a tree with USEs")
        if id(node) in written or id(node) in self.open:
            if node.name:
                if names.get(node.name) is not node:
                    self.lose(f"USE {node.name} means another node of that name in the file; give them different names")
                return None, node.name
            if isinstance(item, Use):
                raise VitruvianError(f"a {node.type} is USEd but has no DEF name; give it one")
        return node, ""

    def begin(self, node: Node) -> None:
        written, names = self.scopes[-1]
        written.add(id(node))
        self.open.add(id(node))
        if node.name:
            names[node.name] = node

    def text(self, node: Node, name: str, value: object, protos: Mapping[str, Proto]) -> str | None:
        """A field's value as text of this encoding; None (and a note in `lost`) when it can't be said."""
        if isinstance(value, Literal) and value.syntax == self.syntax:
            return value.text
        return self.typed(value, type_of(node, name, protos), f"{node.type}.{name}")

    def typed(self, value: object, type: str, where: str) -> str | None:
        """As `text`, when the type is at hand."""
        if not isinstance(value, Literal):
            return text_of(value, type, self.syntax)
        text = translate(value, type, self.syntax)
        if text is None and value.text.strip(" \t\n,[]") not in ("", "NULL", "null"):
            self.lose(f"{where}: {' '.join(value.text[:40].split())} can't be written")
        return text


def _plain(node: Node) -> Iterator[tuple[str, Node | Use | Comment]]:
    """(field, child) one field after the other."""
    for name, value in node.fields.items():
        if isinstance(value, Node | Use):
            yield name, value
        elif isinstance(value, list):
            yield from ((name, v) for v in value if isinstance(v, Node | Use | Comment))


def entries(node: Node) -> Iterator[tuple[str, Node | Use | Comment]]:
    """(field, child or comment) in XML's order; comments outside of lists stand before their field."""
    if not node.comments and not node.order:
        plain = list(_plain(node))
        if not any(isinstance(v, Comment) for _, v in plain):
            yield from plain
            return
    before: dict[str, list[Comment]] = {}
    for name, comment in node.comments:
        before.setdefault(name, []).append(comment)
    last = before.pop("", [])
    lists = {}
    for name, value in node.fields.items():
        if isinstance(value, Node | Use):
            lists[name] = [value]
        elif isinstance(value, list) and any(isinstance(v, Node | Use | Comment) for v in value):
            lists[name] = value
    for name in before:
        if name not in lists:
            yield from (("", c) for c in before[name])
    counts = {name: sum(not isinstance(v, Comment) for v in value) for name, value in lists.items()}
    order = node.order
    if not order or len(order) != sum(counts.values()) or any(order.count(n) != c for n, c in counts.items()):
        order = [name for name, count in counts.items() for _ in range(count)]
    rest = {name: iter(value) for name, value in lists.items()}
    for name in order:
        yield from ((name, c) for c in before.pop(name, ()))
        for value in rest[name]:
            yield name, value
            if not isinstance(value, Comment):
                break
    for name, values in rest.items():
        yield from ((name, value) for value in values)
    yield from (("", c) for c in last)
