"""Sidecars, `NAME.sewing.json`: how the pieces of a drawing that knows no seams are cut, sewn and worn.

Source: note cloth.md, section 2.4. Version 1; everything may be left out but the version:

    {"vitruvian_sewing": 1,
     "pieces": {"sleeve": {"copies": 2, "mirror": true, "unfold": false, "label": "arm", "fabric": "", "order": 0}},
     "split": [["front", 3, 0.5]],
     "seams": [{"a": [["front", 1, 0, 1]], "b": [["back", 1]], "reversed": true, "kind": "plain", "open": false}],
     "anchors": [["front", 5, "lower_interface"]],
     "places": {"front": {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "translation": [0, 1.4, 0.2]},
                "sleeve": {"wrap": "left sleeve"}},
     "buttons": [{"a": ["front", [0.1, 0.2]], "b": ["back", [0.1, 0.2]]}]}

`pieces` go by the names of the drawing; all others by the names of the panels that are cut: the piece's own for the first,
NAME_mirrored for its mirror image, NAME_2 and NAME_2_mirrored for further ones. `split` cuts an edge in two at a share of
its length, one after the other, before seams and anchors count edges. Lengths are metres, as in a pattern's file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vitruvian.cloth.cutting import split
from vitruvian.cloth.pattern import Panel, Pattern
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.drawn import Cut, Drawn, cut
from vitruvian.formats.json_checked import a_flag, a_list, a_text, an_index, an_object, numbers, read_checked, wrong
from vitruvian.formats.pattern_file import button_of, place_of, seam_between

KEY, VERSION = "vitruvian_sewing", 1
COPIES = 100
FIELDS = ("pieces", "split", "seams", "anchors", "places", "buttons")


def sidecar_of(path: str | Path) -> Path:
    """Where the sidecar of a drawing is looked for: NAME.sewing.json beside it, NAME up to the first dot."""
    path = Path(path)
    return path.with_name(path.name.split(".")[0] + ".sewing.json")


def sewn(path: str | Path, pieces: Sequence[Drawn], sidecar: str | Path | None = None) -> Pattern:
    """The pattern of a drawing's pieces, by its sidecar (None: the one beside the file, if there is one).

    Without a sidecar pieces are cut as their file says and nothing is sewn. `extra` has the notches as rows [panel, edge
    that starts there, kind], and `wrap`: panel -> where it is worn, in words. Raises `FileError` about either file.
    """
    name = Path(path).name.split(".")[0]
    beside = sidecar_of(path)
    given = Path(sidecar) if sidecar is not None else beside if beside.is_file() else None
    if given is not None:
        return read_checked(given, lambda whole: _sewn(name, pieces, an_object(whole, "file")))
    try:
        return _sewn(name, pieces, {KEY: VERSION})
    except FileError:
        raise
    except VitruvianError as e:
        raise FileError(path, 1, str(e)) from None


def _sewn(name: str, pieces: Sequence[Drawn], said: Mapping[str, Any]) -> Pattern:
    version = said.get(KEY)
    if version != VERSION or isinstance(version, bool):
        raise wrong(KEY, f"version {VERSION}", version)
    strange = next((k for k in said if k not in (KEY, *FIELDS)), None)
    if strange is not None:
        raise wrong("sidecar", f"one of {', '.join(FIELDS)}", strange)
    ways, others = _ways(an_object(said.get("pieces", {}), "pieces"), [p.panel.name for p in pieces])
    cuts, marks = cut(pieces, ways)
    if not cuts:
        raise wrong("pieces", "at least one copy of one", "none")
    panels = {p.name: p for p in cuts}
    if len(panels) < len(cuts):
        raise wrong("pieces", "panels of different names", [p.name for p in cuts])
    for piece, fields in others.items():
        for copy, panel in panels.items():
            if copy == piece or _copy_of(copy, piece):
                panels[copy] = replace(panel, **fields)
    marks = [list(m) for m in marks]
    for i, row in enumerate(a_list(said.get("split", []), "split")):
        _split(panels, marks, a_list(row, f"split {i}", 3), f"split {i}")
    for i, row in enumerate(a_list(said.get("anchors", []), "anchors")):
        _anchor(panels, a_list(row, f"anchor {i}", 3), f"anchor {i}")
    wraps = _placed(panels, an_object(said.get("places", {}), "places"))
    counts = {n: len(p.edges) for n, p in panels.items()}
    seams = [seam_between(s, f"seam {i}", counts) for i, s in enumerate(a_list(said.get("seams", []), "seams"))]
    buttons = [button_of(b, f"button {i}", counts) for i, b in enumerate(a_list(said.get("buttons", []), "buttons"))]
    extra = ({"notches": marks} if marks else {}) | ({"wrap": wraps} if wraps else {})
    return Pattern(name, tuple(panels.values()), tuple(seams), tuple(buttons), extra=extra)


def _copy_of(copy: str, piece: str) -> bool:
    rest = copy.removeprefix(piece).removesuffix("_mirrored")
    return copy.startswith(piece) and (rest == "" or (rest[0] == "_" and rest[1:].isdecimal()))


def _ways(rows: Mapping[str, Any], names: Sequence[str]) -> tuple[dict[str, Cut], dict[str, dict[str, Any]]]:
    """How pieces are cut, and the fields of their panels."""
    ways: dict[str, Cut] = {}
    others: dict[str, dict[str, Any]] = {}
    for name, value in rows.items():
        where = f"piece {name:.40}"
        if name not in names:
            raise wrong("pieces", f"one of {', '.join(names)}", name)
        row = an_object(value, where)
        known = ("unfold", "copies", "mirror", "label", "fabric", "order")
        strange = next((k for k in row if k not in known), None)
        if strange is not None:
            raise wrong(where, f"one of {', '.join(known)}", strange)
        flags = {k: a_flag(row[k], f"{where} {k}") for k in ("unfold", "mirror") if k in row}
        copies = an_index(row["copies"], f"{where} copies", COPIES) if "copies" in row else None
        ways[name] = Cut(flags.get("unfold"), copies, flags.get("mirror"))
        others[name] = {k: a_text(row[k], f"{where} {k}") for k in ("label", "fabric") if k in row}
        if "order" in row:
            others[name]["order"] = an_index(row["order"], f"{where} order", 1000)
    return ways, others


def _panel(panels: Mapping[str, Panel], name: object, where: str) -> Panel:
    if not isinstance(name, str) or name not in panels:
        raise wrong(where, f"one of the panels {', '.join(panels)}", name)
    return panels[name]


def _split(panels: dict[str, Panel], marks: list[list[Any]], row: list[Any], where: str) -> None:
    if len(row) != 3:
        raise wrong(where, "[panel, edge, share]", row)
    panel = _panel(panels, row[0], where)
    edge = an_index(row[1], f"{where} edge", len(panel.edges))
    share = float(numbers([row[2]], f"{where} share", 1)[0])
    if not 0.001 <= share <= 0.999:
        raise wrong(f"{where} share", "0.001 to 0.999", share)
    panels[panel.name] = split(panel, edge, [share])
    for mark in marks:
        if mark[0] == panel.name and mark[1] > edge:
            mark[1] += 1


def _anchor(panels: dict[str, Panel], row: list[Any], where: str) -> None:
    if len(row) != 3:
        raise wrong(where, "[panel, edge, label]", row)
    panel = _panel(panels, row[0], where)
    edge = an_index(row[1], f"{where} edge", len(panel.edges))
    label = a_text(row[2], f"{where} label", some=True)
    edges = list(panel.edges)
    edges[edge] = replace(edges[edge], label=label)
    panels[panel.name] = replace(panel, edges=tuple(edges))


def _placed(panels: dict[str, Panel], rows: Mapping[str, Any]) -> dict[str, str]:
    wraps = {}
    for name, value in rows.items():
        panel = _panel(panels, name, "places")
        row = an_object(value, f"place of {name:.40}")
        if "wrap" in row:
            wraps[name] = a_text(row["wrap"], f"place of {name:.40} wrap", some=True)
        else:
            rotation, move = place_of(row, f"place of {name:.40}")
            if rotation is None or move is None:
                raise wrong(f"place of {name:.40}", "wrap, or rotation and translation", list(row))
            panels[name] = replace(panel, rotation=rotation, translation=move)
    return wraps


def document(pattern: Pattern) -> dict[str, Any]:
    """The sidecar that says a pattern's seams, buttons and anchors; its pieces are cut as their file has them."""
    from vitruvian.formats.pattern_file import document as whole

    said = whole(pattern)
    anchors = [[p.name, i, e.label] for p in pattern.panels for i, e in enumerate(p.edges) if _is_anchor(e.label)]
    return {KEY: VERSION, "seams": said["seams"], "anchors": anchors, "buttons": said["buttons"]}


def _is_anchor(label: str) -> bool:
    return bool(label) and ".." not in label


def write_sidecar(pattern: Pattern, path: str | Path) -> None:
    """The sidecar of a pattern's seams, buttons and anchors, a line each."""
    import json

    from vitruvian.formats.atomic import atomic

    said = document(pattern)
    parts = [f'{{"{KEY}": {VERSION}']
    for key in ("seams", "anchors", "buttons"):
        rows = ",".join("\n " + json.dumps(row, ensure_ascii=False) for row in said[key])
        parts.append(f'"{key}": [{rows}]')
    with atomic(path) as temporary:
        Path(temporary).write_text(",\n".join(parts) + "}\n", encoding="utf-8")
