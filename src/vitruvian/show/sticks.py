"""The skeleton of a capture as a figure: a ball for each joint, a stick for each bone, beside the body that it moves."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Body, Floats, Ints, Part, Skeleton, Skin, Weights
from vitruvian.motion.names import match
from vitruvian.motion.turns import positions, world_rotations
from vitruvian.motion.types import Motion

GAP = 0.35  # metres between the two, seen from the front
BALL, STICK = 0.020, 0.012  # radii on a body of 1.75 m, metres
SIDES = 8  # of a stick
COLORS = {"l": (0.27, 0.66, 0.61), "r": (0.93, 0.56, 0.27), "": (0.55, 0.50, 0.85)}  # left, right, middle


@dataclass(frozen=True, eq=False)
class Sticks:
    """A motion on a figure of balls and sticks, with its own rest and proportions: `body` and `motion` of one skeleton."""

    body: Body
    motion: Motion


def sticks(motion: Motion, beside: tuple[Skeleton, Motion] | None = None, *, name: str = "source") -> Sticks:
    """The figure of a motion's skeleton, metres, on the floor (the lowest place that a joint comes to).

    beside: skeleton and motion of a figure that it shall stand beside, to that one's right at its first frame.
    """
    skeleton = replace(motion.skeleton, binding=None)
    skin = _skin(skeleton)
    places = _places(motion)
    placement = np.eye(4)
    placement[1, 3] = -float(places[..., 1].min()) + _thickness(skeleton)
    if beside is not None:
        there = _places(beside[1])[0]
        here = places[min(1, len(places) - 1)]  # the first frame of conversions often is no part of the motion
        right = there[:, 0].min() - GAP - here[:, 0].max()
        placement[[0, 2], 3] = right, float(there[0, 2] - here[0, 2])
        placement[1, 3] += float(min(_places(beside[1])[..., 1].min(), 0.1)) - _thickness(beside[0])
    return Sticks(Body(name, skeleton, skin, placement=placement), motion)


def _places(motion: Motion) -> Floats:
    """(F,J,3) joints over time, metres."""
    s = motion.skeleton
    world = world_rotations(s.parents, motion.rotation)
    return positions(s.parents, s.centers, world, motion.translation, motion.joint_translation)


def _thickness(skeleton: Skeleton) -> float:
    return BALL * _size(skeleton) / 1.75


def _size(skeleton: Skeleton) -> float:
    """The longest way across the resting skeleton, metres; 1.75 where there is none."""
    size = float(np.ptp(np.concatenate([skeleton.centers, skeleton.site_points]), axis=0).max())
    return size if size > 1e-6 else 1.75


def _skin(skeleton: Skeleton) -> Skin:
    """Balls and sticks, each moved by one joint: a stick by the joint that it begins at."""
    unit = _size(skeleton) / 1.75
    roles = match(skeleton.names)
    side: list[str] = []
    for name, p in zip(skeleton.names, skeleton.parents):
        side.append(roles[name][:2] if name in roles else side[p] if p >= 0 else "")
    bones = [(int(p), skeleton.centers[j], j) for j, p in enumerate(skeleton.parents) if p >= 0]
    leaves = set(range(len(skeleton))) - {int(p) for p in skeleton.parents}
    bones += [(int(j), p, int(j)) for j, p in zip(skeleton.site_joints, skeleton.site_points) if int(j) in leaves]
    length = np.full(len(skeleton), np.inf)
    for start, end, _ in bones:
        long = float(np.linalg.norm(end - skeleton.centers[start]))
        if long > 1e-4 * unit:
            length[start] = min(length[start], long)
    near = np.array([min(length[j], length[p] if p >= 0 else np.inf) for j, p in enumerate(skeleton.parents)])
    radius = np.minimum(BALL * unit, 0.22 * near)
    radius[~np.isfinite(radius)] = BALL * unit
    ball, faces = _ball()
    groups: dict[str, list[tuple[Floats, Ints, int]]] = {"": [], "l": [], "r": []}
    for j, center in enumerate(skeleton.centers):
        groups[_group(side[j])].append((center + radius[j] * ball, faces, j))
    for start, end, owner in bones:
        piece = _stick(skeleton.centers[start], end, min(STICK * unit, 0.6 * float(radius[start])))
        if piece is not None:
            groups[_group(side[owner])].append((*piece, start))
    vertices, triangles, joint, parts = [], [], [], []
    count = done = 0
    for which, pieces in groups.items():
        first = done
        for points, corners, j in pieces:
            vertices.append(points)
            triangles.append(corners + count)
            joint += [j] * len(points)
            count, done = count + len(points), done + len(corners)
        if done > first:
            parts.append(
                Part({"": "middle", "l": "left", "r": "right"}[which], first, done, COLORS[which], roughness=0.45)
            )
    weights = Weights(np.arange(count + 1, dtype=np.int32), np.array(joint, np.int32), np.ones(count))
    return Skin(np.concatenate(vertices), np.concatenate(triangles), weights, parts=tuple(parts))


def _group(side: str) -> str:
    return side[0] if side in ("l_", "r_") else ""


def _ball() -> tuple[Floats, Ints]:
    """A unit sphere: an icosahedron, each face in four."""
    g = (1 + 5**0.5) / 2
    corners = [(0, s, t * g) for s in (-1, 1) for t in (-1, 1)]
    points = [np.array(np.roll(c, k), dtype=np.float64) for k in range(3) for c in corners]
    points = [p / np.linalg.norm(p) for p in points]
    near = [[i for i in range(12) if i != j and points[i] @ points[j] > 0.4] for j in range(12)]
    faces = {tuple(sorted((a, b, c))) for a in range(12) for b in near[a] for c in near[a] if c in near[b]}
    middle: dict[tuple[int, int], int] = {}

    def half(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in middle:
            middle[key] = len(points)
            m = points[a] + points[b]
            points.append(m / np.linalg.norm(m))
        return middle[key]

    out = []
    for face in sorted(faces):
        a, b, c = face
        if np.dot(np.cross(points[b] - points[a], points[c] - points[a]), points[a]) < 0:
            b, c = c, b
        ab, bc, ca = half(a, b), half(b, c), half(c, a)
        out += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.array(points), np.array(out, np.int32)


def _stick(start: Floats, end: Floats, radius: float) -> tuple[Floats, Ints] | None:
    """A tapered tube from one point to another; None where they are one."""
    way = end - start
    length = float(np.linalg.norm(way))
    if length < 1e-9 or radius < 1e-9:
        return None
    way = way / length
    across = np.cross(way, np.eye(3)[int(np.abs(way).argmin())])
    across /= np.linalg.norm(across)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    ring: NDArray[np.float64] = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(way, across)
    points = np.concatenate([start + radius * ring, end + 0.6 * radius * ring])
    k = np.arange(SIDES)
    n = (k + 1) % SIDES
    faces = np.concatenate([np.stack([k, n, SIDES + k], 1), np.stack([n, SIDES + n, SIDES + k], 1)])
    return points, faces.astype(np.int32)
