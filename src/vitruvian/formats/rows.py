"""Pieces that readers of capture files share: bounded reading, lines, numbers, and errors that name the line."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, warn
from vitruvian.motion.markers import FARTHEST

LARGEST = 1 << 30  # bytes; an hour of 100 markers at 120 Hz as text is a quarter of it
MOST_NAMES = 10_000


def content(path: str | os.PathLike[str], largest: int = LARGEST) -> bytes:
    """All bytes of a file. Raises FileError when it can't be read or is larger than `largest`."""
    try:
        size = Path(path).stat().st_size
        if size > largest:
            raise FileError(path, 0, f"has {size / 1e6:.0f} MB, expected at most {largest / 1e6:.0f}; split it")
        return Path(path).read_bytes()
    except OSError as error:
        raise FileError(path, 0, f"can't be read ({error.strerror})") from None


def text_lines(path: str | os.PathLike[str]) -> list[str]:
    """The lines of a text file, in UTF-8 or Latin-1, with any line ends. Raises FileError for binary content."""
    data = content(path)
    if b"\0" in data[:4096]:
        raise FileError(path, 1, "expected text, found binary data")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def number(path: object, line: int, word: str, what: str = "a number", at: str = "") -> float:
    """One finite number. Raises FileError with the line and `at`, such as a frame."""
    try:
        value = float(word) if "_" not in word else np.nan
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        hint = " (decimal commas are not allowed)" if re.fullmatch(r"[-+]?\d+,\d+", word) else ""
        raise FileError(path, line, f"{at and f'{at}: '}expected {what}, found {word[:40]!r}{hint}")
    return value


def whole(path: object, line: int, word: str, what: str, at: str = "") -> int:
    """A whole number, also written as 12.0. Raises FileError with the line."""
    value = number(path, line, word, what, at)
    if value != int(value) or abs(value) > 1e15:
        raise FileError(path, line, f"expected {what}, found {word[:40]!r}")
    return int(value)


def cells(path: object, line: int, frame: object, words: Sequence[str]) -> list[float]:
    """Coordinates, NaN for blank cells and the word nan. Raises FileError with line and frame."""
    out = []
    for word in words:
        bare = word.strip()
        if not bare or bare.lower() in ("nan", "-nan", "nan(ind)", "-nan(ind)"):
            out.append(np.nan)
            continue
        value = number(path, line, bare, "a coordinate", f"frame {frame}")
        if abs(value) > FARTHEST:
            raise FileError(path, line, f"frame {frame}: expected a coordinate below {FARTHEST:g}, found {bare[:40]}")
        out.append(value)
    return out


def steady(path: object, times: Floats, fps: float, lines: Sequence[int]) -> tuple[float, tuple[str, ...]]:
    """The rate that the times (F,) show, checked against the `fps` that the file says (0: it says none), and notes.

    Raises FileError where times do not rise.
    """
    if len(times) < 2:
        return fps, ()
    steps = np.diff(times)
    if (steps <= 0).any():
        bad = int(np.argmax(steps <= 0)) + 1
        raise FileError(
            path, lines[bad], f"frame {bad}: expected times that rise, found {times[bad]:g} after {times[bad - 1]:g}"
        )
    mean = (len(times) - 1) / (times[-1] - times[0])
    notes: tuple[str, ...] = ()
    if fps <= 0 or abs(mean / fps - 1) > 0.01:
        found = float(round(mean)) if mean > 0.5 and abs(mean / round(mean) - 1) < 0.002 else float(mean)
        if fps > 0:
            warn(f"{path}: says {fps:g} frames a second but its times show {found:g}, which counts")
        fps, notes = found, (f"rate {found:g} per second: from the times",)
    if steps.max() > 1.5 / fps:
        gap = int(np.argmax(steps > 1.5 / fps))
        warn(f"{path}:{lines[gap]}: frames are missing after {times[gap]:g} s; they are not made up")
    return fps, notes
