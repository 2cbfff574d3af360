"""Patterns in DXF as apparel CAD writes them (AAMA, ASTM D6673): one block a piece, what lines are said by their layers.

Source: note cloth.md, section 2.3. Read and written by ezdxf, an optional extra. Layers: 1 cut line, 14 sew line, 4 corners
and notches, 2 turn points, 6 fold, 7 grain, 11 cut-outs; others are kept in `extra`. The format knows no seams.
"""

from __future__ import annotations

import io
import logging
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.cutting import Segment
from vitruvian.cloth.pattern import Pattern, along, ends, length, loops
from vitruvian.errors import FileError, MissingExtra, VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.formats.drawn import Drawn, different, drawn, size, within
from vitruvian.formats.json_checked import LONGEST
from vitruvian.formats.sewing import sewn
from vitruvian.formats.source import Limits, read_bytes

CUT, TURN, CORNER, FOLD, GRAIN, HOLE, SEW = "1", "2", "4", "6", "7", "11", "14"
SMALL = Limits(bytes=8 << 20)
PIECES, ENTITIES, POINTS = 500, 20_000, 200_000  # of a file, of a block, of all lines of a block
UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
INSUNITS = {1: "in", 4: "mm", 5: "cm", 6: "m"}  # $INSUNITS of newer files
SHARP = np.radians(20.0)  # a corner where nothing says so
NEAR = 5e-5  # metres between a corner's point and its vertex
CHORD, CHORDS = 0.002, 24  # metres of a curve's chords that are written, and how many at least
FARTHEST = 100.0  # metres
_SAID = re.compile(r"\s*(PIECE NAME|QUANTITY|UNITS|STYLE NAME)\s*:\s*(.*?)\s*\Z", re.IGNORECASE)


def read_dxf(path: str | Path, *, sidecar: str | Path | None = None, unit: str | None = None) -> Pattern:
    """The pattern of a DXF file. unit: mm, cm, m or in where the file does not say it; sidecar as in `read_freesewing`.

    Outlines are split into edges at the points of layers 2 and 4 and where they turn by more than 20 degrees. Pieces keep
    the direction in which they are drawn: clockwise ones are seen from inside. Raises `FileError`, and MissingExtra
    without ezdxf.
    """
    if unit is not None and unit not in UNITS:
        raise VitruvianError(f"unit: expected one of {', '.join(UNITS)}, found {unit!r:.20}")
    document = _opened(path)
    try:
        pieces, kept = _pieces(document, unit)
    except VitruvianError as e:
        raise FileError(path, 1, str(e)) from None
    except Exception as e:  # what broken entities do to ezdxf is not foreseeable
        raise FileError(path, 1, f"expected DXF entities, found broken ones ({type(e).__name__}: {e})") from None
    pattern = sewn(path, pieces, sidecar)
    if not kept:
        return pattern
    from dataclasses import replace

    return replace(pattern, extra={**pattern.extra, "layers": kept})


def _ezdxf() -> Any:
    try:
        import ezdxf
        import ezdxf.recover
    except ImportError:
        raise MissingExtra("patterns", "DXF") from None
    return ezdxf


@contextmanager
def _silent() -> Iterator[None]:
    """ezdxf tells a logger what it mends; whoever loads a file hears it from nobody."""
    log = logging.getLogger("ezdxf")
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        log.setLevel(before)


def _opened(path: str | Path) -> Any:
    data = read_bytes(path, SMALL)
    ezdxf = _ezdxf()
    try:
        with _silent():
            return ezdxf.recover.read(io.BytesIO(data))[0]
    except Exception as e:  # as above: hostile bytes raise much more than ezdxf.DXFError
        raise FileError(path, 1, f"expected a DXF file: {e or type(e).__name__}") from None


def _pieces(document: Any, unit: str | None) -> tuple[list[Drawn], dict[str, Any]]:
    said = _said(document.modelspace())
    blocks = [b for b in document.blocks if not b.name.startswith(("*", "$", "_"))]
    if len(blocks) > PIECES:
        raise VitruvianError(f"expected at most {PIECES} blocks, found {len(blocks)}")
    for block in blocks:
        said = _said(block) | said
    scale = UNITS[unit or _unit(said, document)]
    out, kept = [], {}
    for block in blocks:
        lines = _Lines(block, scale)
        outline = max((r for r in lines.closed(SEW) or lines.closed(CUT)), key=_run_size, default=None)
        if outline is None:
            continue
        own = _said(block)
        name = _name(own.get("PIECE NAME") or block.name)
        out.append(_piece(name, outline, lines, own))
        rest = {k: [p.tolist() for p in v] for k, v in lines.runs.items() if k not in (CUT, SEW, FOLD, GRAIN, HOLE)}
        if rest:
            kept[name] = rest
    if not out:  # no blocks: every closed line of the drawing is a piece
        lines = _Lines(document.modelspace(), scale)
        layers = [layer for layer in (SEW, CUT) if lines.closed(layer)][:1] or list(lines.runs)
        rings = [r for layer in layers for r in lines.closed(layer) if _run_size(r) > 1e-4]
        out = [_piece(f"piece{k + 1}", ring, lines, {}) for k, ring in enumerate(rings[: PIECES + 1])]
    if not out:
        raise VitruvianError("expected blocks with a closed line on layer 14 or 1, or closed lines, found none")
    if len(out) > PIECES:
        raise VitruvianError(f"expected at most {PIECES} pieces, found more")
    return different(out), kept


def _unit(said: dict[str, str], document: Any) -> str:
    word = said.get("UNITS", "").upper()
    if word in ("METRIC", "ENGLISH"):
        return "mm" if word == "METRIC" else "in"
    known = INSUNITS.get(int(document.header.get("$INSUNITS", 0) or 0))
    if known is None:
        found = repr(word[:20]) if word else "no such text"
        raise VitruvianError(f"expected the text UNITS: METRIC or UNITS: ENGLISH, found {found}; say unit=")
    return known


def _said(space: Iterable[Any]) -> dict[str, str]:
    """What its texts say: PIECE NAME, QUANTITY, UNITS, STYLE NAME."""
    out: dict[str, str] = {}
    for k, entity in enumerate(space):
        if k > ENTITIES:
            raise VitruvianError(f"expected at most {ENTITIES} entities in a block, found more")
        if entity.dxftype() in ("TEXT", "MTEXT", "ATTDEF"):
            found = _SAID.match(str(entity.text if entity.dxftype() == "MTEXT" else entity.dxf.text)[:500])
            if found:
                out.setdefault(found[1].upper(), found[2])
    return out


def _name(text: str) -> str:
    plain = "".join(c for c in text.strip() if c.isprintable())[:LONGEST]
    return plain or "piece"


class _Lines:
    """The points (n,2) metres of the lines of a block, and its single points, by layer."""

    def __init__(self, space: Iterable[Any], scale: float) -> None:
        self.runs: dict[str, list[Floats]] = {}
        self.points: dict[str, list[Floats]] = {}
        count = 0
        for entity in space:
            kind, layer = entity.dxftype(), str(entity.dxf.layer)
            if kind == "POINT":
                at = np.array(tuple(entity.dxf.location)[:2], np.float64) * scale
                self.points.setdefault(layer, []).append(_checked(at[None])[0])
            elif kind in ("POLYLINE", "LWPOLYLINE", "LINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE"):
                points = _flat(entity, scale)
                count += len(points)
                if count > POINTS:
                    raise VitruvianError(f"expected at most {POINTS} points in a block, found more")
                if len(points) > 1:
                    self.runs.setdefault(layer, []).append(points)

    def closed(self, layer: str) -> list[Floats]:
        """Closed lines (n,2), the first point not repeated; open ones that meet are joined."""
        out, loose = [], []
        for run in self.runs.get(layer, []):
            if len(run) > 3 and np.hypot(*(run[0] - run[-1])) < NEAR:
                out.append(run[:-1])
            else:
                loose.append(run)
        return out + _joined(loose)


def _joined(loose: list[Floats]) -> list[Floats]:
    out = []
    if len(loose) > 500:
        return []
    while loose:
        run = loose.pop(0)
        while np.hypot(*(run[0] - run[-1])) > NEAR:
            near = [(k, turn) for k, r in enumerate(loose) for turn in (1, -1) if _meets(run, r[::turn])]
            if not near:
                break
            k, turn = near[0]
            run = np.concatenate([run, loose.pop(k)[::turn][1:]])
        if len(run) > 3 and np.hypot(*(run[0] - run[-1])) < NEAR:
            out.append(run[:-1])
    return out


def _meets(run: Floats, other: Floats) -> bool:
    return bool(np.hypot(*(run[-1] - other[0])) < NEAR)


def _checked(points: Floats) -> Floats:
    if not np.isfinite(points).all() or np.abs(points).max(initial=0) > FARTHEST:
        raise VitruvianError(f"expected points within {FARTHEST:g} m of the origin, found others; is the unit right?")
    return points


def _flat(entity: Any, scale: float) -> Floats:
    """A line's points (n,2), curves in chords that leave them by 0.05 mm; closed ones end where they begin."""
    from ezdxf.path import make_path

    if entity.dxftype() == "POLYLINE" and not entity.has_arc:
        points = [tuple(v.dxf.location)[:2] for v in entity.vertices]
        points += points[:1] if entity.is_closed else []
    elif entity.dxftype() == "LINE":
        points = [tuple(entity.dxf.start)[:2], tuple(entity.dxf.end)[:2]]
    else:
        path = make_path(entity)
        corners = np.array([tuple(v)[:2] for v in path.control_vertices()], np.float64).reshape(-1, 2)
        _checked(corners * scale)
        points = []
        for p in path.flattening(5e-5 / scale):
            points.append(tuple(p)[:2])
            if len(points) > POINTS:
                break
    return _checked(np.array(points, np.float64).reshape(-1, 2) * scale)


def _run_size(ring: Floats) -> float:
    return size([("polyline", np.concatenate([ring, ring[:1]]))])


def _piece(name: str, outline: Floats, lines: _Lines, said: dict[str, str]) -> Drawn:
    marks = [p for layer in (CORNER, TURN) for p in lines.points.get(layer, [])]
    run, notches = _edges(outline, np.array(marks).reshape(-1, 2))
    inner = lines.closed(HOLE)
    holes = [r for r in (_edges(h, np.zeros((0, 2)))[0] for h in inner) if within(run, r)]
    fold, grain = (next(iter(lines.runs.get(layer, [])), None) for layer in (FOLD, GRAIN))
    numbers = [int(n) for n in re.findall(r"\d{1,3}", said.get("QUANTITY", ""))] or [1]
    copies = min(max(sum(numbers), 1), 20)
    pair = fold is None and copies % 2 == 0
    way = None if grain is None else grain[-1] - grain[0]
    line = None if fold is None else fold[[0, -1]]
    return drawn(
        name, [run, *holes], fold=line, grain=way, copies=copies, mirror=pair, wind=False,
        notches=[("notch", p) for p in notches],
    )  # fmt: skip


def _edges(ring: Floats, marks: Floats) -> tuple[list[Segment], list[Floats]]:
    """A closed line cut at its corners, and the marks that are within its edges: notches."""
    keep = np.hypot(*(ring - np.roll(ring, 1, axis=0)).T) > 1e-6
    ring = ring[keep] if keep.sum() >= 3 else ring
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.einsum("ij,ij->i", before, after))
    corner = np.abs(turn) > SHARP
    loose: list[Floats] = []
    for mark in marks:
        apart = np.hypot(*(ring - mark).T)
        if apart.min() < NEAR:
            corner[apart.argmin()] = True
        else:
            loose.append(mark)
    at = np.flatnonzero(corner)
    if len(at) < 2:
        at = np.unique([*(at if len(at) else [0]), (int(at[0] if len(at) else 0) + len(ring) // 2) % len(ring)])
    out = []
    for a, b in zip(at, [*at[1:], at[0] + len(ring)]):
        points = np.take(ring, np.arange(a, b + 1), axis=0, mode="wrap")
        out.append(("polyline" if len(points) > 2 else "line", points))
    return out, loose


def write_dxf(pattern: Pattern, path: str | Path) -> list[str]:
    """The panels as blocks of an R12 file, millimetres, their curves in chords; what the format cannot hold.

    Corners are points on layer 4, so that reading it brings back the edges. MissingExtra without ezdxf.
    """
    ezdxf = _ezdxf()
    with _silent():
        document = ezdxf.new("R12")
        for layer in (CUT, CORNER, GRAIN, HOLE, SEW):
            document.layers.add(layer)
        space = document.modelspace()
        place, taken = 0.0, {"*"}
        for panel in pattern.panels:
            block = document.blocks.new(_block_name(panel.name, taken))
            rings = [_ring(pattern, panel, loop) for loop in loops(panel)]
            for k, ring in enumerate(rings):
                for layer in (CUT, SEW) if not k else (HOLE,):
                    block.add_polyline2d([tuple(p) for p in ring], close=True, dxfattribs={"layer": layer})
            for i in next(iter(loops(panel)), []):
                block.add_point(tuple(1000 * ends(panel, i)[0]), dxfattribs={"layer": CORNER})
            whole = np.concatenate([*rings, np.zeros((0, 2))])
            low, high = (whole.min(axis=0), whole.max(axis=0)) if len(whole) else (np.zeros(2), np.zeros(2))
            middle, way = 0.5 * (low + high), panel.grain / np.hypot(*panel.grain) * 0.3 * float(np.min(high - low))
            block.add_line(tuple(middle - way), tuple(middle + way), dxfattribs={"layer": GRAIN})
            for k, text in enumerate((f"PIECE NAME: {panel.name}", "QUANTITY: 1")):
                block.add_text(text, height=3, dxfattribs={"layer": CUT, "insert": tuple(middle - [0, 6 * k])})
            space.add_blockref(block.name, (place - float(low[0]), 0.0))
            place += float(high[0] - low[0]) + 50
        for k, text in enumerate((f"STYLE NAME: {pattern.name}", "UNITS: METRIC")):
            space.add_text(text, height=3, dxfattribs={"insert": (0.0, -5.0 * k)})
        with atomic(path) as temporary:
            document.saveas(temporary)
    lost = ["seams"] * bool(pattern.seams) + ["places"] * any(p.rotation is not None for p in pattern.panels)
    lost += ["fabrics"] * any(p.fabric for p in pattern.panels) + ["buttons"] * bool(pattern.buttons)
    curved = any(e.kind not in ("line", "polyline") for p in pattern.panels for e in p.edges)
    labels = any(p.label or any(e.label for e in p.edges) for p in pattern.panels)
    return lost + ["curves, which become chords"] * curved + ["labels"] * labels


def _ring(pattern: Pattern, panel: Any, loop: Sequence[int]) -> Floats:
    """(n,2) millimetres of a loop, its first point not repeated."""
    pieces = []
    for i in loop:
        edge = panel.edges[i]
        if edge.kind in ("line", "polyline"):
            points = np.concatenate([ends(panel, i)[0][None], edge.points])
        else:
            count = max(CHORDS, int(np.ceil(length(panel, i) / CHORD)))
            points = along(panel, i, np.arange(count) / count)
        pieces.append(points)
    return 1000 * np.concatenate(pieces)


def _block_name(name: str, taken: set[str]) -> str:
    """A name that R12 allows: 31 letters, digits, $, - and _."""
    plain = re.sub(r"[^A-Z0-9_-]", "_", name.upper())[:28] or "PIECE"
    plain = f"P{plain}" if plain[0] in "_$" else plain
    out, k = plain, 1
    while out in taken:
        k += 1
        out = f"{plain[:26]}_{k}"
    taken.add(out)
    return out
