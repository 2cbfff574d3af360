"""Panels cut from what is drawn: edges split, pieces unfolded about a fold, mirrored for the body's other side.

Source: note cloth.md, sections 2.2 and 2.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vitruvian.body.types import Floats
from vitruvian.cloth.pattern import CHORDS, Edge, Panel, along, area, ends, knots, length, loops
from vitruvian.errors import VitruvianError

ON_FOLD = 5e-5  # metres from the fold's line
TINY = 1e-5  # metres: an edge that is none
SIDES = {"left": "right", "right": "left"}
Segment = tuple[str, Floats]  # kind as in pattern.KINDS, and its points with both ends (k,2)


def panel_of(
    name: str, outlines: Sequence[Sequence[Segment]], names: Sequence[str] = (), *, wind: bool = True
) -> Panel:
    """A panel of closed runs of segments, the outline first, then holes; wound counter-clockwise (`wind`) or as they are.

    Runs are closed by a line where they are not; segments shorter than `TINY` go, curves that are straight become lines.
    names: labels of the outline's segments. VitruvianError for a run of fewer than two edges.
    """
    vertices: list[Floats] = []
    edges: list[Edge] = []
    for k, run in enumerate(outlines):
        labels = list(names) if not k else []
        kept = [(s, labels[i] if i < len(labels) else "") for i, s in enumerate(run) if _extent(s) > TINY]
        if kept and np.hypot(*(kept[-1][0][1][-1] - kept[0][0][1][0])) > TINY:
            kept.append((("line", np.stack([kept[-1][0][1][-1], kept[0][0][1][0]])), ""))
        if len(kept) < 2:
            raise VitruvianError(f"panel {name:.40}: expected a closed outline, found {len(kept)} edges")
        first = len(vertices)
        for i, (segment, said) in enumerate(kept):
            kind, points = _plain(segment)
            vertices.append(points[0])
            end = first + (i + 1) % len(kept)
            edges.append(Edge(first + i, end, kind, points[1:-1], said))
    panel = Panel(name, np.array(vertices), tuple(edges))
    return rewound(panel) if wind and area(panel) < 0 else panel


def _extent(segment: Segment) -> float:
    return float(np.hypot(*(segment[1] - segment[1][0]).T).max())


def _plain(segment: Segment) -> Segment:
    """A Bezier curve whose controls lie on its chord, in their order, is a line."""
    kind, points = segment
    if kind not in ("quadratic", "cubic"):
        return segment
    way = points[-1] - points[0]
    chord = float(np.hypot(*way))
    if chord < TINY:
        return segment
    way = way / chord
    to = points - points[0]
    aside, on = to @ np.array([-way[1], way[0]]), to @ way
    straight = np.abs(aside).max() < 1.5 * TINY and on.min() > -TINY and on.max() < chord + TINY
    return ("line", points[[0, -1]]) if straight else segment


def rewound(panel: Panel) -> Panel:
    """The same piece, its loops gone through the other way: edge k becomes `turned_edge(panel, k)`."""
    edges = list(panel.edges)
    for loop in loops(panel):
        turned = [panel.edges[i] for i in loop[::-1]]
        for i, e in zip(loop, turned):
            edges[i] = replace(e, start=e.end, end=e.start, points=e.points[::-1])
    return replace(panel, edges=tuple(edges))


def turned_edge(panel: Panel, edge: int) -> int:
    """Which edge of a rewound or mirrored panel an edge is; t along it is then 1 - t."""
    loop = next(loop for loop in loops(panel) if edge in loop)
    return loop[len(loop) - 1 - loop.index(edge)]


def mirrored(panel: Panel, name: str) -> Panel:
    """The piece for the body's other side, (-u, v), wound as the piece is; left and right of labels change places.

    It has no place. Edge k becomes `turned_edge(panel, k)`.
    """
    flip = np.array([-1.0, 1.0])
    edges = tuple(replace(e, points=e.points * flip, label=_other(e.label)) for e in panel.edges)
    out = replace(
        panel, name=name, vertices=panel.vertices * flip, edges=edges, grain=panel.grain * flip,
        label=_other(panel.label), rotation=None, translation=None,
    )  # fmt: skip
    return rewound(out)


def _other(label: str) -> str:
    side, _, rest = label.partition("_")
    return f"{SIDES[side]}_{rest}" if side in SIDES and rest else label


def unfolded(panel: Panel, fold: Floats) -> Panel:
    """The whole piece of a half that is cut on the fold, a line through two points (2,2) metres. Edges on the fold go.

    Edges of the half come first, in their order from the fold on, then their mirror images back to it.
    VitruvianError where no edge lies on the fold, or the others are not in one run.
    """
    way = fold[1] - fold[0]
    size = float(np.hypot(*way))
    if size < TINY:
        raise VitruvianError(f"panel {panel.name:.40}: expected a fold between two places, found one")
    across = np.array([-way[1], way[0]]) / size
    aside = (panel.vertices - fold[0]) @ across
    first, *holes = list(loops(panel))
    folded = [e.kind == "line" and max(abs(aside[e.start]), abs(aside[e.end])) < ON_FOLD for e in panel.edges]
    run = [i for i in first if not folded[i]]
    starts = [k for k, i in enumerate(first) if not folded[i] and folded[first[k - 1]]]
    if len(run) == len(first) or len(starts) != 1:
        found = "none" if not starts else f"{len(starts)} runs of other edges between them"
        raise VitruvianError(f"panel {panel.name:.40}: expected one run of edges on the fold, found {found}")
    run = (first[starts[0] :] + first[: starts[0]])[: len(run)]

    def over(points: Floats) -> Floats:
        return points - 2 * np.outer((points - fold[0]) @ across, across)

    vertices = [panel.vertices[panel.edges[i].start] for i in run] + [panel.vertices[panel.edges[run[-1]].end]]
    for k in (0, -1):  # exactly on the fold
        vertices[k] = vertices[k] - ((vertices[k] - fold[0]) @ across) * across
    n = len(run)
    half = [replace(panel.edges[i], start=k, end=k + 1) for k, i in enumerate(run)]
    rest = [
        replace(e, start=n + k, end=(n + k + 1) % (2 * n), points=over(e.points[::-1]), label=_other(e.label))
        for k, e in enumerate(half[::-1])
    ]
    corners = np.concatenate([vertices, over(np.array(vertices))[n - 1 : 0 : -1]])
    edges = [*half, *rest]
    for hole in holes:
        points = np.array([panel.vertices[panel.edges[i].start] for i in hole])
        for turn, place in ((False, points), (True, over(points)[::-1])):
            low = len(corners)
            corners = np.concatenate([corners, place])
            for k, i in enumerate(hole):
                # the mirror image goes through its vertices backwards: its edge k is between those of edge m - 2 - k
                e = panel.edges[hole[(len(hole) - 2 - k) % len(hole)]] if turn else panel.edges[i]
                curve = over(e.points[::-1]) if turn else e.points
                edges.append(replace(e, start=low + k, end=low + (k + 1) % len(hole), points=curve))
    return replace(panel, vertices=corners, edges=tuple(edges))


def split(panel: Panel, edge: int, at: Sequence[float]) -> Panel:
    """The panel with an edge cut at shares `at` of its length; its pieces are curves of the same kind in its stead."""
    a, b = ends(panel, edge)
    rest = panel.edges[edge]
    places = sorted(t for t in at if 0 < t < 1)
    vertices, pieces, done = [*panel.vertices], [], 0.0
    for t in places:
        share = (t - done) / (1 - done)
        (one, two), middle = _divided(rest, a, b, share)
        vertices.append(middle)
        pieces.append(replace(rest, end=len(vertices) - 1, points=one))
        rest, a, done = replace(rest, start=len(vertices) - 1, points=two), middle, t
    edges = (*panel.edges[:edge], *pieces, rest, *panel.edges[edge + 1 :])
    return replace(panel, vertices=np.array(vertices), edges=edges)


def _divided(edge: Edge, a: Floats, b: Floats, share: float) -> tuple[tuple[Floats, Floats], Floats]:
    """Points of both pieces of an edge, and where it is cut."""
    one = Panel("one", np.array([a, b]), (replace(edge, start=0, end=1),))
    if edge.kind in ("line", "arc"):
        quarter, middle, late = along(one, 0, [share / 2, share, (1 + share) / 2])
        none = np.zeros((0, 2))
        return ((quarter[None], late[None]) if edge.kind == "arc" else (none, none)), middle
    control = np.concatenate([a[None], edge.points, b[None]])
    if edge.kind == "polyline":
        steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(control, axis=0).T))])
        inner, middle = steps[1:-1], along(one, 0, share)[0]
        before = inner < share * steps[-1] - 1e-12
        after = inner > share * steps[-1] + 1e-12
        return (edge.points[before], edge.points[after]), middle
    u = _parameter(one, share)
    left, right, row = [control[0]], [control[-1]], control
    while len(row) > 1:  # de Casteljau
        row = (1 - u) * row[:-1] + u * row[1:]
        left.append(row[0])
        right.insert(0, row[-1])
    return (np.array(left[1:-1]), np.array(right[1:-1])), left[-1]


def _parameter(one: Panel, share: float) -> float:
    """The Bezier parameter at a share of the curve's length, by the chords that `length` measures."""
    way = knots(one.edges[0], *ends(one, 0))
    steps = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    return float(np.interp(share * steps[-1], steps, np.linspace(0, 1, CHORDS + 1)))


def nearest(panel: Panel, point: Floats) -> tuple[int, float, float]:
    """The edge next to a point (2,), how far along it (0 to 1), and the metres between."""
    best = (0, 0.0, np.inf)
    for i, e in enumerate(panel.edges):
        corners = np.concatenate([panel.vertices[[e.start, e.end]], e.points])
        box = corners.min(axis=0), corners.max(axis=0)
        reach = 2 * np.ptp(corners) if e.kind == "arc" else 0.0  # which bulges beyond its points
        if np.maximum(np.maximum(box[0] - point, point - box[1]), 0.0).max() - reach > best[2]:
            continue
        low, high = 0.0, 1.0
        for _ in range(4):
            t = np.linspace(low, high, 65)
            apart = np.hypot(*(along(panel, i, t) - point).T)
            k = int(apart.argmin())
            low, high = t[max(k - 1, 0)], t[min(k + 1, 64)]
        if apart[k] < best[2]:
            best = (i, float(t[k]), float(apart[k]))
    return best


def notched(panel: Panel, marks: Sequence[Floats], *, reach: float = 0.012) -> tuple[Panel, list[int], list[int]]:
    """The panel with its edges split at marks (2,), the vertices that stand at them, and which marks those were.

    Marks farther than `reach` metres from any edge are none of its outline; those within 1 mm of a vertex split nothing.
    """
    out, vertices, used = panel, [], []
    for k, mark in enumerate(marks):
        edge, t, apart = nearest(out, mark)
        if apart > reach:
            continue
        e, long = out.edges[edge], length(out, edge)
        if t * long < 1e-3 or (1 - t) * long < 1e-3:
            vertices.append(e.start if t < 0.5 else e.end)
        else:
            out = split(out, edge, [t])
            vertices.append(len(out.vertices) - 1)
        used.append(k)
    return out, vertices, used
