"""Drafts of FreeSewing, as JSON (parts with points, paths and snippets) and as SVG, and outlines in SVG of other programs.

Source: note cloth.md, section 2.2. All are millimetres, y down; outlines are paths of the class "fabric".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.cutting import Segment
from vitruvian.cloth.pattern import Pattern
from vitruvian.errors import FileError, VitruvianError
from vitruvian.formats.drawn import Drawn, different, drawn, size, within
from vitruvian.formats.json_checked import a_list, a_text, an_object, numbers, read_checked, wrong
from vitruvian.formats.sewing import sewn
from vitruvian.formats.svg_shapes import Drawing, Shape, read_drawing

OUTLINE = "fabric"  # class
NOTCHES = ("notch", "bnotch")
FARTHEST = 1e5  # mm
SMALLEST = 1e-4  # square metres of an outline of other programs
MOST, HOLES = 500, 200  # pieces of a drawing, runs of a path
OURS = "cloth"  # class of outlines in drawings of our own
OPS = {"move": ("to",), "line": ("to",), "curve": ("cp1", "cp2", "to")}


def read_freesewing(path: str | Path, *, sidecar: str | Path | None = None) -> Pattern:
    """The pattern of a FreeSewing dump in JSON, cut and sewn as its sidecar says (None: NAME.sewing.json beside it, if it
    is there). Raises `FileError` that names the part and path."""
    return sewn(path, read_checked(path, _parts), sidecar)


def _parts(whole: object) -> list[Drawn]:
    top = an_object(whole, "file")
    if top.get("units", "mm") != "mm":
        raise wrong("units", "mm", top["units"])
    parts = an_object(top.get("parts"), "parts")
    if len(parts) > MOST:
        raise wrong("parts", f"at most {MOST}", len(parts))
    found = [_part(short, an_object(parts[name], f"part {name:.40}")) for name, short in _short(list(parts)).items()]
    pieces = [p for p in found if p is not None]
    if not pieces:
        raise wrong("parts", f'one with a path of class "{OUTLINE}" at least', ", ".join(parts))
    return different(pieces)


def _short(names: Sequence[str]) -> dict[str, str]:
    """Names without the name of the design, which all parts begin with."""
    heads = {n.partition(".")[0] for n in names}
    common = len(heads) == 1 and all("." in n and n.partition(".")[2] for n in names)
    return {n: a_text(n.partition(".")[2] if common else n, "part", some=True) for n in names}


def _part(name: str, part: Mapping[str, Any]) -> Drawn | None:
    where = f"part {name:.40}"
    paths = an_object(part.get("paths", {}), f"{where} paths")
    points = an_object(part.get("points", {}), f"{where} points")
    known: dict[tuple[float, float], str] = {}
    for title, at in points.items():
        u, v = (numbers(at, f"{where} point {title:.40}", 2, FARTHEST) * [1e-3, -1e-3]).tolist()
        known.setdefault((round(u, 6), round(v, 6)), title)
    outlines, fold, grain = [], None, None
    for title, path in paths.items():
        said = f"{where} path {title:.40}"
        path = an_object(path, said)
        if path.get("class") == OUTLINE:
            outlines.append(_ops(path.get("ops"), said))
        elif title.startswith("__macro_cutonfold_"):
            fold = _ends(_ops(path.get("ops"), said))
        elif title.startswith("__macro_grainline_"):
            grain = _ends(_ops(path.get("ops"), said))
    outlines = [o for o in outlines if o]
    if not outlines:
        return None
    outline = max(outlines, key=size)
    corners = [tuple(round(float(v), 6) for v in s[1][0]) for s in outline]
    titles = [known.get((u, v), "") for u, v in corners]
    names = [f"{a}..{b}" if a or b else "" for a, b in zip(titles, [*titles[1:], titles[0]])]
    notches = []
    for title, snippet in an_object(part.get("snippets", {}), f"{where} snippets").items():
        snippet = an_object(snippet, f"{where} snippet {title:.40}")
        if snippet.get("def") in NOTCHES:
            at = numbers(snippet.get("at"), f"{where} snippet {title:.40}", 2, FARTHEST) * [1e-3, -1e-3]
            notches.append((str(snippet["def"]), at))
    return _made(name, [outline], names, fold, grain, notches)


def _made(
    name: str,
    outlines: Sequence[Sequence[Segment]],
    names: Sequence[str],
    fold: Floats | None,
    grain: Floats | None,
    notches: Sequence[tuple[str, Floats]],
) -> Drawn:
    """A part: once where it is cut on the fold, otherwise for both sides of the body."""
    way = None if grain is None else grain[1] - grain[0]
    once = fold is not None
    copies = 1 if once else 2
    return drawn(name, outlines, names=names, fold=fold, grain=way, notches=notches, copies=copies, mirror=not once)


def _ops(value: object, where: str) -> list[Segment]:
    """Segments of the operations of a path, metres, y up."""
    out: list[Segment] = []
    here = start = np.zeros(2)
    for k, row in enumerate(a_list(value, where)):
        op = an_object(row, f"{where} op {k}")
        kind = op.get("type")
        if kind == "close":
            out.append(("line", np.array([here, start])))
            here = start
            continue
        if kind == "noop":
            continue
        if not isinstance(kind, str) or kind not in OPS:
            raise wrong(f"{where} op {k}", f"one of {', '.join(OPS)}, close", kind)
        points = [numbers(op.get(n), f"{where} op {k} {n}", 2, FARTHEST) * [1e-3, -1e-3] for n in OPS[kind]]
        if kind == "move":
            start = points[0]
        else:
            out.append(("line" if kind == "line" else "cubic", np.array([here, *points])))
        here = points[-1]
    return out


def _ends(run: Sequence[Segment]) -> Floats | None:
    """The first and last point of a path (2,2): of a fold's or grain's mark."""
    return np.array([run[0][1][0], run[-1][1][-1]]) if run else None


def read_svg(path: str | Path, *, sidecar: str | Path | None = None, outlines: str | None = None) -> Pattern:
    """The pattern of an SVG drawing at scale 1:1: a draft of FreeSewing, a drawing of ours, or closed outlines.

    outlines: the class of those that are pieces; None: every closed one of 1 cm2 or more. Inner subpaths of one path are
    holes. Sidecar as in `read_freesewing`. Raises `FileError`.
    """
    drawing = read_drawing(path)
    parts = {g for s in drawing.shapes for g in s.groups if "-part-" in g and g.startswith("fs-stack-")}
    try:
        if parts and outlines is None:
            pieces = [p for g, n in _short_groups(drawing).items() if (p := _group(g, n, drawing)) is not None]
        else:
            pieces = _plain(drawing, outlines)
    except FileError:
        raise
    except VitruvianError as e:
        raise FileError(path, 1, str(e)) from None
    if not pieces:
        raise FileError(path, 1, f"expected closed outlines{f' of class {outlines}' if outlines else ''}, found none")
    return sewn(path, different(pieces), sidecar)


def _short_groups(drawing: Drawing) -> dict[str, str]:
    order = dict.fromkeys(g for s in drawing.shapes for g in s.groups if "-part-" in g and g.startswith("fs-stack-"))
    parts = {g: g.partition("-part-")[2] or g for g in order}
    short = _short(list(parts.values()))
    return {g: short[n] for g, n in parts.items()}


def _segments(shape: Shape, k: int = 0) -> list[Segment]:
    return [(kind, points * 1e-3) for kind, points in shape.runs[k].segments]


def _group(group: str, name: str, drawing: Drawing) -> Drawn | None:
    """A part of a FreeSewing drawing."""
    mine = [s for s in drawing.shapes if group in s.groups and s.runs]
    outlines = [_segments(s) for s in mine if s.attributes.get("class") == OUTLINE]
    if not outlines:
        return None

    home = next(s.home for s in mine if s.attributes.get("class") == OUTLINE)
    outlines = [[(kind, points - 1e-3 * home) for kind, points in run] for run in outlines]

    def mark(name: str) -> Floats | None:
        found = [s for s in mine if s.attributes.get("marker-start", "").lower().startswith(f"url(#{name}from")]
        ends = _ends(_segments(found[0])) if found else None
        return None if ends is None else ends - 1e-3 * home

    notches = [(m.what, (m.at - home) * 1e-3) for m in drawing.marks if group in m.groups and m.what in NOTCHES]
    return _made(name, [max(outlines, key=size)], (), mark("cutonfold"), mark("grainline"), notches)


def _plain(drawing: Drawing, wanted: str | None) -> list[Drawn]:
    """Pieces of a drawing that says nothing of sewing."""
    if wanted is None and any(OURS in s.attributes.get("class", "").split() for s in drawing.shapes):
        wanted = OURS
    out: list[Drawn] = []
    grains = [s for s in drawing.shapes if "grain" in s.attributes.get("class", "").split() and s.runs and s.groups]
    if len(grains) > MOST:
        raise wrong("drawing", f"at most {MOST} grain lines", len(grains))
    for k, shape in enumerate(drawing.shapes):
        if len(out) > MOST:
            raise wrong("drawing", f"at most {MOST} closed outlines; say the class of those that are pieces", "more")
        if wanted is not None and wanted not in shape.attributes.get("class", "").split():
            continue
        closed = [_segments(shape, i) for i, run in enumerate(shape.runs) if _closed(run.segments, run.closed)]
        closed = [c for c in closed if size(c) >= SMALLEST]
        if not closed:
            continue
        title = shape.attributes.get("inkscape:label") or (shape.groups[-1] if shape.groups and wanted == OURS else "")
        title = title or shape.attributes.get("id") or next((g for g in shape.groups[::-1] if g), "") or f"piece{k}"
        if len(closed) > HOLES:
            raise wrong(f"path {title:.40}", f"at most {HOLES} closed runs", len(closed))
        grain = next((_segments(s) for s in grains if s.groups == shape.groups), None)
        way = None if grain is None else np.subtract(*_both(grain))
        for outline, holes in _nested(closed):
            name = a_text(title, "name of an outline", some=True)
            out.append(drawn(name, [outline, *holes], grain=way, wind=wanted != OURS))
    return out


def _both(run: Sequence[Segment]) -> tuple[Floats, Floats]:
    return run[-1][1][-1], run[0][1][0]


def _closed(segments: Sequence[Segment], said: bool) -> bool:
    return said or bool(np.hypot(*(segments[-1][1][-1] - segments[0][1][0])) < 0.01)


def _nested(runs: Sequence[list[Segment]]) -> list[tuple[list[Segment], list[list[Segment]]]]:
    """Outlines with the runs inside them."""
    out: list[tuple[list[Segment], list[list[Segment]]]] = []
    for run in sorted(runs, key=size, reverse=True):
        home = next((holes for outline, holes in out if within(outline, run)), None)
        if home is None:
            out.append((run, []))
        else:
            home.append(run)
    return out
