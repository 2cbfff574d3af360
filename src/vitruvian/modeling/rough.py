"""A rough stand-in for any person: few points, few joints, few numbers of shape, laid onto a scan in a second.

The points are some of the built-in person's; its shapes are the mean and the principal directions of a seeded sample of the
shape space, all brought to one height, so that only proportions are left and a scan may be in any unit. The pose is that
of 20 joints. Everything is found by Gauss-Newton on closest points both ways, point to plane, with weights that forget
what is far (S. Geman and D. McClure 1987; S. Bouaziz et al., "Sparse iterative closest point", 2013, for the scheme).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vitruvian.body import rotations as rot
from vitruvian.body.types import Floats, Ints
from vitruvian.modeling import anatomy, source
from vitruvian.modeling.shape import Shape, shaped

HEIGHT = 1.7  # metres: what every sample, and every scan, is brought to
SAMPLES = 28
SHAPES = 12  # principal directions that are kept
CELL = 0.032  # metres between points, half as much on hands, feet and head
JOINTS = (
    "humanoid_root", "vl3", "vt6", "vc4", "skullbase",
    "l_sternoclavicular", "l_shoulder", "l_elbow", "l_radiocarpal", "l_hip", "l_knee", "l_talocrural",
    "r_sternoclavicular", "r_shoulder", "r_elbow", "r_radiocarpal", "r_hip", "r_knee", "r_talocrural",
)  # fmt: skip
# Radians that a joint is expected to turn about X (bending), Y (twisting), Z (sideways) from the A pose.
LOOSE = {
    "vl3": (0.15, 0.12, 0.1), "vt6": (0.15, 0.12, 0.1), "vc4": (0.2, 0.2, 0.15), "skullbase": (0.25, 0.3, 0.15),
    "sternoclavicular": (0.08, 0.12, 0.2), "shoulder": (0.7, 0.6, 0.9), "elbow": (0.35, 0.6, 0.35),
    "radiocarpal": (0.25, 0.25, 0.25), "hip": (0.35, 0.25, 0.25), "knee": (0.35, 0.08, 0.06),
    "talocrural": (0.25, 0.15, 0.15),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Rough:
    """The stand-in at rest (the A pose of the source). points (K,3) and what a unit of each shape number adds, (C,K,3);
    centers (J,3) and (C,J,3) likewise; weights (K,J), parents (J,).

    normals (K,3); the last points are the feature points `names`, not for matching; loose (J,3): see `LOOSE`.
    """

    points: Floats
    shapes: Floats
    centers: Floats
    centre_shapes: Floats
    weights: Floats
    parents: Ints
    normals: Floats
    names: tuple[str, ...]
    loose: Floats

    @property
    def matched(self) -> int:
        """How many points are for matching."""
        return len(self.points) - len(self.names)


@dataclass(eq=False)
class Likeness:
    """Where a stand-in stands. turn (J,3,3) of each joint against its parent, shift (3,) of the root, scale, shape (C,)."""

    turn: Floats
    shift: Floats
    scale: float
    shape: Floats


def _samples() -> list[Shape]:
    """People of all kinds, the same every time: corners of the shape space first, then chance."""
    kinds: list[dict[str, Any]] = [
        {}, {"gender": 0.0}, {"gender": 1.0}, {"age": 10}, {"age": 13, "gender": 0.0}, {"age": 80, "gender": 0.0},
        {"age": 80, "gender": 1.0}, {"weight": 0.0}, {"weight": 1.0, "gender": 0.0}, {"weight": 1.0, "gender": 1.0},
        {"muscle": 1.0, "gender": 1.0}, {"muscle": 0.0, "weight": 0.8}, {"height": 0.0}, {"height": 1.0, "gender": 1.0},
        {"height": 1.0, "gender": 0.0}, {"gender": 0.0, "cup": 1.0, "weight": 0.7}, {"proportions": 0.0},
        {"proportions": 1.0},
    ]  # fmt: skip
    rng = np.random.default_rng(7)
    for _ in range(SAMPLES - len(kinds)):
        gender, muscle, weight, height, proportions, cup = rng.uniform(0, 1, 6).round(3).tolist()
        kinds.append(
            {"gender": gender, "muscle": muscle, "weight": weight, "height": height, "proportions": proportions,
             "cup": cup, "age": float(rng.uniform(10, 85)),
             "details": {"measure-upperarm-length": rng.normal(0, 0.4), "measure-lowerarm-length": rng.normal(0, 0.4),
                         "measure-upperleg-height": rng.normal(0, 0.4), "measure-lowerleg-height": rng.normal(0, 0.4),
                         "measure-shoulder-dist": rng.normal(0, 0.4), "measure-waist-circ": rng.normal(0, 0.4)}}
        )  # fmt: skip
    out = []
    for kind in kinds:
        limited = {n: float(np.clip(v, -1, 1)) for n, v in kind.pop("details", {}).items()}
        out.append(Shape(**kind, details=limited))
    return out


@cache
def rough() -> Rough:
    """The stand-in, made once: about a second."""
    names = anatomy.names()
    place = {n: i for i, n in enumerate(names)}
    kept = [place[n] for n in JOINTS]
    fold = np.arange(len(names))
    parents = anatomy.parents()
    for j in range(len(names)):
        while fold[j] not in kept:
            fold[j] = parents[fold[j]]
    above = np.array([kept.index(fold[parents[j]]) if parents[j] >= 0 else -1 for j in kept], np.int32)
    w = source.weights()
    mine = w.vertex < source.BODY
    held = np.zeros((source.BODY, len(kept)))
    row = np.array([kept.index(int(j)) for j in fold])
    np.add.at(held, (w.vertex[mine], row[w.joint[mine]]), w.weight[mine])
    held /= np.maximum(held.sum(axis=1, keepdims=True), 1e-12)
    base = shaped(Shape())[: source.BODY]
    vertex = _some(base, held)
    features = source.feature_vertices()
    vertex = np.concatenate([vertex, list(features.values())])
    everyone, joints = [], []
    for shape in _samples():
        points = shaped(shape)
        body = points[: source.BODY]
        scale = HEIGHT / float(np.ptp(body[:, 1]))
        foot = np.array([0.0, body[:, 1].min(), 0.0])
        everyone.append((body[vertex] - foot) * scale)
        joints.append((anatomy.centers(points)[kept] - foot) * scale)
    flat = np.concatenate([np.array(everyone), np.array(joints)], axis=1).reshape(len(everyone), -1)
    mean = flat.mean(axis=0)
    _, size, rows = np.linalg.svd(flat - mean, full_matrices=False)
    spread = rows[:SHAPES] * (size[:SHAPES, None] / np.sqrt(len(flat)))
    mean, spread = mean.reshape(-1, 3), spread.reshape(SHAPES, -1, 3)
    loose = np.array([LOOSE.get(n.removeprefix("l_").removeprefix("r_"), (9.0, 9.0, 9.0)) for n in JOINTS])
    k = len(vertex)
    return Rough(
        mean[:k],
        spread[:, :k],
        mean[k:],
        spread[:, k:],
        held[vertex],
        above,
        _normals(base)[vertex],
        tuple(features),
        loose,
    )


def _some(base: Floats, held: Floats) -> NDArray[np.int64]:
    """Vertices of the body, spread evenly, more on hands, feet and head; none inside mouth and eye sockets."""
    from vitruvian.modeling.look import mask

    fine = [JOINTS.index(n) for n in ("skullbase", "l_radiocarpal", "r_radiocarpal", "l_talocrural", "r_talocrural")]
    dense = held[:, fine].sum(axis=1) > 0.5
    inside = mask("inside-mouth")[: source.BODY] > 0.1
    out = []
    for part, cell in ((~dense & ~inside, CELL), (dense & ~inside, 0.55 * CELL)):
        index = np.flatnonzero(part)
        key = np.floor(base[index] / cell).astype(np.int64)
        _, where = np.unique(key, axis=0, return_inverse=True)
        where = where.reshape(-1)
        middle = np.stack([np.bincount(where, base[index, a]) for a in range(3)], axis=1) / np.bincount(where)[:, None]
        order = np.lexsort((np.linalg.norm(base[index] - middle[where], axis=1), where))
        first = np.flatnonzero(np.diff(where[order], prepend=-1))
        out.append(index[order[first]])
    return np.concatenate(out)


def _normals(points: Floats) -> Floats:
    return vertex_normals(points, source.array("triangles"))


def vertex_normals(points: Floats, triangles: Ints) -> Floats:
    """(V,3) unit normals, weighted by area; zero where a point has no area around it."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    out = np.stack(
        [np.bincount(triangles.reshape(-1), np.repeat(area[:, k], 3), minlength=len(points)) for k in range(3)], axis=1
    )
    size = np.linalg.norm(out, axis=1, keepdims=True)
    return out / np.where(size > 0, size, 1)


def start(turn: Floats | None = None) -> Likeness:
    """The mean person, upright, facing +Z, turned by (3,3)."""
    turns = np.tile(np.eye(3), (len(JOINTS), 1, 1))
    if turn is not None:
        turns[0] = turn
    return Likeness(turns, np.zeros(3), 1.0, np.zeros(SHAPES))


@dataclass(frozen=True, eq=False)
class Posed:
    """A likeness worked out: points (K,3), normals (K,3), and what derivatives need."""

    points: Floats
    normals: Floats
    blend: Floats  # (K,3,3)
    turns: Floats  # (J,3,3) in space
    centers: Floats  # (J,3)
    parts: Floats  # (K,J,3) the weighted places by joint


def posed(model: Rough, who: Likeness) -> Posed:
    """Where the stand-in's points are; metres of the scan brought to `HEIGHT`."""
    rest = model.points + np.tensordot(who.shape, model.shapes, 1)
    centers = model.centers + np.tensordot(who.shape, model.centre_shapes, 1)
    turns = np.empty_like(who.turn)
    at = np.empty_like(centers)
    for j, p in enumerate(model.parents):
        if p < 0:
            turns[j], at[j] = who.turn[j], who.shift + who.scale * centers[j]
        else:
            turns[j] = turns[p] @ who.turn[j]
            at[j] = at[p] + who.scale * (turns[p] @ (centers[j] - centers[p]))
    offset = at - who.scale * np.einsum("jab,jb->ja", turns, centers)
    blend = np.tensordot(model.weights, turns, 1)
    parts = model.weights[:, :, None] * (who.scale * np.einsum("jab,kb->kja", turns, rest) + offset)
    points = parts.sum(axis=1)
    return Posed(points, np.einsum("kab,kb->ka", blend, model.normals), blend, turns, at, parts)


def jacobian(model: Rough, who: Likeness, now: Posed, rows: NDArray[np.int64]) -> Floats:
    """(n,3,P) how the points `rows` move with: a turn in space of every joint (3 J), shift (3), log scale, shape (C)."""
    below = np.eye(len(JOINTS))
    for j in range(len(JOINTS) - 1, 0, -1):
        below[model.parents[j]] += below[j]
    n, count = len(rows), len(JOINTS)
    sums = np.tensordot(now.parts[rows], below, axes=([1], [1]))  # (n,3,J) weighted places of all joints below
    share = model.weights[rows] @ below.T  # (n,J)
    arm = sums.transpose(0, 2, 1) - share[:, :, None] * now.centers
    out = np.zeros((n, 3, 3 * count + 4 + SHAPES))
    turn = np.zeros((n, 3, count, 3))
    x, y, z = arm[..., 0], arm[..., 1], arm[..., 2]
    turn[:, 1, :, 0], turn[:, 2, :, 0] = -z, y
    turn[:, 0, :, 1], turn[:, 2, :, 1] = z, -x
    turn[:, 0, :, 2], turn[:, 1, :, 2] = -y, x
    out[:, :, : 3 * count] = turn.reshape(n, 3, -1)
    out[:, :, 3 * count : 3 * count + 3] = np.eye(3)
    out[:, :, 3 * count + 3] = now.points[rows] - who.shift
    moved = np.empty((SHAPES, count, 3))
    for j, p in enumerate(model.parents):
        step = model.centre_shapes[:, j] - (model.centre_shapes[:, p] if p >= 0 else 0)
        moved[:, j] = step if p < 0 else moved[:, p] + step @ now.turns[p].T
    moved -= np.einsum("jab,cjb->cja", now.turns, model.centre_shapes)
    local = np.einsum("nab,cnb->nac", now.blend[rows], model.shapes[:, rows])
    local += np.tensordot(model.weights[rows], moved, axes=([1], [1])).transpose(0, 2, 1)
    out[:, :, 3 * count + 4 :] = who.scale * local
    return out


def moved(who: Likeness, now: Posed, step: Floats, parents: Ints) -> Likeness:
    """The likeness after a step (P,) in the coordinates of `jacobian`."""
    count = len(JOINTS)
    turn = who.turn.copy()
    for j, p in enumerate(parents):
        by = step[3 * j : 3 * j + 3]
        size = float(np.linalg.norm(by))
        by = by * min(1.0, 0.5 / max(size, 1e-12))
        frame = now.turns[p] if p >= 0 else np.eye(3)
        turn[j] = frame.T @ rot.to_matrix(rot.from_vector(by)) @ frame @ turn[j]
    scale = float(np.clip(who.scale * np.exp(np.clip(step[3 * count + 3], -0.1, 0.1)), 0.5, 2.0))
    shape = np.clip(who.shape + step[3 * count + 4 :], -4, 4)
    return Likeness(turn, who.shift + step[3 * count : 3 * count + 3], scale, shape)
