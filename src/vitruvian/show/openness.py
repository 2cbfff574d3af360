"""How open each point of a body lies: soft shade for armpits, fingers and folds, computed once at rest.

The page multiplies ambient light by it, which costs nothing while a figure moves. Only what is near counts, so that an
arm that hangs beside the trunk at rest does not leave its shade there when it is raised.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vitruvian.body.types import Floats, Ints, Skeleton, Weights

RAYS = 32
JOINED = 0.45  # metres along the skeleton
REACH = 0.09  # metres; what is farther away hides nothing


def openness(
    points: Floats,
    triangles: Ints,
    owner: Ints | None = None,
    apart: Floats | None = None,
    *,
    rays: int = RAYS,
    reach: float = REACH,
) -> NDArray[np.float32]:
    """(V,) in 0..1: how much of the cosine-weighted half space above each vertex nothing nearer than `reach` hides.

    points (V,3) metres, triangles (T,3). With `owner` (V,) joints and `apart` (J,J) metres between them along the
    skeleton, surfaces of joints further apart than `JOINED` do not shade each other: a hand leaves the thigh.
    Hits count less with distance. Ambient occlusion by ray casting (Embree);
    all ones where embreex is missing. The directions are fixed: the same mesh gives the same answer.
    """
    count = len(points)
    try:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh
    except ImportError:
        return np.ones(count, np.float32)
    if not len(triangles) or not count:
        return np.ones(count, np.float32)
    _, first, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    if len(first) < count:  # surfaces that meet at a seam have the same shade there
        place = place.reshape(-1)
        mine = None if owner is None else owner[first]
        return openness(points[first], place[triangles].astype(np.int32), mine, apart, rays=rays, reach=reach)[place]
    scene = rtcore_scene.EmbreeScene()
    center = points.mean(axis=0)
    p = np.ascontiguousarray(points - center, dtype=np.float32)
    TriangleMesh(scene, p, np.ascontiguousarray(triangles, dtype=np.int32))
    normal = vertex_normals(p, triangles)
    helper = np.where(np.abs(normal[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(normal, helper)
    u /= np.maximum(np.linalg.norm(u, axis=1, keepdims=True), 1e-12)
    v = np.cross(normal, u)
    origins = np.ascontiguousarray(p + 1e-3 * normal, dtype=np.float32)
    far = np.full(count, reach, np.float32)
    hidden = np.zeros(count)
    turn = np.arange(count) * 2.399963  # the golden angle: neighbours look in different directions
    for k in range(rays):
        rise = np.sqrt((k + 0.5) / rays)  # cosine-weighted
        around = 2.399963 * k + turn
        flat = rise * np.cos(around)[:, None] * u + rise * np.sin(around)[:, None] * v
        direction = np.ascontiguousarray(flat + np.sqrt(1 - rise * rise) * normal, dtype=np.float32)
        hit = scene.run(origins, direction, dists=far.copy(), output=1)  # run writes into dists
        # the back of a surface hides nothing: who sees it lies inside, as a fold of cloth or the root of a hair does
        front = (np.asarray(hit["Ng"]) * direction).sum(axis=1) < 0
        distance = np.where((np.asarray(hit["primID"]) >= 0) & front, np.asarray(hit["tfar"]), np.inf)
        if owner is not None and apart is not None:
            struck = owner[triangles[np.asarray(hit["primID"]), 0]]
            distance[apart[owner, struck] > JOINED] = np.inf
        hidden += np.clip(1 - distance / reach, 0, 1) ** 0.7
    return smooth((1 - hidden / rays).astype(np.float32), triangles)


def owners(weights: Weights) -> Ints:
    """(V,) the joint with the largest weight of each vertex, 0 without any."""
    return weights.top(1)[0][:, 0]


def reaches(skeleton: Skeleton) -> Floats:
    """(J,J) metres between joints along the bones at rest; infinite between trees."""
    n = len(skeleton)
    out = np.full((n, n), np.inf)
    for j, parent in enumerate(skeleton.parents):
        if parent >= 0:
            step = np.linalg.norm(skeleton.centers[j] - skeleton.centers[parent])
            out[j, :j] = out[:j, j] = out[parent, :j] + step
        out[j, j] = 0
    return out


def vertex_normals(points: NDArray, triangles: Ints) -> NDArray[np.float64]:
    """(V,3) unit normals weighted by area; up where a vertex has none."""
    a, b, c = (points[triangles[:, i]].astype(np.float64) for i in range(3))
    face = np.cross(b - a, c - a)
    out = np.zeros((len(points), 3))
    for i in range(3):
        np.add.at(out, triangles[:, i], face)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.where(length > 1e-18, out / np.maximum(length, 1e-18), [[0.0, 1.0, 0.0]])


def smooth(values: NDArray[np.float32], triangles: Ints) -> NDArray[np.float32]:
    """Values (V,) averaged half and half with those of their neighbours: takes the grain of few rays away."""
    total, number = np.zeros(len(values)), np.zeros(len(values))
    for i, j in ((0, 1), (1, 2), (2, 0)):
        for a, b in ((i, j), (j, i)):
            np.add.at(total, triangles[:, a], values[triangles[:, b]])
            np.add.at(number, triangles[:, a], 1)
    return np.where(number > 0, 0.5 * values + 0.5 * total / np.maximum(number, 1), values).astype(np.float32)
