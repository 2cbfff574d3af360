"""Seams proposed for patterns that carry none: which edges may belong together, how sure that is, and why.

Source: note cloth.md, sections 2.2 to 2.4. Nothing is sewn by this: who reads the proposals takes those that are right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Panel, Pattern, Seam, Span, along, area, length, loops, placed

EXACT, SHARE = 0.003, 0.012  # metres and share of the length by which edges that are sewn together usually differ
NEAR = 0.15  # metres between edges that will be sewn, as their panels hang
WIDEST = np.radians(60.0)  # that a dart opens
SHORTEST = 0.002  # metres: an edge that is worth a seam
SAMPLES = np.array([0.0, 0.25, 0.5, 0.75, 1.0])
Key = tuple[str, int]


@dataclass(frozen=True)
class Proposal:
    """A seam that may be meant, how likely (0 to 1), and what speaks for it."""

    seam: Seam
    score: float
    reason: str


@dataclass(frozen=True, eq=False)
class _Side:
    """An edge: its panel, metres along it, how straight it is, and in the world five points along it and its middle
    normal, out of the panel; None where the panel has no place."""

    key: Key
    label: str
    edge_label: str
    length: float
    straight: float
    points: Floats | None
    normal: Floats | None


def proposals(pattern: Pattern, *, notches: Mapping[Key, int] | None = None, least: float = 0.6) -> list[Proposal]:
    """Seams between edges that none joins yet, the most likely first; no edge is in two of them.

    notches: (panel, edge) -> how many marks it carries; edges that differ in that are not paired. least: score below
    which nothing is proposed. Darts are found by their shape. Where panels have places, edges that hang near to each
    other count for more, and hems and cuffs, which look like side seams, are left open.
    """
    taken = {(s.panel, s.edge) for seam in pattern.seams for s in (*seam.a, *seam.b)}
    out = _darts(pattern, taken)
    taken |= {(s.panel, s.edge) for p in out for s in (*p.seam.a, *p.seam.b)}
    sides = [_side(p, i) for p in pattern.panels for i in range(len(p.edges)) if (p.name, i) not in taken]
    sides = [s for s in sides if s.length >= SHORTEST and not _free(s)]
    marks = notches or {}
    found = []
    for i, a in enumerate(sides):
        for b in sides[:i]:
            if a.key[0] == b.key[0] or marks.get(a.key, 0) != marks.get(b.key, 0):
                continue
            score, reason = _likely(a, b, marks.get(a.key, 0))
            if score >= least:
                found.append((score, b.key, a.key, reason))
    used: set[Key] = set()
    for score, one, two, reason in sorted(found, key=lambda f: (-f[0], f[1], f[2])):
        if one in used or two in used:
            continue
        used |= {one, two}
        equal = sum((one in f[1:3] or two in f[1:3]) and f[1:3] != (one, two) and f[0] > score - 0.02 for f in found)
        if equal:
            reason += f", but {equal} others fit as well"
            score *= 1 if _hangs(pattern, one) else 1 / (1 + equal)
        if score < least:
            continue
        out.append(Proposal(Seam((Span(*one),), (Span(*two),)), score, reason))
    return sorted(out, key=lambda p: -p.score)


def _hangs(pattern: Pattern, key: Key) -> bool:
    panel = pattern.panel(key[0])
    return panel.rotation is not None and panel.translation is not None


def _side(panel: Panel, edge: int) -> _Side:
    flat = along(panel, edge, SAMPLES)
    long = length(panel, edge)
    chord = float(np.hypot(*(flat[-1] - flat[0])))
    points = normal = None
    if panel.rotation is not None and panel.translation is not None:
        way = flat[3] - flat[1]
        out = np.array([way[1], -way[0]]) * np.sign(area(panel))
        normal = panel.rotation[:, :2] @ out / max(float(np.hypot(*out)), 1e-12)
        points = placed(panel, flat)
    label = panel.edges[edge].label
    return _Side((panel.name, edge), panel.label, label, long, chord / max(long, 1e-12), points, normal)


def _free(side: _Side) -> bool:
    """A hem, a cuff or the edge that the garment hangs by."""
    if side.edge_label == "lower_interface":
        return True
    if side.normal is None or side.points is None:
        return False
    aside = float(np.sign(side.points[2, 0]) * side.normal[0])
    return bool(side.normal[1] < -0.55 and aside > -0.45 and side.label != "") and side.length > 0.05


def _likely(a: _Side, b: _Side, marks: int) -> tuple[float, str]:
    differ = abs(a.length - b.length)
    same = float(np.exp(-((differ / (EXACT + SHARE * max(a.length, b.length))) ** 2)))
    shape = float(np.exp(-((abs(a.straight - b.straight) / 0.06) ** 2)))
    reason = f"lengths {100 * a.length:.1f} and {100 * b.length:.1f} cm"
    if marks:
        reason += f", {marks} notches on both"
    if a.points is None or b.points is None:
        return 0.8 * same + 0.2 * shape, reason
    gap = (a.points - b.points[::-1])[:, :2]  # front and back hang apart: as they are seen from the front
    apart = float(np.mean(np.hypot(*gap.T)))
    near = float(np.exp(-((apart / NEAR) ** 2)))
    return 0.4 * same + 0.5 * near + 0.1 * shape, f"{reason}, {100 * apart:.0f} cm apart"


def _darts(pattern: Pattern, taken: set[Key]) -> list[Proposal]:
    """Two straight edges of one length that cut a narrow wedge out of a panel."""
    out = []
    for panel in pattern.panels:
        turn = np.sign(area(panel))
        for loop in loops(panel):
            for one, two in zip(loop, [*loop[1:], loop[0]]):
                a, b = panel.edges[one], panel.edges[two]
                if (panel.name, one) in taken or (panel.name, two) in taken or a.kind != "line" or b.kind != "line":
                    continue
                u = panel.vertices[a.start] - panel.vertices[a.end]
                v = panel.vertices[b.end] - panel.vertices[b.start]
                la, lb = float(np.hypot(*u)), float(np.hypot(*v))
                opens = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v)) * turn
                if not 0 < opens < WIDEST or abs(la - lb) > EXACT + SHARE * max(la, lb):
                    continue
                seam = Seam((Span(panel.name, one),), (Span(panel.name, two),), kind="dart")
                score = 0.98 - 0.3 * opens / WIDEST
                said = f"a wedge of {np.degrees(opens):.0f} degrees with legs of {100 * la:.1f} and {100 * lb:.1f} cm"
                out.append(Proposal(seam, score, said))
                taken = taken | {(panel.name, one), (panel.name, two)}
    return out
