"""Skin weights for players that take four influences, and what that and linear skinning cost in millimetres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from vitruvian.body.kinematics import joint_matrices, pose_matrices
from vitruvian.body.rotations import from_vector
from vitruvian.body.types import Body, Floats, Ints, Weights
from vitruvian.motion.types import Motion


def completed(weights: Weights, joints: int) -> Weights:
    """Rows that sum to one: what is missing goes to one more joint, number `joints`, that never moves.

    Rows that sum to more than one are divided by their sum (glTF can't express them).
    """
    sums = weights.sums
    # a deficit below this is rounding in the file, not a wish to stay at rest
    short = np.flatnonzero(sums < 1 - 1e-4)
    vertex = np.concatenate([weights.vertex, short])
    joint = np.concatenate([weights.joint, np.full(len(short), joints)])
    weight = np.concatenate([weights.weight, 1 - sums[short]])
    full = Weights.from_pairs(len(weights), vertex, joint, weight)
    return Weights(full.row, full.joint, full.weight / full.sums[full.vertex])


def limit(weights: Weights, joints: int, count: int) -> tuple[Ints, Floats, dict[str, Any]]:
    """The `count` largest influences of each vertex, divided by their sum: (V,count) joints and weights, and the facts.

    Ties go to the lower joint; places without weight name joint 0. Joint number `joints` stands for "stays at rest".
    """
    full = completed(weights, joints)
    chosen, kept = full.top(count)
    total = kept.sum(axis=1, keepdims=True)
    facts: dict[str, Any] = {
        "pruned_weights": int((full.counts > count).sum()),
        "largest_dropped_weight": float(max(1 - total.min(initial=1.0), 0.0)),
        "overweight_vertices": int((weights.sums > 1 + 1e-4).sum()),
    }
    kept = (kept / total).astype(np.float32).astype(np.float64)
    kept[:, 0] += 1 - kept.sum(axis=1)
    chosen[kept == 0] = 0
    return chosen, kept, facts


def poses(body: Body, motion: Motion | None, random: int = 100) -> Floats:
    """(F,J,4,4) joint matrices to try a skin on: rest, then every frame, or `random` seeded poses without a motion.

    A random pose turns every joint by up to 60 degrees about a random axis.
    """
    s = body.skeleton
    rest = joint_matrices(s)
    if motion is not None:
        return np.concatenate([rest, joint_matrices(s, motion)])
    rng = np.random.default_rng(0)
    axis = rng.normal(size=(random, len(s), 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    turn = from_vector(axis * rng.uniform(0, np.pi / 3, (random, len(s), 1)))
    return np.concatenate([rest, pose_matrices(s, turn, s.translation[None])])


def matrix_of(joints: NDArray, weights: NDArray, columns: int) -> csr_array:
    """Sparse (V,columns) from padded rows (V,k)."""
    n, k = joints.shape
    return csr_array((weights.reshape(-1), joints.reshape(-1), np.arange(0, n * k + 1, k)), shape=(n, columns))


def browsers(weights: Weights, columns: int) -> csr_array:
    """Sparse (V,columns) with the meaning of H-Anim: p' = p + sum w (M p - p), the last column is what stays."""
    n = len(weights)
    own = csr_array((weights.weight, weights.joint, weights.row), shape=(n, columns))
    still = np.full(n, columns - 1), np.arange(n + 1)
    return own + csr_array((1 - weights.sums, *still), shape=(n, columns))


def measure(body: Body, motion: Motion | None, joints: Ints, weights: Floats, deformer: str) -> dict[str, Any]:
    """Distances in metres between our skin and what a glTF player makes of it, over `poses`."""
    skin, columns = body.skin, len(body.skeleton) + 1
    exact = browsers(skin.weights, columns)
    loss = exact - matrix_of(joints, weights, columns)
    loss.data[np.abs(loss.data) < 1e-7] = 0
    loss.eliminate_zeros()
    rows = np.flatnonzero(np.diff(loss.indptr))
    loss = loss[rows]
    rest = np.concatenate([skin.rest, np.ones((len(skin.rest), 1))], -1)[rows]
    matrices = poses(body, motion)
    worst, square = 0.0, 0.0
    for m in matrices if len(rows) else ():
        blend = (loss @ _flat(m)).reshape(-1, 3, 4)
        distance = ((blend @ rest[:, :, None])[:, :, 0] ** 2).sum(axis=1)
        worst, square = max(worst, float(distance.max())), square + float(distance.sum())
    out: dict[str, Any] = {
        "poses": len(matrices),
        "max_vertex_error_m": worst**0.5,
        "rms_vertex_error_m": (square / (len(matrices) * max(len(skin.rest), 1))) ** 0.5,
        "deformer": deformer,
        "deformer_difference_m": 0.0,
        "displacer_error_m": _displacers(body, exact, matrices),
    }
    if deformer != "linear" and motion is not None:
        out["deformer_difference_m"] = _difference(body, matrices[1:], exact, deformer)
    return out


def _flat(matrices: Floats) -> Floats:
    """(J+1,12): the upper rows of each joint matrix, then those of the joint that stays."""
    return np.concatenate([matrices[:, :3].reshape(-1, 12), np.eye(4)[:3].reshape(1, 12)])


def _difference(body: Body, matrices: Floats, exact: csr_array, deformer: str) -> float:
    """Largest distance between a deformer and linear skinning, over at most 60 frames spread evenly."""
    from vitruvian.deform.deformer import deformer as make

    some = np.linspace(0, len(matrices) - 1, min(len(matrices), 60)).round().astype(int)
    move = make(deformer, body)
    rest = np.concatenate([body.skin.rest, np.ones((len(body.skin.rest), 1))], -1)
    worst = 0.0
    for start in range(0, len(some), 8):
        chunk = matrices[some[start : start + 8]]
        ours = np.asarray(move(chunk, {m.name: 0.0 for m in body.skin.morphs}), np.float64).reshape(len(chunk), -1, 3)
        for m, v in zip(chunk, ours):
            linear = ((exact @ _flat(m)).reshape(-1, 3, 4) @ rest[:, :, None])[:, :, 0]
            worst = max(worst, float(np.linalg.norm(linear - v, axis=1).max(initial=0.0)))
    return worst


def _displacers(body: Body, exact: csr_array, matrices: Floats) -> float:
    """Largest distance that a Joint displacer at weight 1 is off, being morphed before skinning instead of after."""
    late = [m for m in body.skin.morphs if not m.before and len(m.index)]
    if not late:
        return 0.0
    some = matrices[np.linspace(0, len(matrices) - 1, min(len(matrices), 12)).round().astype(int)]
    worst = 0.0
    for m in some:
        flat = _flat(m)
        turn = (exact @ flat).reshape(-1, 3, 4)[:, :, :3]
        for d in late:
            apart = turn[d.index] - m[d.joint, :3, :3]
            worst = max(worst, float(np.linalg.norm((apart @ d.offset[:, :, None])[:, :, 0], axis=1).max()))
    return worst
