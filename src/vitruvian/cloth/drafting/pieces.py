"""Pieces as they are drawn: outlines of named edges, mirrored, unfolded, joined by name.

All are drawn as the wearer is seen from the front: u to the body's left, v up. A front winds counter-clockwise and a back
clockwise, so that both face away from the body and every seam runs end to start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Edge, Panel, Seam, Span, area, length
from vitruvian.errors import VitruvianError

FRONT, BACK = 1, -1
ARMS = np.radians(45.483)  # how far below the horizontal the arms hang for which patterns are placed
SIDES = {"left": "right", "right": "left"}


@dataclass(frozen=True, eq=False)
class Line:
    """An edge of a piece that starts at `at` (2,) metres and runs to the start of the next: straight, or a Bezier curve
    with one or two controls `via`."""

    name: str
    at: tuple[float, float]
    via: tuple[tuple[float, float], ...] = ()
    label: str = ""
    arc: bool = False  # via is the one point half way along an arc


@dataclass(frozen=True, eq=False)
class Piece:
    """A panel and the names of its edges."""

    panel: Panel
    names: tuple[str, ...]

    def edge(self, name: str) -> int:
        """The number of an edge."""
        return self.names.index(name)

    def length(self, *names: str) -> float:
        """Metres along edges."""
        return sum(length(self.panel, self.edge(n)) for n in names)

    def span(self, name: str, t0: float = 0.0, t1: float = 1.0) -> Span:
        """An edge as a seam wants it, or the part of it from t0 to t1 along the outline."""
        return Span(self.panel.name, self.edge(name), t0, t1)


def piece(
    name: str,
    lines: Sequence[Line],
    face: int,
    place: tuple[float, float, float],
    *,
    turn: float = 0.0,
    around: float = 0.0,
    tilt: float = 0.0,
    label: str = "body",
    grain: tuple[float, float] = (0.0, 1.0),
    order: int = 0,
) -> Piece:
    """A piece of closed `lines` that faces forwards (`FRONT`) or backwards, turned about z by `turn`, tilted by
    `tilt` so that what is below leans out, turned about y by `around` radians, and moved to `place`."""
    corners = np.array([line.at for line in lines], np.float64)
    kinds = {0: "line", 1: "quadratic", 2: "cubic"}
    edges = tuple(
        Edge(
            i,
            (i + 1) % len(lines),
            "arc" if line.arc else kinds[len(line.via)],
            np.array(line.via, np.float64).reshape(-1, 2),
            line.label,
        )
        for i, line in enumerate(lines)
    )
    rotation = _about(1, around) @ _about(0, -face * tilt) @ _about(2, turn)
    panel = Panel(name, corners, edges, label, rotation, np.array(place), np.array(grain), order=order)
    if area(panel) * face > 0:
        return Piece(panel, tuple(line.name for line in lines))
    # the other way round: edge k of the new outline is the last but k of the old one
    back = tuple(replace(e, start=e.end, end=e.start, points=e.points[::-1]) for e in edges[::-1])
    return Piece(replace(panel, edges=back), tuple(line.name for line in lines[::-1]))


def _about(axis: int, angle: float) -> Floats:
    """(3,3) rotation about an axis."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i] = out[j, j] = np.cos(angle)
    out[j, i] = np.sin(angle)
    out[i, j] = -out[j, i]
    return out


def mirrored(lines: Sequence[Line]) -> list[Line]:
    """The same closed outline for the body's other side; "left" and "right" at the start of labels change places."""
    ends = [lines[(i + 1) % len(lines)].at for i in range(len(lines))]
    return [_mirrored(line, end) for line, end in zip(lines[::-1], ends[::-1])]


def _mirrored(line: Line, end: tuple[float, float]) -> Line:
    side, _, rest = line.label.partition("_")
    label = f"{SIDES[side]}_{rest}" if side in SIDES else line.label
    via = tuple((-u, v) for u, v in line.via[::-1])
    return replace(line, at=(-end[0], end[1]), via=via, label=label)


def unfolded(half: Sequence[Line], end: tuple[float, float]) -> list[Line]:
    """A whole outline of the half on the body's left, drawn from a point on the fold u = 0 to `end` on the fold. Edges are
    named `l_` and `r_`."""
    ends = [*(line.at for line in half[1:]), end]
    left = [replace(line, name=f"l_{line.name}") for line in half]
    right = [replace(_mirrored(a, b), name=f"r_{a.name}") for a, b in zip(half[::-1], ends[::-1])]
    return left + right


def join(
    one: Piece, names: str | Sequence[str], other: Piece, others: str | Sequence[str] | None = None, kind: str = "plain"
) -> Seam:
    """Edges of two pieces sewn to each other. Several on a side follow one another along the outline."""
    sides = []
    for who, which in ((one, names), (other, names if others is None else others)):
        wanted = [which] if isinstance(which, str) else list(which)
        sides.append(tuple(who.span(n) for n in _in_turn(who, wanted)))
    return Seam(sides[0], sides[1], kind=kind)


def _in_turn(who: Piece, names: Sequence[str]) -> list[str]:
    """Edges in the order of the outline, which goes on from its last edge to its first: begun after the widest gap."""
    order = sorted(names, key=who.edge)
    at = [who.edge(n) for n in order]
    gaps = [(a - b) % len(who.names) for a, b in zip(at, [at[-1], *at[:-1]])]
    first = int(np.argmax(gaps)) if len(order) > 1 else 0
    return order[first:] + order[:first]


def dart(one: Piece, name: str) -> Seam:
    """Both legs of a dart, edges `name`_a and `name`_b."""
    return Seam((one.span(f"{name}_a"),), (one.span(f"{name}_b"),), kind="dart")


def darted(
    start: tuple[float, float], end: tuple[float, float], darts: Sequence[tuple[float, float, float]], label: str = ""
) -> list[Line]:
    """A waist drawn outwards from the middle of the body, with darts of (share of the way, width, depth) metres that point
    down. Edges `waist0`, `dart0_a`, `dart0_b`, `waist1`, ..."""
    a, b = np.array(start), np.array(end)
    way = (b - a) / np.hypot(*(b - a))
    down = np.array([way[1], -way[0]])
    lines = [Line("waist0", start, (), label)]
    for k, (share, width, depth) in enumerate(darts):
        middle = a + share * (b - a)
        corners = [middle - 0.5 * width * way, middle + depth * down, middle + 0.5 * width * way]
        points = [(float(u), float(v)) for u, v in corners]
        lines += [
            Line(f"dart{k}_a", points[0]),
            Line(f"dart{k}_b", points[1]),
            Line(f"waist{k + 1}", points[2], (), label),
        ]
    return lines


def shared(width: float, depth: float, most: float = 0.038) -> list[tuple[float, float, float]]:
    """A width taken in by as many darts as are not wider than `most`; none where it is hardly anything."""
    if width < 0.004:
        return []
    count = int(np.ceil(width / most))
    return [((k + 1) / (count + 1), width / count, depth * (1 - 0.12 * k)) for k in range(count)]


def solved(f: Callable[[float], float], low: float, high: float, what: str) -> float:
    """Where a rising function is 0, by bisection; VitruvianError if it is nowhere between the bounds."""
    if f(low) > 0 or f(high) < 0:
        raise VitruvianError(f"draft: {what} cannot be made for these measures; change the ease")
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if f(middle) < 0 else (low, middle)
    return 0.5 * (low + high)


def curve(*points: tuple[float, float]) -> float:
    """Metres along a line or Bezier curve of 2 to 4 control points."""
    corners = np.array([points[0], points[-1], (1e3, 1e3)])
    kind = {2: "line", 3: "quadratic", 4: "cubic"}[len(points)]
    middle: Floats = np.array(points[1:-1], np.float64).reshape(-1, 2)
    return length(Panel("curve", corners, (Edge(0, 1, kind, middle),)), 0)
