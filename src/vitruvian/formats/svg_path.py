"""The language of SVG paths and transforms, read into lines, Bezier curves and arcs.

Source: SVG 1.1 (second edition), sections 7.6 and 8.3, appendix F.6 for arcs.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.cutting import Segment
from vitruvian.errors import VitruvianError

MOST = 20_000  # numbers of one path
LARGEST = 1e7
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?", re.ASCII)
_GAP = re.compile(r"[\s,]*")
_COUNTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "S": 4, "Q": 4, "T": 2, "A": 7, "Z": 0}
_TRANSFORM = re.compile(r"\s*,?\s*([A-Za-z]+)\s*\(([^()]*)\)", re.ASCII)
_ARGUMENTS = {"matrix": (6,), "translate": (1, 2), "scale": (1, 2), "rotate": (1, 3), "skewX": (1,), "skewY": (1,)}


@dataclass(frozen=True)
class Run:
    """A subpath: its segments one after the other, and whether it says that it is closed."""

    segments: tuple[Segment, ...]
    closed: bool


def runs(d: str, matrix: Floats | None = None) -> list[Run]:
    """The subpaths of path data under a matrix (3,3) (None: identity), in the units of the drawing.

    VitruvianError that names the place in the data where it cannot be read.
    """
    return _Reader(d, np.eye(3) if matrix is None else matrix).read()


def transform(text: str) -> Floats:
    """(3,3) of a transform attribute: matrix, translate, scale, rotate, skewX, skewY. VitruvianError for others."""
    out, place = np.eye(3), 0
    while place < len(text):
        found = _TRANSFORM.match(text, place)
        if found is None:
            if text[place:].strip(" ,\t\r\n"):
                raise VitruvianError(
                    f"transform: expected matrix(...), translate(...), ..., found {text[place:]!r:.40}"
                )
            break
        name, values = found[1], [float(v) for v in _NUMBER.findall(found[2])]
        if _NUMBER.sub("", found[2]).strip(" ,\t\r\n") or len(values) not in _ARGUMENTS.get(name, ()):
            raise VitruvianError(f"transform: expected one of {', '.join(_ARGUMENTS)}, found {found[0].strip()!r:.60}")
        out = out @ _matrix(name, values)
        if not np.isfinite(out).all() or np.abs(out).max() > LARGEST:
            raise VitruvianError(f"transform: expected numbers up to {LARGEST:g}, found {found[0].strip()!r:.60}")
        place = found.end()
    return out


def _matrix(name: str, v: list[float]) -> Floats:
    if name == "matrix":
        return np.array([[v[0], v[2], v[4]], [v[1], v[3], v[5]], [0, 0, 1.0]])
    if name == "translate":
        return np.array([[1, 0, v[0]], [0, 1, v[1] if len(v) > 1 else 0], [0, 0, 1.0]])
    if name == "scale":
        return np.diag([v[0], v[-1], 1.0])
    turn = np.radians(v[0])
    if name == "skewX":
        return np.array([[1, np.tan(turn), 0], [0, 1, 0], [0, 0, 1.0]])
    if name == "skewY":
        return np.array([[1, 0, 0], [np.tan(turn), 1, 0], [0, 0, 1.0]])
    spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    if len(v) == 1:
        return spin
    return _matrix("translate", v[1:]) @ spin @ _matrix("translate", [-v[1], -v[2]])


def moved(points: Floats, matrix: Floats) -> Floats:
    """Points (k,2) under a matrix (3,3)."""
    return points @ matrix[:2, :2].T + matrix[:2, 2]


class _Reader:
    """Walks along path data; all points are absolute and not yet moved by the matrix."""

    def __init__(self, d: str, matrix: Floats) -> None:
        self.d, self.place, self.matrix = d, 0, matrix
        self.here = self.start = np.zeros(2)
        self.control: tuple[str, Floats] | None = None  # of the last curve: its command and last control point
        self.segments: list[Segment] = []
        self.out: list[Run] = []
        self.count = 0

    def fail(self, expected: str) -> VitruvianError:
        found = self.d[self.place : self.place + 20]
        return VitruvianError(f"path data: expected {expected} at character {self.place}, found {found!r}")

    def skip(self) -> None:
        found = _GAP.match(self.d, self.place)
        self.place = found.end() if found else self.place

    def number(self) -> float:
        self.skip()
        found = _NUMBER.match(self.d, self.place)
        if found is None:
            raise self.fail("a number")
        self.place = found.end()
        self.count += 1
        value = float(found[0])
        if not abs(value) <= LARGEST:
            raise self.fail(f"numbers up to {LARGEST:g} before it")
        if self.count > MOST:
            raise self.fail(f"at most {MOST} numbers")
        return value

    def flag(self) -> bool:
        self.skip()
        found = self.d[self.place : self.place + 1]
        if found not in ("0", "1"):
            raise self.fail("a flag, 0 or 1,")
        self.place += 1
        return found == "1"

    def point(self, relative: bool) -> Floats:
        return np.array([self.number(), self.number()]) + (self.here if relative else 0.0)

    def read(self) -> list[Run]:
        command = ""
        while True:
            self.skip()
            if self.place >= len(self.d):
                break
            letter = self.d[self.place]
            if letter.upper() in _COUNTS and letter.isascii():
                if not command and letter not in "Mm":
                    raise self.fail("M or m")
                command = letter
                self.place += 1
            elif not command or command in "Zz":
                raise self.fail("a command")
            elif command in "Mm":  # more points after a move are lines
                command = "L" if command == "M" else "l"
            self.step(command.upper(), command.islower())
        self.finish(False)
        return self.out

    def finish(self, closed: bool) -> None:
        if self.segments:
            self.out.append(Run(tuple(self.segments), closed))
        self.segments = []

    def step(self, command: str, relative: bool) -> None:
        if command == "Z":
            self.to("line", self.start)
            self.finish(True)
            self.here = self.start
        elif command == "M":
            self.finish(False)
            self.here = self.start = self.point(relative)
        elif command == "L":
            self.to("line", self.point(relative))
        elif command in "HV":
            along = int(command == "V")
            end = self.here.copy()
            end[along] = self.number() + (self.here[along] if relative else 0.0)
            self.to("line", end)
        elif command in "CS":
            first = self.point(relative) if command == "C" else self.smooth("CS")
            second, end = self.point(relative), self.point(relative)
            self.to("cubic", end, first, second)
            self.control = ("C", second)
            return
        elif command in "QT":
            middle = self.point(relative) if command == "Q" else self.smooth("QT")
            self.to("quadratic", self.point(relative), middle)
            self.control = ("Q", middle)
            return
        else:
            radii, turn = np.array([self.number(), self.number()]), self.number()
            large, sweep = self.flag(), self.flag()
            self.arc(np.abs(radii), np.radians(turn), large, sweep, self.point(relative))
        self.control = None

    def smooth(self, kinds: str) -> Floats:
        """The last control point, seen from here on the other side."""
        known = self.control is not None and self.control[0] in kinds
        return 2 * self.here - self.control[1] if known and self.control else self.here

    def to(self, kind: str, end: Floats, *controls: Floats) -> None:
        self.segments.append((kind, moved(np.array([self.here, *controls, end]), self.matrix)))
        self.here = end

    def arc(self, radii: Floats, turn: float, large: bool, sweep: bool, end: Floats) -> None:
        if not radii.all():
            self.to("line", end)
            return
        if not np.abs(end - self.here).max() > 0:
            return
        spin = _matrix("rotate", [float(np.degrees(turn))])[:2, :2]
        a, b = self.here @ spin / radii, end @ spin / radii  # where the ellipse is a circle of radius 1
        way = b - a
        half = float(np.hypot(*way)) / 2
        radii, a, b, half = (radii * half, a / half, b / half, 1.0) if half > 1 else (radii, a, b, half)
        side = np.sqrt(max(1 - half * half, 0.0)) / half if half else 0.0
        across = 0.5 * np.array([-(b - a)[1], (b - a)[0]])
        center = 0.5 * (a + b) + across * side * (1 if large != sweep else -1)
        first = float(np.arctan2(*(a - center)[::-1]))
        last = float(np.arctan2(*(b - center)[::-1]))
        span = (last - first) % (2 * np.pi) if sweep else -((first - last) % (2 * np.pi))

        def at(angle: float) -> Floats:
            return ((center + [np.cos(angle), np.sin(angle)]) * radii) @ spin.T

        m = self.matrix[:2, :2]
        round_ = abs(radii[0] - radii[1]) < 1e-9 * radii.max() and np.allclose(m @ m.T, m[0] @ m[0] * np.eye(2), 1e-9)
        if round_:
            self.to("arc", end, at(first + span / 2))
            return
        count = max(1, int(np.ceil(abs(span) / (np.pi / 8))))
        step = span / count
        reach = 4 / 3 * np.tan(step / 4)
        for k in range(count):
            low, high = first + k * step, first + (k + 1) * step
            one = at(low) + (reach * np.array([-np.sin(low), np.cos(low)]) * radii) @ spin.T
            two = at(high) - (reach * np.array([-np.sin(high), np.cos(high)]) * radii) @ spin.T
            self.to("cubic", end if k == count - 1 else at(high), one, two)
