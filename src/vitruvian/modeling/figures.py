"""Bodies made ready for measuring: the surface, the feature points, which part of the body each triangle is."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats
from vitruvian.errors import VitruvianError
from vitruvian.hanim.humanoid import Humanoid
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.features import feature_points
from vitruvian.modeling.mass import part_of
from vitruvian.modeling.measures import Figure, figure_of
from vitruvian.modeling.scans import Surface

_WHOLE = ("trunk", "head")


def humanoid_figure(humanoid: Humanoid, landmarks: Mapping[str, Floats] | None = None) -> Figure:
    """A humanoid at rest; the built-in person without its clothes and hair, with the skin that they hide."""
    places = landmarks if landmarks is not None else feature_points(humanoid)
    if bare(humanoid):
        return Figure(humanoid.skin_coord[: source.BODY], source.array("triangles"), places, built_in_parts())
    joints = humanoid.joints()
    moving = [s.triangles for s in humanoid.skin if s.points is None and len(s.triangles)]
    if moving:
        triangles = np.concatenate(moving)
        strongest = np.full(len(humanoid.skin_coord), -1)
        best = np.zeros(len(humanoid.skin_coord))
        for k, joint in enumerate(joints):
            index, weight = joint.skin_coord_index, joint.skin_coord_weight
            more = weight > best[index]
            strongest[index[more]], best[index[more]] = k, weight[more]
        owner = strongest[triangles]
        parts = _named([j.name for j in joints], part_of(joints), owner) if (strongest >= 0).any() else None
        return figure_of(humanoid.skin_coord, triangles, places, parts)
    points, faces, start = [], [], 0
    for segment in humanoid.segments():
        for shape in segment.shapes:
            if shape.points is not None and len(shape.triangles):
                where = np.asarray(shape.points, dtype=np.float64)
                if shape.transform is not None:
                    where = where @ shape.transform[:3, :3].T + shape.transform[:3, 3]
                points.append(where)
                faces.append(shape.triangles + start)
                start += len(where)
    if not points:
        raise VitruvianError(f"humanoid {humanoid.name!r}: expected a skin or Segment geometry to measure, found none")
    return figure_of(np.concatenate(points), np.concatenate(faces), places)


def _named(names: list[str], part: dict[str, str], owner: NDArray[np.integer]) -> NDArray[np.str_]:
    """(T,) the part of triangles whose corners belong to joints `owner` (T,3); "" where corners disagree or have none."""
    sided = [part[n] if part[n] in _WHOLE else (n[:2] if n[:2] in ("l_", "r_") else "") + part[n] for n in names]
    label = np.array([*sided, ""])
    corners = label[owner]
    return np.where((corners[:, 0] == corners[:, 1]) | (corners[:, 0] == corners[:, 2]), corners[:, 0], corners[:, 1])


@cache
def built_in_parts() -> NDArray[np.str_]:
    """(27036,) the part of each triangle of the built-in body."""
    strongest = source.weights().top(1)[0][: source.BODY, 0]
    joints = list(anatomy.skeleton(4, np.zeros((len(anatomy.names()), 3))).values())
    return _named(list(anatomy.names()), part_of(joints), strongest[source.array("triangles")])


def bare(humanoid: Humanoid) -> bool:
    """Whether the points are those of the built-in person, some of whose skin is left out below clothes."""
    if len(humanoid.skin_coord) < source.BODY:
        return False
    whole = source.array("triangles")
    for shape in humanoid.skin:
        if shape.points is None and len(shape.triangles) > len(whole) // 4 and shape.triangles.max() < source.BODY:
            mine, known = (
                np.sort(t, axis=1).astype(np.int64) @ [1 << 32, 1 << 16, 1] for t in (shape.triangles, whole)
            )
            if np.isin(mine, known).mean() > 0.98:
                return True
    return False


def surface_frame(landmarks: Mapping[str, Any], unit: str | None) -> tuple[Floats, float, dict[str, Floats]]:
    """The turn (3,3) that stands a surface upright, metres per unit of it, and its landmarks, checked, as they are."""
    from vitruvian.modeling.landmarks import UNITS, checked

    if unit is not None and unit not in UNITS:
        raise VitruvianError(f"unit: expected one of {', '.join(UNITS)}, found {unit!r}")
    seen = checked(landmarks)
    return _upright(seen.points), UNITS[unit or seen.unit], seen.points


def surface_figure(mesh: Surface, landmarks: Mapping[str, Floats] | None, unit: str | None) -> Figure:
    """A surface turned upright and brought to metres by its landmarks, or by what is found on it."""
    from vitruvian.modeling.landmarks import detect

    given = {n: p for n, (p, _) in detect(mesh).items()} if landmarks is None else dict(landmarks)
    turn, metres, seen = surface_frame(given, unit)
    points = np.asarray(mesh.vertices, dtype=np.float64) @ turn.T * metres
    return figure_of(points, mesh.triangles, {n: turn @ p * metres for n, p in seen.items()})


def _upright(points: Mapping[str, Floats]) -> Floats:
    """(3,3) the turn that makes the axis that is up +Y and the left of the body +X."""
    high = [p for n, p in points.items() if n in ("skull_vertex", "sellion", "menton", "cervicale", "suprasternale")]
    low = [p for n, p in points.items() if "tarsal" in n or "malleolus" in n or "calcaneus" in n or "femoral" in n]
    across = [p - points["r_" + n[2:]] for n, p in points.items() if n[:2] == "l_" and "r_" + n[2:] in points]
    if not high or not low or not across:
        raise VitruvianError("measures: expected feature points of head, legs and both sides to tell which way is up")
    up = np.mean(high, axis=0) - np.mean(low, axis=0)
    axis = np.zeros(3)
    axis[np.argmax(np.abs(up))] = np.sign(up[np.argmax(np.abs(up))])
    left = np.mean(across, axis=0)
    left = left - (left @ axis) * axis
    left /= max(float(np.linalg.norm(left)), 1e-12)
    return np.stack([left, axis, np.cross(left, axis)])
