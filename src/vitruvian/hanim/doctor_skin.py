"""The doctor's rules about skin, displacers and the faces of segments."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from vitruvian.hanim import surface
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.graph import Node
from vitruvian.hanim.view import walk_groups

_WEIGHT_TOLERANCE = 1e-3


def examine(figure: Figure) -> None:
    """S01 to S09, M04 to M06, D01, D02."""
    for rule in (_weights, _skin, _displacers):
        rule(figure)


def _weights(figure: Figure) -> None:
    """S01 to S07 and M06."""
    chart, add = figure.chart, figure.chart.add
    count = len(figure.points)
    total, influences = np.zeros(count), np.zeros(count, np.int64)
    any_weight = mentioned = False
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
        bad = good & ((weight < 0) | (weight > 1 + _WEIGHT_TOLERANCE))
        if bad.any():
            first = int(np.argmax(bad))
            message = f"joint {name}: weight {weight[first]:g} at entry {first} is outside 0..1: the skin explodes"
            add("S05", joint, message, "clamp it")
        inside = ~outside & good
        index, weight = index[inside], weight[inside]
        if len(np.unique(index)) < len(index):
            message = f"joint {name} names {len(index) - len(np.unique(index))} vertices twice: their weights add up"
            add("S06", joint, message, "sum them into one entry")
        any_weight |= bool((weight != 0).any())
        np.add.at(total, index, weight)
        influences[np.unique(index[weight != 0])] += 1
    if figure.skin_coord is None:
        return
    if not any_weight and figure.joints:
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
    off = np.flatnonzero((influences > 0) & (np.abs(total - 1) > _WEIGHT_TOLERANCE))
    if off.size:
        worst = off[int(np.argmax(np.abs(total[off] - 1)))]
        message = f"weights of {off.size} points do not sum to 1 (point {worst}: {total[worst]:.4g})"
        add("S03", figure.node, message + ": below 1 sticks to rest, above 1 overshoots", "normalise")
    many = int((influences > 4).sum())
    if many:
        add("S07", figure.node, f"{many} points have more than 4 influences: glTF and VRM export prunes them")


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
    for geometry in geometries:
        coord = surface.coordinate(geometry)
        if coord is None:
            continue
        points = _rows(chart.numbers(coord, "point"))
        if figure.skin_coord is not None and coord is not figure.skin_coord and weighted:
            same = points.shape == figure.points.shape and np.allclose(points, figure.points, equal_nan=True)
            what = "is a copy of skinCoord" if same else "is another node than skinCoord"
            fix = "USE one Coordinate in both places" if same else "index the skinCoord"
            add("M04", geometry, f"the geometry's Coordinate {what}: the mesh never deforms", fix)
        for field, low in (("coordIndex", -1), ("index", 0)):
            index = chart.indices(geometry, field)
            bad = (index < low) | (index >= len(points))
            if bad.any():
                first = int(np.argmax(bad))
                message = (
                    f"{field}: {int(bad.sum())} entries outside 0..{len(points) - 1} (entry {first}: {index[first]})"
                )
                add("S09", geometry, message, "drop those faces")
            elif field == "coordIndex" and len(index):
                thin = sum(b - a - 1 < 3 for a, b in pairwise([-1, *np.flatnonzero(index == -1)]))
                if thin:
                    add("S09", geometry, f"{thin} faces with fewer than three corners", "drop those faces")
    normals = node.children("skinNormal")
    if normals and figure.skin_coord is not None:
        count = len(_rows(chart.numbers(normals[0], "vector")))
        if count != len(figure.points):
            message = f"skinNormal has {count} vectors for {len(figure.points)} points"
            add("S08", node, message, "leave skinNormal out or recompute it")
    for segment, _ in figure.segments:
        _segment_faces(figure, segment)


def _segment_faces(figure: Figure, segment: Node) -> None:
    chart = figure.chart
    for child in walk_groups(chart.reading, segment.children("children")):
        for geometry in child.children("geometry"):
            coord = surface.coordinate(geometry)
            if coord is None:
                continue
            count = len(_rows(chart.numbers(coord, "point")))
            index = chart.indices(geometry, "coordIndex")
            bad = (index < -1) | (index >= count)
            if bad.any():
                first = int(np.argmax(bad))
                message = f"coordIndex: {int(bad.sum())} entries outside 0..{count - 1} (entry {first}: {index[first]})"
                chart.add("S09", geometry, message, "drop those faces")


def _rows(array: Floats) -> Floats:
    return array[: len(array) // 3 * 3].reshape(-1, 3)


def _cut_out(figure: Figure) -> bool:
    """Whether the Segments draw the skin: all their points are skin points, whose weights are kept beside them."""
    skin = {p.tobytes() for p in figure.points.reshape(-1, 3).astype(np.float32) + 0.0}
    found = False
    for segment, _ in figure.segments:
        for node in walk_groups(figure.chart.reading, segment.children("children")):
            for geometry in node.children("geometry") if node.type == "Shape" else []:
                coord = surface.coordinate(geometry)
                points = _rows(figure.chart.numbers(coord, "point")) if coord is not None else np.zeros((0, 3))
                if any(p.tobytes() not in skin for p in points.astype(np.float32) + 0.0):
                    return False
                found = found or len(points) > 0
    return found


def _displacers(figure: Figure) -> None:
    chart, add = figure.chart, figure.chart.add
    for node, owner in figure.displacers:
        index, moves = chart.indices(node, "coordIndex"), chart.numbers(node, "displacements")
        on_joint = chart.reading.kind(owner) == "Joint"
        if on_joint:
            limit = len(figure.points)
            if figure.skin_coord is None:
                add("D02", node, "displacer of a joint without skinCoord has no effect", "give skinCoord")
        else:
            limit = max((len(_rows(chart.numbers(c, "point"))) for c in _coords(chart, owner)), default=0)
        bad = (index < 0) | (index >= limit)
        if bad.any() and (limit or not on_joint):
            first = int(np.argmax(bad))
            message = f"coordIndex: {int(bad.sum())} entries outside 0..{limit - 1} (entry {first}: {index[first]})"
            add("D01", node, message, "drop those entries")
        if len(moves) % 3 or (len(moves) and len(moves) // 3 != len(index)):
            message = f"{len(index)} coordIndex but {len(moves) / 3:g} displacements"
            add("D01", node, message, "cut both to the shorter")


def _coords(chart: Chart, segment: Node) -> list[Node]:
    found = list(segment.children("coord"))
    for child in walk_groups(chart.reading, segment.children("children")):
        found += [c for g in child.children("geometry") if (c := surface.coordinate(g)) is not None]
    return found
