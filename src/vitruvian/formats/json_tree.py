"""JSON with the places of things, for readers of JSON formats: objects and lists as they stand, values as source text.

Python's own reader forgets lines, recurses, and lets the last of two equal keys win. Here each object and value knows
its place, lists of plain values stay one span of text that nobody copies or parses before it is asked for, nesting and
counts are bounded, and two equal keys in one object are an error. Time and memory are linear in the text: no pattern
can backtrack.
"""

from __future__ import annotations

import os
import re
from bisect import bisect_right
from dataclasses import dataclass, field

from vitruvian.errors import FileError, warn
from vitruvian.formats.source import LIMITS, Limits, decode, read_bytes
from vitruvian.hanim.json_values import unquoted

_STRING = r'"[^"\\]*+(?:\\.[^"\\]*+)*+"'
_NUMBER = r"-?(?:0|[1-9][0-9]*+)(?:\.[0-9]++)?+(?:[eE][-+]?[0-9]++)?+(?![-+.\w])"
_WORD = r"[-+.\w]++"
_COMMA = r"[ \t\n]*+,[ \t\n]*+"
_X3D = re.compile(r'\s*+\{\s*+"X3D"\s*+:')
_BLANK = re.compile(r"[ \t\n]*+")
_KEY = re.compile(rf"[ \t\n]*+({_STRING})[ \t\n]*+:[ \t\n]*+", re.DOTALL)
# A key with a plain value or a list of numbers and what comes after them: most of what is in a file.
_SIMPLE = re.compile(
    rf"[ \t\n]*+({_STRING})[ \t\n]*+:[ \t\n]*+"
    rf"({_STRING}|{_NUMBER}|true|false|null|\[[ \t\n]*+{_NUMBER}(?:{_COMMA}{_NUMBER})*+[ \t\n]*+\])[ \t\n]*+([,}}])",
    re.DOTALL | re.ASCII,
)
# A list of numbers as JSON has them, a list of any plain values, and one plain value.
_NUMBERS = re.compile(rf"\[[ \t\n]*+{_NUMBER}(?:{_COMMA}{_NUMBER})*+[ \t\n]*+\]", re.ASCII)
_FLAT = re.compile(
    rf"\[[ \t\n]*+(?:(?:{_STRING}|{_WORD})(?:{_COMMA}(?:{_STRING}|{_WORD}))*+)?+[ \t\n]*+\]", re.DOTALL | re.ASCII
)
_FLAT_HEAD = re.compile(
    rf"\[[ \t\n]*+(?:(?:{_STRING}|{_WORD})(?:{_COMMA}(?:{_STRING}|{_WORD}))*+(?:{_COMMA})?+)?+[ \t\n]*+",
    re.DOTALL | re.ASCII,
)
_PLAIN = re.compile(rf"{_STRING}|{_WORD}", re.DOTALL | re.ASCII)
_LEGAL = re.compile(rf"(?:{_NUMBER}|true|false|null)\Z", re.ASCII)
_IN_FLAT = re.compile(rf"{_STRING}|({_WORD})", re.DOTALL | re.ASCII)
# What isn't JSON but is written by some: said once, kept as it stands. NaN and Infinity are for the doctor to judge.
_TOLERATED = re.compile(r"[-+]?(?:(?:[0-9]++\.?+[0-9]*+|\.[0-9]++)(?:[eE][-+]?[0-9]++)?+|0[xX][0-9a-fA-F]++)", re.ASCII)
_NOT_FINITE = re.compile(r"[-+]?(?:nan|inf(?:inity)?+)", re.ASCII | re.IGNORECASE)


@dataclass(slots=True, eq=False)
class Span:
    """A value that holds no objects: a string, number, true, false, null, or a list of such, as it stands."""

    start: int
    end: int


@dataclass(slots=True, eq=False)
class Object:
    """`items`: key -> (place of the key, value), in source order."""

    start: int
    items: dict[str, tuple[int, Value]] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class List:
    """A list that holds objects or lists, or of which nobody can tell because it is empty."""

    start: int
    end: int = 0
    items: list[Value] = field(default_factory=list)


Value = Span | Object | List


class Tree:
    """A JSON text and its top value. `path` is for messages. FileError with the line where it is no JSON; with `partly`
    that is kept as `failure`, and `top` is what stands before it."""

    def __init__(self, path: object, text: str, *, limits: Limits = LIMITS, partly: bool = False):
        self.path, self.text, self.limits = path, text, limits
        self.ends = [m.start() for m in re.finditer("\n", text)]
        self.count = 0
        self.told = False  # about numbers that aren't JSON's
        self.top: Value = Span(0, 0)
        self.failure: FileError | None = None
        try:
            self._read()
        except FileError as failure:
            if not partly:
                raise
            self.failure = failure

    def line(self, place: int) -> int:
        """1-based line of a place in the text."""
        return bisect_right(self.ends, place - 1) + 1

    def fail(self, place: int, what: str) -> FileError:
        return FileError(self.path, self.line(place), what)

    def found(self, place: int) -> str:
        """What stands at a place, for messages."""
        if place >= len(self.text):
            return "the end of the file"
        word = _PLAIN.match(self.text, place)
        return repr((word[0] if word else self.text[place])[:40])

    def source(self, span: Span | List) -> str:
        return self.text[span.start : span.end]

    def string(self, value: Value) -> str | None:
        """The string that a value is; numbers and words as they stand; None for lists and objects."""
        if not isinstance(value, Span) or self.text[value.start] == "[":
            return None
        text = self.text[value.start : value.end]
        return unquoted(text) if text[0] == '"' else text

    def strings(self, value: Value) -> list[str]:
        """The strings of a list, or the one that a value is; objects inside are left out."""
        if isinstance(value, Span) and self.text[value.start] == "[":
            return [t[1] or unquoted(t[0]) for t in _IN_FLAT.finditer(self.text, value.start, value.end)]
        values = value.items if isinstance(value, List) else [value]
        return [s for v in values if (s := self.string(v)) is not None]

    def _read(self) -> None:
        text = self.text
        deepest = 4 * self.limits.depth + 16
        stack: list[Object | List] = []
        top, place = self._value(_BLANK.match(text).end())  # type: ignore[union-attr]
        self.top = top
        if not isinstance(top, Span):
            stack.append(top)
        after, comma = False, False  # whether a value stands before this place, or a comma
        while stack:
            holder = stack[-1]
            if not after and isinstance(holder, Object):
                place, after, comma = self._simple(holder, place, comma)
                if after:
                    stack.pop()
                    continue
            place = _BLANK.match(text, place).end()  # type: ignore[union-attr]
            here, closer = text[place : place + 1], "}" if isinstance(holder, Object) else "]"
            if here == closer:
                if comma:
                    raise self.fail(place, f"expected a value after the comma, found {closer!r}")
                place, after = place + 1, True
                if isinstance(holder, List):
                    holder.end = place
                stack.pop()
                continue
            if after:
                if here != ",":
                    raise self._unended(holder, place, f"expected , or {closer}")
                place, after, comma = place + 1, False, True
                continue
            comma = False
            if isinstance(holder, Object):
                match = _KEY.match(text, place)
                if match is None:
                    raise self._unended(holder, place, 'expected "key":')
                key = self._key(holder, match)
                value, place = self._value(match.end())
                holder.items[key] = (match.start(1), value)
            elif not here:
                raise self._unended(holder, place, "expected a value or ]")
            else:
                value, place = self._value(place)
                holder.items.append(value)
            after = isinstance(value, Span)
            if not isinstance(value, Span):
                if len(stack) >= deepest:
                    raise self.fail(place, f"objects and lists are nested deeper than {deepest}")
                stack.append(value)
        place = _BLANK.match(text, place).end()  # type: ignore[union-attr]
        if place < len(text):
            raise self.fail(place, f"expected the end of the file, found {self.found(place)}")

    def _simple(self, holder: Object, place: int, comma: bool) -> tuple[int, bool, bool]:
        """Keys with plain values, as many as come: (place behind them, whether the object ends, whether a comma did)."""
        items, text = holder.items, self.text
        while (match := _SIMPLE.match(text, place)) is not None:
            items[self._key(holder, match)] = (match.start(1), Span(*match.span(2)))
            self._counted(place)
            place = match.end()
            if match[3] == "}":
                return place, True, False
            comma = True
        return place, False, comma

    def _key(self, holder: Object, match: re.Match[str]) -> str:
        key = unquoted(match[1])
        if key in holder.items:
            raise self.fail(match.start(1), f"{match[1][:60]} is given twice in one object; leave one")
        return key

    def _value(self, place: int) -> tuple[Value, int]:
        """The value at a place and where it ends; of an object or list with more than plain values, where it begins."""
        text = self.text
        self._counted(place)
        opener = text[place : place + 1]
        if opener == "{":
            return Object(place), place + 1
        if opener == "[":
            flat = _NUMBERS.match(text, place) or _FLAT.match(text, place)
            if flat is None:
                end = _FLAT_HEAD.match(text, place).end()  # type: ignore[union-attr]
                if text[end : end + 1] not in ("{", "["):
                    raise self._unended(List(place), end, "expected a value or ]")
                return List(place), place + 1
            if _BLANK.match(text, place + 1).end() == flat.end() - 1:  # type: ignore[union-attr]
                return List(place), place + 1
            self._judge(*flat.span())
            return Span(*flat.span()), flat.end()
        plain = _PLAIN.match(text, place)
        if plain is None:
            if opener == '"':
                raise self.fail(place, "a string is not closed")
            raise self.fail(place, f"expected a value, found {self.found(place)}")
        if opener != '"':
            self._judge(*plain.span())
        return Span(*plain.span()), plain.end()

    def _counted(self, place: int) -> None:
        self.count += 1
        if self.count > self.limits.entries + 3 * self.limits.nodes:
            raise self.fail(place, f"more than {self.limits.entries + 3 * self.limits.nodes} values")

    def _unended(self, holder: Object | List, place: int, expected: str) -> FileError:
        if place >= len(self.text):
            what = "object" if isinstance(holder, Object) else "list"
            return self.fail(place, f"the file ends inside the {what} of line {self.line(holder.start)}")
        return self.fail(place, f"{expected}, found {self.found(place)}")

    def _judge(self, start: int, end: int) -> None:
        """Refuse words that mean nothing; tell once about numbers that JSON writes otherwise."""
        if _NUMBERS.fullmatch(self.text, start, end):
            return
        for match in _IN_FLAT.finditer(self.text, start, end):
            word = match[1]
            if word is None or _LEGAL.match(word):
                continue
            if _TOLERATED.fullmatch(word):
                if not self.told:
                    warn(f"{self.path}:{self.line(match.start())}: {word[:40]} is not how JSON writes a number")
                    self.told = True
            elif not _NOT_FINITE.fullmatch(word):
                raise self.fail(match.start(), f"expected a value, found {word[:40]!r}")


def top_keys(path: str | os.PathLike[str], *, limits: Limits = LIMITS) -> list[str]:
    """The keys of the object that a JSON file (gzip too) has on top, [] when that is something else.

    Of a file that begins with an "X3D" object, which has no other key, no more is read than that. FileError as `Tree`.
    """
    text = decode(path, read_bytes(path, limits))
    if _X3D.match(text):
        return ["X3D"]
    top = Tree(path, text, limits=limits).top
    return list(top.items) if isinstance(top, Object) else []
