"""Tokens of VRML97 and Classic X3D, in time linear in the text.

The syntax can be cut without knowing any node: a field's value is the longest run of numbers, strings and booleans, or
a bracketed list of them, or begins a node. All patterns use possessive quantifiers, so none can backtrack.
"""

from __future__ import annotations

import re
from bisect import bisect_right

from vitruvian.errors import FileError

_GAP = r"(?:[\s,]++|#[^\n]*+)*+"
_VALUE = r'(?:[-+.0-9][-+.\w]*+|"(?:[^"\\]|\\.)*+"|(?:TRUE|FALSE|true|false|NULL)(?![^\s"#,.\[\]{}]))'
_BLANK = re.compile(r"[\s,]*+", re.ASCII)
_COMMENT = re.compile(r"#([^\n]*+)")
_PUNCTUATION = "{}[]."
_WORD = re.compile(r'[^\s"#,.\[\]{}]++', re.ASCII)
_NAME = re.compile(r'[^\s"#,\[\]{}]++', re.ASCII)
_STRING = re.compile(r'"((?:[^"\\]|\\.)*+)"', re.DOTALL | re.ASCII)
_RUN = re.compile(f"{_VALUE}(?:{_GAP}{_VALUE})*+", re.DOTALL | re.ASCII)
_PLAIN_LIST = re.compile(r"\[[-+.,\s0-9eE]*+\]", re.ASCII)
_LIST_BODY = re.compile(rf"\[(?:{_GAP}{_VALUE})*+{_GAP}", re.DOTALL | re.ASCII)
_SIMPLE_FIELD = re.compile(
    rf"""[\s,]*+([^\s"#,.\[\]{{}}]++)[\s,]*+(\[[\s,]*+[-+.0-9][-+.,\s0-9eE]*+\]|{_VALUE}(?:{_GAP}{_VALUE})*+)""",
    re.DOTALL | re.ASCII,
)
_LEGAL = re.compile(r"""[^\x00-\x20"#'+,.0-9\[\\\]{}\x7f-][^\x00-\x20"#',.\[\\\]{}\x7f]*""")
KEYWORDS = frozenset(
    "DEF EXTERNPROTO FALSE IS NULL PROTO ROUTE TO TRUE USE eventIn eventOut exposedField field EXPORT IMPORT AS "
    "inputOnly outputOnly inputOutput initializeOnly COMPONENT META PROFILE UNIT".split()
)


def legal_name(name: str) -> bool:
    """Whether VRML can write this name of a node, field or prototype."""
    return bool(_LEGAL.fullmatch(name)) and name not in KEYWORDS and name not in ("true", "false")


class Lexer:
    """A place in the text, and what can stand there. Methods move the place; all raise FileError with the line."""

    def __init__(self, path: object, text: str, start: int = 0):
        self.path, self.text, self.place = path, text, start
        self.ends = [m.start() for m in re.finditer("\n", text)]

    def line(self, place: int | None = None) -> int:
        """1-based line of a place in the text (default: here)."""
        return bisect_right(self.ends, (self.place if place is None else place) - 1) + 1

    def fail(self, what: str, place: int | None = None) -> FileError:
        return FileError(self.path, self.line(place), what)

    def found(self) -> str:
        """What stands here, for messages."""
        if self.place >= len(self.text):
            return "the end of the file"
        word = _NAME.match(self.text, self.place)
        return repr((word[0] if word else self.text[self.place])[:40])

    def comment(self) -> tuple[str, int] | None:
        """The comment that comes next, if one does: (text, line). Moves over blanks either way."""
        place = self.place = _BLANK.match(self.text, self.place).end()  # type: ignore[union-attr]
        if self.text[place : place + 1] != "#":
            return None
        match = _COMMENT.match(self.text, place)
        assert match is not None
        self.place = match.end()
        return match[1], self.line(place)

    def at(self, character: str) -> bool:
        """Whether this character stands here; moves over it if so."""
        if self.text[self.place : self.place + 1] == character:
            self.place += 1
            return True
        return False

    def peek(self) -> str:
        """The character here, "" at the end."""
        return self.text[self.place : self.place + 1]

    def skip(self) -> None:
        """Move over blanks and comments."""
        while self.comment() is not None:
            pass

    def expect(self, character: str, why: str) -> None:
        self.skip()
        if not self.at(character):
            raise self.fail(f"expected {character} {why}, found {self.found()}")

    def word(self, what: str) -> str:
        """The word here: a keyword, type or name without dots."""
        match = _WORD.match(self.text, self.place)
        if match is None:
            raise self.fail(f"expected {what}, found {self.found()}")
        self.place = match.end()
        return match[0]

    def name(self, what: str) -> str:
        """A name after blanks and comments; names with dots occur and are taken."""
        self.skip()
        match = _NAME.match(self.text, self.place)
        if match is None:
            raise self.fail(f"expected {what}, found {self.found()}")
        self.place = match.end()
        return match[0]

    def end(self, what: str) -> tuple[str, str]:
        """One end of a ROUTE: node.field."""
        text = self.name(what)
        node, _, field = text.rpartition(".")
        if not node or not field:
            raise self.fail(f"expected {what} as NODE.FIELD, found {text!r}")
        return node, field

    def string(self, what: str) -> str:
        """The inside of a string in quotes, as it stands."""
        self.skip()
        match = _STRING.match(self.text, self.place)
        if match is None:
            if self.peek() == '"':
                raise self.fail("a string is not closed")
            raise self.fail(f"expected {what} in quotes, found {self.found()}")
        self.place = match.end()
        return match[1]

    def simple_field(self) -> tuple[str, int, str] | None:
        """(name, place of the value, value) when a word and a plain value come next, which most fields are.

        Doesn't move: `place` is set by the caller to the value's end when the word is the name of a field.
        """
        match = _SIMPLE_FIELD.match(self.text, self.place)
        return None if match is None else (match[1], match.start(2), match[2])

    def value(self) -> str | None:
        """The source text of a value that holds no nodes; None when a node, a list of nodes or nothing stands here."""
        text, place = self.text, self.place
        if text[place : place + 1] == "[":
            match = _PLAIN_LIST.match(text, place)
            if match is None:
                match = _LIST_BODY.match(text, place)
                assert match is not None
                end = match.end()
                if text[end : end + 1] != "]":
                    inner = re.compile(_GAP, re.ASCII).match(text, place + 1).end()  # type: ignore[union-attr]
                    if inner == end and end < len(text) and text[end] not in '"[{}.':
                        return None  # a list of nodes
                    self.place = end
                    raise self.fail(
                        "a string is not closed"
                        if self.peek() == '"'
                        else f"expected a value or ] in the list of line {self.line(place)}, found {self.found()}"
                    )
                self.place = end + 1
                return text[place : end + 1]
            self.place = match.end()
            return match[0]
        match = _RUN.match(text, place)
        if match is None:
            if text[place : place + 1] == '"':
                raise self.fail("a string is not closed")
            return None
        self.place = match.end()
        return match[0]
