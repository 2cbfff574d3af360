"""CSM: the marker files of Character Studio, read and written.

ASCII sections that begin with `$` and a keyword: `$Order` lists the markers, each row of `$Points` is a frame number and
the coordinates, DROPOUT where a marker was not seen. Source: note motion.md, 3.5. No official specification is public,
so the reader is lenient: keywords in any case and order, one DROPOUT a marker or one a coordinate.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats.atomic import atomic
from vitruvian.formats.rows import MOST_NAMES, cells, number, text_lines, whole
from vitruvian.formats.trc import lost_by_text
from vitruvian.motion.markers import Markers, from_y_up, measured, metres_per

_KNOWN = "filename date time actor comments firstframe lastframe spinelinks rate order points".split()


def read_csm(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    fps: float | None = None,
    actor: str | None = None,
) -> Markers:
    """The markers of a CSM file, in metres, Y up.

    CSM has Z up; it says no unit: `unit`, or the common one that makes the figure a person. `fps` where $Rate is absent.
    Unknown sections become notes. Raises FileError with line and frame.
    """
    lines = text_lines(path)
    sections = _sections(path, lines)
    names = [word for _, text in sections.get("order", []) for word in text.split()]
    if not 0 < len(names) <= MOST_NAMES:
        raise FileError(path, 0, f"expected $Order with 1 to {MOST_NAMES} marker names, found {len(names)}")
    if "points" not in sections:
        raise FileError(path, len(lines), "expected $Points with the coordinates, found none")
    rate = fps
    if rate is None:
        if "rate" not in sections:
            raise FileError(path, 0, "says no frame rate ($Rate); say fps=...")
        line, word = sections["rate"][0] if sections["rate"] else (0, "")
        rate = number(path, line, (word.split() or [""])[0], "frames a second after $Rate")
    if not 0 < rate <= 1e6:
        raise FileError(path, 0, f"expected a frame rate above zero, found {rate:g}")
    notes = [f"${k}: {' '.join(t for _, t in v)[:200]}" for k, v in sections.items() if k not in _KNOWN]
    frames, raw, gaps = _points(path, sections["points"], len(names))
    notes += gaps
    for key, have in (("firstframe", frames[0]), ("lastframe", frames[-1])):
        told = sections.get(key) or [(0, "")]
        if told[0][1].strip().isdigit() and int(told[0][1][:18]) != have:
            notes.append(f"${key} says {told[0][1].strip()[:18]}, the rows {have}; the rows count")
    try:
        return measured(
            names, raw, rate, unit=unit, up=up, said_up="z", why_up="what CSM means", actor=actor, notes=notes,
            first=frames[0], start=frames[0] / rate, name=Path(path).stem,
        )  # fmt: skip
    except VitruvianError as error:
        raise FileError(path, 0, str(error)) from None


def _sections(path: object, lines: list[str]) -> dict[str, list[tuple[int, str]]]:
    """keyword -> (line, text) of what stands behind it and below it."""
    out: dict[str, list[tuple[int, str]]] = {}
    at: list[tuple[int, str]] | None = None
    for n, line in enumerate(lines, 1):
        text = line.strip()
        if text.startswith("$"):
            key, _, rest = text[1:].replace("\t", " ").partition(" ")
            if key.lower() in out:
                raise FileError(path, n, f"${key[:40]} stands twice, expected it once")
            if len(out) >= 1000:
                raise FileError(path, n, "expected at most 1000 sections")
            at = out[key.lower()] = []
            text = rest.strip()
        if text:
            if at is None:
                raise FileError(path, n, f"expected a section such as $Order, found {text[:40]!r}")
            at.append((n, text))
    return out


def _points(path: object, lines: list[tuple[int, str]], count: int) -> tuple[list[int], np.ndarray, list[str]]:
    """Frame numbers, raw coordinates (F,M,3) and notes; frames left out are gaps of all markers."""
    rows: list[list[float]] = []
    frames: list[int] = []
    for n, text in lines:
        words = text.split()
        frame = whole(path, n, words[0], "a frame number")
        if frames and frame <= frames[-1]:
            raise FileError(path, n, f"frame {frame}: expected a number above {frames[-1]}, frames rise")
        gone = sum(w.upper() == "DROPOUT" for w in words)
        cell = 3 if gone and len(words) - 1 + 2 * gone == 3 * count else 1
        flat: list[str] = []
        for word in words[1:]:
            flat += [""] * cell if word.upper() == "DROPOUT" else [word]
        if len(flat) != 3 * count:
            raise FileError(
                path, n, f"frame {frame}: expected {3 * count} coordinates, 3 for each of {count} markers, "
                f"found {len(words) - 1}"
            )  # fmt: skip
        frames.append(frame)
        rows.append(cells(path, n, frame, flat))
    if not rows:
        raise FileError(path, 0, "expected rows of coordinates after $Points, found none")
    span = frames[-1] - frames[0] + 1
    notes = []
    if span > 2 * len(rows) + 100:
        raise FileError(path, lines[-1][0], f"frames {frames[0]} to {frames[-1]}, but only {len(rows)} are there")
    raw = np.full((span, 3 * count), np.nan)
    raw[np.array(frames) - frames[0]] = rows
    if span > len(rows):
        warn(f"{path}: {span - len(rows)} frames between {frames[0]} and {frames[-1]} are missing: read as gaps")
        notes.append(f"{span - len(rows)} frames are missing: gaps of all markers")
    return frames, raw.reshape(span, count, 3), notes


def write_csm(markers: Markers, path: str | os.PathLike[str], *, unit: float | str = "mm") -> dict[str, list[str]]:
    """Write markers as CSM: Z up, millimetres (CSM names no unit), DROPOUT for gaps. The report: {"lost": [...]}.

    Blanks in names become underscores. The file is complete or absent.
    """
    scale = metres_per(unit)
    names = ["_".join(n.split()).replace("$", "_") or "marker" for n in markers.names]
    last = markers.first + len(markers) - 1
    head = [f"$Filename {Path(path).name}", f"$FirstFrame {markers.first}", f"$LastFrame {last}", "$SpineLinks 3"]
    head += [f"$Rate {markers.fps:.10g}", "$Order", " ".join(names), "$Points"]
    table = from_y_up(markers.points, "z") / scale + 0.0
    gone = "DROPOUT DROPOUT DROPOUT"
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(head) + "\n")
        for f, frame in enumerate(table.tolist()):
            values = " ".join(gone if p[0] != p[0] else f"{p[0]:.5f} {p[1]:.5f} {p[2]:.5f}" for p in frame)
            file.write(f"{markers.first + f} {values}\n")
    return {"lost": lost_by_text(markers)}
