"""X3D JSON (ISO/IEC 19776-5): reader. The writer is in `x3d_json_writer`.

A node is {"Type": {...}}; "@field" is a value, "-field" holds nodes, "#comment" a comment, "#sourceText" a program.
Objects have no order in JSON, so a USE may stand before its DEF and a type's fields before its name; both are found.
Variants that are met in files are read too: a single object for a list of one, lists of one for single nodes, values as
XML would have them inside a string, nodes without the field they belong to, comments as a key of the node.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator

from vitruvian.errors import FileError, warn
from vitruvian.formats.json_tree import List, Object, Span, Tree, Value
from vitruvian.formats.printer import Step, run
from vitruvian.formats.scopes import Scopes, cut_early, put
from vitruvian.formats.source import LIMITS, Limits, decode, no_collection, read_bytes, refuse_crowds
from vitruvian.formats.x3d_json_pieces import Pieces
from vitruvian.formats.x3d_json_writer import write_json
from vitruvian.hanim.fields import placement
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

__all__ = ["parse_json", "read_json", "write_json"]

_STATEMENTS = ("ROUTE", "ProtoDeclare", "ExternProtoDeclare", "IMPORT", "EXPORT")
_SOURCE = ("#sourceText", "#sourceCode", "@sourceCode")
_IGNORED = ("encoding", "JSON schema", "$schema")


def read_json(path: str | os.PathLike[str], *, limits: Limits = LIMITS) -> Scene:
    """The scene graph of an X3D JSON file (gzip too).

    FileError with path and line when the file isn't JSON with an "X3D" object on top or is beyond the limits. Defects
    with one accepted meaning are warnings.
    """
    return parse_json(read_bytes(path, limits), path, limits=limits)


def parse_json(data: bytes, path: str | os.PathLike[str] = "", *, limits: Limits = LIMITS) -> Scene:
    """As `read_json`, from bytes; `path` is for messages."""
    text = decode(path, data)
    start = text[:200].lstrip()
    if start.startswith(("<", "#X3D", "#VRML")):
        kind = "XML; name it .x3d" if start[0] == "<" else "Classic X3D or VRML; name it .x3dv or .wrl"
        raise FileError(path, 1, f"is not JSON but {kind}")
    refuse_crowds(path, text, "{", limits.entries + 2 * limits.nodes, "objects")
    with no_collection(), warnings.catch_warnings():
        tree = Tree(path, text, limits=limits, partly=True)
        if (failure := tree.failure) is not None:
            warnings.simplefilter("ignore")  # what is read now is for whoever tells about the failure
        top = tree.top.items.get("X3D") if isinstance(tree.top, Object) else None
        reader = _Reader(tree, limits)
        try:
            if top is not None and isinstance(top[1], Object):
                reader.read(top[1])
            elif failure is None:
                found = (
                    f"the key {next(iter(tree.top.items), '(none)')!r}" if isinstance(tree.top, Object) else "no object"
                )
                raise FileError(path, 1, f'expected {{"X3D": {{...}}}} at the top, found {found}')
        except FileError as error:
            failure = failure or error
    if failure is not None:
        failure.partial = reader.scene
        raise failure
    return reader.scene


class _Body:
    """The statements of a scene or prototype that is being read."""

    __slots__ = ("items", "mark", "later", "waiting")

    def __init__(self, items: list[Statement]):
        self.items = items
        self.mark = 0  # where the statement that is being read stands
        self.later: list[Statement] = []  # ROUTEs found inside it
        self.waiting: list[tuple[Use, Node | None, str]] = []  # USEs without a DEF so far, the field they stand in


class _Reader(Pieces):
    def __init__(self, tree: Tree, limits: Limits):
        super().__init__(tree, Scopes(tree.path, limits), limits)
        self.scene = Scene(os.fspath(tree.path), "x3dj", "")  # type: ignore[call-overload]
        self.bodies: list[_Body] = []
        self.sizes = [0]  # nodes below each open node, USEs expanded
        self.tops: list[Node] = []  # nodes that no node holds
        self.places: dict[int, tuple[Node, Node, str]] = {}  # node -> itself, the node and field that hold it
        self.moved: set[tuple[int, str, str]] = set()  # node, field, field behind which that went
        self.dangling: list[Use] = []
        self.steps = 0

    # The file

    def read(self, top: Object) -> None:
        tree, scene = self.tree, self.scene
        scene.version, scene.profile = self.word(top, "@version"), self.word(top, "@profile")
        world: Value | None = None
        for key, (place, value) in top.items.items():
            if key == "#comment":
                scene.header_comments += self.comments(place, value)
            elif key == "head" and isinstance(value, Object):
                self.head(value)
            elif key.lower() == "scene":
                world = value
            elif key not in _IGNORED and key[:1] != "@":
                self.warn(place, f"{key[:60]} means nothing in X3D and is left out")
        if isinstance(world, Object):
            run(self.body(scene.body, world))
        elif world is not None and tree.string(world) != "null":
            raise tree.fail(world.start, f"expected the Scene to be an object, found {tree.found(world.start)}")
        if self.moved:
            self.dangling += cut_early(self.path, self.tops, self.limits)
        self.scopes.dangling = len(self.dangling)
        if self.dangling:
            self.scopes.first = (self.dangling[0].line, self.dangling[0].name)
        self.scopes.finish()

    def head(self, head: Object) -> None:
        scene = self.scene
        for key, (place, value) in head.items.items():
            if key == "#comment":
                scene.header_comments += self.comments(place, value)
                continue
            for entry in self.objects(key, value):
                self.scopes.count(self.tree.line(entry.start))
                if key == "meta":
                    scene.metas.append((self.word(entry, "@name"), self.word(entry, "@content")))
                elif key == "component":
                    scene.components.append((self.word(entry, "@name"), int(self.number(entry, "@level"))))
                elif key == "unit":
                    names = self.word(entry, "@category"), self.word(entry, "@name")
                    scene.units.append((*names, self.number(entry, "@conversionFactor")))
                elif "#comment" in entry.items:
                    scene.header_comments += self.comments(*entry.items["#comment"])
                else:
                    self.warn(place, f"{key[:60]} means nothing in the head and is left out")

    # Statements

    def body(self, items: list[Statement], holder: Object) -> Step:
        """Everything in a Scene or ProtoBody."""
        body = _Body(items)
        self.bodies.append(body)
        for key, (place, value) in holder.items.items():
            if key[:1] == "@":
                self.warn(place, f"{key[:60]} means nothing here and is left out")
                continue
            entries = self.entries(value) if key[:1] == "-" else self.entry(key, place, value)
            for name, where, content in entries:
                body.mark = len(items)
                if name == "#comment":
                    items.extend(self.comments(where, content))
                elif name in _STATEMENTS:
                    yield self.statement(name, where, content)
                else:
                    item, step = self.node(name, where, content)
                    items.append(item)
                    if isinstance(item, Node):
                        self.tops.append(item)
                    elif item.node is None:
                        body.waiting.append((item, None, ""))
                    if step is not None:
                        yield step
                items.extend(body.later)
                body.later = []
        self.bodies.pop()
        for use, owner, field in body.waiting:
            self.bind(use, owner, field)

    def bind(self, use: Use, owner: Node | None, field: str) -> None:
        """The DEF of a USE that has none before it: one in another field of a node around both, since the fields of an
        object have no order. That field goes first then."""
        target = self.scopes.names[-1].get(use.name)
        around: dict[int, str] = {}  # nodes around the USE -> the field on the way to it
        while owner is not None and target is not None:
            around[id(owner)] = field
            _, owner, field = self.places.get(id(owner), (None, None, ""))
            self.steps += 1
        node = target
        while node is not None and self.steps < self.limits.expansion:
            _, node, theirs = self.places.get(id(node), (None, None, ""))
            self.steps += 1
            if node is None or id(node) not in around:
                continue
            mine, fields = around[id(node)], node.fields
            names = list(fields)
            if mine == theirs or mine not in fields or theirs not in fields:
                break
            if (id(node), theirs, mine) in self.moved:
                break
            if names.index(mine) < names.index(theirs):
                names.remove(mine)
                names.insert(names.index(theirs) + 1, mine)
                node.fields = {name: fields[name] for name in names}
            self.moved.add((id(node), mine, theirs))
            use.node = target
            return
        self.dangling.append(use)

    def statement(self, name: str, place: int, value: Value) -> Step:
        """A statement that may stand inside nodes too: it is kept beside the statement that holds them."""
        body, line = self.bodies[-1], self.tree.line(place)
        if not isinstance(value, Object):
            raise self.tree.fail(place, f"expected {name} to be an object, found {self.tree.found(value.start)}")
        self.scopes.count(line)
        if name == "ROUTE":
            source = self.word(value, "@fromNode"), self.word(value, "@fromField")
            body.later.append(Route(*source, self.word(value, "@toNode"), self.word(value, "@toField"), line))
        elif name == "IMPORT":
            names = self.word(value, "@inlineDEF"), self.word(value, "@importedDEF")
            body.later.append(Import(*names, self.word(value, "@AS"), line))
        elif name == "EXPORT":
            body.later.append(Export(self.word(value, "@localDEF"), self.word(value, "@AS"), line))
        else:
            proto = Proto(self.word(value, "@name"), line=line)
            if not proto.name:
                raise self.tree.fail(place, f"{name} needs a name")
            body.items.insert(body.mark, proto)
            body.mark += 1
            yield from self.declaration(proto, value, name == "ExternProtoDeclare")

    def declaration(self, proto: Proto, holder: Object, external: bool) -> Step:
        if external:
            url = holder.items.get("@url")
            proto.url = Literal("", "json", proto.line) if url is None else self.literal("@url", *url)
        body: Object | None = None
        parts = [holder]
        for key, (place, value) in holder.items.items():
            if key == "ProtoInterface" and isinstance(value, Object):
                parts.append(value)
            elif key == "ProtoBody" and isinstance(value, Object):
                body = value
            elif key[:1] == "@":
                if key not in ("@name", "@url"):
                    proto.extra[key[1:]] = self.word(holder, key)
            elif key not in ("field", "-children", "#comment"):
                self.warn(place, f"{key[:60]} means nothing in a prototype and is left out")
        for part in parts:
            yield from self.interface(part, proto.interface, proto.comments)
        if body is not None and not external:
            self.scopes.enter(proto.name, proto.line)
            self.sizes.append(0)
            yield self.body(proto.body, body)
            self.sizes.pop()
            self.scopes.leave()
        self.scopes.declare(proto)

    def interface(self, part: Object, fields: list[ProtoField], comments: list[tuple[str, Comment]]) -> Step:
        """The fields of a declaration, with the comments before each."""
        pending: list[Comment] = []
        for key, (place, value) in part.items.items():
            if key == "#comment":
                pending += self.comments(place, value)
            elif key == "-children":
                pending += [c for n, p, v in self.entries(value) if n == "#comment" for c in self.comments(p, v)]
            elif key == "field":
                for entry in self.objects(key, value):
                    if "#comment" in entry.items and len(entry.items) == 1:
                        pending += self.comments(*entry.items["#comment"])
                        continue
                    own = ProtoField("", "", "", line=self.tree.line(entry.start))
                    fields.append(own)
                    yield from self.own_field(own, entry)
                    comments.extend((own.name, c) for c in pending)
                    pending = []
        comments.extend(("", c) for c in pending)

    def own_field(self, own: ProtoField, entry: Object) -> Step:
        """One line of an interface: its default stands in "@value" or, if nodes, in "-children"."""
        self.scopes.count(own.line)
        own.access, own.type, own.name = (self.word(entry, k) for k in ("@accessType", "@type", "@name"))
        for key, (place, value) in entry.items.items():
            if key == "@value":
                own.value = self.literal(key, place, value)
            elif key[:1] == "@":
                if key not in ("@accessType", "@type", "@name"):
                    own.extra[key[1:]] = self.word(entry, key)
            elif key == "#comment":
                own.comments += self.comments(place, value)
            else:
                holder: dict[str, object] = {}
                yield from self.nodes(holder, own.type, own.comments, key, place, value, None, "")
                own.value = holder.get("", own.value)
                found = own.value if isinstance(own.value, list) else [own.value]
                self.tops += [n for n in found if isinstance(n, Node)]

    def nodes(
        self,
        holder: dict[str, object],
        kind: str,
        comments: list[Comment],
        key: str,
        place: int,
        value: Value,
        owner: Node | None,
        field: str,
    ) -> Step:
        """Nodes as the value of a field that is declared or given by name; into holder[""], their comments apart."""
        if key[:1] == "-" and isinstance(value, Span):
            if self.tree.string(value) != "null":
                raise self.tree.fail(place, f"expected nodes in {key[:60]}, found {self.tree.found(value.start)}")
            holder[""] = Literal("null", "json", self.tree.line(place))
            return
        if kind == "MFNode":
            holder.setdefault("", [])
        for name, where, content in self.entries(value) if key[:1] == "-" else self.entry(key, place, value):
            if name == "#comment":
                comments += self.comments(where, content)
            elif name in _STATEMENTS:
                yield self.statement(name, where, content)
            else:
                item, step = self.node(name, where, content)
                put(holder, "", item, kind)
                self.placed(item, owner, field)
                if step is not None:
                    yield step

    # Nodes

    def node(self, type: str, place: int, content: Value) -> tuple[Node | Use, Step | None]:
        """The node or USE of an entry, and the step that reads its inside."""
        line = self.tree.line(place)
        if not isinstance(content, Object):
            if self.tree.string(content) != "null":
                found = self.tree.found(content.start)
                raise self.tree.fail(place, f"expected the fields of {type[:60]} in an object, found {found}")
            content = Object(place)
        if "@USE" in content.items:
            if "@DEF" in content.items:
                self.warn(place, f"{type[:60]} has DEF and USE; the USE counts")
            name = self.word(content, "@USE")
            target, size = self.scopes.use(name, line)
            use = Use(name, target, line, "", type)
            self.scopes.count(line, 1)
            self.sizes[-1] += size
            return use, None
        if len(self.sizes) > self.limits.depth:
            raise self.tree.fail(place, f"nodes are nested deeper than {self.limits.depth}")
        node = Node(type, self.word(content, "@DEF"), line=line, instance=type == "ProtoInstance")
        if node.instance:
            node.type = self.word(content, "@name")
            if not node.type:
                raise self.tree.fail(place, "ProtoInstance needs the name of a prototype")
            self.scopes.instance(node.type, line)
        self.scopes.count(line, 1, 1 + len(content.items))
        return node, self.inside(node, content)

    def inside(self, node: Node, content: Object) -> Step:
        """The fields of a node."""
        self.scopes.begin(node)
        self.sizes.append(1)
        fields, tree = node.fields, self.tree
        pending: list[Comment] = []
        skipped = {"@DEF", "@USE", "@containerField", "@name" if node.instance else ""}
        for key, (place, value) in content.items.items():
            if key in skipped:
                continue
            sign, name = key[:1], key[1:]
            if key in _SOURCE:
                node.text = "\n".join(tree.strings(value))
            elif key == "#comment":
                pending += self.comments(place, value)
            elif sign == "@":
                fields[name] = self.literal(key, place, value)
                pending = self.comment_on(node, name, pending)
            elif sign == "-":
                pending = self.comment_on(node, name, pending) if name != "children" else pending
                yield from self.children(node, name, place, value, pending)
            elif key == "field" and not node.instance:
                before = len(node.interface)
                yield from self.interface(Object(place, {key: (place, value)}), node.interface, node.comments)
                if len(node.interface) > before:
                    pending = self.comment_on(node, node.interface[before].name, pending)
            elif key == "fieldValue":
                first = next((self.word(e, "@name") for e in self.objects(key, value)), "")
                pending = self.comment_on(node, first, pending)
                for entry in self.objects(key, value):
                    yield from self.field_value(node, entry)
            elif key == "IS":
                for part in self.objects(key, value):
                    for each in self.objects("IS", part.items.get("connect", (0, List(0)))[1]):
                        self.scopes.count(node.line)
                        node.connects.append((self.word(each, "@nodeField"), self.word(each, "@protoField")))
            elif isinstance(value, Span) or sign in ("#", ""):
                self.warn(place, f"{key[:60] or '(no name)'} means nothing in {node.type} and is left out")
            else:  # a node without its field, as an element stands in XML
                yield from self.loose(node, "", place, self.entry(key, place, value), [])
        node.comments.extend(("", c) for c in pending)
        size = self.sizes.pop()
        self.scopes.end(node, size)
        self.sizes[-1] += size

    def comment_on(self, node: Node, name: str, pending: list[Comment]) -> list[Comment]:
        """Comments belong to the field that comes after them."""
        node.comments.extend((name, c) for c in pending)
        return []

    def children(self, node: Node, name: str, place: int, value: Value, pending: list[Comment]) -> Step:
        """The nodes of a field. Comments alone in "-children" of a node without such a field stay `pending`."""
        fields, kind = node.fields, self.scopes.node_type(node, name)
        if node.instance and name == "children":  # a prototype's field of that name would be a fieldValue
            kind = ""
        if isinstance(value, Span):
            if self.tree.string(value) != "null":
                raise self.tree.fail(place, f"expected nodes in -{name[:60]}, found {self.tree.found(value.start)}")
            fields[name] = Literal("null", "json", self.tree.line(place))
            return
        items: list[Node | Use | Comment] = []
        yield from self.loose(node, name, place, self.entries(value), items)
        found = [v for v in items if not isinstance(v, Comment)]
        remarks = [v for v in items if isinstance(v, Comment)]
        if name == "children" and not found and kind != "MFNode" and (remarks or pending):
            pending += remarks
        elif name in fields:  # by "@name", by a fieldValue, or by nodes that name it themselves
            self.warn(place, f"{node.type} gives {name[:60]} twice; the later nodes count")
            fields[name] = [*pending, *items]
            pending.clear()
        elif (
            kind == "SFNode" and len(found) == 1 or (kind != "MFNode" and isinstance(value, Object) and len(found) == 1)
        ):
            fields[name] = found[0]
            node.comments.extend((name, c) for c in [*pending, *remarks])
            pending.clear()
        elif not found and not remarks and kind == "SFNode":
            fields[name] = Literal("null", "json", self.tree.line(place))
        else:
            fields[name] = [*pending, *items]
            pending.clear()

    def loose(
        self,
        node: Node,
        name: str,
        place: int,
        entries: Iterator[tuple[str, int, Value]],
        items: list[Node | Use | Comment],
    ) -> Step:
        """Entries into `items`, or into the field that they name themselves or, when there is none, belong to."""
        for type, where, content in entries:
            if type == "#comment":
                items += self.comments(where, content)
                continue
            if type in _STATEMENTS:
                yield self.statement(type, where, content)
                continue
            item, step = self.node(type, where, content)
            target = self.word(content, "@containerField") if isinstance(content, Object) else ""
            target = target or name or placement(node.type, type, isinstance(item, Use))
            self.placed(item, node, target)
            if target == name:
                items.append(item)
            else:
                put(node.fields, target, item, self.scopes.node_type(node, target))
            if step is not None:
                yield step

    def placed(self, item: Node | Use, owner: Node | None, field: str) -> None:
        if isinstance(item, Node):
            if owner is not None:
                self.places[id(item)] = item, owner, field
        elif item.node is None:
            self.bodies[-1].waiting.append((item, owner, field))

    def field_value(self, node: Node, entry: Object) -> Step:
        """A value that an instance gives to a field of its prototype."""
        name, line = self.word(entry, "@name"), self.tree.line(entry.start)
        self.scopes.count(line)
        holder: dict[str, object] = {}
        comments: list[Comment] = []
        kind = self.scopes.node_type(node, name)
        for key, (place, value) in entry.items.items():
            if key == "@value":
                holder[""] = self.literal(key, place, value)
            elif key == "#comment":
                comments += self.comments(place, value)
            elif key[:1] != "@":
                inside = holder.get("")
                if kind == "MFNode" and not isinstance(inside, list):
                    inside = holder[""] = []
                remarks = inside if isinstance(inside, list) and kind == "MFNode" else comments
                yield from self.nodes(holder, kind, remarks, key, place, value, node, name)
        if name in node.fields:
            warn(f"{self.path}:{line}: {node.type} gives {name} twice; the later value counts")
        node.fields[name] = holder.get("", [] if kind == "MFNode" else Literal("", "json", line))
        node.comments.extend((name, c) for c in comments)
