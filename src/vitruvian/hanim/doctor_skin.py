"""The doctor's rules about skin, displacers and the faces of segments."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim import surface
from vitruvian.hanim.animation import event
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_space import rows
from vitruvian.hanim.doctor_words import several, some
from vitruvian.hanim.graph import Node
from vitruvian.hanim.view import walk_groups

WEIGHT_TOLERANCE = 1e-3
_MOST = 4  # influences that glTF and VRM keep


def examine(figure: Figure) -> None:
    """S01 to S09, M04 to M06, D01 to D03."""
    for rule in (_weights, _skin, _displacers):
        rule(figure)


def _weights(figure: Figure) -> None:
    """S01 to S07 and M06."""
    chart, add = figure.chart, figure.chart.add
    count = len(figure.points)
    total, influences = np.zeros(count), np.zeros(count, np.int64)
    any_weight = mentioned = False
    pairs: list[tuple[NDArray[np.int64], Floats]] = []
    for joint in figure.joints:
        index, weight = chart.indices(joint, "skinCoordIndex"), chart.numbers(joint, "skinCoordWeight")
        name = figure.name(joint)
        if len(index) != len(weight):
            message = f"joint {name}: {len(index)} skinCoordIndex but {len(weight)} skinCoordWeight: browsers differ"
            fix = "cut the weights" if len(weight) > len(index) else "give the missing weights"
            add("S01", joint, message, fix)
            n = min(len(index), len(weight))
            if 0 < len(weight) < len(index):
                weight = np.concatenate([weight, np.full(len(index) - len(weight), weight[-1])])
            else:
                index, weight = index[:n], weight[:n]
        mentioned |= bool(len(index))
        outside = (index < 0) | (index >= count)
        if outside.any() and figure.skin_coord is not None:
            first = int(np.argmax(outside))
            message = f"joint {name}: {int(outside.sum())} skinCoordIndex outside 0..{count - 1} (entry {first}"
            add("S02", joint, f"{message} is {index[first]})", "drop those pairs")
        good = np.isfinite(weight)
        bad = good & ((weight < 0) | (weight > 1 + WEIGHT_TOLERANCE))
        if bad.any():
            first = int(np.argmax(bad))
            message = f"joint {name}: weight {weight[first]:g} at entry {first} is outside 0..1: the skin explodes"
            add("S05", joint, message, "clamp it")
        inside = ~outside & good
        index, weight = index[inside], weight[inside]
        if len(np.unique(index)) < len(index):
            what = several(len(index) - len(np.unique(index)), "point", "points")
            message = f"joint {name} names {what} twice: their weights add up"
            add("S06", joint, message, "sum them into one entry")
        any_weight |= bool((weight != 0).any())
        np.add.at(total, index, weight)
        influences[np.unique(index[weight != 0])] += 1
        pairs.append((index, weight))
    if figure.skin_coord is None:
        return
    if not any_weight and figure.joints:
        if not mentioned and figure.baked:
            return
        rule = "S05" if mentioned else "M06"
        message = (
            "all weights are zero: the skin does not follow" if mentioned else "no joint has weights: the skin stays"
        )
        add(rule, figure.node, message, "transfer weights from another body")
        return
    used = _used_points(figure)
    without = np.flatnonzero(influences == 0)
    if without.size:
        drawn = int(used[without].sum())
        message = f"{without.size} of {count} skin points have no weight (first {without[0]}): they stay behind"
        message += f"; faces use {drawn} of them" if drawn else "; no face uses them"
        add("S04", figure.node, message, "give them the weights of their nearest neighbour")
    off = np.flatnonzero((influences > 0) & (np.abs(total - 1) > WEIGHT_TOLERANCE))
    if off.size:
        worst = off[int(np.argmax(np.abs(total[off] - 1)))]
        message = (
            f"weights of {several(off.size, 'point', 'points')} do not sum to 1 (point {worst}: {total[worst]:.4g})"
        )
        add("S03", figure.node, message + ": below 1 sticks to rest, above 1 overshoots", "normalise")
    many = int((influences > _MOST).sum())
    if many:
        message = (
            f"{several(many, 'point has', 'points have')} more than {_MOST} influences: glTF and VRM export prunes them"
        )
        add("S07", figure.node, f"{message}, at most {_dropped(pairs):.3g} of the weight of a point")


def _dropped(pairs: list[tuple[NDArray[np.int64], Floats]]) -> float:
    """The largest sum of weights of a point beyond its four largest."""
    index, weight = (np.concatenate([p[k] for p in pairs]) for k in (0, 1))
    order = np.lexsort((-weight, index))
    index, weight = index[order], weight[order]
    start = np.flatnonzero(np.r_[True, index[1:] != index[:-1]])
    rank = np.arange(len(index)) - np.repeat(start, np.diff(np.r_[start, len(index)]))
    return float(np.bincount(index[rank >= _MOST], weight[rank >= _MOST], minlength=1).max())


def _used_points(figure: Figure) -> np.ndarray:
    """(v,) whether a face of the skin uses the point; all when no face can be read."""
    used = np.zeros(len(figure.points), bool)
    for shape in figure.skin:
        for geometry in shape.children("geometry"):
            index = np.concatenate([figure.chart.indices(geometry, f) for f in ("coordIndex", "index")])
            used[index[(index >= 0) & (index < len(used))]] = True
    return used if used.any() else ~used


def _skin(figure: Figure) -> None:
    """M04, M05, S08, S09."""
    chart, add, node = figure.chart, figure.chart.add, figure.node
    weighted = any(chart.numbers(j, "skinCoordWeight").any() for j in figure.joints)
    geometries = [g for s in figure.skin for g in s.children("geometry")]
    if weighted and not geometries and not _cut_out(figure):
        fix = "put the Shape into skin, with skinCoord USEd in its geometry"
        add("M05", node, "joints have weights but skin is empty: nothing of it is drawn", fix)
    if figure.skin_coord is None and weighted and geometries:
        add("M04", node, "skinCoord is missing: the mesh never deforms", "USE the geometry's Coordinate as skinCoord")
    led = {r.to_node for r in chart.scene.routes() if event(r.to_field) == "point"}
    for geometry in geometries:
        coord = surface.coordinate(geometry)
        if coord is None:
            continue
        points = rows(chart.numbers(coord, "point"))
        strange = figure.skin_coord is not None and coord is not figure.skin_coord
        if strange and weighted and coord.name not in led:  # points of moving clothes have a ROUTE of their own
            same = points.shape == figure.points.shape and np.allclose(points, figure.points, equal_nan=True)
            what = "is a copy of skinCoord" if same else "is another node than skinCoord"
            fix = "USE one Coordinate in both places" if same else "index the skinCoord"
            add("M04", geometry, f"the geometry's Coordinate {what}: the mesh never deforms", fix)
        _faces(chart, geometry)
    normals = node.children("skinNormal")
    if normals:
        count = len(rows(chart.numbers(normals[0], "vector")))
        if count != len(figure.points):
            message = f"skinNormal has {count} vectors for {len(figure.points)} points"
            add("S08", node, message, "leave skinNormal out or recompute it")
    for segment, _ in figure.segments:
        for child in walk_groups(chart.reading, segment.children("children")):
            for geometry in child.children("geometry"):
                _faces(chart, geometry)


class Faces(NamedTuple):
    """What is wrong with the faces of a geometry: `field` with the indices, `first` place of each face's first corner,
    `last` behind its last, `beyond` and `thin` which faces index beyond the `points` or have < 3 different corners.
    """

    field: str
    points: int
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    beyond: NDArray[np.bool_]
    thin: NDArray[np.bool_]


def faces(chart: Chart, geometry: Node) -> Faces | None:
    """The faces of an indexed geometry; None when it has none, or is made of lines or points."""
    coord = surface.coordinate(geometry)
    field = "coordIndex" if geometry.fields.get("coordIndex") is not None else "index"
    index = chart.indices(geometry, field)
    if coord is None or not len(index) or not geometry.type.startswith("Indexed") or "Line" in geometry.type:
        return None
    count = len(rows(chart.numbers(coord, "point")))
    ends = np.zeros(0, np.int64)
    corners = {"IndexedTriangleSet": 3, "IndexedQuadSet": 4}.get(geometry.type)
    if corners:
        first = np.arange(0, len(index), corners)
        last = np.minimum(first + corners, len(index))
    else:
        ends = np.flatnonzero(index == -1)
        first = np.r_[0, ends + 1]
        last = np.r_[ends, len(index)]
        if len(ends) and ends[-1] == len(index) - 1:
            first, last = first[:-1], last[:-1]
    wrong = (index < 0) | (index >= count)
    separators = np.zeros(len(index), bool)
    separators[ends] = True
    wrong &= ~separators
    total = np.r_[0, np.cumsum(wrong)]
    face = np.repeat(np.arange(len(first)), last - first)
    corner = index[~separators][: len(face)]
    order = np.lexsort((corner, face))
    new = np.r_[True, (np.diff(face[order]) != 0) | (np.diff(corner[order]) != 0)][: len(face)]
    distinct = np.bincount(face[order][new], minlength=len(first))
    return Faces(field, count, first, last, total[last] > total[first], distinct < 3)


def _faces(chart: Chart, geometry: Node) -> None:
    """S09 for one geometry."""
    found = faces(chart, geometry)
    if found is None:
        return
    index = chart.indices(geometry, found.field)
    if found.beyond.any():
        wrong = [k for k in range(found.first[found.beyond][0], found.last[found.beyond][0])]
        first = next(k for k in wrong if not 0 <= index[k] < found.points)
        number = int(((index < -1) | (index >= found.points)).sum()) or 1
        what = f"{found.field}: {several(number, 'entry', 'entries')} outside 0..{found.points - 1}"
        message = f"{what} (entry {first}: {index[first]})"
        chart.add("S09", geometry, message, "drop those faces")
    elif found.thin.any():
        message = f"{several(int(found.thin.sum()), 'face', 'faces')} with fewer than three different corners"
        chart.add("S09", geometry, message, "drop those faces")


def _cut_out(figure: Figure) -> bool:
    """Whether the Segments draw the skin: all their points are skin points, whose weights are kept beside them."""
    skin = {p.tobytes() for p in figure.points.reshape(-1, 3).astype(np.float32) + 0.0}
    found = False
    for segment, _ in figure.segments:
        for node in walk_groups(figure.chart.reading, segment.children("children")):
            for geometry in node.children("geometry") if node.type == "Shape" else []:
                coord = surface.coordinate(geometry)
                points = rows(figure.chart.numbers(coord, "point")) if coord is not None else np.zeros((0, 3))
                if any(p.tobytes() not in skin for p in points.astype(np.float32) + 0.0):
                    return False
                found = found or len(points) > 0
    return found


def _displacers(figure: Figure) -> None:
    """D01 to D03."""
    chart, add = figure.chart, figure.chart.add
    driven = {(r.to_node, event(r.to_field)) for r in chart.scene.routes()} if figure.displacers else set()
    silent = []
    for node, owner in figure.displacers:
        index, moves = chart.indices(node, "coordIndex"), chart.numbers(node, "displacements")
        on_joint = chart.reading.kind(owner) == "Joint"
        if on_joint and figure.skin_coord is None:
            add("D02", node, "displacer of a joint without skinCoord has no effect", "give skinCoord")
        limit = displaceable(figure, owner)
        bad = (index < 0) | (index >= limit)
        if bad.any() and (limit or not on_joint):
            first = int(np.argmax(bad))
            what = several(int(bad.sum()), "entry", "entries")
            message = f"coordIndex: {what} outside 0..{limit - 1} (entry {first}: {index[first]})"
            add("D01", node, message, "drop those entries")
        if len(moves) % 3 or (len(moves) and len(moves) // 3 != len(index)):
            message = f"{len(index)} coordIndex but {len(moves) / 3:g} displacements"
            add("D01", node, message, "cut both to the shorter")
        region = not moves.any() and chart.text(node, "name").endswith("_feature")  # moves nothing at any weight
        if not region and not chart.numbers(node, "weight").any() and (node.name, "weight") not in driven:
            silent.append(chart.text(node, "name") or node.name or "(no name)")
    if silent:
        what = several(len(silent), "displacer has", "displacers have")
        message = f"{what} weight 0 and no ROUTE to it ({some(silent)}): never shown by the file alone"
        add("D03", figure.displacers[0][0], message)


def displaceable(figure: Figure, owner: Node) -> int:
    """How many points a displacer of this Joint or Segment can index."""
    if figure.chart.reading.kind(owner) == "Joint":
        return len(figure.points)
    coords = list(owner.children("coord"))
    for child in walk_groups(figure.chart.reading, owner.children("children")):
        coords += [c for g in child.children("geometry") if (c := surface.coordinate(g)) is not None]
    return max((len(rows(figure.chart.numbers(c, "point"))) for c in coords), default=0)
