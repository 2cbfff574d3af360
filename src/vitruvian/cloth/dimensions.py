"""Dimensions of a pattern as expressions of a body's measures, such as `chest/4 + 2`, in centimetres as tailors write them.

A pattern keeps them in `extra["drawing"]["dimensions"]`, as the editor in the page writes them, each an object:

    {"panel": "front", "edge": 2, "length": "chest/4 + 2", "fix": "start", "stretch": true}    the length of an edge
    {"panel": "front", "axis": 0, "length": "hips/2 + 3"}                                      the width (0) or height (1)

fix: which end of the edge stays ("start", "end", or "middle" for neither); stretch: all of the panel that lies beyond an
end goes with it. The page has twins of what is here, in show/page/pattern/measures.js and shaping.js.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Edge, Panel, Pattern, ends, length, loops, outline
from vitruvian.errors import VitruvianError

LONGEST, DEEPEST = 200, 50  # characters, brackets in brackets
PASSES = 3  # one dimension may move what another had set
MOST = 2000  # dimensions of a pattern
FUNCTIONS: Mapping[str, Callable[..., float]] = {"min": min, "max": max, "sqrt": math.sqrt, "abs": abs}
ONE = ("sqrt", "abs")  # functions of one number
SHARES = {"start": (0.0, 1.0), "middle": (-0.5, 0.5), "end": (-1.0, 0.0)}  # how far the ends go
_TOKEN = re.compile(r"\s*(?:(\d+(?:\.\d*)?|\.\d+)|([A-Za-z_]\w*)|([-+*/(),]))", re.ASCII)


def evaluate(text: str, measures: Mapping[str, float]) -> float:
    """Centimetres that an expression says for a body of these measures (metres).

    Numbers, names of measures, + - * / and brackets, min, max, sqrt and abs; nothing else is understood, and no code is
    run. Raises VitruvianError in one line.
    """
    try:
        value = _Reader(text, measures).value()
    except (ArithmeticError, ValueError) as error:
        raise VitruvianError(f"dimension {text!r:.60}: it has no value: {error}") from None
    if not math.isfinite(value):
        raise VitruvianError(f"dimension {text!r:.60}: it has no value")
    return value


class _Reader:
    """Reads an expression from left to right."""

    def __init__(self, text: str, measures: Mapping[str, float]):
        self.text, self.measures = text, measures
        if len(text) > LONGEST:
            raise self.wrong(f"expected at most {LONGEST} characters")
        self.words: list[float | str] = []
        whole, at = text.rstrip(), 0
        while at < len(whole):
            found = _TOKEN.match(whole, at)
            if found is None:
                raise self.wrong(f"did not expect {whole[at:].strip()[0]}")
            self.words.append(float(found[1]) if found[1] is not None else found[2] or found[3])
            at = found.end()
        if not self.words:
            raise self.wrong("expected a length")
        self.words.reverse()

    def wrong(self, what: str) -> VitruvianError:
        return VitruvianError(f"dimension {self.text!r:.60}: {what}")

    @property
    def next(self) -> float | str | None:
        return self.words[-1] if self.words else None

    def value(self) -> float:
        out = self.sum(0)
        if self.words:
            raise self.wrong(f"did not expect {self.next}")
        return out

    def sum(self, deep: int) -> float:
        out = self.product(deep)
        while self.next in ("+", "-"):
            out = out + self.product(deep) if self.words.pop() == "+" else out - self.product(deep)
        return out

    def product(self, deep: int) -> float:
        out = self.signed(deep)
        while self.next in ("*", "/"):
            out = out * self.signed(deep) if self.words.pop() == "*" else out / self.signed(deep)
        return out

    def signed(self, deep: int) -> float:
        if deep > DEEPEST:
            raise self.wrong("expected fewer brackets")
        if self.next in ("+", "-"):
            return self.signed(deep + 1) if self.words.pop() == "+" else -self.signed(deep + 1)
        return self.atom(deep)

    def atom(self, deep: int) -> float:
        if not self.words:
            raise self.wrong("it ends too early")
        word = self.words.pop()
        if isinstance(word, float):
            return word
        if word == "(":
            out = self.sum(deep + 1)
            self.close()
            return out
        if not word[0].isalpha():
            raise self.wrong(f"expected a number or a measure, found {word}")
        if self.next == "(":
            return self.call(word, deep)
        if word not in self.measures:
            raise self.wrong(f"no measure {word}: there are {', '.join(sorted(self.measures)) or 'none'}")
        return 100.0 * self.measures[word]

    def call(self, name: str, deep: int) -> float:
        if name not in FUNCTIONS:
            raise self.wrong(f"no function {name}: there are {', '.join(FUNCTIONS)}")
        self.words.pop()
        values = [self.sum(deep + 1)]
        while self.next == ",":
            self.words.pop()
            values.append(self.sum(deep + 1))
        self.close()
        if name in ONE and len(values) > 1:
            raise self.wrong(f"{name} takes one number")
        return FUNCTIONS[name](*values) if name in ONE else FUNCTIONS[name](values)

    def close(self) -> None:
        if self.next != ")":
            raise self.wrong("expected a closing bracket")
        self.words.pop()


def fitted(pattern: Pattern, measures: Mapping[str, float]) -> Pattern:
    """The pattern with all its dimensions evaluated for a body of these measures (metres), which it then carries.

    Raises VitruvianError for a dimension that cannot be evaluated, naming its panel. Patterns without stay as they are.
    """
    lines = dimensions(pattern)
    if not lines:
        return pattern
    panels = {p.name: p for p in pattern.panels}
    for _ in range(PASSES):
        for line in lines:
            name, edge = line["panel"], line.get("edge")
            panel = panels.get(name)
            if panel is None or (edge is not None and not 0 <= edge < len(panel.edges)):
                continue
            try:
                wanted = evaluate(line["length"], measures) / 100
                if not wanted > 0:
                    raise VitruvianError(f"dimension {line['length']!r:.60}: a length has to be positive")
            except VitruvianError as error:
                raise VitruvianError(f"panel {name:.60}: {error}") from None
            if edge is None:
                panels[name] = extended(panel, line["axis"], wanted)
            else:
                fix, stretch = line.get("fix", "start"), line.get("stretch", True)
                panels[name] = lengthened(panel, edge, wanted, fix=fix, stretch=stretch)
    return replace(pattern, panels=tuple(panels[p.name] for p in pattern.panels), measures=dict(measures))


def dimensions(pattern: Pattern) -> list[dict[str, Any]]:
    """What a pattern says in `extra["drawing"]["dimensions"]`; lines of another shape are left out."""
    kept = pattern.extra.get("drawing")
    lines = kept.get("dimensions") if isinstance(kept, Mapping) else None
    if not isinstance(lines, list | tuple):
        return []
    return [dict(line) for line in lines[:MOST] if isinstance(line, Mapping) and _good(line)]


def _good(line: Mapping[str, Any]) -> bool:
    about = type(line.get("edge")) is int if "edge" in line else line.get("axis") in (0, 1)
    texts = isinstance(line.get("panel"), str) and isinstance(line.get("length"), str)
    return about and texts and line.get("fix", "start") in SHARES and isinstance(line.get("stretch", True), bool)


def lengthened(panel: Panel, edge: int, wanted: float, *, fix: str = "start", stretch: bool = True) -> Panel:
    """The panel with its edge `wanted` metres long. fix and stretch as in the module's head; curves are turned and scaled
    with their chords. An edge without a chord stays as it is."""
    (a, b), now = ends(panel, edge), length(panel, edge)
    chord = b - a
    long = float(np.hypot(*chord))
    if not (now > 0 and long > 0) or abs(now - wanted) < 1e-10:
        return panel
    grown, way = chord * (wanted / now - 1), chord / long
    at = (panel.vertices - a) @ way
    low, high = SHARES[fix]
    share = np.where(at >= long - 1e-6, high, np.where(at <= 1e-6, low, 0.0)) if stretch else np.zeros(len(at))
    share[panel.edges[edge].end] = high
    share[panel.edges[edge].start] = low
    return moved(panel, panel.vertices + share[:, None] * grown)


def moved(panel: Panel, vertices: Floats) -> Panel:
    """The panel with its vertices (n,2) elsewhere, and the curves turned and scaled with their chords."""
    edges = []
    for e in panel.edges:
        old, new = panel.vertices[[e.start, e.end]], vertices[[e.start, e.end]]
        edges.append(replace(e, points=_carried(e, old, new)) if len(e.points) and (old != new).any() else e)
    return replace(panel, vertices=vertices, edges=tuple(edges))


def _carried(edge: Edge, old: Floats, new: Floats) -> Floats:
    start, chord, to = old[0], old[1] - old[0], new[1] - new[0]
    square = float(chord @ chord)
    if square < 1e-18:
        return edge.points - start + new[0]
    re, im = float(chord @ to) / square, float(chord[0] * to[1] - chord[1] * to[0]) / square
    x, y = (edge.points - start).T
    return new[0] + np.stack([re * x - im * y, im * x + re * y], axis=1)


def extended(panel: Panel, axis: int, wanted: float) -> Panel:
    """The panel scaled along u (axis 0) or v (1) so that its outline is `wanted` metres wide or high."""
    points = np.concatenate([outline(panel, loop, 0.01) for loop in loops(panel)])
    low, now = points[:, axis].min(), np.ptp(points[:, axis])
    if not now > 0 or abs(now - wanted) < 1e-10:
        return panel

    def put(p: Floats) -> Floats:
        out = p.copy()
        out[:, axis] = low + (p[:, axis] - low) * (wanted / now)
        return out

    edges = tuple(replace(e, points=put(e.points)) if len(e.points) else e for e in panel.edges)
    return replace(panel, vertices=put(panel.vertices), edges=edges)
