"""Where two scenes differ: exactly (a round trip in one encoding) or by what they mean (between encodings)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vitruvian.errors import FileError
from vitruvian.hanim.fields import fields_of, type_of
from vitruvian.hanim.graph import Comment, Export, Import, Literal, Node, Proto, ProtoField, Route, Scene, Use
from vitruvian.hanim.json_values import number
from vitruvian.hanim.values import bare, default_of, is_null, parse, text_of, translate

_Pair = tuple[str, object, object, Mapping[str, Proto]]
_RENAMED = {("Switch", "choice"): "children", ("LOD", "level"): "children", ("Collision", "collide"): "enabled"}


def same(a: Scene, b: Scene, *, typed: bool = False) -> bool:
    """Whether `difference` finds nothing."""
    return not difference(a, b, typed=typed)


def difference(a: Scene, b: Scene, *, typed: bool = False) -> str:
    """The first difference of two scenes as one line, "" when there is none. Lines of the file don't count.

    Exact: types, names, fields and their order, source text, comments, containers. `typed`: values as their types say,
    floats as float32; a missing field equals an empty one; comments, order of fields and ways of writing don't count.
    """
    for what in ("version", "profile", "components", "metas", "units"):
        if not typed and getattr(a, what) != getattr(b, what):
            return f"{what}: {getattr(a, what)!r} is not {getattr(b, what)!r}"
    if not typed:
        found = _shallow("head", a.header_comments, b.header_comments, {}, False)
        if isinstance(found, str):
            return found
    stack: list[_Pair] = [("scene", a.body, b.body, {})]
    while stack:
        where, x, y, protos = stack.pop()
        found = _shallow(where, x, y, protos, typed)
        if isinstance(found, str):
            return found
        stack.extend(reversed(found))
    return ""


def _shallow(where: str, x: object, y: object, protos: Mapping[str, Proto], typed: bool) -> str | list[_Pair]:
    """A difference, or the parts that are left to compare."""
    if isinstance(x, list) and isinstance(y, list) and _graph(x) and _graph(y):
        if typed:
            x, y = ([v for v in z if not isinstance(v, Comment)] for z in (x, y))
            if where == "scene":
                x, y = ([v for v in z if not isinstance(v, Import | Export)] for z in (x, y))
        if len(x) != len(y):
            return f"{where}: {len(x)} entries, not {len(y)}"
        inner = {**protos, **{v.name: v for v in x if isinstance(v, Proto)}}
        return [(f"{where}[{i}]", v, w, inner) for i, (v, w) in enumerate(zip(x, y, strict=True))]
    if type(x) is not type(y):
        return f"{where}: {_name(x)} is not {_name(y)}"
    if isinstance(x, Node) and isinstance(y, Node):
        return _nodes(f"{where} {x.type} {x.name}".rstrip(), x, y, protos, typed)
    if isinstance(x, Use) and isinstance(y, Use):
        names = ["name"] if typed else ["name", "container", "type"]
        found = _attributes(where, x, y, names)
        if not found and (x.node is None) != (y.node is None):
            found = f"{where}: USE {x.name} dangles in one only"
        return found or []
    if isinstance(x, Proto) and isinstance(y, Proto):
        found = _attributes(where, x, y, ["name"] if typed else ["name", "extra"])
        if not found and len(x.interface) != len(y.interface):
            found = f"{where} PROTO {x.name}: {len(x.interface)} fields, not {len(y.interface)}"
        found = found or ("" if typed else _comments(where, x.comments, y.comments))
        found = found or _values(f"{where}.url", x.url, y.url, "MFString", typed)
        pairs: list[_Pair] = [(f"{where}.{f.name}", f, g, protos) for f, g in zip(x.interface, y.interface)]
        return found or [*pairs, (f"{where}.body", x.body, y.body, protos)]
    if isinstance(x, ProtoField) and isinstance(y, ProtoField):
        found = _attributes(where, x, y, ["access", "type", "name"] if typed else ["access", "type", "name", "extra"])
        if not typed:
            found = found or _comments(where, [("", c) for c in x.comments], [("", c) for c in y.comments])
        one, other = x.value, y.value
        if typed:  # no value means the type's own default
            one, other = (Literal(default_of(x.type, "vrml"), "vrml") if v is None else v for v in (one, other))
        return found or _value(where, one, other, x.type, protos, typed)
    if isinstance(x, Comment) and isinstance(y, Comment):
        return "" if typed else _attributes(where, x, y, ["text"]) or []
    return _attributes(where, x, y, [s for s in getattr(x, "__slots__", ()) if s != "line"]) or []


def _graph(value: list) -> bool:
    return not value or isinstance(value[0], Node | Use | Comment | Route | Proto | Import | Export)


def _name(x: object) -> str:
    return f"{type(x).__name__} {getattr(x, 'name', '') or getattr(x, 'text', '')}".strip()


def _attributes(where: str, x: object, y: object, names: list[str]) -> str:
    for name in names:
        if getattr(x, name) != getattr(y, name):
            return f"{where} {name}: {getattr(x, name)!r} is not {getattr(y, name)!r}"
    return ""


def _comments(where: str, x: list[tuple[str, Comment]], y: list[tuple[str, Comment]]) -> str:
    if [(n, c.text) for n, c in x] != [(n, c.text) for n, c in y]:
        return f"{where}: comments {[(n, c.text) for n, c in x]} are not {[(n, c.text) for n, c in y]}"
    return ""


def _nodes(where: str, x: Node, y: Node, protos: Mapping[str, Proto], typed: bool) -> str | list[_Pair]:
    exact = ["connects"] if typed else ["container", "connects", "text", "instance", "order"]
    found = _attributes(where, x, y, ["type", "name", *exact])
    if found:
        return found
    if not typed:
        if list(x.fields) != list(y.fields):
            return f"{where}: fields {list(x.fields)} are not {list(y.fields)}"
        found = _comments(where, x.comments, y.comments)
        if found:
            return found
    if len(x.interface) != len(y.interface):
        return f"{where}: {len(x.interface)} own fields, not {len(y.interface)}"
    pairs: list[_Pair] = [(f"{where}.{f.name}", f, g, protos) for f, g in zip(x.interface, y.interface)]
    mine, theirs = (_fields(n, typed) for n in (x, y))
    for name in {**mine, **theirs}:
        kind = type_of(x, name, protos)
        one, other = mine.get(name), theirs.get(name)
        left = _value(f"{where}.{name}", one, other, kind, protos, typed)
        if isinstance(left, str):
            return left
        pairs.extend(left)
    return pairs


def _fields(node: Node, typed: bool) -> dict[str, object]:
    if not typed:
        return node.fields
    fields = {_RENAMED.get((node.type, name), name): value for name, value in node.fields.items()}
    if node.text and "url" in fields_of(node.type):  # VRML has a Script's program among its urls
        url = fields.get("url")
        fields["url"] = [*(parse(url, "MFString") if isinstance(url, Literal) else url or []), node.text]  # type: ignore[misc]
    return fields


def _value(
    where: str, one: object, other: object, kind: str, protos: Mapping[str, Proto], typed: bool
) -> str | list[_Pair]:
    if typed:
        one, other = ([v] if isinstance(v, Node | Use) else v for v in (one, other))
        if kind in ("SFNode", "MFNode", "") or isinstance(one, list) or isinstance(other, list):
            one, other = ([] if _empty(v, kind) else v for v in (one, other))
    if isinstance(one, Node | Use) or (isinstance(one, list) and _graph(one)):
        return [(where, one, other, protos)]
    found = _values(where, one, other, kind, typed)
    return found or []


def _empty(value: object, kind: str) -> bool:
    if not isinstance(value, Literal):
        return value is None
    if is_null(value):
        return True
    text = (value.text if value.syntax == "json" else bare(value)).strip(" \t\n,[]")
    if kind or value.syntax == "vrml":  # in XML and JSON, NULL of unknown type is a word
        return text in ("", "NULL") or (not kind and text == '""')
    return _canonical(value, "") in ("", '""')


def _values(where: str, one: object, other: object, kind: str, typed: bool) -> str:
    """Difference of two values that hold no nodes."""
    if not typed:
        if isinstance(one, Literal) and isinstance(other, Literal):
            equal = (one.text, one.syntax) == (other.text, other.syntax)
        elif isinstance(one, Literal) or isinstance(other, Literal):
            equal = False
        else:
            equal = type(one) is type(other) and bool(np.array_equal(one, other))  # type: ignore[arg-type]
    else:
        one, other = _canonical(one, kind), _canonical(other, kind)
        equal = one == other
    return "" if equal else f"{where}: {_cut(one)} is not {_cut(other)}"


def _canonical(value: object, kind: str) -> object:
    """A value as VRML text without blanks to spare: what is typed is parsed first, what isn't is compared as words."""
    if value is None:
        return None
    if isinstance(value, Literal):
        if kind:
            words = bare(value)
            try:
                value = parse(value, kind)
            except FileError:
                return " ".join(words.replace(",", " ").split()).strip("[ ]")
        else:
            plain = translate(value, "", "xml")
            plain = bare(value) if plain is None else plain
            text = translate(Literal(plain, "xml"), "", "vrml") or plain
            found = text.replace(",", " ").strip("[ ]").split()
            return " ".join(w if (n := number(w)) is None else repr(float(n)) for w in found)
    return None if value is None else text_of(value, kind, "vrml")


def _cut(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."
