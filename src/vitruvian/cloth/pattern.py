"""Sewing patterns: flat panels with straight and curved edges, and the seams that join them.

A panel lives in a plane of its own, (u, v) in metres; v is the warp unless its grain says otherwise. It is placed around
the body by x = R (u, v, 0) + t, or rolled about its middle, and R (0, 0, sign of its area) points away from the body there:
panels wind either way round.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import comb
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, floats, require

# Points that a curve has beside its ends: controls of the Beziers, one point half way along an arc; None: any number
KINDS: Mapping[str, int | None] = MappingProxyType({"line": 0, "quadratic": 1, "cubic": 2, "arc": 1, "polyline": None})
SEAMS = ("plain", "gather", "ease", "dart", "pleat")
CHORDS = 256  # of a Bezier curve, to measure along it


@dataclass(frozen=True, eq=False)
class Edge:
    """From vertex `start` of a panel to vertex `end`: kind as in `KINDS`, points (k,2) metres in the panel's plane.

    All curves are given by points, so that moving, scaling and mirroring a panel means doing so to its points.
    """

    start: int
    end: int
    kind: str = "line"
    points: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    label: str = ""

    def __post_init__(self) -> None:
        require(self.kind in KINDS, "kind", f"one of {', '.join(KINDS)}", repr(self.kind))
        object.__setattr__(self, "points", floats(self.points, "points", KINDS[self.kind], 2))


@dataclass(frozen=True, eq=False)
class Panel:
    """One piece of cloth.

    vertices (n,2) metres; edges chain vertex to vertex into closed loops, the outline first, then holes. grain (2,) is
    the direction of the warp. rotation (3,3) and translation (3,) place it around the body, H-Anim frame; None where a
    pattern does not say. bend (2,) rolls it around the body there: the direction in its plane in which it curves inwards,
    as long as 1 / radius, 1/m; (0, 0) is flat. label is the part of the body it belongs to ("body", "arm", "leg", "");
    fabric a name, or "" for the garment's; order counts layers outwards.
    """

    name: str
    vertices: Floats
    edges: tuple[Edge, ...]
    label: str = ""
    rotation: Floats | None = None
    translation: Floats | None = None
    grain: Floats = field(default_factory=lambda: np.array([0.0, 1.0]))
    fabric: str = ""
    order: int = 0
    bend: Floats = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        name = f"panel {self.name}: "
        object.__setattr__(self, "vertices", floats(self.vertices, name + "vertices", None, 2))
        object.__setattr__(self, "grain", floats(self.grain, name + "grain", 2))
        object.__setattr__(self, "bend", floats(self.bend, name + "bend", 2))
        require(bool(np.any(self.grain)), name + "grain", "a direction", "zero")
        for i, edge in enumerate(self.edges):
            good = 0 <= edge.start < len(self.vertices) and 0 <= edge.end < len(self.vertices)
            found = f"{edge.start} to {edge.end}"
            require(good, f"{name}edge {i}", f"vertices of 0 to {len(self.vertices) - 1}", found)
        if self.rotation is not None:
            object.__setattr__(self, "rotation", floats(self.rotation, name + "rotation", 3, 3))
        if self.translation is not None:
            object.__setattr__(self, "translation", floats(self.translation, name + "translation", 3))


@dataclass(frozen=True)
class Span:
    """Part of a panel's edge, from t0 to t1 of its normalised arc length (t0 < t1)."""

    panel: str
    edge: int
    t0: float = 0.0
    t1: float = 1.0

    def __post_init__(self) -> None:
        name, found = f"{self.panel} edge {self.edge}", f"{self.t0}, {self.t1}"
        require(0 <= self.t0 < self.t1 <= 1, name, "0 <= t0 < t1 <= 1", found)


@dataclass(frozen=True)
class Seam:
    """Side a sewn to side b, each one or more spans, one after the other along a loop.

    reversed: the end of a meets the start of b, which is how two pieces that wind the same way lie edge to edge.
    Sides may differ in length: the longer is gathered evenly. open: a slit that may be closed, not sewn.
    """

    a: tuple[Span, ...]
    b: tuple[Span, ...]
    reversed: bool = True
    kind: str = "plain"
    open: bool = False

    def __post_init__(self) -> None:
        require(self.kind in SEAMS, "seam", f"one of {', '.join(SEAMS)}", repr(self.kind))
        require(bool(self.a and self.b), "seam", "two sides", "one")


@dataclass(frozen=True)
class Button:
    """Two points that are held together when the garment is closed: (panel, (u, v) metres) each."""

    a: tuple[str, tuple[float, float]]
    b: tuple[str, tuple[float, float]]


@dataclass(frozen=True)
class Pattern:
    """Panels and seams. measures: of the body that it was drafted for, metres; extra: what a file said besides."""

    name: str
    panels: tuple[Panel, ...]
    seams: tuple[Seam, ...] = ()
    buttons: tuple[Button, ...] = ()
    measures: Mapping[str, float] = field(default_factory=dict)
    extra: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = [p.name for p in self.panels]
        require(bool(names), f"pattern {self.name}", "at least one panel", "none")
        twice = next((n for i, n in enumerate(names) if n in names[:i]), None)
        require(twice is None, f"pattern {self.name}", "different names of panels", f"{twice!r} twice")

    def panel(self, name: str) -> Panel:
        """The panel of that name; KeyError otherwise."""
        found = [p for p in self.panels if p.name == name]
        if not found:
            raise KeyError(name)
        return found[0]


def loops(panel: Panel) -> Iterator[list[int]]:
    """Indices of the edges of each closed loop; one that does not close (see the doctor) ends where it breaks off."""
    loop: list[int] = []
    for i, edge in enumerate(panel.edges):
        if loop and panel.edges[loop[-1]].end != edge.start:
            yield loop
            loop = []
        loop.append(i)
        if edge.end == panel.edges[loop[0]].start:
            yield loop
            loop = []
    if loop:
        yield loop


def ends(panel: Panel, edge: int) -> tuple[Floats, Floats]:
    """(2,) metres each: where the edge starts and ends."""
    e = panel.edges[edge]
    return panel.vertices[e.start], panel.vertices[e.end]


def length(panel: Panel, edge: int) -> float:
    """Metres along the edge."""
    a, b = ends(panel, edge)
    e = panel.edges[edge]
    if e.kind == "arc":
        center, start, angle = _arc(a, e.points[0], b)
        return float(np.hypot(*(a - center)) * abs(angle)) if angle else float(np.hypot(*(b - a)))
    return float(np.hypot(*np.diff(knots(e, a, b), axis=0).T).sum())


def along(panel: Panel, edge: int, t: object) -> Floats:
    """(k,2) metres: points of the edge at t (k,) of its normalised arc length."""
    a, b = ends(panel, edge)
    e = panel.edges[edge]
    t = np.clip(np.atleast_1d(np.asarray(t, np.float64)), 0.0, 1.0)
    if e.kind == "arc":
        center, start, angle = _arc(a, e.points[0], b)
        if angle:
            radius, turn = np.hypot(*(a - center)), start + t * angle
            out = center + radius * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        else:
            out = a + t[:, None] * (b - a)
    else:
        way = knots(e, a, b)
        steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
        at = t * steps[-1]
        out = np.stack([np.interp(at, steps, way[:, 0]), np.interp(at, steps, way[:, 1])], axis=-1)
    out[t == 0], out[t == 1] = a, b
    return out


def arc(panel: Panel, edge: int) -> tuple[Floats, float, float]:
    """Centre (2,) metres, start angle and signed angle of an edge that is an arc; angle 0: a straight line."""
    a, b = ends(panel, edge)
    return _arc(a, panel.edges[edge].points[0], b)


def outline(panel: Panel, loop: list[int], step: float = 0.002) -> Floats:
    """(k,2) metres: the loop as a polygon with a point at least every `step` of each curve; lines stay whole."""
    pieces = []
    for i in loop:
        straight = panel.edges[i].kind == "line"
        count = 1 if straight else max(8, int(np.ceil(length(panel, i) / step)))
        pieces.append(along(panel, i, np.arange(count) / count))
    return np.concatenate(pieces)


def area(panel: Panel) -> float:
    """Square metres, positive where the outline winds counter-clockwise; holes taken off."""
    parts = [_area(panel, loop) for loop in loops(panel)]
    return parts[0] - np.sign(parts[0]) * sum(abs(p) for p in parts[1:]) if parts else 0.0


def _area(panel: Panel, loop: list[int]) -> float:
    """Signed area of a loop: its polygon of chords, and for arcs the exact segments beside them."""
    total = 0.0
    for i in loop:
        a, b = ends(panel, i)
        e = panel.edges[i]
        if e.kind == "arc":
            center, _, angle = _arc(a, e.points[0], b)
            total += 0.5 * (a[0] * b[1] - a[1] * b[0])
            total += 0.5 * float(np.sum((a - center) ** 2)) * (angle - np.sin(angle)) if angle else 0.0
        else:
            p = knots(e, a, b)
            total += 0.5 * float(np.sum(p[:-1, 0] * p[1:, 1] - p[:-1, 1] * p[1:, 0]))
    return total


def knots(e: Edge, a: Floats, b: Floats) -> Floats:
    """Points along a line, polyline or Bezier; chords of the latter."""
    if e.kind in ("line", "polyline"):
        return np.concatenate([a[None], e.points, b[None]])
    t, control = np.linspace(0.0, 1.0, CHORDS + 1)[:, None], np.concatenate([a[None], e.points, b[None]])
    degree = len(control) - 1
    return sum(comb(degree, k) * t**k * (1 - t) ** (degree - k) * c for k, c in enumerate(control))


def _arc(a: Floats, middle: Floats, b: Floats) -> tuple[Floats, float, float]:
    """Centre (2,), start angle and signed angle of the arc from a through its middle to b; angle 0: a straight line."""
    chord, sag = b - a, middle - 0.5 * (a + b)
    width = np.hypot(*chord)
    across = np.array([chord[1], -chord[0]])  # to the right of the chord
    h = float(sag @ across) / width if width else float(np.hypot(*sag))
    if width and abs(h) < 1e-9 * width:
        return a, 0.0, 0.0
    if not width:  # a whole circle
        center = 0.5 * (a + middle)
        return center, float(np.arctan2(*(a - center)[::-1])), 2 * np.pi
    # a sag h to the right turns counter-clockwise by 4 atan(2 h / width)
    angle = 4 * np.arctan2(2 * h, width)
    radius = (width * width / 4 + h * h) / (2 * h)
    center = 0.5 * (a + b) + across / width * (h - radius)
    return center, float(np.arctan2(*(a - center)[::-1])), float(angle)


def placed(panel: Panel, points: Floats) -> NDArray[np.float64]:
    """(k,3) metres around the body of points (k,2) of a panel that has a place."""
    if panel.rotation is None or panel.translation is None:
        raise ValueError(f"panel {panel.name}: expected a place")
    strength = float(np.hypot(*panel.bend))
    if not strength:
        return points @ panel.rotation[:, :2].T + panel.translation
    way = panel.bend / strength
    middle = 0.5 * (panel.vertices.min(axis=0) + panel.vertices.max(axis=0))
    along = (points - middle) @ way
    turn = strength * along
    flat = points + np.multiply.outer(np.sin(turn) / strength - along, way)
    deep = (np.cos(turn) - 1) / strength * (1.0 if area(panel) > 0 else -1.0)
    return np.column_stack([flat, deep]) @ panel.rotation.T + panel.translation
