"""GarmentCode's pattern files: panels with curved edges, their places around the body, and stitches.

Source: the format as described in note cloth.md, section 2.1.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Edge, Panel, Pattern, Seam, Span
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.source import LIMITS, decode, read_bytes

MOST = 2000  # panels, and edges of one panel: no garment has as many
UNITS = (0.1, 100_000.0)  # in a metre


def read_garmentcode(path: str | Path) -> Pattern:
    """The pattern of a GarmentCode file, metres. Raises `FileError` that names the panel and edge."""
    text = decode(path, read_bytes(path, LIMITS))
    try:
        whole = json.loads(text, parse_constant=_refused)
    except (ValueError, RecursionError) as e:
        raise FileError(path, getattr(e, "lineno", 1), f"expected JSON: {e}") from None
    try:
        return _pattern(whole, Path(path).name.split(".")[0])
    except FileError:
        raise
    except VitruvianError as e:
        raise FileError(path, 1, str(e)) from None


def _refused(word: str) -> float:
    raise ValueError(f"expected a finite number, found {word}")


def _wrong(where: str, expected: str, found: object) -> VitruvianError:
    return VitruvianError(f"{where}: expected {expected}, found {found!r:.60}")


def _object(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, dict):
        raise _wrong(where, "an object", value)
    return value


def _list(value: object, where: str, most: int = MOST) -> list[Any]:
    if not isinstance(value, list):
        raise _wrong(where, "a list", value)
    if len(value) > most:
        raise _wrong(where, f"at most {most} entries", len(value))
    return value


def _numbers(value: object, where: str, count: int) -> Floats:
    if not isinstance(value, list) or len(value) != count or not all(_is_number(v) for v in value):
        raise _wrong(where, f"{count} numbers", value)
    return np.array(value, np.float64)


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _pattern(whole: object, name: str) -> Pattern:
    top = _object(whole, "file")
    properties = _object(top.get("properties", {}), "properties")
    unit = properties.get("units_in_meter")
    if not _is_number(unit) or not UNITS[0] <= unit <= UNITS[1]:
        raise _wrong("properties.units_in_meter", "how many of its units are a metre, 100 for centimetres", unit)
    curved = properties.get("curvature_coords", "relative")
    if curved not in ("relative", "absolute"):
        raise _wrong("properties.curvature_coords", "relative or absolute", curved)
    pattern = _object(top.get("pattern"), "pattern")
    panels = _object(pattern.get("panels"), "pattern.panels")
    if len(panels) > MOST:
        raise _wrong("pattern.panels", f"at most {MOST} panels", len(panels))
    made = tuple(_panel(n, p, 1 / unit, curved == "relative") for n, p in panels.items())
    counts = {p.name: len(p.edges) for p in made}
    stitches = _list(pattern.get("stitches", []), "pattern.stitches")
    seams = tuple(_seam(s, f"stitch {i}", counts) for i, s in enumerate(stitches))
    extra = {k: v for k, v in top.items() if k != "pattern"}
    extra |= {k: v for k, v in pattern.items() if k not in ("panels", "stitches")}
    return Pattern(name, made, seams, extra=extra)


def _panel(name: str, value: object, scale: float, relative: bool) -> Panel:
    where = f"panel {name:.40}"
    panel = _object(value, where)
    rows = _list(panel.get("vertices"), f"{where} vertices")
    vertices = np.array([_numbers(v, f"{where} vertex {i}", 2) for i, v in enumerate(rows)]).reshape(-1, 2) * scale
    rows = _list(panel.get("edges"), f"{where} edges")
    edges = tuple(_edge(e, f"{where} edge {i}", vertices, scale, relative) for i, e in enumerate(rows))
    turn = np.radians(_numbers(panel.get("rotation", [0, 0, 0]), f"{where} rotation", 3))
    move = _numbers(panel.get("translation", [0, 0, 0]), f"{where} translation", 3) * scale
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
    edge = _object(value, where)
    ends = edge.get("endpoints")
    good = isinstance(ends, list) and len(ends) == 2 and all(isinstance(e, int) for e in ends)
    if not isinstance(ends, list) or not good or not all(0 <= e < len(vertices) for e in ends):
        raise _wrong(f"{where} endpoints", f"two vertices of 0 to {len(vertices) - 1}", ends)
    start, end = ends
    label = edge.get("label", "")
    label = label if isinstance(label, str) else ""
    curve = edge.get("curvature")
    if curve is None:
        return Edge(start, end, label=label)
    if isinstance(curve, list):  # as it was written once: the control of a quadratic curve
        curve = {"type": "quadratic", "params": [curve]}
    kind, given = _object(curve, where).get("type"), _object(curve, where).get("params")
    a, b = vertices[start], vertices[end]
    if kind == "circle":
        radius, large, right = _numbers(given, f"{where} circle", 3)
        return Edge(start, end, "arc", _half_way(a, b, radius * scale, bool(large), bool(right))[None], label)
    count = {"quadratic": 1, "cubic": 2}.get(kind) if isinstance(kind, str) else None
    if count is None or not isinstance(kind, str):
        raise _wrong(f"{where} curvature", "quadratic, cubic or circle", kind)
    rows = [_numbers(p, f"{where} control", 2) for p in _list(given, f"{where} controls")]
    if len(rows) != count:
        raise _wrong(f"{where} curvature", f"{count} controls of a {kind} curve", len(rows))
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
    stitch = _list(value, where, 3)
    if len(stitch) < 2:
        raise _wrong(where, "two sides", value)
    sides = []
    for side in stitch[:2]:
        panel, edge = (_object(side, where).get(k) for k in ("panel", "edge"))
        if (
            not isinstance(panel, str)
            or panel not in counts
            or not isinstance(edge, int)
            or not 0 <= edge < counts[panel]
        ):
            raise _wrong(where, "a panel and one of its edges", side)
        sides.append((Span(panel, edge),))
    if len(stitch) == 3 and stitch[2] != "right_wrong":
        raise _wrong(where, "right_wrong as the third entry", stitch[2])
    return Seam(sides[0], sides[1], reversed=len(stitch) < 3)
