"""C3D: the binary exchange format of motion laboratories, read.

Intel, DEC and MIPS numbers, integer and float storage, labels beyond 255, analog channels, events. A reader of its own
keeps hostile files bounded and needs no extra; on the reference file its points are those of `ezc3d` and `c3d` bit for
bit. Source: note motion.md, 3.3; "The C3D File Format User Guide" (Motion Lab Systems).
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.errors import FileError, VitruvianError, warn
from vitruvian.formats.rows import MOST_NAMES, content
from vitruvian.motion.markers import FARTHEST, Markers, measured

_BLOCK = 512
_KEY = 12345  # marks the events of the header


@dataclass(frozen=True)
class _Numbers:
    """How a processor writes numbers."""

    name: str

    @property
    def end(self) -> str:
        return ">" if self.name == "MIPS" else "<"

    def shorts(self, data: bytes, *, signed: bool = True) -> np.ndarray:
        return np.frombuffer(data, f"{self.end}{'i' if signed else 'u'}2")

    def floats(self, data: bytes) -> np.ndarray:
        """float32 as they are meant. A DEC number has its 16-bit words swapped and an exponent that is two higher."""
        if self.name != "DEC":
            return np.frombuffer(data, f"{self.end}f4").astype(np.float32)
        words = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
        bits = np.ascontiguousarray(words).view("<u4")[:, 0]
        zero = (bits & 0x7F800000) == 0  # an exponent of zero is the number zero
        out = bits.view("<f4") / np.float32(4)
        return np.where(zero, np.float32(0), out).astype(np.float32)


_PROCESSORS = {84: _Numbers("Intel"), 85: _Numbers("DEC"), 86: _Numbers("MIPS")}


@dataclass(frozen=True)
class _Parameter:
    kind: int  # -1 text, 1 byte, 2 integer, 4 float
    shape: tuple[int, ...]
    data: bytes


@dataclass(frozen=True)
class _File:
    path: object
    data: bytes
    numbers: _Numbers
    parameters: dict[str, _Parameter]  # "GROUP:NAME"

    def values(self, name: str) -> np.ndarray:
        """All numbers of a parameter, in file order; none when it is absent or text."""
        p = self.parameters.get(name)
        if p is None or p.kind == -1:
            return np.zeros(0)
        if p.kind == 4:
            return self.numbers.floats(p.data).astype(np.float64)
        if p.kind == 2:
            return self.numbers.shorts(p.data).astype(np.float64)
        return np.frombuffer(p.data, np.uint8).astype(np.float64)

    def texts(self, name: str) -> list[str]:
        """The strings of a parameter; also LABELS2, LABELS3, ... behind LABELS."""
        out: list[str] = []
        for k in range(1, 200):
            p = self.parameters.get(name if k == 1 else f"{name}{k}")
            if p is None or p.kind != -1:
                break
            size = p.shape[0] if p.shape else 0
            count = int(np.prod(p.shape[1:])) if len(p.shape) > 1 else 1
            out += [_plain(p.data[i * size : (i + 1) * size]) for i in range(count)]
        return out

    def number(self, name: str, default: float) -> float:
        found = self.values(name)
        return float(found[0]) if len(found) and np.isfinite(found[0]) else default


def _plain(text: bytes) -> str:
    try:
        return text.decode("utf-8").strip(" \0")
    except UnicodeDecodeError:
        return text.decode("latin-1").strip(" \0")


def read_c3d(
    path: str | os.PathLike[str],
    *,
    unit: float | str | None = None,
    up: str | None = None,
    fps: float | None = None,
    actor: str | None = None,
) -> Markers:
    """The markers of a C3D file, in metres, Y up, with its analog channels and events.

    Unit and up axis are POINT:UNITS and POINT:Y_SCREEN where the file has them, `unit`, `up`, `fps` win. A point with a
    negative residual, or with all numbers zero, was not seen. `actor` picks one of several people by the prefix of
    their labels (SUBJECTS:LABEL_PREFIXES, or what stands before a colon). A file cut short gives the frames that it
    has, with a warning. Raises FileError.
    """
    file = _open(path)
    raw, analog, facts = _frames(file)
    rate = fps if fps is not None else facts["rate"]
    if not (np.isfinite(rate) and 0 < rate <= 1e6):
        raise FileError(path, 0, f"says a frame rate of {rate:g}; say fps=...")
    labels = file.texts("POINT:LABELS")
    count = raw.shape[1]
    notes = list(facts["notes"])
    if len(labels) < count:
        notes.append(f"{count - len(labels)} points have no label: called P and their number")
    names = [(labels[i] if i < len(labels) else "") or f"P{i + 1}" for i in range(count)]
    units = file.texts("POINT:UNITS")
    screen = (file.texts("POINT:Y_SCREEN") or [""])[0].lower()
    said_up = screen.lstrip("+") if screen.lstrip("+-") in ("x", "y", "z") else None
    wide = file.values("SUBJECTS:USED")
    prefixes = file.texts("SUBJECTS:LABEL_PREFIXES") if len(wide) and wide[0] >= 2 else []
    first = facts["first"]
    try:
        return measured(
            names, raw, rate, unit=unit, up=up, said_unit=units[0] if units else None, said_up=said_up, actor=actor,
            notes=notes, prefixes=[p for p in prefixes if p], first=first, start=(first - 1) / rate,
            events=_events(file), analog=analog, analog_fps=rate * facts["samples"], name=Path(path).stem,
        )  # fmt: skip
    except VitruvianError as error:
        raise FileError(path, 0, str(error)) from None


def raw_points(path: str | os.PathLike[str]) -> Floats:
    """Points (F,M,3) as the file has them, in its unit and axes, NaN where a point was not seen."""
    return _frames(_open(path))[0]


def _open(path: str | os.PathLike[str]) -> _File:
    data = content(path)
    if len(data) < 2 * _BLOCK or data[1] != 0x50 or not data[0]:
        raise FileError(path, 0, "expected a C3D file (80 in its second byte), found something else")
    at = (data[0] - 1) * _BLOCK
    if at + 4 > len(data):
        raise FileError(path, 0, f"its parameters begin at byte {at}, expected that before the end at {len(data)}")
    numbers = _PROCESSORS.get(data[at + 3])
    if numbers is None:
        raise FileError(path, 0, f"expected a processor 84, 85 or 86 (Intel, DEC, MIPS), found {data[at + 3]}")
    end = min(len(data), at + max(data[at + 2], 1) * _BLOCK) if data[at + 2] else len(data)
    return _File(path, data, numbers, _parameters(path, data, at + 4, end, numbers))


def _parameters(path: object, data: bytes, at: int, end: int, numbers: _Numbers) -> dict[str, _Parameter]:
    groups: dict[int, str] = {}
    found: list[tuple[int, str, _Parameter]] = []
    while at + 2 <= end:
        size, number = (int(v) for v in np.frombuffer(data[at : at + 2], np.int8))
        size = abs(size)  # negative: locked
        if size == 0 or number == 0:
            break
        name = _plain(data[at + 2 : at + 2 + size]).upper()
        at += 2 + size
        if at + 2 > end:
            raise FileError(path, 0, f"parameter {name[:40]!r} ends behind the parameters' end at byte {end}")
        step = int(numbers.shorts(data[at : at + 2])[0])
        if number < 0:
            groups[-number] = name
        else:
            found.append((number, name, _parameter(path, name, data, at + 2, end)))
        if step == 0:
            break
        if step < 2:
            raise FileError(path, 0, f"parameter {name[:40]!r} points back by {step} bytes")
        at += step
        if len(found) + len(groups) > 20_000:
            raise FileError(path, 0, "expected at most 20000 parameters")
    return {f"{groups.get(number, number)}:{name}": p for number, name, p in found}


def _parameter(path: object, name: str, data: bytes, at: int, end: int) -> _Parameter:
    if at + 2 > end:
        raise FileError(path, 0, f"parameter {name[:40]!r} ends behind the parameters' end at byte {end}")
    kind = int(np.frombuffer(data[at : at + 1], np.int8)[0])
    dims = data[at + 1]
    if kind not in (-1, 1, 2, 4) or dims > 7 or at + 2 + dims > end:
        raise FileError(
            path, 0, f"parameter {name[:40]!r}: expected text, bytes, integers or floats, found kind {kind}"
        )
    shape = tuple(data[at + 2 : at + 2 + dims])
    size = abs(kind)
    for n in shape:
        size *= n
    start = at + 2 + dims
    if start + size > len(data):
        raise FileError(path, 0, f"parameter {name[:40]!r} has {size} bytes, more than are left in the file")
    return _Parameter(kind, shape, data[start : start + size])


def _frames(file: _File) -> tuple[Floats, dict[str, Floats], dict[str, Any]]:
    """Points (F,M,3) in the file's unit, analog channels, and first frame, rate, samples a frame and notes."""
    header = file.numbers.shorts(file.data[:_BLOCK], signed=False)
    real = file.numbers.floats(file.data[:_BLOCK])
    points, width, samples = int(header[1]), int(header[2]), int(header[9])
    scale = file.number("POINT:SCALE", float(real[3]))
    rate = file.number("POINT:RATE", float(file.numbers.floats(file.data[20:24])[0]))
    first, last = int(header[3]), int(header[4])
    begin, finish = file.values("TRIAL:ACTUAL_START_FIELD"), file.values("TRIAL:ACTUAL_END_FIELD")
    if len(begin) >= 2 and len(finish) >= 2:  # two 16-bit words, the lower one first
        low = [int(v) & 0xFFFF for v in (begin[0], begin[1], finish[0], finish[1])]
        first, last = low[0] + (low[1] << 16), low[2] + (low[3] << 16)
    count = last - first + 1
    if count <= 0 or points > MOST_NAMES:
        raise FileError(file.path, 0, f"expected frames and at most {MOST_NAMES} points, found {count} and {points}")
    if points == 0:
        raise FileError(file.path, 0, "expected points, found analog channels only")
    start = (int(file.number("POINT:DATA_START", 0.0)) & 0xFFFF or int(header[8])) - 1
    start *= _BLOCK
    if not 0 < start < len(file.data):
        raise FileError(file.path, 0, f"its points begin at byte {start}, expected that before {len(file.data)}")
    if not np.isfinite(scale) or scale == 0:
        raise FileError(file.path, 0, f"POINT:SCALE is {scale:g}, expected a number but zero")
    size = 4 if scale < 0 else 2
    row = 4 * points + width
    notes = []
    have = (len(file.data) - start) // (row * size)
    if have < count:
        long = file.values("POINT:FRAMES")
        if len(long) and 0 < int(long[0]) & 0xFFFF <= have and count > 0xFFFF:
            count = int(long[0]) & 0xFFFF
        else:
            warn(f"{file.path}: says {count} frames, {have} are there; the file is cut short, read as far as it goes")
            notes.append(f"the file says {count} frames, {have} are there")
            count = have
        if count == 0:
            raise FileError(file.path, 0, "expected frames, found the end of the file")
    body = file.data[start : start + count * row * size]
    table = (file.numbers.floats if scale < 0 else file.numbers.shorts)(body).reshape(count, row)
    block = table[:, : 4 * points].reshape(count, points, 4)
    with np.errstate(invalid="ignore", over="ignore"):
        place = block[..., :3].astype(np.float64)
        if scale > 0:
            place = place * scale
        unseen = (block[..., 3] < 0) | ~(block[..., :3] != 0).any(axis=-1)
        wrong = ~(np.abs(place) <= FARTHEST).all(axis=-1) & ~unseen
    if wrong.any():
        f, m = np.argwhere(wrong)[0]
        told = "NaN" if np.isnan(place[f, m]).any() else f"{np.abs(place[f, m]).max():g}"
        if not np.isnan(place[wrong]).any(axis=-1).all():
            raise FileError(file.path, 0, f"frame {first + f}: point {m + 1}: expected a coordinate, found {told}")
        unseen |= wrong  # some programs write NaN for what was not seen
    place[unseen] = np.nan
    facts = {"first": first, "rate": rate, "samples": samples, "notes": notes}
    return place, _analog(file, table[:, 4 * points :], samples, scale < 0), facts


def _analog(file: _File, table: np.ndarray, samples: int, real: bool) -> dict[str, Floats]:
    """channel -> (F * samples,) in the channel's unit: (stored - offset) * scale * general scale."""
    if not samples or not table.shape[1] or table.shape[1] % samples:
        return {}
    channels = table.shape[1] // samples
    if file.texts("ANALOG:FORMAT")[:1] == ["UNSIGNED"] and not real:
        table = table.astype(np.int32) & 0xFFFF
    data = table.astype(np.float64).reshape(-1, channels)
    general = file.number("ANALOG:GEN_SCALE", 1.0)
    scales, offsets, labels = file.values("ANALOG:SCALE"), file.values("ANALOG:OFFSET"), file.texts("ANALOG:LABELS")
    out: dict[str, Floats] = {}
    for c in range(channels):
        scale = scales[c] if c < len(scales) else 1.0
        offset = offsets[c] if c < len(offsets) else 0.0
        name = (labels[c] if c < len(labels) else "") or f"A{c + 1}"
        while name in out:
            name += "_"
        with np.errstate(invalid="ignore", over="ignore"):
            values = (data[:, c] - offset) * scale * general
        if not np.isfinite(values).all():
            warn(f"{file.path}: analog channel {name[:40]!r} holds what is no number; the channel is left out")
            continue
        out[name] = values
    return out


def _events(file: _File) -> tuple[tuple[float, str], ...]:
    """(seconds, name) of the EVENT group, or of the header."""
    used = int(file.number("EVENT:USED", 0.0))
    times = file.values("EVENT:TIMES")
    if used > 0 and len(times) >= 2:
        labels, sides = file.texts("EVENT:LABELS"), file.texts("EVENT:CONTEXTS")
        found = []
        for i, (minutes, seconds) in enumerate(times[: 2 * (len(times) // 2)].reshape(-1, 2)[:used]):
            side, label = (sides[i] if i < len(sides) else ""), (labels[i] if i < len(labels) else "event")
            if np.isfinite(minutes) and np.isfinite(seconds):
                found.append((float(minutes * 60 + seconds), f"{side} {label}".strip()))
        return tuple(sorted(found))
    words = file.numbers.shorts(file.data[:_BLOCK])
    if words[149] != _KEY:
        return ()
    count = min(max(int(words[150]), 0), 18)
    times = file.numbers.floats(file.data[304 : 304 + 4 * count])
    names = [_plain(file.data[396 + 4 * i : 400 + 4 * i]) or "event" for i in range(count)]
    return tuple(sorted((float(t), n) for t, n in zip(times, names) if np.isfinite(t)))
