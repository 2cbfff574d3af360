"""Fewer points for what lies between contours: head, hands, feet and clothes of a body that must be quick to draw.

Surfaces are reduced by quadric edge collapse; a new point takes weights, colours and texture coordinates of the point
that it grew out of. Source of the method: Garland and Heckbert, Surface simplification using quadric error metrics, 1997.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vitruvian.body.types import Floats, Ints
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid, Shape

_SMALL = 0.12  # an influence below this is left to the others
_LEAST = 12  # triangles that every shape keeps
_INSIDE = ("teeth", "tongue")  # what a shut mouth hides
_STIFF = ("hair", "brows", "lashes", "eyes")


def lightened(humanoid: Humanoid, points: int) -> Humanoid:
    """A copy whose skin has about `points` points; contour surfaces stay as they are.

    Skin points are metres in humanoid space, in `skin_coord`. Influences under 0.12 are dropped, and hair, brows, lashes
    and eyes follow one joint each, so that most of the skin is rigid. Displacers of the skin are lost. A humanoid with
    fewer points keeps them. Raises VitruvianError for fewer than 100 points.
    """
    if points < 100:
        raise VitruvianError(f"points of the skin: expected at least 100, found {points}")
    shapes = [s for s in humanoid.skin if s.points is None and s.name not in _INSIDE and len(s.triangles)]
    whole = sum(len(np.unique(s.triangles)) for s in shapes)
    out = humanoid.copied()
    joints = out.joints()
    table = _weights(humanoid, joints)
    if whole <= points:
        chosen = [(s, np.unique(s.triangles)) for s in shapes]
        made = [(s, humanoid.skin_coord[v], np.searchsorted(v, s.triangles).astype(np.int32), v) for s, v in chosen]
    else:
        share = np.array([_importance(humanoid.skin_coord, s) for s in shapes])
        budgets = 2 * points * share / share.sum()
        made = [(s, *_reduced(humanoid.skin_coord, s, int(b))) for s, b in zip(shapes, budgets, strict=True)]
    first = np.cumsum([0, *(len(place) for _, place, _, _ in made)])
    rows = [table[born] if s.name not in _STIFF else _of_one(table[born]) for s, _, _, born in made]
    color = [np.ones((len(born), 3)) if s.colors is None else s.colors[born] for s, _, _, born in made]
    texture = [_texture(humanoid.skin_coord, s)[born] for s, _, _, born in made]
    out.skin_coord, out.skin_normal = np.concatenate([place for _, place, _, _ in made]), None
    colors = np.concatenate(color) if any(s.colors is not None for s in shapes) else None
    uv = np.concatenate(texture)
    out.skin = [
        replace(
            s, triangles=(triangles + start).astype(np.int32), colors=colors, uv=None if s.uv is None else uv,
            uv_triangles=None, normals=None, normal_triangles=None, faces=None, skin_index=None, node=None,
        )
        for (s, _, triangles, _), start in zip(made, first[:-1], strict=True)
    ]  # fmt: skip
    weights = np.concatenate(rows)
    weights[weights < _SMALL * weights.max(axis=1, keepdims=True)] = 0
    weights /= np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    for number, joint in enumerate(joints):
        here = np.flatnonzero(weights[:, number] > 0)
        joint.skin_coord_index = here.astype(np.int32)
        joint.skin_coord_weight = weights[here, number]
        joint.displacers = []
    return out.settled()


def _weights(humanoid: Humanoid, joints: list) -> Floats:
    table = np.zeros((len(humanoid.skin_coord), len(joints)))
    for number, joint in enumerate(joints):
        np.add.at(table[:, number], joint.skin_coord_index, joint.skin_coord_weight)
    table[table.sum(axis=1) <= 0, 0] = 1
    return table


def _importance(points: Floats, shape: Shape) -> float:
    a, b, c = np.moveaxis(points[shape.triangles], 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    return float(np.sqrt(area * len(shape.triangles)))


def _reduced(points: Floats, shape: Shape, budget: int) -> tuple[Floats, Ints, Ints]:
    """Points (n,3), triangles (t,3) and (n,) the skin point that each grew out of."""
    import igl

    used, local = np.unique(shape.triangles, return_inverse=True)
    _, first, same = np.unique(np.round(points[used], 6), axis=0, return_index=True, return_inverse=True)
    triangles = same.reshape(-1)[local.reshape(-1, 3)]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    start = np.ascontiguousarray(points[used][first])
    goal = max(_LEAST, min(budget, len(triangles)))
    place, faces, _, born = igl.qslim(start, np.ascontiguousarray(triangles, np.int32), goal)
    kept = np.unique(faces)
    return place[kept], np.searchsorted(kept, faces).astype(np.int32), used[first[born[kept]]]


def _of_one(weights: Floats) -> Floats:
    """All points with the joint that holds the most of them."""
    out = np.zeros_like(weights)
    out[:, np.argmax(weights.sum(axis=0))] = 1
    return out


def _texture(points: Floats, shape: Shape) -> Floats:
    """(n,2) texture coordinates of the skin's points as the shape has them; zero where it has none."""
    out = np.zeros((len(points), 2))
    if shape.uv is not None:
        corners = shape.triangles if shape.uv_triangles is None else shape.uv_triangles
        out[shape.triangles.reshape(-1)] = shape.uv[corners.reshape(-1)]
    return out
