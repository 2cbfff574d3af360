"""GarmentCode's pattern files: panels with curved edges, their places around the body, and stitches.

Source: the format as described in note cloth.md, section 2.1.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Edge, Panel, Pattern, Seam, Span
from vitruvian.errors import VitruvianError
from vitruvian.formats.json_checked import MOST, a_list, a_text, an_object, is_number, numbers, read_checked, wrong

UNITS = (0.1, 100_000.0)  # in a metre


def read_garmentcode(path: str | Path) -> Pattern:
    """The pattern of a GarmentCode file, metres. Raises `FileError` that names the panel and edge."""
    return read_checked(path, lambda whole: _pattern(whole, Path(path).name.split(".")[0]))


def _pattern(whole: object, name: str) -> Pattern:
    top = an_object(whole, "file")
    properties = an_object(top.get("properties", {}), "properties")
    unit = properties.get("units_in_meter")
    if not is_number(unit) or not UNITS[0] <= unit <= UNITS[1]:
        raise wrong("properties.units_in_meter", "how many of its units are a metre, 100 for centimetres", unit)
    curved = properties.get("curvature_coords", "relative")
    if curved not in ("relative", "absolute"):
        raise wrong("properties.curvature_coords", "relative or absolute", curved)
    pattern = an_object(top.get("pattern"), "pattern")
    panels = an_object(pattern.get("panels"), "pattern.panels")
    if len(panels) > MOST:
        raise wrong("pattern.panels", f"at most {MOST} panels", len(panels))
    made = tuple(_panel(n, p, 1 / unit, curved == "relative") for n, p in panels.items())
    counts = {p.name: len(p.edges) for p in made}
    stitches = a_list(pattern.get("stitches", []), "pattern.stitches")
    seams = tuple(_seam(s, f"stitch {i}", counts) for i, s in enumerate(stitches))
    extra = {k: v for k, v in top.items() if k != "pattern"}
    extra |= {k: v for k, v in pattern.items() if k not in ("panels", "stitches")}
    return Pattern(name, made, seams, extra=extra)


def _panel(name: str, value: object, scale: float, relative: bool) -> Panel:
    where = f"panel {a_text(name, 'panel', some=True):.40}"
    panel = an_object(value, where)
    rows = a_list(panel.get("vertices"), f"{where} vertices")
    vertices = np.array([numbers(v, f"{where} vertex {i}", 2) for i, v in enumerate(rows)]).reshape(-1, 2) * scale
    rows = a_list(panel.get("edges"), f"{where} edges")
    edges = tuple(_edge(e, f"{where} edge {i}", vertices, scale, relative) for i, e in enumerate(rows))
    turn = np.radians(numbers(panel.get("rotation", [0, 0, 0]), f"{where} rotation", 3))
    move = numbers(panel.get("translation", [0, 0, 0]), f"{where} translation", 3) * scale
    label = panel.get("label", "")
    return Panel(name, vertices, edges, label if isinstance(label, str) else "", _rotation(turn), move)


def _rotation(angles: Floats) -> Floats:
    """Rz Ry Rx of angles about x, y and z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    rx = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    ry = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    rz = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return rz @ ry @ rx


def _edge(value: object, where: str, vertices: Floats, scale: float, relative: bool) -> Edge:
    edge = an_object(value, where)
    ends = edge.get("endpoints")
    good = isinstance(ends, list) and len(ends) == 2 and all(isinstance(e, int) for e in ends)
    if not isinstance(ends, list) or not good or not all(0 <= e < len(vertices) for e in ends):
        raise wrong(f"{where} endpoints", f"two vertices of 0 to {len(vertices) - 1}", ends)
    start, end = ends
    label = edge.get("label", "")
    label = label if isinstance(label, str) else ""
    curve = edge.get("curvature")
    if curve is None:
        return Edge(start, end, label=label)
    if isinstance(curve, list):  # as it was written once: the control of a quadratic curve
        curve = {"type": "quadratic", "params": [curve]}
    kind, given = an_object(curve, where).get("type"), an_object(curve, where).get("params")
    a, b = vertices[start], vertices[end]
    if kind == "circle":
        radius, large, right = numbers(given, f"{where} circle", 3)
        return Edge(start, end, "arc", _half_way(a, b, radius * scale, bool(large), bool(right))[None], label)
    count = {"quadratic": 1, "cubic": 2}.get(kind) if isinstance(kind, str) else None
    if count is None or not isinstance(kind, str):
        raise wrong(f"{where} curvature", "quadratic, cubic or circle", kind)
    rows = [numbers(p, f"{where} control", 2) for p in a_list(given, f"{where} controls")]
    if len(rows) != count:
        raise wrong(f"{where} curvature", f"{count} controls of a {kind} curve", len(rows))
    along, across = b - a, np.array([a[1] - b[1], b[0] - a[0]])
    points = [a + x * along + y * across if relative else scale * np.array([x, y]) for x, y in rows]
    return Edge(start, end, kind, np.array(points), label)


def _half_way(a: Floats, b: Floats, radius: float, large: bool, right: bool) -> Floats:
    """The middle of the arc from a to b on that side of the chord."""
    way = b - a
    chord = float(np.hypot(*way))
    if not chord:
        raise VitruvianError("circle: expected an arc between two places, found one place")
    half = chord / 2
    flat = math.sqrt(max(radius * radius - half * half, 0.0))
    radius = max(abs(radius), half)
    sag = radius + flat if large else radius - flat
    across = np.array([way[1], -way[0]]) / chord  # to the right
    return 0.5 * (a + b) + (sag if right else -sag) * across


def _seam(value: object, where: str, counts: Mapping[str, int]) -> Seam:
    stitch = a_list(value, where, 3)
    if len(stitch) < 2:
        raise wrong(where, "two sides", value)
    sides = []
    for side in stitch[:2]:
        panel, edge = (an_object(side, where).get(k) for k in ("panel", "edge"))
        if (
            not isinstance(panel, str)
            or panel not in counts
            or not isinstance(edge, int)
            or not 0 <= edge < counts[panel]
        ):
            raise wrong(where, "a panel and one of its edges", side)
        sides.append((Span(panel, edge),))
    if len(stitch) == 3 and stitch[2] != "right_wrong":
        raise wrong(where, "right_wrong as the third entry", stitch[2])
    return Seam(sides[0], sides[1], reversed=len(stitch) < 3)
