"""What an SVG drawing shows: its paths and the places of what it uses, in millimetres, y up.

The parser is expat with entities refused. What stands in defs, symbols, markers and clips is not shown. Units: width and
height with the viewBox; without a viewBox 96 pixels are an inch.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from xml.parsers import expat

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.source import Limits, no_collection, read_bytes, refuse_crowds
from vitruvian.formats.svg_path import Run, moved, runs, transform

SMALL = Limits(bytes=32 << 20)
DEEPEST, MOST = 200, 200_000  # elements inside each other, and in all
NUMBERS = 1_000_000  # characters of all path data
UNITS = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72, "pc": 25.4 / 6, "px": 25.4 / 96, "": 25.4 / 96, "q": 0.25}
_LENGTH = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)\s*([A-Za-z]*|%)\s*\Z", re.ASCII)
_UNSEEN = {"defs", "symbol", "marker", "clipPath", "mask", "pattern", "linearGradient", "radialGradient", "metadata"}


@dataclass(frozen=True)
class Shape:
    """A path, polygon, polyline, line, rect, circle or ellipse: its tag, attributes, the ids of the groups around it
    (outermost first), its subpaths, mm, y up, and where the origin of the innermost group is (2,)."""

    tag: str
    attributes: dict[str, str]
    groups: tuple[str, ...]
    runs: tuple[Run, ...]
    home: Floats


@dataclass(frozen=True)
class Mark:
    """A place where something is used: what, the groups around it, where (2,), mm, y up, and their origin (2,)."""

    what: str
    groups: tuple[str, ...]
    at: Floats
    home: Floats


@dataclass(frozen=True)
class Drawing:
    """All shapes and marks of a file."""

    shapes: tuple[Shape, ...]
    marks: tuple[Mark, ...]
    title: str = ""


def read_drawing(path: str | Path) -> Drawing:
    """The drawing of an SVG file. Raises `FileError` with the line."""
    data = read_bytes(path, SMALL)
    refuse_crowds(path, data, b"<", 2 * MOST, "XML tags")
    reader = _Reader(path)
    try:
        with no_collection():
            reader.expat.Parse(data, True)
    except expat.ExpatError as error:
        what = expat.errors.messages.get(error.code, str(error))
        raise FileError(path, error.lineno, f"is not well-formed XML: {what}") from None
    except FileError:
        raise
    except VitruvianError as error:
        raise FileError(path, reader.expat.CurrentLineNumber, str(error)) from None
    except (LookupError, ValueError) as error:  # an encoding that nobody knows
        raise FileError(path, 1, f"can't be decoded: {error}") from None
    return Drawing(tuple(reader.shapes), tuple(reader.marks), " ".join("".join(reader.title).split()))


class _Reader:
    def __init__(self, path: str | Path) -> None:
        self.path = path
        self.shapes: list[Shape] = []
        self.marks: list[Mark] = []
        self.title: list[str] = []
        self.stack: list[tuple[str, Floats, tuple[str, ...], bool]] = []
        self.amount = 0
        self.expat = expat.ParserCreate()
        self.expat.StartElementHandler = self.begin
        self.expat.EndElementHandler = self.end
        self.expat.CharacterDataHandler = self.characters
        self.expat.EntityDeclHandler = self.refused
        self.expat.AttlistDeclHandler = self.refused
        self.expat.SkippedEntityHandler = self.refused

    def refused(self, *_: object) -> None:
        raise FileError(self.path, self.expat.CurrentLineNumber, "declares or uses an entity; that is refused")

    def characters(self, text: str) -> None:
        if len(self.stack) == 2 and self.stack[-1][0] == "title" and len(self.title) < 50:
            self.title.append(text[:200])

    def begin(self, tag: str, attributes: dict[str, str]) -> None:
        tag = tag.rpartition(":")[2]
        if not self.stack:
            if tag != "svg":
                raise VitruvianError(f"expected an svg element at the top, found {tag:.40}")
            self.stack.append((tag, _page(attributes), (), True))
            return
        if len(self.stack) > DEEPEST:
            raise VitruvianError(f"expected at most {DEEPEST} elements inside each other")
        _, matrix, groups, seen = self.stack[-1]
        home = matrix[:2, 2]
        seen = seen and tag not in _UNSEEN and attributes.get("display") != "none"
        if not seen:
            self.stack.append((tag, matrix, groups, False))
            return
        if "transform" in attributes:
            matrix = matrix @ transform(attributes["transform"])
        if tag == "svg":
            raise VitruvianError("expected one svg element, found one inside another")
        if tag in ("g", "a"):
            label = attributes.get("id") or attributes.get("inkscape:label") or ""
            groups = (*groups, label)
        elif tag == "use":
            href = attributes.get("href") or attributes.get("xlink:href") or ""
            at = np.array([_number(attributes, "x"), _number(attributes, "y")])
            self.marks.append(Mark(href.removeprefix("#"), groups, moved(at[None], matrix)[0], home))
        else:
            d = _data(tag, attributes)
            self.amount += len(d)
            if self.amount > NUMBERS:
                raise VitruvianError(f"expected at most {NUMBERS} characters of paths")
            if d:
                found = tuple(runs(d, matrix))
                self.shapes.append(Shape(tag, attributes, groups, found, home))
        self.stack.append((tag, matrix, groups, True))

    def end(self, _: str) -> None:
        self.stack.pop()


def _number(attributes: dict[str, str], name: str, default: float = 0.0) -> float:
    """A length in units of the drawing; of those with a unit in px, as CSS has it."""
    if name not in attributes:
        return default
    found = _LENGTH.match(attributes[name])
    if found is None or found[2].lower() not in UNITS or not isfinite(float(found[1])):
        raise VitruvianError(f"{name}: expected a length, found {attributes[name]!r:.40}")
    return float(found[1]) * (UNITS[found[2].lower()] / UNITS["px"] if found[2] else 1.0)


def _page(attributes: dict[str, str]) -> Floats:
    """(3,3) from the drawing's units to millimetres, y up."""
    box = attributes.get("viewBox", "").replace(",", " ").split()
    scale, low = 1.0, np.zeros(2)
    if box:
        try:
            x, y, width, height = (float(v) for v in box)
        except ValueError:
            x = y = width = height = np.nan
        if not (isfinite(x) and isfinite(y) and 0 < width < 1e7 and 0 < height < 1e7):
            raise VitruvianError(f"viewBox: expected four numbers, found {attributes['viewBox']!r:.60}")
        low = np.array([x, y])
        sizes = [attributes.get(n, "100%") for n in ("width", "height")]
        known = [
            _number(attributes, n) / size
            for n, size, said in zip(("width", "height"), (width, height), sizes)
            if not said.strip().endswith("%")
        ]
        if len(known) == 2 and not 0.98 < known[0] / max(known[1], 1e-12) < 1.02:
            raise VitruvianError("expected width and height in the proportion of the viewBox; scale it by hand")
        scale = known[0] if known else 1.0
    scale *= UNITS["px"]
    if not 1e-6 < scale < 1e6:
        raise VitruvianError(f"expected a drawing of some size, found {scale:g} mm a unit")
    return np.array([[scale, 0, -scale * low[0]], [0, -scale, scale * low[1]], [0, 0, 1.0]])


def _data(tag: str, attributes: dict[str, str]) -> str:
    """Path data of a shape; "" for what is none."""
    if tag == "path":
        return attributes.get("d", "")
    if tag in ("polygon", "polyline"):
        points = attributes.get("points", "").strip()
        return f"M{points}{'Z' if tag == 'polygon' else ''}" if points else ""
    value = lambda name, default=0.0: _number(attributes, name, default)  # noqa: E731
    if tag == "line":
        return f"M{value('x1')!r},{value('y1')!r}L{value('x2')!r},{value('y2')!r}"
    if tag == "rect":
        x, y, w, h = (value(n) for n in ("x", "y", "width", "height"))
        return f"M{x!r},{y!r}h{w!r}v{h!r}h{-w!r}z" if w > 0 and h > 0 else ""
    if tag in ("circle", "ellipse"):
        cx, cy = value("cx"), value("cy")
        rx, ry = (value("r"), value("r")) if tag == "circle" else (value("rx"), value("ry"))
        arc = f"a{rx!r},{ry!r} 0 1 0"
        return f"M{cx - rx!r},{cy!r}{arc} {2 * rx!r},0{arc} {-2 * rx!r},0z" if rx > 0 and ry > 0 else ""
    return ""
