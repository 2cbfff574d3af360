"""X3D JSON (ISO/IEC 19776-5): writer. Fields that nobody touched are written with the text that was read.

The form is that of the Web3D Consortium's stylesheet, which other readers know: fields before what is declared, comments
of a node in its "-children", a program as a list of lines. Long lists of numbers have one row a line.
"""

from __future__ import annotations

import os
from collections.abc import Mapping

from vitruvian.formats.atomic import atomic
from vitruvian.formats.printer import Printer, Step, run
from vitruvian.formats.scopes import in_sight
from vitruvian.hanim.fields import type_of
from vitruvian.hanim.graph import (
    Comment,
    Export,
    Import,
    Literal,
    Node,
    Proto,
    ProtoField,
    Route,
    Scene,
    Statement,
    Use,
)
from vitruvian.hanim.json_values import quoted

_SITE = "https://www.web3d.org/specifications/x3d-"
_VERSIONS = ("3.0", "3.1", "3.2", "3.3", "4.0")
_DEEPEST, _ROWS = 60, 12  # columns of indent at most: of nodes, of rows of numbers (there are so many of them)


def write_json(scene: Scene, path: str | os.PathLike[str]) -> list[str]:
    """Write a scene of any encoding as X3D JSON; the answer lists what JSON can't hold (one line each, [] when nothing).

    The file appears whole or not at all. VitruvianError when the folder isn't writable or when the graph can't be a
    file (a node inside itself, a number that isn't finite).
    """
    text, lost = print_json(scene)
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return lost


def print_json(scene: Scene) -> tuple[str, list[str]]:
    """The JSON text of a scene, and what it couldn't hold."""
    printer = _JsonPrinter(scene, "json", "x3dj")
    printer.file()
    printer.lines.append("")
    return "\n".join(printer.lines), printer.lost


def _nodes(value: object) -> list[Node | Use | Comment] | None:
    """What stands in a node-valued field; None for a field of another kind."""
    if isinstance(value, Node | Use):
        return [value]
    if isinstance(value, list) and isinstance(next(iter(value), None), Node | Use | Comment):
        return value
    return None


class _JsonPrinter(Printer):
    """`depth` is that of what is open; `fresh`: nothing stands in it yet, so that the next line needs no comma before."""

    def __init__(self, scene: Scene, syntax: str, encoding: str):
        super().__init__(scene, syntax, encoding)
        self.depth = 0
        self.fresh = True

    # Lines

    def put(self, text: str) -> None:
        if not self.fresh:
            self.lines[-1] += ","
        self.fresh = False
        self.lines.append(" " * min(self.depth, _DEEPEST) + text)

    def begin_list(self, text: str) -> None:
        """A line that opens an object or list."""
        self.put(text)
        self.depth += 1
        self.fresh = True

    def end_list(self, closers: str) -> None:
        self.depth -= 1
        if self.fresh:
            self.lines[-1] += closers
        else:
            self.lines.append(" " * min(self.depth, _DEEPEST) + closers)
        self.fresh = False

    def pair(self, key: str, text: str, *, raw: bool = True) -> None:
        """A key and the source text of its value; text that isn't `raw` gets its indent here."""
        if not raw and "\n" in text:
            text = text.replace("\n", "\n" + " " * min(self.depth + 1, _ROWS))
            text = text[: text.rindex("\n") + 1] + " " * min(self.depth, _DEEPEST) + "]"
        self.put(f"{quoted(key)}: {text}")

    def strings(self, **pairs: str | None) -> None:
        for key, text in pairs.items():
            if text is not None:
                self.pair("@" + key, quoted(text))

    def value(self, key: str, value: object, type: str, where: str) -> None:
        if isinstance(value, Literal) and value.syntax == "json":
            if value.text:
                self.pair(key, value.text)
            return
        text = self.typed(value, type, where)
        if text is not None:
            self.pair(key, text, raw=False)

    def comment(self, comment: Comment) -> None:
        self.put(f'{{"#comment": {quoted(comment.text)}}}')

    # The file

    def file(self) -> None:
        scene = self.scene
        version, profile = scene.version, scene.profile
        if scene.encoding == "wrl":
            version, profile = "3.3", "Immersive"
        self.begin_list("{" + quoted("X3D") + ": {")
        self.pair("encoding", quoted("UTF-8"))
        self.strings(profile=profile or None, version=version or None)
        if version in _VERSIONS:
            self.strings(**{"xsd:noNamespaceSchemaLocation": f"{_SITE}{version}.xsd"})
            self.pair("JSON schema", quoted(f"{_SITE}{version}-JSONSchema.json"))
        if scene.components or scene.units or scene.metas or scene.header_comments:
            self.head()
        self.begin_list(quoted("Scene") + ": {")
        if scene.body:
            self.begin_list(quoted("-children") + ": [")
            run(self.statements(scene.body, {}))
            self.end_list("]")
        self.end_list("}")
        self.end_list("}}")

    def head(self) -> None:
        scene = self.scene
        self.begin_list(quoted("head") + ": {")
        self.remarks(scene.header_comments)
        entries = {
            "component": [{"@name": quoted(name), "@level": str(level)} for name, level in scene.components],
            "unit": [
                {"@category": quoted(category), "@name": quoted(name), "@conversionFactor": repr(factor)}
                for category, name, factor in scene.units
            ],
            "meta": [{"@name": quoted(name), "@content": quoted(content)} for name, content in scene.metas],
        }
        for key, rows in entries.items():
            if rows:
                self.begin_list(quoted(key) + ": [")
                for row in rows:
                    self.put("{" + ", ".join(f"{quoted(k)}: {v}" for k, v in row.items()) + "}")
                self.end_list("]")
        self.end_list("}")

    def remarks(self, comments: list[Comment]) -> None:
        """Comments that have no place in a list of nodes."""
        if comments:
            self.begin_list(quoted("-children") + ": [")
            for comment in comments:
                self.comment(comment)
            self.end_list("]")

    def statements(self, body: list[Statement], outer: Mapping[str, Proto]) -> Step:
        protos = in_sight(outer, body)
        for statement in body:
            if isinstance(statement, Node | Use):
                yield self.node(statement, "{", "}", protos)
            elif isinstance(statement, Proto):
                yield self.proto(statement, protos)
            elif isinstance(statement, Comment):
                self.comment(statement)
            elif isinstance(statement, Route):
                s = statement
                pairs = {"fromNode": s.from_node, "fromField": s.from_field, "toNode": s.to_node, "toField": s.to_field}
                self.row("ROUTE", pairs)
            elif isinstance(statement, Import):
                pairs = {"inlineDEF": statement.inline, "importedDEF": statement.name}
                self.row("IMPORT", pairs | ({"AS": statement.alias} if statement.alias else {}))
            elif isinstance(statement, Export):
                self.row("EXPORT", {"localDEF": statement.name} | ({"AS": statement.alias} if statement.alias else {}))

    def row(self, key: str, pairs: dict[str, str]) -> None:
        inside = ", ".join(f"{quoted('@' + k)}: {quoted(v)}" for k, v in pairs.items())
        self.put(f"{{{quoted(key)}: {{{inside}}}}}")

    # Nodes

    def node(self, item: Node | Use, before: str, after: str, protos: Mapping[str, Proto]) -> Step:
        """A node between the text `before` on its first line and `after` on its last."""
        node, name = self.resolve(item)
        if node is None:
            self.use(item, name, before, after)
            return
        instance = node.instance or node.type in protos
        self.begin(node)
        self.begin_list(f"{before}{quoted('ProtoInstance' if instance else node.type)}: {{")
        self.strings(name=node.type if instance else None, DEF=node.name or None)
        if instance:
            yield from self.given(node, protos)
        else:
            yield from self.contents(node, protos)
        self.end_list("}" + after)
        self.open.discard(id(node))

    def use(self, item: Node | Use, name: str, before: str, after: str) -> None:
        node = item.node if isinstance(item, Use) else item
        type = item.type or (node.type if node is not None else "")
        inside = f"{quoted('@USE')}: {quoted(name)}"
        if node is not None and node.instance:
            type, inside = "ProtoInstance", f"{quoted('@name')}: {quoted(node.type)}, {inside}"
        if not type:
            type = "Group"
            self.lose(f"USE {name} stands for nothing, so its type is not known; written as a Group")
        self.put(f"{before}{quoted(type)}: {{{inside}}}{after}")

    def contents(self, node: Node, protos: Mapping[str, Proto]) -> Step:
        """Fields in their order; comments outside of lists in "-children", before the first field that has one."""
        remarks = list(node.comments)
        fields: dict[str, tuple[str, object]] = {}
        for key, value in node.fields.items():
            kind, nodes = type_of(node, key, protos), _nodes(value)
            if kind == "SFNode" and nodes and sum(not isinstance(v, Comment) for v in nodes) == 1:
                # a single node's comments have no list to stand in
                remarks += [(key, v) for v in nodes if isinstance(v, Comment)]
                value = next(v for v in nodes if not isinstance(v, Comment))
            fields[key] = kind, value
        comments, commented = [c for _, c in remarks], {name for name, _ in remarks}
        children = next((k for k in node.fields if self.name(node, k) == "children" and _nodes(node.fields[k])), None)
        taken: set[str] = {"@DEF", "@USE"}
        for key, (kind, value) in fields.items():
            if comments and children is None and key in commented:
                self.remarks(comments)
                comments, taken = [], taken | {"-children"}
            name = self.name(node, key)
            nodes = _nodes(value)
            if nodes is None and isinstance(value, list) and not value and kind in ("MFNode", "SFNode", ""):
                nodes = []
            null = kind in ("MFNode", "SFNode") and isinstance(value, Literal)
            sign = "@" if nodes is None and not null else "-"
            if sign + name in taken:
                self.lose(f"{node.type}.{name}: given twice")
                continue
            taken.add(sign + name)
            if nodes is None:
                self.value(sign + name, value, kind, f"{node.type}.{name}")
            elif kind == "MFNode" or isinstance(value, list) and (kind != "SFNode" or len(nodes) != 1):
                yield from self.several(sign + name, [*comments, *nodes] if key == children else nodes, protos)
                comments = [] if key == children else comments
            else:
                yield self.single(sign + name, nodes[0], protos)
        own = {f.name for f in node.interface}
        if comments and (own & commented or not node.interface):
            self.remarks(comments)
            comments = []
        yield from self.interface(node.interface, protos)
        self.remarks(comments)
        self.connections(node)
        if node.text:
            self.program(node.text)

    def single(self, key: str, item: Node | Use | Comment, protos: Mapping[str, Proto]) -> Step:
        assert not isinstance(item, Comment)
        yield self.node(item, f"{quoted(key)}: {{", "}", protos)

    def several(self, key: str, items: list, protos: Mapping[str, Proto]) -> Step:
        self.begin_list(quoted(key) + ": [")
        for item in items:
            if isinstance(item, Comment):
                self.comment(item)
            else:
                yield self.node(item, "{", "}", protos)
        self.end_list("]")

    def program(self, text: str) -> None:
        self.begin_list(quoted("#sourceText") + ": [")
        for line in text.split("\n"):
            self.put(quoted(line))
        self.end_list("]")

    def connections(self, node: Node) -> None:
        if node.connects:
            self.begin_list(f"{quoted('IS')}: {{{quoted('connect')}: [")
            for inner, outer in node.connects:
                pair = f"{quoted('@nodeField')}: {quoted(self.name(node, inner))}, {quoted('@protoField')}"
                self.put(f"{{{pair}: {quoted(outer)}}}")
            self.end_list("]}")

    def given(self, node: Node, protos: Mapping[str, Proto]) -> Step:
        """What an instance gives to the fields of its prototype."""
        remarks = list(node.comments)
        kinds = {key: type_of(node, key, protos) for key in node.fields}
        for key, value in node.fields.items():
            if kinds[key] != "MFNode":
                remarks += [(key, v) for v in _nodes(value) or [] if isinstance(v, Comment)]
        comments, early = [c for _, c in remarks], any(name for name, _ in remarks)
        self.remarks(comments if early else [])
        if node.fields:
            self.begin_list(quoted("fieldValue") + ": [")
            for key, value in node.fields.items():
                self.begin_list("{" + f"{quoted('@name')}: {quoted(key)}")
                self.fresh = False
                nodes, kind = _nodes(value), kinds[key]
                if nodes and kind != "MFNode":
                    nodes = [v for v in nodes if not isinstance(v, Comment)]
                if nodes is None and isinstance(value, list) and not value and kind in ("MFNode", "SFNode", ""):
                    nodes = []
                if nodes is not None:
                    yield from self.several("-children", nodes, protos)
                elif kind in ("MFNode", "SFNode") and isinstance(value, Literal):
                    self.value("-children", value, kind, key)
                else:
                    self.value("@value", value, kind, f"{node.type}.{key}")
                self.end_list("}")
            self.end_list("]")
        self.remarks([] if early else comments)
        self.connections(node)

    # Prototypes

    def interface(self, fields: list[ProtoField], protos: Mapping[str, Proto]) -> Step:
        if not fields:
            return
        self.begin_list(quoted("field") + ": [")
        for own in fields:
            self.begin_list(f"{{{quoted('@accessType')}: {quoted(own.access)}")
            self.fresh = False
            self.strings(type=own.type, name=own.name, **own.extra)
            nodes = _nodes(own.value)
            comments = [*own.comments, *(v for v in nodes or [] if isinstance(v, Comment))]
            of_nodes = own.type.endswith("Node")
            if of_nodes and isinstance(own.value, list) and not own.value:
                nodes = []
            if nodes is not None or comments:
                real = [v for v in nodes or [] if not isinstance(v, Comment)]
                yield from self.several("-children", [*comments, *real], protos)
            if nodes is None and own.value is not None:
                self.value("-value" if of_nodes else "@value", own.value, own.type, own.name)
            self.end_list("}")
        self.end_list("]")

    def proto(self, proto: Proto, protos: Mapping[str, Proto]) -> Step:
        self.begin_list(f"{{{quoted('ExternProtoDeclare' if proto.external else 'ProtoDeclare')}: {{")
        self.strings(name=proto.name, **proto.extra)
        if proto.url is not None:
            self.value("@url", proto.url, "MFString", f"{proto.name}.url")
        inside = not proto.external and bool(proto.interface or proto.comments)
        if inside:
            self.begin_list(quoted("ProtoInterface") + ": {")
        comments = [c for _, c in proto.comments]
        early = any(name for name, _ in proto.comments) or not proto.interface
        self.remarks(comments if early else [])
        yield from self.interface(proto.interface, protos)
        self.remarks([] if early else comments)
        if inside:
            self.end_list("}")
        if not proto.external:
            self.begin_list(quoted("ProtoBody") + ": {")
            self.scopes.append((set(), {}))
            if proto.body:
                self.begin_list(quoted("-children") + ": [")
                yield from self.statements(proto.body, protos)
                self.end_list("]")
            self.scopes.pop()
            self.end_list("}")
        self.end_list("}}")
