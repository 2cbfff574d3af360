"""Bodies that the skinning tests share."""

from __future__ import annotations

import numpy as np

from vitruvian.body.kinematics import pose_matrices
from vitruvian.body.rotations import from_vector, normalize
from vitruvian.body.types import Body, Skeleton, Skin, Weights

RINGS, POINTS = 81, 64


def skeleton(joints: int, centers=None, chain=True) -> Skeleton:
    centers = np.zeros((joints, 3)) if centers is None else centers
    parents = np.arange(-1, joints - 1) if chain else np.full(joints, -1)
    return Skeleton(tuple(f"j{i}" for i in range(joints)), parents, centers)


def point(weights, position=(0.3, 0.4, 0.5)) -> Body:
    """One vertex on as many joints as there are weights."""
    n = len(weights)
    rows = Weights.from_pairs(1, np.zeros(n, int), np.arange(n), weights)
    return Body("point", skeleton(n, chain=False), Skin(np.array([position]), np.zeros((0, 3), np.int32), rows))


def cylinder(weights_of, joints: int = 2) -> Body:
    """Closed cylinder, radius 1, z in -4..4; `weights_of(z)` gives (V, joints) weights."""
    z = np.repeat(np.linspace(-4, 4, RINGS), POINTS)
    turn = np.tile(np.arange(POINTS) * 2 * np.pi / POINTS, RINGS)
    rest = np.concatenate([np.stack([np.cos(turn), np.sin(turn), z], 1), [[0, 0, -4.0], [0, 0, 4.0]]])
    a = np.arange(POINTS)
    b = (a + 1) % POINTS
    sides = [np.stack([r + a, r + b, r + POINTS + b, r + POINTS + a], 1) for r in np.arange(RINGS - 1) * POINTS]
    quads = np.concatenate(sides)
    last = (RINGS - 1) * POINTS
    low, high = np.full(POINTS, RINGS * POINTS), np.full(POINTS, RINGS * POINTS + 1)
    caps = [np.stack([low, b, a], 1), np.stack([high, last + a, last + b], 1)]
    triangles = np.concatenate([quads[:, :3], quads[:, [0, 2, 3]], *caps])
    weights = weights_of(rest[:, 2])
    vertex, joint = np.nonzero(weights > -1)
    rows = Weights.from_pairs(len(rest), vertex, joint, weights[vertex, joint])
    centers = np.zeros((joints, 3))
    centers[0, 2] = -4
    return Body("cylinder", skeleton(joints, centers, chain=False), Skin(rest, triangles, rows))


def halves(z):
    s = np.clip((z + 1.5) / 3, 0, 1)
    s = s * s * (3 - 2 * s)
    return np.stack([1 - s, s], axis=1)


def turned(axis, degrees: float) -> np.ndarray:
    """Matrices (2,4,4): the second joint turned about an axis through the origin."""
    rotation = from_vector(np.radians(degrees) * np.asarray(axis, dtype=float))
    return pose_matrices(skeleton(2, chain=False), np.stack([[0, 0, 0, 1.0], rotation])[None], np.zeros((1, 2, 3)))[0]


def volume(body: Body, points) -> float:
    a, b, c = (points[body.skin.triangles[:, k]].astype(float) for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def ring_areas(points) -> np.ndarray:
    rings = np.asarray(points, dtype=float)[: RINGS * POINTS].reshape(RINGS, POINTS, 3)
    rings = rings - rings.mean(axis=1, keepdims=True)
    return np.linalg.norm(np.cross(rings, np.roll(rings, -1, axis=1)).sum(axis=1), axis=1) / 2


def crowd(influences: int, vertices: int = 150, joints: int = 12, *, sums=None, seed: int = 0) -> Body:
    """Random vertices with 1 to `influences` random joints each; `sums` (low, high) scales the weights."""
    rng = np.random.default_rng(seed)
    vertex, joint, weight = [], [], []
    for v in range(vertices):
        k = int(rng.integers(1, influences + 1))
        total = 1.0 if sums is None else rng.uniform(*sums)
        vertex += [v] * k
        joint += rng.choice(joints, k, replace=False).tolist()
        weight += (rng.dirichlet(np.ones(k)) * total).tolist()
    rest = rng.uniform(-1, 1, (vertices, 3))
    triangles = rng.integers(0, vertices, (vertices, 3))
    skin = Skin(rest, triangles, Weights.from_pairs(vertices, vertex, joint, weight))
    return Body("crowd", skeleton(joints, rng.uniform(-1, 1, (joints, 3))), skin)


def poses(body: Body, frames: int = 3, angle: float = 0.5, seed: int = 1, scale: bool = False) -> np.ndarray:
    """Random matrices about the joints' centres, none of which hangs on another."""
    rng = np.random.default_rng(seed)
    n = len(body.skeleton)
    more = {}
    if scale:
        more = {
            "scale": rng.uniform(0.7, 1.4, (n, 3)),
            "scale_orientation": normalize(rng.normal(size=(n, 4))),
        }
    loose = Skeleton(body.skeleton.names, np.full(n, -1), body.skeleton.centers, **more)
    turns = rng.normal(size=(frames, n, 3))
    turns *= rng.uniform(0, angle, (frames, n, 1)) / np.linalg.norm(turns, axis=-1, keepdims=True)
    return pose_matrices(loose, from_vector(turns), rng.normal(scale=0.05, size=(frames, n, 3)))
