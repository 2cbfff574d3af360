"""Sides of panels as sewing sees them: edges that run on smoothly, from one corner or notch to the next.

Source: note cloth.md, sections 2.2 to 2.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Panel, Pattern, Span, along, area, length, loops, placed

SMOOTH = np.radians(4.0)  # an edge goes on in the next one where it turns less
SAMPLES = np.linspace(0.0, 1.0, 9)
FLAT = 0.7  # of a panel's outward normal that points forwards or backwards, where it stands in front or behind
Key = tuple[str, int]


@dataclass(frozen=True, eq=False)
class Side:
    """Edges of a panel that follow each other: metres along them, how straight they are, the notches ("": none) at their
    start and end, and in the world nine points along them and their middle normal, out of the panel; None where the panel
    has no place.

    flat: the panel stands before or behind the body. label: the panel's, edge_label: that of the edges.
    """

    panel: str
    edges: tuple[int, ...]
    label: str
    edge_label: str
    length: float
    straight: float
    notches: tuple[str, str]
    points: Floats | None
    normal: Floats | None
    flat: bool

    @property
    def key(self) -> Key:
        """What it is called by: its panel and first edge."""
        return self.panel, self.edges[0]

    def spans(self) -> tuple[Span, ...]:
        """The side as a seam wants it."""
        return tuple(Span(self.panel, e) for e in self.edges)


def sides_of(pattern: Pattern, taken: set[Key], *, joined: bool = True) -> list[Side]:
    """All sides of edges that are not taken; joined: those that go on smoothly are one."""
    marks = notches_of(pattern)
    return [_side(p, run, marks) for p in pattern.panels for run in _runs(p, taken, marks, joined)]


def notches_of(pattern: Pattern) -> dict[Key, str]:
    """(panel, edge) -> the notch at which it starts, as readers leave it in `extra`."""
    rows = pattern.extra.get("notches", [])
    good = [r for r in rows if isinstance(r, list | tuple) and len(r) == 3] if isinstance(rows, list | tuple) else []
    return {(str(r[0]), int(r[1])): str(r[2]) for r in good}


def _runs(panel: Panel, taken: set[Key], marks: Mapping[Key, str], joined: bool) -> list[tuple[int, ...]]:
    out: list[tuple[int, ...]] = []
    for loop in loops(panel):
        free = [(panel.name, i) not in taken for i in loop]
        on = [
            joined
            and free[k]
            and free[k - 1]
            and _goes_on(panel, loop[k - 1], loop[k])
            and (panel.name, loop[k]) not in marks
            for k in range(len(loop))
        ]  # whether edge k goes on from the one before
        first = next((k for k in range(len(loop)) if not on[k]), 0)
        run: list[int] = []
        for k in [*range(first, len(loop)), *range(first)]:
            if run and not on[k]:
                out.append(tuple(run))
                run = []
            if free[k]:
                run.append(loop[k])
        if run:
            out.append(tuple(run))
    return out


def _goes_on(panel: Panel, one: int, two: int) -> bool:
    labels = [panel.edges[i].label for i in (one, two)]
    if [label if ".." not in label else "" for label in labels][0] != (labels[1] if ".." not in labels[1] else ""):
        return False
    a, b = along(panel, one, [0.98, 1.0]), along(panel, two, [0.0, 0.02])
    u, v = a[1] - a[0], b[1] - b[0]
    turn = np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v)
    curved = panel.edges[one].kind != "line" or panel.edges[two].kind != "line"
    return bool(abs(turn) < (SMOOTH if curved else 1e-3))


def along_side(panel: Panel, edges: Sequence[int], shares: Floats) -> Floats:
    """(k,2) metres: points at shares of the length of edges that follow each other."""
    sizes = np.array([length(panel, i) for i in edges])
    ends = np.concatenate([[0.0], np.cumsum(sizes)])
    at = np.asarray(shares) * ends[-1]
    which = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(edges) - 1)
    return np.array([along(panel, edges[k], (d - ends[k]) / max(sizes[k], 1e-12))[0] for k, d in zip(which, at)])


def _side(panel: Panel, run: tuple[int, ...], marks: Mapping[Key, str]) -> Side:
    flat = along_side(panel, run, SAMPLES)
    long = sum(length(panel, i) for i in run)
    chord = float(np.hypot(*(flat[-1] - flat[0])))
    points = normal = None
    stands = True
    if panel.rotation is not None and panel.translation is not None:
        way = flat[6] - flat[2]
        out = np.array([way[1], -way[0]]) * np.sign(area(panel))
        normal = panel.rotation[:, :2] @ out / max(float(np.hypot(*out)), 1e-12)
        points = placed(panel, flat)
        stands = abs(float(panel.rotation[2, 2])) > FLAT and not np.any(panel.bend)
    label = next((panel.edges[i].label for i in run if ".." not in panel.edges[i].label), "")
    loop = next(loop for loop in loops(panel) if run[0] in loop)
    after = loop[(loop.index(run[-1]) + 1) % len(loop)]
    kinds = marks.get((panel.name, run[0]), ""), marks.get((panel.name, after), "")
    straight = chord / max(long, 1e-12)
    return Side(panel.name, run, panel.label, label, long, straight, kinds, points, normal, stands)
