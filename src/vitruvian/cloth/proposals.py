"""Seams proposed for patterns that carry none: which edges may belong together, how sure that is, and why.

Source: note cloth.md, sections 2.2 to 2.4. Nothing is sewn by this: who reads the proposals takes those that are right.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import Pattern, Seam, Span, area, length, loops
from vitruvian.cloth.sides import Key, Side, sides_of

EXACT, SHARE = 0.003, 0.012  # metres and share of the length by which edges that are sewn together usually differ
NEAR = 0.15  # metres between edges that will be sewn, as their panels hang
WIDEST, STRAIGHT = np.radians(60.0), 1.02  # that a dart opens, and how much longer than straight its legs are
SHORTEST = 0.002  # metres: an edge that is worth a seam
HANGS = ("leg", "skirt")  # labels of panels that have no shoulders
WAIST = 0.3  # metres from the middle within which a waist is
LONG = 0.1  # metres of a side that several are sewn to
MOST = 12  # sides in a row that one side is sewn to
CENTER = 0.35  # metres between the middle sides of two halves before they are sewn
OTHERS = re.compile(r"(?:^|(?<=[^a-z]))(?:mirrored|left|right|l|r)(?=$|[^a-z])")


@dataclass(frozen=True)
class Proposal:
    """A seam that may be meant, how likely (0 to 1), and what speaks for it."""

    seam: Seam
    score: float
    reason: str


def proposals(pattern: Pattern, *, notches: Mapping[Key, int] | None = None, least: float = 0.6) -> list[Proposal]:
    """Seams between edges that none joins yet, the most likely first; no edge is in two of them.

    Edges that go on smoothly count as one where more is found in that way. notches: (panel, edge) -> how many marks it
    carries; edges that differ in that are not paired, nor are sides between notches of different kinds in
    `extra["notches"]`. least: score below which nothing is proposed. Darts are found by their shape; the halves of a piece
    are joined in the middle; a side that is as long as several in a row, joined by what is found before, is sewn to those
    (a waistband to waists, a sleeve's cap to armholes). Where panels have places, edges that hang near to each other count
    for more, and hems and cuffs are left open.
    """
    taken = {(s.panel, s.edge) for seam in pattern.seams for s in (*seam.a, *seam.b)}
    darts = _darts(pattern, taken)
    taken |= {(s.panel, s.edge) for p in darts for s in (*p.seam.a, *p.seam.b)}
    best: list[Proposal] = []
    smooth = sides_of(pattern, taken)
    middle = _middles(smooth)
    # edge by edge, or those that go on smoothly as one: what leaves less unsewn
    for every in (sides_of(pattern, taken, joined=False), smooth):
        found = _paired(pattern, every, middle, darts, notches or {}, least)
        if _worth(pattern, found) > 1.02 * _worth(pattern, best):
            best = found
    return sorted(darts + best, key=lambda p: -p.score)


def _worth(pattern: Pattern, found: list[Proposal]) -> float:
    """Metres of what is sewn, each as far as it is likely."""
    panels = {p.name: p for p in pattern.panels}
    return sum(p.score * length(panels[s.panel], s.edge) for p in found for s in (*p.seam.a, *p.seam.b))


def _paired(
    pattern: Pattern,
    every: list[Side],
    middle: set[Key],
    darts: list[Proposal],
    marks: Mapping[Key, int],
    least: float,
) -> list[Proposal]:
    hangs = any(s.label in HANGS for s in every)
    sides = [s for s in every if s.length >= SHORTEST and not _free(s, hangs)]
    found = []
    for i, a in enumerate(sides):
        for b in sides[:i]:
            score, reason = _judged(a, b, middle, marks)
            if score >= least:
                found.append((score, b.key, a.key, reason))
    of = {s.key: s for s in sides}
    used: set[Key] = set()
    out: list[Proposal] = []
    for score, one, two, reason in sorted(found, key=lambda f: (-f[0], f[1], f[2])):
        if one in used or two in used:
            continue
        used |= {one, two}
        equal = sum((one in f[1:3] or two in f[1:3]) and f[1:3] != (one, two) and f[0] > score - 0.02 for f in found)
        if equal:
            reason += f", but {equal} others fit as well"
            score *= 1 if of[one].points is not None else 1 / (1 + equal)
        if score < least:
            continue
        out.append(Proposal(Seam(of[one].spans(), of[two].spans()), score, reason))
    rest = [s for s in sides if s.key not in used]
    return out + _rows(pattern, rest, [p.seam for p in darts + out], least)


def _free(side: Side, hangs: bool) -> bool:
    """A hem, a cuff or the edge that the garment hangs by. hangs: legs or a skirt hang on something."""
    if side.edge_label == "lower_interface":
        return True
    if side.normal is None or side.points is None or (hangs and side.label == "body"):
        return False
    aside = float(np.sign(side.points[4, 0]) * side.normal[0])
    return bool(side.normal[1] < -0.45 and aside > -0.45 and side.label != "") and side.length > 0.05


def _piece(name: str) -> str:
    """A name without the body's side."""
    return OTHERS.sub("", name.lower()).strip("_- .")


def _twins(a: Side, b: Side) -> bool:
    return a.panel != b.panel and _piece(a.panel) == _piece(b.panel)


def _middles(sides: list[Side]) -> set[Key]:
    """Of each half of a piece that has its twin the edges that are in the middle of the body: of the sides that look there
    the one that is nearest to it; of legs and skirts the uppermost, as inseams and vents look there too."""
    best: dict[str, tuple[float, Side]] = {}
    pieces = [_piece(n) for n in {s.panel for s in sides}]
    for s in sides:
        if s.points is None or s.normal is None or not s.flat or pieces.count(_piece(s.panel)) != 2:
            continue
        x = float(np.mean([r.points[:, 0].mean() for r in sides if r.panel == s.panel and r.points is not None]))
        near = float(np.abs(s.points[:, 0]).min()) < 0.06
        if near and s.normal[0] * np.sign(x) < -0.5 and s.length > 0.05:
            fit = float(s.points[:, 1].max()) if s.label in HANGS else -float(np.abs(s.points[:, 0]).mean())
            if s.panel not in best or fit > best[s.panel][0]:
                best[s.panel] = (fit, s)
    return {(s.panel, e) for _, s in best.values() for e in s.edges}


def _judged(a: Side, b: Side, middle: set[Key], marks: Mapping[Key, int]) -> tuple[float, str]:
    """How likely two sides are sewn to each other, and why."""
    count = marks.get(a.key, 0)
    if count != marks.get(b.key, 0) or a.notches != b.notches[::-1]:
        return 0.0, ""
    if a.panel == b.panel:
        return _round(a, b)
    twins, both = _twins(a, b), (a.key in middle) + (b.key in middle)
    if twins and not (a.flat and b.flat):
        return 0.0, ""  # one for each arm
    if _waist(a) and _waist(b):
        return 0.0, ""
    if a.points is not None and b.points is not None and a.flat and b.flat:
        if both == 1 or (both == 2 and not twins):
            return 0.0, ""
        if twins and both == 2:
            return _halves(a, b)
        if twins:
            return 0.0, ""  # two fronts meet in the middle or not at all
    return _likely(a, b, count)


def _waist(side: Side) -> bool:
    """The upper edge of what has no shoulders: not the side of a skirt that is cut as a ring."""
    if side.label not in HANGS or side.normal is None or side.points is None:
        return False
    return bool(side.normal[1] > 0.7 and np.abs(side.points[:, 0]).max() < WAIST)


def _alike(a: Side, b: Side) -> tuple[float, float, str]:
    """How alike the lengths and the bends of two sides are, in words too."""
    same = _same(a.length, b.length)
    shape = float(np.exp(-((abs(a.straight - b.straight) / 0.06) ** 2)))
    return same, shape, f"lengths {100 * a.length:.1f} and {100 * b.length:.1f} cm"


def _same(a: float, b: float) -> float:
    return float(np.exp(-((abs(a - b) / (EXACT + SHARE * max(a, b))) ** 2)))


def _likely(a: Side, b: Side, marks: int) -> tuple[float, str]:
    same, shape, reason = _alike(a, b)
    if marks or any(a.notches):
        reason += f", {marks or sum(map(bool, a.notches))} notches on both"
    if a.points is None or b.points is None:
        return 0.8 * same + 0.2 * shape, reason
    apart = _apart(a.points, b.points, a.flat and b.flat)
    near = float(np.exp(-((apart / NEAR) ** 2)))
    if any(a.notches):  # what is marked alike may hang farther apart
        near = max(near, float(np.exp(-((apart / (3 * NEAR)) ** 2))))
    return 0.4 * same + 0.5 * near + 0.1 * shape, f"{reason}, {100 * apart:.0f} cm apart"


def _apart(a: Floats, b: Floats, flat: bool) -> float:
    """Metres between two sides that run against each other; panels before and behind as they are seen from the front."""
    gap = a - b[::-1]
    return float(np.mean(np.linalg.norm(gap[:, :2] if flat else gap, axis=1)))


def _halves(a: Side, b: Side) -> tuple[float, str]:
    """The middle sides of two halves: they may be an opening as well."""
    same, shape, reason = _alike(a, b)
    assert a.points is not None and b.points is not None
    gap = (a.points - b.points[::-1])[:, :2]
    if abs(gap[:, 0].mean()) > CENTER or float(np.abs(gap[:, 1]).mean()) > 0.05:
        return 0.0, ""
    return 0.93 * (0.8 * same + 0.2 * shape), f"{reason}, the middle of two halves, if it is no opening"


def _round(a: Side, b: Side) -> tuple[float, str]:
    """Both ends of a piece that goes all around a limb or the body."""
    if a.points is None or b.points is None or a.normal is None or b.normal is None or a.flat:
        return 0.0, ""
    same, shape, reason = _alike(a, b)
    apart = _apart(a.points, b.points, False)
    near = float(np.exp(-((apart / NEAR) ** 2)))
    if min(a.straight, b.straight) < 0.95 or float(a.normal @ b.normal) > -0.5:
        return 0.0, ""
    return 0.4 * same + 0.5 * near + 0.1 * shape, f"{reason}, both ends of one piece, {100 * apart:.0f} cm apart"


def _rows(pattern: Pattern, sides: list[Side], seams: list[Seam], least: float) -> list[Proposal]:
    """Sides that are as long as several others in a row."""
    corner = _corners(pattern, [*pattern.seams, *seams])
    out: list[Proposal] = []
    left = sorted((s for s in sides if s.points is not None), key=lambda s: -s.length)
    while left:
        found = max((_row(s, left, corner) for s in left), key=lambda f: f[0], default=(0.0, "", None, []))
        score, reason, long, row = found
        if score < least or long is None:
            break
        out.append(Proposal(Seam(long.spans(), tuple(x for s in row for x in s.spans())), score, reason))
        left = [s for s in left if s is not long and s not in row]
    return out


def _row(long: Side, sides: list[Side], corner: Mapping[Key, int]) -> tuple[float, str, Side | None, list[Side]]:
    best: tuple[float, str, Side | None, list[Side]] = (0.0, "", None, [])
    starts: dict[int, list[Side]] = {}
    for s in sides:
        if _may_follow(long, s):
            starts.setdefault(corner[s.panel, s.edges[0]], []).append(s)
    for s in sides:
        if not _may_follow(long, s):
            continue
        row, total = [s], s.length
        limit = long.length + 2 * (EXACT + SHARE * long.length)
        while total < long.length - 2 * (EXACT + SHARE * long.length) and len(row) < MOST:
            end = corner[row[-1].panel, -1 - row[-1].edges[-1]]
            after = [x for x in starts.get(end, []) if x not in row and total + x.length < limit]
            if not after:
                break
            row.append(after[0])
            total += after[0].length
        if len(row) < 2:
            continue
        same = _same(total, long.length)
        points = _resampled(row)
        if long.points is None or points is None or same < 0.3:
            continue
        apart = _apart(long.points, points, all(x.flat for x in (long, *row)))
        near = float(np.exp(-((apart / (2 * NEAR)) ** 2)))
        marked = (row[0].notches[0], row[-1].notches[1])
        score = 0.45 * same + 0.55 * near if marked == long.notches[::-1] else 0.0
        if score > best[0]:
            said = f"{100 * long.length:.1f} cm are as long as {len(row)} sides in a row, {100 * apart:.0f} cm apart"
            best = (score, said, long, row)
    return best


def _may_follow(long: Side, short: Side) -> bool:
    own = short.panel == long.panel or _twins(short, long) or (_waist(short) and _waist(long))
    return not own and long.length > LONG


def _resampled(row: list[Side]) -> Floats | None:
    """Nine points along sides in a row."""
    if any(s.points is None for s in row):
        return None
    sizes = np.array([s.length for s in row])
    ends = np.concatenate([[0.0], np.cumsum(sizes)]) / sizes.sum()
    at = np.linspace(0, 1, 9)
    which = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, len(row) - 1)
    out = []
    for k, t in zip(which, at):
        own = (t - ends[k]) / (ends[k + 1] - ends[k]) * 8
        points = row[k].points
        assert points is not None
        out.append([np.interp(own, np.arange(9), points[:, c]) for c in range(3)])
    return np.array(out)


def _corners(pattern: Pattern, seams: list[Seam]) -> dict[Key, int]:
    """For each edge, (panel, edge) -> the corner at which it starts, and (panel, -1 - edge) -> that at which it ends, as
    seams that are known join them."""
    number: dict[Key, int] = {}
    for p in pattern.panels:
        for i, e in enumerate(p.edges):
            number[p.name, i] = number.setdefault((f"{p.name}\0", e.start), len(number))
            number[p.name, -1 - i] = number.setdefault((f"{p.name}\0", e.end), len(number))
    parent = {n: n for n in number.values()}

    def root(n: int) -> int:
        while parent[n] != n:
            n = parent[n]
        return n

    def ends(side: tuple[Span, ...]) -> tuple[int, int]:
        return number[side[0].panel, side[0].edge], number[side[-1].panel, -1 - side[-1].edge]

    for seam in seams:
        a, b = ends(seam.a), ends(seam.b)
        for x, y in zip(a, b[::-1] if seam.reversed else b):
            parent[root(x)] = root(y)
    return {key: root(n) for key, n in number.items() if not key[0].endswith("\0")}


def _darts(pattern: Pattern, taken: set[Key]) -> list[Proposal]:
    """Two straight edges of one length that cut a narrow wedge out of a panel."""
    out = []
    for panel in pattern.panels:
        turn = np.sign(area(panel))
        for loop in loops(panel):
            for one, two in zip(loop, [*loop[1:], loop[0]]):
                a, b = panel.edges[one], panel.edges[two]
                if (panel.name, one) in taken or (panel.name, two) in taken or a.end != b.start:
                    continue
                u = panel.vertices[a.start] - panel.vertices[a.end]
                v = panel.vertices[b.end] - panel.vertices[b.start]
                la, lb = float(np.hypot(*u)), float(np.hypot(*v))
                opens = float(np.arctan2(u[0] * v[1] - u[1] * v[0], u @ v)) * turn
                legs = [length(panel, i) for i in (one, two)]
                bowed = legs[0] > STRAIGHT * la or legs[1] > STRAIGHT * lb
                if not 0 < opens < WIDEST or bowed or abs(la - lb) > EXACT + SHARE * max(la, lb):
                    continue
                seam = Seam((Span(panel.name, one),), (Span(panel.name, two),), kind="dart")
                score = 0.98 - 0.3 * opens / WIDEST
                said = f"a wedge of {np.degrees(opens):.0f} degrees with legs of {100 * la:.1f} and {100 * lb:.1f} cm"
                out.append(Proposal(seam, score, said))
                taken = taken | {(panel.name, one), (panel.name, two)}
    return out
