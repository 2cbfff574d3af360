"""Repairs of places: the file's own pose baked into centres, skin and segments; mirrored centres; size and ground.

Baking: M_j is what the file's pose does to all that joint j carries (product of the local matrices down to j). Centres
become M_j c_j, skin points p + sum w (M_j p - p), and what a segment holds is wrapped in a Transform with M_j, so that
the picture stays what it was while every joint is at rest. An animation R(t), t(t) of joint j under parent p becomes
R_p R(t) R_j^-1 R_p^-1 and R_p (t(t) - t_j), where R_j, t_j are the joint's own pose and R_p turns as M_p does: then the
new joint matrices times the baked pose are the old ones at all times.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np

from vitruvian.hanim.animation import event
from vitruvian.hanim.doctor import Chart, Floats
from vitruvian.hanim.doctor_figure import Figure
from vitruvian.hanim.doctor_fix import Wanted, entries, target
from vitruvian.hanim.doctor_fix_played import rebuilt
from vitruvian.hanim.doctor_pose import crooked_pairs, misplaced, placement, whole_body
from vitruvian.hanim.doctor_space import DEFAULTS, at_rest, matrix, mesh, rest_matrices, rows, vector
from vitruvian.hanim.graph import Literal, Node, Use
from vitruvian.hanim.reading import leniently
from vitruvian.hanim.surface import matrix as placed

_UNITS = (0.001, 0.01, 0.0254, 0.1, 0.3048, 10.0, 100.0)  # mm, cm, inch, dm, foot and their like
_PLACES = ("translation", "rotation", "scale", "scaleOrientation")
_TINY = 1e-9


def _bake(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """P01: every joint at rest, the picture and its animation unchanged."""
    chart = figure.chart
    moved = [j for j in figure.joints if not at_rest(chart, j)]
    if not moved:
        return
    poses, bent = rest_matrices(figure), {id(j) for j in moved}
    tracks, played = _tracks(figure, poses), rebuilt(figure, poses)
    if (
        tracks is None
        or played is None
        or any(abs(np.linalg.det(m[:3, :3])) < _TINY or np.linalg.det(m[:3, :3]) < 0 for m in poses.values())
    ):
        return  # what drives it, or a scale of zero, leaves no one answer: the finding stays
    _bake_skin(figure, poses)
    for segment, joint in figure.segments:
        if not np.array_equal(poses[id(joint)], np.eye(4)):
            _carry(figure, segment, poses[id(joint)])
            _carry_mass(figure, segment, poses[id(joint)])
    for joint in figure.joints:
        pose = poses[id(joint)]
        if not np.array_equal(pose, np.eye(4)):
            _carry(figure, joint, pose)
    for displacer, owner in figure.displacers:
        moves = rows(chart.numbers(displacer, "displacements"))
        if id(owner) in poses and len(moves) and not np.array_equal(poses[id(owner)], np.eye(4)):
            displacer.fields["displacements"] = moves @ poses[id(owner)][:3, :3].T
    centers = {id(j): _move(poses[id(j)], vector(chart, j, "center")) for j in figure.joints}
    for joint in figure.joints:
        if id(joint) in bent or not np.array_equal(poses[id(joint)], np.eye(4)):
            joint.fields["center"] = centers[id(joint)]
            _still(figure, joint)
    for interpolator, values in tracks:
        interpolator.fields["keyValue"] = values
    for motion, fields in played:
        motion.fields |= fields
    yield f"the pose of {len(moved)} joints baked into centres, skin and segments; all joints are at rest (P01)"


def _move(pose: Floats, points: Floats) -> Floats:
    return points @ pose[:3, :3].T + pose[:3, 3]


def _tracks(figure: Figure, poses: dict[int, Floats]) -> list[tuple[Node, Floats]] | None:
    """Interpolators and their new values; None when something drives the joints that can't be carried over."""
    chart = figure.chart
    defs = chart.scene.defs()
    by_name = {j.name: j for j in figure.joints if j.name}
    drives: dict[int, set[str]] = defaultdict(set)
    for route in chart.scene.routes():
        drives[id(defs.get(route.from_node))].add(route.to_node)
    found = []
    for route in chart.scene.routes():
        joint, source = by_name.get(route.to_node), defs.get(route.from_node)
        field = event(route.to_field)
        if joint is None or field not in {"rotation", "translation", "scale"}:
            continue
        holder = figure.parent[id(joint)]
        above = poses[id(holder)][:3, :3] if holder is not None else np.eye(3)
        own = np.eye(4) if at_rest(chart, joint) else matrix(chart, joint)
        if np.array_equal(above, np.eye(3)) and np.array_equal(own, np.eye(4)):
            continue
        kinds = {"rotation": "OrientationInterpolator", "translation": "PositionInterpolator"}
        if source is None or source.type != kinds.get(field) or len(drives[id(source)]) > 1:
            return None
        if any(np.abs(m @ m.T - np.eye(3)).max() > 1e-6 for m in (above, own[:3, :3])):
            return None  # scaled: no turn stands for the turned turn
        values = chart.numbers(source, "keyValue")
        if field == "translation":
            shift = vector(chart, joint, "translation")
            found.append((source, (rows(values) - shift) @ above.T))
        else:
            turns = values[: len(values) // 4 * 4].reshape(-1, 4)
            found.append((source, np.array([_turned(t, above, own[:3, :3]) for t in turns]).reshape(-1, 4)))
    return found


def _turned(value: Floats, above: Floats, own: Floats) -> Floats:
    """The axis and angle of R_p R R_j^-1 R_p^-1."""
    size = float(np.linalg.norm(value[:3]))
    zero, one = np.zeros(3), np.ones(3)
    turn = np.array([*(value[:3] / size), value[3]]) if size else np.array([0.0, 0, 1, 0])
    linear = placed(zero, zero, turn, one, np.array([0.0, 0, 1, 0]))[:3, :3]
    return _axis_angle(above @ linear @ own.T @ above.T)


def _axis_angle(turn: Floats) -> Floats:
    """(4,) axis and angle in 0..pi of a rotation matrix, exact near 0 and pi too (through the quaternion)."""
    trace = np.array([np.trace(turn), *np.diag(turn)])
    k = int(np.argmax(trace))
    if k == 0:
        q = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1], 1 + trace[0]])
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q = np.zeros(4)
        q[i] = 1 + turn[i, i] - turn[j, j] - turn[m, m]
        q[j], q[m] = turn[i, j] + turn[j, i], turn[i, m] + turn[m, i]
        q[3] = turn[m, j] - turn[j, m]
    q = q / np.linalg.norm(q) * (1 if q[3] >= 0 else -1)
    size = float(np.linalg.norm(q[:3]))
    angle = 2 * float(np.arctan2(size, q[3]))
    return np.array([*(q[:3] / size), angle]) if size > 1e-12 else np.array([0.0, 0, 1, 0])


def _bake_skin(figure: Figure, poses: dict[int, Floats]) -> None:
    """Skin points and normals where the pose has put them. Counts that differ are read as browsers read them."""
    chart, points = figure.chart, figure.points
    normals = figure.node.children("skinNormal")
    vectors = rows(chart.numbers(normals[0], "vector")) if normals else np.zeros((0, 3))
    moved, turned = points.copy(), vectors.copy()
    for joint in figure.joints:
        pose = poses[id(joint)]
        index, weight = chart.indices(joint, "skinCoordIndex"), chart.numbers(joint, "skinCoordWeight")
        if np.array_equal(pose, np.eye(4)) or not len(index) or not len(weight):
            continue
        weight = np.concatenate([weight, np.full(max(len(index) - len(weight), 0), weight[-1])])[: len(index)]
        inside = (index >= 0) & (index < len(points)) & np.isfinite(weight)
        index, weight = index[inside], weight[inside]
        np.add.at(moved, index, weight[:, None] * (_move(pose, points[index]) - points[index]))
        if len(vectors) == len(points):
            turn = np.linalg.inv(pose[:3, :3]).T
            np.add.at(turned, index, weight[:, None] * (vectors[index] @ turn.T - vectors[index]))
    if figure.skin_coord is not None and not np.array_equal(moved, points, equal_nan=True):
        figure.skin_coord.fields["point"] = moved
        if len(vectors) == len(points) and len(vectors):
            size = np.linalg.norm(turned, axis=1, keepdims=True)
            normals[0].fields["vector"] = turned / np.where(size > 0, size, 1)


def _carry(figure: Figure, owner: Node, pose: Floats) -> None:
    """Move what a joint or segment holds: sites by their own fields, shapes and groups inside one Transform."""
    chart = figure.chart
    kept: list[Node | Use] = []
    carried: list[Node | Use] = []
    for entry in entries(owner, "children"):
        child = target(entry)
        kind = chart.reading.kind(child) if child is not None else "Joint"
        if kind == "Site" and child is not None:
            fields = _fields(pose @ matrix(chart, child))
            _still(figure, child, center=True)
            child.fields |= fields
        (kept if kind else carried).append(entry)
    if carried:
        owner.fields["children"] = [*kept, Node("Transform", fields={**_fields(pose), "children": carried})]
        owner.order = []


def _still(figure: Figure, node: Node, *, center: bool = False) -> None:
    """Take the fields away that place a node; written out where its prototype has another default."""
    for field in (*_PLACES, "center") if center else _PLACES:
        node.fields.pop(field, None)
        default = figure.chart.reading.raw(node, field)
        if isinstance(default, Literal) and not np.array_equal(leniently(default.text), DEFAULTS[field]):
            node.fields[field] = np.array(DEFAULTS[field])


def _fields(pose: Floats) -> dict[str, object]:
    """The Transform fields of a matrix with positive determinant, those that are not default. Polar decomposition."""
    u, size, vt = np.linalg.svd(pose[:3, :3])
    turn, stretch = u @ vt, size
    fields: dict[str, object] = {}
    if np.abs(pose[:3, 3]).max() > _TINY:
        fields["translation"] = pose[:3, 3].copy()
    angle = _axis_angle(turn)
    if abs(angle[3]) > _TINY:
        fields["rotation"] = angle
    if np.ptp(stretch) <= 1e-7 * stretch.max():
        if abs(stretch[0] - 1) > 1e-7:
            fields["scale"] = np.full(3, stretch.mean())
    else:
        basis = vt.T if np.linalg.det(vt) > 0 else -vt.T
        fields["scale"], fields["scaleOrientation"] = stretch.copy(), _axis_angle(basis)
    return fields


def _carry_mass(figure: Figure, segment: Node, pose: Floats) -> None:
    """Centre and moments of inertia go along."""
    chart = figure.chart
    center, inertia = chart.numbers(segment, "centerOfMass"), chart.numbers(segment, "momentsOfInertia")
    if center.size == 3 and center.any() and not (center == -1).all():
        segment.fields["centerOfMass"] = _move(pose, center)
    if inertia.size == 9 and inertia.any():
        u, _, vt = np.linalg.svd(pose[:3, :3])
        turn = u @ vt
        segment.fields["momentsOfInertia"] = (turn @ inertia.reshape(3, 3) @ turn.T).reshape(-1)


def _mirror(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """P03, on request: right centres are mirrored left ones."""
    if "P03+" not in wanted:
        return
    joints = {figure.name(j): j for j in figure.joints}
    pairs = crooked_pairs(figure)
    for left, right in pairs.items():
        joints[right].fields["center"] = figure.chart.numbers(joints[left], "center") * [-1, 1, 1]
    if pairs:
        yield f"centres of {len(pairs)} right joints are those of the left ones, mirrored (P03)"


def _place(figure: Figure, wanted: Wanted) -> Iterator[str]:
    """P05, on request: in metres, on the ground, on the Y axis."""
    at = whole_body(figure)
    if "P05+" not in wanted or at is None:
        return
    chart, node = figure.chart, figure.node
    points, _ = mesh(figure)
    tall, soles, middle = placement(figure, at, points)
    if tall <= 0:
        return
    if not 0.25 <= tall <= 2.7:
        fitting = [f for f in _UNITS if 1.0 <= tall * f <= 1.9]
        factor = min(fitting, key=lambda f: abs(tall * f - 1.5)) if fitting else 1.5 / tall
        node.fields["scale"] = vector(chart, node, "scale") * factor
        yield f"scale times {factor:g}: from ankle to skull it measures {tall * factor:.3g} m (P05)"
        figure = Figure(Chart(chart.scene, chart.path), node)
        tall, soles, middle = placement(figure, at, points)
    high, aside = misplaced(tall, soles, middle, points)
    if high or aside:
        shift = np.array([middle[0] * aside, soles * high, middle[2] * aside])
        node.fields["translation"] = new = vector(figure.chart, node, "translation") - shift
        yield f"translation {' '.join(f'{v:.4g}' for v in new)} puts it onto the ground and the Y axis (P05)"


STEPS = (_bake, _mirror, _place)
