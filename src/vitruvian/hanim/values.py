"""Field values: source text to typed values and back, and between the ways of writing them (XML, VRML, JSON).

Typed values: bool, int, float, str, list of bool, list of str; SFVec3f and its kin float64 (n,), their MF forms
float64 (k, n), MFFloat float64 (k,), MFInt32 int32 (k,). Units and frames are the file's own.
Source: ISO/IEC 19775-1 clause 5, 19776-1 (XML), 19776-2 (Classic), 19776-5 (JSON), 14772-1 (VRML97).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.hanim import json_values
from vitruvian.hanim.digits import double_of, shortest, shortest_of
from vitruvian.hanim.graph import Literal, Node, Use
from vitruvian.native import parse_floats

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_COLUMNS = {
    **{f"Vec{n}{p}": n for n in (2, 3, 4) for p in "fd"},
    **{f"Matrix{n}{p}": n * n for n in (3, 4) for p in "fd"},
    "Rotation": 4,
    "Color": 3,
    "ColorRGBA": 4,
    "Float": 1,
    "Double": 1,
    "Time": 1,
}
COLUMNS = {**_COLUMNS, "Int32": 1}
"""How many numbers make one value, by type without its SF or MF."""
_DOUBLE = {"Double", "Time", *(t for t in _COLUMNS if t.endswith("d"))}
_INTEGER = {"Int32", "Image"}
_SINGLE_FLOATS = {*_COLUMNS} - _DOUBLE

_VRML_COMMENT = re.compile(r"#[^\n]*")
_STRING = re.compile(r'"((?:[^"\\]|\\.)*+)"', re.DOTALL)
_STRING_OR_COMMENT = re.compile(r'("(?:[^"\\]|\\.)*+")|#[^\n]*', re.DOTALL)
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_XML_ESCAPE = re.compile(r'\\(["\\])')
_TOKEN = re.compile(r"[^ \t-\r]+")
# What the VRML lexer takes for a number; whether it is one is found out when it is parsed.
_NUMBERS = re.compile(r"(?:[\s,]*+[-+.0-9][-+.\w]*+)*+[\s,]*+", re.ASCII)


def parse(literal: Literal, type: str, path: object = "") -> object:
    """The typed value of source text; NULL is None, and so is JSON's null whatever the type.

    Raises FileError (path and line) when the text isn't a value of that type: a malformed number, one that isn't finite
    or doesn't fit 32 bits, a count that doesn't fit the type.
    """
    many, base = type.startswith("MF"), type[2:]
    if is_null(literal):
        return None
    if base in _COLUMNS or base in _INTEGER:
        text = _numbers(literal, many)
        if not many and base in _COLUMNS and len(text) < 80:
            few = _at_sight(text, _COLUMNS[base])
            if few is not None and len(few) == 1:
                return few[0]
            if few is not None:
                import numpy as np

                return np.array(few)
        if base in _INTEGER:
            return _integers(literal, text, type, path)
        return _floats(literal, text, type, path)
    if base == "Bool":
        return _booleans(literal, many, path)
    if base == "String":
        return _strings(literal, many, path)
    if base == "Node":
        if literal.text.strip(" \t\n,[]") in ("", "NULL"):
            return None
        raise FileError(path, literal.line, f"expected a node, found {_short(literal.text)}")
    raise FileError(path, literal.line, f"{type} is no field type of X3D; expected one such as SFFloat or MFVec3f")


def value(node: Node, field: str, type: str, default: object = None, path: object = "") -> object:
    """The typed value of a node's field; `default` when the node doesn't give it. Errors as `parse`."""
    found = node.fields.get(field)
    if isinstance(found, Literal):
        parsed = parse(found, type, path)
        return default if parsed is None else parsed
    if found is None or isinstance(found, Node | Use):
        return default
    return found


def _at_sight(text: str, count: int) -> list[float] | None:
    """That many finite numbers in plain writing, without the cost of arrays; None when they need a closer look."""
    words = text.split()
    if len(words) != count or "_" in text or not text.isascii():
        return None
    try:
        numbers = list(map(float, words))
    except ValueError:
        return None
    return numbers if all(v - v == 0 for v in numbers) else None


def _short(text: str) -> str:
    text = " ".join(text[:80].split())
    return repr(text if len(text) <= 40 else text[:37] + "...")


def is_null(literal: Literal) -> bool:
    """Whether JSON says that there is no value."""
    return literal.syntax == "json" and literal.text.strip() == "null"


def bare(literal: Literal) -> str:
    """The text without the comments that VRML may have inside, and without the brackets and quotes of JSON."""
    text = literal.text
    if literal.syntax == "json":
        return json_values.plain(text)
    if literal.syntax != "vrml" or "#" not in text:
        return text
    if '"' not in text:
        return _VRML_COMMENT.sub("", text)
    return _STRING_OR_COMMENT.sub(lambda m: m[1] or "", text)


def _numbers(literal: Literal, many: bool) -> str:
    text = bare(literal)
    if many and literal.syntax == "vrml":
        text = text.strip()
        if text.startswith("[") and text.endswith("]"):
            text = text[1:-1]
    return text.replace(",", " ")


def _malformed(literal: Literal, token: str, path: object, expected: str) -> FileError:
    return FileError(path, _line(literal, token), f"expected {expected}, found {_short(token)}")


def _line(literal: Literal, token: str) -> int:
    """The line of a token: VRML and JSON text keeps its line ends, an XML attribute doesn't."""
    if literal.syntax == "xml":
        return literal.line
    place = re.search(rf"(?<![^\s,\[]){re.escape(token)}(?![^\s,\]])", literal.text)
    return literal.line + (literal.text.count("\n", 0, place.start()) if place else 0)


def _floats(literal: Literal, text: str, type: str, path: object) -> object:
    array = _parsed(literal, text, path)
    n = _COLUMNS[type[2:]]
    if type.startswith("SF"):
        if array.size != n:
            raise FileError(path, literal.line, f"{type} is {n} numbers, found {array.size}")
        return float(array[0]) if n == 1 else array
    if array.size % n:
        raise FileError(path, literal.line, f"{type} is groups of {n} numbers, found {array.size} numbers")
    return array if n == 1 else array.reshape(-1, n)


def _parsed(literal: Literal, text: str, path: object, expected: str = "a number") -> NDArray[np.float64]:
    """All numbers of a text, finite every one."""
    try:
        return parse_floats(text.encode("ascii", "replace"))
    except ValueError as error:
        place = error.offset  # type: ignore[attr-defined]
    token = _TOKEN.search(text, place)[0]  # type: ignore[index]
    plain = token.isascii() and "_" not in token and _is_number(token, float)
    raise _malformed(literal, token, path, "a finite number" if plain else expected)


def _is_number(token: str, kind: Callable[[str], object]) -> bool:
    try:
        kind(token)
    except ValueError:
        return False
    return True


def _integer(token: str) -> int:
    """Decimal, or hexadecimal with 0x."""
    try:
        return int(token)
    except ValueError:
        if token.lstrip("+-")[:2].lower() == "0x":
            return int(token, 16)
        raise


def _hexadecimal(literal: Literal, text: str, path: object) -> NDArray[np.float64]:
    """Whole numbers, some with 0x."""
    import numpy as np

    found = []
    for token in _TOKEN.findall(text):
        try:
            if not token.isascii() or "_" in token:
                raise ValueError
            number = _integer(token)
        except ValueError:
            raise _malformed(literal, token, path, "a whole number") from None
        found.append(float(min(max(number, -(2**53)), 2**53)))
    return np.array(found, np.float64)


def _integers(literal: Literal, text: str, type: str, path: object) -> object:
    import numpy as np

    if "." in text or "x" in text or "X" in text or "e" in text or "E" in text:  # hexadecimal, or wrong
        array, highest = _hexadecimal(literal, text, path), 2**32 - 1
    else:
        array, highest = _parsed(literal, text, path, "a whole number"), 2**31 - 1
    image = type[2:] == "Image"  # width, height, components, pixels of up to 4 bytes
    highest = 2**32 if image else highest
    if array.size and (array.min() < -(2**31) or array.max() > highest):
        wide = (array < -(2**31)) | (array > highest)
        raise _malformed(literal, text.split()[int(np.argmax(wide))], path, "a number that fits 32 bits")
    if image:
        return array.astype(np.int64)
    if type == "MFInt32":
        return array.astype(np.int64).astype(np.int32)
    if array.size != 1:
        raise FileError(path, literal.line, f"{type} is 1 number, found {array.size}")
    return int(array[0])


def _booleans(literal: Literal, many: bool, path: object) -> object:
    words = _numbers(literal, many).split()
    right = ("TRUE", "FALSE") if literal.syntax == "vrml" else ("true", "false")
    found = []
    for word in words:
        if word not in right:
            if word.lower() not in ("true", "false"):
                raise _malformed(literal, word, path, f"{right[0]} or {right[1]}")
            warn(f"{path}:{literal.line}: {word} is taken for {word.upper() if right[0] == 'TRUE' else word.lower()}")
        found.append(word.lower() == "true")
    if many:
        return found
    if len(found) != 1:
        raise FileError(path, literal.line, f"SFBool is one of {right[0]} and {right[1]}, found {_short(literal.text)}")
    return found[0]


def _strings(literal: Literal, many: bool, path: object) -> object:
    text = literal.text
    if literal.syntax == "json":
        words = json_values.tokens(text)
        if many and len(words) == 1 and not text.lstrip().startswith("["):
            return _strings(Literal(words[0][1], "xml", literal.line), many, path)  # as an attribute has it
        if not many and len(words) > 1:
            raise FileError(path, literal.line, f"SFString is one string, found {_short(text)}")
        return [t for _, t in words] if many else "".join(t for _, t in words)
    if literal.syntax == "xml":
        if not many:
            return _XML_ESCAPE.sub(r"\1", text) if "\\" in text else text
        if not text.lstrip().startswith('"'):
            return [text] if text.strip() else []  # a single string without its quotes
        return _quoted(literal, text, 0, len(text), path)
    start, end = 0, len(text)
    stripped = text.strip()
    if many and stripped.startswith("["):
        if not stripped.endswith("]"):
            raise FileError(path, literal.line, f"expected strings in brackets, found {_short(text)}")
        start, end = text.index("[") + 1, text.rindex("]")
    found = _quoted(literal, text, start, end, path)
    if many:
        return found
    if len(found) != 1:
        raise FileError(path, literal.line, f"SFString is one string in quotes, found {_short(text)}")
    return found[0]


def _quoted(literal: Literal, text: str, start: int, end: int, path: object) -> list[str]:
    """All quoted strings of text[start:end]; blanks, commas and (VRML) comments between them."""
    found: list[str] = []
    gap = re.compile(r"(?:[\s,]++|#[^\n]*+)*+" if literal.syntax == "vrml" else r"[\s,]*+")
    place = gap.match(text, start, end).end()  # type: ignore[union-attr]
    while place < end:
        string = _STRING.match(text, place, end)
        if string is None:
            line = literal.line + text.count("\n", 0, place)
            raise FileError(path, line, f"expected a string in quotes, found {_short(text[place:end])}")
        body = string[1]
        found.append(_ESCAPE.sub(r"\1", body) if "\\" in body else body)
        place = gap.match(text, string.end(), end).end()  # type: ignore[union-attr]
    return found


def quote(text: str) -> str:
    """A string in quotes, as in MFString and in VRML."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def text_of(value: object, type: str, syntax: str) -> str:
    """Source text ("xml", "vrml" or "json") of a typed value.

    `type` may be "" when nothing tells it; then numbers in an array of one dimension are written as a list when there
    are more than four (JSON: always). Floats are the shortest text that reads back as the same float32 (float64 for
    double types). Long lists of JSON have a line for each row.
    """
    if isinstance(value, Literal):
        text = translate(value, type, syntax)
        if text is None:
            raise VitruvianError(f"{_short(value.text)} can't be written in {syntax} syntax")
        return text
    vrml, json, base = syntax == "vrml", syntax == "json", type[2:]
    if isinstance(value, float) and type[:2] == "SF" and base in _SINGLE_FLOATS and not json:
        return shortest_of(value)
    if value is None:
        return "NULL" if vrml else "null" if json else ""
    if base == "String" or isinstance(value, str) or (isinstance(value, list) and value and isinstance(value[0], str)):
        if isinstance(value, str) and type != "MFString":
            return quote(value) if vrml else json_values.quoted(value) if json else value.replace("\\", "\\\\")
        entries: list[str] = [value] if isinstance(value, str) else list(value)  # type: ignore[call-overload]
        if json:
            return json_values.listed([json_values.quoted(s) for s in entries])
        strings = " ".join(map(quote, entries))
        return f"[ {strings} ]" if vrml else strings
    import numpy as np

    few = isinstance(value, np.ndarray) and value.ndim == 1 and value.size <= 4
    if few and type[:2] == "SF" and not json and base in _SINGLE_FLOATS:
        return " ".join(map(shortest_of, value.tolist()))  # type: ignore[attr-defined]
    array = np.asarray(value)
    many = type.startswith("MF") or (not type and (array.ndim > 1 or array.size > 4))
    if array.dtype == bool or base == "Bool":
        words = ("FALSE", "TRUE") if vrml else ("false", "true")
        texts, n = [words[bool(v)] for v in array.ravel()], 1
    elif base in _INTEGER or (not type and array.dtype.kind in "iu"):
        texts, n = list(map(str, array.astype(np.int64).ravel().tolist())), 1
    else:
        texts = [double_of(v) for v in array.ravel().tolist()] if base in _DOUBLE else shortest(array)
        n = _COLUMNS.get(base) or (array.shape[-1] if array.ndim > 1 else 1)
    if json:
        single = len(texts) == 1 and not array.ndim and not type.startswith("MF")
        return texts[0] if single else json_values.listed(texts, n, faces=type == "MFInt32")
    if not vrml:
        return " ".join(texts)
    rows = [" ".join(texts[i : i + n]) for i in range(0, len(texts), n)] if n > 1 else [" ".join(texts)]
    text = (", " if len(rows) > 1 else " ").join(rows)
    return (f"[ {text} ]" if text else "[ ]") if many else text


def default_of(type: str, syntax: str) -> str:
    """The text of the value that a field of this type has when nobody gives one."""
    base = type[2:]
    if type.startswith("MF"):
        return "[ ]" if syntax == "vrml" else ""
    if base == "Node":
        return "NULL" if syntax == "vrml" else ""
    if base == "String":
        return '""' if syntax == "vrml" else ""
    if base == "Bool":
        return "FALSE" if syntax == "vrml" else "false"
    if base == "Rotation":
        return "0 0 1 0"
    if base.startswith("Matrix"):
        return " ".join(str(int(i == j)) for i in range(int(base[6])) for j in range(int(base[6])))
    return " ".join(["0"] * (3 if base == "Image" else _COLUMNS.get(base, 1)))


def translate(literal: Literal, type: str, syntax: str) -> str | None:
    """The text of a literal in another syntax; None when it can't be said there.

    With an unknown `type` ("") what the text looks like decides: numbers, booleans, strings in quotes, a plain string.
    JSON says whatever isn't of its type as a string, which reads back as the same defect.
    """
    if literal.syntax == syntax:
        return literal.text
    base = type[2:]
    if syntax == "json":
        return _to_json(literal, type)
    if literal.syntax == "json":
        if is_null(literal):
            return "NULL" if syntax == "vrml" and base in ("Node", "") else None
        words = json_values.tokens(literal.text)
        if not type and any(string for string, _ in words):
            listed = literal.text.lstrip().startswith("[")
            kind, entries = ("MFString" if listed else "SFString"), [t for _, t in words]
            return text_of(entries if listed else entries[0], kind, syntax)
        if base != "String":
            literal = Literal(" ".join(json_values.plain(literal.text).split()), "xml", literal.line)
            if syntax == "xml":
                return literal.text
    if base == "Node":
        return "NULL" if syntax == "vrml" and literal.text.strip() in ("", "NULL") else None
    try:
        if base == "String":
            return text_of(parse(literal, type), type, syntax)
        if syntax == "vrml":
            return _to_vrml(literal, type)
        return _to_xml(literal, type)
    except FileError:
        return None


def _to_vrml(literal: Literal, type: str) -> str | None:
    text = literal.text
    words = text.replace(",", " ").split()
    if words and all(w.lower() in ("true", "false") for w in words):
        text = text.upper()
    elif not _NUMBERS.fullmatch(text) or (not words and type[:2] != "MF"):
        if type:
            return None
        if text.lstrip().startswith('"'):
            with suppress(FileError):  # one that only starts with a quote is a plain string
                return text_of(parse(literal, "MFString"), "MFString", "vrml")
        return quote(_XML_ESCAPE.sub(r"\1", text))
    many = type.startswith("MF") or (not type and len(words) > 4)
    if not many:
        return text
    return f"[ {text} ]" if words else "[ ]"


def _to_xml(literal: Literal, type: str) -> str | None:
    text = bare(literal).strip()
    if not type and '"' in text:
        many = text.startswith("[") or len(_STRING.findall(text)) > 1
        type = "MFString" if many else "SFString"
        return text_of(parse(literal, type), type, "xml")
    if text == "NULL":
        return None
    if text.startswith("[") and text.endswith("]"):
        text = text[1:-1].strip()
    text = " ".join(text.split())
    words = text.replace(",", " ").split()
    if words and all(w.lower() in ("true", "false") for w in words):
        return text.lower()
    return text


def _to_json(literal: Literal, type: str) -> str | None:
    vrml, base = literal.syntax == "vrml", type[2:]
    text = bare(literal).strip()
    if base == "Node" or (not type and vrml):
        if text == "NULL" or (base == "Node" and not text):
            return "null"
        if base == "Node":
            return None
    if base == "String" or (not type and '"' in text):
        kind = type or (
            "MFString" if not vrml or text.startswith("[") or len(_STRING.findall(text)) > 1 else "SFString"
        )
        for attempt in (kind, "MFString") if vrml else (kind,) if type or text.startswith('"') else ():
            with suppress(FileError):
                return text_of(parse(literal, attempt), attempt, "json")
    many = type.startswith("MF") or base not in ("Float", "Double", "Time", "Int32", "Bool", "")
    inner = text
    if vrml and text.startswith("[") and text.endswith("]"):
        inner, many = text[1:-1], True
    inner = inner.replace(",", " ")
    words = inner.split()
    found: list[str] | None = None
    if base in ("Bool", "") and words and all(w.lower() in ("true", "false") for w in words):
        found = [w.lower() for w in words]
    elif base not in ("Bool", "String") and (words or many):
        found = json_values.numbers(inner)
    if found is None:
        return json_values.quoted(literal.text if type or vrml else _XML_ESCAPE.sub(r"\1", literal.text))
    if len(found) == 1 and not many:
        return found[0]
    return json_values.listed(found, _COLUMNS.get(base, 1), faces=type == "MFInt32")
