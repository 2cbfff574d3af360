"""The pattern doctor: what is wrong with a pattern, found before anything is sewn.

Source: note cloth.md, section 2.5.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Panel, Pattern, Seam, Span, area, ends, length, loops, outline, placed

ERROR, WARNING, NOTE = "error", "warning", "note"
RULES = {
    "P01": "the edges of a panel chain into closed outlines",
    "P02": "a panel has an area",
    "P03": "an outline does not touch or cross itself",
    "P04": "a seam names panels and edges that are there",
    "P05": "a seam joins two different pieces of edges",
    "P06": "no piece of an edge is sewn twice",
    "P07": "the sides of a seam are about as long as each other, or it is a gather",
    "P08": "seams turn no part of the garment inside out against the rest",
    "P09": "every panel is sewn to something",
    "P10": "all panels are sewn into one piece",
    "P11": "edges are longer than what is cut",
    "P12": "corners are not needles",
    "P13": "both sides of a seam are labelled alike",
    "P14": "no two panels are the same piece in the same place",
    "P15": "a panel has a place near to the body",
}
RATIO, GATHER = 1.25, 1.5  # between the sides of a seam: a warning, and what only a gather has
SHORT, SHARP = 0.003, np.radians(10.0)  # metres, radians
FAR = 3.0  # metres from the origin between the feet
STEP = 0.003  # metres between the points with which outlines are tried
ALIKE = 1e-4  # metres


@dataclass(frozen=True)
class Finding:
    """What is wrong by which of `RULES`, where (panel and edge, "" and -1 for the whole), and what to do."""

    rule: str
    severity: str
    message: str
    panel: str = ""
    edge: int = -1


def examined(pattern: Pattern) -> list[Finding]:
    """All findings, errors first."""
    found = [f for p in pattern.panels for f in _panel(p)]
    found += _seams(pattern)
    found += _whole(pattern)
    rank = {ERROR: 0, WARNING: 1, NOTE: 2}
    return sorted(found, key=lambda f: (rank[f.severity], f.rule))


def _panel(panel: Panel) -> Iterator[Finding]:
    name = panel.name
    broken = False
    for loop in loops(panel):
        if panel.edges[loop[-1]].end != panel.edges[loop[0]].start:
            broken = True
            said = f"its outline is open after edge {loop[-1]}: join it to the start of edge {loop[0]}"
            yield Finding("P01", ERROR, said, name, loop[-1])
    if not panel.edges:
        broken = True
        yield Finding("P01", ERROR, "it has no edges", name)
    for i in range(len(panel.edges)):
        if length(panel, i) < SHORT:
            said = f"only {1000 * length(panel, i):.2f} mm long: merge it with its neighbour"
            yield Finding("P11", WARNING, said, name, i)
    if broken:
        return
    size = abs(area(panel))
    if size < 1e-6:
        yield Finding("P02", ERROR, f"its area is {1e4 * size:.4f} cm2: draw an outline with an inside", name)
        return
    crossing = _crossing(panel)
    if crossing is not None:
        one, two, (u, v) = crossing
        said = f"crosses or touches edge {two} near ({100 * u:.1f}, {100 * v:.1f}) cm: move a corner or control"
        yield Finding("P03", ERROR, said, name, one)
    yield from _corners(panel)
    if panel.rotation is None or panel.translation is None:
        yield Finding("P15", NOTE, "no place around the body: it is found from its name and label", name)
    else:
        far = float(np.linalg.norm(placed(panel, panel.vertices), axis=1).max(initial=0))
        if far > FAR:
            said = f"placed {far:.1f} m from the body's feet: is the pattern's unit right?"
            yield Finding("P15", WARNING, said, name)


def _crossing(panel: Panel) -> tuple[int, int, Floats] | None:
    """Two edges that meet other than at their common corner, and where."""
    points: list[Floats] = []
    owner: list[int] = []
    after: list[int] = []
    for loop in loops(panel):
        first = len(owner)
        for i in loop:
            own = outline(panel, [i], STEP)
            points.append(own)
            owner += [i] * len(own)
        after += [*range(first + 1, len(owner)), first]  # the last point of a loop goes on to its first
    a = np.concatenate(points)
    following, owner_of = np.array(after), np.array(owner)
    b = a[following]
    for i in range(len(a) - 1):
        others = np.arange(i + 1, len(a))
        others = others[(following[others] != i) & (following[i] != others)]
        hit = others[_meet(a[i], b[i], a[others], b[others])]
        if len(hit):
            return int(owner_of[i]), int(owner_of[hit[0]]), 0.5 * (a[i] + b[i])
    return None


def _meet(a: Floats, b: Floats, c: Floats, d: Floats) -> np.ndarray:
    """(k,) whether segment a b meets the segments c d (k,2)."""

    def side(p: Floats, q: Floats, r: Floats) -> Floats:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    one, two, three, four = side(a, b, c), side(a, b, d), side(c, d, a), side(c, d, b)
    return (one * two < 0) & (three * four < 0)


def _corners(panel: Panel) -> Iterator[Finding]:
    for loop in loops(panel):
        for before, i in zip([loop[-1], *loop[:-1]], loop):
            one, two = outline(panel, [before], STEP), outline(panel, [i], STEP)
            here = ends(panel, i)[0]
            back = one[-1] - here
            on = (two[1] if len(two) > 1 else ends(panel, i)[1]) - here
            wide = np.arctan2(*back[::-1]) - np.arctan2(*on[::-1])  # inside: the tip of a dart is nearly all round
            angle = float(wide if area(panel) > 0 else -wide) % (2 * np.pi)
            if angle < SHARP and np.hypot(*back) > 0 and np.hypot(*on) > 0:
                said = f"its first corner has only {np.degrees(angle):.0f} degrees: cloth bunches there"
                yield Finding("P12", WARNING, said, panel.name, i)


def _seams(pattern: Pattern) -> Iterator[Finding]:
    panels = {p.name: p for p in pattern.panels}
    used: dict[tuple[str, int], list[tuple[float, float, int]]] = {}
    for k, seam in enumerate(pattern.seams):
        spans = [*seam.a, *seam.b]
        missing = [s for s in spans if s.panel not in panels or not 0 <= s.edge < len(panels[s.panel].edges)]
        if missing:
            said = f"seam {k} names it, but it is not there: give the panel's name and an edge from 0 on"
            yield Finding("P04", ERROR, said, missing[0].panel, missing[0].edge)
            continue
        if any(_overlap(s, t) for s in seam.a for t in seam.b):
            yield Finding("P05", ERROR, f"seam {k} sews it to itself", spans[0].panel, spans[0].edge)
            continue
        for s in spans:
            taken = used.setdefault((s.panel, s.edge), [])
            twice = [j for low, high, j in taken if min(high, s.t1) - max(low, s.t0) > 1e-6]
            if twice and "pleat" not in (seam.kind, pattern.seams[twice[0]].kind):
                said = f"seams {twice[0]} and {k} both sew it: three pieces would meet in one line"
                yield Finding("P06", ERROR, said, s.panel, s.edge)
            taken.append((s.t0, s.t1, k))
        yield from _sides(k, seam, panels)


def _overlap(one: Span, two: Span) -> bool:
    same = (one.panel, one.edge) == (two.panel, two.edge)
    return same and min(one.t1, two.t1) - max(one.t0, two.t0) > 1e-6


def _sides(k: int, seam: Seam, panels: dict[str, Panel]) -> Iterator[Finding]:
    a, b = (sum(length(panels[s.panel], s.edge) * (s.t1 - s.t0) for s in side) for side in (seam.a, seam.b))
    ratio = max(a, b) / max(min(a, b), 1e-9)
    first = seam.a[0]
    limit = {"gather": np.inf, "ease": GATHER}.get(seam.kind, RATIO)
    if ratio > limit:
        kind = "a gather" if ratio > GATHER else "an ease"
        said = f"seam {k}: {100 * a:.1f} cm are sewn to {100 * b:.1f} cm; if that is meant, call it {kind}"
        yield Finding("P07", WARNING, said, first.panel, first.edge)
    labels = {panels[s.panel].edges[s.edge].label for s in (*seam.a, *seam.b)} - {""}
    labels = {label for label in labels if ".." not in label}  # the names of its ends are not what it is for
    if len(labels) > 1:
        said = f"seam {k} joins edges labelled {' and '.join(sorted(labels))}"
        yield Finding("P13", WARNING, said, first.panel, first.edge)


def _whole(pattern: Pattern) -> Iterator[Finding]:
    names = [p.name for p in pattern.panels]
    parent, flipped = {n: n for n in names}, dict.fromkeys(names, False)

    def root(n: str) -> tuple[str, bool]:
        odd = False
        while parent[n] != n:
            odd ^= flipped[n]
            n = parent[n]
        return n, odd

    sewn: set[str] = set()
    for k, seam in enumerate(pattern.seams):
        spans = [s for s in (*seam.a, *seam.b) if s.panel in parent]
        if len(spans) < len(seam.a) + len(seam.b):
            continue
        sewn |= {s.panel for s in spans}
        for s in spans[1:]:
            (one, x), (two, y) = root(spans[0].panel), root(s.panel)
            turned = not seam.reversed and s in seam.b
            if one != two:
                parent[two], flipped[two] = one, x ^ y ^ turned
            elif x ^ y ^ turned:
                said = f"seam {k} joins the outside to the inside: turn it round (right_wrong)"
                yield Finding("P08", ERROR, said, s.panel, s.edge)
    alone = [n for n in names if n not in sewn] if len(names) > 1 else []
    for n in alone:
        yield Finding("P09", WARNING, "no seam reaches it: it will fall off", n)
    pieces = len({root(n)[0] for n in names}) - len(alone)
    if pieces > 1:
        yield Finding("P10", WARNING, f"the seams make {pieces} separate garments")
    for i, p in enumerate(pattern.panels):
        for q in pattern.panels[:i]:
            if len(p.vertices) == len(q.vertices) and np.abs(p.vertices - q.vertices).max() < ALIKE and _here(p, q):
                yield Finding("P14", WARNING, f"the same piece as panel {q.name}, in the same place", p.name)


def _here(p: Panel, q: Panel) -> bool:
    if p.rotation is None or q.rotation is None or p.translation is None or q.translation is None:
        return False
    return bool(np.abs(p.translation - q.translation).max() < ALIKE and np.abs(p.rotation - q.rotation).max() < ALIKE)
