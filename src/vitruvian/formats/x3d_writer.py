"""X3D XML (ISO/IEC 19776-1): writer. Fields that nobody touched are written with the text that was read."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from functools import lru_cache

from vitruvian.formats.atomic import atomic
from vitruvian.formats.printer import Printer, Step, entries, run
from vitruvian.formats.scopes import in_sight
from vitruvian.hanim.fields import container_of, placement, type_of
from vitruvian.hanim.graph import (
    Comment,
    Export,
    Import,
    Node,
    Proto,
    ProtoField,
    Route,
    Scene,
    Statement,
    Use,
)

_SPECIAL = re.compile(r"[&<'\n\t\r]")
_ESCAPES = {"&": "&amp;", "<": "&lt;", "'": "&apos;", "\n": "&#10;", "\t": "&#9;", "\r": "&#13;"}
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")
_TROUBLE = re.compile(f"{_FORBIDDEN.pattern[:-1]}&<'\n\t\r]")
_NAME = re.compile(r"[^\W\d][\w.-]*(?::[^\W\d][\w.-]*)?")
_VERSIONS = ("3.0", "3.1", "3.2", "3.3", "4.0")


def write_x3d(scene: Scene, path: str | os.PathLike[str]) -> list[str]:
    """Write a scene of any encoding as X3D XML; the answer lists what XML can't hold (one line each, [] when nothing).

    The file appears whole or not at all. VitruvianError when the folder isn't writable or when the graph can't be a
    file (a node inside itself, a number that isn't finite).
    """
    text, lost = print_x3d(scene)
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return lost


def print_x3d(scene: Scene) -> tuple[str, list[str]]:
    """The XML text of a scene, and what it couldn't hold."""
    printer = _XmlPrinter(scene, "xml", "x3d")
    printer.head()
    run(printer.statements(scene.body, {}, 2))
    printer.lines.append("  </Scene>\n</X3D>\n")
    return "\n".join(printer.lines), printer.lost


@lru_cache(maxsize=1024)
def _legal(name: str) -> bool:
    """Whether XML can hold the name of an element or attribute."""
    return _NAME.fullmatch(name) is not None


class _XmlPrinter(Printer):
    def attributes(self, **pairs: str | None) -> str:
        return "".join(f" {key}='{self.escape(text)}'" for key, text in pairs.items() if text is not None)

    def escape(self, text: str) -> str:
        if not _TROUBLE.search(text):
            return text
        if _FORBIDDEN.search(text):
            self.lose("control characters, which XML can't hold; written as U+FFFD")
            text = _FORBIDDEN.sub("\ufffd", text)
        return _SPECIAL.sub(lambda m: _ESCAPES[m[0]], text)

    def line(self, depth: int, text: str) -> None:
        self.lines.append("  " * min(depth, 40) + text)

    def comment(self, comment: Comment, depth: int) -> None:
        text = _FORBIDDEN.sub("\ufffd", comment.text)
        while "--" in text:  # XML forbids it inside comments
            text = text.replace("--", "- -")
        self.line(depth, f"<!--{text + ' ' if text.endswith('-') else text}-->")

    def head(self) -> None:
        scene = self.scene
        version, profile = scene.version, scene.profile
        if scene.encoding == "wrl":
            version, profile = "3.3", "Immersive"
        self.lines.append('<?xml version="1.0" encoding="UTF-8"?>')
        schema = {}
        if version in _VERSIONS:
            site = f"https://www.web3d.org/specifications/x3d-{version}"
            self.lines.append(f'<!DOCTYPE X3D PUBLIC "ISO//Web3D//DTD X3D {version}//EN" "{site}.dtd">')
            schema = {
                "xmlns:xsd": "http://www.w3.org/2001/XMLSchema-instance",
                "xsd:noNamespaceSchemaLocation": f"{site}.xsd",
            }
        self.lines.append(f"<X3D{self.attributes(profile=profile or None, version=version or None, **schema)}>")
        if scene.components or scene.units or scene.metas or scene.header_comments:
            self.line(1, "<head>")
            for comment in scene.header_comments:
                self.comment(comment, 2)
            for name, level in scene.components:
                self.line(2, f"<component{self.attributes(name=name, level=str(level))}/>")
            for category, name, factor in scene.units:
                self.line(2, f"<unit{self.attributes(category=category, name=name, conversionFactor=repr(factor))}/>")
            for name, content in scene.metas:
                self.line(2, f"<meta{self.attributes(content=content, name=name)}/>")
            self.line(1, "</head>")
        self.line(1, "<Scene>")

    def statements(self, body: list[Statement], outer: Mapping[str, Proto], depth: int) -> Step:
        protos = in_sight(outer, body)
        for statement in body:
            if isinstance(statement, Node | Use):
                yield self.node(statement, "", "", protos, depth)
            elif isinstance(statement, Proto):
                yield self.proto(statement, protos, depth)
            elif isinstance(statement, Comment):
                self.comment(statement, depth)
            elif isinstance(statement, Route):
                ends = self.attributes(
                    fromNode=statement.from_node,
                    fromField=statement.from_field,
                    toNode=statement.to_node,
                    toField=statement.to_field,
                )
                self.line(depth, f"<ROUTE{ends}/>")
            elif isinstance(statement, Import):
                names = self.attributes(
                    inlineDEF=statement.inline, importedDEF=statement.name, AS=statement.alias or None
                )
                self.line(depth, f"<IMPORT{names}/>")
            elif isinstance(statement, Export):
                self.line(depth, f"<EXPORT{self.attributes(localDEF=statement.name, AS=statement.alias or None)}/>")

    def node(self, item: Node | Use, parent: str, field: str, protos: Mapping[str, Proto], depth: int) -> Step:
        node, name = self.resolve(item)
        if node is None:
            self.use(item, name, parent, field, protos, depth)
            return
        instance = node.instance or node.type in protos
        if not instance and not _legal(node.type):
            self.lose(f"node {node.type}, whose name XML can't hold, with all below it")
            return
        self.begin(node)
        tag = "ProtoInstance" if instance else node.type
        head = f"<{tag}{self.attributes(name=node.type if instance else None, DEF=node.name or None)}"
        if not instance:
            for key, value in node.fields.items():
                head += self.attribute(node, key, value, protos)
        head += self.container(item, parent, tag, False, field)
        start = len(self.lines)
        if instance:
            yield from self.values(node, protos, depth + 1)
        else:
            yield from self.contents(node, protos, depth + 1)
        if len(self.lines) == start:
            self.line(depth, f"{head}/>")
        else:
            self.lines[start] = "  " * min(depth, 40) + f"{head}>\n" + self.lines[start]
            self.line(depth, f"</{tag}>")
        self.open.discard(id(node))

    def use(self, item: Node | Use, name: str, parent: str, field: str, protos: Mapping, depth: int) -> None:
        node = item.node if isinstance(item, Use) else item
        tag, proto = item.type or (node.type if node is not None else ""), None
        if node is not None and (node.instance or node.type in protos):
            tag, proto = "ProtoInstance", node.type
        if not tag or not _legal(tag):
            tag = "Group"
            self.lose(f"USE {name} stands for nothing, so its type is not known; written as a Group")
        container = self.container(item, parent, tag, True, field)
        self.line(depth, f"<{tag}{self.attributes(name=proto, USE=name)}{container}/>")

    def container(self, item: Node | Use, parent: str, tag: str, use: bool, field: str) -> str:
        """containerField where the file had it or where a reader would otherwise put the node elsewhere.

        What was read from XML keeps its place as it came; all else is told also to those who don't guess as we do.
        """
        written = item.container
        usual = placement(parent, tag, use) if self.scene.encoding == "x3d" and item.line else container_of(tag)
        if field and (written or usual != field):
            written = field
        return self.attributes(containerField=written) if written else ""

    def attribute(self, node: Node, key: str, value: object, protos: Mapping[str, Proto]) -> str:
        if isinstance(value, Node | Use) or value is None:
            return ""
        if isinstance(value, list) and isinstance(next(iter(value), None), Node | Use | Comment):
            return ""
        if isinstance(value, list) and not value and type_of(node, key, protos) in ("MFNode", "SFNode", ""):
            return ""
        text = self.text(node, key, value, protos)
        if text is None:
            return ""
        name = self.name(node, key)
        if not _legal(name):
            self.lose(f"{node.type}.{name}: XML has no attribute of such a name")
            return ""
        return f" {name}='{text if hasattr(value, 'dtype') else self.escape(text)}'"

    def contents(self, node: Node, protos: Mapping[str, Proto], depth: int) -> Step:
        """What stands between a node's tags."""
        comments: list[tuple[str, Comment]] = []
        if node.interface:
            own = {f.name for f in node.interface}
            comments = [c for c in node.comments if c[0] in own]
            yield from self.interface(node.interface, comments, protos, depth)
        if node.connects:
            self.connections(node, depth)
        for field, child in entries(node):
            if isinstance(child, Comment):
                if not any(child is c for _, c in comments):
                    self.comment(child, depth)
            else:
                yield self.node(child, node.type, self.name(node, field), protos, depth)
        self.characters(node)

    def characters(self, node: Node) -> None:
        """Character data: the program of a Script, or whatever else stood there."""
        if not node.text:
            return
        text = node.text.replace("]]>", "]]]]><![CDATA[>")
        if _FORBIDDEN.search(text):
            self.lose("control characters, which XML can't hold; written as U+FFFD")
            text = _FORBIDDEN.sub("\ufffd", text)
        self.lines.append(f"<![CDATA[{text}]]>")

    def connections(self, node: Node, depth: int) -> None:
        self.line(depth, "<IS>")
        for inner, outer in node.connects:
            self.line(depth + 1, f"<connect{self.attributes(nodeField=self.name(node, inner), protoField=outer)}/>")
        self.line(depth, "</IS>")

    def interface(
        self, fields: list[ProtoField], comments: list[tuple[str, Comment]], protos: Mapping[str, Proto], depth: int
    ) -> Step:
        for own in fields:
            for name, comment in comments:
                if name == own.name:
                    self.comment(comment, depth)
            yield self.own_field(own, protos, depth)

    def own_field(self, own: ProtoField, protos: Mapping[str, Proto], depth: int) -> Step:
        value = own.value
        children = value if isinstance(value, list) else [value]
        nodes = [c for c in children if isinstance(c, Node | Use | Comment)]
        text = None
        if value is not None and not nodes and not (isinstance(value, list) and own.type.endswith("Node")):
            text = self.typed(value, own.type, own.name)
        head = self.attributes(accessType=own.access, type=own.type, name=own.name, value=text, **own.extra)
        if not nodes and not own.comments:
            self.line(depth, f"<field{head}/>")
            return
        self.line(depth, f"<field{head}>")
        for child in [*own.comments, *nodes]:
            if isinstance(child, Comment):
                self.comment(child, depth + 1)
            else:
                yield self.node(child, "", "", protos, depth + 1)
        self.line(depth, "</field>")

    def values(self, node: Node, protos: Mapping[str, Proto], depth: int) -> Step:
        """What stands between the tags of a ProtoInstance."""
        if node.connects:
            self.connections(node, depth)
        for field, value in node.fields.items():
            for name, comment in node.comments:
                if name == field:
                    self.comment(comment, depth)
            children = value if isinstance(value, list) else [value]
            nodes = [c for c in children if isinstance(c, Node | Use | Comment)]
            name = self.attributes(name=field)
            if nodes:
                self.line(depth, f"<fieldValue{name}>")
                for child in nodes:
                    if isinstance(child, Comment):
                        self.comment(child, depth + 1)
                    else:
                        yield self.node(child, "", "", protos, depth + 1)
                self.line(depth, "</fieldValue>")
            elif isinstance(value, list) and not value and type_of(node, field, protos) in ("MFNode", "SFNode", ""):
                self.line(depth, f"<fieldValue{name}/>")
            else:
                text = self.text(node, field, value, protos)
                if text is not None:
                    self.line(depth, f"<fieldValue{name}{self.attributes(value=text)}/>")
        for name, comment in node.comments:
            if name not in node.fields:
                self.comment(comment, depth)
        self.characters(node)

    def proto(self, proto: Proto, protos: Mapping[str, Proto], depth: int) -> Step:
        tag = "ExternProtoDeclare" if proto.external else "ProtoDeclare"
        url = None
        if proto.url is not None:
            url = self.typed(proto.url, "MFString", f"{proto.name}.url")
        self.line(depth, f"<{tag}{self.attributes(name=proto.name, url=url, **proto.extra)}>")
        inner = depth + 1
        if not proto.external and (proto.interface or proto.comments):
            self.line(inner, "<ProtoInterface>")
            inner += 1
        yield from self.interface(proto.interface, proto.comments, protos, inner)
        own = {f.name for f in proto.interface}
        for name, comment in proto.comments:
            if name not in own:
                self.comment(comment, inner)
        if not proto.external:
            if inner > depth + 1:
                self.line(depth + 1, "</ProtoInterface>")
            self.line(depth + 1, "<ProtoBody>")
            self.scopes.append((set(), {}))
            yield from self.statements(proto.body, protos, depth + 2)
            self.scopes.pop()
            self.line(depth + 1, "</ProtoBody>")
        self.line(depth, f"</{tag}>")
