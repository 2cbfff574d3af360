"""A small figure for tests: four joints, a hundred or so vertices, every feature a writer has to carry."""

from __future__ import annotations

import numpy as np

from vitruvian.body.types import Body, Morph, Part, Skeleton, Skin, Weights
from vitruvian.motion.types import Motion

NAMES = ("humanoid_root", "vl5", "skullbase", "l_shoulder", "l_elbow", "l_radiocarpal")
PARENTS = (-1, 0, 1, 1, 3, 4)
CENTERS = np.array([[0, 0.9, 0], [0, 1.1, 0], [0, 1.5, 0], [0.2, 1.4, 0], [0.45, 1.4, 0.0], [0.7, 1.4, 0.0]])


def tube(a, b, radius: float, rings: int = 14, around: int = 18) -> tuple[np.ndarray, np.ndarray]:
    """A closed tube from a to b: vertices, triangles."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    axis = (b - a) / np.linalg.norm(b - a)
    side = np.cross(axis, [0, 0, 1.0])
    side /= np.linalg.norm(side)
    other = np.cross(axis, side)
    t = np.linspace(0, 1, rings)
    p = 2 * np.pi * np.arange(around) / around
    ring = radius * (np.cos(p)[:, None] * side + np.sin(p)[:, None] * other)
    swell = np.sqrt(np.clip(1 - (2 * t - 1) ** 6, 0.01, 1))
    points = (a + np.outer(t, b - a))[:, None] + ring * swell[:, None, None]
    vertices = np.concatenate([points.reshape(-1, 3), [a, b]])
    i = np.arange(around)
    j = (i + 1) % around
    faces = []
    for r in range(rings - 1):
        u, v = r * around, (r + 1) * around
        faces += [np.stack([u + i, u + j, v + j], -1), np.stack([u + i, v + j, v + i], -1)]
    n = rings * around
    faces.append(np.stack([0 * i + n, j, i], -1))
    faces.append(np.stack([0 * i + n + 1, n - around + i, n - around + j], -1))
    return vertices, np.concatenate(faces).astype(np.int32)


def figure(*, spread: float = 0.12, deficit: bool = False) -> Body:
    """A trunk and an arm, painted, in two parts, weights that fall off with distance from each joint."""
    parts, vertices, triangles = [], [], []
    start = count = 0
    for name, a, b, r, color in (
        ("skin", (0.1, 1.4, 0), (0.95, 1.4, 0), 0.06, (0.8, 0.6, 0.5)),
        ("top", (0, 0.85, 0), (0, 1.75, 0), 0.16, (0.2, 0.3, 0.6)),
    ):
        v, t = tube(a, b, r)
        vertices.append(v)
        triangles.append(t + start)
        parts.append(Part(name, count, count + len(t), color, 0.5))
        start, count = start + len(v), count + len(t)
    rest, faces = np.concatenate(vertices), np.concatenate(triangles)
    distance = np.linalg.norm(rest[:, None] - CENTERS, axis=-1)
    w = np.exp(-((distance / spread) ** 2) / 2) + 1e-12
    w /= w.sum(axis=1, keepdims=True)
    w[w < 1e-6] = 0
    w /= w.sum(axis=1, keepdims=True)
    if deficit:
        w[rest[:, 1] < 1.0] *= 0.6
    v, j = np.nonzero(w)
    bump = np.flatnonzero((rest[:, 1] > 1.6) & (rest[:, 2] > 0.05))
    morphs = (
        Morph("smile_action", bump, np.tile([0.0, 0.0, 0.03], (len(bump), 1)), 2),
        Morph("chest_action", bump[:4], np.tile([0.0, 0.01, 0.0], (4, 1)), 1, before=True),
    )
    uv = np.stack([np.arctan2(rest[:, 2], rest[:, 0]) / 2 / np.pi + 0.5, rest[:, 1] / 2], -1)
    colors = np.where(np.arange(len(rest))[:, None] < len(vertices[0]), [0.8, 0.6, 0.5], [0.2, 0.3, 0.6])
    skin = Skin(rest, faces, Weights.from_pairs(len(rest), v, j, w[v, j]), uv, faces, colors, tuple(parts), morphs)
    limits = np.full((6, 3, 2), np.nan)
    limits[4] = [[-2.5, 0], [-0.1, 0.1], [-1, 1]]
    skeleton = Skeleton(
        NAMES, np.array(PARENTS), CENTERS, limits=limits,
        site_names=("l_hand_tip", "front_view"), site_joints=np.array([5, 0]),
        site_points=np.array([[0.95, 1.4, 0], [0.4, 1.4, 3.0]]),
    )  # fmt: skip
    return Body("tester", skeleton, skin)


def wave(body: Body, frames: int = 12, *, loop: bool = True) -> Motion:
    """The arm waves, the trunk turns and the figure wanders."""
    t = np.arange(frames) / frames * 2 * np.pi
    rotation = np.zeros((frames, len(body.skeleton), 4))
    rotation[..., 3] = 1
    for joint, axis, size in ((0, 1, 0.4), (1, 2, 0.3), (3, 2, 0.9), (4, 1, 1.2), (5, 0, 0.8)):
        angle = size * np.sin(t + joint)
        rotation[:, joint, axis], rotation[:, joint, 3] = np.sin(angle / 2), np.cos(angle / 2)
    translation = np.stack([0.1 * np.sin(t), 0.02 * np.cos(2 * t), 0.05 * np.cos(t)], -1)
    weights = {"smile_action": 0.5 + 0.5 * np.sin(t)}
    return Motion(body.skeleton, 24.0, rotation, translation, weights=weights, loop=loop, name="wave")
