"""How JSON writes field values (ISO/IEC 19776-5): the pieces that `values` puts together.

A number, a boolean and a string are themselves, everything longer is a list. Vectors stand flat in one list. Readers
also meet numbers inside strings ("0 1 0", as an XML attribute has them) and lists in lists; both are taken.
"""

from __future__ import annotations

import json
import re

WIDTH = 100
"""Columns that a line of a list has at most, without its indent."""

_TOKEN = re.compile(r'("[^"\\]*+(?:\\.[^"\\]*+)*+")|[^\s,\[\]"]++', re.DOTALL)
_UNSPEAKABLE = re.compile("[\x00\ud800-\udfff]")
_BARE_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
_PUNCTUATION = str.maketrans("[],", "   ")
_LEGAL = re.compile(r"-?(?:0|[1-9][0-9]*+)(?:\.[0-9]++)?+(?:[eE][-+]?[0-9]++)?+", re.ASCII)
_ALL_LEGAL = re.compile(rf"(?:\s*+{_LEGAL.pattern}(?=[\s]|\Z))*+\s*+", re.ASCII)
_LOOSE = re.compile(r"([-+]?)(?:0[xX]([0-9a-fA-F]++)|([0-9]*+)(?:\.([0-9]*+))?+([eE][-+]?[0-9]++)?+)", re.ASCII)


def unquoted(text: str) -> str:
    """The string that a JSON string stands for. What no other encoding can hold (NUL, half a surrogate) is U+FFFD."""
    body = text[1:-1]
    if "\\" in body:
        try:
            body = json.loads(text, strict=False)
        except ValueError:  # an escape that JSON doesn't have: the character itself, as everywhere else in X3D
            body = _BARE_ESCAPE.sub(r"\1", body)
    return body if body.isascii() and "\0" not in body else _UNSPEAKABLE.sub("\ufffd", body)


def quoted(text: str) -> str:
    """A string as JSON writes it."""
    return json.dumps(_UNSPEAKABLE.sub("\ufffd", text), ensure_ascii=False)


def tokens(text: str) -> list[tuple[bool, str]]:
    """All plain values of a JSON value, without its brackets: (whether it is a string, the string or word)."""
    return [(True, unquoted(m[1])) if m[1] else (False, m[0]) for m in _TOKEN.finditer(text)]


def plain(text: str) -> str:
    """A JSON value as XML would write it: numbers and words with blanks between them, strings without quotes."""
    if '"' in text:
        return " ".join(t for _, t in tokens(text))
    return (
        text.translate(_PUNCTUATION) if text.isascii() else text.replace("[", " ").replace("]", " ").replace(",", " ")
    )


def number(word: str) -> str | None:
    """A number of another encoding as JSON may write it (no +, no leading point, no hexadecimal); None for no number."""
    if _LEGAL.fullmatch(word):
        return word
    match = _LOOSE.fullmatch(word)
    if match is None:
        return None
    sign, hexadecimal, whole, part, exponent = match.groups()
    sign = "-" if sign == "-" else ""
    if hexadecimal:
        if len(hexadecimal) > 16:
            return None
        return sign + str(int(hexadecimal, 16))
    if not whole and not part:
        return None
    return f"{sign}{whole.lstrip('0') or '0'}{'.' + part if part else ''}{exponent or ''}"


def numbers(text: str) -> list[str] | None:
    """The numbers of a text with blanks between them, as JSON may write them; None when a word is no number."""
    words = text.split()
    if _ALL_LEGAL.fullmatch(text):
        return words
    found = [number(w) for w in words]
    return None if None in found else found  # type: ignore[return-value]


def listed(texts: list[str], columns: int = 1, *, faces: bool = False) -> str:
    """A list, in one line when it is short, else with one row of `columns` values a line so that it diffs well.

    `faces` breaks lines behind each -1. No line is longer than `WIDTH`, unless a single value is. Lines after the first
    have no indent yet; the last is the bracket.
    """
    size = sum(map(len, texts)) + 2 * len(texts)
    faces = faces and texts.count("-1") > 1
    if size <= WIDTH and not faces and (columns == 1 or len(texts) <= columns):
        return f"[{', '.join(texts)}]"
    if columns > 1:
        rows = [texts[i : i + columns] for i in range(0, len(texts), columns)]
    elif faces:
        rows, start = [], 0
        for i, text in enumerate(texts, 1):
            if text == "-1":
                rows.append(texts[start:i])
                start = i
        rows += [texts[start:]] if start < len(texts) else []
    else:
        rows = [texts]
    lines: list[str] = []
    for row in rows:
        line = ", ".join(row)
        lines += [line] if len(line) <= WIDTH else _wrapped(row)
    return "[\n" + ",\n".join(lines) + "\n]"


def _wrapped(texts: list[str]) -> list[str]:
    lines, start, width = [], 0, 0
    for i, text in enumerate(texts):
        width += len(text) + 2
        if width > WIDTH + 1 and i > start:
            lines.append(", ".join(texts[start:i]))
            start, width = i, len(text) + 2
    return [*lines, ", ".join(texts[start:])]
