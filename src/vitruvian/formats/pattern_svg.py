"""Drawings of patterns at scale 1:1: SVG in millimetres, seams in colours that match."""

from __future__ import annotations

import colorsys
from html import escape
from pathlib import Path

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Panel, Pattern, along, arc, area, ends, length, loops, outline
from vitruvian.formats.atomic import atomic

MARGIN, GAP = 12.0, 14.0  # mm around the drawing and between panels
WIDEST = 1600.0  # mm: fabric is about as wide
GOLDEN = 0.61803398875
Sewn = dict[tuple[str, int], list[tuple[int, str, float, float, bool]]]  # see sewn_edges


def write_svg(pattern: Pattern, path: str | Path) -> None:
    """The panels beside each other, one unit of the drawing a millimetre of cloth.

    Each edge has its number and length; edges that are sewn to each other have one colour and the seam's number, and an
    arrow along which both sides run together.
    """
    with atomic(path) as temporary:
        Path(temporary).write_text(drawing(pattern), encoding="utf-8")


def drawing(pattern: Pattern) -> str:
    """The text of `write_svg`."""
    places, (width, height) = laid_out(pattern)
    seams = sewn_edges(pattern)
    body = []
    for panel, move in zip(pattern.panels, places):
        body += _panel(panel, move, seams)
    box = f"{width:.2f} {height:.2f}"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.2f}mm" height="{height:.2f}mm" viewBox="0 0 {box}">\n'
        f"<title>{escape(pattern.name)}</title>\n<style>\n"
        ".cloth{fill:#f7f3ea;stroke:none} .edge{fill:none;stroke:#444;stroke-width:.7}\n"
        ".seam{fill:none;stroke-width:1.6;stroke-linecap:round} .grain{stroke:#999;stroke-width:.5}\n"
        "text{font-family:sans-serif;fill:#333;text-anchor:middle} .name{font-size:13px;font-weight:600}\n"
        ".mark{font-size:5.5px} .of{font-size:7px;font-weight:700}\n</style>\n"
    )
    return head + "\n".join(body) + "\n</svg>\n"


def laid_out(pattern: Pattern) -> tuple[list[Floats], tuple[float, float]]:
    """Millimetres by which each panel is moved (2,), y down, so that they lie in rows, and the size of the drawing."""
    boxes = []
    for panel in pattern.panels:
        points = np.concatenate([page(outline(panel, loop)) for loop in loops(panel)] or [np.zeros((1, 2))])
        boxes.append((points.min(axis=0), np.ptp(points, axis=0)))
    widest = max(WIDEST, max((size[0] for _, size in boxes), default=0) + 2 * MARGIN)
    order = sorted(range(len(boxes)), key=lambda k: -boxes[k][1][1])
    places = [np.zeros(2)] * len(boxes)
    x = y = MARGIN
    row = right = 0.0
    for k in order:
        low, size = boxes[k]
        if x > MARGIN and x + size[0] + MARGIN > widest:
            x, y, row = MARGIN, y + row + GAP, 0.0
        places[k] = np.array([x, y]) - low
        x, row = x + float(size[0]) + GAP, max(row, float(size[1]))
        right = max(right, x - GAP)
    return places, (right + MARGIN, y + row + MARGIN)


def page(points: Floats) -> Floats:
    """Millimetres of the drawing, y down, of metres in a panel."""
    return points * [1000.0, -1000.0]


def _path(points: Floats, closed: bool = False) -> str:
    return "M" + "L".join(f"{x:.2f},{y:.2f}" for x, y in points) + ("Z" if closed else "")


def _curves(panel: Panel, loop: list[int], move: Floats) -> str:
    """Path data of a loop with its curves, to a tenth of a micrometre."""
    out: list[str] = []
    for i in loop:
        edge = panel.edges[i]
        a, b = (page(p) + move for p in ends(panel, i))
        inner = page(edge.points) + move
        if not out:
            out.append(f"M{_at(a)}")
        if edge.kind == "arc":
            center, _, angle = arc(panel, i)
            radius = 1000 * float(np.hypot(*(ends(panel, i)[0] - center)))
            if not angle:
                out.append(f"L{_at(b)}")
            elif abs(angle) < 1.99 * np.pi:
                out.append(f"A{radius:.4f} {radius:.4f} 0 {int(abs(angle) > np.pi)} {int(angle < 0)} {_at(b)}")
            else:  # an arc that ends where it began is none in SVG
                half = f"A{radius:.4f} {radius:.4f} 0 0 {int(angle < 0)} "
                out.append(f"{half}{_at(inner[0])}{half}{_at(b)}")
        elif edge.kind == "polyline":
            out += [f"L{_at(p)}" for p in (*inner, b)]
        else:
            letter = {"line": "L", "quadratic": "Q", "cubic": "C"}[edge.kind]
            out.append(letter + " ".join(_at(p) for p in (*inner, b)))
    return "".join(out) + "Z"


def _at(point: Floats) -> str:
    return f"{point[0]:.4f},{point[1]:.4f}"


def sewn_edges(pattern: Pattern) -> Sewn:
    """For each edge its seams: number, colour, from and to, and whether the seam runs along it."""
    out: Sewn = {}
    for k, seam in enumerate(pattern.seams):
        r, g, b = colorsys.hls_to_rgb((k * GOLDEN) % 1, 0.42, 0.62)
        color = f"#{round(255 * r):02x}{round(255 * g):02x}{round(255 * b):02x}"
        for side, forward in ((seam.a, True), (seam.b, not seam.reversed)):
            for s in side:
                out.setdefault((s.panel, s.edge), []).append((k, color, s.t0, s.t1, forward))
    return out


def _panel(panel: Panel, move: Floats, seams: Sewn) -> list[str]:
    out = [f'<g id="{escape(panel.name)}">']
    shapes = [page(outline(panel, loop)) + move for loop in loops(panel)]
    curves = "".join(_curves(panel, loop, move) for loop in loops(panel))
    out.append(f'<path class="cloth" fill-rule="evenodd" d="{curves}"/>')
    middle = shapes[0].mean(axis=0) if shapes else move
    for i in range(len(panel.edges)):
        curve = page(along(panel, i, np.linspace(0, 1, 2 if panel.edges[i].kind == "line" else 49))) + move
        out.append(f'<path class="edge" d="{_path(curve)}"/>')
        way = unit(curve[len(curve) // 2] - curve[len(curve) // 2 - 1])
        inward = np.array([way[1], -way[0]]) * (1.0 if area(panel) > 0 else -1.0)
        for k, color, low, high, forward in seams.get((panel.name, i), []):
            own = page(along(panel, i, np.linspace(low, high, 49))) + move
            out.append(f'<path class="seam" stroke="{color}" d="{_path(own)}"/>')
            out += _arrow(own if forward else own[::-1], color, k, inward)
        a, b = (page(p) + move for p in ends(panel, i))
        at = page(along(panel, i, 0.5))[0] + move
        inner = at + 7 * inward
        turn = np.degrees(np.arctan2(b[1] - a[1], b[0] - a[0]))
        turn = turn - 180 if turn > 90 else turn + 180 if turn < -90 else turn
        said = f"{i}: {100 * length(panel, i):.1f} cm"
        where = f'x="{inner[0]:.2f}" y="{inner[1]:.2f}" transform="rotate({turn:.1f} {inner[0]:.2f} {inner[1]:.2f})"'
        out.append(f'<text class="mark" {where}>{said}</text>')
    warp = unit(panel.grain * [1.0, -1.0]) * 35
    (x1, y1), (x2, y2) = middle - warp, middle + warp
    out.append(f'<line class="grain" x1="{x1:.2f}" y1="{y1:.2f}" x2="{x2:.2f}" y2="{y2:.2f}"/>')
    out.append(f'<text class="name" x="{middle[0]:.2f}" y="{middle[1]:.2f}">{escape(panel.name)}</text></g>')
    return out


def _arrow(points: Floats, color: str, number: int, inward: Floats) -> list[str]:
    """A head on the seam that says which way it runs, and the seam's number outside the panel."""
    here, way = points[len(points) // 2], unit(points[-1] - points[0])
    across = np.array([-way[1], way[0]])
    head = np.array([here + 4 * way, here - 2 * way + 2.4 * across, here - 2 * way - 2.4 * across])
    at = here - 7 * inward
    return [
        f'<path fill="{color}" d="{_path(head, True)}"/>',
        f'<text class="of" style="fill:{color}" x="{at[0]:.2f}" y="{at[1] + 2.4:.2f}">{number}</text>',
    ]


def unit(v: Floats) -> Floats:
    """A vector of length 1; that of none is none."""
    size = float(np.hypot(*v))
    return v / size if size > 0 else v
