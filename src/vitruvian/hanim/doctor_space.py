"""Where things are in a file that may hold anything: matrices of nodes, points of meshes. Never raises."""

from __future__ import annotations

import numpy as np

from vitruvian.hanim import surface
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.graph import Node

DEFAULTS = {
    "translation": (0.0, 0.0, 0.0),
    "center": (0.0, 0.0, 0.0),
    "rotation": (0.0, 0.0, 1.0, 0.0),
    "scale": (1.0, 1.0, 1.0),
    "scaleOrientation": (0.0, 0.0, 1.0, 0.0),
}


def vector(chart: Chart, node: Node, field: str) -> Floats:
    """(n,) a field of the five that place things, its default when absent or unusable; axes of length 1."""
    given = chart.numbers(node, field)
    default = np.array(DEFAULTS[field])
    if given.size != default.size or not np.isfinite(given).all():
        return default
    if default.size == 4:
        size = float(np.linalg.norm(given[:3]))
        return np.array([*(given[:3] / size), given[3]]) if size else default
    return given


def matrix(chart: Chart, node: Node) -> Floats:
    """(4, 4) of what places a node among its siblings; the identity when no field does."""
    if not any(field in node.fields for field in DEFAULTS) and node.type not in chart.reading.protos:
        return np.eye(4)
    return surface.matrix(*(vector(chart, node, field) for field in DEFAULTS))


def rows(array: Floats) -> Floats:
    """(n, 3) of a flat array; what is left over at the end is dropped."""
    return array[: len(array) // 3 * 3].reshape(-1, 3)


def at_rest(chart: Chart, joint: Node) -> bool:
    """Whether a joint is neither turned nor moved nor scaled in the file."""
    if not any(field in joint.fields for field in DEFAULTS) and joint.type not in chart.reading.protos:
        return True
    turned = vector(chart, joint, "rotation")[3] != 0
    return not (turned or vector(chart, joint, "translation").any() or (vector(chart, joint, "scale") != 1).any())


def rest_matrices(figure: Figure) -> dict[int, Floats]:
    """Joint node id -> (4, 4) where the file's own pose puts what the joint carries, in humanoid space."""
    found: dict[int, Floats] = {}
    for joint in figure.joints:
        holder = figure.parent[id(joint)]
        above = found[id(holder)] if holder is not None else np.eye(4)
        found[id(joint)] = above if at_rest(figure.chart, joint) else above @ matrix(figure.chart, joint)
    return found


def segment_points(chart: Chart, segment: Node) -> tuple[Floats, bool]:
    """(n, 3) the points of a segment's shapes in its frame, and whether all its shapes have points of their own."""
    found, complete = [], True
    stack: list[tuple[Node, Floats]] = [(n, np.eye(4)) for n in segment.children("children")]
    seen: set[int] = set()
    while stack:
        node, above = stack.pop()
        if id(node) in seen or chart.reading.kind(node):
            continue
        seen.add(id(node))
        if node.type == "Shape":
            for geometry in node.children("geometry"):
                coord = surface.coordinate(geometry)
                complete &= coord is not None
                if coord is not None:
                    points = rows(chart.numbers(coord, "point"))
                    points = points[np.isfinite(points).all(axis=1)]
                    found.append(points @ above[:3, :3].T + above[:3, 3])
            continue
        own = above @ matrix(chart, node) if node.type == "Transform" else above
        complete &= node.type not in {"Inline", "Switch", "LOD"}
        stack.extend((child, own) for child in node.children("children"))
    return np.concatenate(found) if found else np.zeros((0, 3)), complete


def mesh(figure: Figure) -> tuple[Floats, bool]:
    """(n, 3) all points of skin and segments in humanoid space, and whether they are the whole of what is drawn."""
    parts = [figure.points[np.isfinite(figure.points).all(axis=1)]]
    complete = True
    for segment, _ in figure.segments:
        points, whole = segment_points(figure.chart, segment)
        parts.append(points)
        complete &= whole
    return np.concatenate(parts), complete
