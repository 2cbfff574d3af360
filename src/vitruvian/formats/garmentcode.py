"""GarmentCode's pattern files: panels with curved edges, their places around the body, and stitches.

Source: the format as described in note cloth.md, section 2.1.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Edge, Panel, Pattern, Seam, Span, arc, ends
from vitruvian.errors import VitruvianError
from vitruvian.formats.atomic import atomic
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


def write_garmentcode(pattern: Pattern, path: str | Path) -> list[str]:
    """A file of centimetres that GarmentCode reads; what it cannot hold.

    VitruvianError for edges that are polylines, which the format does not know.
    """
    panels, lost = {}, []
    for panel in pattern.panels:
        move = np.zeros(3) if panel.translation is None else panel.translation
        panels[panel.name] = {
            "translation": (100 * move).tolist(),
            "rotation": _angles(np.eye(3) if panel.rotation is None else panel.rotation),
            "vertices": (100 * panel.vertices).tolist(),
            "edges": [_edge_said(panel, i) for i in range(len(panel.edges))],
        } | ({"label": panel.label} if panel.label else {})
    stitches = []
    for k, seam in enumerate(pattern.seams):
        one = len(seam.a) == len(seam.b) == 1 and all((s.t0, s.t1) == (0, 1) for s in (*seam.a, *seam.b))
        if not one or seam.open:
            lost.append(f"seam {k}, which is {'open' if seam.open else 'of parts of edges, or of several'}")
            continue
        sides: list[Any] = [{"panel": s.panel, "edge": s.edge} for s in (seam.a[0], seam.b[0])]
        stitches.append(sides if seam.reversed else [*sides, "right_wrong"])
    for what, there in (
        ("places", any(p.rotation is None for p in pattern.panels)),
        ("rolled places", any(np.any(p.bend) for p in pattern.panels)),
        ("buttons", pattern.buttons),
        ("fabrics", any(p.fabric for p in pattern.panels)),
        ("grain", any(p.grain[0] or p.grain[1] < 0 for p in pattern.panels)),
        ("kinds of seams", any(s.kind != "plain" for s in pattern.seams)),
    ):
        lost += [what] * bool(there)
    properties = {"units_in_meter": 100, "curvature_coords": "relative", "normalize_panel_translation": False}
    whole = {
        "pattern": {"panels": panels, "stitches": stitches, "panel_order": list(panels)},
        "parameters": {}, "parameter_order": [], "properties": properties | {"normalized_edge_loops": True},
    }  # fmt: skip
    with atomic(path) as temporary:
        Path(temporary).write_text(json.dumps(whole, indent=1), encoding="utf-8")
    return lost


def _angles(r: Floats) -> list[float]:
    """Degrees about x, y and z of Rz Ry Rx."""
    y = math.asin(max(-1.0, min(1.0, -r[2, 0])))
    if abs(r[2, 0]) > 1 - 1e-12:  # x and z turn about one axis
        return [math.degrees(v) for v in (math.atan2(-r[1, 2], r[1, 1]), y, 0.0)]
    return [math.degrees(v) for v in (math.atan2(r[2, 1], r[2, 2]), y, math.atan2(r[1, 0], r[0, 0]))]


def _edge_said(panel: Panel, i: int) -> dict[str, Any]:
    edge = panel.edges[i]
    out: dict[str, Any] = {"endpoints": [edge.start, edge.end]}
    a, b = ends(panel, i)
    if edge.kind == "polyline":
        raise VitruvianError(f"panel {panel.name} edge {i}: GarmentCode knows no polylines; write .pattern.json")
    if edge.kind == "arc":
        center, _, angle = arc(panel, i)
        if angle:
            params = [100 * float(np.hypot(*(a - center))), int(abs(angle) > math.pi), int(angle > 0)]
            out["curvature"] = {"type": "circle", "params": params}
    elif edge.kind != "line":
        way = b - a
        across = np.array([-way[1], way[0]])
        square = float(way @ way)
        if not square:
            raise VitruvianError(f"panel {panel.name} edge {i}: GarmentCode knows no curves that end where they begin")
        out["curvature"] = {
            "type": edge.kind,
            "params": [[float((p - a) @ way) / square, float((p - a) @ across) / square] for p in edge.points],
        }
    return out | ({"label": edge.label} if edge.label else {})
