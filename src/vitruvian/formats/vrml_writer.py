"""VRML97 and Classic X3D: writer. Fields that nobody touched are written with the text that was read."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping

from vitruvian.formats.atomic import atomic
from vitruvian.formats.printer import Printer, Step, run
from vitruvian.formats.scopes import in_sight
from vitruvian.formats.vrml_lexer import legal_name
from vitruvian.hanim.fields import fields_of, native, type_of
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
from vitruvian.hanim.values import default_of, parse, quote, text_of

_READABLE = re.compile(r'[^\s"#,\[\]{}]+', re.ASCII)
_ILLEGAL = re.compile(r"""[\x00-\x20"#',.\[\\\]{}\x7f]""")
_VERSION = re.compile(r"[0-9]+\.[0-9]+")
_WORDS_97 = {
    "inputOnly": "eventIn",
    "outputOnly": "eventOut",
    "initializeOnly": "field",
    "inputOutput": "exposedField",
}
VRML97_NODES = frozenset(
    "Anchor Appearance AudioClip Background Billboard Box Collision Color ColorInterpolator Cone Coordinate "
    "CoordinateInterpolator Cylinder CylinderSensor DirectionalLight ElevationGrid Extrusion Fog FontStyle Group "
    "ImageTexture IndexedFaceSet IndexedLineSet Inline LOD Material MovieTexture NavigationInfo Normal "
    "NormalInterpolator OrientationInterpolator PixelTexture PlaneSensor PointLight PointSet PositionInterpolator "
    "ProximitySensor ScalarInterpolator Script Shape Sound Sphere SphereSensor SpotLight Switch Text "
    "TextureCoordinate TextureTransform TimeSensor TouchSensor Transform Viewpoint VisibilitySensor WorldInfo".split()
)


def write_vrml(scene: Scene, path: str | os.PathLike[str]) -> list[str]:
    """Write a scene as Classic X3D when its encoding is "x3dv", as VRML97 when it is "wrl".

    A scene that was read from XML is written in the language of the path's extension (.wrl: VRML97, else Classic X3D).
    Returns what the language can't hold (one line each, [] when nothing). The file appears whole or not at all.
    VitruvianError when the folder isn't writable or when the graph can't be a file (a node inside itself, a number that
    isn't finite).
    """
    encoding = scene.encoding
    if encoding not in ("wrl", "x3dv"):
        encoding = "wrl" if os.fspath(path).lower().endswith((".wrl", ".wrz")) else "x3dv"
    text, lost = print_vrml(scene, encoding)
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")
    return lost


def print_vrml(scene: Scene, encoding: str = "") -> tuple[str, list[str]]:
    """The text of a scene in "x3dv" or "wrl" (default: its own encoding), and what it couldn't hold."""
    printer = _VrmlPrinter(scene, "vrml", encoding or scene.encoding)
    printer.head()
    run(printer.statements(scene.body, {}, 0))
    printer.lines.append("")
    return "\n".join(printer.lines), printer.lost


class _VrmlPrinter(Printer):
    def __init__(self, scene: Scene, syntax: str, encoding: str):
        super().__init__(scene, syntax, encoding)
        self.native_names = scene.encoding in ("wrl", "x3dv")  # names were read from VRML: write them as they were
        self.names: dict[str, str] = {}
        self.taken: set[str] = set()

    def line(self, depth: int, text: str) -> None:
        self.lines.append(" " * min(depth, 60) + text)

    def comments(self, comments: list[Comment], depth: int) -> None:
        for comment in comments:
            for text in comment.text.split("\n"):
                self.line(depth, "#" + text)

    def legal(self, name: str) -> str:
        """A name of a node as VRML can say it."""
        if legal_name(name) or (self.native_names and _READABLE.fullmatch(name)):
            return name
        if name not in self.names:
            if not self.taken:
                self.taken = set(self.scene.defs())
            new = _ILLEGAL.sub("_", name)
            if not legal_name(new):
                new = "_" + new
            while new in self.taken:
                new += "_"
            self.taken.add(new)
            self.names[name] = new
            self.lose(f"name {name!r}, written as {new}")
        return self.names[name]

    def word(self, name: str, what: str) -> bool:
        """Whether a type or field can be written; notes the loss if not."""
        if legal_name(name) or (self.native_names and _READABLE.fullmatch(name)):
            return True
        self.lose(f"{what} {name!r}: VRML can't write such a name")
        return False

    def head(self) -> None:
        scene = self.scene
        if self.encoding == "wrl":
            self.lines.append("#VRML V2.0 utf8")
        else:
            version = scene.version if scene.encoding != "wrl" else "3.3"
            if not _VERSION.fullmatch(version):
                self.lose(f"version {version!r}, written as 3.3")
                version = "3.3"
            self.lines.append(f"#X3D V{version} utf8")
        rest = scene.header_comments
        if len(rest) == 1 and rest[0].line == 1 and self.native_names:
            self.lines[0] += " " + rest[0].text
        else:
            self.comments(rest, 0)
        if self.encoding == "wrl":
            for name, content in scene.metas:
                self.comments([Comment(f" META {quote(name)} {quote(content)}")], 0)
            for category, name, factor in scene.units:
                self.lose(f"UNIT {category} {name} {factor:g}: VRML97 has no units")
            return
        profile = scene.profile or ("Immersive" if scene.encoding != "x3dv" else "")
        if profile and self.word(profile, "PROFILE"):
            self.lines.append(f"PROFILE {profile}")
        for name, level in scene.components:
            if self.word(name, "COMPONENT"):
                self.lines.append(f"COMPONENT {name}:{level}")
        for category, name, factor in scene.units:
            if self.word(category, "UNIT") and self.word(name, "UNIT"):
                self.lines.append(f"UNIT {category} {name} {factor!r}")
        self.lines += [f"META {quote(name)} {quote(content)}" for name, content in scene.metas]

    def statements(self, body: list[Statement], outer: Mapping[str, Proto], depth: int) -> Step:
        protos = in_sight(outer, body)
        for statement in body:
            if isinstance(statement, Node | Use):
                yield self.node(statement, "", protos, depth)
            elif isinstance(statement, Proto):
                yield self.proto(statement, protos, depth)
            elif isinstance(statement, Comment):
                self.comments([statement], depth)
            elif isinstance(statement, Route):
                s = statement
                source, target = self.legal(s.from_node), self.legal(s.to_node)
                if self.word(s.from_field, "ROUTE from") and self.word(s.to_field, "ROUTE to"):
                    self.line(depth, f"ROUTE {source}.{s.from_field} TO {target}.{s.to_field}")
            elif self.encoding == "wrl":
                self.lose(f"{type(statement).__name__.upper()} {statement.name}: VRML97 has none")
            else:
                alias = f" AS {self.legal(statement.alias)}" if statement.alias else ""
                if isinstance(statement, Import):
                    self.line(depth, f"IMPORT {self.legal(statement.inline)}.{self.legal(statement.name)}{alias}")
                elif isinstance(statement, Export):
                    self.line(depth, f"EXPORT {self.legal(statement.name)}{alias}")

    def node(self, item: Node | Use, before: str, protos: Mapping[str, Proto], depth: int) -> Step:
        """A node after the text `before` on its first line."""
        node, name = self.resolve(item)
        if node is None:
            self.line(depth, f"{before}USE {self.legal(name)}")
            return
        if not self.word(node.type, "node"):
            if before:
                self.line(depth, f"{before}NULL")
            return
        foreign = self.encoding == "wrl" and self.scene.encoding != "wrl"
        if foreign and node.type not in protos and node.type not in VRML97_NODES and native(node.type):
            self.lose(f"{node.type} is no node of VRML97: kept, but VRML97 browsers don't know it")
        self.begin(node)
        head = f"DEF {self.legal(node.name)} {node.type}" if node.name else node.type
        self.line(depth, f"{before}{head} {{")
        start = len(self.lines)
        yield from self.contents(node, protos, depth + 1)
        if len(self.lines) == start:
            self.lines[-1] += " }"
        else:
            self.line(depth, "}")
        self.open.discard(id(node))

    def contents(self, node: Node, protos: Mapping[str, Proto], depth: int) -> Step:
        comments: dict[str, list[Comment]] = {}
        for name, comment in node.comments:
            comments.setdefault(name, []).append(comment)
        last = comments.pop("", [])
        own = {f.name for f in node.interface}
        inner = {}
        for name, outer in node.connects:
            if name in own:
                inner[name] = outer
        for field in node.interface:
            self.comments(comments.pop(field.name, []), depth)
            yield from self.own_field(field, inner.get(field.name, ""), protos, depth, True)
        for name, outer in node.connects:
            if name not in own and self.word(name, f"{node.type} field") and self.word(outer, "field"):
                self.comments(comments.pop(name, []), depth)
                self.line(depth, f"{self.name(node, name)} IS {outer}")
        fields = node.fields
        if node.text and node.type not in protos and "url" in fields_of(node.type):
            fields = self.with_source(node)
        elif node.text:
            self.lose(f"text inside {node.type}: {' '.join(node.text[:40].split())}")
        for name, value in fields.items():
            self.comments(comments.pop(name, []), depth)
            yield from self.field(node, name, value, protos, depth)
        for rest in comments.values():
            self.comments(rest, depth)
        self.comments(last, depth)

    def with_source(self, node: Node) -> dict[str, object]:
        """The fields of a Script whose program stands in XML character data: it becomes the last url."""
        url = node.fields.get("url")
        urls = parse(url, "MFString") if isinstance(url, Literal) else url or []
        return {**node.fields, "url": [*urls, node.text]}  # type: ignore[misc]

    def field(self, node: Node, key: str, value: object, protos: Mapping[str, Proto], depth: int) -> Step:
        if value is None or not self.word(key, f"{node.type} field"):
            return
        name = self.name(node, key)
        if isinstance(value, Node | Use):
            yield self.node(value, f"{name} ", protos, depth)
        elif isinstance(value, list) and (not value or isinstance(value[0], Node | Use | Comment)):
            kind = type_of(node, key, protos)
            if not value and kind not in ("MFNode", ""):
                if kind != "SFNode":
                    self.line(depth, f"{name} {text_of(value, kind, 'vrml')}")
            elif kind == "SFNode" and len(value) == 1 and not isinstance(value[0], Comment):
                yield self.node(value[0], f"{name} ", protos, depth)
            else:
                yield from self.nodes(name, value, protos, depth)
        else:
            text = self.text(node, key, value, protos)
            if text is not None:
                self.line(depth, f"{name} {text}")

    def nodes(self, name: str, value: list, protos: Mapping[str, Proto], depth: int) -> Step:
        if not value:
            self.line(depth, f"{name} [ ]")
            return
        self.line(depth, f"{name} [")
        for child in value:
            if isinstance(child, Comment):
                self.comments([child], depth + 1)
            else:
                yield self.node(child, "", protos, depth + 1)
        self.line(depth, "]")

    def own_field(
        self, own: ProtoField, connected: str, protos: Mapping[str, Proto], depth: int, with_value: bool
    ) -> Step:
        """One declaration of an interface, with its default unless it is an event or an EXTERNPROTO's."""
        self.comments(own.comments, depth)
        if not (self.word(own.name, "field") and self.word(own.type or "", f"type of {own.name}")):
            return
        access = own.access
        if access not in _WORDS_97:
            access = "inputOutput"
            self.lose(f"access {own.access!r} of field {own.name}, written as inputOutput")
        head = f"{_WORDS_97[access] if self.encoding == 'wrl' else access} {own.type} {own.name}"
        value = own.value
        if connected:
            self.line(depth, f"{head} IS {connected}")
        elif not with_value or access in ("inputOnly", "outputOnly"):
            self.line(depth, head)
        elif isinstance(value, Node | Use):
            if own.type == "MFNode":
                yield from self.nodes(head, [value], protos, depth)
            else:
                yield self.node(value, f"{head} ", protos, depth)
        elif isinstance(value, list) and (
            own.type.endswith("Node") or isinstance(next(iter(value), None), Node | Use | Comment)
        ):
            yield from self.nodes(head, value, protos, depth)
        else:
            text = None if value is None else self.typed(value, own.type, own.name)
            self.line(depth, f"{head} {default_of(own.type, 'vrml') if text is None else text}")

    def proto(self, proto: Proto, protos: Mapping[str, Proto], depth: int) -> Step:
        if not self.word(proto.name, "prototype"):
            return
        comments: dict[str, list[Comment]] = {}
        for name, comment in proto.comments:
            comments.setdefault(name, []).append(comment)
        last = comments.pop("", [])
        self.line(depth, f"{'EXTERNPROTO' if proto.external else 'PROTO'} {proto.name} [")
        for own in proto.interface:
            self.comments(comments.pop(own.name, []), depth + 1)
            yield from self.own_field(own, "", protos, depth + 1, not proto.external)
        for rest in comments.values():
            self.comments(rest, depth + 1)
        self.comments(last, depth + 1)
        if proto.url is not None:
            self.line(depth, f"] {self.typed(proto.url, 'MFString', proto.name + '.url') or '[ ]'}")
            return
        self.line(depth, "] {")
        self.scopes.append((set(), {}))
        yield from self.statements(proto.body, protos, depth + 1)
        self.scopes.pop()
        self.line(depth, "}")
