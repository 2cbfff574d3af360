"""VRML97 (ISO/IEC 14772-1) and Classic X3D (19776-2): one reader for both. The writer is in `vrml_writer`.

The parser needs no table of nodes: the syntax alone says what a value is, so unknown nodes and fields are read as well
as known ones. Statements inside nodes (ROUTE, PROTO) are kept beside the statement that holds them.
"""

from __future__ import annotations

import os
import re

from vitruvian.errors import FileError, warn
from vitruvian.formats.printer import Step, run
from vitruvian.formats.scopes import Scopes
from vitruvian.formats.source import LIMITS, Limits, decode, no_collection, read_bytes, refuse_crowds
from vitruvian.formats.vrml_lexer import Lexer
from vitruvian.formats.vrml_writer import write_vrml
from vitruvian.hanim.fields import ACCESS, native
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
from vitruvian.hanim.values import parse

__all__ = ["parse_vrml", "read_vrml", "write_vrml"]

_HEADER = re.compile(r"#(VRML|X3D) V([0-9]+\.[0-9]+) (utf8|ascii)[ \t]*([^\n]*)")
_COMPONENT = re.compile(r'([^\s:,#"\[\]{}]+)\s*:\s*([0-9]+)', re.ASCII)
_EMPTY_LIST = re.compile(r"\[(?:[\s,]++|#[^\n]*+)*+\]", re.ASCII)
_RESERVED = frozenset(("ROUTE", "PROTO", "EXTERNPROTO", "IMPORT", "EXPORT", *ACCESS))
_NESTED = ("ROUTE", "PROTO", "EXTERNPROTO", "IMPORT", "EXPORT")


def read_vrml(path: str | os.PathLike[str], *, limits: Limits = LIMITS) -> Scene:
    """The scene graph of a VRML97 or Classic X3D file (gzip too); its header says which.

    FileError with path and line when the file isn't one of them or is beyond the limits. Defects with one accepted
    meaning are warnings.
    """
    return parse_vrml(read_bytes(path, limits), path, limits=limits)


def parse_vrml(data: bytes, path: str | os.PathLike[str] = "", *, limits: Limits = LIMITS, assume: str = "") -> Scene:
    """As `read_vrml`, from bytes; `path` is for messages. `assume` is the header of a file that has no right one."""
    text = decode(path, data)
    header = _HEADER.match(text)
    start = header.end() if header else 0
    if header is None and assume:
        header = _HEADER.match(assume)
    if header is None:
        if text.lstrip().startswith("<"):
            raise FileError(path, 1, "is XML, not Classic X3D or VRML; name it .x3d")
        raise FileError(path, 1, "expected the header '#VRML V2.0 utf8' or '#X3D V3.3 utf8'")
    language, version, encoding, rest = header.groups()
    if language == "VRML" and (version != "2.0" or encoding != "utf8"):
        raise FileError(path, 1, f"VRML {version} is another language than VRML97; convert it to VRML97 first")
    scene = Scene(os.fspath(path), "wrl" if language == "VRML" else "x3dv", version)
    if rest.strip():
        scene.header_comments.append(Comment(rest.strip(), 1))
    refuse_crowds(path, text, "{", limits.nodes, "nodes")
    reader = _Reader(path, text, start, scene, limits)
    try:
        with no_collection():
            run(reader.statements(scene.body, ""))
    except FileError as failure:
        failure.partial = scene
        raise
    reader.scopes.finish()
    return scene


class _Body:
    """The statements of a scene or prototype that is being read."""

    __slots__ = ("items", "mark", "later")

    def __init__(self, items: list[Statement]):
        self.items = items
        self.mark = 0  # where the statement that is being read stands
        self.later: list[Statement] = []  # ROUTEs found inside it


class _Reader:
    def __init__(self, path: str | os.PathLike[str], text: str, start: int, scene: Scene, limits: Limits):
        self.path, self.scene, self.limits = path, scene, limits
        self.lexer = Lexer(path, text, start)
        self.scopes = Scopes(path, limits)
        self.bodies: list[_Body] = []
        self.sizes = [0]  # nodes below each open node, USEs expanded

    def comments(self) -> list[Comment]:
        """The comments that stand here."""
        found = []
        while (comment := self.lexer.comment()) is not None:
            self.scopes.count(comment[1])
            found.append(Comment(*comment))
        return found

    # Statements

    def statements(self, items: list[Statement], inside: str) -> Step:
        """Statements up to the end of the file or, `inside` a prototype, up to its closing brace."""
        lexer, body = self.lexer, _Body(items)
        self.bodies.append(body)
        opened = lexer.line()
        while True:
            items.extend(self.comments())
            place = lexer.place
            if lexer.at("}"):
                if not inside:
                    raise lexer.fail("a } that closes nothing", place)
                break
            if not lexer.peek():
                if inside:
                    raise lexer.fail(f"the file ends inside PROTO {inside} of line {opened}")
                break
            body.mark = len(items)
            word = lexer.word("a node or statement")
            if word in _NESTED:
                yield from self.nested(word)
            elif word in ("PROFILE", "COMPONENT", "META", "UNIT") and not inside:
                self.head(word)
            else:
                item, step = self.node(word)
                body.mark = len(items)
                items.append(item)
                if step is not None:
                    yield step
            items.extend(body.later)
            body.later = []
        self.bodies.pop()

    def nested(self, word: str) -> Step:
        """A statement that may stand inside nodes too."""
        lexer, body = self.lexer, self.bodies[-1]
        line = lexer.line()
        self.scopes.count(line)
        if word == "ROUTE":
            source = lexer.end("the source of the ROUTE")
            self.keyword("TO", "in a ROUTE")
            body.later.append(Route(*source, *lexer.end("the target of the ROUTE"), line))
        elif word == "IMPORT":
            inline, name = lexer.end("what is imported")
            body.later.append(Import(inline, name, self.alias(), line))
        elif word == "EXPORT":
            body.later.append(Export(lexer.name("what is exported"), self.alias(), line))
        else:
            proto = Proto(lexer.name("the name of a prototype"), line=line)
            body.items.insert(body.mark, proto)
            body.mark += 1
            yield from self.prototype(proto, word == "EXTERNPROTO")

    def keyword(self, word: str, where: str) -> None:
        found = self.lexer.name(f"{word} {where}")
        if found != word:
            raise self.lexer.fail(f"expected {word} {where}, found {found!r}")

    def alias(self) -> str:
        place = self.lexer.place
        self.lexer.skip()
        if self.is_next("AS"):
            return self.lexer.name("a name after AS")
        self.lexer.place = place
        return ""

    def is_next(self, word: str) -> bool:
        """Whether this word stands here; moves over it if so."""
        lexer = self.lexer
        end = lexer.place + len(word)
        if lexer.text.startswith(word, lexer.place) and lexer.text[end : end + 1] in "\n\t ,#":
            lexer.place = end
            return True
        return False

    def head(self, word: str) -> None:
        """PROFILE, COMPONENT, META, UNIT."""
        lexer, scene = self.lexer, self.scene
        if word == "PROFILE":
            scene.profile = lexer.name("the name of a profile")
        elif word == "META":
            scene.metas.append((self.string("the name of a META"), self.string("the content of a META")))
        elif word == "COMPONENT":
            lexer.skip()
            match = _COMPONENT.match(lexer.text, lexer.place)
            if match is None:
                raise lexer.fail(f"expected NAME:LEVEL after COMPONENT, found {lexer.found()}")
            lexer.place = match.end()
            scene.components.append((match[1], int(match[2][:9])))
        else:
            category, name, factor = (lexer.name(f"the {w} of a UNIT") for w in ("category", "name", "factor"))
            factor += "".join("." + lexer.name("digits") for _ in range(lexer.at(".")))
            scene.units.append((category, name, parse(Literal(factor, "vrml", lexer.line()), "SFDouble", self.path)))  # type: ignore[arg-type]

    def string(self, what: str) -> str:
        line = self.lexer.line()
        return parse(Literal(f'"{self.lexer.string(what)}"', "vrml", line), "SFString", self.path)  # type: ignore[return-value]

    def prototype(self, proto: Proto, external: bool) -> Step:
        lexer = self.lexer
        lexer.expect("[", f"after PROTO {proto.name}")
        while True:
            pending = self.comments()
            if lexer.at("]"):
                proto.comments.extend(("", c) for c in pending)
                break
            word = lexer.word("eventIn, eventOut, field, exposedField or ]")
            if word not in ACCESS:
                raise lexer.fail(f"expected eventIn, eventOut, field, exposedField or ], found {word!r}")
            own = self.own_field(word)
            proto.comments.extend((own.name, c) for c in pending)
            proto.interface.append(own)
            if not external and own.access in ("initializeOnly", "inputOutput"):
                proto.comments.extend((own.name, c) for c in self.comments())
                yield from self.own_value(own)
        if external:
            lexer.skip()
            line, text = lexer.line(), lexer.value()
            if text is None:
                raise lexer.fail(f"expected the url of EXTERNPROTO {proto.name}, found {lexer.found()}")
            proto.url = Literal(text, "vrml", line)
        else:
            lexer.expect("{", f"to begin the body of PROTO {proto.name}")
            self.scopes.enter(proto.name, proto.line)
            self.sizes.append(0)
            yield self.statements(proto.body, proto.name)
            self.sizes.pop()
            self.scopes.leave()
        self.scopes.declare(proto)

    # Nodes

    def node(self, word: str) -> tuple[Node | Use, Step | None]:
        """The node or USE that begins with this word, and the step that reads its inside."""
        lexer = self.lexer
        line = lexer.line()
        if word == "USE":
            name = lexer.name("a name after USE")
            target, size = self.scopes.use(name, line)
            self.scopes.count(line, 1)
            self.sizes[-1] += size
            return Use(name, target, line), None
        name = ""
        if word == "DEF":
            name = lexer.name("a name after DEF")
            word = lexer.name("the type of a node")
        if len(self.sizes) > self.limits.depth:
            raise lexer.fail(f"nodes are nested deeper than {self.limits.depth}")
        self.scopes.count(line, 1)
        node = Node(word, name, line=line)
        node.instance = self.scopes.instance(word, line, builtin=native(word)) is not None
        lexer.expect("{", f"after {word}")
        return node, self.inside(node)

    def inside(self, node: Node) -> Step:
        """What stands between a node's braces."""
        lexer = self.lexer
        self.scopes.begin(node)
        self.sizes.append(1)
        pending: list[Comment] = []
        fields, count = node.fields, self.scopes.count
        while True:
            simple = lexer.simple_field()
            if simple is not None:
                name, place, text = simple
                if name not in _RESERVED and name not in fields:
                    if pending:
                        node.comments.extend((name, c) for c in pending)
                        pending = []
                    line = lexer.line(place)
                    count(line)
                    fields[name] = Literal(text, "vrml", line)
                    lexer.place = place + len(text)
                    continue
            pending += self.comments()
            if lexer.at("}"):
                break
            if not lexer.peek():
                raise lexer.fail(f"the file ends inside {node.type} of line {node.line}")
            word = lexer.word("the name of a field or }")
            if word in _NESTED:
                yield from self.nested(word)
                continue
            if word in ACCESS:
                own = self.own_field(word)
                node.interface.append(own)
                name = own.name
            else:
                own, name = None, word
            self.scopes.count(lexer.line())
            pending += self.comments()
            node.comments.extend((name, c) for c in pending)
            pending = []
            if self.is_next("IS"):
                node.connects.append((name, lexer.name("a field of the prototype")))
            elif own is not None:
                if own.access in ("initializeOnly", "inputOutput"):
                    yield from self.own_value(own)
            else:
                yield from self.field(node, word)
        node.comments.extend(("", c) for c in pending)
        size = self.sizes.pop()
        self.scopes.end(node, size)
        self.sizes[-1] += size

    def own_field(self, word: str) -> ProtoField:
        """A declaration after its first word: type and name."""
        line = self.lexer.line()
        self.scopes.count(line)
        return ProtoField(ACCESS[word], self.lexer.name("a type"), self.lexer.name("the name of a field"), line=line)

    def own_value(self, own: ProtoField) -> Step:
        holder: dict[str, object] = {}
        yield from self.value(holder, "", own.type, own.name)
        own.value = holder[""]

    def field(self, node: Node, name: str) -> Step:
        before = node.fields.get(name)
        if before is not None:
            warn(f"{self.path}:{self.lexer.line()}: {node.type} gives {name} twice; the later value counts")
        kind = self.scopes.node_type(node, name) if self.lexer.peek() == "[" else ""
        yield from self.value(node.fields, name, kind, name)
        if isinstance(before, list) and isinstance(node.fields[name], list):
            node.fields[name] = [*before, *node.fields[name]]  # type: ignore[misc]

    def value(self, holder: dict[str, object], key: str, kind: str, name: str) -> Step:
        """A field's value: source text, a node or a list of nodes."""
        lexer = self.lexer
        place = lexer.place
        text = lexer.value()
        if text is not None:
            if kind == "MFNode" and _EMPTY_LIST.fullmatch(text):
                lexer.place = place + 1
                holder[key] = self.comments()
                lexer.at("]")
            else:
                holder[key] = Literal(text, "vrml", lexer.line(place))
            return
        if not lexer.at("["):
            if lexer.peek() in ("", "}", "]"):
                raise lexer.fail(f"expected the value of {name}, found {lexer.found()}")
            item, step = self.node(lexer.word(f"the value of {name}"))
            holder[key] = item
            if step is not None:
                yield step
            return
        items: list[object] = []
        holder[key] = items
        opened = lexer.line(place)
        while True:
            items.extend(self.comments())
            if lexer.at("]"):
                return
            if not lexer.peek():
                raise lexer.fail(f"the file ends inside the list of line {opened}")
            word = lexer.word("a node or ]")
            if word in _NESTED:
                yield from self.nested(word)
                continue
            item, step = self.node(word)
            items.append(item)
            if step is not None:
                yield step
