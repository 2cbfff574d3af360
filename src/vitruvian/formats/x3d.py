"""X3D XML (ISO/IEC 19776-1), versions 3.0 to 4.0: reader. The writer is in `x3d_writer`.

The parser is expat with every road to the outside closed: no entity may be declared, a DOCTYPE is read over and never
fetched, nothing is expanded. Everything in the file ends up in the graph: unknown elements and attributes, comments,
prototypes, character data.
"""

from __future__ import annotations

import os
from xml.parsers import expat

from vitruvian.errors import FileError, warn
from vitruvian.formats.scopes import Scopes, put
from vitruvian.formats.source import LIMITS, Limits, no_collection, read_bytes, refuse_crowds
from vitruvian.formats.x3d_writer import write_x3d
from vitruvian.hanim.fields import placement
from vitruvian.hanim.graph import Comment, Export, Import, Literal, Node, Proto, ProtoField, Route, Scene, Use

__all__ = ["parse_x3d", "read_x3d", "write_x3d"]

# What an open element is. Nodes may stand in the first four.
_BODY, _NODE, _FIELD, _VALUE, _PROTO, _INTERFACE, _IS, _HEAD, _ROOT, _LEAF = range(10)


def read_x3d(path: str | os.PathLike[str], *, limits: Limits = LIMITS) -> Scene:
    """The scene graph of an X3D XML file (gzip too).

    FileError with path and line when the file isn't well-formed X3D or beyond the limits. Defects with one accepted
    meaning are warnings.
    """
    return parse_x3d(read_bytes(path, limits), path, limits=limits)


def parse_x3d(data: bytes, path: str | os.PathLike[str] = "", *, limits: Limits = LIMITS) -> Scene:
    """As `read_x3d`, from bytes; `path` is for messages."""
    start = data[:200].lstrip(b"\xef\xbb\xbf \t\r\n")
    if start.startswith((b"#X3D", b"#VRML")):
        raise FileError(path, 1, "is Classic X3D or VRML, not XML; name it .x3dv or .wrl")
    refuse_crowds(path, data, b"<", 2 * limits.entries, "XML tags")  # a tag that opens, one that closes
    reader = _Reader(path, limits)
    try:
        with no_collection():
            reader.expat.Parse(data, True)
    except expat.ExpatError as error:
        what = expat.errors.messages.get(error.code, str(error))
        failure = FileError(path, error.lineno, reader.broken(what))
        failure.partial = reader.scene
        raise failure from None
    except FileError as failure:
        failure.partial = reader.scene
        raise
    except (LookupError, ValueError) as error:  # an encoding that nobody knows
        raise FileError(path, 1, f"can't be decoded: {error}") from None
    reader.scopes.finish()
    return reader.scene


class _Open:
    """An element that is being read. `item` is what it makes, `parent` the node it belongs to."""

    __slots__ = (
        "kind",
        "item",
        "name",
        "type",
        "pending",
        "text",
        "cdata",
        "order",
        "mixed",
        "size",
        "mark",
        "later",
        "line",
    )

    def __init__(self, kind: int, item: object, name: str = "", type: str = "", line: int = 0):
        self.kind, self.item, self.name, self.type, self.line = kind, item, name, type, line
        self.pending: list[Comment] = []
        self.text: list[str] = []
        self.cdata = self.mixed = False
        self.order: list[str] = []
        self.size = 1
        # In a body: where the statement that is being read stands, and the ROUTEs found inside it.
        self.mark = 0
        self.later: list[Route | Import | Export] = []


class _Reader:
    def __init__(self, path: str | os.PathLike[str], limits: Limits):
        self.path = path
        self.limits = limits
        self.scene = Scene(path=os.fspath(path), encoding="x3d", version="")
        self.scopes = Scopes(path, limits)
        self.stack: list[_Open] = []
        self.tags: list[tuple[str, int]] = []
        self.in_cdata = False
        parser = self.expat = expat.ParserCreate()
        parser.buffer_text = True
        parser.buffer_size = 1 << 16
        parser.StartElementHandler = self.start
        parser.EndElementHandler = self.end
        parser.CommentHandler = self.comment
        parser.CharacterDataHandler = self.characters
        parser.StartCdataSectionHandler = self.cdata_start
        parser.EndCdataSectionHandler = self.cdata_end
        parser.EntityDeclHandler = self.entity
        parser.AttlistDeclHandler = self.attributes
        parser.SkippedEntityHandler = self.skipped
        self.statements = {
            "ROUTE": self.route,
            "ProtoDeclare": self.declaration,
            "ExternProtoDeclare": self.declaration,
            "ProtoInstance": self.instance,
            "IMPORT": self.import_,
            "EXPORT": self.export,
        }

    def fail(self, what: str) -> FileError:
        return FileError(self.path, self.expat.CurrentLineNumber, what)

    def broken(self, what: str) -> str:
        if what == "no element found" and self.tags:
            tag, line = self.tags[-1]
            return f"the file ends inside <{tag}> of line {line}"
        if what == "no element found":
            return "holds no XML"
        return f"is not well-formed XML: {what}"

    # What must not be in a file

    def entity(self, name: str, *_: object) -> None:
        raise self.fail(f"declares the entity {name}; entity declarations are refused")

    def attributes(self, *_: object) -> None:
        raise self.fail("declares attribute defaults; declarations inside a file are refused")

    def skipped(self, name: str, *_: object) -> None:
        raise self.fail(f"uses the entity &{name};, which nothing declares")

    # Elements

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        stack = self.stack
        line = self.expat.CurrentLineNumber
        self.tags.append((tag, line))
        if len(stack) > self.limits.depth:
            raise self.fail(f"elements are nested deeper than {self.limits.depth}")
        if not stack:
            if tag.lower() != "x3d":
                raise self.fail(f"expected the root element X3D, found {tag}")
            self.scene.version = attributes.get("version", "")
            self.scene.profile = attributes.get("profile", "")
            stack.append(_Open(_ROOT, self.scene))
            return
        top = stack[-1]
        kind = top.kind
        if kind <= _VALUE:
            statement = self.statements.get(tag)
            if statement is not None:
                statement(top, tag, attributes, line)
            elif kind == _NODE and tag in ("IS", "field", "fieldValue"):
                self.part(top, tag, attributes, line)
            else:
                self.node(top, tag, attributes, line)
        else:
            self.structure(top, tag, attributes, line)

    def structure(self, top: _Open, tag: str, attributes: dict[str, str], line: int) -> None:
        """Elements where no node may stand: the head, interfaces, connections."""
        kind, scene, item = top.kind, self.scene, top.item
        opened = _Open(_LEAF, None, line=line)
        if kind == _ROOT and tag.lower() == "scene":
            opened = _Open(_BODY, scene.body, line=line)
        elif kind == _ROOT and tag == "head":
            opened = _Open(_HEAD, None)
        elif kind == _HEAD and tag == "meta":
            scene.metas.append((attributes.get("name", ""), attributes.get("content", "")))
        elif kind == _HEAD and tag == "component":
            scene.components.append((attributes.get("name", ""), int(self.number(attributes.get("level", "1"), int))))
        elif kind == _HEAD and tag == "unit":
            factor = self.number(attributes.get("conversionFactor", "1"), float)
            scene.units.append((attributes.get("category", ""), attributes.get("name", ""), factor))
        elif kind == _PROTO and tag == "ProtoInterface":
            opened = _Open(_INTERFACE, item)
        elif kind == _PROTO and tag == "ProtoBody":
            assert isinstance(item, Proto)
            self.flush(top, item.comments, "")
            self.scopes.enter(item.name, line)
            opened = _Open(_BODY, item.body, item.name, line=line)
        elif kind in (_INTERFACE, _PROTO) and tag == "field":
            assert isinstance(item, Proto)
            own = self.own_field(attributes, line)
            self.flush(top, item.comments, own.name)
            item.interface.append(own)
            opened = _Open(_FIELD, own, own.name, own.type)
        elif kind == _IS and tag == "connect":
            assert isinstance(item, Node)
            item.connects.append((attributes.get("nodeField", ""), attributes.get("protoField", "")))
        elif kind != _LEAF:
            warn(f"{self.path}:{line}: <{tag}> means nothing here and is left out")
        self.scopes.count(line)
        self.stack.append(opened)

    def node(self, top: _Open, tag: str, attributes: dict[str, str], line: int, instance: bool = False) -> None:
        container = attributes.pop("containerField", "") if "containerField" in attributes else ""
        if "USE" in attributes:
            self.use(top, tag, attributes, line, container, instance)
            return
        name = attributes.pop("DEF") if "DEF" in attributes else ""
        if instance:
            type = attributes.pop("name", "")
            if not type:
                raise self.fail("ProtoInstance needs the name of a prototype")
            self.scopes.instance(type, line)
        else:
            type = tag
        node = Node(type, name, {key: Literal(text, "xml", line) for key, text in attributes.items()}, line, container)
        node.instance = instance
        self.scopes.count(line, 1, 1 + len(attributes))
        self.attach(top, node, container or placement(getattr(top.item, "type", ""), tag, False))
        self.scopes.begin(node)
        self.stack.append(_Open(_NODE, node, line=line))

    def use(self, top: _Open, tag: str, attributes: dict[str, str], line: int, container: str, instance: bool) -> None:
        if "DEF" in attributes:
            warn(f"{self.path}:{line}: <{tag}> has DEF and USE; the USE counts")
        target, size = self.scopes.use(attributes["USE"], line)
        use = Use(attributes["USE"], target, line, container, tag)
        self.scopes.count(line, 1)
        top.size += size
        self.attach(top, use, container or placement(getattr(top.item, "type", ""), tag, True))
        self.stack.append(_Open(_LEAF, None, line=line))

    def attach(self, top: _Open, item: Node | Use, field: str) -> None:
        """Put a node where it belongs in what is open, with the comments before it."""
        kind, pending = top.kind, top.pending
        if kind == _BODY:
            body: list = top.item  # type: ignore[assignment]
            if pending or top.later:
                self.flush_body(top)
            top.mark = len(body)
            body.append(item)
            return
        if kind == _FIELD:
            own: ProtoField = top.item  # type: ignore[assignment]
            holder = {} if own.value is None or isinstance(own.value, Literal) else {"": own.value}
            put(holder, "", item, top.type)
            own.value = holder[""]
            return
        node: Node = top.item  # type: ignore[assignment]
        if kind == _VALUE:
            field = top.name
        elif top.order and top.order[-1] != field and isinstance(node.fields.get(field), list | Node | Use):
            top.mixed = True
        if kind == _NODE:
            top.order.append(field)
        several = put(node.fields, field, item, self.scopes.node_type(node, field))
        if pending:
            if several is not None:
                several[-1:] = [*pending, item]
            else:
                node.comments.extend((field, c) for c in pending)
            top.pending = []

    def part(self, top: _Open, tag: str, attributes: dict[str, str], line: int) -> None:
        """What belongs to a node but is no node: IS, a Script's field, an instance's fieldValue."""
        node: Node = top.item  # type: ignore[assignment]
        self.scopes.count(line)
        if tag == "IS":
            self.stack.append(_Open(_IS, node, line=line))
        elif tag == "field":
            own = self.own_field(attributes, line)
            self.flush(top, node.comments, own.name)
            node.interface.append(own)
            self.stack.append(_Open(_FIELD, own, own.name, own.type))
        else:
            name = attributes.get("name", "")
            self.flush(top, node.comments, name)
            if "value" in attributes:
                node.fields[name] = Literal(attributes["value"], "xml", line)
            elif self.scopes.node_type(node, name) == "MFNode":
                node.fields.setdefault(name, [])
            self.stack.append(_Open(_VALUE, node, name, line=line))

    def own_field(self, attributes: dict[str, str], line: int) -> ProtoField:
        take = attributes.pop
        own = ProtoField(take("accessType", ""), take("type", ""), take("name", ""), line=line)
        if "value" in attributes:
            own.value = Literal(take("value"), "xml", line)
        own.extra = attributes
        return own

    def instance(self, top: _Open, tag: str, attributes: dict[str, str], line: int) -> None:
        self.node(top, tag, attributes, line, instance=True)

    def route(self, top: _Open, tag: str, attributes: dict[str, str], line: int) -> None:
        get = attributes.get
        self.statement(Route(get("fromNode", ""), get("fromField", ""), get("toNode", ""), get("toField", ""), line))

    def import_(self, top: _Open, tag: str, attributes: dict[str, str], line: int) -> None:
        get = attributes.get
        self.statement(Import(get("inlineDEF", ""), get("importedDEF", ""), get("AS", ""), line))

    def export(self, top: _Open, tag: str, attributes: dict[str, str], line: int) -> None:
        self.statement(Export(attributes.get("localDEF", ""), attributes.get("AS", ""), line))

    def statement(self, item: Route | Import | Export) -> None:
        """Statements may stand inside nodes; they are kept after the statement that holds them."""
        body = next(o for o in reversed(self.stack) if o.kind == _BODY)
        self.scopes.count(item.line)
        if body is self.stack[-1]:
            self.flush_body(body)
            body.item.append(item)  # type: ignore[attr-defined]
        else:
            body.later.append(item)
        self.stack.append(_Open(_LEAF, None, line=item.line))

    def declaration(self, top: _Open, tag: str, attributes: dict[str, str], line: int) -> None:
        proto = Proto(attributes.pop("name", ""), line=line)
        if not proto.name:
            raise self.fail(f"{tag} needs a name")
        if tag == "ExternProtoDeclare":
            proto.url = Literal(attributes.pop("url", ""), "xml", line)
        proto.extra = attributes
        self.scopes.count(line)
        body = next(o for o in reversed(self.stack) if o.kind == _BODY)
        statements: list = body.item  # type: ignore[assignment]
        if body is top:
            self.flush_body(body)
            statements.append(proto)
        else:  # inside a node: it is declared before the statement that holds it
            statements.insert(body.mark, proto)
            body.mark += 1
        self.stack.append(_Open(_PROTO, proto, line=line))

    def end(self, tag: str) -> None:
        self.tags.pop()
        top = self.stack.pop()
        kind = top.kind
        if kind == _NODE:
            node: Node = top.item  # type: ignore[assignment]
            if top.pending:
                node.comments.extend(("", c) for c in top.pending)
            if top.text:
                text = "".join(top.text)
                node.text = "" if text.isspace() and not top.cdata else text
            if top.mixed:
                node.order = top.order
            self.scopes.end(node, top.size)
            self.stack[-1].size += top.size
        elif kind == _BODY:
            self.flush_body(top)
            if self.scopes.bodies and top.item is not self.scene.body:
                self.scopes.leave()
        elif kind == _PROTO:
            proto: Proto = top.item  # type: ignore[assignment]
            self.flush(top, proto.comments, "")
            self.scopes.declare(proto)
        elif kind == _INTERFACE:
            self.flush(top, top.item.comments, "")  # type: ignore[attr-defined]
        elif kind == _FIELD:
            top.item.comments.extend(top.pending)  # type: ignore[attr-defined]
            self.stack[-1].size += top.size - 1
        elif kind == _VALUE:
            if isinstance(top.item, Node):
                top.item.fields.setdefault(top.name, Literal("", "xml", top.line))
            self.flush(top, top.item.comments, "")  # type: ignore[attr-defined]
            self.stack[-1].size += top.size - 1
        elif top.pending and self.stack:
            self.stack[-1].pending.extend(top.pending)

    def flush(self, top: _Open, comments: list[tuple[str, Comment]], name: str) -> None:
        if top.pending:
            comments.extend((name, c) for c in top.pending)
            top.pending = []

    def flush_body(self, body: _Open) -> None:
        if body.later:
            body.item.extend(body.later)  # type: ignore[attr-defined]
            body.later = []
        if body.pending:
            body.item.extend(body.pending)  # type: ignore[attr-defined]
            body.pending = []

    def number(self, text: str, kind: type) -> int | float:
        try:
            return kind(text)
        except ValueError:
            raise self.fail(f"expected a number, found {text[:40]!r}") from None

    # Text

    def comment(self, text: str) -> None:
        line = self.expat.CurrentLineNumber
        self.scopes.count(line)
        comment = Comment(text, line)
        if not self.stack or self.stack[-1].kind in (_ROOT, _HEAD):
            self.scene.header_comments.append(comment)
        else:
            self.stack[-1].pending.append(comment)

    def characters(self, text: str) -> None:
        if not self.stack:
            return
        top = self.stack[-1]
        if top.kind == _NODE:
            if not self.in_cdata and not top.text and text.isspace():
                return
            if self.in_cdata and not top.cdata:
                top.cdata, top.text = True, []
            if self.in_cdata or not top.cdata:
                top.text.append(text)
        elif not text.isspace():
            warn(f"{self.path}:{self.expat.CurrentLineNumber}: text outside of nodes is left out")

    def cdata_start(self) -> None:
        self.in_cdata = True

    def cdata_end(self) -> None:
        self.in_cdata = False
