"""TRC marker files (Motion Analysis, OpenSim), read and written.

Labels are the non-empty cells in order, never by column, because tabs between them vary; the rows count, not the number
of frames that the head announces. Source: note motion.md, 3.4.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats.atomic import atomic
from vitruvian.formats.rows import MOST_NAMES, cells, number, steady, text_lines, whole
from vitruvian.motion.markers import Markers, from_y_up, measured, metres_per


def read_trc(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    fps: float | None = None,
    actor: str | None = None,
) -> Markers:
    """The markers of a TRC file, in metres, Y up.

    The head says unit and rate; `unit`, `fps` win over it. TRC does not say which axis is up: `up`, or the axis from
    foot to head markers. Blank cells and `nan` are gaps. `actor` picks one of several people by the prefix of their
    labels. Raises FileError with line and frame.
    """
    lines = text_lines(path)
    if not lines[0].lower().startswith("pathfiletype"):
        raise FileError(path, 1, f"expected PathFileType at the start of a TRC file, found {lines[0][:40]!r}")
    if len(lines) < 5:
        raise FileError(path, len(lines), "expected a head of five lines, found the end of the file")
    keys = [k.lower() for k in lines[1].split()]
    head = dict(zip(keys, lines[2].split()))
    rate = fps if fps is not None else number(path, 3, head.get("datarate", ""), "DataRate in frames a second")
    if not 0 < rate <= 1e6:
        raise FileError(path, 3, f"expected a DataRate above zero, found {rate:g}")
    names = [c.strip() for c in (lines[3].split("\t") if "\t" in lines[3] else lines[3].split())]
    names = [n for n in names if n][2:]
    if not 0 < len(names) <= MOST_NAMES:
        raise FileError(path, 4, f"expected Frame#, Time and 1 to {MOST_NAMES} labels, found {len(names)} labels")
    frames, times, rows, where = _rows(path, lines, names)
    told = head.get("nummarkers", "")
    if told.isdigit() and int(told) != len(names):
        warn(f"{path}:3: NumMarkers is {told[:20]}, {len(names)} markers are there; read as they are")
    told = head.get("numframes", "")
    notes = [f"the head says {told[:20]} frames, {len(rows)} are there"] if told != str(len(rows)) else []
    if fps is None:
        rate, more = steady(path, np.array(times), rate, where)
        notes += more
    raw = np.array(rows).reshape(len(rows), len(names), 3)
    try:
        return measured(
            names, raw, rate, unit=unit, up=up, said_unit=head.get("units"), actor=actor, notes=notes,
            first=frames[0] if frames else 1, start=times[0] if times else 0.0, name=Path(path).stem,
        )  # fmt: skip
    except VitruvianError as error:
        raise FileError(path, 0, str(error)) from None


def _rows(
    path: object, lines: list[str], names: list[str]
) -> tuple[list[int], list[float], list[list[float]], list[int]]:
    """Frame numbers, times, coordinates and the line of each row."""
    frames: list[int] = []
    times: list[float] = []
    rows: list[list[float]] = []
    where: list[int] = []
    width = 2 + 3 * len(names)
    short = 0
    for n, line in enumerate(lines[5:], 6):
        words = line.split()
        if not words:
            continue
        if len(words) != width:  # blank cells: only tabs show where
            words = line.split("\t")
            while len(words) > width and not words[-1].strip():
                words.pop()
            missing = width - len(words)
            if len(words) < 2 or missing < 0 or missing % 3:
                raise FileError(
                    path, n, f"row {len(rows)}: expected {width} cells, frame, time and 3 for each of {len(names)} "
                    f"labels, found {len(words)}"
                )  # fmt: skip
            short += missing > 0
            words += [""] * missing
        frame = whole(path, n, words[0].strip(), "a frame number", f"row {len(rows)}")
        frames.append(frame)
        times.append(number(path, n, words[1].strip(), "a time in seconds", f"frame {frame}"))
        rows.append(cells(path, n, frame, words[2:]))
        where.append(n)
    if not rows:
        raise FileError(path, len(lines), "expected rows of coordinates after the head, found none")
    if short:
        warn(f"{path}: {short} rows end early; the markers they lack are read as not seen")
    return frames, times, rows, where


def write_trc(
    markers: Markers, path: str | os.PathLike[str], *, unit: float | str = "mm", up: str = "y"
) -> dict[str, list[str]]:
    """Write markers as TRC; gaps are blank cells. The report: {"lost": what TRC can't hold}.

    `unit` m, cm, mm or metres per unit; `up` the axis that points upwards in the file. The file is complete or absent.
    """
    scale = metres_per(unit)
    word = unit if isinstance(unit, str) else {1.0: "m", 0.01: "cm", 0.001: "mm"}.get(scale)
    if word is None:
        raise VitruvianError(f"unit: TRC names its unit; expected m, cm, mm or in, found {unit!r}")
    names = [" ".join(n.split()) or "marker" for n in markers.names]
    count, rate = len(names), f"{markers.fps:.10g}"
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{len(markers)}\t{count}\t{word}\t{rate}\t{markers.first}\t{len(markers)}",
        "Frame#\tTime\t" + "\t\t\t".join(names),
        "\t\t" + "\t".join(f"{axis}{m}" for m in range(1, count + 1) for axis in "XYZ"),
        "",
    ]
    table = from_y_up(markers.points, up).reshape(len(markers), 3 * count) / scale + 0.0
    with atomic(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write("\n".join(head) + "\n")
        for f, row in enumerate(table.tolist()):
            values = "\t".join("" if x != x else f"{x:.6f}" for x in row)
            file.write(f"{markers.first + f}\t{markers.start + f / markers.fps:.6f}\t{values}\n")
    return {"lost": lost_by_text(markers)}


def lost_by_text(markers: Markers) -> list[str]:
    """What plain tables of markers have no place for."""
    lost = []
    if markers.analog:
        lost.append(f"{len(markers.analog)} analog channels: the format holds markers only")
    if markers.events:
        lost.append(f"{len(markers.events)} events: the format holds markers only")
    return lost
