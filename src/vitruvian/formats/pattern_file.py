"""Our own file of sewing patterns, `NAME.pattern.json`: everything that a Pattern holds, without loss, for people to read.

Source: note cloth.md, section 2.4. Lengths are metres. Version 1:

    {"vitruvian_pattern": 1, "name": "tube",
     "panels": [{"name": "front", "label": "body", "fabric": "", "order": 0, "grain": [0, 1],
       "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [0, 1, 0.2],
       "vertices": [[0, 0], [0.3, 0], [0.3, 0.4]],
       "edges": [{"ends": [0, 1], "kind": "line"},
                 {"ends": [1, 2], "kind": "quadratic", "points": [[0.32, 0.2]], "label": "left_armhole"},
                 {"ends": [2, 0], "kind": "line"}]}],
     "seams": [{"a": [["front", 1, 0, 1]], "b": [["back", 1, 0, 1]], "reversed": true, "kind": "plain", "open": false}],
     "buttons": [{"a": ["front", [0.1, 0.2]], "b": ["back", [0.1, 0.2]]}],
     "measures": {"chest": 0.99}, "extra": {}}

Rotation and translation are left out together where a panel has no place; a panel that is rolled around the body there has
"bend": [u, v], the way it curves, as long as 1 / radius. Everything but names, vertices and the ends of
edges may be left out for what it is usually. A span is [panel, edge, from, to] or [panel, edge].
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import KINDS, SEAMS, Button, Edge, Panel, Pattern, Seam, Span
from vitruvian.errors import VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.formats.json_checked import (
    a_flag,
    a_list,
    a_text,
    an_index,
    an_object,
    is_number,
    numbers,
    read_checked,
    wrong,
)

KEY, VERSION = "vitruvian_pattern", 1
FARTHEST = 1000.0  # metres
POINTS = 100_000  # of a polyline


def read_pattern(path: str | Path) -> Pattern:
    """The pattern of a file. Raises `FileError` that names panel, edge and field."""
    return read_checked(path, lambda whole: pattern_from(an_object(whole, "file"), Path(path).name.split(".")[0]))


def write_pattern(pattern: Pattern, path: str | Path) -> None:
    """A file that `read_pattern` reads as the same pattern. VitruvianError where `extra` holds what JSON cannot say."""
    said = text(pattern)
    with atomic(path) as temporary:
        Path(temporary).write_text(said, encoding="utf-8")


WRITERS = {
    ".pattern.json": ("pattern_file", "write_pattern"),
    ".garmentcode.json": ("garmentcode", "write_garmentcode"),
    ".svg": ("pattern_svg", "write_svg"),
    ".dxf": ("pattern_dxf", "write_dxf"),
    ".pdf": ("pattern_pdf", "write_drawing"),
}


def write_any(pattern: Pattern, path: str | Path) -> list[str]:
    """Write a pattern by the ending of `path`; what is lost. VitruvianError for an ending that patterns do not have."""
    name = Path(path).name.lower()
    for ending, (module, function) in WRITERS.items():
        if name.endswith(ending):
            return getattr(import_module(f"vitruvian.formats.{module}"), function)(pattern, path) or []
    raise VitruvianError(f"{path}: a pattern can be written as {', '.join(WRITERS)}")


def document(pattern: Pattern) -> dict[str, Any]:
    """The file as plain lists, dictionaries, numbers and text. VitruvianError where `extra` cannot be said in JSON."""
    out: dict[str, Any] = {KEY: VERSION, "name": pattern.name}
    out["panels"] = [_panel_said(p) for p in pattern.panels]
    out["seams"] = [
        {
            "a": [[s.panel, s.edge, s.t0, s.t1] for s in seam.a],
            "b": [[s.panel, s.edge, s.t0, s.t1] for s in seam.b],
            "reversed": seam.reversed,
            "kind": seam.kind,
            "open": seam.open,
        }
        for seam in pattern.seams
    ]
    out["buttons"] = [{side: [at[0], list(at[1])] for side, at in (("a", b.a), ("b", b.b))} for b in pattern.buttons]
    out["measures"] = {name: float(value) for name, value in pattern.measures.items()}
    try:
        out["extra"] = json.loads(json.dumps(dict(pattern.extra), allow_nan=False))
    except (TypeError, ValueError, RecursionError) as e:
        raise VitruvianError(f"pattern {pattern.name:.60}: expected extra that JSON can hold: {e}") from None
    return out


def _panel_said(panel: Panel) -> dict[str, Any]:
    out: dict[str, Any] = {"name": panel.name, "label": panel.label, "fabric": panel.fabric, "order": panel.order}
    out["grain"] = panel.grain.tolist()
    if panel.rotation is not None:
        out["rotation"] = panel.rotation.tolist()
    if panel.translation is not None:
        out["translation"] = panel.translation.tolist()
    if np.any(panel.bend):
        out["bend"] = panel.bend.tolist()
    out["vertices"] = panel.vertices.tolist()
    out["edges"] = [_edge_said(e) for e in panel.edges]
    return out


def _edge_said(edge: Edge) -> dict[str, Any]:
    out: dict[str, Any] = {"ends": [int(edge.start), int(edge.end)], "kind": edge.kind}
    if edge.kind != "line":
        out["points"] = edge.points.tolist()
    if edge.label:
        out["label"] = edge.label
    return out


def text(pattern: Pattern) -> str:
    """What `write_pattern` writes: a line for each vertex, edge, seam and button."""
    whole = document(pattern)
    pattern_from(whole, "")  # what could not be read is not written
    panels = []
    for panel in whole["panels"]:
        rows = {key: panel.pop(key) for key in ("vertices", "edges")}
        head = _line(panel)[:-1]
        panels.append(head + ",\n" + ",\n".join(f' "{key}": {_rows(r, 2)}' for key, r in rows.items()) + "}")
    parts = [
        f'{{"{KEY}": {VERSION}',
        f'"name": {_line(whole["name"])}',
        '"panels": [\n' + ",\n".join(panels) + "]",
        *(f'"{key}": {_rows(whole[key], 1)}' for key in ("seams", "buttons")),
        *(f'"{key}": {_line(whole[key])}' for key in ("measures", "extra")),
    ]
    return ",\n".join(parts) + "}\n"


def _line(value: object) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False)


def _rows(rows: list[Any], indent: int) -> str:
    return "[" + ",".join("\n" + " " * indent + _line(row) for row in rows) + "]"


def pattern_from(document: Mapping[str, Any], source: str) -> Pattern:
    """The pattern of a document as `document` makes; source: its name where the document has none.

    VitruvianError in one line that names the panel, edge or seam and the field.
    """
    version = document.get(KEY)
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise wrong(KEY, f"a version, {VERSION}", version)
    if version > VERSION:
        raise wrong(KEY, f"version {VERSION}: the file is from a newer vitruvian", version)
    name = a_text(document.get("name", source), "name")
    rows = a_list(document.get("panels"), "panels")
    panels = tuple(_panel(row, i) for i, row in enumerate(rows))
    Pattern(name, panels)  # names that are there twice are said before seams that miss one of them
    counts = {p.name: len(p.edges) for p in panels}
    seams = a_list(document.get("seams", []), "seams")
    buttons = a_list(document.get("buttons", []), "buttons")
    measures = an_object(document.get("measures", {}), "measures")
    strange = next((k for k, v in measures.items() if not is_number(v)), None)
    if strange is not None:
        raise wrong(f"measures {strange:.40}", "a number", measures[strange])
    return Pattern(
        name,
        panels,
        tuple(seam_between(s, f"seam {i}", counts) for i, s in enumerate(seams)),
        tuple(button_of(b, f"button {i}", counts) for i, b in enumerate(buttons)),
        {a_text(k, "measures", some=True): float(v) for k, v in measures.items()},
        dict(an_object(document.get("extra", {}), "extra")),
    )


def _panel(value: object, number: int) -> Panel:
    panel = an_object(value, f"panel {number}")
    name = a_text(panel.get("name"), f"panel {number} name", some=True)
    where = f"panel {name:.40}"
    vertices = _points(panel.get("vertices"), f"{where} vertices")
    edges = a_list(panel.get("edges"), f"{where} edges")
    order = panel.get("order", 0)
    if not isinstance(order, int) or isinstance(order, bool) or abs(order) > 1000:
        raise wrong(f"{where} order", "an integer of -1000 to 1000", order)
    rotation, move = place_of(panel, where)
    return Panel(
        name,
        vertices,
        tuple(_edge(e, f"{where} edge {i}", len(vertices)) for i, e in enumerate(edges)),
        a_text(panel.get("label", ""), f"{where} label"),
        rotation,
        move,
        numbers(panel.get("grain", [0.0, 1.0]), f"{where} grain", 2, 1e6),
        a_text(panel.get("fabric", ""), f"{where} fabric"),
        order,
        numbers(panel.get("bend", [0.0, 0.0]), f"{where} bend", 2, FARTHEST),
    )


def place_of(value: Mapping[str, Any], where: str) -> tuple[Floats | None, Floats | None]:
    """Rotation (3,3) and translation (3,) metres of an object that has them, None where not."""
    rotation, move = value.get("rotation"), value.get("translation")
    if rotation is not None:
        rows = a_list(rotation, f"{where} rotation", 3)
        rotation = np.array([numbers(r, f"{where} rotation", 3, 10.0) for r in rows])
        if rotation.shape != (3, 3) or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4:
            raise wrong(f"{where} rotation", "a rotation matrix", rotation.tolist())
    return rotation, None if move is None else numbers(move, f"{where} translation", 3, FARTHEST)


def _points(value: object, where: str, most: int = POINTS) -> Floats:
    rows = a_list(value, where, most)
    return np.array([numbers(r, f"{where} {i}", 2, FARTHEST) for i, r in enumerate(rows)]).reshape(-1, 2)


def _edge(value: object, where: str, count: int) -> Edge:
    edge = an_object(value, where)
    ends = a_list(edge.get("ends"), f"{where} ends", 2)
    if len(ends) != 2:
        raise wrong(f"{where} ends", "two vertices", ends)
    start, end = (an_index(e, f"{where} ends", count) for e in ends)
    kind = edge.get("kind", "line")
    if not isinstance(kind, str) or kind not in KINDS:
        raise wrong(f"{where} kind", f"one of {', '.join(KINDS)}", kind)
    points = _points(edge.get("points", []), f"{where} points")
    if KINDS[kind] not in (None, len(points)):
        raise wrong(f"{where} points", f"{KINDS[kind]} points of a {kind}", len(points))
    return Edge(start, end, kind, points, a_text(edge.get("label", ""), f"{where} label"))


def span(value: object, where: str, counts: Mapping[str, int]) -> Span:
    """A span, [panel, edge] or [panel, edge, from, to], of panels that have so many edges."""
    row = a_list(value, where, 4)
    if len(row) not in (2, 4):
        raise wrong(where, "[panel, edge] or [panel, edge, from, to]", value)
    if not isinstance(row[0], str) or row[0] not in counts:
        raise wrong(where, "the name of a panel", row[0])
    edge = an_index(row[1], f"{where} panel {row[0]:.40} edge", counts[row[0]])
    low, high = numbers(row[2:] or [0.0, 1.0], f"{where} from and to", 2).tolist()
    return Span(row[0], edge, low, high)


def seam_between(value: object, where: str, counts: Mapping[str, int]) -> Seam:
    """A seam of panels that have so many edges."""
    seam = an_object(value, where)
    sides = []
    for side in ("a", "b"):
        rows = a_list(seam.get(side), f"{where} side {side}")
        if not rows:
            raise wrong(f"{where} side {side}", "at least one span", rows)
        sides.append(tuple(span(r, f"{where} side {side}", counts) for r in rows))
    kind = seam.get("kind", "plain")
    if not isinstance(kind, str) or kind not in SEAMS:
        raise wrong(f"{where} kind", f"one of {', '.join(SEAMS)}", kind)
    turned = a_flag(seam.get("reversed", True), f"{where} reversed")
    return Seam(sides[0], sides[1], turned, kind, a_flag(seam.get("open", False), f"{where} open"))


def button_of(value: object, where: str, counts: Mapping[str, int]) -> Button:
    """A button of panels of these names."""
    button = an_object(value, where)
    sides = []
    for side in ("a", "b"):
        row = a_list(button.get(side), f"{where} side {side}", 2)
        if len(row) != 2 or not isinstance(row[0], str) or row[0] not in counts:
            raise wrong(f"{where} side {side}", "[panel, [u, v]]", row)
        u, v = numbers(row[1], f"{where} side {side}", 2, FARTHEST).tolist()
        sides.append((row[0], (u, v)))
    return Button(sides[0], sides[1])
