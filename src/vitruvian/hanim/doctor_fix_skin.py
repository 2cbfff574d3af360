"""Repairs of the skin: weights, faces, normals, the Coordinate that skin and faces share; displacers; stray shapes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from vitruvian.hanim import surface, tables
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure, loose_shapes, modern
from vitruvian.hanim.doctor_fix import Names, Wanted, entries, put, take, target
from vitruvian.hanim.doctor_skin import WEIGHT_TOLERANCE, displaceable, faces
from vitruvian.hanim.doctor_space import rows, segment_points, vector
from vitruvian.hanim.graph import Node, Use
from vitruvian.hanim.view import walk_groups

Ints = NDArray[np.int64]


def _pairs(figure: Figure, joint: Node) -> tuple[Ints, Floats]:
    return figure.chart.indices(joint, "skinCoordIndex"), figure.chart.numbers(joint, "skinCoordWeight")


def _set(joint: Node, index: Ints, weight: Floats) -> None:
    joint.fields["skinCoordIndex"], joint.fields["skinCoordWeight"] = index.astype(np.int32), weight


def _counts(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """S01, on request: as many weights as indices, as browsers read them."""
    if "S01+" not in wanted:
        return
    for joint in figure.joints:
        index, weight = _pairs(figure, joint)
        if len(index) == len(weight):
            continue
        if 0 < len(weight) < len(index):
            weight = np.concatenate([weight, np.full(len(index) - len(weight), weight[-1])])
        n = min(len(index), len(weight))
        _set(joint, index[:n], weight[:n])
        yield f"joint {figure.name(joint)} has {n} weights for {n} indices (S01)"


def _outside(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """S02: no index beyond the points. When most are, it is the points that are wrong, and nothing is dropped."""
    if figure.skin_coord is None:
        return
    every = np.concatenate([np.zeros(0, np.int64), *(_pairs(figure, j)[0] for j in figure.joints)])
    if 2 * int(((every < 0) | (every >= len(figure.points))).sum()) > len(every):
        return
    for joint in figure.joints:
        index, weight = _pairs(figure, joint)
        bad = (index < 0) | (index >= len(figure.points))
        if bad.any():
            gone = np.flatnonzero(bad)
            _set(joint, index[~bad], np.delete(weight, gone[gone < len(weight)]))
            yield f"{int(bad.sum())} skin indices of joint {figure.name(joint)} outside the points dropped (S02)"


def _clamp(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """S05: weights in 0..1."""
    for joint in figure.joints:
        _, weight = _pairs(figure, joint)
        bad = np.isfinite(weight) & ((weight < 0) | (weight > 1 + WEIGHT_TOLERANCE))
        if bad.any():
            joint.fields["skinCoordWeight"] = np.where(bad, np.clip(weight, 0, 1), weight)
            yield f"{int(bad.sum())} weights of joint {figure.name(joint)} clamped to 0..1 (S05)"


def _sums(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """S06, S03: each point once per joint, its weights sum to 1. Joints with other counts of weights wait for S01."""
    if figure.skin_coord is None or not len(figure.points):
        return
    for joint in figure.joints:
        index, weight = _pairs(figure, joint)
        if ((index < 0) | (index >= len(figure.points))).any() or not np.isfinite(weight).all():
            return
    pairs: dict[int, tuple[Ints, Floats]] = {}
    changed: set[int] = set()
    total, fixed = np.zeros(len(figure.points)), np.ones(len(figure.points), bool)
    for joint in figure.joints:
        index, weight = _pairs(figure, joint)
        if len(index) != len(weight):
            n = min(len(index), len(weight))
            if len(weight):  # browsers use the last weight again: those points can't be scaled by themselves
                fixed[index[n:]] = False
                fixed[index[n - 1 : n]] &= len(weight) >= len(index)
            np.add.at(total, index[:n], weight[:n])
            fixed[index[:n]] &= len(weight) >= len(index)
            continue
        if len(np.unique(index)) < len(index):
            index, where = np.unique(index, return_inverse=True)
            weight = np.bincount(where, weight, minlength=len(index)).astype(np.float64)
            changed.add(id(joint))
            yield f"joint {figure.name(joint)} names each vertex once (S06)"
        pairs[id(joint)] = (index, weight)
        np.add.at(total, index, weight)
    off = (total > 0) & (np.abs(total - 1) > WEIGHT_TOLERANCE) & fixed
    if off.any():
        yield f"weights of {int(off.sum())} vertices sum to 1 (S03)"
    for joint in figure.joints:
        if id(joint) not in pairs:
            index, weight = _pairs(figure, joint)
            n = min(len(index), len(weight))
            if n and off[index[:n]].any():
                joint.fields["skinCoordWeight"] = np.r_[_scaled(index[:n], weight[:n], off, total), weight[n:]]
            continue
        index, weight = pairs[id(joint)]
        if off[index].any():
            weight = _scaled(index, weight, off, total)
            changed.add(id(joint))
        if id(joint) in changed:
            _set(joint, index, weight)


def _scaled(index: Ints, weight: Floats, off: NDArray[np.bool_], total: Floats) -> Floats:
    return np.where(off[index], weight / np.where(total[index] > 0, total[index], 1), weight)


def _unweighted(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """S04, on request: points without weight get those of the nearest weighted point, along the mesh where it reaches."""
    count = len(figure.points)
    if "S04+" not in wanted or not count or not np.isfinite(figure.points).all():
        return
    weighted = np.zeros(count, bool)
    for joint in figure.joints:
        index, weight = _pairs(figure, joint)
        if len(index) != len(weight) or ((index < 0) | (index >= count)).any():
            return
        weighted[index[weight > 0]] = True
    bare = np.flatnonzero(~weighted)
    if not bare.size or not weighted.any():
        return
    source = _nearest(figure, weighted)[bare]
    for joint in figure.joints:
        index, weight = _pairs(figure, joint)
        own = np.zeros(count)
        np.add.at(own, index, weight)
        more = own[source] > 0
        if more.any():
            kept = ~np.isin(index, bare)
            _set(joint, np.r_[index[kept], bare[more]], np.r_[weight[kept], own[source[more]]])
    yield f"{bare.size} skin points have the weights of their nearest neighbour (S04)"


def _nearest(figure: Figure, weighted: NDArray[np.bool_]) -> Ints:
    """(v,) the weighted point nearest to each point: the shortest way along edges, else through the air."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import cKDTree

    points, count = figure.points, len(figure.points)
    ends = []
    for shape in figure.skin:
        for geometry in shape.children("geometry"):
            found = faces(figure.chart, geometry)
            if found is None or surface.coordinate(geometry) is not figure.skin_coord:
                continue
            index = figure.chart.indices(geometry, found.field)
            for a, b in zip(found.first[~found.beyond], found.last[~found.beyond]):
                ends.append(np.stack([index[a:b], np.roll(index[a:b], -1)]))
    at = np.flatnonzero(weighted)
    nearest = at[cKDTree(points[at]).query(points)[1]]
    if ends:
        edge = np.concatenate(ends, axis=1)
        length = np.maximum(np.linalg.norm(points[edge[0]] - points[edge[1]], axis=1), 1e-12)
        graph = coo_array((length, (edge[0], edge[1])), shape=(count, count)).tocsr()
        _, _, source = dijkstra(graph, directed=False, indices=at, min_only=True, return_predecessors=True)
        nearest = np.where(source >= 0, source, nearest)
    return nearest


def _normals(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """S08: one normal for each point, the mean of its faces' by their areas."""
    normals = figure.node.children("skinNormal")
    if not normals or len(rows(figure.chart.numbers(normals[0], "vector"))) == len(figure.points):
        return
    total = np.zeros((len(figure.points), 3))
    for shape in figure.skin:
        for geometry in shape.children("geometry"):
            found = faces(figure.chart, geometry)
            if found is None or surface.coordinate(geometry) is not figure.skin_coord:
                continue
            index = figure.chart.indices(geometry, found.field)
            for a, b in zip(found.first[~found.beyond & ~found.thin], found.last[~found.beyond & ~found.thin]):
                corner = figure.points[index[a:b]]
                normal = np.cross(corner, np.roll(corner, -1, axis=0)).sum(axis=0)  # Newell: twice the area
                np.add.at(total, index[a:b], normal)
    size = np.linalg.norm(total, axis=1)
    if not (size > 0).any() or not np.isfinite(size).all():
        del figure.node.fields["skinNormal"]
        figure.node.order = []
        yield "skinNormal is left out: there are no faces to compute it from (S08)"
        return
    total[size == 0], size[size == 0] = [0, 1, 0], 1
    normals[0].fields["vector"] = total / size[:, None]
    yield f"skinNormal computed anew for {len(figure.points)} points (S08)"


def _faces(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """S09, on request: faces that can't be drawn are dropped."""
    if "S09+" not in wanted:
        return
    shapes = list(figure.skin)
    for segment, _ in figure.segments:
        below = walk_groups(figure.chart.reading, segment.children("children"))
        shapes += [n for n in below if n.type == "Shape"]
    for shape in shapes:
        for geometry in shape.children("geometry"):
            found = faces(figure.chart, geometry)
            if found is None or not (found.beyond | found.thin).any():
                continue
            bad = found.beyond | found.thin
            _drop_faces(figure.chart, geometry, found.field, found.first, found.last, ~bad)
            yield f"{int(bad.sum())} faces of {geometry.type} {geometry.name} dropped (S09)"


def _drop_faces(chart: Chart, geometry: Node, field: str, first: Ints, last: Ints, kept: NDArray[np.bool_]) -> None:
    """Keep some faces; indices per corner and per face go along."""
    length = len(chart.indices(geometry, field))
    ended = geometry.type not in {"IndexedTriangleSet", "IndexedQuadSet"}
    spans = [np.arange(a, min(b + ended, length)) for a, b in zip(first[kept], last[kept])]
    places = np.concatenate(spans) if spans else np.zeros(0, np.int64)
    for other in (field, "texCoordIndex", "normalIndex", "colorIndex"):
        index = chart.indices(geometry, other)
        if len(index) == length:
            geometry.fields[other] = index[places].astype(np.int32)
        elif len(index) == len(first):
            geometry.fields[other] = index[kept].astype(np.int32)


def _skin_coord(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """M04: the skin's geometry and skinCoord share one Coordinate, when the points are the same."""
    node = figure.node
    coords = [c for s in figure.skin for g in s.children("geometry") if (c := surface.coordinate(g)) is not None]
    weighted = any(figure.chart.numbers(j, "skinCoordWeight").any() for j in figure.joints)
    if not coords or not weighted or figure.skin_coord in coords:
        return
    points = figure.chart.numbers(coords[0], "point")
    if figure.skin_coord is not None and not np.array_equal(points.reshape(-1), figure.points.reshape(-1)):
        return
    coords[0].name = coords[0].name or Names(figure.chart.scene).free("hanim_skin_coords")
    node.fields.pop("skinCoord", None)
    node.fields["skinCoord"] = [Use(coords[0].name, coords[0], container="skinCoord", type=coords[0].type)]
    node.order = []
    yield f"skinCoord is a USE of {coords[0].name} (M04)"


def _shape(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """M05, on request: the Shape whose faces use skinCoord goes into skin, when there is one."""
    chart, node = figure.chart, figure.node
    if "M05+" not in wanted or figure.skin or figure.skin_coord is None:
        return
    if not any(chart.numbers(j, "skinCoordWeight").any() for j in figure.joints):
        return
    scene = chart.scene
    for shape in [n for n in chart.nodes if n.type == "Shape"]:
        if figure.skin_coord not in [surface.coordinate(g) for g in shape.children("geometry")]:
            continue
        holder = next(iter(chart.above(shape)), None)
        if holder is None:
            scene.body = [s for s in scene.body if s is not shape]
        else:
            field = next(f for f, entry in holder.entries() if entry is shape)
            take(holder, field, shape)
        put(node, "skin", shape)
        coords = entries(node, "skinCoord")
        late = node.fields.pop("skinCoord")
        if any(isinstance(c, Use) for c in coords):
            node.fields["skinCoord"] = late  # a USE of the Coordinate in the shape stands behind it
        else:
            node.fields = {"skinCoord": late, **node.fields}
        yield f"Shape {shape.name} moved into skin (M05)"
        return


def _displacers(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """D01: indices and displacements that fit. D02, on request: out of a joint that has no skin."""
    chart = figure.chart
    for node, owner in figure.displacers:
        index, moves = chart.indices(node, "coordIndex"), rows(chart.numbers(node, "displacements"))
        limit = displaceable(figure, owner)
        on_joint = chart.reading.kind(owner) == "Joint"
        whole = len(chart.numbers(node, "displacements")) % 3 == 0
        bad = (index < 0) | (index >= limit) if limit or not on_joint else np.zeros(len(index), bool)
        if bad.any() or not whole or (len(moves) and len(moves) != len(index)):
            n = min(len(index), len(moves)) if len(moves) else len(index)
            kept = ~bad[:n]
            if n and not kept.any():
                continue  # nothing would be left: it is the mesh that is wrong
            node.fields["coordIndex"] = index[:n][kept].astype(np.int32)
            if len(moves):
                node.fields["displacements"] = moves[:n][kept]
            else:
                node.fields.pop("displacements", None)
            yield f"displacer {figure.name(node)} cut to {int(kept.sum())} points (D01)"
        if "D02+" in wanted and on_joint and figure.skin_coord is None:
            segment = next((s for s, j in figure.segments if j is owner), None)
            if segment is not None and len(index) and index.max() < displaceable(figure, segment) and index.min() >= 0:
                entry = next(e for e in entries(owner, "displacers") if target(e) is node)
                take(owner, "displacers", entry)
                put(segment, "displacers", entry)
                yield f"displacer {figure.name(node)} moved to segment {figure.name(segment)} (D02)"


def _stray(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """M21, on request: shapes outside any segment go into that of the nearest joint."""
    if "M21+" not in wanted or not figure.joints:
        return
    chart = figure.chart
    for owner, kind, holders, _ in loose_shapes(figure):
        for holder in holders:
            joint = owner if kind == "joint" else _nearest_joint(figure, holder)
            segment = next((s for s, j in figure.segments if j is joint), None)
            if segment is None:
                segment = _new_segment(figure, joint)
                if segment is None:
                    continue
                figure.segments.append((segment, joint))
            entry = next(e for e in entries(owner, "children") if target(e) is holder)
            take(owner, "children", entry)
            put(segment, "children", entry)
            yield f"{holder.type} {holder.name} moved into segment {chart.text(segment, 'name')} (M21)"


def _nearest_joint(figure: Figure, holder: Node) -> Node:
    points, _ = segment_points(figure.chart, Node("Group", fields={"children": [holder]}))
    if not len(points):
        return figure.joints[0]
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return min(figure.joints, key=lambda j: float(np.linalg.norm(vector(figure.chart, j, "center") - middle)))


def _new_segment(figure: Figure, joint: Node) -> Node | None:
    """An empty segment under a joint, with its standard name; None where the file has no type for it."""
    native = joint.type.startswith("HAnim")
    kind = "HAnimSegment" if native else next((s.type for s, _ in figure.segments), "")
    name = tables.canonical(figure.name(joint))
    standard = tables.joints()[name].segment if name else f"{figure.name(joint)}_segment"
    if not kind:
        return None
    if name and not modern(figure):
        standard = tables.name_in(standard, "1.x", "segment") or standard
    segment = Node(kind, Names(figure.chart.scene).free(f"hanim_{standard}"), {"name": standard})
    segment.instance = joint.instance
    held = joint.fields.get("children")
    joint.fields["children"] = [segment, *(held if isinstance(held, list) else entries(joint, "children"))]
    joint.order = []
    return segment


STEPS = (_counts, _outside, _clamp, _sums, _unweighted, _displacers, _skin_coord, _shape, _faces, _normals, _stray)
