"""Scans of people whose feature points are known: persons of the shape space, posed, turned, resampled, damaged."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

import vitruvian as vt
from vitruvian.body import rotations as rot
from vitruvian.body.kinematics import pose_matrices
from vitruvian.modeling import source
from vitruvian.modeling.person import person
from vitruvian.modeling.rough import vertex_normals

UPS = {"y": np.eye(3), "z": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}


@dataclass(frozen=True, eq=False)
class Scan:
    """vertices (V,3), triangles (T,3); truth: feature point -> place (3,); metres: length of the scan's unit."""

    vertices: np.ndarray
    triangles: np.ndarray
    truth: dict[str, np.ndarray]
    metres: float


def scan(
    shape: dict[str, Any],
    *,
    arms: tuple[float, float] = (45, 45),
    bend: float = 10,
    stance: float = 6,
    knee: float = 4,
    head: float = 5,
    yaw: float = 0.0,
    up: str = "y",
    metres: float = 1.0,
    noise: float = 0.001,
    thick: float = 0.0,
    holes: tuple[tuple[str, float], ...] = (),
    cell: float = 0.0,
    dressed: bool = False,
    inside_out: bool = False,
    seed: int = 0,
) -> Scan:
    """`arms` (degrees from the body, left and right), `bend` of elbows, `stance` and `knee` of legs; `yaw` in radians.

    thick: metres of cloth over the skin; holes: feature points and radii; cell: metres, points nearer than that are one.
    """
    rng = np.random.default_rng(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        look = {} if dressed else {"outfit": None, "hair": "none"}
        h = person(**shape, **look)
    points = posed(h, arms, bend, stance, knee, head)
    truth = {n: points[v] for n, v in source.feature_vertices().items()}
    faces = np.concatenate([s.triangles for s in h.skin]) if dressed else source.array("triangles")
    if not dressed:
        points = points[: source.BODY]
    if thick:
        points = points + vertex_normals(points, faces) * thick
    if cell:
        points, faces = clustered(points, faces, cell)
    points = points + rng.normal(size=points.shape) * noise
    for name, radius in holes:
        faces = faces[np.linalg.norm(points[faces].mean(axis=1) - truth[name], axis=1) > radius]
    turn = UPS[up] @ rot.to_matrix(rot.from_vector(np.array([0.0, yaw, 0.0])))
    used, corner = np.unique(faces, return_inverse=True)
    faces = corner.reshape(-1, 3).astype(np.int32)
    if inside_out:
        faces = faces[:, ::-1]
    where = points[used] @ turn.T / metres
    return Scan(where, np.ascontiguousarray(faces), {n: turn @ p / metres for n, p in truth.items()}, metres)


def posed(
    h: vt.Humanoid, arms: tuple[float, float], bend: float, stance: float, knee: float, head: float
) -> np.ndarray:
    """(V,3) points of a humanoid's skin with arms raised, elbows bent forward, legs apart, knees bent, head turned."""
    body = vt.pack(h)
    turns = np.tile([0, 0, 0, 1.0], (len(body.skeleton), 1))
    for side, sign, arm in (("l_", 1, arms[0]), ("r_", -1, arms[1])):
        for name, vector in (
            ("shoulder", (0, 0, sign * arm)),
            ("elbow", (-bend, 0, 0)),
            ("hip", (-knee, 0, sign * stance)),
            ("knee", (2 * knee, 0, 0)),
        ):
            turns[body.skeleton.index[side + name]] = rot.from_vector(np.radians(np.array(vector, float)))
    turns[body.skeleton.index["skullbase"]] = rot.from_vector(np.radians(np.array([head, head, 0.0])))
    matrices = pose_matrices(body.skeleton, turns[None], np.zeros((1, len(body.skeleton), 3)))
    return vt.deformer("log", body)(matrices)[0].astype(np.float64)


def clustered(points: np.ndarray, faces: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """A coarser surface: points of one cell of a grid become their middle, what has no area goes."""
    _, where = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_inverse=True)
    where = where.reshape(-1)
    middle = np.stack([np.bincount(where, points[:, k]) for k in range(3)], axis=1) / np.bincount(where)[:, None]
    small = where[faces]
    return middle, small[(small != np.roll(small, 1, axis=1)).all(axis=1)]


# What a scan may be like, for tests and for the benchmark.
CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "man, A pose": ({"gender": 1.0}, {}),
    "heavy woman, arms low, cloth": ({"gender": 0.0, "weight": 1.0}, {"arms": (25, 25), "thick": 0.01, "yaw": 1.0}),
    "child of 10, T pose, mm, z up": ({"age": 10}, {"arms": (80, 85), "up": "z", "metres": 0.001, "yaw": 2.0}),
    "old thin man, dressed, cm": (
        {"age": 80, "weight": 0.0, "gender": 1.0},
        {"arms": (60, 30), "dressed": True, "metres": 0.01, "yaw": 3.0},
    ),
    "tall heavy man, inches, no soles, no crown": (
        {"gender": 1.0, "weight": 1.0, "height": 1.95},
        {
            "arms": (89, 89),
            "metres": 0.0254,
            "yaw": 4.0,
            "holes": (("skull_vertex", 0.1), ("l_sphyrion", 0.07), ("r_sphyrion", 0.07), ("crotch", 0.08)),
        },
    ),
    "short slack woman, z up, arms at 20": (
        {"gender": 0.0, "muscle": 0.0, "height": 1.52},
        {"arms": (20, 20), "up": "z", "yaw": 5.0},
    ),
    "muscular man, T pose, armpits missing, 4 mm noise": (
        {"gender": 1.0, "muscle": 1.0},
        {"arms": (90, 90), "noise": 0.004, "holes": (("l_axilla_proximal", 0.07), ("r_axilla_distal", 0.07))},
    ),
    "bent woman of 70, resampled": (
        {"gender": 0.0, "age": 70, "weight": 0.9},
        {"arms": (30, 35), "stance": 12, "bend": 25, "knee": 12, "head": 15, "cell": 0.012, "yaw": 0.5},
    ),
    "arms unlike, inside out, coarse": (
        {"gender": 0.5, "weight": 0.2},
        {"arms": (70, 20), "stance": 2, "bend": 40, "knee": 0, "cell": 0.02, "inside_out": True, "yaw": 6.0},
    ),
}


def case(name: str) -> Scan:
    """One of the cases."""
    shape, how = CASES[name]
    return scan(shape, **{"seed": len(name), **how})
