"""Drawings of patterns at scale 1:1 for printers: PDF, one page as large as the drawing or pages to be glued.

Source: PDF 1.4 reference (Adobe, third edition), sections 3.4, 4.1 to 4.9 and 5.3. The drawing is one form that each page
shows its part of.
"""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Panel, Pattern, along, area, ends, length, loops, outline
from vitruvian.errors import VitruvianError
from vitruvian.formats.atomic import atomic
from vitruvian.formats.pattern_svg import Sewn, laid_out, page, sewn_edges, unit

POINT = 72 / 25.4  # points in a millimetre
PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}
EDGE = 10.0  # mm of paper that printers leave white
MOST = 500  # pages
LARGEST = 5000.0  # mm of a page that readers show


def write_drawing(pattern: Pattern, path: str | Path) -> list[str]:
    """The drawing on one page; what a drawing cannot hold."""
    write_pdf(pattern, path)
    return ["everything but what is drawn"]


def write_pdf(pattern: Pattern, path: str | Path, *, paper: str | None = None) -> int:
    """The panels beside each other, a millimetre of cloth a millimetre of paper; how many pages.

    paper: one of `PAPERS`, whose pages are cut at their frames and glued, row A to the left, numbered downwards; None: one
    page of the drawing's size. VitruvianError for other papers, and where it would be more than `MOST` pages.
    """
    if paper is not None and paper.lower() not in PAPERS:
        raise VitruvianError(f"paper: expected one of {', '.join(PAPERS)}, found {paper!r:.20}")
    places, size = laid_out(pattern)
    if paper is None and max(size) > LARGEST:
        raise VitruvianError(
            f"{path}: the drawing is {max(size) / 1000:.1f} m long, too large for one page; give a paper"
        )
    seams = sewn_edges(pattern)
    body = "\n".join(line for p, move in zip(pattern.panels, places) for line in _panel(p, move, size[1], seams))
    pages = _pages(size, PAPERS[paper.lower()] if paper else None)
    if len(pages) > MOST:
        raise VitruvianError(f"{path}: it would be {len(pages)} pages, more than {MOST}")
    data = _file(body, size, pages)
    with atomic(path) as temporary:
        Path(temporary).write_bytes(data)
    return len(pages)


Page = tuple[tuple[float, float], str]  # its size in mm and what is drawn on it


def _pages(size: tuple[float, float], paper: tuple[float, float] | None) -> list[Page]:
    if paper is None:
        return [(size, f"{POINT:.6f} 0 0 {POINT:.6f} 0 0 cm /D Do")]
    wide, high = paper[0] - 2 * EDGE, paper[1] - 2 * EDGE
    columns, rows = (max(1, int(np.ceil(s / w - 1e-9))) for s, w in zip(size, (wide, high)))
    out = []
    for c in range(columns):
        for r in range(rows):
            x, y = EDGE - c * wide, EDGE - (size[1] - (r + 1) * high)
            name = f"{_letters(c)}{r + 1} of {_letters(columns - 1)}{rows}"
            frame = f"{EDGE:.2f} {EDGE:.2f} {wide:.2f} {high:.2f} re"
            shown = f"q {frame} W n 1 0 0 1 {x:.3f} {y:.3f} cm /D Do Q"
            marks = [f"0.6 G 0.2 w {frame} S", *_marks(wide, high), _text(name, EDGE + 14, paper[1] - EDGE + 2, 8)]
            if not c and not r:
                marks.append(_text("this line is 100 mm long", EDGE + 110, EDGE - 5, 6))
                marks.append(f"0 G {EDGE + 60:.2f} {EDGE - 7:.2f} m {EDGE + 160:.2f} {EDGE - 7:.2f} l S")
            out.append((paper, f"{POINT:.6f} 0 0 {POINT:.6f} 0 0 cm {shown} " + " ".join(marks)))
    return out


def _letters(k: int) -> str:
    return ("" if k < 26 else chr(64 + k // 26)) + chr(65 + k % 26)


def _marks(wide: float, high: float) -> list[str]:
    """Crosses in the middle of the frame's sides, where neighbours meet."""
    out = []
    for x, y in ((0, 0.5), (1, 0.5), (0.5, 0), (0.5, 1)):
        u, v = EDGE + x * wide, EDGE + y * high
        out.append(f"{u - 4:.2f} {v:.2f} m {u + 4:.2f} {v:.2f} l {u:.2f} {v - 4:.2f} m {u:.2f} {v + 4:.2f} l S")
    return out


def _panel(panel: Panel, move: Floats, height: float, seams: Sewn) -> list[str]:
    """Drawing commands of a panel, mm, y up."""

    def up(points: Floats) -> Floats:
        return (page(points) + move) * [1.0, -1.0] + [0.0, height]

    shapes = [up(outline(panel, loop)) for loop in loops(panel)]
    out = ["0.97 0.95 0.92 rg " + " ".join(_path(s, "h") for s in shapes) + " f*"]
    for i in range(len(panel.edges)):
        curve = up(along(panel, i, np.linspace(0, 1, 2 if panel.edges[i].kind == "line" else 65)))
        out.append(f"0.27 G 0.5 w {_path(curve)} S")
        way = unit(curve[len(curve) // 2] - curve[len(curve) // 2 - 1])
        inward = np.array([-way[1], way[0]]) * (1.0 if area(panel) > 0 else -1.0)
        for k, color, low, high, forward in seams.get((panel.name, i), []):
            r, g, b = (int(color[j : j + 2], 16) / 255 for j in (1, 3, 5))
            own = up(along(panel, i, np.linspace(low, high, 49)))
            own = own if forward else own[::-1]
            here, on = own[24], unit(own[25] - own[23])
            across = np.array([-on[1], on[0]])
            head = np.array([here + 4 * on, here - 2 * on + 2.4 * across, here - 2 * on - 2.4 * across])
            tone = f"{r:.3f} {g:.3f} {b:.3f}"
            out.append(f"{tone} RG {tone} rg 1.2 w {_path(own)} S {_path(head, 'h')} f")
            at = here - 7 * inward
            out.append(_text(str(k), float(at[0]), float(at[1]), 6, color=tone))
        a, b = (up(p[None])[0] for p in ends(panel, i))
        at = up(along(panel, i, 0.5))[0] + 6 * inward
        turn = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
        turn = turn - np.pi if turn > np.pi / 2 else turn + np.pi if turn < -np.pi / 2 else turn
        out.append(_text(f"{i}: {100 * length(panel, i):.1f} cm", float(at[0]), float(at[1]), 4.5, turn))
    middle = shapes[0].mean(axis=0) if shapes else up(np.zeros((1, 2)))[0]
    warp = unit(panel.grain) * 35
    out.append(f"0.6 G 0.4 w {_path(np.array([middle - warp, middle + warp]))} S")
    out.append(_text(panel.name, float(middle[0]), float(middle[1]) + 3, 11))
    return out


def _path(points: Floats, end: str = "") -> str:
    first, *rest = (f"{x:.3f} {y:.3f}" for x, y in points)
    return f"{first} m " + " ".join(f"{p} l" for p in rest) + (f" {end}" if end else "")


def _text(text: str, x: float, y: float, size: float, turn: float = 0.0, color: str = "0.2 0.2 0.2") -> str:
    """Text about a place, as Helvetica has it; letters that Windows' Latin alphabet lacks become ?."""
    plain = text.encode("cp1252", "replace")
    said = "".join(f"\\{b:03o}" if b < 32 or b > 126 or b in b"()\\" else chr(b) for b in plain)
    c, s = np.cos(turn), np.sin(turn)
    half = 0.26 * size * len(plain)  # letters are about half as wide as high
    at = f"{c:.5f} {s:.5f} {-s:.5f} {c:.5f} {x - half * c:.3f} {y - half * s:.3f}"
    return f"{color} rg BT /H {size:g} Tf {at} Tm ({said}) Tj ET"


def _file(body: str, size: tuple[float, float], pages: list[Page]) -> bytes:
    """The bytes of a document whose pages show parts of one form."""
    font = b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>"
    kids = " ".join(f"{5 + 2 * k} 0 R" for k in range(len(pages)))
    box = f"/BBox [0 0 {size[0]:.2f} {size[1]:.2f}]"
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>".encode(),
        font,
        _stream(body, f"/Type /XObject /Subtype /Form {box} /Resources << /Font << /H 3 0 R >> >>"),
    ]
    for k, ((width, height), shown) in enumerate(pages):
        media = f"[0 0 {width * POINT:.3f} {height * POINT:.3f}]"
        own = f"/Resources << /Font << /H 3 0 R >> /XObject << /D 4 0 R >> >> /Contents {6 + 2 * k} 0 R"
        objects += [f"<< /Type /Page /Parent 2 0 R /MediaBox {media} {own} >>".encode(), _stream(shown)]
    out, places = bytearray(b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n"), []
    for k, content in enumerate(objects):
        places.append(len(out))
        out += f"{k + 1} 0 obj\n".encode() + content + b"\nendobj\n"
    start = len(out)
    out += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode()
    out += b"".join(f"{p:010d} 00000 n \n".encode() for p in places)
    out += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R >>\nstartxref\n{start}\n%%EOF\n".encode()
    return bytes(out)


def _stream(text: str, more: str = "") -> bytes:
    data = zlib.compress(text.encode("ascii"), 6)
    head = f"<< {more} /Length {len(data)} /Filter /FlateDecode >>\nstream\n"
    return head.encode() + data + b"\nendstream"
