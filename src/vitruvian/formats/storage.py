"""MOT and STO: OpenSim's tables of joint angles, forces and the like over time, read.

A head up to `endheader`, then a row of names, the first of which is time. Angles are in degrees where the head says
`inDegrees=yes`, and in SIMM's motion files. Source: note motion.md, 3.4.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, warn
from vitruvian.formats.rows import MOST_NAMES, number, steady, text_lines
from vitruvian.motion.markers import Storage


def read_storage(path: str | os.PathLike[str]) -> Storage:
    """The table in a MOT or STO file, values as they stand. Its `degrees` says whether angles are in degrees, None when
    the head does not say it. Raises FileError with the line.
    """
    lines = text_lines(path)
    end = next((n for n, line in enumerate(lines[:1000]) if line.strip().lower() == "endheader"), None)
    if end is None:
        raise FileError(path, min(len(lines), 1000), "expected endheader after the head, found none")
    head = {}
    for line in lines[:end]:
        key, sign, value = line.partition("=")
        if sign:
            head[key.strip().lower()] = value.strip()
    if head.get("datatype", "double").lower() != "double":
        raise FileError(path, 1, f"DataType {head['datatype'][:20]}: expected plain numbers (double)")
    at = next((n for n in range(end + 1, len(lines)) if lines[n].strip()), None)
    if at is None:
        raise FileError(path, len(lines), "expected a row of names after endheader, found the end of the file")
    names = [c.strip() for c in lines[at].split("\t") if c.strip()] if "\t" in lines[at] else lines[at].split()
    if len(names) < 2 or names[0].lower() != "time" or len(names) > MOST_NAMES:
        raise FileError(path, at + 1, f"expected the names of columns, time first, found {lines[at][:40]!r}")
    rows: list[list[float]] = []
    where: list[int] = []
    for n in range(at + 1, len(lines)):
        words = lines[n].split()
        if not words:
            continue
        if len(words) != len(names):
            raise FileError(path, n + 1, f"row {len(rows)}: expected {len(names)} numbers, found {len(words)}")
        rows.append([np.nan if w.lower() in ("nan", "-nan") else number(path, n + 1, w) for w in words])
        where.append(n + 1)
    if not rows:
        raise FileError(path, len(lines), "expected rows of numbers after the names, found none")
    table = np.array(rows)
    if np.isnan(table[:, 0]).any():
        raise FileError(path, where[int(np.argmax(np.isnan(table[:, 0])))], "expected a time, found nan")
    told = head.get("nrows", head.get("datarows", ""))
    if told.isdigit() and int(told[:18]) != len(rows):
        warn(f"{path}: says {told[:18]} rows, {len(rows)} are there; read as they are")
    rate, notes = steady(path, table[:, 0], 0.0, where)
    degrees, why = _degrees(head, lines[:end], table[:, 1:])
    return Storage(tuple(names[1:]), table[:, 0], table[:, 1:], degrees, rate, Path(path).stem, (why, *notes))


def _degrees(head: dict[str, str], lines: list[str], values: Floats) -> tuple[bool | None, str]:
    """Whether angles are in degrees (None: unknown), and why."""
    if "indegrees" in head:
        said = head["indegrees"].lower() == "yes"
        return said, f"angles in {'degrees' if said else 'radians'}: the file says so"
    if any("simm motion" in line.lower() for line in lines):
        return True, "angles in degrees: a SIMM motion file"
    if len(values) and np.nanmax(np.abs(values), initial=0.0) > 4 * np.pi:
        return None, "the head does not say inDegrees; values beyond two turns in radians look like degrees"
    return None, "the head does not say inDegrees: angles may be in degrees or radians"
